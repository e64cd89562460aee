"""Joints that close loops: the motion of hinges, other programs, redundant rows, refusals."""

import numpy as np
import pytest
from fixtures.refusals import expect_refusal
from fixtures.tolerances import AUDITED
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from protochain.core.errors import Fault, MechanicsError
from protochain.mechanics import multibody
from protochain.mechanics.motion import DormandPrince, ImplicitMidpoint, Leapfrog, RungeKutta4
from protochain.mechanisms import Mechanism, Rosenbrock
from protochain.mechanisms.assemble import Hinge
from protochain.mechanisms.closing import Closing
from protochain.mechanisms.impacts import ContactPoint, impact

G = 9.81
PRECISE = DormandPrince(1e-10)
CLOSED = 1e-11
"""Of loops after a step: the bar is 1e-12 of the size, and the audit finds its own rounding beside it."""
SAME = 1e-7
"""Of motions by two routes: errors of 1e-10 a step in some hundred steps."""


def bar(m, name, start, end, **more):
    """A rod along its length, with its origin at the start."""
    along = np.subtract(end, start)
    length = float(np.linalg.norm(along))
    m.body(name, length, com=along / 2.0, inertia=length**3 / 12.0, **more)


def four_bar(kind="revolute", last="rocker", **more):
    m = Mechanism(gravity=(0, 0, -G))
    a, b, c, d = (np.array(x) for x in ((0.0, 0, 0), (0.0, 0, 1.0), (2.0, 0, 1.5), (2.0, 0, 0)))
    for name, start, end in (("crank", a, b), ("coupler", b, c), ("rocker", d, c)):
        bar(m, name, start, end)
    m.hinge("A", "world", "crank", axis=(0, 1, 0), qd=3.0)
    m.hinge("B", "crank", "coupler", axis=(0, 1, 0), at=b - a)
    m.hinge("D", "world", "rocker", axis=(0, 1, 0), at=d)
    m.close("C", ("coupler", c - b), (last, c - d), kind, axis=(0, 1, 0), **more)
    return m


def test_a_four_bar_moves_as_mujoco_says():
    mujoco = pytest.importorskip("mujoco")

    def body(length):
        return f'mass="{length}" diaginertia="{" ".join([str(length**3 / 12.0)] * 3)}"'

    step = 2e-4
    model = mujoco.MjModel.from_xml_string(f"""<mujoco>
      <option timestep="{step}" gravity="0 0 {-G}" integrator="RK4"><flag contact="disable"/></option>
      <worldbody>
        <body><joint axis="0 1 0"/><inertial pos="0 0 0.5" {body(1.0)}/>
          <body name="c" pos="0 0 1"><joint axis="0 1 0"/>
            <inertial pos="1 0 0.25" {body(np.hypot(2.0, 0.5))}/></body></body>
        <body name="r" pos="2 0 0"><joint axis="0 1 0"/><inertial pos="0 0 0.75" {body(1.5)}/></body>
      </worldbody>
      <equality><connect body1="c" body2="r" anchor="2 0 0.5" solref="{2 * step} 1"
        solimp="0.9999 0.9999 0.001"/></equality></mujoco>""")
    data = mujoco.MjData(model)
    data.qvel[:] = 3.0, -3.0, 2.0
    mujoco.mj_step(model, data, round(1.0 / step))
    run = four_bar().build().simulate(1.0, 0.5, PRECISE)
    # Its loops give way a little: the error falls with the step, and is 5e-9 here.
    assert np.allclose(run.q[-1], data.qpos, atol=1e-6)


