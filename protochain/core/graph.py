"""Graphs of bonds: bonded atoms, connected molecules, and neighbours few bonds away."""

from collections.abc import Hashable
from itertools import combinations
from typing import Any, TypeVar

import numpy as np
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components

from protochain.core.arrays import Integers

Neighbours = tuple[tuple[int, ...], ...]
_Node = TypeVar("_Node", bound=Hashable)


def neighbours(bonds: Integers, n: int) -> Neighbours:
    """For each of n atoms, those that bonds (m, 2) join to it, in their order."""
    near: list[list[int]] = [[] for _ in range(n)]
    for i, j in bonds.tolist():
        near[i].append(j)
        near[j].append(i)
    return tuple(map(tuple, near))


def both_ways(bonds: Integers) -> Integers:
    """(2 m, 2) int: bonds (m, 2), and the same from their other ends."""
    return np.vstack([bonds, bonds[:, ::-1]])


def bond_angles(bonds: Integers, n: int) -> Integers:
    """(k, 3) int: atoms of every bond angle, its vertex in the middle, sorted by vertex, then the others."""
    angles = [
        (first, middle, last)
        for middle, around in enumerate(neighbours(bonds, n))
        for first, last in combinations(sorted(around), 2)
    ]
    return np.array(angles, dtype=np.int64).reshape(-1, 3)


def components(bonds: Integers, n: int) -> Integers:
    """(n,) int: number of the molecule of each atom, connected by bonds (m, 2)."""
    return np.asarray(connected_components(_adjacency(bonds, n), directed=False)[1], dtype=np.int64)


def group_members(of: Integers) -> list[Integers]:
    """Members of each group in ascending order. ``of`` (n,) has the group of each member, from 0 on."""
    return np.split(np.argsort(of, kind="stable"), np.cumsum(np.bincount(of))[:-1])


def pairs_within(bonds: Integers, n: int, n_most: int) -> Integers:
    """(k, 2) int: pairs of n atoms separated by at most so many of the bonds (m, 2), smaller index first."""
    step = _adjacency(both_ways(bonds), n)
    reach, power = step, step
    for _ in range(n_most - 1):
        power = power @ step
        reach = reach + power
    pairs = coo_array(reach)
    upper = pairs.row < pairs.col
    return np.column_stack([pairs.row[upper], pairs.col[upper]]).astype(np.int64)


def within(bonded: Any, start: _Node, n_most: int) -> set[_Node]:
    """Atoms at most so many bonds away, and the atom itself. ``bonded[atom]`` are the neighbours of one."""
    atoms = {start}
    for _ in range(n_most):
        atoms |= {neighbour for atom in atoms for neighbour in bonded[atom]}
    return atoms


def beyond(bonded: Any, first: int, second: int) -> set[int]:
    """Atoms on the second's side of a bond, without both. Through a ring they lead back to the first."""
    atoms, ahead = {first, second}, [second]
    while ahead:
        fresh = [i for i in bonded[ahead.pop()] if i not in atoms]
        atoms.update(fresh)
        ahead += fresh
    return atoms - {first, second}


def _adjacency(bonds: Integers, n: int) -> csr_array:
    return coo_array((np.ones(len(bonds), dtype=np.int64), bonds.T), shape=(n, n)).tocsr()
