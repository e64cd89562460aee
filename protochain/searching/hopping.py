"""Hopping: Metropolis' criterion over minima, each from the last accepted one by a move and a descent.

Monte Carlo minimisation (Li, Scheraga, PNAS 84:6611, 1987), also known as basin hopping.
"""

from dataclasses import dataclass, replace

import numpy as np

from protochain.core.arrays import Floats, Value
from protochain.core.units import MOLAR_GAS
from protochain.dynamics.loop import noise
from protochain.searching.landscape import Landscape
from protochain.searching.moves import a_kind, moved
from protochain.searching.pieces import Finding, stream

ADAPTED = 100
"""Hops during which the size of a turn follows how often it is accepted; then it stays."""
_WANTED, _FACTOR = 0.3, 1.1
_LARGEST = np.pi


@dataclass(frozen=True, eq=False)
class Hopping(Value):
    """State of a walk over minima.

    q (n,) rad: Torsions of the minimum where it is.
    energy kJ/mol: Of this minimum.
    n_done, n_accepted, n_evaluations: Hops, those accepted, and evaluations so far.
    size rad: Standard deviation of turns.
    """

    q: Floats
    energy: float
    n_done: int
    n_accepted: int
    n_evaluations: int
    size: float

    @property
    def acceptance(self) -> float:
        """Share of the hops that were accepted."""
        return self.n_accepted / max(self.n_done, 1)


@dataclass(frozen=True)
class Hops:
    """Hopping by Metropolis' criterion at K; random numbers depend on seed, walker and the hop's number."""

    temperature: float
    seed: int
    walker: int
    state = Hopping

    def begin(self, landscape: Landscape) -> tuple[Hopping, Finding]:
        """Descend from the chain as it is."""
        done = landscape.minimise(landscape.chain.q0)
        state = Hopping(done.q, done.energy, 0, 0, done.n_evaluations, np.pi / 4)
        return state, Finding.minimum(done.q, done.energy, done.n_evaluations)

    def step(self, landscape: Landscape, state: Hopping) -> tuple[Hopping, Finding]:
        """Hop once."""
        hop = state.n_done + 1
        random = noise(self.seed, hop, stream(self.walker))
        kind = a_kind(landscape.moves, random)
        done = landscape.minimise(moved(landscape.moves, kind, state.q, state.size, random))
        accepted = metropolis(done.energy - state.energy, self.temperature, random)
        n_evaluations = state.n_evaluations + done.n_evaluations
        found = Finding.minimum(done.q, done.energy, n_evaluations)
        after = replace(
            state,
            n_done=hop,
            n_accepted=state.n_accepted + accepted,
            n_evaluations=n_evaluations,
            size=_adapted(state.size, accepted)
            if kind in ("crankshaft", "turn") and hop <= ADAPTED
            else state.size,
        )
        return (replace(after, q=done.q, energy=done.energy) if accepted else after), found


def metropolis(rise: float, temperature: float, random: np.random.Generator) -> bool:
    """Whether a rise in energy, kJ/mol, is accepted; a number is drawn in either case."""
    drawn = random.random()
    return bool(rise <= 0.0 or (temperature > 0.0 and drawn < np.exp(-rise / (MOLAR_GAS * temperature))))


def _adapted(size: float, accepted: bool) -> float:
    """Size of turns after one: its logarithm rests where the share wanted is accepted."""
    return float(min(size * _FACTOR ** ((1.0 if accepted else 0.0) - _WANTED), _LARGEST))
