"""The problem a minimiser solves: an energy over a space of freedoms, and a count of its evaluations."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np

from protochain.core.arrays import Floats
from protochain.core.settings import document_fields
from protochain.core.timings import part

Force = Callable[[Floats], tuple[float, Floats]]
"""Positions (na, 3) in nm -> energy in kJ/mol and forces (na, 3) in kJ/mol/nm."""


class BudgetSpentError(Exception):
    """The evaluations allowed are used up. The loop converts this to a status."""


class Placement(Protocol):
    """Coordinates and their positions: a pose of a chain, or free atoms."""

    @property
    def q(self) -> Floats:
        """(n_q,) float."""

    @property
    def x(self) -> Floats:
        """(na, 3) float, nm."""


@document_fields
@dataclass(frozen=True, eq=False)
class Evaluation:
    """Energy and torques at one point."""

    pose: Placement  # For metrics computed at this point.
    energy: float  # kJ/mol: Of force field and restraint together.
    # (n_v,) float: -dE/d(freedom) in the space's own scale: kJ/mol/rad, or kJ/mol/nm for atoms that move
    # freely.
    torque: Floats
    residual: float  # Largest torque or RMS force, to be compared with the tolerance.
    restraint: float = 0.0  # kJ/mol: Energy of the restraint alone.

    @property
    def q(self) -> Floats:
        """(n_q,) float: coordinates."""
        return self.pose.q

    @property
    def x(self) -> Floats:
        """(na, 3) float, nm: positions."""
        return self.pose.x

    @property
    def is_finite(self) -> bool:
        """Whether energy and torques are all finite."""
        return bool(np.isfinite(self.energy) and np.isfinite(self.torque).all())


class Space(Protocol):
    """Freedoms that a minimiser moves in."""

    longest: float  # Largest change of one freedom in a step that uses curvature.
    first: float  # Largest change of one freedom in a step without curvature.
    unit: str  # Name and unit of the residual, as a format string.
    eigenvalue_unit: str  # Unit of the Hessian's eigenvalues.
    lever: float  # Change of a freedom that counts like a turn of one radian.

    def start(self, x: Floats) -> Floats:
        """Coordinates (n_q,) of positions (na, 3)."""

    def place(self, q: Floats) -> Placement:
        """Positions at coordinates q (n_q,)."""

    def torque(self, at: Placement, forces: Floats) -> Floats:
        """Torques (n_v,) of forces (na, 3) on the atoms at a placement."""

    def transport_torque(self, torque: Floats, at: Placement, to: Placement) -> Floats:
        """Convert torques (n_v,) from the freedoms at one placement to the freedoms at another."""

    def residual(self, torque: Floats) -> float:
        """Size of the torques, to be compared with the tolerance."""

    def sizes(self, torque: Floats) -> dict[str, float]:
        """RMS and largest torque, by their names in a trace. One of the two is the residual."""

    def move(self, q: Floats, step: Floats) -> Floats:
        """Coordinates after a step (n_v,)."""

    def stiffness(
        self, at: Evaluation, near_by: Any = None, tether: Floats | None = None
    ) -> Callable[[Floats], Floats]:
        """Solver for a model of the Hessian at a point: torques (n_v,) -> step (n_v,)."""
        # near_by: coupling of nearby atoms; tether (na,): springs to fixed points.

    def softness(self, at: Evaluation) -> Callable[[Floats], Floats]:
        """Solver for a model of the Hessian with a tiny floor, to rank soft directions."""

    def motions_of_whole(self, at: Evaluation) -> Floats:
        """Orthonormal rigid motions (k, n_v) that do not move fixed atoms."""

    def inertia(self, at: Evaluation) -> Callable[[Floats], Floats]:
        """Solver for the mass matrix at a point: torques (n_v,) -> accelerations (n_v,)."""


@dataclass(frozen=True, eq=False)
class Tally:
    """Evaluations counted so far, and the lowest energy among them."""

    n_evaluations: int = 0
    best: Evaluation | None = None  # Point of lowest energy among those allowed as the result.
    improved_at: int = 0  # Number of the evaluation that found it.


@document_fields
@dataclass
class Problem:
    """An energy over a space, with a budget of evaluations."""

    space: Space  # Freedoms to minimise in.
    energy: Force  # Positions to energy and forces.
    max_evaluations: int  # Evaluations allowed.
    restraint: Force | None = None  # Added to the energy.
    # Whether positions may be the result. A run may pass through any.
    allowed: Callable[[Floats], bool] | None = None
    tally: Tally = field(default_factory=Tally)  # Evaluations so far.
    interrupts: Sequence[int] = ()  # Signals received. After one, evaluation stops.

    @property
    def n_evaluations(self) -> int:
        """Evaluations so far."""
        return self.tally.n_evaluations

    @property
    def best(self) -> Evaluation | None:
        """Point of lowest energy among those allowed."""
        return self.tally.best

    @part("evaluations")
    def evaluate(self, q: Floats) -> Evaluation:
        """Evaluate energy and torques at q, and count the evaluation.

        Raises
        ------
        BudgetSpentError
            If no evaluation is left.
        KeyboardInterrupt
            If a signal was received. A line search of a large protein may last many seconds.
        """
        if self.interrupts:
            raise KeyboardInterrupt
        n = self.n_evaluations + 1
        if n > self.max_evaluations:
            raise BudgetSpentError
        self.tally = replace(self.tally, n_evaluations=n)
        at = evaluate(self.space, self.energy, q, self.restraint)
        lower = at.is_finite and (self.best is None or at.energy < self.best.energy)
        if lower and self.allows(at.x):
            self.tally = Tally(n, at, n)
        return at

    def allows(self, x: Floats) -> bool:
        """Whether positions (na, 3) are allowed as the result."""
        return self.allowed is None or self.allowed(x)

    def move(self, q: Floats, step: Floats) -> Floats:
        """Coordinates after a step (n_v,) in the space's scale."""
        return self.space.move(q, step)

    @property
    def lists_at(self) -> Floats | None:
        """Positions at which the energy's neighbour lists were built, if it has any."""
        return getattr(self.energy, "lists_at", None)

    def restore(self, tally: Tally, lists_at: Floats | None) -> None:
        """Restore earlier counts, and rebuild the neighbour lists at earlier positions."""
        self.tally = tally
        if lists_at is not None and hasattr(self.energy, "list_at"):
            self.energy.list_at(lists_at)


def evaluate(space: Space, energy: Force, q: Floats, restraint: Force | None = None) -> Evaluation:
    """Energy and torques at q, uncounted."""
    pose = space.place(q)
    value, forces = energy(pose.x)
    penalty = 0.0
    if restraint is not None:
        penalty, pull = restraint(pose.x)
        forces = forces + pull
    torque = space.torque(pose, forces)
    return Evaluation(pose, value + penalty, torque, space.residual(torque), penalty)
