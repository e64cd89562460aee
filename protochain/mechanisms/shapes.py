"""Touches of balls with planes, surfaces and each other."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from protochain.core.arrays import Floats, Integers, read_only
from protochain.core.checks import brief
from protochain.core.errors import MechanicsError
from protochain.core.settings import document_fields
from protochain.mechanics.multibody import Frames
from protochain.mechanics.multibody.algebra import dot, kernel, put, scale, subtract, vector, vector_at
from protochain.mechanics.multibody.kinematics import end_of
from protochain.mechanisms.bodies import WORLD, Bodies
from protochain.mechanisms.element_arguments import number, numbers
from protochain.mechanisms.search import BoxTree, box_tree, overlapping, touching
from protochain.mechanisms.triangles import least_distances


@document_fields
@dataclass(frozen=True)
class Ball:
    """Sphere fixed in a body. With a radius of zero, a point, as the corner of a block."""

    body: str  # Name of the body, or ``"world"``.
    radius: float  # Radius.
    at: ArrayLike = (0.0, 0.0, 0.0)  # (3,) float: Centre, in the body's axes.

    def __post_init__(self) -> None:
        if not isinstance(self.body, str):
            raise MechanicsError(f"a ball's body {brief(self.body)}: give the name of a body")
        if number(self.radius, f'the radius of a ball of "{self.body}"') < 0.0:
            raise MechanicsError(f'the radius {self.radius:g} of a ball of "{self.body}" is negative')
        numbers(self.at, f'the centre of a ball of "{self.body}"')


@document_fields
@dataclass(frozen=True)
class Plane:
    """Half-space fixed in a body. All points below the plane are inside, however deep."""

    body: str = WORLD  # Name of the body, or ``"world"``.
    at: ArrayLike = (0.0, 0.0, 0.0)  # (3,) float: A point of the plane, in the body's axes.
    normal: ArrayLike = (0.0, 0.0, 1.0)  # (3,) float: Direction out of the half-space, in the body's axes.


@document_fields
@dataclass(frozen=True)
class Surface:
    """Triangles fixed in a body, with two sides."""

    body: str  # Name of the body, or ``"world"``.
    vertices: ArrayLike  # (n, 3) float: Corners, in the body's axes.
    faces: ArrayLike  # (m, 3) int: Corners of each triangle.


Obstacle = Plane | Surface | None
Other = Obstacle | Sequence[Ball]
"""Obstacles of balls. None is each other."""


class Touches(NamedTuple):
    """Overlap of two bodies a and b."""

    pair: Integers  # (k, 2) int: Number of the ball, and of what it touches, in order.
    ends: Integers  # (k, 2) int: Bodies a and b; -1 is the world.
    place: Floats  # (k, 3): Middle of the overlap.
    normal: Floats  # (k, 3): Unit vectors from b to a.
    depth: Floats  # (k,): Overlaps, all positive.


class Balls(NamedTuple):
    """Balls of a tree: bodies (n,), centres (n, 3) along the axes of the tree's frames, radii (n,)."""

    body: Integers
    at: Floats
    radius: Floats

    def centres(self, frames: Frames) -> Floats:
        """(n, 3) float: centres in the world."""
        centres: Floats = _centres(frames.rotation, frames.origin, self.body, self.at)
        return centres


def balls_of(bodies: Bodies, balls: Sequence[Ball], asking: str) -> Balls:
    """Balls by numbers of bodies."""
    if not balls:
        raise MechanicsError(f"{asking}: give at least one ball")
    body = [bodies.number(ball.body, asking) for ball in balls]
    at = [bodies.inside(b, np.asarray(ball.at, dtype=float)) for b, ball in zip(body, balls, strict=True)]
    return Balls(read_only(body, np.int64), read_only(at), read_only([ball.radius for ball in balls]))


