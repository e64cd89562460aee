"""Checkpoints: what is written is read again, part by part; what is damaged is refused."""

import io
import zipfile

import numpy as np
import pytest
from fixtures.quadratics import Flat, positive

import protochain as pc
from protochain.core.checkpoints import checkpoint, write_checkpoint
from protochain.minimisers.checkpoint import _to_plain, load_checkpoint, save_checkpoint
from protochain.minimisers.descent import Descent, DescentState
from protochain.minimisers.lbfgs import LBFGS
from protochain.minimisers.loop import Snapshot, Unstarted
from protochain.minimisers.metrics import Preconditioner, Stiffness
from protochain.minimisers.problem import Evaluation, Tally
from protochain.minimisers.spaces import Positions
from protochain.minimisers.stages import Stage, Waypoint
from protochain.minimisers.steps import StrongWolfe


def point(k):
    return Evaluation(Positions(np.arange(3.0) + k), -float(k), np.full(3, 0.1 * k), 2.0 * k, 0.5 * k)


X = np.zeros((1, 3))


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
    read = load_checkpoint(tmp_path / "run.npz", plan(space), {"seed": 1}, X)
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
    tree = _to_plain((step, np.ones(2), step), arrays, {})
    assert tree == [{"array": "a0"}, {"array": "a1"}, {"array": "a0"}]
    assert list(arrays) == ["a0", "a1"] and arrays["a0"] is step


def test_a_run_that_has_not_begun_and_has_no_lists(tmp_path):
    waypoint = Waypoint(1, 0, Snapshot(Unstarted(point(1)), point(1), Tally(1), 0, None))
    save_checkpoint(tmp_path / "run.npz", waypoint, {})
    read = load_checkpoint(tmp_path / "run.npz", plan(Flat()), {}, X)
    assert type(read.last.state) is Unstarted and same(read.last.state.at, point(1))
    assert read.last.tally.best is None and read.last.lists_at is None


def state(tree):
    return tree["fields"]["last"]["fields"]["state"]["fields"]


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda tree: tree["fields"].pop("stage"), "KeyError: 'stage'"),
        (lambda tree: tree["fields"].update(stage=2), "ValueError: stage 2 of 2"),
        (lambda tree: tree["fields"].update(stage=-1), "ValueError: stage -1 of 2"),
        (lambda tree: tree["fields"].update(before="4"), "ValueError: before is of another type: str"),
        (lambda tree: tree["fields"]["last"]["fields"].update(n_iterations=None), "ValueError: n_iterations"),
        (lambda tree: state(tree).update(memory="all"), "ValueError: memory is of another type: str"),
        (lambda tree: state(tree).update(memory=[[1.0, 2.0, 3.0]]), "ValueError: memory is of another type"),
        (lambda tree: state(tree).update(rule=0.1), "ValueError: rule is of another type: float"),
        (lambda tree: state(tree)["preconditioner"].update(age="7"), "ValueError: age is of another type"),
        (lambda tree: state(tree)["at"]["evaluation"].pop(2), "TypeError: "),
        (lambda tree: state(tree)["at"]["evaluation"].__setitem__(1, "low"), "ValueError: energy is of"),
        (lambda tree: state(tree)["at"]["evaluation"].__setitem__(2, None), "ValueError: torque is not (3,)"),
        (lambda tree: tree["fields"]["last"].update(kind="Other"), "KeyError: 'Other'"),
        (lambda tree: tree["fields"].update(more=1), "TypeError: Waypoint"),
    ],
)
def test_a_damaged_checkpoint_is_refused(change, why, tmp_path):
    path = tmp_path / "run.npz"
    save_checkpoint(path, kept(), {})
    with checkpoint(path, {}, "run") as found:
        arrays, tree = found.arrays, found.values
    change(tree)
    write_checkpoint(path, arrays, tree, {})
    with pytest.raises(pc.ProtochainError) as refusal:
        load_checkpoint(path, plan(Flat(matrix=np.eye(3))), {}, X)
    assert str(refusal.value).startswith(f"{path}: damaged checkpoint ({why}")
    assert str(refusal.value).endswith("; give a file that an earlier run wrote as its checkpoint")


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda a: a[..., :2], "is not (3,) numbers"),
        (lambda a: a * np.nan, "is not finite"),
        (lambda a: a + 1e200, "is not finite"),
        (lambda a: a.astype("U8"), "is not (3,) numbers"),
        (lambda a: a.astype(int), "is not (3,) numbers"),
        (lambda a: a[:, None], "is not (3,) numbers"),
    ],
)
def test_every_array_fits_the_freedoms_before_it_is_used(change, why, tmp_path):
    path, step, space = tmp_path / "run.npz", np.array([1.0, 2.0, 3.0]), Flat(matrix=np.eye(3))
    save_checkpoint(path, kept(((step, step + 1.0, 14.0),)), {})
    with checkpoint(path, {}, "run") as found:
        arrays, tree = found.arrays, found.values
    assert len(arrays) == 11
    for name, array in arrays.items():
        write_checkpoint(path, {**arrays, name: change(array)}, tree, {})
        space.made.clear()
        with pytest.raises(pc.ProtochainError, match="damaged checkpoint") as refusal:
            load_checkpoint(path, plan(space), {}, X)
        assert why.replace("(3,)", f"{array.shape}") in str(refusal.value)
        # No matrix is made at a point that does not fit.
        assert all(np.isfinite(at.q).all() and len(at.q) == 3 for _, at in space.made)


def test_an_array_that_claims_more_than_the_file_holds_is_not_made(tmp_path):
    path = tmp_path / "run.npz"
    with zipfile.ZipFile(path, "w") as file:
        for shape in ((10**11,), (10**6, 10**6), (3,)):
            head = io.BytesIO()
            np.lib.format.write_array_header_1_0(
                head, {"descr": "<f8", "fortran_order": False, "shape": shape}
            )
            file.writestr(f"{len(shape)}{shape[0]}.npy", head.getvalue() + bytes(32))
    with pytest.raises(pc.ProtochainError, match="is not a checkpoint of a run; give another"):
        checkpoint(path, {}, "run", "give another").__enter__()


def test_a_packed_archive_is_no_checkpoint(tmp_path):
    path = tmp_path / "run.npz"
    np.savez_compressed(path, q=np.zeros(10_000_000), text=np.array('{"settings": {}, "values": 1}'))
    assert path.stat().st_size < 100_000
    with pytest.raises(pc.ProtochainError, match="is not a checkpoint"):
        checkpoint(path, {}, "run").__enter__()
