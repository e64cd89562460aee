"""Choice of one state for each of several sites: the global minimum of own and pair energies.

Goldstein's dead-end elimination (Biophys. J. 66:1335, 1994) and bounds by message passing (Globerson,
Jaakkola, NIPS 2007) rule out states that the minimum cannot have; what is left falls into components, which
are solved by elimination of sites, as along a tree decomposition, where its tables are small enough, and else
by branch and bound, with both again in every branch.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import prod
from typing import NamedTuple

import numpy as np

from protochain.arrays import Floats, Integers
from protochain.compilation import njit

Pairs = dict[tuple[int, int], Floats]
"""Tables (n_i, n_j) of sites i < j that interact."""

_LARGEST = 1_000_000
"""Entries of a table in the elimination of sites; beyond, branches are smaller."""
_MOST_TABLES = 200_000
"""Looked at in all branches, some ten seconds."""
_ROUNDS = 30
"""Rounds of message passing for a bound; they end when it hardly rises."""
_RISE = 1e-3
_SLIGHT = 1e-9
"""kJ/mol: round-off of energies; a smaller spread is none."""


_Found = tuple[float, dict[int, int]]


class Assignment(NamedTuple):
    """The states chosen.

    Parameters
    ----------
    states : (n,) int
        State of each site.
    energy : float
        Sum of the own and pair energies.
    is_proven : bool
        Whether it is the global minimum; if not, the search was ended as too long.
    """

    states: Integers
    energy: float
    is_proven: bool


def best(
    own: Sequence[Floats], pairs: Mapping[tuple[int, int], Floats],
    largest: int = _LARGEST, most_tables: int = _MOST_TABLES,
) -> Assignment:  # fmt: skip
    """Find the states of lowest energy; the same tables give the same states.

    Parameters
    ----------
    own : sequence of (n_i,) float
        Energy of each state of each site.
    pairs : mapping of (int, int) to (n_i, n_j) float
        Energy between the states of sites i < j.
    largest, most_tables : int
        Entries of a table in the elimination, and tables looked at in all branches.

    Returns
    -------
    Assignment
    """
    everything = _Part(
        tuple(range(len(own))), tuple(np.array(each, dtype=float) for each in own),
        tuple(np.arange(len(each)) for each in own),
        {ij: np.array(table, dtype=float) for ij, table in pairs.items()}, 0.0,
    )  # fmt: skip
    search = _Search(largest, most_tables)
    found = search.below(everything, np.inf)
    assert found is not None
    states = np.array([found[1][site] for site in range(len(own))], dtype=np.int64)
    return Assignment(states, _energy(own, pairs, states), not search.is_spent)


@dataclass(frozen=True, eq=False)
class _Part:
    """Sites, and the states of them that are left.

    Parameters
    ----------
    sites : tuple of int
        As in the whole.
    own : tuple of (n_i,) float
    states : tuple of (n_i,) int
        As in the whole.
    pairs : dict
        By places in ``sites``.
    constant : float
        Energy of all that was decided.
    """

    sites: tuple[int, ...]
    own: tuple[Floats, ...]
    states: tuple[Integers, ...]
    pairs: Pairs
    constant: float

    def kept(self, alive: Sequence[np.ndarray]) -> "_Part":
        """Only these states (n_i,) bool of each site."""
        if all(each.all() for each in alive):
            return self
        own, states = (
            tuple(values[keep] for values, keep in zip(each, alive, strict=True))
            for each in (self.own, self.states)
        )
        pairs = {(i, j): table[np.ix_(alive[i], alive[j])] for (i, j), table in self.pairs.items()}
        return _Part(self.sites, own, states, pairs, self.constant)

    def undecided(self) -> tuple["_Part", dict[int, int]]:
        """The sites with several states left, and the state of each of the others."""
        decided = {k for k, own in enumerate(self.own) if len(own) == 1}
        own, constant, pairs = list(self.own), self.constant, {}
        for (i, j), table in self.pairs.items():
            if i in decided and j in decided:
                constant += float(table[0, 0])
            elif i in decided:
                own[j] = own[j] + table[0]
            elif j in decided:
                own[i] = own[i] + table[:, 0]
            else:
                pairs[i, j] = table
        constant += sum(float(own[k][0]) for k in decided)
        left = [k for k in range(len(self.sites)) if k not in decided]
        part = _Part(self.sites, tuple(own), self.states, pairs, constant).only(left)
        return part, {self.sites[k]: int(self.states[k][0]) for k in sorted(decided)}

    @property
    def bound(self) -> float:
        """What no energy is below."""
        return self.constant + sum(float(each.min()) for each in (*self.own, *self.pairs.values()))

    def only(self, places: Sequence[int]) -> "_Part":
        """These sites, and the tables among them."""
        at = {k: new for new, k in enumerate(places)}
        return _Part(
            tuple(self.sites[k] for k in places), tuple(self.own[k] for k in places),
            tuple(self.states[k] for k in places),
            {(at[i], at[j]): table for (i, j), table in self.pairs.items() if i in at and j in at},
            self.constant,
        )  # fmt: skip

    def components(self) -> list[list[int]]:
        """Places of the sites that hang together."""
        group = list(range(len(self.sites)))
        for i, j in self.pairs:
            group = [group[i] if each == group[j] else each for each in group]
        return [[k for k, each in enumerate(group) if each == one] for one in dict.fromkeys(group)]


class _Search:
    """Branch and bound, counting the tables that it looks at."""

    def __init__(self, largest: int, most_tables: int) -> None:
        self.largest, self.left = largest, most_tables
        self.is_spent = False

    def below(self, part: _Part, limit: float) -> _Found | None:
        """Lowest energy and its states, if that is below a limit."""
        found: _Found | None = None
        decided: dict[int, int] = {}
        while True:
            part, more = part.kept(_undominated(part)).undecided()
            part, decided = _bounded(part), decided | more
            energy, states = _guessed(part)
            if energy < limit:
                found, limit = (energy, decided | states), energy - _SLIGHT
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

    def _in_components(self, part: _Part, limit: float) -> _Found | None:
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

    def _of_component(self, part: _Part, limit: float) -> _Found | None:
        order, size = _order(part)
        if size <= self.largest:
            found = _eliminated(part, order)
            return found if found[0] < limit else None
        best_one: _Found | None = None
        degree = [sum(k in edge for edge in part.pairs) for k in range(len(part.sites))]
        site = max(range(len(part.sites)), key=lambda k: (degree[k], len(part.own[k]), -k))
        for state in np.argsort(part.own[site], kind="stable").tolist():
            self.left -= len(part.pairs)
            self.is_spent = self.is_spent or self.left < 0
            if self.is_spent:
                break
            alive = [np.ones(len(own), dtype=bool) for own in part.own]
            alive[site] = np.arange(len(part.own[site])) == state
            found_here = self.below(part.kept(alive), limit)
            if found_here is not None:
                best_one, limit = found_here, found_here[0]
        return best_one


def _guessed(part: _Part) -> _Found:
    """A good energy and its states; it spares most branches."""
    states = _descended(part.own, part.pairs)
    taken = zip(part.sites, part.states, states.tolist(), strict=True)
    energy = part.constant + _energy(part.own, part.pairs, states)
    return energy, {site: int(its[state]) for site, its, state in taken}


def _undominated(part: _Part) -> list[np.ndarray]:
    """States (n_i,) bool of each site that Goldstein's criterion leaves."""
    alive = [np.ones(len(own), dtype=bool) for own in part.own]
    beside: list[list[tuple[int, Floats]]] = [[] for _ in part.sites]
    for (i, j), table in part.pairs.items():
        beside[i].append((j, table))
        beside[j].append((i, table.T))
    waiting = dict.fromkeys(range(len(part.sites)))
    while waiting:
        i = next(iter(waiting))
        del waiting[i]
        mine = np.flatnonzero(alive[i])
        tables = [table[np.ix_(alive[i], alive[j])] for j, table in beside[i]]
        starts = np.cumsum([0, *(table.shape[1] for table in tables)])
        rows = np.ascontiguousarray(np.hstack([np.zeros((len(mine), 0)), *tables]))
        left = _goldstein(part.own[i][mine], rows, starts)
        if not left.all():
            alive[i][mine[~left]] = False
            waiting |= dict.fromkeys([i, *(j for j, _ in beside[i])])
    return alive


