"""Mechanical system and phase space, as integrators see them: trees in potentials, under loads.

Any consistent set of units will do. Proteins are in nm, ps, amu and kJ/mol, scenes in m, s, kg and J.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import ClassVar, NamedTuple, Protocol

import numpy as np

from protochain.core.arrays import Floats, read_only
from protochain.core.errors import Fault, MechanicsError, ProtochainError
from protochain.core.settings import document_fields
from protochain.mechanics import multibody
from protochain.mechanics.multibody import Frames, Tree
from protochain.mechanics.multibody.articulated import Articulated, articulate, solve
from protochain.mechanics.multibody.forward import accelerations
from protochain.mechanics.multibody.hamilton import momenta
from protochain.mechanics.multibody.rotations import displacement_rates
from protochain.mechanics.tableaux import Tableau

Potential = Callable[[Floats, Articulated], tuple[float, Floats]]
"""Coordinates (n_q,) and factors of M there -> energy and torques (n_v,)."""
Drive = Callable[[float], tuple[Floats, Floats, Floats]]
"""Time -> coordinates, velocities and accelerations (k,) of the driven hinges, in the tree's order."""
NOTHING: Floats = read_only(np.zeros(0))
"""Work of no loads."""


class StepTooLargeError(ProtochainError):
    """A time step so large that no solution of its equations is found, or the energy jumps.

    Parameters
    ----------
    *parts
        As of ``ProtochainError``.
    fault : Fault, optional
        As of ``ProtochainError``.
    """

    fault = Fault.STEP


@document_fields
class Applied(NamedTuple):
    """What loads do at one moment."""

    # (nb, 6) float, optional: Moment on each body about the origin of its frame, and force, along world axes.
    wrenches: Floats | None = None
    torques: Floats | None = None  # (n_v,) float, optional: Torques (forces) at the hinges.


@document_fields
@dataclass(frozen=True, eq=False)
class Load:
    """Forces that no potential gives: drives, dampers, friction, thrust."""

    # Time, coordinates (n_q,), velocities (n_v,) and frames -> :class:`Applied`.
    applied: Callable[[float, Floats, Floats, Frames], Applied]
    # Whether the velocities are used. The leapfrog refuses such loads, since its kick would be implicit.
    depends_on_velocity: bool = True

    def along(self, tree: Tree, time: float, q: Floats, qd: Floats, frames: Frames) -> Floats:
        """(n_v,) float: the loads as torques, whose product with the velocities is their power."""
        wrenches, torques = self.applied(time, q, qd, frames)
        out = np.zeros(tree.n_v) if wrenches is None else multibody.pull_back(tree, frames, wrenches)
        return out if torques is None else out + torques


@document_fields
@dataclass(frozen=True, eq=False)
class Phase:
    """Point in phase space, from which any integrator can continue."""

    q: Floats  # (n_q,) float: Coordinates.
    qd: Floats  # (n_v,) float: Velocities.
    p: Floats  # (n_v,) float: Canonical momenta M qd.
    potential: float  # Potential energy.
    torque: Floats  # (n_v,) float: Minus the gradient of the potential, and the loads.
    factors: Articulated  # Factors of the mass matrix at q, with the frames of the bodies.
    time: float = 0.0  # Time since the start.
    # (k,) float: Work since the start, of each of the system's loads, then of its drive if it has one.
    work: Floats = field(default_factory=lambda: NOTHING)
    # (k, n_v) float, optional: Single loads as torques, then the torques of the drive. None without loads and
    # drive.
    loads: Floats | None = None

    @property
    def kinetic(self) -> float:
        """Kinetic energy."""
        return 0.5 * float(self.p @ self.qd)

    @property
    def total(self) -> float:
        """Total energy."""
        return self.kinetic + self.potential

    @property
    def power(self) -> Floats:
        """(k,) float: power of each of the loads, and of the drive."""
        return NOTHING if self.loads is None else np.asarray(self.loads @ self.qd)

    @property
    def effort(self) -> Floats:
        """(n_v,) float: sizes of the torques, which cancel at rest."""
        return np.abs(self.torque) + (0.0 if self.loads is None else np.sum(np.abs(self.loads), axis=0))

    @property
    def is_finite(self) -> bool:
        """Whether energy, torques and velocities are all finite."""
        return bool(
            np.isfinite(self.potential) and np.isfinite(self.torque).all() and np.isfinite(self.qd).all()
        )


