"""Choose one state for each site: the global minimum of self and pair energies.

Goldstein's dead-end elimination (Biophys. J. 66:1335, 1994) and bounds by message passing (Globerson,
Jaakkola, NIPS 2007) rule out states that the minimum cannot have. The remaining sites form components. If
its tables are small enough, a component is solved by elimination of sites, as along a tree decomposition.
Otherwise branch and bound applies both criteria again in every branch.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from math import prod
from typing import NamedTuple

import numpy as np

from protochain.core.arrays import Floats, Integers
from protochain.structure.sidechains.reduction import (
    ROUND_OFF,
    Part,
    eliminate_dead_ends,
    neighbour_tables,
    raise_bound,
)

_LARGEST = 1_000_000
"""Largest number of entries of a table in the elimination of sites. Larger components are branched."""
_MOST_TABLES = 200_000  # Largest number of tables read in all branches, in some ten seconds.
_ENTRIES = 500  # Number of entries from which a table counts as several.
_Solution = tuple[float, dict[int, int]]


class Assignment(NamedTuple):
    """Chosen states."""

    states: Integers  # (n,) int: State of each site.
    energy: float  # Sum of the self and pair energies.
    is_proven: bool  # Whether it is the global minimum. If not, the search was too long.


def assign_states(
    energies: Sequence[Floats], pairs: Mapping[tuple[int, int], Floats],
    largest: int = _LARGEST, most_tables: int = _MOST_TABLES,
) -> Assignment:  # fmt: skip
    """Find the states of lowest energy. Equal tables lead to equal states."""
    everything = Part(
        tuple(range(len(energies))), tuple(np.array(values, dtype=float) for values in energies),
        tuple(np.arange(len(values)) for values in energies),
        {ij: np.array(table, dtype=float) for ij, table in pairs.items()}, 0.0,
    )  # fmt: skip
    search = _Search(largest, most_tables)
    solution = search.below(everything, np.inf)
    assert solution is not None
    states = np.array([solution[1][site] for site in range(len(energies))], dtype=np.int64)
    return Assignment(states, _energy(energies, pairs, states), not search.is_spent)


def site_elimination(
    pairs: Mapping[tuple[int, int], Floats], n_states: Sequence[int]
) -> Callable[[Sequence[Floats]], Integers]:
    """Function from self energies to states (n,) of lowest energy, for few states and loose networks.

    It eliminates sites alone, always in the same order.
    """
    sites, numbers = tuple(range(len(n_states))), tuple(map(np.arange, n_states))
    part = Part(sites, tuple(map(np.zeros, n_states)), numbers, dict(pairs), 0.0)
    order = _order(part)[0]

    def choose(energies: Sequence[Floats]) -> Integers:
        states = _eliminate(replace(part, energies=tuple(energies)), order)[1]
        return np.array([states[site] for site in sites], dtype=np.int64)

    return choose


class _Search:
    """Branch and bound that counts the tables it reads."""

    def __init__(self, largest: int, most_tables: int) -> None:
        self.largest, self.left = largest, most_tables
        self.is_spent = False

    def below(self, part: Part, limit: float) -> _Solution | None:
        """Return the lowest energy and its states if the energy is below a limit."""
        solution: _Solution | None = None
        decided: dict[int, int] = {}
        while True:
            part, newly_decided = part.restrict(eliminate_dead_ends(part)).split_decided()
            part, decided = raise_bound(part), decided | newly_decided
            energy, states = _initial_guess(part)
            if energy < limit:
                solution, limit = (energy, decided | states), energy - ROUND_OFF
            bound = part.bound
            if bound >= limit:
                return solution
            # With any state, the energy is at least the bound plus the excess of the state over the best one.
            alive = [bound + energies - energies.min() < limit for energies in part.energies]
            if all(mask.all() for mask in alive):
                break
            part = part.restrict(alive)
        better = self._in_components(part, limit)
        return (better[0], decided | better[1]) if better else solution

    def _in_components(self, part: Part, limit: float) -> _Solution | None:
        energy, states, slack = part.constant, dict[int, int](), limit - part.bound
        parts = [replace(part.subset(places), constant=0.0) for places in part.components()]
        # Energies of small components lower the limits of the larger ones.
        for component in sorted(parts, key=lambda p: len(p.sites)):
            solution = self._of_component(component, component.bound + slack)
            if solution is None:
                return None
            energy, states = energy + solution[0], states | solution[1]
            slack -= solution[0] - component.bound
        return energy, states

    def _of_component(self, part: Part, limit: float) -> _Solution | None:
        order, size = _order(part)
        if size <= self.largest:
            solution = _eliminate(part, order)
            return solution if solution[0] < limit else None
        best_solution: _Solution | None = None
        degree = [sum(k in edge for edge in part.pairs) for k in range(len(part.sites))]
        site = max(range(len(part.sites)), key=lambda k: (degree[k], len(part.energies[k]), -k))
        for state in np.argsort(part.energies[site], kind="stable").tolist():
            self.left -= sum(1 + table.size // _ENTRIES for table in part.pairs.values())
            self.is_spent = self.is_spent or self.left < 0
            if self.is_spent:
                break
            alive = [np.ones(len(energies), dtype=bool) for energies in part.energies]
            alive[site] = np.arange(len(part.energies[site])) == state
            branch_solution = self.below(part.restrict(alive), limit)
            if branch_solution is not None:
                best_solution, limit = branch_solution, branch_solution[0]
        return best_solution


def _initial_guess(part: Part) -> _Solution:
    """Return a low energy and its states, which spares most branches."""
    states = _descend(part.energies, part.pairs)
    used = zip(part.sites, part.states, states.tolist(), strict=True)
    energy = part.constant + _energy(part.energies, part.pairs, states)
    return energy, {site: int(state_numbers[state]) for site, state_numbers, state in used}


def _order(part: Part) -> tuple[list[int], int]:
    """Return the order of elimination, smallest table next, and the size of its largest table."""
    near = {k: {j for j, _ in sites} for k, sites in enumerate(neighbour_tables(part.pairs, len(part.sites)))}
    states = [len(energies) for energies in part.energies]
    order, largest = [], 1
    while near:
        size, k = min((prod([states[k], *(states[j] for j in sites)]), k) for k, sites in near.items())
        largest = max(largest, size)
        sites = near.pop(k)
        for j in sites:
            near[j] = (near[j] | sites) - {j, k}
        order.append(k)
    return order, largest


def _eliminate(part: Part, order: Sequence[int]) -> _Solution:
    """Return the lowest energy and its states by minimising over one site after the other."""
    factors: list[tuple[tuple[int, ...], Floats]] = [((k,), e) for k, e in enumerate(part.energies)]
    factors += part.pairs.items()
    # Numbers of the factors of each site, in the order of their sums.
    numbers: list[dict[int, None]] = [{} for _ in part.energies]
    for number, (sites, _) in enumerate(factors):
        for site in sites:
            numbers[site][number] = None
    steps: list[tuple[int, tuple[int, ...], Integers]] = []
    energy = part.constant
    for k in order:
        involved = [factors[number] for number in numbers[k]]
        for number in [*numbers[k]]:
            for site in factors[number][0]:
                del numbers[site][number]
        scope = tuple(sorted({site for sites, _ in involved for site in sites} - {k}))
        total = np.zeros([len(part.energies[site]) for site in (*scope, k)])
        for sites, table in involved:
            # Axes in the order of the scope, with k last.
            axes = sorted(range(len(sites)), key=lambda a: (sites[a] == k, sites[a]))
            shape = [len(part.energies[site]) if site in sites else 1 for site in (*scope, k)]
            total += table.transpose(axes).reshape(shape)
        steps.append((k, scope, total.argmin(axis=-1)))
        if scope:
            for site in scope:
                numbers[site][len(factors)] = None
            factors.append((scope, total.min(axis=-1)))
        else:
            energy += float(total.min())
    used: dict[int, int] = {}
    for k, scope, choice in reversed(steps):
        used[k] = int(choice[tuple(used[site] for site in scope)])
    return energy, {part.sites[k]: int(part.states[k][state]) for k, state in used.items()}


def _descend(energies: Sequence[Floats], pairs: Mapping[tuple[int, int], Floats]) -> Integers:
    """Return states that no change of one site improves. Each starts at its best after earlier sites."""
    partners = neighbour_tables(pairs, len(energies))
    states, improves = np.full(len(energies), -1), True
    while improves:
        improves = False
        for i, self_costs in enumerate(energies):
            cost = self_costs + sum(
                (table[:, states[j]] for j, table in partners[i] if states[j] >= 0), np.zeros(len(self_costs))
            )
            k = int(np.argmin(cost))
            if states[i] < 0 or cost[k] < cost[states[i]] - ROUND_OFF:
                states[i], improves = k, True
    return states


def _energy(energies: Sequence[Floats], pairs: Mapping[tuple[int, int], Floats], states: Integers) -> float:
    alone = sum(float(values[state]) for values, state in zip(energies, states, strict=True))
    return alone + sum(float(table[states[i], states[j]]) for (i, j), table in pairs.items())
