"""Stages of a method. Each stage is one run of the loop, in one space, with one energy."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from protochain.core.arrays import Floats
from protochain.core.timings import part
from protochain.minimisers.descent import Descent
from protochain.minimisers.device_descent import DeviceDescent
from protochain.minimisers.lbfgs import LBFGS
from protochain.minimisers.loop import Ending, Method, Snapshot, Stop, Unstarted, run
from protochain.minimisers.problem import BudgetSpentError, Evaluation, Force, Problem, Space, Tally
from protochain.minimisers.restraints import SOFT_TETHER, SoftRepulsion, Sum, Tethers
from protochain.minimisers.spaces import Cartesian, Torsions
from protochain.minimisers.steps import StrongWolfe

PATIENCE = 500  # Evaluations without a new lowest energy after which a run counts as stalled.

SINGLE_PRECISION_ENDS = (Stop.TOLERANCE, Stop.NO_DESCENT, Stop.NON_FINITE)
"""Endings that single precision may cause, by noise or by numbers above 1e38 if atoms overlap."""
Answer = Callable[[Problem, Ending, Floats], Floats]
"""Result of a stage, given the problem, the ending, and its first q."""


def last(problem: Problem, ending: Ending, q: Floats) -> Floats:
    """Final point if the run ended by itself, finite and allowed, otherwise as :func:`lowest`."""
    end = ending.last.state.at
    sound = ending.stop is Stop.NO_DESCENT and end.is_finite and problem.allows(end.x)
    return end.q if sound else lowest(problem, ending, q)


def lowest(problem: Problem, ending: Ending, q: Floats) -> Floats:
    """Final point if it met the tolerance without climbing, otherwise the lowest point, or the start."""
    end = ending.last.state.at
    reached = ending.stop is Stop.TOLERANCE and end.energy <= ending.last.start.energy
    if reached and problem.allows(end.x):
        return end.q
    return q if problem.best is None else problem.best.q


@dataclass(frozen=True, eq=False)
class Stage:
    """One run of the loop."""

    space: Space
    method: Method
    energy: Force
    tolerance: float
    restraint: Force | None = None
    # Whether its points belong in the trace. Points with another energy than the force field do not.
    recorded: bool = True
    patience: int = PATIENCE  # Evaluations without a new lowest energy, after which it stops.
    answer: Answer = lowest  # Selects the result, from which the next stage starts.
    after: tuple[Stop, ...] = ()  # Endings of the previous stage after which this one runs; empty: all.
    name: str = ""  # Name for the watcher.
    # Whether to run it from the placement at the end of the previous stage. Otherwise it is skipped.
    ready: "Callable[[Stage, Any], bool] | None" = None
    # Fits the stage to the positions (na, 3) at which the previous one ended.
    fit: "Callable[[Stage, Floats], Stage] | None" = None
    # Whether it only examines the end of the previous stage. If it finds nothing, the previous ending stays.
    looks: bool = False
    # Endings that end the walk, unless the next stage runs after them.
    ends: tuple[Stop, ...] = (Stop.BUDGET, Stop.INTERRUPTED, Stop.NON_FINITE)


def overlap_stage(space: Torsions) -> Stage:
    """Stage that separates overlapping atoms by soft repulsion in torsions, without the force field."""
    structure = space.chain.structure
    tethers = Tethers(structure.positions, np.full(structure.n_atoms, SOFT_TETHER))
    soft, descent = Sum([SoftRepulsion(structure), tethers]), Descent(LBFGS(), StrongWolfe())
    return Stage(space, descent, soft, 1.0, recorded=False, name="resolving clashes")


def with_reference(stage: Stage) -> list[Stage]:
    """The stage, and a second one on the exact form of its energy if this is another engine."""
    # In all atoms on a device OpenMM's minimiser runs the first stage.
    energy: Any = stage.energy
    if energy.is_exact:
        return [stage]
    exact = replace(stage, energy=energy.exact, after=SINGLE_PRECISION_ENDS)
    if getattr(energy, "minimises", False) and isinstance(stage.space, Cartesian):
        stage = replace(stage, method=DeviceDescent(stage.tolerance))
    return [stage, exact]


def moving_part(stage: Stage, moving: NDArray[np.bool_]) -> Stage:
    """Stage in all atoms whose energy skips terms that are constant among the fixed atoms."""
    groups = np.where(moving, -1, 0)[:, None]

    def fit(stage: Stage, x: Floats) -> Stage:
        energy: Any = stage.energy
        return replace(stage, energy=energy.without_constants(groups, x))

    return replace(stage, fit=fit)


@dataclass(frozen=True, eq=False)
class Waypoint:
    """State of a stopped walk."""

    stage: int  # Index in the plan; before: iterations of the previous stages.
    before: int
    last: Snapshot
    at: Floats | None = None  # (na, 3): Positions to which the stage was fitted, if any.
    ended: str = ""  # Name of the ending of the previous stage, if any.


@dataclass(frozen=True, eq=False)
class Outcome:
    """Unjudged result of a method."""

    stop: Stop
    space: Space
    q: Floats  # (n_q,): Coordinates in that space.
    n_iterations: int
    n_evaluations: int
    restraint: Force | None = None  # Of the last stage.
    # Whether no stage was skipped; waypoint: for a checkpoint, None if nothing was computed.
    complete: bool = True
    waypoint: Waypoint | None = None
    lowest_eigenvalue: float | None = None  # Of the Hessian at q, if a stage found it.
    eigenvalue_at_most: float | None = None  # Upper bound from an unfinished search.

    @property
    def x(self) -> Floats:
        """(na, 3) float, nm."""
        return self.space.place(self.q).x


@part("loop")
def walk(
    plan: Sequence[Stage],
    x: Floats,
    max_evaluations: int,
    allowed: Callable[[Floats], bool] | None,
    record: Callable[[Evaluation, Stage, int], None],
    resume: Waypoint | None = None,
    resumable: bool = True,
) -> Outcome:
    """Run the stages in order, each from the result of the previous one: x (na, 3) nm."""
    progress = _Walk(plan[resume.stage if resume else 0].space, plan[0].space.start(x), resume)
    for i, planned in enumerate(plan[progress.first :], progress.first):
        stage = progress.enter(planned)
        if stage is None:
            continue
        problem = Problem(stage.space, stage.energy, max_evaluations, stage.restraint, allowed)
        tally = Tally(progress.n_evaluations, None, progress.n_evaluations)
        problem.restore(tally, stage.space.place(progress.q).x if resumable else None)

        def note(at: Evaluation, stage: Stage = stage, problem: Problem = problem) -> None:
            record(at, stage, problem.n_evaluations)

        snapshot = progress.first_snapshot(stage, problem)
        try:
            ending = run(problem, stage.method, progress.q, stage.tolerance, stage.patience, note, snapshot)
        except (BudgetSpentError, KeyboardInterrupt) as error:
            # The stage has evaluated nothing: the result of the previous one stays.
            progress.stop = Stop.BUDGET if isinstance(error, BudgetSpentError) else Stop.INTERRUPTED
            break
        if progress.ends(i, stage, problem, ending, [*plan[i + 1 : i + 2]]):
            break
    return progress.outcome(planned, plan[i + 1 :])


class _Walk:
    """State of a walk between two stages."""

    def __init__(self, space: Space, q: Floats, resume: Waypoint | None) -> None:
        self.space, self.q, self.resume = space, q, resume
        self.first, self.n_iterations = (resume.stage, resume.before) if resume else (0, 0)
        # Of the last stage that did more than examine an end.
        self.stop = Stop[resume.ended] if resume and resume.ended else Stop.BUDGET
        self.waiting = resume.last if resume else None
        self.home = resume.at if resume else None
        self.waypoint, self.left_out, self.n_evaluations = resume, False, 0
        self.before: tuple[Problem, Ending] | None = None

    def enter(self, stage: Stage) -> Stage | None:
        """The stage fitted to the current positions or to saved ones, or None if it is skipped."""
        if self.waiting is not None:
            stage, self.home = _fit_stage(stage, self.home)
            self.q = self.waiting.start.q
        elif stage.after and (self.left_out or self.stop not in stage.after):
            return None
        else:
            at = self.space.place(self.q)
            self.left_out = stage.ready is not None and not stage.ready(stage, at)
            if self.left_out:
                return None
            stage, self.home = _fit_stage(stage, at.x)
            if stage.space is not self.space:
                self.q = stage.space.start(at.x)
        self.space = stage.space
        return stage

    def first_snapshot(self, stage: Stage, problem: Problem) -> Snapshot | None:
        """First snapshot of a stage: a saved run, or the previous end if it only examines this end."""
        if self.waiting is None and stage.looks and self.before is not None:
            return _reuse_evaluation(problem, *self.before, self.q)
        return self.waiting

    def ends(self, i: int, stage: Stage, problem: Problem, ending: Ending, next_stages: list[Stage]) -> bool:
        """Move to the result of a stage, and return whether the walk ends there."""
        ended = self.stop.name if i else ""
        self.waypoint = Waypoint(i, self.n_iterations, ending.last, self.home, ended)
        self.waiting, self.n_evaluations = None, problem.n_evaluations
        self.q, self.before = stage.answer(problem, ending, self.q), (problem, ending)
        if stage.looks and ending.stop in (Stop.NO_DESCENT, Stop.NON_FINITE):
            return True
        self.stop = ending.stop
        self.n_iterations += 0 if stage.looks else ending.last.n_iterations
        return self.stop in stage.ends and not any(self.stop in s.after for s in next_stages)

    def outcome(self, last: Stage, remaining: Sequence[Stage]) -> Outcome:
        """Result after the last visited stage of the plan."""
        return Outcome(
            Stop.STRAINED if self.left_out else self.stop, self.space, self.q, self.n_iterations,
            self.n_evaluations, last.restraint, not self.left_out and all(s.after for s in remaining),
            self.waypoint, *_eigenvalues(self.before),
        )  # fmt: skip


def _eigenvalues(before: tuple[Problem, Ending] | None) -> tuple[float | None, float | None]:
    """Lowest eigenvalue, and its upper limit, from the last stage."""
    state = before and before[1].last.state
    return getattr(state, "lowest_eigenvalue", None), getattr(state, "eigenvalue_at_most", None)


def _reuse_evaluation(problem: Problem, before: Problem, ending: Ending, q: Floats) -> Snapshot | None:
    """Snapshot at q if the previous stage, with the same energy, evaluated it, otherwise None."""
    points = (at for at in (ending.last.state.at, before.best) if at is not None and at.q is q)
    at = next(points, None) if problem.energy is before.energy else None
    if at is None:
        return None
    return Snapshot(Unstarted(at), at, problem.tally, 0, problem.lists_at)


def _fit_stage(stage: Stage, x: Floats | None) -> tuple[Stage, Floats | None]:
    """Stage fitted to positions, and these for its waypoint. A stage without fit is returned unchanged."""
    return (stage, None) if stage.fit is None or x is None else (stage.fit(stage, x), x)
