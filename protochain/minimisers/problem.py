"""What a minimiser sees: evaluate a point, move from it, and the count of what that cost."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from protochain.arrays import Floats

Force = Callable[[Floats], tuple[float, Floats]]
"""Positions (na, 3) in nm -> energy in kJ/mol and forces (na, 3) in kJ/mol/nm."""


class BudgetSpentError(Exception):
    """The evaluations allowed are used up; the loop turns this into a status."""


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Energy and torques at one point.

    Parameters
    ----------
    q : (n_q,) float
    x : (na, 3) float, nm
    energy : float, kJ/mol
        Of the force field and of what restrains the run.
    torque : (n_v,) float
        -dE/d(freedom) in the space's own scale: kJ/mol/rad, or kJ/mol/nm for atoms that move freely.
    residual : float
        What the tolerance is held against: the largest torque, or the RMS force.
    restraint : float, kJ/mol
        The part of the energy that only restrains.
    """

    q: Floats
    x: Floats
    energy: float
    torque: Floats
    residual: float
    restraint: float = 0.0

    @property
    def is_finite(self) -> bool:
        """Whether energy and torques are all numbers."""
        return bool(np.isfinite(self.energy) and np.isfinite(self.torque).all())


class Space(Protocol):
    """Freedoms that a minimiser moves in."""

    longest: float
    """Largest change of one freedom in a step that knows the curvature."""
    first: float
    """Largest change of one freedom when nothing is known of the curvature."""
    unit: str
    """Of the residual, with what it is."""

    def start(self, x: Floats) -> Floats:
        """Coordinates (n_q,) of positions (na, 3)."""

    def place(self, q: Floats) -> tuple[Floats, Callable[[Floats], Floats]]:
        """Positions (na, 3) in nm at q, and what turns forces (na, 3) there into torques (n_v,)."""

    def residual(self, torque: Floats) -> float:
        """Return what the tolerance is held against."""

    def move(self, q: Floats, step: Floats) -> Floats:
        """Coordinates after a step (n_v,)."""

    def stiffness(self, at: Evaluation) -> Callable[[Floats], Floats]:
        """Solve with a model of the Hessian made at a point: torques (n_v,) -> step (n_v,)."""

    def inertia(self, at: Evaluation) -> Callable[[Floats], Floats]:
        """Solve with the mass matrix at a point: torques (n_v,) -> accelerations (n_v,)."""


@dataclass
class Problem:
    """An energy over a space, with a budget of evaluations.

    Parameters
    ----------
    space : Space
    energy : callable
        May be replaced by its double-precision twin during a run.
    max_evaluations : int
    restraint : callable, optional
        Added to the energy.
    allowed : callable, optional
        Whether positions may be an answer; others are only passed through.
    """

    space: Space
    energy: Force
    max_evaluations: int
    restraint: Force | None = None
    allowed: Callable[[Floats], bool] | None = None
    n_evaluations: int = 0
    best: Evaluation | None = None
    improved_at: int = 0

    def evaluate(self, q: Floats) -> Evaluation:
        """Energy and torques at q, remembering the lowest energy seen.

        Raises
        ------
        BudgetSpentError
            If no evaluation is left.
        """
        if self.n_evaluations >= self.max_evaluations:
            raise BudgetSpentError
        self.n_evaluations += 1
        at = evaluate(self.space, self.energy, q, self.restraint)
        lower = at.is_finite and (self.best is None or at.energy < self.best.energy)
        if lower and (self.allowed is None or self.allowed(at.x)):
            self.best = at
            self.improved_at = self.n_evaluations
        return at

    def move(self, q: Floats, step: Floats) -> Floats:
        """Coordinates after a step (n_v,) in the space's scale."""
        return self.space.move(q, step)

    @property
    def lists_at(self) -> Floats | None:
        """Positions that the energy's neighbour lists were made at, if it has any."""
        return getattr(self.energy, "lists_at", None)

    def restore(
        self, best: Evaluation | None, improved_at: int, n_evaluations: int, lists_at: Floats | None
    ) -> None:
        """Be as at an earlier time."""
        self.best, self.improved_at, self.n_evaluations = best, improved_at, n_evaluations
        if lists_at is not None and hasattr(self.energy, "list_at"):
            self.energy.list_at(lists_at)


def evaluate(space: Space, energy: Force, q: Floats, restraint: Force | None = None) -> Evaluation:
    """Energy and torques at q, uncounted."""
    x, pull_back = space.place(q)
    value, forces = energy(x)
    held = 0.0
    if restraint is not None:
        held, pull = restraint(x)
        forces = forces + pull
    torque = pull_back(forces)
    return Evaluation(q, x, value + held, torque, space.residual(torque), held)
