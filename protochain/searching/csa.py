"""Conformational space annealing: minima of a bank are crossed, and the bank's diversity is reduced.

Lee, Scheraga, Rackovsky, J. Comput. Chem. 18:1222 (1997). A bank of random minima covers the torsions. A new
minimum replaces the nearest within a cutoff distance if it is lower, else the highest. The cutoff starts at
half the mean distance of random minima, so that one funnel cannot fill the bank, and then shrinks.
"""

from dataclasses import dataclass, replace

import numpy as np

from protochain.core.arrays import Floats, Value, read_only
from protochain.dynamics.loop import noise
from protochain.searching.landscape import DescentEnd, Landscape
from protochain.searching.minima import SAME_ENERGY, Symmetry
from protochain.searching.moves import apply_move, cross_over, draw_kind, random_torsions
from protochain.searching.walker_steps import Finding, stream

BANK = 50
"""Number of random minima that are added to the bank together."""
TRIALS, ROUNDS = 20, 2
"""Trials from each minimum in a round, and rounds between additions of random minima."""
MUTATED, RANDOM = 0.15, 0.15
"""Share of trials by moves as in hopping, and share of crossings with a random minimum."""
WIDE, NARROW = 1 / 2, 1 / 5
"""Largest and smallest cutoff, relative to the mean distance of random minima."""
_COOLING = (NARROW / WIDE) ** (1.0 / (BANK * TRIALS))
_SIZE = np.pi / 4


@dataclass(frozen=True, eq=False)
class Bank(Value):
    """State of a bank of m minima."""

    q: Floats  # (m, n) rad: Torsions of the minima.
    energies: Floats  # (m,) kJ/mol.
    tried: Floats  # (m,): Trials from each minimum since it was added or since the round began.
    random: Floats  # (k, n) rad: The last random minima.
    room: int  # Capacity of the bank: random minima are added up to it.
    mean: float  # rad: Mean distance of the random minima.
    width: float  # Cutoff distance, relative to ``mean``.
    n_rounds: int
    n_done: int  # Descents.
    n_accepted: int  # Descents that changed the bank.
    n_evaluations: int

    @property
    def energy(self) -> float:
        """Lowest energy, kJ/mol."""
        return float(self.energies.min())

    @property
    def acceptance(self) -> float:
        """Share of the descents that changed the bank."""
        return self.n_accepted / self.n_done


@dataclass(frozen=True)
class Crossings:
    """The method of conformational space annealing."""

    seed: int  # seed, walker: Random numbers of a trial depend on these and its number alone.
    walker: int
    state = Bank

    def begin(self, landscape: Landscape) -> tuple[Bank, Finding]:
        """Descend from the chain's coordinates to the first minimum of the bank."""
        end = landscape.minimise(landscape.chain.q0)
        q = read_only(end.q[None])
        state = Bank(
            q, read_only([end.energy]), read_only([0.0]), q, BANK, 0.0, WIDE, 0, 1, 1, end.n_evaluations
        )
        return state, Finding.minimum(end.q, end.energy, end.n_evaluations)

    def step(self, landscape: Landscape, state: Bank) -> tuple[Bank, Finding]:
        """Descend from random torsions while the bank is not full, else from a trial."""
        number = state.n_done + 1
        random = noise(self.seed, number, stream(self.walker))
        moves, joins = landscape.moves, len(state.q) < state.room
        if joins:
            end = landscape.minimise(random_torsions(moves, state.q.shape[1], random))
            after = add_random(state, end, landscape.symmetry)
        else:
            seed = random.choice(np.flatnonzero(state.tried < TRIALS))
            if random.random() < MUTATED:
                trial = apply_move(moves, draw_kind(moves, random), state.q[seed], _SIZE, random)
            else:
                partners = state.random if random.random() < RANDOM else state.q
                trial = cross_over(moves, state.q[seed], partners[random.integers(len(partners))], random)
            end = landscape.minimise(trial)
            tried = state.tried.copy()
            tried[seed] += 1.0
            after = next_round(add_minimum(replace(state, tried=read_only(tried)), end, landscape.symmetry))
        n_evaluations = state.n_evaluations + end.n_evaluations
        finding = Finding.minimum(end.q, end.energy, n_evaluations)
        return replace(after, n_done=number, n_evaluations=n_evaluations), finding


def add_random(state: Bank, end: DescentEnd, symmetry: Symmetry) -> Bank:
    """Add a random minimum. The last minimum sets the cutoff."""
    random = np.concatenate([state.random, end.q[None]])[-2 * BANK :]
    after = replace(
        state,
        q=read_only(np.concatenate([state.q, end.q[None]])),
        energies=read_only([*state.energies, end.energy]),
        tried=read_only([*state.tried, 0.0]),
        random=read_only(random),
        n_accepted=state.n_accepted + 1,
    )
    if len(after.q) < state.room:
        return after
    distances = [symmetry.distance(random[:k], random[k]) for k in range(1, len(random))]
    return replace(after, mean=float(np.mean(np.concatenate(distances))), width=WIDE)


def add_minimum(state: Bank, end: DescentEnd, symmetry: Symmetry) -> Bank:
    """Shrink the cutoff. Replace the minimum within the cutoff, or else the highest, by a lower minimum."""
    state = replace(state, width=max(state.width * _COOLING, NARROW))
    distances = symmetry.distance(state.q, end.q)
    nearest, highest = int(np.argmin(distances)), int(np.argmax(state.energies))
    is_near = distances[nearest] < state.width * state.mean
    place = nearest if is_near else highest
    fall = state.energies[place] - end.energy
    if not fall > 0.0:
        return state
    q, energies, tried = state.q.copy(), state.energies.copy(), state.tried.copy()
    q[place], energies[place] = end.q, end.energy
    if not is_near or fall > SAME_ENERGY:
        tried[place] = 0.0
    return replace(
        state, q=read_only(q), energies=read_only(energies), tried=read_only(tried),
        n_accepted=state.n_accepted + 1,
    )  # fmt: skip


def next_round(state: Bank) -> Bank:
    """Begin another round after all trials. After some rounds, increase the capacity for random minima."""
    if np.any(state.tried < TRIALS):
        return state
    after = replace(state, tried=read_only(np.zeros(len(state.q))), n_rounds=state.n_rounds + 1)
    if after.n_rounds % ROUNDS:
        return after
    # The bank doubles once. Then the higher half is removed.
    n = len(state.q)
    selected = np.argsort(state.energies, kind="stable")[:BANK] if n > BANK else np.arange(n)
    return replace(
        after, q=read_only(state.q[selected]), energies=read_only(state.energies[selected]),
        tried=read_only(np.zeros(len(selected))), room=2 * BANK,
    )  # fmt: skip
