"""Cells and trees of boxes against all pairs and scipy's cKDTree."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from protochain.core.errors import MechanicsError
from protochain.mechanisms.search import LEAF, box_tree, overlapping, touching


def all_pairs(centre, radius):
    """Pairs of spheres that touch, of all pairs."""
    i, j = np.triu_indices(len(centre), 1)
    near = np.sum((centre[i] - centre[j]) ** 2, axis=1) <= (radius[i] + radius[j]) ** 2
    return np.column_stack([i, j])[near]


@pytest.mark.parametrize("stretch", [(1, 1, 1), (30, 1, 0), (0, 0, 1), (1e5, 1e5, 1e5), (0, 0, 0)])
@pytest.mark.parametrize("n", [1, 3, 400])
def test_spheres_that_touch_are_those_of_all_pairs(n, stretch):
    rng = np.random.default_rng(n)
    centre = rng.uniform(-1.0, 1.0, (n, 3)) * stretch
    # Clusters far from each other, so that cells share places of the table.
    centre[n // 2 :] = centre[: n - n // 2] + rng.normal(0.0, 0.05, (n - n // 2, 3))
    radius = rng.uniform(0.0, 0.1, n)
    found = touching(centre, radius)
    assert found.tolist() == all_pairs(centre, radius).tolist()
    assert n < 400 or len(found) > 100


def test_pairs_are_those_of_a_tree_of_points():
    centre = np.random.default_rng(3).uniform(0.0, 12.0, (20000, 3))
    found = touching(centre, np.full(len(centre), 0.25))
    expected = cKDTree(centre).query_pairs(0.5, output_type="ndarray")
    assert np.array_equal(found, expected[np.lexsort(expected.T[::-1])])


def test_one_that_has_flown_off_and_points_that_coincide():
    centre = np.random.default_rng(4).uniform(0.0, 1.0, (50, 3))
    centre[7] = 1e12, -1e12, 1e12
    centre[11] = centre[40]
    assert touching(centre, np.zeros(50)).tolist() == [[11, 40]]
    radius = np.full(50, 0.1)
    assert np.array_equal(touching(centre, radius), all_pairs(centre, radius))
    assert touching(np.zeros((0, 3)), np.zeros(0)).shape == (0, 2)


@pytest.mark.parametrize(
    ("centre", "radius", "words"),
    [(np.nan, 1.0, "sphere 1: its centre"), (0.0, -1.0, "sphere 1: its radius"), (0.0, np.inf, "radius")],
)
def test_what_is_no_sphere_is_refused_by_its_number(centre, radius, words):
    with pytest.raises(MechanicsError, match=words):
        touching(np.array([[0.0, 0.0, 0.0], [centre, 0.0, 0.0]]), np.array([1.0, radius]))


def boxes(n, size, rng):
    low = rng.uniform(0.0, 1.0, (n, 3))
    return low, low + rng.uniform(0.0, size, (n, 3))


@pytest.mark.parametrize("n", [0, 1, LEAF, LEAF + 1, 37, 500])
def test_boxes_that_overlap_are_those_of_all_pairs(n):
    rng = np.random.default_rng(n)
    low, high = boxes(n, 0.1, rng)
    others = boxes(60, 0.2, rng)
    found = overlapping(box_tree(low, high), *others)
    meet = (others[0][:, None] <= high) & (low <= others[1][:, None])
    assert found.tolist() == np.argwhere(meet.all(axis=2)).tolist()
    assert n < 500 or len(found) > 100


def test_boxes_of_one_place_end_in_leaves():
    """Nothing tells them apart along any axis."""
    low = np.zeros((100, 3))
    tree = box_tree(low, low + 1.0)
    assert overlapping(tree, np.ones((1, 3)), np.full((1, 3), 2.0))[:, 1].tolist() == list(range(100))
    assert np.all(tree.items[:, 1] - tree.items[:, 0] <= LEAF)
    assert not any(array.flags.writeable for array in vars(tree).values())


def test_a_search_of_the_tree_looks_at_few_boxes():
    """A small box among 4096 in a row: only the nodes on its way down overlap."""
    low = np.column_stack([np.arange(4096.0), np.zeros((4096, 2))])
    tree = box_tree(low, low + 0.5)
    overlap = (tree.low[:, 0] <= 1000.4) & (tree.high[:, 0] >= 1000.1)
    assert overlap.sum() == 11
    assert len(tree.after) == 2047


def test_empty_boxes_are_refused():
    with pytest.raises(MechanicsError, match="box 1: its corners"):
        box_tree(np.zeros((2, 3)), np.array([[1.0, 1.0, 1.0], [1.0, -1.0, 1.0]]))
