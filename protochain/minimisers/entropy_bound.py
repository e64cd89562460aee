"""Bounds on the step of the kineto-static compliance method: the step nearest to KCM's within a bound.

Mohammadi and Spong (IEEE Control Syst. Lett. 6, 2022, and J. Dyn. Syst. Meas. Control 147:051011, 2025) bound
d^T Q d, which limits the rate of entropy loss, and use the direction d nearest to the KCM vector field. Only
their abstracts could be read. The metrics Q and the solution below are derived in theory.md.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal, get_args

import numpy as np

from protochain.chains.chain import Chain, Pose
from protochain.chains.contacts import alpha_contacts
from protochain.core.arrays import Floats
from protochain.core.errors import ProtochainError
from protochain.mechanics.multibody import HingeKind, Tree, pull_back, rigid_bodies
from protochain.mechanics.multibody.articulated import solve_for_bodies
from protochain.mechanics.multibody.newton_euler import inertial_loads
from protochain.mechanics.multibody.tree import ARMATURE, MASS
from protochain.minimisers.kcm import KCM
from protochain.minimisers.metrics import Solve
from protochain.minimisers.problem import Evaluation, Problem, Space
from protochain.minimisers.spaces import Torsions

MetricName = Literal["turns", "mass", "positions", "contacts"]
METRIC_NAMES: tuple[str, ...] = get_args(MetricName)
MOST_ITERATIONS = 5
"""Newton's iterations for the multiplier. Spectra over eight decades need five from a cold start."""
_ROUND_OFF = 1e-14


@dataclass(frozen=True)
class MeanTurn:
    """Mean square of the turns, in rad^2: the identity over the number of freedoms."""

    n_v: int

    def product(self, step: Floats) -> Floats:
        """Q d for a step (n_v,)."""
        return step / self.n_v

    def shifted_solver(self, multiplier: float) -> Solve:
        """Solver for I + multiplier Q."""
        return lambda step: step / (1.0 + multiplier / self.n_v)


@dataclass(frozen=True, eq=False)
class MeanMovement:
    """Weighted mean square movement of atoms, in nm^2: the mass matrix if weights are masses."""

    # Products and solutions are O(n) sweeps. I + multiplier Q is the mass matrix of the weights with an
    # armature of 1/multiplier at every hinge, times the multiplier.

    tree: Tree  # The chain's tree with weights, of sum 1, in place of the masses.
    pose: Pose  # Pose of the chain.
    scale: Floats  # (n_v,) float: Rates of the freedoms for a unit step, as in :class:`Torsions`.

    def product(self, step: Floats) -> Floats:
        """Q d for a step (n_v,)."""
        frames = self.pose.frames
        loads = inertial_loads(self.tree, frames, np.zeros(len(step)), self.scale * step)
        return np.asarray(self.scale * pull_back(self.tree, frames, loads))

    def shifted_solver(self, multiplier: float) -> Solve:
        """Solver for I + multiplier Q."""
        bodies = self.tree.bodies.copy()
        bodies[:, ARMATURE] = 1.0 / multiplier
        # A point mass at the origin of a free root resists its translation alone, whose scale is not 1.
        for root in np.flatnonzero(self.tree.kind == HingeKind.FREE):
            lever = self.scale[self.tree.v_start[root] + 3]
            bodies[root, MASS] += (1.0 / lever**2 - 1.0) / multiplier

        def solve(step: Floats) -> Floats:
            rates = solve_for_bodies(self.tree, bodies, self.pose.frames, step / self.scale)
            return rates / (multiplier * self.scale)

        return solve


Ellipsoid = MeanTurn | MeanMovement
"""A positive semidefinite matrix Q that measures steps: d^T Q d is a mean square movement."""


def ellipsoid_at(name: str, space: Space, at: Evaluation) -> Ellipsoid:
    """Ellipsoid of a name of ``METRIC_NAMES`` at a point of a space of hinges."""
    if not isinstance(space, Torsions) or not isinstance(at.pose, Pose):
        raise ProtochainError("entropy bounds apply to methods that turn hinges; choose a method of KCM")
    chain = space.chain
    if name == "turns":
        return MeanTurn(chain.n_v)
    if name == "contacts":
        # Each C-alpha weighs one more than the number of its contacts.
        alphas = chain.structure.alpha_carbons
        counts = np.bincount(alpha_contacts(chain.structure, at.x).ravel(), minlength=chain.n_atoms)
        tree = _tree_of_alphas(chain, 1.0 + counts[alphas].astype(float))
    else:
        tree = _tree_of_weights(chain, name)
    return MeanMovement(tree, at.pose, space.scale)


