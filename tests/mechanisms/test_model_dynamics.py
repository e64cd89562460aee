"""Matrices and torques of a model at coordinates by name, against Pinocchio and MuJoCo."""

import numpy as np
import pytest
from fixtures.tolerances import BY_MUJOCO, BY_PINOCCHIO, RATE_OF_STEP

from protochain.core.errors import MechanicsError, ProtochainError
from protochain.mechanics.motion import DormandPrince
from protochain.mechanisms import Mechanism

LINKS = ("base", "upper", "fore", "hand", "left", "right")
JOINTS = {
    "arm": (
        ("shoulder", "revolute", "base", "upper"), ("elbow", "continuous", "upper", "fore"),
        ("rail", "prismatic", "fore", "hand"),
    ),
    "tree": (
        ("shoulder", "revolute", "base", "upper"), ("elbow", "continuous", "upper", "fore"),
        ("rail", "prismatic", "fore", "hand"), ("left", "revolute", "upper", "left"),
        ("right", "revolute", "base", "right"),
    ),
}  # fmt: skip
"""Name, kind, parent and child of each joint."""


def urdf(case):
    """A robot of links with unlike masses, and joints about skew axes."""
    joints = JOINTS[case]
    text = '<robot name="r"><link name="base"/>'
    for k, (_, _, _, link) in enumerate(joints):
        text += f"""<link name="{link}"><inertial><origin xyz="0.1 {0.05 * k} 0.2" rpy="0.3 0.1 {k}"/>
            <mass value="{2.5 - 0.4 * k}"/><inertia ixx="0.11" ixy="0.01" ixz="-0.02" iyy="0.12" iyz="0.005"
            izz="0.05"/></inertial></link>"""
    for k, (name, kind, parent, child) in enumerate(joints):
        text += f"""<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>
            <origin xyz="0 0.1 {0.3 + 0.1 * k}" rpy="0.2 {0.4 * k} -0.7"/><axis xyz="0.3 {k} 1"/>
            <limit lower="-2" upper="2" effort="1" velocity="1"/></joint>"""
    return text + "</robot>"


@pytest.mark.parametrize("case", JOINTS)
def test_the_four_functions_are_those_of_pinocchio(case):
    pin = pytest.importorskip("pinocchio")
    m = Mechanism.from_urdf(urdf(case))
    m.set_gravity((0.0, 0.0, -9.81))
    ours, theirs = m.build(), pin.buildModelFromXML(urdf(case))
    names = [name for name, *_ in JOINTS[case]]
    rng = np.random.default_rng(3)
    at, rate, torque = (dict(zip(names, rng.normal(size=len(names)), strict=True)) for _ in range(3))
    q, v, tau = pin.neutral(theirs), np.zeros(theirs.nv), np.zeros(theirs.nv)
    for name in names:
        joint = theirs.joints[theirs.getJointId(name)]
        value = at[name]
        q[joint.idx_q : joint.idx_q + joint.nq] = (np.cos(value), np.sin(value)) if joint.nq == 2 else value
        v[joint.idx_v], tau[joint.idx_v] = rate[name], torque[name]
    place = [ours.bodies.freedom(name)[1] for name in names]
    other = [theirs.joints[theirs.getJointId(name)].idx_v for name in names]
    data = theirs.createData()
    mass = pin.crba(theirs, data, q)
    mass = np.triu(mass) + np.triu(mass, 1).T
    bias, a = pin.nonLinearEffects(theirs, data, q, v), pin.aba(theirs, theirs.createData(), q, v, tau)
    inverse = pin.rnea(theirs, theirs.createData(), q, v, 2.0 * a)

    def same(mine, wanted):
        assert np.max(np.abs(mine - wanted)) < BY_PINOCCHIO * np.max(np.abs(wanted))

    same(ours.mass_matrix(at)[np.ix_(place, place)], mass[np.ix_(other, other)])
    same(ours.bias(at, rate)[place], bias[other])
    qdd = ours.forward_dynamics(at, rate, torque)
    same(qdd[place], a[other])
    same(ours.inverse_dynamics(at, rate, 2.0 * qdd)[place], inverse[other])
    # The same by arrays, and the place of a point.
    state = ours.state(q=at, qd=rate)
    assert np.array_equal(ours.bias(state.q, state.qd), ours.bias(at, rate))
    pin.framesForwardKinematics(theirs, data, q)
    frame = data.oMf[theirs.getFrameId("hand")]
    same(state.point("hand", (0.1, 0.2, 0.3)), frame.act(np.array([0.1, 0.2, 0.3])))
    assert [state.angle(name) for name in names] == pytest.approx([at[name] for name in names])


