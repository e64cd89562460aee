import numpy as np
import pytest
from conftest import ROUND_OFF, ROUND_OFF_DEEP
from oracles import frames, random_q, random_tree, torques
from scipy.spatial.transform import Rotation

from protochain.errors import ProtochainError
from protochain.multibody import HingeKind, Tree, integrate, pose, pull_back


@pytest.mark.parametrize("free", [False, True])
@pytest.mark.parametrize("n", [2, 7, 60, 300])
def test_pose_is_the_product_of_rotations(n, free):
    rng = np.random.default_rng(n)
    tree = random_tree(n, rng, free)
    q = random_q(tree, rng)
    fast = pose(tree, q)
    rotations, origins = frames(tree, q)
    assert np.allclose(fast.rotation, [r.as_matrix() for r in rotations], atol=ROUND_OFF_DEEP)
    assert np.allclose(fast.origin, origins, atol=ROUND_OFF_DEEP * n)


@pytest.mark.parametrize("free", [False, True])
@pytest.mark.parametrize("n", [3, 7, 60])
def test_pull_back_is_the_sum_over_outboard_points(n, free):
    rng = np.random.default_rng(n)
    tree = random_tree(n, rng, free)
    q = random_q(tree, rng)
    at = pose(tree, q)
    body = rng.integers(0, n, size=4 * n)
    points, f = rng.normal(size=(4 * n, 3)), rng.normal(size=(4 * n, 3))
    moment, force = np.zeros((n, 3)), np.zeros((n, 3))
    np.add.at(moment, body, np.cross(points - at.origin[body], f))
    np.add.at(force, body, f)
    slow = torques(tree, q, points, body, f)
    assert np.allclose(
        pull_back(tree, at, moment, force), slow, rtol=0, atol=ROUND_OFF * np.abs(slow).max() * n
    )


@pytest.mark.parametrize("free", [False, True])
def test_pull_back_is_the_transposed_jacobian(free):
    rng = np.random.default_rng(5)
    tree = random_tree(12, rng, free)
    q = random_q(tree, rng)
    local, f = rng.normal(size=(12, 3)), rng.normal(size=(12, 3))

    def work(step):
        at = pose(tree, integrate(tree, q, step))
        return np.sum(f * (at.origin + np.einsum("bij,bj->bi", at.rotation, local)))

    at = pose(tree, q)
    arms = np.einsum("bij,bj->bi", at.rotation, local)
    tau = pull_back(tree, at, np.cross(arms, f), f)
    h = 1e-5
    numeric = [(work(h * unit) - work(-h * unit)) / (2 * h) for unit in np.eye(tree.n_v)]
    # Truncation of a central difference at 1e-5: 1e-10 of third derivatives of order ten.
    assert np.allclose(tau, numeric, rtol=0, atol=1e-8)


def test_loads_given_are_left_as_they_were():
    rng = np.random.default_rng(1)
    tree = random_tree(5, rng, True)
    moment, force = rng.normal(size=(5, 3)), rng.normal(size=(5, 3))
    before = moment.copy(), force.copy()
    pull_back(tree, pose(tree, random_q(tree, rng)), moment, force)
    assert np.array_equal(moment, before[0]) and np.array_equal(force, before[1])


@pytest.mark.parametrize("size", [0.0, 1e-9, 1e-4, 0.3, 3.0])
def test_integrate_turns_a_free_root_by_the_exponential(size):
    tree = Tree(
        np.array([-1]), np.array([HingeKind.FREE]), np.zeros((1, 3)), np.zeros((1, 3)), np.eye(3)[None]
    )
    rng = np.random.default_rng(2)
    start = Rotation.random(rng=rng)
    x, y, z, w = start.as_quat()
    omega, v = size * np.array([0.6, 0.0, 0.8]), np.array([1.0, 2.0, 3.0])
    moved = integrate(tree, np.array([w, x, y, z, 0.1, 0.2, 0.3]), np.concatenate([omega, v]))
    expected = Rotation.from_rotvec(omega) * start
    assert np.allclose(pose(tree, moved).rotation[0], expected.as_matrix(), atol=ROUND_OFF)
    assert abs(np.linalg.norm(moved[:4]) - 1) < ROUND_OFF
    assert np.allclose(moved[4:], [1.1, 2.2, 3.3], atol=ROUND_OFF)


def test_a_tree_that_makes_no_sense_is_refused():
    fine = random_tree(4, np.random.default_rng(0), False)
    with pytest.raises(ProtochainError, match="must come before"):
        Tree(np.array([-1, 2, 1, 0]), fine.kind, fine.axis, fine.offset, fine.placement)
    with pytest.raises(ProtochainError, match="unit length"):
        Tree(fine.parent, fine.kind, 2 * fine.axis, fine.offset, fine.placement)
    with pytest.raises(ProtochainError, match="shapes"):
        Tree(fine.parent, fine.kind, fine.axis[:2], fine.offset, fine.placement)
    with pytest.raises(ProtochainError, match="only a root"):
        Tree(fine.parent, np.full(4, HingeKind.FREE), fine.axis, fine.offset, fine.placement)


def test_a_tree_and_its_frames_cannot_be_changed():
    tree = random_tree(4, np.random.default_rng(0), False)
    with pytest.raises(ValueError, match="read-only"):
        tree.offset[0] = 1.0
    with pytest.raises(ValueError, match="read-only"):
        pose(tree, np.zeros(tree.n_q)).origin[0] = 1.0
