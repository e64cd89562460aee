"""Where the bodies are, and what a load on them feels like at the hinges: one sweep each, O(n)."""

from dataclasses import dataclass

import numpy as np
from numba import njit

from protochain.arrays import Floats, Integers, read_only
from protochain.multibody.tree import HingeKind, Tree

_REVOLUTE = int(HingeKind.REVOLUTE)
_FREE = int(HingeKind.FREE)


@dataclass(frozen=True, eq=False)
class Frames:
    """World frames of the bodies at one q.

    Parameters
    ----------
    rotation : (nb, 3, 3) float
        Columns are the body's axes in the world.
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
    q : (n_q,) float, rad (and nm for free roots)

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
        tree.parent, tree.kind, tree.axis, tree.offset, tree.placement, tree.q_start,
        np.ascontiguousarray(q, dtype=np.float64), rotation, origin,
    )  # fmt: skip
    return Frames(read_only(rotation), read_only(origin))


def pull_back(tree: Tree, frames: Frames, moment: Floats, force: Floats) -> Floats:
    """Generalised torques tau = J^T (moment, force) of loads on the bodies, by one inward sweep.

    Parameters
    ----------
    tree : Tree
    frames : Frames
    moment : (nb, 3) float, kJ/mol/rad
        Moment on each body about its frame's origin, world axes.
    force : (nb, 3) float, kJ/mol/nm
        Force on each body, world axes.

    Returns
    -------
    (n_v,) float
        kJ/mol/rad for hinges; a free root has (moment, force) about its frame's origin, world axes.

    Notes
    -----
    The inward half of the recursive Newton-Euler algorithm without inertia: Featherstone, *Rigid Body
    Dynamics Algorithms* (2008), table 5.1. O(n).
    """
    tau = np.empty(tree.n_v)
    _inward_loads(
        tree.parent, tree.kind, tree.axis, tree.v_start, frames.rotation, frames.origin,
        np.array(moment, dtype=np.float64), np.array(force, dtype=np.float64), tau,
    )  # fmt: skip
    return tau


def integrate(tree: Tree, q: Floats, v: Floats) -> Floats:
    """Move from q along v for unit time, keeping quaternions of unit length.

    Parameters
    ----------
    tree : Tree
    q : (n_q,) float
    v : (n_v,) float
        Hinge rates; a free root turns about the world-frame vector omega and moves by v.

    Returns
    -------
    (n_q,) float
        For a free root exp(omega) times its rotation, so d/dt along the path is (omega, v) throughout.
    """
    moved = np.array(q, dtype=np.float64)
    _integrate(tree.kind, tree.q_start, tree.v_start, np.ascontiguousarray(v, dtype=np.float64), moved)
    return moved


@njit(cache=True)
def _rotation_about(axis: Floats, angle: float, out: Floats) -> None:
    """Rodrigues' formula."""
    c, s = np.cos(angle), np.sin(angle)
    x, y, z = axis[0], axis[1], axis[2]
    t = 1.0 - c
    out[0, 0], out[0, 1], out[0, 2] = t * x * x + c, t * x * y - s * z, t * x * z + s * y
    out[1, 0], out[1, 1], out[1, 2] = t * x * y + s * z, t * y * y + c, t * y * z - s * x
    out[2, 0], out[2, 1], out[2, 2] = t * x * z - s * y, t * y * z + s * x, t * z * z + c


