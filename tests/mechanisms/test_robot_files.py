"""Robots of URDF and MJCF: masses, frames and motion as Pinocchio and MuJoCo have them."""

import sys
import warnings
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from fixtures.mujoco_states import motion_of, without
from fixtures.tolerances import BY_MUJOCO
from scipy.spatial.transform import Rotation

from protochain.core.errors import InertiaWarning, MechanicsError
from protochain.mechanics.motion import DormandPrince
from protochain.mechanics.multibody import forward_dynamics, pose
from protochain.mechanisms import Mechanism
from protochain.mechanisms.assemble import Body
from protochain.mechanisms.hinge_friction import HingeFriction

SAME = 1e-10
"""Of accelerations, relative: rounding of long chains, some thousand times."""
MOVED = 1e-7
"""Of places after half a second, by steps that keep 1e-10 and by a thousand of Runge-Kutta's."""

URDF = """<?xml version="1.0"?>
<robot name="arm">
  <material name="grey"><color rgba="0.5 0.5 0.5 1"/></material>
  <link name="world"/>
  <link name="base"><inertial><origin xyz="0 0 0.1"/><mass value="3"/>
    <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial>
    <visual><geometry><mesh filename="package://nowhere/base.stl"/></geometry></visual></link>
  <link name="upper"><inertial><origin xyz="0.1 -0.02 0.3" rpy="0.4 -0.3 1.2"/><mass value="2.5"/>
    <inertia ixx="0.11" ixy="0.01" ixz="-0.02" iyy="0.12" iyz="0.005" izz="0.05"/></inertial></link>
  <link name="cross"/>
  <link name="fore"><inertial><origin xyz="0.02 0.1 0.2"/><mass value="1.2"/>
    <inertia ixx="0.03" ixy="0" ixz="0.001" iyy="0.028" iyz="0" izz="0.01"/></inertial></link>
  <link name="hand"><inertial><origin rpy="0 0 1"/><mass value="0.4"/>
    <inertia ixx="0.002" ixy="0" ixz="0" iyy="0.003" iyz="0" izz="0.0025"/></inertial></link>
  <link name="tool"/>
  <joint name="weld" type="fixed"><parent link="world"/><child link="base"/><origin xyz="0.1 0.2 0"/></joint>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
    <origin xyz="0 0.1 0.4" rpy="0.2 0.5 -0.7"/><axis xyz="0.3 0.4 1"/>
    <limit lower="-1.5" upper="2" effort="1" velocity="1"/><dynamics damping="0.3" friction="0.2"/></joint>
  <joint name="elbow" type="continuous"><parent link="upper"/><child link="cross"/>
    <origin xyz="0 0 0.6"/><axis xyz="0 1 0"/></joint>
  <joint name="roll" type="continuous"><parent link="cross"/><child link="fore"/><axis xyz="1 0 0"/></joint>
  <joint name="rail" type="prismatic"><parent link="fore"/><child link="hand"/>
    <origin xyz="0 0 0.5" rpy="1 0 0"/><axis xyz="0 0 -1"/>
    <limit lower="-0.2" upper="0.2" effort="1" velocity="1"/></joint>
  <joint name="tip" type="fixed"><parent link="hand"/><child link="tool"/>
    <origin xyz="0 0 0.1"/><axis xyz="0 0 0"/></joint>
</robot>
"""

MJCF = """<mujoco>
  <compiler angle="radian"/>
  <option gravity="0.3 0 -9.81" integrator="RK4" timestep="0.0005"><flag contact="disable"/></option>
  <worldbody>
    <body name="base" pos="0.1 0.2 0.5" euler="0.3 0.1 0">
      <joint name="pan" axis="0 1 0.2" pos="0.05 0 0.1" damping="0.2" stiffness="3" springref="0.4"
        ref="0.3"/>
      <inertial pos="0.1 0 -0.2" mass="1.2" diaginertia="0.02 0.03 0.025" euler="0.1 0.5 0"/>
      <body name="arm" pos="0.3 0 -0.1" euler="0 0.4 0.2">
        <joint name="tilt" axis="1 0 0"/>
        <joint name="rail" type="slide" axis="0 0 1" pos="0.1 0.1 0" stiffness="50" ref="0.02" damping="1"/>
        <joint name="turn" axis="0 1 0" pos="0 0.05 0"/>
        <inertial pos="0 0.1 -0.1" mass="0.7" diaginertia="0.01 0.012 0.013"/>
        <body name="tip" pos="0 0 -0.4"><joint name="ball" type="ball"/>
          <inertial pos="0.05 0 -0.1" mass="0.4" diaginertia="0.003 0.004 0.005"/></body>
      </body>
    </body>
    <body name="flier" pos="1 0 1" euler="0.4 0 0"><freejoint/>
      <inertial pos="0.02 0.03 0" mass="0.5" diaginertia="0.003 0.004 0.005"/></body>
  </worldbody>
</mujoco>"""


