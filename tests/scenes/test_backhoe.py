"""The backhoe: cylinders, teeth and chain, measures of stability; and the whole scene, quick."""

import numpy as np
import pytest

from bench.scenes.backhoe.machine import CYLINDERS, DESIGNS, hold, posture, vehicle
from bench.scenes.backhoe.stability import force_angle
from bench.scenes.bucket.backhoe import EDGE

SQUARE = np.array([(1.0, -1.0, 0.0), (1.0, 1.0, 0.0), (-1.0, 1.0, 0.0), (-1.0, -1.0, 0.0)])
DOWN = np.array([0.0, 0.0, -10.0])


@pytest.mark.parametrize(("name", "angle"), [("boom", -0.5), ("stick", 1.7), ("bucket", -2.0)])
def test_lengths_of_cylinders_have_their_derivatives(name, angle):
    cylinder, h = CYLINDERS[name], 1e-5

    def at(t):
        return cylinder.length(angle + 0.8 * t - 0.7 * t * t, 0.8 - 1.4 * t, -1.4)

    for k in (0, 1):
        assert (at(h)[k] - at(-h)[k]) / (2 * h) == pytest.approx(at(0.0)[k + 1], abs=1e-8)
    assert cylinder.lever(angle) == pytest.approx(at(0.0)[1] / 0.8)


def test_cylinders_bring_the_edge_where_it_is_sent_and_have_their_lengths():
    model = vehicle(DESIGNS[0], hold(posture((0.75, 0.2), -0.4, 0.5)), None).build()
    state = model.state()
    place = state.rotation("house").T @ (state.point("bucket", EDGE) - state.point("house"))
    assert place == pytest.approx([0.75 + 0.1, 0.0, 0.2 - 0.1], abs=1e-9)
    for name, cylinder in CYLINDERS.items():
        foot, eye = ((x, 0.0, z) for x, z in (cylinder.foot, cylinder.eye))
        apart = state.point(cylinder.child, eye) - state.point(cylinder.parent, foot)
        assert np.linalg.norm(apart) == pytest.approx(state.angle(f"{name} cylinder"), abs=1e-12)
        assert state.point(f"{name} rod") == pytest.approx(state.point(cylinder.child, eye), abs=1e-12)


def test_the_force_angle_measure_of_a_cart():
    """A square of half width 1, its centre of mass at a height of 2: atan(1/2) on all sides."""
    at = np.array([0.0, 0.0, 2.0])
    angle, measure = force_angle(SQUARE, at, DOWN, np.zeros(3))
    assert angle == pytest.approx(np.full(4, np.arctan2(1, 2))) and measure == pytest.approx(10 * angle)
    # A push forward turns the force towards the front edge, and from the rear.
    angle, _ = force_angle(SQUARE, at, np.array([3.0, 0.0, -10.0]), np.zeros(3))
    tilt = np.arctan2(3, 10)
    assert angle[[0, 2]] == pytest.approx([np.arctan2(1, 2) - tilt, np.arctan2(1, 2) + tilt])
    assert angle[[1, 3]] == pytest.approx(np.full(2, np.arctan2(1, 2)))
    # It tips where the moment about the edge changes sign, whether of a force or of a couple.
    for share in (0.99, 1.01):
        for force, moment in (((5 * share, 0, 0), (0, 0, 0)), ((0, 0, 0), (0, 10 * share, 0))):
            angle, _ = force_angle(SQUARE, at, DOWN + force, np.array(moment, float))
            assert (angle[0] > 0.0) == (share < 1.0) and angle[2] > 0.0
