"""Simulated annealing and damped dynamics: constrained dynamics with a falling temperature."""

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from protochain.core.arrays import Floats
from protochain.core.units import MOLAR_GAS
from protochain.mechanics import multibody
from protochain.mechanics.multibody.articulated import Articulated, articulate, solve
from protochain.minimisers.problem import Evaluation, Problem
from protochain.minimisers.spaces import Torsions

if TYPE_CHECKING:
    from protochain.mechanics.motion.system import Phase

LONGEST_TURN = 0.1
"""rad. Largest turn of a freedom in one step. It stops overlaps from throwing the chain apart."""
_HALVINGS = 30


@dataclass(frozen=True, eq=False)
class AnnealingState:
    """Current point and velocity, and the number of steps so far."""

    at: Evaluation
    velocity: Floats
    n_steps: int


@dataclass(frozen=True)
class Annealing:
    """Langevin dynamics of rigid bodies as the temperature falls linearly to zero: at 0 K damped dynamics."""

    # Source: Kirkpatrick, Gelatt, Vecchi, Science 220:671 (1983).

    temperature: float = 0.0  # K: Initial; friction 1/ps, of the thermostat.
    n_steps: int = 1000
    friction: float = 10.0
    time_step: float = 0.004  # ps: Shortened if a freedom would turn by more than ``LONGEST_TURN``.
    seed: int = 0  # Of the random forces and initial velocities.
    states = (AnnealingState,)

    def init(self, problem: Problem, at: Evaluation) -> AnnealingState:
        """Start at rest, or with velocities of the initial temperature."""
        # Dynamics is imported on use: few minimisations need it, and the import is slow.
        from protochain.dynamics.loop import noise

        tree = _torsions(problem).chain.tree
        kt = MOLAR_GAS * self.temperature
        qd = multibody.sample_velocities(tree, multibody.pose(tree, at.q), kt, noise(self.seed, 0))
        return AnnealingState(at, qd, 0)

    def warm(self, problem: Problem, at: Evaluation) -> None:
        """Take a step, to compile the kernels of dynamics."""
        self.step(problem, self.init(problem, at))

    def step(self, problem: Problem, state: AnnealingState) -> AnnealingState | None:
        """State after one time step, or None after the last step."""
        from protochain.dynamics.loop import noise
        from protochain.dynamics.thermostats import Langevin
        from protochain.mechanics.motion.leapfrog import Leapfrog
        from protochain.mechanics.motion.system import Phase, StepTooLargeError, System

        if state.n_steps == self.n_steps:
            return None
        space = _torsions(problem)
        tree, seen = space.chain.tree, [state.at]

        def potential(q: Floats, factors: Articulated) -> tuple[float, Floats]:
            seen.append(problem.evaluate(q))
            return seen[-1].energy, seen[-1].torque / space.scale

        system = System(tree, potential)
        torque = state.at.torque / space.scale
        factors = articulate(tree, multibody.pose(tree, state.at.q))
        p = multibody.multiply_mass(tree, factors.frames, state.velocity)
        phase = Phase(state.at.q, state.velocity, p, state.at.energy, torque, factors)
        time_step = self._time_step(space, phase)
        # Halve the time step until the leapfrog succeeds.
        for _ in range(_HALVINGS):
            try:
                phase = Leapfrog().step(system, phase, time_step)
                break
            except StepTooLargeError:
                time_step *= 0.5
        else:
            return None
        # Langevin thermostat at the temperature of this step.
        n_steps = state.n_steps + 1
        thermal_energy = MOLAR_GAS * self.temperature * (1.0 - n_steps / self.n_steps)
        thermostat = Langevin(thermal_energy, self.friction)
        random = partial(noise, self.seed, n_steps)
        phase, _ = thermostat.apply(system, phase, thermostat.init(phase), time_step, random)
        return AnnealingState(seen[-1], phase.qd, n_steps)

    def _time_step(self, space: Torsions, phase: "Phase") -> float:
        """Time step, shortened if velocities or accelerations would turn a freedom too far."""
        rate = float(np.max(np.abs(phase.qd / space.scale), initial=0.0))
        acceleration = float(np.max(np.abs(solve(phase.factors, phase.torque) / space.scale), initial=0.0))
        shortest = min(
            LONGEST_TURN / rate if rate > 0.0 else np.inf,
            np.sqrt(2.0 * LONGEST_TURN / acceleration) if acceleration > 0.0 else np.inf,
        )
        return min(self.time_step, shortest)


def _torsions(problem: Problem) -> Torsions:
    assert isinstance(problem.space, Torsions)
    return problem.space
