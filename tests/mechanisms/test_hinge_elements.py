"""Balls, stops, motors and friction in hinges, and what a state tells: closed forms, scipy, loops."""

import numpy as np
import pytest
from fixtures.refusals import expect_refusal
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from protochain.core.errors import Fault, MechanicsError
from protochain.mechanics import multibody
from protochain.mechanics.motion import DormandPrince, ImplicitMidpoint, RungeKutta4, StepTooLargeError
from protochain.mechanisms import (
    Mechanism,
    Rosenbrock,
    frequencies,
    linearise,
    state_matrix,
)  # fmt: skip

G = 9.81
PRECISE = DormandPrince(1e-10)
FOLLOWED = 1e-8
"""Of positions of order one after a second of steps that keep 1e-10."""
ROUNDED = 1e-12
"""Of numbers of order one that differ by rounding alone."""
NUDGED = 1e-7
"""Of central differences with steps of 1e-5 or 1e-6."""


def two_balls(**more):
    m = Mechanism(gravity=(0, 0, -G), **more)
    m.body("a", 1.0, com=(0.3, 0.1, -0.5), inertia=(0.3, 0.2, 0.25))
    m.body("b", 0.7, com=(0.1, 0.1, -0.3), inertia=(0.05, 0.06, 0.04))
    return m


def test_ball_hinges_move_as_free_bodies_whose_points_are_held():
    turned = Rotation.from_rotvec((0.5, 0.2, -0.1)).as_matrix()
    m = two_balls()
    m.hinge("s", "world", "a", "ball", at=(0.1, 0, 0), q=(0.3, -0.5, 0.2), qd=(8.0, 5.0, -9.0))
    m.hinge("t", "a", "b", "ball", at=(0, 0.2, -1), rotation=turned, q=(0, 0, 3.0), qd=(0.2, 0.1, 4.0))
    model = m.build()
    run = model.simulate(2.0, 0.01, PRECISE)
    start, end = model.state(), model.state(run.end)
    free = Mechanism(gravity=(0, 0, -G))
    for name, mass, com, inertia in (
        ("a", 1.0, (0.3, 0.1, -0.5), (0.3, 0.2, 0.25)), ("b", 0.7, (0.1, 0.1, -0.3), (0.05, 0.06, 0.04)),
    ):  # fmt: skip
        place = {"position": start.point(name), "rotation": start.rotation(name)}
        free.body(name, mass, com, inertia, **place, velocity=start.velocity(name), spin=start.spin(name))
    free.close("s", ("world", (0.1, 0, 0)), ("a", (0, 0, 0)), "spherical")
    free.close("t", ("a", (0, 0.2, -1)), ("b", (0, 0, 0)), "spherical")
    other = free.build().simulate(2.0, 0.01, PRECISE)
    there = other.model.state(other.end)
    for name in "ab":
        assert np.allclose(end.point(name), there.point(name), atol=10 * FOLLOWED)
        assert np.allclose(end.spin(name), there.spin(name), atol=100 * FOLLOWED)
    assert run.audit().energy < FOLLOWED
    # Rotation vectors stay within half a turn, though the bodies turn further.
    vectors = run.motion[["t x", "t y", "t z"]].to_numpy()
    assert np.max(np.linalg.norm(vectors, axis=1)) <= np.pi + ROUNDED
    assert np.max(np.abs(np.diff(vectors, axis=0))) > 1.0
    # What is seen outside is the relative rotation and angular velocity, axes of the child.
    relative = end.rotation("a").T @ end.rotation("b")
    assert np.allclose(turned @ Rotation.from_rotvec(end.angle("t")).as_matrix(), relative, atol=ROUNDED)
    assert np.allclose(end.rate("t"), end.rotation("b").T @ (end.spin("b") - end.spin("a")), atol=1e-10)


def test_what_takes_one_coordinate_refuses_a_ball():
    for method, more in (
        ("torsion", {"stiffness": 1.0}), ("torque", {"value": 1.0}), ("friction", {"torque": 1.0}),
        ("stop", {"high": 1.0, "stiffness": 1.0}),
    ):  # fmt: skip
        m = two_balls()
        m.hinge("s", "world", "a", "ball")
        m.hinge("t", "a", "b")
        getattr(m, method)("x", hinge="s", **more)
        with pytest.raises(MechanicsError, match=r'"x".*"s" is a ball'):
            m.build()


def slide(**more):
    m = Mechanism(**more)
    m.body("block", 2.0)
    m.hinge("way", "world", "block", "prismatic", axis=(1, 0, 0), qd=3.0)
    return m


