"""The kineto-static compliance method: turn hinges along their torques, in some norm or metric."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from protochain.arrays import Floats
from protochain.minimisers.metrics import Euclidean, Metric, Preconditioner
from protochain.minimisers.problem import Evaluation, Problem
from protochain.minimisers.steps import Fixed, Rule


def by_largest(direction: Floats) -> Floats:
    """Largest turn 1: as published."""
    return np.asarray(direction / np.max(np.abs(direction)))


def by_length(direction: Floats) -> Floats:
    """Root of the sum of squared turns 1."""
    return np.asarray(direction / np.linalg.norm(direction))


def by_sign(direction: Floats) -> Floats:
    """Every hinge by 1, the way its torque points."""
    return np.sign(direction)


@dataclass(frozen=True)
class Standing:
    """Where the method stands, with its metric and what its step rule remembers."""

    at: Evaluation
    preconditioner: Preconditioner
    rule: Any


@dataclass(frozen=True)
class KCM:
    """Turn every hinge in proportion to its torque: a direction times a step rule.

    theta_{k+1} = theta_k + h f(tau_k), with f(tau) = tau / max|tau| as published: Kazerounian, Latif,
    Alvarado, J. Mech. Des. 127:712 (2005). No masses, no velocities, no line search. Other norms: Robotics
    14(11):167 (2025). With a metric P the direction is f(P^-1 tau): with P = M, overdamped motion of the
    chain.

    Parameters
    ----------
    rule : Rule
        How far to go. The fixed angle lowers the energy of every sample; half of it is slower everywhere, and
        twice as much first raises the energy of packed proteins of a hundred residues and more, where a
        small turn in mid-chain moves much.
    metric : Metric
    norm : callable
        f.
    """

    rule: Rule = field(default_factory=lambda: Fixed(0.0005))
    metric: Metric = field(default_factory=Euclidean)
    norm: Callable[[Floats], Floats] = by_largest

    def init(self, problem: Problem, at: Evaluation) -> Standing:
        """Stand at the start."""
        return Standing(at, Preconditioner.first(self.metric, problem.space, at), self.rule.init(at))

    def step(self, problem: Problem, state: Standing) -> Standing | None:
        """Turn along the torques."""
        direction = self.norm(state.preconditioner.solve(state.at.torque))
        found = self.rule.step(problem, state.at, direction, state.rule)
        if found is None:
            return None
        at, rule = found
        return Standing(at, state.preconditioner.next(problem.space, at), rule)
