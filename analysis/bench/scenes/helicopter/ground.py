"""On the ground: take-off, a gust and a step of the pitch, what the legs bear; and heave on legs by scipy."""

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pandas as pd
from scipy.integrate import solve_ivp

from bench.cases import Found, check, vanishes
from bench.scenes.helicopter import landing
from bench.scenes.helicopter.checks import LINEAR, balance
from bench.scenes.helicopter.landing import LIFT, MASS, gust, spun_up, step, traced
from bench.scenes.helicopter.lift import Motion
from bench.scenes.helicopter.parts import (
    BLADE_MASS,
    BLADES,
    HEIGHT,
    LEGS,
    RADIUS,
    RATE,
    WEIGHT,
    Design,
    Helicopter,
    build,
    flying,
    settled,
)  # fmt: skip
from protochain.core.arrays import Floats
from protochain.mechanisms import Run

TAKE_OFF = 1.1
"""Lift at full rate of the shaft, in weights: the feet leave the ground at 0.953 of it."""
ROTOR = BLADES * BLADE_MASS * RADIUS**2 / 3.0
"""kg m^2. Of straight blades about the shaft."""
DOP853 = "heave on four legs, scipy's DOP853"
Case = tuple[str, Callable[[Design], tuple[Helicopter, Run]]]


def standing(
    given: Design, until: float, time_step: float, every: int = 1,
    wind: Motion | None = None, change: Motion | None = None, share: float = LIFT,
) -> tuple[Helicopter, Run]:  # fmt: skip
    """Stand on the ground, a share of the weight on the rotor, through a gust or a change of the pitch."""
    legs = given.legs or LEGS
    given = replace(given, legs=legs, gust=wind or (lambda t: 0.0))
    helicopter = flying(given, share, 0.0, change or (lambda t: 0.0))
    start = settled(helicopter.model, (0.0, 0.0, 0.0), (1.0 - share) * WEIGHT / (4.0 * legs.stiffness))
    return helicopter, helicopter.model.simulate(until, time_step, every=every, start=start)


def take_off(
    given: Design, up: float, until: float, time_step: float, every: int = 1
) -> tuple[Helicopter, Run]:
    """Spin the rotor up with its pitch set, until the lift carries the weight and the feet leave the ground.

    The tail rotor balances the torque of a straight rotor. Thrust goes with the square of the rate, and so
    the induced velocity with the rate.
    """
    motion, trim = spun_up(up), flying(given, TAKE_OFF).given
    tail = {
        "name": "tail rotor", "body": "fuselage", "moment": lambda t: (0.0, 0.0, ROTOR * motion(t)[2])
    }  # fmt: skip
    slower = replace(
        trim,
        motion=motion,
        loads=(*trim.loads, tail),
        gust=lambda t: trim.inflow * (1.0 - motion(t)[1] / RATE),
    )
    helicopter, legs = build(slower), given.legs or LEGS
    start = settled(helicopter.model, (0.0, 0.0, 0.0), WEIGHT / (4.0 * legs.stiffness))
    return helicopter, helicopter.model.simulate(until, time_step, every=every, start=start)


def heave(helicopter: Helicopter, times: Floats) -> tuple[Floats, Floats]:
    """Height (n,) over the touch, and force of all linear legs (n,), of a rigid helicopter that stands.

    One equation, M z'' = lift - weight + legs, from rest where the legs bear what the rotor does not.
    """
    legs = helicopter.given.legs
    assert legs is not None
    k, c = 4.0 * legs.stiffness, 4.0 * legs.damping

    def force(z: float, climb: float) -> float:
        return max(0.0, -k * z - c * climb) if z <= 0.0 else 0.0

    def rates(t: float, y: Floats) -> list[float]:
        lift = helicopter.lift.thrust(t, y[1])
        return [y[1], (lift - WEIGHT + force(y[0], y[1])) / MASS]

    start = [(helicopter.lift.thrust(0.0) - WEIGHT) / k, 0.0]
    found = solve_ivp(
        rates, (times[0], times[-1]), start, "DOP853", times, rtol=1e-9, atol=1e-10, max_step=0.02
    ).y  # fmt: skip
    return found[0], np.array([force(z, climb) for z, climb in found.T])


