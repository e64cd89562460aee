"""Pinocchio and MuJoCo, given the same tree, find the same accelerations."""

from types import SimpleNamespace

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

from protochain.mechanics.multibody import (
    HingeKind,
    Tree,
    forward_dynamics,
    log_det_mass,
    mass_matrix,
    pose,
    random_tree,
)

KINDS = (HingeKind.REVOLUTE, HingeKind.PRISMATIC, HingeKind.SCREW)
AGREEMENT = {30: 1e-10, 300: 1e-8}
"""Relative, by number of hinges: two stable methods differ by eps times the condition of M, some 1e4 at 30
hinges and 1e7 at 300."""


def state(tree: Tree, seed: int) -> SimpleNamespace:
    rng = np.random.default_rng(seed)
    q = rng.uniform(-2, 2, size=tree.n_q)
    if tree.kind[0] == HingeKind.FREE:
        q[:4] /= np.linalg.norm(q[:4])
    return SimpleNamespace(q=q, qd=rng.normal(size=tree.n_v), tau=rng.normal(size=tree.n_v))


def pinocchio_acceleration(tree: Tree, s: SimpleNamespace) -> np.ndarray:
    joints = {
        HingeKind.REVOLUTE: lambda pitch: pin.JointModelRZ(),
        HingeKind.PRISMATIC: lambda pitch: pin.JointModelPZ(),
        HingeKind.SCREW: lambda pitch: pin.JointModelHZ(pitch),
        HingeKind.FREE: lambda pitch: pin.JointModelFreeFlyer(),
    }
    model = pin.Model()
    joint_of = []
    for b in range(tree.n_bodies):
        parent = joint_of[tree.parent[b]] if tree.parent[b] >= 0 else 0
        placement = pin.SE3(np.array(tree.placement[b]), np.array(tree.offset[b]))
        joint = joints[HingeKind(tree.kind[b])](tree.pitch[b])
        joint_of.append(model.addJoint(parent, joint, placement, f"body{b}"))
        inertia = pin.Inertia(tree.mass[b], np.array(tree.com[b]), np.array(tree.inertia[b]))
        model.appendBodyToJoint(joint_of[b], inertia, pin.SE3.Identity())
    model.gravity.setZero()
    q, v, tau = (np.zeros(model.nq), np.zeros(model.nv), np.zeros(model.nv))
    turn = Rotation.from_quat(np.roll(s.q[:4], -1)).as_matrix() if tree.kind[0] == HingeKind.FREE else None
    for b, joint in enumerate(joint_of):
        iq, iv = model.joints[joint].idx_q, model.joints[joint].idx_v
        k, m = tree.q_start[b], tree.v_start[b]
        if turn is not None and b == 0:
            # Position, quaternion (x, y, z, w); velocities and forces linear first, in the body's axes.
            q[iq : iq + 7] = [*s.q[4:7], *s.q[1:4], s.q[0]]
            v[iv : iv + 6] = [*turn.T @ s.qd[3:6], *turn.T @ s.qd[:3]]
            tau[iv : iv + 6] = [*turn.T @ s.tau[3:6], *turn.T @ s.tau[:3]]
        else:
            q[iq], v[iv], tau[iv] = s.q[k], s.qd[m], s.tau[m]
    a = pin.aba(model, model.createData(), q, v, tau)
    out = np.zeros(tree.n_v)
    for b, joint in enumerate(joint_of):
        iv, m = model.joints[joint].idx_v, tree.v_start[b]
        if turn is not None and b == 0:
            # The derivative of velocity's components in moving axes leaves omega x u out.
            out[:3], out[3:6] = (
                turn @ a[iv + 3 : iv + 6],
                turn @ a[iv : iv + 3] + np.cross(s.qd[:3], s.qd[3:6]),
            )
        else:
            out[m] = a[iv]
    return out


