"""Loads, stiff integration, error norms and events of trees, against closed forms and scipy's integrators."""

from dataclasses import replace

import numpy as np
import pytest
from fixtures.refusals import expect_refusal
from fixtures.tolerances import ONE_STEP, ROUND_OFF
from scipy.integrate import solve_ivp

from protochain.core.errors import Fault, MechanicsError
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
from protochain.mechanics.multibody import HingeKind, Tree, random_tree
from protochain.mechanisms import Rosenbrock
from protochain.mechanisms.event import Watched, march
from protochain.mechanisms.rosenbrock import _advance

G = 9.81
LENGTH, MASS = 0.7, 2.0
INERTIA = MASS * LENGTH**2
"""Pendulum: a point of mass 2 kg on a rod of 0.7 m."""


def pendulum():
    """A pendulum that swings about the world's y axis and hangs down at q = 0."""
    down = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])  # body x along the world's -z
    quarter = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # body z along the world's y
    placement = down.T @ quarter
    return Tree(
        np.array([-1]),
        np.array([HingeKind.REVOLUTE]),
        np.zeros((1, 3)),
        placement[None],
        np.array([MASS]),
        np.array([[LENGTH, 0.0, 0.0]]),
        np.zeros((1, 3, 3)),
    )


def slider():
    """A ball of 1 kg that moves along the world's z axis."""
    return Tree(
        np.array([-1]), np.array([HingeKind.PRISMATIC]), np.zeros((1, 3)), np.eye(3)[None], np.ones(1),
        np.zeros((1, 3)), 1e-3 * np.eye(3)[None],
    )  # fmt: skip


def nothing(q, factors):
    return 0.0, np.zeros(factors.tree.n_v)


def free_fall(q, factors):
    return G * float(q[0]), np.array([-G])


def swings(q, factors):
    """Potential of the pendulum, as a spring so that it needs no frames: k (1 - cos q)."""
    k = MASS * G * LENGTH
    return k * (1.0 - float(np.cos(q[0]))), np.array([-k * float(np.sin(q[0]))])


def drive(time, q, qd, frames):
    return Applied(torques=np.array([3.0 * np.sin(5.0 * time) - 0.8 * qd[0]]))


def shake(time, q, qd, frames):
    return Applied(torques=np.array([3.0 * np.sin(5.0 * time)]))


def exact(damping, until, start=(0.4, 1.0)):
    """The driven pendulum by DOP853."""

    def rates(t, y):
        torque = 3.0 * np.sin(5.0 * t) - damping * y[1]
        return [y[1], torque / INERTIA - G / LENGTH * np.sin(y[0])]

    return solve_ivp(rates, (0.0, until), start, method="DOP853", rtol=1e-13, atol=1e-13).y[:, -1]


def steps(system, integrator, at, n, h):
    for _ in range(n):
        at = integrator.step(system, at, h)
    return at


def error(at, wanted):
    return max(abs(at.q[0] - wanted[0]), abs(at.qd[0] - wanted[1]))


# --- Loads


@pytest.mark.parametrize(
    ("integrator", "load", "damping", "order"),
    [
        (RungeKutta4(), drive, 0.8, 4),
        (ImplicitMidpoint(1e-13), drive, 0.8, 2),
        (Rosenbrock(ONE_STEP), drive, 0.8, 2),
        (Leapfrog(), shake, 0.0, 2),
    ],
    ids=["rk4", "midpoint", "rosenbrock", "leapfrog"],
)
def test_order_under_a_load_that_depends_on_time(integrator, load, damping, order):
    system = System(pendulum(), swings, loads=(Load(load, damping > 0.0),))
    start, wanted = system.at(np.array([0.4]), np.array([1.0])), exact(damping, 1.0)
    coarse, fine = (error(steps(system, integrator, start, n, 1.0 / n), wanted) for n in (50, 100))
    assert np.log2(coarse / fine) == pytest.approx(order, abs=0.25)
    assert fine < 0.01


@pytest.mark.parametrize(
    "integrator", [DormandPrince(1e-12), Rosenbrock(1e-6)], ids=["dormand-prince", "rosenbrock"]
)
def test_tolerance_is_kept_by_substeps(integrator):
    system = System(pendulum(), swings, loads=(Load(drive),))
    at = steps(system, integrator, system.at(np.array([0.4]), np.array([1.0])), 4, 0.25)
    assert at.time == pytest.approx(1.0, abs=1e-15)
    assert error(at, exact(0.8, 1.0)) < 1000 * integrator.tolerance