@pytest.mark.parametrize("kind", ["revolute", "prismatic", "rigid"])
def test_a_free_body_that_a_joint_closes_moves_as_on_a_hinge(kind):
    """A double pendulum in space: the second rod on a hinge of the tree, or free and closed to the first."""
    axis, tilt = (0.3, 1.0, -0.2), np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]])
    lever = (0.1, 0.2, -1.0)

    def begun(**place):
        m = Mechanism(gravity=(0, 0, -G))
        bar(m, "upper", (0, 0, 0), lever)
        m.hinge("pin", "world", "upper", axis=(0, 1, 0.5), q=0.4, qd=1.0)
        bar(m, "lower", (0, 0, 0), (0.5, 0.1, -0.7), **place)
        return m

    m = begun()
    named, rate = ("fixed", 0.0) if kind == "rigid" else (kind, 0.5)
    m.hinge("joint", "upper", "lower", named, at=lever, axis=axis, rotation=tilt, qd=rate)
    hinged = m.build()
    at = hinged.state()
    m = begun(position=at.point("lower"), rotation=at.rotation("lower"), velocity=at.velocity("lower"),
              spin=at.spin("lower"))  # fmt: skip
    m.close("joint", ("upper", lever), ("lower", (0, 0, 0)), kind, axis=axis)
    tree, loop = (model.simulate(0.4, 0.4, PRECISE) for model in (hinged, m.build()))
    ends = [run.model.state(run.end) for run in (tree, loop)]
    for point in ((0, 0, 0), (0.5, 0.1, -0.7)):
        assert np.allclose(*(state.point("lower", point) for state in ends), atol=SAME)
        assert np.allclose(*(state.velocity("lower", point) for state in ends), atol=10 * SAME)
    assert loop.audit().energy < 1e-8


@pytest.mark.parametrize(
    ("kind", "freedoms"),
    [("spherical", 3), ("revolute", 1), ("universal", 2), ("cylindrical", 2), ("prismatic", 1), ("planar", 3),
     ("rigid", 0)],
)  # fmt: skip
def test_a_kind_leaves_as_many_freedoms_as_it_should_and_keeps_the_energy(kind, freedoms):
    m = Mechanism(gravity=(0, 0, -G))
    m.body("b", 2.0, com=(0.3, 0.2, 0.1), inertia=(0.1, 0.2, 0.25), position=(0.1, 0.2, 0.3))
    more = {"axis_b": (0, 1, 0)} if kind == "universal" else {}
    m.close("joint", ("b", (0, 0, 0)), ("world", (0.1, 0.2, 0.3)), kind, axis=(1, 0, -0.5), **more)
    model = m.build()
    assert model.directions.shape == (6, freedoms)
    run = model.simulate(0.3, 0.1, PRECISE)
    assert run.audit().gap < CLOSED
    assert run.audit().energy < 1e-8
    frames = run.end.factors.frames
    errors, rows = model.bodies.joints.rows(frames)
    assert np.allclose(errors, 0.0, atol=CLOSED)
    assert np.linalg.matrix_rank(multibody.row_matrix(model.tree, frames, rows)) == 6 - freedoms
    assert len(model.state().loops.body) == 6 - freedoms


def random_closed():
    """A spatial tree with a loop within and one to the world, away from where they close."""
    rng = np.random.default_rng(7)
    m = Mechanism()
    for k, parent in enumerate(("world", "b0", "b1", "b1", "b3")):
        m.body(f"b{k}", 1.0 + k, com=rng.normal(size=3), inertia=(1.0, 1.2, 1.5))
        m.hinge(f"h{k}", parent, f"b{k}", at=rng.normal(size=3), axis=rng.normal(size=3))
    m.body("free", 2.0, inertia=1.0, position=(0.5, 0.2, 0.1))
    m.close("u", ("b4", (0.1, 0.2, 0.3)), ("free", (0, 0.1, 0)), "prismatic", axis=(0.2, 1, 0))
    m.close("w", ("world", (0.4, 0.2, 0.3)), ("b2", (0, 0.1, 0.3)), "universal", (1, 0, 0), (0, 0.6, 0.8))
    return m, rng


def test_rows_and_accelerations_are_derivatives_of_the_errors():
    m, rng = random_closed()
    m._parts[Closing], closings = {}, list(m._parts[Closing].values())
    bodies = m.build().bodies
    tree, q = bodies.tree, multibody.integrate(bodies.tree, bodies.q, rng.normal(size=bodies.tree.n_v))
    qd, qdd = rng.normal(size=(2, tree.n_v))
    for closing in closings:
        joints = closing.bind(bodies)

        def errors(t, joints=joints):
            moved = multibody.integrate(tree, q, t * qd + 0.5 * t * t * qdd)
            return joints.rows(multibody.pose(tree, moved))[0]

        frames, h = multibody.pose(tree, q), 1e-4
        rates = multibody.row_matrix(tree, frames, joints.rows(frames)[1]) @ qd
        assert np.allclose(rates, (errors(h) - errors(-h)) / (2 * h), atol=1e-6)
        # A free root's exponential has the derivative qdd at the start of the path only.
        found = joints.accelerations(tree, frames, qd, qdd)
        assert np.allclose(found, (errors(h) - 2 * errors(0.0) + errors(-h)) / h**2, atol=1e-5)


