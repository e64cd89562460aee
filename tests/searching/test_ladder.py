"""Temperatures: lengths between them, and how they are placed."""

import numpy as np
import pytest
from scipy.special import erfc

from protochain.core.units import MOLAR_GAS
from protochain.searching.tempering import (
    TARGET,
    Replicas,
    Tempering,
    equally_spaced,
    exchange,
    length_of_acceptance,
    update_headings,
)


def test_exchanges_of_normal_energies_are_accepted_as_the_length_says():
    """Energies of one width whose means are as far apart as the width demands of canonical ensembles."""
    random = np.random.default_rng(0)
    beta, width = np.array([0.4, 0.3]), 6.0
    means = -(width**2) * beta
    energy = means + width * random.standard_normal((200_000, 2))
    odds = np.exp(np.minimum(0.0, (beta[0] - beta[1]) * (energy[:, 0] - energy[:, 1])))
    length = width * (beta[0] - beta[1])
    assert np.mean(odds) == pytest.approx(erfc(0.5 * length), abs=0.003)
    assert length_of_acceptance(erfc(0.5 * length)) == pytest.approx(length, rel=1e-9)


def test_a_constant_heat_capacity_has_constant_ratios():
    """Energies as wide as kT: lengths follow ln T, but for the trapezoid."""
    start = np.array([300.0, 310.0, 320.0, 400.0, 500.0, 600.0])
    for _ in range(3):
        start = equally_spaced(start, np.diff(np.log(start)))
    assert start == pytest.approx(np.geomspace(300.0, 600.0, 6), rel=1e-9)


LEVELS = np.array([0.0, 3.0, 5.0, 9.0])
MULTIPLICITY = np.array([1.0, 4.0, 2.0, 12.0])


def test_exchanges_keep_every_temperature_canonical():
    """Levels with multiplicities, drawn canonically: after exchanges they are as frequent as before."""
    random, temperatures = np.random.default_rng(4), np.array([300.0, 400.0, 700.0])
    weights = MULTIPLICITY * np.exp(-LEVELS / (MOLAR_GAS * temperatures[:, None]))
    shares = weights / weights.sum(axis=1, keepdims=True)
    n, counts, moved = 20_000, np.zeros((3, 4)), 0
    for number in range(n):
        drawn = np.array([random.choice(4, p=its) for its in shares])
        order, odds = exchange(LEVELS[drawn], temperatures, number % 2, random)
        assert sorted(order) == [0, 1, 2] and order[2 - 2 * (number % 2)] == 2 - 2 * (number % 2)
        assert np.all(odds > 0.0) and np.all(odds <= 1.0)
        moved += order[0] != 0
        counts[np.arange(3), drawn[order]] += 1
    assert moved > n / 10
    error = np.sqrt(shares * (1.0 - shares) / n)
    assert np.max(np.abs(counts / n - shares) / error) < 3.5


def test_round_trips_are_ways_up_and_back():
    heading, trips = np.zeros(3), 0
    for replica in ([0, 1, 2], [1, 0, 2], [1, 2, 0], [1, 2, 0], [1, 0, 2], [0, 1, 2], [0, 1, 2]):
        heading, back = update_headings(heading, np.array(replica, dtype=float))
        trips += back
    # Replica 0 was at the bottom, the top, and the bottom again; 2 began at the top.
    assert trips == 1 and heading.tolist() == [1.0, 1.0, 0.0]
    # A way up alone is none, and a replica at the bottom again is counted when it arrives.
    ways = [update_headings(np.array([1.0, 0.0, -1.0]), np.array(at))[1] for at in ([1, 2, 0], [2, 1, 0])]
    assert ways == [0, 1] and update_headings(np.array([1.0, -1.0, 0.0]), np.array([0.0, 2.0, 1.0]))[1] == 0


@pytest.mark.parametrize(("n_done", "is_end"), [(10, False), (20, False), (30, True), (7, None)])
def test_time_steps_go_with_their_temperatures_when_these_are_placed(n_done, is_end):
    """After a stage that is not the last, temperatures move, and counts of all stages begin anew."""
    ladder = np.array([300.0, 330.0, 600.0])
    steps = np.array([0.010, 0.014, 0.006])
    state = Tempering(
        np.zeros((3, 1)), np.zeros(3), ladder, steps, np.arange(3.0), np.array([1.0, -1.0, 0.0]),
        np.array([4.0, 1.0]), 3.0, 5, n_done, 99, 2,
    )  # fmt: skip
    replicas = Replicas((300.0, 600.0), 3, 30, seed=0, walker=0)
    # Acceptances at the target leave the time steps alone.
    after = replicas._adapt(state, np.full(3, TARGET))
    placed = equally_spaced(ladder, length_of_acceptance(np.array([0.8, 0.2])))
    assert placed[1] > 340.0
    expected = (placed, np.interp(placed, ladder, steps)) if is_end is False else (ladder, steps)
    assert after.temperatures == pytest.approx(expected[0]) and after.time_steps == pytest.approx(expected[1])
    counts = (after.accepted, after.n_counted, after.n_trips, *after.odds, *after.heading)
    assert counts == ((3.0, 5, 2, 4.0, 1.0, 1.0, -1.0, 0.0) if is_end is None else (0.0,) * 8)
    assert replicas._adapt(state, np.array([TARGET, 1.0, 0.0])).n_done == n_done
    if is_end:
        more = replicas._adapt(state, np.array([TARGET, 1.0, 0.0])).time_steps
        assert more[1] > steps[1] and more[2] < steps[2] and more[0] == pytest.approx(steps[0])
