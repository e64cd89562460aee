"""Extreme helicopters, and what can be left out of one."""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.integrate import simpson

from bench.cases import Found, check, judged, left_out, vanishes
from bench.scenes.helicopter import landing, resonance
from bench.scenes.helicopter.checks import LINEAR, RIGID, THIN, exactly, frequencies_about
from bench.scenes.helicopter.ground import take_off
from bench.scenes.helicopter.legs import Legs
from bench.scenes.helicopter.parts import (
    BLADE,
    FLAP,
    GRAVITY,
    LAG,
    LEGS,
    RATE,
    WEIGHT,
    Design,
    build,
    settled,
)
from bench.scenes.helicopter.safety import landed
from protochain.core.arrays import Floats
from protochain.core.errors import Fault
from protochain.mechanics.motion import DormandPrince, Integrator
from protochain.mechanisms import Rosenbrock
from protochain.mechanisms.segments import Beam

BLOW = 0.004
"""s. For which a blade is struck."""


def stiffer(factor: float) -> Beam:
    """Blade whose EI and GJ are so many times as large."""
    return replace(BLADE, bending=(FLAP * factor, LAG * factor), twist=BLADE.twist * factor)


def _turning(factor: float, rate: float, cells: int, bound: float = 1e-3) -> Found:
    thin = replace(THIN, bending=(FLAP * factor, LAG * factor), twist=THIN.twist * factor)
    exact = exactly(thin, rate)
    found = [frequencies_about(thin, rate, cells, axis) for axis in "yyzx"]
    near = [each[np.argmin(np.abs(each - w))] for each, w in zip(found, exact, strict=True)]
    worst = float(np.max(np.abs(np.array(near) / exact - 1.0)))
    return vanishes("frequencies", worst, bound, "Ritz")


def _climb(given: Design, until: float, h: float, integrator: Integrator | None) -> Floats:
    """Speed of climbing over time, after a step of the pitch."""
    helicopter, run = landing.hovering(given, until, h, change=landing.step, integrator=integrator)
    return landing.traced(helicopter, run)["climb"].to_numpy()


def _with_stiff_blades(integrator: Integrator | None) -> Found:
    """A step of the pitch with blades a million times as stiff: it climbs as with rigid ones."""
    given = replace(landing.RIGID, cells=2, modes=False, beam=stiffer(1e6))
    found, exact = (_climb(each, 0.1, 2e-3, integrator) for each in (given, landing.RIGID))
    worst = float(np.max(np.abs(found - exact)) / np.max(exact))
    return vanishes("climb", worst, 1e-4, "rigid blades")


def _legs(given: Design, sink: float, until: float, h: float) -> Floats:
    helicopter, run = landing.touchdown(given, sink, until, h)
    return landing.traced(helicopter, run)["legs"].to_numpy()


def _bare(legs: Legs, sink: float, until: float, h: float) -> Found:
    """Rigid landing with the rotor at rest, without lift, against the oscillator."""
    given = replace(RIGID, speed=0.0, legs=legs)
    helicopter, run = landing.touchdown(given, sink, until, h, share=0.0)
    found = landing.traced(helicopter, run)["legs"].to_numpy()
    k, c = 4.0 * legs.stiffness, 4.0 * legs.damping
    exact = landing.oscillator(run.time, k, c, 0.0, sink, WEIGHT)[1]
    left = np.flatnonzero(exact[1:] <= 0.0)
    on = slice(0, left[0] if len(left) else None)
    worst = float(np.max(np.abs(found - exact)[on]) / np.max(exact[on]))
    return vanishes("legs", worst, 1e-4, "damped oscillator")


def _rebounds() -> Found:
    """Without dampers it leaves the ground as quickly as it came."""
    given = replace(RIGID, speed=0.0, legs=replace(LINEAR, damping=0.0))
    helicopter, run = landing.touchdown(given, 2.0, 0.6, 1e-3, share=0.0)
    trace = landing.traced(helicopter, run)
    return check("speed", float(trace["climb"].max()), np.sqrt(4.0 + _push_off(given)), 1e-4, "energy")


