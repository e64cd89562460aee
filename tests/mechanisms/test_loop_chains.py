"""Chains of closed loops: groups of equations along them, against dense algebra and closed forms."""

import numpy as np
import pytest
from fixtures.random_loops import dense_accelerations, dense_matrices, moving
from fixtures.tolerances import AUDITED, LOOPED

from protochain.mechanics.motion import DormandPrince
from protochain.mechanisms import Mechanism
from protochain.mechanisms.loop_factors import find_fronts


def chain(seed, n, planar):
    """Bodies on the world in a row, neighbours joined by couplers, in loops of shuffled names and order."""
    rng = np.random.default_rng(seed)
    m = Mechanism(gravity=rng.normal(size=3) * 5.0)
    hinge = {"kind": "revolute", "axis": (0, 1, 0)} if planar else {"kind": "ball"}
    for k in range(n + 1):
        for name in (f"b{k}", f"c{k}")[: 1 + (k < n)]:
            m.body(name, rng.uniform(0.5, 2.0), 0.3 * rng.normal(size=3), rng.uniform(0.05, 0.09, 3))
    for k in range(n + 1):
        m.hinge(f"p{k}", "world", f"b{k}", at=(2.0 * k, 0, 0), **hinge)
    for k in range(n):
        m.hinge(f"j{k}", f"b{k}", f"c{k}", at=rng.normal(size=3), **hinge)
    state = m.build().state()
    for k in rng.permutation(n):
        point = rng.normal(size=3) + np.array([2.0 * k + 1.0, 0, 0])
        ends = [(name, point - state.point(name)) for name in (f"c{k}", f"b{k + 1}")]
        m.close(f"e{k}", *ends, "revolute" if planar else "spherical", axis=(0, 1, 0))
    return m, rng


def fronts(model):
    return find_fronts(model.tree.locked_links, model.bodies.joints.body)


@pytest.mark.parametrize("planar", [True, False])
@pytest.mark.parametrize("n", [2, 20])
def test_a_chain_of_loops_in_any_order_moves_as_dense_algebra(planar, n):
    """In a plane three equations of five are redundant; on balls freedoms are left in every group."""
    for seed in range(3):
        model, qd = moving(*chain(seed, n, planar))
        assert (len(fronts(model).ends) > 1) == (n > 2)
        at = model.system.at(model.q, qd)
        wanted = dense_accelerations(dense_matrices(model, at.q, at.qd))
        found = model.system.accelerations(at.time, at.q, at.qd, at.torque, at.loads, at.factors)[0]
        assert np.max(np.abs(found - wanted)) < 1e-3 * LOOPED * np.max(np.abs(wanted))


def test_groups_of_a_long_chain_are_as_small_as_of_a_short_one():
    """So that the cost is proportional to the number of loops."""
    short, long = (fronts(chain(0, n, True)[0].build()) for n in (12, 40))
    assert np.all(long.sizes <= short.sizes)
    assert len(long.ends) > 3 * len(short.ends)


def test_a_long_row_of_loops_keeps_energy_and_closure():
    """A thousand swings' steps: loops do not drift, and energy is conserved."""
    m = Mechanism(gravity=(0, 0, -9.81))
    for k in range(21):
        m.body(f"bar{k}", 1.0, com=(0, 0, -0.5), inertia=1 / 12)
        m.hinge(f"pin{k}", "world", f"bar{k}", axis=(0, 1, 0), at=(k, 0, 0), q=0.3)
    for k in range(20):
        m.body(f"link{k}", 1.0, com=(0.5, 0, 0), inertia=1 / 12)
        m.hinge(f"joint{k}", f"bar{k}", f"link{k}", axis=(0, 1, 0), at=(0, 0, -1.0), q=-0.3)
        m.close(f"end{k}", (f"link{k}", (1.0, 0, 0)), (f"bar{k + 1}", (0, 0, -1.0)), axis=(0, 1, 0))
    audit = m.build().simulate(20.0, 0.02, DormandPrince(1e-11)).audit()
    assert audit.energy < AUDITED
    assert audit.gap < 1e-12 and audit.parting < 1e-12
