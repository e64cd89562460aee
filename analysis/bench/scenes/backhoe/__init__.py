"""A backhoe that digs: cylinders, tracks, soil that pushes back, and when it tips.

After Ahmadi and Wasfy's backhoe, whose text and data were not found: all numbers here are chosen. What is
known of it from others, and where it is:

==================================================  =====================================================
frame, boom, stick and bucket, with joints          ``machine``: hinges; bushings in the scene ``bucket``
hydraulic cylinders, forces of drives and joints    ``machine``: closed loops; ``Run.motion``, ``reactions``
tracks of 24 shoes on wheels and sprockets          ``track``: one of them, with half the machine, in a plane
the machine on the ground, slides and tips          ``cycle``: its tracks as feet of ten balls
ground and bucket of polygons, found by boxes       ground of triangles (``without``); bucket of four plates
friction of asperities                              ``mechanisms.Friction`` and the cubes' own
soil of cubes that press on each other              ``bench.soil.pile``, and ``bench.soil.soil`` pushes back
stability of designs                                ``stability``: centre of pressure, and force-angle measure
==================================================  =====================================================

Left out: both tracks under the digging vehicle, whose shoes take steps as short as the cubes', for which it
stands on feet; a track in soil that gives way, whose heap would need thousands of cubes under each shoe, so
that it rolls on rigid ground; why it creeps by 1 %, of which only that its pins move in their seats was seen;
buckets of triangles under cubes, whose plates are boxes; and hydraulics, for which lengths of
cylinders are prescribed, and forces found.
"""

from functools import partial

import numpy as np
import pandas as pd

from bench.cases import Found, Point, Scene, check, tried
from bench.scenes.backhoe import checks
from bench.scenes.backhoe.cycle import (
    END,
    FULL,
    SMALL,
    STEP,
    Ground,
    Worked,
    in_bucket,
    settled,
    soil_table,
    work,
    working,
)  # fmt: skip
from bench.scenes.backhoe.extremes import limits, tipping_load, tips_at, without
from bench.scenes.backhoe.machine import ARM, DESIGNS, vehicle
from bench.scenes.backhoe.stability import traced
from protochain.mechanics.motion import DormandPrince, Integrator, RungeKutta4
from protochain.mechanisms import Run

SLOW = 1.0
"""rad/s. Rate of the sprocket at which the track is checked."""

__all__ = ["DESIGNS", "run", "settled", "traced", "work"]


def run(quick: bool = False) -> Scene:
    """Run the scene; quick: few cubes, one design, a fifth of a second of digging."""
    ground = settled(SMALL if quick else FULL)
    until, designs = (0.2, DESIGNS[:1]) if quick else (END, DESIGNS)
    cycles = [work(design, ground, until) for design in designs]
    # Of every fourth step.
    traces = [traced(each, 4).assign(design=each.design.name) for each in cycles]
    rates = {SLOW: 1.1} if quick else {SLOW: 1.75, 2.0: 1.2}
    driven = {rate: checks.driven(rate, time) for rate, time in rates.items()}
    found: list[Found] = [
        *checks.statics(designs), *checks.arm(), *checks.excavation(cycles[0]),
        *checks.track(driven[SLOW], 0.03 if quick else 0.02),
    ]  # fmt: skip
    if not quick:
        load, exact = tips_at(DESIGNS[0]), tipping_load(DESIGNS[0])
        found.append(check("load that tips it, N", load, exact, 0.02, "moments about an edge"))
    track = driven[SLOW].motion[["time", "frame x", "frame z", "sprocket", "sprocket drive"]]
    return Scene(
        "backhoe", "a backhoe that digs in cubes: energy that machine and soil do not agree on",
        tuple(found), _work(ground, quick), tuple(limits(quick)), tuple(without(quick)),
        {
            "cycle": pd.concat(traces, ignore_index=True), "soil": soil_table(cycles[0].soil),
            "designs": _designs(cycles, traces), "track": track, "slip": checks.slipping(driven),
        },
        "energy that does not balance, J",
    )  # fmt: skip


def _designs(cycles: list[Worked], traces: list[pd.DataFrame]) -> pd.DataFrame:
    """Least stability of each design in a cycle, loads it takes, and largest forces."""
    rows = []
    for worked, trace in zip(cycles, traces, strict=True):
        rows.append({
            "design": worked.design.name, "mass_kg": worked.design.mass,
            "tipping_load_N": tipping_load(worked.design), "least_pressure_m": trace["pressure"].min(),
            "least_angle_deg": trace["angle"].min(), "least_measure": trace["measure"].min(),
            "lifted_mm": 1e3 * trace["lifted"].max(), "most_tilt_deg": trace["tilt"].max(),
            "moved_mm": 1e3 * np.hypot(*(trace.iloc[-1][["x", "y"]] - trace.iloc[0][["x", "y"]])),
            **{f"most_{name}_N": trace[name].abs().max() for name in ARM},
            "in_bucket": in_bucket(worked.soil.heap, worked.state(-1)), "seconds": worked.seconds,
        })  # fmt: skip
    return pd.DataFrame(rows)


def _work(ground: Ground, quick: bool) -> list[Point]:
    """Energy that does not balance by step: of machine and soil together, and of the machine held."""
    until = 0.2 if quick else 0.3
    path = checks.flat(working(ground.level))
    held = vehicle(DESIGNS[0], path, None).build()

    def cycled(step: float) -> Worked:
        return work(DESIGNS[0], ground, until, step)

    def apart(worked: Worked) -> float:
        return abs(checks.balance(worked).passed)

    def alone(integrator: Integrator, step: float) -> Run:
        return held.simulate(until, step, integrator)

    def lost(run: Run) -> float:
        lack = run.total - np.sum(run.work, axis=1)
        return float(np.max(np.abs(lack - lack[0])))

    together = (2e-3, STEP) if quick else (4e-3, 2e-3, STEP)
    rows = [tried("machine and soil", f"{1e3 * h:g} ms", partial(cycled, h), apart) for h in together]
    for h in (0.02, 0.01, 5e-3):
        call = partial(alone, RungeKutta4(), h)
        rows.append(tried("machine held, Runge-Kutta", f"{1e3 * h:g} ms", call, lost, 2))
    for tolerance in (1e-6, 1e-8, 1e-10):
        call = partial(alone, DormandPrince(tolerance), 0.05)
        rows.append(tried("machine held, Dormand-Prince", f"{tolerance:g}", call, lost, 2))
    return rows
