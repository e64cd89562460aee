"""Soil that a mechanism digs in: a heap of cubes, moved by its bodies, that pushes them back.

Both take steps in turn. After a step of the mechanism the cubes take many short ones, while their plates go
as the bodies have gone; what they do to the bodies, on average over the step, is extrapolated to the next.
So the mechanism has every impulse of the cubes two steps later at most, and momentum is kept. Spin, and what
the two count as work, differ by errors that fall with the step.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from bench.soil.parts import Heap, Motion
from bench.soil.pile import Pile
from protochain.core.arrays import Floats, Integers, freeze
from protochain.core.errors import MechanicsError
from protochain.mechanics import multibody
from protochain.mechanics.motion import Applied, Load, Phase
from protochain.mechanics.multibody import Frames
from protochain.mechanisms.bodies import Bodies
from protochain.mechanisms.elements import Acting, Named


class Look(NamedTuple):
    """The soil after a step of the mechanism.

    kinetic, potential, stored, dissipated: Energies of the cubes.
    work: What plates have done to them.
    momentum (3,): Of the cubes.
    pushes (k, 3): Mean force on each of the soil's bodies over the step.
    """

    time: float
    kinetic: float
    potential: float
    stored: float
    dissipated: float
    work: float
    momentum: Floats
    pushes: Floats


@dataclass(frozen=True, eq=False)
class Soil(Named):
    """Cubes that push back.

    name: Name.
    bodies: Bodies that have the plates of the pile, by ``pile.plates.body``, each in the body's own axes;
        "world" stands still.
    pile: Cubes and plates.
    heap: The cubes at the start.
    least: Steps of the cubes to one of the mechanism, at least; as many more as they need.
    """

    noun: ClassVar[str] = "soil"

    bodies: Sequence[str]
    pile: Pile
    heap: Heap
    least: int = 1

    def __post_init__(self) -> None:
        n = self.pile.plates.n_bodies
        if len(self.bodies) < n:
            raise MechanicsError(
                f"{self.label}: a plate is on body {n - 1}, but {len(self.bodies)} are named; name each"
            )
        if self.least < 1:
            raise MechanicsError(f"{self.label}: least {self.least}: give a whole number from 1")

    def bind(self, bodies: Bodies) -> Acting:
        """Return what acts: forces whose work is counted, and the cubes, which remember."""
        found = Digging(bodies, self)
        return Acting(load=Load(found.applied, depends_on_velocity=False), memory=found)


@dataclass(frozen=True, eq=False)
class _Stopped:
    """What a run that goes on begins with."""

    heap: Heap
    mean: Floats
    pushes: Floats
    looks: tuple[Look, ...]


class Digging:
    """Cubes as a mechanism moves them. What changes in a run is the heap, after each of its steps.

    bodies: Bodies of the mechanism.
    soil: Cubes.
    heap: The cubes, after the last step of the last run.
    looks: The soil after each of its steps.
    """

    def __init__(self, bodies: Bodies, soil: Soil) -> None:
        self.tree, self.soil = bodies.tree, soil
        self.numbers = np.array([bodies.number(name, soil.label) for name in soil.bodies], dtype=np.int64)
        plates = soil.pile.plates
        # From the bodies' own axes to those of the tree's frames.
        axes = np.array([bodies.axes(b) for b in self.numbers[plates.body]]).reshape(-1, 3, 3)
        plates = replace(
            plates, centre=np.einsum("mij,mj->mi", axes, plates.centre), rotation=axes @ plates.rotation
        )
        self.pile = replace(soil.pile, plates=plates)
        self._before: Phase | None = None
        self._ended: tuple[Phase | None, _Stopped] = None, self._fresh()
        self._resume(self._ended[1])

    def _fresh(self) -> _Stopped:
        none = np.zeros((len(self.numbers), 6))
        return _Stopped(self.soil.heap, none, none, ())

    def _resume(self, where: _Stopped) -> None:
        self.heap, self.looks = where.heap, list(where.looks)
        self.mean, self.pushes = where.mean, where.pushes

    def applied(self, time: float, q: Floats, qd: Floats, frames: Frames) -> Applied:
        """Return what the cubes do in this step."""
        wrenches = np.zeros((self.tree.n_bodies, 6))
        for b, push in zip(self.numbers, self.pushes, strict=True):
            if b >= 0:
                wrenches[b] += push
        return Applied(wrenches)

    def begin(self, start: Phase) -> None:
        """Begin a run; one that goes on where the last ended has its cubes."""
        self._before = None
        self._resume(self._ended[1] if start is self._ended[0] else self._fresh())

    def end(self, at: Phase | None) -> None:
        """End a run; its cubes stay to be looked at, its forces do not."""
        self._ended = at, _Stopped(self.heap, self.mean, self.pushes, tuple(self.looks))
        self.recall(None)

    @property
    def kept(self) -> Floats:
        """Wrenches (k, 6) on the bodies of the soil."""
        return self.pushes

    def recall(self, kept: Floats | None) -> None:
        """Let the forces be those of a row."""
        self.pushes = np.zeros((len(self.numbers), 6)) if kept is None else kept

    def settle(self, at: Phase) -> None:
        """End a step: the cubes take theirs."""
        before, self._before = self._before, at
        if before is None or not at.time > before.time:
            return
        span = at.time - before.time
        steps = max(self.soil.least, int(np.ceil(span / self.pile.longest_step * (1.0 - 1e-9))))
        motion = between(self._frames(before), self._frames(at), span, steps)
        heap, reaction = self.pile.advance(self.heap, steps, span / steps, motion)
        mean = np.mean(reaction, axis=0)
        self.heap, self.mean, self.pushes = heap, mean, freeze(2.0 * mean - self.mean)
        self.looks.append(self._look(at.time))

    def _frames(self, at: Phase) -> tuple[Floats, Floats, Floats]:
        """Origins, rotations and twists of the soil's bodies."""
        frames, k = at.factors.frames, len(self.numbers)
        twists = multibody.velocities(self.tree, frames, at.qd)
        origin, rotation, twist = np.zeros((k, 3)), np.tile(np.eye(3), (k, 1, 1)), np.zeros((k, 6))
        moving = self.numbers >= 0
        own: Integers = self.numbers[moving]
        origin[moving], rotation[moving], twist[moving] = (
            frames.origin[own],
            frames.rotation[own],
            twists[own],
        )
        return origin, rotation, twist

    def _look(self, time: float) -> Look:
        pile, heap = self.pile, self.heap
        return Look(
            time, pile.kinetic(heap), pile.potential(heap), heap.stored, heap.dissipated, heap.work,
            pile.mass @ heap.velocity, self.mean[:, 3:],
        )  # fmt: skip


