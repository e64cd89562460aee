"""Bodies without mass between hinges: a universal joint in closed form, limits of small masses, refusals."""

from dataclasses import replace

import numpy as np
import pytest
from fixtures.refusals import expect_refusal
from fixtures.slow_mechanics import slow_mass_matrix
from fixtures.tolerances import ONE_STEP
from scipy.integrate import solve_ivp

from protochain.core.errors import Fault, MechanicsError
from protochain.mechanics.motion import DormandPrince, ImplicitMidpoint, Leapfrog, RungeKutta4, System
from protochain.mechanics.multibody import (
    HingeKind,
    Tree,
    centre_of_mass,
    forward_dynamics,
    inverse_dynamics,
    log_det_gradient,
    log_det_mass,
    pose,
    random_tree,
    sample_velocities,
    solve_mass,
)  # fmt: skip
from protochain.mechanisms import Rosenbrock

G, LENGTH, MASS = 9.81, 0.7, 2.0
ABOUT_X = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
"""Frame whose z axis is its parent's x."""
ABOUT_Y = np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]])
"""Frame whose z axis is its parent's y."""


def universal(cross=0.0):
    """A ball on a rod that hangs from a universal joint, whose cross turns about the world's x axis.

    The cross has the inertia of a ball of this mass. The rod turns about the cross's y axis, and hangs along
    -z at q = 0.
    """
    seat = ABOUT_X.T @ ABOUT_Y
    down = seat.T @ ABOUT_X.T @ np.array([0.0, 0, -LENGTH])
    return Tree(
        np.array([-1, 0]), np.array([HingeKind.REVOLUTE] * 2), np.zeros((2, 3)), np.stack([ABOUT_X, seat]),
        np.array([cross, MASS]), np.stack([np.zeros(3), down]),
        np.stack([cross * 1e-2 * np.eye(3), np.zeros((3, 3))]),
    )  # fmt: skip


def weight(q, factors):
    k = MASS * G * LENGTH
    (a, b), sines = np.cos(q), np.sin(q)
    return k * (1.0 - float(a * b)), -k * np.array([sines[0] * b, a * sines[1]])


def exact(until, start):
    """The ball at l (-sin b, sin a cos b, -cos a cos b) by DOP853, from Lagrange's equations."""

    def rates(t, y):
        (a, b), (da, db) = y[:2], y[2:]
        dda = (2.0 * da * db * np.sin(b) * np.cos(b) - G / LENGTH * np.sin(a) * np.cos(b)) / np.cos(b) ** 2
        ddb = -(da**2) * np.sin(b) * np.cos(b) - G / LENGTH * np.cos(a) * np.sin(b)
        return [da, db, dda, ddb]

    return solve_ivp(rates, (0.0, until), start, method="DOP853", rtol=1e-13, atol=1e-13).y[:, -1]


START = (0.4, 0.6, 2.0, -1.0)


def ends(tree, integrator, n, until=1.0):
    system = System(tree, weight)
    at = first = system.at(np.array(START[:2]), np.array(START[2:]))
    for _ in range(n):
        at = integrator.step(system, at, until / n)
    return first, at


def test_the_axes_are_those_of_the_closed_form():
    tree, q = universal(), np.array([0.4, 0.6])
    expected = LENGTH * np.array([-np.sin(0.6), np.sin(0.4) * np.cos(0.6), -np.cos(0.4) * np.cos(0.6)])
    assert np.allclose(centre_of_mass(tree, pose(tree, q)), expected, atol=1e-14)


def test_a_universal_joint_moves_as_by_dop853():
    _, at = ends(universal(), DormandPrince(1e-13), 4)
    assert np.concatenate([at.q, at.qd]) == pytest.approx(exact(1.0, START), abs=1e-11)


@pytest.mark.parametrize(
    ("integrator", "order"),
    [(RungeKutta4(), 4), (Leapfrog(), 2), (ImplicitMidpoint(1e-13), 2), (Rosenbrock(ONE_STEP), 2)],
    ids=["rk4", "leapfrog", "midpoint", "rosenbrock"],
)
def test_every_integrator_takes_bodies_without_mass(integrator, order):
    wanted = exact(1.0, START)
    coarse, fine = (ends(universal(), integrator, n)[1] for n in (100, 200))
    errors = [np.linalg.norm(np.concatenate([at.q, at.qd]) - wanted) for at in (coarse, fine)]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.25)


