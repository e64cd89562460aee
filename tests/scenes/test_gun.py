"""The scene of a gun on a deck: right in its short form, and its parts fail where they should."""

from dataclasses import replace

import numpy as np
import pytest

from bench.scenes import run
from bench.scenes.gun.extremes import REFUSED
from bench.scenes.gun.oracle import Planar
from bench.scenes.gun.parts import Gun, built
from protochain.mechanics.motion import DormandPrince
from protochain.mechanics.multibody import mass_matrix, pose


@pytest.mark.slow
def test_a_gun_is_right():
    scene = run("gun", quick=True)
    assert scene.wrong == () and len(scene.left_out) == 2
    names = [each.name for each in scene.checks]
    assert len(set(names)) == len(names) > 30
    refused = {each.name for each in scene.extremes if each.verdict == "refused"}
    assert refused == {"tube 1e6 times as stiff, explicit steps", *(name for name, *_ in REFUSED)}
    assert set(scene.tables) == {"isolation", "claim", "search", "flexible", "decks", "cells", "bursts"}
    assert set(scene.work["method"]) == {"Kutta", "Dormand-Prince", "midpoint", "Rosenbrock"}
    assert all(np.diff(own["error"])[-1] < 0.0 for _, own in scene.work.groupby("method"))


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
