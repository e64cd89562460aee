"""Contact of boxes: against MuJoCo, the hull of all differences of corners, and a quadratic program."""

import numpy as np
import pytest
from fixtures.touching import Box, touch_boxes, touch_plane
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from bench.soil.box_kernels import FACES, STEEPEST
from protochain.core.errors import MechanicsError
from protochain.mechanisms.element_arguments import check_boxes

SIGNS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
EXACT = 1e-12
"""Relative to boxes of size one: some fifty rounded operations."""


def corners(box: Box) -> np.ndarray:
    return np.array(box.centre) + (SIGNS * box.half) @ np.array(box.rotation).T


def pairs(number: int, apart: float, seed: int) -> list[tuple[Box, Box]]:
    rng = np.random.default_rng(seed)

    def box(spread: float) -> Box:
        rotation = Rotation.random(rng=rng).as_matrix()
        return Box(spread * rng.normal(size=3), rotation, rng.uniform(0.3, 1.0, 3))

    return [(box(0.1), box(apart)) for _ in range(number)]


def depth_by_hull(a: Box, b: Box) -> float:
    """Distance of the origin from the surface of the Minkowski difference; negative outside."""
    difference = (corners(a)[:, None] - corners(b)[None]).reshape(-1, 3)
    return float(-np.max(ConvexHull(difference).equations[:, 3]))


def within(box: Box, points: np.ndarray) -> np.ndarray:
    """How far points are from the middle, in half edges: 1 on the surface."""
    return np.max(np.abs((points - box.centre) @ np.array(box.rotation)) / box.half, axis=1)


def test_depth_is_that_of_the_hull_of_differences_and_every_axis_occurs():
    axes = set()
    for a, b in pairs(900, 0.9, 1):
        touch, depth = touch_boxes(a, b), depth_by_hull(a, b)
        assert (touch.depth > 0.0) == (depth > 0.0)
        if depth > 0.0:
            assert touch.depth == pytest.approx(depth, abs=EXACT)
            axes.add(touch.axis)
    assert axes == set(range(15))


def test_forces_at_the_points_are_the_gradients_of_their_depths():
    step, clipped = 1e-6, 0
    for a, b in pairs(300, 0.9, 8):
        touch = touch_boxes(a, b)
        if touch.depth <= 0.0 or np.any(
            np.linalg.norm(touch.pushes, axis=1) > np.hypot(1.0, 0.99 * STEEPEST)
        ):
            continue
        np.testing.assert_allclose(touch.pushes @ touch.normal, 1.0, atol=EXACT)
        clipped += np.any(np.abs(touch.pushes - touch.normal) > 1e-3)
        for direction in np.eye(3):
            moved = touch_boxes(a, b._replace(centre=b.centre + step * direction))
            if moved.axis == touch.axis and len(moved.depths) == len(touch.depths):
                slope = (moved.depths - touch.depths) / step
                np.testing.assert_allclose(slope, -touch.pushes @ direction, atol=1e-4)
    assert clipped > 50


def test_a_whole_face_a_crossing_and_an_octagon():
    cube = (1.0, 1.0, 1.0)
    low = Box((0, 0, 0), np.eye(3), cube)
    flat = touch_boxes(low, Box((0.5, 0, 1.9), np.eye(3), cube))
    assert flat.axis in (2, 5) and flat.normal == pytest.approx([0, 0, 1])
    assert flat.depths == pytest.approx([0.1] * 4) and np.sum(flat.shares) == pytest.approx(1.0)
    around = sorted(map(tuple, flat.points.round(12)))
    assert around == [
        (-0.5, -1, 0.95),
        (-0.5, 1, 0.95),
        (1, -1, 0.95),
        (1, 1, 0.95),
    ]
    turned = touch_boxes(low, Box((0, 0, 1.9), Rotation.from_euler("z", np.pi / 4).as_matrix(), cube))
    assert turned.shares == pytest.approx([0.125] * 8)
    roof = Rotation.from_euler("y", np.pi / 4).as_matrix()
    keel = Rotation.from_euler("x", np.pi / 4).as_matrix()
    edges = touch_boxes(Box((0, 0, 0), roof, cube), Box((0.3, 0.2, 2.8), keel, cube))
    assert edges.axis >= FACES and edges.depth == pytest.approx(2 * np.sqrt(2) - 2.8)
    assert edges.points[0] == pytest.approx([0, 0.2, 1.4]) or edges.points[0] == pytest.approx([0.3, 0, 1.4])


def test_a_plane_is_touched_by_the_corners_below_it():
    rng = np.random.default_rng(7)
    for _ in range(50):
        up, offset = rng.normal(size=3), rng.normal()
        up /= np.linalg.norm(up)
        box = Box(rng.normal(size=3), Rotation.random(rng=rng).as_matrix(), rng.uniform(0.3, 1.5, 3))
        touch, level = touch_plane(up, offset, box), corners(box) @ up - offset
        assert touch.depth == pytest.approx(-np.min(level), abs=EXACT)
        assert sorted(touch.depths) == pytest.approx(sorted(-level[level < 0.0]), abs=EXACT)
        below = touch.points - 0.5 * touch.depths[:, None] * up
        assert np.allclose(within(box, below), 1.0) if len(below) else touch.depth <= 0.0


FINE = Box((0, 0, 0), np.eye(3), (1, 1, 1))


@pytest.mark.parametrize(
    ("box", "why"),
    [
        (Box((0, 0, np.nan), np.eye(3), (1, 1, 1)), "finite"),
        (Box((0, 0, 0), np.eye(3), (1, 0, 1)), "edges"),
        (Box((0, 0, 0), -np.eye(3), (1, 1, 1)), "rotation"),
    ],
)
def test_what_is_no_box_is_refused(box, why):
    boxes = [np.array([other, part], dtype=float) for other, part in zip(FINE, box, strict=True)]
    with pytest.raises(MechanicsError, match=f"box 1: .*{why}"):
        check_boxes(*boxes)
