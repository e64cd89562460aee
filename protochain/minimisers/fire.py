"""FIRE, the fast inertial relaxation engine, and velocity quenching."""

from dataclasses import dataclass, field

import numpy as np

from protochain.core.arrays import Floats
from protochain.core.settings import document_fields
from protochain.minimisers.metrics import Mass, Metric, Preconditioner
from protochain.minimisers.problem import Evaluation, Problem


@dataclass(frozen=True, eq=False)
class FireState:
    """Current point and velocity, with the adapted time step and mixing."""

    at: Evaluation
    preconditioner: Preconditioner
    velocity: Floats
    time_step: float
    mixing: float
    downhill: int = 0


@document_fields
@dataclass(frozen=True)
class Fire:
    """Move with inertia, turn the velocity towards the torques, and stop when the energy rises.

    Bitzek, Koskinen, Gaehler, Moseler, Gumbsch, Phys. Rev. Lett. 97:170201 (2006), in a metric: accelerations
    are M^-1 tau. With all of the velocity turned (``mixing`` 1 and ``fade`` 1) it is the velocity quench of
    Jonsson, Mills, Jacobsen (1998).
    """

    metric: Metric = field(default_factory=Mass)  # Inertia.
    mixing: float = 0.1  # Share of the velocity turned towards the torques.
    fade: float = 0.99  # Factor on the mixing at each step downhill.
    time_step: float = 0.001  # ps: Initial time step.
    longest_time_step: float = 0.02  # ps: Largest time step.
    states = (FireState,)

    def init(self, problem: Problem, at: Evaluation) -> FireState:
        """Start at rest."""
        first = Preconditioner.first(self.metric, problem.space, at)
        return FireState(at, first, np.zeros_like(at.torque), self.time_step, self.mixing)

    def step(self, problem: Problem, state: FireState) -> FireState | None:
        """State after one time step."""
        at, v, dt, mixing, downhill = state.at, state.velocity, state.time_step, state.mixing, state.downhill
        push = state.preconditioner.solve(at.torque)
        if v @ at.torque > 0.0:
            v = (1.0 - mixing) * v + mixing * np.linalg.norm(v) / np.linalg.norm(push) * push
            downhill += 1
            if downhill > 5:
                dt, mixing = min(1.1 * dt, self.longest_time_step), self.fade * mixing
        else:
            v, dt, mixing, downhill = np.zeros_like(v), 0.5 * dt if np.any(v) else dt, self.mixing, 0
        v = v + dt * push
        turn = dt * v
        short = min(1.0, 0.1 * problem.space.longest / np.max(np.abs(turn)))
        if short < 1.0:
            # Forces between overlapping atoms are too large: limit the step, and scale the velocity alike.
            turn, v = short * turn, short * v
        after = problem.evaluate(problem.move(at.q, turn))
        if not after.is_finite:
            return None
        return FireState(after, state.preconditioner.next(problem.space, after), v, dt, mixing, downhill)
