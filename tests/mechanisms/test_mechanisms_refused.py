"""Mechanisms that cannot be, extremes, events, and what a run that needs none of it pays."""

import re
from contextlib import nullcontext
from dataclasses import replace
from unittest import mock

import numpy as np
import pytest
from fixtures.pendulum import DOWN, G, pendulum
from fixtures.refusals import expect_refusal
from fixtures.tolerances import AUDITED

from protochain.core.errors import Fault, MechanicsError
from protochain.mechanics.motion import (
    Applied,
    DormandPrince,
    ImplicitMidpoint,
    Leapfrog,
    Load,
    RungeKutta4,
    StepTooLargeError,
)
from protochain.mechanisms import Acting, Ball, Law, Mechanism, Plane, Rosenbrock, Surface, frequencies
from protochain.mechanisms.drawing import drawing
from protochain.mechanisms.impacts import ContactPoint
from protochain.mechanisms.rosenbrock import GAMMA, _advance, _check_balance

ORIGIN = (0, 0, 0)
BALL, LAW = Ball("rod", 0.1), Law(1e6)


def two():
    m = pendulum()
    m.body("tip", 1.0, inertia=1.0)
    return m


def welded(m, kind="fixed", **more):
    m.hinge("weld", "rod", "tip", kind, **more)
    return m


class Nothing:
    def bind(self, bodies):
        return Acting()


def chained(*pairs):
    m = Mechanism()
    for name in sorted({name for pair in pairs for name in pair} - {"world"}):
        m.body(name, 1.0, inertia=1.0)
    for parent, child in pairs:
        m.hinge(f"{parent}-{child}", parent, child)
    return m


