"""Closed loops: a four-bar, a slider-crank, a platform of six legs, parallelograms.

Loops are closed by joints (``Mechanism.close``), and beside them by stiff bushings.
"""

from collections.abc import Iterator
from functools import partial

import numpy as np
import pandas as pd
from scipy.integrate import solve_ivp
from scipy.special import ellipk

from bench.cases import Found, Point, Scene, check, judged, left_out, tried, vanishes
from bench.cost import least_seconds
from bench.fits import exponent
from protochain.core.arrays import Floats
from protochain.core.errors import Fault
from protochain.mechanics.motion import DormandPrince, ImplicitMidpoint, Integrator
from protochain.mechanisms import Mechanism, Model, Rosenbrock, Run, frequencies
from protochain.mechanisms.loop_joints import LoopJoints, factor_loops

G = 9.81
PRECISE = DormandPrince(1e-10)
UNTIL = 1.0
STIFFNESS = 1e8
"""N/m, of the bushing that closes the four-bar."""
PINS = {"A": (0.0, 0.0, 0.0), "B": (0.0, 0.0, 1.0), "C": (2.0, 0.0, 1.5), "D": (2.0, 0.0, 0.0)}
"""m. Of the four-bar at the start; its bars have a kilogram per metre."""
ENDS = ("coupler", (2.0, 0.0, 0.5)), ("rocker", (0.0, 0.0, 1.5))
"""Where coupler and rocker meet, on each."""
Y = (0, 1, 0)


Place = Floats | tuple[float, float, float]


def bar(m: Mechanism, name: str, start: Place, end: Place, mass: float | None = None) -> None:
    """Add a rod, of a kilogram per metre by default, with its origin at its start and the world's axes."""
    along = np.subtract(end, start)
    length = float(np.linalg.norm(along))
    mass = length if mass is None else mass
    m.body(name, mass, com=0.5 * along, inertia=mass * length**2 / 12.0)


def four_bar(close: bool = True, damping: float = 0.0, speed: float = 3.0, rocker: float = 1.5) -> Mechanism:
    """Crank, coupler and rocker in the plane of x and z; the crank starts upright, at 3 rad/s."""
    m = Mechanism(gravity=(0, 0, -G))
    a, b, c, d = (np.array(PINS[name]) for name in "ABCD")
    for name, start, end, mass in (("crank", a, b, 1.0), ("coupler", b, c, None), ("rocker", d, c, rocker)):
        bar(m, name, start, end, mass)
    # Upright, the coupler does not turn.
    rates = (speed, 0.0, 0.0) if close else (speed, -speed, speed / 1.5)
    m.hinge("A", "world", "crank", axis=Y, qd=rates[0])
    m.hinge("B", "crank", "coupler", axis=Y, at=b - a, qd=rates[1])
    m.hinge("D", "world", "rocker", axis=Y, at=d, qd=rates[2])
    if close:
        m.close("C", *ENDS, "revolute", axis=Y)
    else:
        m.bushing("C", *ENDS, (0, 0, 0, *3 * [STIFFNESS]), (0, 0, 0, *3 * [damping]))
    return m


