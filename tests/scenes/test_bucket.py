"""The scene bucket: what it finds, and that its machine moves where it should."""

import numpy as np
import pytest

from bench.scenes.bucket.backhoe import EDGE, backhoe, reach


def test_the_edge_goes_where_it_is_sent():
    place, tilt = np.array([0.7, 0.1]), -0.9
    state = backhoe(angles=reach(place, tilt)).build().state()
    assert state.point("bucket", EDGE) == pytest.approx([0.7, 0.0, 0.1], abs=1e-12)
    c, s = np.cos(tilt), np.sin(tilt)
    assert state.rotation("bucket") == pytest.approx(np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]), abs=1e-12)