def robots():
    """URDF files of the package example-robot-data, where it is on the path."""
    found = [Path(place) / "cmeel.prefix/share/example-robot-data/robots" for place in sys.path]
    names = (
        "panda_description/urdf/panda.urdf", "ur_description/urdf/ur5_robot.urdf",
        "talos_data/robots/talos_left_arm.urdf", "g1_description/urdf/g1_29dof_rev_1_0.urdf",
        "solo_description/robots/solo12.urdf", "human_description/robots/human.urdf",
    )  # fmt: skip
    return [each / name for each in found for name in names if (each / name).is_file()]


def accelerations(model, seed):
    """At a random state: coordinates, rates, torques, and accelerations of ours by hinge."""
    rng, bodies = np.random.default_rng(seed), model.bodies
    tree = bodies.tree
    q, qd, tau = rng.uniform(-1, 1, tree.n_q), rng.normal(size=tree.n_v), rng.normal(size=tree.n_v)
    found = forward_dynamics(tree, q, qd, tau, bodies.weights(pose(tree, q)))
    moving = [name for name, b in bodies.hinges.items() if tree.v_start[b] < tree.v_start[b + 1]]
    places = {name: bodies.freedom(name) for name in moving}
    return {name: (q[k], qd[v], tau[v], found[v]) for name, (k, v) in places.items()}


def of_pinocchio(pin, model, given):
    q, qd, tau = pin.neutral(model), np.zeros(model.nv), np.zeros(model.nv)
    for name, (at, rate, torque, _) in given.items():
        joint = model.joints[model.getJointId(name)]
        q[joint.idx_q : joint.idx_q + joint.nq] = (np.cos(at), np.sin(at)) if joint.nq == 2 else at
        qd[joint.idx_v], tau[joint.idx_v] = rate, torque
    found = pin.aba(model, model.createData(), q, qd, tau)
    return np.array([found[model.joints[model.getJointId(name)].idx_v] for name in given])


def test_a_urdf_moves_as_pinocchio_reads_it():
    pin = pytest.importorskip("pinocchio")
    model, other = Mechanism.from_urdf(URDF).build(), pin.buildModelFromXML(URDF)
    for seed in range(5):
        given = accelerations(model, seed)
        assert given.keys() == {"shoulder", "elbow", "roll", "rail"}
        wanted = of_pinocchio(pin, other, given)
        ours = np.array([each[3] for each in given.values()])
        assert np.max(np.abs(ours - wanted)) < SAME * np.max(np.abs(wanted))


DUMMIES = {
    "needle": ("roll", 'mass value="0.01"', "1e-9", "1e-9", "1e-3"),
    "no mass": ("roll", 'mass value="0"', "1e-4", "1e-4", "1e-4"),
    "negative by rounding": ("tip", 'mass value="0.1"', "-5.4e-20", "-5.4e-20", "0"),
    "moving": ("rail", 'mass value="0.3"', "1e-3", "1e-3", "0.05"),
}  # fmt: skip
"""Joint, mass and moments of its child, which no body has."""


def with_dummy(joint, mass, xx, yy, zz):
    """The arm with a link of such an inertia fixed to the child of a joint, or in its place."""
    inertial = f'<inertial><origin xyz="0.01 0 0.02" rpy="0.3 0 0"/><{mass}/>'
    inertial += f'<inertia ixx="{xx}" ixy="0" ixz="0" iyy="{yy}" iyz="0" izz="{zz}"/></inertial>'
    if joint == "rail":
        start = URDF.index('<link name="hand">')
        return (
            URDF[:start]
            + f'<link name="hand">{inertial}</link>'
            + URDF[URDF.index('  <link name="tool"/>') :]
        )
    child = {"roll": "fore", "tip": "tool"}[joint]
    more = f'<link name="dummy">{inertial}</link><joint name="to dummy" type="fixed"><parent link="{child}"/>'
    return URDF.replace("</robot>", f'{more}<child link="dummy"/><origin xyz="0.1 0 0"/></joint></robot>')


