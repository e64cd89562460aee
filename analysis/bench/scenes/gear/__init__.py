"""Two spur gears whose teeth are bodies on springs, and whose flanks press on each other.

After Liu, Appl. Mech. Mater. 44-47:1273 (2010), whose text and data were not found: wheels of 20 and 40
teeth, module 4 mm, are taken. What is known of it from others, and where it is:

=======================================  ================================================================
teeth as bodies on springs               ``mesh``: each turns about its wheel's axis on spring and damper
teeth fixed to their wheels              the same without springs: rigid wheels, which give at the flanks
contact of flanks                        ``geometry``: involutes and tip corners; Lankarani and Nikravesh
stiffness of teeth                       by ISO 6336, by finite elements (``ELEMENTS``), and along the flank
                                         by Weber and Banaschek (``teeth``)
=======================================  ================================================================

Beyond it: shifted teeth; friction of flanks; a second pair, of numbers chosen (``SECOND``), as its own are
not known; back flanks with play, on which gears rattle (``rattle``). Under torque back flanks do not meet,
and are left out. Wheels that tilt are left out altogether.
"""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd

from bench.cases import Found, Point, Scene, check, judged, left_out, vanishes
from bench.cost import timed
from bench.fits import exponent
from bench.scenes.gear import rattle
from bench.scenes.gear.geometry import GearPair
from bench.scenes.gear.mesh import Gear, gears, meshing_of
from bench.scenes.gear.oracle import reference
from bench.scenes.gear.quasi import at_rest, frequency, lag_of, near, stiff_flanks
from bench.scenes.gear.teeth import flattening, mesh_stiffness, pair_stiffness
from protochain.core.arrays import Floats
from protochain.core.errors import Fault
from protochain.mechanics.motion import DormandPrince, Integrator, RungeKutta4
from protochain.mechanisms import Model, Rosenbrock, Run
from protochain.mechanisms.contact import Law, lankarani_nikravesh

__all__ = ["Gear", "GearPair", "run"]

ONE, TWO = 0.0, 4e-3
"""Places of the driving wheel, m, at which one pair of teeth touches, and two do."""
START = 1e-3
"""Place at which motions begin: half a millimetre on, a second pair comes in."""
ELEMENTS = 23.3e9
"""N/m^2. c' of a pair of these teeth by finite elements (``tests/scenes/test_gear_teeth.py``).

Without what their flanks give about the contact; together 16.1e9 N/m^2 at 300 N/mm, where ISO 6336 has
16.3e9 for such teeth, and takes 14e9 for most.
"""
ALONG = "teeth of Weber and Banaschek"
LOAD = 3e5
"""N/m: force by width for which ISO 6336 states its stiffness."""
SECOND = GearPair((31, 47), 3e-3, float(np.radians(25.0)))
FRICTION = 0.05
STEP = 1e-6
"""s: two thirds of a radian of the fastest vibration, of teeth on their flanks."""
PUBLISHED = "by hand, of the tip circles"


def run(quick: bool = False) -> Scene:
    """Run the scene; quick: one base pitch instead of four."""
    gear = Gear()
    pitches = 1 if quick else 4
    traces = {
        "teeth on springs": _trace(gear, pitches),
        "teeth of finite elements": _trace(replace(gear, stiffness=ELEMENTS), pitches),
        ALONG: _trace(replace(gear, along=True), pitches),
        "rigid wheels": _trace(gear, pitches, rigid=True),
    }
    places = 24 if quick else 96
    sweep, along = _sweep(gear, places), _sweep(replace(gear, along=True), places)
    stiffness = _stiffness(gear)
    tables = {
        "trace": pd.concat([table.assign(model=name) for name, table in traces.items()]),
        "rest": sweep,
        "rest_along": along,
        "flank": _flank(gear.pair),
        "stiffness": stiffness,
        "light": _light(gear, quick),
        "rattle": rattle.rattling(quick),
        "rattle_teeth": rattle.rattling_teeth(quick),
        "models": pd.DataFrame([{"model": name, **_summary(t, gear)} for name, t in traces.items()]),
    }
    work, found = _work(gear, 3e-4 if quick else 1e-3, quick)
    rest = {"teeth on springs": sweep, ALONG: along}
    checks = (*_checks(gear), *_moving(gear, traces, rest, pitches), *_ratios(stiffness), *found)
    checks += (*_teeth(gear.pair),)
    checks += (*rattle.checks(quick), *_rubbing())
    left = _left_out(gear, 2e-4 if quick else 1e-3)
    return Scene(
        "gear", "spur gears: teeth on springs, flanks that press on each other", checks, work,
        tuple(_extremes(gear)), tuple(left), tables, "error of angles, of the quasi-static error",
    )  # fmt: skip


