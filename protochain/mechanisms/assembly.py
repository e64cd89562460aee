"""A mechanism as built, and the rows of its motion, as integrators and pictures see them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from protochain.core.arrays import Floats, finite, read_only
from protochain.core.checks import number
from protochain.core.errors import BodyError, MechanicsError
from protochain.mechanics import multibody
from protochain.mechanics.motion import Drive, Equations, Load, Phase, System
from protochain.mechanics.multibody import Tree
from protochain.mechanics.multibody.newton_euler import momenta_of_bodies
from protochain.mechanisms.bodies import Bodies, State
from protochain.mechanisms.elements import Conservative, Memory, Sum
from protochain.mechanisms.event import Event, Happened
from protochain.mechanisms.explicit import CompiledLoops, CompiledSystem, compile_elements
from protochain.mechanisms.loop_factors import DEPENDENT
from protochain.mechanisms.loop_joints import ClosedEquations

Coordinates = ArrayLike | Mapping[str, ArrayLike] | None
"""Values of all freedoms, of hinges by name, or by default of the start."""


@dataclass(frozen=True, eq=False)
class NamedLoad:
    """A load, whose work is counted under its name, and the hinges at which it is a motor's torque."""

    name: str
    load: Load
    dissipates: bool = False
    hinges: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Assembly:
    """Bodies, the elements that act on them, and the start. See :class:`Model`."""

    bodies: Bodies  # Bodies by name, with their tree.
    q: Floats  # (n_q,) float: Coordinates at the start.
    qd: Floats  # (n_v,) float: Velocities at the start.
    conservative: tuple[Conservative, ...] = ()  # Elements with an energy, by kind.
    loads: tuple[NamedLoad, ...] = ()  # Loads by name.
    # Time -> coordinates, rates and accelerations of the driven hinges, in the order of the tree.
    drive: Drive | None = None
    events: tuple[Event, ...] = ()  # Events.
    inside: bool = False  # Whether nothing acts from outside, so that momentum and spin are conserved.
    memories: tuple[Memory, ...] = ()  # Memories of elements from step to step.

    @property
    def tree(self) -> Tree:
        """Rigid bodies."""
        return self.bodies.tree

    @property
    def directions(self) -> Floats:
        """(n_v, k) float: directions in which it can move, as columns: of all hinges that are not driven."""
        return self.directions_at(self.start())

    def directions_at(self, at: Phase) -> Floats:
        """As :attr:`directions`, at a phase."""
        free = np.eye(self.tree.n_v)[:, self.tree.undriven_v]
        joints, frames = self.bodies.joints, at.factors.frames
        if joints is None:
            return free
        g = joints.matrix(self.tree, frames)[:, self.tree.undriven_v]
        sizes = np.linalg.svd(g, compute_uv=False)
        rank = int(np.sum(sizes > DEPENDENT * max(1.0, np.max(sizes, initial=0.0))))
        rank = rank if joints.rank is None else min(rank, joints.rank)
        rows = multibody.row_matrix(self.tree, frames, joints.rows(frames)[1])
        return np.asarray(free @ np.linalg.svd(rows @ free)[2][rank:].T) if rank else free

    @cached_property
    def system(self) -> Equations:
        """The mechanism as integrators see it."""
        loads = tuple(acting.load for acting in self.loads)
        potential, joints = Sum(self.tree, self.conservative), self.bodies.joints
        compiled = compile_elements(self.tree, self.conservative, loads, self.drive, joints)
        common: dict[str, Any] = {
            "tree": self.tree, "potential": potential, "loads": loads, "drive": self.drive,
        }  # fmt: skip
        if joints is not None:
            common["joints"] = joints
        if compiled is not None:
            return (CompiledSystem if joints is None else CompiledLoops)(**common, compiled=compiled)
        return (System if joints is None else ClosedEquations)(**common)

    @property
    def works(self) -> tuple[str, ...]:
        """Names of elements that do work, in the order of ``Phase.work``."""
        return (*(load.name for load in self.loads), *(("drives",) if self.drive is not None else ()))

    def start(self) -> Phase:
        """Phase at the start. Refused if the pose is singular, or an element returns a non-finite value."""
        return self._phase(None, None, 0.0)

    def _phase(self, q: Coordinates, qd: Coordinates, time: float) -> Phase:
        """Phase at coordinates and velocities, as :meth:`state` accepts them."""
        try:
            at = self._values(q, "q", self.q), self._values(qd, "qd", self.qd)
            return self.system.at(*at, number(time, "time"))
        except BodyError as error:
            raise error.by_name(self.bodies.names) from None

    def _values(self, values: Coordinates, name: str, usual: Floats) -> Floats:
        """Array of values, or of values by hinge. Without a value a hinge has the usual one."""
        if not isinstance(values, Mapping):
            return usual if values is None else finite(values, usual.shape, name)
        out = usual.copy()
        for hinge, value in values.items():
            self.bodies.hinge(hinge, name)
            place = (self.bodies.ball(hinge) or self.bodies.freedom(hinge, name))[name != "q"]
            place = slice(place, place + 1) if isinstance(place, int) else place
            unit = 1.0 if name == "tau" else self.bodies.unit(hinge)
            out[place] = unit * finite(value, out[place].shape, f"{name} of {hinge}")
        return out

    def state(
        self, at: Phase | None = None, *, q: Coordinates = None, qd: Coordinates = None, time: float = 0.0
    ) -> State:
        """State at a phase, or at coordinates and velocities, for points and velocities by name.

        Parameters
        ----------
        at : Phase, optional
            Phase, as :attr:`Run.end`. It excludes the other arguments.
        q : (n_q,) float, or mapping of str to float, optional
            Coordinates in radians, or coordinates of hinges by name, in the unit of the mechanism. Other
            coordinates are the start's. Loops are closed with the least change.
        qd : (n_v,) float, or mapping of str to float, optional
            Velocities, as ``q``.
        time : float
            Time of the drives.

        Returns
        -------
        State
            With all bodies in place.

        Raises
        ------
        MechanicsError
            If a hinge is unknown, the pose is singular, or loops do not close.
        """
        if at is not None and not (q is qd is None):
            raise MechanicsError("state: a phase has coordinates; give a phase, or q and qd")
        at = self._phase(q, qd, time) if at is None else at
        state = State(self.bodies, at.time, at.q, at.qd, at.factors.frames)
        # Known already, so that impulses need not factorise again.
        state.__dict__["factors"] = at.factors
        return state

    def mass_matrix(self, q: Coordinates = None, time: float = 0.0) -> Floats:
        """Mass matrix M, so that the kinetic energy is qd^T M qd / 2.

        Parameters
        ----------
        q, time : (n_q,) float or mapping, and float
            As of :meth:`state`.

        Returns
        -------
        (n_v, n_v) float
            As of Pinocchio's ``crba`` and MuJoCo's ``mj_fullM``, with the inertia of rotors. Freedoms are in
            the order of ``qd``. ``bodies.freedom(hinge)`` returns their places.
        """
        return multibody.mass_matrix(self.tree, self._phase(q, None, time).factors.frames)

    def bias(self, q: Coordinates = None, qd: Coordinates = None, time: float = 0.0) -> Floats:
        """Torques without acceleration: b in M qdd + b = tau.

        Parameters
        ----------
        q, qd, time : (n_q,) and (n_v,) float or mappings, and float
            As of :meth:`state`.

        Returns
        -------
        (n_v,) float
            Velocity products minus gravity, as Pinocchio's ``nonLinearEffects`` and MuJoCo's ``qfrc_bias``,
            minus the torques of all other elements.
        """
        return self.inverse_dynamics(q, qd, np.zeros(self.tree.n_v), time)

    def forward_dynamics(
        self, q: Coordinates = None, qd: Coordinates = None, tau: Coordinates = None, time: float = 0.0
    ) -> Floats:
        """Accelerations under all elements and further torques.

        Parameters
        ----------
        q, qd, time : (n_q,) and (n_v,) float or mappings, and float
            As of :meth:`state`.
        tau : (n_v,) float, or mapping of str to float, optional
            Torques at hinges, and forces at slides, in addition to the elements.

        Returns
        -------
        (n_v,) float
            Accelerations in radians, with closed loops, and as prescribed at driven hinges.
        """
        at = self._phase(q, qd, time)
        torque = at.torque + self._values(tau, "tau", np.zeros(self.tree.n_v))
        return self.system.accelerations(at.time, at.q, at.qd, torque, at.loads, at.factors)[0]

    def inverse_dynamics(
        self, q: Coordinates, qd: Coordinates, qdd: Coordinates, time: float = 0.0
    ) -> Floats:
        """Torques that accelerations require in addition to all elements.

        Parameters
        ----------
        q, qd, time : (n_q,) and (n_v,) float or mappings, and float
            As of :meth:`state`.
        qdd : (n_v,) float, or mapping of str to float
            Accelerations, of other hinges 0.

        Returns
        -------
        (n_v,) float
            Torques at hinges, and forces at slides, driven ones included. Joints of loops transmit no force.
        """
        at = self._phase(q, qd, time)
        qdd = self._values(qdd, "qdd", np.zeros(self.tree.n_v))
        return self.system.inverse_dynamics(at.q, at.qd, qdd) - at.torque


