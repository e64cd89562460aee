"""What a step is measured in: a metric turns torques into a direction."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from protochain.arrays import Floats
from protochain.minimisers.problem import Evaluation, Space

Solve = Callable[[Floats], Floats]


class Metric(Protocol):
    """A positive definite matrix that changes slowly with the place."""

    @property
    def lasts(self) -> int:
        """Iterations after which it is made anew."""

    def at(self, space: Space, at: Evaluation) -> Solve:
        """Solve with the matrix as it is at a point."""


@dataclass(frozen=True)
class Euclidean:
    """Every freedom counts the same."""

    lasts: int = 1_000_000_000

    def at(self, space: Space, at: Evaluation) -> Solve:
        """Nothing to solve."""
        return np.copy


@dataclass(frozen=True)
class Mass:
    """The mass matrix: descent in it is overdamped motion of the chain (M^-1 tau in O(n))."""

    lasts: int = 1

    def at(self, space: Space, at: Evaluation) -> Solve:
        """Solve with the mass matrix."""
        return space.inertia(at)


@dataclass(frozen=True)
class Stiffness:
    """A model of the Hessian, made from contacts and bonds: see :mod:`protochain.minimisers.springs`."""

    lasts: int = 20

    def at(self, space: Space, at: Evaluation) -> Solve:
        """Solve with the model made at this point."""
        return space.stiffness(at)


@dataclass(frozen=True, eq=False)
class Preconditioner:
    """A metric as it was at a point, and how many iterations it has served.

    Parameters
    ----------
    metric : Metric
    made_at : Evaluation
    solve : callable
    age : int
    """

    metric: Metric
    made_at: Evaluation
    solve: Solve
    age: int = 0

    @classmethod
    def first(cls, metric: Metric, space: Space, at: Evaluation) -> "Preconditioner":
        """Make a metric at a point."""
        return cls(metric, at, metric.at(space, at))

    def next(self, space: Space, at: Evaluation) -> "Preconditioner":
        """Return the one for the next iteration: the same, or made anew when it is too old."""
        if self.age + 1 >= self.metric.lasts:
            return self.first(self.metric, space, at)
        return replace(self, age=self.age + 1)
