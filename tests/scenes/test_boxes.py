"""Contact of boxes: against MuJoCo, the hull of all differences of corners, and a quadratic program."""

import numpy as np
import pytest
from fixtures.touching import Box, touch_boxes, touch_plane
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

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
    for a, b in pairs(400, 0.9, 1):
        touch, depth = touch_boxes(a, b), depth_by_hull(a, b)
        assert (touch.depth > 0.0) == (depth > 0.0)
        if depth > 0.0:
            assert touch.depth == pytest.approx(depth, abs=EXACT)
            axes.add(touch.axis)
    assert axes == set(range(15))


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
