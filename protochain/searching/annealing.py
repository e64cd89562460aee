"""Annealing: hybrid Monte Carlo in torsions that is cooled, descends, and begins again at the top."""

from dataclasses import dataclass, replace

import numpy as np

from protochain.core import defaults
from protochain.core.arrays import Floats, Value, read_only
from protochain.dynamics.loop import noise
from protochain.searching.ladder import equally_spaced, geometric, length_of_widths
from protochain.searching.landscape import Landscape
from protochain.searching.pieces import Finding, stream

RUNGS, TRAJECTORIES = 40, 5
"""Temperatures of a cooling, and trajectories at each."""
PILOTS = 2
"""Coolings from which the schedule is made; the first is by constant ratios."""
WANTED = 0.8
_GAIN = 0.2
_STEPS = 0.002, 0.04
"""Shortest and longest time step, ps."""


@dataclass(frozen=True, eq=False)
class Annealing(Value):
    """State of a cooling.

    q (n,) rad: Torsions.
    energy kJ/mol.
    temperatures (RUNGS,) K: From the highest.
    time_steps (RUNGS,) ps.
    widths (RUNGS,) kJ/mol: Of energies at each temperature, as the last pilot found them.
    accepted: Sum over rungs of the share of trajectories that was accepted.
    n_done, n_evaluations: Rungs and evaluations, over all coolings.
    """

    q: Floats
    energy: float
    temperatures: Floats
    time_steps: Floats
    widths: Floats
    accepted: float
    n_done: int
    n_evaluations: int

    @property
    def acceptance(self) -> float:
        """Share of trajectories that was accepted."""
        return self.accepted / max(self.n_done, 1)


@dataclass(frozen=True)
class Coolings:
    """The method of annealing.

    temperatures K: Lowest and highest.
    seed, walker: Random numbers of a rung depend on these and its number alone.
    """

    temperatures: tuple[float, float]
    seed: int
    walker: int
    state = Annealing

    def begin(self, landscape: Landscape) -> tuple[Annealing, Finding]:
        """Descend from the chain as it is."""
        done = landscape.minimise(landscape.chain.q0)
        low, high = self.temperatures
        state = Annealing(
            done.q, done.energy, read_only(geometric(high, low, RUNGS)),
            read_only(np.full(RUNGS, 2.0 * defaults.TIME_STEP)), read_only(np.zeros(RUNGS)), 0.0, 0,
            done.n_evaluations,
        )  # fmt: skip
        return state, Finding.minimum(done.q, done.energy, done.n_evaluations)

    def step(self, landscape: Landscape, state: Annealing) -> tuple[Annealing, Finding]:
        """Sample at one temperature; after the lowest descend, and go on at the highest."""
        cooling, rung = divmod(state.n_done, RUNGS)
        swept = landscape.sweep(
            state.q, float(state.temperatures[rung]), float(state.time_steps[rung]), TRAJECTORIES,
            int(noise(self.seed, state.n_done + 1, stream(self.walker)).integers(2**63)),
        )  # fmt: skip
        after = replace(
            state,
            q=swept.q,
            energy=float(swept.energies[-1]),
            accepted=state.accepted + swept.accepted,
            n_done=state.n_done + 1,
            n_evaluations=state.n_evaluations + swept.n_evaluations,
        )
        if cooling < PILOTS:
            steps, widths = state.time_steps.copy(), state.widths.copy()
            steps[rung] = np.clip(steps[rung] * np.exp(_GAIN * (swept.accepted - WANTED)), *_STEPS)
            widths[rung] = np.std(swept.energies, ddof=1)
            after = replace(after, time_steps=read_only(steps), widths=read_only(widths))
        if rung < RUNGS - 1:
            return after, Finding.none(len(state.q))
        done = landscape.minimise(after.q)
        n_evaluations = after.n_evaluations + done.n_evaluations
        if cooling < PILOTS:
            after = scheduled(after)
        return replace(after, n_evaluations=n_evaluations), Finding.minimum(
            done.q, done.energy, n_evaluations
        )


def scheduled(state: Annealing) -> Annealing:
    """Place the temperatures at equal thermodynamic lengths, by the widths of energies found at them."""
    smooth = np.convolve(np.pad(state.widths, 2, "edge"), np.full(5, 0.2), "valid")
    placed = equally_spaced(state.temperatures, length_of_widths(state.temperatures, smooth))
    rising = slice(None, None, -1)
    steps = np.interp(placed, state.temperatures[rising], state.time_steps[rising])
    return replace(state, temperatures=read_only(placed), time_steps=read_only(steps))