def test_forces_of_a_loop_are_gauss_least_change():
    """Dense: M (a - a_free) = G^T x, G a = -gamma, of redundant rows, too."""
    model = four_bar().build()
    at = model.start()
    tree, frames = model.tree, at.factors.frames
    mass = multibody.mass_matrix(tree, frames)
    g = multibody.row_matrix(tree, frames, model.bodies.joints.rows(frames)[1])
    assert len(g) == 5 and np.linalg.matrix_rank(g) == 2
    free = multibody.forward_dynamics(tree, at.q, at.qd, at.torque)
    gamma = model.bodies.joints.accelerations(tree, frames, at.qd, np.zeros(3))
    impulse = np.linalg.lstsq(g @ np.linalg.solve(mass, g.T), -gamma - g @ free, rcond=1e-12)[0]
    dense = free + np.linalg.solve(mass, g.T @ impulse)
    found, _ = model.system.accelerations(0.0, at.q, at.qd, at.torque, at.loads, at.factors)
    assert np.allclose(found, dense, rtol=1e-9)


def test_a_driven_crank_does_work_through_the_loop():
    m = Mechanism(gravity=(0, 0, -G))
    bar(m, "crank", (0, 0, 0), (0.5, 0, 0))
    bar(m, "rod", (0, 0, 0), (2.0, 0, 0))
    m.body("piston", 3.0, inertia=1.0)
    m.hinge("A", "world", "crank", axis=(0, -1, 0))
    m.hinge("B", "crank", "rod", axis=(0, -1, 0), at=(0.5, 0, 0))
    m.hinge("slide", "world", "piston", "prismatic", axis=(1, 0, 0), at=(2.5, 0, 0))
    m.close("pin", ("rod", (2.0, 0, 0)), ("piston", (0, 0, 0)), axis=(0, 1, 0))
    m.drive("A", lambda t: (4.0 * t, 4.0, 0.0))
    run = m.build().simulate(2.0, 0.01, DormandPrince(1e-9))
    where = run.q[:, run.model.bodies.freedom("slide")[0]]
    angle = 4.0 * run.time
    assert np.allclose(where + 2.5, 0.5 * np.cos(angle) + np.sqrt(4.0 - 0.25 * np.sin(angle) ** 2), atol=1e-9)
    assert run.audit().energy < 1e-7
    assert np.ptp(run.table["work drives"]) > 1.0


def test_an_impact_acts_through_the_loop():
    """A blow on the rocker, plastic, stops the crank."""
    model = four_bar().build()
    state = model.state()
    rocker = model.bodies.number("rocker")
    wall = ContactPoint("stop", (-1, rocker), state.point("rocker", (0, 0, 1.5)), (-1.0, 0, 0))
    qd = impact(state.factors, state.qd, [wall], loops=state.loops).qd
    assert np.allclose(qd, 0.0, atol=AUDITED)


def test_coordinates_and_rates_that_are_given_stay_and_others_follow():
    m = four_bar()
    m._parts[Hinge]["A"].fix(q=0.3)
    model = m.build()
    assert model.q[0] == 0.3 and model.qd[0] == 3.0
    errors, rows = model.bodies.joints.rows(model.state().frames)
    assert np.allclose(errors, 0.0, atol=CLOSED)
    assert np.allclose(
        multibody.row_matrix(model.tree, model.state().frames, rows) @ model.qd, 0.0, atol=CLOSED
    )


@pytest.mark.parametrize(
    ("act", "words"),
    [
        (lambda: four_bar("ball"), r'closing "C": its kind .ball.: give cylindrical, planar.* or universal'),
        (lambda: four_bar("universal"), "axis_b applies to kind universal"),
        (lambda: four_bar(axis_b=(1, 0, 0)), "axis_b applies to kind universal"),
        (lambda: four_bar(last="bench").build(), 'closing "C": there is no body "bench"'),
        (lambda: out_of_reach().build(), r'closing "far": it stays open by .*; give coordinates'),
        (lambda: contradicted().build(), r'closing "C": the rates of hinges open it by .*the others follow'),
        (lambda: four_bar().build().simulate(1.0, 0.1, Leapfrog()), "support closed loops; use Runge-Kutta"),
        (lambda: four_bar().build().simulate(1.0, 0.1, ImplicitMidpoint()), "does not support closed loops"),
    ],
)  # fmt: skip
def test_what_does_not_close_is_refused_in_words(act, words):
    with pytest.raises(MechanicsError, match=words) as refusal:
        act()
    assert "\n" not in str(refusal.value)


