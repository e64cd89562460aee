"""Forces in hinges, joints and drives: statics, pendulums, inverse dynamics, work, MuJoCo's sensors."""

import numpy as np
import pytest
from fixtures.tolerances import AUDITED

from protochain.core.errors import MechanicsError
from protochain.mechanics.motion import DormandPrince
from protochain.mechanisms import Ball, Friction, Law, Mechanism, Plane

G = 9.81
PRECISE = DormandPrince(1e-10)
FORCE, MOMENT = ["force x", "force y", "force z"], ["moment x", "moment y", "moment z"]
BALANCED = 1e-9
"""Of forces of some newtons: rounding of accelerations, some hundred times."""


def rod(m, name, along, mass=1.0):
    length = float(np.linalg.norm(along))
    m.body(name, mass, com=np.multiply(0.5, along), inertia=mass * length**2 / 12.0)


def test_a_pendulum_pulls_on_its_pin_with_its_weight_and_what_turns_it():
    m = Mechanism(gravity=(0, 0, -G))
    m.body("bob", 2.0, com=(0, 0, -1.5))
    m.hinge("pin", "world", "bob", axis=(0, 1, 0), q=0.7)
    run = m.build().simulate(1.0, 0.1, PRECISE)
    found, angle, rate = run.reactions("pin"), run.q[:, 0], run.qd[:, 0]
    tension = 2.0 * (G * np.cos(angle) + 1.5 * rate**2)
    # The pin's axis is y: a positive angle moves the bob to -x.
    outward = np.column_stack([-np.sin(angle), 0.0 * angle, -np.cos(angle)])
    assert np.allclose(np.sum(found[FORCE].to_numpy() * outward, axis=1), -tension, atol=BALANCED)
    assert np.allclose(found[MOMENT], 0.0, atol=BALANCED)
    assert np.array_equal(found["time"], run.time)


def arm(**more):
    """Three links in space, with a spring, a damper, a motor, a load and a fixed hinge among them."""
    m = Mechanism(gravity=(0.5, 0, -G))
    rod(m, "a", (0.5, 0.1, -0.2))
    rod(m, "b", (0.4, -0.3, 0.1), 2.0)
    m.body("c", 1.5, com=(0.1, 0.2, 0.3), inertia=(0.1, 0.2, 0.25))
    m.body("tool", 0.7, com=(0.0, 0.1, 0.0), inertia=0.05)
    m.hinge("h1", "world", "a", axis=(0, 0.6, 0.8), q=0.3, qd=1.0)
    m.hinge("h2", "a", "b", "prismatic", at=(0.5, 0.1, -0.2), axis=(1, 0, 0), q=0.1, qd=-0.5)
    m.hinge("h3", "b", "c", at=(0.4, -0.3, 0.1), axis=(0, 0, 1), **({"q": -0.4, "qd": 2.0} | more))
    m.hinge("h4", "c", "tool", "fixed", at=(0.1, 0.2, 0.3))
    m.torsion("spring", "h2", stiffness=30.0, damping=2.0)
    m.torque("motor", "h1", 3.0)
    m.load("push", "tool", (0, 0.1, 0), force=(1.0, 2.0, 3.0), moment=(0.1, 0, 0.2))
    m.spring("tie", ("c", (0, 0, 0)), ("world", (1.0, 1.0, 0.0)), stiffness=20.0, rest=0.5)
    return m


def test_along_their_axes_reactions_are_what_acts_in_the_hinges():
    model = arm().build()
    run = model.simulate(0.5, 0.05, PRECISE)
    q, v = (run.motion[["h2", "h2 rate"]].to_numpy()).T
    axis = {name: [] for name in ("h1", "h2", "h3")}
    for k in range(len(run.time)):
        state = model.state(model.system.at(run.q[k], run.qd[k], run.time[k]))
        axis["h1"].append((0, 0.6, 0.8))
        axis["h2"].append(state.rotation("a") @ (1.0, 0, 0))
        axis["h3"].append(state.rotation("b") @ (0, 0, 1.0))
    along = {
        name: np.sum(run.reactions(name)[FORCE if name == "h2" else MOMENT].to_numpy() * axis[name], axis=1)
        for name in axis
    }
    assert np.allclose(along["h1"], 3.0, atol=BALANCED)
    assert np.allclose(along["h2"], -30.0 * q - 2.0 * v, atol=BALANCED)
    assert np.allclose(along["h3"], 0.0, atol=BALANCED)


