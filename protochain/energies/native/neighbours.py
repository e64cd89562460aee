"""Neighbour lists of blocks and of atoms, valid until an atom has moved too far."""

from dataclasses import dataclass

import numpy as np

from protochain.core.arrays import Floats, Integers
from protochain.energies.native.layout import W, scalar
from protochain.energies.native.pairs import difference

SKIN = 0.1  # nm. Margin of the lists, which are valid until an atom has moved half of it.


@dataclass(frozen=True, eq=False)
class Lists:
    """Pairs of blocks and of atoms at one set of positions."""

    x: Floats  # (na, 3) nm: Positions at which the lists were built.
    tiles: Integers  # (n_tiles, 2) int: Pairs of blocks within the cutoff, the second not before the first.
    changing: Integers  # (n, 2) int: Tiles whose atoms do not all belong to one rigid group.
    is_near: np.ndarray  # (n,) bool: Whether atoms of a changing tile may be near each other.
    is_necked: np.ndarray  # (n_tiles,) bool: Whether atoms of a tile may have a neck.
    # (n, 2) int: Pairs of atoms that may be near each other, without pairs at a fixed distance.
    close: Integers
    free: Integers  # (n, 2) int: Pairs of ``close`` that are not exceptions.

    def are_valid(self, x: Floats) -> bool:
        """Whether the lists are valid at x: no atom has moved more than half the skin."""
        return bool(largest_displacement2(self.x, x) <= (0.5 * SKIN) ** 2)


def make_lists(
    x: Floats, near: float, block_near: Floats, neck_reach: float, cutoff: float,
    exceptions: tuple[Integers, Integers], groups: Integers, block_group: Integers,
    tiles: Integers | None = None,
) -> Lists:  # fmt: skip
    """Build the neighbour lists."""
    # x (na, 3) nm, near nm, block_near (blocks,) nm, necked nm, cutoff nm, exceptions (na + 1,) int, groups
    # (na, k) int, block_group (blocks,) int, tiles (n, 2) int.
    boxes, reaches = _boxes(x), (block_near + SKIN, neck_reach + SKIN)
    if tiles is None:
        tiles, is_near, is_necked = _tiles(*boxes, *reaches, cutoff + SKIN)
    else:
        is_near, is_necked = _classify_tiles(tiles, *boxes, *reaches).T
    first, second = block_group[tiles.T]
    changes = (first != second) | (first < 0)
    changing, is_near = tiles[changes], is_near[changes]
    close, is_free = _close_pairs(x, changing[is_near], near + SKIN, exceptions[0], exceptions[1], groups)
    return Lists(x.copy(), tiles, changing, is_near, is_necked, close, close[is_free])


@scalar
def largest_displacement2(a: Floats, b: Floats) -> float:
    """Largest squared displacement of an atom."""
    largest = 0.0
    for i in range(len(a)):
        dx, dy, dz = a[i, 0] - b[i, 0], a[i, 1] - b[i, 1], a[i, 2] - b[i, 2]
        largest = max(largest, dx * dx + dy * dy + dz * dz)
    return largest


def _boxes(x: Floats) -> tuple[Floats, Floats]:
    first = np.arange(0, len(x), W)
    return np.minimum.reduceat(x, first), np.maximum.reduceat(x, first)


def _tiles(
    low: Floats, high: Floats, near: Floats, neck_reach: float, cutoff: float
) -> tuple[Integers, np.ndarray, np.ndarray]:
    """Sorted pairs of blocks within the cutoff, and whether they are near and may have necks."""
    axis = int(np.argmax(np.ptp(low, axis=0)))
    tiles, kinds = _sweep_tiles(np.argsort(low[:, axis]), axis, low, high, near, neck_reach, cutoff)
    order = np.argsort(tiles @ [len(low), 1])
    is_near, is_necked = kinds[order].T
    return tiles[order], is_near, is_necked


