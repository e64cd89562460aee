"""Step rules, which set the length of a step along a direction."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from protochain.core.arrays import Floats
from protochain.core.settings import document_fields
from protochain.minimisers.problem import Evaluation, Problem

SMALLEST = 1e-8  # rad or nm. The gain of a shorter step would disappear in the rounding of the energy.

_DECREASE, _FLATTER = 1e-4, 0.9
"""Constants of the strong Wolfe conditions for quasi-Newton steps, as in Nocedal and Wright."""
_MOST = 10  # Largest number of doublings, and then of points between two.

_Along = Callable[[float], float]
_Point = tuple[float, ...]


class Rule(Protocol):
    """Step length along a direction scaled to a largest turn of 1, or to its natural length."""

    def init(self, at: Evaluation) -> Any:
        """State at the start."""

    def step(
        self, problem: Problem, at: Evaluation, direction: Floats, state: Any
    ) -> tuple[float, Evaluation, Any] | None:
        """Step length, next point and state, or None if no step along the direction lowers the energy."""


@document_fields
@dataclass(frozen=True)
class Fixed:
    """Constant step length, whether the energy falls or rises."""

    length: float  # rad: Angle of the largest turn, for a direction whose largest entry is 1.

    def init(self, at: Evaluation) -> None:
        """No state."""

    def step(
        self, problem: Problem, at: Evaluation, direction: Floats, state: None
    ) -> tuple[float, Evaluation, None]:
        """Make the step."""
        return self.length, problem.evaluate(problem.move(at.q, self.length * direction)), None


@document_fields
@dataclass(frozen=True)
class Decaying:
    """Step length ``length / (1 + k / half)`` at step k.

    The lengths sum to infinity and their squares do not (Robbins, Monro, Ann. Math. Stat. 22:400, 1951).
    """

    length: float  # rad: Initial step length.
    half: float  # Number of steps after which the length has halved.

    def init(self, at: Evaluation) -> int:
        """Number of steps so far."""
        return 0

    def step(
        self, problem: Problem, at: Evaluation, direction: Floats, state: int
    ) -> tuple[float, Evaluation, int]:
        """Make the step, and count it."""
        length = self.length / (1.0 + state / self.half)
        return length, problem.evaluate(problem.move(at.q, length * direction)), state + 1


@document_fields
@dataclass(frozen=True)
class AcceptReject:
    """Lengthen the step if the energy falls, otherwise reject and shorten it."""

    length: float  # rad: Initial step length.
    grow: float = 1.2  # Factor on the length after an accepted step.
    shrink: float = 0.5  # Factor on the length after a rejected step.

    def init(self, at: Evaluation) -> float:
        """Initial step length."""
        return self.length

    def step(
        self, problem: Problem, at: Evaluation, direction: Floats, state: float
    ) -> tuple[float, Evaluation, float] | None:
        """Shrink the step until the energy falls."""
        length = state
        while length * np.max(np.abs(direction)) > SMALLEST:
            after = problem.evaluate(problem.move(at.q, length * direction))
            if after.is_finite and after.energy < at.energy:
                return length, after, self.grow * length
            length *= self.shrink
        return None


@document_fields
@dataclass(frozen=True)
class Armijo:
    """Backtrack until the energy is sufficiently below the highest of the last few (Armijo).

    Armijo, Pacific J. Math. 16:1 (1966), in the nonmonotone form of Grippo, Lampariello, Lucidi, SIAM J.
    Numer. Anal. 23:707 (1986).
    """

    length: float  # Initial step length. Each later search begins at twice the last length.
    window: int = 1  # Number of past energies for comparison. 1 is monotone.
    decrease: float = 1e-4  # Sufficient share of the decrease predicted by the slope.

    def init(self, at: Evaluation) -> tuple[float, tuple[float, ...]]:
        """Initial step length and energy."""
        return self.length, (at.energy,)

    def step(
        self, problem: Problem, at: Evaluation, direction: Floats, state: tuple[float, tuple[float, ...]]
    ) -> tuple[float, Evaluation, tuple[float, tuple[float, ...]]] | None:
        """Halve the step until the decrease suffices."""
        length, seen = state
        slope = at.torque @ direction
        while length * np.max(np.abs(direction)) > SMALLEST:
            after = problem.evaluate(problem.move(at.q, length * direction))
            if after.is_finite and after.energy <= max(seen) - self.decrease * length * slope:
                return length, after, (2.0 * length, (*seen, after.energy)[-self.window :])
            length *= 0.5
        return None


@dataclass(frozen=True)
class StrongWolfe:
    """Search for a step length that meets the strong Wolfe conditions.

    Nocedal, Wright, *Numerical Optimization* (2006), algorithms 3.5 and 3.6, as in scipy (a slow import).
    """

    def init(self, at: Evaluation) -> None:
        """No state."""

    def step(
        self, problem: Problem, at: Evaluation, direction: Floats, state: None
    ) -> tuple[float, Evaluation, None] | None:
        """Search from a step of length 1. If the search fails, return its lowest point."""
        falls = float(at.torque @ direction)
        first = problem.evaluate(problem.move(at.q, direction))
        if (
            first.is_finite
            and first.energy <= at.energy - _DECREASE * falls
            and abs(first.torque @ direction) <= _FLATTER * falls
        ):
            return 1.0, first, None
        tried = {1.0: first}

        def point(length: float) -> Evaluation:
            if length not in tried:
                tried[length] = problem.evaluate(problem.move(at.q, length * direction))
            return tried[length]

        def height(length: float) -> float:
            # NaN would be neither higher nor lower than the start, and pass for a fall.
            evaluation = point(length)
            return evaluation.energy if evaluation.is_finite else np.inf

        def slope(length: float) -> float:
            return -float(point(length).torque @ direction)

        length = _search_length(height, slope, at.energy, falls)
        if length is None:
            # Against a stiff contact, or on a long lever, the interpolation may fail at too long a step.
            size, nearest, length = np.max(np.abs(direction)), min(tried), min(tried, key=height)
            while nearest * size > SMALLEST and not height(length) < at.energy:
                nearest *= 0.1
                length = min((length, nearest), key=height)
            if not height(length) < at.energy:
                return None
        return length, tried[length], None


def _search_length(height: _Along, slope: _Along, start: float, falls: float) -> float | None:
    """Length that meets the conditions (algorithm 3.5), or after ten doublings, or None."""
    before, energy_before, slope_before = 0.0, start, -falls
    length, energy = 1.0, height(1.0)
    for k in range(_MOST):
        if energy > start - _DECREASE * length * falls or (k and energy >= energy_before):
            return _zoom(height, slope, start, falls, (before, energy_before, slope_before), (length, energy))
        slope_now = slope(length)
        if abs(slope_now) <= _FLATTER * falls:
            return length
        if slope_now >= 0.0:
            return _zoom(height, slope, start, falls, (length, energy, slope_now), (before, energy_before))
        before, energy_before, slope_before = length, energy, slope_now
        length *= 2.0
        energy = height(length)
    return length


def _zoom(
    height: _Along, slope: _Along, start: float, falls: float, low: _Point, high: _Point
) -> float | None:
    """Length between two (algorithm 3.6): low with energy and slope, high with energy."""
    previous: _Point = ()
    for _ in range(_MOST + 1):
        wide = high[0] - low[0]
        left, right = sorted((low[0], high[0]))
        cubic = _cubic(*low, *high, *previous[:2]) if previous else np.nan
        for length, share in ((cubic, 0.2), (_parabola(*low, *high), 0.1)):
            if left + share * wide <= length <= right - share * wide:
                break
        else:
            length = low[0] + 0.5 * wide
        energy = height(length)
        if energy > start - _DECREASE * length * falls or energy >= low[1]:
            previous, high = high, (length, energy)
            continue
        slope_now = slope(length)
        if abs(slope_now) <= _FLATTER * falls:
            return length
        previous, high = (high, low[:2]) if slope_now * wide >= 0.0 else (low, high)
        low = (length, energy, slope_now)
    return None


def _cubic(a: float, fa: float, slope: float, b: float, fb: float, c: float, fc: float) -> float:
    """Minimum of the cubic through three points with a slope at the first, or NaN."""
    b, c = b - a, c - a
    with np.errstate(all="ignore"):
        right = np.array([fb - fa - slope * b, fc - fa - slope * c])
        c3 = np.dot([[c**2, -(b**2)], [-(c**3), b**3]], right) / np.float64((b * c) ** 2 * (b - c))
        return float(a + (-c3[1] + np.sqrt(c3[1] * c3[1] - 3 * c3[0] * slope)) / (3 * c3[0]))


def _parabola(a: float, fa: float, slope: float, b: float, fb: float) -> float:
    """Minimum of the parabola through two points with a slope at the first. Not finite without one."""
    b -= a
    with np.errstate(all="ignore"):
        return float(a - slope / (2.0 * ((fb - fa - slope * b) / np.float64(b * b))))
