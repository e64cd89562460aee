"""Factors of the equations of closed loops, by sparse orthogonal elimination along chains of loops.

With M^-1 = [1 - H psi K]^T D^-1 [1 - H psi K], G M^-1 G^T = Y Y^T. A row of Y has only the freedoms on the
paths from its bodies to the root. Rows of Y are eliminated group by group in the order of the equations: O(n)
if neighbours alone share freedoms. George, Heath, Linear Algebra Appl. 34:69 (1980).
"""

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from protochain.core.arrays import Floats, Integers
from protochain.mechanics.multibody import algebra
from protochain.mechanics.multibody.algebra import add, cross, dot, kernel, scale, subtract
from protochain.mechanics.multibody.small import solve_lower
from protochain.mechanics.multibody.tree import PARENT, SLIDE, TURN, Q, V

DEPENDENT = 1e-9
"""Part of an equation that no other has, by the size it could have, below which it is rounding. Loops are
closed to 1e-12."""
_GROUP = 5
"""Equations of a group, at least: the order of elimination is free among them, and fixed between groups."""


class Fronts(NamedTuple):
    """Groups of equations, and freedoms in the order in which the groups reach them."""

    starts: Integers  # (k + 1,): First equation of each group, then the number of equations.
    ends: Integers  # (k,): End of the equations that share freedoms with this or an earlier group.
    freedoms: Integers  # Freedoms by the first group that has them.
    reached: Integers  # (k + 1,): Where each group begins in ``freedoms``.
    first: Integers  # (n_v,): First equation of the first group of each freedom.
    # (3,): Most equations of a freedom, most equations of a front, most rows of a front.
    sizes: Integers


def moved_by(links: Integers, body: Integers) -> np.ndarray:
    """(m, n_v) bool: freedoms on the paths from pairs of bodies (m, 2) to their roots."""
    moved = np.zeros((len(body), links[-1, V]), dtype=np.bool_)
    for row, bodies in zip(moved, body.tolist(), strict=True):
        for b in bodies:
            while b >= 0:
                row[links[b, V] : links[b + 1, V]] = True
                b = links[b, PARENT]
    return moved


