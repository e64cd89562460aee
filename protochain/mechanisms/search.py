"""Which particles may touch, and which triangles: cells for particles, a tree of boxes for a surface."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from protochain.core.arrays import Floats, Integers, Value, floats, freeze
from protochain.core.compilation import njit
from protochain.core.errors import MechanicsError
from protochain.core.settings import document_fields

MOST_CELLS = 2**20
"""Cells along an axis, so that the number of a cell fits into an integer."""
MARGIN = 1.0 + 1e-9
"""Edge of a cell in diameters: above rounding, so that what touches is never two cells apart."""
LEAF = 4
"""Most items of a leaf of a tree of boxes."""


def kernel(function: Any) -> Any:
    """Compile a search. It rounds products and sums as numpy does."""
    return njit(cache=True, error_model="numpy")(function)


def touching(centre: Floats, radius: Floats) -> Integers:
    """Find the pairs of spheres that touch or overlap, by Cartesian cells.

    Parameters
    ----------
    centre : (n, 3) float
        Centres.
    radius : (n,) float
        Radii. A skin, within which pairs stay valid, is half of it added to each.

    Returns
    -------
    (k, 2) int
        Pairs (i, j), i < j, in order, with ``|c_i - c_j| <= r_i + r_j``.

    Raises
    ------
    MechanicsError
        If a centre is not finite, or a radius is not a length.

    Notes
    -----
    Cells with an edge of the largest diameter, of which each is compared with itself and its neighbours:
    Allen, Tildesley, *Computer Simulation of Liquids* (1987), section 5.3. O(n) for spheres of like size,
    however far some have flown: cells share the places of a table as long as there are spheres.
    """
    n = len(centre)
    centre, radius = floats(centre, (n, 3), "centre"), floats(radius, (n,), "radius")
    _refuse("centre", ~np.isfinite(centre).all(axis=1))
    _refuse("radius", np.less(radius, 0.0) | ~np.isfinite(radius))
    if not n:
        return np.empty((0, 2), np.int64)
    return in_order(near_pairs(centre, radius, edge_of(centre, radius)), n)


def _refuse(name: str, mask: Any) -> None:
    if np.any(mask):
        raise MechanicsError(
            f"sphere {int(np.argmax(mask))}: its {name} must be finite, a radius not negative"
        )


@kernel
def edge_of(centre: Floats, radius: Floats) -> float:
    """Edge of the cells: the largest diameter, or more if the cells would be too many."""
    widest = 0.0
    for k in range(3):
        widest = max(widest, np.max(centre[:, k]) - np.min(centre[:, k]))
    edge = max(2.0 * np.max(radius), widest / MOST_CELLS)
    return edge * MARGIN if edge > 0.0 else 1.0


@kernel
def sort_into_cells(x: Floats, edge: float) -> tuple[Integers, Integers, Integers, Integers]:
    """Sort points by their cells."""
    # x (n, 3) -> order (n,) int: Points, cell by cell, those of one cell as they were given -> cell (n,) int:
    # Number of the cell of each, in that order: x + size[0] (y + size[1] z), with x, y, z from 1 -> start (m
    # + 1,) int: Those of cell c are among ``order[start[k]:start[k + 1]]``, k = c modulo m, a power of two,
    # along with those of cells that share the place -> size (2,) int: Cells along x and along y, with an
    # empty one at each end.
    n = len(x)
    places = 4
    while places < 2 * n:
        places *= 2
    low, size = np.empty(3), np.empty(2, np.int64)
    for k in range(3):
        low[k] = np.min(x[:, k])
        if k < 2:
            # Odd, lest layers fall upon the same places.
            size[k] = (int((np.max(x[:, k]) - low[k]) / edge) + 3) | 1
    own_items, start = np.empty(n, np.int64), np.zeros(places + 1, np.int64)
    for i in range(n):
        a, b, c = (x[i, 0] - low[0]) / edge, (x[i, 1] - low[1]) / edge, (x[i, 2] - low[2]) / edge
        own_items[i] = int(a) + 1 + size[0] * (int(b) + 1 + size[1] * (int(c) + 1))
        start[(own_items[i] & (places - 1)) + 1] += 1
    for k in range(places):
        start[k + 1] += start[k]
    order, cell, filled = np.empty(n, np.int64), np.empty(n, np.int64), start[:-1].copy()
    for i in range(n):
        place = own_items[i] & (places - 1)
        order[filled[place]], cell[filled[place]] = i, own_items[i]
        filled[place] += 1
    return order, cell, start, size


@kernel
def near_pairs(centre: Floats, radius: Floats, edge: float) -> Integers:
    """Pairs of :func:`touching`, cell by cell, for an edge of at least the largest diameter."""
    order, cell, start, size = sort_into_cells(centre, edge)
    n, places, count = len(order), len(start) - 1, 0
    pairs = np.empty((1024, 2), np.int64)
    x, r = np.empty((n, 3)), np.empty(n)
    for a in range(n):
        i = order[a]
        x[a, 0], x[a, 1], x[a, 2], r[a] = centre[i, 0], centre[i, 1], centre[i, 2], radius[i]
    # Of a cell's neighbours those after it, in rows: itself and the next, and four rows of three.
    layer = size[0] * size[1]
    first = np.array([0, size[0] - 1, layer - size[0] - 1, layer - 1, layer + size[0] - 1])
    for a in range(n):
        item = order[a]
        for row in range(5):
            target, width = cell[a] + first[row], 3 if row else 2
            place = target & (places - 1)
            # A row goes on at the beginning of the table where it passes the end.
            beyond = place + width - places
            b, end = start[place] if row else a + 1, start[min(place + width, places)]
            for _ in range(2 if beyond > 0 else 1):
                while count + end - b > len(pairs):
                    pairs = np.concatenate((pairs, pairs))
                for k in range(b, end):
                    dx, dy, dz = (x[a, 0] - x[k, 0], x[a, 1] - x[k, 1], x[a, 2] - x[k, 2])
                    reach, step = r[a] + r[k], cell[k] - target
                    # Written in any case and kept if near: a branch that cannot be foreseen costs more.
                    near = dx * dx + dy * dy + dz * dz <= reach * reach
                    pairs[count, 0], pairs[count, 1] = (min(item, order[k]), max(item, order[k]))
                    count += near & (step >= 0) & (step < width)
                b, end = 0, start[max(beyond, 0)]
    return pairs[:count].copy()


@kernel
def in_order(pairs: Integers, n: int) -> Integers:
    """Pairs of numbers below n sorted by the first, then the second, in O(n + pairs)."""
    for column in (1, 0):
        start = np.zeros(n + 1, np.int64)
        for k in range(len(pairs)):
            start[pairs[k, column] + 1] += 1
        for i in range(n):
            start[i + 1] += start[i]
        into = np.empty_like(pairs)
        for k in range(len(pairs)):
            place = start[pairs[k, column]]
            into[place, 0], into[place, 1] = pairs[k, 0], pairs[k, 1]
            start[pairs[k, column]] += 1
        pairs = into
    return pairs


@document_fields
@dataclass(frozen=True, eq=False)
class BoxTree(Value):
    """Tree of bounding boxes along the axes, each node followed by its descendants."""

    low: Floats  # (nodes, 3) float: Lowest corners of the nodes' boxes.
    high: Floats  # (nodes, 3) float: Highest corners of the nodes' boxes.
    after: Integers  # (nodes,) int: Next node that is not a descendant.
    # (nodes, 2) int: Items ``order[items[k, 0]:items[k, 1]]`` of leaf k, none of another node.
    items: Integers
    order: Integers  # (n,) int: Items as the leaves have them.
    item_low: Floats  # (n, 3) float: Lowest corners of the items' boxes.
    item_high: Floats  # (n, 3) float: Highest corners of the items' boxes.


def box_tree(low: Floats, high: Floats) -> BoxTree:
    """Tree of the bounding boxes of some items, as of triangles.

    Parameters
    ----------
    low, high : (n, 3) float
        Lowest and highest corners of the boxes.

    Returns
    -------
    BoxTree
        Halved at the median along the axis on which the centres spread most: O(n log^2 n), once.

    Raises
    ------
    MechanicsError
        If a corner is not finite, or a box is empty.
    """
    n = len(low)
    low, high = floats(low, (n, 3), "low"), floats(high, (n, 3), "high")
    mask = ~(np.isfinite(low) & np.isfinite(high) & (low <= high)).all(axis=1)
    if np.any(mask):
        raise MechanicsError(f"box {int(np.argmax(mask))}: its corners must be finite, the low one below")
    node_low, node_high, after, items, order = _halve(low, high)
    for array in (after, items, order):
        array.flags.writeable = False
    own_items = freeze(low.copy()), freeze(high.copy())
    return BoxTree(freeze(node_low), freeze(node_high), after, items, order, *own_items)


def overlapping(tree: BoxTree, low: Floats, high: Floats) -> Integers:
    """Which items' boxes overlap which others.

    Parameters
    ----------
    tree : BoxTree
        Boxes of the items.
    low, high : (m, 3) float
        Corners of the others.

    Returns
    -------
    (k, 2) int
        Number of the other, number of the item, in order. Boxes that only touch are among them.
    """
    low, high = floats(low, (len(low), 3), "low"), floats(high, (len(low), 3), "high")
    pairs_found = _overlaps(
        tree.low, tree.high, tree.after, tree.items, tree.order, tree.item_low, tree.item_high, low, high
    )
    return in_order(pairs_found, max(len(low), len(tree.order)))


@kernel
def _halve(low: Floats, high: Floats) -> tuple[Floats, Floats, Integers, Integers, Integers]:
    """Arrays of the tree, node by node, depth first."""
    n = len(low)
    order, n_most = np.arange(n), 2 * n + 1
    node_low, node_high = np.empty((n_most, 3)), np.empty((n_most, 3))
    after, items = np.zeros(n_most, np.int64), np.zeros((n_most, 2), np.int64)
    # Parts of `order` still to be made nodes of.
    parts, waiting, count = np.empty((64, 2), np.int64), 1 if n else 0, 0
    parts[0, 0], parts[0, 1] = 0, n
    ends = np.empty(n_most, np.int64)
    while waiting:
        waiting -= 1
        first, last = parts[waiting, 0], parts[waiting, 1]
        axis, widest = 0, -1.0
        for k in range(3):
            least, most_k, left, right = np.inf, -np.inf, np.inf, -np.inf
            for place in range(first, last):
                i = order[place]
                least, most_k = min(least, low[i, k]), max(most_k, high[i, k])
                # Half of each first: their sum might overflow.
                middle = 0.5 * low[i, k] + 0.5 * high[i, k]
                left, right = min(left, middle), max(right, middle)
            node_low[count, k], node_high[count, k] = least, most_k
            if right - left > widest:
                axis, widest = k, right - left
        ends[count] = last
        if last - first <= LEAF:
            items[count, 0], items[count, 1] = first, last
        else:
            part = order[first:last].copy()
            by_middle = np.argsort(0.5 * low[part, axis] + 0.5 * high[part, axis], kind="mergesort")
            for k in range(last - first):
                order[first + k] = part[by_middle[k]]
            middle_place = (first + last) // 2
            # The last one in is made a node first, so that it follows its parent.
            parts[waiting, 0], parts[waiting, 1] = middle_place, last
            parts[waiting + 1, 0], parts[waiting + 1, 1] = first, middle_place
            waiting += 2
        count += 1
    _link(ends[:count], after)
    low, high = node_low[:count].copy(), node_high[:count].copy()
    return low, high, after[:count].copy(), items[:count].copy(), order


@kernel
def _link(ends: Integers, after: Integers) -> None:
    """Write the next node that is not a descendant: the first later one that ends later."""
    for k in range(len(ends) - 1, -1, -1):
        later = k + 1
        while later < len(ends) and ends[later] <= ends[k]:
            later = after[later]
        after[k] = later


@kernel
def _overlaps(
    node_low: Floats, node_high: Floats, after: Integers, items: Integers, order: Integers,
    item_low: Floats, item_high: Floats, low: Floats, high: Floats,
) -> Integers:  # fmt: skip
    """Pairs of :func:`overlapping`."""
    pairs, count = np.empty((1024, 2), np.int64), 0
    for m in range(len(low)):
        k = 0
        while k < len(after):
            if not _meet(node_low, node_high, k, low, high, m):
                k = after[k]
                continue
            for place in range(items[k, 0], items[k, 1]):
                i = order[place]
                if _meet(item_low, item_high, i, low, high, m):
                    if count == len(pairs):
                        pairs = np.concatenate((pairs, pairs))
                    pairs[count, 0], pairs[count, 1] = m, i
                    count += 1
            k += 1
    return pairs[:count].copy()


@kernel
def _meet(low: Floats, high: Floats, k: int, other_low: Floats, other_high: Floats, m: int) -> bool:
    """Whether two boxes overlap or touch."""
    return (
        low[k, 0] <= other_high[m, 0] and other_low[m, 0] <= high[k, 0]
        and low[k, 1] <= other_high[m, 1] and other_low[m, 1] <= high[k, 1]
        and low[k, 2] <= other_high[m, 2] and other_low[m, 2] <= high[k, 2]
    )  # fmt: skip
