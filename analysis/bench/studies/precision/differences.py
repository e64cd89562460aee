"""Derivatives by differences, extrapolated to a step of zero."""

from collections.abc import Callable
from typing import Any

import numpy as np


def extrapolated(f: Callable[[Any], Any], h: Any, levels: int = 5) -> tuple[np.ndarray, float]:
    """Derivative of a smooth function at zero, and an estimate of its error."""
    best, least = np.asarray(np.nan), np.inf
    above: list[np.ndarray] = []
    for i in range(levels):
        step = h / 2**i
        row = [(np.asarray(f(step)) - np.asarray(f(-step))) / (2 * step)]
        for k, before in enumerate(above, 1):
            row.append(row[-1] + (row[-1] - before) / (4**k - 1))
        if above:
            change = float(max(np.max(np.abs(row[-1] - each)) for each in (above[-1], row[-2])))
            if change < least:
                best, least = row[-1], change
        above = row
    return best, least
