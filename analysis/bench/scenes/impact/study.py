"""Random impacts, of trees and of loops, in the plane and in space: which laws add energy, and how often."""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import chain
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from protochain.core.arrays import Floats
from protochain.core.defaults import IMPACT_TOLERANCE
from protochain.core.errors import MechanicsError
from protochain.mechanics.multibody import (
    HingeKind,
    Rows,
    Tree,
    kinetic_energy,
    pose,
    random_tree,
    velocities,
)
from protochain.mechanics.multibody.articulated import Articulated, articulate
from protochain.mechanisms.impacts import ContactPoint, close_loops, impact
from protochain.mechanisms.impacts.impact import Law, Order
from protochain.mechanisms.impacts.path import DONE, follow
from protochain.mechanisms.impacts.points import Struck

GAIN = 1e-9
"""Of the kinetic energy: what counts as gained. Curved pieces have errors of 1e-10."""
PER_POSE, AT_ONCE = 25, 5
"""Impacts of a tree in one pose; those of one point with the same velocities, whose W take one sweep."""
LAWS: tuple[Law, ...] = ("newton", "poisson", "stronge")


class Kind(NamedTuple):
    """A row of the study.

    plane: Whether all moves in one plane.
    points: Number of points.
    law, order: As of :func:`protochain.mechanisms.impacts.impact`.
    share: Of all impacts.
    """

    plane: bool
    points: int
    law: Law
    order: Order
    share: float