def test_a_damped_stop_loses_as_a_law_of_its_restitution_says_and_never_pulls():
    k, c = 5000.0, 40.0
    m = slide()
    m.stop("end", "way", high=0.3, stiffness=k, damping=c)
    run = m.build().simulate(0.4, 1e-4, PRECISE)

    def rates(t, y):
        return [y[1], -max(k * y[0] + c * y[1], 0.0) / 2.0]

    def leaves(t, y):
        return k * y[0] + c * y[1]

    leaves.terminal, leaves.direction = True, -1
    end = solve_ivp(rates, (0.0, 1.0), [1e-300, 3.0], events=leaves, rtol=1e-11, atol=1e-12)
    assert run.qd[-1, 0] == pytest.approx(end.y[1, -1], rel=1e-4)
    assert run.table["dissipation"].iloc[-1] == pytest.approx(9.0 - run.qd[-1, 0] ** 2, rel=1e-4)
    with pytest.raises(MechanicsError, match="beyond its limits"):
        beyond = slide()
        beyond.stop("end", "way", low=0.1, stiffness=k)
        beyond.build()


def sway(size, rate, phase=0.0):
    return lambda t: (
        size * np.sin(rate * t + phase), size * rate * np.cos(rate * t + phase),
        -size * rate**2 * np.sin(rate * t + phase),
    )  # fmt: skip


WANTED = {"h1": sway(0.4, 3.0), "h2": sway(0.1, 4.0), "h3": sway(0.7, 2.0, 0.5)}


def arm(**more):
    m = Mechanism(gravity=(0.5, 0, -G), **more)
    for name, mass in (("a", 1.0), ("b", 2.0), ("c", 1.5)):
        m.body(name, mass, com=(0.2, 0.1, -0.1), inertia=(0.1, 0.2, 0.25))
    start = {name: (f(0.0)[0], f(0.0)[1]) for name, f in WANTED.items()}
    for name, parent, child, kind, axis in (
        ("h1", "world", "a", "revolute", (0, 0.6, 0.8)), ("h2", "a", "b", "prismatic", (1, 0, 0)),
        ("h3", "b", "c", "revolute", (0, 0, 1)),
    ):  # fmt: skip
        m.hinge(name, parent, child, kind, (0.3, 0.1, 0), axis, q=start[name][0], qd=start[name][1])
    return m


def test_motors_with_feed_forward_follow_with_the_torques_of_inverse_dynamics():
    m = arm()
    m.motor("arm", WANTED, stiffness=50.0, damping=5.0, feed_forward=True)
    run = m.build().simulate(1.0, 0.01, PRECISE)
    driven = arm()
    for name, motion in WANTED.items():
        driven.drive(name, motion)
    exact = driven.build().simulate(1.0, 0.01, PRECISE)
    for name, motion in WANTED.items():
        assert np.allclose(run.motion[name], [motion(t)[0] for t in run.time], atol=FOLLOWED)
        assert np.allclose(run.motion[f"{name} torque"], exact.motion[f"{name} drive"], atol=1e-5)
        assert np.allclose(
            run.motion[f"{name} power"], run.motion[f"{name} torque"] * run.motion[f"{name} rate"]
        )
    work = run.table["work arm"].iloc[-1]
    assert work == pytest.approx(exact.table["work drives"].iloc[-1], abs=1e-6)


def test_a_pd_motor_is_a_spring_and_a_damper_to_where_it_holds_and_no_stronger_than_its_limit():
    m, other = slide(), slide()
    m.motor("hold", {"way": 0.5}, stiffness=80.0, damping=3.0)
    other.torsion("hold", "way", stiffness=80.0, rest=0.5, damping=3.0)
    runs = [each.build().simulate(1.0, 0.01, PRECISE) for each in (m, other)]
    assert np.allclose(runs[0].q, runs[1].q, atol=FOLLOWED)
    weak = slide()
    weak.motor("hold", {"way": 100.0}, stiffness=80.0, limit=4.0)
    run = weak.build().simulate(1.0, 0.01, PRECISE)
    assert run.q[-1, 0] == pytest.approx(3.0 + 0.5 * 4.0 / 2.0, rel=1e-9)


def test_a_block_slides_down_a_slope_as_coulomb_says():
    angle, mu = 0.6, 0.3
    axis = (np.cos(angle), 0, -np.sin(angle))
    m = Mechanism(gravity=(0, 0, -G))
    m.body("block", 2.0)
    m.hinge("way", "world", "block", "prismatic", axis=axis, qd=0.5)
    m.friction("rubs", "way", coefficient=mu, damping=0.4, speed=1e-4)
    run = m.build().simulate(1.0, 0.01, PRECISE)
    pull = G * (np.sin(angle) - mu * np.cos(angle))
    last = pull / 0.2 + (0.5 - pull / 0.2) * np.exp(-0.2)
    assert run.qd[-1, 0] == pytest.approx(last, abs=1e-8)
    lost = run.total[0] - run.total[-1]
    assert run.table["dissipation"].iloc[-1] == pytest.approx(lost, rel=1e-8)
    assert run.audit().energy < 1e-8


