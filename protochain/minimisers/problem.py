"""What a minimiser sees: evaluate a point, move from it, and the count of what that cost."""

from dataclasses import dataclass, field

import numpy as np

from protochain import multibody
from protochain.arrays import Floats
from protochain.chain import Chain, pose, pull_back
from protochain.energies.protocol import Energy
from protochain.multibody import HingeKind

ROOT_LEVER = 0.1
"""nm moved by a free root for one radian: makes its forces and the hinges' torques one kind of number."""


class BudgetSpentError(Exception):
    """The evaluations allowed are used up; the loop turns this into a status."""


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Energy and torques at one point.

    Parameters
    ----------
    q : (n_q,) float
    x : (na, 3) float, nm
    energy : float, kJ/mol
    torque : (n_v,) float, kJ/mol/rad
        -dE/d(freedom); the force on a free root is multiplied by ``ROOT_LEVER``.
    """

    q: Floats
    x: Floats
    energy: float
    torque: Floats

    @property
    def max_torque(self) -> float:
        """Largest torque, kJ/mol/rad."""
        return float(np.max(np.abs(self.torque)))

    @property
    def is_finite(self) -> bool:
        """Whether energy and torques are all numbers."""
        return bool(np.isfinite(self.energy) and np.isfinite(self.torque).all())


@dataclass
class Problem:
    """An energy over a chain's coordinates, with a budget of evaluations.

    Parameters
    ----------
    chain : Chain
    energy : Energy
        May be replaced by its double-precision twin during a run.
    max_evaluations : int
    """

    chain: Chain
    energy: Energy
    max_evaluations: int
    n_evaluations: int = 0
    best: Evaluation | None = None
    improved_at: int = 0
    scale: Floats = field(init=False)

    def __post_init__(self) -> None:
        self.scale = root_scale(self.chain)

    def evaluate(self, q: Floats) -> Evaluation:
        """Energy and torques at q, remembering the lowest energy seen.

        Raises
        ------
        BudgetSpentError
            If no evaluation is left.
        """
        if self.n_evaluations >= self.max_evaluations:
            raise BudgetSpentError
        self.n_evaluations += 1
        at = evaluate(self.chain, self.energy, q, self.scale)
        if at.is_finite and (self.best is None or at.energy < self.best.energy):
            self.best = at
            self.improved_at = self.n_evaluations
        return at

    def move(self, q: Floats, step: Floats) -> Floats:
        """Coordinates after a step (n_v,) in the units in which torques are kJ/mol/rad."""
        return multibody.integrate(self.chain.tree, q, self.scale * step)


def root_scale(chain: Chain) -> Floats:
    """(n_v,) float: 1 for angles, ``ROOT_LEVER`` for the translation of a free root."""
    scale = np.ones(chain.n_v)
    for body in np.flatnonzero(chain.tree.kind == HingeKind.FREE):
        start = chain.tree.v_start[body]
        scale[start + 3 : start + 6] = ROOT_LEVER
    return scale


def evaluate(chain: Chain, energy: Energy, q: Floats, scale: Floats) -> Evaluation:
    """Energy and scaled torques at q, uncounted."""
    posed = pose(chain, q)
    value, forces = energy(posed.x)
    return Evaluation(posed.q, posed.x, value, scale * pull_back(chain, posed, forces))
