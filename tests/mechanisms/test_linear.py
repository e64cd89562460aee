"""Small motions: derivatives along a simulation, MuJoCo's bias of ball joints, frequencies of fine beams."""

import numpy as np
import pytest
from fixtures.tolerances import DIFFERENCED
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from protochain.mechanics import multibody
from protochain.mechanics.motion import RungeKutta4
from protochain.mechanics.multibody import HingeKind
from protochain.mechanisms import Mechanism, frequencies, linearise, state_matrix
from protochain.mechanisms.assemble import Hinge
from protochain.mechanisms.segments import Beam, add_beam

G = 9.81
STEP, NUDGE = 1e-4, 1e-4


def ball(m):
    m.body("a", 1.0, com=(0.1, 0.2, -1), inertia=(0.1, 0.2, 0.3))
    m.hinge("p", "world", "a", "ball", q=(0.3, 0.2, 0.1), qd=(1.0, 2.0, 3.0))


def balls(m):
    """Two ball joints, a turning carrier and a slide."""
    ball(m)
    m.body("c", 0.7, com=(0.2, 0, 0.1), inertia=(0.1, 0.12, 0.2))
    m.hinge("r", "a", "c", axis=(1, 0, 1), at=(0, 0.1, -1), q=0.4, qd=-2.0)
    m.body("b", 2.0, com=(0.3, 0.2, -0.4), inertia=(0.2, 0.3, 0.4))
    m.hinge("s", "c", "b", "ball", at=(0.5, 0, 0), q=(-0.4, 1.2, 0.3), qd=(3.0, 2.0, 4.0))
    m.body("d", 0.5, inertia=0.1)
    m.hinge("t", "b", "d", "prismatic", axis=(0, 1, 1), at=(0.1, 0, 0), q=0.3, qd=1.5)
    m.spring("pull", ("d", (0, 0, 0)), ("world", (1, 1, 0)), stiffness=30.0, rest=0.5)
    m.torsion("slow", "r", stiffness=3.0, damping=0.3)


def free(m):
    """A body that spins and flies, with a universal joint and a ball joint on it."""
    m.body("f", 2.0, com=(0.1, 0, 0.2), inertia=(0.3, 0.4, 0.5), position=(1, 2, 3), spin=(1.0, -2.0, 0.5),
           velocity=(0.3, 0.1, -0.2))  # fmt: skip
    m.body("cross", 0.0)
    m.body("g", 1.0, com=(0, 0, -0.5), inertia=(0.1, 0.1, 0.05))
    m.hinge("u", "f", "cross", axis=(1, 0, 0), at=(0, 0.3, 0), q=0.2, qd=2.0)
    m.hinge("v", "cross", "g", axis=(0, 1, 0), q=0.3, qd=-1.0)
    m.body("h", 0.6, com=(0.2, 0.1, 0), inertia=(0.05, 0.06, 0.04))
    m.hinge("b", "g", "h", "ball", at=(0, 0, -1), qd=(4.0, -3.0, 2.0))
    m.spring("tie", ("h", (0.1, 0, 0)), ("world", (1, 2, 0)), stiffness=8.0, damping=0.4)


def planar(m):
    """Slides along x and y and a turn, as a planar joint has them, with a ball joint on it."""
    for name in "xy":
        m.body(name, 0.0)
    m.body("disc", 2.0, com=(0.2, 0.1, 0), inertia=0.3)
    m.hinge("x", "world", "x", "prismatic", axis=(1, 0, 0), qd=1.0)
    m.hinge("y", "x", "y", "prismatic", axis=(0, 1, 0), qd=-0.5)
    m.hinge("turn", "y", "disc", qd=3.0)
    m.body("bob", 0.5, com=(0, 0.1, -0.4), inertia=(0.02, 0.03, 0.01))
    m.hinge("ball", "disc", "bob", "ball", at=(0.4, 0, 0), qd=(2.0, 1.0, -4.0))
    m.spring("home", ("disc", (0, 0, 0)), ("world", (0.3, 0, 0)), stiffness=20.0)