@njit(cache=True)
def _goldstein(own: Floats, rows: Floats, starts: Integers) -> np.ndarray:
    """(n,) bool: states that no other one beats with every choice of the neighbours.

    ``rows`` (n, sum of n_j) are the pair energies, those of neighbour k from column starts[k] on.
    """
    n, n_beside = len(own), len(starts) - 1
    least, most = own.copy(), own.copy()
    for r in range(n):
        for k in range(n_beside):
            low, high = np.inf, -np.inf
            for c in range(starts[k], starts[k + 1]):
                low, high = min(low, rows[r, c]), max(high, rows[r, c])
            least[r] += low
            most[r] += high
    left = np.ones(n, dtype=np.bool_)
    for r in range(n):
        for t in range(n):
            if t == r or not left[t] or most[r] < least[t]:
                continue
            more = own[r] - own[t]
            for k in range(n_beside):
                low = np.inf
                for c in range(starts[k], starts[k + 1]):
                    low = min(low, rows[r, c] - rows[t, c])
                more += low
            # Of equal ones, the first stays.
            if more > _SLIGHT or (t < r and more >= 0.0):
                left[r] = False
                break
    return left


def _bounded(part: _Part) -> _Part:
    """The same energies, moved between tables so that the sum of their minima rises."""
    if not part.pairs:
        return part
    first = np.cumsum([0, *map(len, part.own)])
    start = np.cumsum([0, *(table.size for table in part.pairs.values())])
    own = np.concatenate(part.own)
    tables = np.concatenate([table.ravel() for table in part.pairs.values()])
    _pass_messages(own, first, tables, start, np.array(list(part.pairs)))
    pairs = {
        (i, j): tables[begin:end].reshape(len(part.own[i]), len(part.own[j]))
        for (i, j), begin, end in zip(part.pairs, start, start[1:], strict=False)
        if tables[begin:end].max() >= _SLIGHT
    }
    return _Part(part.sites, tuple(np.split(own, first[1:-1])), part.states, pairs, part.constant)


