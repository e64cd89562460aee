"""Graphs of bonds, and of side chains that may touch."""

import numpy as np
import pytest

from protochain.core.graph import beyond, bond_angles, both_ways, components, neighbours, pairs_within, within
from protochain.structure.sidechains.reduction import neighbour_tables, touching

SQUARE = np.array([[0, 1], [1, 2], [2, 3], [0, 3], [3, 4], [5, 6]])
"""A ring of four with a tail, and a pair."""


def test_a_ring_with_a_tail_and_a_pair_beside_it():
    near = neighbours(SQUARE, 8)
    assert near == ((1, 3), (0, 2), (1, 3), (2, 0, 4), (3,), (6,), (5,), ())
    assert both_ways(SQUARE[:2]).tolist() == [[0, 1], [1, 2], [1, 0], [2, 1]]
    assert components(SQUARE, 8).tolist() == [0, 0, 0, 0, 0, 1, 1, 2]
    assert within(near, 4, 0) == {4} and within(near, 4, 2) == {4, 3, 2, 0} == within(near, 4, 3) - {1}
    assert beyond(near, 3, 4) == set() and beyond(near, 4, 3) == {0, 1, 2} and beyond(near, 0, 1) == {2, 3, 4}


def test_components_are_those_of_bonds_given_many_times():
    assert components(np.repeat([[0, 1]], 256, axis=0), 3).tolist() == [0, 0, 1]


def test_bond_angles_go_by_their_vertex():
    assert bond_angles(SQUARE, 8).tolist() == [
        [1, 0, 3], [0, 1, 2], [1, 2, 3], [0, 3, 2], [0, 3, 4], [2, 3, 4],
    ]  # fmt: skip
    assert bond_angles(SQUARE[:0], 2).shape == (0, 3)


@pytest.mark.parametrize(("most", "more"), [(1, []), (2, [[0, 2], [0, 4], [1, 3], [2, 4]])])
def test_pairs_few_bonds_apart(most, more):
    assert sorted(pairs_within(SQUARE, 8, most).tolist()) == sorted(SQUARE.tolist() + more)


def test_side_chains_that_may_touch_and_their_tables():
    line = [np.array([[[t, 0.0, 0.0]], [[t + 2.0, 0.0, 0.0]]]) for t in (0.0, 4.0, 9.0)]
    assert touching(line, 2.1) == [(0, 1)] and touching(line, 3.1) == [(0, 1), (1, 2)]
    assert touching(line[:1], 9.0) == []
    table = np.arange(6.0).reshape(2, 3)
    ((one, own),), ((other, turned),), none = neighbour_tables({(0, 1): table}, 3)
    assert (one, other, none) == (1, 0, []) and (own is table) and np.array_equal(turned, table.T)
