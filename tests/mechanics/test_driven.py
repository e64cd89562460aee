"""Driven hinges: dense algebra, the same hinge fixed, Pinocchio; their motion by scipy and closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from fixtures.pinocchio_tree import KINDS, pinocchio_acceleration, state
from fixtures.slow_mechanics import any_tree, random_q
from fixtures.tolerances import ONE_STEP
from scipy.integrate import solve_ivp

from protochain.core.errors import MechanicsError
from protochain.mechanics import multibody
from protochain.mechanics.motion import (
    Applied,
    DormandPrince,
    ImplicitMidpoint,
    Leapfrog,
    Load,
    RungeKutta4,
    System,
)
from protochain.mechanics.multibody import (
    HingeKind,
    Tree,
    forward_dynamics,
    inverse_dynamics,
    log_det_closed,
    log_det_gradient,
    log_det_mass,
    mass_matrix,
    operational_inverse,
    point_rows,
    pose,
    random_tree,
    row_matrix,
    sample_velocities,
    solve_closed,
    solve_mass,
)  # fmt: skip
from protochain.mechanics.multibody.articulated import articulate, solve
from protochain.mechanisms import Rosenbrock

G = 9.81
LENGTH, MASS, INERTIA = 0.7, 2.0, 0.05
"""Pendulum: 2 kg, centre of mass 0.7 m below the pivot; moment of inertia about it."""
ALONG_X = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
"""Frame whose z axis is the world's x: a slide along x."""


def on_a_cart(driven=True, cart=3.0):
    """A pendulum about y that hangs from a cart on the world's x axis; downwards at q = 0."""
    # The body's z axis is the world's y, its x axis the world's -z.
    seat = np.array([[0.0, -1, 0], [0, 0, 1], [-1, 0, 0]])
    return Tree(
        np.array([-1, 0]),
        np.array([HingeKind.PRISMATIC, HingeKind.REVOLUTE]),
        np.zeros((2, 3)),
        np.stack([ALONG_X, ALONG_X.T @ seat]),
        np.array([cart, MASS]),
        np.array([[0.0, 0, 0], [LENGTH, 0, 0]]),
        np.stack([(cart > 0.0) * np.eye(3), INERTIA * np.eye(3)]),
        driven=np.array([driven, False]),
    )


def weight(q, factors):
    return MASS * G * LENGTH * (1.0 - float(np.cos(q[1]))), np.array([0.0, -MASS * G * LENGTH * np.sin(q[1])])


def motion(time):
    """To and fro, faster and faster: where the cart is, its velocity, its acceleration."""
    phase, rate = 3.0 * time + time**2, 3.0 + 2.0 * time
    x = 0.3 * np.sin(phase)
    return (
        np.array([x]),
        np.array([0.3 * rate * np.cos(phase)]),
        np.array([0.6 * np.cos(phase) - rate**2 * x]),
    )


def driven_system(**others):
    return System(on_a_cart(), weight, drive=motion, **others)


def angle_and_work(until, damping=0.0, start=(0.4, 1.0)):
    """The pendulum's angle and rate and the work of its drive, by DOP853 from the textbook equation."""
    inertia, lever = INERTIA + MASS * LENGTH**2, MASS * LENGTH

    def rates(t, y):
        (_,), (v,), (a,) = motion(t)
        # A turn by y about the world's y axis carries what hangs down towards -x.
        acceleration = (lever * a * np.cos(y[0]) - lever * G * np.sin(y[0]) - damping * y[1]) / inertia
        force = (3.0 + MASS) * a - lever * (acceleration * np.cos(y[0]) - y[1] ** 2 * np.sin(y[0]))
        return [y[1], acceleration, force * v]

    return solve_ivp(rates, (0.0, until), (*start, 0.0), method="DOP853", rtol=1e-13, atol=1e-13).y[:, -1]


def steps(system, integrator, at, n, h):
    for _ in range(n):
        at = integrator.step(system, at, h)
    return at