def started(gear: Gear, until: float, everything: bool = False, rigid: bool = False) -> Model:
    """Model that begins at rest under its torque, but turning, and may turn for some time."""
    one, other = gear.pair.wheels
    if rigid:
        give = (gear.torque / one.base / gear.flank.stiffness) ** (1.0 / gear.flank.exponent)
        return gears(
            gear, rigid=True, start={"wheel 0": START / one.base, "wheel 1": (START - give) / other.base}
        )
    live = None if everything else passing(gear, until)
    rest, q = at_rest(gear, START)
    return gears(
        gear, live, start={name: float(q[rest.bodies.freedom(name)[0]]) for name in rest.bodies.hinges}
    )


def passing(gear: Gear, until: float) -> tuple[range, range]:
    """Teeth of both wheels that come near the mesh from the start to a time."""
    return near(gear, START, START + 1.01 * gear.speed * gear.pair.wheels[0].base * until)


def lags(moved: Run, gear: Gear) -> Floats:
    """(n,) float: transmission error of the driving wheel, rad."""
    return np.array([lag_of(moved.model, q, gear) for q in moved.q])


def _time(gear: Gear, pitches: float) -> float:
    return pitches * gear.pair.base_pitch / gear.pair.wheels[0].base / gear.speed


def _trace(gear: Gear, pitches: int, rigid: bool = False) -> pd.DataFrame:
    """Transmission error and forces while so many pairs of teeth pass."""
    until = _time(gear, pitches)
    model = started(gear, until, rigid=rigid)
    moved = model.simulate(until, STEP, every=10)
    pressing = [meshing_of(model).pressing(q, qd) for q, qd in zip(moved.q, moved.qd, strict=True)]
    one, other = (model.bodies.freedom(f"wheel {k}")[0] for k in (0, 1))
    force = gear.torque / gear.pair.wheels[0].base
    return pd.DataFrame({
        "time": moved.time, "pitches": moved.q[:, one] * gear.pair.wheels[0].base / gear.pair.base_pitch,
        "lag": lags(moved, gear), "pairs": [int(np.sum(pairs[:, 2] > 0.0)) for pairs in pressing],
        "force": [pairs[:, 2].max(initial=0.0) / force for pairs in pressing], "driving": moved.qd[:, one],
        "driven": moved.qd[:, other], "audit": moved.audit().energy,
    })  # fmt: skip


def _sweep(gear: Gear, n: int) -> pd.DataFrame:
    """Gears at rest over a base pitch."""
    rows = []
    for pitches in np.arange(n) / n:
        place = pitches * gear.pair.base_pitch
        model, q = at_rest(gear, place)
        pairs = meshing_of(model).pressing(q, np.zeros_like(q))
        rows.append((pitches, lag_of(model, q, gear), int(np.sum(pairs[:, 2] > 0.0))))
    return pd.DataFrame(rows, columns=["pitches", "lag", "pairs"])


def _summary(trace: pd.DataFrame, gear: Gear) -> dict[str, float]:
    late = trace[trace["pitches"] >= trace["pitches"].max() - 1.0]
    return {
        "lag_mean": late["lag"].mean(), "lag_swing": float(np.ptp(late["lag"])),
        "force_max": late["force"].max(), "pairs_mean": late["pairs"].mean(),
        "ratio": late["driving"].mean() / late["driven"].mean(), "audit": float(trace["audit"].iloc[0]),
    }  # fmt: skip


def _checks(gear: Gear) -> Iterator[Found]:
    """Gears at rest and their vibrations."""
    yield check("contact ratio", gear.pair.contact_ratio, 1.635, 5e-4, PUBLISHED)
    light = replace(gear, torque=1e-6 * gear.torque)
    yield check("pairs that touch at a millionth of the torque", _touching(light), 1.635, 5e-4, PUBLISHED)
    stiff = stiff_flanks(gear)
    for place, pairs in ((ONE, 1), (TWO, 2)):
        model, q = at_rest(stiff, place)
        of = f"{pairs} pair{'s' * (pairs - 1)}"
        source = "T/(r_b^2 c' b N), flanks 1e5 times as stiff as teeth"
        yield check(
            f"transmission error at rest, {of}, rad", lag_of(model, q, gear), gear.error(pairs), 2e-5, source
        )
        source = "sqrt(k_m (r_b1^2/I1 + r_b2^2/I2))"
        value, oracle = frequency(replace(stiff, tooth=1e-4), place), gear.frequency(pairs)
        yield check(f"frequency, {of}, light teeth, rad/s", value, oracle, 2e-5, source)
        yield check(f"frequency, {of}, steel teeth, rad/s", frequency(stiff, place), oracle, 0.02, source)


