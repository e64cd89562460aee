"""Gears: forces of flanks against their energies, and the scene itself."""

import numpy as np
import pytest
from scipy.optimize import approx_fprime

from bench.scenes import run
from bench.scenes.gear import started
from bench.scenes.gear.mesh import Gear, meshing_of
from protochain.mechanics.motion import System


def test_flanks_push_with_the_gradient_of_their_energy():
    model = started(Gear(), 1e-3)
    flanks = meshing_of(model)
    rng = np.random.default_rng(1)
    factors = model.start().factors
    # Where two pairs touch, one at a tip corner.
    turned = model.q + 1e-6 * rng.normal(size=len(model.q))
    for k, base in ((0, 37.588e-3), (1, 75.175e-3)):
        turned[model.bodies.freedom(f"wheel {k}")[0]] += 6e-4 / base
    pairs = flanks.pressing(turned, np.zeros_like(turned))
    assert np.sum(pairs[:, 1] > 0.0) == 2
    only = System(model.tree, lambda q, _: (flanks.add(q, factors.frames, None, torques), torques))
    torques = np.zeros(model.tree.n_v)
    _, force = only.potential(turned, factors)
    gradient = approx_fprime(turned, lambda q: flanks.add(q, factors.frames, None, np.zeros_like(q)), 1e-9)
    assert np.abs(gradient + force).max() < 1e-4 * np.abs(force).max()


@pytest.fixture(scope="module")
def scene():
    return run("gear", quick=True)


def test_the_scene_is_right(scene):
    assert scene.wrong == ()
    assert len(scene.checks) >= 14
    assert {each.verdict for each in scene.extremes} == {"right", "refused"}


def test_teeth_on_springs_give_way_more_than_rigid_ones(scene):
    models = scene.tables["models"].set_index("model")
    assert models.loc["teeth on springs", "lag_mean"] > 4.0 * models.loc["rigid wheels", "lag_mean"]
    assert models["ratio"].to_numpy() == pytest.approx(2.0, abs=1e-3)
    assert scene.work.groupby("method")["error"].min()["RK4"] < 1e-5
