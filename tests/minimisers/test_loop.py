"""The loop, its problem and its stages, with methods that do as they are told."""

from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from types import SimpleNamespace

import numpy as np
import pytest
from fixtures.quadratics import Along, Flat, Quadratic, evaluation

from protochain.minimisers import loop
from protochain.minimisers.loop import Ending, Snapshot, Stop, Unstarted, run
from protochain.minimisers.problem import BudgetSpentError, Evaluation, Problem, Tally, evaluate
from protochain.minimisers.spaces import Positions
from protochain.minimisers.stages import PATIENCE, Stage, last, lowest, walk


def lifted(x):
    return 100.0, np.full_like(x, 3.0)


def test_an_evaluation_adds_the_restraint_to_energy_and_forces():
    x = np.array([1.0, -2.0, 3.0])
    plain = evaluate(Flat(), Quadratic(np.eye(3)), x)
    assert (plain.energy, plain.torque.tolist(), plain.residual, plain.restraint) == (
        7.0,
        [-1, 2, -3],
        3.0,
        0.0,
    )
    held = evaluate(Flat(), Quadratic(np.eye(3)), x, lifted)
    assert (held.energy, held.torque.tolist(), held.residual, held.restraint) == (
        107.0,
        [2, 5, 0],
        5.0,
        100.0,
    )
    assert held.q is x and held.x.tolist() == [[1.0, -2.0, 3.0]]
    problem = Problem(Flat(), Quadratic(np.eye(3)), 9, lifted)
    assert problem.evaluate(x).energy == 107.0


@pytest.mark.parametrize(
    ("energy", "torque", "finite"),
    [
        (1.0, 1.0, True), (np.inf, 1.0, False), (np.nan, 1.0, False), (1.0, np.nan, False),
        (1.0, -np.inf, False),
    ],
)  # fmt: skip
def test_a_point_is_finite_if_its_energy_and_all_torques_are(energy, torque, finite):
    assert evaluation(energy, [0.0, torque, 0.0]).is_finite is finite


def test_a_problem_counts_and_remembers_the_lowest_point_that_is_allowed():
    told = {1.0: 5.0, 2.0: 5.0, 3.0: 4.0, 4.0: np.nan, 5.0: -np.inf, 6.0: 3.0, 7.0: 3.5}
    problem = Problem(Flat(), Along(told.get), 7, allowed=lambda x: x[0, 0] != 6.0)
    assert (problem.n_evaluations, problem.best, problem.tally.improved_at) == (0, None, 0)
    tallies = []
    for t in told:
        problem.evaluate(np.array([t, 0.0, 0.0]))
        tallies.append((problem.n_evaluations, problem.best.q[0], problem.tally.improved_at))
    assert tallies == [(1, 1, 1), (2, 1, 1), (3, 3, 3), (4, 3, 3), (5, 3, 3), (6, 3, 3), (7, 7, 7)]
    with pytest.raises(BudgetSpentError):
        problem.evaluate(np.zeros(3))
    assert problem.n_evaluations == 7 and len(problem.energy.asked) == 7
    assert not problem.allows(np.full((1, 3), 6.0)) and problem.allows(np.ones((1, 3)))
    assert Problem(Flat(), problem.energy, 1).allows(np.full((1, 3), 6.0))
    assert problem.move(np.ones(3), np.arange(3.0)).tolist() == [1.0, 2.0, 3.0]


def test_restoring_a_problem_rebuilds_the_lists_of_an_energy_that_has_any():
    listed = []
    energy = SimpleNamespace(list_at=listed.append, lists_at="there")
    problem = Problem(Flat(), energy, 9)
    assert problem.lists_at == "there" and Problem(Flat(), Quadratic(np.eye(3)), 9).lists_at is None
    problem.restore(Tally(3), "here")
    assert listed == ["here"] and problem.n_evaluations == 3
    problem.restore(Tally(4), None)
    assert listed == ["here"] and problem.n_evaluations == 4
    plain = Problem(Flat(), Quadratic(np.eye(3)), 9)
    plain.restore(Tally(5), "here")
    assert plain.n_evaluations == 5