@njit(cache=True)
def _rotation_of_quaternion(quaternion: Floats, out: Floats) -> None:
    w, x, y, z = quaternion / np.sqrt(np.sum(quaternion * quaternion))
    out[0, 0], out[0, 1], out[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    out[1, 0], out[1, 1], out[1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    out[2, 0], out[2, 1], out[2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)


@njit(cache=True)
def _multiply(a: Floats, b: Floats, out: Floats) -> None:
    for i in range(3):
        for j in range(3):
            out[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]


@njit(cache=True)
def _outward_frames(
    parent: Integers, kind: Integers, axis: Floats, offset: Floats, placement: Floats, q_start: Integers,
    q: Floats, rotation: Floats, origin: Floats,
) -> None:  # fmt: skip
    joint = np.empty((3, 3))
    turn = np.empty((3, 3))
    for b in range(len(parent)):
        p = parent[b]
        if p < 0:
            joint[:] = placement[b]
            origin[b] = offset[b]
        else:
            _multiply(rotation[p], placement[b], joint)
            for i in range(3):
                origin[b, i] = origin[p, i]
                for j in range(3):
                    origin[b, i] += rotation[p, i, j] * offset[b, j]
        k = q_start[b]
        if kind[b] == _REVOLUTE:
            _rotation_about(axis[b], q[k], turn)
            _multiply(joint, turn, rotation[b])
        elif kind[b] == _FREE:
            _rotation_of_quaternion(q[k : k + 4], turn)
            _multiply(joint, turn, rotation[b])
            for i in range(3):
                for j in range(3):
                    origin[b, i] += joint[i, j] * q[k + 4 + j]
        else:
            rotation[b] = joint


@njit(cache=True)
def _inward_loads(
    parent: Integers, kind: Integers, axis: Floats, v_start: Integers, rotation: Floats, origin: Floats,
    moment: Floats, force: Floats, tau: Floats,
) -> None:  # fmt: skip
    """Accumulate loads in ``moment`` and ``force``, which it overwrites."""
    for b in range(len(parent) - 1, -1, -1):
        k = v_start[b]
        if kind[b] == _REVOLUTE:
            tau[k] = 0.0
            for i in range(3):
                along = rotation[b, i, 0] * axis[b, 0] + rotation[b, i, 1] * axis[b, 1]
                along += rotation[b, i, 2] * axis[b, 2]
                tau[k] += along * moment[b, i]
        elif kind[b] == _FREE:
            tau[k : k + 3] = moment[b]
            tau[k + 3 : k + 6] = force[b]
        p = parent[b]
        if p >= 0:
            lx, ly, lz = origin[b, 0] - origin[p, 0], origin[b, 1] - origin[p, 1], origin[b, 2] - origin[p, 2]
            fx, fy, fz = force[b, 0], force[b, 1], force[b, 2]
            moment[p, 0] += moment[b, 0] + ly * fz - lz * fy
            moment[p, 1] += moment[b, 1] + lz * fx - lx * fz
            moment[p, 2] += moment[b, 2] + lx * fy - ly * fx
            for i in range(3):
                force[p, i] += force[b, i]


@njit(cache=True)
def _integrate(kind: Integers, q_start: Integers, v_start: Integers, v: Floats, q: Floats) -> None:
    """Overwrite q."""
    for b in range(len(kind)):
        k, m = q_start[b], v_start[b]
        if kind[b] == _REVOLUTE:
            q[k] += v[m]
        elif kind[b] == _FREE:
            x, y, z = v[m], v[m + 1], v[m + 2]
            half = 0.5 * np.sqrt(x * x + y * y + z * z)
            # sin(half)/(2 half) by its series near zero, where the quotient loses digits.
            s = 0.5 * np.sin(half) / half if half > 1e-4 else 0.5 - half * half / 12.0
            aw, ax, ay, az = np.cos(half), s * x, s * y, s * z
            quaternion = q[k : k + 4] / np.sqrt(np.sum(q[k : k + 4] ** 2))
            bw, bx, by, bz = quaternion
            q[k] = aw * bw - ax * bx - ay * by - az * bz
            q[k + 1] = aw * bx + ax * bw + ay * bz - az * by
            q[k + 2] = aw * by - ax * bz + ay * bw + az * bx
            q[k + 3] = aw * bz + ax * by - ay * bx + az * bw
            for i in range(3):
                q[k + 4 + i] += v[m + 3 + i]