Row = tuple[float, Floats, Floats, Floats, float, Floats, float]
"""Time, q, qd, p, potential energy and work of a phase, and energy that events have given until then: a plain
tuple, because a NamedTuple needs twice as long."""


def _column(k: int, doc: str) -> "cached_property[Floats]":
    """Property of a motion: column k of its rows, as an array."""
    column = cached_property(lambda motion: read_only([row[k] for row in motion.rows]))
    column.__doc__ = doc
    return column


@dataclass(frozen=True, eq=False)
class Motion:
    """Rows of a motion, as arrays that are made at first use. See :class:`Run`."""

    model: Assembly  # The mechanism.
    rows: Sequence[Row]  # Phases, without their factors.
    events: tuple[Happened, ...]  # Events that happened.
    end: Phase  # Phase at the end, from which :meth:`Model.simulate` can go on.
    # Contents of the model's memories at each row, empty without memories.
    kept: Sequence[tuple[Any, ...]] = ()

    time = _column(0, "(n,) float: times of the rows.")
    q = _column(1, "(n, n_q) float: coordinates.")
    qd = _column(2, "(n, n_v) float: velocities.")
    potential = _column(4, "(n,) float: potential energy.")
    work = _column(5, "(n, k) float: work since the start of each of ``model.works``.")
    jumps = _column(6, "(n,) float: energy given by events since the start.")

    @cached_property
    def kinetic(self) -> Floats:
        """(n,) float: kinetic energy."""
        return read_only(0.5 * np.einsum("ij,ij->i", [row[3] for row in self.rows], self.qd))

    @property
    def total(self) -> Floats:
        """(n,) float: energy."""
        return self.kinetic + self.potential

    @property
    def dissipation(self) -> Floats:
        """(n,) float: energy that dampers and friction have dissipated."""
        taking = np.flatnonzero([load.dissipates for load in self.model.loads])
        return np.asarray(0.0 - np.sum(self.work[:, taking], axis=1))

    @property
    def momenta(self) -> Floats:
        """(n, 2, 3) float: momentum, and angular momentum about the world's origin."""
        return self._momenta[0]

    @cached_property
    def _momenta(self) -> tuple[Floats, Floats]:
        """Momentum and spin, and the sums of their sizes over the bodies, (n, 2)."""
        tree, n = self.model.tree, len(self.time)
        totals, sizes = np.empty((n, 2, 3)), np.empty((n, 2))
        for i, (q, qd) in enumerate(zip(self.q, self.qd, strict=True)):
            frames = multibody.pose(tree, q)
            momenta = momenta_of_bodies(tree, frames, multibody.velocities(tree, frames, qd))
            linear_and_angular = momenta[:, 3:], momenta[:, :3] + np.cross(frames.origin, momenta[:, 3:])
            totals[i] = [np.sum(one, axis=0) for one in linear_and_angular]
            sizes[i] = [np.sum(np.linalg.norm(one, axis=1)) for one in linear_and_angular]
        return read_only(totals), read_only(sizes)
