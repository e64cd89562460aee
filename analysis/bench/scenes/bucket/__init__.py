"""A backhoe's bucket in a soil of cubes: slopes, weights, work of drives, bushings, sleep.

Boom, stick and bucket on drives, the frame on the ground, after Ahmadi and Wasfy's backhoe; free cubes of
20 mm and 2000 kg/m^3 with faces, edges and corners. Tracks, and soil that pushes back: scene ``backhoe``.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pandas as pd

from bench.cases import Found, Scene, check, left_out, vanishes
from bench.fits import exponent
from bench.scenes.bucket import joints, trials
from bench.scenes.bucket.backhoe import backhoe, motion_of
from bench.scenes.bucket.dig import NARROW, SIDE, WIDE, Dug, Settled, Site, away, dig, settle, soil
from bench.soil.parts import Motion, Sleep
from protochain.core.arrays import Floats

__all__ = ["Dug", "Settled", "Site", "dig", "run", "settle"]

SAME = 0.1 * SIDE
"""m. How far a cube may lie from where it would without sleep."""


def run(quick: bool = False) -> Scene:
    """Run the scene; quick: 400 cubes in a narrow bin instead of 2000, and half a second of digging."""
    settled = settle(NARROW, 0.5) if quick else settle(WIDE, 0.7)
    # Where few cubes lie above the floor, the bucket only scrapes, lest it crush them.
    dug = dig(settled, 0.5, 0.1, looks=10) if quick else dig(settled)
    bushings, work = joints.compare((1e5, 1e6) if quick else (1e4, 1e5, 1e6, 1e7, 1e8))
    kept = trials.energies((1.0, 0.5, 0.25, 0.125))
    found = trials.search((1000, 4000) if quick else (1000, 3000, 10_000, 30_000, 100_000))
    speed = pd.DataFrame(
        [
            {
                "part": "settle",
                "cubes": settled.site.cubes,
                "time": settled.heap.time,
                "seconds": settled.seconds,
            },
            {"part": "dig", "cubes": settled.site.cubes, "time": dug.heap.time, "seconds": dug.seconds},
        ]
    )
    tables = {
        "soil": dug.table, "machine": dug.machine, "cubes": dug.snapshots, "bushings": bushings,
        "search": found, "speed": speed, "impacts": kept,
    }  # fmt: skip
    return Scene(
        "bucket", "a backhoe's bucket in a soil of cubes",
        tuple(_checks(settled, dug, bushings, found, kept, quick)),
        work, tuple(trials.extremes()), (_sleep(settled if quick else settle(NARROW, 0.5)),),
        tables, "distance of the cutting edge from that of the machine on hinges, m",
    )  # fmt: skip


def _checks(
    settled: Settled, dug: Dug, bushings: pd.DataFrame, found: pd.DataFrame, kept: pd.DataFrame, quick: bool
) -> Iterator[Found]:
    yield from trials.checks(kept)
    weight = settled.site.cubes * trials.MASS * trials.FREE_FALL
    yield check("force on the bin, N", settled.carried, weight, 1e-3, "the weight of the cubes")
    yield vanishes("energy unaccounted for while they fall, of that dissipated", settled.unaccounted, 0.01,
                "energy and dissipation")  # fmt: skip
    work = float(dug.machine["work"].iloc[-1])
    # The narrow, short cut of a quick run dissipates less beside the same steps.
    bound = 0.02 if quick else 0.01
    yield check("work of the drives, J", work, work - dug.unexplained, bound, "energy and dissipation")
    slope = exponent(bushings["stiffness"], bushings["error"])
    yield check("exponent of a bushing's error by its stiffness", slope, -1.0, 0.1, "1/k", "absolute")
    slope = exponent(bushings["stiffness"], bushings["step"])
    yield check("exponent of its longest step", slope, -0.5, 0.05, "1/sqrt k", "absolute")
    if not quick:
        cost = exponent(found["cubes"], found["seconds"])
        yield check("exponent of the cost of search", max(cost, 1.0), 1.0, 0.1, "cells", "absolute")


def _sleep(settled: Settled, duration: float = 0.1) -> Found:
    """Cubes that sleep are left out: the heap stays the same."""
    model = backhoe(away).build()
    awake = soil(settled.site, model)
    drowsy = soil(settled.site, model, Sleep.under(trials.FREE_FALL, SIDE))
    fixed = motion_of(model, away, np.zeros(1))

    def still(steps: int) -> Motion:
        return Motion(*(np.repeat(part, steps + 1, axis=0) for part in fixed))

    h = awake.longest_step
    rest, steps = round(0.6 / h), round(duration / h)
    heap, _ = awake.advance(settled.heap, rest, h, still(rest))
    heap, _ = drowsy.advance(heap, rest // 2, h, still(rest // 2))
    woken = replace(heap, asleep=np.zeros_like(heap.asleep))

    def everything() -> Floats:
        return awake.advance(woken, steps, h, still(steps))[0].position

    def less() -> Floats:
        return drowsy.advance(heap, steps, h, still(steps))[0].position

    size = float(np.max(np.abs(heap.position)))
    share = 100.0 * float(np.mean(heap.asleep))
    return left_out(
        f"cubes that sleep, {share:.0f} % of {len(heap.asleep)}", everything, less, SAME / size, 2
    )
