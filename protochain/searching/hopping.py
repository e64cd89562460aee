"""Hopping: Metropolis' criterion over minima, each by a move and a descent from the last accepted minimum.

Monte Carlo minimisation (Li, Scheraga, PNAS 84:6611, 1987), also known as basin hopping.
"""

from dataclasses import dataclass, replace

import numpy as np

from protochain.core.arrays import Floats, Value
from protochain.core.units import MOLAR_GAS
from protochain.dynamics.loop import noise
from protochain.searching.landscape import Landscape
from protochain.searching.moves import apply_move, draw_kind
from protochain.searching.walker_steps import Finding, stream

N_ADAPTIVE = 100
"""Number of hops in which the size of turns adapts to their acceptance. Then it is constant."""
_TARGET, _FACTOR = 0.3, 1.1
_LARGEST = np.pi


@dataclass(frozen=True, eq=False)
class Hopping(Value):
    """State of a walk over minima."""

    q: Floats  # (n,) rad: Torsions of the current minimum.
    energy: float  # kJ/mol: Energy of the current minimum.
    n_done: int  # n_done, n_accepted, n_evaluations: Hops, accepted hops, and evaluations so far.
    n_accepted: int
    n_evaluations: int
    size: float  # rad: Standard deviation of turns.

    @property
    def acceptance(self) -> float:
        """Share of accepted hops."""
        return self.n_accepted / max(self.n_done, 1)


@dataclass(frozen=True)
class Hops:
    """The method of hopping."""

    temperature: float  # K: Temperature of Metropolis' criterion.
    seed: int  # seed, walker: Random numbers of a hop depend on these and its number alone.
    walker: int
    state = Hopping

    def begin(self, landscape: Landscape) -> tuple[Hopping, Finding]:
        """Descend from the chain's coordinates."""
        end = landscape.minimise(landscape.chain.q0)
        state = Hopping(end.q, end.energy, 0, 0, end.n_evaluations, np.pi / 4)
        return state, Finding.minimum(end.q, end.energy, end.n_evaluations)

    def step(self, landscape: Landscape, state: Hopping) -> tuple[Hopping, Finding]:
        """Hop once."""
        hop = state.n_done + 1
        random = noise(self.seed, hop, stream(self.walker))
        kind = draw_kind(landscape.moves, random)
        end = landscape.minimise(apply_move(landscape.moves, kind, state.q, state.size, random))
        accepted = metropolis(end.energy - state.energy, self.temperature, random)
        n_evaluations = state.n_evaluations + end.n_evaluations
        finding = Finding.minimum(end.q, end.energy, n_evaluations)
        adapts = kind in ("crankshaft", "turn") and hop <= N_ADAPTIVE
        size = _adapt(state.size, accepted) if adapts else state.size
        n_accepted = state.n_accepted + accepted
        after = replace(state, n_done=hop, n_accepted=n_accepted, n_evaluations=n_evaluations, size=size)
        return (replace(after, q=end.q, energy=end.energy) if accepted else after), finding


def metropolis(rise: float, temperature: float, random: np.random.Generator) -> bool:
    """Whether a rise in energy, kJ/mol, is accepted. A number is drawn in both cases."""
    drawn = random.random()
    return bool(rise <= 0.0 or (temperature > 0.0 and drawn < np.exp(-rise / (MOLAR_GAS * temperature))))


def _adapt(size: float, accepted: bool) -> float:
    """Size of turns after a turn. On average its logarithm is constant at the target acceptance."""
    return float(min(size * _FACTOR ** ((1.0 if accepted else 0.0) - _TARGET), _LARGEST))
