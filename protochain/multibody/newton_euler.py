"""Loads that a motion needs, by Newton's and Euler's laws: inverse dynamics, M x, momentum, energy. O(n)."""

import numpy as np

from protochain.arrays import Floats, Integers, floats
from protochain.multibody.algebra import (
    add,
    cross,
    hinge_axis,
    kernel,
    lever,
    pair,
    put,
    put_pair,
    rigid_inertia,
    scale,
    symmetric_times,
    vector,
)  # fmt: skip
from protochain.multibody.kinematics import Frames, pull_back, velocities
from protochain.multibody.tree import Tree


def inverse_dynamics(
    tree: Tree, frames: Frames, qd: Floats, qdd: Floats, wrench: Floats | None = None
) -> Floats:
    """Torques that give the accelerations qdd: tau = M qdd + c(q, qd) - J^T wrench.

    Parameters
    ----------
    tree : Tree
    frames : Frames
    qd, qdd : (n_v,) float, rad/ps and rad/ps^2 (nm for slides)
        A free root's are (omega, u) and their time derivatives, world axes.
    wrench : (nb, 6) float, optional, kJ/mol/rad and kJ/mol/nm
        External loads: moment about the body's origin, force; world axes.

    Returns
    -------
    (n_v,) float, kJ/mol

    Notes
    -----
    Recursive Newton-Euler algorithm: Luh, Walker, Paul (1980); Featherstone (2008), table 5.1. O(n).
    """
    loads = inertial_loads(tree, frames, qd, qdd)
    if wrench is not None:
        loads -= floats(wrench, (tree.n_bodies, 6), "wrench")
    return pull_back(tree, frames, loads)


def multiply_mass(tree: Tree, frames: Frames, x: Floats) -> Floats:
    """M x without forming M: the torques that give x as acceleration from rest.

    Parameters
    ----------
    tree : Tree
    frames : Frames
    x : (n_v,) float

    Returns
    -------
    (n_v,) float
        In amu nm^2 times the unit of x. O(n).
    """
    return inverse_dynamics(tree, frames, np.zeros(tree.n_v), x)


def inertial_loads(tree: Tree, frames: Frames, qd: Floats, qdd: Floats | None = None) -> Floats:
    """Load on each body that makes it move as qd and qdd say.

    Parameters
    ----------
    tree : Tree
    frames : Frames
    qd, qdd : (n_v,) float
        Without qdd, the loads that velocities alone need.

    Returns
    -------
    (nb, 6) float, kJ/mol/rad and kJ/mol/nm
        Moment about the body's origin and force, world axes. O(n).

    Notes
    -----
    With c the centre of mass from the origin, a the origin's acceleration and I about the origin:
    force = m (a + alpha x c + omega x (omega x c)), moment = I alpha + m c x a + omega x I omega.
    """
    loads = np.empty((tree.n_bodies, 6))
    outward_loads(
        tree.parent, tree.v_start, tree.twist, tree.rigid, frames.rotation, frames.origin,
        floats(qd, (tree.n_v,), "qd"),
        np.zeros(tree.n_v) if qdd is None else floats(qdd, (tree.n_v,), "qdd"), loads,
    )  # fmt: skip
    return loads


def kinetic_energy(tree: Tree, frames: Frames, qd: Floats) -> float:
    """Kinetic energy of the bodies, from their twists.

    Parameters
    ----------
    tree : Tree
    frames : Frames
    qd : (n_v,) float, rad/ps and nm/ps

    Returns
    -------
    float, kJ/mol
    """
    twists = velocities(tree, frames, qd)
    return 0.5 * float(np.vdot(twists, _momenta(tree, frames, twists)))


def momentum(tree: Tree, frames: Frames, qd: Floats) -> tuple[Floats, Floats]:
    """Linear momentum, and angular momentum about the common centre of mass.

    Parameters
    ----------
    tree : Tree
    frames : Frames
    qd : (n_v,) float, rad/ps and nm/ps

    Returns
    -------
    (3,) float, amu nm/ps; (3,) float, amu nm^2/ps
    """
    each = _momenta(tree, frames, velocities(tree, frames, qd))
    linear = each[:, 3:].sum(axis=0)
    arms = frames.origin - centre_of_mass(tree, frames)
    return linear, np.sum(each[:, :3] + np.cross(arms, each[:, 3:]), axis=0)


def centre_of_mass(tree: Tree, frames: Frames) -> Floats:
    """Centre of mass of all bodies together.

    Returns
    -------
    (3,) float, nm
    """
    each = frames.origin + np.einsum("bij,bj->bi", frames.rotation, tree.com)
    return np.asarray(tree.mass @ each / tree.mass.sum())


def _momenta(tree: Tree, frames: Frames, twists: Floats) -> Floats:
    """(nb, 6) float: each body's angular momentum about its origin, and linear momentum."""
    momenta = np.empty((tree.n_bodies, 6))
    _body_momenta(tree.rigid, frames.rotation, twists, momenta)
    return momenta


@kernel
def _body_momenta(rigid: Floats, rotation: Floats, twists: Floats, momenta: Floats) -> None:
    for b in range(len(rigid)):
        mass, first, second = rigid_inertia(rotation, rigid, b)
        omega, u = pair(twists, b)
        angular = add(symmetric_times(second, omega), cross(first, u))
        put_pair(angular, add(scale(mass, u), cross(omega, first)), momenta, b)


@kernel
def outward_loads(
    parent: Integers, v_start: Integers, twist: Floats, rigid: Floats, rotation: Floats, origin: Floats,
    qd: Floats, qdd: Floats, loads: Floats,
) -> None:  # fmt: skip
    """Write the load on each body. Accelerations are the classical ones of the origins, not spatial ones."""
    motion = np.empty((len(parent), 9))
    for b in range(len(parent)):
        p, k = parent[b], v_start[b]
        n_v = v_start[b + 1] - k
        omega, alpha, a = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        if p >= 0:
            omega, alpha, a = vector(motion, p, 0), vector(motion, p, 3), vector(motion, p, 6)
            arm = lever(origin, b, p)
            a = add(a, add(cross(alpha, arm), cross(omega, cross(omega, arm))))
        if n_v == 1:
            axis = hinge_axis(rotation, b)
            turn, slide = twist[b]
            if slide != 0.0:
                coriolis = scale(2.0 * slide * qd[k], cross(omega, axis))
                a = add(a, add(scale(slide * qdd[k], axis), coriolis))
            alpha = add(alpha, scale(turn, add(scale(qdd[k], axis), scale(qd[k], cross(omega, axis)))))
            omega = add(omega, scale(turn * qd[k], axis))
        elif n_v == 6:
            omega, alpha = (qd[k], qd[k + 1], qd[k + 2]), (qdd[k], qdd[k + 1], qdd[k + 2])
            a = (qdd[k + 3], qdd[k + 4], qdd[k + 5])
        put(omega, motion, b, 0)
        put(alpha, motion, b, 3)
        put(a, motion, b, 6)
        mass, first, second = rigid_inertia(rotation, rigid, b)
        centripetal = cross(omega, cross(omega, first))
        force = add(scale(mass, a), add(cross(alpha, first), centripetal))
        moment = add(symmetric_times(second, alpha), cross(first, a))
        put_pair(add(moment, cross(omega, symmetric_times(second, omega))), force, loads, b)
