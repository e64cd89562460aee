"""Metrics: positive definite matrices whose inverses turn torques into search directions."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from protochain.core.arrays import Floats
from protochain.core.settings import document_fields
from protochain.core.timings import part
from protochain.minimisers.problem import Evaluation, Space

Solve = Callable[[Floats], Floats]
NEAR_REFRESH = 5
"""Iterations between two models of the Hessian from the force field's near terms, each costs about an energy.
With a model at every step, runs in all atoms need as many evaluations. With one in 20 steps, a third more."""


class Metric(Protocol):
    """A positive definite matrix that varies slowly with the coordinates."""

    @property
    def refresh_every(self) -> int:
        """Iterations between two computations of the matrix."""

    def at(self, space: Space, at: Evaluation) -> Solve:
        """Solver for the matrix at a point."""


@document_fields
@dataclass(frozen=True)
class Euclidean:
    """The identity."""

    refresh_every: int = 1_000_000_000  # Iterations between two computations of the matrix.

    def at(self, space: Space, at: Evaluation) -> Solve:
        """Solver for the identity: a copy."""
        return np.copy


@document_fields
@dataclass(frozen=True)
class Mass:
    """The mass matrix. Descent in this metric is overdamped motion of the chain (M^-1 tau in O(n))."""

    refresh_every: int = 1  # Iterations between two computations of the matrix.

    def at(self, space: Space, at: Evaluation) -> Solve:
        """Solver for the mass matrix."""
        return space.inertia(at)


@document_fields
@dataclass(frozen=True)
class Stiffness:
    """A model of the Hessian from the force field's near terms, or from springs if these are not known.

    See :mod:`protochain.minimisers.curvature` and :mod:`protochain.minimisers.spring_model`.
    """

    refresh_every: int = 20  # Iterations between two computations of the matrix.

    def at(self, space: Space, at: Evaluation) -> Solve:
        """Solver for the model made at a point."""
        return space.stiffness(at)


@dataclass(frozen=True)
class Damped(Stiffness):
    """The model of all atoms, damped in proportion to the RMS force: far from a minimum, steps are short."""

    # A regularised Newton method (Li, Fukushima, Qi, Yamashita, Comput. Optim. Appl. 28:131, 2004). Soft
    # freedoms do not run ahead of stiff ones, so that a start leads to a nearby minimum.

    damping: float = 300.0  # 1/nm: Added to the diagonal, times the RMS force.

    def at(self, space: Space, at: Evaluation) -> Solve:
        """Solver for the model made at a point."""
        return space.stiffness(at, None, np.full(len(at.x), self.damping * at.residual))


@document_fields
@dataclass(frozen=True, eq=False)
class Preconditioner:
    """A metric computed at one point, and used for some iterations."""

    metric: Metric  # Computes the matrix.
    made_at: Evaluation  # Point of the computation.
    solve: Solve  # Solver for the matrix.
    age: int = 0  # Iterations since then.

    @classmethod
    @part("metric")
    def first(cls, metric: Metric, space: Space, at: Evaluation) -> "Preconditioner":
        """Compute a metric at a point."""
        return cls(metric, at, metric.at(space, at))

    def next(self, space: Space, at: Evaluation) -> "Preconditioner":
        """Preconditioner of the next iteration: the same one, or a new one every ``refresh_every``."""
        if self.age + 1 >= self.metric.refresh_every:
            return self.first(self.metric, space, at)
        return replace(self, age=self.age + 1)
