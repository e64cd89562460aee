"""What an integrator sees: a tree, what acts on it, and where it is and how it moves."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

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
"""Coordinates (n_q,) and the factors of M there -> energy in kJ/mol and torques (n_v,)."""


class StepTooLargeError(ProtochainError):
    """The equations of a time step have no solution that could be found."""


@dataclass(frozen=True, eq=False)
class Phase:
    """A point of phase space: a value, from which every integrator can go on.

    Parameters
    ----------
    q : (n_q,) float
    qd : (n_v,) float, rad/ps and nm/ps
    p : (n_v,) float
        Canonical momenta M qd.
    potential : float, kJ/mol
    torque : (n_v,) float, kJ/mol/rad and kJ/mol/nm
        Minus the gradient of the potential.
    factors : Articulated
        Of the mass matrix at q, with the frames of the bodies.
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
        """Kinetic and potential energy, kJ/mol."""
        return self.kinetic + self.potential

    @property
    def is_finite(self) -> bool:
        """Whether energy, torques and velocities are all numbers."""
        return bool(
            np.isfinite(self.potential) and np.isfinite(self.torque).all() and np.isfinite(self.qd).all()
        )


class Constraint(Protocol):
    """What may not change."""

    def kept(self, factors: Articulated, p: Floats) -> Floats:
        """Velocities (n_v,) of momenta p, less those that are not allowed."""

    def fly(self, flight: "Flight", at: Phase, p: Floats, time_step: float) -> "Flown":
        """Fly with impulses that keep what is to be kept."""


Flown = tuple[Floats, Floats, Articulated]
"""Coordinates (n_q,), momenta (n_v,) and factors of M where a flight ends."""
Flight = Callable[[Phase, Floats, float], Flown]
"""Where it begins, the momenta (n_v,) it begins with, its time in ps: motion without a potential."""


class Integrator(Protocol):
    """Equations of motion, a time step at a time."""

    def init(self, system: "System", q: Floats, qd: Floats) -> Phase:
        """Return the phase at q (n_q,), moving with qd (n_v,)."""
        return system.at(q, qd)

    def step(self, system: "System", at: Phase, time_step: float) -> Phase:
        """Return the phase one time step (ps) later; a negative step goes back."""


@dataclass(frozen=True, eq=False)
class System:
    """A forest of rigid bodies in a potential.

    Parameters
    ----------
    tree : Tree
    potential : callable
    closure : Constraint, optional
        What the leapfrog keeps; other integrators do not look.
    """

    tree: Tree
    potential: Potential
    closure: Constraint | None = None

    def at(self, q: Floats, qd: Floats) -> Phase:
        """Return the phase at q (n_q,), moving with qd (n_v,)."""
        factors = self.factors(q)
        potential, torque = self.potential(q, factors)
        return Phase(q, qd, momenta(self.tree, factors.frames, qd)[0], potential, torque, factors)

    def arrived(self, q: Floats, p: Floats, factors: Articulated, time_step: float) -> Phase:
        """Return the phase at q (n_q,) with momenta p (n_v,), after half a time step's push there."""
        potential, torque = self.potential(q, factors)
        p = p + 0.5 * time_step * torque
        return Phase(q, solve(factors, p), p, potential, torque, factors)

    def factors(self, q: Floats) -> Articulated:
        """Frames of the bodies and factors of M at q (n_q,)."""
        return articulate(self.tree, multibody.pose(self.tree, q))

    def moving(self, at: Phase, qd: Floats) -> Phase:
        """Return the same place with other velocities, less what the constraints do not allow."""
        p, _ = momenta(self.tree, at.factors.frames, qd)
        if self.closure is not None:
            qd = self.closure.kept(at.factors, p)
            p, _ = momenta(self.tree, at.factors.frames, qd)
        return replace(at, qd=qd, p=p)


def chain_potential(chain: Chain, energy: Energy) -> Potential:
    """Potential of a chain in a force field."""

    def potential(q: Floats, factors: Articulated) -> tuple[float, Floats]:
        x = place_atoms(chain, factors.frames)
        value, forces = energy(x)
        return value, pull_back(chain, Pose(q, factors.frames, x), forces)

    return potential


def total(parts: list[Potential]) -> Potential:
    """Sum of potentials."""

    def potential(q: Floats, factors: Articulated) -> tuple[float, Floats]:
        each = [part(q, factors) for part in parts]
        return sum(value for value, _ in each), np.sum([torque for _, torque in each], axis=0)

    return potential