@pytest.mark.parametrize(
    ("act", "words"),
    [
        (lambda m: Mechanism().build(), "the mechanism is empty; add a body"),
        (lambda m: Mechanism(gravity=-9.81), "gravity -9.81: give three numbers"),
        (lambda m: m.body("rod", 1.0), 'body "rod" is named twice'),
        (lambda m: m.body("world", 1.0), '"world" is reserved'),
        (lambda m: m.body(7, 1.0), "the name 7 of a body: give a text"),
        (lambda m: m.body("b", -1.0), 'body "b": its mass -1.0: give none below zero'),
        (lambda m: m.body("b", np.nan), 'body "b": its mass nan: give a number, finite'),
        (lambda m: m.body("b", 1.0, com=(0, 0)), 'body "b": its centre of mass'),
        (lambda m: m.body("b", 1.0, inertia=np.eye(3) + np.eye(3, k=1)), "its inertia is not symmetric"),
        (lambda m: m.body("b", 1.0, rotation=2 * np.eye(3)), "its rotation is none"),
        (lambda m: m.hinge("pin", "rod", "tip"), 'hinge "pin" is named twice'),
        (lambda m: m.hinge("h", "rod", "tip", axis=ORIGIN), 'hinge "h": its axis has length zero'),
        (lambda m: m.hinge("h", "rod", "tip", "pin"), "its kind 'pin': give revolute"),
        (lambda m: m.hinge("h", "rod", "tip", q=np.inf), 'hinge "h": its q inf'),
        (lambda m: m.hinge("h", "rod", "tip", "screw"), "its pitch is zero; give a pitch, or kind revolute"),
        (lambda m: m.hinge("h", "rod", "tip", pitch=1.0), "pitch applies to screws only"),
        (lambda m: m.hinge("h", "rod", "tip", "fixed", q=1.0), "must be zero as it is fixed"),
        (lambda m: m.spring("s", ("rod", ORIGIN), ("tip", ORIGIN), -1.0), 'spring "s": its stiffness -1.0'),
        (lambda m: m.spring("s", ("rod", ORIGIN), ("tip", ORIGIN)), 'spring "s": it has no effect'),
        (lambda m: m.spring("s", ("rod", ORIGIN), ("rod", DOWN), 1.0), 'both of its ends are on "rod"'),
        (lambda m: m.spring("s", "rod", ("tip", ORIGIN), 1.0), "give its ends as"),
        (lambda m: m.bushing("u", ("rod", ORIGIN), ("tip", ORIGIN), (1, 2, 3)), "give six numbers"),
        (lambda m: m.torsion("t", "pin", damping=-1.0), 'torsion "t": its damping -1.0'),
        (lambda m: m.load("f", "rod"), "it has no effect"),
        (lambda m: m.load("f", "rod", force=lambda: 1), "callable of t, or of t and state"),
        (lambda m: m.force("f", 3.0), "bind"),
        (lambda m: m.on("e", 1.0, lambda s: None), "value must be a function"),
        (lambda m: Ball("b", "x"), "the radius of a ball of \"b\" 'x': give a number"),
        (lambda m: Ball("b", -1.0), 'the radius -1 of a ball of "b" is negative'),
        (lambda m: Ball("b", 0.1, (0, np.nan, 0)), 'the centre of a ball of "b"'),
        (lambda m: Ball(7, 1.0), "a ball's body 7: give the name of a body"),
        (lambda m: m.contact("c", BALL, Plane(), LAW), 'contact "c": balls Ball(.*): give a list of balls'),
        (lambda m: m.contact("c", [BALL], "floor", LAW), "other 'floor': give a list of balls, .*or None"),
        (lambda m: m.contact("c", [BALL], Plane(), "hertz"), "law 'hertz': give a Law, as"),
        (lambda m: m.contact("c", [BALL], Plane(), LAW, 0.3), "friction 0.3: give a Friction"),
        (lambda m: Law("x"), "the stiffness of a contact 'x': give a number"),
        (lambda m: m.close("c", ("rod", DOWN), ("tip", DOWN), ["rigid"]), "its kind .*: give cylindrical"),
        (lambda m: m.close("c", "rod", ("tip", DOWN)), "give its ends as"),
        (lambda m: m.drive("pin", 3.0), "motion 3.0: give a function of time"),
        (lambda m: frequencies("rod"), "model 'rod': give one, as build"),
        (lambda m: m.friction("f", "pin"), 'friction "f": it has no effect; give a torque'),
        (lambda m: m.friction("f", "pin", 1.0, speed=0.0), 'friction "f": its speed is zero'),
        (lambda m: m.friction("f", "pin", -1.0), 'friction "f": its torque -1.0: give none below zero'),
        (lambda m: m.motor("k", {}), 'motor "k": its follow {}: give hinges and their motions'),
        (lambda m: m.motor("k", "pin"), "motor \"k\": its follow 'pin': give hinges"),
        (lambda m: m.motor("k", {"pin": 0.0}, limit=0.0), 'motor "k": its limit 0: give one above 0'),
        (lambda m: m.motor("k", {"pin": 0.0}, -1.0), 'motor "k": its stiffness -1.0'),
        (lambda m: m.stop("s", "pin", 0.0, 1.0), 'stop "s": its stiffness is zero'),
        (lambda m: m.stop("s", "pin", 1.0, 1.0, 9.0), 'stop "s": its limits 1 and 1: give a low'),
        (lambda m: m.stop("s", "pin", stiffness=9.0), 'stop "s": its limits -inf and inf'),
        (lambda m: m.stop("s", "pin", np.nan, 1.0, 9.0), 'stop "s": its limit nan'),
        (lambda m: ContactPoint("p", (0, 1), ORIGIN, ORIGIN), "contact 'p': its normal has no direction"),
        (lambda m: ContactPoint("p", (0, 1), (0, np.nan, 0), DOWN), "contact 'p': its point is not finite"),
        (lambda m: ContactPoint("p", (0, 0), ORIGIN, DOWN), "contact 'p': a body cannot touch itself"),
        (lambda m: ContactPoint("p", (0, 0.5), ORIGIN, DOWN), "contact 'p': bodies (0, 0.5): give two"),
        (lambda m: ContactPoint("p", (0, 1, 2), ORIGIN, DOWN), "bodies (0, 1, 2): give two numbers"),
        (lambda m: ContactPoint("p", (0, 1), ORIGIN, DOWN, -0.1), "its friction -0.1 must be 0 or more"),
        (lambda m: ContactPoint("p", (0, 1), ORIGIN, DOWN, 0.0, 1.1), "its restitution 1.1 is not 0 to 1"),
    ],
)
def test_what_cannot_be_is_refused_where_it_is_given(act, words):
    with pytest.raises(MechanicsError) as refusal:
        act(two())
    assert words in str(refusal.value) or re.search(words, str(refusal.value))
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("act", "words"),
    [
        (lambda m: m.hinge("h", "pod", "tip"), 'its parent "pod" is not a body ("rod", "tip")'),
        (lambda m: m.hinge("h", "rod", "world"), "the world cannot be a child; swap"),
        (lambda m: m.hinge("h", "tip", "rod"), 'body "rod" has two inward hinges, "pin" and "h"'),
        (lambda m: m.hinge("h", "tip", "tip"), 'body "tip" is in a loop of hinges, with hinge "h"'),
        (lambda m: m.spring("s", ("rod", ORIGIN), ("top", ORIGIN), 1.0), '"s": there is no body "top"'),
        (lambda m: m.torsion("t", "pan", 1.0), 'torsion "t": there is no hinge "pan"; there are "pin"'),
        (lambda m: m.load("f", "top", force=DOWN), 'load "f": there is no body "top"'),
        (lambda m: m.load("f", "world", force=DOWN), "the world does not move"),
        (lambda m: m.torque("f", "pan", 1.0), 'torque "f": there is no hinge "pan"'),
        (lambda m: m.drive("pan", lambda t: (0, 0, 0)), 'there is no hinge "pan"'),
        (lambda m: m.drive("pin", lambda t: (0, 0)), 'drive of hinge "pin": at time 0 it gives (0, 0)'),
        (lambda m: m.drive("pin", lambda t: (0, 0, 0)), "its drive begins at q = 0, qd = 0, not at"),
        (lambda m: welded(m).drive("weld", lambda t: (0, 0, 0)), 'drive: hinge "weld" is fixed'),
        (lambda m: welded(m, "ball").drive("weld", lambda t: (0, 0, 0)), 'drive: hinge "weld" is ball'),
        (lambda m: m.drive("lid", lambda t: (0, 0, 0)), 'drive: there is no hinge "lid"'),
        (lambda m: (m.motor("k", {"pin": 0.0}, 1.0), m.drive("pin", lambda t: (0.3, 0, 0))), "is driven"),
        (
            lambda m: welded(m, "screw", pitch=1.0).friction("f", "weld", coefficient=0.1),
            'friction "f": a screw has no pin',
        ),
        (lambda m: m.force("f", Nothing()), 'force "f": its bind() returns an empty Acting'),
        (lambda m: (m.body("b", 1.0, inertia=1.0, spin=DOWN), m.hinge("h", "rod", "b")), "spin applies to"),
        (
            lambda m: m.contact("c", [BALL], Surface("tip", np.eye(2), np.array([[0, 1, 2]])), LAW),
            "vertices must be (n, 3) and faces (m, 3)",
        ),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_refused_by_build(act, words):
    m = two()
    act(m)
    with pytest.raises(MechanicsError) as refusal:
        m.build()
    assert words in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_hinges_in_a_loop_are_refused_by_name():
    with pytest.raises(MechanicsError, match=r'is in a loop of hinges, with hinge "c-a".*close\(\)'):
        chained(("a", "b"), ("b", "c"), ("c", "a")).build()


@pytest.mark.parametrize("inertia", [0.0, (1.0, 1.0, 0.0), (0.0, 1.0, 1.0)])
def test_a_free_point_or_needle_is_refused_unless_others_resist(inertia):
    m = Mechanism()
    m.body("dust", 1e-9, inertia=inertia)
    with pytest.raises(MechanicsError, match='body "dust": it is free and has no inertia about some axis'):
        m.build()
    m.body("tail", 1.0, com=(1, 2, 3), inertia=1.0)
    m.hinge("h", "dust", "tail", "fixed")
    assert m.build().simulate(0.1, 0.01).audit().energy < AUDITED


@pytest.mark.parametrize(
    ("motion", "words"),
    [
        (lambda t: (np.sin(t), 2.0 * np.cos(t), -np.sin(t)), "its coordinate changes by 0.9"),
        (lambda t: (np.sin(t), np.cos(t), np.sin(t)), "its rate changes by -0."),
        (lambda t: (t if t < 0.5 else np.nan, 1.0, 0.0), "it gives"),
    ],
)
def test_a_drive_that_is_no_motion_is_refused(motion, words):
    m = pendulum(q=0.0)
    m.drive("pin", motion)
    with pytest.raises(MechanicsError, match=f'drive of hinge "pin": at time .* {words}'):
        m.build().simulate(1.0, 0.01)


def test_a_drive_whose_first_angles_are_rounding_is_a_motion():
    """The spin-up of Kane, Ryan, Banerjee (1987): from rest, terms of order one cancel to 1e-12 rad."""
    share, w = 0.4, 2.0 * np.pi / 15.0
    m = pendulum(q=0.0)
    m.drive("pin", lambda t: (
        share * (0.5 * t * t + (np.cos(w * t) - 1.0) / w**2), share * (t - np.sin(w * t) / w),
        share * (1.0 - np.cos(w * t)),
    ))  # fmt: skip
    for step in (1e-1, 4e-3, 1e-4):
        m.build().simulate(3.0 * step, step, balance=np.inf)


def test_what_the_tree_refuses_is_said_by_name():
    m = pendulum()
    m.body("needle", 1.0, com=(0, 0, 1.0))
    m.hinge("h", "rod", "needle", axis=(0, 0, 1))
    with expect_refusal(fault=Fault.NO_INERTIA, kind=MechanicsError, match='^body "needle": '):
        m.build()
    m = pendulum()
    m.body("odd", 1.0, inertia=(1, 1, 3))
    with pytest.raises(MechanicsError, match=r'^body "odd": its inertia is impossible for a rigid body'):
        m.build()


@pytest.mark.parametrize("integrator", [Leapfrog(), ImplicitMidpoint()])
def test_what_moves_by_momenta_takes_no_ball_hinge(integrator):
    model = welded(two(), "ball").build()
    model.simulate(0.01, 0.01)
    with pytest.raises(MechanicsError, match="does not support ball hinges; use Runge-Kutta"):
        model.simulate(0.01, 0.01, integrator)


def test_shapes_to_draw_are_a_list_of_shapes():
    run = pendulum().build().simulate(0.1, 0.1)
    for shapes in (BALL, "rod", 3):
        with pytest.raises(MechanicsError, match="give a list of Ball, Rod and Block"):
            drawing(run, [0], shapes)


def test_a_torsion_on_a_fixed_hinge_is_refused():
    m = two()
    m.hinge("weld", "rod", "tip", "fixed")
    m.torsion("t", "weld", 1.0)
    with pytest.raises(MechanicsError, match='torsion "t": hinge "weld" is fixed'):
        m.build()


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"until": 0.0}, "until 0.0: give a finite number above 0"),
        ({"until": np.nan}, "until nan"),
        ({"time_step": -1e-3}, "time_step -0.001: give a finite number above 0"),
        ({"every": 0}, "every 0: give a whole number from 1"),
        ({"balance": -1.0}, "balance -1.0"),
        ({"integrator": "rk4"}, r"integrator 'rk4': give one, as RungeKutta4\(\)"),
        ({"integrator": RungeKutta4}, r"integrator RungeKutta4, a class: give one, as RungeKutta4\(\)"),
        ({"start": 3}, "start 3: give a phase"),
        ({"until": 1e3, "time_step": 1e-6}, r"1e\+09 rows do not fit in memory: give every from 100"),
        ({"until": 1e6, "time_step": 1e-6, "every": 10**6}, r"1e\+12 steps take 100 days at least: give a"),
    ],
)
def test_arguments_of_simulate_are_checked(more, words):
    with pytest.raises(MechanicsError, match=words):
        pendulum().build().simulate(**{"until": 1.0, "time_step": 0.1} | more)


