"""Frames, twists and generalised torques of rigid bodies, each by one O(n) sweep."""

from dataclasses import dataclass

import numpy as np

from protochain.core.arrays import Floats, Integers, Value, floats, freeze
from protochain.core.settings import document_fields
from protochain.mechanics.multibody import algebra
from protochain.mechanics.multibody.algebra import ZERO, Vector, add, cross, dot, kernel, scale, subtract
from protochain.mechanics.multibody.tree import AXES, OFFSET, PARENT, SLIDE, TURN, Q, Tree, V
from protochain.mechanics.multibody.trigonometry import cosines_and_sines


@document_fields
@dataclass(frozen=True, eq=False)
class Frames(Value):
    """World frames of the bodies at one q."""

    # (nb, 3, 3) float: Axes of the bodies in the world, as columns. The third is the hinge axis.
    rotation: Floats
    origin: Floats  # (nb, 3) float, nm: Origins of the body frames, which lie on the hinge axes.


WORLD: tuple[algebra.Matrix, Vector] = (algebra.IDENTITY, ZERO)
"""Parent frame of roots."""


def pose(tree: Tree, q: Floats) -> Frames:
    """World frames of all bodies at q, by one outward sweep.

    Parameters
    ----------
    tree, q : Tree and (n_q,) float, rad (nm for prismatic hinges and the position of free roots)
        Rigid bodies and their coordinates.

    Returns
    -------
    Frames
        World frames of the bodies.

    Notes
    -----
    Featherstone, *Rigid Body Dynamics Algorithms* (2008). O(n).

    Examples
    --------
    >>> from protochain import multibody
    >>> tree = multibody.random_tree(5, seed=1)
    >>> q = np.append([1.0, 0, 0, 0, 0, 0, 0], np.zeros(4))
    >>> multibody.pose(tree, q).origin.shape
    (5, 3)
    """
    rotation = np.empty((tree.n_bodies, 3, 3))
    origin = np.empty((tree.n_bodies, 3))
    outward_frames(tree.links, tree.bodies, floats(q, (tree.n_q,), "q"), rotation, origin)
    return Frames(freeze(rotation), freeze(origin))


def velocities(tree: Tree, frames: Frames, qd: Floats) -> Floats:
    """Compute the twists of the bodies, V = J qd, by one outward sweep.

    Parameters
    ----------
    tree, frames : Tree, Frames
        Rigid bodies and their world frames.
    qd : (n_v,) float, rad/ps or nm/ps
        Velocities.

    Returns
    -------
    (nb, 6) float, rad/ps and nm/ps
        Angular velocity, then velocity of the frame's origin, world axes.

    Notes
    -----
    Featherstone, *Rigid Body Dynamics Algorithms* (2008). O(n).
    """
    twists = np.empty((tree.n_bodies, 6))
    outward_twists(
        tree.links, tree.bodies, frames.rotation, frames.origin, floats(qd, (tree.n_v,), "qd"), twists
    )
    return twists


def jacobian(tree: Tree, frames: Frames) -> Floats:
    """Dense Jacobian of the body twists: V = J qd.

    Parameters
    ----------
    tree, frames : Tree, Frames
        Rigid bodies and their world frames.

    Returns
    -------
    (nb, 6, n_v) float
        Columns are the degrees of freedom. O(n^2): for tests and small studies.
    """
    return np.stack([velocities(tree, frames, unit) for unit in np.eye(tree.n_v)], axis=2)


def pull_back(tree: Tree, frames: Frames, wrench: Floats) -> Floats:
    """Generalised torques tau = J^T wrench of loads on the bodies, by one inward sweep.

    Parameters
    ----------
    tree, frames : Tree, Frames
        Rigid bodies and their world frames.
    wrench : (nb, 6) float, kJ/mol/rad and kJ/mol/nm
        Moment on each body about its frame's origin, then force, along world axes.

    Returns
    -------
    (n_v,) float
        Torques, kJ/mol per unit of q. A free root has (moment, force) about its frame's origin, world axes.

    Notes
    -----
    The inward half of the recursive Newton-Euler algorithm without inertia: Featherstone, *Rigid Body
    Dynamics Algorithms* (2008). O(n).
    """
    tau = np.empty(tree.n_v)
    inward_torques(
        tree.links, tree.bodies, frames.rotation, frames.origin,
        floats(wrench, (tree.n_bodies, 6), "wrench").copy(), tau,
    )  # fmt: skip
    return tau


