"""Where balls touch planes, surfaces and each other."""

from collections.abc import Callable
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike

from protochain.arrays import Floats, Integers, read_only
from protochain.errors import MechanicsError
from protochain.mechanisms.bodies import WORLD, Bodies
from protochain.mechanisms.search import BoxTree, box_tree, overlapping, touching
from protochain.mechanisms.triangles import least_distances
from protochain.multibody import Frames


@dataclass(frozen=True)
class Ball:
    """Sphere fixed in a body; with a radius of zero, a point, as the corner of a block.

    Parameters
    ----------
    body : str
        Name of the body, or ``"world"``.
    radius : float
        Radius.
    at : (3,) float
        Centre, in the body's axes.
    """

    body: str
    radius: float
    at: ArrayLike = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Plane:
    """Half-space fixed in a body; whatever is below the plane is inside, however deep.

    Parameters
    ----------
    body : str
        Name of the body, or ``"world"``.
    at, normal : (3,) float
        A point of the plane and the direction out of the half-space, in the body's axes.
    """

    body: str = WORLD
    at: ArrayLike = (0.0, 0.0, 0.0)
    normal: ArrayLike = (0.0, 0.0, 1.0)


@dataclass(frozen=True)
class Surface:
    """Triangles fixed in a body, with two sides.

    Parameters
    ----------
    body : str
        Name of the body, or ``"world"``.
    vertices : (n, 3) float
        Corners, in the body's axes.
    faces : (m, 3) int
        Corners of each triangle.
    """

    body: str
    vertices: ArrayLike
    faces: ArrayLike


class Touches(NamedTuple):
    """Where two bodies a and b overlap.

    Parameters
    ----------
    pair : (k, 2) int
        Number of the ball, and of what it touches, in order.
    ends : (k, 2) int
        Bodies a and b; -1 is the world.
    place : (k, 3) float
        Middle of the overlap.
    normal : (k, 3) float
        Unit vectors from b to a.
    depth : (k,) float
        Overlaps, all positive.
    """

    pair: Integers
    ends: Integers
    place: Floats
    normal: Floats
    depth: Floats


@dataclass(frozen=True, eq=False)
class Balls:
    """Balls of a tree: bodies (n,), centres (n, 3) along the axes of the tree's frames, radii (n,)."""

    body: Integers
    at: Floats
    radius: Floats

    def centres(self, frames: Frames) -> Floats:
        """(n, 3) float: centres in the world."""
        rotation, origin = placed(frames, self.body)
        return origin + np.einsum("nij,nj->ni", rotation, self.at)


def _three(values: ArrayLike, what: str) -> Floats:
    array = np.asarray(values, dtype=float)
    if array.shape != (3,) or not np.isfinite(array).all():
        raise MechanicsError(f"{what} must be three finite numbers")
    return array


def balls_of(bodies: Bodies, balls: Sequence[Ball], asking: str) -> Balls:
    """Balls by numbers of bodies.

    Raises
    ------
    MechanicsError
        If there is none, a body is not there, or a radius or centre is no length.
    """
    if not balls:
        raise MechanicsError(f"{asking}: give at least one ball")
    numbers = [bodies.number(ball.body, asking) for ball in balls]
    centres = [_three(ball.at, f"{asking}: the centre of a ball") for ball in balls]
    radius = np.array([ball.radius for ball in balls], dtype=float)
    if not (np.isfinite(radius) & (radius >= 0.0)).all():
        raise MechanicsError(f"{asking}: the radius of a ball must be finite and not negative")
    at = [bodies.inside(b, centre) for b, centre in zip(numbers, centres, strict=True)]
    return Balls(read_only(numbers, np.int64), read_only(at), read_only(radius))


def placed(frames: Frames, body: Integers) -> tuple[Floats, Floats]:
    """Rotations (n, 3, 3) and origins (n, 3) of bodies; -1 is the world."""
    rotation, origin = frames.rotation[body], frames.origin[body]
    fixed = body < 0
    rotation[fixed], origin[fixed] = np.eye(3), 0.0
    return rotation, origin


@dataclass(frozen=True, eq=False)
class OnPlane:
    """Balls on a plane: its body, a point and its normal along the axes of the tree's frame."""

    balls: Balls
    body: int
    at: Floats
    normal: Floats

    def touches(self, frames: Frames) -> Touches:
        """Balls that reach below the plane."""
        rotation, origin = placed(frames, np.array([self.body]))
        normal, at = rotation[0] @ self.normal, origin[0] + rotation[0] @ self.at
        centre = self.balls.centres(frames)
        depth = self.balls.radius - (centre - at) @ normal
        i = np.flatnonzero(depth > 0.0)
        place = centre[i] - (self.balls.radius[i] - 0.5 * depth[i])[:, None] * normal
        ends = np.column_stack([self.balls.body[i], np.full(len(i), self.body)])
        pair = np.column_stack([i, np.zeros(len(i), np.int64)])
        return Touches(pair, ends, place, np.tile(normal, (len(i), 1)), depth[i])

    def refuse_depth(self, touches: Touches) -> None:
        """Nothing: a half-space is right at any depth."""


