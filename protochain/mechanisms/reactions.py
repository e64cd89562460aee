"""Forces in hinges and in joints of loops, and what drives give, at the rows of a run."""

from collections.abc import Iterator
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from protochain.core.arrays import Floats
from protochain.mechanics.motion import Phase
from protochain.mechanics.multibody.newton_euler import inertial_loads
from protochain.mechanisms.assembly import Assembly, Motion
from protochain.mechanisms.loop_joints import factor_loops

if TYPE_CHECKING:
    import pandas as pd


class Transmitted(NamedTuple):
    """Forces through hinges and joints at one moment."""

    at: Phase  # The moment.
    # (nb, 6): Moment about the origin of each body, and force, by which its parent, or the world, moves it.
    hinges: Floats
    joints: Floats  # (m,): Forces and moments of the equations of the joints that close loops.


def transmitted_forces(model: Assembly, at: Phase) -> Transmitted:
    """Find the forces of hinges, by Newton and Euler from the outermost bodies inward."""
    # What a body lacks to move as it does, beyond gravity, springs, loads and joints of loops, comes from its
    # parent, less what it passes on to its children: Luh, Walker, Paul (1980). O(n).
    tree, system, frames = model.tree, model.system, at.factors.frames
    qdd, _ = system.accelerations(at.time, at.q, at.qd, at.torque, at.loads, at.factors)
    applied, unread = np.zeros((tree.n_bodies, 6)), np.zeros(tree.n_v)
    for part in model.conservative:
        part.add(at.q, frames, applied, unread)
    for acting in model.loads:
        wrenches = acting.load.applied(at.time, at.q, at.qd, frames).wrenches
        applied += 0.0 if wrenches is None else wrenches
    impulses, joints = np.zeros(0), model.bodies.joints
    if joints is not None:
        # Driven hinges have accelerations in place of torques.
        torque = at.torque.copy()
        if model.drive is not None:
            torque[tree.driven_v] = model.drive(at.time)[2]
        free = system.forward_dynamics(at.q, at.qd, torque)
        loops = factor_loops(at.factors, joints)
        impulses = loops.impulses(-joints.accelerations(tree, frames, at.qd, free))
        applied += loops.wrenches(impulses)
    passed = inertial_loads(tree, frames, at.qd, qdd) - applied
    for b in range(tree.n_bodies - 1, -1, -1):
        p = int(tree.parent[b])
        if p >= 0:
            arm = frames.origin[b] - frames.origin[p]
            passed[p, :3] += passed[b, :3] + np.cross(arm, passed[b, 3:])
            passed[p, 3:] += passed[b, 3:]
    return Transmitted(at, passed, impulses)


def phases(run: Motion) -> Iterator[Phase]:
    """Phases of the rows, each while the elements' memories, as anchors of friction, are restored."""
    memories = run.model.memories
    try:
        for k, (time, q, qd) in enumerate(zip(run.time, run.q, run.qd, strict=True)):
            for memory, state in zip(memories, run.kept[k] if memories else (), strict=True):
                memory.recall(state)
            yield run.model.system.at(q, qd, float(time))
    finally:
        for memory in memories:
            memory.recall(None)


def reactions(run: Motion, name: str) -> "pd.DataFrame":
    """Return the forces that pass through a hinge, or a joint that closes a loop.

    Parameters
    ----------
    run : Run
        The motion.
    name : str
        Hinge or joint.

    Returns
    -------
    pandas.DataFrame
        A row a time: ``force x`` ... ``moment z``, world axes, on the child of a hinge about its origin,
        on the second body of a joint about its point. Torques of springs, motors and drives in it are
        among them. If joints depend on others, forces are not unique, and these are the least.

    Raises
    ------
    MechanicsError
        If the hinge is unknown.
    """
    import pandas as pd

    model, bodies = run.model, run.model.bodies
    rows = [k for k, joint in enumerate(bodies.joint_names) if joint == name]
    if not rows:
        b = bodies.hinge(name, "reactions")
        wrenches = [transmitted_forces(model, at).hinges[b] for at in phases(run)]
    else:
        assert bodies.joints is not None
        wrenches = [_of_joint(transmitted_forces(model, at), model, rows) for at in phases(run)]
    wrench = np.array(wrenches)
    columns = {f"force {axis}": wrench[:, 3 + k] for k, axis in enumerate("xyz")}
    columns |= {f"moment {axis}": wrench[:, k] for k, axis in enumerate("xyz")}
    return pd.DataFrame({"time": run.time, **columns})


def _of_joint(moment: Transmitted, model: Assembly, rows: list[int]) -> Floats:
    """(6,) float: moment about the joint's point of the second body, and force on that."""
    joints, frames = model.bodies.joints, moment.at.factors.frames
    assert joints is not None
    b = int(joints.body[rows[0], 1])
    point = joints.point[rows[0], 1]
    place = point if b < 0 else frames.rotation[b] @ point + frames.origin[b]
    # The wrench on the world is opposite to the wrench on the first body.
    side, sign = (1, 1.0) if b >= 0 else (0, -1.0)
    a = int(joints.body[rows[0], side])
    wrench = sign * np.einsum("m,mi->i", moment.joints[rows], joints.rows(frames)[1].wrench[rows, side])
    wrench[:3] += np.cross(frames.origin[a] - place, wrench[3:])
    return np.asarray(wrench)


def motion(run: Motion) -> "pd.DataFrame":
    """One row a time: coordinate and rate of each hinge, and torque and power of its motors or drive.

    ``pin``, ``pin rate``. A driven hinge has ``pin drive``, one with motors or torques ``pin torque``
    and ``pin power``, the sums of all of them. Slides have forces, and balls ``x``, ``y``, ``z``.
    """
    import pandas as pd

    model, tree = run.model, run.model.tree
    columns, bodies = {"time": run.time}, model.bodies
    motors = [k for k, load in enumerate(model.loads) if load.hinges]
    driving = torque = np.empty(0)
    if motors or model.drive is not None:
        loads = np.array([at.loads for at in phases(run)])
        driving, torque = loads[:, -1], np.sum(loads[:, motors], axis=1)
    moved = {name for k in motors for name in model.loads[k].hinges}
    for name, b in bodies.hinges.items():
        if tree.v_start[b] == tree.v_start[b + 1]:
            continue
        unit, place = bodies.unit(name), bodies.ball(name)
        if place:
            columns |= {f"{name} {x}": run.q[:, place[0]][:, k] / unit for k, x in enumerate("xyz")}
            columns |= {f"{name} rate {x}": run.qd[:, place[1]][:, k] / unit for k, x in enumerate("xyz")}
            continue
        q, v = bodies.freedom(name)
        columns |= {name: run.q[:, q] / unit, f"{name} rate": run.qd[:, v] / unit}
        if v in tree.driven_v:
            columns[f"{name} drive"] = driving[:, v]
        elif name in moved:
            columns |= {f"{name} torque": torque[:, v], f"{name} power": torque[:, v] * run.qd[:, v]}
    return pd.DataFrame(columns)