@dataclass(frozen=True)
class Stepping:
    """A method that steps along the first coordinate by whole numbers, to a last one."""

    final: int = 99
    raises: dict = field(default_factory=dict)

    def init(self, problem, at):
        return SimpleNamespace(at=at, begun=True)

    def step(self, problem, state):
        t = state.at.q[0] + 1
        if t in self.raises:
            raise self.raises[t]
        if t > self.final:
            return None
        return SimpleNamespace(at=problem.evaluate(np.array([t, 0.0, 0.0])), begun=state.begun)


def ran(
    method=None, energy=lambda t: -t, torque=lambda t: 9.0, budget=99, patience=99, resume=None, seen=None
):
    problem = Problem(Flat(), Along(energy, torque), budget)
    seen = [] if seen is None else seen
    ending = run(problem, method or Stepping(), np.zeros(3), 2.0, patience, seen.append, resume)
    return problem, ending, [at.q[0] for at in seen]


def test_a_run_ends_at_its_tolerance():
    for residual, stop, end in ((2.0, Stop.TOLERANCE, 4.0), (2.1, Stop.NO_DESCENT, 6.0)):
        problem, ending, seen = ran(Stepping(6), torque=lambda t, r=residual: r if t >= 4 else 9.0)
        assert (ending.stop, ending.last.state.at.q[0], ending.last.n_iterations) == (stop, end, end)
        assert seen == list(range(int(end) + 1)) and problem.n_evaluations == end + 1
        assert ending.last.start.q[0] == 0.0 and ending.last.state.begun
        assert ending.last.tally is problem.tally and ending.last.lists_at is None


def test_a_run_that_finds_no_lower_energy_within_its_patience_is_circling():
    # Lowest at the third step, evaluation 4: evaluations 5 to 7 are the patience, one more ends it.
    problem, ending, seen = ran(energy=lambda t: abs(t - 3.0), patience=3)
    assert ending.stop is Stop.CIRCLING and problem.n_evaluations == 8 and seen[-1] == 7.0


def test_a_run_keeps_its_last_complete_iteration_where_it_is_stopped(monkeypatch):
    _, ending, seen = ran(budget=4)
    assert (ending.stop, ending.last.n_iterations, seen) == (Stop.BUDGET, 3, [0, 1, 2, 3])
    _, ending, seen = ran(Stepping(raises={3.0: KeyboardInterrupt()}))
    assert (ending.stop, ending.last.n_iterations, seen) == (Stop.INTERRUPTED, 2, [0, 1, 2])
    _, ending, seen = ran(energy=lambda t: np.nan if t == 2 else -t)
    assert (ending.stop, ending.last.n_iterations, seen) == (Stop.NON_FINITE, 2, [0, 1, 2])
    with pytest.raises(BudgetSpentError):
        ran(budget=0)
    signals = []
    monkeypatch.setattr(loop, "held_interrupts", lambda: nullcontext(signals))
    _, ending, seen = ran(energy=lambda t: signals.append(2) or -t)
    assert (ending.stop, ending.last.n_iterations, seen) == (Stop.INTERRUPTED, 0, [0])
    with pytest.raises(KeyboardInterrupt):
        ran()


def test_a_method_that_is_not_begun_when_a_run_stops_is_begun_when_it_goes_on():
    class Dying(Stepping):
        def init(self, problem, at):
            raise KeyboardInterrupt

    _, ending, seen = ran(Dying())
    assert ending.stop is Stop.INTERRUPTED and isinstance(ending.last.state, Unstarted) and seen == [0]
    again, ended, seen = ran(Stepping(2), resume=ending.last)
    assert ended.stop is Stop.NO_DESCENT and seen == [0, 1, 2] and again.n_evaluations == 3
    assert ended.last.start is ending.last.start


def test_a_run_goes_on_with_the_counts_and_lists_it_had():
    listed = []

    class Listing(Along):
        lists_at = property(lambda self: "now")

        def list_at(self, x):
            listed.append(x)

    _, ending, _ = ran(Stepping(3))
    kept = replace(ending.last, lists_at="then")
    again = Problem(Flat(), Listing(lambda t: -t, lambda t: 9.0), 99)
    ended = run(again, Stepping(5), np.full(3, 7.0), 2.0, 99, lambda at: None, kept)
    assert listed == ["then"] and ended.last.lists_at == "now"
    assert (ended.last.n_iterations, again.n_evaluations, ended.last.start.q[0]) == (5, 6, 0.0)