@dataclass(frozen=True, eq=False)
class Among:
    """Balls on balls: of all pairs of other bodies, or of those between the first ``first`` and the others."""

    balls: Balls
    first: int
    name: str
    body: ClassVar[int] = 0

    def touches(self, frames: Frames) -> Touches:
        """Balls that overlap."""
        centre, body, radius = self.balls.centres(frames), self.balls.body, self.balls.radius
        pair = touching(centre, radius)
        i, j = pair[body[pair[:, 0]] != body[pair[:, 1]]].T
        if self.first:
            i, j = np.array([i, j])[:, (i < self.first) & (j >= self.first)]
        apart = centre[i] - centre[j]
        length = np.linalg.norm(apart, axis=1)
        # Centres that coincide have no direction; any will do, until the step is refused.
        normal = np.divide(
            apart, length[:, None], out=np.tile([0.0, 0.0, 1.0], (len(i), 1)), where=length[:, None] > 0
        )
        depth = radius[i] + radius[j] - length
        place = centre[i] - (radius[i] - 0.5 * depth)[:, None] * normal
        return Touches(np.column_stack([i, j]), np.column_stack([body[i], body[j]]), place, normal, depth)

    def refuse_depth(self, touches: Touches) -> None:
        """Raise if a ball has all but passed through another."""
        radius = self.balls.radius[touches.pair]
        _refuse(self.name, radius.sum(axis=1) - touches.depth < 0.5 * radius.max(axis=1), touches)


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
        rotation, origin = placed(frames, np.array([self.body]))
        turn, radius = rotation[0], self.balls.radius
        # In the frame of the surface.
        centre = np.ascontiguousarray((self.balls.centres(frames) - origin[0]) @ turn)
        near = overlapping(self.tree, centre - radius[:, None], centre + radius[:, None])
        pair, point, distance = least_distances(near, centre, radius, self.corners)
        i = pair[:, 0]
        normal = (centre[i] - point) / np.where(distance > 0.0, distance, 1.0)[:, None]
        depth = radius[i] - distance
        place = (point + 0.5 * depth[:, None] * -normal) @ turn.T + origin[0]
        ends = np.column_stack([self.balls.body[i], np.full(len(i), self.body)])
        return Touches(pair, ends, place, normal @ turn.T, depth)

    def refuse_depth(self, touches: Touches) -> None:
        """Raise if a ball has all but passed through."""
        _refuse(self.name, touches.depth > 0.5 * self.balls.radius[touches.pair[:, 0]], touches)


def _refuse(name: str, bad: np.ndarray, touches: Touches) -> None:
    if np.any(bad):
        k = int(np.argmax(bad))
        raise MechanicsError(
            f"{name}: ball {touches.pair[k, 0]} is {touches.depth[k]:.3g} deep, beyond half a body; raise the "
            "stiffness or take shorter steps"
        )


class Finder(Protocol):
    """Where some balls touch something: the balls, and the body of the other, unless these are balls too."""

    @property
    def balls(self) -> Balls: ...
    @property
    def body(self) -> int: ...

    def touches(self, frames: Frames) -> Touches:
        """Return the touches at one pose."""

    def refuse_depth(self, touches: Touches) -> None:
        """Raise if one is so deep that its direction means nothing."""


def finder(
    bodies: Bodies, balls: Sequence[Ball], other: Plane | Surface | Sequence[Ball] | None, name: str
) -> Finder:
    """What finds where balls touch a plane, a surface, other balls, or each other (None).

    Raises
    ------
    MechanicsError
        If a shape cannot be touched.
    """
    found = balls_of(bodies, balls, name)
    if isinstance(other, Plane):
        body = bodies.number(other.body, name)
        normal = _three(other.normal, f"{name}: the normal of the plane")
        if not np.any(normal):
            raise MechanicsError(f"{name}: the normal of the plane has no direction")
        _refuse_own(found, body, name)
        at = bodies.inside(body, _three(other.at, f"{name}: the point of the plane"))
        return OnPlane(found, body, at, bodies.inside(body, normal / np.linalg.norm(normal)))
    if isinstance(other, Surface):
        return _on_surface(bodies, found, other, name)
    if other is None:
        return Among(found, 0, name)
    return Among(balls_of(bodies, [*balls, *other], name), len(balls), name)


def _on_surface(bodies: Bodies, balls: Balls, surface: Surface, name: str) -> OnSurface:
    body = bodies.number(surface.body, name)
    _refuse_own(balls, body, name)
    if not (balls.radius > 0.0).all():
        raise MechanicsError(f"{name}: a point cannot lie in a surface; give every ball a radius")
    vertices, faces = np.asarray(surface.vertices, dtype=float), np.asarray(surface.faces)
    if vertices.ndim != 2 or vertices.shape[1] != 3 or faces.ndim != 2 or faces.shape[1] != 3:
        raise MechanicsError(f"{name}: vertices must be (n, 3) and faces (m, 3)")
    if not np.isfinite(vertices).all() or faces.dtype.kind not in "iu":
        raise MechanicsError(f"{name}: vertices must be finite, and faces integers")
    outside = ((faces < 0) | (faces >= len(vertices))).any(axis=1)
    if outside.any():
        raise MechanicsError(f"{name}: triangle {int(np.argmax(outside))} has a corner that is not there")
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
