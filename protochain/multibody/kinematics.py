"""Where the bodies are, how they move, what loads on them do at the hinges: one sweep each, O(n)."""

from dataclasses import dataclass

import numpy as np

from protochain.arrays import Floats, Integers, floats, frozen
from protochain.multibody.algebra import (
    Vector,
    add,
    add_pair,
    cross,
    dot,
    hinge_axis,
    kernel,
    lever,
    matrix,
    pair,
    put,
    put_pair,
    scale,
    subtract,
    turned,
    vector,
)  # fmt: skip
from protochain.multibody.tree import Tree
from protochain.multibody.trigonometry import cosines_and_sines


@dataclass(frozen=True, eq=False)
class Frames:
    """World frames of the bodies at one q.

    Parameters
    ----------
    rotation : (nb, 3, 3) float
        Columns are the body's axes in the world; the third is the hinge's.
    origin : (nb, 3) float, nm
        The body frame's origin, which lies on its hinge axis.
    """

    rotation: Floats
    origin: Floats


def pose(tree: Tree, q: Floats) -> Frames:
    """World frames of all bodies at q, by one outward sweep.

    Parameters
    ----------
    tree : Tree
    q : (n_q,) float, rad (nm for prismatic hinges and the position of free roots)

    Returns
    -------
    Frames

    Notes
    -----
    Featherstone, *Rigid Body Dynamics Algorithms* (2008), section 4.4. O(n).
    """
    rotation = np.empty((tree.n_bodies, 3, 3))
    origin = np.empty((tree.n_bodies, 3))
    _outward_frames(
        tree.parent, tree.q_start, tree.twist, tree.offset, tree.placement,
        floats(q, (tree.n_q,), "q"), rotation, origin,
    )  # fmt: skip
    return Frames(frozen(rotation), frozen(origin))


def velocities(tree: Tree, frames: Frames, qd: Floats) -> Floats:
    """Twists of the bodies, V = J qd, by one outward sweep.

    Parameters
    ----------
    tree : Tree
    frames : Frames
    qd : (n_v,) float, rad/ps or nm/ps

    Returns
    -------
    (nb, 6) float, rad/ps and nm/ps
        Angular velocity, then velocity of the frame's origin, world axes.

    Notes
    -----
    Featherstone, *Rigid Body Dynamics Algorithms* (2008), equation 3.33. O(n).
    """
    twists = np.empty((tree.n_bodies, 6))
    _outward_twists(
        tree.parent, tree.v_start, tree.twist, frames.rotation, frames.origin,
        floats(qd, (tree.n_v,), "qd"), twists,
    )  # fmt: skip
    return twists


def jacobian(tree: Tree, frames: Frames) -> Floats:
    """Dense Jacobian of the body twists: V = J qd.

    Parameters
    ----------
    tree : Tree
    frames : Frames

    Returns
    -------
    (nb, 6, n_v) float
        A column for each freedom. O(n^2): for tests and small studies.
    """
    return np.stack([velocities(tree, frames, unit) for unit in np.eye(tree.n_v)], axis=2)


def pull_back(tree: Tree, frames: Frames, wrench: Floats) -> Floats:
    """Generalised torques tau = J^T wrench of loads on the bodies, by one inward sweep.

    Parameters
    ----------
    tree : Tree
    frames : Frames
    wrench : (nb, 6) float, kJ/mol/rad and kJ/mol/nm
        Moment on each body about its frame's origin, then force; world axes.

    Returns
    -------
    (n_v,) float
        kJ/mol for each unit of q; a free root has (moment, force) about its frame's origin, world axes.

    Notes
    -----
    The inward half of the recursive Newton-Euler algorithm without inertia: Featherstone, *Rigid Body
    Dynamics Algorithms* (2008), table 5.1. O(n).
    """
    tau = np.empty(tree.n_v)
    _inward_loads(
        tree.parent, tree.v_start, tree.twist, frames.rotation, frames.origin,
        floats(wrench, (tree.n_bodies, 6), "wrench").copy(), tau,
    )  # fmt: skip
    return tau


def integrate(tree: Tree, q: Floats, qd: Floats) -> Floats:
    """Move from q along qd for unit time, keeping quaternions of unit length.

    Parameters
    ----------
    tree : Tree
    q : (n_q,) float
    qd : (n_v,) float
        Hinge rates; a free root turns about the world-frame vector omega and moves by u.

    Returns
    -------
    (n_q,) float
        For a free root exp(omega) times its rotation, so d/dt along the path is (omega, u) throughout.
    """
    moved = floats(q, (tree.n_q,), "q").copy()
    _integrate(tree.q_start, tree.v_start, floats(qd, (tree.n_v,), "qd"), moved)
    return moved