def four_bar(m):
    """A loop of revolute joints that turns, with a ball joint on its coupler."""
    a, b, c, d = (np.array(x) for x in ((0.0, 0, 0), (0.0, 0, 1.0), (2.0, 0, 1.5), (2.0, 0, 0)))
    for name, start, end in (("crank", a, b), ("coupler", b, c), ("rocker", d, c)):
        length = float(np.linalg.norm(end - start))
        m.body(name, length, com=(end - start) / 2.0, inertia=length**3 / 12.0)
    m.hinge("A", "world", "crank", axis=(0, 1, 0), qd=3.0)
    m.hinge("B", "crank", "coupler", axis=(0, 1, 0), at=b)
    m.hinge("D", "world", "rocker", axis=(0, 1, 0), at=d)
    m.body("bob", 0.5, com=(0, 0.1, -0.4), inertia=(0.02, 0.03, 0.01))
    m.hinge("ball", "coupler", "bob", "ball", at=(1, 0, 0), qd=(2.0, 1.0, -4.0))
    m.close("C", ("coupler", c - b), ("rocker", c - d), axis=(0, 1, 0))


def spatial_loop(m):
    """A loop of four ball joints, of which the rates of one are given."""
    for k in range(3):
        m.body(f"l{k}", 1.0 + k, com=(0.4, 0.1, 0), inertia=(0.1, 0.2, 0.25))
        bent, rate = (0.3 * k, 0.9 - k, 0.8), (1.0, 0.5, -2.0) if k == 0 else 0.0
        at, ends = (1.0 * (k > 0), 0, 0), (f"l{k - 1}" if k else "world", f"l{k}")
        m.hinge(f"j{k}", *ends, "ball", at=at, q=bent, qd=rate)
    end = m.build().state().point("l2", (1, 0, 0))
    m.close("end", ("l2", (1, 0, 0)), ("world", end), "spherical")


MOVING = (ball, balls, free, planar, four_bar, spatial_loop)


def built(make):
    m = Mechanism(gravity=(0, 0.5, -G))
    make(m)
    return m.build()


def rates_along(model, at):
    """d(qd)/dt by central differences of a simulation."""
    after, before = (RungeKutta4().step(model.system, at, step) for step in (STEP, -STEP))
    return (after.qd - before.qd) / (2.0 * STEP)


@pytest.mark.parametrize("make", MOVING)
def test_outputs_get_the_time_derivatives_of_rates(make):
    model, given = built(make), []
    linearise(model, outputs=[lambda s, qdd: given.append(qdd.copy()) or 0.0])
    # The first two are of the state itself, before any nudge.
    wanted = rates_along(model, model.start())
    assert np.allclose(given[0], wanted, rtol=DIFFERENCED, atol=DIFFERENCED * np.abs(wanted).max())


def apart(tree, q, other):
    """(n_v,): displacement from one pose to another, of balls along their axes, free along the world's."""
    out = np.zeros(tree.n_v)
    for b in range(tree.n_bodies):
        i, v = tree.q_start[b], tree.v_start[b]
        if tree.kind[b] == HingeKind.BALL:
            turns = [Rotation.from_rotvec(np.array(x[i : i + 3])) for x in (q, other)]
            out[v : v + 3] = (turns[0].inv() * turns[1]).as_rotvec()
        elif tree.kind[b] == HingeKind.FREE:
            turns = [Rotation.from_quat(np.roll(x[i : i + 4], -1)) for x in (q, other)]
            out[v : v + 3] = (turns[1] * turns[0].inv()).as_rotvec()
            out[v + 3 : v + 6] = other[i + 4 : i + 7] - q[i + 4 : i + 7]
        elif tree.v_start[b + 1] > v and tree.q_start[b + 1] > i:
            out[v] = other[i] - q[i]
    return out


