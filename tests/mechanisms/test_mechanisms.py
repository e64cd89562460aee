"""Mechanisms by name, against closed forms, scipy's integrators and finite differences."""

import numpy as np
import pytest
from fixtures.pendulum import DOWN, G, pendulum
from fixtures.tolerances import AUDITED, ELEMENT_DIFFERENCE, ROUND_OFF
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from protochain.core.errors import MechanicsError
from protochain.mechanics import multibody
from protochain.mechanics.motion import (
    Applied,
    DormandPrince,
    Load,
    RungeKutta4,
)  # fmt: skip
from protochain.mechanisms import Acting, Bushing, Mechanism, Named, Spring, Torsion
from protochain.mechanisms.assemble import Hinge
from protochain.mechanisms.elements import Sum
from protochain.mechanisms.model import _Simulation

ORIGIN = (0.0, 0.0, 0.0)


def crowd(seed, free=True):
    """Six bodies in a tree of all kinds of hinges, with axes and places of any direction."""
    rng = np.random.default_rng(seed)
    m = Mechanism(gravity=rng.normal(size=3))
    kinds = ("revolute", "prismatic", "screw", "fixed", "revolute")
    for i in range(6):
        inertia = 0.1 * np.diag(1.0 + rng.random(3))
        turn = Rotation.random(random_state=seed + i).as_matrix()
        more = {"position": rng.normal(size=3), "rotation": turn} if i == 0 and free else {}
        m.body(f"b{i}", 1.0 + rng.random(), 0.3 * rng.normal(size=3), turn @ inertia @ turn.T, **more)
        if i == 0 and free:
            continue
        parent = f"b{rng.integers(i)}" if i else "world"
        kind = kinds[(i - 1) % 5]
        more = {} if kind == "fixed" else {"q": rng.normal(), "qd": rng.normal()}
        if kind == "screw":
            more["pitch"] = 0.3
        m.hinge(f"h{i}", parent, f"b{i}", kind, rng.normal(size=3), rng.normal(size=3), turn, **more)
    return m


# --- The builder's frames


def test_a_hinges_axes_and_places_are_those_of_the_parent():
    """A door on a vertical axis through (1, 2, 3) in a wall turned by a quarter."""
    wall = Rotation.from_euler("z", 90, degrees=True).as_matrix()
    m = Mechanism()
    m.body("wall", 1.0, inertia=1.0)
    m.hinge("wall", "world", "wall", "fixed", at=(0, 0, 1), rotation=wall)
    m.body("door", 1.0, com=(0.5, 0, 0), inertia=1.0)
    m.hinge("door", "wall", "door", at=(1, 2, 3), axis=(0, 0, 5), q=np.radians(30.0), qd=2.0)
    state = m.build().state()
    assert np.allclose(state.point("door"), wall @ (1, 2, 3) + (0, 0, 1))
    turned = Rotation.from_euler("z", 120, degrees=True).as_matrix()
    assert np.allclose(state.rotation("door"), turned)
    assert np.allclose(state.velocity("door", (0.5, 0, 0)), 2.0 * np.cross((0, 0, 1), turned @ (0.5, 0, 0)))
    assert np.allclose(state.spin("door"), (0, 0, 2))
    assert (state.angle("door"), state.rate("door")) == (np.radians(30.0), 2.0)


