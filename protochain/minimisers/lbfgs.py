"""Limited-memory quasi-Newton."""

from collections import deque
from dataclasses import dataclass, field

import numpy as np
from scipy.linalg.blas import daxpy, ddot

from protochain.arrays import Floats
from protochain.minimisers.metrics import Metric, Preconditioner, Solve, Stiffness
from protochain.minimisers.problem import Evaluation, Problem
from protochain.minimisers.steps import strong_wolfe

_CURVATURE = 1e-10
"""A pair with less curvature than this (relative) would make the metric singular: it is left out."""

Pairs = tuple[tuple[Floats, Floats, float], ...]
"""Steps, the falls in torque along them, and the products of both, which are positive; oldest first."""


@dataclass(frozen=True)
class Memory:
    """Where the method stands, its metric, and the last steps and torque changes, oldest first."""

    at: Evaluation
    preconditioner: Preconditioner
    pairs: Pairs = ()


@dataclass(frozen=True)
class LBFGS:
    """L-BFGS with a strong-Wolfe line search: Nocedal, Wright, *Numerical Optimization* (2006), 7.4-7.5.

    The first estimate of the Hessian is a metric, scaled to the last pair: it may change from one iteration
    to the next. Free roots move on their rotation group: steps and torque changes of successive points are
    taken as vectors of one space, which is right to first order in the step.

    Parameters
    ----------
    metric : Metric
    memory : int
        Pairs kept.
    """

    metric: Metric = field(default_factory=Stiffness)
    memory: int = 100

    def init(self, problem: Problem, at: Evaluation) -> Memory:
        """Start with an empty memory."""
        return Memory(at, Preconditioner.first(self.metric, problem.space, at))

    def step(self, problem: Problem, state: Memory) -> Memory | None:
        """Search along the quasi-Newton direction; failing that, along the preconditioned torques."""
        space = problem.space
        for pairs in (state.pairs, ()) if state.pairs else ((),):
            direction = quasi_newton(state.at.torque, pairs, state.preconditioner.solve)
            limit = space.longest if pairs else space.first
            direction *= min(1.0, limit / np.max(np.abs(direction)))
            found = strong_wolfe(problem, state.at, direction)
            if found is not None:
                length, at = found
                recent = deque(pairs, maxlen=self.memory)
                step, change = length * direction, state.at.torque - at.torque
                # Torques of atoms on top of one another have no representable square: no pair then.
                with np.errstate(over="ignore"):
                    curvature = float(step @ change)
                    if curvature > _CURVATURE * np.linalg.norm(step) * np.linalg.norm(change):
                        recent.append((step, change, curvature))
                return Memory(at, state.preconditioner.next(space, at), tuple(recent))
        return None


def quasi_newton(torque: Floats, pairs: Pairs, solve: Solve = np.copy) -> Floats:
    """Inverse-Hessian estimate times the torques, by the two-loop recursion (algorithm 7.4).

    Parameters
    ----------
    torque : (n_v,) float
        Minus the gradient.
    pairs : tuple of ((n_v,) float, (n_v,) float, float)
        Steps, the falls in torque along them, and the (positive) products of both; oldest first.
    solve : callable
        With the first estimate of the Hessian, but for its scale.

    Returns
    -------
    (n_v,) float
        A descent direction.
    """
    direction = torque.copy()
    weights = []
    # In place, by BLAS: with many pairs temporaries would cost more than the energy of a small protein.
    for step, change, curvature in reversed(pairs):
        weights.append(ddot(step, direction) / curvature)
        daxpy(change, direction, a=-weights[-1])
    direction = solve(direction)
    if pairs:
        _, change, curvature = pairs[-1]
        direction *= curvature / ddot(change, solve(change))
    for (step, change, curvature), weight in zip(pairs, reversed(weights), strict=True):
        daxpy(step, direction, a=weight - ddot(change, direction) / curvature)
    return direction
