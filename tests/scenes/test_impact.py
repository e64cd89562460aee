"""The scene of impacts: right in its short form, and its parts fail where they should."""

import numpy as np
import pytest
from fixtures.refusals import expect_refusal

from bench.scenes.impact import bounces
from bench.scenes.impact.study import each_alone, random_points, random_pose
from protochain.core.errors import Fault, MechanicsError
from protochain.mechanics.multibody import kinetic_energy
from protochain.mechanisms.impacts import impact


@pytest.mark.parametrize("looped", [False, True])
@pytest.mark.parametrize("plane", [False, True])
def test_impacts_from_one_sweep_are_those_of_one_each(plane, looped):
    rng = np.random.default_rng(4)
    posed = random_pose(plane, looped, rng)
    tree, frames = posed.factors.tree, posed.factors.frames
    assert (posed.loops is not None) == looped
    if plane:
        assert np.abs(frames.origin[:, 2]).max() == 0.0
    qd = impact(posed.factors, rng.normal(size=tree.n_v), (), loops=posed.loops).qd
    points = list(random_points(posed, qd, 6, 1, rng))
    found = list(each_alone(posed, qd, points, "stronge"))
    for point, work in zip(points, found, strict=True):
        after = impact(posed.factors, qd, [point], "stronge", posed.loops)
        assert after.before[0] @ point.normal < 1e-14
        change = kinetic_energy(tree, frames, after.qd) - kinetic_energy(tree, frames, qd)
        assert work == pytest.approx(change, rel=1e-9, abs=1e-12)


def test_bounces_are_ended_or_refused():
    table, end = bounces.bounce(bounces.ball(), ends=True)
    assert end > table["time"].iloc[-1] and table["speed"].iloc[-1] < bounces.SLOWEST
    assert not all(each.right for each in bounces.bounce_checks(table, end * (1.0 + 1e-10)))
    with expect_refusal(fault=Fault.ENDLESS, kind=MechanicsError):
        bounces.bounce(bounces.ball(), ends=False)
