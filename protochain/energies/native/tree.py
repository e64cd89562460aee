"""A tree over blocks of atoms, and the pairs of its nodes that act as near or far.

Atoms are ordered by recursive bisection of the longest side of their box, so that blocks of W atoms and
groups of them are compact. Each of the CHUNKS has a tree of its own: what it sums inward and outward needs
no other. Barnes, Hut, Nature 324:446 (1986); both nodes are opened in turn: Dehnen, J. Comput. Phys. 179:27
(2002).
"""

from dataclasses import dataclass

import numpy as np

from protochain.core.arrays import Floats, Integers
from protochain.energies.native.layout import CHUNKS, W, scalar
from protochain.energies.native.neighbours import SKIN, wider

FIRST, END, LEFT, RIGHT, PARENT = range(5)
"""Columns of a node: first block, that after the last; children, -1 for a leaf; parent, -1 for a root."""


@dataclass(frozen=True, eq=False)
class Tree:
    """Nodes about fixed centres, parents before children, those of a chunk side by side."""

    order: Integers  # (na,) int: Atoms in the order of the blocks.
    nodes: Integers  # (n, 5) int.
    roots: Integers  # (CHUNKS + 1,) int: First node of each chunk.
    centre: Floats  # (n, 3) nm.
    radius: Floats  # (n,) nm: Largest distance of an atom from the centre.
    start: Integers  # (n + 1,) int.
    source: Integers  # (m,) int: Far nodes of each node, from its start on; far from each other.
    near: Integers  # (k, 2) int: Pairs of blocks that are not far, the second not before the first, in order.


