"""MJCF of random models: masses, rotors, springs, dampers and loops as MuJoCo has them, here and back."""

import numpy as np
import pytest
from fixtures.mujoco_states import motion_of
from fixtures.tolerances import BY_MUJOCO
from scipy.spatial.transform import Rotation

from protochain.core.errors import MechanicsError
from protochain.mechanics.motion import DormandPrince
from protochain.mechanisms import Mechanism

mujoco = pytest.importorskip("mujoco")

CLOSED = 1e-10
"""m and rad. MuJoCo's residual of a loop that is closed here to 1e-12 of its size."""


def text_of(values):
    return " ".join(f"{x:.17g}" for x in np.ravel(values))


def joint(rng, name, kind):
    """A joint with random attributes, of which some are missing."""
    given = {"armature": rng.uniform(0, 0.3), "damping": rng.uniform(0, 0.5), "stiffness": rng.uniform(0, 9)}
    if kind in ("hinge", "slide"):
        given |= {"springref": rng.normal(), "ref": 0.3 * rng.normal()}
        given |= {"axis": rng.normal(size=3), "pos": 0.2 * rng.normal(size=3)}
    if kind == "ball":
        given["pos"] = 0.2 * rng.normal(size=3)
    kept = {key: value for key, value in given.items() if rng.random() < 0.7}
    return f'<joint name="{name}" type="{kind}" ' + " ".join(
        f'{key}="{text_of(value)}"' for key, value in kept.items()
    ) + "/>"  # fmt: skip


def inertial(rng, thin):
    moments = np.sort(rng.uniform(0.02, 0.035, 3))
    if thin:
        moments[2] = moments[0] + moments[1]
    where = f'pos="{text_of(0.1 * rng.normal(size=3))}" quat="{text_of(rng.normal(size=4))}"'
    return f'<inertial {where} mass="{rng.uniform(0.5, 2)}" diaginertia="{text_of(moments)}"/>'


def random_mjcf(seed):
    """Two trees of random joints, up to three to a body, of which one is free."""
    rng = np.random.default_rng(seed)

    def body(k, depth):
        kinds = rng.choice(["hinge", "slide", "ball"], size=rng.integers(1, 4)).tolist()
        kinds = kinds[: kinds.index("ball") + 1] if "ball" in kinds else kinds
        joints = "".join(joint(rng, f"j{k}{i}", kind) for i, kind in enumerate(kinds))
        if depth == 0 and k == "1":
            joints = joint(rng, "f", "free")
        inner = "".join(body(f"{k}{i}", depth + 1) for i in range(rng.integers(1, 3))) if depth < 2 else ""
        at = f'pos="{text_of(0.3 * rng.normal(size=3))}" quat="{text_of(rng.normal(size=4))}"'
        return f'<body name="b{k}" {at}>{inertial(rng, rng.random() < 0.3)}{joints}{inner}</body>'

    off = "".join(f' {flag}="disable"' for flag in ("gravity", "spring", "damper") if rng.random() < 0.2)
    return (
        f'<mujoco><compiler angle="radian" autolimits="true"/><option gravity="1 2 -9"><flag{off}/></option>'
        f"<worldbody>{body('0', 0)}{body('1', 0)}</worldbody></mujoco>"
    )


@pytest.mark.parametrize("seed", range(12))
def test_random_models_move_as_in_mujoco_here_and_back(seed):
    text = random_mjcf(seed)
    m = Mechanism.from_mjcf(text)
    written = m.to_mjcf()
    # Bodies of several joints stay bodies of several joints.
    model = mujoco.MjModel.from_xml_string(text)
    back = mujoco.MjModel.from_xml_string(written)
    assert (back.nbody, back.njnt, back.nv) == (model.nbody, model.njnt, model.nv)
    for other in (model, back):
        for mechanism in (m, Mechanism.from_mjcf(written)):
            ours, theirs = motion_of(mechanism, other, seed)
            assert ours == pytest.approx(theirs, rel=BY_MUJOCO, abs=BY_MUJOCO * np.max(np.abs(theirs)))


def test_a_free_body_with_spring_damper_and_armature_moves_as_in_mujoco():
    text = """<mujoco><option integrator="RK4" timestep="0.0005"/><worldbody><body name="a" pos="0 0 1">
      <joint type="free" damping="2" stiffness="50" armature="0.2"/>
      <inertial pos="0.02 0 -0.2" mass="1" diaginertia="0.02 0.03 0.025"/></body></worldbody>
      <keyframe><key qvel="0.3 1 0 2 -1 3"/></keyframe></mujoco>"""
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    m = Mechanism.from_mjcf(text)
    built = m.build()
    qd = np.array([2.0, -1, 3, 0.3, 1, 0])
    data.qvel[:] = [*qd[3:], *qd[:3]]
    mujoco.mj_step(model, data, 400)
    run = built.simulate(0.2, 0.01, DormandPrince(1e-10), start=built.system.at(built.q, qd))
    state = built.state(run.end)
    assert np.allclose(state.point("a"), data.xpos[1], atol=1e-7)
    assert np.allclose(state.rotation("a").ravel(), data.xmat[1], atol=1e-7)
    assert run.audit().energy < 1e-8