def begun(system):
    given = np.array([9.0, 0.4]), np.array([9.0, 1.0])
    at = system.at(*given)
    assert np.array_equal(given, [[9.0, 0.4], [9.0, 1.0]])
    return at


# --- Solutions with M

SEEDS = [seed for seed in range(30) if 12 < any_tree(seed).n_v < 70]


def driven_tree(seed):
    """A tree with a third of its hinges driven, coordinates, their frames; its driven and other freedoms."""
    rng = np.random.default_rng(seed)
    tree = any_tree(seed)
    tree = replace(tree, driven=(np.diff(tree.v_start) == 1) & (rng.random(tree.n_bodies) < 0.35))
    assert 0 < len(tree.driven_v) < tree.n_v
    q = random_q(tree, rng)
    return tree, q, pose(tree, q), rng, tree.driven_v, tree.undriven_v


@pytest.mark.parametrize("seed", SEEDS)
def test_accelerations_are_those_of_the_partition_of_the_mass_matrix(seed):
    """M_ff qdd_f = tau_f - c_f - M_fd qdd_d."""
    tree, q, frames, rng, d, f = driven_tree(seed)
    qd, tau = rng.normal(size=(2, tree.n_v))
    wrench = rng.normal(size=(tree.n_bodies, 6))
    m, bias = mass_matrix(tree, frames), inverse_dynamics(tree, q, qd, np.zeros(tree.n_v), wrench)
    expected = tau.copy()
    expected[f] = np.linalg.solve(m[np.ix_(f, f)], tau[f] - bias[f] - m[np.ix_(f, d)] @ tau[d])
    found = forward_dynamics(tree, q, qd, tau, wrench)
    assert np.array_equal(found[d], tau[d])
    assert np.abs(found - expected).max() < 1e-9 * np.abs(expected).max()
    # The torques that drive them, given to the same tree without drives, move it in the same way.
    torques = inverse_dynamics(tree, q, qd, found, wrench)
    assert np.abs(torques - tau)[f].max() < 1e-9 * np.abs(torques).max()
    again = forward_dynamics(replace(tree, driven=None), q, qd, torques, wrench)
    assert np.abs(found - again).max() < 1e-8 * np.abs(found).max()


@pytest.mark.parametrize("seed", SEEDS)
def test_solutions_leave_driven_freedoms_out(seed):
    tree, _, frames, rng, d, f = driven_tree(seed)
    m = mass_matrix(tree, frames)[np.ix_(f, f)]
    tau, inverse = rng.normal(size=tree.n_v), np.zeros((tree.n_v, tree.n_v))
    inverse[np.ix_(f, f)] = np.linalg.inv(m)
    for found in (
        solve_mass(tree, frames, tau),
        solve_mass(tree, frames, tau, "fixman"),
        solve(articulate(tree, frames), tau),
    ):
        assert np.array_equal(found[d], np.zeros(len(d)))
        assert np.abs(found - inverse @ tau).max() < 1e-8 * np.abs(inverse @ tau).max()
    for method in ("articulated", "fixman"):
        assert log_det_mass(tree, frames, method) == pytest.approx(np.linalg.slogdet(m)[1], abs=1e-7)
    rows = point_rows(frames, (0, tree.n_bodies - 1), frames.origin[[0, -1]] + 0.1)
    g = row_matrix(tree, frames, rows)
    there = g @ inverse @ g.T
    assert np.allclose(operational_inverse(tree, frames, rows), there, atol=1e-9 * np.abs(there).max())
    if np.linalg.cond(there) < 1e6:
        for method in ("articulated", "fixman"):
            closed = solve_closed(tree, frames, tau, rows, method)
            expected = inverse @ (tau - g.T @ np.linalg.solve(there, g @ inverse @ tau))
            assert np.abs(closed - expected).max() < 1e-7 * np.abs(expected).max()
            closed_det = log_det_closed(tree, frames, rows, method)
            assert closed_det == pytest.approx(np.linalg.slogdet(there)[1], abs=1e-7)