MJCF = """<mujoco><compiler angle="radian"/><option gravity="0.3 0 -9.81"><flag contact="disable"/></option>
  <worldbody><body name="base" pos="0 0 0.5" euler="0.3 0.1 0">
    <joint name="pan" axis="0 1 0.2" damping="0.2" stiffness="3" springref="0.4" armature="0.05"/>
    <inertial pos="0.1 0 -0.2" mass="1.2" diaginertia="0.02 0.03 0.025" euler="0.1 0.5 0"/>
    <body name="arm" pos="0.3 0 -0.1" euler="0 0.4 0.2">
      <joint name="rail" type="slide" axis="0 0 1" stiffness="50" damping="1"/>
      <inertial pos="0 0.1 -0.1" mass="0.7" diaginertia="0.01 0.012 0.013"/></body>
    <body name="leg" pos="-0.2 0.1 0"><joint name="turn" axis="1 0 0" damping="0.1"/>
      <inertial pos="0.05 0 -0.1" mass="0.4" diaginertia="0.003 0.004 0.005"/></body>
  </body></worldbody></mujoco>"""


def test_springs_dampers_and_rotors_are_included_as_in_mujoco():
    mujoco = pytest.importorskip("mujoco")
    ours, theirs = Mechanism.from_mjcf(MJCF).build(), mujoco.MjModel.from_xml_string(MJCF)
    data, rng = mujoco.MjData(theirs), np.random.default_rng(5)
    names = [theirs.joint(k).name for k in range(theirs.njnt)]
    q, qd, tau = rng.normal(size=(3, theirs.nv))
    data.qpos[:], data.qvel[:], data.qfrc_applied[:] = q, qd, tau
    mujoco.mj_forward(theirs, data)
    mass = np.zeros((theirs.nv, theirs.nv))
    mujoco.mj_fullM(theirs, data, mass)
    at, rate, torque = (dict(zip(names, values, strict=True)) for values in (q, qd, tau))
    place = [ours.bodies.freedom(name)[1] for name in names]
    assert ours.mass_matrix(at)[np.ix_(place, place)] == pytest.approx(mass, rel=BY_MUJOCO)
    bias = data.qfrc_bias - data.qfrc_passive
    assert ours.bias(at, rate)[place] == pytest.approx(bias, rel=BY_MUJOCO)
    assert ours.forward_dynamics(at, rate, torque)[place] == pytest.approx(data.qacc, rel=BY_MUJOCO)


def four_bar(**at_start):
    m = Mechanism(gravity=(0, 0, -9.81))
    places = {"crank": ((0, 0, 0), (0, 0, 1.0)), "coupler": ((0, 0, 1.0), (2.0, 0, 1.5))}
    for name, (start, end) in {**places, "rocker": ((2.0, 0, 0), (2.0, 0, 1.5))}.items():
        m.body(name, 1.0, com=np.subtract(end, start) / 2.0, inertia=0.1)
    m.hinge("A", "world", "crank", axis=(0, 1, 0), **at_start)
    m.hinge("B", "crank", "coupler", axis=(0, 1, 0), at=(0, 0, 1.0))
    m.hinge("D", "world", "rocker", axis=(0, 1, 0), at=(2.0, 0, 0))
    m.close("C", ("coupler", (2.0, 0, 0.5)), ("rocker", (0, 0, 1.5)), axis=(0, 1, 0))
    return m