@dataclass(frozen=True, eq=False)
class OnPlane:
    """Balls on a plane: its body, a point and its normal along the axes of the tree's frame."""

    balls: Balls
    body: int
    at: Floats
    normal: Floats

    def touches(self, frames: Frames) -> Touches:
        """Balls that reach below the plane."""
        return Touches(*_below(frames.rotation, frames.origin, *self.balls, self.body, self.at, self.normal))

    def refuse_depth(self, touches: Touches) -> None:
        """Nothing: a half-space is right at any depth."""

    def refuse_passage(self, before: Frames, after: Frames) -> None:
        """Nothing: whatever is below is inside."""


@dataclass(frozen=True, eq=False)
class Among:
    """Balls on balls of other bodies: all of them, or the first ``first`` on the others."""

    balls: Balls
    first: int
    name: str
    body: ClassVar[int] = 0

    def touches(self, frames: Frames) -> Touches:
        """Balls that overlap."""
        centre, balls = self.balls.centres(frames), self.balls
        pair = touching(centre, balls.radius)
        return Touches(*_normals_between(pair, centre, balls.body, balls.radius, self.first))

    def refuse_depth(self, touches: Touches) -> None:
        """Raise if a ball has all but passed through another."""
        radius = self.balls.radius[touches.pair]
        _refuse(self.name, radius.sum(axis=1) - touches.depth < 0.5 * radius.max(axis=1), touches)

    def refuse_passage(self, before: Frames, after: Frames) -> None:
        """Raise if balls have passed through each other on the straight way from one step to the next."""
        start, radius, body = self.balls.centres(before), self.balls.radius, self.balls.body
        move = self.balls.centres(after) - start
        way = np.linalg.norm(move, axis=1)
        if not np.any(way > 0.25 * radius):
            return
        pair = touching(start + 0.5 * move, radius + 0.5 * way)
        i, j = pair.T
        pairs = (body[i] != body[j]) & ((self.first == 0) | ((i < self.first) & (j >= self.first)))
        i, j = i[pairs], j[pairs]
        gap, moved = start[i] - start[j], move[i] - move[j]
        along = -np.sum(gap * moved, axis=1) / np.maximum(np.sum(moved**2, axis=1), np.finfo(float).tiny)
        # At the ends of the way the depth is looked at as it is.
        least = np.linalg.norm(gap + along[:, None] * moved, axis=1)
        _refuse_passage(
            self.name, i, (along > 0) & (along < 1) & (least < 0.5 * np.maximum(radius[i], radius[j]))
        )


@dataclass(frozen=True, eq=False)
class OnSurface:
    """Balls on triangles: body of the surface, corners (m, 3, 3) along the axes of the tree's frame."""

    balls: Balls
    body: int
    corners: Floats
    tree: BoxTree
    name: str

    def touches(self, frames: Frames) -> Touches:
        """Points of the surface within a ball that are nearer to its centre than those around them."""
        radius, (turn, at), centre = self.balls.radius, self._seat(frames), self._centres(frames)
        pair, point, distance = self._near(centre)
        i = pair[:, 0]
        normal = (centre[i] - point) / np.where(distance > 0.0, distance, 1.0)[:, None]
        depth = radius[i] - distance
        place = (point - 0.5 * depth[:, None] * normal) @ turn.T + at
        ends = np.column_stack([self.balls.body[i], np.full(len(i), self.body)])
        return Touches(pair, ends, place, normal @ turn.T, depth)

    def refuse_depth(self, touches: Touches) -> None:
        """Raise if a ball has all but passed through."""
        _refuse(self.name, touches.depth > 0.5 * self.balls.radius[touches.pair[:, 0]], touches)

    def refuse_passage(self, before: Frames, after: Frames) -> None:
        """Raise if a ball has passed through on the straight way from one step to the next."""
        start, radius = self._centres(before), self.balls.radius
        move = self._centres(after) - start
        parts = int(np.ceil(2.0 * np.max(np.linalg.norm(move, axis=1) / radius)))
        low, high = np.minimum(start, start + move), np.maximum(start, start + move)
        if parts < 2 or not len(overlapping(self.tree, low - radius[:, None], high + radius[:, None])):
            return
        for part in np.arange(1, parts) / parts:
            pair, _, distance = self._near(start + part * move)
            _refuse_passage(self.name, pair[:, 0], distance < 0.5 * radius[pair[:, 0]])

    def _seat(self, frames: Frames) -> tuple[Floats, Floats]:
        """Axes and origin of the surface."""
        if self.body < 0:
            return np.eye(3), np.zeros(3)
        return frames.rotation[self.body], frames.origin[self.body]

    def _centres(self, frames: Frames) -> Floats:
        """(n, 3) float: centres of the balls in the frame of the surface."""
        turn, at = self._seat(frames)
        return np.ascontiguousarray((self.balls.centres(frames) - at) @ turn)

    def _near(self, centre: Floats) -> tuple[Integers, Floats, Floats]:
        """Balls and triangles, the nearest points, and their distances."""
        radius = self.balls.radius[:, None]
        near = overlapping(self.tree, centre - radius, centre + radius)
        nearest: tuple[Integers, Floats, Floats] = least_distances(near, centre, radius[:, 0], self.corners)
        return nearest