def integrate(tree: Tree, q: Floats, qd: Floats) -> Floats:
    """Advance q along constant velocities qd for unit time, with quaternions of unit length.

    Parameters
    ----------
    tree, q : Tree and (n_q,) float
        Rigid bodies and their coordinates.
    qd : (n_v,) float
        Hinge rates. A free root rotates by the world-frame vector omega and moves by u.

    Returns
    -------
    (n_q,) float
        New coordinates. A free root is rotated by exp(omega), so its twist is (omega, u) throughout.

    Examples
    --------
    >>> from protochain import multibody
    >>> tree = multibody.random_tree(5, seed=1)
    >>> q = np.append([1.0, 0, 0, 0, 0, 0, 0], np.zeros(4))
    >>> bool(np.allclose(multibody.integrate(tree, q, np.zeros(tree.n_v)), q))
    True
    """
    moved = floats(q, (tree.n_q,), "q").copy()
    move_along(tree.links, floats(qd, (tree.n_v,), "qd"), moved)
    return moved


@kernel
def outward_frames(links: Integers, bodies: Floats, q: Floats, rotation: Floats, origin: Floats) -> None:
    """Write the frames of :func:`pose`."""
    cosine, sine = np.empty(len(q)), np.empty(len(q))
    cosines_and_sines(q, cosine, sine)
    for b in range(len(bodies)):
        p, k = links[b, PARENT], links[b, Q]
        n_q = links[b + 1, Q] - k
        above, at = (algebra.matrix(rotation, p), algebra.vector(origin, p)) if p >= 0 else WORLD
        turn, at = seat(bodies, b, above, at)
        if n_q == 1:
            turn, at = turned_by_hinge(turn, at, bodies[b, TURN], bodies[b, SLIDE], q[k], cosine[k], sine[k])
        elif n_q == 7:
            turn, at = moved_freely(at, q, k)
        elif n_q == 3:
            turn = turned_by_ball(turn, q, k)
        algebra.put_matrix(turn, rotation, b)
        algebra.put(at, origin, b, 0)


@kernel
def turned_by_ball(seat: algebra.Matrix, q: Floats, k: int) -> algebra.Matrix:
    """Axes y, z, x, as columns, after a rotation by a rotation vector, from the axes at q = 0."""
    x, y, z = q[k], q[k + 1], q[k + 2]
    w, x, y, z = quaternion_of(x, y, z)
    a = algebra.rotate(seat, (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)))
    b = algebra.rotate(seat, (2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)))
    c = algebra.rotate(seat, (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)))
    return b[0], c[0], a[0], b[1], c[1], a[1], b[2], c[2], a[2]


@kernel
def half_sine(half: float) -> float:
    """sin(half) / (2 half), by its series near zero, because the quotient loses digits there."""
    return 0.5 * np.sin(half) / half if half > 1e-4 else 0.5 - half * half / 12.0


@kernel
def seat(bodies: Floats, b: int, above: algebra.Matrix, at: Vector) -> tuple[algebra.Matrix, Vector]:
    """Frame of body b at q = 0, from the frame of its parent."""
    x = algebra.rotate(above, algebra.vector(bodies, b, AXES))
    y = algebra.rotate(above, algebra.vector(bodies, b, AXES + 3))
    z = algebra.rotate(above, algebra.vector(bodies, b, AXES + 6))
    at = add(at, algebra.rotate(above, algebra.vector(bodies, b, OFFSET)))
    return (x[0], y[0], z[0], x[1], y[1], z[1], x[2], y[2], z[2]), at


@kernel
def turned_by_hinge(
    seat: algebra.Matrix, at: Vector, turn: float, slide: float, q: float, cosine: float, sine: float
) -> tuple[algebra.Matrix, Vector]:
    """Frame of a body with its hinge at q, from the frame at q = 0."""
    c, s = (cosine, sine) if turn != 0.0 else (1.0, 0.0)
    x, y, z = (seat[0], seat[3], seat[6]), (seat[1], seat[4], seat[7]), (seat[2], seat[5], seat[8])
    x, y = add(scale(c, x), scale(s, y)), subtract(scale(c, y), scale(s, x))
    at = add(at, scale(slide * q, z))
    return (x[0], y[0], z[0], x[1], y[1], z[1], x[2], y[2], z[2]), at


@kernel
def moved_freely(at: Vector, q: Floats, k: int) -> tuple[algebra.Matrix, Vector]:
    """Frame of a free root: rotation by the quaternion w + ix + jy + kz, which need not have unit length."""
    w, x, y, z = q[k], q[k + 1], q[k + 2], q[k + 3]
    s = 2.0 / (w * w + x * x + y * y + z * z)
    turn = (
        1 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y),
        s * (x * y + w * z), 1 - s * (x * x + z * z), s * (y * z - w * x),
        s * (x * z - w * y), s * (y * z + w * x), 1 - s * (x * x + y * y),
    )  # fmt: skip
    return turn, add(at, (q[k + 4], q[k + 5], q[k + 6]))


