"""Kinematics: poses, velocities, loads, and what a tree may be."""

from dataclasses import replace

import numpy as np
import pytest
from fixtures.refusals import expect_refusal
from fixtures.slow_mechanics import N_TREES, any_tree, random_q, slow_frames, slow_jacobian
from fixtures.tolerances import ROUND_OFF, round_off
from scipy.spatial.transform import Rotation

from protochain.core.errors import Fault, MechanicsError, ProtochainError
from protochain.mechanics.multibody import (
    HingeKind,
    Tree,
    integrate,
    jacobian,
    pose,
    pull_back,
    random_tree,
    rigid_bodies,
    velocities,
)
from protochain.mechanics.multibody.tree import BALL_PLACEMENT
from protochain.mechanics.multibody.trigonometry import cosines_and_sines


@pytest.mark.parametrize("seed", range(N_TREES))
def test_pose_is_the_product_of_rotations(seed):
    tree = any_tree(seed)
    q = random_q(tree, np.random.default_rng(seed))
    fast, slow = pose(tree, q), slow_frames(tree, q)
    size = 1 + np.abs(slow.origin).max()
    assert np.abs(fast.rotation - slow.rotation).max() < round_off(tree)
    assert np.abs(fast.origin - slow.origin).max() < round_off(tree) * size


@pytest.mark.parametrize("seed", range(N_TREES))
def test_velocities_jacobian_and_pull_back_are_one_linear_map(seed):
    tree = any_tree(seed)
    rng = np.random.default_rng(seed)
    frames = pose(tree, random_q(tree, rng))
    slow = slow_jacobian(tree, frames)
    tolerance = round_off(tree) * (1 + np.abs(slow).max())
    assert np.abs(jacobian(tree, frames) - slow).max(initial=0) < tolerance
    qd, wrench = rng.normal(size=tree.n_v), rng.normal(size=(tree.n_bodies, 6))
    assert np.abs(velocities(tree, frames, qd) - slow @ qd).max() < tolerance * tree.n_bodies
    tau = np.einsum("bik,bi->k", slow, wrench)
    assert np.abs(pull_back(tree, frames, wrench) - tau).max(initial=0) < tolerance * tree.n_bodies


@pytest.mark.parametrize("seed", [1, 3, 5, 7])
def test_velocities_are_the_motion_of_points_on_the_bodies(seed):
    tree = any_tree(seed)
    rng = np.random.default_rng(seed)
    q, qd = random_q(tree, rng), rng.normal(size=tree.n_v)
    local, h = rng.normal(size=(tree.n_bodies, 3)), 1e-6

    def points(time):
        at = pose(tree, integrate(tree, q, time * qd))
        return at.origin + np.einsum("bij,bj->bi", at.rotation, local)

    frames = pose(tree, q)
    arms = np.einsum("bij,bj->bi", frames.rotation, local)
    twists = velocities(tree, frames, qd)
    moved = (points(h) - points(-h)) / (2 * h)
    # Cancellation: eps / h.
    expected = twists[:, 3:] + np.cross(twists[:, :3], arms)
    assert np.abs(moved - expected).max() < 1e-8 * (1 + np.abs(expected).max()) * tree.n_bodies


@pytest.mark.parametrize("size", [1e-9, 1.0, 4.0, 1e3, 9e5, 1e9])
def test_cosines_and_sines_are_right_to_a_few_units_in_the_last_place(size):
    angle = np.concatenate([np.random.default_rng(0).uniform(-size, size, 10001), [0.0, size, -size]])
    cosine, sine = np.empty_like(angle), np.empty_like(angle)
    cosines_and_sines(angle, cosine, sine)
    assert np.abs(cosine - np.cos(angle)).max() <= 2 * np.finfo(float).eps
    assert np.abs(sine - np.sin(angle)).max() <= 2 * np.finfo(float).eps
    near = np.abs(angle) < 0.7
    assert np.all(np.abs(sine - np.sin(angle))[near] <= 2 * np.spacing(np.abs(np.sin(angle[near]))))


def test_angles_that_are_not_numbers_stay_so():
    angle = np.array([np.nan, np.inf, 0.5])
    cosine, sine = np.empty(3), np.empty(3)
    cosines_and_sines(angle, cosine, sine)
    assert np.isnan(cosine[:2]).all() and cosine[2] == pytest.approx(np.cos(0.5), rel=1e-15)


def test_loads_given_are_left_as_they_were():
    tree = random_tree(5, 1)
    rng = np.random.default_rng(1)
    wrench = rng.normal(size=(5, 6))
    before = wrench.copy()
    pull_back(tree, pose(tree, random_q(tree, rng)), wrench)
    assert np.array_equal(wrench, before)


@pytest.mark.parametrize("size", [0.0, 1e-9, 1e-4, 0.3, 3.0])
def test_integrate_turns_a_free_root_by_the_exponential(size):
    tree = random_tree(1, 0)
    start = Rotation.random(rng=np.random.default_rng(2))
    x, y, z, w = start.as_quat()
    omega, v = size * np.array([0.6, 0.0, 0.8]), np.array([1.0, 2.0, 3.0])
    moved = integrate(tree, np.array([w, x, y, z, 0.1, 0.2, 0.3]), np.concatenate([omega, v]))
    expected = Rotation.from_rotvec(omega) * start
    assert np.allclose(pose(tree, moved).rotation[0], expected.as_matrix(), atol=ROUND_OFF)
    assert abs(np.linalg.norm(moved[:4]) - 1) < ROUND_OFF
    assert np.allclose(moved[4:], [1.1, 2.2, 3.3], atol=ROUND_OFF)