@pytest.mark.parametrize("make", MOVING)
def test_the_state_matrix_is_how_neighbouring_simulations_part(make):
    model = built(make)
    tree, at, ways = model.tree, model.start(), model.directions
    back, k = np.linalg.pinv(ways), ways.shape[1]
    columns = []
    for j in range(2 * k):
        ends = []
        for sign in (1.0, -1.0):
            way = sign * NUDGE * ways[:, j % k]
            move, rate = (way, 0.0 * way) if j < k else (0.0 * way, way)
            near = model.system.at(multibody.integrate(tree, at.q, move), at.qd + rate)
            # Loops project velocities by the mass: those along the directions are given again.
            for _ in range(3):
                near = model.system.at(near.q, near.qd + ways @ (back @ (at.qd + rate - near.qd)))
            ends.append([RungeKutta4().step(model.system, near, step) for step in (STEP, -STEP)])
        parted = []
        for step, (up, down) in zip((STEP, -STEP), zip(*ends, strict=True), strict=True):
            middle = RungeKutta4().step(model.system, at, step)
            move = apart(tree, middle.q, up.q) - apart(tree, middle.q, down.q)
            parted.append(np.concatenate([back @ move, back @ (up.qd - down.qd)]) / (2.0 * NUDGE))
        columns.append((parted[0] - parted[1]) / (2.0 * STEP))
    found, wanted = state_matrix(model), np.array(columns).T
    assert np.allclose(found, wanted, rtol=1e-5, atol=1e-5 * np.abs(wanted).max())


@pytest.mark.parametrize("bodies", [1, 2])
def test_feed_forward_beside_balls_that_turn_is_mujoco_s_bias(bodies):
    mujoco = pytest.importorskip("mujoco")
    rng = np.random.default_rng(bodies)
    m = Mechanism(gravity=(0, 0, -G))
    m.body("a", 1.0, com=(0.5, 0, 0), inertia=0.1)
    m.hinge("j", "world", "a", axis=(0, 0, 1))
    rates, text, end = [0.7], "", ""
    for k in range(bodies):
        com, inertia, qd = rng.normal(size=3), rng.uniform(0.2, 0.3, 3), rng.normal(size=3) * 3.0
        m.body(f"b{k}", 2.0, com=com, inertia=inertia)
        m.hinge(f"ball{k}", f"b{k - 1}" if k else "a", f"b{k}", "ball", at=(1, 0, 0), qd=qd)
        rates += [*qd]
        numbers = [" ".join(map(repr, map(float, x))) for x in (com, inertia)]
        text += f"""<body pos="1 0 0"><joint type="ball"/>
          <inertial pos="{numbers[0]}" mass="2" diaginertia="{numbers[1]}"/>"""
        end += "</body>"
    m.motor("mo", {"j": lambda t: (0.7 * t, 0.7, 0.0)}, feed_forward=True)
    m._parts[Hinge]["j"].fix(qd=0.7)
    model = m.build()
    other = mujoco.MjModel.from_xml_string(f"""<mujoco><option gravity="0 0 {-G}"/><worldbody><body>
        <joint axis="0 0 1"/><inertial pos="0.5 0 0" mass="1" diaginertia="0.1 0.1 0.1"/>{text}{end}
        </body></worldbody></mujoco>""")
    data = mujoco.MjData(other)
    data.qvel[:] = rates
    mujoco.mj_forward(other, data)
    at = model.start()
    assert at.loads[0][0] == pytest.approx(data.qfrc_bias[0], rel=1e-10)
    found = model.system.accelerations(0.0, at.q, at.qd, 0.0 * at.qd, None, at.factors)[0]
    m.set_gravity((0, 0, 0))
    other.opt.gravity[:] = 0.0
    mujoco.mj_forward(other, data)
    assert np.allclose(found, data.qacc, rtol=1e-9, atol=1e-9)


# --- Frequencies

BEAM = Beam(length=1.0, mass=1.0, bending=1.0)


def roots(function, low):
    """Wave numbers to the square: frequencies of a beam of unit length, mass and stiffness."""
    return np.array([brentq(function, low + np.pi * i, low + np.pi * (i + 1)) for i in range(6)]) ** 2


CLAMPED = roots(lambda b: np.cos(b) + 1.0 / np.cosh(b), 0.0)
FREE = roots(lambda b: np.cos(b) - 1.0 / np.cosh(b), np.pi)
TIP = 0.7
LOADED = roots(
    lambda b: np.cos(b) + 1.0 / np.cosh(b) - TIP * b * (np.sin(b) - np.cos(b) * np.tanh(b)), 1e-6
)  # fmt: skip