WELDS = {
    "relpose": '<weld body1="a" body2="b" relpose="0.5 0.1 0 {quat}"/>',
    "anchor": '<weld body1="a" body2="b" anchor="0.2 0.3 0.1" relpose="0.5 0.1 0 {quat}"/>',
    "world": '<weld body1="b" relpose="0.5 0.1 0 {quat}"/>',
    "sites": '<weld site1="sa" site2="sb"/>',
    "connect": '<connect body1="a" body2="b" anchor="0.3 0.2 0"/>',
    "connected sites": '<connect site1="sa" site2="sb"/>',
}


@pytest.mark.parametrize("angle", [0.5, 2.0, 3.0])
@pytest.mark.parametrize("kind", WELDS)
def test_loops_are_closed_as_mujoco_wants_them(kind, angle):
    """MuJoCo, put where the mechanism begins, finds no residual of its constraint, as after a round trip."""
    turn = Rotation.from_rotvec(angle * np.array([0.6, 0.0, 0.8]))
    quat = text_of(np.roll(turn.as_quat(), 1))
    free = '<freejoint/><inertial pos="0 0 -.2" mass="1" diaginertia=".02 .03 .025"/>'
    text = f"""<mujoco><worldbody>
      <body name="a" pos="0 0 1" euler="20 0 30">{free}<site name="sa" pos="0.1 0.2 0" quat="{quat}"/></body>
      <body name="b" pos="0.5 0 1">{free}<site name="sb" pos="0 0.1 0" euler="0 40 0"/></body>
      </worldbody><equality>{WELDS[kind].format(quat=quat)}</equality></mujoco>"""
    m = Mechanism.from_mjcf(text)
    built = m.build()
    for source in (text, m.to_mjcf()):
        model = mujoco.MjModel.from_xml_string(source)
        data = mujoco.MjData(model)
        for name in "ab":
            b, j = built.bodies.number(name), int(model.body(name).jntadr[0])
            k, a = built.tree.q_start[b], int(model.jnt_qposadr[j])
            data.qpos[a : a + 7] = [*built.q[k + 4 : k + 7], *built.q[k : k + 4]]
        mujoco.mj_forward(model, data)
        assert data.nefc in (3, 6)
        assert np.max(np.abs(data.efc_pos)) < CLOSED


def test_a_rotation_of_another_kind_of_loop_is_refused():
    m = Mechanism()
    with pytest.raises(MechanicsError, match="rotation applies to kind rigid"):
        m.close("c", ("a", (0, 0, 0)), ("b", (0, 0, 0)), "revolute", rotation=np.eye(3))


def test_bodies_that_mujoco_would_refuse_are_written_so_that_it_loads_them():
    """Thin rods, flat plates, points and bodies without mass between hinges, and one that carries two."""
    m = Mechanism(gravity=(0, 0, -9.81))
    m.body("rod", 1.0, com=(0, 0, -0.5), inertia=(1 / 12, 1 / 12, 0))
    m.body("cross", 0.0)
    m.body("plate", 0.3, com=(0.1, 0, -0.1), inertia=Rotation.random(rng=1).as_matrix() @ np.diag(
        [0.1 / 3, 0.2 / 3, 0.1]) @ Rotation.random(rng=1).as_matrix().T)  # fmt: skip
    m.body("fork", 0.0)
    m.body("left", 0.2, com=(0, 0.3, 0.1), inertia=0.0)
    m.body("right", 0.2, com=(0.3, 0.1, 0), inertia=0.01)
    m.hinge("a", "world", "rod", axis=(0, 1, 0))
    m.hinge("b", "rod", "cross", at=(0, 0, -1), axis=(1, 0, 0.1))
    m.hinge("c", "cross", "plate", at=(0, 0, -0.1), axis=(0, 1, 0), armature=0.2)
    m.hinge("d", "plate", "fork", axis=(0, 0, 1), at=(0.2, 0, 0))
    m.hinge("e", "fork", "left", axis=(1, 0, 0))
    m.hinge("f", "fork", "right", axis=(0, 1, 0))
    model = mujoco.MjModel.from_xml_string(m.to_mjcf())
    assert model.nbody - 1 == 5  # The cross is a second joint of the plate.
    ours, theirs = motion_of(m, model, 3)
    assert ours == pytest.approx(theirs, rel=BY_MUJOCO, abs=BY_MUJOCO * np.max(np.abs(theirs)))