@pytest.mark.parametrize("of", [DormandPrince, Rosenbrock, ImplicitMidpoint])
@pytest.mark.parametrize("tolerance", ["fine", -1.0, 0.0, np.nan])
def test_tolerances_are_checked(of, tolerance):
    with expect_refusal("tolerance"):
        of(tolerance)


def test_forces_that_are_no_numbers_are_refused_by_name():
    m = pendulum()
    m.load("gust", "rod", force=lambda t: (np.nan if t > 0.1 else 0.0, 0, 0))
    with expect_refusal(fault=Fault.NOT_FINITE, kind=MechanicsError, match='"gust"'):
        m.build().simulate(1.0, 0.01)


# --- Extremes


def oscillator(stiffness, mass, damping=0.0, qd=0.0):
    m = Mechanism()
    m.body("a", mass)
    m.hinge("rail", "world", "a", "prismatic", axis=(1, 0, 0), q=0.0 if qd else 0.1, qd=qd)
    m.torsion("s", "rail", stiffness, damping=damping)
    return m.build()


@pytest.mark.parametrize("mass", [1.0, 1e-9])
@pytest.mark.parametrize("stiffness", [1e8, 1e12])
@pytest.mark.parametrize("integrator", [RungeKutta4(), Leapfrog()])
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_steps_that_resolve_no_vibration_are_refused(stiffness, mass, integrator):
    with expect_refusal(fault=Fault.STEP, kind=StepTooLargeError, match=r"0\.001"):
        oscillator(stiffness, mass).simulate(0.05, 1e-3, integrator)