@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (0, 0, -1), (1, -2, 3), (1e-9, 0, 1)])
@pytest.mark.parametrize("kind", ["revolute", "prismatic", "screw"])
def test_a_body_moves_along_its_axis_in_its_own_axes(axis, kind):
    """Chasles: R at + slide along the axis; com and inertia are those given, whatever the axis."""
    unit, q = np.array(axis) / np.linalg.norm(axis), 0.7
    inertia, com = np.diag([0.3, 0.4, 0.5]), np.array([0.1, 0.2, 0.3])
    turn = Rotation.from_rotvec([0.4, -0.2, 0.9]).as_matrix()
    m = Mechanism()
    m.body("b", 2.0, com, inertia)
    pitch = {"pitch": 0.25} if kind == "screw" else {}
    m.hinge("h", "world", "b", kind, (1, 2, 3), axis, turn, q=q, qd=1.0, **pitch)
    model = m.build()
    state = model.state()
    angle = q if kind != "prismatic" else 0.0
    slide = {"revolute": 0.0, "prismatic": q, "screw": 0.25 * q}[kind]
    wanted = Rotation.from_rotvec(angle * unit).as_matrix() @ turn
    assert np.allclose(state.rotation("b"), wanted, atol=1e3 * ROUND_OFF)
    assert np.allclose(state.point("b"), np.array([1, 2, 3]) + slide * unit)
    turning, sliding = {"revolute": (1, 0), "prismatic": (0, 1), "screw": (1, 0.25)}[kind]
    u = sliding * unit + turning * np.cross(unit, wanted @ com)
    spin = wanted.T @ (turning * unit)
    assert model.start().kinetic == pytest.approx(0.5 * 2.0 * u @ u + 0.5 * spin @ inertia @ spin)


def test_a_free_body_starts_where_and_as_it_is_told():
    turn = Rotation.from_rotvec([2.0, -1.0, 2.0]).as_matrix()
    m = Mechanism()
    m.body("b", 2.0, (0.1, 0, 0), 1.0, (1, 2, 3), turn, velocity=(4, 5, 6), spin=(7, 8, 9))
    state = m.build().state()
    assert np.allclose(state.rotation("b"), turn)
    assert np.allclose(state.point("b", (1, 1, 1)), (1, 2, 3) + turn @ (1, 1, 1))
    assert np.allclose(state.velocity("b"), (4, 5, 6))
    assert np.allclose(
        state.velocity("b", (1, 1, 1)), np.array([4, 5, 6]) + np.cross((7, 8, 9), turn @ (1, 1, 1))
    )


def test_a_model_is_not_changed_by_its_builder():
    m = pendulum()
    model = m.build()
    m.body("more", 1.0)
    m.torsion("t", "pin", stiffness=5.0)
    assert model.tree.n_bodies == 1 and len(model.conservative) == 1
    with pytest.raises(ValueError, match="read-only"):
        model.q[0] = 1.0


# --- Energy and forces


def elements(m, rng):
    """One or more of each kind, on the bodies of :func:`crowd`."""

    def point():
        return 0.5 * rng.normal(size=3)

    m.spring("s1", ("b1", point()), ("b4", point()), stiffness=7.0, rest=0.4, damping=0.7)
    m.spring("s2", ("world", point()), ("b5", point()), stiffness=3.0, rest=0.0, damping=0.2)
    m.spring("s3", ("b2", point()), ("b3", point()), stiffness=2.0)
    m.torsion("t1", "h1", stiffness=3.0, rest=0.3, damping=0.4)
    m.torsion("t2", "h2", stiffness=1.0, rest=None, damping=0.3)
    m.torsion("t3", "h1", stiffness=0.5)
    m.bushing("u1", ("b0", point()), ("b5", point()), stiffness=1.0 + rng.random(6), damping=rng.random(6))
    m.bushing("u2", ("world", point()), ("b3", point()), stiffness=1.0 + rng.random(6), damping=0.1)
    m.bushing("u3", ("b4", point()), ("world", point()), stiffness=1.0 + rng.random(6))


def gradient(model, q):
    """Minus the gradient of the energy along the freedoms, by central differences."""
    tree, system = model.tree, model.system

    def energy(q):
        return system.potential(q, system.factors(q))[0]

    steps = 1e-6 * np.eye(tree.n_v)
    return np.array(
        [
            (energy(multibody.integrate(tree, q, -s)) - energy(multibody.integrate(tree, q, s))) / 2e-6
            for s in steps
        ]
    )


