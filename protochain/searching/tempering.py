"""Tempering: replica exchange of hybrid Monte Carlo in torsions, with Fixman's potential.

Each replica samples exp(-E/kT) at its temperature. Neighbours exchange their torsions by Metropolis'
criterion (Swendsen, Wang, Phys. Rev. Lett. 57:2607, 1986, and Sugita, Okamoto, Chem. Phys. Lett. 314:141,
1999). Fixman's term cancels there, as it is kT times the same function of the torsions at every temperature.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import erfcinv

from protochain.core import defaults
from protochain.core.arrays import Floats, Value, read_only
from protochain.core.units import MOLAR_GAS
from protochain.dynamics.loop import noise
from protochain.searching.landscape import Landscape
from protochain.searching.walker_steps import Finding, stream

STAGES = 3
"""Stages of the pilot. The temperatures are adapted after each stage but the last. Every walker runs the same
pilot, so that all have the same temperatures and none waits for others."""
QUENCHED = 5
"""Rounds between descents, which begin at each temperature in turn."""
TARGET = 0.8
"""Acceptance of trajectories to which the pilot adapts the time steps."""
_GAIN = 0.1
_STEPS = 0.002, 0.04  # Shortest and longest time step, ps.
_RAREST, _MOST_FREQUENT = 1e-3, 0.999
"""Limits of acceptances. Values closer to 0 or 1 would need more trials than a pilot has."""


def length_of_acceptance(acceptance: Floats) -> Floats:
    """Thermodynamic length between temperatures with this acceptance of exchanges."""
    # For energies with normal distributions of one width s it is L = s |1/kT - 1/kT'|, and the mean
    # acceptance is erfc(L/2) (Predescu, Predescu, Ciobanu, J. Chem. Phys. 120:4119, 2004).
    return np.asarray(2.0 * erfcinv(np.clip(acceptance, _RAREST, _MOST_FREQUENT)))


def equally_spaced(temperatures: Floats, lengths: Floats) -> Floats:
    """Replace inner temperatures so that thermodynamic lengths between neighbours are equal."""
    along = np.concatenate([[0.0], np.cumsum(lengths)])
    targets = np.linspace(0.0, along[-1], len(temperatures))
    ladder = np.exp(np.interp(targets, along, np.log(temperatures)))
    ladder[[0, -1]] = temperatures[[0, -1]]
    return np.asarray(ladder)


@dataclass(frozen=True, eq=False)
class Tempering(Value):
    """State of r replicas."""

    q: Floats  # (r, n) rad: Torsions at each temperature.
    energy: Floats  # (r,) kJ/mol.
    temperatures: Floats  # (r,) K.
    time_steps: Floats  # (r,) ps.
    replica: Floats  # (r,): Number of the replica at each temperature.
    # (r,): For each replica: 1 if it was last at the lowest temperature, -1 at the highest, 0 if at neither.
    heading: Floats
    # (r - 1,): Sum over rounds since the last adaptation of the exchange probability of neighbours.
    odds: Floats
    accepted: float  # Sum over these rounds of the share of accepted trajectories.
    n_counted: int  # Number of these rounds.
    # n_done, n_evaluations, n_trips: Rounds, evaluations, and round trips of replicas from the lowest
    # temperature to the highest and back.
    n_done: int
    n_evaluations: int
    n_trips: int

    @property
    def acceptance(self) -> float:
        """Mean acceptance of exchanges."""
        return float(np.mean(self.odds) / max(self.n_counted, 1))


@dataclass(frozen=True)
class Replicas:
    """The method of tempering."""

    temperatures: tuple[float, float]  # K: Lowest and highest.
    n_replicas: int
    pilot: int  # Rounds in which the temperatures are adapted.
    seed: int  # seed, walker: Random numbers of a round depend on these and its number alone.
    walker: int
    state = Tempering

    def begin(self, landscape: Landscape) -> tuple[Tempering, Finding]:
        """Put all replicas at the minimum to which the chain descends."""
        end = landscape.minimise(landscape.chain.q0)
        r = self.n_replicas
        # Temperatures with constant ratios are optimal for a constant heat capacity.
        state = Tempering(
            read_only([end.q] * r), read_only([end.energy] * r),
            read_only(np.geomspace(*self.temperatures, r)), read_only(np.full(r, 2.0 * defaults.TIME_STEP)),
            read_only(np.arange(r)), read_only(np.zeros(r)), read_only(np.zeros(r - 1)),
            0.0, 0, 0, end.n_evaluations, 0,
        )  # fmt: skip
        return state, Finding.minimum(end.q, end.energy, end.n_evaluations, r)

    def step(self, landscape: Landscape, state: Tempering) -> tuple[Tempering, Finding]:
        """Move every replica by a trajectory, then exchange neighbours, even and odd pairs in turn."""
        number, r = state.n_done + 1, self.n_replicas
        walker = 0 if number <= self.pilot else self.walker
        # In the pilot all walkers use the same random numbers.
        runs = [
            landscape.sweep(
                state.q[k], float(state.temperatures[k]), float(state.time_steps[k]), 1,
                int(noise(self.seed, number, stream(walker, k)).integers(2**63)),
            )
            for k in range(r)
        ]  # fmt: skip
        q, energy = np.array([run.q for run in runs]), np.array([run.energies[-1] for run in runs])
        acceptances = np.array([run.accepted for run in runs])
        random = noise(self.seed, number, stream(walker))
        order, odds = exchange(energy, state.temperatures, number % 2, random)
        replica = state.replica[order]
        heading, trips = update_headings(state.heading, replica)
        n_evaluations = state.n_evaluations + sum(run.n_evaluations for run in runs)
        after = replace(
            state,
            q=read_only(q[order]),
            energy=read_only(energy[order]),
            replica=read_only(replica),
            heading=read_only(heading),
            odds=read_only(state.odds + odds),
            accepted=state.accepted + float(acceptances.mean()),
            n_counted=state.n_counted + 1,
            n_done=number,
            n_evaluations=n_evaluations,
            n_trips=state.n_trips + trips,
        )
        if number <= self.pilot:
            return self._adapt(after, acceptances), Finding.empty(q.shape[1], r)
        finding = Finding(
            np.empty((0, q.shape[1] + 2)), np.concatenate([after.energy[:, None], after.q], axis=1)[None]
        )
        # Every few rounds a descent yields a minimum.
        if number % QUENCHED:
            return after, finding
        end = landscape.minimise(after.q[number // QUENCHED % r])
        n_evaluations += end.n_evaluations
        minimum = Finding.minimum(end.q, end.energy, n_evaluations, r)
        return replace(after, n_evaluations=n_evaluations), Finding.concatenate([finding, minimum])

    def _adapt(self, state: Tempering, acceptances: Floats) -> Tempering:
        """Adapt the time steps to the acceptance, and at the end of a stage the temperatures."""
        steps = np.clip(state.time_steps * np.exp(_GAIN * (acceptances - TARGET)), *_STEPS)
        state = replace(state, time_steps=read_only(steps))
        if state.n_done not in [self.pilot * k // STAGES for k in range(1, STAGES + 1)]:
            return state
        if state.n_done < self.pilot:
            lengths = length_of_acceptance(state.odds / state.n_counted)
            temperatures = equally_spaced(state.temperatures, lengths)
            steps = np.interp(temperatures, state.temperatures, steps)
            state = replace(state, temperatures=read_only(temperatures), time_steps=read_only(steps))
        r = self.n_replicas
        return replace(
            state, odds=read_only(np.zeros(r - 1)), accepted=0.0, n_counted=0, heading=read_only(np.zeros(r)),
            n_trips=0,
        )  # fmt: skip


def exchange(
    energy: Floats, temperatures: Floats, first: int, random: np.random.Generator
) -> tuple[np.ndarray, Floats]:
    """Exchange the pairs (k, k + 1) of neighbours with k = first, first + 2, ..."""
    # energy (r,) kJ/mol, temperatures (r,) K -> (r,) int: new order of the torsions by temperature,
    # (r - 1,): exchange probability of each pair, also of pairs that are not tried.
    beta = 1.0 / (MOLAR_GAS * temperatures)
    order = np.arange(len(energy))
    odds = np.exp(np.minimum(0.0, np.diff(beta) * np.diff(energy)))
    for k in range(first, len(energy) - 1, 2):
        if random.random() < odds[k]:
            order[[k, k + 1]] = order[[k + 1, k]]
    return order, odds


def update_headings(heading: Floats, replica: Floats) -> tuple[Floats, int]:
    """Update headings at the end temperatures, and return the number of completed round trips."""
    heading = heading.copy()
    lowest, highest = int(replica[0]), int(replica[-1])
    trips = int(heading[lowest] < 0.0)
    heading[lowest] = 1.0
    if heading[highest] > 0.0:
        heading[highest] = -1.0
    return heading, trips