def test_what_a_drive_gives_is_its_work():
    m = arm(q=0.0, qd=0.0)
    m.drive("h3", lambda t: (np.sin(3 * t) - 3 * t, 3 * np.cos(3 * t) - 3.0, -9 * np.sin(3 * t)))
    run = m.build().simulate(1.0, 1e-3, DormandPrince(1e-9))
    motion = run.motion
    power = motion["h3 drive"] * motion["h3 rate"]
    work = np.concatenate([[0.0], np.cumsum(0.5 * (power[1:].to_numpy() + power[:-1].to_numpy()) * 1e-3)])
    assert np.allclose(work, run.table["work drives"], atol=1e-4 * np.ptp(work))
    axis = run.model.state(run.end).rotation("b") @ (0, 0, 1.0)
    last = run.reactions("h3")[MOMENT].to_numpy()[-1]
    assert axis @ last == pytest.approx(motion["h3 drive"].iloc[-1], abs=BALANCED)


def test_a_joint_of_a_loop_carries_what_a_hinge_in_its_place_does():
    """A bar on two supports: a pin of the tree, and a joint that closes; and the same the other way round."""
    found = []
    for pin, end in ((0.0, 2.0), (2.0, 0.0)):
        m = Mechanism(gravity=(0, 0, -G))
        m.body("bar", 3.0, com=(0.5 - pin, 0, 0), inertia=1.0)
        m.hinge("pin", "world", "bar", axis=(0, 1, 0), at=(pin, 0, 0))
        m.close("support", ("world", (end, 0, 0)), ("bar", (end - pin, 0, 0)), "spherical")
        run = m.build().simulate(0.1, 0.1)
        found.append([run.reactions(name)[FORCE].to_numpy()[-1] for name in ("pin", "support")])
    # Statics: the centre of mass is a quarter of the way.
    assert np.allclose([each[2] for each in found[0]], [0.75 * 3.0 * G, 0.25 * 3.0 * G], atol=BALANCED)
    assert np.allclose([each[2] for each in found[1]], [0.25 * 3.0 * G, 0.75 * 3.0 * G], atol=BALANCED)


