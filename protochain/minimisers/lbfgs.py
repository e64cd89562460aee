"""Limited-memory quasi-Newton in torsions."""

import warnings
from collections import deque
from dataclasses import dataclass

import numpy as np
from scipy.optimize import line_search

from protochain.arrays import Floats
from protochain.minimisers.problem import Evaluation, Problem

_CURVATURE = 1e-10
"""A pair with less curvature than this (relative) would make the metric singular: it is left out."""

_SMALLEST_TURN = 1e-8
"""rad: what a shorter step gains is lost in the rounding of the energy."""


@dataclass(frozen=True)
class Memory:
    """Where the method stands, and the last steps and torque changes, oldest first."""

    at: Evaluation
    pairs: tuple[tuple[Floats, Floats], ...] = ()


@dataclass(frozen=True)
class LBFGS:
    """L-BFGS with a strong-Wolfe line search: Nocedal, Wright, *Numerical Optimization* (2006), 7.4-7.5.

    Free roots move on their rotation group: steps and torque changes of successive points are taken as
    vectors of one space, which is right to first order in the step.

    Parameters
    ----------
    memory : int
        Pairs kept.
    max_angle : float, rad
        No hinge is asked to turn further in one step.
    first_angle : float, rad
        The largest turn of the first trial step, when nothing is known of the curvature.
    """

    memory: int = 20
    max_angle: float = 0.5
    first_angle: float = 0.01

    def init(self, at: Evaluation) -> Memory:
        """Start with an empty memory."""
        return Memory(at)

    def step(self, problem: Problem, state: Memory) -> Memory | None:
        """Search along the quasi-Newton direction; failing that, along the torques."""
        for pairs in (state.pairs, ()) if state.pairs else ((),):
            direction = quasi_newton(state.at.torque, pairs)
            limit = self.max_angle if pairs else self.first_angle
            direction *= min(1.0, limit / np.max(np.abs(direction)))
            found = strong_wolfe(problem, state.at, direction)
            if found is not None:
                length, at = found
                recent = deque(pairs, maxlen=self.memory)
                step, change = length * direction, state.at.torque - at.torque
                # Torques of atoms on top of one another have no representable square: no pair then.
                with np.errstate(over="ignore"):
                    curved = step @ change > _CURVATURE * np.linalg.norm(step) * np.linalg.norm(change)
                if curved:
                    recent.append((step, change))
                return Memory(at, tuple(recent))
        return None


def quasi_newton(torque: Floats, pairs: tuple[tuple[Floats, Floats], ...]) -> Floats:
    """Inverse-Hessian estimate times the torques, by the two-loop recursion (algorithm 7.4).

    Parameters
    ----------
    torque : (n_v,) float
        Minus the gradient.
    pairs : tuple of ((n_v,) float, (n_v,) float)
        Steps and the falls in torque along them, oldest first, each of positive curvature.

    Returns
    -------
    (n_v,) float
        A descent direction.
    """
    direction = torque.copy()
    weights = []
    for step, change in reversed(pairs):
        weight = (step @ direction) / (step @ change)
        direction -= weight * change
        weights.append(weight)
    if pairs:
        step, change = pairs[-1]
        direction *= (step @ change) / (change @ change)
    for (step, change), weight in zip(pairs, reversed(weights), strict=True):
        direction += (weight - (change @ direction) / (step @ change)) * step
    return direction


def strong_wolfe(problem: Problem, at: Evaluation, direction: Floats) -> tuple[float, Evaluation] | None:
    """Step length that meets the strong Wolfe conditions, or the lowest point met on the way.

    Parameters
    ----------
    problem : Problem
    at : Evaluation
    direction : (n_v,) float

    Returns
    -------
    tuple of (float, Evaluation), or None
        None if no point tried lies lower than the start.
    """
    tried: dict[float, Evaluation] = {}

    def point(length: Floats) -> Evaluation:
        key = float(length[0])
        if key not in tried:
            tried[key] = problem.evaluate(problem.move(at.q, key * direction))
        return tried[key]

    def height(length: Floats) -> float:
        return point(length).energy

    def lowest() -> float:
        return min((found.energy for found in tried.values() if found.is_finite), default=np.inf)

    def slope(length: Floats) -> Floats:
        return np.array([-point(length).torque @ direction])

    with warnings.catch_warnings():
        # Failure is in the return value.
        warnings.simplefilter("ignore")
        length = line_search(
            height,
            slope,
            np.zeros(1),
            np.ones(1),
            gfk=np.array([-at.torque @ direction]),
            old_fval=at.energy,
            maxiter=10,
        )[0]
    if length is None:
        # Against a wall (a stiff contact, a long lever) the interpolation may give up too far out.
        size = np.max(np.abs(direction))
        nearest = min(tried)
        while nearest * size > _SMALLEST_TURN and not lowest() < at.energy:
            nearest *= 0.1
            point(np.array([nearest]))
        if not lowest() < at.energy:
            return None
        length = next(key for key, found in tried.items() if found.is_finite and found.energy == lowest())
    return float(length), tried[float(length)]
