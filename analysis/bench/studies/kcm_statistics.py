"""Exact tests of the study of KCM against dynamics: sign flips over proteins, Holm's correction, power.

The null hypothesis is that a protein's effect is as likely as its negative. The test statistic is the sum of
the effects, and its distribution under all 2^n choices of signs is exact (Fisher, The Design of Experiments,
1935, section 21). Holm, Scand. J. Statist. 6:65, 1979, corrects for the number of tests of a table.
"""

from collections.abc import Sequence

import numpy as np

from protochain.core.arrays import Floats

LEVEL = 0.05
"""Adjusted p up to which an effect is concluded."""
POWER = 0.8
"""Chance of a conclusion for which the number of proteins is computed."""
MOST = 1000
"""Proteins up to which that number is sought."""
SAMPLES, BATCH = 1000, 100
"""Sets of proteins that are drawn for a power: standard error 1.3 per cent; and how many at once."""
DENOMINATOR = 60
"""Effects are shares of few starts: multiples of 1/d for a d up to this."""
_SAME = 1e-9
"""Relative to the largest sum: sums that differ less are equal but for round-off."""


def sign_flip(values: Sequence[float] | Floats) -> float:
    """Two-sided exact p of a sign-flip test that the effects (n,) are symmetric about 0."""
    sizes: Floats = np.abs(np.asarray(values, dtype=float))
    sizes = sizes[sizes > 0.0]
    if not len(sizes):
        return 1.0
    limit = abs(float(np.sum(values))) - _SAME * float(sizes.sum())
    # Sums of the two halves are joined by their cumulative weights: 2^(n/2) sums instead of 2^n.
    left, right = _sums(sizes[::2]), _sums(sizes[1::2])
    above = np.r_[np.cumsum(right[1][::-1])[::-1], 0.0]
    at_least = above[np.searchsorted(right[0], limit - left[0])]
    # Signs are symmetric, so that both tails weigh the same; at a limit of 0 or less all sums count.
    return 1.0 if limit <= 0.0 else min(1.0, 2.0 * float(left[1] @ at_least))


def _sums(sizes: Floats) -> tuple[Floats, Floats]:
    """Sums of sizes (n,) under all signs in increasing order, (m,), and their probabilities (m,)."""
    sums: Floats = np.zeros(1)
    weights: Floats = np.ones(1)
    scale = max(float(sizes.sum()), 1e-300) if len(sizes) else 1.0
    for size in sizes:
        both = np.r_[sums - size, sums + size]
        # Equal sums are merged: shares have few different ones.
        _, first, merged = np.unique(np.round(both / scale, 12), return_index=True, return_inverse=True)
        sums = both[first]
        weights = np.asarray(np.bincount(merged, np.r_[weights, weights] / 2.0), dtype=float)
    return sums, weights


def holm(p: Sequence[float] | Floats) -> Floats:
    """Adjusted p (n,) of the tests of one table, by Holm's step-down method; NaN is no test."""
    p = np.asarray(p, dtype=float)
    tests = np.flatnonzero(np.isfinite(p))
    order = tests[np.argsort(p[tests], kind="stable")]
    adjusted = np.full(len(p), np.nan)
    adjusted[order] = np.minimum(1.0, np.maximum.accumulate(p[order] * np.arange(len(order), 0, -1)))
    return adjusted


def power(values: Sequence[float] | Floats, n: int, level: float, seed: int = 0) -> float:
    """Chance that n proteins, drawn from these effects, give a p of at most the level, and the mean's sign.

    The p of each sample is that of ``sign_flip``, from the characteristic function of its sum.
    """
    units = _in_units(values)
    different, counts = np.unique(units, return_counts=True)
    random = np.random.default_rng(seed)
    sizes = np.abs(different)
    n_sums = 1 << int(2 * n * max(int(sizes.max()), 1) + 1).bit_length()
    waves = np.cos(2.0 * np.pi * np.outer(sizes, np.arange(n_sums // 2 + 1)) / n_sums)
    reached = 0
    for _ in range(0, SAMPLES, BATCH):
        drawn = random.multinomial(n, counts / counts.sum(), size=BATCH)
        totals = drawn @ different
        transform = np.prod(waves[None] ** drawn[:, :, None], axis=1)
        tail = np.fft.irfft(transform, n_sums)[:, : n_sums // 2][:, ::-1].cumsum(axis=1)[:, ::-1]
        p = np.where(totals == 0, 1.0, 2.0 * tail[np.arange(BATCH), np.abs(totals)])
        reached += int(((p <= level * (1.0 + _SAME)) & (np.sign(totals) == np.sign(units.sum()))).sum())
    return reached / SAMPLES


def proteins_needed(values: Sequence[float] | Floats, level: float) -> float:
    """Least number of proteins like these for a power of ``POWER``.

    NaN if the mean is 0, infinite beyond ``MOST``.
    """
    if abs(float(np.sum(values))) < _SAME:
        return np.nan
    n, high = 1, 2
    while power(values, high, level) < POWER:
        n, high = high, 2 * high
        if n >= MOST:
            return np.inf
    while high - n > 1:
        middle = (n + high) // 2
        n, high = (n, middle) if power(values, middle, level) >= POWER else (middle, high)
    return float(high)


def _in_units(values: Sequence[float] | Floats) -> np.ndarray:
    """Effects (n,) as integers, in units of their common fraction."""
    values = np.asarray(values, dtype=float)
    for denominator in range(1, DENOMINATOR + 1):
        units = values * denominator
        if np.abs(units - np.round(units)).max() < 1e-6:
            return np.round(units).astype(np.int64)
    raise ValueError(f"effects {values} are not multiples of 1/{DENOMINATOR} or larger fractions")
