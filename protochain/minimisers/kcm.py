"""The kineto-static compliance method: hinges turn along their torques, in some norm or metric."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from protochain.core.arrays import Floats
from protochain.core.settings import document_fields
from protochain.minimisers.descent import Direction
from protochain.minimisers.metrics import Euclidean, Metric, Solve
from protochain.minimisers.problem import Evaluation, Problem

_TURN = 1e-5  # rad, of the largest freedom: step of the differences of torques.


def by_largest(direction: Floats) -> Floats:
    """Scale to a largest turn of 1."""
    return np.asarray(direction / np.max(np.abs(direction)))


def by_length(direction: Floats) -> Floats:
    """Scale to a Euclidean norm of 1."""
    return np.asarray(direction / np.linalg.norm(direction))


def by_sign(direction: Floats) -> Floats:
    """Sign of each torque: every hinge turns by the same angle."""
    return np.sign(direction)


@document_fields
@dataclass(frozen=True)
class KCM(Direction):
    """Turn every hinge in proportion to its torque, with a set largest turn, or a set norm of all turns.

    theta_{k+1} = theta_k + h f(tau_k), with f(tau) = tau / max|tau|. It has no masses, no velocities and no
    line search. The step rule sets h. With a metric P the direction is f(P^-1 tau). With P = M it is
    overdamped motion of the chain. theory.md lists the sources, and papers that could not be read.
    """

    metric: Metric = field(default_factory=Euclidean)  # Metric P.
    norm: Callable[[Floats], Floats] = by_largest  # Norm f.

    def propose(
        self, problem: Problem, at: Evaluation, solve: Solve, memory: None
    ) -> Iterator[tuple[Floats, None]]:
        """Yield the torques, in the metric and the norm."""
        yield self.norm(solve(at.torque)), memory


@document_fields
@dataclass(frozen=True)
class Proportional(Direction):
    """Turn every hinge by its torque times one constant compliance: theta_{k+1} = theta_k + c tau_k.

    In a harmonic well this converges if c is below 2/kappa, with kappa the largest eigenvalue of the
    Hessian. c is set at the start and stays constant, so that it is too large if stiffer contacts form later.
    """

    # Share of 2/kappa. In extended Met-enkephalin kappa is 143 kJ/mol/rad^2, in the minimum 376. There a
    # share of 0.25 converges, and 0.5 does not.
    safety: float = 0.25
    n_products: int = 8  # Products with the Hessian for kappa, each two evaluations.

    def propose(
        self, problem: Problem, at: Evaluation, solve: Solve, memory: tuple[float, ...]
    ) -> Iterator[tuple[Floats, tuple[float, ...]]]:
        """Yield the turns, with the compliance in the memory."""
        kappa = memory[0] if memory else largest_eigenvalue(problem, at, self.n_products)
        yield (2.0 * self.safety / kappa) * at.torque, (kappa,)


def largest_eigenvalue(problem: Problem, at: Evaluation, n_products: int) -> float:
    """Lower bound of the largest absolute eigenvalue of the Hessian at a point."""
    # -> kJ/mol/rad^2: Largest size of a Ritz value. Products are central differences of torques.
    vectors: list[Floats] = []
    products: list[Floats] = []
    new = at.torque
    for _ in range(min(n_products, len(at.torque))):
        size = float(np.linalg.norm(new))
        if not np.isfinite(size) or size == 0.0:
            break
        vectors.append(new / size)
        turn = _TURN / np.max(np.abs(vectors[-1])) * vectors[-1]
        before, after = (problem.evaluate(problem.move(at.q, side * turn)) for side in (-1.0, 1.0))
        products.append((before.torque - after.torque) / (2.0 * np.linalg.norm(turn)))
        new, scale = products[-1], np.linalg.norm(products[-1])
        for _ in range(2):
            for vector in vectors:
                new = new - (vector @ new) * vector
        if np.linalg.norm(new) < 1e-6 * scale:
            break
    if not vectors:
        return 1.0
    small = np.array(vectors) @ np.array(products).T
    return float(np.max(np.abs(np.linalg.eigvalsh(0.5 * (small + small.T)))))
