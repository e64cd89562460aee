"""Directions of the limited-memory quasi-Newton method, L-BFGS."""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from scipy.linalg.blas import daxpy, ddot

from protochain.core.arrays import Floats
from protochain.core.settings import document_fields
from protochain.minimisers.descent import Direction
from protochain.minimisers.metrics import Metric, Solve, Stiffness
from protochain.minimisers.problem import Evaluation, Problem

_CURVATURE = 1e-10
"""Relative. Pairs with less curvature are skipped: they would make the estimate of the Hessian singular."""
NEAR_MEMORY = 5
"""Pairs stored with a metric of the force field's near terms, to correct for its missing terms. With 100
pairs, mostly from earlier metrics and points, runs need half as many evaluations again."""

Pairs = tuple[tuple[Floats, Floats, float], ...]
"""Steps, the decreases of torque along them, and the (positive) products of both, oldest first."""


@document_fields
@dataclass(frozen=True)
class LBFGS(Direction):
    """L-BFGS: Nocedal, Wright, *Numerical Optimization* (2006), 7.4-7.5.

    The first estimate of the Hessian is a metric, scaled to the last pair. It may change from one iteration
    to the next. Free roots move on their rotation group. Steps and torque changes of successive points are
    treated as vectors of one space, which is correct to first order in the step.
    """

    metric: Metric = field(default_factory=Stiffness)  # First estimate of the Hessian.
    memory: int = 100  # Number of stored pairs.

    def propose(
        self, problem: Problem, at: Evaluation, solve: Solve, memory: Pairs
    ) -> Iterator[tuple[Floats, Pairs]]:
        """Yield the quasi-Newton direction, then the preconditioned torques without the pairs."""
        for pairs in (memory, ()) if memory else ((),):
            direction = quasi_newton(at.torque, pairs, solve)
            limit = problem.space.longest if pairs else problem.space.first
            direction *= min(1.0, limit / np.max(np.abs(direction)))
            yield direction, pairs

    def update(self, memory: Pairs, before: Evaluation, step: Floats, after: Evaluation) -> Pairs:
        """Add a pair, and drop the oldest if there are too many."""
        recent = deque(memory, maxlen=self.memory)
        change = before.torque - after.torque
        # The squared torques of coinciding atoms may overflow: no pair then.
        with np.errstate(over="ignore"):
            curvature = float(step @ change)
            if curvature > _CURVATURE * np.linalg.norm(step) * np.linalg.norm(change):
                recent.append((step, change, curvature))
        return tuple(recent)


def quasi_newton(torque: Floats, pairs: Pairs, solve: Solve = np.copy) -> Floats:
    """Inverse-Hessian estimate times the torques, by the two-loop recursion (algorithm 7.4)."""
    # torque (n_v,) -> (n_v,): A descent direction.
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