@njit(cache=True)
def _pass_messages(own: Floats, first: Integers, tables: Floats, start: Integers, edges: Integers) -> None:
    """Share what each table and its two sites have together equally between the sites, again and again.

    The energies of site i are own[first[i]:first[i + 1]], the table of an edge begins at its start. In the
    end, the least of each row and column of a table is its sites', so that a separable table is zero.
    """
    before = -np.inf
    for turn in range(_ROUNDS + 1):
        bound, is_last = 0.0, turn == _ROUNDS
        for e in range(len(edges)):
            one = own[first[edges[e, 0]] : first[edges[e, 0] + 1]]
            other = own[first[edges[e, 1]] : first[edges[e, 1] + 1]]
            table = tables[start[e] : start[e + 1]].reshape(len(one), len(other))
            if not is_last:
                for r in range(len(one)):
                    for s in range(len(other)):
                        table[r, s] += one[r] + other[s]
                least = np.full(len(other), np.inf)
                for r in range(len(one)):
                    low = np.inf
                    for s in range(len(other)):
                        low, least[s] = min(low, table[r, s]), min(least[s], table[r, s])
                    one[r] = 0.5 * low
                other[:] = 0.5 * least
                for r in range(len(one)):
                    for s in range(len(other)):
                        table[r, s] -= one[r] + other[s]
            for r in range(len(one)):
                low = table[r].min()
                table[r] -= low
                one[r] += low
            for s in range(len(other)):
                low = table[:, s].min()
                table[:, s] -= low
                other[s] += low
        for i in range(len(first) - 1):
            bound += own[first[i] : first[i + 1]].min()
        if is_last or bound < before + _RISE:
            break
        before = bound


def _order(part: _Part) -> tuple[list[int], int]:
    """Order of elimination, the smallest table next, and the size of its largest table."""
    beside: dict[int, set[int]] = {k: set() for k in range(len(part.sites))}
    for i, j in part.pairs:
        beside[i].add(j)
        beside[j].add(i)
    states = [len(own) for own in part.own]
    order, largest = [], 1
    while beside:
        size, k = min((prod([states[k], *(states[j] for j in its)]), k) for k, its in beside.items())
        largest = max(largest, size)
        its = beside.pop(k)
        for j in its:
            beside[j] = (beside[j] | its) - {j, k}
        order.append(k)
    return order, largest


def _eliminated(part: _Part, order: Sequence[int]) -> _Found:
    """Lowest energy and its states, by minimising over one site after the other."""
    factors = [((k,), own) for k, own in enumerate(part.own)] + list(part.pairs.items())
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
    taken: dict[int, int] = {}
    for k, scope, which in reversed(steps):
        taken[k] = int(which[tuple(taken[site] for site in scope)])
    return energy, {part.sites[k]: int(part.states[k][state]) for k, state in taken.items()}


def _descended(own: Sequence[Floats], pairs: Mapping[tuple[int, int], Floats]) -> Integers:
    """States that no change of a single site improves, from the best of each beside those before it."""
    beside: list[list[tuple[int, Floats]]] = [[] for _ in own]
    for (i, j), table in pairs.items():
        beside[i].append((j, table))
        beside[j].append((i, table.T))
    states, improves = np.full(len(own), -1), True
    while improves:
        improves = False
        for i, mine in enumerate(own):
            cost = mine + sum(
                (table[:, states[j]] for j, table in beside[i] if states[j] >= 0), np.zeros(len(mine))
            )
            k = int(np.argmin(cost))
            if states[i] < 0 or cost[k] < cost[states[i]] - _SLIGHT:
                states[i], improves = k, True
    return states


def _energy(own: Sequence[Floats], pairs: Mapping[tuple[int, int], Floats], states: Integers) -> float:
    alone = sum(float(each[state]) for each, state in zip(own, states, strict=True))
    return alone + sum(float(table[states[i], states[j]]) for (i, j), table in pairs.items())