def order_along(moved: np.ndarray) -> Integers:
    """Order of pairs of bodies in which neighbours share freedoms, from those that move them, (m, n_v)."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import reverse_cuthill_mckee

    def spread(order: Integers) -> int:
        used = moved[order][:, moved.any(axis=0)]
        return int(np.sum(len(used) - 1 - np.argmax(used[::-1], axis=0) - np.argmax(used, axis=0)))

    as_given, shares = np.arange(len(moved)), csr_array(moved.astype(np.int64))
    narrow = reverse_cuthill_mckee((shares @ shares.T).tocsr(), symmetric_mode=True).astype(np.int64)
    return narrow if spread(narrow) < spread(as_given) else as_given


def find_fronts(links: Integers, body: Integers) -> Fronts:
    """Groups of equations between pairs of bodies (m, 2), in the order of the equations."""
    m = len(body)
    changes = np.flatnonzero(np.any(body[1:] != body[:-1], axis=1)) + 1
    starts = [0]
    for place in changes.tolist():
        if place - starts[-1] >= _GROUP:
            starts.append(place)
    fronts = _fronts_of(links, body, np.array([*starts, m]))
    # Where most equations share freedoms, the order of elimination is free.
    if 2 * np.sum(fronts.ends - fronts.starts[:-1]) > m * len(fronts.ends):
        return _fronts_of(links, body, np.array([0, m]))
    return fronts


def _fronts_of(links: Integers, body: Integers, starts: Integers) -> Fronts:
    k, n_v = len(starts) - 1, links[-1, V]
    bodies = [np.unique(body[a:b], axis=0) for a, b in pairwise(starts)]
    moved = np.array([np.any(moved_by(links, pairs), axis=0) for pairs in bodies]).reshape(k, n_v)
    used = np.flatnonzero(moved.any(axis=0))
    first = np.argmax(moved, axis=0)
    last = k - 1 - np.argmax(moved[::-1], axis=0)
    reach = np.arange(k)
    np.maximum.at(reach, first[used], last[used])
    ends = starts[1:][np.maximum.accumulate(reach)]
    freedoms = used[np.argsort(first[used], kind="stable")]
    reached = np.searchsorted(first[freedoms], np.arange(k + 1))
    width = int(np.max(starts[1:][last[used]] - starts[first[used]], initial=0))
    height = rows = 0
    for g in range(k):
        rows += int(reached[g + 1] - reached[g])
        height, rows = max(height, rows), min(rows, int(ends[g] - starts[g + 1]))
    sizes = np.array([width, np.max(ends - starts[:-1], initial=0), height])
    return Fronts(starts, ends, freedoms, reached, starts[first], sizes)


@kernel
def factor_loops_at(
    links: Integers, bodies: Floats, rotation: Floats, origin: Floats, gain: Floats, pivot: Floats,
    root: Floats, body: Integers, wrench: Floats, size: float, fronts: tuple[Any, ...],
) -> tuple[Floats, Floats, Floats, Integers, Integers]:  # fmt: skip
    """Scales, lengths, coefficients, their spans and order of :class:`FactoredLoops`."""
    m, first, width = len(body), fronts[4], fronts[5][0]
    y, scales, lengths, squares = np.zeros((len(first), width)), np.zeros(m), np.zeros(m), np.zeros(m)
    for i in range(m):
        # The square of the largest length that y could have decides what is rounding. Loads of the two bodies
        # pass inward one after the other: those of bodies that are fixed to each other cancel.
        largest = 0.0
        for side in range(2):
            moment, force = algebra.pair(wrench[i], side)
            b = body[i, side]
            while b >= 0:
                k = links[b, V]
                w = links[b + 1, V] - k
                if w == 6:
                    x = np.array([moment[0], moment[1], moment[2], force[0], force[1], force[2]])
                    solve_lower(root[links[b, Q] - k], 6, x)
                    for j in range(6):
                        y[k + j, i - first[k + j]] += x[j]
                        largest += x[j] * x[j]
                if w == 1:
                    axis = algebra.hinge_axis(rotation, b)
                    along = bodies[b, TURN] * dot(axis, moment) + bodies[b, SLIDE] * dot(axis, force)
                    y[k, i - first[k]] += along / np.sqrt(pivot[b])
                    turn, slide = bodies[b, TURN] * bodies[b, TURN], bodies[b, SLIDE] * bodies[b, SLIDE]
                    push = dot(force, force)
                    largest += (turn * (dot(moment, moment) + size * size * push) + slide * push) / pivot[b]
                p = links[b, PARENT]
                if p >= 0:
                    moment = add(moment, cross(algebra.lever(origin, b, p), force))
                if w == 1:
                    g, h = algebra.pair(gain, b)
                    moment, force = subtract(moment, scale(along, g)), subtract(force, scale(along, h))
                b = p
        lengths[i] = np.sqrt(largest)
    for k in range(len(first)):
        for j in range(min(width, m - first[k])):
            squares[first[k] + j] += y[k, j] * y[k, j]
    for i in range(m):
        length, largest = np.sqrt(squares[i]), lengths[i]
        lengths[i] = 0.0
        if length > DEPENDENT * largest:
            scales[i], lengths[i] = 1.0 / length, length / largest
    for k in range(len(first)):
        for j in range(min(width, m - first[k])):
            y[k, j] *= scales[first[k] + j]
    return scales, lengths, *_eliminate(y, lengths, fronts)


@kernel
def _eliminate(y: Floats, lengths: Floats, fronts: tuple[Any, ...]) -> tuple[Floats, Integers, Integers]:
    """Coefficients (r, window) of unit rows by orthonormal ones, their spans, and the rows of these."""
    # Householder's reflections, pivoting in a group: Golub, Van Loan, Matrix Computations (2013), 5.4.
    # Next is the row whose rest exceeds its rounding, an inverse length, by the largest factor.
    starts, ends, freedoms, reached, _, (width, window, height) = fronts
    most = min(len(y), len(lengths))
    coefficients, spans, order = (
        np.zeros((most, window)),
        np.empty((most, 2), np.int64),
        np.empty(most, np.int64),
    )
    front, weights, squares = np.empty((height, window)), np.empty(window), np.empty(window)
    rank, n_rows = 0, 0
    for group in range(len(ends)):
        start, end = starts[group], ends[group]
        size, columns = starts[group + 1] - start, end - start
        for t in range(reached[group], reached[group + 1]):
            for j in range(columns):
                front[n_rows, j] = y[freedoms[t], j] if j < width else 0.0
            n_rows += 1
        while n_rows > 0:
            squares[:size] = 0.0
            for i in range(n_rows):
                for j in range(size):
                    squares[j] += front[i, j] * front[i, j]
            best, largest = -1, DEPENDENT
            for j in range(size):
                exceeds = np.sqrt(squares[j]) * lengths[start + j]
                if exceeds > largest:
                    best, largest = j, exceeds
            if best < 0:
                break
            _reflect(front, 0, n_rows, best, squares[best], columns, weights)
            for j in range(columns):
                counts = j >= size or np.sqrt(squares[j]) * lengths[start + j] > DEPENDENT
                coefficients[rank, j] = front[0, j] if counts else 0.0
            spans[rank, 0], spans[rank, 1], order[rank] = start, end, start + best
            rank, n_rows = rank + 1, n_rows - 1
            front[0, :columns] = front[n_rows, :columns]
        left = columns - size
        following = ends[group + 1] - starts[group + 1] if group + 1 < len(ends) else 0
        for i in range(n_rows):
            for j in range(following):
                front[i, j] = front[i, j + size] if j < left else 0.0
        # No more rows than the equations that are left.
        for j in range(left if n_rows > left else 0):
            square = 0.0
            for i in range(j, n_rows):
                square += front[i, j] * front[i, j]
            _reflect(front, j, n_rows, j, square, left, weights)
        n_rows = min(n_rows, left)
    return coefficients[:rank], spans[:rank], order[:rank]


@kernel
def _reflect(
    rows: Floats, top: int, bottom: int, pivot: int, square: float, columns: int, weights: Floats
) -> None:
    """Reflect rows from ``top`` to ``bottom`` so that only the first has a component in column ``pivot``."""
    length, corner = np.sqrt(square), rows[top, pivot]
    if length == 0.0:
        return
    diagonal = -length if corner > 0.0 else length
    rows[top, pivot] = corner - diagonal
    weights[:columns] = 0.0
    for i in range(top, bottom):
        part = rows[i, pivot]
        for j in range(columns):
            weights[j] += part * rows[i, j]
    spread = 1.0 / (length * (length + abs(corner)))
    for i in range(top, bottom):
        part = spread * rows[i, pivot]
        for j in range(columns):
            rows[i, j] -= part * weights[j]
        rows[i, pivot] = 0.0
    rows[top, pivot] = diagonal


@kernel
def least_impulses(
    scales: Floats, coefficients: Floats, spans: Integers, order: Integers, target: Floats
) -> Floats:
    """Impulses (m,), scaled of least norm, that change rates by ``target`` (m,)."""
    # With Y = C Q and impulses z of scaled equations, velocities Q^T c satisfy C c = target, and C^T z = c.
    # Without Q these are as stable as with it (Paige, SIAM J. Numer. Anal. 10:1160, 1973).
    r, x, residual = len(order), np.zeros(len(scales)), scales * target
    c, change = np.empty(r), np.empty(r)
    for p in range(r):
        c[p] = residual[order[p]] / coefficients[p, order[p] - spans[p, 0]]
        _add_times(-c[p], coefficients, p, spans, residual)
    if r < np.count_nonzero(scales):
        square, begins = _square(coefficients, spans)
        if _factor_square(square, begins):
            # Redundant equations: c of least squares and z = C (C^T C)^-1 c, once more for what is left.
            for _ in range(2):
                for p in range(r):
                    change[p] = _times(coefficients, p, spans, residual)
                _solve_square(square, begins, change)
                for p in range(r):
                    c[p] += change[p]
                    _add_times(-change[p], coefficients, p, spans, residual)
            for _ in range(2):
                for p in range(r):
                    change[p] = c[p] - _times(coefficients, p, spans, x)
                _solve_square(square, begins, change)
                for p in range(r):
                    _add_times(change[p], coefficients, p, spans, x)
            return scales * x
    for p in range(r - 1, -1, -1):
        x[order[p]] = (c[p] - _times(coefficients, p, spans, x)) / coefficients[p, order[p] - spans[p, 0]]
    return scales * x


@kernel
def _times(coefficients: Floats, p: int, spans: Integers, x: Floats) -> float:
    total, start = 0.0, spans[p, 0]
    for j in range(spans[p, 1] - start):
        total += coefficients[p, j] * x[start + j]
    return total


@kernel
def _add_times(factor: float, coefficients: Floats, p: int, spans: Integers, x: Floats) -> None:
    start = spans[p, 0]
    for j in range(spans[p, 1] - start):
        x[start + j] += factor * coefficients[p, j]


@kernel
def _square(coefficients: Floats, spans: Integers) -> tuple[Floats, Integers]:
    """C^T C, whose row p has the columns from ``begins[p]`` to p."""
    r, most, begins = len(spans), 0, np.zeros(len(spans), np.int64)
    for p in range(r):
        begins[p] = begins[p - 1] if p else 0
        while spans[begins[p], 1] <= spans[p, 0] and begins[p] < p:
            begins[p] += 1
        most = max(most, p - begins[p] + 1)
    square = np.empty((r, most))
    for p in range(r):
        for q in range(begins[p], p + 1):
            shift, total = spans[p, 0] - spans[q, 0], 0.0
            for j in range(spans[q, 1] - spans[p, 0]):
                total += coefficients[p, j] * coefficients[q, shift + j]
            square[p, q - begins[p]] = total
    return square, begins


@kernel
def _factor_square(square: Floats, begins: Integers) -> bool:
    """Overwrite a banded matrix by Cholesky's factor. Return False if it is not positive."""
    for p in range(len(begins)):
        diagonal = square[p, p - begins[p]]
        for q in range(begins[p], p + 1):
            total = square[p, q - begins[p]]
            for k in range(max(begins[p], begins[q]), q):
                total -= square[p, k - begins[p]] * square[q, k - begins[q]]
            if q < p:
                square[p, q - begins[p]] = total / square[q, q - begins[q]]
            elif total > 1e-15 * diagonal:
                square[p, p - begins[p]] = np.sqrt(total)
            else:
                return False
    return True


@kernel
def _solve_square(factor: Floats, begins: Integers, x: Floats) -> None:
    """Overwrite x by the solution with the matrix of this factor."""
    for p in range(len(x)):
        for q in range(begins[p], p):
            x[p] -= factor[p, q - begins[p]] * x[q]
        x[p] /= factor[p, p - begins[p]]
    for p in range(len(x) - 1, -1, -1):
        x[p] /= factor[p, p - begins[p]]
        for q in range(begins[p], p):
            x[q] -= factor[p, q - begins[p]] * x[p]
