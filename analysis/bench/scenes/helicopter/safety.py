"""Where it may land: limits of sink, drift and slope with blades that bend, a map of them, and resonance.

After a landing it stands with its rotor turning. In the components of a disc, which do not turn with the
shaft, the motion of its blades has constant coefficients, as in ``resonance``, and so eigenvalues.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache, partial
from typing import NamedTuple

import numpy as np
import pandas as pd

from bench.cases import Found, check
from bench.scenes.helicopter import landing
from bench.scenes.helicopter.landing import LIFT, touchdown, traced
from bench.scenes.helicopter.parts import (
    BLADE_MASS,
    BLADES,
    GRAVITY,
    HEIGHT,
    LEGS,
    MAST,
    MODES,
    RATE,
    TRANSMISSION,
    WEIGHT,
    Design,
    Helicopter,
    flying,
    settled,
)  # fmt: skip
from protochain.core.arrays import Floats
from protochain.mechanics.motion import Phase
from protochain.mechanics.multibody import integrate
from protochain.mechanisms import Model, state_matrix

TILT = 8.0
"""Degrees. Largest tilt in a landing, beyond that of the ground."""
OVERLOAD = 12e3
"""N. What a leg bears: one and a half times its share of a level landing at 2 m/s."""
GROWTH = 0.1
"""1/s. A motion that grows faster, tenfold in 23 s, is resonance."""
ELASTIC = Design(cells=4)
"""Blades in modes take steps of 2 ms with any number of cells."""
STEP = 2e-3
UNTIL = {"drift": 0.8, "slope": 1.5, "rate": 0.2, "sink": 0.2}
"""s. To come down on a slope takes longer; straight down the legs bear most at the touch."""
SINKS, DRIFTS = (0.5, 1.0, 2.0, 3.0), (0.0, 1.5, 3.0, 4.5, 6.0)
SLOPES, RATES = (4.0, 8.0, 12.0, 16.0, 20.0), (35.0, 40.0, 45.0, 50.0, 55.0)


CENTRE = HEIGHT + GRAVITY / WEIGHT * (TRANSMISSION * MAST + BLADES * BLADE_MASS * (MAST + 0.4))
"""m. Of all its mass, above the feet."""


class Landing(NamedTuple):
    """Largest force of a leg, N, and largest tilt beyond that of the ground, degrees."""

    leg: float
    tilt: float


def landed(
    sink: float, until: float, drift: float = 0.0, slope: float = 0.0, rate: float = RATE, step: float = STEP
) -> Landing:  # fmt: skip
    """Land: sinking and drifting in m/s, on a slope in degrees, the shaft at a rate."""
    legs = replace(LEGS, slope=float(np.radians(slope)))
    there = replace(ELASTIC, legs=legs, speed=rate)
    trace = traced(*touchdown(there, sink, until, step, None, drift, 2))
    forces = trace[[f"leg {k + 1}" for k in range(4)]].to_numpy()
    return Landing(float(forces.max()), max(0.0, float(trace["tilt"].max()) - slope))


def verdict(found: Landing, growth: float) -> str:
    """What is wrong with a landing: it tips, a leg bears too much, the rotor resonates; or it is safe."""
    if found.tilt > TILT:
        return "tips"
    if found.leg > OVERLOAD:
        return "leg overload"
    return "resonance" if growth > GROWTH else "safe"


def safe_map(quick: bool) -> pd.DataFrame:
    """Grids of sink speed by drift, by slope, and by the rate of the shaft."""
    sinks = (1.0, 3.0) if quick else SINKS
    rows = []
    for by, values in (("drift", DRIFTS), ("slope", SLOPES), ("rate", RATES)):
        for value in (values[0], values[-1]) if quick else values:
            growth = standing_growth(value if by == "rate" else RATE)
            for sink in sinks:
                found = landed(sink, min(UNTIL[by], 0.5 if quick else np.inf), **{by: value})
                rows.append((by, value, sink, *found, growth, verdict(found, growth)))
    return pd.DataFrame(rows, columns=["by", "value", "sink", "leg", "tilt", "growth", "verdict"])


def limits(quick: bool) -> pd.DataFrame:
    """Largest drift and slope for each sink at which a landing is safe, by bisection.

    ``drift`` and ``slope`` are safe, ``drift_over`` and ``slope_over`` are not. The last row is of the
    largest sink that is safe straight down on the level.
    """
    turns = 1 if quick else 4

    def safe(by: str, sink: float, value: float) -> bool:
        where = {} if by == "sink" else {by: value}
        found = landed(value if by == "sink" else sink, 0.2 if quick else UNTIL[by], **where)
        return verdict(found, 0.0) == "safe"

    rows = []
    for sink in (1.0,) if quick else landing.SINKS[:3]:
        drift, slope = (
            _bisected(partial(safe, by, sink), 0.0, high, turns)
            for by, high in (("drift", 8.0), ("slope", 24.0))
        )
        rows.append((sink, landed(sink, UNTIL["sink"]).leg, *drift, *slope))
    most, _ = _bisected(partial(safe, "sink", 0.0), 0.0, 8.0, 6 if quick else 10)
    rows.append((most, landed(most, UNTIL["sink"]).leg, 0.0, np.nan, 0.0, np.nan))
    return pd.DataFrame(rows, columns=["sink", "leg", "drift", "drift_over", "slope", "slope_over"])


def _bisected(safe: Callable[[float], bool], low: float, high: float, turns: int) -> tuple[float, float]:
    for _ in range(turns):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if safe(middle) else (low, middle)
    return low, high


def _of_disc(model: Model, rate: float) -> tuple[Floats, Floats]:
    """Matrix P (2 k, 2 k) from components of the disc and their rates to those of the blades, and its rate.

    At azimuth zero; a blade moves by y_0 + y_c cos psi + y_s sin psi. Roots come first, and stay.
    """
    k, modes = model.directions.shape[1], sum(MODES.values())
    roots = k - BLADES * modes
    parts = np.zeros((3, k, k))
    parts[0, :roots, :roots] = np.eye(roots)
    for blade in range(BLADES):
        c, s = np.cos(2.0 * np.pi * blade / BLADES), np.sin(2.0 * np.pi * blade / BLADES)
        for mode in range(modes):
            own, first = roots + blade * modes + mode, roots + 3 * mode
            parts[:, own, first : first + 3] = (
                (1.0, c, s), (0.0, -rate * s, rate * c), (0.0, -rate * rate * c, -rate * rate * s),
            )  # fmt: skip
    still = np.zeros((k, k))
    change = np.block([[parts[0], still], [parts[1], parts[0]]])
    return change, np.block([[parts[1], still], [parts[2], parts[1]]])


def standing(rate: float, given: Design = ELASTIC) -> tuple[Helicopter, Phase]:
    """Stand with the rotor turning, which lifts as in a landing."""
    legs = given.legs or LEGS
    helicopter = flying(replace(given, speed=rate, legs=legs), LIFT)
    depth = (1.0 - LIFT) * WEIGHT / (4.0 * legs.stiffness)
    return helicopter, settled(helicopter.model, (0.0, 0.0, 0.0), depth)


def of_small_motions(helicopter: Helicopter, at: Phase) -> tuple[Floats, Floats]:
    """Eigenvalues and eigenvectors, as columns, of small motions in components of the disc."""
    change, rate = _of_disc(helicopter.model, helicopter.given.speed)
    values, vectors = np.linalg.eig(
        np.linalg.solve(change, state_matrix(helicopter.model, at) @ change - rate)
    )
    return values, vectors


@cache
def standing_growth(rate: float) -> float:
    """Growth of the least stable motion of a helicopter that stands, 1/s."""
    return float(np.max(of_small_motions(*standing(rate))[0].real))


def against_eigenvalues(quick: bool, rate: float = 55.0, size: float = 1e-5) -> Iterator[Found]:
    """The motion that grows fastest, followed in time, against its eigenvalue."""
    helicopter, at = standing(rate)
    model, (values, vectors) = helicopter.model, of_small_motions(helicopter, at)
    worst = int(np.argmax(values.real))
    b, change = model.directions, _of_disc(model, rate)[0]
    first = change @ np.real(vectors[:, worst])
    first *= size / np.max(np.abs(first[: b.shape[1]]))
    start = model.system.at(
        integrate(model.tree, at.q, b @ first[: b.shape[1]]), at.qd + b @ first[b.shape[1] :]
    )
    turns, steps = (2, 150) if quick else (6, 150)
    time = 2.0 * np.pi / rate
    run = model.simulate(turns * time, time / steps, every=steps, start=start)
    still = model.simulate(turns * time, time / steps, every=steps, start=at)
    # After whole turns the blades are where they were, and so are the components of the disc.
    dual = np.linalg.inv(vectors)[worst] @ np.linalg.inv(change)
    back = np.linalg.pinv(b)
    sizes = []
    for q, qd, q0, qd0 in zip(run.q, run.qd, still.q, still.qd, strict=True):
        moved = np.concatenate([back @ _displacement(model, q, q0), back @ (qd - qd0)])
        sizes.append(np.abs(dual @ moved))
    found = float(np.polyfit(run.time, np.log(sizes), 1)[0])
    name = f"standing, shaft at {rate:g} rad/s: growth of the least stable motion, 1/s"
    yield check(name, found, float(values[worst].real), 0.01, "eigenvalue in components of the disc")


def _displacement(model: Model, q: Floats, at: Floats) -> Floats:
    """Small displacement (n_v,) between coordinates, roots next to upright; driven hinges stay."""
    tree = model.tree
    out = np.zeros(tree.n_v)
    for body in range(tree.n_bodies):
        k, v = tree.q_start[body], tree.v_start[body]
        if tree.q_start[body + 1] - k == 7:
            # Quaternions of small rotations: half of each.
            out[v : v + 3] = 2.0 * (q[k + 1 : k + 4] - at[k + 1 : k + 4])
            out[v + 3 : v + 6] = q[k + 4 : k + 7] - at[k + 4 : k + 7]
        elif tree.q_start[body + 1] > k:
            out[v] = q[k] - at[k]
    return out


def largest_sink(table: pd.DataFrame) -> Found:
    """Largest sink straight down: dampers alone bear the touch, c v + c2 v^2 = what a leg may bear."""
    c, squared = LEGS.damping, LEGS.squared
    wanted = (np.sqrt(c * c + 4.0 * squared * OVERLOAD) - c) / (2.0 * squared)
    source = "c v + c2 v^2 of a leg at the touch"
    return check("largest sink, m/s", float(table["sink"].iloc[-1]), wanted, 0.13, source, "absolute")


def on_a_slope(slope: float = 20.0, until: float = 3.0) -> Iterator[Found]:
    """Legs uphill and downhill of a rigid helicopter at rest, its rotor stopped, against statics."""
    stiff = replace(LEGS, stiffness=100.0 * LEGS.stiffness, damping=10.0 * LEGS.damping, squared=0.0)
    legs = replace(stiff, slope=float(np.radians(slope)))
    bare = replace(landing.RIGID, legs=legs, speed=0.0)
    trace = traced(*touchdown(bare, 0.0, until, 1e-3, share=0.0, every=100))
    s, arm = np.radians(slope), CENTRE * np.tan(np.radians(slope))
    last = trace.iloc[-1]
    for side, feet, sign in (("uphill", (1, 3), -1.0), ("downhill", (2, 4), 1.0)):
        force = float(sum(last[f"leg {k}"] for k in feet))
        wanted = 0.5 * WEIGHT * np.cos(s) * (1.0 + sign * arm)
        name = f"standing on a slope of {slope:g} degrees: legs {side}, N"
        yield check(name, force, wanted, 0.01, "statics")
