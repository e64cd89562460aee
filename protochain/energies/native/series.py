"""Polynomials in place of logarithms and exponentials, which do not vectorise without a vector library.

Interpolated at Chebyshev points, with relative errors below 1e-14.
"""

from collections.abc import Callable

import numpy as np

from protochain.arrays import Floats, read_only
from protochain.energies.native.layout import tiled, variant

NEAR_RATIO = 0.5
"""Largest s / r for which the near series hold."""
FAR_RATIO = 0.24
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


def _padded(coefficients: tuple[float, ...]) -> Floats:
    return read_only(np.pad(coefficients, (0, 14 - len(coefficients))))


NEAR_INTEGRAL = _padded(_interpolated(_integral, 13, 0.0, NEAR_RATIO**2))
NEAR_SLOPE = _padded(_interpolated(_slope, 13, 0.0, NEAR_RATIO**2))
FAR_INTEGRAL = _padded(_interpolated(_integral, 7, 0.0, FAR_RATIO**2))
FAR_SLOPE = _padded(_interpolated(_slope, 7, 0.0, FAR_RATIO**2))
"""(14,) float: coefficients of g(y) and h(y), y = (s/r)^2, of the descreening integral s^3 g / (2 r^4) and
its slope -s^3 h / (2 r^5)."""
_LN2 = float(np.log(2.0))
LARGEST_EXPONENT = 40.0
EXPONENTIAL = read_only(
    [*_interpolated(np.exp, 10, -0.35, 0.35), LARGEST_EXPONENT, -1.0 / _LN2, 0.5, _LN2, 2.0**52 + 2.0**51]
)
"""(16,) float: coefficients of exp(z), then the other constants of :func:`exponential`. Adding the last one
rounds a double to a whole number, which its last bits then hold.

Kernels take coefficients from arrays: constants in the code would be loaded for every pair.
"""
Fourteen = tuple[
    float, float, float, float, float, float, float, float, float, float, float, float, float, float
]
Sixteen = tuple[
    float, float, float, float, float, float, float, float, float, float, float, float, float, float, float,
    float,
]  # fmt: skip


@tiled
def sixteen(c: Floats) -> Sixteen:
    """Read coefficients before a loop."""
    return (
        c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], c[8], c[9], c[10], c[11], c[12], c[13], c[14], c[15]
    )  # fmt: skip


@tiled
def fourteen(c: Floats) -> Fourteen:
    """Read coefficients before a loop."""
    return c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], c[8], c[9], c[10], c[11], c[12], c[13]


@tiled
def exponential(d: float, c: Sixteen) -> float:
    """exp(-d) for d >= 0; e^-40, negligible beside what it is added to, for d > 40.

    2^n exp(z), n whole: n goes into the bits of the exponent. Terms are paired (Estrin's scheme) to shorten
    the chain of dependences.
    """
    y = min(d, c[11]) * c[12]
    n = np.floor(y + c[13])
    z = (y - n) * c[14]
    z2 = z * z
    z4 = z2 * z2
    low = (c[0] + c[1] * z) + (c[2] + c[3] * z) * z2
    middle = (c[4] + c[5] * z) + (c[6] + c[7] * z) * z2
    value = low + middle * z4 + ((c[8] + c[9] * z) + c[10] * z2) * (z4 * z4)
    bits = np.float64(value).view(np.int64) + (np.float64(n + c[15]).view(np.int64) << 52)
    return float(np.int64(bits).view(np.float64))


@variant
def series(y: float, c: Fourteen, near: bool) -> float:
    """Sum of c[k] y^k, of fourteen terms if near and eight otherwise."""
    y2 = y * y
    y4 = y2 * y2
    first = (c[0] + c[1] * y) + (c[2] + c[3] * y) * y2
    second = (c[4] + c[5] * y) + (c[6] + c[7] * y) * y2
    if near:
        third = (c[8] + c[9] * y) + (c[10] + c[11] * y) * y2
        return (first + second * y4) + (third + (c[12] + c[13] * y) * y4) * (y4 * y4)
    return first + second * y4