def _refuse(name: str, mask: np.ndarray, touches: Touches) -> None:
    if np.any(mask):
        k = int(np.argmax(mask))
        raise MechanicsError(
            f"{name}: ball {touches.pair[k, 0]} is {touches.depth[k]:.3g} deep, beyond half a body; raise "
            "the stiffness or use shorter steps"
        )


def _refuse_passage(name: str, ball: Integers, mask: np.ndarray) -> None:
    if np.any(mask):
        raise MechanicsError(
            f"{name}: ball {ball[int(np.argmax(mask))]} passes through its obstacle within a step; "
            "use shorter steps"
        )


Finder = OnPlane | Among | OnSurface
"""Touches of some balls with an obstacle: a body, -1 for the world, or any number if these are balls."""


def finder(bodies: Bodies, balls: Sequence[Ball], obstacle: Other, name: str) -> Finder:
    """Finder of touches of balls with a plane, a surface, other balls, or each other (None)."""
    bound = balls_of(bodies, balls, name)
    if isinstance(obstacle, Plane):
        body = bodies.number(obstacle.body, name)
        normal = numbers(obstacle.normal, f"{name}: the normal of the plane")
        if not np.any(normal):
            raise MechanicsError(f"{name}: the normal of the plane has no direction")
        _refuse_own(bound, body, name)
        at = bodies.inside(body, numbers(obstacle.at, f"{name}: the point of the plane"))
        return OnPlane(bound, body, at, bodies.inside(body, normal / np.linalg.norm(normal)))
    if isinstance(obstacle, Surface):
        return _on_surface(bodies, bound, obstacle, name)
    if obstacle is None:
        return Among(bound, 0, name)
    return Among(balls_of(bodies, [*balls, *obstacle], name), len(balls), name)


def _on_surface(bodies: Bodies, balls: Balls, surface: Surface, name: str) -> OnSurface:
    body = bodies.number(surface.body, name)
    _refuse_own(balls, body, name)
    if not (balls.radius > 0.0).all():
        raise MechanicsError(f"{name}: a ball without radius cannot touch a surface; give it a radius")
    vertices, faces = np.asarray(surface.vertices, dtype=float), np.asarray(surface.faces)
    if vertices.ndim != 2 or vertices.shape[1] != 3 or faces.ndim != 2 or faces.shape[1] != 3:
        raise MechanicsError(f"{name}: vertices must be (n, 3) and faces (m, 3)")
    if not np.isfinite(vertices).all() or faces.dtype.kind not in "iu":
        raise MechanicsError(f"{name}: vertices must be finite, and faces integers")
    outside = ((faces < 0) | (faces >= len(vertices))).any(axis=1)
    if outside.any():
        raise MechanicsError(f"{name}: triangle {int(np.argmax(outside))} has a corner that is not a vertex")
    corners = vertices[faces]
    sides = corners[:, 1:] - corners[:, :1]
    flat = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1) <= 1e-12 * np.sum(sides**2, axis=(1, 2))
    if flat.any():
        raise MechanicsError(f"{name}: triangle {int(np.argmax(flat))} has no area")
    corners = corners @ bodies.axes(body).T
    tree = box_tree(corners.min(axis=1), corners.max(axis=1))
    return OnSurface(balls, body, read_only(corners), tree, name)