def test_rosenbrock_refuses_vibrations_that_take_too_many_substeps(monkeypatch):
    monkeypatch.setattr("protochain.mechanisms.rosenbrock._MOST", 300)
    with expect_refusal(fault=Fault.STEP, kind=StepTooLargeError, match="300 substeps"):
        oscillator(1e12, 1e-9).simulate(0.05, 1e-3, Rosenbrock())


@pytest.mark.parametrize("damping", [1e3, 1e8, 1e12])
def test_a_damper_of_any_stiffness_is_right_by_rosenbrock(damping):
    """Much stiffer than the step, the body follows the force."""
    m = Mechanism()
    m.body("a", 1.0)
    m.hinge("rail", "world", "a", "prismatic", axis=(1, 0, 0), qd=1.0)
    m.torsion("d", "rail", damping=damping)
    m.load("push", "a", force=(1.0, 0, 0))
    run = m.build().simulate(0.1, 1e-3, Rosenbrock())
    assert run.qd[-1, 0] * damping == pytest.approx(1.0, rel=1e-6)
    assert run.q[-1, 0] == pytest.approx((1.0 + 0.1) / damping, rel=0.01, abs=1e-15)
    if damping > 3e3:
        with expect_refusal(fault=Fault.STEP, kind=StepTooLargeError):
            m.build().simulate(0.1, 1e-3)