def ending_at(stop, energy, torque=0.0, begun_at=0.0):
    at = Evaluation(Positions(np.full(3, 2.0)), energy, np.full(3, torque), 0.0)
    return Ending(stop, Snapshot(Unstarted(at), evaluation(begun_at, [0.0] * 3), Tally(), 3, None))


@pytest.mark.parametrize(
    ("stop", "energy", "torque", "last_is_end", "lowest_is_end"),
    [
        (Stop.NO_DESCENT, 5.0, 0.0, True, False), (Stop.NO_DESCENT, 5.0, np.nan, False, False),
        (Stop.TOLERANCE, -1.0, 0.0, True, True), (Stop.TOLERANCE, 0.0, 0.0, True, True),
        (Stop.TOLERANCE, 0.1, 0.0, False, False), (Stop.BUDGET, -1.0, 0.0, False, False),
    ],
)  # fmt: skip
@pytest.mark.parametrize("allowed", [True, False])
def test_the_answer_of_a_stage(stop, energy, torque, last_is_end, lowest_is_end, allowed):
    best = evaluation(-2.0, [0.0] * 3, (1.0, 1.0, 1.0))
    first, ending = np.zeros(3), ending_at(stop, energy, torque)
    for tally, otherwise in ((Tally(3, best, 2), 1.0), (Tally(3), 0.0)):
        problem = Problem(Flat(), Quadratic(np.eye(3)), 9, allowed=lambda x: allowed, tally=tally)
        for answer, is_end in ((last, last_is_end), (lowest, lowest_is_end)):
            assert answer(problem, ending, first)[0] == (2.0 if is_end and allowed else otherwise)


def at(t):
    return np.array([[t, 0.0, 0.0]])


@dataclass(eq=False)
class Scaled(Flat):
    """A space whose q is a multiple of the positions."""

    scale: float = 1.0

    def start(self, x):
        return self.scale * x.flatten()

    def place(self, q):
        return SimpleNamespace(q=q, x=q.reshape(-1, 3) / self.scale)


def stage_of(method, space=None, energy=lambda t: -t, **settings):
    return Stage(space or Flat(), method, Along(energy, lambda t: 9.0), 2.0, **settings)


def test_stages_start_where_the_one_before_ended_and_share_a_budget():
    seen = []

    def record(at, stage, n_evaluations):
        if stage.recorded:
            seen.append((at.q[0], at.x[0, 0], stage.space.scale, n_evaluations))

    one, two = Scaled(scale=1.0), Scaled(scale=10.0)
    plan = [
        stage_of(Stepping(2), one), stage_of(Stepping(2), one, recorded=False),
        stage_of(Stepping(22), two, restraint=lambda x: (50.0, 0.0 * x)),
    ]  # fmt: skip
    done = walk(plan, at(1.0), 99, None, record)
    # From 1 to 2 in one step; from 2 nowhere; in the other space from 20 to 22.
    assert seen == [(1, 1, 1, 1), (2, 2, 1, 2), (20, 2, 10, 4), (21, 2.1, 10, 5), (22, 2.2, 10, 6)]
    assert (done.stop, done.space, done.q[0], done.n_iterations, done.n_evaluations) == (
        Stop.NO_DESCENT, two, 22.0, 3, 6,
    )  # fmt: skip
    assert done.restraint is plan[2].restraint and done.complete and done.x[0, 0] == 2.2
    assert (done.waypoint.stage, done.waypoint.before, done.waypoint.last.n_iterations) == (2, 1, 2)
    assert done.waypoint.last.state.at.restraint == 50.0
    assert Stage(one, None, None, 1.0).patience == PATIENCE == 500


def test_stages_that_alternate_between_spaces_take_the_positions_along():
    one, two = Scaled(scale=1.0), Scaled(scale=10.0)
    plan = [stage_of(Stepping(2), one), stage_of(Stepping(21), two), stage_of(Stepping(3.1), one)]
    done = walk(plan, at(1.0), 99, None, lambda *_: None)
    # From 1 to 2, as 20 to 21, as 2.1 to 3.1.
    assert done.q[0] == pytest.approx(3.1) and done.space is one and done.n_iterations == 3


def test_a_stage_says_which_endings_end_the_walk():
    """One that may fail, as of the parting of overlaps, is followed by the next."""
    for ends, at_end in (((Stop.NON_FINITE,), 1.0), ((), 3.0)):
        first = stage_of(Stepping(3), energy=lambda t: np.nan if t == 2 else -t, ends=ends)
        assert walk([first, stage_of(Stepping(3))], at(0.0), 99, None, lambda *_: None).q[0] == at_end