def _touching(gear: Gear) -> float:
    """Mean number of pairs of teeth that press at rest, over a base pitch that begins with one."""

    def pairs(place: float) -> int:
        model, q = at_rest(gear, place)
        return int(np.sum(meshing_of(model).pressing(q, np.zeros_like(q))[:, 1] > 0.0))

    ends = []
    for low, high in ((ONE, TWO), (gear.pair.base_pitch, TWO)):
        for _ in range(16):
            middle = 0.5 * (low + high)
            low, high = (low, middle) if pairs(middle) > 1 else (middle, high)
        ends.append(high)
    return 1.0 + (ends[1] - ends[0]) / gear.pair.base_pitch


def _moving(
    gear: Gear, traces: dict[str, pd.DataFrame], sweeps: dict[str, pd.DataFrame], pitches: int
) -> Iterator[Found]:
    """Gears that turn, damped, against those at rest."""
    for name, trace in traces.items():
        audit = float(trace["audit"].iloc[0])
        yield vanishes(f"audit of energy, {name}", audit, 1e-8, "energy less work is kept")
    # They swing about the mean of their rest; in the first pitch from another start.
    bound = 0.05 if pitches == 1 else 0.02
    for name, sweep in sweeps.items():
        last = traces[name][traces[name]["pitches"] >= pitches - 1.0]
        rest = np.interp(last["pitches"] % 1.0, sweep["pitches"], sweep["lag"], period=1.0)
        claim = f"mean transmission error while turning, {name}, rad"
        yield check(claim, last["lag"].mean(), rest.mean(), bound, "at rest, place by place")
    energy = _undamped(gear, 2e-4)
    yield vanishes("change of energy without damping", energy, 1e-8, "the start")


def _flank(pair: GearPair, n: int = 41) -> pd.DataFrame:
    """Stiffness of one pair of teeth along the path of contact, without and with flattened flanks, N/m^2."""
    place = np.linspace(*pair.path, n)
    give = flattening(pair, LOAD)
    return pd.DataFrame({
        "pitches": place / pair.base_pitch, "teeth": pair_stiffness(pair, place),
        "pair": pair_stiffness(pair, place, give),
    })  # fmt: skip


def _teeth(pair: GearPair) -> Iterator[Found]:
    """Stiffness along the flank against finite elements and ISO 6336-1, method B."""
    found = float(pair_stiffness(pair, np.array(0.0)))
    yield check("stiffness at the pitch point, N/m^2", found, ELEMENTS, 0.02, "finite elements")
    one, other = pair.teeth
    give = flattening(pair, LOAD)
    stiffest = float(_flank(pair)["pair"].max())
    theory = 1e9 / (0.04723 + 0.15551 / one + 0.25791 / other)
    yield check("c'_th, N/m^2", stiffest, theory, 0.03, "ISO 6336-1: 1/q of standard teeth")
    ratio = mesh_stiffness(pair, give) / stiffest
    yield check("c_gamma by c'", ratio, 0.75 * pair.contact_ratio + 0.25, 0.05, "ISO 6336-1")


def _rubbing(n: int = 64) -> Iterator[Found]:
    """What friction takes of the power while a pair of teeth passes, place by place; and of a motion."""
    for pair in (GearPair(), SECOND):
        gear, taken = Gear(pair, torque=0.1, friction=FRICTION), []
        for place in (np.arange(n) + 0.5) / n * pair.base_pitch:
            model, q = at_rest(gear, float(place))
            qd = np.zeros_like(q)
            for k, rate in enumerate((gear.speed, gear.speed / gear.ratio)):
                qd[model.bodies.freedom(f"wheel {k}")[1]] = rate
            torques = meshing_of(model).resist(0.0, q, qd, model.start().factors.frames).torques
            taken.append(-qd @ np.asarray(torques) / (gear.torque * gear.speed))
        begin, end = (abs(each) / pair.base_pitch for each in pair.path)
        turns = np.pi * sum(1.0 / teeth for teeth in pair.teeth)
        oracle = FRICTION * turns * (1.0 - begin - end + begin**2 + end**2)
        name = "share of the power that friction takes, {} and {} teeth".format(*pair.teeth)
        yield check(name, float(np.mean(taken)), oracle, 0.01, "Ohlendorf's H_v, load shared evenly")
    moved = started(replace(Gear(), friction=FRICTION), 2e-4).simulate(2e-4, STEP)
    yield vanishes("audit of energy, with friction", moved.audit().energy, 1e-6, "energy less work is kept")