def test_substeps_backwards_are_the_mirror_image():
    """From rest, under a load that is even in time: the same substeps, with the same rounding."""
    push = Load(lambda t, q, qd, frames: Applied(torques=np.array([3.0 * np.cos(40.0 * t)])), False)
    system = System(pendulum(), swings, loads=(push,))
    start = system.at(np.array([0.4]), np.zeros(1))
    ahead, back = (DormandPrince().step(system, start, h) for h in (0.25, -0.25))
    assert np.array_equal(ahead.q, back.q) and np.array_equal(ahead.qd, -back.qd)


@pytest.mark.parametrize(
    ("integrator", "allowed"),
    [
        (DormandPrince(1e-12), 1e-9),
        (RungeKutta4(), 1e-7),
        (ImplicitMidpoint(1e-13), 1e-3),
        (Rosenbrock(ONE_STEP), 1e-2),
    ],
    ids=["dormand-prince", "rk4", "midpoint", "rosenbrock"],
)  # fmt: skip
def test_energy_changes_by_the_work_of_the_loads(integrator, allowed):
    """Wrenches and torques together on a tree with a free root: its kinetic energy is their work."""
    rng = np.random.default_rng(3)
    tree = random_tree(5, 3, root=HingeKind.FREE)
    pushed = rng.normal(size=(tree.n_bodies, 6))

    def push(time, q, qd, frames):
        twists = multibody.velocities(tree, frames, qd)
        return Applied(np.cos(3.0 * time) * pushed - 0.2 * twists, -0.1 * qd)

    system = System(tree, nothing, loads=(Load(push),))
    q = np.zeros(tree.n_q)
    q[0] = 1.0
    start = system.at(q, 0.5 * rng.normal(size=tree.n_v))
    end = steps(system, integrator, start, 100, 0.01)
    (work,) = end.work
    assert abs(work) > 0.1
    assert end.total - start.total == pytest.approx(work, abs=allowed * abs(work))


def test_loads_add_up_and_each_has_its_work():
    """Two loads move the tree as their sum does, and share its work."""
    tree, at = pendulum(), (np.array([0.4]), np.array([1.0]))
    both = Load(shake, False), Load(lambda t, q, qd, f: Applied(torques=-0.8 * qd))
    apart, one = System(tree, swings, loads=both), System(tree, swings, loads=(Load(drive),))
    assert apart.depends_on_velocity and not System(tree, swings, loads=both[:1]).depends_on_velocity
    for integrator in (RungeKutta4(), DormandPrince(1e-10), Rosenbrock(), ImplicitMidpoint()):
        ends = [steps(s, integrator, s.at(*at), 10, 0.02) for s in (apart, one)]
        assert np.array_equal(ends[0].q, ends[1].q)
        assert ends[0].work.shape == (2,) and ends[0].loads.shape == (2, 1)
        assert ends[0].work.sum() == pytest.approx(ends[1].work[0], rel=ROUND_OFF)
        # The damper takes 0.8 times the integral of a velocity's square, which falls from one to zero.
        assert -0.06 < ends[0].work[1] < -0.04
        assert ends[0].power == pytest.approx(ends[0].loads @ ends[0].qd)
    gentle = System(tree, swings, loads=(both[0], both[0]))
    twice = steps(gentle, Leapfrog(), gentle.at(*at), 10, 0.02)
    assert twice.work[0] == twice.work[1] != 0.0


def test_leapfrog_refuses_loads_that_depend_on_velocities():
    system = System(pendulum(), swings, loads=(Load(drive),))
    with pytest.raises(MechanicsError, match="velocities"):
        Leapfrog().step(system, system.at(np.array([0.4]), np.array([1.0])), 0.01)


def test_other_velocities_bring_other_loads():
    system = System(pendulum(), swings, loads=(Load(drive),))
    at = system.at(np.array([0.4]), np.array([1.0]), time=0.3, work=np.array([2.0]))
    turned = system.with_velocities(at, np.array([-1.0]))
    assert turned.torque[0] == pytest.approx(at.torque[0] + 1.6)
    assert (turned.time, *turned.work) == (0.3, 2.0)


def test_without_loads_a_phase_is_as_before():
    system = System(pendulum(), swings)
    at = steps(system, Leapfrog(), system.at(np.array([0.4]), np.array([1.0])), 5, 0.01)
    assert at.loads is None and at.work.shape == at.power.shape == (0,)
    assert at.time == pytest.approx(0.05)


# --- Stiff systems, units


