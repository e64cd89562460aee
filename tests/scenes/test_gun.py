"""The scene of a gun on a deck: right in its short form, and its parts fail where they should."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import quad

from bench.scenes import run
from bench.scenes.gun import parts, search, study
from bench.scenes.gun.extremes import REFUSED
from bench.scenes.gun.oracle import CRADLE, ROLL, SLIDE, Planar
from bench.scenes.gun.parts import Gun, built
from protochain.core.errors import MechanicsError
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


def test_the_search_finds_no_axle_that_keeps_a_shot_from_the_muzzle(scene):
    table = scene.tables["search"].set_index(["when", "case"])
    early, late = table.loc[search.EARLY], table.loc[search.LATE]
    assert early["ten_per_cent"].to_dict() == {
        "shot": False, "shot, no couple": True, "blow to the deck": True,
    }  # fmt: skip
    assert not late.loc["shot", "ten_per_cent"] and (table["share"] <= 1.0).all()
    # What it varies is another gun, and as good as it says.
    best = early.loc["blow to the deck"]
    gun = replace(dict(search.CASES)["blow to the deck"], deck=search.DECK)
    least = study.amplitudes(
        built(replace(gun, axle=best["axle"], ratio=best["ratio"], balanced=best["balanced"])), study.EXIT
    )[0]
    stiff = study.amplitudes(built(replace(gun, axle=search.STIFFEST)), study.EXIT)[0]
    assert best["muzzle_mm"] == pytest.approx(1e3 * least, rel=1e-12)
    assert best["share"] == pytest.approx(least / stiff, rel=1e-12)
    # Nelder and Mead go on from the grid.
    assert best["ratio"] not in 10.0 ** np.array([search.LOW[1], search.HIGH[1]])


def test_a_search_ends_at_the_least_within_its_ends_and_passes_by_what_falls():
    middle = 0.5 * (search.LOW + search.HIGH)
    for least in (middle, np.array([search.HIGH[0] + 1.0, *middle[1:]])):
        x, value = search.refined(lambda x, at=least: float(np.sum((x - at) ** 2)), search.LOW + 0.2, 300)
        within = np.minimum(least, search.HIGH)
        np.testing.assert_allclose(x, within, atol=0.02)
        assert value == pytest.approx(np.sum((x - least) ** 2), rel=1e-12)
    asked = []
    search.refined(lambda x: asked.append(x) or float(x[0]), search.HIGH, 10)
    assert len(asked) == 10 and all((x >= search.LOW).all() and (x <= search.HIGH).all() for x in asked)
    assert search.moved(Gun(), 0.01, np.array([0.0, -1.0, 0.0])) == (np.inf, np.inf)


def test_claims_are_counted_at_a_tenth():
    rows = [("shot", 1e6, axle, early, late) for axle, early, late in ((1.0, 0.099, 0.2), (2.0, 1.0, 1.0))]
    table = pd.DataFrame(rows, columns=["case", "deck", "axle", "share_early", "share"])
    found = study.claimed(table)
    assert found["ten_per_cent"].tolist() == [True, False] and found["best_axle"].tolist() == [1.0, 1.0]
    assert found["least_share"].tolist() == [0.099, 0.2]


def test_shots_give_their_impulse():
    gun = Gun(shots=2, charge=0.5)
    for until, shots in ((0.5, 1), (0.9, 2)):
        found = quad(gun.thrust, 0.0, until, points=[0.003, 0.02, 0.503, 0.52], limit=200)[0]
        assert found == pytest.approx(0.5 * shots * 7.5e3, rel=1e-9)
    assert Gun().thrust(parts.PULSE) == pytest.approx(7.5e3 / (2.5e-3 * np.e), rel=1e-14)
    assert Gun().thrust(0.0) == Gun().thrust(-1.0) == Gun().thrust(0.6) + Gun().heel(1.0) - Gun().thrust(0.6)
    assert parts.BREECH + parts.TUBE.mass * parts.TUBE.length == pytest.approx(800.0, abs=1e-9)


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


def test_forces_of_the_other_equations_are_gradients():
    """Of an energy, written here once more, by differences."""
    gun = Gun(cells=2, deck=1e7, axle=1e6)
    planar, rng = Planar(gun), np.random.default_rng(3)
    y = planar.standing + 0.1 * rng.normal(size=planar.n)
    stiffness, _, rest = planar.springs

    def energy(y):
        _, along, _ = planar.places(y)
        heights = along[:, 1:].sum(axis=1).imag + y[0]
        # Heave and slide turn nothing: their columns of arms are empty.
        lift = gun.equilibrator * np.prod(parts.LEVER) * np.sin(y[CRADLE] - y[ROLL])
        spring = 0.5 * (y - rest) @ stiffness @ (y - rest)
        return spring + 9.81 * planar.masses @ heights - lift

    for k, one in enumerate(1e-5 * np.eye(planar.n)):
        slope = (energy(y + one) - energy(y - one)) / 2e-5
        assert planar.pull(y)[k] == pytest.approx(-slope, rel=1e-5, abs=1e-2), k


def test_a_rigid_deck_is_left_out_and_what_falls_is_refused():
    assert built(Gun(deck=np.inf)).model.tree.n_v == 2 and built(Gun()).model.tree.n_v == 4
    assert built(Gun(cells=3)).model.tree.n_v == 7
    with pytest.raises(MechanicsError, match="the gun falls"):
        built(Gun(axle=0.0, balanced=0.0))
    # A balanced barrel that slides back as it rises leans on the axle the more: it needs some stiffness.
    assert built(Gun(axle=1e4)).start.q[2] > parts.ELEVATION
    with pytest.raises(MechanicsError, match="the gun falls"):
        built(Gun(axle=0.0))
