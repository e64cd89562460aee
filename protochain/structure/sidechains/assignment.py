"""Choice of one state for each of several sites: the global minimum of own and pair energies.

Goldstein's dead-end elimination (Biophys. J. 66:1335, 1994) and bounds by message passing (Globerson,
Jaakkola, NIPS 2007) rule out states that the minimum cannot have; what is left falls into components, which
are solved by elimination of sites, as along a tree decomposition, where its tables are small enough, and else
by branch and bound, with both again in every branch.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import prod
from typing import NamedTuple

import numpy as np

from protochain.core.arrays import Floats, Integers
from protochain.structure.sidechains.conflicts import neighbour_tables
from protochain.structure.sidechains.reduction import SLIGHT, Part, eliminate_dead_ends, raise_bound

_LARGEST = 1_000_000
"""Entries of a table in the elimination of sites; beyond, branches are smaller."""
_MOST_TABLES = 200_000
"""Looked at in all branches, some ten seconds."""
_ENTRIES = 500
"""Entries from which on a table counts as several."""
_Found = tuple[float, dict[int, int]]


class Assignment(NamedTuple):
    """The states chosen."""

    states: Integers  # (n,) int: State of each site.
    energy: float  # Sum of the own and pair energies.
    is_proven: bool  # Whether it is the global minimum; if not, the search was ended as too long.


def assign_states(
    own: Sequence[Floats], pairs: Mapping[tuple[int, int], Floats],
    largest: int = _LARGEST, most_tables: int = _MOST_TABLES,
) -> Assignment:  # fmt: skip
    """Find the states of lowest energy; the same tables give the same states."""
    everything = Part(
        tuple(range(len(own))), tuple(np.array(each, dtype=float) for each in own),
        tuple(np.arange(len(each)) for each in own),
        {ij: np.array(table, dtype=float) for ij, table in pairs.items()}, 0.0,
    )  # fmt: skip
    search = _Search(largest, most_tables)
    found = search.below(everything, np.inf)
    assert found is not None
    states = np.array([found[1][site] for site in range(len(own))], dtype=np.int64)
    return Assignment(states, _energy(own, pairs, states), not search.is_spent)


def eliminate_sites(own: Sequence[Floats], pairs: Mapping[tuple[int, int], Floats]) -> Integers:
    """(n,) int: states of lowest energy by elimination of sites alone, for few states and loose networks."""
    part = Part(
        tuple(range(len(own))), tuple(own), tuple(np.arange(len(each)) for each in own), dict(pairs), 0.0
    )
    states = _eliminated(part, _order(part)[0])[1]
    return np.array([states[site] for site in range(len(own))], dtype=np.int64)


class _Search:
    """Branch and bound, counting the tables that it looks at."""

    def __init__(self, largest: int, most_tables: int) -> None:
        self.largest, self.left = largest, most_tables
        self.is_spent = False

    def below(self, part: Part, limit: float) -> _Found | None:
        """Lowest energy and its states, if that is below a limit."""
        found: _Found | None = None
        decided: dict[int, int] = {}
        while True:
            part, more = part.kept(eliminate_dead_ends(part)).undecided()
            part, decided = raise_bound(part), decided | more
            energy, states = _guessed(part)
            if energy < limit:
                found, limit = (energy, decided | states), energy - SLIGHT
            bound = part.bound
            if bound >= limit:
                return found
            # With any state, the energy is at least the bound and what the state costs more than the best.
            alive = [bound + own - own.min() < limit for own in part.own]
            if all(each.all() for each in alive):
                break
            part = part.kept(alive)
        better = self._in_components(part, limit)
        return (better[0], decided | better[1]) if better else found

    def _in_components(self, part: Part, limit: float) -> _Found | None:
        energy, states, slack = part.constant, dict[int, int](), limit - part.bound
        parts = [replace(part.only(places), constant=0.0) for places in part.components()]
        # What costs little to know leaves less to search in the others.
        for each in sorted(parts, key=lambda some: len(some.sites)):
            found = self._of_component(each, each.bound + slack)
            if found is None:
                return None
            energy, states = energy + found[0], states | found[1]
            slack -= found[0] - each.bound
        return energy, states

    def _of_component(self, part: Part, limit: float) -> _Found | None:
        order, size = _order(part)
        if size <= self.largest:
            found = _eliminated(part, order)
            return found if found[0] < limit else None
        best_one: _Found | None = None
        degree = [sum(k in edge for edge in part.pairs) for k in range(len(part.sites))]
        site = max(range(len(part.sites)), key=lambda k: (degree[k], len(part.own[k]), -k))
        for state in np.argsort(part.own[site], kind="stable").tolist():
            self.left -= sum(1 + table.size // _ENTRIES for table in part.pairs.values())
            self.is_spent = self.is_spent or self.left < 0
            if self.is_spent:
                break
            alive = [np.ones(len(own), dtype=bool) for own in part.own]
            alive[site] = np.arange(len(part.own[site])) == state
            found_here = self.below(part.kept(alive), limit)
            if found_here is not None:
                best_one, limit = found_here, found_here[0]
        return best_one


def _guessed(part: Part) -> _Found:
    """A good energy and its states; it spares most branches."""
    states = _descended(part.own, part.pairs)
    used = zip(part.sites, part.states, states.tolist(), strict=True)
    energy = part.constant + _energy(part.own, part.pairs, states)
    return energy, {site: int(its[state]) for site, its, state in used}


def _order(part: Part) -> tuple[list[int], int]:
    """Order of elimination, the smallest table next, and the size of its largest table."""
    near = {k: {j for j, _ in its} for k, its in enumerate(neighbour_tables(part.pairs, len(part.sites)))}
    states = [len(own) for own in part.own]
    order, largest = [], 1
    while near:
        size, k = min((prod([states[k], *(states[j] for j in its)]), k) for k, its in near.items())
        largest = max(largest, size)
        its = near.pop(k)
        for j in its:
            near[j] = (near[j] | its) - {j, k}
        order.append(k)
    return order, largest


def _eliminated(part: Part, order: Sequence[int]) -> _Found:
    """Lowest energy and its states, by minimising over one site after the other."""
    factors: list[tuple[tuple[int, ...], Floats]] = [((k,), own) for k, own in enumerate(part.own)]
    factors += part.pairs.items()
    steps: list[tuple[int, tuple[int, ...], Integers]] = []
    energy = part.constant
    for k in order:
        mine = [factor for factor in factors if k in factor[0]]
        factors = [factor for factor in factors if k not in factor[0]]
        scope = tuple(sorted({site for its, _ in mine for site in its} - {k}))
        total = np.zeros([len(part.own[site]) for site in (*scope, k)])
        for its, table in mine:
            # Axes in the order of the scope, with k last.
            axes = sorted(range(len(its)), key=lambda a: (its[a] == k, its[a]))
            shape = [len(part.own[site]) if site in its else 1 for site in (*scope, k)]
            total += table.transpose(axes).reshape(shape)
        steps.append((k, scope, total.argmin(axis=-1)))
        if scope:
            factors.append((scope, total.min(axis=-1)))
        else:
            energy += float(total.min())
    used: dict[int, int] = {}
    for k, scope, which in reversed(steps):
        used[k] = int(which[tuple(used[site] for site in scope)])
    return energy, {part.sites[k]: int(part.states[k][state]) for k, state in used.items()}


def _descended(own: Sequence[Floats], pairs: Mapping[tuple[int, int], Floats]) -> Integers:
    """States that no change of a single site improves, from the best of each beside those before it."""
    partners = neighbour_tables(pairs, len(own))
    states, improves = np.full(len(own), -1), True
    while improves:
        improves = False
        for i, mine in enumerate(own):
            cost = mine + sum(
                (table[:, states[j]] for j, table in partners[i] if states[j] >= 0), np.zeros(len(mine))
            )
            k = int(np.argmin(cost))
            if states[i] < 0 or cost[k] < cost[states[i]] - SLIGHT:
                states[i], improves = k, True
    return states


def _energy(own: Sequence[Floats], pairs: Mapping[tuple[int, int], Floats], states: Integers) -> float:
    alone = sum(float(each[state]) for each, state in zip(own, states, strict=True))
    return alone + sum(float(table[states[i], states[j]]) for (i, j), table in pairs.items())