def _push_off(given: Design) -> float:
    """Square of the speed gained by rising from the ground to where the weight is carried."""
    assert given.legs is not None
    # The speed is largest where the legs carry the weight: at v^2 + g^2 M / k.
    return GRAVITY * WEIGHT / (4.0 * given.legs.stiffness)


def _blown(given: Design, impulse: float) -> Design:
    """Let a blade be struck up at its tip, by an impulse that lasts a few milliseconds."""

    def blow(t: float) -> tuple[float, float, float]:
        size = 2.0 * np.sin(np.pi * t / BLOW) ** 2 / BLOW if 0.0 < t < BLOW else 0.0
        return 0.0, 0.0, impulse * size

    body, at = build(given).blades[0].tip
    return replace(given, loads=({"name": "blow", "body": body, "at": at, "force": blow},))


def _struck(impulse: float) -> Found:
    """A blade is struck as the feet touch: all forces from outside must add up to the change of momentum."""
    given = _blown(Design(cells=4), impulse)
    helicopter, run = landing.touchdown(given, 1.0, 0.05, 2e-4, DormandPrince(1e-9))
    system, tree, up = helicopter.model.system, helicopter.model.tree, []
    roots = tree.v_start[:-1][tree.parent < 0] + 5
    for time, q, qd in zip(run.time, run.q, run.qd, strict=True):
        at = system.at(q, qd, float(time))
        # All that acts on a root and what it carries; what acts between two of them takes itself away.
        up.append(float(np.sum(at.torque[roots])))
    change = float(run.momenta[-1, 0, 2] - run.momenta[0, 0, 2])
    return check("momentum", change, float(simpson(up, x=run.time)), 1e-6, "sum of the forces from outside")


def _struck_in_space(impulse: float) -> Found:
    """The same where nothing else acts: the blow is the change of momentum."""
    helicopter = build(_blown(Design(cells=4, legs=None, speed=0.0, gravity=0.0), impulse))
    run = helicopter.model.simulate(0.02, 2e-4)
    return check("momentum", run.momenta[-1, 0, 2], impulse, 1e-7, "the impulse")


def _standing(speed: float, until: float) -> Found:
    """Standing on the ground while the rotor turns, a blade pushed aside: the motion dies out."""
    helicopter = build(Design(cells=4, speed=speed, damping=2e-3))
    model = helicopter.model
    start = settled(model, (0.0, 0.0, 0.0), WEIGHT / (4.0 * LEGS.stiffness))
    places = [model.bodies.freedom(name) for name in helicopter.blades[0].hinges if name[-1] == "z"]
    at, freedoms = [place for place, _ in places], [freedom for _, freedom in places]
    lag = next(column for column in model.directions.T if np.any(column[freedoms]))
    qd = start.qd + 0.2 * lag / np.max(np.abs(lag))
    run = model.simulate(until, 1e-3, every=10, start=model.system.at(start.q, qd))
    angle = np.abs(np.sum(run.q[:, at], axis=1))
    grown = float(np.max(angle[-40:]) / np.max(angle[:40]))
    return vanishes("lag", grown, 0.9, "decay")


def _hard(sink: float) -> Found:
    """Legs straight down bear most at the touch, by their dampers."""
    exact = LEGS.damping * sink + LEGS.squared * sink**2
    return check("leg", landed(sink, 0.1, step=5e-4).leg, exact, 1e-9, "c v + c2 v^2")


def _takes_off(factor: float) -> Found:
    """Height after a take-off with stiff blades, and rigid ones."""
    stiff = Design(cells=2, mounts=False, beam=stiffer(factor))
    found, exact = (
        float(helicopter.model.state(run.end).point("fuselage")[2])
        for helicopter, run in (take_off(each, 2.0, 2.0, 1e-3, 100) for each in (stiff, landing.RIGID))
    )
    return check("height", found, exact, 1e-3, "rigid blades", "absolute")