def out_of_reach():
    m = four_bar()
    m.close("far", ("crank", (0, 0, 1.0)), ("world", (9.0, 0, 0)), "spherical")
    return m


def contradicted():
    m = four_bar()
    m._parts[Hinge]["B"].fix(qd=1.0)
    m._parts[Hinge]["D"].fix(qd=1.0)
    return m


def test_a_loop_of_fixed_bodies_is_closed_as_it_stands():
    m = Mechanism()
    bar(m, "beam", (0, 0, 0), (1.0, 0, 0))
    m.hinge("wall", "world", "beam", "fixed")
    m.close("end", ("beam", (1.0, 0, 0)), ("world", (1.0, 0, 0)), "spherical")
    assert m.build().bodies.tree.n_v == 0


@pytest.mark.parametrize("integrator", [RungeKutta4(), Rosenbrock()])
def test_integrators_of_accelerations_keep_loops_closed(integrator):
    run = four_bar().build().simulate(0.5, 2e-3, integrator)
    precise = four_bar().build().simulate(0.5, 0.5, PRECISE)
    assert run.audit().gap < CLOSED and run.audit().parting < CLOSED
    assert np.allclose(run.q[-1], precise.q[-1], atol=1e-4)


# --- Loops that are long, or move against their count of freedoms


def scissor(n, angle=0.5):
    """A lift of n stages, whose bars of 2 m cross at their centres, and its acceleration from rest."""
    m, c, s = Mechanism(gravity=(0, 0, -9.81)), np.cos(angle), np.sin(angle)
    m.body("a0", 1.0, com=(1.0, 0, 0), inertia=1 / 3)
    m.hinge("ha0", "world", "a0", axis=(0, -1, 0), q=angle)
    m.body("slide", 0.2, inertia=0.01)
    m.hinge("hs", "world", "slide", kind="prismatic", axis=(1, 0, 0), q=2 * c)
    m.body("b0", 1.0, com=(1.0, 0, 0), inertia=1 / 3)
    m.hinge("hb0", "slide", "b0", axis=(0, -1, 0), q=np.pi - angle)
    for k in range(n):
        for one, other, q in (("a", "b", 2 * angle - np.pi), ("b", "a", np.pi - 2 * angle)) if k else ():
            m.body(f"{one}{k}", 1.0, com=(1.0, 0, 0), inertia=1 / 3)
            m.hinge(f"h{one}{k}", f"{other}{k - 1}", f"{one}{k}", at=(2, 0, 0), axis=(0, -1, 0), q=q)
        m.close(f"m{k}", a=(f"a{k}", (1, 0, 0)), b=(f"b{k}", (1, 0, 0)), kind="revolute", axis=(0, 1, 0))
    rise = (2 * np.arange(n) + 1.0) ** 2
    inertia = 2.0 * np.sum(s * s + rise * c * c + 1 / 3) + 0.8 * s * s
    return m.build(), -2.0 * 9.81 * n * n * c / inertia


def accelerations(model):
    at = model.start()
    return model.system.accelerations(at.time, at.q, at.qd, at.torque, at.loads, at.factors)[0]


@pytest.mark.parametrize("n", [10, 150])
def test_a_scissor_lift_of_any_length_falls_as_its_closed_form(n):
    """At 150 stages the smallest eigenvalue that counts is 1e-8 of the largest."""
    model, wanted = scissor(n)
    assert accelerations(model)[model.bodies.freedom("ha0")[1]] == pytest.approx(wanted, rel=1e-10)
    model.simulate(2e-3, 1e-3)


def turned(axis, angle):
    return Rotation.from_rotvec(np.multiply(axis, angle)).as_matrix()


