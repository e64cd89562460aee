"""The scene ``loops``; joints themselves are tested in tests/mechanisms/test_closing.py."""

import numpy as np

from bench.scenes.loops import by_lagrange, period


def test_the_oracles_are_right_where_they_are_known():
    """A crank in its first millisecond, and a pendulum of small swings."""
    assert abs(by_lagrange(1e-3) - 3e-3) < 1e-5
    omega = np.sqrt(9.81 * (1.0 + 1.0) / (2.0 / 3.0 + 1.0))
    assert abs(period(1, 1e-4) * omega / (2.0 * np.pi) - 1.0) < 1e-8
