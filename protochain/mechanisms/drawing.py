"""Contents of pictures of mechanisms: shapes of bodies, by the user or from hinges, joints and contacts."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from protochain.core.arrays import Floats
from protochain.core.checks import brief
from protochain.core.errors import MechanicsError
from protochain.core.settings import document_fields
from protochain.mechanics import multibody
from protochain.mechanics.multibody import HingeKind
from protochain.mechanisms.assembly import Assembly, Motion
from protochain.mechanisms.bodies import Bodies
from protochain.mechanisms.bushing import Bushings
from protochain.mechanisms.contact_forces import ContactForces
from protochain.mechanisms.element_arguments import number, numbers
from protochain.mechanisms.linear_springs import Springs
from protochain.mechanisms.shapes import Ball, OnPlane, OnSurface

THICK = 0.02
"""Diameter of rods without a radius, and least thickness of blocks, by the size of the picture."""
_NEAR = 1e-9
"""Distance of points that are one, by the size of the tree."""


@document_fields
@dataclass(frozen=True)
class Rod:
    """Cylinder fixed in a body, between two of its points, to be drawn."""

    body: str  # Name of the body, or ``"world"``.
    a: ArrayLike  # (3,) float: First end, in the body's axes.
    b: ArrayLike  # (3,) float: Second end, in the body's axes.
    radius: float | None = None  # Radius. By default a hundredth of the picture.

    def __post_init__(self) -> None:
        for name in ("a", "b"):
            numbers(getattr(self, name), f'end {name} of a rod of "{self.body}"')
        if self.radius is not None and not number(self.radius, f'the radius of a rod of "{self.body}"') > 0:
            raise MechanicsError(f'the radius {self.radius:g} of a rod of "{self.body}": give one above 0')


@document_fields
@dataclass(frozen=True)
class Block:
    """Box fixed in a body, along its axes, to be drawn."""

    body: str  # Name of the body, or ``"world"``.
    edges: ArrayLike  # (3,) float: Lengths of its edges.
    at: ArrayLike = (0.0, 0.0, 0.0)  # (3,) float: Its middle, in the body's axes.

    def __post_init__(self) -> None:
        if np.any(numbers(self.edges, f'edges of a block of "{self.body}"') < 0.0):
            raise MechanicsError(f'edges {brief(self.edges)} of a block of "{self.body}": give none below 0')
        numbers(self.at, f'the middle of a block of "{self.body}"')


Shape = Ball | Rod | Block


class Lines(NamedTuple):
    """Springs: bodies (n, 2) of their ends, -1 for the world, and points (n, 2, 3) in the bodies' axes."""

    ends: np.ndarray
    points: Floats


class Ground(NamedTuple):
    """A plane that something touches: its body, a point and its normal, in the body's axes."""

    body: int
    at: Floats
    normal: Floats


class Mesh(NamedTuple):
    """A surface that something touches: its body, and corners (n, 3, 3) of triangles, in the body's axes."""

    body: int
    corners: Floats


class Drawing(NamedTuple):
    """A motion to draw."""

    bodies: Bodies
    shapes: tuple[Shape, ...]  # Of bodies and the world.
    lines: Lines  # lines, grounds, meshes: Springs, planes, and surfaces.
    grounds: tuple[Ground, ...]
    meshes: tuple[Mesh, ...]
    times: Floats  # (n,).
    rotation: Floats  # rotation, origin: (n, nb, 3, 3): Axes of the bodies, as columns, and their origins.
    origin: Floats
    low: Floats  # low, high: (3,): Box in which all of it happens.
    high: Floats

    @property
    def size(self) -> float:
        """Diagonal of the box."""
        size = float(np.linalg.norm(self.high - self.low))
        return size if size > 0.0 else 1.0

    def place(self, k: int, body: int, points: Floats) -> Floats:
        """Points (..., 3) of a body at moment k, in the world."""
        if body < 0:
            return points
        return np.asarray(points @ self.rotation[k, body].T + self.origin[k, body])


def drawing(run: Motion, rows: Sequence[int], shapes: Sequence[Shape] | None) -> Drawing:
    """Return what there is to draw of rows of a run."""
    model, bodies = run.model, run.model.bodies
    drawn = tuple(_default_shapes(model) if shapes is None else _check_shapes(shapes, bodies))
    frames = [multibody.pose(model.tree, run.q[k]) for k in rows]
    origin = np.array([s.origin for s in frames])
    rotation = np.array([s.rotation @ bodies.turn.swapaxes(1, 2) for s in frames])
    lines = _lines(model)
    finders = [part.finder for part in model.conservative if isinstance(part, ContactForces)]
    grounds = tuple(
        Ground(s.body, bodies.axes(s.body).T @ s.at, bodies.axes(s.body).T @ s.normal)
        for s in finders
        if isinstance(s, OnPlane)
    )
    meshes = tuple(Mesh(s.body, s.corners @ bodies.axes(s.body)) for s in finders if isinstance(s, OnSurface))
    times, corner = run.time[list(rows)], np.zeros(3)
    picture = Drawing(bodies, drawn, lines, grounds, meshes, times, rotation, origin, corner, corner)
    reached = [origin.reshape(-1, 3)]
    for shape in drawn:
        b, points = bodies.number(shape.body), outline(shape)
        reach = 0.0 if isinstance(shape, Block) else float(shape.radius or 0.0)
        for k in range(len(rows)):
            at = picture.place(k, b, points)
            reached += [at - reach, at + reach]
    fixed = lines.points[lines.ends < 0]
    reached += [picture.place(k, s.body, s.corners).reshape(-1, 3) for s in meshes for k in range(len(rows))]
    everything = np.concatenate([*reached, fixed.reshape(-1, 3)])
    return picture._replace(low=everything.min(axis=0), high=everything.max(axis=0))


