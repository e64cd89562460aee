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

    def fly(self, at: Phase, pushed: Floats, time_step: float) -> tuple[Floats, Floats, Articulated]:
        """Move with impulses that keep what is to be kept: coordinates, momenta and factors of M."""


class Integrator(Protocol):
    """Equations of motion, a time step at a time."""

    def init(self, system: "System", q: Floats, qd: Floats) -> Phase:
        """Return the phase at q (n_q,), moving with qd (n_v,)."""

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
        return self.from_factors(q, articulate(self.tree, multibody.pose(self.tree, q)), qd=qd)

    def from_factors(
        self, q: Floats, factors: Articulated, *, qd: Floats | None = None, p: Floats | None = None
    ) -> Phase:
        """Return the phase at q, whose factors of M are known, from velocities or else from momenta."""
        potential, torque = self.potential(q, factors)
        if qd is None:
            assert p is not None
            qd = solve(factors, p)
        else:
            p, _ = momenta(self.tree, factors.frames, qd)
        return Phase(q, qd, p, potential, torque, factors)

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
