"""The soil: cubes that fall into a bin and settle, and the bucket that digs in them."""

from dataclasses import dataclass, replace
from time import process_time

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from bench.scenes.bucket.backhoe import (
    BODIES,
    EDGE,
    GRAVITY,
    Path,
    backhoe,
    bucket_plates,
    digging,
    motion_of,
)  # fmt: skip
from bench.soil.parts import Heap, Law, Plates, Sleep
from bench.soil.pile import Pile
from protochain.core.arrays import Floats
from protochain.mechanics.motion import Applied, Load
from protochain.mechanics.multibody import Frames
from protochain.mechanisms import Model

SIDE, DENSITY, STIFFNESS, FRICTION = 0.02, 2000.0, 1e5, 0.5
"""m, kg/m^3, N/m and 1: chosen."""
PITCH = 1.76 * SIDE
"""Of cubes before they fall: turned anyhow, they reach sqrt 3 edges."""
WINDOW = 1e-3
"""s. Over which forces on the bucket are averaged: far longer than an impact, far shorter than the way."""


@dataclass(frozen=True)
class Site:
    """Bin and number of cubes.

    low, high (2,) m: Corners of the bin's floor, at z = 0.
    seed: Of the cubes' rotations.
    """

    low: tuple[float, float]
    high: tuple[float, float]
    cubes: int
    seed: int = 0


WIDE = Site((0.4, -0.13), (0.96, 0.13), 2000)
NARROW = Site((0.4, -0.09), (0.96, 0.09), 400)


def bin_plates(site: Site, body: int) -> Plates:
    """Floor and walls of the bin, thick, on a body that stands still."""
    (x0, y0), (x1, y1) = site.low, site.high
    x, y, thick, high = 0.5 * (x0 + x1), 0.5 * (y0 + y1), 0.05, 1.0
    a, b = 0.5 * (x1 - x0), 0.5 * (y1 - y0)
    boxes = [
        ((x, y, -thick), (a + 2 * thick, b + 2 * thick, thick)),
        ((x0 - thick, y, high), (thick, b + 2 * thick, high)),
        ((x1 + thick, y, high), (thick, b + 2 * thick, high)),
        ((x, y0 - thick, high), (a, thick, high)),
        ((x, y1 + thick, high), (a, thick, high)),
    ]
    centre, half = np.array([box[0] for box in boxes]), np.array([box[1] for box in boxes])
    return Plates(np.full(5, body), centre, np.tile(np.eye(3), (5, 1, 1)), half)


def soil(site: Site, model: Model, sleep: Sleep | None = None) -> Pile:
    """Cubes, with the bin and the bucket."""
    one, other = bin_plates(site, len(BODIES)), bucket_plates(model.bodies.number("bucket"), model)
    both = Plates(
        *(
            np.concatenate([getattr(p, name) for p in (one, other)])
            for name in ("body", "centre", "rotation", "half")
        )
    )
    n = site.cubes
    return Pile(
        np.full(n, SIDE), np.full(n, DENSITY * SIDE**3), Law(STIFFNESS, FRICTION), np.array(GRAVITY),
        plates=both, sleep=sleep,
    )  # fmt: skip


