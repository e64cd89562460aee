"""Descent: a direction and a step rule, combined into a method of the loop."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Protocol

from protochain.arrays import Floats
from protochain.minimisers.metrics import Metric
from protochain.minimisers.problem import Evaluation, Problem
from protochain.minimisers.steps import Rule


class Direction(Protocol):
    """Search directions from torques, curvature and memory.

    A direction without memory need only define ``propose``.
    """

    states: tuple[type, ...] = ()
    """Classes of its state, frozen dataclasses that a checkpoint can store."""

    def init(self, problem: Problem, at: Evaluation) -> Any:
        """State at the start."""
        return None

    def propose(self, problem: Problem, at: Evaluation, state: Any) -> Iterator[tuple[Floats, Any]]:
        """Yield directions (n_v,), best first, each with the state to keep if the step rule accepts it."""

    def update(
        self, problem: Problem, state: Any, before: Evaluation, step: Floats, after: Evaluation
    ) -> Any:
        """State after a step (n_v,) from one point to the next."""
        return state


@dataclass(frozen=True, eq=False)
class DescentState:
    """Current point, with the states of the direction and of the step rule."""

    at: Evaluation
    direction: Any
    rule: Any


@dataclass(frozen=True)
class Descent:
    """Step along the first proposed direction in which the step rule finds a next point.

    Parameters
    ----------
    direction : Direction
        Where to step.
    rule : Rule
        How far to step.
    """

    direction: Direction
    rule: Rule

    @property
    def states(self) -> tuple[type, ...]:
        """Classes of its state."""
        return (DescentState, *self.direction.states)

    @property
    def metric(self) -> Metric:
        """Metric of the direction's preconditioner."""
        metric: Metric = self.direction.metric  # type: ignore[attr-defined]
        return metric

    def init(self, problem: Problem, at: Evaluation) -> DescentState:
        """State at the start."""
        return DescentState(at, self.direction.init(problem, at), self.rule.init(at))

    def step(self, problem: Problem, state: DescentState) -> DescentState | None:
        """State after one step; None if no direction leads to a next point."""
        for direction, kept in self.direction.propose(problem, state.at, state.direction):
            found = self.rule.step(problem, state.at, direction, state.rule)
            if found is not None:
                length, at, rule = found
                kept = self.direction.update(problem, kept, state.at, length * direction, at)
                return DescentState(at, kept, rule)
        return None
