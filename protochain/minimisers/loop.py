"""The one loop: it counts, records, checks and stops; methods only say what the next point is."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Any, Protocol

from protochain.arrays import Floats
from protochain.minimisers.problem import BudgetSpentError, Evaluation, Problem


class Stop(Enum):
    """Why a loop ended, before anyone has judged the result."""

    TOLERANCE = "the largest torque or RMS force fell below the tolerance"
    NO_DESCENT = "no step lowers the energy any further"
    CIRCLING = "the energy has found no new low for a long time"
    BUDGET = "the evaluations allowed are used up"
    NON_FINITE = "the energy or a torque is not a number"
    INTERRUPTED = "interrupted"


class State(Protocol):
    """A method's memory; the loop reads only where it is."""

    @property
    def at(self) -> Evaluation:
        """The current point."""


class Method(Protocol):
    """A direction times a step rule."""

    def init(self, problem: Problem, at: Evaluation) -> Any:
        """State at the start."""

    def step(self, problem: Problem, state: Any) -> Any | None:
        """Return the next state, or None if no step lowers the energy."""


@dataclass(frozen=True)
class Ending:
    """How a loop ended.

    Parameters
    ----------
    stop : Stop
    start, at : Evaluation
        Where the method began and where it stood; the problem remembers the lowest energy.
    n_iterations : int
    """

    stop: Stop
    start: Evaluation
    at: Evaluation
    n_iterations: int


def run(
    problem: Problem,
    method: Method,
    q: Floats,
    tolerance: float,
    patience: int,
    record: Callable[[Evaluation], None],
) -> Ending:
    """Step from q until the tolerance is met or nothing more can be done.

    Parameters
    ----------
    problem : Problem
    method : Method
    q : (n_q,) float
    tolerance : float
        Stop when the residual is no larger.
    patience : int
        Stop after this many evaluations without a new lowest energy.
    record : callable
        Called with each point the method accepts, the start included.

    Returns
    -------
    Ending
        Also on interruption (KeyboardInterrupt) and on a spent budget: nothing is lost.
    """
    at = start = problem.evaluate(q)
    n_iterations = 0
    try:
        record(at)
        state = method.init(problem, at)
        while True:
            if not at.is_finite:
                return Ending(Stop.NON_FINITE, start, at, n_iterations)
            if at.residual <= tolerance:
                return Ending(Stop.TOLERANCE, start, at, n_iterations)
            if problem.n_evaluations - problem.improved_at > patience:
                return Ending(Stop.CIRCLING, start, at, n_iterations)
            state = method.step(problem, state)
            if state is None:
                return Ending(Stop.NO_DESCENT, start, at, n_iterations)
            at = state.at
            n_iterations += 1
            record(at)
    except BudgetSpentError:
        return Ending(Stop.BUDGET, start, at, n_iterations)
    except KeyboardInterrupt:
        return Ending(Stop.INTERRUPTED, start, at, n_iterations)
