"""A cantilever of finite segments: frequencies, rotation, spin-up, rigid ends, limits.

Its frequencies are held against Euler and Bernoulli's beam, and rotating against the table of Wright, Smith,
Thresher, Wang, J. Appl. Mech. 49:197 (1982) and a Ritz solution in polynomials. The spin-up is that of Kane,
Ryan, Banerjee, J. Guid. Control Dyn. 10:139 (1987). Frequencies and rates are in units of sqrt(EI / m l^4).
"""

from functools import partial

import numpy as np
import pandas as pd

from bench.cases import Point, Scene
from bench.cost import timed
from bench.fits import exponent, extrapolated
from bench.scenes.beam import checks
from bench.scenes.beam.extremes import limits, without
from bench.scenes.beam.parts import ROOTS, UNIT, at_rest, built, lowest
from protochain.core.arrays import Floats
from protochain.mechanics.multibody import multiply_mass, pose
from protochain.mechanisms.segments import Beam


def run(quick: bool = False) -> Scene:
    """Run the scene; quick: few cells and few rates: some seconds."""
    trace, spinning = checks.spun_up(4 if quick else 8)
    rotating = checks.rotation((0.0, 6.0) if quick else tuple(checks.ROTATING))
    lengths = _lengths((10, 100, 1000) if quick else (10, 100, 1000, 10_000))
    found = (
        *checks.still(), *checks.rigid_ends(), *checks.against_table(rotating), *spinning, checks.twist(),
        checks.energy(4 if quick else 8),
    )  # fmt: skip
    return Scene(
        "beam", "a cantilever of finite segments: its first three frequencies", found,
        _work((4, 8, 16, 32) if quick else (4, 8, 16, 32, 64, 128, 256)), tuple(limits(quick)),
        tuple(without()), {"spin_up": trace, "rotation": rotating, "lengths": lengths},
        "largest relative error of three frequencies",
    )  # fmt: skip


def _work(numbers: tuple[int, ...]) -> list[Point]:
    """Error of the first three frequencies by the number of cells."""
    rows = []
    for lumped in (False, True):
        beam = Beam(1.0, 1.0, 1.0, lumped=lumped)
        before: tuple[Floats, float] | None = None
        for n in numbers:
            found, seconds = timed(partial(at_rest, beam, n), 3)
            found = found[:3]
            error = float(np.max(np.abs(found / ROOTS**2 - 1.0)))
            rows.append(Point("lumped" if lumped else "consistent", f"{n} cells", seconds, error))
            if before is not None:
                error = float(np.max(np.abs(extrapolated(before[0], found) / ROOTS**2 - 1.0)))
                label = "lumped, extrapolated" if lumped else "consistent, extrapolated"
                rows.append(Point(label, f"{n // 2} and {n} cells", seconds + before[1], error))
            before = found, seconds
    return rows


def _lengths(numbers: tuple[int, ...]) -> pd.DataFrame:
    """Seconds of the first frequency, in O(n), with the builder's and without."""
    rows = []
    for n in numbers:
        model = built(UNIT, n)
        frames = pose(model.tree, model.q)
        _, product = timed(partial(multiply_mass, model.tree, frames, np.ones(n)), 20)
        found, seconds = timed(partial(lowest, UNIT, n), 2)
        rows.append((n, product, seconds, abs(found / ROOTS[0] ** 2 - 1.0)))
    table = pd.DataFrame(rows, columns=["cells", "seconds_of_m_x", "seconds", "error"])
    long = table[table["cells"] >= table["cells"].max() // 10]
    return table.assign(exponent=exponent(long["cells"], long["seconds_of_m_x"]))
