"""The helicopter: legs, lift, mechanisms in modes, ground resonance; and the whole scene, quick."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp

from bench.scenes import run
from bench.scenes.helicopter.legs import Legs
from bench.scenes.helicopter.lift import Lift, Strip
from bench.scenes.helicopter.parts import (
    BLADE,
    BLADES,
    RADIUS,
    RATE,
    trimmed,
)  # fmt: skip
from protochain.mechanics.motion import DormandPrince
from protochain.mechanisms import Mechanism

FEET = [(1.0, 0.5, 0.0), (-1.0, 0.5, 0.0), (0.0, -1.0, 0.0)]


def block(legs, **where):
    """A block of 10 kg whose feet are as high as its centre of mass, so that friction does not turn it."""
    m = Mechanism(gravity=(0.0, 0.0, -9.81))
    m.body("block", mass=10.0, inertia=(1.0, 2.0, 3.0), **where)
    m.force("legs", legs)
    return m.build()


def test_legs_push_only_and_have_the_energy_of_their_springs():
    legs = Legs("block", FEET, 500.0, 30.0, 20.0)
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    for depth, rate in ((0.1, 0.7), (0.1, -0.7), (0.1, -5.0), (-0.1, 0.7), (0.0, 0.5)):
        where = {"position": (3, 4, -depth), "velocity": (0, 0, -rate), "rotation": turn}
        model = block(legs, **where)
        one = max(0.0, 500.0 * depth + 30.0 * rate + 20.0 * rate * abs(rate)) if depth >= 0.0 else 0.0
        np.testing.assert_allclose(legs.forces(model.state()), one, rtol=1e-12)
        at = model.start()
        # The free root's freedoms: moment and force along world axes.
        np.testing.assert_allclose(at.torque[5] + 98.1, 3.0 * one, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(at.torque[:5], 0.0, atol=1e-12)
        stored = at.potential + 98.1 * depth
        assert stored == pytest.approx(1.5 * 500.0 * max(depth, 0.0) ** 2, abs=1e-12)


def test_friction_opposes_the_motion_and_stops_it_as_in_closed_form():
    legs, depth = Legs("block", FEET, 500.0, friction=0.4, slip=0.3), 98.1 / 1500.0
    model = block(legs, position=(0, 0, -depth), velocity=(3.0, 4.0, 0.0))
    moved = model.simulate(1.5, 0.1, DormandPrince(1e-10))
    # v' = -mu g v / sqrt(v^2 + slip^2), the direction stays.
    exact = solve_ivp(
        lambda t, v: -0.4 * 9.81 * v / np.hypot(v, 0.3), (0, 1.5), [5.0], rtol=1e-11, atol=1e-12
    )
    velocity = model.state(moved.end).velocity("block")
    np.testing.assert_allclose(velocity, exact.y[0, -1] * np.array([0.6, 0.8, 0.0]), atol=1e-8)
    assert 0.0 < exact.y[0, -1] < 0.5 and moved.audit().energy < 1e-9
    assert moved.dissipation[-1] == pytest.approx(5.0 * (25.0 - exact.y[0, -1] ** 2), rel=1e-7)


def test_lift_is_the_integral_of_the_strips_and_acts_where_they_are():
    """Against quadrature of the formula, with twist, gust and the motion of a blade; up along the shaft."""
    m = Mechanism()
    m.body("hub", 1.0, inertia=1.0, rotation=np.diag([1.0, -1.0, -1.0]))
    # Turned about its own axis by 0.1, the leading edge up along the shaft.
    c, s = np.cos(0.1), np.sin(0.1)
    m.body("blade", 1.0, inertia=1.0)
    m.hinge(
        "root",
        parent="hub",
        child="blade",
        rotation=[[1, 0, 0], [0, c, -s], [0, s, c]],
        qd=0.0,
        axis=(0, 1, 0),
    )
    nodes, weights = np.polynomial.legendre.leggauss(4)
    x, dx = 1.0 + 0.5 * (nodes + 1.0) * 2.0, weights
    strips = tuple(Strip("blade", (a, 0.0, 0.0), a, b) for a, b in zip(x, dx, strict=True))
    lift = Lift("hub", strips, 0.7, lambda t: 20.0 + t, lambda t: 0.05 * t, lambda t: 3.0, inflow=1.0)
    m.force("lift", lift)
    model = m.build()
    flaps = 0.2
    qd = model.qd.copy()
    # About y of the hub, the blade's tip sinks.
    qd[model.bodies.freedom("root")[1]] = flaps
    at = model.system.at(model.q, qd, time=2.0)

    def force(r):
        return 0.7 * (0.1 + s - (1.0 - flaps * r - 3.0) / (22.0 * r)) * (22.0 * r) ** 2

    total = quad(force, 1.0, 3.0, epsrel=1e-12)[0]
    moment = quad(lambda r: r * force(r), 1.0, 3.0, epsrel=1e-12)[0]
    np.testing.assert_allclose(at.torque[3:6], [0.0, 0.0, -total], atol=1e-10 * total)
    assert at.torque[model.bodies.freedom("root")[1]] == pytest.approx(-moment, rel=1e-12)
    flat = quad(lambda r: 0.7 * (0.1 * 22.0 * r - (1.0 - 3.0 + 0.5)) * 22.0 * r, 1.0, 3.0)[0]
    assert lift.thrust(2.0, 0.5) == pytest.approx(flat, rel=1e-12)
    # Of the pitch at time zero, 1 + 0.5 of inflow and climb.
    pitch = trimmed(lift, 500.0, 0.5)
    assert replace(lift, pitch=lambda t: pitch, gust=lambda t: 0.0).thrust(0.0, 0.5) == pytest.approx(500.0)


@pytest.mark.slow
def test_a_helicopter_is_right():
    found = run("helicopter", quick=True)
    assert found.wrong == () and len(found.checks) == 41
    outcomes = {each.name: each.verdict for each in found.extremes}
    assert {name for name, outcome in outcomes.items() if outcome == "refused"} == {
        "EI times 1e6, explicit",
        "blade struck by 20 kN s at touchdown",
        "legs damped 300 times more, explicit",
        "legs without stiffness",
    }
    own = {"resonance", "touchdown", "gust", "pitch", "run_up", "limits", "legs", "map"}
    assert own | {"gust_on_the_ground", "pitch_on_the_ground", "take_off"} == set(found.tables)
    seen = found.tables["map"].set_index(["by", "value", "sink"])["verdict"]
    assert seen["drift", 6.0, 1.0] == "tips" and seen["rate", 35.0, 3.0] == "leg overload"
    assert seen["rate", 55.0, 1.0] == "resonance" and seen["slope", 4.0, 1.0] == "safe"
    borne = found.tables["legs"].set_index(["case", "blades"])
    # A gust of 5 m/s lifts it off its legs, a pitch of 0.02 rad does not.
    assert (borne.loc["gust on the ground", "leg_min"] == 0.0).all()
    assert (borne.loc["pitch on the ground", "leg_min"] > 100.0).all()
    assert borne["leg_max"].max() < 12e3 and borne.loc[("take-off", "bend"), "in_the_air"] > 0.0
    assert len(found.left_out) == 2 and np.isfinite(found.work["error"]).all()
    landed = found.tables["touchdown"]
    assert landed["legs"].iloc[0] == pytest.approx(4.0 * (3000.0 + 500.0), rel=1e-9)
    assert BLADES == 3 and BLADE.length == RADIUS and RATE == 45.0
