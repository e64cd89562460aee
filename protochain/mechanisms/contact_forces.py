"""Forces between bodies that press on each other, and the anchors of their friction from step to step."""

from typing import NamedTuple

import numpy as np

from protochain.core.arrays import Floats, Integers
from protochain.mechanics import multibody
from protochain.mechanics.motion import Applied, Phase
from protochain.mechanics.multibody import Frames, Tree, algebra
from protochain.mechanics.multibody.algebra import Vector, add, dot, kernel, scale, subtract
from protochain.mechanics.multibody.kinematics import end_of
from protochain.mechanisms.linear_springs import push, speed_of
from protochain.mechanisms.shapes import Finder, Touches

STIFFNESS, EXPONENT, DAMPING, FRICTION, SPRING, DASHPOT = range(6)
"""Constants of a contact."""


class Anchors(NamedTuple):
    """Anchors of friction springs: pairs (k, 2), and their ends (k, 6) in the frames of both bodies."""

    pair: Integers
    arms: Floats


NO_ANCHORS = Anchors(np.empty((0, 2), np.int64), np.empty((0, 6)))


class ContactForces:
    """Forces of a contact in a mechanism. Only the anchors change in a run, after each of its steps."""

    def __init__(self, tree: Tree, finder: Finder, constants: Floats) -> None:
        # Stiffness, exponent, damping of the normal force; coefficient, stiffness, damping of friction.
        self.tree, self.finder, self.constants = tree, finder, constants
        self.anchors = NO_ANCHORS
        self._last: tuple[Frames, Touches] | None = None
        self._settled: Frames | None = None
        self._ended: tuple[Phase | None, Anchors] = None, NO_ANCHORS

    def touches(self, frames: Frames) -> Touches:
        """Touches at one pose, which are asked for by the elastic force and the load."""
        if self._last is None or self._last[0] is not frames:
            self._last = frames, self.finder.touches(frames)
        return self._last[1]

    def add(self, q: Floats, frames: Frames, wrenches: Floats, torques: Floats) -> float:
        """Add the elastic forces."""
        energy: float = _press(frames.origin, *self.touches(frames)[1:], self.constants, wrenches)
        return energy

    def resist(self, time: float, q: Floats, qd: Floats, frames: Frames) -> Applied:
        """Damping and friction."""
        touches = self.touches(frames)
        wrenches = np.zeros((self.tree.n_bodies, 6))
        if len(touches.pair):
            twists, stretch = multibody.velocities(self.tree, frames, qd), self.stretches(frames, touches)
            _resist(frames.origin, twists, *touches[1:], stretch, self.constants, wrenches)
        return Applied(wrenches)

    def stretches(self, frames: Frames, touches: Touches) -> Floats:
        """(k, 3) float: springs of friction, zero for pairs without an anchor."""
        separation = np.zeros((len(touches.pair), 3))
        if len(self.anchors.pair):
            ends = touches.pair, touches.ends, touches.normal
            _stretch(frames.rotation, frames.origin, *ends, *self.anchors, separation)
        return separation

    def begin(self, start: Phase) -> None:
        """Begin a run. If it continues the last run, it has its anchors."""
        if start is self._ended[0]:
            self.anchors = self._ended[1]

    def end(self, at: Phase | None) -> None:
        """End a run, after which forces are again those without a past."""
        self._ended, self.anchors, self._settled = (at, self.anchors), NO_ANCHORS, None

    @property
    def kept(self) -> Anchors:
        """The anchors."""
        return self.anchors

    def recall(self, memory: Anchors | None) -> None:
        """Restore the anchors of friction of a row."""
        self.anchors = memory or NO_ANCHORS

    def settle(self, at: Phase) -> None:
        """End a step: drag anchors along, and place anchors of new touches."""
        frames = at.factors.frames
        touches = self.touches(frames)
        self.finder.refuse_depth(touches)
        if self._settled is not None:
            self.finder.refuse_passage(self._settled, frames)
        self._settled = frames
        if not self.constants[FRICTION] or not len(touches.pair):
            self.anchors = NO_ANCHORS
            return
        stretch = self.stretches(frames, touches)
        twists = multibody.velocities(self.tree, frames, at.qd)
        arms = np.empty((len(stretch), 6))
        _drag(frames.rotation, frames.origin, twists, *touches[1:], stretch, self.constants, arms)
        self.anchors = Anchors(touches.pair, arms)


@kernel
def _relative(origin: Floats, twists: Floats, a: int, b: int, place: Vector) -> Vector:
    """Velocity of a's point at a place relative to b's."""
    # Of the world, -1, any arm will do.
    of_a = speed_of(twists, a, subtract(place, algebra.vector(origin, a)))
    return subtract(of_a, speed_of(twists, b, subtract(place, algebra.vector(origin, b))))


@kernel
def _apply(force: Vector, origin: Floats, a: int, b: int, place: Vector, wrenches: Floats) -> None:
    """Add a force on a at a place, and its reaction on b."""
    push(force, subtract(place, algebra.vector(origin, a)), a, wrenches)
    push(scale(-1.0, force), subtract(place, algebra.vector(origin, b)), b, wrenches)


