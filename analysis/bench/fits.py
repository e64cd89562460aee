"""How errors and costs go with a step or a size."""

from collections.abc import Iterable

import numpy as np

from protochain.core.arrays import Floats


def exponent(x: Floats | Iterable[float], y: Floats | Iterable[float]) -> float:
    """Fit the exponent p of y ~ x^p, by least squares of the logarithms: x, y (k,)."""
    points = np.column_stack([np.asarray(list(x), float), np.asarray(list(y), float)])
    points = np.log(points[np.all(np.isfinite(points) & (points > 0.0), axis=1)])
    if len(np.unique(points[:, 0])) < 2:
        return float("nan")
    return float(np.polyfit(points[:, 0], points[:, 1], 1)[0])


def extrapolated(coarse: Floats, fine: Floats) -> Floats:
    """Limit of values whose error falls as 1/n^2, from two of them, the second of twice as many cells."""
    return (4.0 * fine - coarse) / 3.0


def order(coarse: Floats | float, middle: Floats | float, fine: Floats | float) -> float:
    """Order of the error of three values, each of twice as many cells as the one before."""
    first, second = (
        float(np.linalg.norm(x) if np.ndim(x) else np.abs(x)) for x in (middle - coarse, fine - middle)
    )
    return float(np.log2(first / second))