def cantilever(cells, tip=0.0, damping=0.0, gravity=(0.0, 0, 0)):
    m = Mechanism(gravity=gravity)
    beam = add_beam(m, "beam", BEAM, cells, damping=damping)
    if tip:
        m.body("tip", tip)
        m.hinge("end", beam.tip[0], "tip", "fixed", at=beam.tip[1])
    return m


def floating(cells):
    """A beam in the plane that nothing holds: slide and turn at its end."""
    m = Mechanism()
    m.body("end", 0.0)
    m.hinge("slide", "world", "end", "prismatic", axis=(0, 1, 0))
    add_beam(m, "beam", BEAM, cells, "end", {"kind": "revolute", "axis": (0, 0, 1)})
    return m


@pytest.mark.parametrize("cells", [64, 128, pytest.param(256, marks=pytest.mark.slow), 512])
def test_frequencies_of_fine_beams_err_by_their_cells_alone(cells):
    """Errors of hinged segments fall with the square of the cells, of a free beam with the fourth power."""
    found = frequencies(cantilever(cells).build())
    assert len(found) == cells
    assert found[0] / CLAMPED[0] - 1.0 == pytest.approx(0.229429 / cells**2, rel=2e-4)
    assert np.allclose(
        cells**2 * (found[:5] / CLAMPED[:5] - 1.0), (0.2294, 0.797, 1.308, 1.83, 2.35), rtol=0.01
    )
    if cells > 256:
        return
    loaded = frequencies(cantilever(cells, TIP).build())
    assert np.allclose(cells**2 * (loaded[:3] / LOADED[:3] - 1.0), (0.1497, 0.6637, 1.1795), rtol=0.005)
    free = frequencies(floating(cells).build())
    # A turn and a slide have no frequency.
    assert len(free) == cells
    assert np.allclose(cells**4 * (1.0 - free[:3] / FREE[:3]), (0.3475, 2.638, 10.14), rtol=0.02)


def clamped_at_both_ends(cells):
    m = Mechanism()
    beam = add_beam(m, "beam", BEAM, cells)
    m.close("end", beam.tip, ("world", (1.0, 0, 0)), "rigid")
    return m


def rotor(cells):
    m = Mechanism()
    m.body("hub", 1.0, inertia=1.0)
    m.hinge("spin", "world", "hub")
    joint = {"kind": "fixed", "at": (0.1, 0, 0)}
    add_beam(m, "beam", Beam(1.0, 1.0, (1.0, 2.0)), cells, "hub", joint, bends="yz")
    m.drive("spin", lambda t: (5.0 * t, 5.0, 0.0))
    return m


def test_frequencies_of_a_beam_in_a_loop_and_of_a_damped_one():
    """Both ends clamped have the wave numbers of both free; stiffness times a time damps mode by mode."""
    found = frequencies(clamped_at_both_ends(128).build())
    assert len(found) == 126
    assert np.allclose(128**2 * (found[:3] / FREE[:3] - 1.0), (1.549, 2.620, 3.666), rtol=1e-3)
    undamped = frequencies(cantilever(128).build())[:3]
    time = 0.02 / undamped[0]
    damped = frequencies(cantilever(128, damping=time).build())
    assert np.allclose(damped[:3], undamped * np.sqrt(1.0 - (0.5 * time * undamped) ** 2), rtol=1e-9)


@pytest.mark.parametrize(
    "made",
    [cantilever(8, gravity=(0, -9.81, 0)), cantilever(8, damping=0.01, gravity=(0, -9.81, 0)),
     cantilever(8, gravity=(-30.0, 0, 0)), floating(8), clamped_at_both_ends(8), rotor(6)],
)  # fmt: skip
def test_frequencies_of_coarse_beams_are_those_of_the_state_matrix(made):
    """Of one that falls, is damped, buckles, floats, is in a loop and rotates."""
    model = made.build()
    wanted = np.linalg.eigvals(state_matrix(model)).imag
    # Motions that nothing resists, and those by rounding.
    wanted = np.sort(wanted[wanted > 1e-3])
    assert np.allclose(frequencies(model), wanted, rtol=1e-7)
