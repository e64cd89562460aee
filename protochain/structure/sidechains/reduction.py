"""Remaining states of sites, and criteria that rule out states that no minimum has.

Goldstein's dead-end elimination: Biophys. J. 66:1335 (1994). Bounds by message passing: Globerson, Jaakkola,
NIPS 2007 (energies move between tables, and no sum of them changes).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from protochain.core.arrays import Floats, Integers
from protochain.core.compilation import njit
from protochain.core.graph import components, group_members

ROUND_OFF = 1e-9
"""kJ/mol. Round-off of energies. A smaller spread counts as zero."""
_ROUNDS = 30  # Largest number of rounds of message passing. They end when the bound hardly rises.
_RISE = 1e-3

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


@dataclass(frozen=True, eq=False)
class Part:
    """Sites and their remaining states."""

    sites: tuple[int, ...]  # Numbers in the whole problem.
    energies: tuple[Floats, ...]  # Self energies of the states.
    states: tuple[Integers, ...]  # Numbers in the whole problem.
    pairs: Pairs  # By places in ``sites``.
    constant: float  # Energy of the decided sites.

    def restrict(self, alive: Sequence[np.ndarray]) -> "Part":
        """Return the part with only these states (n_i,) bool of each site."""
        if all(mask.all() for mask in alive):
            return self
        energies, states = (
            tuple(values[keep] for values, keep in zip(arrays, alive, strict=True))
            for arrays in (self.energies, self.states)
        )
        pairs = {(i, j): table[np.ix_(alive[i], alive[j])] for (i, j), table in self.pairs.items()}
        return Part(self.sites, energies, states, pairs, self.constant)

    def split_decided(self) -> tuple["Part", dict[int, int]]:
        """Return the part of the sites with several states, and the state of each other site."""
        decided = {k for k, energies in enumerate(self.energies) if len(energies) == 1}
        energies, constant, pairs = list(self.energies), self.constant, {}
        for (i, j), table in self.pairs.items():
            if i in decided and j in decided:
                constant += float(table[0, 0])
            elif i in decided:
                energies[j] = energies[j] + table[0]
            elif j in decided:
                energies[i] = energies[i] + table[:, 0]
            else:
                pairs[i, j] = table
        constant += sum(float(energies[k][0]) for k in decided)
        left = [k for k in range(len(self.sites)) if k not in decided]
        part = Part(self.sites, tuple(energies), self.states, pairs, constant).subset(left)
        return part, {self.sites[k]: int(self.states[k][0]) for k in sorted(decided)}

    @property
    def bound(self) -> float:
        """Lower bound of the energy."""
        return self.constant + sum(float(table.min()) for table in (*self.energies, *self.pairs.values()))

    def subset(self, places: Sequence[int]) -> "Part":
        """Return the part of these sites, with the tables between them."""
        at = {k: new for new, k in enumerate(places)}
        return Part(
            tuple(self.sites[k] for k in places), tuple(self.energies[k] for k in places),
            tuple(self.states[k] for k in places),
            {(at[i], at[j]): table for (i, j), table in self.pairs.items() if i in at and j in at},
            self.constant,
        )  # fmt: skip

    def components(self) -> list[list[int]]:
        """Places of the sites of each connected component."""
        pairs = np.array([*self.pairs], dtype=np.int64).reshape(-1, 2)
        return [members.tolist() for members in group_members(components(pairs, len(self.sites)))]


def eliminate_dead_ends(part: Part) -> list[np.ndarray]:
    """Find the states (n_i,) bool of each site that pass Goldstein's criterion."""
    alive = [np.ones(len(energies), dtype=bool) for energies in part.energies]
    partners = neighbour_tables(part.pairs, len(part.sites))
    waiting = dict.fromkeys(range(len(part.sites)))
    while waiting:
        i = next(iter(waiting))
        del waiting[i]
        candidates = np.flatnonzero(alive[i])
        tables = [table[np.ix_(alive[i], alive[j])] for j, table in partners[i]]
        starts = np.cumsum([0, *(table.shape[1] for table in tables)])
        rows = np.ascontiguousarray(np.hstack([np.zeros((len(candidates), 0)), *tables]))
        left = _goldstein(part.energies[i][candidates], rows, starts)
        if not left.all():
            alive[i][candidates[~left]] = False
            waiting |= dict.fromkeys([i, *(j for j, _ in partners[i])])
    return alive