def _undamped(gear: Gear, until: float) -> float:
    free = replace(gear, damping=0.0, flank=Law(gear.flank.stiffness, gear.flank.exponent))
    moved = started(free, until).simulate(until, until / 10, DormandPrince(1e-11))
    return moved.audit().energy


def _stiffness(gear: Gear) -> pd.DataFrame:
    """Ratio of the angles that both wheels turn by between two places, at growing stiffness."""
    rows = []
    for factor in (1.0, 10.0, 100.0, 1e3, 1e4):
        stiff = gear.stiffer(factor)
        ends = [at_rest(stiff, place) for place in (ONE, TWO)]
        turned = np.diff([(q[m.bodies.freedom("wheel 0")[0]], lag_of(m, q, gear)) for m, q in ends], axis=0)[
            0
        ]
        # Of the lag, whose digits the difference of both angles has lost.
        rows.append(
            (factor * gear.stiffness, 1.0 / (0.5 * (1.0 - turned[1] / turned[0])), turned[1] / turned[0])
        )
    return pd.DataFrame(rows, columns=["stiffness", "ratio", "excess"])


def _ratios(stiffness: pd.DataFrame) -> Iterator[Found]:
    source = "numbers of teeth"
    yield check("ratio of angles, teeth 1e4 times as stiff", stiffness["ratio"].iloc[-1], 2.0, 1e-6, source)
    order = exponent(stiffness["stiffness"], -stiffness["excess"])
    yield check("its excess goes with the stiffness to the power", order, -1.0, 1e-3, "linear teeth")


def _work(gear: Gear, until: float, quick: bool) -> tuple[list[Point], list[Found]]:
    """Error of all angles at the end against seconds."""
    model = started(gear, until)
    live = passing(gear, until)
    names = [
        name
        for k in (0, 1)
        for name in (f"wheel {k}", *(f"tooth {k} {n % gear.pair.teeth[k]}" for n in live[k]))
    ]
    places = [model.bodies.freedom(name)[0] for name in names]
    start = np.concatenate([model.q[places], model.qd[places]])
    wanted, seconds = timed(lambda: reference(gear, live, start, np.array([0.0, until]))[-1, : len(places)])

    def error(integrator: Integrator, step: float) -> tuple[float, float]:
        end, seconds = timed(lambda: model.simulate(until, step, integrator, 10**9).q[-1, places])
        return seconds, float(np.abs(end - wanted).max() / gear.error(1))

    settings: list[tuple[str, str, Integrator, float]] = [
        ("RK4", f"{h:g} s", RungeKutta4(), h) for h in (2e-6, 1e-6, 5e-7, 2.5e-7)[: 2 if quick else 4]
    ]
    settings += [
        ("Dormand-Prince", f"{t:g}", DormandPrince(t), 5e-5) for t in (1e-6, 1e-8, 1e-10, 1e-12)
    ]  # fmt: skip
    settings += [
        ("ROS2", f"{t:g}", Rosenbrock(t), 4e-6) for t in (1e-6, 1e-7, 1e-8)[: 1 if quick else 3]
    ]  # fmt: skip
    rows = [Point(method, setting, *error(integrator, h)) for method, setting, integrator, h in settings]
    best = min(row.error for row in rows)
    source = "scipy's DOP853 at 1e-12, without trees or kernels"
    found = vanishes("angles at the end, of the error at rest", best, 1e-6, source)
    return [*rows, Point("DOP853", "1e-12", seconds, np.nan)], [found]


def _light(gear: Gear, quick: bool) -> pd.DataFrame:
    """Light teeth between flanks that damp: an explicit method must resolve what an implicit one need not.

    The error of the lag after 0.1 ms, of that at rest, against the explicit method at half a step near its
    longest.
    """
    until, tooth, h = 1e-4, *((0.1, 1e-7) if quick else (0.01, 1e-8))
    light = replace(gear, tooth=tooth)
    model = started(light, until)

    def lag(integrator: Integrator, step: float) -> float:
        return float(lags(model.simulate(until, step, integrator, 10**9), gear)[-1])

    wanted, rows = lag(RungeKutta4(), 0.5 * h), []
    for method, integrator, step, setting in (
        ("RK4", RungeKutta4(), h, f"{h:g} s"),
        *(("ROS2", Rosenbrock(t), 2e-6, f"{t:g}") for t in (1e-5, 1e-6, 1e-7)[: 1 if quick else 3]),
    ):
        found, seconds = timed(partial(lag, integrator, step))
        error = abs(found - wanted) / gear.error(1)
        rows.append((method, tooth, setting, seconds, error))
    return pd.DataFrame(rows, columns=["method", "tooth", "setting", "seconds", "error"])