def test_substeps_without_end_are_refused(monkeypatch):
    """A stiff damper keeps explicit substeps short, however little moves; the true number takes seconds."""
    monkeypatch.setattr("protochain.mechanics.motion.substeps._MOST", 1000)
    model = oscillator(0.0, 1.0, damping=1e8, qd=1.0)
    with expect_refusal(fault=Fault.STEP, kind=StepTooLargeError, match=r"1000 substeps .* 0\.000\d"):
        model.simulate(0.1, 0.1, DormandPrince())
    assert model.simulate(0.1, 0.1, Rosenbrock()).qd[-1, 0] == pytest.approx(0.0, abs=1e-6)


def test_balance_says_what_is_no_error():
    model = oscillator(1.0, 1.0)
    with pytest.raises(StepTooLargeError):
        model.simulate(12.0, 1.0)
    assert 0.1 < model.simulate(12.0, 1.0, balance=np.inf).audit().energy < 0.2


def test_rosenbrock_may_lose_a_thousandth_of_the_energy_that_flows():
    m = Mechanism(gravity=(0, 0, -G))
    m.body("a", 2.0, com=(0.3, 0, 0))
    m.hinge("drop", "world", "a", "prismatic", axis=(0, 0, 1), q=1.0, qd=3.0)
    m.load("push", "a", force=(0, 0, 1.0))
    system = m.build().system
    at = system.at(np.array([1.0]), np.array([3.0]), work=np.ones(1))
    after = system.at(np.array([0.5]), np.array([4.0]), work=np.zeros(1))
    work = after.total - at.total
    allowed = 1e-3 * (16.0 + 0.5 * 2.0 * G + abs(work))
    for part in (0.99, 1.02, -0.99, -1.02):
        with pytest.raises(StepTooLargeError) if abs(part) > 1.0 else nullcontext():
            _check_balance(system, at, replace(after, work=at.work + work + part * allowed), np.zeros(1))


