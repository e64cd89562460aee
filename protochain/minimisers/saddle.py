"""Whether a run ends in a minimum: the lowest eigenvalue of its Hessian, and the way off a saddle point.

Davidson's method (J. Comput. Phys. 17:87, 1975): the subspace grows by the residual of the last estimate, in
a metric of contacts, and each vector costs one product with the Hessian, a difference of torques.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from protochain import multibody
from protochain.arrays import Floats
from protochain.chain import Pose
from protochain.contacts import near_pairs
from protochain.interrupts import answering
from protochain.minimisers import springs
from protochain.minimisers.loop import Ending, Stop
from protochain.minimisers.metrics import Preconditioner, Solve
from protochain.minimisers.problem import Evaluation, Problem, Space
from protochain.minimisers.spaces import Torsions
from protochain.minimisers.stages import Stage
from protochain.multibody import HingeKind
from protochain.structure.model import Structure

TURN = 1e-4
"""rad, of the largest freedom: step of the one-sided differences of torques that build the subspace."""

CENTRAL = 1e-3
"""rad, of the largest freedom: step of the central difference that gives the eigenvalue. It may be longer, as
its error is of second order."""

SHARE = 0.002
"""The search ends when the last vector lowered the estimate by less than this share, as would the next."""

STARTS, WEIGHT = 3, 0.3
"""Vectors that the search begins with, and weight of the residual of the second lowest estimate.

