"""Truncated Newton and pseudo-transient continuation: conjugate gradients on Hessian-vector products."""

from dataclasses import dataclass, field

import numpy as np

from protochain.arrays import Floats
from protochain.minimisers.metrics import Metric, Preconditioner, Solve, Stiffness
from protochain.minimisers.problem import Evaluation, Problem
from protochain.minimisers.steps import SMALLEST, strong_wolfe

_TURN = 1e-5
"""rad or nm, of the largest freedom: the step of a difference of torques. What it neglects grows with it,
what rounding adds shrinks."""


@dataclass(frozen=True)
class Position:
    """Where the method stands, and its preconditioner."""

    at: Evaluation
    preconditioner: Preconditioner


@dataclass(frozen=True)
class Continuation:
    """Where the method stands, and its pseudo-time step."""

    at: Evaluation
    time_step: float


@dataclass(frozen=True)
class Newton:
    """Truncated Newton: Dembo, Steihaug, Math. Program. 26:190 (1983).

    Solves H d = tau by preconditioned conjugate gradients until the residual is small against the torque, or
    a direction of negative curvature shows up; then a strong-Wolfe search along d. A product with H costs an
    evaluation.

    Parameters
    ----------
    metric : Metric
        The preconditioner.
    most : int
        Products for one step at most.
    """

    metric: Metric = field(default_factory=Stiffness)
    most: int = 30

    def init(self, problem: Problem, at: Evaluation) -> Position:
        """Stand at the start."""
        return Position(at, Preconditioner.first(self.metric, problem.space, at))

    def step(self, problem: Problem, state: Position) -> Position | None:
        """Search along the Newton direction; failing that, along the preconditioned torques."""
        space, at, solve = problem.space, state.at, state.preconditioner.solve
        enough = min(0.5, np.sqrt(at.residual / (at.residual + 1000.0)))
        newton = conjugate_gradients(problem, at, solve, 0.0, enough, self.most)
        for direction, limit in ((newton, space.longest), (solve(at.torque), space.first)):
            direction = direction * min(1.0, limit / np.max(np.abs(direction)))
            found = strong_wolfe(problem, at, direction) if direction @ at.torque > 0 else None
            if found is not None:
                return Position(found[1], state.preconditioner.next(space, found[1]))
        return None


@dataclass(frozen=True)
class PseudoTransient:
    """Pseudo-transient continuation of d theta/dt = tau by linearly implicit Euler steps.

    (1/delta + H) d = tau, with delta growing as the torque falls, delta_{k+1} = delta_k |tau_{k-1}| / |tau_k|
    (switched evolution relaxation): Kelley, Keyes, SIAM J. Numer. Anal. 35:508 (1998); for the
    compliance method, Robotics 13(10):150 (2024). From small steps along the torques it turns into Newton's
    method. A step that raises the energy is taken back, and delta made smaller.

    Parameters
    ----------
    time_step : float, rad^2 mol/kJ
        First delta, for a largest torque of 1 kJ/mol/rad: it is divided by the largest torque.
    most : int
        Products with H for one step at most.
    """

    time_step: float = 0.01
    most: int = 30

    def init(self, problem: Problem, at: Evaluation) -> Continuation:
        """Stand at the start with the first time step."""
        return Continuation(at, self.time_step / max(1.0, at.residual))

    def step(self, problem: Problem, state: Continuation) -> Continuation | None:
        """Take the longest step that lowers the energy."""
        space, at, delta = problem.space, state.at, state.time_step
        while True:
            turn = conjugate_gradients(problem, at, np.copy, 1.0 / delta, 0.1, self.most)
            size = np.max(np.abs(turn))
            if size < SMALLEST:
                return None
            found = problem.evaluate(problem.move(at.q, turn * min(1.0, space.longest / size)))
            if found.is_finite and found.energy < at.energy:
                grown = delta * np.linalg.norm(at.torque) / np.linalg.norm(found.torque)
                return Continuation(found, float(grown))
            delta *= 0.25


def conjugate_gradients(
    problem: Problem, at: Evaluation, solve: Solve, shift: float, enough: float, most: int
) -> Floats:
    """Solve (shift + H) d = tau roughly, staying where the curvature is positive.

    Parameters
    ----------
    problem : Problem
        Counts an evaluation for each product with H.
    at : Evaluation
    solve : callable
        The preconditioner.
    shift : float
    enough : float
        Residual to stop at, as part of the torque, both measured by the preconditioner.
    most : int
        Products at most.

    Returns
    -------
    (n_v,) float
        A descent direction (Nocedal, Wright, *Numerical Optimization*, 2006, algorithm 7.1).
    """
    turn = np.zeros_like(at.torque)
    left = at.torque.copy()
    z = solve(left)
    direction, size = z, left @ z
    target = enough**2 * size
    for n in range(most):
        h = _TURN / np.max(np.abs(direction))
        moved = problem.evaluate(problem.move(at.q, h * direction))
        product = (at.torque - moved.torque) / h + shift * direction
        curvature = direction @ product
        if not curvature > 0.0:
            return direction.copy() if n == 0 else turn
        length = size / curvature
        turn += length * direction
        left -= length * product
        z = solve(left)
        before, size = size, left @ z
        if size <= target:
            break
        direction = z + (size / before) * direction
    return turn
