"""Cholesky's factorisation of sparse symmetric matrices of 3x3 blocks, one row of blocks for each atom.

The pattern of the factor follows from the elimination tree (Liu, SIAM J. Matrix Anal. Appl. 11:134, 1990),
row by row (Davis, *Direct Methods for Sparse Linear Systems*, 2006, 4.1-4.3). Columns are then computed from
left to right. Blocks of 3x3 need a ninth of the indices of a general library. SuperLU is nine times slower.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.linalg import spilu

from protochain.core.arrays import Floats, Integers
from protochain.mechanics.multibody.algebra import kernel


def elimination_order(n: int, pairs: Integers) -> Integers:
    """Order of n rows for a sparse factor, by multiple minimum degree."""
    # pairs (m, 2) int -> (n,) int: Place of each row in the order.
    # With the order for other pairs, as at the start of a run, the factor needs 3 to 100 times the products.
    i, j = pairs.T
    values = np.r_[np.full(2 * len(i), -1.0), np.full(n, 2.0 * len(i) + 1.0)]
    rows, columns = np.r_[i, j, np.arange(n)], np.r_[j, i, np.arange(n)]
    graph = coo_array((values, (rows, columns)), shape=(n, n)).tocsc()
    # An incomplete factor is found sooner, in the same order.
    settings = {"SymmetricMode": True}
    factors = spilu(graph, 1.0, 1.0, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=settings)
    return np.asarray(factors.perm_c, dtype=np.int64)


@dataclass(frozen=True, eq=False)
class Factor:
    """Factor L of a matrix A = L L^T, in an order of elimination."""

    place: Integers  # (n,) int: Place of each row in the order.
    start: Integers  # (n + 1,) int: Of each column of L.
    rows: Integers  # (m,) int: Of the blocks below the diagonal, ascending in each column.
    blocks: Floats  # (m, 9).
    inverse: Floats  # (n, 9): Inverses of the diagonal blocks of L.

    def solve(self, right: Floats) -> Floats:
        """Solution (3 n,) of A x = b."""
        x = np.empty_like(right)
        _solve(self.place, self.start, self.rows, self.blocks, self.inverse, right, x)
        return x


def factorise(place: Integers, atom_blocks: Floats, pairs: Integers, pair_blocks: Floats) -> Factor:
    """Factorise a positive definite matrix, with blocks (n, 9) of atoms and (m, 9) of pairs (m, 2)."""
    start, rows, first, column, at = _pattern(place, pairs)
    blocks, inverse = np.zeros((len(rows), 9)), np.empty((len(place), 9))
    _put(place, atom_blocks, pairs, pair_blocks, start, rows, blocks, inverse)
    _eliminate(start, rows, first, column, at, blocks, inverse)
    return Factor(place, start, rows, blocks, inverse)


@kernel
def _pattern(place: Integers, pairs: Integers) -> tuple[Integers, Integers, Integers, Integers, Integers]:
    # Start and rows of each column; and of each row start, columns and the blocks' places in them.
    n = len(place)
    # Neighbours before each row.
    begin = np.zeros(n + 1, np.int64)
    for m in range(len(pairs)):
        begin[max(place[pairs[m, 0]], place[pairs[m, 1]]) + 1] += 1
    for i in range(n):
        begin[i + 1] += begin[i]
    filled, before = begin[:-1].copy(), np.empty(len(pairs), np.int64)
    for m in range(len(pairs)):
        a, b = place[pairs[m, 0]], place[pairs[m, 1]]
        row = max(a, b)
        before[filled[row]] = min(a, b)
        filled[row] += 1
    # Elimination tree, with paths shortened.
    parent, ancestor = np.full(n, -1, np.int64), np.full(n, -1, np.int64)
    for i in range(n):
        for m in range(begin[i], begin[i + 1]):
            k = before[m]
            while k != -1 and k < i:
                above = ancestor[k]
                ancestor[k] = i
                if above == -1:
                    parent[k] = i
                k = above
    # Row i of the factor: the paths in the tree from its neighbours up to i.
    first, start, seen = np.zeros(n + 1, np.int64), np.zeros(n + 1, np.int64), np.full(n, -1, np.int64)
    for i in range(n):
        seen[i] = i
        for m in range(begin[i], begin[i + 1]):
            k = before[m]
            while seen[k] != i:
                seen[k] = i
                start[k + 1] += 1
                first[i + 1] += 1
                k = parent[k]
    for i in range(n):
        start[i + 1] += start[i]
        first[i + 1] += first[i]
    filled, seen = start[:-1].copy(), np.full(n, -1, np.int64)
    rows, column = np.empty(start[n], np.int64), np.empty(start[n], np.int64)
    at = np.empty(start[n], np.int64)
    for i in range(n):
        seen[i], free = i, first[i]
        for m in range(begin[i], begin[i + 1]):
            k = before[m]
            while seen[k] != i:
                seen[k] = i
                rows[filled[k]], column[free], at[free] = i, k, filled[k]
                filled[k] += 1
                free += 1
                k = parent[k]
    return start, rows, first, column, at


@kernel
def _put(
    place: Integers, atom_blocks: Floats, pairs: Integers, pair_blocks: Floats, start: Integers,
    rows: Integers, blocks: Floats, diagonal: Floats,
) -> None:  # fmt: skip
    """Write the matrix into the pattern of its factor: blocks below the diagonal and on it."""
    for i in range(len(place)):
        for p in range(9):
            diagonal[place[i], p] = atom_blocks[i, p]
    for m in range(len(pairs)):
        a, b = place[pairs[m, 0]], place[pairs[m, 1]]
        low, high = start[min(a, b)], start[min(a, b) + 1]
        while low < high:
            middle = (low + high) // 2
            if rows[middle] < max(a, b):
                low = middle + 1
            else:
                high = middle
        for p in range(3):
            for q in range(3):
                # The block of row a and column b, or below the diagonal its transpose.
                blocks[low, 3 * p + q] += pair_blocks[m, 3 * p + q] if a > b else pair_blocks[m, 3 * q + p]


@kernel
def _eliminate(
    start: Integers, rows: Integers, first: Integers, column: Integers, at: Integers, blocks: Floats,
    diagonal: Floats,
) -> None:  # fmt: skip
    """Convert a matrix to its factor, and its diagonal blocks to inverses of the factor's diagonal blocks."""
    n = len(diagonal)
    sums = np.zeros((n, 9))
    for j in range(n):
        # Column j of the matrix, minus the products of earlier columns.
        pivot = diagonal[j].copy()
        for m in range(start[j], start[j + 1]):
            for p in range(9):
                sums[rows[m], p] = blocks[m, p]
        for e in range(first[j], first[j + 1]):
            block = at[e]
            a, b, c, d, f, g, h, p, q = blocks[block]
            pivot[0] -= a * a + b * b + c * c
            pivot[3] -= d * a + f * b + g * c
            pivot[4] -= d * d + f * f + g * g
            pivot[6] -= h * a + p * b + q * c
            pivot[7] -= h * d + p * f + q * g
            pivot[8] -= h * h + p * p + q * q
            for m in range(block + 1, start[column[e] + 1]):
                i = rows[m]
                for r in range(0, 9, 3):
                    u, v, w = blocks[m, r], blocks[m, r + 1], blocks[m, r + 2]
                    sums[i, r] -= u * a + v * b + w * c
                    sums[i, r + 1] -= u * d + v * f + w * g
                    sums[i, r + 2] -= u * h + v * p + w * q
        # Lower triangle of the factor of the diagonal block, and its inverse.
        s = 1.0 / np.sqrt(pivot[0])
        x, y = pivot[3] * s, pivot[6] * s
        t = 1.0 / np.sqrt(pivot[4] - x * x)
        z = (pivot[7] - x * y) * t
        o = 1.0 / np.sqrt(pivot[8] - y * y - z * z)
        st, to = -x * s * t, -z * t * o
        so = (x * z * t - y) * s * o
        for p in range(9):
            diagonal[j, p] = 0.0
        diagonal[j, 0], diagonal[j, 3], diagonal[j, 4] = s, st, t
        diagonal[j, 6], diagonal[j, 7], diagonal[j, 8] = so, to, o
        # Blocks below the diagonal, times the transposed inverse.
        for m in range(start[j], start[j + 1]):
            i = rows[m]
            for r in range(0, 9, 3):
                u, v, w = sums[i, r], sums[i, r + 1], sums[i, r + 2]
                blocks[m, r] = u * s
                blocks[m, r + 1] = u * st + v * t
                blocks[m, r + 2] = u * so + v * to + w * o


