"""Truncated Newton and pseudo-transient continuation, by conjugate gradients on Hessian-vector products."""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from protochain.core.arrays import Floats
from protochain.core.settings import document_fields
from protochain.minimisers.descent import Direction
from protochain.minimisers.metrics import Metric, Solve, Stiffness
from protochain.minimisers.problem import Evaluation, Problem
from protochain.minimisers.steps import SMALLEST

_TURN = 1e-5
"""rad or nm, change of the largest freedom for differences of torques: between truncation and rounding."""


@dataclass(frozen=True, eq=False)
class PseudoTransientState:
    """Current point and pseudo-time step."""

    at: Evaluation
    time_step: float


@document_fields
@dataclass(frozen=True)
class Newton(Direction):
    """Truncated Newton: Dembo, Steihaug, Math. Program. 26:190 (1983).

    Preconditioned conjugate gradients solve H d = tau until the residual is small relative to the torque, or
    the curvature along a direction is negative. A product with H costs an evaluation.
    """

    metric: Metric = field(default_factory=Stiffness)  # The preconditioner.
    max_products: int = 30  # Products with H in one step at most.

    def propose(
        self, problem: Problem, at: Evaluation, solve: Solve, memory: None
    ) -> Iterator[tuple[Floats, None]]:
        """Yield the Newton direction, then the preconditioned torques."""
        space = problem.space
        rtol = min(0.5, np.sqrt(at.residual / (at.residual + 1000.0)))
        newton = conjugate_gradients(problem, at, solve, 0.0, rtol, self.max_products)
        for direction, limit in ((newton, space.longest), (solve(at.torque), space.first)):
            direction = direction * min(1.0, limit / np.max(np.abs(direction)))
            if direction @ at.torque > 0:
                yield direction, memory


@document_fields
@dataclass(frozen=True)
class PseudoTransient:
    """Pseudo-transient continuation of d theta/dt = tau by linearly implicit Euler steps.

    (1/delta + H) d = tau, with delta growing as the torque falls, ``delta_{k+1} =
    delta_k |tau_{k-1}| / |tau_k|`` (switched evolution relaxation, Kelley, Keyes, SIAM J. Numer. Anal.
    35:508, 1998, and for the compliance method Robotics 13(10):150, 2024). It begins with small steps along
    the torques and becomes Newton's method. A step that raises the energy is rejected, and delta reduced.
    """

    # rad^2 mol/kJ: First delta, for a largest torque of 1 kJ/mol/rad. It is divided by the largest torque.
    time_step: float = 0.01
    max_products: int = 30  # Products with H in one step at most.
    states = (PseudoTransientState,)

    def init(self, problem: Problem, at: Evaluation) -> PseudoTransientState:
        """Start, with the initial time step."""
        return PseudoTransientState(at, self.time_step / max(1.0, at.residual))

    def step(self, problem: Problem, state: PseudoTransientState) -> PseudoTransientState | None:
        """Make the longest step that lowers the energy."""
        space, at, delta = problem.space, state.at, state.time_step
        while True:
            turn = conjugate_gradients(problem, at, np.copy, 1.0 / delta, 0.1, self.max_products)
            size = np.max(np.abs(turn))
            if size < SMALLEST:
                return None
            after = problem.evaluate(problem.move(at.q, turn * min(1.0, space.longest / size)))
            if after.is_finite and after.energy < at.energy:
                grown = delta * np.linalg.norm(at.torque) / np.linalg.norm(after.torque)
                return PseudoTransientState(after, float(grown))
            delta *= 0.25


def conjugate_gradients(
    problem: Problem, at: Evaluation, solve: Solve, shift: float, rtol: float, max_products: int
) -> Floats:
    """Solve (shift + H) d = tau inexactly, in the subspace of positive curvature so far."""
    # -> (n_v,): A descent direction (Nocedal, Wright, *Numerical Optimization*, 2006, algorithm 7.1).
    turn = np.zeros_like(at.torque)
    residual = at.torque.copy()
    z = solve(residual)
    direction, size = z, residual @ z
    target = rtol**2 * size
    for n in range(max_products):
        h = _TURN / np.max(np.abs(direction))
        displaced = problem.evaluate(problem.move(at.q, h * direction))
        product = (at.torque - displaced.torque) / h + shift * direction
        curvature = direction @ product
        if not curvature > 0.0:
            return direction.copy() if n == 0 else turn
        length = size / curvature
        turn += length * direction
        residual -= length * product
        z = solve(residual)
        before, size = size, residual @ z
        if size <= target:
            break
        direction = z + (size / before) * direction
    return turn