@pytest.mark.parametrize("part", [0.95, 1e4])
def test_rosenbrock_damps_at_once_what_creeps(part):
    """By its rational function, if what it loses has less energy than the tolerance, moved in a step."""
    h, damping, tolerance = 0.1, 1e4, 0.01
    z = -damping * h
    first, end = 1.0 + z / (1.0 - GAMMA * z), (1.0 + (1.0 - 2.0 * GAMMA) * z) / (1.0 - GAMMA * z) ** 2
    work = 0.5 * z * (1.0 + first**2)
    lack = 0.5 * (end**2 - 1.0) - work - 1e-3 * (0.5 - work)
    qd = part * tolerance / h / np.sqrt(2.0 * lack)
    run = oscillator(0.0, 1.0, damping, qd).simulate(h, h, Rosenbrock(tolerance), balance=np.inf)
    assert (run.qd[-1, 0] == pytest.approx(end * qd, rel=1e-6)) == (part < 1.0)


def test_rosenbrock_chooses_substeps_by_an_error_of_order_two():
    """Of free fall the method of order one within errs by (1/2 - gamma) g h^2 in any substep."""
    m = Mechanism(gravity=(0, 0, -G))
    m.body("a", 1.0)
    m.hinge("drop", "world", "a", "prismatic", axis=(0, 0, 1))
    with mock.patch("protochain.mechanisms.rosenbrock._advance", wraps=_advance) as advance:
        m.build().simulate(1.0, 1.0, Rosenbrock(1e-3))
    steps = [call.args[2] for call in advance.call_args_list]
    expected = 0.9 * np.sqrt(1e-3 / (G * (0.5 - GAMMA)))
    assert len(steps) > 50 and steps[5:-1] == pytest.approx([expected] * (len(steps) - 6))


# --- Events, and going on


