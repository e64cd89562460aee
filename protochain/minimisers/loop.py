"""The one loop of all minimisers. Methods propose the next point. The loop records, checks and stops."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any, Protocol

from protochain.core.arrays import Floats
from protochain.core.interrupts import held_interrupts
from protochain.minimisers.problem import BudgetSpentError, Evaluation, Problem, Tally


class Stop(Enum):
    """Reason a loop ended, before the result is judged."""

    TOLERANCE = "the largest torque or RMS force fell below the tolerance"
    NO_DESCENT = "no step lowers the energy any further"
    CIRCLING = "no lower energy for a long time"
    BUDGET = "the allowed evaluations are used up"
    SADDLE = "the energy falls on both sides of the stationary point"
    NON_FINITE = "the energy or a torque is not a number"
    INTERRUPTED = "interrupted"
    STRAINED = (
        "bonds, angles and contacts are strained beyond what turning bonds can relieve without unfolding the "
        "chain; relax moves all atoms and preserves the fold"
    )


class Method(Protocol):
    """A minimiser: a :class:`protochain.minimisers.Descent`, or any object with these two methods.

    For checkpoints, ``states`` lists the classes of its state, which are frozen dataclasses.
    """

    def init(self, problem: Problem, at: Evaluation) -> Any:
        """State at the start."""

    def step(self, problem: Problem, state: Any) -> Any | None:
        """State after one step, or None at the end, for the reason in ``stop`` of its state or no descent."""


@dataclass(frozen=True, eq=False)
class Snapshot:
    """State of a run between two iterations, complete enough to continue it."""

    state: Any  # Of the method. The loop reads only ``at``, its current point.
    start: Evaluation  # First point of the run.
    tally: Tally
    n_iterations: int
    # (na, 3): Positions at which the energy's neighbour lists were built, which set the order of its sums.
    lists_at: Floats | None


@dataclass(frozen=True, eq=False)
class Ending:
    """How a loop ended."""

    stop: Stop
    last: Snapshot  # After the last complete iteration.


def run(
    problem: Problem,
    method: Method,
    q: Floats,
    tolerance: float,
    patience: int,
    record: Callable[[Evaluation], None],
    resume: Snapshot | None = None,
) -> Ending:
    """Iterate from q until the tolerance is met, no step descends, or the run is stopped.

    Parameters
    ----------
    problem : Problem
        Counts the evaluations.
    method : Method
        Proposes the points.
    q : (n_q,) float
        First point.
    tolerance : float
        Stop if the residual is at most this.
    patience : int
        Stop after this many evaluations without a new lowest energy.
    record : callable
        Called with each point the method accepts, including the start.
    resume : Snapshot, optional
        Continue from there, with the same steps as an uninterrupted run.

    Returns
    -------
    Ending
        Also on interruption (a signal, or KeyboardInterrupt) and on a spent budget.

    Raises
    ------
    BudgetSpentError, KeyboardInterrupt
        Before the first point was evaluated.
    """
    with held_interrupts() as interrupts:
        problem.interrupts = interrupts
        if resume is None:
            at = problem.evaluate(q)
            last = _snapshot(problem, Unstarted(at), at, 0)
        else:
            last = resume
            problem.restore(last.tally, last.lists_at)
        try:
            record(last.state.at)
            if isinstance(last.state, Unstarted):
                last = replace(last, state=method.init(problem, last.state.at))
            while True:
                at = last.state.at
                if not at.is_finite:
                    return Ending(Stop.NON_FINITE, last)
                if at.residual <= tolerance:
                    return Ending(Stop.TOLERANCE, last)
                if problem.n_evaluations - problem.tally.improved_at > patience:
                    return Ending(Stop.CIRCLING, last)
                if interrupts:
                    return Ending(Stop.INTERRUPTED, last)
                state = method.step(problem, last.state)
                if state is None:
                    return Ending(getattr(last.state, "stop", Stop.NO_DESCENT), last)
                last = _snapshot(problem, state, last.start, last.n_iterations + 1)
                record(state.at)
        except BudgetSpentError:
            return Ending(Stop.BUDGET, last)
        except KeyboardInterrupt:
            return Ending(Stop.INTERRUPTED, last)


@dataclass(frozen=True)
class Unstarted:
    """State before the method is initialised."""

    at: Evaluation


def _snapshot(problem: Problem, state: Any, start: Evaluation, n_iterations: int) -> Snapshot:
    return Snapshot(state, start, problem.tally, n_iterations, problem.lists_at)
