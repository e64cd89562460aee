"""Whether a run ends in a minimum: the lowest eigenvalue of its Hessian, and steps off a saddle point.

Davidson's method (J. Comput. Phys. 17:87, 1975): the residual of the last estimate extends the subspace, in a
metric that ranks soft directions. Each vector costs one product with the Hessian, a difference of torques, or
of forces if all atoms move. Lengths in rad correspond to 0.1 nm for all atoms (``lever``). The search begins
with some vectors, and also follows the second lowest estimate (as in Liu's block method), as it may become
the lowest eigenvalue. The estimate is never below the eigenvalue.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from protochain.core.arrays import Floats
from protochain.minimisers.loop import Stop
from protochain.minimisers.metrics import Preconditioner, Solve
from protochain.minimisers.problem import Evaluation, Problem, Space
from protochain.minimisers.stages import Stage

TURN = 1e-4
"""rad, change of the largest freedom for one-sided differences of torques that build the subspace."""
CENTRAL = 1e-3
"""rad, change of the largest freedom for the central difference that measures an uncertain curvature. It may
be longer, as its error is of second order."""

SHARE = 0.002
"""The search ends if the last vector lowered the estimate by less than this share, and the next one would."""
STARTS, WEIGHT = 3, 0.3
"""Initial vectors of the search, and weight of the residual of the second lowest estimate.

With one vector, and the lowest estimate alone, 3 of 15 peptides end at their second eigenvalue, up to twice
the lowest. The start has hardly any component along a soft turn of two hinges that are each stiff. The
softest eigenvectors of the metric, pairs of the run, or the near terms' metric need fewer products on some
proteins. On others they also end twice too high."""

LEAST = 0.1
"""kJ/mol/nm^2. If all atoms move, smaller ones count as 0: 100 atoms gain < 0.05 kJ/mol in 0.1 nm."""
SIGN, SOFT = 1e-3, 2.0
"""kJ/mol/rad^2. In torsions: error of a measured eigenvalue near 0, and lower limit for a clear minimum.

Dense Hessians of ends near a shoulder differ by up to 5.4e-4. Minima of peptides have 1.88 or more."""

ALL_ATOMS_UP_TO = 1.0
"""kJ/mol/nm, tolerance above which ends in all atoms are not examined by default: no minima yet."""
MOST = 100
"""Products of a search. A search that needs more reports an upper bound of the eigenvalue.