def test_mujocos_sensors_say_the_same():
    mujoco = pytest.importorskip("mujoco")
    m = Mechanism(gravity=(0, 0, -G))
    rod(m, "a", (0.5, 0, 0))
    rod(m, "b", (0.4, 0, 0), 2.0)
    m.body("c", 1.5, com=(0.1, 0.2, 0.3), inertia=(0.1, 0.2, 0.25))
    for name, parent, child, at, axis, q, qd in (
        ("h1", "world", "a", (0, 0, 0), (0, 1, 0), 0.3, 1.0),
        ("h2", "a", "b", (0.5, 0, 0), (0, 0, 1), -0.2, 2.0),
        ("h3", "b", "c", (0.4, 0, 0), (1, 0, 0), 0.5, -1.0),
    ):  # fmt: skip
        m.hinge(name, parent, child, axis=axis, at=at, q=q, qd=qd)
    m.torque("motor", "h2", 0.7)
    run = m.build().simulate(0.01, 0.01)

    def body(place, axis, mass, com, moments):
        return (
            f'<body pos="{place}"><joint name="j{mass}" axis="{axis}"/><site name="s{mass}"/>'
            f'<inertial pos="{com}" mass="{mass}" diaginertia="{moments}"/>'
        )

    masses = (1, 2, 1.5)
    bodies = (
        body("0 0 0", "0 1 0", 1, "0.25 0 0", " ".join(3 * [str(0.25 / 12)])),
        body("0.5 0 0", "0 0 1", 2, "0.2 0 0", " ".join(3 * [str(0.32 / 12)])),
        body("0.4 0 0", "1 0 0", 1.5, "0.1 0.2 0.3", "0.1 0.2 0.25"),
    )
    sensors = "".join(f'<force site="s{mass}"/><torque site="s{mass}"/>' for mass in masses)
    model = mujoco.MjModel.from_xml_string(f"""<mujoco>
      <option gravity="0 0 {-G}"><flag contact="disable"/></option>
      <worldbody>{"".join(bodies)}</body></body></body></worldbody>
      <actuator><motor joint="j2"/></actuator><sensor>{sensors}</sensor></mujoco>""")
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.ctrl[:] = (0.3, -0.2, 0.5), (1.0, 2.0, -1.0), 0.7
    mujoco.mj_forward(model, data)
    for k, mass in enumerate(masses):
        turn = data.site(f"s{mass}").xmat.reshape(3, 3)
        own = run.reactions(f"h{k + 1}").iloc[0]
        # What the parent does to the child, in the axes of the site.
        theirs = data.sensordata[6 * k : 6 * k + 6].reshape(2, 3) @ turn.T
        for words, vector in ((FORCE, theirs[0]), (MOMENT, theirs[1])):
            assert np.allclose(own[words].to_numpy(dtype=float), vector, atol=1e-8)


def test_what_has_no_forces_is_refused():
    run = arm().build().simulate(0.1, 0.05)
    with pytest.raises(MechanicsError, match='reactions: there is no hinge "h9"; there are "h1"'):
        run.reactions("h9")
    for name in (["h1"], None, 0):
        with pytest.raises(MechanicsError, match="reactions: there is no hinge"):
            run.reactions(name)


def test_a_drive_drags_a_sled_with_what_friction_has_where_it_sticks_and_slips():
    """Three feet, each on a spring from where it began, until it slips."""
    mass, coefficient, spring, feet = 2.0, 0.3, 1e3, [(0, 0, 0), (0.1, 0, 0), (0, 0.1, 0)]
    m = Mechanism(gravity=(0, 0, -G))
    m.body("cart", 0.0)
    m.body("sled", mass, inertia=0.1)
    m.hinge("pull", "world", "cart", "prismatic", axis=(1, 0, 0))
    m.hinge("height", "cart", "sled", "prismatic", axis=(0, 0, 1), q=-mass * G / 3e4)
    m.drive("pull", lambda t: (0.01 * t**2, 0.02 * t, 0.02))
    m.contact("floor", [Ball("sled", 0.0, foot) for foot in feet], Plane(), Law(1e4, 1.0, 1.0),
              Friction(coefficient, spring))  # fmt: skip
    model = m.build()
    run = model.simulate(1.0, 1e-3, every=20)
    wanted = np.minimum(3 * spring * run.motion["pull"], coefficient * mass * G) + 0.02 * mass
    assert wanted.min() < 0.1 and wanted.max() == pytest.approx(coefficient * mass * G + 0.02 * mass)
    # Anchors are those after a step: the sled stretches its springs by no more until the next.
    assert np.allclose(run.motion["pull drive"], wanted, atol=3 * spring * 0.02 * 1e-3)
    assert np.allclose(run.reactions("pull")["force x"], run.motion["pull drive"], atol=1e-9)
    assert np.allclose(run.reactions("height")["force x"], run.motion["pull drive"], atol=1e-9)
    # To ask changes nothing of a run that goes on.
    half = model.simulate(0.5, 1e-3, every=500)
    half.reactions("pull")
    assert np.array_equal(model.simulate(1.0, 1e-3, start=half.end).q[-1], run.q[-1])
    assert run.audit().energy < AUDITED