@pytest.mark.parametrize("case", DUMMIES)
def test_an_inertia_that_no_body_has_is_used_as_it_is_and_named(case):
    pin, text = pytest.importorskip("pinocchio"), with_dummy(*DUMMIES[case])
    link = "hand" if case == "moving" else "dummy"
    with pytest.warns(InertiaWarning, match=f'link "{link}": its inertia .* used unchanged'):
        m = Mechanism.from_urdf(text)
    model, other = m.build(), pin.buildModelFromXML(text)
    given = accelerations(model, 1)
    wanted, ours = of_pinocchio(pin, other, given), np.array([each[3] for each in given.values()])
    assert np.max(np.abs(ours - wanted)) < SAME * np.max(np.abs(wanted))
    # As a body of its own it is refused.
    body = next(each for each in m.parts(Body) if each.name == link)
    alone = Mechanism()
    alone.body("b", body.mass, inertia=body.inertia)
    with pytest.raises(MechanicsError, match="inertia"):
        alone.build()


@pytest.mark.parametrize("case", DUMMIES)
def test_what_is_fixed_to_others_goes_to_mjcf_as_one_body(case):
    mujoco = pytest.importorskip("mujoco")
    with pytest.warns(InertiaWarning):
        m = Mechanism.from_urdf(with_dummy(*DUMMIES[case]))
    m = without(m, HingeFriction)
    if case == "moving":
        with pytest.raises(MechanicsError, match='body "hand": MuJoCo requires the triangle inequality'):
            m.to_mjcf()
        return
    ours, theirs = motion_of(m, mujoco.MjModel.from_xml_string(m.to_mjcf()), 2)
    assert ours == pytest.approx(theirs, rel=BY_MUJOCO, abs=BY_MUJOCO * np.max(np.abs(theirs)))


@pytest.mark.parametrize("path", robots() or [None], ids=lambda path: path.stem if path else "none")
def test_public_robots_move_as_pinocchio_reads_them(path):
    if path is None:
        pytest.skip("example-robot-data is not installed")
    pin = pytest.importorskip("pinocchio")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InertiaWarning)
        model = Mechanism.from_urdf(path, leave_out=("mimic",)).build()
    other = pin.buildModelFromUrdf(str(path))
    assert np.sum(model.tree.mass) == pytest.approx(sum(each.mass for each in other.inertias))
    given = accelerations(model, 1)
    wanted, ours = of_pinocchio(pin, other, given), np.array([each[3] for each in given.values()])
    assert np.max(np.abs(ours - wanted)) < SAME * np.max(np.abs(wanted))


def test_joints_of_a_urdf_resist_as_it_says():
    m = Mechanism.from_urdf(URDF, stops=300.0)
    model = m.build()
    assert model.works == ("damping", "hinge friction")
    names = {part.name for part in m.parts(object)}
    assert {"shoulder: damping", "shoulder: friction", "shoulder: stop", "rail: stop"} <= names
    assert "elbow: stop" not in names
    run = model.simulate(0.2, 0.005, DormandPrince(1e-8))
    assert run.table["dissipation"].iloc[-1] > 0.0
    # The world's link is the world, and bodies keep their frames.
    assert np.allclose(model.state().point("base"), (0.1, 0.2, 0.0))
    weld = URDF[URDF.index('  <joint name="weld"') : URDF.index('  <joint name="shoulder"')]
    free = Mechanism.from_urdf(URDF.replace('<link name="world"/>', "").replace(weld, ""), free=True)
    assert free.build().tree.n_v == 6 + 4


def test_an_mjcf_moves_as_in_mujoco():
    mujoco = pytest.importorskip("mujoco")
    model = Mechanism.from_mjcf(MJCF).build()
    other = mujoco.MjModel.from_xml_string(MJCF)
    data = mujoco.MjData(other)
    mujoco.mj_step(other, data, 1000)
    run = model.simulate(0.5, 0.01, DormandPrince(1e-10))
    state = model.state(run.end)
    for name in ("base", "arm", "tip", "flier"):
        assert np.allclose(state.point(name), data.body(name).xpos, atol=MOVED)
        assert np.allclose(state.rotation(name).ravel(), data.body(name).xmat, atol=MOVED)
    for name in ("pan", "rail", "turn"):
        assert state.angle(name) == pytest.approx(float(data.joint(name).qpos[0]), abs=MOVED)


