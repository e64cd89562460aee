"""Pinocchio and MuJoCo, given the same tree, find the same accelerations."""

from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from fixtures.pinocchio_tree import KINDS, pinocchio_acceleration, state
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

AGREEMENT = {30: 1e-10, 300: 1e-8}
"""Relative, by number of hinges: two stable methods differ by eps times the condition of M, some 1e4 at 30
hinges and 1e7 at 300."""


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
