"""The factorisation in blocks against dense algebra."""

import numpy as np
import pytest

from protochain.minimisers.cholesky import _pattern, elimination_order, factorise


def scene(seed, n, m):
    """Blocks between random rows, some twice, the first not always the smaller; and the dense matrix."""
    rng = np.random.default_rng(seed)
    pairs = rng.integers(0, n, size=(m, 2))
    pairs = pairs[pairs[:, 0] != pairs[:, 1]]
    pairs = np.concatenate([pairs, pairs[:3, ::-1]]).astype(np.int64)
    own = np.zeros((n, 3, 3)) + rng.uniform(0.5, 1.0, n)[:, None, None] * np.eye(3)
    shared = rng.normal(size=(len(pairs), 3, 3))
    dense = np.zeros((n, 3, n, 3))
    for (i, j), block in zip(pairs, shared, strict=True):
        dense[i, :, j] += block
        dense[j, :, i] += block.T
        # No block is larger than those that it couples: the matrix stays positive.
        size = np.linalg.norm(block, 2) * np.eye(3)
        own[i] += size
        own[j] += size
    for i in range(n):
        dense[i, :, i] += own[i]
    return own.reshape(n, 9), pairs, shared.reshape(-1, 9), dense.reshape(3 * n, 3 * n)


@pytest.mark.parametrize(("n", "m"), [(1, 0), (2, 1), (7, 12), (40, 60), (60, 600)])
def test_a_solution_is_that_of_dense_algebra(n, m):
    own, pairs, shared, dense = (
        scene(n, n, m) if m else (np.eye(3).reshape(1, 9) * 2.0, *EMPTY, 2.0 * np.eye(3))
    )
    right = np.random.default_rng(1).normal(size=3 * n)
    for place in (elimination_order(n, pairs), np.random.default_rng(2).permutation(n)):
        found = factorise(place, own, pairs, shared).solve(right)
        assert found == pytest.approx(np.linalg.solve(dense, right), rel=1e-9, abs=1e-11)


EMPTY = np.empty((0, 2), np.int64), np.empty((0, 9))


def test_the_pattern_is_that_of_elimination_by_hand():
    _, pairs, _, _ = scene(3, 30, 40)
    place = np.random.default_rng(0).permutation(30)
    filled = np.zeros((30, 30), dtype=bool)
    filled[place[pairs[:, 0]], place[pairs[:, 1]]] = True
    filled |= filled.T
    for k in range(30):
        later = np.flatnonzero(filled[k, k + 1 :]) + k + 1
        filled[np.ix_(later, later)] = True
    start, rows, first, column, at = _pattern(place, pairs)
    for k in range(30):
        below = np.flatnonzero(filled[k + 1 :, k]) + k + 1
        assert np.array_equal(rows[start[k] : start[k + 1]], below)
        left = slice(first[k], first[k + 1])
        assert set(column[left].tolist()) == set(np.flatnonzero(filled[k, :k]).tolist())
        assert (rows[at[left]] == k).all()
    assert len(rows) == start[-1] == first[-1] == len(column)


def test_an_order_keeps_the_factor_of_a_chain_as_sparse_as_the_chain():
    n = 200
    chain = np.column_stack([np.arange(n - 1), np.arange(1, n)])
    shuffled = np.random.default_rng(0).permutation(n)[chain]
    place = elimination_order(n, shuffled)
    assert sorted(place.tolist()) == list(range(n))
    assert len(_pattern(place, shuffled)[1]) == n - 1