def test_a_mechanism_goes_to_mjcf_and_back():
    mujoco = pytest.importorskip("mujoco")
    m = Mechanism(gravity=(0, 0, -9.81), units="deg")
    for k, name in enumerate("abc"):
        m.body(
            name, mass=1.0 + k, com=(0.1, 0.05, -0.3), inertia=[[0.1, 0.01, 0], [0.01, 0.08, 0], [0, 0, 0.09]]
        )
    m.hinge("h", "world", "a", axis=(0, 1, 0))
    m.hinge("s", "a", "b", "ball", at=(0, 0, -0.6))
    m.hinge("l", "b", "c", "prismatic", at=(0.1, 0, -0.5), axis=(1, 0, 0.2))
    m.body("f", mass=1.0, inertia=0.1, position=(1, 0, 0))
    m.spring("tie", ("c", (0, 0, 0.1)), ("f", (0.1, 0, 0)), stiffness=30, damping=0.5)
    m.torsion("t", "h", stiffness=2.0, damping=0.3, rest=20.0)
    m.torsion("u", "l", stiffness=20.0, damping=0.3)
    model = mujoco.MjModel.from_xml_string(text := m.to_mjcf())
    model.opt.timestep = 5e-4
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 1000)
    run = m.build().simulate(0.5, 0.01, DormandPrince(1e-10))
    state = run.model.state(run.end)
    for name in "abcf":
        assert np.allclose(state.point(name), data.body(name).xpos, atol=MOVED)
    back = Mechanism.from_mjcf(text, leave_out=["tendons"], units="deg")
    back.spring("tie", ("c", (0, 0, 0.1)), ("f", (0.1, 0, 0)), stiffness=30, damping=0.5)
    again = back.build().simulate(0.5, 0.01, DormandPrince(1e-10))
    assert np.allclose(again.q[-1], run.q[-1], atol=MOVED)
    m.hinge("w", "c", "g", "screw", pitch=0.1)
    m.body("g", 1.0, inertia=0.1)
    with pytest.raises(MechanicsError, match=r'hinge "w".*screw'):
        m.to_mjcf()


@pytest.mark.parametrize(("rest", "written"), [(None, (0.5, 0.15)), (0.0, (0.0, 0.0)), (0.2, (0.2, 0.2))])
def test_a_spring_at_rest_where_it_is_built_is_at_rest_there_in_mjcf(rest, written):
    m = Mechanism()
    for name in "ac":
        m.body(name, mass=1.0, inertia=0.1)
    m.hinge("h", "world", "a", axis=(0, 1, 0), q=0.5)
    m.hinge("l", "a", "c", "prismatic", axis=(1, 0, 0), q=0.15)
    m.torsion("t", "h", stiffness=2.0, rest=rest)
    m.torsion("u", "l", stiffness=20.0, rest=rest)
    joints = {joint.get("name"): joint for joint in ElementTree.fromstring(m.to_mjcf()).iter("joint")}
    assert tuple(float(joints[name].get("springref", 0.0)) for name in "hl") == written


def test_loops_of_an_mjcf_close():
    pytest.importorskip("mujoco")
    text = """<mujoco><compiler angle="radian"/><worldbody>
      <body name="crank"><joint name="a" axis="0 -1 0"/><geom type="capsule" fromto="0 0 0 1 0 0" size="0.1"/>
        <body name="rod" pos="1 0 0"><joint name="b" axis="0 -1 0"/>
          <geom type="capsule" fromto="0 0 0 2 0 0" size="0.1"/></body></body>
      <body name="rocker" pos="2 0 0"><joint name="d" axis="0 -1 0"/>
        <geom type="capsule" fromto="0 0 0 1 0 0" size="0.1"/></body>
      </worldbody><equality><connect body1="rod" body2="rocker" anchor="2 0 0"/></equality></mujoco>"""
    run = Mechanism.from_mjcf(text).build().simulate(0.3, 0.01, DormandPrince(1e-9))
    state = run.model.state(run.end)
    assert np.allclose(state.point("rod", (2, 0, 0)), state.point("rocker", (1, 0, 0)), atol=1e-11)
    assert run.audit().energy < 1e-7


LEAN = np.arcsin(0.75)
CRANK, ROD = (Rotation.from_rotvec([0, angle, 0]) for angle in (LEAN, np.pi - LEAN))


def crank_and_rod():
    """Two bars, of which the second ends 1.5 to the right of where the first is held, and as high."""
    m = Mechanism(gravity=(0, 0, -9.81))
    for name, length in (("crank", 1.0), ("rod", 1.0)):
        inertia = 0.1 * np.diag([1.0, 1.0, 0.1])
        m.body(name, 1.0, com=(0, 0, 0.5 * length), inertia=inertia)
    m.hinge("a", "world", "crank", axis=(0, 1, 0), rotation=CRANK.as_matrix())
    m.hinge("b", "crank", "rod", axis=(0, 1, 0), at=(0, 0, 1.0), rotation=(CRANK.inv() * ROD).as_matrix())
    return m


