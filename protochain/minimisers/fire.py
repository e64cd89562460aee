"""The fast inertial relaxation engine, and the quench of velocities: minimisers that move."""

from dataclasses import dataclass, field

import numpy as np

from protochain.arrays import Floats
from protochain.minimisers.metrics import Mass, Metric, Preconditioner
from protochain.minimisers.problem import Evaluation, Problem


@dataclass(frozen=True)
class Moving:
    """Where the method stands, how fast it moves, and its own settings' state."""

    at: Evaluation
    preconditioner: Preconditioner
    velocity: Floats
    time_step: float
    mixing: float
    downhill: int = 0


@dataclass(frozen=True)
class Fire:
    """Let the chain move, turn its velocity towards the torques, and stop it when it climbs.

    Bitzek, Koskinen, Gaehler, Moseler, Gumbsch, Phys. Rev. Lett. 97:170201 (2006), in a metric: accelerations
    are M^-1 tau. With all of the velocity turned (``mixing`` 1 that does not fade) it is the quench of
    Jonsson, Mills, Jacobsen (1998): what damped dynamics of the chain is built of.

    Parameters
    ----------
    metric : Metric
    mixing : float
        Part of the velocity turned towards the torques.
    fade : float
        Factor on the mixing at each step downhill.
    time_step, longest_time_step : float, ps
    """

    metric: Metric = field(default_factory=Mass)
    mixing: float = 0.1
    fade: float = 0.99
    time_step: float = 0.001
    longest_time_step: float = 0.02

    def init(self, problem: Problem, at: Evaluation) -> Moving:
        """Stand still at the start."""
        first = Preconditioner.first(self.metric, problem.space, at)
        return Moving(at, first, np.zeros_like(at.torque), self.time_step, self.mixing)

    def step(self, problem: Problem, state: Moving) -> Moving | None:
        """Move for one time step."""
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
            # A blow that would throw the chain apart: as far as a step may go, and slower.
            turn, v = short * turn, short * v
        found = problem.evaluate(problem.move(at.q, turn))
        if not found.is_finite:
            return None
        return Moving(found, state.preconditioner.next(problem.space, found), v, dt, mixing, downhill)