class Constraint(Protocol):
    """Holonomic constraint on the coordinates."""

    def project_velocities(self, factors: Articulated, p: Floats) -> Floats:
        """Velocities (n_v,) of momenta p (n_v,), projected onto those that satisfy the constraint."""

    def drift(self, drift: "Drift", at: Phase, p: Floats, time_step: float) -> "Drifted":
        """Drift with constraint impulses, such that the constraint is satisfied at the end."""


Drifted = tuple[Floats, Floats, Articulated]
"""Coordinates (n_q,), momenta (n_v,) and factors of M at the end of a drift."""
Drift = Callable[[Phase, Floats, float], Drifted]
"""Motion without potential: phase at the start, momenta (n_v,) there, time step -> its end."""


class Integrator(Protocol):
    """Integrator of the equations of motion."""

    reversible: ClassVar[bool] = False
    """Whether steps are time-reversible and preserve phase-space volume."""

    @property
    def remedy(self) -> str:
        """Remedy for a time step that is too long."""
        return "use a shorter one"

    def init(self, system: "Equations", q: Floats, qd: Floats) -> Phase:
        """Return the phase at q (n_q,) with velocities qd (n_v,)."""
        return system.at(q, qd)

    def step(self, system: "Equations", at: Phase, time_step: float) -> Phase:
        """Return the phase one time step later. A negative step runs backwards."""

    def check_return(self, system: "Equations", before: Phase, after: Phase, time_step: float) -> None:
        """Check that a step from ``after`` backwards ends at the start of the step to it.

        Raises
        ------
        StepTooLargeError
            If it does not: implicit equations may have several solutions, or be solved in one direction only.
        """
        refuse_departure(system, self.step(system, after, -time_step).q, before.q)


def refuse_departure(system: "Equations", q: Floats, start: Floats) -> None:
    """Raise if a step back has other coordinates than the start of the step."""
    # Far above round-off, below the distance of solutions, in radians and sizes of the tree.
    if not np.max(np.abs(q - start) / system.coordinate_units, initial=0.0) < 1e-6:
        raise StepTooLargeError("the time step cannot be reversed")


