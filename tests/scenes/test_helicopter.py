"""The helicopter: legs, lift, mechanisms in modes, ground resonance; and the whole scene, quick."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp

from bench.scenes import run
from bench.scenes.helicopter import landing, resonance, safety
from bench.scenes.helicopter.legs import Legs
from bench.scenes.helicopter.lift import Lift, Strip
from bench.scenes.helicopter.modes import in_modes
from bench.scenes.helicopter.parts import (
    BLADE,
    BLADES,
    LEGS,
    RADIUS,
    RATE,
    WEIGHT,
    Given,
    build,
    flying,
    settled,
    trimmed,
)  # fmt: skip
from protochain.core.errors import MechanicsError
from protochain.mechanics.motion import DormandPrince, ImplicitMidpoint, Leapfrog, RungeKutta4
from protochain.mechanics.multibody import integrate, mass_matrix, pose
from protochain.mechanisms import Mechanism, Rosenbrock, state_matrix
from protochain.mechanisms.linear import frequencies
from protochain.mechanisms.segments import Beam, add_beam

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


def test_a_block_slides_down_a_slope_as_in_closed_form():
    """In the axes of the ground: g sin less mu g cos, friction regularised; it presses with g cos."""
    slope, mu = 0.7, 0.4
    legs = Legs("block", FEET, 5e4, friction=mu, slip=0.3, slope=slope)
    along, up = np.array([0.0, np.cos(slope), np.sin(slope)]), legs.normal
    turn = np.column_stack([[1.0, 0.0, 0.0], along, up])
    depth = 98.1 * np.cos(slope) / 1.5e5
    model = block(legs, position=3.0 * along - depth * up, rotation=turn)
    np.testing.assert_allclose(legs.forces(model.state()), 98.1 * np.cos(slope) / 3.0, rtol=1e-9)
    moved = model.simulate(1.0, 0.01, DormandPrince(1e-9))
    pull, most = 9.81 * np.sin(slope), mu * 9.81 * np.cos(slope)
    exact = solve_ivp(
        lambda t, v: pull - most * v / np.hypot(v, 0.3), (0, 1.0), [0.0], rtol=1e-11, atol=1e-12
    )
    velocity = model.state(moved.end).velocity("block")
    np.testing.assert_allclose(velocity, -exact.y[0, -1] * along, atol=1e-6)
    assert moved.audit().energy < 1e-7
    # A block off the ground, which is lower downhill, bears nothing.
    away = block(legs, position=3.0 * along + 1e-3 * up, rotation=turn)
    assert np.max(legs.forces(away.state())) == 0.0


def test_a_landing_is_judged_by_what_is_worst():
    fine = safety.Landing(1e3, 1.0)
    for found, growth, said in (
        (fine, 0.0, "safe"), (fine, 0.2, "resonance"), (fine._replace(leg=1.3e4), 0.2, "leg overload"),
        (safety.Landing(1.3e4, 9.0), 0.2, "tips"),
    ):  # fmt: skip
        assert safety.verdict(found, growth) == said


def test_components_of_the_disc_have_constant_coefficients():
    """Eigenvalues of small motions are the same wherever the shaft stands."""
    helicopter, at = safety.standing(55.0, Given(cells=2))
    first = safety.of_small_motions(helicopter, at)[0]
    model = helicopter.model
    # A third of a turn later the next blade is there.
    later = model.system.at(at.q.copy(), at.qd, time=2.0 * np.pi / 3.0 / 55.0)
    q = later.q.copy()
    q[model.bodies.freedom("shaft")[0]] += 2.0 * np.pi / 3.0
    other = safety.of_small_motions(helicopter, model.system.at(q, at.qd, time=later.time))[0]
    assert np.max(other.real) == pytest.approx(np.max(first.real), abs=1e-3)
    # In the blades' own components they are not eigenvalues of what does not turn.
    turning = np.linalg.eigvals(state_matrix(model, at))
    assert np.max(turning.real) != pytest.approx(np.max(first.real), abs=0.1)


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


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"stiffness": 0.0}, "must be above zero"), ({"damping": -1.0}, "not below it"),
        ({"squared": np.nan}, "not below it"), ({"friction": np.inf}, "finite"),
        ({"slip": 0.0}, "slip 0; give a speed"), ({"slope": 1.6}, "slope 1.6; give an"),
        ({"body": "world"}, "the world has none"),
        ({"body": "wheel"}, 'no body "wheel"'),
    ],
)  # fmt: skip
def test_legs_that_are_none_are_refused(fields, words):
    with pytest.raises(MechanicsError, match=words):
        block(Legs(**{"body": "block", "feet": FEET, "stiffness": 1.0, **fields}))


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


def beam_on_a_free_shaft(cells=4, bends="yz", modes=None):
    """A beam with gravity on a free body, whose shaft turns ever more quickly, with a load at its tip."""
    m = Mechanism(gravity=(0.0, 0.0, -9.81))
    m.body("base", 2.0, inertia=(0.3, 0.2, 0.4), spin=(0.1, 0.0, 0.0))
    m.body("shaft", 0.5, inertia=0.1)
    m.hinge("turn", parent="base", child="shaft", at=(0.1, 0.0, 0.2))
    m.drive("turn", lambda t: (2.0 * t + t * t, 2.0 + 2.0 * t, 2.0))
    beam = add_beam(m, "beam", Beam(1.0, 1.0, (3.0, 5.0)), cells, "shaft", bends=bends, damping=0.01)
    m.load("push", *beam.tip, force=lambda t: (0.3, 0.2 * t, 0.5))
    model = m.build()
    about = [[name for name in beam.hinges if name[-1] == axis] for axis in bends]
    return in_modes(model, [(names, modes) for names in about]) if modes is not None else model, about


def test_in_all_modes_a_mechanism_moves_as_without():
    model, _ = beam_on_a_free_shaft()
    all_modes, _ = beam_on_a_free_shaft(modes=4)
    rng = np.random.default_rng(3)
    move, rates = 0.2 * rng.normal(size=(2, model.tree.n_v))
    q = integrate(model.tree, model.q, move)
    both = []
    for each in (model, all_modes):
        at = each.system.at(q, model.qd + rates, time=0.3)
        qdd, loads = each.system.accelerations(0.3, at.q, at.qd, at.torque, at.loads, at.factors)
        both.append((qdd, loads))
    np.testing.assert_allclose(both[1][0], both[0][0], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(both[1][1], both[0][1], rtol=1e-9, atol=1e-9)


def test_in_some_modes_energy_and_work_balance_and_the_rest_is_held():
    model, (about_y, about_z) = beam_on_a_free_shaft(cells=5, modes=2)
    moved = model.simulate(0.5, 0.05, DormandPrince(1e-10))
    assert moved.audit().energy < 1e-9
    assert set(model.works) == {"damping", "push", "drives"} and np.abs(moved.work[-1]).min() > 1e-3
    for names in (about_y, about_z):
        q = moved.q[:, [model.bodies.freedom(name)[0] for name in names]]
        sizes = np.linalg.svd(q)[1]
        assert sizes[1] > 1e-6 and sizes[2] < 1e-12
    # The accelerations solve the projected equations, with M of all hinges.
    at = moved.end
    qdd, _ = model.system.accelerations(at.time, at.q, at.qd, at.torque, at.loads, at.factors)
    mass = mass_matrix(model.tree, pose(model.tree, at.q))
    more = at.torque + 0.1 * mass @ model.directions[:, 0]
    quicker, _ = model.system.accelerations(at.time, at.q, at.qd, more, at.loads, at.factors)
    np.testing.assert_allclose(quicker - qdd, 0.1 * model.directions[:, 0], atol=1e-10)


def test_modes_are_those_of_the_beam_that_is_held():
    """Clamped, the lowest frequencies stay to the last digit, and no others are left."""
    m = Mechanism()
    beam = add_beam(m, "beam", Beam(1.0, 1.0, 2.0), 6)
    model = m.build()
    reduced = in_modes(model, [(beam.hinges, 2)])
    assert reduced.directions.shape == (6, 2)
    np.testing.assert_allclose(frequencies(reduced), frequencies(model)[:2], rtol=1e-8)
    held = in_modes(model, [(beam.hinges[:1], 1), (beam.hinges[1:], 0)])
    assert held.directions.shape == (6, 1) and np.flatnonzero(held.directions).tolist() == [0]


def test_modes_that_cannot_be_are_refused():
    m = Mechanism()
    beam = add_beam(m, "beam", Beam(1.0, 1.0, 2.0), 3, joint={"axis": (0, 0, 1), "qd": 1.0})
    model = m.build()
    for groups, words in (
        ([(beam.hinges, 4)], "4 modes of 3 hinges"), ([(beam.hinges, 1.5)], "1.5 modes"),
        ([(beam.hinges, 1), (beam.hinges[:1], 1)], 'hinge "beam 1z" cannot be in a group'),
        ([(["beam"], 1)], 'hinge "beam" has no spring'), ([(["odd"], 1)], 'no hinge "odd"'),
    ):  # fmt: skip
        with pytest.raises(MechanicsError, match=words):
            in_modes(model, groups)
    reduced = in_modes(model, [(beam.hinges, 1)])
    for integrator in (Leapfrog(), ImplicitMidpoint()):
        with pytest.raises(MechanicsError, match="takes no bodies that bend; take Runge"):
            reduced.simulate(0.01, 0.01, integrator)
    both = [reduced.simulate(0.1, 1e-3, each).end.q for each in (RungeKutta4(), Rosenbrock())]
    np.testing.assert_allclose(both[1], both[0], atol=1e-6)
    m.torsion("damper", "beam 1z", damping=0.1)
    m.hinge("end", parent=beam.tip[0], child="weight", at=beam.tip[1], qd=1.0)
    m.body("weight", 1.0, com=(0.1, 0, 0), inertia=0.1)
    m.torsion("spring", "end", stiffness=1.0)
    with pytest.raises(MechanicsError, match="otherwise than in their modes"):
        in_modes(m.build(), [((*beam.hinges, "end"), 1)])


def test_hub_and_blades_have_the_states_they_are_given():
    """In and out of Fourier's components of the lag, and the energies of hub and blades."""
    rotor = resonance.HAMMOND
    model = resonance.build(rotor, 25.0)
    given = np.array([0.01, -0.02, 0.03, 0.015, 0.4, 0.3, -0.2, 0.1])
    at = resonance.start(model, rotor, 25.0, given)
    found = resonance.states(model, rotor, 25.0, at.q[None], at.qd[None])[0]
    np.testing.assert_allclose(found, given, rtol=1e-12)
    for k in range(4):
        # A blade's second moment about its hinge, and what all of it weighs.
        b = model.bodies.number(f"blade {k}")
        assert model.tree.inertia[b, 2, 2] + 94.9 * (289.1 / 94.9) ** 2 == pytest.approx(1084.7)
    assert model.tree.mass.sum() == pytest.approx(8026.6 + 4 * 94.9)