Searches took 13 to 47 products in proteins of 53 to 486 atoms. With a limit of a fifth of the run, 3 of 8
ended at a positive bound of a negative eigenvalue."""

FIRST, SHORTEST, LONGEST = 0.1, 1e-3, 1.6
"""rad, of the largest freedom: first, shortest and longest turn off a saddle point."""
ROUNDS = 4  # Saddle points that a run may leave. Then it ends at one.


@dataclass(frozen=True)
class Soft:
    """Stiffness with a tiny floor, to rank soft directions."""

    refresh_every: int = 1_000_000_000  # Iterations between two computations of the matrix.

    def at(self, space: Space, at: Evaluation) -> Solve:
        """Solver for the matrix at a point."""
        return space.softness(at)


@dataclass(frozen=True, eq=False)
class CurvatureState:
    """A search between two products."""

    at: Evaluation  # Point of the search; after the last step, a point below a saddle point.
    preconditioner: Preconditioner
    vectors: tuple[Floats, ...] = ()  # vectors, products: Orthonormal vectors, and the Hessian times them.
    products: tuple[Floats, ...] = ()
    direction: Floats | None = None  # (n_v,): Unit vector of lowest curvature so far.
    residuals: tuple[Floats, ...] = ()  # H v - ritz v for it, and for the second lowest.
    # ritz, fall, doubt: Curvature along it, its decrease by the last vector, and its uncertainty, from the
    # asymmetry of the products: differences of torques are rounded.
    ritz: float = np.inf
    fall: float = np.inf
    doubt: float = 0.0
    value: float | None = None  # The lowest eigenvalue; None during the search.
    # is_saddle, confirmed, left: Whether it is a saddle point, whether a lower point was searched, and
    # whether ``at`` is this lower point.
    is_saddle: bool = False
    confirmed: bool = False
    left: bool = False

    @property
    def stop(self) -> Stop:
        """Reason for the end of the search."""
        return Stop.SADDLE if self.is_saddle else Stop.NO_DESCENT

    @property
    def is_spent(self) -> bool:
        """Whether no more products are allowed."""
        return len(self.vectors) >= MOST

    @property
    def eigenvalue_at_most(self) -> float | None:
        """Upper limit of the lowest eigenvalue, if the search ended too early to find it."""
        enough = self.value is not None and not self.is_spent
        return None if enough or self.left or not np.isfinite(self.ritz) else self.ritz

    @property
    def lowest_eigenvalue(self) -> float | None:
        """Value at ``at``, if the search reached it."""
        is_known = self.value is not None and np.isfinite(self.value) and not self.is_spent
        return self.value if is_known and not self.left else None


@dataclass(frozen=True)
class Curvature:
    """Find the lowest eigenvalue of the Hessian at a point, and step from a saddle point to a lower point.

    At a saddle point the torques meet the tolerance, and an eigenvalue is below -tolerance/lever (and below
    -``SIGN`` or -``LEAST``). In this direction, a turn of less than 1 rad causes a torque above the
    tolerance, or an RMS displacement of less than 0.1 nm such an RMS force. Shoulders in torsions count, too.
    """

    tolerance: float  # Of the minimisation.
    # Whether only fixed atoms fix it in space: rigid motions, whose curvature is 0, are excluded.
    floats: bool = False
    leaves: bool = True  # Whether to step off a saddle point.
    metric: Soft = Soft()
    states = (CurvatureState,)

    def init(self, problem: Problem, at: Evaluation) -> CurvatureState:
        """Begin without vectors."""
        return CurvatureState(at, Preconditioner.first(self.metric, problem.space, at))

    def step(self, problem: Problem, state: CurvatureState) -> CurvatureState | None:
        """State after one more product, the eigenvalue, or the step to a lower point, or None at the end."""
        if state.value is None:
            extended = self._extend_subspace(problem, state)
            return self._measure_eigenvalue(problem, state) if extended is None else extended
        if not state.is_saddle or state.confirmed:
            return None
        # With an energy in single precision, or a limit of the run, no lower point may exist.
        lower = step_off(problem, state.at, problem.space.lever * _largest_one(state.direction))
        if lower is None or not self.leaves:
            return replace(state, is_saddle=lower is not None, confirmed=True)
        return replace(state, at=lower, confirmed=True, left=True)

    def _extend_subspace(self, problem: Problem, state: CurvatureState) -> CurvatureState | None:
        """State with one more vector, or None if it has enough."""
        solve, at, n = state.preconditioner.solve, state.at, len(state.vectors)
        rigid = problem.space.motions_of_whole(at) if self.floats else ()
        if n < STARTS:
            # Any start with a component along the lowest will do: the metric makes it soft.
            new = solve(np.random.default_rng(n).normal(size=len(at.torque)))
        else:
            new, second = (solve(residual) for residual in state.residuals)
            gain = float(abs(state.residuals[0] @ new))
            second_gain = WEIGHT * float(abs(state.residuals[1] @ second))
            little = SHARE * max(abs(state.ritz), LEAST)
            if max(gain, second_gain, state.fall) < little or state.is_spent:
                return None
            new = new if gain >= second_gain else second
        vector = _orthonormal(new, (*rigid, *state.vectors))
        if vector is None:
            return None
        h = TURN * problem.space.lever / np.max(np.abs(vector))
        product = (at.torque - _torque(problem, at, h * vector)) / h
        if not np.isfinite(product).all():
            return replace(state, value=np.nan)
        return _add_vector(state, vector, product)

    def _measure_eigenvalue(self, problem: Problem, state: CurvatureState) -> CurvatureState | None:
        """State with the eigenvalue, or None without a direction."""
        if state.direction is None:
            return None
        value, is_shoulder, in_torsions = state.ritz, False, problem.space.lever == 1.0
        # If this is clearly a minimum, no further evaluations are needed.
        if value < (SOFT if in_torsions else LEAST) or state.doubt > SHARE * value:
            turn = CENTRAL * problem.space.lever * _largest_one(state.direction)
            before, after = (_torque(problem, state.at, side * turn) for side in (-1.0, 1.0))
            value = float(turn @ (before - after) / (2.0 * turn @ turn))
            is_shoulder = in_torsions and self.leaves and _is_shoulder(turn, before, state.at.torque, after)
        least = max(self.tolerance / problem.space.lever, SIGN if in_torsions else LEAST)
        saddle = state.at.residual <= self.tolerance and (value < -least or is_shoulder)
        return replace(state, value=value, is_saddle=saddle)


def _torque(problem: Problem, at: Evaluation, step: Floats) -> Floats:
    """Torque (n_v,) after a step (n_v,), along the freedoms before the step."""
    after = problem.evaluate(problem.move(at.q, step))
    return problem.space.transport_torque(after.torque, after.pose, at.pose)


def _is_shoulder(turn: Floats, *torques: Floats) -> bool:
    """Whether the torque along a soft turn (n_v,) has no zero, by a parabola through three torques."""
    before, at, after = (float(turn @ torque) for torque in torques)
    slope, bend = 0.5 * (after - before), before - 2.0 * at + after
    return abs(slope) < SOFT * float(turn @ turn) and slope**2 < 2.0 * at * bend


def step_off(problem: Problem, at: Evaluation, direction: Floats) -> Evaluation | None:
    """Point below a saddle point, on the lower side along a direction (n_v,), or None if there is none."""

    def point_at(angle: float) -> Evaluation | None:
        point = problem.evaluate(problem.move(at.q, angle * direction))
        lower = point.is_finite and point.energy < at.energy
        return point if lower and problem.allows(point.x) else None

    angle = FIRST
    while angle >= SHORTEST:
        sides = [(point, way) for way in (angle, -angle) if (point := point_at(way)) is not None]
        if sides:
            best, way = min(sides, key=lambda side: side[0].energy)
            while abs(2.0 * way) <= LONGEST:
                farther = point_at(2.0 * way)
                if farther is None or not farther.energy < best.energy:
                    break
                best, way = farther, 2.0 * way
            return best
        angle *= 0.5
    return None


def with_curvature(plan: Sequence[Stage], floats: bool) -> list[Stage]:
    """Plan of a run that checks whether its end is a minimum, and leaves a saddle point."""
    final = plan[-1]
    ends = (Stop.TOLERANCE, Stop.NO_DESCENT, Stop.CIRCLING)
    method = Curvature(final.tolerance, floats)
    # The answer is the point of the search, or the lower point.
    look = replace(
        final, method=method, tolerance=-np.inf, recorded=False, patience=2 * MOST, after=ends,
        answer=lambda problem, ending, q: ending.last.state.at.q, name="looking for a saddle point",
        ready=None, looks=True,
    )  # fmt: skip
    again = replace(final, after=(Stop.SADDLE,), ready=None)
    return [*plan, *[look, again] * ROUNDS, replace(look, method=replace(method, leaves=False))]


def _add_vector(state: CurvatureState, vector: Floats, product: Floats) -> CurvatureState:
    """State with another vector, and the two lowest Ritz pairs of all."""
    vectors, products = (*state.vectors, vector), (*state.products, product)
    v, hv = np.array(vectors), np.array(products)
    small = v @ hv.T
    values, weights = np.linalg.eigh(0.5 * (small + small.T))
    lowest = weights[:, :2].T
    directions = lowest @ v
    residuals = lowest @ hv - values[:2, None] * directions
    return replace(
        state,
        vectors=vectors,
        products=products,
        direction=directions[0],
        residuals=tuple(residuals),
        ritz=float(values[0]),
        fall=state.ritz - float(values[0]),
        doubt=0.5 * float(np.linalg.norm((small - small.T) @ lowest[0])),
    )


def _orthonormal(vector: Floats, basis: Sequence[Floats]) -> Floats | None:
    """Unit vector along the component of a vector orthogonal to others, or None if this vanishes."""
    remainder = vector / np.linalg.norm(vector)
    for _ in range(2):
        for basis_vector in basis:
            remainder = remainder - (basis_vector @ remainder) * basis_vector
    size = float(np.linalg.norm(remainder))
    return remainder / size if size > 1e-8 else None


def _largest_one(direction: Floats | None) -> Floats:
    assert direction is not None
    return np.asarray(direction / np.max(np.abs(direction)))