def by_lagrange(until: float, speed: float = 3.0) -> float:
    """Angle of the four-bar's crank from its start, by the Lagrangian of that angle alone.

    Directions of coupler and rocker are those of two circles, their derivatives two linear equations.
    """
    lengths = np.array([1.0, np.hypot(2.0, 0.5), 1.5])

    def rates(t: float, y: Floats) -> tuple[float, float]:
        tip = np.array([np.cos(y[0]), np.sin(y[0])])
        to = np.array([2.0, 0.0]) - tip
        far = np.hypot(*to)
        inner = np.arccos((lengths[1] ** 2 + far**2 - lengths[2] ** 2) / (2.0 * lengths[1] * far))
        coupler = np.arctan2(to[1], to[0]) + inner
        end = tip + lengths[1] * np.array([np.cos(coupler), np.sin(coupler)])
        at = np.array([y[0], coupler, np.arctan2(end[1], end[0] - 2.0)])
        across, inward = lengths * [-np.sin(at), np.cos(at)], -lengths * [np.cos(at), np.sin(at)]
        loop = np.column_stack([across[:, 1], -across[:, 2]])
        one = np.array([1.0, *np.linalg.solve(loop, -across[:, 0])])
        two = np.array([0.0, *np.linalg.solve(loop, -inward @ (np.array([1.0, 1.0, -1.0]) * one**2))])
        speeds, curves = across * one, across * two + inward * one**2
        # Centres of the bars: the coupler begins where the crank ends.
        v, c = 0.5 * speeds, 0.5 * curves
        v[:, 1], c[:, 1] = v[:, 1] + speeds[:, 0], c[:, 1] + curves[:, 0]
        moments = lengths**3 / 12.0
        inertia = np.sum(lengths * v * v) + np.sum(moments * one**2)
        slope = np.sum(lengths * v * c) + np.sum(moments * one * two)
        return y[1], -(slope * y[1] ** 2 + G * np.sum(lengths * v[1])) / inertia

    start = [0.5 * np.pi, -speed]
    found = solve_ivp(rates, (0.0, until), start, "DOP853", rtol=1e-12, atol=1e-12)
    return float(0.5 * np.pi - found.y[0, -1])


def slider_crank(speed: float = 4.0) -> Model:
    """A crank of 0.5 m, driven at a constant rate, moves a piston by a rod of 2 m."""
    m = Mechanism(gravity=(0, 0, -G))
    bar(m, "crank", (0.0, 0, 0), (0.5, 0, 0))
    bar(m, "rod", (0.0, 0, 0), (2.0, 0, 0))
    m.body("piston", 3.0, inertia=1.0)
    m.hinge("A", "world", "crank", axis=(0, -1, 0))
    m.hinge("B", "crank", "rod", axis=(0, -1, 0), at=(0.5, 0, 0))
    m.hinge("slide", "world", "piston", "prismatic", axis=(1, 0, 0), at=(2.5, 0, 0))
    m.close("pin", ("rod", (2.0, 0, 0)), ("piston", (0, 0, 0)), axis=Y)
    m.drive("A", lambda t: (speed * t, speed, 0.0))
    return m.build()