@kernel
def _press(
    origin: Floats, ends: Integers, place: Floats, normal: Floats, depth: Floats, constants: Floats,
    wrenches: Floats,
) -> float:  # fmt: skip
    """Add the elastic forces. Return their energy."""
    energy, exponent = 0.0, constants[EXPONENT]
    for k in range(len(depth)):
        size, at = constants[STIFFNESS] * depth[k] ** exponent, algebra.vector(place, k)
        energy += size * depth[k] / (exponent + 1.0)
        _apply(scale(size, algebra.vector(normal, k)), origin, ends[k, 0], ends[k, 1], at, wrenches)
    return energy


@kernel
def _forces(
    moving: Vector, normal: Vector, depth: float, stretch: Vector, constants: Floats
) -> tuple[float, float, Vector, Vector]:
    """Elastic force, whole normal force, tangential velocity, and force of friction before it is capped."""
    elastic = constants[STIFFNESS] * depth ** constants[EXPONENT]
    closing = -dot(moving, normal)
    pressed = max(0.0, elastic * (1.0 + constants[DAMPING] * closing))
    slip = add(moving, scale(closing, normal))
    trial = add(scale(-constants[SPRING], stretch), scale(-constants[DASHPOT], slip))
    return elastic, pressed, slip, trial


@kernel
def _resist(
    origin: Floats, twists: Floats, ends: Integers, place: Floats, normal: Floats, depth: Floats,
    stretch: Floats, constants: Floats, wrenches: Floats,
) -> None:  # fmt: skip
    """Add damping and friction."""
    for k in range(len(depth)):
        a, b, at, out = ends[k, 0], ends[k, 1], algebra.vector(place, k), algebra.vector(normal, k)
        moving = _relative(origin, twists, a, b, at)
        elastic, pressed, _, trial = _forces(moving, out, depth[k], algebra.vector(stretch, k), constants)
        size, limit = np.sqrt(dot(trial, trial)), constants[FRICTION] * pressed
        force = add(scale(pressed - elastic, out), scale(limit / size if size > limit else 1.0, trial))
        _apply(force, origin, a, b, at, wrenches)


@kernel
def _drag(
    rotation: Floats, origin: Floats, twists: Floats, ends: Integers, place: Floats, normal: Floats,
    depth: Floats, stretch: Floats, constants: Floats, arms: Floats,
) -> None:  # fmt: skip
    """Place anchors at the present places if friction allows it, so rolling balls do not seem to slip."""
    # An anchor is dragged to where the spring alone has the greatest friction.
    for k in range(len(depth)):
        a, b, at, spring = ends[k, 0], ends[k, 1], algebra.vector(place, k), algebra.vector(stretch, k)
        moving = _relative(origin, twists, a, b, at)
        _, pressed, _, _ = _forces(moving, algebra.vector(normal, k), depth[k], spring, constants)
        pull = constants[SPRING] * np.sqrt(dot(spring, spring))
        limit = constants[FRICTION] * pressed
        if pull > limit:
            spring = scale(limit / pull, spring)
        algebra.put(_inside(rotation, origin, a, at), arms, k, 0)
        algebra.put(_inside(rotation, origin, b, subtract(at, spring)), arms, k, 3)


@kernel
def _inside(rotation: Floats, origin: Floats, b: int, place: Vector) -> Vector:
    """Place in the frame of a body."""
    if b < 0:
        return place
    return algebra.rotate_back(algebra.matrix(rotation, b), subtract(place, algebra.vector(origin, b)))


@kernel
def _stretch(
    rotation: Floats, origin: Floats, pair: Integers, ends: Integers, normal: Floats, anchored: Integers,
    arms: Floats, separation: Floats,
) -> None:  # fmt: skip
    """Write the springs of friction from their anchors, for pairs in order."""
    # A ball that has come to another triangle takes its anchor along, if it had but one and has but one.
    n, m, first = len(pair), len(anchored), 0
    for k in range(n):
        while first < m and anchored[first, 0] < pair[k, 0]:
            first += 1
        anchor, last = -1, first
        while last < m and anchored[last, 0] == pair[k, 0]:
            if anchored[last, 1] == pair[k, 1]:
                anchor = last
            last += 1
        alone = (k == 0 or pair[k - 1, 0] != pair[k, 0]) and (k + 1 == n or pair[k + 1, 0] != pair[k, 0])
        if anchor < 0 and last == first + 1 and alone:
            anchor = first
        if anchor >= 0:
            _, place_a = end_of(rotation, origin, ends[k, 0], algebra.vector(arms, anchor, 0))
            _, place_b = end_of(rotation, origin, ends[k, 1], algebra.vector(arms, anchor, 3))
            spring, out = subtract(place_a, place_b), algebra.vector(normal, k)
            algebra.put(subtract(spring, scale(dot(spring, out), out)), separation, k, 0)