def against_heave(quick: bool) -> Iterator[Found]:
    """Rigid blades and linear legs: their force over time, and the rate at which they leave the ground."""
    rigid = replace(landing.RIGID, legs=LINEAR)
    up = 2.0 if quick else 4.0
    for name, bound, (helicopter, run) in (
        # Where feet come and go their dampers act, or stop, at once: within a step.
        ("gust on the ground", 2e-3, standing(rigid, 0.8, 1e-3, wind=gust)),
        ("pitch on the ground", 1e-7, standing(rigid, 0.8, 1e-3, change=step)),
        ("take-off", 1e-7, take_off(rigid, up, up, 2e-3)),
    ):
        trace = traced(helicopter, run)
        height, force = heave(helicopter, run.time)
        worst = float(np.max(np.abs(trace["legs"] - force))) / WEIGHT
        yield vanishes(f"rigid, {name}: force of the legs over time, of the weight", worst, bound, DOP853)
        end = trace["height"].iloc[-1] - HEIGHT
        yield check(f"rigid, {name}: height at the end, m", end, height[-1], 2e-5, DOP853, "absolute")
    rate = float(np.interp(left_at(trace), run.time, [helicopter.lift.rate(t) for t in run.time]))
    # The mass that moves up must be pushed: the legs lose their load a little later than at rest.
    source = "sqrt of weight by lift at full rate"
    name = "rigid, take-off: rate of the shaft as the feet leave, rad/s"
    yield check(name, rate, RATE / TAKE_OFF**0.5, 0.01, source)


def left_at(trace: pd.DataFrame) -> float:
    """Time at which the legs bear something for the last time."""
    return float(trace.loc[trace["legs"] > 0.0, "time"].max())


def cases(quick: bool) -> tuple[Case, ...]:
    """What a helicopter on the ground goes through, each for some given parts."""
    until, up = (0.3, 1.0) if quick else (1.0, 6.0)
    return (
        ("gust on the ground", lambda given: standing(given, until, 1e-3, 5, wind=gust)),
        ("pitch on the ground", lambda given: standing(given, until, 1e-3, 5, change=step)),
        ("take-off", lambda given: take_off(given, up, up if quick else up + 0.5, 2e-3, 5)),
    )


def leg_loads(given: Design, quick: bool) -> tuple[dict[str, pd.DataFrame], pd.DataFrame, list[Found]]:
    """Traces of the cases, what a leg bears in each, with blades that bend and rigid ones, and energy."""
    traces, rows, found = {}, [], []
    for name, case in cases(quick):
        for blades, parts in (("bend", given), ("rigid", replace(landing.RIGID, legs=given.legs))):
            helicopter, run = case(parts)
            trace = traced(helicopter, run)
            rows.append((name, blades, *borne(trace)))
            if blades == "bend":
                traces[name.replace(" ", "_").replace("-", "_")] = trace.assign(
                    rate=[helicopter.lift.rate(t) for t in run.time]
                )
                found.append(balance(name, run, 1e-4 if quick else 1e-5))
    names = ["case", "blades", "leg_max", "leg_min", "in_the_air", "tilt", "tip_swing"]
    return traces, pd.DataFrame(rows, columns=names), found


def borne(trace: pd.DataFrame) -> tuple[float, float, float, float, float]:
    """Largest and least force of a leg, N; share of the time in the air; tilt, degrees; swing of a tip, m."""
    legs = trace[[f"leg {k + 1}" for k in range(4)]].to_numpy()
    air = float(np.mean(trace["legs"] == 0.0))
    return (
        float(legs.max()),
        float(legs.min()),
        air,
        float(trace["tilt"].max()),
        float(np.ptp(trace["tip 1"])),
    )