def outline(shape: Shape) -> Floats:
    """(n, 3) float: middle of a ball, ends of a rod, or corners of a block, in the axes of its body."""
    if isinstance(shape, Ball):
        return np.array([shape.at], dtype=float)
    if isinstance(shape, Rod):
        return np.array([shape.a, shape.b], dtype=float)
    signs = np.array([[k >> axis & 1 for axis in range(3)] for k in range(8)]) - 0.5
    return np.asarray(shape.at, dtype=float) + signs * np.asarray(shape.edges, dtype=float)


def _check_shapes(shapes: Any, bodies: Bodies) -> Sequence[Shape]:
    """Shapes of bodies that are there."""
    remedy = 'give a list of Ball, Rod and Block, as [Block("plate", (1, 1, 0.1))]'
    if isinstance(shapes, Shape) or not isinstance(shapes, Sequence) or isinstance(shapes, str):
        raise MechanicsError(f"shapes {brief(shapes)}: {remedy}")
    for shape in shapes:
        if not isinstance(shape, Shape):
            raise MechanicsError(f"shapes: {brief(shape)} is not a shape: {remedy}")
        bodies.number(shape.body, "shapes")
    return shapes


def _default_shapes(model: Assembly) -> Iterator[Shape]:
    """Default shapes: rods to joints and elements, balls of contacts, else blocks or balls."""
    # A block or ball has the body's moments of inertia.
    tree, bodies = model.tree, model.bodies
    joint_points = _joint_points(model)
    touching = {b: [] for b in range(tree.n_bodies)}  # type: dict[int, list[Ball]]
    for part in model.conservative:
        if isinstance(part, ContactForces):
            balls = part.finder.balls
            for b, at, radius in zip(balls.body.tolist(), balls.at, balls.radius.tolist(), strict=True):
                if b >= 0:
                    touching[b].append(Ball(bodies.names[b], radius, bodies.turn[b] @ at))
    for b, name in enumerate(bodies.names):
        com = bodies.turn[b] @ tree.com[b]
        ends = [at for at in joint_points[b] if np.linalg.norm(at) > _NEAR * tree.size]
        yield from (ball for ball in touching[b] if ball.radius > 0.0)
        if touching[b] and not ends:
            continue
        if not ends and tree.kind[b] != HingeKind.FREE and np.linalg.norm(com) > _NEAR * tree.size:
            # An even rod on a hinge ends as far beyond its centre of mass.
            ends = [2.0 * com]
        for at in ends:
            yield Rod(name, (0.0, 0.0, 0.0), at)
        if not ends and tree.mass[b] > 0.0:
            yield from _like(name, com, bodies.turn[b] @ tree.inertia[b] @ bodies.turn[b].T / tree.mass[b])


def _joint_points(model: Assembly) -> list[list[Floats]]:
    """Points of each body, in its own axes, at which other bodies, loops or springs are joint_points."""
    tree, bodies = model.tree, model.bodies
    joints: list[list[Floats]] = [[] for _ in range(tree.n_bodies)]

    def add(b: int, at: Floats) -> None:
        point = bodies.turn[b] @ at if b >= 0 else at
        if b >= 0 and not any(np.allclose(point, p, atol=_NEAR * tree.size) for p in joints[b]):
            joints[b].append(point)

    for b in range(tree.n_bodies):
        if tree.kind[b] != HingeKind.FREE:
            add(int(tree.parent[b]), tree.offset[b])
    if bodies.joints is not None:
        for pair, points in zip(bodies.joints.body, bodies.joints.point, strict=True):
            for b, at in zip(pair, points, strict=True):
                add(int(b), at)
    for part in model.conservative:
        if isinstance(part, Springs | Bushings):
            for pair, points in zip(part.ends, part.points, strict=True):
                add(int(pair[0]), points[:3])
                add(int(pair[1]), points[3:])
    return joints


def _like(name: str, at: Floats, inertia: Floats) -> Iterator[Shape]:
    """A ball or block with these moments of inertia by the mass."""
    moments = np.diagonal(inertia)
    if np.ptp(moments) <= 1e-6 * np.max(moments):
        yield Ball(name, float(np.sqrt(2.5 * moments[0])), at)
    else:
        edges = np.sqrt(np.maximum(6.0 * (np.sum(moments) - 2.0 * moments), 0.0))
        yield Block(name, edges, at)


def _lines(model: Assembly) -> Lines:
    rows = [part for part in model.conservative if isinstance(part, Springs)]
    ends = np.concatenate([np.empty((0, 2), np.int64), *(part.ends for part in rows)])
    points = np.concatenate([np.empty((0, 6)), *(part.points for part in rows)]).reshape(-1, 2, 3)
    # Index -1 finds the last axes, of the world.
    turn = np.concatenate([model.bodies.turn, [np.eye(3)]])
    return Lines(ends, np.einsum("nsij,nsj->nsi", turn[ends], points))
