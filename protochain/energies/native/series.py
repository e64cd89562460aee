"""Polynomials in place of roots, logarithms and exponentials.

The functions do not vectorise without a vector library, or wait for a processor's only divider. Polynomials
interpolate at Chebyshev points, with relative errors below 3e-12, or 1e-13 for roots, exponentials and
logarithms.
"""

from collections.abc import Callable

import numpy as np

from protochain.energies.native.layout import ordered_kernel

NEAR_RATIO = 0.5  # Largest s / r for which the near series are valid.
FAR_RATIO = 0.24  # Largest s / r for which the far series are valid.


def fit_chebyshev(
    function: Callable[[np.ndarray], np.ndarray], degree: int, low: float, high: float
) -> tuple[float, ...]:
    """Coefficients of the polynomial through a function at Chebyshev points."""
    polynomial = np.polynomial.Chebyshev.interpolate(function, degree, [low, high])
    return tuple(float(c) for c in polynomial.convert(kind=np.polynomial.Polynomial).coef)


def integral_sum(y: np.ndarray) -> np.ndarray:
    """Sum of 2k/(2k+1) y^(k-1)."""
    return np.sum([2 * k / (2 * k + 1) * y ** (k - 1) for k in range(1, 200)], axis=0)


def slope_sum(y: np.ndarray) -> np.ndarray:
    """Sum of 2k (2k+2)/(2k+1) y^(k-1)."""
    return np.sum([2 * k * (2 * k + 2) / (2 * k + 1) * y ** (k - 1) for k in range(1, 200)], axis=0)


NEAR_INTEGRAL = fit_chebyshev(integral_sum, 11, 0.0, NEAR_RATIO**2)
NEAR_SLOPE = fit_chebyshev(slope_sum, 11, 0.0, NEAR_RATIO**2)
FAR_INTEGRAL = fit_chebyshev(integral_sum, 6, 0.0, FAR_RATIO**2)
FAR_SLOPE = fit_chebyshev(slope_sum, 6, 0.0, FAR_RATIO**2)
"""Coefficients of g(y) and h(y), y = (s/r)^2, of the descreening integral s^3 g / (2 r^4) and its slope
-s^3 h / (2 r^5)."""
_POWER = fit_chebyshev(np.exp2, 9, -0.5, 0.5)
_ROOT = fit_chebyshev(lambda e: (1.0 - e) ** -0.5, 3, -0.0705, 0.0675)
_LOG = fit_chebyshev(
    lambda w: np.sum([2.0 / (2 * k + 1) * w**k for k in range(60)], axis=0), 6, 0.0, (3.0 - 8.0**0.5) ** 2
)
_SMALLEST_POWER = -60.0
_ROUNDING = 2.0**52 + 2.0**51
"""Addition of this number rounds a double to a whole number, which is then in its last bits."""
_HALVED = np.uint64(0x5FE6EB50C7B537A9)
"""This number minus half the bits of a double gives the bits of its inverse root within 3.5 %."""
_ONE, _MANTISSA = np.uint64(1), np.uint64(52)
_BIAS = np.uint64(1023)
_FROM_ROOT_HALF = np.uint64(0x3FF0000000000000 - 0x3FE6A09E667F3BCD)
"""Difference from the bits of the root of 1/2 to the bits of 1."""
_ROUNDING_BITS = np.uint64(0x4338000000000000)
_LN2 = float(np.log(2.0))

_Coefficients = tuple[float, ...]


# Plain Horner: fewest operations. With paired terms, LLVM's superword-level vectoriser transforms a function
# before the loop vectoriser can process it in its loop.
@ordered_kernel
def _horner_4(c: _Coefficients, x: float) -> float:
    return c[0] + x * (c[1] + x * (c[2] + x * c[3]))


@ordered_kernel
def _horner_7(c: _Coefficients, x: float) -> float:
    return c[0] + x * (c[1] + x * (c[2] + x * _horner_4(c[3:], x)))


@ordered_kernel
def _horner_10(c: _Coefficients, x: float) -> float:
    return c[0] + x * (c[1] + x * (c[2] + x * _horner_7(c[3:], x)))


@ordered_kernel
def _horner_12(c: _Coefficients, x: float) -> float:
    return c[0] + x * (c[1] + x * _horner_10(c[2:], x))


@ordered_kernel
def integral_series(y: float, near: bool) -> float:
    """g(y), of twelve terms if near and seven otherwise."""
    if near:
        return _horner_12(NEAR_INTEGRAL, y)
    return _horner_7(FAR_INTEGRAL, y)


@ordered_kernel
def slope_series(y: float, near: bool) -> float:
    """h(y), of twelve terms if near and seven otherwise."""
    if near:
        return _horner_12(NEAR_SLOPE, y)
    return _horner_7(FAR_SLOPE, y)


@ordered_kernel
def power_of_two(y: float) -> float:
    """2^y for y <= 0, and 2^-60, negligible in its sum, for y < -60."""
    # y = n + z, n whole: n is added to the bits of the exponent.
    y = max(y, _SMALLEST_POWER)
    rounded = y + _ROUNDING
    value = _horner_10(_POWER, y - (rounded - _ROUNDING))
    bits = np.float64(value).view(np.uint64) + (np.float64(rounded).view(np.uint64) << _MANTISSA)
    return float(np.uint64(bits).view(np.float64))


@ordered_kernel
def inverse_root(x: float) -> float:
    """1 / sqrt(x), finite for x = 0, three times as fast as the divider of a processor."""
    # From a guess y by the bits of x, 1 / sqrt(x) = y (1 - e)^(-1/2), e = 1 - x y^2, as a polynomial, twice.
    y = np.uint64(_HALVED - (np.float64(x).view(np.uint64) >> _ONE)).view(np.float64)
    y *= _horner_4(_ROOT, 1.0 - x * y * y)
    e = 1.0 - x * y * y
    return float(y + y * e * (0.5 + 0.375 * e))


@ordered_kernel
def logarithm(x: float) -> float:
    """log(x) of a positive, normal x = 2^n m, m from 0.71 to 1.41: n log(2) + 2 atanh((m - 1) / (m + 1))."""
    bits = np.float64(x).view(np.uint64)
    exponent = np.uint64((bits + _FROM_ROOT_HALF) >> _MANTISSA)
    m = np.uint64(bits - ((exponent - _BIAS) << _MANTISSA)).view(np.float64)
    n = np.uint64(_ROUNDING_BITS + exponent - _BIAS).view(np.float64) - _ROUNDING
    t = (m - 1.0) / (m + 1.0)
    return float(n * _LN2 + t * _horner_7(_LOG, t * t))
