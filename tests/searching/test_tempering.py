"""What replicas sample, against quadrature; and that what moves forth moves back as often."""

import numpy as np
import pytest

import protochain as pc
from protochain.core.units import MOLAR_GAS
from protochain.searching.landscape import Landscape
from protochain.searching.statistics import mean_and_error
from protochain.searching.tempering import Replicas
from protochain.searching.walker_steps import advance

WITHIN = 3.5
"""Standard errors, of some twenty blocks: what chance does once in a thousand times."""


@pytest.fixture(scope="module")
def two_hinges():
    """Trialanine of which only two phi turn, with its energies on a grid."""
    structure = pc.from_sequence("AAA")
    landscape = Landscape.of(pc.build_chain(structure, "phi"), pc.energy(structure, threads=1))
    assert landscape.chain.n_hinges == 2
    at = 2.0 * np.pi * (np.arange(60) + 0.5) / 60 - np.pi
    chain, energy = landscape.chain, landscape.energy
    grid = np.array([[energy(pc.pose(chain, np.array([a, b])).x)[0] for b in at] for a in at])
    return landscape, at, grid


def test_replicas_of_two_hinges_agree_with_quadrature(two_hinges):
    landscape, at, grid = two_hinges
    method = Replicas((300.0, 600.0), 2, 100, 1, 0)
    state, found = advance(landscape, method, None, 15_000, np.inf)
    samples = found.samples
    assert len(samples) == state.n_done - method.pilot > 200
    assert state.temperatures == pytest.approx([300.0, 600.0])
    assert state.n_trips > 5 and 0.3 < state.acceptance < 0.95
    for k, temperature in enumerate(state.temperatures):
        weight = np.exp(-(grid - grid.min()) / (MOLAR_GAS * temperature))
        weight /= weight.sum()
        measures = {
            "energy": (samples[:, k, 0], grid, 1.0),
            "first": (np.cos(samples[:, k, 1]), np.cos(at)[:, None], 0.1),
            "second": (np.cos(samples[:, k, 2]), np.cos(at)[None, :], 0.1),
        }
        for name, (series, value, wide) in measures.items():
            mean, error = mean_and_error([series])
            assert error < wide
            assert abs(mean - np.sum(weight * value)) < WITHIN * error, (temperature, name)


def accepted_exchanges(grid, temperatures):
    """Mean acceptance across each pair of neighbours, by quadrature."""
    energy, beta = grid.ravel(), 1.0 / (MOLAR_GAS * temperatures)
    weights = np.exp(-np.outer(beta, energy - energy.min()))
    weights /= weights.sum(axis=1, keepdims=True)
    return [
        one @ np.exp(np.minimum(0.0, rise * (energy - energy[:, None]))) @ other
        for one, other, rise in zip(weights[:-1], weights[1:], np.diff(beta), strict=True)
    ]


def test_a_pilot_places_temperatures_for_equal_exchanges_and_then_they_stay(two_hinges):
    landscape, _, grid = two_hinges
    method, placed = Replicas((200.0, 5000.0), 4, 301, 1, 0), []
    state, _ = method.begin(landscape)
    while state.n_done < method.pilot + 10:
        before = state.temperatures
        state, _ = method.step(landscape, state)
        if not np.array_equal(state.temperatures, before):
            placed.append(state.n_done)
    assert placed == [100, 200] and state.n_counted == 10
    assert state.temperatures[[0, -1]] == pytest.approx([200.0, 5000.0])
    assert np.ptp(accepted_exchanges(grid, np.geomspace(200.0, 5000.0, 4))) > 0.25
    assert np.ptp(accepted_exchanges(grid, state.temperatures)) < 0.15


def test_transitions_are_as_frequent_forth_as_back(two_hinges):
    """Among three and more places: between two alone it would be so of any walk.

    Trajectories are short: long ones forget where they began, and hide a walk that drifts between them.
    """
    landscape, _, _ = two_hinges
    q, places = landscape.minimise(landscape.chain.q0).q, []
    for k in range(300):
        q = landscape.sweep(q, 600.0, 0.005, 1, k).q
        places.append(int(np.digitize(q[0], np.deg2rad([-130.0, -105.0, -80.0, -60.0]))))
    counts = np.zeros((5, 5))
    np.add.at(counts, (places[:-1], places[1:]), 1)
    i, j = np.triu_indices(5, 1)
    both = counts[i, j] + counts[j, i]
    seen = both >= 8
    assert seen.sum() >= 3
    squares = (counts[i, j] - counts[j, i])[seen] ** 2 / both[seen]
    # The mean of chi squared is the number of pairs; the limit is passed once in a thousand times.
    assert squares.sum() < seen.sum() + 3.1 * np.sqrt(2.0 * seen.sum()) + 3.0


def test_energies_and_evaluations_are_those_of_what_was_done(two_hinges):
    landscape, _, _ = two_hinges
    energy = landscape.energy
    done = landscape.minimise(landscape.chain.q0)
    assert done.energy == pytest.approx(energy(landscape.positions(done.q))[0], abs=1e-9)
    swept = landscape.sweep(done.q, 400.0, 0.02, 3, 5)
    assert len(swept.energies) == 3
    assert swept.energies[-1] == pytest.approx(energy(landscape.positions(swept.q))[0], abs=1e-9)
    assert 61 <= swept.n_evaluations <= 64 and np.max(np.abs(swept.q)) <= np.pi
    again = landscape.sweep(done.q, 400.0, 0.02, 3, 5)
    assert np.array_equal(again.q, swept.q)