@pytest.mark.parametrize("kind", ["spherical", "rigid"])
@pytest.mark.parametrize("side", ["world first", "world last", "a body"])
def test_loops_go_to_mjcf_and_back(kind, side):
    """Of four bars, the last a post; a weld holds what a hinge lets turn."""
    mujoco = pytest.importorskip("mujoco")
    m, up, foot = crank_and_rod(), ROD.inv().as_matrix(), (1.5, 0, -0.4)
    m.body("post", 1.0, inertia=0.1)
    m.body("foot", 1.0, inertia=0.1)
    if side == "a body":
        m.hinge("d", "world", "post", axis=(0, 1, 0), at=foot)
        m.hinge("c", "rod", "foot", axis=(0, 1, 0), at=(0, 0, 1.0), rotation=up)
        there, end = ("post", (0, 0, 0.4)), ("rod", (0, 0, 1.0))
    else:
        m.hinge("c", "rod", "post", axis=(0, 1, 0), at=(0, 0, 1.0), rotation=up)
        m.hinge("d", "post", "foot", axis=(0, 1, 0), at=(0, 0, -0.4))
        there, end = ("world", foot), ("post", (0, 0, -0.4))
    end = ("foot", (0, 0, 0)) if kind == "rigid" else end
    m.close("C", *((there, end) if side == "world first" else (end, there)), kind)
    text = m.to_mjcf()
    model = mujoco.MjModel.from_xml_string(text)
    assert model.neq == 1
    assert model.eq_type[0] == (mujoco.mjtEq.mjEQ_WELD if kind == "rigid" else mujoco.mjtEq.mjEQ_CONNECT)
    both = m, Mechanism.from_mjcf(text)
    run, back = (each.build().simulate(0.2, 0.02, DormandPrince(1e-9)) for each in both)
    assert np.abs(run.q[-1] - run.q[0]).max() > 0.01
    assert np.allclose(back.q[-1], run.q[-1], atol=MOVED)
    first, second = (run.model.state(run.end).point(*each) for each in (end, there))
    assert np.allclose(first, second, atol=1e-9)


def test_what_mjcf_cannot_say_is_refused_by_name():
    m = crank_and_rod()
    m.close("C", ("rod", (0, 0, 1.0)), ("world", (1.5, 0, 0)), "revolute", axis=(0, 1, 0))
    with pytest.raises(MechanicsError, match=r'"C": MJCF closes loops by ball and rigid only, not by'):
        m.to_mjcf()
    for act, said in (
        (lambda m: m.friction("f", "a", coefficient=0.1), 'friction "f": MJCF has constant friction only'),
        (lambda m: m.load("f", "rod", force=(1, 0, 0)), 'load "f": MJCF does not support it'),
        (
            lambda m: (m.torsion("t", "a", 1.0), m.torsion("u", "a", 2.0)),
            'torsion "u": hinge "a" has a stiffness already',
        ),
    ):
        m = crank_and_rod()
        act(m)
        with pytest.raises(MechanicsError, match=said):
            m.to_mjcf()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("<robot", "XML"), ("<sdf/>", "<robot>"), (URDF.replace("continuous", "planar"), "planar"),
        (URDF.replace('value="2.5"', 'value="much"'), "much"),
        (URDF.replace('<axis xyz="1 0 0"/>', '<axis xyz="1 0 0"/><mimic joint="elbow"/>'), 'mimic.*"roll"'),
        ("nowhere.urdf", "nowhere.urdf"), (7, "7"),
    ],
    ids=["cut", "other", "planar", "mass", "mimic", "nowhere", "number"],
)  # fmt: skip
def test_files_that_are_none_or_have_more_are_refused(text, said):
    with pytest.raises(MechanicsError, match=said):
        Mechanism.from_urdf(text)


def test_an_mjcf_with_more_is_refused_unless_it_is_left_out(tmp_path):
    pytest.importorskip("mujoco")
    heavy = MJCF.replace('<body name="arm"', '<body name="arm" gravcomp="0.5"')
    with pytest.raises(MechanicsError, match=r'gravcomp \("arm"\).*leave_out'):
        Mechanism.from_mjcf(heavy)
    file = tmp_path / "robot.xml"
    file.write_text(heavy)
    m = Mechanism.from_mjcf(file, leave_out={"gravcomp"})
    assert m.left_out == {"gravcomp": "arm"}
    m.build()
    with pytest.raises(MechanicsError, match="MuJoCo cannot read it"):
        Mechanism.from_mjcf(MJCF.replace("slide", "glide"))
