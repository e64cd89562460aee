"""Mechanisms of which some bodies bend by shapes: equations of motion for any integrator, and the start."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from protochain.core.arrays import Floats, read_only
from protochain.core.checks import brief
from protochain.core.errors import MechanicsError
from protochain.mechanics.motion import Equations, Load, Phase
from protochain.mechanics.multibody import Frames
from protochain.mechanics.multibody.rotations import displacement_rates
from protochain.mechanisms.elements import Conservative, Gravity
from protochain.mechanisms.flexible import dynamics as flexible_dynamics
from protochain.mechanisms.flexible.flexible import Flexible, Shapes, bend, elastic, integrate
from protochain.mechanisms.model import Model


@dataclass(frozen=True, eq=False)
class BendingSystem(Equations):
    """Bodies of which some bend, in a potential in addition to their elastic energy, under loads.

    ``flexible.Flexible`` defines coordinates and freedoms. Potentials and
    loads get ``flexible.Bent`` for factors and frames, and loads may give wrenches
    (nn, 6) on all nodes. Runge-Kutta and Rosenbrock methods accept it.
    """

    flexible: Flexible = field(kw_only=True)  # Bodies, on the hinges of ``tree``.

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.flexible.tree is not self.tree:
            raise MechanicsError("give bodies that bend, on the tree of the system")

    @property
    def n_v(self) -> int:
        """Number of freedoms."""
        return self.flexible.n_v

    @cached_property
    def units(self) -> Floats:
        """(n_v,) float: units. For amplitudes, a section moves by the tree's size, or turns by a radian."""
        return read_only(np.concatenate([self.tree.units, self._of_shapes]))

    @cached_property
    def coordinate_units(self) -> Floats:
        """(n_q,) float: as :attr:`units`, of each coordinate."""
        return read_only(np.concatenate([self.tree.coordinate_units, self._of_shapes]))

    @cached_property
    def _of_shapes(self) -> Floats:
        amounts = [
            np.maximum(np.abs(s.moves).max(axis=(0, 1)) / self.tree.size, np.abs(s.turns).max(axis=(0, 1)))
            for s in self.flexible.shapes
            if s is not None
        ]
        return 1.0 / np.concatenate([np.zeros(0), *amounts])

    def factors(self, q: Floats) -> Any:
        """Frames of all nodes at q (n_q,)."""
        return bend(self.flexible, q)

    def forces(self, time: float, q: Floats, qd: Floats, factors: Any) -> tuple[float, Floats, Floats | None]:
        """Potential and elastic energy, torques (n_v,) of these and the loads, and of each load alone."""
        potential, torque, loads = super().forces(time, q, qd, factors)
        energy, bending = elastic(self.flexible, q)
        return potential + energy, torque + bending, loads

    def momenta(self, factors: Any, qd: Floats) -> Floats:
        """Momenta (n_v,) of velocities."""
        return flexible_dynamics.multiply_mass(self.flexible, factors, qd)

    def along(self, load: Load, time: float, q: Floats, qd: Floats, factors: Any) -> Floats:
        """Torques (n_v,) of a load."""
        wrenches, torques = load.applied(time, q, qd, factors)
        out = np.zeros(self.n_v)
        if wrenches is not None:
            out = flexible_dynamics.pull_back(self.flexible, factors, wrenches)
        return out if torques is None else out + torques

    def forward_dynamics(self, q: Floats, qd: Floats, tau: Floats) -> Floats:
        """Accelerations (n_v,) under torques, with the prescribed ones at driven hinges."""
        return flexible_dynamics.forward_dynamics(self.flexible, q, qd, tau)

    def inverse_dynamics(self, q: Floats, qd: Floats, qdd: Floats) -> Floats:
        """Torques (n_v,) of accelerations."""
        return flexible_dynamics.inverse_dynamics(self.flexible, q, qd, qdd)

    def integrate(self, q: Floats, move: Floats) -> Floats:
        """Coordinates (n_q,) after a displacement (n_v,)."""
        return integrate(self.flexible, q, move)

    def displacement_rates(self, move: Floats, qd: Floats) -> Floats:
        """Rates (n_v,) of a displacement, for velocities at its end."""
        rigid, out = self.tree.n_v, qd.copy()
        out[:rigid] = displacement_rates(self.tree, move[:rigid], qd[:rigid])
        return out


