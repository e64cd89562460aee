"""Stiff and extreme beams, and what beams do without."""

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
from scipy.optimize import brentq

from bench.cases import Found, check, judged, left_out
from bench.fits import extrapolated
from bench.scenes.beam.parts import (
    EULER,
    ROOTS,
    UNIT,
    at_rest,
    built,
    deflections,
    lowest,
    ritz,
    spun,
    steady,
)  # fmt: skip
from protochain.core.arrays import Floats
from protochain.core.errors import Fault
from protochain.mechanics.motion import RungeKutta4
from protochain.mechanisms import Mechanism, Rosenbrock
from protochain.mechanisms.linear import frequencies
from protochain.mechanisms.segments import Beam, add_beam

REFUSED: tuple[tuple[str, dict[str, Any], str, Fault], ...] = (
    ("all of it rigid", {"rigid": 0.5}, "z", Fault.BENDS),
    ("twist without stiffness", {}, "x", Fault.NO_STIFFNESS),
    ("twist without inertia", {"twist": 1.0}, "x", Fault.NO_INERTIA),
    ("a length below zero", {"length": -1.0}, "z", Fault.NEGATIVE),
)
"""Name, fields of the beam, axes, and refusal."""


def _with_mass(ratio: float) -> Found:
    """Cantilever with a point at its tip, so many times as heavy as the beam."""
    found = [at_rest(UNIT, cells, ratio)[:1] for cells in (8, 16)]

    def closes(b: float) -> float:
        cosh, sinh, cos, sin = np.cosh(b), np.sinh(b), np.cos(b), np.sin(b)
        return float(1.0 + cos * cosh + ratio * b * (cos * sinh - sin * cosh))

    root = brentq(closes, 1e-3, ROOTS[0], xtol=1e-15, rtol=1e-14)
    value = float(extrapolated(*found)[0])
    return check("frequency", value, root**2, 1e-5, "transcendental equation of the beam with a point")


def _implicit(stiffness: float, force: float) -> Found:
    """Deflection by a small force at the tip, by Rosenbrock, whose steps are far beyond stable others."""
    beam, cells = Beam(1.0, 1.0, stiffness), 8
    unit = ROOTS[0] ** 2 * np.sqrt(stiffness)
    mechanism = Mechanism()
    end = add_beam(mechanism, "beam", beam, cells, damping=0.5 / unit)
    mechanism.load("force", *end.tip, force=(0.0, force, 0.0))
    model, integrator = mechanism.build(), Rosenbrock()
    at = model.start()
    for _ in range(200):
        at = integrator.step(model.system, at, 0.5 / unit)
    tip = deflections(at.q[None], beam.lengths(cells))[0]
    # The hinges stand in the middle of their cells: the sum of (l - x)^2 is less by 1/4n^2 of it.
    oracle = force / (3.0 * stiffness) * (1.0 - 0.25 / cells**2)
    return check("deflection", tip, oracle, 1e-5, "F l^3 / 3 EI, as a sum over 8 cells")


def _creep() -> Found:
    """Beam with dampers so strong that it only creeps: its angles fall by e in their time constant."""
    time, cells = 1e3, 4
    model = built(UNIT, cells, damping=time)
    at, integrator = model.system.at(np.full(cells, 1e-3), np.zeros(cells)), Rosenbrock()
    for _ in range(50):
        at = integrator.step(model.system, at, 0.02 * time)
    return check("angle", at.q[-1] / 1e-3, np.exp(-1.0), 1e-3, "exp(-1)")


def _fast(rate: float) -> Found:
    found = [frequencies(spun(UNIT, n, steady(rate), "y"))[:1] for n in (32, 64)]
    return check("flap frequency", float(extrapolated(*found)[0]), ritz(rate)[0], 1e-3, "Ritz")


def _scaled(factor: float) -> Found:
    found = frequencies(built(Beam(1.0, 1.0, factor), 16))[0] / np.sqrt(factor)
    return check("frequency / sqrt EI", found, at_rest(UNIT, 16)[0], 1e-7, "EI = 1")