def test_thermal_velocities_have_the_covariance_of_what_is_free():
    """One sample is linear in its noise, so that unit noise gives a factor of the covariance, exactly."""
    tree, _, frames, _, d, f = driven_tree(SEEDS[0])

    class Unit:
        def __init__(self, k):
            self.k = k

        def standard_normal(self, n):
            return np.eye(n)[self.k]

    columns = np.array([sample_velocities(tree, frames, 2.0, Unit(k)) for k in range(tree.n_v)]).T
    expected = 2.0 * np.linalg.inv(mass_matrix(tree, frames)[np.ix_(f, f)])
    found = columns @ columns.T
    assert np.array_equal(found[d], np.zeros((len(d), tree.n_v)))
    assert np.allclose(found[np.ix_(f, f)], expected, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("seed", SEEDS[:4])
def test_the_gradient_of_ln_det_runs_along_driven_freedoms_too(seed):
    tree, q, frames, _, d, _ = driven_tree(seed)
    gradient, h = log_det_gradient(tree, frames), 1e-4
    assert np.abs(gradient[d]).max() > 1e-3 * np.abs(gradient).max()
    for k in range(tree.n_v):
        step = h * np.eye(tree.n_v)[k]
        ends = [log_det_mass(tree, pose(tree, multibody.integrate(tree, q, sign * step))) for sign in (1, -1)]
        assert (ends[0] - ends[1]) / (2 * h) == pytest.approx(gradient[k], abs=1e-5 * np.abs(gradient).max())


@pytest.mark.parametrize("root", [HingeKind.REVOLUTE, HingeKind.FREE])
def test_under_the_driving_torques_pinocchio_moves_driven_hinges_as_given(root):
    tree = random_tree(30, 3, 0.4, root, KINDS)
    driven = replace(tree, driven=(np.diff(tree.v_start) == 1) & (np.arange(30) % 3 == 1))
    s = state(tree, 3)
    given = s.tau[driven.driven_v]
    qdd = forward_dynamics(driven, s.q, s.qd, s.tau)
    s.tau = inverse_dynamics(driven, s.q, s.qd, qdd)
    theirs = pinocchio_acceleration(tree, s)
    assert np.abs(qdd - theirs).max() < 1e-9 * np.abs(qdd).max()
    assert theirs[driven.driven_v] == pytest.approx(given, abs=1e-9 * np.abs(qdd).max())


def test_nothing_driven_is_no_drive():
    tree = random_tree(5, 0)
    none = replace(tree, driven=np.zeros(5, dtype=bool))
    assert none.driven is None and none.is_plain and none.locked_links is none.links
    some = replace(tree, driven=np.arange(5) == 2)
    assert (some.driven_q, some.driven_v) == ([8], [7]) and not some.is_plain
    assert replace(some, mass=2.0 * tree.mass).driven_v == [7]


# --- Motion


def test_a_pendulum_on_a_driven_pivot_moves_as_by_dop853():
    system = driven_system()
    at = steps(system, DormandPrince(1e-13), begun(system), 4, 0.25)
    angle, rate, work = angle_and_work(1.0)
    assert at.q == pytest.approx([motion(1.0)[0][0], angle], abs=1e-11)
    assert at.qd == pytest.approx([motion(1.0)[1][0], rate], abs=1e-11)
    assert at.work == pytest.approx([work], abs=1e-10)


@pytest.mark.parametrize(
    ("integrator", "order"), [(RungeKutta4(), 4), (Rosenbrock(ONE_STEP), 2)], ids=["rk4", "rosenbrock"]
)
def test_order_under_a_drive(integrator, order):
    system, wanted = driven_system(), angle_and_work(1.0)
    coarse, fine = (steps(system, integrator, begun(system), n, 1.0 / n) for n in (80, 160))
    for value in (lambda at: at.q[1] - wanted[0], lambda at: at.qd[1] - wanted[1]):
        assert np.log2(abs(value(coarse) / value(fine))) == pytest.approx(order, abs=0.35)
    assert fine.work == pytest.approx(wanted[2:], abs=1e-5 if order == 4 else 1e-3)


@pytest.mark.parametrize(
    "integrator",
    [RungeKutta4(), DormandPrince(1e-9), Rosenbrock(), Rosenbrock(1e-4)],
    ids=["rk4", "dormand-prince", "rosenbrock", "adaptive rosenbrock"],
)
def test_driven_hinges_are_where_the_drive_says_to_the_bit(integrator):
    system = driven_system()
    at = steps(system, integrator, begun(system), 7, 0.037)
    x, v, _ = motion(at.time)
    assert (at.q[0], at.qd[0]) == (x[0], v[0])
    assert at.p == pytest.approx(mass_matrix(system.tree, at.factors.frames) @ at.qd, abs=1e-13)
    # Substeps add up to the step but for rounding, of which nothing may be left.
    for _ in range(4):
        at = integrator.step(system, at, 0.1)
        assert at.q[0] == motion(at.time)[0][0]
    back = steps(system, integrator, steps(system, integrator, at, 4, -0.1), 7, -0.037)
    assert back.q == pytest.approx(begun(system).q, abs=0.05)


def test_what_a_drive_does_and_a_damper_takes_is_the_energy():
    """Damped, pushed and driven at once, each with its own account."""
    damper = Load(lambda t, q, qd, frames: Applied(torques=np.array([0.0, -0.4 * qd[1]])))
    push = Load(lambda t, q, qd, frames: Applied(torques=np.array([5.0, 0.0])), depends_on_velocity=False)
    system = driven_system(loads=(damper, push))
    start = begun(system)
    at = steps(system, DormandPrince(1e-12), start, 8, 0.125)
    angle, rate, work = angle_and_work(1.0, damping=0.4)
    assert (at.q[1], at.qd[1]) == pytest.approx((angle, rate), abs=1e-10)
    x = motion(1.0)[0][0]
    # What the push gives to the cart the drive takes from it.
    assert at.work[1:] == pytest.approx([5.0 * x, work - 5.0 * x], abs=1e-9)
    assert at.work[0] < -0.1
    assert at.total - start.total == pytest.approx(at.work.sum(), abs=1e-9)
    # The same force in closed form.
    inertia, lever, (_, (v,), (a,)) = INERTIA + MASS * LENGTH**2, MASS * LENGTH, motion(1.0)
    swing = (lever * (a * np.cos(angle) - G * np.sin(angle)) - 0.4 * rate) / inertia
    force = (3.0 + MASS) * a - lever * (swing * np.cos(angle) - rate**2 * np.sin(angle))
    assert at.loads[:, 0] == pytest.approx([0.0, 5.0, force - 5.0], abs=1e-8)
    assert at.power == pytest.approx([-0.4 * rate**2, 5.0 * v, (force - 5.0) * v], abs=1e-8)


def test_integrators_by_momenta_refuse_drives():
    system = driven_system()
    for integrator, name in ((Leapfrog(), "leapfrog"), (ImplicitMidpoint(), "midpoint rule")):
        with pytest.raises(MechanicsError, match=f"the {name} does not support driven hinges; use"):
            integrator.step(system, begun(system), 0.01)


def test_a_drive_and_its_hinges_belong_together():
    with pytest.raises(MechanicsError, match="driven hinges, but the system has no drive"):
        System(on_a_cart(), weight)
    with pytest.raises(MechanicsError, match="a drive, but the tree has no driven hinge"):
        System(on_a_cart(driven=False), weight, drive=motion)
    wrong = System(on_a_cart(), weight, drive=lambda t: (np.zeros(2), np.zeros(1), np.zeros(1)))
    with pytest.raises(MechanicsError, match=r"the drive of 1 hinges gives shapes \(2,\), \(1,\) and"):
        begun(wrong)