def test_only_a_walk_that_may_be_resumed_makes_its_lists_where_stages_begin():
    class Listing:
        made = 0

        def __call__(self, x):
            return -x[0, 0], np.ones_like(x)

        def list_at(self, x):
            self.made += 1

    for resumable in (True, False):
        energy = Listing()
        plan = [replace(stage_of(Stepping(2)), energy=energy) for _ in range(2)]
        walk(plan, at(0.0), 99, None, lambda *_: None, resumable=resumable)
        assert energy.made == 2 * resumable


@pytest.mark.parametrize(
    ("named", "n_run"), [((Stop.NON_FINITE,), 2), ((Stop.TOLERANCE,), 1), ((), 1), (None, 1)]
)
def test_what_is_no_number_is_followed_by_a_stage_that_names_it_or_by_none(named, n_run):
    first = stage_of(Stepping(3), energy=lambda t: np.nan if t == 2 else -t)
    plan = [first, *([] if named is None else [stage_of(Stepping(3), after=named)])]
    done = walk(plan, at(0.0), 99, None, lambda *_: None)
    assert done.stop is (Stop.NO_DESCENT if n_run == 2 else Stop.NON_FINITE)
    # The lowest before, at 1, is kept; the second stage goes on from there to 3.
    assert done.q[0] == (3.0 if n_run == 2 else 1.0) and done.n_evaluations == (6 if n_run == 2 else 3)


@pytest.mark.parametrize("budget", range(1, 8))
def test_a_walk_goes_on_from_any_budget_as_if_it_had_never_stopped(budget):
    plan = [stage_of(Stepping(3)), stage_of(Stepping(5), after=(Stop.NO_DESCENT,))]
    whole = walk(plan, at(0.0), 99, None, lambda *_: None)
    part = walk(plan, at(0.0), budget, None, lambda *_: None)
    rest = walk(plan, at(0.0), 99, None, lambda *_: None, part.waypoint)
    assert part.n_evaluations == budget and (whole.n_evaluations, whole.n_iterations) == (7, 5)
    assert part.stop is (Stop.BUDGET if budget < 7 else Stop.NO_DESCENT)
    assert (rest.q[0], rest.n_evaluations, rest.n_iterations, rest.stop) == (5.0, 7, 5, Stop.NO_DESCENT)
    assert part.q[0] == min(budget - 1, 3) if budget < 6 else part.q[0] == budget - 2


def test_a_walk_without_a_single_evaluation_ends_at_its_start():
    plan = [stage_of(Stepping(3)), stage_of(Stepping(5))]
    done = walk(plan, at(1.0), 0, None, lambda *_: None)
    assert (done.stop, done.q[0], done.n_iterations, done.n_evaluations) == (Stop.BUDGET, 1.0, 0, 0)
    assert not done.complete and done.waypoint is None


def test_what_is_allowed_patience_and_answer_reach_the_stage():
    def energy(t):
        return abs(t - 3.0)

    plan = [stage_of(Stepping(), energy=energy, patience=4)]
    done = walk(plan, at(0.0), 99, lambda x: x[0, 0] < 2.0, lambda *_: None)
    # Allowed are 0 and 1, evaluations 1 and 2: four more are its patience.
    assert (done.stop, done.q[0], done.n_evaluations) == (Stop.CIRCLING, 1.0, 7)
    plan = [stage_of(Stepping(6), energy=energy, answer=last)]
    assert walk(plan, at(0.0), 99, None, lambda *_: None).q[0] == 6.0
    plan = [stage_of(Stepping(6), energy=energy)]
    assert walk(plan, at(0.0), 99, None, lambda *_: None).q[0] == 3.0


def test_an_interrupt_before_a_stages_first_point_leaves_the_result_of_the_one_before():
    def energy(t):
        raise KeyboardInterrupt

    plan = [stage_of(Stepping(3)), stage_of(Stepping(5), energy=energy)]
    done = walk(plan, at(0.0), 99, None, lambda *_: None)
    assert (done.stop, done.q[0], done.n_evaluations, done.n_iterations) == (Stop.INTERRUPTED, 3.0, 4, 3)
    assert done.complete and done.waypoint.stage == 0
