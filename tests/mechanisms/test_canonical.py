"""Canonical momenta of bodies that bend: three ways to rates, and two links against equations by hand."""

from dataclasses import replace

import numpy as np
import pytest
from fixtures.bending_trees import some, two_links
from fixtures.refusals import expect_refusal
from scipy.integrate import solve_ivp

from bench.scenes.canonical import by_hand
from protochain.core.errors import Fault, MechanicsError
from protochain.mechanics.multibody import HingeKind
from protochain.mechanisms.flexible.dynamics import (
    canonical_rates,
    forward_dynamics,
    mass_matrix,
    momenta,
    rates_of,
)
from protochain.mechanisms.flexible.flexible import bend, elastic

EPS = np.finfo(float).eps


def test_two_links_move_as_by_hand_in_both_forms():
    flexible = two_links()
    q, qd = np.array([0.3, 0.9, 0.05, -0.04]), np.array([2.0, -3.0, 0.5, 0.4])
    p = momenta(flexible, q, qd)[0]

    def canonical(t, y):
        return np.concatenate(canonical_rates(flexible, y[:4], y[4:], elastic(flexible, y[:4])[1]))

    def accelerated(t, y):
        return np.concatenate([y[4:], forward_dynamics(flexible, y[:4], y[4:], elastic(flexible, y[:4])[1])])

    expected, other, found = (
        solve_ivp(rates, (0.0, 0.2), start, method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
        for rates, start in (
            (by_hand(flexible), np.concatenate([q, qd])),
            (accelerated, np.concatenate([q, qd])),
            (canonical, np.concatenate([q, p])),
        )
    )
    assert np.abs(expected - np.concatenate([q, qd])).max() > 0.3
    assert np.allclose(other, expected, atol=1e-9)
    assert np.allclose(found[:4], expected[:4], atol=1e-9)
    assert np.allclose(momenta(flexible, expected[:4], expected[4:])[0], found[4:], atol=1e-9)
    # Nothing depends on the first angle: no term adds to its momentum, not even rounding.
    assert found[4] == pytest.approx(p[0], abs=1e-13)


@pytest.mark.parametrize("seed", range(6))
def test_three_ways_to_rates_agree(seed):
    flexible, q, qd, _, _ = some(seed, (HingeKind.FREE, HingeKind.REVOLUTE)[seed % 2])
    bent, p = bend(flexible, q), momenta(flexible, q, qd)[0]
    blocks = mass_matrix(flexible, bent)
    m = np.block([[blocks.rr, blocks.rf], [blocks.rf.T, blocks.ff]])
    condition = np.linalg.cond(m)
    for route in ("articulated", "blocks", "dense"):
        found = rates_of(flexible, bent, p, route)
        assert np.abs(found - qd).max() < 100 * EPS * condition * np.abs(qd).max(), route
        residual = momenta(flexible, q, found)[0] - p
        assert np.abs(residual).max() < 100 * EPS * np.abs(m).max() * np.abs(qd).max(), route


def test_what_has_no_momenta_is_refused():
    flexible = two_links()
    bent = bend(flexible, np.zeros(4))
    with pytest.raises(MechanicsError, match="route 'magic' is not known; choose articulated, blocks or"):
        rates_of(flexible, bent, np.zeros(4), "magic")
    driven = replace(flexible, tree=replace(flexible.tree, driven=np.array([True, False])))
    with expect_refusal(fault=Fault.DRIVEN, kind=MechanicsError):
        rates_of(driven, bent, np.zeros(4))
    empty = replace(flexible, shapes=tuple(replace(s, mass=0.0 * s.mass) for s in flexible.shapes))
    for route in ("articulated", "blocks", "dense"):
        with pytest.raises(MechanicsError, match=r"singular|no inertia"):
            rates_of(empty, bent, np.zeros(4), route)