def test_degrees_are_radians_outside():
    def made(units):
        one = np.degrees(1.0) if units == "deg" else 1.0
        m = Mechanism(gravity=(0, 0, -G), units=units)
        for name in "abcd":
            m.body(name, 1.0, com=(0.1, 0.2, -0.5), inertia=(0.3, 0.2, 0.25))
        m.hinge("p", "world", "a", axis=(0, 1, 0), q=0.4 * one, qd=-0.2 * one)
        m.hinge("s", "a", "b", "ball", at=(0, 0, -1), q=np.multiply(one, (0.1, 0.2, 0.3)))
        m.hinge("d", "b", "c", axis=(1, 0, 0))
        m.hinge("l", "c", "d", "prismatic", axis=(1, 0, 0), q=0.3)
        m.drive("d", lambda t: tuple(one * x for x in sway(0.3, 2.0)(t)))
        m.torsion("t", "p", stiffness=20.0, rest=0.2 * one)
        m.torsion("u", "l", stiffness=20.0, rest=0.2)
        m.stop("stop", "p", low=-0.3 * one, high=0.6 * one, stiffness=100.0)
        m.motor("m", {"p": 0.3 * one, "l": 0.1}, stiffness=5.0)
        return m.build().simulate(0.5, 0.01, PRECISE), one

    (plain, _), (degrees, one) = made("rad"), made("deg")
    assert np.allclose(plain.q, degrees.q, atol=FOLLOWED)
    for name in ("p", "p rate", "d", "d rate", "s x", "s rate z"):
        assert np.allclose(one * plain.motion[name], degrees.motion[name], atol=one * FOLLOWED)
    for name in ("l", "l rate", "d drive", "p torque", "p power", "l torque"):
        assert np.allclose(plain.motion[name], degrees.motion[name], atol=100 * FOLLOWED)
    ends = [run.model.state(run.end) for run in (plain, degrees)]
    assert ends[1].angle("p") == pytest.approx(one * ends[0].angle("p"))
    assert np.allclose(ends[1].rate("s"), one * ends[0].rate("s"))
    with pytest.raises(MechanicsError, match="units"):
        Mechanism(units="degrees")


def test_weights_and_jacobians_are_the_derivatives_of_energies_and_places():
    m = arm()
    m.hinge("ball", "c", "d", "ball", at=(0.1, 0.2, 0.3), q=(0.3, 0.1, -0.5))
    m.body("d", 0.5, com=(0.1, 0, 0.2), inertia=(0.1, 0.2, 0.25))
    m.body("flier", 1.0, com=(0.1, 0.2, 0), inertia=(0.1, 0.2, 0.25), position=(1, 2, 3))
    model = m.build()
    system, tree, q = model.system, model.tree, model.q
    state = model.state()
    for name in ("c", "d", "flier"):
        jacobian = state.jacobian(name, (0.3, -0.2, 0.1))
        qd = np.random.default_rng(1).normal(size=tree.n_v)
        moved = model.state(system.at(q, qd))
        wanted = [*moved.velocity(name, (0.3, -0.2, 0.1)), *moved.spin(name)]
        assert np.allclose(jacobian @ qd, wanted, atol=ROUNDED)
    moves = [1e-5 * unit for unit in np.eye(tree.n_v)]
    above, below = (
        [system.at(multibody.integrate(tree, q, sign * move), 0 * model.qd).potential for move in moves]
        for sign in (1, -1)
    )
    assert np.allclose(state.weight, np.subtract(below, above) / 2e-5, atol=NUDGED)


def cart(angle=0.0):
    """A cart of 2 kg on a spring with a pendulum of 0.5 kg and 0.7 m."""
    m = Mechanism(gravity=(0, 0, -G))
    m.body("cart", 2.0)
    m.body("bob", 0.5, com=(0, 0, -0.7))
    m.hinge("way", "world", "cart", "prismatic", axis=(1, 0, 0))
    m.hinge("pin", "cart", "bob", axis=(0, -1, 0), q=angle)
    m.torsion("spring", "way", stiffness=30.0, damping=0.6)
    return m.build()


