"""Neighbour lists against all pairs: every entry and its order, and distances at the limit itself."""

import numpy as np
import pytest

from protochain.energies.native import neighbours
from protochain.energies.native.layout import W
from protochain.energies.native.neighbours import SKIN, largest_displacement2, make_lists, partners


def box_gap(x, a, b):
    """Distance of the bounding boxes of two blocks of 32 atoms."""
    one, other = x[32 * a : 32 * a + 32], x[32 * b : 32 * b + 32]
    apart = [
        max(one[:, k].min() - other[:, k].max(), other[:, k].min() - one[:, k].max(), 0.0) for k in range(3)
    ]
    return float(np.sqrt(np.sum(np.square(apart))))


def listed(x, near, block_near, necked, cutoff, excepted, groups):
    """All lists by loops over all blocks and atoms."""
    n = len(x)
    blocks = range((n + 31) // 32)
    tiles, is_near, is_necked, close = [], [], [], []
    for a in blocks:
        for b in blocks:
            gap = box_gap(x, a, b)
            if a <= b and gap < cutoff + 0.1:
                tiles.append([a, b])
                is_near.append(gap < max(block_near[a], block_near[b]) + 0.1)
                is_necked.append(gap < necked + 0.1)
    for (a, b), is_close in zip(tiles, is_near, strict=True):
        for i in range(32 * a, 32 * a + 32) if is_close else ():
            for j in range(32 * b, 32 * b + 32):
                if i < j < n and np.linalg.norm(x[i] - x[j]) < near + 0.1:
                    own = {group for group in groups[i] if group >= 0}
                    if not own & set(groups[j]):
                        close.append([i, j])
    free = [pair for pair in close if tuple(pair) not in excepted]
    return tiles, is_near, is_necked, close, free


@pytest.mark.parametrize("n", [1, 32, 33, 70, 150])
@pytest.mark.parametrize("seed", [0, 1])
def test_lists_are_those_of_all_pairs_whatever_the_last_block(n, seed):
    assert W == 32 and SKIN == 0.1
    rng = np.random.default_rng(seed)
    # Along a line, with gaps between the blocks, so that these lie at all distances.
    gaps = np.cumsum([0.0, 0.05, 0.3, 0.45, 0.65])
    x = np.column_stack([0.01 * np.arange(n) + gaps[np.arange(n) // 32], *rng.uniform(-0.4, 0.4, (2, n))])
    x = np.ascontiguousarray(x[:, rng.permutation(3)] * rng.choice([-1.0, 1.0], 3))
    block_near = np.array([0.1, 0.3, 0.5, 0.2, 0.4])[: (n + 31) // 32]
    pairs = np.sort(rng.integers(0, n, (4 * n, 2)), axis=1)
    pairs = np.unique(pairs[pairs[:, 0] < pairs[:, 1]], axis=0)[:: 1 + seed]
    groups = np.where(rng.random((n, 2)) < 0.5, -1, rng.integers(0, 1 + n // 6, (n, 2)))
    excepted = {tuple(pair) for pair in pairs.tolist()}
    exceptions = partners(pairs[rng.permutation(len(pairs))], n)
    found = make_lists(x, 0.5, block_near, 0.1, 1.2, exceptions, groups, np.full(len(block_near), -1))
    tiles, is_near, is_necked, close, free = listed(x, 0.5, block_near, 0.1, 1.2, excepted, groups)
    assert found.tiles.tolist() == tiles
    assert found.is_near.tolist() == is_near and found.is_necked.tolist() == is_necked
    assert found.close.tolist() == close and found.free.tolist() == free
    assert n < 70 or len(close) > len(free) > 0
    assert n < 150 or 0 < np.sum(is_necked) < np.sum(is_near) < len(tiles) < 15
    assert found.x is not x and np.array_equal(found.x, x)


@pytest.mark.parametrize("n", [1, 32, 33, 64, 70])
def test_each_block_has_one_box_and_there_are_no_others(n):
    # Spare boxes would be in no list, but pairs of them take time and memory.
    x = np.random.default_rng(n).normal(size=(n, 3))
    blocks = [x[first : first + 32] for first in range(0, n, 32)]
    low, high = neighbours._boxes(x)
    assert np.array_equal(low, [block.min(axis=0) for block in blocks])
    assert np.array_equal(high, [block.max(axis=0) for block in blocks])


def test_lists_of_very_many_pairs_keep_all_of_them():
    # All atoms near each other: 4950 pairs, more than the first room for them and its double.
    x = np.random.default_rng(0).uniform(0.0, 0.1, (100, 3))
    pairs = np.array([[0, 1], [40, 99], [98, 99]])
    no_groups = np.full((100, 1), -1)
    found = make_lists(x, 0.5, np.full(4, 0.5), 0.3, 1.2, partners(pairs, 100), no_groups, no_groups[:4, 0])
    every = {(i, j) for i in range(100) for j in range(i + 1, 100)}
    assert len(found.close) == 4950 and {tuple(pair) for pair in found.close.tolist()} == every
    free = {tuple(pair) for pair in found.free.tolist()}
    assert every - free == {(0, 1), (40, 99), (98, 99)} and len(found.free) == 4947


def two_points(distance, axis, near=0.9, block_near=0.9, necked=0.9, cutoff=0.9):
    """Lists of two blocks, all atoms of each at one point."""
    x = np.zeros((64, 3))
    x[32:, axis] = distance
    none = partners(np.zeros((0, 2), np.int64), 64)
    groups = np.repeat([[0], [1]], 32, axis=0)
    return make_lists(x, near, np.full(2, block_near), necked, cutoff, none, groups, np.full(2, -1))


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_pair_at_the_limit_itself_is_beyond_it(axis, sign):
    # 0.4 and the skin are 0.5, exactly.
    for distance, within in ((0.5, False), (0.5 - 1e-12, True), (0.5 + 1e-12, False)):
        assert ([0, 1] in two_points(sign * distance, axis, cutoff=0.4).tiles.tolist()) is within
        for limit in ("block_near", "necked"):
            lists = two_points(sign * distance, axis, **{limit: 0.4})
            assert lists.tiles.tolist() == [[0, 0], [0, 1], [1, 1]]
            marks = lists.is_near if limit == "block_near" else lists.is_necked
            assert marks.tolist() == [True, within, True]
            other = lists.is_necked if limit == "block_near" else lists.is_near
            assert other.tolist() == [True, True, True]
        lists = two_points(sign * distance, axis, near=0.4)
        assert lists.close.tolist() == [[i, j] for i in range(32) for j in range(32, 64) if within]
    # Atoms of blocks that are not near are not close, however near they are.
    assert len(two_points(sign * 0.5, axis, block_near=0.4).close) == 0


def test_the_furthest_move_is_the_largest_of_all_atoms():
    a = np.array([[1.0, 2.0, 3.0], [0.0, 0.0, 0.0], [5.0, 5.0, 5.0]])
    move = np.array([[1.0, 0.0, 0.0], [3.0, -4.0, 12.0], [0.0, 2.0, 0.0]])
    assert largest_displacement2(a, a + move) == largest_displacement2(a + move, a) == 169.0
    assert (
        largest_displacement2(a[:1], a[:1] + np.array([[2.0, 3.0, 6.0]])) == 49.0
        and largest_displacement2(a, a) == 0.0
    )
    for k in range(3):
        assert largest_displacement2(a, a + np.roll(move, k, axis=0)) == 169.0


def test_lists_hold_up_to_half_the_skin_itself():
    lists = two_points(0.3, 0)
    for axis in range(3):
        for move, held in ((0.05, True), (0.0500001, False), (-0.05, True), (-0.0500001, False)):
            # From 0, so that the move is exact.
            x = lists.x.copy()
            x[5, axis] = move
            assert lists.are_valid(x) is held


def test_atoms_share_a_group_in_any_column_but_none_is_no_group():
    groups = np.array([[1, -1, 4], [-1, -1, -1], [2, 3, 1], [0, -1, -1], [5, 0, -1]])
    expected = {(0, 2), (3, 4)}
    for i in range(5):
        for j in range(5):
            shares = {(min(i, j), max(i, j))} <= expected or (i == j and i != 1)
            assert neighbours._share_group(groups, i, j) is shares


def test_partners_are_sorted_and_begin_where_the_starts_say():
    pairs = np.array([[3, 5], [0, 4], [3, 4], [0, 2], [1, 4]])
    start, second = partners(pairs, 6)
    assert start.tolist() == [0, 2, 3, 3, 5, 5, 5] and second.tolist() == [2, 4, 4, 4, 5]
    assert start.dtype == second.dtype == np.int64
    start, second = partners(np.zeros((0, 2), np.int64), 3)
    assert start.tolist() == [0, 0, 0, 0] and len(second) == 0 and second.dtype == np.int64