def before_the_fall(site: Site) -> tuple[Floats, Floats]:
    """Places and rotations of the cubes, in layers above the bin."""
    rng = np.random.default_rng(site.seed)
    low, high = np.array(site.low), np.array(site.high)
    counts = ((high - low) / PITCH).astype(int)
    layer = counts[0] * counts[1]
    numbers = np.arange(site.cubes)
    x, y = numbers % layer % counts[0], numbers % layer // counts[0]
    pitch = (high - low) / counts
    places = np.column_stack([low[0] + (x + 0.5) * pitch[0], low[1] + (y + 0.5) * pitch[1],
                              (numbers // layer + 0.5) * PITCH])  # fmt: skip
    return places, Rotation.random(site.cubes, rng=rng).as_matrix()


def away(t: float) -> tuple[Floats, Floats, Floats]:
    """The machine, folded away above the bin."""
    return np.array([-1.2, 0.3, 0.5]), np.zeros(3), np.zeros(3)


@dataclass(frozen=True, eq=False)
class Settled:
    """Soil at rest.

    level m: How high it lies.
    carried N: Force on the bin, upward, over the last tenth of a second, with what speeds the cubes up.
    unaccounted: Energy that came from nothing, of that dissipated.
    seconds: Processor seconds.
    """

    site: Site
    heap: Heap
    level: float
    carried: float
    unaccounted: float
    seconds: float


def settle(site: Site, duration: float, split: int = 1) -> Settled:
    """Let the cubes fall and come to rest; steps may be split into shorter ones."""
    began = process_time()
    model = backhoe(away).build()
    pile = soil(site, model)
    h = pile.longest_step / split
    places, rotations = before_the_fall(site)
    fixed = motion_of(model, away, np.zeros(1))
    start = heap = pile.start(places, rotations, motion=fixed)
    last = round(0.1 / h)
    for steps in (round(duration / h) - last, last):
        before = heap
        standing = type(fixed)(*(np.repeat(part, steps + 1, axis=0) for part in fixed))
        heap, reaction = pile.advance(heap, steps, h, standing)
    lifted = float(np.sum(pile.mass * (heap.velocity - before.velocity)[:, 2])) / (last * h)
    carried = -float(np.mean(reaction[:, len(BODIES), 5])) - lifted
    top = float(np.quantile(heap.position[:, 2], 0.95)) + 0.5 * SIDE
    off = abs(pile.total(heap) - pile.total(start)) / heap.dissipated
    return Settled(site, heap, top, carried, off, process_time() - began)


@dataclass(frozen=True, eq=False)
class Dug:
    """The bucket's work.

    heap: Soil at the end.
    table: Energies of the soil, work of the bucket, cubes asleep and in the bucket, by time.
    snapshots: Places and rotations of the cubes at some times.
    machine: Angles of the hinges, torques and work of the drives, energy of the machine, by time.
    unexplained J: Work of the drives that is neither energy, of machine or soil, nor dissipation.
    seconds: Processor seconds.
    """

    heap: Heap
    table: pd.DataFrame
    snapshots: pd.DataFrame
    machine: pd.DataFrame
    unexplained: float
    seconds: float


def dig(
    settled: Settled, duration: float = 1.0, depth: float = 0.3, sleep: Sleep | None = None, looks: int = 50
) -> Dug:
    """Dig, from soil at rest, to a part of its depth."""
    path = digging(settled.level, duration, depth)
    model = backhoe(path).build()
    pile = soil(settled.site, model, sleep)
    # Whole steps to a window, and whole windows to a look.
    per_window = int(np.ceil(WINDOW / pile.longest_step))
    windows = round(duration / looks / WINDOW)
    h, steps = duration / looks / windows / per_window, windows * per_window
    first = settled.heap
    heap = replace(first, time=0.0, sums=np.zeros_like(first.sums))
    heap = pile.start(
        heap.position, heap.rotation, heap.velocity, heap.spin, motion_of(model, path, np.zeros(1))
    )
    rows, shots, forces, seconds = [], [_snapshot(heap)], [], 0.0
    rows.append(_row(pile, heap, model, path))
    for look in range(looks):
        times = h * np.arange(look * steps, (look + 1) * steps + 1, dtype=np.float64)
        motion = motion_of(model, path, times)
        began = process_time()
        heap, reaction = pile.advance(heap, steps, h, motion)
        seconds += process_time() - began
        forces.append(reaction[:, : model.tree.n_bodies].reshape(windows, per_window, -1, 6).mean(axis=1))
        rows.append(_row(pile, heap, model, path))
        if (look + 1) % max(looks // 5, 1) == 0:
            shots.append(_snapshot(heap))
    machine = _drives(path, np.concatenate(forces), h * per_window, duration)
    table = pd.DataFrame(rows)
    work = machine["work"].iloc[-1]
    gained = machine["energy"].iloc[-1] - machine["energy"].iloc[0]
    soil_gained = table["kinetic"] + table["potential"] + table["stored"] + table["dissipated"]
    off = work - gained - (soil_gained.iloc[-1] - soil_gained.iloc[0])
    return Dug(heap, table, pd.concat(shots, ignore_index=True), machine, float(off), seconds)


def _row(pile: Pile, heap: Heap, model: Model, path: Path) -> dict[str, float]:
    held = inside_bucket(heap, model, path)
    return {
        "time": heap.time, "kinetic": pile.kinetic(heap), "potential": pile.potential(heap),
        "stored": heap.stored, "dissipated": heap.dissipated, "work": heap.work,
        "asleep": int(np.sum(heap.asleep)), "in_bucket": int(np.sum(held)),
    }  # fmt: skip


def inside_bucket(heap: Heap, model: Model, path: Path) -> np.ndarray:
    """(n,) bool: cubes whose centres are in the bucket."""
    state = model.state(model.system.at(path(heap.time)[0], path(heap.time)[1], heap.time))
    seen = (heap.position - state.point("bucket")) @ state.rotation("bucket")
    low, high = np.array([EDGE[0], -0.06, EDGE[2]]), np.array([-EDGE[0], 0.06, 0.02])
    return np.asarray(np.all((seen > low) & (seen < high), axis=1))


def _snapshot(heap: Heap) -> pd.DataFrame:
    columns = np.column_stack([heap.position, heap.quaternion])
    table = pd.DataFrame(columns, columns=["x", "y", "z", "qw", "qx", "qy", "qz"])
    table.insert(0, "time", heap.time)
    return table


def _drives(path: Path, forces: Floats, window: float, duration: float) -> pd.DataFrame:
    """The machine under the forces of the soil (windows, nb, 6): what its drives do."""

    def applied(t: float, q: Floats, qd: Floats, frames: Frames) -> Applied:
        place = np.clip(t / window - 0.5, 0.0, len(forces) - 1.0)
        k = min(int(place), len(forces) - 2)
        return Applied(forces[k] + (place - k) * (forces[k + 1] - forces[k]))

    machine = backhoe(path)
    machine.force("soil", Load(applied, depends_on_velocity=False))
    run = machine.build().simulate(duration, window)
    table = pd.DataFrame({"time": run.time, "energy": run.total, "work": run.work[:, -1]})
    table[["boom", "stick", "bucket"]] = run.q
    return table
