"""Gears: flanks against drawn involutes, forces against energies, and the scene itself."""

import numpy as np
import pytest
from scipy.optimize import approx_fprime
from scipy.spatial import cKDTree

from bench.scenes import run
from bench.scenes.gear import started
from bench.scenes.gear.geometry import GearPair, overlap
from bench.scenes.gear.mesh import Gear, gears, meshing_of
from protochain.mechanics.motion import System

DRAWN = 3e-8
"""m. Of gaps of 50 um between curves of points 2 um apart."""


def involute(wheel, place, points=6001):
    """Points of a flank that crosses the line of action at a place, from near the base circle to the tip.

    A string unwound from the base circle, whose foot falls back as it grows longer; the other wheel is half a
    turn about the pitch point away, and its places count the other way.
    """
    alpha = wheel.pressure_angle
    roll = np.linspace(0.02, np.sqrt((wheel.tip / wheel.base) ** 2 - 1.0), points)
    begin = place / wheel.base - alpha + np.tan(alpha)
    return wheel.base * np.exp(1j * (begin - roll)) * (1.0 + 1j * roll)


def gap(pair, driving, driven):
    """Distance of two drawn flanks."""
    one, other = pair.wheels
    front, back = involute(one, driving), one.pitch + other.pitch - involute(other, -driven)
    return (
        cKDTree(np.column_stack([front.real, front.imag]))
        .query(np.column_stack([back.real, back.imag]))[0]
        .min()
    )


@pytest.mark.parametrize("teeth", [(20, 40), (33, 25)])
def test_gaps_are_those_of_drawn_involutes_on_the_path_of_contact_and_beyond_it(teeth):
    pair = GearPair(teeth)
    begin, end = pair.path
    for place in (begin - 2e-3, begin - 3e-4, begin + 1e-4, 0.0, end - 1e-4, end + 3e-4, end + 2e-3):
        depth, _, _ = overlap(place - 2.5e-5, place + 2.5e-5, *pair.corners)
        assert gap(pair, place - 2.5e-5, place + 2.5e-5) == pytest.approx(-depth, abs=DRAWN)
        if begin < place < end:
            assert depth == pytest.approx(-5e-5, rel=1e-12)
        else:
            assert depth < -5.1e-5


def back_flank(wheel, place):
    """Points of the back of a tooth whose front is at a place, drawn from its thickness."""
    thick = 0.5 * np.pi + 2.0 * wheel.shift * np.tan(wheel.pressure_angle)
    # Its front crosses the pitch circle at this angle, and the tooth follows.
    middle = np.exp(1j * (place / wheel.base - thick / wheel.teeth))
    return middle**2 * involute(wheel, place).conj()


@pytest.mark.parametrize("pair", [GearPair(), GearPair((9, 40), shift=0.45), GearPair((33, 25), shift=-0.2)])
def test_gaps_of_back_flanks_are_those_of_drawn_teeth(pair):
    gear = Gear(pair, backlash=3e-5)
    model = gears(gear, rigid=True)
    one, other = pair.wheels
    for turned in (0.0, 1e-3, -2.5e-3):
        q = np.array([turned / one.base, (turned - 5e-5) / other.base])
        pairs = meshing_of(model).pressing(q, np.zeros(2))
        back = pairs[pairs[:, 3] == 1]
        # As drawn, teeth fill the gaps, and the driven wheel is 50 um back, into the fronts.
        steps = np.arange(-3, 4) * pair.base_pitch
        driving, driven = (
            np.concatenate([back_flank(wheel, sign * (turned + n) + back) for n in steps])
            for wheel, sign, back in ((one, 1.0, 0.0), (other, -1.0, 5e-5))
        )
        driven = one.pitch + other.pitch - driven
        tree = cKDTree(np.column_stack([driving.real, driving.imag]))
        gap = tree.query(np.column_stack([driven.real, driven.imag]))[0]
        assert gap.min() == pytest.approx(5e-5, abs=DRAWN)
        # Where, along the line of action of back flanks, whose curves are 30 nm farther apart 30 um away.
        line = np.sin(pair.pressure_angle) - 1j * np.cos(pair.pressure_angle)
        place = ((driven[gap.argmin()] - one.pitch) * line.conjugate()).real - back[back[:, 1].argmax(), 0]
        assert abs(place - pair.base_pitch * round(place / pair.base_pitch)) < 1e-4
        assert back[:, 1].max() == pytest.approx(-8e-5, rel=1e-9)


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


def test_damping_of_flanks_opposes_their_approach_and_never_pulls():
    model = started(Gear(), 1e-3)
    flanks, frames = meshing_of(model), model.start().factors.frames
    one = model.bodies.freedom("wheel 0")[1]
    elastic = np.zeros(model.tree.n_v)
    flanks.add(model.q, frames, None, elastic)
    for rate, factor in ((1.0, 1.0), (-1.0, -1.0), (-1e3, None)):
        qd = np.zeros(model.tree.n_v)
        qd[one] = rate
        damped = flanks.resist(0.0, model.q, qd, frames).torques
        share = damped[one] / elastic[one]
        # a v of Lankarani and Nikravesh, with e = 0.8 at 0.1 m/s; at most all of the force is taken away.
        wanted = -1.0 if factor is None else factor * 0.75 * 0.36 / 0.1 * 37.588e-3
        assert share == pytest.approx(wanted, rel=1e-4)


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
