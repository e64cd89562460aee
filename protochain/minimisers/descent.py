"""Descent: a direction and a step rule, combined into a method of the loop."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from protochain.core.arrays import Floats
from protochain.core.checks import following
from protochain.core.errors import ProtochainError
from protochain.core.settings import document_fields
from protochain.minimisers.metrics import Euclidean, Metric, Preconditioner, Solve
from protochain.minimisers.problem import Evaluation, Problem
from protochain.minimisers.steps import Rule


class Direction(Protocol):
    """Search directions from torques, curvature and memory. Only ``propose`` has to be defined.

    The memory consists of numbers, arrays, and tuples of them. It is empty at the start.
    """

    metric: Metric = Euclidean()  # Metric of the preconditioner.

    def propose(
        self, problem: Problem, at: Evaluation, solve: Solve, memory: Any
    ) -> Iterator[tuple[Floats, Any]]:
        """Yield directions (n_v,), best first, each with the memory to store if the step succeeds.

        ``solve`` applies the inverse of the metric.
        """

    def update(self, memory: Any, before: Evaluation, step: Floats, after: Evaluation) -> Any:
        """Memory after a step (n_v,) from one point to the next."""
        return memory


@dataclass(frozen=True, eq=False)
class DescentState:
    """Current point and preconditioner, with the memories of the direction and of the step rule."""

    at: Evaluation
    preconditioner: Preconditioner
    memory: Any
    rule: Any


@document_fields
@dataclass(frozen=True)
class Descent:
    """Step along the first direction proposed in which the step rule finds a next point."""

    direction: Direction  # Where to step.
    rule: Rule  # How far to step.
    states = (DescentState,)

    def __post_init__(self) -> None:
        following(Direction, "propose")(self.direction, "direction")
        following(Metric, "at", "refresh_every")(self.direction.metric, "metric")
        following(Rule, "init", "step")(self.rule, "rule")

    @property
    def metric(self) -> Metric:
        """Metric of the preconditioner."""
        return self.direction.metric

    def init(self, problem: Problem, at: Evaluation) -> DescentState:
        """State at the start."""
        first = Preconditioner.first(self.metric, problem.space, at)
        return DescentState(at, first, (), self.rule.init(at))

    def step(self, problem: Problem, state: DescentState) -> DescentState | None:
        """State after one step, or None if no direction leads to a next point."""
        before, preconditioner = state.at, state.preconditioner
        for direction, memory in self.direction.propose(problem, before, preconditioner.solve, state.memory):
            if np.shape(direction) != before.torque.shape:
                raise ProtochainError(
                    f"direction {type(self.direction).__name__}: propose yields shape {np.shape(direction)}, "
                    f"not that of the torques, {before.torque.shape}"
                )
            accepted = self.rule.step(problem, before, direction, state.rule)
            if accepted is not None:
                length, at, rule = accepted
                memory = self.direction.update(memory, before, length * direction, at)
                return DescentState(at, preconditioner.next(problem.space, at), memory, rule)
        return None
