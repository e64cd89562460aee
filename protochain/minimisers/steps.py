"""Step rules: how far to go along a direction."""

import warnings
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from scipy.optimize import line_search

from protochain.arrays import Floats
from protochain.minimisers.problem import Evaluation, Problem

SMALLEST = 1e-8
"""rad or nm: what a shorter step gains is lost in the rounding of the energy."""


class Rule(Protocol):
    """How far to go along a direction whose largest turn, or whose natural length, is known."""

    def init(self, at: Evaluation) -> Any:
        """State at the start."""

    def step(
        self, problem: Problem, at: Evaluation, direction: Floats, state: Any
    ) -> tuple[Evaluation, Any] | None:
        """Return the next point and state, or None if no step along the direction lowers the energy."""


@dataclass(frozen=True)
class Fixed:
    """Go the same length at every step, up or down: as KCM was published.

    Parameters
    ----------
    length : float, rad
        Of a direction whose largest turn is 1, the angle of that turn.
    """

    length: float

    def init(self, at: Evaluation) -> None:
        """Nothing to remember."""

    def step(
        self, problem: Problem, at: Evaluation, direction: Floats, state: None
    ) -> tuple[Evaluation, None]:
        """Go."""
        return problem.evaluate(problem.move(at.q, self.length * direction)), None


@dataclass(frozen=True)
class Decaying:
    """Go ``length / (1 + k / half)`` at step k: too long at first to settle, then short enough.

    The lengths sum to infinity and their squares do not (Robbins, Monro, Ann. Math. Stat. 22:400, 1951).

    Parameters
    ----------
    length : float, rad
    half : float
        Steps after which it is half as long.
    """

    length: float
    half: float

    def init(self, at: Evaluation) -> int:
        """No step so far."""
        return 0

    def step(self, problem: Problem, at: Evaluation, direction: Floats, state: int) -> tuple[Evaluation, int]:
        """Go, and count."""
        length = self.length / (1.0 + state / self.half)
        return problem.evaluate(problem.move(at.q, length * direction)), state + 1


@dataclass(frozen=True)
class AcceptReject:
    """Go further after a step that lowers the energy; take back one that does not, and go less far.

    Parameters
    ----------
    length : float, rad
        At the start.
    grow, shrink : float
    """

    length: float
    grow: float = 1.2
    shrink: float = 0.5

    def init(self, at: Evaluation) -> float:
        """Begin with the first length."""
        return self.length

    def step(
        self, problem: Problem, at: Evaluation, direction: Floats, state: float
    ) -> tuple[Evaluation, float] | None:
        """Try until the energy is lower."""
        length = state
        while length * np.max(np.abs(direction)) > SMALLEST:
            found = problem.evaluate(problem.move(at.q, length * direction))
            if found.is_finite and found.energy < at.energy:
                return found, self.grow * length
            length *= self.shrink
        return None


@dataclass(frozen=True)
class Armijo:
    """Backtrack until the energy lies enough below the highest of the last few.

    Armijo, Pacific J. Math. 16:1 (1966); nonmonotone as Grippo, Lampariello, Lucidi, SIAM J. Numer. Anal.
    23:707 (1986).

    Parameters
    ----------
    length : float
        At the start; later twice what the last step was.
    window : int
        Energies looked back on: 1 is monotone.
    decrease : float
        Part of the predicted decrease that is enough.
    """

    length: float
    window: int = 1
    decrease: float = 1e-4

    def init(self, at: Evaluation) -> tuple[float, tuple[float, ...]]:
        """Begin with the first length and energy."""
        return self.length, (at.energy,)

    def step(
        self, problem: Problem, at: Evaluation, direction: Floats, state: tuple[float, tuple[float, ...]]
    ) -> tuple[Evaluation, tuple[float, tuple[float, ...]]] | None:
        """Halve until it is low enough."""
        length, seen = state
        slope = at.torque @ direction
        while length * np.max(np.abs(direction)) > SMALLEST:
            found = problem.evaluate(problem.move(at.q, length * direction))
            if found.is_finite and found.energy <= max(seen) - self.decrease * length * slope:
                return found, (2.0 * length, (*seen, found.energy)[-self.window :])
            length *= 0.5
        return None


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

    Notes
    -----
    Nocedal, Wright, *Numerical Optimization* (2006), algorithms 3.5 and 3.6, as scipy has them.
    """
    tried: dict[float, Evaluation] = {}

    def point(length: Floats) -> Evaluation:
        key = float(length[0])
        if key not in tried:
            tried[key] = problem.evaluate(problem.move(at.q, key * direction))
        return tried[key]

    def height(length: Floats) -> float:
        return point(length).energy

    def slope(length: Floats) -> Floats:
        return np.array([-point(length).torque @ direction])

    def lowest() -> float:
        return min((found.energy for found in tried.values() if found.is_finite), default=np.inf)

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
        while nearest * size > SMALLEST and not lowest() < at.energy:
            nearest *= 0.1
            point(np.array([nearest]))
        if not lowest() < at.energy:
            return None
        length = next(key for key, found in tried.items() if found.is_finite and found.energy == lowest())
    return float(length), tried[float(length)]
