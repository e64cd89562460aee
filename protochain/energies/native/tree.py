"""A tree over blocks of atoms, and the pairs of its nodes that act as near or far.

Atoms are ordered by recursive bisection of the longest side of their box, so that blocks of W atoms and
groups of blocks are compact. Each of the CHUNKS has a separate tree, so its inward and outward sums are
independent. Barnes, Hut, Nature 324:446 (1986). Both nodes are opened in turn: Dehnen, J. Comput. Phys.
179:27 (2002).
"""

from dataclasses import dataclass

import numpy as np

from protochain.core.arrays import Floats, Integers
from protochain.energies.native.layout import CHUNKS, W, scalar
from protochain.energies.native.neighbours import SKIN, grow_rows

FIRST, END, LEFT, RIGHT, PARENT = range(5)
"""Columns of a node: range of blocks, children (-1 for a leaf), and parent (-1 for a root)."""


@dataclass(frozen=True, eq=False)
class Tree:
    """Nodes about fixed centres, by chunk, with parents before children."""

    order: Integers  # (na,) int: Atoms in the order of the blocks.
    nodes: Integers  # (n, 5) int.
    roots: Integers  # (CHUNKS + 1,) int: First node of each chunk.
    centre: Floats  # (n, 3) nm.
    radius: Floats  # (n,) nm: Largest distance of an atom from the centre.
    start: Integers  # (n + 1,) int.
    source: Integers  # (m,) int: Far nodes of each node, from its start on.
    near: Integers  # (k, 2) int: Pairs of blocks that are not far, the second not before the first, in order.