@pytest.mark.parametrize("free", [True, False])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_forces_are_minus_the_gradient_of_the_energy(seed, free):
    m, rng = crowd(seed, free), np.random.default_rng(seed)
    elements(m, rng)
    model = m.build()
    q = multibody.integrate(model.tree, model.q, 0.5 * rng.normal(size=model.tree.n_v))
    for part in model.conservative:
        torques = Sum(model.tree, [part])(q, model.system.factors(q))[1]
        alone = gradient(_with_only(model, part), q)
        assert np.allclose(torques, alone, atol=ELEMENT_DIFFERENCE * np.linalg.norm(alone))
    torques = model.system.potential(q, model.system.factors(q))[1]
    assert np.linalg.norm(torques) > 1.0


def _with_only(model, part):
    from dataclasses import replace

    return replace(model, conservative=(part,))


def test_elements_of_a_kind_are_one_and_their_sums_the_same_in_whatever_order_of_kinds():
    rng = np.random.default_rng(4)
    ends = [((f"b{k}", rng.normal(size=3)), ("world", rng.normal(size=3))) for k in range(3)]
    elements = [Spring(f"s{k}", *end, 1.0 / 3.0, damping=0.1) for k, end in enumerate(ends)]
    elements += [Torsion(f"t{k}", f"h{k}", 0.7, 0.1) for k in range(3)]
    elements += [Bushing(f"u{k}", *end, 0.9, 0.3) for k, end in enumerate(ends)]
    starts = []
    for order in (elements, elements[3:] + elements[:3], elements[6:] + elements[3:6] + elements[:3]):
        m = Mechanism(DOWN)
        for k in range(3):
            m.body(f"b{k}", 1.0, inertia=1.0)
            m.hinge(
                f"h{k}", f"b{k - 1}" if k else "world", f"b{k}", axis=(1, k, 0), at=(0.3, 0, 0), q=0.2, qd=1.0
            )
        for element in order:
            m.add(element)
        model = m.build()
        assert (len(model.conservative), model.works) == (4, ("damping",))
        starts.append(model.system.at(model.q + 0.3, model.qd))
    assert all(np.array_equal(at.torque, starts[0].torque) for at in starts)
    assert len({at.potential for at in starts}) == 1


def test_energies_are_those_of_their_definitions():
    """Of two springs, two torsions, a bushing and weight at once: the sum, to rounding."""
    m = Mechanism(gravity=(0.0, -2.0, -9.0))
    m.body("rod", 2.0, (0, 0, -0.5), 0.1)
    m.hinge("pin", "world", "rod", at=(0, 0, 3.0), axis=(0, 1, 0), q=np.pi / 2)  # along the world's -x
    m.body("ball", 3.0, inertia=1.0, position=(1.0, 2.0, 3.0))
    m.spring("long", ("rod", (0, 0, -1.0)), ("ball", ORIGIN), stiffness=5.0, rest=0.5)
    m.spring("slack", ("world", ORIGIN), ("ball", ORIGIN), stiffness=7.0, rest=4.0)
    m.torsion("t1", "pin", stiffness=3.0, rest=0.5)
    m.torsion("t2", "pin", stiffness=2.0)
    m.bushing("u", ("ball", ORIGIN), ("world", (0, 2.0, 1.0)), stiffness=(1, 1, 1, 10, 20, 30))
    weight = 2.0 * 9.0 * 3.0 + 3.0 * (2.0 * 2.0 + 9.0 * 3.0)
    springs = 2.5 * (np.sqrt(8.0) - 0.5) ** 2 + 3.5 * (np.sqrt(14.0) - 4.0) ** 2
    torsions = 1.5 * (np.pi / 2 - 0.5) ** 2 + 1.0 * (np.pi / 2) ** 2
    bushing = 5.0 * 1.0 + 15.0 * 4.0
    start = m.build().start()
    assert start.potential == pytest.approx(weight + springs + torsions + bushing, rel=ROUND_OFF)