def bending(model: Model, shapes: Mapping[str, Shapes]) -> tuple[BendingSystem, Phase]:
    """Let bodies of a mechanism bend.

    Parameters
    ----------
    model : Model
        The mechanism as built. Bodies that bend have mass and inertia of their shapes.
    shapes : mapping of str to Shapes
        Shapes of bodies by name, in the bodies' own axes, as of :func:`assumed_modes`. A body whose hinge is
        on one of these rides on the section that is nearest to the hinge.

    Returns
    -------
    BendingSystem, Phase
        Equations of motion, for ``step`` of Runge-Kutta, Dormand-Prince and Rosenbrock, and the start, with
        all bodies straight. Loads may be added by ``dataclasses.replace(system, loads=...)``. For Hamilton's
        equations, ``flexible.canonical_rates(system.flexible, at.q, at.p, at.torque)``.

    Raises
    ------
    MechanicsError
        If the body is unknown. If the mechanism has loops, or loads, dampers, events and contacts that
        lose energy, which see rigid bodies. While it moves, if an element acts on a body that bends: let it
        act on a rigid one, fixed to a section.
    """
    bodies, tree = model.bodies, model.tree
    if bodies.joints is not None:
        raise MechanicsError(
            "flexible bodies do not support closed loops; close them by springs "
            "between rigid bodies that are fixed to their sections"
        )
    if model.loads or model.events or model.memories:
        raise MechanicsError(
            "loads, dampers, friction and events apply to rigid bodies only; remove them, and set loads of "
            "flexible bodies by dataclasses.replace(system, loads=...)"
        )
    shapes_of: list[Shapes | None] = [None] * tree.n_bodies
    for name, sections in shapes.items():
        b = bodies.number(name, "bending")
        if b < 0 or not isinstance(sections, Shapes):
            raise MechanicsError(
                f'bending: "{name}": {brief(sections)}: give Shapes of a body, as assumed_modes()'
            )
        shapes_of[b] = _rotate(sections, bodies.turn[b].T)
    section = np.full(tree.n_bodies, -1)
    for b, p in enumerate(tree.parent):
        carrier = shapes_of[p] if p >= 0 else None
        if carrier is not None:
            section[b] = np.argmin(np.linalg.norm(carrier.place - tree.offset[b], axis=1))
    flexible = Flexible(tree, tuple(shapes_of), section)
    gravity = [part.acceleration for part in model.conservative if isinstance(part, Gravity)]
    parts = [part for part in model.conservative if not isinstance(part, Gravity)]
    forces = _Forces(model, flexible, sum(gravity, np.zeros(3)), parts)
    system = BendingSystem(tree, forces, drive=model.drive, flexible=flexible)
    straight = np.zeros(flexible.n_v - tree.n_v)
    return system, system.at(np.append(model.q, straight), np.append(model.qd, straight))


@dataclass(frozen=True, eq=False)
class _Forces:
    """Potential of a model's elements, which act on rigid bodies, and of the weight of all nodes."""

    model: Model
    flexible: Flexible
    gravity: Floats
    parts: Sequence[Conservative]

    def __call__(self, q: Floats, bent: Any) -> tuple[float, Floats]:
        """Energy and torques (n_v,)."""
        flexible, tree = self.flexible, self.flexible.tree
        mass, body = flexible.sections.mass, flexible.node_start[:-1]
        wrenches, torques = np.zeros((tree.n_bodies, 6)), np.zeros(tree.n_v)
        frames = Frames(bent.rotation[body], bent.origin[body])
        energy = -float(mass @ (bent.origin @ self.gravity))
        for part in self.parts:
            energy += part.add(q[: tree.n_q], frames, wrenches, torques)
        for b in np.flatnonzero(np.any(wrenches, axis=1)):
            if flexible.shapes[b] is not None:
                raise MechanicsError(
                    f'a load acts on "{self.model.bodies.names[b]}", which is flexible; fix a body to its '
                    "section by a hinge of kind fixed, and apply the load there"
                )
        nodes = np.concatenate([np.zeros((len(mass), 3)), mass[:, None] * self.gravity], axis=1)
        nodes[body] += wrenches
        pulled = flexible_dynamics.pull_back(flexible, bent, nodes)
        pulled[: tree.n_v] += torques
        return energy, pulled


def _rotate(shapes: Shapes, turn: Floats) -> Shapes:
    """Shapes along other axes: vectors v become turn v."""
    return Shapes(
        shapes.place @ turn.T, shapes.mass, turn @ shapes.inertia @ turn.T,
        np.einsum("ij,njk->nik", turn, shapes.moves), np.einsum("ij,njk->nik", turn, shapes.turns),
        np.einsum("ij,njkl->nikl", turn, shapes.shortening), shapes.stiffness,
    )  # fmt: skip
