"""A digging cycle: in, along, up, aside; cubes and machine push each other."""

from dataclasses import dataclass, replace
from time import process_time

import numpy as np
import pandas as pd

from bench.scenes.backhoe.machine import Design, Path, posture, through, vehicle
from bench.scenes.bucket.backhoe import EDGE, GRAVITY, bucket_shape
from bench.scenes.bucket.dig import DENSITY, FRICTION, SIDE, Site, before_the_fall, bin_plates
from bench.soil.parts import Heap, Motion, Plates
from bench.soil.parts import Law as CubeLaw
from bench.soil.pile import Pile
from bench.soil.soil import Digging, Soil
from protochain.core.arrays import Floats
from protochain.mechanisms import Plane, Run, State, Surface
from protochain.mechanisms.assembly import Assembly

STEP = 1e-3
"""s. Of the machine; cubes take as many shorter ones as they need."""
WALL = 0.1
"""m. Half the height of the walls of the bin, once all cubes lie in it."""
FULL, SMALL = Site((0.5, -0.09), (0.84, 0.09), 200), Site((0.5, -0.09), (0.84, 0.09), 60)
SOFT = 2e4
"""N/m. Stiffness of the cubes, which sets their steps."""
SWING, ASIDE, END = (0.75, 0.5), np.deg2rad(60.0), 1.3
"""s, rad, s. When the house begins to turn, and how long it does; how far; end of a cycle."""


@dataclass(frozen=True, eq=False)
class Ground:
    """Cubes at rest in a bin.

    pile: Cubes, the bin on body 0, the bucket on body 1.
    level m: How high they lie.
    """

    pile: Pile
    heap: Heap
    level: float


def settled(site: Site, duration: float = 0.4) -> Ground:
    """Let cubes fall into a bin, and come to rest."""
    high, n = bin_plates(site, 0), site.cubes
    pile = Pile(
        np.full(n, SIDE), np.full(n, DENSITY * SIDE**3), CubeLaw(SOFT, FRICTION, by="volume"),
        np.array(GRAVITY), plates=high,
    )  # fmt: skip
    h = pile.longest_step
    places, rotations = before_the_fall(site)
    steps = round(duration / h)
    fixed = Motion(
        np.zeros((steps + 1, 1, 3)), np.tile(np.eye(3), (steps + 1, 1, 1, 1)), np.zeros((steps + 1, 1, 6))
    )
    heap, _ = pile.advance(pile.start(places, rotations, motion=fixed), steps, h, fixed)
    # Lower walls, over which the bucket can swing: the same plates for what touches them.
    centre, half = high.centre.copy(), high.half.copy()
    centre[1:, 2], half[1:, 2] = WALL, WALL
    both = [replace(high, centre=centre, half=half), bucket_shape(1)]
    names = ("body", "centre", "rotation", "half")
    plates = Plates(*(np.concatenate([getattr(part, name) for part in both]) for name in names))
    heap = replace(heap, time=0.0, sums=np.append(np.zeros(4), heap.sums[4]))
    top = float(np.quantile(heap.position[:, 2], 0.95)) + 0.5 * SIDE if n else 0.0
    return Ground(replace(pile, plates=plates), heap, top)


def working(level: float, depth: float = 0.4) -> Path:
    """Cycle: the bucket goes into soil of a level, along and up; the house slews; it is held aside."""
    deep = depth * level
    marks = [
        (0.0, 0.82, 0.03, -75.0),
        (0.15, 0.80, -0.75 * deep, -75.0),
        (0.4, 0.64, -deep, -50.0),
        (0.6, 0.54, -0.25 * deep, -12.0),
        (0.8, 0.55, 0.15, 5.0),
        (1.25, 0.8, 0.3, 5.0),
    ]
    times = np.array([mark[0] for mark in marks])
    arm = through(times, np.array([posture((x, level + z), np.deg2rad(tilt)) for _, x, z, tilt in marks]))

    def path(t: float) -> tuple[Floats, Floats, Floats]:
        # The house turns by itself, or a spline through all would swing to and fro in the soil.
        s = min(max((t - SWING[0]) / SWING[1], 0.0), 1.0)
        rise = (
            s**3 * (10.0 - 15.0 * s + 6.0 * s**2), 30.0 * s**2 * (1.0 - s) ** 2 / SWING[1],
            60.0 * s * (1.0 - s) * (1.0 - 2.0 * s) / SWING[1] ** 2,
        )  # fmt: skip
        return tuple(np.append(ASIDE * own, each[1:]) for own, each in zip(rise, arm(t), strict=True))  # type: ignore[return-value]  # mypy does not count them

    return path


@dataclass(frozen=True, eq=False)
class Worked:
    """A cycle that was run.

    run: The machine's motion.
    soil: The cubes.
    seconds: Processor seconds.
    """

    design: Design
    run: Run
    soil: Digging
    seconds: float

    @property
    def model(self) -> Assembly:
        """The machine."""
        return self.run.model

    def state(self, row: int) -> State:
        """The machine at a row."""
        run = self.run
        return self.model.state(self.model.system.at(run.q[row], run.qd[row], float(run.time[row])))


def work(
    design: Design, ground: Ground, until: float = END, step: float = STEP, every: int = 1,
    floor: Surface | Plane | None = None, path: Path | None = None,
) -> Worked:  # fmt: skip
    """Run a cycle."""
    machine = vehicle(design, path or working(ground.level), floor or Plane())
    machine.add(Soil("soil", ("world", "bucket"), ground.pile, ground.heap))
    model = machine.build()
    began = process_time()
    run = model.simulate(until, step, every=every)
    (soil,) = (each for each in model.memories if isinstance(each, Digging))
    return Worked(design, run, soil, process_time() - began)


def in_bucket(heap: Heap, state: State) -> int:
    """Number of cubes whose centres are in the bucket."""
    seen = (heap.position - state.point("bucket")) @ state.rotation("bucket")
    low, high = np.array([EDGE[0], -0.06, EDGE[2]]), np.array([-EDGE[0], 0.06, 0.02])
    return int(np.sum(np.all((seen > low) & (seen < high), axis=1)))


def soil_table(soil: Digging) -> pd.DataFrame:
    """The soil after each step: energies, work, momentum, and the mean force on the bucket."""
    rows = pd.DataFrame([look[:6] for look in soil.looks], columns=list(soil.looks[0]._fields[:6]))
    momentum: Floats = np.array([look.momentum for look in soil.looks])
    pushes: Floats = np.array([look.pushes[1] for look in soil.looks])
    rows[[f"momentum {axis}" for axis in "xyz"]] = momentum
    rows[[f"force {axis}" for axis in "xyz"]] = pushes
    return rows