def limits(quick: bool) -> Iterator[Found]:
    """Helicopters that are stiff, soft, quick, struck, undamped, or make no sense."""
    cells = 8 if quick else 12
    for factor in (1.0, 1e6) if quick else (1e-3, 1.0, 1e3, 1e6):
        # The softer, the shorter the part at the root that bends.
        n, bound = (80, 0.005) if factor < 0.1 else (cells, 1e-3)
        label = f"EI times {factor:g}: frequencies of blades at 45 rad/s"
        yield judged(label, partial(_turning, factor, RATE, n, bound))
    for rate in (50.0,) if quick else (0.1, 10.0, 50.0):
        yield judged(f"W {rate:g} rad/s: frequencies of blades", partial(_turning, 1.0, rate, cells))
    yield judged("EI times 1e6, explicit", partial(_with_stiff_blades, None), Fault.STEP)
    yield judged("EI times 1e6, implicit", partial(_with_stiff_blades, Rosenbrock()))
    yield judged(
        "W 50 rad/s, standing, a blade pushed aside", partial(_standing, 50.0, 0.6 if quick else 1.0)
    )
    yield judged("blade struck by 200 N s, in space", partial(_struck_in_space, 200.0))
    yield judged("blade struck by 200 N s at touchdown", partial(_struck, 200.0))
    yield judged("blade struck by 20 kN s at touchdown", partial(_struck, 2e4), Fault.HALF_TURN)
    yield judged("legs without dampers: rebound", _rebounds)
    undamped, thick = replace(LINEAR, damping=0.0), replace(LINEAR, damping=1e6)
    yield judged("legs without dampers: force", partial(_bare, undamped, 2.0, 0.2, 1e-3))
    yield judged("legs damped 300 times more, explicit", partial(_bare, thick, 1.0, 0.02, 1e-3), Fault.STEP)
    yield judged("legs damped 300 times more, short steps", partial(_bare, thick, 1.0, 0.005, 1e-5))
    yield judged("sink 20 m/s", partial(_bare, LINEAR, 20.0, 0.1, 5e-4))
    yield judged(
        "legs without stiffness", lambda: _bare(replace(LEGS, stiffness=0.0), 1.0, 0.1, 1e-3),
        Fault.NO_STIFFNESS,
    )  # fmt: skip
    yield judged("sink 20 m/s, blades that bend", partial(_hard, 20.0))
    yield judged("take-off with blades a hundred times as stiff", partial(_takes_off, 1e2))
    bare = replace(resonance.HAMMOND, lag_damping=0.0, hub_damping=(0.0, 0.0))
    yield judged("ground resonance without any damper", partial(_undamped_growth, bare))


def _undamped_growth(rotor: resonance.Rotor) -> Found:
    rate = 258.0 * resonance.RPM
    exact = float(np.max(resonance.eigenvalues(rotor, rate)[0].real))
    return check("growth", resonance.growth(resonance.simulated(rotor, rate, 6)), exact, 0.01, "eigenvalue")


def without(quick: bool) -> Iterator[Found]:
    """Rigid blades left out of the coordinates instead of made stiff; high modes of blades."""
    rigid, implicit = landing.RIGID, Rosenbrock()
    stiff = replace(rigid, cells=2, modes=False, beam=stiffer(1e6))
    # What is left out lets an explicit method step as far as the implicit one.
    yield left_out(
        "blades that bend, made stiff (EI times 1e6): climb after a step of the pitch",
        partial(_climb, stiff, 0.2, 2e-3, implicit), partial(_climb, rigid, 0.2, 2e-3, None), 1e-4, 1,
    )  # fmt: skip
    until = 0.05 if quick else 0.2
    cells, each = (8, 4) if quick else (12, 8)
    free = Design(cells=cells, modes=False, mounts=False, legs=LINEAR, damping=0.0)

    def all_modes() -> Floats:
        # So many cells ask for steps as short.
        return _legs(free, 1.0, until, 2e-3 / each)[::each]

    what = "high modes of blades, in steps that they allow: force of the legs"
    yield left_out(what, all_modes, lambda: _legs(replace(free, modes=True), 1.0, until, 2e-3), 2e-3, 1)