def bennett(start, qd, copies=1):
    """Bennett's linkages: four hinges each, in no plane and no sphere, that turn."""
    twist = 0.5
    lengths, twists = [1.0, 1.4] * 2, [twist, np.arcsin(1.4 * np.sin(twist))] * 2
    xs, zs = (1, 0, 0), (0, 0, 1)

    def gap(q):
        turn, place = np.eye(3), np.zeros(3)
        for angle, length, alpha in zip([start, *q], lengths, twists, strict=True):
            turn = turn @ turned(zs, angle)
            place = place + length * turn[:, 0]
            turn = turn @ turned(xs, alpha)
        return np.concatenate([place, (turn - np.eye(3)).ravel()])

    near = [np.pi - 0.05, -start, 0.05 - np.pi]
    q = [start, *least_squares(gap, near, xtol=1e-15, ftol=1e-15, gtol=1e-15).x]
    m = Mechanism(gravity=(0, 0, -9.81))
    last = turned(zs, q[3])
    end = -(last @ turned(xs, twists[3])).T @ last @ [lengths[3], 0, 0]
    for of in [""] + [f" {k}" for k in range(1, copies)]:
        for k in range(3):
            m.body(f"l{k}{of}", 1.0, com=(lengths[k] / 2, 0, 0), inertia=(0.01, 0.1, 0.1))
        m.hinge(f"h0{of}", "world", f"l0{of}", axis=zs, q=q[0], qd=qd)
        for k in (1, 2):
            at, twisted = (lengths[k - 1], 0, 0), turned(xs, twists[k - 1])
            ends = f"l{k - 1}{of}", f"l{k}{of}"
            m.hinge(f"h{k}{of}", *ends, at=at, rotation=twisted, axis=twisted @ zs, q=q[k])
        tip = f"l2{of}", (lengths[2], 0, 0)
        m.close(f"J{of}", a=tip, b=("world", end), axis=turned(xs, twists[2]) @ zs)
    return m.build()


@pytest.mark.parametrize(("start", "qd", "until"), [(0.9, 1.5, 2.0), (0.05, -2.5, 0.3)])
def test_bennett_s_linkage_passes_the_pose_in_line(start, qd, until):
    """Its equations depend on each other where the loop is closed, and nowhere else."""
    model = bennett(start, qd)
    run, other = model.simulate(until, 1e-3), model.simulate(until, 5e-3, DormandPrince(1e-10))
    assert np.min(run.motion["h0"]) < -0.5
    assert run.audit().energy < 1e-8 and other.audit().energy < 1e-8
    assert np.allclose(run.q[-1], other.q[-1], atol=1e-8)
    assert model.directions.shape[1] == 1


# --- Dead points


def slider_crank(angle, motion=None, rate=0.0):
    """A crank of 1 m, a rod of 2 m and a block, which moves as given."""
    m, tilt = Mechanism(), np.arcsin(np.sin(angle) / 2.0)
    bar(m, "crank", (0, 0, 0), (1.0, 0, 0))
    bar(m, "rod", (0, 0, 0), (2.0, 0, 0))
    m.body("block", 1.0, inertia=0.1)
    m.hinge("O", "world", "crank", q=angle)
    m.hinge("A", "crank", "rod", at=(1.0, 0, 0), q=-tilt - angle)
    place = np.cos(angle) + 2.0 * np.cos(tilt)
    m.hinge("S", "world", "block", kind="prismatic", axis=(1, 0, 0), q=place, qd=rate)
    m.close("B", ("rod", (2.0, 0, 0)), ("block", (0, 0, 0)))
    if motion is not None:
        m.drive("S", lambda t: np.add(motion(t), (place, 0, 0)))
    return m


@pytest.mark.parametrize("integrator", [RungeKutta4(), DormandPrince()])
def test_a_drive_beyond_a_dead_point_is_refused_as_such(integrator):
    """The block is 0.645 m from where crank and rod are in line."""
    model = slider_crank(1.0, lambda t: (t, 1.0, 0.0)).build()
    for every in (1, 7):
        with pytest.raises(
            MechanicsError, match=r"beyond a dead point, .* not close at time 0\.65;"
        ) as refused:
            model.simulate(1.0, 0.01, integrator, every)
        assert refused.value.fault is Fault.OPEN
    model.simulate(0.6, 0.01, integrator)


def test_rates_that_a_dead_point_does_not_allow_are_refused_as_such():
    for m in (slider_crank(0.0, rate=1.0), slider_crank(0.0, lambda t: (-t, -1.0, 0.0))):
        with expect_refusal(fault=Fault.OPEN, kind=MechanicsError, match='closing "B"'):
            m.build()
    slider_crank(0.1, rate=1.0).build()
