"""The scene of a gun on a deck: right in its short form, and its parts fail where they should."""

from dataclasses import replace

import numpy as np
import pytest

from bench.scenes import run
from bench.scenes.gun.extremes import REFUSED
from bench.scenes.gun.oracle import CRADLE, SLIDE, Planar
from bench.scenes.gun.parts import Gun, built
from protochain.mechanics.motion import DormandPrince
from protochain.mechanics.multibody import mass_matrix, pose


@pytest.fixture(scope="module")
def scene():
    return run("gun", quick=True)


def test_a_gun_is_right(scene):
    assert scene.wrong == () and len(scene.left_out) == 2
    names = [each.name for each in scene.checks]
    assert len(set(names)) == len(names) > 30
    refused = {each.name for each in scene.extremes if each.verdict == "refused"}
    assert refused == {"tube 1e6 times as stiff, explicit steps", *(name for name, *_ in REFUSED)}
    assert set(scene.tables) == {"isolation", "claim", "search", "flexible", "decks", "cells", "bursts"}
    assert set(scene.work["method"]) == {"Kutta", "Dormand-Prince", "midpoint", "Rosenbrock"}
    assert all(np.diff(own["error"])[-1] < 0.0 for _, own in scene.work.groupby("method"))


def test_a_soft_axle_keeps_the_deck_from_the_muzzle_but_not_the_shot(scene):
    claim = scene.tables["claim"]
    early = claim["when"] == "until the projectile has left"
    shot = claim["case"].isin(["shot", "shot, no equilibrator"])
    assert (claim.loc[shot, "least_share"] == 1.0).all() and not claim.loc[shot, "ten_per_cent"].any()
    assert claim.loc[early & ~shot, "ten_per_cent"].all() and set(claim.loc[~shot, "case"]) == {
        "shot, no couple", "blow to the deck"
    }  # fmt: skip
    assert not claim.loc[~early & (claim["case"] == "shot, no couple"), "ten_per_cent"].any()
    soft = scene.tables["isolation"].groupby("case")["sag_mrad"].max()
    assert soft["shot, no equilibrator"] > 7.0 > 1.0 > soft["shot"]


def test_the_equilibrator_balances_the_barrel_at_any_elevation():
    gun = Gun(axle=0.0, offset=0.0)
    for elevation in (-0.2, 0.0, 0.35, 1.2):
        planar = Planar(gun)
        y = np.zeros(planar.n)
        y[CRADLE] = elevation
        assert abs(planar.pull(y)[CRADLE]) < 1e-9
        y[SLIDE] = -0.5
        assert planar.pull(y)[CRADLE] == pytest.approx(0.5 * 800.0 * 9.81 * np.cos(elevation), rel=1e-12)
        y[SLIDE] = 0.0
        bare, half = (Planar(replace(gun, balanced=share)).pull(y)[CRADLE] for share in (0.0, 0.5))
        assert bare < 0.0 and half == pytest.approx(0.5 * bare, rel=1e-12)
    soft = Gun(axle=1e6)
    assert replace(soft, ratio=2.0 * soft.ratio).dampers[2] == pytest.approx(2.0 * soft.dampers[2], rel=1e-15)


@pytest.mark.parametrize("cells", [0, 2])
def test_the_gun_stands_and_its_other_equations_are_its_own(cells):
    gun = Gun(deck=1e6, axle=1e6, cells=cells)
    found, planar = built(gun), Planar(gun)
    torque = np.abs(found.start.torque)
    assert torque.max() < 1e-6 and found.start.kinetic == 0.0
    np.testing.assert_allclose(planar.muzzle(planar.standing), found.muzzle_at(found.start), atol=1e-12)
    # In absolute and in relative angles mass matrices have one determinant: the change is unimodular.
    model = found.model
    mass = mass_matrix(model.tree, pose(model.tree, found.start.q))
    other = np.linalg.slogdet(planar.mass(planar.standing))
    np.testing.assert_allclose(other, np.linalg.slogdet(mass), rtol=1e-12)
    # What is not the same gun is seen.
    end, times = found.end(DormandPrince(1e-10), 0.01, 0.02), np.array([0.02])
    np.testing.assert_allclose(planar.moved(times)[0], end, atol=1e-9)
    for other in (replace(gun, offset=-0.02), replace(gun, balanced=0.0), replace(gun, damped=0.9)):
        assert np.abs(Planar(other).moved(times)[0] - end).max() > 1e-6