@kernel
def _outward_frames(
    parent: Integers, q_start: Integers, twist: Floats, offset: Floats, placement: Floats, q: Floats,
    rotation: Floats, origin: Floats,
) -> None:  # fmt: skip
    cosine, sine = np.empty(len(q)), np.empty(len(q))
    cosines_and_sines(q, cosine, sine)
    for b in range(len(parent)):
        p, k = parent[b], q_start[b]
        n_q = q_start[b + 1] - k
        joint, at = matrix(placement, b), vector(offset, b)
        if p >= 0:
            above = matrix(rotation, p)
            x = turned(above, (joint[0], joint[3], joint[6]))
            y = turned(above, (joint[1], joint[4], joint[7]))
            z = turned(above, (joint[2], joint[5], joint[8]))
            at = add(vector(origin, p), turned(above, at))
        else:
            x, y, z = (
                (joint[0], joint[3], joint[6]), (joint[1], joint[4], joint[7]), (joint[2], joint[5], joint[8])
            )  # fmt: skip
        if n_q == 1:
            if twist[b, 0] != 0.0:
                c, s = cosine[k], sine[k]
                x, y = add(scale(c, x), scale(s, y)), subtract(scale(c, y), scale(s, x))
            if twist[b, 1] != 0.0:
                at = add(at, scale(twist[b, 1] * q[k], z))
        elif n_q == 7:
            x, y, z = _axes_of_quaternion(q[k], q[k + 1], q[k + 2], q[k + 3])
            at = add(at, (q[k + 4], q[k + 5], q[k + 6]))
        for i in range(3):
            rotation[b, i, 0], rotation[b, i, 1], rotation[b, i, 2] = x[i], y[i], z[i]
        put(at, origin, b, 0)


@kernel
def _axes_of_quaternion(w: float, x: float, y: float, z: float) -> tuple[Vector, Vector, Vector]:
    """Columns of the rotation matrix of w + ix + jy + kz, whatever its length."""
    s = 2.0 / (w * w + x * x + y * y + z * z)
    return (
        (1 - s * (y * y + z * z), s * (x * y + w * z), s * (x * z - w * y)),
        (s * (x * y - w * z), 1 - s * (x * x + z * z), s * (y * z + w * x)),
        (s * (x * z + w * y), s * (y * z - w * x), 1 - s * (x * x + y * y)),
    )


@kernel
def _outward_twists(
    parent: Integers, v_start: Integers, twist: Floats, rotation: Floats, origin: Floats, qd: Floats,
    twists: Floats,
) -> None:  # fmt: skip
    for b in range(len(parent)):
        p, k = parent[b], v_start[b]
        n_v = v_start[b + 1] - k
        omega, u = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        if p >= 0:
            omega, u = pair(twists, p)
            u = add(u, cross(omega, lever(origin, b, p)))
        if n_v == 1:
            axis = hinge_axis(rotation, b)
            omega = add(omega, scale(twist[b, 0] * qd[k], axis))
            u = add(u, scale(twist[b, 1] * qd[k], axis))
        elif n_v == 6:
            omega, u = (qd[k], qd[k + 1], qd[k + 2]), (qd[k + 3], qd[k + 4], qd[k + 5])
        put_pair(omega, u, twists, b)


@kernel
def _inward_loads(
    parent: Integers, v_start: Integers, twist: Floats, rotation: Floats, origin: Floats, wrench: Floats,
    tau: Floats,
) -> None:  # fmt: skip
    """Accumulate loads in ``wrench``, which it overwrites."""
    for b in range(len(parent) - 1, -1, -1):
        p, k = parent[b], v_start[b]
        n_v = v_start[b + 1] - k
        moment, force = pair(wrench, b)
        if n_v == 1:
            axis = hinge_axis(rotation, b)
            tau[k] = twist[b, 0] * dot(axis, moment) + twist[b, 1] * dot(axis, force)
        elif n_v == 6:
            tau[k], tau[k + 1], tau[k + 2] = moment
            tau[k + 3], tau[k + 4], tau[k + 5] = force
        if p >= 0:
            arm = lever(origin, b, p)
            add_pair(add(moment, cross(arm, force)), force, wrench, p)


@kernel
def _integrate(q_start: Integers, v_start: Integers, qd: Floats, q: Floats) -> None:
    """Overwrite q."""
    for b in range(len(q_start) - 1):
        k, m = q_start[b], v_start[b]
        n_q = q_start[b + 1] - k
        if n_q == 1:
            q[k] += qd[m]
        elif n_q == 7:
            x, y, z = qd[m], qd[m + 1], qd[m + 2]
            half = 0.5 * np.sqrt(x * x + y * y + z * z)
            # sin(half)/(2 half) by its series near zero, where the quotient loses digits.
            s = 0.5 * np.sin(half) / half if half > 1e-4 else 0.5 - half * half / 12.0
            aw, ax, ay, az = np.cos(half), s * x, s * y, s * z
            length = np.sqrt(q[k] ** 2 + q[k + 1] ** 2 + q[k + 2] ** 2 + q[k + 3] ** 2)
            bw, bx, by, bz = q[k] / length, q[k + 1] / length, q[k + 2] / length, q[k + 3] / length
            q[k] = aw * bw - ax * bx - ay * by - az * bz
            q[k + 1] = aw * bx + ax * bw + ay * bz - az * by
            q[k + 2] = aw * by - ax * bz + ay * bw + az * bx
            q[k + 3] = aw * bz + ax * by - ay * bx + az * bw
            for i in range(3):
                q[k + 4 + i] += qd[m + 3 + i]