def between(
    first: tuple[Floats, Floats, Floats], last: tuple[Floats, Floats, Floats], span: float, steps: int
) -> Motion:
    """Motion of bodies from one moment to another: places and turns of order three in time."""
    (x0, r0, v0), (x1, r1, v1) = first, last
    turn = Rotation.from_matrix(r1 @ r0.swapaxes(1, 2)).as_rotvec()
    # Rate of the rotation vector at the end: of small turns, w - turn x w / 2 and so on.
    rate = v1[:, :3] - 0.5 * np.cross(turn, v1[:, :3]) + np.cross(turn, np.cross(turn, v1[:, :3])) / 12.0
    s = np.linspace(0.0, 1.0, steps + 1)[:, None, None]
    place, speed = _hermite(s, span, x0, x1, v0[:, 3:], v1[:, 3:])
    angle, turning = _hermite(s, span, np.zeros_like(turn), turn, v0[:, :3], rate)
    spin = turning + 0.5 * np.cross(angle, turning) + np.cross(angle, np.cross(angle, turning)) / 6.0
    turned = Rotation.from_rotvec(angle.reshape(-1, 3)).as_matrix().reshape(*angle.shape, 3)
    return Motion(place, turned @ r0, np.concatenate([spin, speed], axis=2))


def _hermite(s: Floats, span: float, x0: Floats, x1: Floats, v0: Floats, v1: Floats) -> tuple[Floats, Floats]:
    """Cubic by values and rates at both ends, and its rate, at parts s of a span."""
    a, b = span * v0 - (x1 - x0), (x1 - x0) - span * v1
    value = (1.0 - s) * x0 + s * x1 + s * (1.0 - s) * ((1.0 - s) * a + s * b)
    rate = (x1 - x0) + (1.0 - 2.0 * s) * ((1.0 - s) * a + s * b) + s * (1.0 - s) * (b - a)
    return value, rate / span