With one vector, and the lowest alone, 3 of 15 peptides end at their second eigenvalue, up to twice the
lowest: a soft turn of two hinges, each stiff, has hardly a part in the start. So none of 6 does
at 3 tolerances, for some 6 products more; the value remains a bound from above."""

LEAST = 0.1
"""kJ/mol/rad^2. Eigenvalues nearer 0 count as 0: a turn of 1 rad gains less than 0.05 kJ/mol."""

MOST = 60
"""Products at most; what was found by then is the estimate."""

FIRST, SHORTEST, LONGEST = 0.1, 1e-3, 1.6
"""rad, of the largest freedom: first, shortest and longest turn off a saddle point."""

ROUNDS = 4
"""Saddle points that a run leaves; after that it ends at one."""

_FLOOR, _DECAY = 1.0, 8.0
"""kJ/mol/rad^2, added to the stiffness of the contacts, and its decay rate per contact distance. Minimisers
have a higher floor and a steeper decay, for their steps must not be long in soft directions; here the softest
is sought, and these take the fewest products on the samples."""

_LARGE = 500
"""Freedoms from which on the metric is made in a thread, so that Ctrl-C is answered meanwhile."""


@dataclass(frozen=True)
class Soft:
    """Stiffness of the contacts with nearly nothing added: it ranks soft directions.

    Parameters
    ----------
    refresh_every : int
        Iterations between two computations of the matrix.
    """

    refresh_every: int = 1_000_000_000

    def at(self, space: Space, at: Evaluation) -> Solve:
        """Solver for the matrix at a point."""
        assert isinstance(space, Torsions) and isinstance(at.pose, Pose)
        chain, pose, scale = space.chain, at.pose, space.scale

        def factorised() -> Any:
            matrix = springs.torsion_stiffness(chain, pose, _springs) * np.outer(scale, scale)
            matrix[np.diag_indices_from(matrix)] += _FLOOR
            return cho_factor(matrix, lower=True, check_finite=False)

        factor = factorised() if chain.n_v < _LARGE else answering(factorised, held=True)
        return lambda torque: np.asarray(cho_solve(factor, torque, check_finite=False))


def _springs(structure: Structure, x: Floats, bonds: int) -> springs.Springs:
    """Springs of contacts, and of bonds and angles: where a ring or disulfide closes, they are stretched."""
    pairs, touch = near_pairs(structure, x, springs.REACH, bonds)
    distance = np.linalg.norm(x[pairs[:, 0]] - x[pairs[:, 1]], axis=1)
    soft = 72.0 * springs.DEPTH / touch**2 * np.exp(-_DECAY * (distance / touch - 1.0))
    covalent = springs.covalent(structure)
    firm = covalent.stiffness >= springs.ANGLE
    return springs.Springs(
        np.concatenate([pairs, covalent.pairs[firm]]), np.concatenate([soft, covalent.stiffness[firm]])
    )


@dataclass(frozen=True, eq=False)
class CurvatureState:
    """A search between two products.

    Parameters
    ----------
    at : Evaluation
        The point looked at; after the last step, one down the slope from a saddle point.
    preconditioner : Preconditioner
    vectors, products : tuple of (n_v,) float
        Orthonormal, and the Hessian times each.
    direction : (n_v,) float
        Of the lowest curvature found: a unit vector.
    ritz, fall : float, kJ/mol/rad^2
        Curvature along it, and by how much the last vector lowered it.
    value : float, kJ/mol/rad^2, or None
        The lowest eigenvalue; None while it is sought.
    is_saddle, confirmed, left : bool
        Whether it is a saddle point, whether lower points were sought beside it, and whether ``at`` is one.
    """

    at: Evaluation
    preconditioner: Preconditioner
    vectors: tuple[Floats, ...] = ()
    products: tuple[Floats, ...] = ()
    direction: Floats | None = None
    ritz: float = np.inf
    fall: float = np.inf
    value: float | None = None
    is_saddle: bool = False
    confirmed: bool = False
    left: bool = False

    @property
    def stop(self) -> Stop:
        """Why the search ends."""
        return Stop.SADDLE if self.is_saddle else Stop.NO_DESCENT

    @property
    def lowest_eigenvalue(self) -> float | None:
        """Value at ``at``, if it is known."""
        known = self.value is not None and np.isfinite(self.value)
        return self.value if known and not self.left else None


@dataclass(frozen=True)
class Curvature:
    """Find the lowest eigenvalue of the Hessian at a point; from a saddle point step down to a lower one.

    A point is one if its torques meet the tolerance, and an eigenvalue is below -tolerance/rad (and
    below -``LEAST``): a direction in which a turn of less than 1 rad brings a torque above the tolerance.

    Parameters
    ----------
    tolerance : float, kJ/mol/rad
        Of the minimisation.
    floats : bool
        Whether the whole moves freely: its rigid motions, whose curvature is 0, are then left out.
    leaves : bool
        Whether to step off a saddle point.
    """

    tolerance: float
    floats: bool = False
    leaves: bool = True
    metric: Soft = Soft()
    states = (CurvatureState,)

    def init(self, problem: Problem, at: Evaluation) -> CurvatureState:
        """Begin with no vector."""
        return CurvatureState(at, Preconditioner.first(self.metric, problem.space, at))

    def step(self, problem: Problem, state: CurvatureState) -> CurvatureState | None:
        """State after one more product, the eigenvalue, or the step off; None when all is done."""
        if state.value is None:
            found = self._sought(problem, state)
            return self._measured(problem, state) if found is None else found
        if not state.is_saddle or state.confirmed:
            return None
        # An energy in single precision, or a limit of the run, may know of no way down.
        lower = stepped_off(problem, state.at, _largest_one(state.direction))
        if lower is None or not self.leaves:
            return replace(state, is_saddle=lower is not None, confirmed=True)
        return replace(state, at=lower, confirmed=True, left=True)

    def _sought(self, problem: Problem, state: CurvatureState) -> CurvatureState | None:
        """State with one more vector; None if it has enough."""
        solve, at = state.preconditioner.solve, state.at
        rigid = rigid_motions(problem.space, at) if self.floats else ()
        if len(state.vectors) < STARTS:
            # Any start will do that has a part along the lowest: the metric makes it soft.
            new = solve(np.random.default_rng(len(state.vectors)).normal(size=len(at.torque)))
        else:
            value, _, residual = _ritz(state.vectors, state.products)
            _, _, next_one = _ritz(state.vectors, state.products, 1)
            new, other = solve(residual), solve(next_one)
            gain, others = float(abs(residual @ new)), WEIGHT * float(abs(next_one @ other))
            little = SHARE * max(abs(value), LEAST)
            if (max(gain, others, state.fall) < little) or len(state.vectors) >= MOST:
                return None
            new = new if gain >= others else other
        vector = _orthonormal(new, (*rigid, *state.vectors))
        if vector is None:
            return None
        h = TURN / np.max(np.abs(vector))
        product = (at.torque - problem.evaluate(problem.move(at.q, h * vector)).torque) / h
        if not np.isfinite(product).all():
            return replace(state, value=np.nan)
        vectors, products = (*state.vectors, vector), (*state.products, product)
        value, direction, _ = _ritz(vectors, products)
        return replace(
            state,
            vectors=vectors,
            products=products,
            direction=direction,
            ritz=value,
            fall=state.ritz - value,
        )

    def _measured(self, problem: Problem, state: CurvatureState) -> CurvatureState | None:
        """State with the eigenvalue; None if there is no direction to turn in."""
        if state.direction is None:
            return None
        turn = CENTRAL * _largest_one(state.direction)
        before, after = (problem.evaluate(problem.move(state.at.q, side * turn)) for side in (-1.0, 1.0))
        value = float(turn @ (before.torque - after.torque) / (2.0 * turn @ turn))
        saddle = state.at.residual <= self.tolerance and value < -max(self.tolerance, LEAST)
        return replace(state, value=value, is_saddle=saddle)


def stepped_off(problem: Problem, at: Evaluation, direction: Floats) -> Evaluation | None:
    """Point below a saddle point, on the lower of its two sides; None if none is found.

    Parameters
    ----------
    problem : Problem
        Counts the evaluations.
    at : Evaluation
        The saddle point.
    direction : (n_v,) float
        Of negative curvature, its largest entry 1.

    Returns
    -------
    Evaluation or None
        The turn is doubled as long as the energy falls, and halved until it does.
    """

    def turned(angle: float) -> Evaluation | None:
        found = problem.evaluate(problem.move(at.q, angle * direction))
        lower = found.is_finite and found.energy < at.energy
        return found if lower and problem.allows(found.x) else None

    angle = FIRST
    while angle >= SHORTEST:
        sides = [(found, way) for way in (angle, -angle) if (found := turned(way)) is not None]
        if sides:
            best, way = min(sides, key=lambda side: side[0].energy)
            while abs(2.0 * way) <= LONGEST:
                farther = turned(2.0 * way)
                if farther is None or not farther.energy < best.energy:
                    break
                best, way = farther, 2.0 * way
            return best
        angle *= 0.5
    return None


def rigid_motions(space: Space, at: Evaluation) -> tuple[Floats, ...]:
    """Orthonormal motions (n_v,) of the whole as one rigid body; none if a root is fixed."""
    assert isinstance(space, Torsions) and isinstance(at.pose, Pose)
    chain, frames = space.chain, at.pose.frames
    tree = chain.tree
    roots = np.flatnonzero(tree.parent < 0)
    if not (tree.kind[roots] == HingeKind.FREE).all():
        return ()
    motions = np.zeros((6, chain.n_v))
    for root in roots:
        own = slice(tree.v_start[root], tree.v_start[root] + 6)
        twists = np.empty((6, 6))
        for k, unit in enumerate(np.eye(chain.n_v)[own]):
            twists[:, k] = multibody.velocities(tree, frames, unit)[root]
        wanted = np.eye(6)
        # A turn about the world's origin moves this body's origin along.
        wanted[3:, :3] = np.cross(np.eye(3), frames.origin[root]).T
        motions[:, own] = np.linalg.solve(twists, wanted).T
    orthonormal, _ = np.linalg.qr((motions / space.scale).T)
    return tuple(orthonormal.T)


def with_curvature(plan: Sequence[Stage], floats: bool) -> list[Stage]:
    """Plan of a run in torsions that looks whether its end is a minimum, and leaves a saddle point.

    Parameters
    ----------
    plan : sequence of Stage
        The last one is run again from below a saddle point.
    floats : bool
        As of :class:`Curvature`.
    """
    final = plan[-1]
    ends = (Stop.TOLERANCE, Stop.NO_DESCENT, Stop.CIRCLING)
    method = Curvature(final.tolerance, floats)
    look = replace(
        final, method=method, tolerance=-np.inf, recorded=False, patience=2 * MOST, answer=_looked,
        after=ends, name="looking for a saddle point", ready=None, fit=None, looks=True,
    )  # fmt: skip
    again = replace(final, after=(Stop.SADDLE,), ready=None, fit=None)
    return [*plan, *[look, again] * ROUNDS, replace(look, method=replace(method, leaves=False))]


def _looked(problem: Problem, ending: Ending, q: Floats) -> Floats:
    """Point that was looked at, or the lower one beside it."""
    return ending.last.state.at.q


def _ritz(vectors: Sequence[Floats], products: Sequence[Floats], k: int = 0) -> tuple[float, Floats, Floats]:
    """Lowest Ritz value, or the k-th from it if there are so many, its vector, and the residual."""
    v, hv = np.array(vectors), np.array(products)
    small = v @ hv.T
    values, weights = np.linalg.eigh(0.5 * (small + small.T))
    k = min(k, len(values) - 1)
    direction = weights[:, k] @ v
    return float(values[k]), direction, weights[:, k] @ hv - values[k] * direction


def _orthonormal(vector: Floats, to: Sequence[Floats]) -> Floats | None:
    """Part of a vector across others, of length 1; None if nothing is left of it."""
    left = vector / np.linalg.norm(vector)
    for _ in range(2):
        for each in to:
            left = left - (each @ left) * each
    size = float(np.linalg.norm(left))
    return left / size if size > 1e-8 else None


def _largest_one(direction: Floats | None) -> Floats:
    assert direction is not None
    return np.asarray(direction / np.max(np.abs(direction)))