@pytest.mark.parametrize("angle", [1e-9, 1e-3, 0.099, 0.101, 1.0, 2.0, 3.0, 3.09])
def test_a_bushing_is_conservative_for_large_rotations(angle):
    """Energy of the rotation vector in b's axes, from scipy; moments are its gradient."""
    rng = np.random.default_rng(5)
    turn_b, rest = (Rotation.from_rotvec(v) for v in rng.normal(size=(2, 3)))
    axis = np.array([1.0, -2.0, 3.0]) / np.sqrt(14.0)
    k = np.array([2.0, 5.0, 9.0, 1.0, 2.0, 3.0])

    def made(relative):
        """Built with a turned by ``rest`` in b; then a is turned away by ``relative``, in b's axes."""
        m = Mechanism()
        m.body("a", 1.0, inertia=1.0, position=(0.3, 0, 0), rotation=(turn_b * rest).as_matrix())
        m.body("b", 1.0, inertia=1.0, rotation=turn_b.as_matrix())
        m.bushing("u", ("a", (0.1, 0.2, 0.3)), ("b", (0, 0.2, 0)), stiffness=k)
        model = m.build()
        along = turn_b.apply(relative)
        return model, multibody.integrate(model.tree, model.q, np.array([*along, *np.zeros(9)]))

    model, q = made(angle * axis)
    state = model.system.at(q, np.zeros(12))
    a, b = model.state(state).point("a", (0.1, 0.2, 0.3)), model.state(state).point("b", (0, 0.2, 0))
    d = turn_b.inv().apply(a - b)
    wanted = 0.5 * (k[:3] @ (angle * axis) ** 2 + k[3:] @ d**2)
    assert state.potential == pytest.approx(wanted, rel=1e-12, abs=1e-15)
    # A nudge keeps the rotation below half a turn.
    assert np.allclose(state.torque, gradient(model, q), atol=ELEMENT_DIFFERENCE * 20.0)


def test_dampers_take_what_their_definitions_say():
    """Springs c (dl/dt)^2, torsions c qd^2, bushings c times rates in b's axes squared."""
    m, rng = crowd(4), np.random.default_rng(4)
    elements(m, rng)
    model = m.build()
    qd = rng.normal(size=model.tree.n_v)
    at = model.system.at(model.q, qd)
    state, h = model.state(at), 1e-6
    after, before = (
        model.state(model.system.at(multibody.integrate(model.tree, at.q, s * qd), qd)) for s in (h, -h)
    )
    taken = 0.0
    rng = np.random.default_rng(4)
    points = [[0.5 * rng.normal(size=3) for _ in range(2)] for _ in range(3)]
    for (a, b), (p, r), c in zip(
        (("b1", "b4"), ("world", "b5"), ("b2", "b3")), points, (0.7, 0.2, 0.0), strict=True
    ):
        lengths = [np.linalg.norm(s.point(a, p) - s.point(b, r)) for s in (after, before)]
        taken += c * ((lengths[0] - lengths[1]) / (2 * h)) ** 2
    taken += 0.4 * state.rate("h1") ** 2 + 0.3 * state.rate("h2") ** 2
    p, r, _, c = 0.5 * rng.normal(size=3), 0.5 * rng.normal(size=3), rng.random(6), rng.random(6)
    taken += _taken_by_bushing(state, after, before, "b0", "b5", p, r, c, h)
    p, r, _ = 0.5 * rng.normal(size=3), 0.5 * rng.normal(size=3), rng.random(6)
    taken += _taken_by_bushing(state, after, before, "world", "b3", p, r, np.full(6, 0.1), h)
    assert model.works == ("damping",)
    assert at.power[0] == pytest.approx(-taken, rel=1e-6)


def _taken_by_bushing(state, after, before, a, b, p, r, c, h):
    d = [s.rotation(b).T @ (s.point(a, p) - s.point(b, r)) for s in (after, before)]
    rates = np.array([*state.rotation(b).T @ (state.spin(a) - state.spin(b)), *(d[0] - d[1]) / (2 * h)])
    return c @ rates**2