def build_tree(x: Floats, opening: float, least_distance: float) -> Tree:
    """Build the tree at positions x (na, 3) in nm, with a least distance of far atoms in nm."""
    n = -(-len(x) // W)
    order, nodes = _bisect(x, n)
    roots = np.flatnonzero(nodes[:, PARENT] < 0)
    centre, radius = _bounding_spheres(x[order], nodes)
    near, far = _pair_nodes(nodes, roots, centre, radius, opening, least_distance)
    near = near[np.lexsort((near[:, 1], near[:, 0]))]
    ordered_pairs = np.concatenate([far, far[:, ::-1]])
    ordered_pairs = ordered_pairs[np.lexsort((ordered_pairs[:, 1], ordered_pairs[:, 0]))]
    start = np.searchsorted(ordered_pairs[:, 0], np.arange(len(nodes) + 1)).astype(np.int64)
    source = np.ascontiguousarray(ordered_pairs[:, 1])
    return Tree(order, nodes, np.append(roots, len(nodes)), centre, radius, start, source, near)


@scalar
def _bisect(x: Floats, n_blocks: int) -> tuple[Integers, Integers]:
    """Order of the atoms, and nodes. Several chunks are halved by chunks, a single chunk by blocks."""
    n = len(x)
    order, nodes, count = np.arange(n), np.empty((2 * n_blocks, 5), np.int64), 0
    # Pending: first and last chunk (0, 0 within one), first and last block, parent, whether the right child.
    pending = np.empty((128, 6), np.int64)
    pending[0, 0], pending[0, 1], pending[0, 2] = 0, CHUNKS, 0
    pending[0, 3], pending[0, 4], pending[0, 5] = n_blocks, -1, 0
    n_pending = 1
    while n_pending:
        n_pending -= 1
        first, last, begin, end, parent, is_right = pending[n_pending]
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
        # Sort the atoms along the longest side of their box, then split it.
        atoms = order[begin * W : min(n, end * W)].copy()
        axis, widest = 0, -1.0
        for a in range(3):
            low, high = np.inf, -np.inf
            for i in atoms:
                low, high = min(low, x[i, a]), max(high, x[i, a])
            if high - low > widest:
                axis, widest = a, high - low
        along = np.empty(len(atoms))
        for k in range(len(atoms)):
            along[k] = x[atoms[k], axis]
        sorted_ = np.argsort(along, kind="mergesort")
        for k in range(len(atoms)):
            order[begin * W + k] = atoms[sorted_[k]]
        for right in (1, 0):
            entry = pending[n_pending]
            entry[0], entry[1] = (chunk, last) if right else (first, chunk)
            if first == last:
                entry[0], entry[1] = 0, 0
            entry[2], entry[3] = (middle, end) if right else (begin, middle)
            entry[4], entry[5] = me, right
            n_pending += 1
    return order, nodes[:count].copy()


@scalar
def _bounding_spheres(x: Floats, nodes: Integers) -> tuple[Floats, Floats]:
    """Centre and bounding radius of each node."""
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
def _pair_nodes(
    nodes: Integers, roots: Integers, centre: Floats, radius: Floats, opening: float, least_distance: float
) -> tuple[Integers, Integers]:
    """Near pairs of leaves, as blocks, and far pairs of nodes."""
    near, far = np.empty((1024, 2), np.int64), np.empty((1024, 2), np.int64)
    n_near, n_far = 0, 0
    pending = np.empty((4096, 2), np.int64)
    for first_root in range(len(roots)):
        for second_root in range(first_root, len(roots)):
            pending[0, 0], pending[0, 1], n_pending = roots[first_root], roots[second_root], 1
            while n_pending:
                n_pending -= 1
                a, b = pending[n_pending]
                if n_pending + 3 > len(pending):
                    pending = grow_rows(pending, 2 * len(pending))
                if a == b and nodes[a, 2] >= 0:
                    low, high = nodes[a, 2], nodes[a, 3]
                    pending[n_pending, 0], pending[n_pending, 1] = low, low
                    pending[n_pending + 1, 0], pending[n_pending + 1, 1] = low, high
                    pending[n_pending + 2, 0], pending[n_pending + 2, 1] = high, high
                    n_pending += 3
                    continue
                distance, reach = 0.0, radius[a] + radius[b] + SKIN
                for axis in range(3):
                    distance += (centre[a, axis] - centre[b, axis]) ** 2
                distance = np.sqrt(distance)
                # Far if angle and gap allow it, near if both are leaves. Otherwise open the larger node.
                if reach <= opening * distance and distance - reach >= least_distance:
                    if n_far == len(far):
                        far = grow_rows(far, 2 * len(far))
                    far[n_far, 0], far[n_far, 1] = a, b
                    n_far += 1
                elif nodes[a, 2] < 0 and nodes[b, 2] < 0:
                    if n_near == len(near):
                        near = grow_rows(near, 2 * len(near))
                    near[n_near, 0] = min(nodes[a, 0], nodes[b, 0])
                    near[n_near, 1] = max(nodes[a, 0], nodes[b, 0])
                    n_near += 1
                else:
                    opens_first = nodes[b, 2] < 0 or (nodes[a, 2] >= 0 and radius[a] >= radius[b])
                    for side in range(2):
                        pending[n_pending, 0] = nodes[a, 2 + side] if opens_first else a
                        pending[n_pending, 1] = b if opens_first else nodes[b, 2 + side]
                        n_pending += 1
    return near[:n_near].copy(), far[:n_far].copy()


def screened_pairs(tree: Tree, x: Floats, born: Floats, reach: float) -> tuple[Integers, np.ndarray]:
    """Far pairs of blocks for which f of generalised Born differs from r."""
    # x (na, 3) nm, born (na,) nm -> (n, 2) int: Sorted pairs of blocks, the second after the first,
    # (n, W) bool: Rows of the first block with such pairs of atoms.
    born_max = np.array([born[first * W : end * W].max() for first, end in tree.nodes[:, :2]])
    low, high = _bounding_boxes(x, tree.nodes)
    return _screened_tiles(tree.nodes, tree.roots[:-1], tree.near, x, born, born_max, low, high, 4.0 * reach)


@scalar
def _bounding_boxes(x: Floats, nodes: Integers) -> tuple[Floats, Floats]:
    low, high = np.full((len(nodes), 3), np.inf), np.full((len(nodes), 3), -np.inf)
    for node in range(len(nodes)):
        for i in range(nodes[node, 0] * W, min(len(x), nodes[node, 1] * W)):
            for axis in range(3):
                low[node, axis] = min(low[node, axis], x[i, axis])
                high[node, axis] = max(high[node, axis], x[i, axis])
    return low, high


@scalar
def _screened_tiles(
    nodes: Integers, roots: Integers, near: Integers, x: Floats, born: Floats, born_max: Floats, low: Floats,
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
        # Descend from each root to leaves whose box is within reach of the block.
        for root in roots:
            n_pending, pending[0] = 1, root
            while n_pending:
                n_pending -= 1
                b = pending[n_pending]
                if nodes[b, 1] <= i + 1:
                    continue
                gap2 = 0.0
                for axis in range(3):
                    gap = max(low[b, axis] - high[a, axis], low[a, axis] - high[b, axis]) - SKIN
                    gap2 += max(gap, 0.0) ** 2
                if gap2 >= reach * born_max[a] * born_max[b]:
                    continue
                if nodes[b, 2] >= 0:
                    pending[n_pending], pending[n_pending + 1] = nodes[b, 2], nodes[b, 3]
                    n_pending += 2
                    continue
                j = nodes[b, 0]
                if is_near[j] == i:
                    continue
                if count == len(tiles):
                    tiles, rows = grow_rows(tiles, 2 * count), grow_rows(rows, 2 * count)
                has_rows = False
                for k in range(W):
                    rows[count, k] = False
                    atom = i * W + k
                    if atom >= len(x):
                        continue
                    gap2 = 0.0
                    for axis in range(3):
                        gap = max(low[b, axis] - x[atom, axis], x[atom, axis] - high[b, axis]) - SKIN
                        gap2 += max(gap, 0.0) ** 2
                    rows[count, k] = gap2 < reach * born[atom] * born_max[b]
                    has_rows |= rows[count, k]
                if has_rows:
                    tiles[count, 0], tiles[count, 1] = i, j
                    count += 1
    return tiles[:count].copy(), rows[:count].copy()