def test_ground_resonance_grows_as_hammond_has_it():
    rotor = resonance.HAMMOND
    bare = replace(rotor, lag_damping=0.0)
    for of, rpm, known in ((rotor, 250.0, -0.33), (bare, 258.0, 1.03)):
        rate = rpm * resonance.RPM
        exact = np.sort(resonance.eigenvalues(of, rate)[0].real)
        assert exact[-1] == pytest.approx(known, abs=0.005)
        assert resonance.growth(resonance.simulated(of, rate, 3)) == pytest.approx(exact[-1], rel=0.01)
    np.testing.assert_allclose(resonance.multipliers(bare, rate, 32), exact, atol=1e-4)
    # Five blades as three with five thirds of their mass: the hub feels the sum of their moments only.
    more = replace(bare, blades=5, mass=94.9 * 0.8, first=289.1 * 0.8, second=1084.7 * 0.8)
    np.testing.assert_allclose(np.sort(resonance.eigenvalues(more, rate)[0].real), exact, atol=1e-10)
    assert resonance.growth(resonance.simulated(more, rate, 3)) == pytest.approx(exact[-1], rel=0.01)


def test_a_helicopter_settles_in_the_air_and_on_the_ground():
    given = Given(cells=2)
    standing = build(given)
    at = settled(standing.model, (0.0, 0.0, 0.0), 0.05)
    assert np.sum(LEGS.forces(standing.model.state(at))) == pytest.approx(WEIGHT, rel=1e-10)
    flown = flying(replace(given, legs=None), 0.5, -1.0)
    assert flown.lift.thrust(0.0, -1.0) == pytest.approx(0.5 * WEIGHT, rel=1e-12)
    at = settled(flown.model, (1.0, 0.0, -1.0))
    qdd, _ = flown.model.system.accelerations(0.0, at.q, at.qd, at.torque, at.loads, at.factors)
    np.testing.assert_allclose(qdd[flown.model.tree.undriven_v][-12:], 0.0, atol=1e-8)
    # Blades that cone lift a little less: twist is none, as lift acts on the axis.
    assert qdd[5] == pytest.approx(-0.5 * 9.81, rel=0.01)
    state = flown.model.state(at)
    np.testing.assert_allclose(state.velocity("fuselage"), [1.0, 0.0, -1.0], atol=1e-12)
    for blade in flown.blades:
        assert state.point(*blade.tip)[2] - state.point("hub")[2] > 0.05


def test_the_oscillator_solves_its_equation_also_where_it_creeps():
    for k, c in ((2.4e5, 1.2e4), (2.4e5, 4e5)):
        times = np.linspace(0.0, 0.2, 50)
        depth, force = landing.oscillator(times, k, c, 900.0, 1.5, 4000.0, 1200.0)

        def rates(t, y, k=k, c=c):
            return [y[1], (4000.0 + 900.0 * (1.5 - y[1]) - c * y[1] - k * y[0]) / 1200.0]

        fine = {"t_eval": times, "rtol": 1e-11, "atol": 1e-12}
        exact = solve_ivp(rates, (0, 0.2), [0.0, 1.5], method="LSODA", **fine).y
        np.testing.assert_allclose(depth, exact[0], atol=1e-8)
        np.testing.assert_allclose(force, k * exact[0] + c * exact[1], rtol=1e-6, atol=1e-2)


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
