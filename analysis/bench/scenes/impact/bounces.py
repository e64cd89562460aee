"""A ball that bounces without end in a finite time, and comes to rest."""

from collections.abc import Iterator

import numpy as np
import pandas as pd

from bench.cases import Found, check, vanishes
from bench.scenes.impact.systems import Blow, G, dropped
from protochain.mechanics.motion import DormandPrince, Phase, System
from protochain.mechanisms import Model
from protochain.mechanisms.event import Watched, march
from protochain.mechanisms.impacts import impact

HEIGHT, KEPT = 1.0, 0.5
"""m; restitution."""
SLOWEST = 1e-4
"""m/s, below which the jump adds what is left of the bounces, and ends them."""


def bounce(model: Model, ends: bool, until: float = 9.0) -> tuple[pd.DataFrame, float]:
    """Let the ball fall."""
    rows: list[dict[str, float]] = []
    rest = [np.inf]

    def jump(system: System, at: Phase) -> Phase:
        point = Blow("world", "ball", restitution=KEPT).point(model.state(at))
        after = impact(at.factors, at.qd, [point]).qd
        speed = float(after[0])
        rows.append({"bounce": len(rows) + 1, "time": at.time, "speed": speed})
        if ends and speed < SLOWEST:
            # 2 v/g, 2 e v/g ...
            rest[0] = at.time + 2.0 * speed / G / (1.0 - KEPT)
            after = np.zeros(1)
        return system.with_velocities(at, after)

    floor = Watched("floor", lambda at: float(at.q[0]), jump)
    for _ in march(model.system, DormandPrince(1e-12), model.start(), until, 0.1, [floor]):
        if rest[0] < np.inf:
            break
    return pd.DataFrame(rows), rest[0]


def bounce_checks(table: pd.DataFrame, end: float) -> Iterator[Found]:
    """Times of the bounces and of their end against the geometric series."""
    fall = np.sqrt(2.0 * HEIGHT / G)
    source = "geometric series"
    yield check("end of the bounces, s", end, fall * (1.0 + KEPT) / (1.0 - KEPT), 1e-11, source)
    times = fall * (1.0 + 2.0 * np.cumsum([0.0, *(KEPT ** np.arange(1.0, len(table)))]))
    worst = float(np.max(np.abs(table["time"] - times)))
    yield vanishes(f"times of {len(table)} bounces, s", worst, 1e-10, source)


def ball() -> Model:
    """Make the ball."""
    return dropped(HEIGHT)
