"""Errors by blocks, and the test of two temperatures, on series whose answers are known."""

import numpy as np
import pytest

from protochain.core.units import MOLAR_GAS
from protochain.searching.statistics import BLOCKS, blocks_of, drop_warm_up, mean_and_error, slope

LOW, HIGH = (1.0 / (MOLAR_GAS * each) for each in (300.0, 360.0))


def oscillators(beta, n, random, k=12):
    """Energies of k classical oscillators: gamma-distributed."""
    return random.gamma(k, 1.0 / beta, n)


def test_the_slope_of_canonical_histograms_is_the_difference_of_the_inverse_temperatures():
    random = np.random.default_rng(0)
    found = [slope(oscillators(LOW, 2000, random), oscillators(HIGH, 2500, random)) for _ in range(40)]
    error = np.std(found, ddof=1) / np.sqrt(len(found))
    assert abs(np.mean(found) - (LOW - HIGH)) < 2.5 * error
    assert error < 0.02 * (LOW - HIGH)


def test_samples_of_another_temperature_are_found_out():
    """As if the upper ones were of 375 K: the slope is a quarter too steep."""
    random = np.random.default_rng(1)
    wrong = 1.0 / (MOLAR_GAS * 375.0)
    assert slope(oscillators(LOW, 50_000, random), oscillators(wrong, 50_000, random)) == pytest.approx(
        LOW - wrong, rel=0.05
    )
    assert (LOW - wrong) / (LOW - HIGH) > 1.15


def test_histograms_without_overlap_or_width_have_no_slope():
    assert np.isnan(slope(np.arange(10.0), np.arange(100.0, 110.0)))
    assert np.isnan(slope(np.ones(5), np.ones(5)))


def test_errors_of_series_with_a_memory_are_those_of_their_spread():
    random = np.random.default_rng(2)

    def series(n=4000, memory=0.9):
        noise, x = random.standard_normal(n), np.zeros(n)
        for k in range(1, n):
            x[k] = memory * x[k - 1] + noise[k]
        return x

    told = [mean_and_error([series(), series()]) for _ in range(30)]
    spread = np.std([mean for mean, _ in told], ddof=1)
    assert np.mean([error for _, error in told]) == pytest.approx(spread, rel=0.3)
    # Without blocks it would be a quarter of that.
    naive = np.std(series()) / np.sqrt(2 * 3600)
    assert naive < 0.4 * spread


def test_parts_are_the_series_but_for_its_beginning():
    series = np.arange(47.0)
    parts = blocks_of(series)
    assert parts.shape == (BLOCKS, 4) and parts.ravel().tolist() == series[7:].tolist()
    assert blocks_of(series[:3]).tolist() == [[0.0], [1.0], [2.0]]
    assert drop_warm_up(series)[0] == 4.0