def test_a_spring_of_no_length_passes_through_itself():
    """rest=0: harmonic in space, and its damper at no length takes the whole velocity."""
    m = Mechanism()
    m.body("a", 1.0, velocity=(3.0, 0.0, 0.0), inertia=1e-3)
    m.spring("s", ("a", (0, 0, 0)), ("world", (0, 0, 0)), stiffness=16.0, damping=1.0)
    run = m.build().simulate(2.0, 1e-3)
    omega = np.sqrt(16.0 - 0.25)
    wanted = 3.0 / omega * np.exp(-0.5 * run.time) * np.sin(omega * run.time)
    assert np.allclose(run.q[:, 4], wanted, atol=1e-9)
    assert run.audit().energy < AUDITED


def test_a_spring_with_a_length_at_rest_and_none_as_built_is_refused():
    m = Mechanism()
    m.body("a", 1.0, inertia=1.0)
    m.spring("s", ("a", (0, 0, 0)), ("world", (0, 0, 0)), stiffness=1.0, rest=1.0)
    with pytest.raises(MechanicsError, match=r'spring "s": its ends coincide as built.*rest=0'):
        m.build()


# --- Motion


def double_pendulum(t, y, m=(1.0, 2.0), length=(1.0, 0.7)):
    """Textbook: two points on rods without mass, absolute angles from the vertical."""
    a, b, u, w = y
    (m1, m2), (l1, l2) = m, length
    c, s = np.cos(a - b), np.sin(a - b)
    matrix = np.array([[(m1 + m2) * l1, m2 * l2 * c], [l1 * c, l2]])
    right = np.array([
        -m2 * l2 * w**2 * s - (m1 + m2) * G * np.sin(a), l1 * u**2 * s - G * np.sin(b)
    ])  # fmt: skip
    return [u, w, *np.linalg.solve(matrix, right)]


def test_a_double_pendulum_moves_as_the_textbook_says():
    m = Mechanism(gravity=DOWN)
    m.body("one", 1.0, com=(0, 0, -1.0))
    m.body("two", 2.0, com=(0, 0, -0.7))
    # A turn about -y lifts a rod that hangs down towards +x.
    m.hinge("pin", "world", "one", axis=(0, -1, 0), q=1.2, qd=0.5)
    m.hinge("elbow", "one", "two", at=(0, 0, -1.0), axis=(0, -1, 0), q=0.9, qd=-1.0)
    run = m.build().simulate(2.0, 0.02, DormandPrince(1e-11))
    exact = solve_ivp(
        double_pendulum, (0, 2), [1.2, 2.1, 0.5, -0.5], "DOP853", t_eval=run.time[:-1], rtol=1e-13, atol=1e-13
    )
    assert np.allclose(run.q[:-1].cumsum(axis=1), exact.y[:2].T, atol=1e-8)
    assert np.allclose(run.qd[:-1].cumsum(axis=1), exact.y[2:].T, atol=1e-8)
    assert run.audit().energy < AUDITED
    tip = m.build().state().point("two", (0, 0, -0.7))
    assert np.allclose(tip, [np.sin(1.2) + 0.7 * np.sin(2.1), 0, -np.cos(1.2) - 0.7 * np.cos(2.1)])


def test_a_free_system_keeps_momentum_and_spin_whatever_holds_it_together():
    m = Mechanism()
    m.body("a", 1.0, (0.1, 0, 0), 0.2, velocity=(1, 2, 3), spin=(1, 0, -1))
    m.body("b", 2.0, (0, 0.1, 0), 0.3, position=(1, 0, 0))
    m.body("c", 0.5, (0, 0, 0.2), 0.1)
    m.hinge("h", "b", "c", "screw", (0.5, 0, 0), (1, 1, 0), pitch=0.2, qd=1.0)
    m.spring("s", ("a", (0.2, 0, 0)), ("c", (0, 0.1, 0)), stiffness=20.0, damping=1.0)
    m.bushing("u", ("a", (0.5, 0, 0)), ("b", (-0.4, 0.1, 0)), stiffness=(3, 4, 5, 20, 30, 10), damping=0.3)
    m.torsion("t", "h", stiffness=2.0, damping=0.1)
    m.torque("motor", "h", lambda t: np.sin(3.0 * t))
    run = m.build().simulate(1.0, 1e-3)
    audit = run.audit()
    assert audit.energy < AUDITED
    assert max(audit.momentum, audit.spin) < 1e-10
    assert list(run.table.columns[4:8]) == ["work damping", "work motor", "dissipation", "events"]
    assert run.table["dissipation"].is_monotonic_increasing