def _left_out(gear: Gear, until: float) -> Iterator[Found]:
    """Teeth that do not come near the mesh, as parts of their wheels."""

    def answer(everything: bool, integrator: Integrator, time: float) -> Floats:
        return lags(started(gear, time, everything).simulate(time, STEP, integrator, 10), gear)

    for name, integrator, time in (("RK4", RungeKutta4(), until), ("ROS2", Rosenbrock(), 0.1 * until)):
        yield left_out(
            f"teeth far from the mesh on springs, by {name}", partial(answer, True, integrator, time),
            partial(answer, False, integrator, time), 0.01, 2,
        )  # fmt: skip


def _extremes(gear: Gear) -> Iterator[Found]:
    short = 1e-4

    def end(of: Gear, step: float = STEP, integrator: Integrator | None = None) -> Run:
        return started(of, short).simulate(short, step, integrator)

    def audit(of: Gear, step: float = STEP) -> Found:
        return vanishes("audit", end(of, step).audit().energy, 1e-6, "energy less work is kept")

    def swing(of: Gear, step: float = STEP, integrator: Integrator | None = None) -> Found:
        source = "teeth of steel, whose inertia changes little here"
        value, oracle = (lags(each, gear)[-1] for each in (end(of, step, integrator), end(gear)))
        return check("lag at the end", value, oracle, 0.03, source)

    def rest(of: Gear) -> Found:
        model, q = at_rest(of, ONE)
        return check("error at rest", lag_of(model, q, of), of.error(1), 2e-5, "T/(r_b^2 c' b)")

    # A damping that stops what comes in is stiff for the light teeth.
    for restitution, step in ((0.0, 0.1 * STEP), (1.0, STEP)):
        flank = lankarani_nikravesh(gear.flank.stiffness, restitution, 0.1)
        yield judged(f"restitution {restitution:g}", partial(audit, replace(gear, flank=flank), step))
    for factor in (1e-6, 1e-3, 1e3, 1e6):
        stiff = stiff_flanks(
            replace(gear, stiffness=gear.stiffness * factor, torque=gear.torque * min(1.0, factor))
        )
        yield judged(f"teeth {factor:g} times as stiff", partial(rest, stiff))
    yield judged("torque turned round", partial(_parted, gear, short))
    yield judged("step of three radians", lambda: swing(gear, 5e-6), Fault.STEP)
    light = replace(gear, tooth=1e-6)
    yield judged("teeth of a millionth, explicit", lambda: swing(light), Fault.STEP)
    yield judged("teeth of a millionth, implicit", lambda: swing(light, STEP, Rosenbrock(1e-4)))
    yield judged("teeth without inertia", lambda: audit(replace(gear, tooth=0.0)), Fault.NO_INERTIA)
    for label, shift, fault in (
        ("8 teeth: undercut", 0.0, Fault.UNDERCUT), ("8 teeth, shifted by half a module", 0.5, None),
        ("8 teeth, shifted by 0.7 modules: pointed", 0.7, Fault.POINTED),
    ):  # fmt: skip
        yield judged(label, partial(_shifted, shift), fault)


def _shifted(shift: float) -> Found:
    """Contact ratio of 8 shifted teeth on 40."""
    return check("contact ratio", GearPair((8, 40), shift=shift).contact_ratio, 1.3531, 1e-4, PUBLISHED)


def _parted(gear: Gear, until: float) -> Found:
    """Flanks that part: both wheels turn freely, as their torques say."""
    back = replace(gear, torque=-gear.torque)
    moved = gears(back, rigid=True, start={"wheel 1": 1e-7}).simulate(until, STEP)
    (first, _), (second, _) = gear.inertias
    oracle = -0.5 * until**2 * gear.torque * (1.0 / first + gear.ratio**2 / second) - 2e-7
    return check("lag", lag_of(moved.model, moved.q[-1], gear), oracle, 1e-9, "torque by inertia")
