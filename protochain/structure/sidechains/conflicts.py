"""Pairs of side chains that may touch, and tables of the pair energies of their conformers."""

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.spatial import KDTree

from protochain.core.arrays import Floats

Pairs = dict[tuple[int, int], Floats]
"""Tables (n_i, n_j) of sites i < j that interact."""


def touching(places: Sequence[Floats], reach: float) -> list[tuple[int, int]]:
    """Pairs i < j of sites whose conformers, at positions (n, k, 3) each, come as near as a reach."""
    if len(places) < 2:
        return []
    centres, sizes = zip(*map(sphere, places), strict=True)
    near = sorted(KDTree(np.array(centres)).query_pairs(2 * max(sizes) + reach))
    return [(i, j) for i, j in near if np.linalg.norm(centres[i] - centres[j]) < sizes[i] + sizes[j] + reach]


def sphere(x: Floats) -> tuple[Floats, float]:
    """Centre and radius of all positions (n, k, 3)."""
    centre = x.reshape(-1, 3).mean(axis=0)
    return centre, float(np.linalg.norm(x - centre, axis=-1).max())


def neighbour_tables(pairs: Mapping[tuple[int, int], Floats], n: int) -> list[list[tuple[int, Floats]]]:
    """Return the partners and tables of each of n sites, with the states of that site in the rows."""
    tables: list[list[tuple[int, Floats]]] = [[] for _ in range(n)]
    for (i, j), table in pairs.items():
        tables[i].append((j, table))
        tables[j].append((i, table.T))
    return tables