@document_fields
@dataclass(frozen=True, eq=False)
class Equations:
    """Equations of motion of a tree in a potential, under loads: accelerations, of any state.

    Runge-Kutta and Rosenbrock methods accept any of them. These are of rigid bodies. Others override the
    methods with their own.

    Raises
    ------
    MechanicsError
        If the tree has driven hinges and there is not a drive, or the other way round.
    """

    tree: Tree  # Rigid bodies.
    potential: Potential  # Energy and torques at q.
    loads: tuple[Load, ...] = field(default=(), kw_only=True)  # Forces that no potential gives.
    # Motion of the tree's driven hinges, see :data:`Drive`. Velocities and accelerations must be the
    # derivatives of the coordinates: nothing else makes up for a difference.
    drive: Drive | None = field(default=None, kw_only=True)

    beyond: ClassVar[str] = "bodies that bend"
    """Features that integrators by momenta of rigid bodies do not support, for their refusal."""

    def __post_init__(self) -> None:
        if (self.drive is None) != (self.tree.driven is None):
            raise MechanicsError(
                "the tree has driven hinges, but the system has no drive for them"
                if self.drive is None
                else "the system has a drive, but the tree has no driven hinge"
            )

    @property
    def depends_on_velocity(self) -> bool:
        """Whether any load does."""
        return any(load.depends_on_velocity for load in self.loads)

    def at(self, q: Floats, qd: Floats, time: float = 0.0, work: Floats | None = None) -> Phase:
        """Return the phase at q (n_q,) with velocities qd (n_v,), driven hinges as the drive prescribes."""
        q, qd, factors = self.prescribe(time, q, qd)
        potential, torque, loads = self.forces(time, q, qd, factors)
        p = self.momenta(factors, qd)
        if self.drive is not None:
            _, loads = self.accelerations(time, q, qd, torque, loads, factors)
        if work is None:
            work = NOTHING if loads is None else np.zeros(len(loads))
        return Phase(q, qd, p, potential, torque, factors, time, work, loads)

    def prescribe(self, time: float, q: Floats, qd: Floats) -> tuple[Floats, Floats, Articulated]:
        """Coordinates (n_q,) and velocities (n_v,) as drive and joints prescribe them, and their factors."""
        q, qd = self.driven_to(time, q, qd)
        return q, qd, self.factors(q)

    def driven_to(self, time: float, q: Floats, qd: Floats) -> tuple[Floats, Floats]:
        """Coordinates (n_q,) and velocities (n_v,), with the driven hinges' values at a time."""
        if self.drive is None:
            return q, qd
        q, qd = q.copy(), qd.copy()
        q[self.tree.driven_q], qd[self.tree.driven_v], _ = self._drive(time)
        return q, qd

    def forces(
        self, time: float, q: Floats, qd: Floats, factors: Articulated
    ) -> tuple[float, Floats, Floats | None]:
        """Potential energy, torques (n_v,) of potential and loads together, and of each load alone."""
        potential, torque = self.potential(q, factors)
        if not self.loads:
            return potential, torque, None
        loads = np.array([self.along(load, time, q, qd, factors) for load in self.loads])
        return potential, torque + loads.sum(axis=0), loads

    def accelerations(
        self, time: float, q: Floats, qd: Floats, torque: Floats, loads: Floats | None, factors: Articulated
    ) -> tuple[Floats, Floats | None]:
        """Accelerations (n_v,) under torques (n_v,), and the loads. The last is the torques of the drive."""
        if self.drive is None:
            return self.constrain(qd, self.forward_dynamics(q, qd, torque), factors)[0], loads
        driven, prescribed, driving = self.tree.driven_v, torque.copy(), np.zeros(self.n_v)
        prescribed[driven] = self._drive(time)[2]
        qdd, holding = self.constrain(qd, self.forward_dynamics(q, qd, prescribed), factors)
        driving[driven] = (self.inverse_dynamics(q, qd, qdd) - torque - holding)[driven]
        return qdd, np.vstack([driving] if loads is None else [*loads[: len(self.loads)], driving])

    def advance(self, tableau: Tableau, at: Phase, h: float) -> tuple[Phase, Floats, Floats]:
        """Phase after a step of an explicit method, and the errors of its displacement and velocities."""
        a, b, error_weights = (h * weights for weights in tableau.arrays)
        slopes, accelerations = np.zeros((len(b), self.n_v)), np.zeros((len(b), self.n_v))
        # The sum of a row of the tableau is the time of its stage.
        times, powers = at.time + np.sum(a, axis=1), []
        for i, row in enumerate(a):
            time, move, qd = float(times[i]), row @ slopes, at.qd + row @ accelerations
            q, torque, loads, factors = at.q, at.torque, at.loads, at.factors
            if i:
                q, qd = self.driven_to(time, self.integrate(at.q, move), qd)
                factors = self.factors(q)
                _, torque, loads = self.forces(time, q, qd, factors)
            slopes[i] = self.displacement_rates(move, qd)
            accelerations[i], loads = self.accelerations(time, q, qd, torque, loads, factors)
            if loads is not None:
                powers.append(loads @ qd)
        q, qd = self.integrate(at.q, b @ slopes), at.qd + b @ accelerations
        work = at.work + b @ powers if powers else at.work
        return self.at(q, qd, at.time + h, work), error_weights @ slopes, error_weights @ accelerations

    def constrain(self, qd: Floats, qdd: Floats, factors: Articulated) -> tuple[Floats, Floats]:
        """Accelerations (n_v,) that the joints of loops allow, and their torques. Here they allow all."""
        return qdd, np.zeros(1)

    def _drive(self, time: float) -> tuple[Floats, Floats, Floats]:
        assert self.drive is not None
        k = len(self.tree.driven_v)
        q, qd, qdd = (np.asarray(values, dtype=float) for values in self.drive(time))
        if not (q.shape == qd.shape == qdd.shape == (k,)):
            raise MechanicsError(
                f"the drive of {k} hinges gives shapes {q.shape}, {qd.shape} and {qdd.shape}, not ({k},)"
            )
        return q, qd, qdd

    def at_time(self, at: Phase, time: float) -> Phase:
        """Return the phase at a time that differs from its own by rounding."""
        if self.drive is None or time == at.time:
            return replace(at, time=time)
        return self.at(at.q, at.qd, time, at.work)

    def with_velocities(self, at: Phase, qd: Floats) -> Phase:
        """Return the phase with other velocities, except at driven hinges."""
        if self.depends_on_velocity or self.drive is not None:
            return self.at(at.q, qd, at.time, at.work)
        return replace(at, qd=qd, p=self.momenta(at.factors, qd))

    @property
    def n_v(self) -> int:
        """Number of freedoms."""
        return self.tree.n_v

    @property
    def units(self) -> Floats:
        """(n_v,) float: amount of each freedom for a radian or a size of the tree."""
        return self.tree.units

    @property
    def coordinate_units(self) -> Floats:
        """(n_q,) float: as :attr:`units`, of each coordinate."""
        return self.tree.coordinate_units

    def factors(self, q: Floats) -> Articulated:
        """Frames of the bodies and factors of M at q (n_q,)."""
        return articulate(self.tree, multibody.pose(self.tree, q))

    def momenta(self, factors: Articulated, qd: Floats) -> Floats:
        """Momenta (n_v,) of velocities."""
        return momenta(self.tree, factors.frames, qd)[0]

    def along(self, load: Load, time: float, q: Floats, qd: Floats, factors: Articulated) -> Floats:
        """Torques (n_v,) of a load."""
        return load.along(self.tree, time, q, qd, factors.frames)

    def forward_dynamics(self, q: Floats, qd: Floats, tau: Floats) -> Floats:
        """Accelerations (n_v,) under torques, with the prescribed ones at driven hinges."""
        return accelerations(self.tree, q, qd, tau)

    def inverse_dynamics(self, q: Floats, qd: Floats, qdd: Floats) -> Floats:
        """Torques (n_v,) of accelerations."""
        return multibody.inverse_dynamics(self.tree, q, qd, qdd)

    def integrate(self, q: Floats, move: Floats) -> Floats:
        """Coordinates (n_q,) after a displacement (n_v,)."""
        return multibody.integrate(self.tree, q, move)

    def displacement_rates(self, move: Floats, qd: Floats) -> Floats:
        """Rates (n_v,) of a displacement, for velocities at its end."""
        return displacement_rates(self.tree, move, qd)