@pytest.mark.parametrize("size", [0.0, 1e-9, 0.3, 3.0])
def test_integrate_turns_a_ball_hinge_by_the_exponential_about_its_own_axes(size):
    kinds, eye = [HingeKind.BALL, HingeKind.BALL_AXIS, HingeKind.BALL_AXIS], np.eye(3)
    placed, none = np.array([eye, BALL_PLACEMENT, BALL_PLACEMENT]), np.zeros((3, 3))
    inertia = np.array([0.0, 0.0, 1.0])[:, None, None] * eye
    tree = Tree(np.arange(-1, 2), np.array(kinds), none, placed, np.array([0.0, 0.0, 1.0]), none, inertia)
    rng = np.random.default_rng(4)
    for _ in range(20):
        start, omega = (Rotation.random(rng=rng) for _ in range(2))
        step = size * omega.as_rotvec()
        moved = integrate(tree, start.as_rotvec(), step)
        expected = start * Rotation.from_rotvec(step)
        assert np.allclose(Rotation.from_rotvec(moved).as_matrix(), expected.as_matrix(), atol=ROUND_OFF)
        assert np.linalg.norm(moved) <= np.pi + ROUND_OFF


def rod():
    """Two equal masses on the z axis: what hangs on a hinge without anything to turn."""
    return rigid_bodies(np.zeros(2, dtype=int), np.array([[0.0, 0, 0], [0, 0, 0.1]]), np.ones(2), 1)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"parent": [-1, 2, 1, 0]}, "body 1: its parent 2 must come before it"),
        ({"parent": [-1, 0, -2, 0]}, "body 2"),
        ({"offset": np.zeros((2, 3))}, r"offset of a tree of 4 bodies has shape \(2, 3\)"),
        ({"offset": np.full((4, 3), np.nan)}, "body 0: its offset is not finite"),
        ({"kind": [HingeKind.FREE] * 4}, "body 1: only a root can be free"),
        ({"kind": [9] * 4}, "body 0: 9 is not a kind of hinge"),
        ({"placement": np.tile(-np.eye(3), (4, 1, 1))}, "placement"),
        ({"placement": np.tile(1.1 * np.eye(3), (4, 1, 1))}, "placement"),
        ({"mass": [1.0, 1.0, -1.0, 1.0]}, "body 2: its mass -1 must not be negative"),
        ({"mass": [1.0, 1.0, 0.0, 1.0]}, "body 2: it has inertia but no mass"),
        ({"driven": np.array([False, True])}, r"driven of a tree of 4 bodies is bool of shape \(2,\), not"),
        ({"driven": np.ones(4)}, "driven of a tree of 4 bodies is float64 of shape"),
        ({"driven": np.arange(4) < 2}, "body 0: only a hinge of one freedom can be driven, not a FIXED one"),
        ({"inertia": np.tile(np.diag([1.0, 1.0, 3.0]), (4, 1, 1))}, "body 0: its inertia"),
        ({"inertia": np.tile(np.diag([-1.0, 1.0, 1.0]), (4, 1, 1))}, "body 0: its inertia"),
        ({"inertia": np.tile(np.triu(np.ones((3, 3))), (4, 1, 1))}, "body 0: its inertia"),
    ],
)
def test_a_tree_that_makes_no_sense_is_refused(change, words):
    fine = random_tree(4, 0, root=HingeKind.FIXED)
    with pytest.raises(MechanicsError, match=words):
        replace(fine, **{name: np.array(value) for name, value in change.items()})


def test_a_hinge_that_turns_nothing_is_refused():
    mass, com, inertia = rod()
    with expect_refusal(fault=Fault.NO_INERTIA, kind=MechanicsError, match="body 0"):
        Tree(
            np.array([-1]),
            np.array([HingeKind.REVOLUTE]),
            np.zeros((1, 3)),
            np.eye(3)[None],
            mass,
            com,
            inertia,
        )
    # Sliding moves it, and so does turning about another line.
    Tree(
        np.array([-1]), np.array([HingeKind.PRISMATIC]), np.zeros((1, 3)), np.eye(3)[None], mass, com, inertia
    )
    Tree(
        np.array([-1]),
        np.array([HingeKind.REVOLUTE]),
        np.zeros((1, 3)),
        np.eye(3)[None],
        mass,
        com + 0.1,
        inertia,
    )


def test_two_hinges_on_one_line_are_refused():
    mass, com, inertia = (np.concatenate([part, part]) for part in rod())
    offset, placement = np.array([[0.0, 0, 0], [0, 0, 0.2]]), np.tile(np.eye(3), (2, 1, 1))
    kind = np.full(2, HingeKind.REVOLUTE)
    with expect_refusal(fault=Fault.NO_INERTIA, kind=MechanicsError, match="body 0"):
        Tree(np.array([-1, 0]), kind, offset, placement, mass, com, inertia)


def test_arrays_that_do_not_fit_are_refused():
    tree = random_tree(4, 0)
    with pytest.raises(ProtochainError, match=r"q has shape \(3,\), not \(10,\)"):
        pose(tree, np.zeros(3))
    with pytest.raises(ProtochainError, match="wrench has shape"):
        pull_back(tree, pose(tree, np.ones(10)), np.zeros((3, 6)))
    with pytest.raises(ProtochainError, match=r"^qd has shape \(10,\), not \(9,\)"):
        integrate(tree, np.ones(10), np.zeros(10))
    with pytest.raises(ProtochainError, match=r"^q has shape \(9,\), not \(10,\)"):
        integrate(tree, np.ones(9), np.zeros(9))


def test_a_tree_and_its_frames_cannot_be_changed():
    tree = random_tree(4, 0)
    with pytest.raises(ValueError, match="read-only"):
        tree.offset[0] = 1.0
    with pytest.raises(ValueError, match="read-only"):
        pose(tree, np.ones(tree.n_q)).origin[0] = 1.0
