"""Vector products against numpy's, to the bit."""

import numpy as np
import pytest

from protochain.core.arrays import cross

SHAPES = [
    ((3,), (3,)), ((5, 3), (5, 3)), ((4, 2, 3), (4, 2, 3)), ((7, 3), (3,)), ((3,), (7, 3)), ((0, 3), (0, 3)),
]  # fmt: skip


@pytest.mark.parametrize("shapes", SHAPES)
def test_products_are_those_of_numpy(shapes):
    a, b = (np.random.default_rng(k).normal(size=shape) for k, shape in enumerate(shapes))
    np.testing.assert_array_equal(cross(a, b), np.cross(a, b))
    assert cross(a, b).flags.c_contiguous