def _refuse_own(balls: Balls, body: int, name: str) -> None:
    if np.any(balls.body == body):
        raise MechanicsError(
            f"{name}: ball {int(np.argmax(balls.body == body))} belongs to the body it would touch"
        )


@kernel
def _centres(rotation: Floats, origin: Floats, body: Integers, at: Floats) -> Floats:
    centres = np.empty((len(body), 3))
    for i in range(len(body)):
        put(end_of(rotation, origin, body[i], vector(at, i))[1], centres, i, 0)
    return centres


@kernel
def _below(
    rotation: Floats, origin: Floats, body: Integers, at: Floats, radius: Floats, plane: int, point: Floats,
    normal: Floats,
) -> tuple[Integers, Integers, Floats, Floats, Floats]:  # fmt: skip
    """Fields of :class:`Touches` of balls and a plane."""
    n, count = len(body), 0
    pair, ends = np.zeros((n, 2), np.int64), np.empty((n, 2), np.int64)
    place, out, depth = np.empty((n, 3)), np.empty((n, 3)), np.empty(n)
    _, base = end_of(rotation, origin, plane, vector_at(point, 0))
    up, _ = end_of(rotation, origin, plane, vector_at(normal, 0))
    for i in range(n):
        _, centre = end_of(rotation, origin, body[i], vector(at, i))
        deep = radius[i] - dot(subtract(centre, base), up)
        if deep > 0.0:
            pair[count, 0], ends[count, 0], ends[count, 1], depth[count] = i, body[i], plane, deep
            put(up, out, count, 0)
            put(subtract(centre, scale(radius[i] - 0.5 * deep, up)), place, count, 0)
            count += 1
    pair, ends, depth = pair[:count].copy(), ends[:count].copy(), depth[:count].copy()
    return pair, ends, place[:count].copy(), out[:count].copy(), depth


@kernel
def _normals_between(
    pairs: Integers, centre: Floats, body: Integers, radius: Floats, first: int
) -> tuple[Integers, Integers, Floats, Floats, Floats]:
    """Fields of :class:`Touches` of balls and balls."""
    n, count = len(pairs), 0
    pair, ends = np.empty((n, 2), np.int64), np.empty((n, 2), np.int64)
    place, out, depth = np.empty((n, 3)), np.empty((n, 3)), np.empty(n)
    for k in range(n):
        i, j = pairs[k, 0], pairs[k, 1]
        if body[i] == body[j] or (first > 0 and (i >= first or j < first)):
            continue
        separation = subtract(vector(centre, i), vector(centre, j))
        length = np.sqrt(dot(separation, separation))
        deep = radius[i] + radius[j] - length
        # Centres that coincide have no direction; any will do, until the step is refused.
        up = scale(1.0 / length, separation) if length > 0.0 else (0.0, 0.0, 1.0)
        if deep > 0.0:
            pair[count, 0], pair[count, 1], ends[count, 0], ends[count, 1] = i, j, body[i], body[j]
            depth[count] = deep
            put(up, out, count, 0)
            put(subtract(vector(centre, i), scale(radius[i] - 0.5 * deep, up)), place, count, 0)
            count += 1
    pair, ends, depth = pair[:count].copy(), ends[:count].copy(), depth[:count].copy()
    return pair, ends, place[:count].copy(), out[:count].copy(), depth