@kernel
def _solve(
    place: Integers, start: Integers, rows: Integers, blocks: Floats, inverse: Floats, right: Floats,
    x: Floats,
) -> None:  # fmt: skip
    """Solve L L^T x = b, from the first column to the last and back."""
    n = len(place)
    y = np.empty((n, 3))
    for i in range(n):
        for p in range(3):
            y[place[i], p] = right[3 * i + p]
    for j in range(n):
        u, v, w = y[j, 0], y[j, 1], y[j, 2]
        a = inverse[j, 0] * u
        b = inverse[j, 3] * u + inverse[j, 4] * v
        c = inverse[j, 6] * u + inverse[j, 7] * v + inverse[j, 8] * w
        y[j, 0], y[j, 1], y[j, 2] = a, b, c
        for m in range(start[j], start[j + 1]):
            i = rows[m]
            for p in range(3):
                y[i, p] -= blocks[m, 3 * p] * a + blocks[m, 3 * p + 1] * b + blocks[m, 3 * p + 2] * c
    for j in range(n - 1, -1, -1):
        a, b, c = y[j, 0], y[j, 1], y[j, 2]
        for m in range(start[j], start[j + 1]):
            u, v, w = y[rows[m], 0], y[rows[m], 1], y[rows[m], 2]
            a -= blocks[m, 0] * u + blocks[m, 3] * v + blocks[m, 6] * w
            b -= blocks[m, 1] * u + blocks[m, 4] * v + blocks[m, 7] * w
            c -= blocks[m, 2] * u + blocks[m, 5] * v + blocks[m, 8] * w
        y[j, 0] = inverse[j, 0] * a + inverse[j, 3] * b + inverse[j, 6] * c
        y[j, 1] = inverse[j, 4] * b + inverse[j, 7] * c
        y[j, 2] = inverse[j, 8] * c
    for i in range(n):
        for p in range(3):
            x[3 * i + p] = y[place[i], p]
