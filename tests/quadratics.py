"""Minimisers' problems small enough that each step can be written down."""

from dataclasses import dataclass, field

import numpy as np

from protochain.minimisers.problem import Evaluation, Problem
from protochain.minimisers.spaces import Positions


@dataclass
class Flat:
    """Space of 3 n plain numbers, which are the positions; its matrices are given, and their uses counted."""

    longest: float = 0.5
    first: float = 0.01
    matrix: np.ndarray | None = None
    mass: np.ndarray | None = None
    unit: str = "largest {:.4g}"
    made: list = field(default_factory=list)

    def start(self, x):
        return x.flatten()

    def place(self, q):
        return Positions(q)

    def torque(self, at, forces):
        return forces.ravel()

    def residual(self, torque):
        return float(np.max(np.abs(torque)))

    def move(self, q, step):
        return q + step

    def _solver(self, name, matrix, at):
        self.made.append((name, at))
        return lambda torque: np.linalg.solve(matrix, torque)

    def stiffness(self, at):
        return self._solver("stiffness", self.matrix, at)

    def inertia(self, at):
        return self._solver("inertia", self.mass, at)


@dataclass
class Quadratic:
    """E = 1/2 d.H d with d = x - low; all points asked for are noted."""

    hessian: np.ndarray
    low: np.ndarray | float = 0.0
    asked: list = field(default_factory=list)

    def __call__(self, x):
        d = x.ravel() - self.low
        self.asked.append(x.ravel().copy())
        force = -self.hessian @ d
        return float(-0.5 * d @ force), force.reshape(-1, 3)


@dataclass
class Along:
    """Energy and torque along the first coordinate as told by functions; the other two are flat."""

    energy: object
    torque: object = lambda t: 1.0
    asked: list = field(default_factory=list)

    def __call__(self, x):
        t = float(x[0, 0])
        self.asked.append(t)
        return self.energy(t), np.array([[self.torque(t), 0.0, 0.0]])


def evaluation(energy, torque, q=(0.0, 0.0, 0.0), residual=1.0):
    """A point as told."""
    return Evaluation(Positions(np.array(q, dtype=float)), energy, np.array(torque, dtype=float), residual)


def along(energy, torque=lambda t: 1.0, budget=1000, **space):
    """Problem along one coordinate, its start at 0, and the unit direction."""
    problem = Problem(Flat(**space), Along(energy, torque), budget)
    return problem, evaluation(energy(0.0), [torque(0.0), 0.0, 0.0]), np.array([1.0, 0.0, 0.0])


def positive(n, seed, stiffest=100.0):
    """(n, n) positive definite matrix with eigenvalues from 1 to the stiffest."""
    turn, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(n, n)))
    return turn @ np.diag(np.geomspace(1.0, stiffest, n)) @ turn.T