def test_events_happen_and_their_energy_is_counted():
    """A ball that bounces with restitution 0.8; the row of an event is that after its jump."""
    m = Mechanism(gravity=DOWN)
    m.body("ball", 2.0)
    m.hinge("drop", "world", "ball", "prismatic", axis=(0, 0, 1), q=1.0)
    m.on("floor", lambda s: s.angle("drop"), lambda s: -0.8 * s.qd)
    marks = []
    m.on("half", lambda s: s.point("ball")[2] - 0.5, lambda s: marks.append(s.t), passes=True)
    run = m.build().simulate(1.4, 0.01)
    first = np.sqrt(2.0 / G)
    assert [event.name for event in run.events] == ["half", "floor", "half", "floor"]
    times = [np.sqrt(1.0 / G), first, first * 1.8 + np.sqrt(2.0 * (0.64 - 0.5) / G), first * 2.6]
    assert np.allclose([event.time for event in run.events], times, atol=1e-9)
    assert np.allclose(marks, [times[0], times[2]], atol=1e-9)
    lost = 2.0 * G * np.array([0.0, -0.36, 0.0, -0.36 * 0.64])
    assert np.allclose([event.energy for event in run.events], lost, atol=1e-9)
    assert run.table["events"].iloc[-1] == pytest.approx(np.sum(lost))
    assert run.audit().energy < AUDITED
    assert np.any(np.isclose(run.time, first, atol=1e-12))
    assert np.all(np.diff(run.time) > 0.0)


@pytest.mark.parametrize("passes", [True, False])
def test_momentum_is_audited_past_marks_but_not_after_strikes(passes):
    m = Mechanism()
    m.body("ball", 1.0, inertia=1.0, velocity=(-1.0, 0, 0), position=(0.25, 0, 0))
    m.on("wall", lambda s: s.point("ball")[0], lambda s: None if passes else -s.qd, passes=passes)
    run = m.build().simulate(0.5, 0.1)
    assert [event.name for event in run.events] == ["wall"]
    assert (run.audit().momentum is not None) == passes
    assert run.momenta[-1, 0, 0] == pytest.approx(-1.0 if passes else 1.0)


def test_a_jump_that_is_none_or_no_velocities():
    m = pendulum(q=0.5)
    m.on("down", lambda s: s.angle("pin"), lambda s: (1.0, 2.0))
    with pytest.raises(MechanicsError, match='event "down": its jump must give 1 finite velocities'):
        m.build().simulate(2.0, 0.05)
    m = pendulum(q=0.5)
    m.on("down", lambda s: float("nan"), lambda s: None)
    with pytest.raises(MechanicsError, match='event "down": its value is not a number at time'):
        m.build().simulate(2.0, 0.05)


def test_a_run_goes_on_where_it_ended():
    m = pendulum()
    m.load("push", "rod", (0, 0, -1), lambda t: (np.sin(5.0 * t), 0, 0))
    m.torsion("t", "pin", damping=0.1)
    model = m.build()
    whole = model.simulate(1.0, 1 / 128)
    half = model.simulate(0.5, 1 / 128)
    rest = model.simulate(1.0, 1 / 128, start=half.end)
    assert np.array_equal(rest.q[-1], whole.q[-1])
    assert np.array_equal(rest.work[-1], whole.work[-1])
    assert rest.audit().energy < AUDITED


def test_every_with_events_keeps_their_rows_too():
    m = pendulum(q=0.0, qd=1.0)
    m.on("mark", lambda s: 0.15 - s.angle("pin"), lambda s: None, passes=True)
    run = m.build().simulate(0.5, 1 / 32, every=6)
    assert len(run.events) == 1
    happened = run.events[0].time
    assert 4 / 32 < happened < 6 / 32
    assert np.allclose(run.time[:2], [0.0, happened])
    # The step with the event is cut in two, so that steps no longer end at multiples of their length.
    assert run.time[2] == pytest.approx(happened + (6 - int(32 * happened)) / 32, abs=1e-12)
    assert np.allclose(np.diff(run.time[2:-1]), 6 / 32)
    assert run.time[-1] == pytest.approx(0.5, abs=1e-12)


# --- What costs nothing unused