@pytest.mark.parametrize("outside", ["gravity", "hinge", "spring", "load"])
def test_momentum_is_not_audited_where_something_acts_from_outside(outside):
    m = Mechanism(DOWN if outside == "gravity" else (0, 0, 0))
    m.body("a", 1.0, inertia=1.0)
    if outside == "hinge":
        m.hinge("h", "world", "a")
    if outside == "spring":
        m.spring("s", ("world", (1, 0, 0)), ("a", (0, 0, 0)), 1.0)
    if outside == "load":
        m.load("push", "a", force=(0, 0, 1))
    assert m.build().simulate(0.02, 0.01).audit().momentum is None


def test_a_drive_does_the_work_that_the_mechanism_gains():
    """A pendulum on a cart that is shaken: energy is the drive's work; the force is what Newton says."""
    m = pendulum(q=0.4)
    m.body("cart", 3.0)
    m._parts[Hinge].clear()
    m.hinge("rail", "world", "cart", "prismatic", axis=(1, 0, 0))
    m.hinge("pin", "cart", "rod", axis=(0, -1, 0), q=0.4)
    a, w = 0.2, 6.0
    m.drive("rail", lambda t: (a * np.sin(w * t), a * w * np.cos(w * t), -a * w * w * np.sin(w * t)))
    run = m.build().simulate(1.0, 1e-3)

    def rates(t, y):
        shake = -a * w * w * np.sin(w * t)
        return [y[1], -1.5 * (G * np.sin(y[0]) + shake * np.cos(y[0]))]

    exact = solve_ivp(rates, (0, 1), [0.4, 0.0], "DOP853", rtol=1e-13, atol=1e-13).y[:, -1]
    assert np.allclose([run.q[-1, 1], run.qd[-1, 1]], exact, atol=1e-9)
    assert run.q[-1, 0] == a * np.sin(w)
    assert run.model.works == ("drives",)
    assert abs(run.work[-1, 0]) > 0.1
    assert run.audit().energy < AUDITED


def test_a_torsion_on_a_driven_hinge_loads_its_drive():
    """The spring's energy comes from the drive, and the motion beyond is not touched."""
    m = pendulum(q=0.0)
    m.drive("pin", lambda t: (0.5 * t * t, t, 1.0))
    bare = m.build().simulate(1.0, 0.01)
    m.torsion("t", "pin", stiffness=8.0)
    run = m.build().simulate(1.0, 0.01)
    assert np.array_equal(run.q, bare.q)
    assert run.work[-1, 0] - bare.work[-1, 0] == pytest.approx(0.5 * 8.0 * 0.25, abs=1e-9)


def test_loads_do_work_each_by_itself():
    """A ball pushed by a constant force and turned by a moment, and a follower force of its state."""
    m = Mechanism()
    m.body("ball", 2.0, inertia=0.5)
    m.load("push", "ball", force=(4.0, 0, 0))
    m.load("turn", "ball", moment=lambda t: (0, 0, 3.0 * t))
    m.load("drag", "ball", force=lambda t, s: -0.5 * s.velocity("ball"))
    run = m.build().simulate(1.0, 1e-3)
    speed = 8.0 * (1.0 - np.exp(-0.25 * run.time))
    assert np.allclose(run.qd[:, 3], speed, atol=1e-10)
    assert np.allclose(run.qd[:, 2], 3.0 * run.time**2, atol=1e-10)
    table = run.table
    assert table["work turn"].iloc[-1] == pytest.approx(0.25 * 9.0)
    assert table["work push"].iloc[-1] == pytest.approx(4.0 * (8.0 - 32.0 * (1.0 - np.exp(-0.25))))
    assert table["work drag"].iloc[-1] < 0.0
    assert table["dissipation"].iloc[-1] == 0.0
    assert run.audit().energy < AUDITED