@njit(cache=True)
def _goldstein(energies: Floats, rows: Floats, starts: Integers) -> np.ndarray:
    """(n,) bool: undominated states, by pair energies ``rows`` of neighbour k from column starts[k] on."""
    n, n_neighbours = len(energies), len(starts) - 1
    lowest, highest = energies.copy(), energies.copy()
    for r in range(n):
        for k in range(n_neighbours):
            low, high = np.inf, -np.inf
            for c in range(starts[k], starts[k + 1]):
                low, high = min(low, rows[r, c]), max(high, rows[r, c])
            lowest[r] += low
            highest[r] += high
    left = np.ones(n, dtype=np.bool_)
    for r in range(n):
        for t in range(n):
            if t == r or not left[t] or highest[r] < lowest[t]:
                continue
            excess = energies[r] - energies[t]
            for k in range(n_neighbours):
                low = np.inf
                for c in range(starts[k], starts[k + 1]):
                    low = min(low, rows[r, c] - rows[t, c])
                excess += low
            # The first of equal states stays.
            if excess > ROUND_OFF or (t < r and excess >= 0.0):
                left[r] = False
                break
    return left


def raise_bound(part: Part) -> Part:
    """Return the same energies, moved between tables to raise the sum of their minima."""
    if not part.pairs:
        return part
    first = np.cumsum([0, *map(len, part.energies)])
    start = np.cumsum([0, *(table.size for table in part.pairs.values())])
    energies = np.concatenate(part.energies)
    tables = np.concatenate([table.ravel() for table in part.pairs.values()])
    _pass_messages(energies, first, tables, start, np.array(list(part.pairs)))
    pairs = {
        (i, j): tables[begin:end].reshape(len(part.energies[i]), len(part.energies[j]))
        for (i, j), begin, end in zip(part.pairs, start, start[1:], strict=False)
        if tables[begin:end].max() >= ROUND_OFF
    }
    return Part(part.sites, tuple(np.split(energies, first[1:-1])), part.states, pairs, part.constant)


@njit(cache=True)
def _pass_messages(single: Floats, first: Integers, tables: Floats, start: Integers, edges: Integers) -> None:
    """Repeatedly divide the energies of each table and its two sites equally between the sites."""
    # Site i has single[first[i]:first[i + 1]]. Minima of tables move to sites. Separable tables become 0.
    before = -np.inf
    for turn in range(_ROUNDS + 1):
        bound, is_last = 0.0, turn == _ROUNDS
        for e in range(len(edges)):
            rows = single[first[edges[e, 0]] : first[edges[e, 0] + 1]]
            columns = single[first[edges[e, 1]] : first[edges[e, 1] + 1]]
            table = tables[start[e] : start[e + 1]].reshape(len(rows), len(columns))
            if not is_last:
                for r in range(len(rows)):
                    for s in range(len(columns)):
                        table[r, s] += rows[r] + columns[s]
                least = np.full(len(columns), np.inf)
                for r in range(len(rows)):
                    low = np.inf
                    for s in range(len(columns)):
                        low, least[s] = min(low, table[r, s]), min(least[s], table[r, s])
                    rows[r] = 0.5 * low
                columns[:] = 0.5 * least
                for r in range(len(rows)):
                    for s in range(len(columns)):
                        table[r, s] -= rows[r] + columns[s]
            for r in range(len(rows)):
                low = table[r].min()
                table[r] -= low
                rows[r] += low
            for s in range(len(columns)):
                low = table[:, s].min()
                table[:, s] -= low
                columns[s] += low
        for i in range(len(first) - 1):
            bound += single[first[i] : first[i + 1]].min()
        if is_last or bound < before + _RISE:
            break
        before = bound