@pytest.mark.parametrize("load", ["torsion", "load", "torque", "force"])
def test_only_the_leapfrog_refuses_what_depends_on_velocity(load):
    m = pendulum()
    if load == "torsion":
        m.torsion("t", "pin", damping=1.0)
    if load == "load":
        m.load("t", "rod", force=lambda t, s: -s.velocity("rod"))
    if load == "torque":
        m.torque("t", "pin", lambda t, s: -s.rate("pin"))
    if load == "force":
        m.force("t", Load(lambda t, q, qd, frames: Applied(torques=-qd)))
    with pytest.raises(MechanicsError, match="velocities"):
        m.build().simulate(0.1, 0.01, Leapfrog())
    m = pendulum()
    m.torque("t", "pin", lambda t: np.sin(t))
    assert m.build().simulate(0.1, 0.01, Leapfrog()).audit().energy < 1e-3


def test_defaults_of_functions_are_theirs():
    """The usual way to keep the variable of a loop: only what has no default is given."""
    m = Mechanism()
    m.body("a", 1.0, inertia=1.0)
    for name, on in (("first", False), ("second", True)):
        m.load(name, "a", force=lambda t, on=on: (float(on), 0, 0))
    m.load("third", "a", force=lambda t, s, by=2.0: (0, by, 0))
    assert m.build().simulate(1.0, 0.1).qd[-1, 3:] == pytest.approx([1.0, 2.0, 0.0])
    with pytest.raises(MechanicsError, match="callable of t, or of t and state"):
        m.load("fourth", "a", force=lambda t, *, s: (0, 0, 0))


@pytest.mark.parametrize(
    ("part", "words"),
    [
        (lambda m: m.load("f", "rod", force=lambda t: (1 / 0, 0, 0)), 'load "f": its force fails'),
        (lambda m: m.load("f", "rod", moment=lambda t, s: s.angel), 'load "f": its moment fails: Attribute'),
        (lambda m: m.torque("f", "pin", lambda t: {}[t]), 'torque "f": its value fails: KeyError'),
        (lambda m: m.on("f", lambda s: s.angle("pin"), lambda s: 1 / 0), 'event "f": its jump fails'),
        (lambda m: m.on("f", lambda s: [][1], lambda s: None), 'event "f": its value fails: IndexError'),
        (lambda m: m.drive("pin", lambda t: 1 / 0), 'drive of hinge "pin": its motion fails'),
    ],
)
def test_what_fails_in_a_function_names_its_element(part, words):
    m = pendulum()
    with pytest.raises(MechanicsError, match=words):
        part(m)
        m.build().simulate(3.0, 0.1)


def test_a_misspelt_argument_names_element_and_near_name():
    m = pendulum()
    with pytest.raises(MechanicsError, match='spring "s": there is no argument stifness; give stiffness'):
        m.spring("s", ("rod", ORIGIN), ("world", ORIGIN), stifness=1.0)
    with pytest.raises(MechanicsError, match='body "b": there is no argument xyz; give name, mass'):
        m.body(name="b", xyz=1.0)


def test_angles_of_more_than_a_turn_are_asked_about(caplog):
    pendulum(q=3.0).build()
    assert not caplog.records
    pendulum(q=45.0).build()
    assert 'hinge "pin": its q 45 is more than a turn: angles are radians' in caplog.text


@pytest.mark.parametrize("key", ["position", "rotation", "velocity", "spin"])
def test_a_start_of_a_body_that_a_hinge_moves_is_refused_by_name(key):
    m = Mechanism(gravity=DOWN)
    m.body("rod", 1.0, inertia=1.0, **{key: np.eye(3) if key == "rotation" else (0.0, 0.0, 1.0)})
    m.hinge("pin", "world", "rod", axis=(0, 1, 0))
    with pytest.raises(MechanicsError, match=f'body "rod": {key} applies to free bodies only'):
        m.build()
