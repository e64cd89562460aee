"""Statistics of samples at several temperatures: means with errors, and a test for canonical samples."""

import numpy as np
from scipy.special import expit

from protochain.core.arrays import Floats

WARM_UP = 0.1
"""Share of the samples of each walk that is discarded, because all walks begin at one minimum."""
BLOCKS = 10
"""Blocks of each walk. The relative error of an error from n blocks is 1 / sqrt(2 n)."""


def blocks_of(series: Floats) -> Floats:
    """Equal blocks (b, k, ...) of a series (n, ...), without the remainder at its start."""
    n = max(min(BLOCKS, len(series)), 1)
    return series[len(series) % n :].reshape(n, -1, *series.shape[1:])


def drop_warm_up(walk: Floats) -> Floats:
    """Return a walk (k, ...) without its warm-up."""
    return walk[int(WARM_UP * len(walk)) :]


def mean_and_error(walks: list[Floats]) -> tuple[Floats, Floats]:
    """Mean of walks (k, ...) and its standard error, from blocks of all of them."""
    # The error is correct if blocks are longer than the correlation time, and too small for short walks.
    parts = np.concatenate([blocks_of(drop_warm_up(walk)).mean(axis=1) for walk in walks])
    error = np.std(parts, axis=0, ddof=1) / np.sqrt(len(parts)) if len(parts) > 1 else np.nan * parts[0]
    return np.mean(parts, axis=0), np.asarray(error)


def slope(lower: Floats, upper: Floats) -> float:
    """Slope of ln P'/P over the energy, from samples (k,) at a lower and (k',) at an upper temperature."""
    # lower, upper (k,) kJ/mol -> mol/kJ: NaN if the energies do not overlap, or are all the same.
    # The slope of canonical samples is 1/kT - 1/kT' (Shirts, J. Chem. Theory Comput. 9:909, 2013) for any
    # density of states. This is the maximum-likelihood slope of a logistic regression.
    energy = np.concatenate([lower, upper])
    energy = energy - energy.mean()
    above = np.concatenate([np.zeros(len(lower)), np.ones(len(upper))])
    width = float(energy.std())
    if width == 0.0 or max(lower) < min(upper) or max(upper) < min(lower):
        return np.nan
    scaled, parameters = energy / width, np.zeros(2)
    design = np.stack([np.ones_like(scaled), scaled], axis=1)
    for _ in range(50):
        share = expit(design @ parameters)
        information = design.T @ (design * (share * (1.0 - share))[:, None])
        if np.linalg.cond(information) > 1e12:
            return np.nan
        change = np.linalg.solve(information, design.T @ (above - share))
        parameters = parameters + change
        if np.max(np.abs(change)) < 1e-10:
            break
    return float(parameters[1] / width)