def test_a_step_of_rosenbrock_is_its_rational_function_of_a_linear_systems_matrix():
    """Of sliders on sliders with springs, dampers and a growing load; the error that it estimates; work."""
    rng, n, h, gamma = np.random.default_rng(2), 4, 0.3, 1.0 - 1.0 / np.sqrt(2.0)
    tree = random_tree(n, 6, root=HingeKind.PRISMATIC, kinds=(HingeKind.PRISMATIC,))
    (k, c), (steady, growing) = (np.eye(n) + 0.2 * rng.normal(size=(2, n, n))), rng.normal(size=(2, n))
    k = 0.5 * (k + k.T)
    load = Load(lambda t, q, qd, frames: Applied(torques=steady + growing * t - c @ qd))
    system = System(tree, lambda q, factors: (0.5 * q @ k @ q, -k @ q), loads=(load,))
    at = system.at(*rng.normal(size=(2, n)), 0.7)
    a, mass = np.zeros((2 * n + 2, 2 * n + 2)), multibody.mass_matrix(tree, at.factors.frames)
    a[:n, n:-2], a[-2, -1] = np.eye(n), 1.0
    a[n:-2] = np.linalg.solve(mass, np.column_stack([-k, -c, growing, steady]))
    y, one = np.concatenate([at.q, at.qd, [at.time, 1.0]]), np.eye(2 * n + 2)
    near = np.linalg.inv(one - gamma * h * a)
    first = y + h * near @ a @ y
    end = near @ near @ (one + (1.0 - 2.0 * gamma) * h * a) @ y
    power = [(steady + growing * z[-2] - c @ z[n:-2]) @ z[n:-2] for z in (y, first)]
    after, moved, quickened = _advance(system, at, h)
    found = np.concatenate([after.q, after.qd, [after.time], moved, quickened])
    assert found == pytest.approx(np.concatenate([end[:-1], (end - first)[:-2]]), abs=1e-8)
    assert after.work[0] - at.work[0] == pytest.approx(0.5 * h * sum(power), abs=1e-8)


def test_rosenbrock_of_a_free_tree_is_of_order_two():
    rng = np.random.default_rng(5)
    tree = random_tree(4, 5, root=HingeKind.FREE, kinds=(HingeKind.REVOLUTE, HingeKind.PRISMATIC))
    stiff = np.where(np.arange(tree.n_v) < 6, 0.0, 2.0)
    load = Load(lambda t, q, qd, f: Applied(torques=np.sin(t) - stiff * qd))
    system = System(tree, nothing, loads=(load,))
    q = np.zeros(tree.n_q)
    q[0] = 1.0
    start = system.at(q, rng.normal(size=tree.n_v))
    exactly = DormandPrince(1e-12).step(system, start, 0.5)
    errors = [
        np.max(np.abs(steps(system, Rosenbrock(ONE_STEP), start, n, 0.5 / n).q - exactly.q))
        for n in (80, 160)
    ]  # fmt: skip
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.3)


@pytest.mark.parametrize("integrator", [DormandPrince(1e-9), Rosenbrock(1e-4), ImplicitMidpoint()])
def test_no_tolerance_depends_on_the_units(integrator):
    """In metres or millimetres, seconds or milliseconds, the substeps are the same, and so is the end."""
    ends, counts = [], []
    for scale, second in ((1.0, 1.0), (1000.0, 1.0), (1.0, 1000.0)):
        tree = Tree(
            np.array([-1, 0]), np.array([HingeKind.PRISMATIC, HingeKind.REVOLUTE]),
            scale * np.array([[0.0, 0, 0], [0.2, 0, 0]]), np.eye(3)[None].repeat(2, 0), np.ones(2),
            scale * np.array([[0.0, 0, 0], [0.3, 0, 0.1]]), scale**2 * 0.01 * np.eye(3)[None].repeat(2, 0),
        )  # fmt: skip
        count = []

        def potential(q, factors, scale=scale, unit=(scale / second) ** 2, count=count):
            count.append(1)
            x, angle = q[0] / scale, q[1]
            energy = 40.0 * x**2 + 5.0 * np.cos(angle)
            return unit * energy, unit * np.array([-80.0 * x / scale, 5.0 * np.sin(angle)])

        system = System(tree, potential)
        at = steps(system, integrator, system.at(np.array([0.1 * scale, 0.3]), np.zeros(2)), 5, 0.1 * second)
        ends.append(at.q / tree.coordinate_units)
        counts.append(len(count))
    assert max(counts) - min(counts) <= 2
    assert np.allclose(ends[0], ends[1:], atol=1e-7)