def light(seed, n=14):
    """A random tree in which each body that has a child, but no sibling and is no root, may lose its mass."""
    rng = np.random.default_rng(seed)
    tree = random_tree(
        n, seed, 0.3, HingeKind.FREE, (HingeKind.REVOLUTE, HingeKind.PRISMATIC, HingeKind.SCREW)
    )
    out = np.isin(np.arange(n), tree.parent) & (np.arange(n) % 3 == 1)
    assert out.any()
    keep = ~out
    mass, inertia = keep * tree.mass, keep[:, None, None] * tree.inertia
    tree = replace(tree, mass=mass, inertia=inertia)
    q = rng.uniform(-2, 2, tree.n_q)
    return tree, q, pose(tree, q), rng


@pytest.mark.parametrize("seed", range(8))
def test_solutions_agree_with_dense_algebra(seed):
    tree, q, frames, rng = light(seed)
    m, (qd, tau) = slow_mass_matrix(tree, frames), rng.normal(size=(2, tree.n_v))
    x = np.linalg.solve(m, tau)
    tolerance = 1e-15 * np.linalg.cond(m)
    assert np.abs(solve_mass(tree, frames, tau) - x).max() < 100 * tolerance * np.abs(x).max()
    assert log_det_mass(tree, frames) == pytest.approx(np.linalg.slogdet(m)[1], abs=1e-6)
    bias = inverse_dynamics(tree, q, qd, np.zeros(tree.n_v))
    expected = np.linalg.solve(m, tau - bias)
    assert (
        np.abs(forward_dynamics(tree, q, qd, tau) - expected).max() < 100 * tolerance * np.abs(expected).max()
    )
    h, k = 1e-4, 6 + seed % 5
    step = h * np.eye(tree.n_q)[k + 1]
    slope = (log_det_mass(tree, pose(tree, q + step)) - log_det_mass(tree, pose(tree, q - step))) / (2 * h)
    gradient = log_det_gradient(tree, frames)
    assert gradient[k] == pytest.approx(slope, abs=1e-4 * np.abs(gradient).max())
    assert np.isfinite(sample_velocities(tree, frames, 1.0, rng)).all()


# --- What nothing resists


def chain(masses, kinds, axes=None):
    """Bodies one behind the other, 0.1 apart along x, each a ball; axes: placements."""
    n = len(masses)
    masses = np.array(masses, dtype=float)
    placement = np.tile(np.eye(3), (n, 1, 1)) if axes is None else np.stack(axes)
    return Tree(
        np.arange(-1, n - 1), np.array(kinds), np.tile([0.1, 0.0, 0.0], (n, 1)), placement, masses,
        np.zeros((n, 3)), masses[:, None, None] * np.eye(3),
    )  # fmt: skip


@pytest.mark.parametrize(
    "kind", [HingeKind.REVOLUTE, HingeKind.PRISMATIC, HingeKind.SCREW], ids=lambda kind: kind.name
)
def test_a_hinge_of_nothing_but_massless_bodies_is_refused(kind):
    with expect_refusal(fault=Fault.NO_INERTIA, kind=MechanicsError, match="body 1"):
        chain([1, 0, 0], [HingeKind.FREE, kind, kind])
    with expect_refusal(fault=Fault.NO_INERTIA, kind=MechanicsError, match="body 0"):
        chain([0], [HingeKind.FREE])
    # What does not move, or is moved, needs none.
    fine = chain([1, 0, 0], [HingeKind.FREE, HingeKind.FIXED, HingeKind.FIXED])
    driven = replace(chain([1, 1, 1], [HingeKind.FREE, kind, kind]), driven=np.array([False, True, True]))
    driven = replace(driven, mass=np.array([1.0, 0, 0]), inertia=fine.inertia)
    q = np.array([1.0, 0, 0, 0, 0, 0, 0])
    for tree in (fine, driven):
        there = np.concatenate([q, np.zeros(tree.n_q - 7)])
        found = solve_mass(tree, pose(tree, there), np.ones(tree.n_v))
        assert np.allclose(found[:6], 1.0, atol=1e-14)