def test_the_row_looked_at_last_is_that_whose_energy_differs_most_by_more_than_work():
    m = pendulum(q=1.0)
    m.torque("motor", "pin", lambda t: 3.0 * np.sin(3.0 * t))
    model = m.build()
    followed = _Simulation(model, model.start(), RungeKutta4(), 0.05, 1, np.inf)
    run = followed.run(6.0)
    lack = run.kinetic + run.potential - run.work[:, 0]
    assert followed.worst == np.argmax(np.abs(lack - lack[0])) not in (0, len(lack) - 1)


@pytest.mark.parametrize(
    ("value", "turned"),
    [(3.0, 0.75), (lambda t: 6.0 * t, 0.5), (lambda t, s: 8.0 * np.cos(s.t) - 2.0 * s.rate("pin"), None)],
)
def test_a_torque_turns_its_hinge(value, turned):
    """I qdd = tau with I = 2: constant, of the time, of time and state; its work is the energy."""
    m = Mechanism()
    m.body("wheel", 1.0, inertia=(1, 1, 2.0))
    m.hinge("pin", "world", "wheel")
    m.torque("motor", "pin", value)
    run = m.build().simulate(1.0, 1e-2)
    if turned is None:
        # qd' = 4 cos t - qd from rest: qd = 2 (cos t + sin t - e^-t).
        turned = 2.0 * (np.sin(1.0) - np.cos(1.0) + np.exp(-1.0))
    assert run.q[-1, 0] == pytest.approx(turned, rel=1e-8)
    assert run.table["work motor"].iloc[-1] == pytest.approx(run.kinetic[-1], rel=1e-6)


def test_a_force_off_the_centre_acts_at_its_point_along_world_axes():
    turn = Rotation.from_euler("z", 90, degrees=True).as_matrix()
    m = Mechanism()
    m.body("plate", 1.0, com=(0.1, 0, 0), inertia=1.0, rotation=turn)
    m.load("push", "plate", at=(0.5, 0, 0), force=(2.0, 0, 0), moment=(0, 0, 7.0))
    torque = m.build().start().torque
    assert np.allclose(torque, [0, 0, -0.5 * 2.0 + 7.0, 2.0, 0, 0])


@pytest.mark.parametrize("named", [False, True])
def test_elements_of_the_user_act_and_are_counted(named):
    """A force by names: conservative part and a drag whose work is dissipation."""

    class Well(Named):
        def bind(self, bodies):
            b = bodies.number("ball", "well")

            class Energy:
                def add(self, q, frames, wrenches, torques):
                    x = frames.origin[b]
                    wrenches[b, 3:] -= 4.0 * x
                    return 2.0 * float(x @ x)

            def drag(time, q, qd, frames):
                wrenches = np.zeros((bodies.tree.n_bodies, 6))
                wrenches[b, 3:] = -0.5 * qd[3:]
                return Applied(wrenches)

            return Acting(Energy(), Load(drag), dissipates=True)

    m = Mechanism()
    m.body("ball", 1.0, inertia=1e-3, position=(1, 0, 0))
    if named:
        m.add(Well("well"))
    else:
        m.force("well", Well("part"))
    run = m.build().simulate(1.0, 1e-3)
    omega = np.sqrt(4.0 - 1.0 / 16.0)
    wanted = np.exp(-0.25 * run.time) * (np.cos(omega * run.time) + 0.25 / omega * np.sin(omega * run.time))
    assert np.allclose(run.q[:, 4], wanted, atol=1e-9)
    assert run.table["dissipation"].iloc[-1] == pytest.approx(run.total[0] - run.total[-1], abs=1e-9)
