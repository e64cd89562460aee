"""Accelerations of random mechanisms with loops against dense algebra: redundant loops, fixed bodies."""

from dataclasses import replace

import numpy as np
import pytest
from fixtures.random_loops import (
    CLOSINGS,
    dense_accelerations,
    dense_matrices,
    moving,
    random_loops,
)
from fixtures.tolerances import LOOPED
from scipy.spatial.transform import Rotation

from protochain.mechanics.multibody import HingeKind
from protochain.mechanisms import Mechanism
from protochain.mechanisms.assemble import Hinge
from protochain.mechanisms.loop_joints import factor_loops

TURN = Rotation.from_rotvec([0.3, 0.5, -0.7]).as_matrix()


def accelerations(model, at):
    return model.system.accelerations(at.time, at.q, at.qd, at.torque, at.loads, at.factors)[0]


def differs(seed):
    """Largest difference of accelerations, by the largest that loops change."""
    model, qd = moving(*random_loops(seed))
    at, units = model.system.at(model.q, qd), model.tree.units
    dense = dense_matrices(model, at.q, at.qd)
    wanted, free = dense_accelerations(dense), np.linalg.solve(dense.mass, dense.torque)
    scale = max(np.max(np.abs(each / units), initial=0.0) for each in (wanted, free))
    found = np.max(np.abs((accelerations(model, at) - wanted) / units), initial=0.0)
    return found / scale if scale > 0.0 else found


@pytest.mark.parametrize("seeds", [range(40), pytest.param(range(40, 1000), marks=pytest.mark.slow)])
def test_accelerations_with_loops_are_those_of_dense_algebra(seeds):
    wrong = {seed: error for seed in seeds if not (error := differs(seed)) < LOOPED}
    assert not wrong


def welded(kind=None, other=False):
    """Two bodies on a pin, fixed to each other, and a joint between them; another joint to the world."""
    at, place = np.array([0.1, 0.2, 0.3]), np.array([0.4, -0.3, 0.2])
    m = Mechanism(gravity=(0, 0, -9.81))
    m.body("a", 1.0, com=(0.3, 0, 0.1), inertia=0.05)
    m.body("b", 0.5, com=(0.1, 0.1, 0), inertia=0.02)
    m.hinge("pin", "world", "a", axis=(0, 1, 0), qd=1.0)
    m.hinge("weld", "a", "b", "fixed", at=at, rotation=TURN)
    m.body("c", 0.3, com=(0, 0.1, -0.2), inertia=0.01)
    m.hinge("other", "b", "c", axis=(1, 1, 0), at=(0.2, 0, 0))
    if kind:
        inward = {"axis_b": TURN.T @ np.cross((0.2, 0.5, 1.0), (1, 0, 0))} if kind == "universal" else {}
        m.close("again", ("a", place), ("b", TURN.T @ (place - at)), kind, axis=(0.2, 0.5, 1.0), **inward)
    if other:
        m._parts[Hinge]["pin"].fix(qd=0.0)
        m.close("held", ("c", (0.1, 0, 0)), ("world", m.build().state().point("c", (0.1, 0, 0))), "planar")
    return m.build()


@pytest.mark.parametrize("kind", CLOSINGS)
def test_a_joint_between_bodies_fixed_to_each_other_changes_nothing(kind):
    free, closed = welded(), welded(kind)
    assert np.array_equal(closed.qd, free.qd)
    assert np.array_equal(closed.directions, free.directions)
    assert len(closed.state().loops.body) == 0
    at = closed.start()
    assert np.allclose(accelerations(closed, at), accelerations(free, free.start()), rtol=LOOPED)
    assert not np.any(factor_loops(at.factors, closed.bodies.joints).scales)
    runs = [model.simulate(0.2, 0.005) for model in (free, closed)]
    assert np.allclose(runs[0].q[-1], runs[1].q[-1], rtol=LOOPED)
    assert np.allclose(runs[1].reactions("again").iloc[:, 1:], 0.0)


def test_gains_of_fixed_bodies_which_no_sweep_writes_are_not_read():
    model = welded("revolute", other=True)
    at, joints = model.start(), model.bodies.joints
    unwritten = np.where((model.tree.kind == HingeKind.FIXED)[:, None], np.nan, at.factors.gain)
    found, wanted = (factor_loops(each, joints) for each in (replace(at.factors, gain=unwritten), at.factors))
    assert len(wanted.order) > 0
    assert np.array_equal(found.coefficients, wanted.coefficients)


def test_forces_of_redundant_loops_are_the_least():
    """Scaled by what each equation moves alone, as A is of a diagonal of one."""
    for seed in range(40):
        model, qd = moving(*random_loops(seed))
        at = model.system.at(model.q, qd)
        dense, loops = dense_matrices(model, at.q, at.qd), factor_loops(at.factors, model.bodies.joints)
        counts = loops.scales > 0.0
        if loops.rank is None and len(loops.order) < np.count_nonzero(counts):
            wanted = dense.rows @ (
                np.random.default_rng(seed).normal(size=len(qd)) / np.sqrt(np.diag(dense.mass))
            )
            rows = (dense.rows * loops.scales[:, None])[counts]
            inverse = rows @ np.linalg.solve(dense.mass, rows.T)
            least = np.linalg.pinv(inverse, rcond=1e-9) @ (loops.scales * wanted)[counts]
            found = loops.impulses(wanted)[counts] / loops.scales[counts]
            assert np.allclose(found, least, rtol=1e-6, atol=1e-6 * np.abs(least).max(initial=0.0))