@document_fields
@dataclass(frozen=True, eq=False)
class System(Equations):
    """Forest of rigid bodies, whose velocities are M^-1 times their momenta: it can be kicked and drift.

    The leapfrog and the midpoint rule require such a system.
    """

    constraint: Constraint | None = None  # Constraint for the leapfrog. Other integrators ignore it.

    def with_velocities(self, at: Phase, qd: Floats) -> Phase:
        """Return the phase with other velocities, on the constraint, except at driven hinges."""
        if self.constraint is not None:
            qd = self.constraint.project_velocities(at.factors, self.momenta(at.factors, qd))
        return super().with_velocities(at, qd)

    def kick(self, before: Phase, q: Floats, p: Floats, factors: Articulated, time_step: float) -> Phase:
        """Return the phase a step after ``before``, at q (n_q,), p (n_v,) kicked there for half the step."""
        time = before.time + time_step
        # A load that depends on velocities is refused before, so that any will do here.
        potential, torque, loads = self.forces(time, q, before.qd, factors)
        p = p + 0.5 * time_step * torque
        at = Phase(q, solve(factors, p), p, potential, torque, factors, time, before.work, loads)
        if loads is None:
            return at
        return replace(at, work=before.work + 0.5 * time_step * (before.power + at.power))

    def arrive(self, q: Floats, p: Floats, factors: Articulated, time: float, work: Floats) -> Phase:
        """Return the phase at q (n_q,) with momenta p (n_v,)."""
        qd = solve(factors, p)
        potential, torque, loads = self.forces(time, q, qd, factors)
        return Phase(q, qd, p, potential, torque, factors, time, work, loads)


def total(parts: list[Potential]) -> Potential:
    """Sum of potentials.

    Parameters
    ----------
    parts : list of callable
        Potentials.

    Returns
    -------
    callable
        Their sum.
    """

    def potential(q: Floats, factors: Articulated) -> tuple[float, Floats]:
        pairs = [part(q, factors) for part in parts]
        return sum(value for value, _ in pairs), np.sum([torque for _, torque in pairs], axis=0)

    return potential


def canonical(equations: Equations, name: str) -> System:
    """Return them, for an integrator that moves by momenta of rigid bodies."""
    remedy = "use Runge-Kutta, Dormand-Prince or Rosenbrock"
    if not isinstance(equations, System):
        raise MechanicsError(f"the {name} does not support {equations.beyond}; {remedy}")
    if equations.drive is not None:
        raise MechanicsError(f"the {name} does not support driven hinges; {remedy}")
    if len(equations.tree.balls):
        raise MechanicsError(f"the {name} does not support ball hinges; {remedy}")
    return equations