KINDS = (
    *(Kind(plane, 1, law, "together", 0.14)
      for plane in (True, False) for law in LAWS),
    *(Kind(plane, k, "poisson", "together", 0.02) for plane in (True, False) for k in (2, 3, 4)),
    *(Kind(plane, k, "stronge", "in turn", 0.01)
      for plane in (True, False) for k in (3, 4)),
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Posed:
    """A tree in a pose, perhaps with loops.

    factors: Tree, frames and factors of M.
    loops: Rows of the loops.
    plane: Whether all moves in the plane z = 0.
    """

    factors: Articulated
    loops: Rows | None
    plane: bool


def random_impacts(n: int, seed: int) -> pd.DataFrame:
    """Make random impacts, and count those that add energy."""
    rng, rows = np.random.default_rng(seed), []
    for kind in KINDS:
        for looped in (False, True):
            poses = max(1, round(0.5 * kind.share * n / PER_POSE))
            made = (_impacts(random_pose(kind.plane, looped, rng), kind, rng) for _ in range(poses))
            found = np.fromiter(chain.from_iterable(made), float)
            told = found[np.isfinite(found)]
            rows.append(
                {
                    "in": "plane" if kind.plane else "space", "of": "loops" if looped else "trees",
                    "points": kind.points, "law": kind.law, "order": kind.order, "impacts": len(found),
                    "refused": len(found) - len(told), "gained": int(np.sum(told > GAIN)),
                    "largest": float(np.max(told, initial=-1.0)),
                }
            )  # fmt: skip
    return pd.DataFrame(rows)


def _impacts(posed: Posed, kind: Kind, rng: np.random.Generator) -> Iterator[float]:
    """Relative changes of the energy; NaN where an impact is refused."""
    tree, frames = posed.factors.tree, posed.factors.frames
    at_once = AT_ONCE if kind.points == 1 else 1
    for _ in range(PER_POSE // at_once):
        qd = rng.normal(size=tree.n_v)
        qd = qd if posed.loops is None else close_loops(posed.factors, qd, posed.loops)
        before = kinetic_energy(tree, frames, qd)
        points = list(random_points(posed, qd, at_once * kind.points, kind.points, rng))
        some = points[: kind.points]
        try:
            after = impact(posed.factors, qd, some, kind.law, posed.loops, kind.order)
            yield kinetic_energy(tree, frames, after.qd) / before - 1.0
        except MechanicsError:
            yield np.nan
        if at_once > 1:
            yield from (work / before for work in each_alone(posed, qd, points[1:], kind.law))


def each_alone(posed: Posed, qd: Floats, points: Sequence[ContactPoint], law: Law) -> Iterator[float]:
    """Work of impacts of one point each, from the same velocities; NaN if refused. Their W take one sweep."""
    struck = Struck.of(posed.factors, qd, points, posed.loops)
    out = np.empty(8)
    for i, point in enumerate(points):
        own = slice(3 * i, 3 * i + 3)
        w, u = np.ascontiguousarray(struck.w[own, own]), struck.u[own].copy()
        if not (u[0] < -struck.slow[i] and struck.movable[i]):
            yield 0.0
            continue
        status = follow(
            w, u, point.friction, point.restitution, LAWS.index(law), struck.slow[i], IMPACT_TOLERANCE, out
        )  # fmt: skip
        yield float(out[:3] @ (u + 0.5 * w @ out[:3])) if status == DONE else np.nan


def random_points(
    posed: Posed, qd: Floats, k: int, every: int, rng: np.random.Generator
) -> Iterator[ContactPoint]:
    """Points of random bodies with the world or other bodies, friction 0 to 2, restitution 0 to 1.

    The first of each ``every`` points approaches.
    """
    tree, frames = posed.factors.tree, posed.factors.frames
    n, origin, twists = tree.n_bodies, frames.origin, velocities(tree, frames, qd)
    for i in range(k):
        body = int(rng.integers(n))
        other = int(rng.integers(n)) if rng.random() < 0.3 else -1
        pair = (-1 if other == body else other, body)
        point, normal = origin[body] + rng.normal(scale=0.1, size=3), rng.normal(size=3)
        if posed.plane:
            point[2], normal[2] = 0.0, 0.0
        if i % every == 0:
            first, second = (
                twists[b, 3:] + np.cross(twists[b, :3], point - origin[b]) if b >= 0 else np.zeros(3)
                for b in pair
            )
            normal *= -1.0 if (second - first) @ normal > 0.0 else 1.0
        yield ContactPoint(f"point {i}", pair, point, normal, rng.uniform(0.0, 2.0), rng.uniform())


def random_pose(plane: bool, looped: bool, rng: np.random.Generator) -> Posed:
    """Make a random tree of 3 to 8 bodies in a random pose, with one or two loops or none."""
    n = int(rng.integers(3, 9))
    tree = _plane_tree(n, rng) if plane else _space_tree(n, rng)
    q = rng.normal(size=tree.n_q)
    factors = articulate(tree, pose(tree, q))
    while looped:
        loops = _loops(factors, plane, rng)
        # Two loops of one pair of bodies may say the same.
        with suppress(MechanicsError):
            close_loops(factors, np.zeros(tree.n_v), loops)
            return Posed(factors, loops, plane)
    return Posed(factors, None, plane)


def _space_tree(n: int, rng: np.random.Generator) -> Tree:
    root = HingeKind.FREE if rng.random() < 0.5 else HingeKind.REVOLUTE
    kinds = (HingeKind.REVOLUTE, HingeKind.REVOLUTE, HingeKind.PRISMATIC, HingeKind.SCREW)
    return random_tree(n, rng, 0.3, root, kinds)


def _plane_tree(n: int, rng: np.random.Generator) -> Tree:
    tree = random_tree(n, rng, 0.3, HingeKind.REVOLUTE)
    offset, com = tree.offset.copy(), tree.com.copy()
    offset[:, 2] = com[:, 2] = 0.0
    placement = Rotation.from_rotvec(rng.uniform(0.0, 2.0 * np.pi, (n, 1)) * [0.0, 0.0, 1.0]).as_matrix()
    # Principal axes in the plane and along z.
    moments = np.linalg.eigvalsh(tree.inertia)
    inertia = moments[:, :, None] * np.eye(3)
    return Tree(tree.parent, tree.kind, offset, placement, tree.mass, com, inertia)


def _loops(factors: Articulated, plane: bool, rng: np.random.Generator) -> Rows:
    """Rows of one or two pairs of points whose distance stays."""
    tree, origin = factors.tree, factors.frames.origin
    # A plane tree of three bodies would keep no freedom with a second one.
    m = int(rng.integers(1, 3)) if tree.n_v > 4 else 1
    pairs = np.array([rng.permutation(tree.n_bodies)[:2] for _ in range(m)])
    ends = origin[pairs] + rng.normal(scale=0.1, size=(m, 2, 3))
    if plane:
        ends[..., 2] = 0.0
    along = ends[:, 1] - ends[:, 0]
    along /= np.linalg.norm(along, axis=1)[:, None]
    force = np.stack([-along, along], axis=1)
    arms = ends - origin[pairs]
    return Rows(pairs, np.concatenate([np.cross(arms, force), force], axis=2))