def mujoco_acceleration(tree: Tree, s: SimpleNamespace) -> np.ndarray:
    spec = mujoco.MjSpec()
    spec.option.gravity = [0, 0, 0]
    bodies = []
    for b in range(tree.n_bodies):
        parent = bodies[tree.parent[b]] if tree.parent[b] >= 0 else spec.worldbody
        i = tree.inertia[b]
        body = parent.add_body(
            pos=tree.offset[b], quat=np.roll(Rotation.from_matrix(np.array(tree.placement[b])).as_quat(), 1),
            mass=tree.mass[b], ipos=tree.com[b], explicitinertial=True,
            fullinertia=[i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2]],
        )  # fmt: skip
        kinds = {
            HingeKind.REVOLUTE: mujoco.mjtJoint.mjJNT_HINGE,
            HingeKind.PRISMATIC: mujoco.mjtJoint.mjJNT_SLIDE,
            HingeKind.FREE: mujoco.mjtJoint.mjJNT_FREE,
        }
        body.add_joint(name=f"body{b}", type=kinds[HingeKind(tree.kind[b])], axis=[0, 0, 1])
        bodies.append(body)
    model = spec.compile()
    data = mujoco.MjData(model)
    turn = Rotation.from_quat(np.roll(s.q[:4], -1)).as_matrix() if tree.kind[0] == HingeKind.FREE else None
    starts = [model.joint(f"body{b}") for b in range(tree.n_bodies)]
    for b, joint in enumerate(starts):
        iq, iv, k, m = joint.qposadr[0], joint.dofadr[0], tree.q_start[b], tree.v_start[b]
        if turn is not None and b == 0:
            # Position, quaternion (w, x, y, z); linear velocity in the world, angular in the body's axes.
            data.qpos[iq : iq + 7] = [*s.q[4:7], *s.q[:4]]
            data.qvel[iv : iv + 6] = [*s.qd[3:6], *turn.T @ s.qd[:3]]
            data.qfrc_applied[iv : iv + 6] = [*s.tau[3:6], *turn.T @ s.tau[:3]]
        else:
            data.qpos[iq], data.qvel[iv], data.qfrc_applied[iv] = s.q[k], s.qd[m], s.tau[m]
    mujoco.mj_forward(model, data)
    out = np.zeros(tree.n_v)
    for b, joint in enumerate(starts):
        iv, m = joint.dofadr[0], tree.v_start[b]
        if turn is not None and b == 0:
            out[:3], out[3:6] = turn @ data.qacc[iv + 3 : iv + 6], data.qacc[iv : iv + 3]
        else:
            out[m] = data.qacc[iv]
    return out


@pytest.mark.parametrize("root", [HingeKind.REVOLUTE, HingeKind.FREE])
@pytest.mark.parametrize("branching", [0.0, 0.5])
@pytest.mark.parametrize("n", AGREEMENT)
@pytest.mark.parametrize("engine", ["pinocchio", "mujoco"])
def test_accelerations_agree(engine, n, branching, root):
    kinds = KINDS if engine == "pinocchio" else KINDS[:2]
    tree = random_tree(n + (root == HingeKind.FREE), 17 + n, branching, root, kinds)
    s = state(tree, n)
    theirs = (pinocchio_acceleration if engine == "pinocchio" else mujoco_acceleration)(tree, s)
    ours = forward_dynamics(tree, s.q, s.qd, s.tau)
    assert np.abs(ours - theirs).max() < AGREEMENT[n] * np.abs(ours).max()


def test_the_mass_matrix_is_pinocchios():
    tree = random_tree(40, 3, 0.3, HingeKind.REVOLUTE, KINDS)
    s = state(tree, 1)
    frames = pose(tree, s.q)
    # Accelerations for unit torques at rest are the columns of the inverse.
    s.qd = np.zeros(tree.n_v)
    columns = []
    for unit in np.eye(tree.n_v):
        s.tau = unit
        columns.append(pinocchio_acceleration(tree, s))
    m = mass_matrix(tree, frames)
    assert np.abs(m @ np.array(columns).T - np.eye(tree.n_v)).max() < 1e-9
    assert log_det_mass(tree, frames) == pytest.approx(-np.linalg.slogdet(columns)[1], abs=1e-9)