def _too_long() -> Found:
    """Explicit steps of three times the length that is stable."""
    model = built(UNIT, 4)
    start = model.system.at(np.full(4, 1e-3), np.zeros(4))
    run = model.simulate(100.0, 3.0 * 2.8 / at_rest(UNIT, 4)[-1], RungeKutta4(), start=start)
    return check("energy", run.total[-1], run.total[0], 1e-2, "the start")


def limits(quick: bool) -> Iterator[Found]:
    """Beams that are stiff, long, heavy at the tip, quick, damped, or make no sense."""
    for factor in (1e-3, 1e6):
        yield judged(f"EI times {factor:g}, frequency", partial(_scaled, factor))
        yield judged(f"EI times {factor:g}, implicit", partial(_implicit, factor, 1e-4 * factor))
    for n in (1, 2, 1000) if quick else (1, 2, 1000, 10_000):

        def first(n: int = n) -> Found:
            # Error of the first frequency: a fifth of 1/n^2, seen above; rounding of n small angles.
            return check("frequency", lowest(UNIT, n), ROOTS[0] ** 2, 0.5 / n**2 + 1e-10, EULER)

        yield judged(f"cells: {n}", first)
    for ratio in (1e-6, 1.0, 1e6):
        yield judged(f"tip {ratio:g} times as heavy as the beam", partial(_with_mass, ratio))
    if not quick:
        yield judged("rate 50", partial(_fast, 50.0))
    yield judged("dampers that let it only creep", _creep)
    yield judged("steps three times too long", _too_long, Fault.STEP)

    for name, fields, bends, words in REFUSED:
        beam: dict[str, Any] = {"length": 1.0, "mass": 1.0, "bending": 1.0, **fields}
        yield judged(name, partial(_freedoms, beam, bends), words)


def _freedoms(beam: dict[str, Any], bends: str) -> Found:
    model = built(Beam(**beam), 4, bends=bends)
    return check("freedoms", model.tree.n_v, 4, 0.0, "one axis")


def without() -> Iterator[Found]:
    """Axes about which nothing turns, and rigid ends that are not made stiff."""

    def swing(bends: str) -> Floats:
        shaft = Beam(1.0, 1.0, 1.0, twist=1.0, polar=1e-3)
        model = built(shaft, 6, bends=bends)
        at_z = [k for k, name in enumerate(n for n in model.bodies.hinges if n != "beam") if name[-1] == "z"]
        q = np.zeros(model.tree.n_q)
        q[at_z] = 0.05
        start = model.system.at(q, np.zeros(model.tree.n_v))
        return model.simulate(0.05, 1e-4, RungeKutta4(), every=100, start=start).q[:, at_z]

    what = "bending out of the plane and twist, which nothing excites"
    yield left_out(what, partial(swing, "xyz"), partial(swing, "z"), 1e-9, 2)
    tips = Beam(1.0, 1.0, 1.0, rigid=0.0625)

    def stiff_ends() -> float:
        """Frequency with the ends as cells of their own, a thousand million times as stiff."""
        mechanism, share = Mechanism(), tips.rigid
        end = Beam(share, 1.0, 1e9)
        root = add_beam(mechanism, "root", end, 2)
        middle = add_beam(
            mechanism, "middle", Beam(1.0 - 2.0 * share, 1.0, 1.0), 16, root.tip[0],
            {"kind": "fixed", "at": root.tip[1]},
        )  # fmt: skip
        add_beam(mechanism, "end", end, 2, middle.tip[0], {"kind": "fixed", "at": middle.tip[1]})
        return float(frequencies(mechanism.build())[0])

    what = "hinges of rigid ends, made stiff instead: the frequency"
    yield left_out(what, stiff_ends, lambda: float(frequencies(built(tips, 16))[0]), 1e-5)
