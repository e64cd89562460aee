"""Polynomials in place of logarithms and exponentials: without a vector library those are one call each.

Interpolated at Chebyshev's points, from which they differ by less than 1e-14 of their value.
"""

from collections.abc import Callable

import numpy as np

from protochain.energies.native.layout import tiled

NEAR_RATIO = 0.5
"""Largest s / r for which the near series hold."""
FAR_RATIO = 0.16
"""Largest s / r for which the far series hold."""


def _interpolated(
    function: Callable[[np.ndarray], np.ndarray], degree: int, low: float, high: float
) -> tuple[float, ...]:
    found = np.polynomial.Chebyshev.interpolate(function, degree, [low, high])
    return tuple(float(c) for c in found.convert(kind=np.polynomial.Polynomial).coef)


def _integral(y: np.ndarray) -> np.ndarray:
    """Sum of 2k/(2k+1) y^(k-1)."""
    return np.sum([2 * k / (2 * k + 1) * y ** (k - 1) for k in range(1, 200)], axis=0)


def _slope(y: np.ndarray) -> np.ndarray:
    """Sum of 2k (2k+2)/(2k+1) y^(k-1)."""
    return np.sum([2 * k * (2 * k + 2) / (2 * k + 1) * y ** (k - 1) for k in range(1, 200)], axis=0)


_NEAR_INTEGRAL = _interpolated(_integral, 13, 0.0, NEAR_RATIO**2)
_NEAR_SLOPE = _interpolated(_slope, 13, 0.0, NEAR_RATIO**2)
_FAR_INTEGRAL = _interpolated(_integral, 6, 0.0, FAR_RATIO**2)
_FAR_SLOPE = _interpolated(_slope, 6, 0.0, FAR_RATIO**2)
_LN2 = float(np.log(2.0))
_LARGEST_EXPONENT = 40.0
_EXPONENTIAL = _interpolated(np.exp, 10, -0.35, 0.35)
_WHOLE = 2.0**52 + 2.0**51
"""A number beside which a double keeps whole numbers only, in its last bits."""


@tiled
def exponential(d: float) -> float:
    """exp(-d) for d >= 0; e^-40, which is nothing to what it is added to, from there on.

    2^n exp(z), n whole: n goes into the exponent's bits. Terms are paired (Estrin), not nested, for a short
    chain of dependences.
    """
    y = -min(d, _LARGEST_EXPONENT) * (1.0 / _LN2)
    n = np.floor(y + 0.5)
    z = (y - n) * _LN2
    c, z2 = _EXPONENTIAL, z * z
    z4 = z2 * z2
    low = (c[0] + c[1] * z) + (c[2] + c[3] * z) * z2
    middle = (c[4] + c[5] * z) + (c[6] + c[7] * z) * z2
    value = low + middle * z4 + ((c[8] + c[9] * z) + c[10] * z2) * (z4 * z4)
    bits = np.float64(value).view(np.int64) + (np.float64(n + _WHOLE).view(np.int64) << 52)
    return float(np.int64(bits).view(np.float64))


@tiled
def _thirteenth(c: tuple[float, ...], y: float) -> float:
    y2 = y * y
    y4 = y2 * y2
    first = (c[0] + c[1] * y) + (c[2] + c[3] * y) * y2
    second = (c[4] + c[5] * y) + (c[6] + c[7] * y) * y2
    third = (c[8] + c[9] * y) + (c[10] + c[11] * y) * y2
    return (first + second * y4) + (third + (c[12] + c[13] * y) * y4) * (y4 * y4)


@tiled
def _sixth(c: tuple[float, ...], y: float) -> float:
    return c[0] + y * (c[1] + y * (c[2] + y * (c[3] + y * (c[4] + y * (c[5] + y * c[6])))))


@tiled
def near_integral(y: float) -> float:
    """g(y), y = (s/r)^2 up to NEAR_RATIO^2, of the descreening integral s^3 g(y) / (2 r^4)."""
    return _thirteenth(_NEAR_INTEGRAL, y)


@tiled
def near_slope(y: float) -> float:
    """g'(y) of its slope -s^3 g'(y) / (2 r^5)."""
    return _thirteenth(_NEAR_SLOPE, y)


@tiled
def far_integral(y: float) -> float:
    """As :func:`near_integral`, up to FAR_RATIO^2."""
    return _sixth(_FAR_INTEGRAL, y)


@tiled
def far_slope(y: float) -> float:
    """As :func:`near_slope`, up to FAR_RATIO^2."""
    return _sixth(_FAR_SLOPE, y)