@kernel
def end_of(rotation: Floats, origin: Floats, b: int, point: Vector) -> tuple[Vector, Vector]:
    """Lever arm of a point from the origin of its body, and its place. Both are the point in the world."""
    if b < 0:
        return point, point
    arm = algebra.rotate(algebra.matrix(rotation, b), point)
    return arm, add(algebra.vector(origin, b), arm)


@kernel
def outward_twists(
    links: Integers, bodies: Floats, rotation: Floats, origin: Floats, qd: Floats, twists: Floats
) -> None:
    """Write the twists of :func:`velocities`."""
    for b in range(len(bodies)):
        p, k = links[b, PARENT], links[b, V]
        n_v = links[b + 1, V] - k
        omega, u = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        if p >= 0:
            omega, u = algebra.pair(twists, p)
            u = add(u, cross(omega, algebra.lever(origin, b, p)))
        if n_v == 1:
            axis = algebra.hinge_axis(rotation, b)
            omega = add(omega, scale(bodies[b, TURN] * qd[k], axis))
            u = add(u, scale(bodies[b, SLIDE] * qd[k], axis))
        elif n_v == 6:
            omega, u = (qd[k], qd[k + 1], qd[k + 2]), (qd[k + 3], qd[k + 4], qd[k + 5])
        algebra.put_pair(omega, u, twists, b)


@kernel
def inward_torques(
    links: Integers, bodies: Floats, rotation: Floats, origin: Floats, wrench: Floats, tau: Floats
) -> None:
    """Write tau. Accumulate loads inward in ``wrench``."""
    for b in range(len(bodies) - 1, -1, -1):
        p, k = links[b, PARENT], links[b, V]
        n_v = links[b + 1, V] - k
        moment, force = algebra.pair(wrench, b)
        if n_v == 1:
            axis = algebra.hinge_axis(rotation, b)
            tau[k] = bodies[b, TURN] * dot(axis, moment) + bodies[b, SLIDE] * dot(axis, force)
        elif n_v == 6:
            tau[k], tau[k + 1], tau[k + 2] = moment
            tau[k + 3], tau[k + 4], tau[k + 5] = force
        if p >= 0:
            arm = algebra.lever(origin, b, p)
            algebra.add_pair(add(moment, cross(arm, force)), force, wrench, p)


@kernel
def move_along(links: Integers, qd: Floats, q: Floats) -> None:
    """Overwrite q by :func:`integrate`."""
    for b in range(len(links) - 1):
        k, m = links[b, Q], links[b, V]
        n_q = links[b + 1, Q] - k
        if n_q == 1:
            q[k] += qd[m]
        elif n_q == 7:
            x, y, z = qd[m], qd[m + 1], qd[m + 2]
            aw, ax, ay, az = quaternion_of(x, y, z)
            length = np.sqrt(q[k] ** 2 + q[k + 1] ** 2 + q[k + 2] ** 2 + q[k + 3] ** 2)
            bw, bx, by, bz = q[k] / length, q[k + 1] / length, q[k + 2] / length, q[k + 3] / length
            q[k] = aw * bw - ax * bx - ay * by - az * bz
            q[k + 1] = aw * bx + ax * bw + ay * bz - az * by
            q[k + 2] = aw * by - ax * bz + ay * bw + az * bx
            q[k + 3] = aw * bz + ax * by - ay * bx + az * bw
            for i in range(3):
                q[k + 4 + i] += qd[m + 3 + i]
        elif n_q == 3:
            bw, bx, by, bz = quaternion_of(q[k], q[k + 1], q[k + 2])
            aw, ax, ay, az = quaternion_of(qd[m], qd[m + 1], qd[m + 2])
            # The rates are along the axes of what is turned: they come last.
            w = bw * aw - bx * ax - by * ay - bz * az
            x = bw * ax + bx * aw + by * az - bz * ay
            y = bw * ay - bx * az + by * aw + bz * ax
            z = bw * az + bx * ay - by * ax + bz * aw
            if w < 0.0:
                w, x, y, z = -w, -x, -y, -z
            sine = np.sqrt(x * x + y * y + z * z)
            scaled = 2.0 * np.arctan2(sine, w) / sine if sine > 0.0 else 2.0
            q[k], q[k + 1], q[k + 2] = scaled * x, scaled * y, scaled * z


@kernel
def quaternion_of(x: float, y: float, z: float) -> tuple[float, float, float, float]:
    """Quaternion (w, x, y, z) of a rotation vector."""
    half = 0.5 * np.sqrt(x * x + y * y + z * z)
    s = half_sine(half)
    return np.cos(half), s * x, s * y, s * z