@lru_cache(maxsize=4)
def _tree_of_weights(chain: Chain, name: str) -> Tree:
    """Tree whose weights are the masses of the atoms, or equal ones of the C-alphas."""
    if name == "mass":
        structure, tree = chain.structure, chain.tree
        total = np.sum(structure.atom_mass[~structure.obstacle])
        return replace(tree, mass=tree.mass / total, inertia=tree.inertia / total)
    return _tree_of_alphas(chain, np.ones(len(chain.structure.alpha_carbons)))


def _tree_of_alphas(chain: Chain, weights: Floats) -> Tree:
    """Tree whose C-alphas have weights (nca,), scaled to a sum of 1, and all other atoms none."""
    atoms = chain.structure.alpha_carbons
    if not len(atoms):
        raise ProtochainError(
            f"{chain.structure.name}: no C-alpha atoms for this metric; choose 'mass' or 'turns'"
        )
    mass, com, inertia = rigid_bodies(
        chain.atom_body[atoms], chain.atom_local[atoms], weights / np.sum(weights), chain.n_bodies
    )
    # A body without weight is permitted only at a hinge with armature.
    return replace(chain.tree, mass=mass, com=com, inertia=inertia, armature=np.ones(len(mass)))


def nearest_within(step: Floats, ellipsoid: Ellipsoid, bound: float) -> tuple[Floats, float]:
    """Nearest vector d to a step h (n_v,) with d^T Q d <= bound^2, and its multiplier, 0 within the bound."""
    # The solution is d = (I + lambda Q)^-1 h, with lambda from the secular equation |d|_Q = bound (Moré,
    # Sorensen, SIAM J. Sci. Stat. Comput. 4:553, 1983). Newton's method in the logarithms of both solves it,
    # as |d|_Q falls from a constant to a multiple of 1/lambda.
    product = ellipsoid.product(step)
    length = math.sqrt(max(float(step @ product), 0.0))
    if length <= bound:
        return step, 0.0
    # Newton's first step for 1/|d|_Q, which is concave, so that it ends below the solution.
    multiplier = (length / bound - 1.0) * length**2 / float(product @ product)
    nearest = step
    for _ in range(MOST_ITERATIONS):
        solve = ellipsoid.shifted_solver(multiplier)
        nearest = solve(step)
        product = ellipsoid.product(nearest)
        length = math.sqrt(float(nearest @ product))
        if abs(length - bound) <= _ROUND_OFF * bound:
            break
        slope = -multiplier * float(product @ solve(product)) / length**2
        multiplier *= math.exp(math.log(bound / length) / slope)
    return nearest * min(1.0, bound / length), multiplier


@dataclass(frozen=True)
class EntropyBound(KCM):
    """KCM's direction, or the nearest one within an ellipsoid that limits the rate of entropy loss."""

    # Largest RMS movement for each radian by which the hinge of largest torque turns without the bound:
    # nm/rad, or rad/rad in the metric ``turns``.
    rate: float = math.inf
    # Metric Q: RMS of the turns, of the movement of all atoms weighted by mass, of the C-alphas
    # (``positions``), or of the C-alphas weighted by their contacts.
    within: MetricName = "positions"

    def propose(
        self, problem: Problem, at: Evaluation, solve: Solve, memory: None
    ) -> Iterator[tuple[Floats, None]]:
        """Yield the nearest direction."""
        step = self.norm(solve(at.torque))
        if math.isfinite(self.rate) and np.isfinite(step).all():
            step, _ = nearest_within(step, ellipsoid_at(self.within, problem.space, at), self.rate)
        yield step, memory


@dataclass(frozen=True)
class TurnBound(KCM):
    """KCM's direction, or the nearest one in which no hinge turns by more than its limit."""

    # Largest turn of a hinge as a share of the turn of the hinge of largest torque without the bound.
    limit: float = 1.0

    def propose(
        self, problem: Problem, at: Evaluation, solve: Solve, memory: None
    ) -> Iterator[tuple[Floats, None]]:
        """Yield the turns, each projected onto its interval."""
        yield np.clip(self.norm(solve(at.torque)), -self.limit, self.limit), memory