@pytest.mark.parametrize("upright", [False, True])
def test_a_cart_with_a_pendulum_has_the_matrices_of_text_books(upright):
    model = cart(np.pi if upright else 0.0)
    outputs = [
        lambda state: state.point("bob", (0, 0, -0.7))[0],
        lambda state: state.rate("pin"),
        lambda state, qdd: qdd[0],
    ]
    a, b, c, d = linearise(model, ["way", "pin"], outputs)
    sign, m, big, length = (-1.0 if upright else 1.0), 0.5, 2.0, 0.7
    mass = np.array([[big + m, sign * m * length], [sign * m * length, m * length**2]])
    stiff, damp = np.diag([30.0, sign * m * G * length]), np.diag([0.6, 0.0])
    inverse = np.linalg.inv(mass)
    want_a = np.block([[np.zeros((2, 2)), np.eye(2)], [-inverse @ stiff, -inverse @ damp]])
    assert np.allclose(a, want_a, atol=NUDGED)
    assert np.array_equal(a, state_matrix(model))
    assert np.allclose(b, np.vstack([np.zeros((2, 2)), inverse]), atol=NUDGED)
    assert np.allclose(c, [[1, sign * length, 0, 0], [0, 0, 0, 1], want_a[2]], atol=NUDGED)
    assert np.allclose(d, [[0, 0], [0, 0], inverse[0]], atol=NUDGED)
    assert len(frequencies(model)) == (1 if upright else 2)


# --- Rest and creeping


def held_block(qd=0.0, speed=1e-4):
    """A block of 2 kg on a slide 20 degrees down, which friction holds: it creeps at 0.92 of a speed."""
    angle = np.radians(20.0)
    m = Mechanism(gravity=(0, 0, -9.81))
    m.body("block", 2.0, inertia=0.01)
    m.hinge("slope", "world", "block", "prismatic", axis=(np.cos(angle), 0, -np.sin(angle)), qd=qd)
    m.friction("rub", "slope", coefficient=0.5, speed=speed)
    return m.build(), speed * np.arctanh(np.tan(angle) / 0.5)


ADAPTIVE = [DormandPrince(1e-5), DormandPrince(), Rosenbrock(1e-4), Rosenbrock()]


@pytest.mark.parametrize("integrator", ADAPTIVE)
@pytest.mark.parametrize("qd", [0.0, 1e-4])
def test_a_block_that_creeps_down_a_slope_is_followed_within_the_tolerance(integrator, qd):
    """Of a balance of energy, what forces do in displacements below the tolerance is no loss."""
    model, creeping = held_block(qd)
    run = model.simulate(0.02, 0.01, integrator)
    # An error of a tolerance for each of a hundred substeps, in sizes of the tree; of the speed, of a step.
    wrong = 100.0 * integrator.tolerance * model.tree.size
    assert abs(run.q[-1, 0] - creeping * 0.02) < creeping * 1e-3 + 2 * wrong + 2e-5 * abs(qd - creeping)
    assert abs(run.qd[-1, 0] - creeping) < 1e-3 * creeping + wrong / 0.01


def test_what_a_time_step_does_not_resolve_is_refused_at_a_slope_too():
    """The friction settles in 20 microseconds."""
    model, _ = held_block()
    with expect_refusal(fault=Fault.STEP, kind=StepTooLargeError):
        model.simulate(1.0, 0.01)


def hung(q=0.0, damping=0.0):
    m = Mechanism(gravity=(0, 0, -9.81))
    m.body("bob", 1.0, com=(0, 0, -1.0))
    m.hinge("pin", "world", "bob", axis=(0, 1, 0), q=q)
    if damping:
        m.torsion("slow", "pin", damping=damping)
    return m.build()


def on_a_spring():
    m = Mechanism(gravity=(0, 0, -9.81))
    m.body("mass", 1.0)
    m.hinge("slide", "world", "mass", "prismatic", axis=(0, 0, 1), q=-9.81 / 70.0)
    m.torsion("spring", "slide", stiffness=70.0)
    return m.build()


def seesaw():
    """A board with loads on both sides, whose moments cancel but for rounding."""
    m = Mechanism(gravity=(0, 0, -9.81))
    m.body("board", 5.0, inertia=1.0, com=(0, 0, -0.01))
    m.hinge("pin", "world", "board", axis=(0, 1, 0))
    for name, at, mass in (("light", -1.5, 20.0), ("heavy", 0.3, 100.0)):
        m.body(name, mass, inertia=0.1)
        m.hinge(name, "board", name, "fixed", at=(at, 0, -0.1))
    return m.build()


AT_REST = {"hung": hung, "nearly": lambda: hung(1e-9), "damped": lambda: hung(1e-6, 0.5),
           "spring": on_a_spring, "seesaw": seesaw}  # fmt: skip


@pytest.mark.parametrize("made", AT_REST.values(), ids=AT_REST)
@pytest.mark.parametrize("integrator", [RungeKutta4(), *ADAPTIVE, ImplicitMidpoint()])
def test_what_is_at_rest_stays_there_with_any_integrator(made, integrator):
    model = made()
    run = model.simulate(0.5, 0.01, integrator)
    assert np.max(np.abs(run.q)) <= np.max(np.abs(model.q)) + 1e-12
    assert run.audit().energy < 1e-3