def test_hinges_on_one_line_are_refused_at_every_pose():
    """A body without mass between two hinges about one axis turns as it likes."""
    kinds = [HingeKind.FIXED, HingeKind.REVOLUTE, HingeKind.REVOLUTE]
    tree = replace(chain([1, 0, 1], kinds), offset=[[0, 0, 0], [0.1, 0, 0], [0, 0, 0.3]])
    for q in np.random.default_rng(0).uniform(-3, 3, (5, 2)):
        for solution in (
            lambda q=q: solve_mass(tree, pose(tree, q), np.ones(2)),
            lambda q=q: forward_dynamics(tree, q, np.ones(2), np.ones(2)),
        ):
            with pytest.raises(MechanicsError, match="body 1: its hinge has no inertia at this pose"):
                solution()


def test_three_hinges_through_a_point_are_refused_only_where_they_lock():
    """x, y, z through one point with two bodies between: a ball joint until the second turns by a quarter."""
    seats = [ABOUT_X, ABOUT_X.T @ ABOUT_Y, ABOUT_Y.T]
    tree = Tree(
        np.arange(-1, 2), np.array([HingeKind.REVOLUTE] * 3), np.zeros((3, 3)), np.stack(seats),
        np.array([0.0, 0.0, 2.0]), np.array([[0.0, 0, 0], [0, 0, 0], [0.2, 0.3, 0.1]]),
        np.stack([np.zeros((3, 3)), np.zeros((3, 3)), np.diag([1.0, 2.0, 2.5])]),
    )  # fmt: skip
    tau = np.array([0.3, 0.7, -0.2])
    for short in (1.0, 1e-2, 1e-4):
        q = np.array([0.7, np.pi / 2 - short, 0.4])
        m = slow_mass_matrix(tree, pose(tree, q))
        x = solve_mass(tree, pose(tree, q), tau)
        assert np.abs(m @ x - tau).max() < 1e-13 * np.abs(m).max() * np.abs(x).max()
    # Nearer than a millionth of a radian the digits that are left would be few.
    for short, fine in ((3e-6, True), (3e-7, False), (0.0, False)):
        q = np.array([0.7, np.pi / 2 - short, 0.4])
        for solution in (
            lambda q=q: solve_mass(tree, pose(tree, q), tau),
            lambda q=q: forward_dynamics(tree, q, np.zeros(3), tau),
        ):
            if fine:
                assert np.isfinite(solution()).all()
                continue
            with pytest.raises(MechanicsError, match="body 0: its hinge has no inertia at this pose"):
                solution()


def test_a_free_root_without_mass_needs_more_than_one_hinge():
    bodies = [HingeKind.FREE, HingeKind.REVOLUTE, HingeKind.REVOLUTE]
    q = np.array([1.0, 0.2, -0.3, 0.1, 4.0, 5.0, -6.0, 0.4, 0.9])
    one = chain([0, 1, 1], bodies, [np.eye(3), ABOUT_X, np.eye(3)])
    with pytest.raises(MechanicsError, match="body 0: its hinge has no inertia"):
        solve_mass(one, pose(one, q), np.ones(8))
    two = replace(one, parent=[-1, 0, 0])
    m = slow_mass_matrix(two, pose(two, q))
    tau = np.arange(8.0)
    assert np.allclose(m @ solve_mass(two, pose(two, q), tau), tau, atol=1e-11)
    # Both about nearly one line: what resists turning about it goes with the square of their angle.
    q[4:7] = 0.0
    for angle, fine in ((1e-3, True), (3e-7, False)):
        tilted = np.array([[1, 0, angle], [0, 1, 0], [-angle, 0, 1]]) / np.sqrt(
            [1 + angle**2, 1, 1 + angle**2]
        )
        placement, offset = np.stack([np.eye(3), np.eye(3), tilted]), np.zeros((3, 3))
        near = replace(two, placement=placement, offset=offset)
        if fine:
            assert np.isfinite(solve_mass(near, pose(near, q), tau)).all()
            continue
        with pytest.raises(MechanicsError, match="body 0: its hinge has no inertia"):
            solve_mass(near, pose(near, q), tau)


def test_fixmans_method_refuses_bodies_without_mass():
    tree = universal()
    with expect_refusal(fault=Fault.NO_INVERSE, kind=MechanicsError, match="body 0"):
        solve_mass(tree, pose(tree, np.zeros(2)), np.zeros(2), "fixman")
