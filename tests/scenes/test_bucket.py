"""The scene bucket: what it finds, and that its machine moves where it should."""

import numpy as np
import pytest

from bench.scenes import run
from bench.scenes.bucket.backhoe import EDGE, backhoe, bucket_plates, digging, motion_of, reach
from bench.scenes.bucket.joints import ANGLES, on_bushings


@pytest.mark.slow
def test_a_bucket_in_soil_is_right():
    found = run("bucket", quick=True)
    assert found.wrong == () and len(found.checks) == 9
    outcomes = {each.verdict for each in found.extremes}
    assert outcomes == {"right", "refused"} and len(found.extremes) == 17
    soil = found.tables["soil"]
    assert soil["work"].iloc[-1] > 0.0 and np.all(np.diff(soil["dissipated"]) >= 0.0)


def test_the_edge_goes_where_it_is_sent():
    place, tilt = np.array([0.7, 0.1]), -0.9
    state = backhoe(angles=reach(place, tilt)).build().state()
    assert state.point("bucket", EDGE) == pytest.approx([0.7, 0.0, 0.1], abs=1e-12)
    c, s = np.cos(tilt), np.sin(tilt)
    assert state.rotation("bucket") == pytest.approx(np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]), abs=1e-12)


def test_the_way_begins_and_ends_at_rest_and_its_rates_are_derivatives():
    path = digging(0.2)
    for t in (0.0, 1.0):
        assert path(t)[1] == pytest.approx(np.zeros(3), abs=1e-12)
    h = 1e-6
    for t in (0.13, 0.45, 0.81):
        assert (path(t + h)[0] - path(t - h)[0]) / (2 * h) == pytest.approx(path(t)[1], abs=1e-7)
        assert (path(t + h)[1] - path(t - h)[1]) / (2 * h) == pytest.approx(path(t)[2], abs=1e-5)


def test_plates_move_with_the_bucket():
    path = digging(0.2)
    model = backhoe(path).build()
    body = model.bodies.number("bucket")
    plates, h = bucket_plates(body, model), 1e-5
    motion = motion_of(model, path, np.array([0.4 - h, 0.4, 0.4 + h]))
    state = model.state(model.system.at(path(0.4)[0], path(0.4)[1], 0.4))
    turn, at = motion.rotation[1, body], motion.origin[1, body]
    # The bottom lies just below the edge, its normal the bucket's z axis.
    bottom = at + turn @ plates.centre[0]
    wanted = state.point("bucket", (0.0, 0.0, EDGE[2] - plates.half[0, 2]))
    assert bottom == pytest.approx(wanted, abs=1e-12)
    normal = turn @ plates.rotation[0][:, 2]
    assert normal == pytest.approx(state.rotation("bucket")[:, 2], abs=1e-12)
    moved = (motion.origin[2, body] - motion.origin[0, body]) / (2 * h)
    assert motion.twist[1, body, 3:] == pytest.approx(moved, abs=1e-7)


def test_bushings_begin_where_hinges_do():
    hinged, sprung = backhoe(angles=ANGLES).build().state(), on_bushings(1e6).build().state()
    for name in ("boom", "stick", "bucket"):
        assert sprung.point(name) == pytest.approx(hinged.point(name), abs=1e-12)
        assert sprung.rotation(name) == pytest.approx(hinged.rotation(name), abs=1e-12)