def platform() -> Model:
    """A plate on six legs (Gough, Stewart): universal joint, slide on a spring, ball."""
    m = Mechanism(gravity=(0, 0, -G))
    m.body("plate", 10.0, inertia=(0.4, 0.4, 0.8), position=(0, 0, 1.0))
    for k in range(6):
        low, high = (np.pi / 3.0 * (k // 2 * 2 + s * (k % 2 * 2 - 1)) for s in (0.25, 0.75))
        foot = np.array([np.cos(low), np.sin(low), 0.0])
        top = np.array([0.5 * np.cos(high), 0.5 * np.sin(high), 0.0])
        along = top - foot + np.array([0.0, 0.0, 1.0])
        side = np.cross(along, (0.0, 0.0, 1.0))
        m.body(f"cross {k}", 0.0)
        m.hinge(f"a{k}", "world", f"cross {k}", at=foot, axis=side)
        m.body(f"tube {k}", 1.0, com=0.3 * along, inertia=0.05)
        m.hinge(f"b{k}", f"cross {k}", f"tube {k}", axis=np.cross(side, along))
        m.body(f"rod {k}", 0.5, com=-0.2 * along, inertia=0.02)
        m.hinge(f"s{k}", f"tube {k}", f"rod {k}", "prismatic", at=along, axis=along)
        m.torsion(f"spring {k}", f"s{k}", stiffness=2000.0 + 100.0 * k)
        m.close(f"ball {k}", (f"rod {k}", (0, 0, 0)), ("plate", top), "spherical")
    return m.build()


def row(n: int, angle: float = 0.3, speed: float = 0.0) -> Model:
    """Bars of 1 m that hang in a row, their ends joined by n couplers of 1 m: n loops, one freedom."""
    m = Mechanism(gravity=(0, 0, -G))
    for k in range(n + 1):
        bar(m, f"bar {k}", (0.0, 0, 0), (0.0, 0, -1.0))
        m.hinge(f"pin {k}", "world", f"bar {k}", axis=Y, at=(float(k), 0, 0), q=angle, qd=speed)
    for k in range(n):
        bar(m, f"coupler {k}", (0.0, 0, 0), (1.0, 0, 0))
        m.hinge(f"joint {k}", f"bar {k}", f"coupler {k}", axis=Y, at=(0, 0, -1.0), q=-angle)
        m.close(f"end {k}", (f"coupler {k}", (1.0, 0, 0)), (f"bar {k + 1}", (0, 0, -1.0)), axis=Y)
    return m.build()


def period(n: int, angle: float = 0.3) -> float:
    """Period of :func:`row`, as of a pendulum: (n + 1) / 3 + n is its inertia, (n + 1) / 2 + n its moment."""
    omega = np.sqrt(G * ((n + 1) / 2.0 + n) / ((n + 1) / 3.0 + n))
    return float(4.0 / omega * ellipk(np.sin(0.5 * angle) ** 2))


def run(quick: bool = False) -> Scene:
    """Run the scene; quick: short rows only."""
    sizes = (1, 3, 10) if quick else (1, 3, 10, 30, 100)
    costs = _costs(sizes)
    return Scene(
        "loops", "closed loops: joints beside stiff bushings", tuple(_checks(quick)),
        tuple(_work(quick)), tuple(_extremes()), tuple(_left_out()), {"costs": costs},
        "error of angles after a second, rad",
    )  # fmt: skip


def _checks(quick: bool) -> Iterator[Found]:
    moved = four_bar().build().simulate(UNTIL, UNTIL, PRECISE)
    oracle, source = by_lagrange(UNTIL), "its Lagrangian, one angle, DOP853"
    yield check("crank of the four-bar after a second, rad", moved.q[-1, 0], oracle, 1e-8, source)
    yield from _kept("four-bar", moved, 1e-8)
    moved = slider_crank().simulate(2.0, 0.01, DormandPrince(1e-9))
    where, angle = moved.q[:, moved.model.bodies.freedom("slide")[0]], 4.0 * moved.time
    exact = 0.5 * np.cos(angle) + np.sqrt(4.0 - 0.25 * np.sin(angle) ** 2) - 2.5
    yield vanishes(
        "piston of the slider-crank, m", float(np.max(np.abs(where - exact))), 1e-10, "closed form"
    )
    yield from _kept("slider-crank", moved, 1e-7)
    six = platform()
    yield check("freedoms of the platform", six.directions.shape[1], 6, 0.0, "Kutzbach", "absolute")
    yield check("frequencies of the platform", len(frequencies(six)), 6, 0.0, "its springs", "absolute")
    yield from _kept("platform", six.simulate(0.3, 0.02, PRECISE), 1e-7)
    n = 3 if quick else 10
    time = period(n)
    moved = row(n).simulate(time, 0.1 * time, PRECISE)
    yield check(f"row of {n} loops after its period, rad", moved.q[-1, 0], 0.3, 1e-8, "elliptic integral")
    yield from _kept(f"row of {n} loops", moved, 1e-8)


def _kept(name: str, moved: Run, bound: float) -> Iterator[Found]:
    """Energy and loops of a run."""
    audit = moved.audit()
    yield vanishes(f"{name}: energy that is no work", audit.energy, bound, "audit")
    yield vanishes(f"{name}: gap of the loops, of the size", audit.gap or 0.0, 1e-11, "audit")
    yield vanishes(f"{name}: rate of the gap, of the fastest", audit.parting or 0.0, 1e-11, "audit")


def _work(quick: bool) -> Iterator[Point]:
    """Of the four-bar, the largest error of an angle after a second."""
    closed, sprung = four_bar().build(), four_bar(close=False).build()
    exact = closed.simulate(UNTIL, UNTIL, DormandPrince(1e-12)).q[-1]
    closed.simulate(0.01, 0.01)

    def error(moved: Run) -> float:
        return float(np.max(np.abs(moved.q[-1] - exact)))

    for tolerance in (1e-4, 1e-6, 1e-8) if quick else (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9):
        call = partial(closed.simulate, UNTIL, UNTIL, DormandPrince(tolerance))
        yield tried("joint, Dormand-Prince", f"{tolerance:g}", call, error, 3)
    for step in (1e-2,) if quick else (2e-2, 1e-2, 5e-3, 2e-3, 1e-3):
        yield tried("joint, Runge-Kutta 4", f"{step:g} s", partial(closed.simulate, UNTIL, step), error, 2)
    for step in (2e-3,) if quick else (4e-3, 2e-3, 1e-3, 5e-4):
        call = partial(sprung.simulate, UNTIL, step, ImplicitMidpoint())
        yield tried(f"bushing of {STIFFNESS:g} N/m, midpoint", f"{step:g} s", call, error)
    if not quick:
        call = partial(sprung.simulate, UNTIL, 2e-3, DormandPrince(1e-7))
        yield tried(f"bushing of {STIFFNESS:g} N/m, Dormand-Prince", "1e-07", call, error)


def _costs(sizes: tuple[int, ...]) -> pd.DataFrame:
    """Seconds of one evaluation of accelerations by the number of loops; exponents from the last but one."""
    rows = []
    for n in sizes:
        model = row(n)
        at = model.start()
        args = (0.0, at.q, at.qd, at.torque, at.loads, at.factors)
        whole = least_seconds(partial(model.system.accelerations, *args))
        free = least_seconds(partial(model.system.forward_dynamics, at.q, at.qd, at.torque))
        rows.append({"loops": n, "bodies": model.tree.n_bodies, "seconds": whole, "seconds_open": free})
    found = pd.DataFrame(rows)
    long = found.tail(3)
    return found.assign(exponent=exponent(long["loops"], long["seconds"]))


def _extremes() -> Iterator[Found]:
    twice = four_bar()
    twice.close("C again", *ENDS, "revolute", axis=Y)
    yield judged("a joint twice", lambda: _as_once(twice))
    for mass in (1.5e-6, 1.5e6):
        yield judged(f"a rocker of {mass:g} kg", partial(_energy, four_bar(rocker=mass).build()))
    yield judged("a rhombus that turns over, past poses where all bars are in line", _turned_over)
    far = four_bar()
    far.close("far", ("crank", (0, 0, 1.0)), ("world", (9.0, 0, 0)), "spherical")
    yield judged("a loop out of reach", lambda: _energy(far.build()), Fault.OPEN)
    for damping in (0.0, 20.0):
        model = four_bar(close=False, damping=damping).build()
        name = f"a bushing of {STIFFNESS:g} N/m, damper {damping:g} N s/m, Rosenbrock, 2 ms"
        yield judged(name, partial(_energy, model, Rosenbrock(), 2e-3, 1e-4))


def _as_once(twice: Mechanism) -> Found:
    once, more = (m.build().simulate(UNTIL, UNTIL, PRECISE).q[-1] for m in (four_bar(), twice))
    return vanishes("", float(np.max(np.abs(more - once))), 1e-9, "the joint once")


def _energy(
    model: Model, integrator: Integrator = PRECISE, step: float = UNTIL, bound: float = 1e-7
) -> Found:
    return vanishes("", model.simulate(UNTIL, step, integrator).audit().energy, bound, "audit")


def _turned_over() -> Found:
    """Past a pose with all bars in line a rhombus has three ways on, by rounding: loop and energy stay."""
    moved = row(1, 0.0, 8.0).simulate(UNTIL, 0.01, PRECISE)
    audit = moved.audit()
    assert np.ptp(moved.q[:, 0]) > np.pi and audit.gap is not None and audit.gap < 1e-11
    return vanishes("", audit.energy, 1e-7, "audit")


def _left_out() -> Iterator[Found]:
    model = four_bar().build()
    joints = model.bodies.joints
    assert joints is not None
    few = LoopJoints(joints.body[[0, 1]], joints.turns[[0, 1]], joints.point[[0, 1]], joints.along[[0, 1]])
    factors = model.start().factors

    def change(of: LoopJoints) -> Floats:
        loops = factor_loops(factors, of)
        return loops.change(loops.rates(np.ones(3)))

    what = "three equations of a joint in the plane that depend on the others"
    yield left_out(what, partial(change, joints), partial(change, few), 1e-9, 20)
