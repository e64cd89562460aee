"""What is left of the states of sites, and ways to rule out states that no minimum has.

Goldstein's dead-end elimination: Biophys. J. 66:1335 (1994). Bounds by message passing: Globerson, Jaakkola,
NIPS 2007 (the energies only move between tables: no sum of them changes).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from protochain.core.arrays import Floats, Integers
from protochain.core.compilation import njit
from protochain.structure.sidechains.conflicts import Pairs, neighbour_tables

SLIGHT = 1e-9
"""kJ/mol: round-off of energies; a smaller spread is none."""
_ROUNDS = 30
"""Rounds of message passing for a bound; they end when it hardly rises."""
_RISE = 1e-3


@dataclass(frozen=True, eq=False)
class Part:
    """Sites, and the states of them that are left."""

    sites: tuple[int, ...]  # As in the whole.
    own: tuple[Floats, ...]
    states: tuple[Integers, ...]  # As in the whole.
    pairs: Pairs  # By places in ``sites``.
    constant: float  # Energy of all that was decided.

    def kept(self, alive: Sequence[np.ndarray]) -> "Part":
        """Only these states (n_i,) bool of each site."""
        if all(each.all() for each in alive):
            return self
        own, states = (
            tuple(values[keep] for values, keep in zip(each, alive, strict=True))
            for each in (self.own, self.states)
        )
        pairs = {(i, j): table[np.ix_(alive[i], alive[j])] for (i, j), table in self.pairs.items()}
        return Part(self.sites, own, states, pairs, self.constant)

    def undecided(self) -> tuple["Part", dict[int, int]]:
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
        part = Part(self.sites, tuple(own), self.states, pairs, constant).only(left)
        return part, {self.sites[k]: int(self.states[k][0]) for k in sorted(decided)}

    @property
    def bound(self) -> float:
        """What no energy is below."""
        return self.constant + sum(float(each.min()) for each in (*self.own, *self.pairs.values()))

    def only(self, places: Sequence[int]) -> "Part":
        """These sites, and the tables among them."""
        at = {k: new for new, k in enumerate(places)}
        return Part(
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


def eliminate_dead_ends(part: Part) -> list[np.ndarray]:
    """States (n_i,) bool of each site that Goldstein's criterion leaves."""
    alive = [np.ones(len(own), dtype=bool) for own in part.own]
    partners = neighbour_tables(part.pairs, len(part.sites))
    waiting = dict.fromkeys(range(len(part.sites)))
    while waiting:
        i = next(iter(waiting))
        del waiting[i]
        mine = np.flatnonzero(alive[i])
        tables = [table[np.ix_(alive[i], alive[j])] for j, table in partners[i]]
        starts = np.cumsum([0, *(table.shape[1] for table in tables)])
        rows = np.ascontiguousarray(np.hstack([np.zeros((len(mine), 0)), *tables]))
        left = _goldstein(part.own[i][mine], rows, starts)
        if not left.all():
            alive[i][mine[~left]] = False
            waiting |= dict.fromkeys([i, *(j for j, _ in partners[i])])
    return alive


@njit(cache=True)
def _goldstein(own: Floats, rows: Floats, starts: Integers) -> np.ndarray:
    """(n,) bool: states that none beats, by pair energies ``rows`` of neighbours from column starts[k] on."""
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
            if more > SLIGHT or (t < r and more >= 0.0):
                left[r] = False
                break
    return left


def raise_bound(part: Part) -> Part:
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
        if tables[begin:end].max() >= SLIGHT
    }
    return Part(part.sites, tuple(np.split(own, first[1:-1])), part.states, pairs, part.constant)


@njit(cache=True)
def _pass_messages(own: Floats, first: Integers, tables: Floats, start: Integers, edges: Integers) -> None:
    """Share what each table and its two sites have together equally between the sites, again and again."""
    # Site i has own[first[i]:first[i + 1]]. In the end the least of each row and column of a table is its
    # sites', so that a separable table is zero.
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
