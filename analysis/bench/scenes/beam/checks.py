"""Frequencies at rest, with rigid ends, in rotation; spin-up, twist, energy."""

from collections.abc import Iterator

import numpy as np
import pandas as pd

from bench.cases import Found, check, vanishes
from bench.fits import extrapolated
from bench.scenes.beam.parts import (
    EULER,
    ROOTS,
    SPIN_RATE,
    SPIN_TIME,
    SPUN,
    UNIT,
    at_rest,
    built,
    deflections,
    ritz,
    spin_up,
    spun,
    steady,
)  # fmt: skip
from protochain.mechanics.motion import DormandPrince, RungeKutta4
from protochain.mechanisms.linear import frequencies
from protochain.mechanisms.segments import Beam

CONSISTENT = (0.09, 0.31, 0.51)
LUMPED = (-0.06, -0.67, -1.8)
"""Errors of the first three frequencies with 16 cells, per cent, worked out before this was written."""
TIPS = {0.0125: 1.0255, 0.03125: 1.0656, 0.0625: 1.138}
"""Factor of all frequencies by the share of the length that is rigid at each end."""
ROTATING = {0.0: 3.5160, 1.0: 3.6816, 2.0: 4.1373, 4.0: 5.5850, 6.0: 7.3604, 12.0: 13.170}
WRIGHT = "Wright et al., 1982"


def still() -> Iterator[Found]:
    """Frequencies of the clamped beam, consistent and lumped."""
    for label, errors, lumped, bound in (
        ("consistent", CONSISTENT, False, 0.005), ("lumped", LUMPED, True, 0.01),
    ):  # fmt: skip
        found = at_rest(Beam(1.0, 1.0, 1.0, lumped=lumped), 16)[:3]
        for k, (w, error) in enumerate(zip(found, errors, strict=True)):
            name = f"error of frequency {k + 1}, 16 cells, {label}, %"
            yield check(name, 100.0 * (w / ROOTS[k] ** 2 - 1.0), error, bound, EULER, "absolute")
    coarse, fine = at_rest(UNIT, 32)[:3], at_rest(UNIT, 64)[:3]
    for k, limit in enumerate(extrapolated(coarse, fine)):
        name = f"frequency {k + 1} for n to infinity"
        yield check(name, limit, ROOTS[k] ** 2, 1e-6 * ROOTS[k] ** 4 / 12.0, EULER)
        order = np.log2((coarse[k] - ROOTS[k] ** 2) / (fine[k] - ROOTS[k] ** 2))
        yield check(f"order of frequency {k + 1}, 32 to 64 cells", order, 2.0, 0.02, "1/n^2", "absolute")


def rigid_ends() -> Iterator[Found]:
    """Rigid ends multiply all three frequencies."""
    for share, factor in TIPS.items():
        beam = Beam(1.0, 1.0, 1.0, rigid=share)
        found = extrapolated(at_rest(beam, 32)[:3], at_rest(beam, 64)[:3]) / ROOTS**2
        for k in range(3):
            name = f"factor of frequency {k + 1} by tips of {100 * share:g} %"
            yield check(name, found[k], factor, 2e-4, "worked out before")


def rotation(rates: tuple[float, ...]) -> pd.DataFrame:
    """First frequencies of a rotating beam, out of its plane and in it, extrapolated from 16 and 32 cells."""
    rows = []
    for rate in rates:
        out = {
            bends: [frequencies(spun(UNIT, n, steady(rate), bends))[:1] for n in (16, 32)] for bends in "yz"
        }
        flap, lag = (float(extrapolated(*out[bends])[0]) for bends in "yz")
        rows.append((rate, flap, lag, ROTATING[rate], ritz(rate)[0]))
    return pd.DataFrame(rows, columns=["rate", "flap", "lag", "table", "ritz"])


def against_table(rotating: pd.DataFrame) -> Iterator[Found]:
    """Hold the frequencies in rotation against the table and a Ritz solution."""
    for row in rotating.to_dict("records"):
        rate, flap = row["rate"], row["flap"]
        yield check(f"flap frequency at rate {rate:g}", flap, row["table"], 1e-4, WRIGHT)
        yield check(f"flap frequency at rate {rate:g}, by Ritz", flap, row["ritz"], 2e-5, "40 polynomials")
        lag = np.sqrt(row["table"] ** 2 - rate**2)
        yield check(f"frequency in plane at rate {rate:g}", row["lag"], lag, 5e-4, f"w^2 - W^2, {WRIGHT}")


def spun_up(cells: int) -> tuple[pd.DataFrame, list[Found]]:
    """Deflection of the tip while the root is spun up and afterwards, and the frequency of its swings."""
    model, top = spun(SPUN, cells, spin_up, "z"), at_rest(SPUN, cells)[-1]
    run = model.simulate(30.0, 2.4 / top, RungeKutta4(), every=max(1, int(0.02 * top / 2.4)))
    trace = pd.DataFrame({"time": run.time, "deflection": deflections(run.q[:, 1:], SPUN.lengths(cells))})
    late = trace[trace["time"] > SPIN_TIME].to_numpy()
    rises = np.flatnonzero((late[:-1, 1] < 0.0) & (late[1:, 1] >= 0.0))
    (t0, y0), (t1, y1) = late[rises].T, late[rises + 1].T
    crossings = t0 - y0 * (t1 - t0) / (y1 - y0)
    found = 2.0 * np.pi * (len(crossings) - 1) / (crossings[-1] - crossings[0])
    coarse, fine = (frequencies(spun(SPUN, n, steady(SPIN_RATE), "z"))[:1] for n in (16, 32))
    same = frequencies(spun(SPUN, cells, steady(SPIN_RATE), "z"))[0]
    limit = float(extrapolated(coarse, fine)[0])
    # The same beam in units of its own.
    unit = np.sqrt(SPUN.stiffness("z") / (SPUN.mass * SPUN.length**4))
    by_ritz = unit * np.sqrt(ritz(SPIN_RATE / unit)[0] ** 2 - (SPIN_RATE / unit) ** 2)
    kane = "Kane, Ryan, Banerjee, 1987"
    return trace, [
        check(
            f"swings after spin-up, {cells} cells, rad/s", found, same, 1e-3, "small motions, the same cells"
        ),
        check("swings after spin-up for n to infinity, rad/s", limit, 4.51, 0.005, kane, "absolute"),
        check("the same by Ritz, rad/s", limit, by_ritz, 2e-5, "40 polynomials"),
        vanishes("energy that is no work, spin-up", run.audit().energy, 1e-8, "the work"),
    ]


def twist() -> Found:
    """Frequency of a shaft that twists, all other bending allowed."""
    shaft = Beam(1.0, 1.0, (4.0, 9.0), twist=1.0, polar=0.01)
    lowest = []
    for cells in (8, 16):
        found = frequencies(built(shaft, cells, bends="xyz"))
        lowest.append(found[np.argmin(np.abs(found - 5.0 * np.pi))])
    value = float(extrapolated(np.array(lowest[:1]), np.array(lowest[1:]))[0])
    return check("first frequency in twist, with bending", value, 5.0 * np.pi, 1e-5, "pi/2 sqrt(GJ/I l^2)")


def energy(cells: int) -> Found:
    """Energy of a beam that is released bent."""
    model = built(UNIT, cells)
    system = model.system
    start = system.at(np.full(cells, 0.5 / cells), np.zeros(cells))
    run = model.simulate(2.0, 0.1, DormandPrince(1e-10), start=start)
    return vanishes("change of energy, released bent", run.audit().energy, 1e-8, "the start")
