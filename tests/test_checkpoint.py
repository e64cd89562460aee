"""Checkpoints: what is written is read again, part by part; what is damaged is refused."""

import numpy as np
import pytest
from quadratics import Flat, positive

import protochain as pc
from protochain.minimisers.checkpoint import _plain, load_checkpoint, save_checkpoint
from protochain.minimisers.descent import Descent, DescentState
from protochain.minimisers.lbfgs import LBFGS
from protochain.minimisers.loop import Snapshot, Unstarted
from protochain.minimisers.metrics import Preconditioner, Stiffness
from protochain.minimisers.problem import Evaluation, Tally
from protochain.minimisers.spaces import Positions
from protochain.minimisers.stages import Stage, Waypoint
from protochain.minimisers.steps import StrongWolfe
from protochain.storage import read_arrays, write_arrays


def point(k):
    return Evaluation(Positions(np.arange(3.0) + k), -float(k), np.full(3, 0.1 * k), 2.0 * k, 0.5 * k)


def same(one, other):
    return np.array_equal(one.q, other.q) and np.array_equal(one.torque, other.torque) and (
        (one.energy, one.residual, one.restraint) == (other.energy, other.residual, other.restraint)
    )  # fmt: skip


def kept(memory=(), space=None):
    start, made, now = point(1), point(2), point(3)
    solver = Preconditioner(Stiffness(), made, Stiffness().at(space or Flat(matrix=np.eye(3)), made), 7)
    state = DescentState(now, solver, memory, None)
    return Waypoint(1, 4, Snapshot(state, start, Tally(9, point(4), 8), 5, np.ones((1, 3))))


def plan(space):
    return [None, Stage(space, Descent(LBFGS(), StrongWolfe()), None, 1.0)]


def test_a_waypoint_is_read_as_it_was_written(tmp_path):
    step = np.array([1.0, 2.0, 3.0])
    memory = ((step, step + 1.0, 14.0), (step + 1.0, step, np.float64(2.5)))
    space = Flat(matrix=positive(3, 1))
    save_checkpoint(tmp_path / "run.npz", kept(memory), {"seed": 1})
    read = load_checkpoint(tmp_path / "run.npz", plan(space), {"seed": 1})
    assert (type(read), read.stage, read.before, type(read.last)) == (Waypoint, 1, 4, Snapshot)
    assert read.last.n_iterations == 5 and np.array_equal(read.last.lists_at, np.ones((1, 3)))
    tally, state = read.last.tally, read.last.state
    assert (tally.n_evaluations, tally.improved_at) == (9, 8) and same(tally.best, point(4))
    assert same(read.last.start, point(1)) and type(state) is DescentState and same(state.at, point(3))
    assert type(state.at.pose) is Positions and state.rule is None
    assert state.preconditioner.metric == Stiffness() and state.preconditioner.age == 7
    assert same(state.preconditioner.made_at, point(2))
    # The matrix is computed again, at the point where it was.
    ((name, at),) = space.made
    assert name == "stiffness" and same(at, point(2))
    assert state.preconditioner.solve(step) == pytest.approx(np.linalg.solve(space.matrix, step))
    assert type(state.memory) is tuple and [len(pair) for pair in state.memory] == [3, 3]
    for mine, theirs in zip(state.memory, memory, strict=True):
        assert np.array_equal(mine[0], theirs[0]) and np.array_equal(mine[1], theirs[1])
        assert mine[2] == theirs[2] and type(mine[2]) is float


def test_an_array_that_is_in_two_places_is_written_once():
    step = np.arange(3.0)
    arrays = {}
    tree = _plain((step, np.ones(2), step), arrays, {})
    assert tree == [{"array": "a0"}, {"array": "a1"}, {"array": "a0"}]
    assert list(arrays) == ["a0", "a1"] and arrays["a0"] is step


def test_a_run_that_has_not_begun_and_has_no_lists(tmp_path):
    waypoint = Waypoint(1, 0, Snapshot(Unstarted(point(1)), point(1), Tally(1), 0, None))
    save_checkpoint(tmp_path / "run.npz", waypoint, {})
    read = load_checkpoint(tmp_path / "run.npz", plan(Flat()), {})
    assert type(read.last.state) is Unstarted and same(read.last.state.at, point(1))
    assert read.last.tally.best is None and read.last.lists_at is None


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda tree: tree["fields"].pop("stage"), "KeyError: 'stage'"),
        (lambda tree: tree["fields"].update(stage=2), "IndexError: list index out of range"),
        (lambda tree: tree["fields"]["last"].update(kind="Other"), "KeyError: 'Other'"),
        (lambda tree: tree["fields"].update(more=1), "TypeError: Waypoint"),
    ],
)
def test_a_damaged_checkpoint_is_refused(change, why, tmp_path):
    path = tmp_path / "run.npz"
    save_checkpoint(path, kept(), {})
    arrays, tree = read_arrays(path, {})
    change(tree)
    write_arrays(path, arrays, tree, {})
    with pytest.raises(pc.ProtochainError) as refusal:
        load_checkpoint(path, plan(Flat(matrix=np.eye(3))), {})
    assert str(refusal.value).startswith(f"{path}: damaged checkpoint ({why}")
    assert str(refusal.value).endswith(")")
