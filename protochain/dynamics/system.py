"""Mechanical system and phase space, as integrators see them."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import ClassVar, Protocol

import numpy as np

from protochain import multibody
from protochain.arrays import Floats
from protochain.chain import Chain, Pose, place_atoms, pull_back
from protochain.energies.protocol import Energy
from protochain.errors import ProtochainError
from protochain.multibody import Tree
from protochain.multibody.articulated import Articulated, articulate, solve
from protochain.multibody.hamilton import momenta

Potential = Callable[[Floats, Articulated], tuple[float, Floats]]
"""Coordinates (n_q,) and factors of M there -> energy in kJ/mol and torques (n_v,)."""


RETURNED = 1e-6
"""rad and nm: how exactly a step back returns; far above round-off, far below the distance of solutions."""


class StepTooLargeError(ProtochainError):
    """A time step so large that no solution of its equations is found, or the energy jumps."""


def refuse_departure(found: Floats, wanted: Floats, time_step: float) -> None:
    """Raise if a step back has found other coordinates than those where the step began.

    Raises
    ------
    StepTooLargeError
        If any differs by more than ``RETURNED``.
    """
    if not np.max(np.abs(found - wanted), initial=0.0) < RETURNED:
        raise StepTooLargeError(f"a time step of {1000 * abs(time_step):g} fs cannot be taken back")


@dataclass(frozen=True, eq=False)
class Phase:
    """Point in phase space, from which any integrator can continue.

    Parameters
    ----------
    q : (n_q,) float
        Coordinates.
    qd : (n_v,) float, rad/ps and nm/ps
        Velocities.
    p : (n_v,) float
        Canonical momenta M qd.
    potential : float, kJ/mol
        Potential energy.
    torque : (n_v,) float, kJ/mol/rad and kJ/mol/nm
        Minus the gradient of the potential.
    factors : Articulated
        Factors of the mass matrix at q, with the frames of the bodies.
    """

    q: Floats
    qd: Floats
    p: Floats
    potential: float
    torque: Floats
    factors: Articulated

    @property
    def kinetic(self) -> float:
        """Kinetic energy, kJ/mol."""
        return 0.5 * float(self.p @ self.qd)

    @property
    def total(self) -> float:
        """Total energy, kJ/mol."""
        return self.kinetic + self.potential

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
        """Drift with constraint impulses, such that the constraint holds at the end."""


Drifted = tuple[Floats, Floats, Articulated]
"""Coordinates (n_q,), momenta (n_v,) and factors of M at the end of a drift."""
Drift = Callable[[Phase, Floats, float], Drifted]
"""Motion without potential: phase at the start, momenta (n_v,) there, time step in ps -> its end."""


class Integrator(Protocol):
    """Integrator of the equations of motion."""

    reversible: ClassVar[bool] = False
    """Whether steps are time-reversible and preserve phase-space volume."""

    def init(self, system: "System", q: Floats, qd: Floats) -> Phase:
        """Return the phase at q (n_q,) with velocities qd (n_v,)."""
        return system.at(q, qd)

    def step(self, system: "System", at: Phase, time_step: float) -> Phase:
        """Return the phase one time step (ps) later; a negative step runs backwards."""

    def check_return(self, system: "System", before: Phase, after: Phase, time_step: float) -> None:
        """Check that a step from ``after`` backwards ends where the step to it began.

        Raises
        ------
        StepTooLargeError
            If it does not: implicit equations may have several solutions, or be solved in one direction only.
        """
        refuse_departure(self.step(system, after, -time_step).q, before.q, time_step)


@dataclass(frozen=True, eq=False)
class System:
    """Forest of rigid bodies in a potential.

    Parameters
    ----------
    tree : Tree
        Rigid bodies.
    potential : callable
        Energy and torques at q.
    constraint : Constraint, optional
        Constraint for the leapfrog; other integrators ignore it.
    """

    tree: Tree
    potential: Potential
    constraint: Constraint | None = None

    def at(self, q: Floats, qd: Floats) -> Phase:
        """Return the phase at q (n_q,) with velocities qd (n_v,)."""
        factors = self.factors(q)
        potential, torque = self.potential(q, factors)
        return Phase(q, qd, momenta(self.tree, factors.frames, qd)[0], potential, torque, factors)

    def kick(self, q: Floats, p: Floats, factors: Articulated, time_step: float) -> Phase:
        """Return the phase at q (n_q,), its momenta p (n_v,) kicked by the torques there for half a step."""
        potential, torque = self.potential(q, factors)
        p = p + 0.5 * time_step * torque
        return Phase(q, solve(factors, p), p, potential, torque, factors)

    def factors(self, q: Floats) -> Articulated:
        """Frames of the bodies and factors of M at q (n_q,)."""
        return articulate(self.tree, multibody.pose(self.tree, q))

    def with_velocities(self, at: Phase, qd: Floats) -> Phase:
        """Return the phase with other velocities, projected onto the constraint."""
        p, _ = momenta(self.tree, at.factors.frames, qd)
        if self.constraint is not None:
            qd = self.constraint.project_velocities(at.factors, p)
            p, _ = momenta(self.tree, at.factors.frames, qd)
        return replace(at, qd=qd, p=p)


def chain_potential(chain: Chain, energy: Energy) -> Potential:
    """Potential of a chain in a force field.

    Parameters
    ----------
    chain : Chain
        Chain of rigid bodies.
    energy : Energy
        Force field in Cartesian coordinates.

    Returns
    -------
    callable
        Energy and torques at q.
    """

    def potential(q: Floats, factors: Articulated) -> tuple[float, Floats]:
        x = place_atoms(chain, factors.frames)
        value, forces = energy(x)
        return value, pull_back(chain, Pose(q, factors.frames, x), forces)

    return potential


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
        each = [part(q, factors) for part in parts]
        return sum(value for value, _ in each), np.sum([torque for _, torque in each], axis=0)

    return potential