@scalar
def _sweep_tiles(
    order: Integers, axis: int, low: Floats, high: Floats, near: Floats, neck_reach: float, cutoff: float
) -> tuple[Integers, np.ndarray]:
    """Pairs of blocks within the cutoff, and whether they are near and have necks, as two columns."""
    # Sweep along the axis with the largest spread: a block is compared only with blocks that begin before its
    # end. With a short cutoff the time per atom hardly grows with the number of atoms.
    n, room = len(low), 1024
    tiles, kinds = np.empty((room, 2), np.int64), np.empty((room, 2), np.bool_)
    count = 0
    for a in range(n):
        i = order[a]
        for b in range(a, n):
            j = order[b]
            if low[j, axis] >= high[i, axis] + cutoff:
                break
            distance2 = _box_distance2(low, high, i, j)
            if distance2 < cutoff * cutoff:
                if count == room:
                    room *= 2
                    tiles, kinds = grow_rows(tiles, room), grow_rows(kinds, room)
                tiles[count, 0], tiles[count, 1] = min(i, j), max(i, j)
                kinds[count, 0] = distance2 < max(near[i], near[j]) ** 2
                kinds[count, 1] = distance2 < neck_reach * neck_reach
                count += 1
    return tiles[:count].copy(), kinds[:count].copy()


@scalar
def _classify_tiles(
    tiles: Integers, low: Floats, high: Floats, near: Floats, neck_reach: float
) -> np.ndarray:  # fmt: skip
    """Whether pairs of blocks are near and may have necks, as two columns."""
    kinds = np.empty((len(tiles), 2), np.bool_)
    for k in range(len(tiles)):
        distance2 = _box_distance2(low, high, tiles[k, 0], tiles[k, 1])
        kinds[k, 0] = distance2 < max(near[tiles[k, 0]], near[tiles[k, 1]]) ** 2
        kinds[k, 1] = distance2 < neck_reach * neck_reach
    return kinds


@scalar
def _box_distance2(low: Floats, high: Floats, i: int, j: int) -> float:
    distance2 = 0.0
    for k in range(3):
        gap = max(low[i, k] - high[j, k], low[j, k] - high[i, k], 0.0)
        distance2 += gap * gap
    return distance2


@scalar
def grow_rows(rows: np.ndarray, room: int) -> np.ndarray:
    """Copy rows into an array with room for more rows."""
    grown = np.empty((room, rows.shape[1]), rows.dtype)
    # Element by element, because an assignment of slices would compile for three seconds.
    for i in range(len(rows)):
        for j in range(rows.shape[1]):
            grown[i, j] = rows[i, j]
    return grown


@scalar
def _close_pairs(
    x: Floats, tiles: Integers, reach: float, start: Integers, partner: Integers, groups: Integers
) -> tuple[Integers, np.ndarray]:
    n, room = len(x), 1024
    pairs, is_free = np.empty((room, 2), np.int64), np.empty((room, 1), np.bool_)
    count = 0
    for k in range(len(tiles)):
        for i in range(tiles[k, 0] * W, min(n, (tiles[k, 0] + 1) * W)):
            for j in range(max(i + 1, tiles[k, 1] * W), min(n, (tiles[k, 1] + 1) * W)):
                if difference(x, i, j)[3] >= reach * reach or _share_group(groups, i, j):
                    continue
                if count == room:
                    room *= 2
                    pairs, is_free = grow_rows(pairs, room), grow_rows(is_free, room)
                pairs[count, 0], pairs[count, 1], is_free[count, 0] = i, j, True
                for place in range(start[i], start[i + 1]):
                    if partner[place] == j:
                        is_free[count, 0] = False
                count += 1
    return pairs[:count].copy(), is_free[:count, 0].copy()


@scalar
def _share_group(groups: Integers, i: int, j: int) -> bool:
    for a in range(groups.shape[1]):
        for b in range(groups.shape[1]):
            if groups[i, a] == groups[j, b] and groups[i, a] >= 0:
                return True
    return False


def block_groups(groups: Integers) -> Integers:
    """(blocks,) int: rigid group of all atoms of a block, -1 for none, from groups (na, k)."""
    group = []
    for first in range(0, len(groups), W):
        rows = groups[first : first + W]
        group.append(min((g for g in rows[0] if g >= 0 and (rows == g).any(axis=1).all()), default=-1))
    return np.array(group, dtype=np.int64)


def partners(pairs: Integers, n: int) -> tuple[Integers, Integers]:
    """Start of each atom's partners of higher index in a list of pairs, and the partners."""
    order = np.argsort(pairs @ [n, 1])
    first, second = pairs[order].T if len(pairs) else np.zeros((2, 0), np.int64)
    return np.searchsorted(first, np.arange(n + 1)).astype(np.int64), np.ascontiguousarray(second)
