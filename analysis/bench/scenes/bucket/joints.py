"""Joints as bushings beside hinges: the machine falls, held by springs instead of hinges."""

from functools import partial

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from bench.cases import Point
from bench.cost import timed
from bench.scenes.bucket.backhoe import BODIES, EDGE, GRAVITY, HINGES, backhoe
from protochain.core.arrays import Floats
from protochain.mechanics.motion import StepTooLargeError
from protochain.mechanisms import Mechanism, Model

ANGLES = np.array([-0.6, 1.2, -0.3])
"""Of the hinges at the start."""
FALL = 0.2
"""s."""
ARM = 0.1
"""m. Stiffness against tilting is that against shifting times the square of it."""
SHORTEST_ARC = 0.5
"""Steps of bushings, in 1/w of the fastest vibration."""


def on_bushings(stiffness: float) -> Mechanism:
    """The machine with bushings, which turn freely about y only."""
    machine = Mechanism(GRAVITY)
    origins: dict[str, Floats] = {"world": np.zeros(3)}
    turns: dict[str, Floats] = {"world": np.eye(3)}
    for (name, (parent, at)), angle in zip(HINGES.items(), ANGLES, strict=True):
        origins[name] = origins[parent] + turns[parent] @ np.array(at)
        turns[name] = turns[parent] @ Rotation.from_rotvec([0.0, angle, 0.0]).as_matrix()
        mass, com, inertia = BODIES[name]
        machine.body(name, mass, com, inertia, position=origins[name], rotation=turns[name])
        tilting = stiffness * ARM**2
        springs = (tilting, 0.0, tilting, stiffness, stiffness, stiffness)
        machine.bushing(f"joint of {name}", (name, np.zeros(3)), (parent, at), springs)
    return machine


def fastest(stiffness: float) -> float:
    """Bound on the fastest frequency: each body between two bushings, shifted and tilted."""
    bound = 0.0
    for mass, com, inertia in BODIES.values():
        reach = ARM**2 + (2.0 * float(np.linalg.norm(com))) ** 2
        bound = max(
            bound,
            2.0 * stiffness * (1.0 / mass + reach / max(inertia)),
            2.0 * stiffness * ARM**2 / min(inertia),
        )
    return float(np.sqrt(bound))


def edge_of(model: Model, step: float, rows: int = 20) -> Floats:
    """(rows + 1, 3) float, m: way of the cutting edge."""
    every = max(round(FALL / step / rows), 1)
    h = FALL / (rows * every)
    run = model.simulate(FALL, h, every=every)
    places = []
    for t, q, qd in zip(run.time, run.q, run.qd, strict=True):
        places.append(model.state(model.system.at(q, qd, t)).point("bucket", EDGE))
    return np.array(places)


def compare(stiffnesses: tuple[float, ...]) -> tuple[pd.DataFrame, list[Point]]:
    """Distance of the edge from the hinged machine's, and the longest stable step, by stiffness."""
    hinged = backhoe(angles=ANGLES).build()
    exact = edge_of(hinged, 1e-4)
    rows, work = [], []
    for h in (1e-2, 5e-3, 2.5e-3):
        found, seconds = timed(partial(edge_of, hinged, h))
        work.append(Point("hinges", f"{1e3 * h:g} ms", seconds, _apart(found, exact)))
    for k in stiffnesses:
        model = on_bushings(k).build()
        step = SHORTEST_ARC / fastest(k)
        found, seconds = timed(partial(edge_of, model, step))
        error = _apart(found, exact)
        work.append(Point("bushings", f"{k:g} N/m", seconds, error))
        rows.append({"stiffness": k, "error": error, "step": longest_step(model, step), "seconds": seconds})
    return pd.DataFrame(rows), work


def _apart(found: Floats, exact: Floats) -> float:
    return float(np.max(np.linalg.norm(found - exact, axis=1)))


def longest_step(model: Model, safe: float) -> float:
    """Longest step, to 5 %, with which the energy of 60 steps stays what it was."""
    low, high = safe, 64.0 * safe
    while high > 1.05 * low:
        middle = float(np.sqrt(low * high))
        if _holds(model, middle):
            low = middle
        else:
            high = middle
    return low


def _holds(model: Model, step: float) -> bool:
    try:
        with np.errstate(all="ignore"):
            run = model.simulate(60 * step, step)
    except (StepTooLargeError, ValueError, FloatingPointError):
        return False
    # A method that is unstable multiplies what vibrates at every step.
    return bool(np.all(np.abs(run.total - run.total[0]) < 0.1 * (1e-3 + np.max(run.kinetic))))