def plant(x: Floats, opening: float, least: float) -> Tree:
    """Build the tree at positions x (na, 3) in nm: least nm."""
    n = -(-len(x) // W)
    order, nodes = _bisected(x, n)
    roots = np.flatnonzero(nodes[:, PARENT] < 0)
    centre, radius = _balls(x[order], nodes)
    near, far = _separated(nodes, roots, centre, radius, opening, least)
    near = near[np.lexsort((near[:, 1], near[:, 0]))]
    both = np.concatenate([far, far[:, ::-1]])
    both = both[np.lexsort((both[:, 1], both[:, 0]))]
    start = np.searchsorted(both[:, 0], np.arange(len(nodes) + 1)).astype(np.int64)
    return Tree(
        order,
        nodes,
        np.append(roots, len(nodes)),
        centre,
        radius,
        start,
        np.ascontiguousarray(both[:, 1]),
        near,
    )


@scalar
def _bisected(x: Floats, n_blocks: int) -> tuple[Integers, Integers]:
    """Order of the atoms, and nodes: halves of several chunks are chunks, those of one are blocks."""
    n = len(x)
    order, nodes, count = np.arange(n), np.empty((2 * n_blocks, 5), np.int64), 0
    # Pending: first and last chunk (0, 0 within one), first and last block, parent, whether the right child.
    pending = np.empty((128, 6), np.int64)
    pending[0, 0], pending[0, 1], pending[0, 2] = 0, CHUNKS, 0
    pending[0, 3], pending[0, 4], pending[0, 5] = n_blocks, -1, 0
    left = 1
    while left:
        left -= 1
        first, last, begin, end, parent, is_right = pending[left]
        if last - first == 1:
            first, last = 0, 0
        if first == last:
            me = count
            nodes[me, 0], nodes[me, 1], nodes[me, 2], nodes[me, 3], nodes[me, 4] = begin, end, -1, -1, parent
            if parent >= 0:
                nodes[parent, 3 if is_right else 2] = me
            count += 1
            if end - begin <= 1:
                continue
            middle, chunk = (begin + end + 1) // 2, 0
        else:
            me, chunk = -1, (first + last) // 2
            middle = chunk * n_blocks // CHUNKS
        mine = order[begin * W : min(n, end * W)].copy()
        axis, widest = 0, -1.0
        for a in range(3):
            low, high = np.inf, -np.inf
            for i in mine:
                low, high = min(low, x[i, a]), max(high, x[i, a])
            if high - low > widest:
                axis, widest = a, high - low
        along = np.empty(len(mine))
        for k in range(len(mine)):
            along[k] = x[mine[k], axis]
        sorted_ = np.argsort(along, kind="mergesort")
        for k in range(len(mine)):
            order[begin * W + k] = mine[sorted_[k]]
        for right in (1, 0):
            at = pending[left]
            at[0], at[1] = (chunk, last) if right else (first, chunk)
            if first == last:
                at[0], at[1] = 0, 0
            at[2], at[3] = (middle, end) if right else (begin, middle)
            at[4], at[5] = me, right
            left += 1
    return order, nodes[:count].copy()


@scalar
def _balls(x: Floats, nodes: Integers) -> tuple[Floats, Floats]:
    """Centre of each node's box, and radius about it."""
    centre, radius = np.empty((len(nodes), 3)), np.zeros(len(nodes))
    for node in range(len(nodes)):
        begin, end = nodes[node, 0] * W, min(len(x), nodes[node, 1] * W)
        for axis in range(3):
            low, high = np.inf, -np.inf
            for i in range(begin, end):
                low, high = min(low, x[i, axis]), max(high, x[i, axis])
            centre[node, axis] = 0.5 * (low + high)
        for i in range(begin, end):
            d2 = 0.0
            for axis in range(3):
                d2 += (x[i, axis] - centre[node, axis]) ** 2
            radius[node] = max(radius[node], np.sqrt(d2))
    return centre, radius


@scalar
def _separated(
    nodes: Integers, roots: Integers, centre: Floats, radius: Floats, opening: float, least: float
) -> tuple[Integers, Integers]:
    """Pairs of leaves that are near, as blocks, and pairs of nodes that are far."""
    near, far = np.empty((1024, 2), np.int64), np.empty((1024, 2), np.int64)
    n_near, n_far = 0, 0
    pending = np.empty((4096, 2), np.int64)
    for one in range(len(roots)):
        for two in range(one, len(roots)):
            pending[0, 0], pending[0, 1], left = roots[one], roots[two], 1
            while left:
                left -= 1
                a, b = pending[left]
                if left + 3 > len(pending):
                    pending = wider(pending, 2 * len(pending))
                if a == b and nodes[a, 2] >= 0:
                    low, high = nodes[a, 2], nodes[a, 3]
                    pending[left, 0], pending[left, 1] = low, low
                    pending[left + 1, 0], pending[left + 1, 1] = low, high
                    pending[left + 2, 0], pending[left + 2, 1] = high, high
                    left += 3
                    continue
                distance, reach = 0.0, radius[a] + radius[b] + SKIN
                for axis in range(3):
                    distance += (centre[a, axis] - centre[b, axis]) ** 2
                distance = np.sqrt(distance)
                if reach <= opening * distance and distance - reach >= least:
                    if n_far == len(far):
                        far = wider(far, 2 * len(far))
                    far[n_far, 0], far[n_far, 1] = a, b
                    n_far += 1
                elif nodes[a, 2] < 0 and nodes[b, 2] < 0:
                    if n_near == len(near):
                        near = wider(near, 2 * len(near))
                    near[n_near, 0] = min(nodes[a, 0], nodes[b, 0])
                    near[n_near, 1] = max(nodes[a, 0], nodes[b, 0])
                    n_near += 1
                else:
                    opened = nodes[b, 2] < 0 or (nodes[a, 2] >= 0 and radius[a] >= radius[b])
                    for side in range(2):
                        pending[left, 0] = nodes[a, 2 + side] if opened else a
                        pending[left, 1] = b if opened else nodes[b, 2 + side]
                        left += 1
    return near[:n_near].copy(), far[:n_far].copy()


def screened_pairs(tree: Tree, x: Floats, born: Floats, reach: float) -> tuple[Integers, np.ndarray]:
    """Pairs of blocks that are far, but feel by how much f of generalised Born differs from r."""
    # x (na, 3) nm, born (na,) nm -> (n, 2) int: Pairs of blocks, the second after the first, in order -> (n,
    # W) bool: Rows of the first in which an atom does.
    most = np.array([born[first * W : end * W].max() for first, end in tree.nodes[:, :2]])
    low, high = _corners(x, tree.nodes)
    return _screened(tree.nodes, tree.roots[:-1], tree.near, x, born, most, low, high, 4.0 * reach)


@scalar
def _corners(x: Floats, nodes: Integers) -> tuple[Floats, Floats]:
    low, high = np.full((len(nodes), 3), np.inf), np.full((len(nodes), 3), -np.inf)
    for node in range(len(nodes)):
        for i in range(nodes[node, 0] * W, min(len(x), nodes[node, 1] * W)):
            for axis in range(3):
                low[node, axis] = min(low[node, axis], x[i, axis])
                high[node, axis] = max(high[node, axis], x[i, axis])
    return low, high


@scalar
def _screened(
    nodes: Integers, roots: Integers, near: Integers, x: Floats, born: Floats, most: Floats, low: Floats,
    high: Floats, reach: float,
) -> tuple[Integers, np.ndarray]:  # fmt: skip
    n_blocks = -(-len(x) // W)
    leaf, is_near = np.empty(n_blocks, np.int64), np.full(n_blocks, -1)
    for node in range(len(nodes)):
        if nodes[node, 2] < 0:
            leaf[nodes[node, 0]] = node
    tiles, rows = np.empty((1024, 2), np.int64), np.zeros((1024, W), np.bool_)
    count, listed = 0, 0
    pending = np.empty(4096, np.int64)
    for i in range(n_blocks):
        a = leaf[i]
        while listed < len(near) and near[listed, 0] == i:
            is_near[near[listed, 1]] = i
            listed += 1
        for root in roots:
            left, pending[0] = 1, root
            while left:
                left -= 1
                b = pending[left]
                if nodes[b, 1] <= i + 1:
                    continue
                gap2 = 0.0
                for axis in range(3):
                    gap = max(low[b, axis] - high[a, axis], low[a, axis] - high[b, axis]) - SKIN
                    gap2 += max(gap, 0.0) ** 2
                if gap2 >= reach * most[a] * most[b]:
                    continue
                if nodes[b, 2] >= 0:
                    pending[left], pending[left + 1] = nodes[b, 2], nodes[b, 3]
                    left += 2
                    continue
                j = nodes[b, 0]
                if is_near[j] == i:
                    continue
                if count == len(tiles):
                    tiles, rows = wider(tiles, 2 * count), wider(rows, 2 * count)
                any_row = False
                for k in range(W):
                    rows[count, k] = False
                    at = i * W + k
                    if at >= len(x):
                        continue
                    gap2 = 0.0
                    for axis in range(3):
                        gap = max(low[b, axis] - x[at, axis], x[at, axis] - high[b, axis]) - SKIN
                        gap2 += max(gap, 0.0) ** 2
                    rows[count, k] = gap2 < reach * born[at] * most[b]
                    any_row |= rows[count, k]
                if any_row:
                    tiles[count, 0], tiles[count, 1] = i, j
                    count += 1
    return tiles[:count].copy(), rows[:count].copy()