def test_units_of_freedoms():
    tree = random_tree(6, 2, root=HingeKind.FREE, kinds=(HingeKind.PRISMATIC,))
    assert np.array_equal(tree.units, [1.0] * 3 + [tree.size] * 8)
    assert np.array_equal(tree.coordinate_units, [1.0] * 4 + [tree.size] * 8)
    assert tree.size > 0.0
    doubled = replace(
        tree, offset=2 * tree.offset, com=2 * tree.com, inertia=4 * tree.inertia
    )  # fmt: skip
    assert doubled.size == pytest.approx(2 * tree.size)


# --- Events


def bouncing(restitution):
    return Watched(
        "floor", lambda at: float(at.q[0]), lambda s, at: s.with_velocities(at, -restitution * at.qd)
    )


def test_bounces_come_at_the_times_known():
    """A ball dropped from 1 m, restitution 0.8: bounce n at t1 (1 + 2 (e + ... + e^(n-1)))."""
    system, e = System(slider(), free_fall), 0.8
    at = system.at(np.array([1.0]), np.zeros(1))
    found = [
        (p.time, p.total)
        for p, event in march(system, DormandPrince(1e-12), at, 2.5, 0.05, [bouncing(e)])
        if event
    ]
    first = np.sqrt(2.0 / G)
    times = first * (1.0 + 2.0 * np.cumsum([0.0, *(e**k for k in range(1, len(found)))]))
    assert len(found) == 4
    assert np.allclose([t for t, _ in found], times, atol=1e-10)
    assert np.allclose([w for _, w in found], G * e ** (2.0 * np.arange(1, len(found) + 1)), rtol=1e-9)


def test_bounces_shorter_than_the_step_are_seen():
    """Each bounce is followed to where it is above the floor, however short."""
    system = System(slider(), free_fall)
    at = system.at(np.array([1.0]), np.zeros(1))
    found = [
        p.time for p, event in march(system, RungeKutta4(), at, 3.4, 0.5, [bouncing(0.8)]) if event
    ]  # fmt: skip
    first = np.sqrt(2.0 / G)
    times = first * (1.0 + 2.0 * np.cumsum([0.0, *(0.8**k for k in range(1, len(found)))]))
    assert len(found) == 8
    assert np.allclose(found, times, atol=1e-9)


def test_endless_bounces_are_refused_by_name():
    system = System(slider(), free_fall)
    at = system.at(np.array([1.0]), np.zeros(1))
    still = Watched("floor", lambda at: float(at.q[0]), lambda s, at: at)
    for event in (bouncing(0.3), still):
        with expect_refusal(fault=Fault.ENDLESS, kind=MechanicsError):
            list(march(system, RungeKutta4(), at, 5.0, 0.01, [event]))


def test_events_of_one_time_follow_each_other_and_the_earliest_comes_first():
    system = System(slider(), nothing)
    at = system.at(np.array([0.0]), np.ones(1))

    def mark(name, place):
        # Not a straight line, so that its zero is found at a time that is rounded otherwise.
        return Watched(name, lambda p: float(np.sinh(place - p.q[0])) / 3.0, lambda s, p: p, passes=True)

    turn = Watched("wall", lambda p: 0.35 - float(p.q[0]), lambda s, p: s.with_velocities(p, -p.qd))
    events = [mark("late", 0.34), turn, mark("with the wall", 0.35), mark("early", 0.33)]
    events.append(mark("a moment later", 0.33 + 1e-8))

    seen = [(e.name, p.time) for p, e in march(system, RungeKutta4(), at, 0.6, 0.1, events) if e]
    assert [name for name, _ in seen] == ["early", "a moment later", "late", "wall", "with the wall"]
    assert np.allclose([time for _, time in seen], [0.33, 0.33 + 1e-8, 0.34, 0.35, 0.35], rtol=0, atol=1e-12)


def test_an_event_at_the_start_happens():
    system = System(slider(), free_fall)
    at = system.at(np.zeros(1), np.array([-1.0]))
    first, event = next(march(system, RungeKutta4(), at, 1.0, 0.1, [bouncing(1.0)]))
    assert event is not None
    assert (first.time, first.qd[0]) == (0.0, 1.0)


def test_march_ends_at_its_time_and_keeps_the_bare_integrators_bits():
    system = System(pendulum(), swings)
    at = system.at(np.array([0.4]), np.array([1.0]))
    *_, (end, event) = march(system, Leapfrog(), at, 0.25, 0.05)
    assert event is None
    assert end.time == pytest.approx(0.25, abs=1e-14)
    four = steps(system, Leapfrog(), at, 4, 0.05)
    assert np.array_equal(Leapfrog().step(system, four, 0.25 - four.time).q, end.q)
    with pytest.raises(MechanicsError, match="positive"):
        next(march(system, Leapfrog(), at, 1.0, 0.0))