def test_loops_and_drives_accelerate_as_in_a_run():
    driven = four_bar()
    driven.drive("A", lambda t: (0.2 * np.sin(3.0 * t), 0.6 * np.cos(3.0 * t), -1.8 * np.sin(3.0 * t)))
    for m in (four_bar(qd=3.0), driven):
        model, h = m.build(), 1e-4
        run = model.simulate(2 * h, h, DormandPrince(1e-11))
        middle = model.state(q=run.q[1], qd=run.qd[1], time=h)
        slope = (run.qd[2] - run.qd[0]) / (2.0 * h)
        qdd = model.forward_dynamics(middle.q, middle.qd, time=h)
        assert qdd == pytest.approx(slope, abs=RATE_OF_STEP * np.max(np.abs(slope)))
        # The momentum of the run is M qd, of a drive at the time.
        p = model.mass_matrix(run.q[1], time=h) @ run.qd[1]
        assert 0.5 * p @ run.qd[1] == pytest.approx(run.kinetic[1], rel=1e-9)
    # Other torques, which need no force of the joint, give the same accelerations.
    model = four_bar(qd=3.0).build()
    qdd = model.forward_dynamics()
    tau = model.inverse_dynamics(None, None, qdd)
    assert model.forward_dynamics(tau=tau) == pytest.approx(qdd, rel=1e-9)
    assert np.max(np.abs(tau)) > 1.0
    # Coordinates of one hinge close the loop by the others.
    state = model.state(q={"A": 0.1})
    ends = state.point("coupler", (2.0, 0, 0.5)), state.point("rocker", (0, 0, 1.5))
    assert ends[0] == pytest.approx(ends[1], abs=1e-9)


def test_angles_are_in_the_unit_of_the_mechanism():
    m = Mechanism(gravity=(0, 0, -9.81), units="deg")
    m.body("rod", 2.0, com=(0, 0, -1.0), inertia=0.5)
    m.hinge("pin", "world", "rod", axis=(0, 1, 0))
    model = m.build()
    assert model.state(q={"pin": 30.0}).angle("pin") == pytest.approx(30.0)
    # M = m l^2 + I, and the torque of the weight is m g l sin(angle).
    assert model.mass_matrix({"pin": 30.0})[0, 0] == pytest.approx(2.5)
    assert model.bias({"pin": 30.0})[0] == pytest.approx(2.0 * 9.81 * 0.5)
    assert model.forward_dynamics({"pin": 0.0}, None, {"pin": 2.5})[0] == pytest.approx(1.0)
    assert model.inverse_dynamics({"pin": 0.0}, None, {"pin": 90.0})[0] == pytest.approx(2.5 * np.pi / 2.0)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda model: model.state(q={"knee": 0.1}), 'q: there is no hinge "knee"; there are .*"shoulder"'),
        (lambda model: model.state(q=[0.0]), r"q has shape \(1,\), not \(3,\)"),
        (lambda model: model.bias(np.nan * np.ones(3)), "q has nan at 0"),
        (lambda model: model.state(model.start(), q=np.zeros(3)), "give a phase, or q and qd"),
        (lambda model: model.forward_dynamics(tau={"rail": "much"}), "tau of rail"),
        (lambda model: model.state(q=np.zeros(3), time="now"), "time 'now'"),
    ],
)
def test_refused_in_one_line(call, message):
    with pytest.raises(ProtochainError, match=message):
        call(Mechanism.from_urdf(urdf("arm")).build())


def test_a_singular_pose_names_its_body():
    m = Mechanism()
    m.body("point", 1.0, inertia=0.0)
    m.hinge("pin", "world", "point", axis=(0, 1, 0), qd=0.0)
    with pytest.raises(MechanicsError):
        m.build().mass_matrix()
