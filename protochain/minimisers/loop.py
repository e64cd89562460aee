"""The one loop: it counts, records, checks and stops; methods only say what the next point is."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any, Protocol

from protochain.arrays import Floats
from protochain.interrupts import held_interrupts
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


@dataclass(frozen=True, eq=False)
class Snapshot:
    """A run between two iterations: all that the rest of it depends on.

    Parameters
    ----------
    state : State
        The method's.
    start : Evaluation
        Where the run began.
    best : Evaluation or None
    improved_at, n_evaluations, n_iterations : int
    lists_at : (na, 3) float or None
        Positions that the energy's neighbour lists were made at: the order of its sums hangs on them.
    """

    state: State
    start: Evaluation
    best: Evaluation | None
    improved_at: int
    n_evaluations: int
    n_iterations: int
    lists_at: Floats | None


@dataclass(frozen=True, eq=False)
class Ending:
    """How a loop ended.

    Parameters
    ----------
    stop : Stop
    last : Snapshot
        After the last whole iteration; the problem remembers the lowest energy.
    """

    stop: Stop
    last: Snapshot


def run(
    problem: Problem,
    method: Method,
    q: Floats,
    tolerance: float,
    patience: int,
    record: Callable[[Evaluation], None],
    resume: Snapshot | None = None,
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
    resume : Snapshot, optional
        Go on from there instead: the same steps follow as if there had been no stop.

    Returns
    -------
    Ending
        Also on interruption (a signal, or KeyboardInterrupt) and on a spent budget: nothing is lost.

    Raises
    ------
    BudgetSpentError, KeyboardInterrupt
        Before the first point was evaluated.
    """
    if resume is None:
        at = problem.evaluate(q)
        last = _snapshot(problem, Standstill(at), at, 0)
    else:
        last = resume
        problem.restore(last.best, last.improved_at, last.n_evaluations, last.lists_at)
    try:
        with held_interrupts() as interrupts:
            record(last.state.at)
            if isinstance(last.state, Standstill):
                last = replace(last, state=method.init(problem, last.state.at))
            while True:
                at = last.state.at
                if not at.is_finite:
                    return Ending(Stop.NON_FINITE, last)
                if at.residual <= tolerance:
                    return Ending(Stop.TOLERANCE, last)
                if problem.n_evaluations - problem.improved_at > patience:
                    return Ending(Stop.CIRCLING, last)
                if interrupts:
                    return Ending(Stop.INTERRUPTED, last)
                state = method.step(problem, last.state)
                if state is None:
                    return Ending(Stop.NO_DESCENT, last)
                last = _snapshot(problem, state, last.start, last.n_iterations + 1)
                record(state.at)
    except BudgetSpentError:
        return Ending(Stop.BUDGET, last)
    except KeyboardInterrupt:
        return Ending(Stop.INTERRUPTED, last)


@dataclass(frozen=True)
class Standstill:
    """The state before a method has made its own."""

    at: Evaluation


def _snapshot(problem: Problem, state: State, start: Evaluation, n_iterations: int) -> Snapshot:
    return Snapshot(
        state, start, problem.best, problem.improved_at, problem.n_evaluations, n_iterations, problem.lists_at
    )
