"""A search for what the ten per cent can be: the least share of each case, in one table.

Over the axle's spring, its damper and the equilibrator.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import product

import numpy as np
import pandas as pd
from scipy.optimize import minimize

from bench.scenes.gun.parts import Gun, built
from bench.scenes.gun.study import BLOW, CLAIM, EXIT, UNTIL, amplitudes
from protochain.core.arrays import Floats
from protochain.core.errors import MechanicsError

CASES = (
    ("shot", Gun()), ("shot, no couple", Gun(offset=0.0)), ("blow to the deck", Gun(charge=0.0, blow=BLOW)),
    ("blow to the deck, no couple", Gun(charge=0.0, blow=BLOW, offset=0.0)),
)  # fmt: skip
EARLY, LATE = "until the projectile has left", "until the next shot"
DECK = 1e7
"""N/m: no axle of the table keeps it from the muzzle until the next shot."""
STIFFEST = 1e9
"""N m/rad: the axle that others are relative to, and the end of the search."""
LOW, HIGH = np.array([4.0, -2.0, 0.0]), np.array([np.log10(STIFFEST), 0.5, 2.0])
"""Ends of the search: logarithms of the axle's stiffness and of its damper's ratio; equilibrator."""


def searched(numbers: tuple[int, int, int] = (4, 2, 2), most: int = 20, until: float = UNTIL) -> pd.DataFrame:
    """Least share of the stiffest axle's motion that is found: a grid, then Nelder and Mead from its best."""
    grid = np.array(list(product(*map(np.linspace, LOW, HIGH, numbers))))
    rows = []
    for case, gun in CASES:
        on = replace(gun, deck=DECK)
        stiff = np.array(amplitudes(built(replace(on, axle=STIFFEST)), until)[:2])
        first = np.array([moved(on, until, x) for x in grid])
        for what, (when, end) in enumerate(((EARLY, EXIT), (LATE, until))):
            start = grid[int(np.argmin(first[:, what]))]
            x, least = refined(partial(_one, on, end, what), start, most)
            best, share = other(on, x), least / stiff[what]
            rows.append((
                case, when, best.axle, best.ratio, best.balanced, 1e3 * least, share, share <= CLAIM,
            ))  # fmt: skip
    names = ["case", "when", "axle", "ratio", "balanced", "muzzle_mm", "share", "ten_per_cent"]
    return pd.DataFrame(rows, columns=names)


def other(gun: Gun, x: Floats) -> Gun:
    """Gun with the axle and equilibrator of a point of the search."""
    return replace(gun, axle=float(10.0 ** x[0]), ratio=float(10.0 ** x[1]), balanced=float(x[2]))


def moved(gun: Gun, until: float, x: Floats) -> tuple[float, float]:
    """Largest ways of the muzzle until the projectile has left and to the end, m; infinite if it falls."""
    try:
        return amplitudes(built(other(gun, x)), until)[:2]
    except MechanicsError:
        return np.inf, np.inf


def _one(gun: Gun, until: float, what: int, x: Floats) -> float:
    return moved(gun, until, x)[what]


def refined(value: Callable[[Floats], float], start: Floats, most: int) -> tuple[Floats, float]:
    """Best point (3,) within the ends from a start, and its value, by at most so many evaluations."""
    inward = np.where(start > 0.5 * (LOW + HIGH), -0.15, 0.15) * (HIGH - LOW)
    simplex = start + np.vstack([np.zeros(3), np.diag(inward)])
    found = minimize(
        value, start, method="Nelder-Mead", bounds=list(zip(LOW, HIGH, strict=True)),
        options={"initial_simplex": simplex, "maxfev": most, "xatol": 0.01, "fatol": 1e-8},
    )  # fmt: skip
    return np.asarray(found.x), float(found.fun)
