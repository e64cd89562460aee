"""Newton-Euler equations: inverse dynamics, M x, momentum and kinetic energy. O(n)."""

import numpy as np

from protochain.core.arrays import Floats, Integers, floats
from protochain.mechanics.multibody import algebra
from protochain.mechanics.multibody.algebra import ZERO, Vector, add, cross, kernel, scale
from protochain.mechanics.multibody.kinematics import Frames, pose, pull_back, velocities
from protochain.mechanics.multibody.rotations import hinge_accelerations
from protochain.mechanics.multibody.tree import PARENT, SLIDE, TURN, Tree, V

Motion = tuple[Vector, Vector, Vector]
"""Angular velocity and acceleration, and the classical (not spatial) acceleration of the origin."""
AT_REST: Motion = (ZERO, ZERO, ZERO)


def inverse_dynamics(tree: Tree, q: Floats, qd: Floats, qdd: Floats, wrench: Floats | None = None) -> Floats:
    """Inverse dynamics: tau = M qdd + c(q, qd) - J^T wrench for accelerations qdd.

    Parameters
    ----------
    tree, q : Tree and (n_q,) float, rad (nm for prismatic hinges and the position of free roots)
        Rigid bodies and their coordinates.
    qd, qdd : (n_v,) float, rad/ps and rad/ps^2 (nm for slides)
        Velocities and their time derivatives. A free root has (omega, u), world axes, a ball the relative
        angular velocity along its own axes.
    wrench : (nb, 6) float, optional, kJ/mol/rad and kJ/mol/nm
        External loads: moment about the body's origin, and force, along world axes.

    Returns
    -------
    (n_v,) float, kJ/mol
        Torques.

    Notes
    -----
    Recursive Newton-Euler algorithm: Luh, Walker, Paul (1980), Featherstone (2008). O(n).

    Examples
    --------
    >>> from protochain import multibody
    >>> tree = multibody.random_tree(5, seed=1)
    >>> q = np.append([1.0, 0, 0, 0, 0, 0, 0], np.zeros(4))
    >>> rest = np.zeros(tree.n_v)
    >>> bool(np.allclose(multibody.inverse_dynamics(tree, q, rest, rest), 0.0))
    True
    """
    frames = pose(tree, q)
    loads = inertial_loads(tree, frames, qd, qdd)
    if wrench is not None:
        loads -= floats(wrench, (tree.n_bodies, 6), "wrench")
    return pull_back(tree, frames, loads) + tree.rotors * floats(qdd, (tree.n_v,), "qdd")


def multiply_mass(tree: Tree, frames: Frames, x: Floats) -> Floats:
    """Product M x without forming M: the torques for accelerations x from rest.

    Parameters
    ----------
    tree, frames : Tree, Frames
        Rigid bodies and their world frames.
    x : (n_v,) float
        Vector to multiply.

    Returns
    -------
    (n_v,) float
        Product, in amu nm^2 times the unit of x. O(n).

    Examples
    --------
    >>> from protochain import multibody
    >>> tree = multibody.random_tree(5, seed=1)
    >>> q = np.append([1.0, 0, 0, 0, 0, 0, 0], np.zeros(4))
    >>> frames = multibody.pose(tree, q)
    >>> x = np.ones(tree.n_v)
    >>> bool(np.allclose(multibody.multiply_mass(tree, frames, x), multibody.mass_matrix(tree, frames) @ x))
    True
    """
    return pull_back(tree, frames, inertial_loads(tree, frames, np.zeros(tree.n_v), x)) + tree.rotors * x


def inertial_loads(tree: Tree, frames: Frames, qd: Floats, qdd: Floats) -> Floats:
    """Inertial load on each body that moves with qd and qdd."""
    # qd, qdd (n_v,) -> (nb, 6): Moments about the origins of the bodies and forces, world axes. O(n).
    # With c the centre of mass from the origin, a the origin's acceleration and I about the origin: force = m
    # (a + alpha x c + omega x (omega x c)), moment = I alpha + m c x a + omega x I omega.
    loads = np.empty((tree.n_bodies, 6))
    qd, qdd = floats(qd, (tree.n_v,), "qd"), floats(qdd, (tree.n_v,), "qdd")
    outward_loads(
        tree.links, tree.bodies, frames.rotation, frames.origin, qd, hinge_accelerations(tree, qd, qdd), loads
    )
    return loads


def kinetic_energy(tree: Tree, frames: Frames, qd: Floats) -> float:
    """Kinetic energy of the bodies, from their twists, and of the rotors.

    Parameters
    ----------
    tree, frames : Tree, Frames
        Rigid bodies and their world frames.
    qd : (n_v,) float, rad/ps and nm/ps
        Velocities.

    Returns
    -------
    float, kJ/mol
        Kinetic energy.

    Examples
    --------
    >>> from protochain import multibody
    >>> tree = multibody.random_tree(5, seed=1)
    >>> q = np.append([1.0, 0, 0, 0, 0, 0, 0], np.zeros(4))
    >>> frames = multibody.pose(tree, q)
    >>> qd = np.ones(tree.n_v)
    >>> half = 0.5 * qd @ multibody.mass_matrix(tree, frames) @ qd
    >>> bool(np.isclose(multibody.kinetic_energy(tree, frames, qd), half))
    True
    """
    twists = velocities(tree, frames, qd)
    bodies = float(np.vdot(twists, momenta_of_bodies(tree, frames, twists)))
    return 0.5 * bodies + 0.5 * float(np.dot(tree.rotors, np.square(qd)))


def momentum(tree: Tree, frames: Frames, qd: Floats) -> tuple[Floats, Floats]:
    """Linear momentum, and angular momentum about the common centre of mass.

    Parameters
    ----------
    tree, frames : Tree, Frames
        Rigid bodies and their world frames.
    qd : (n_v,) float, rad/ps and nm/ps
        Velocities.

    Returns
    -------
    (3,) float, amu nm/ps, and (3,) float, amu nm^2/ps
        Linear and angular momentum.
    """
    momenta = momenta_of_bodies(tree, frames, velocities(tree, frames, qd))
    linear = momenta[:, 3:].sum(axis=0)
    arms = frames.origin - centre_of_mass(tree, frames)
    return linear, np.sum(momenta[:, :3] + np.cross(arms, momenta[:, 3:]), axis=0)


def centre_of_mass(tree: Tree, frames: Frames) -> Floats:
    """Centre of mass of all bodies together.

    Parameters
    ----------
    tree, frames : Tree, Frames
        Rigid bodies and their world frames.

    Returns
    -------
    (3,) float, nm
        World coordinates.
    """
    centres = frames.origin + np.einsum("bij,bj->bi", frames.rotation, tree.com)
    return np.asarray(tree.mass @ centres / tree.mass.sum())


def momenta_of_bodies(tree: Tree, frames: Frames, twists: Floats) -> Floats:
    """(nb, 6) float: centres body's angular momentum about its origin, and linear momentum."""
    momenta = np.empty((tree.n_bodies, 6))
    body_momenta(tree.bodies, frames.rotation, twists, momenta)
    return momenta


@kernel
def body_momenta(bodies: Floats, rotation: Floats, twists: Floats, momenta: Floats) -> None:
    """Write the angular momentum of each body about its origin, and its linear momentum."""
    for b in range(len(bodies)):
        mass, first, second = algebra.rigid_inertia(algebra.matrix(rotation, b), bodies, b)
        omega, u = algebra.pair(twists, b)
        angular = add(algebra.symmetric_times(second, omega), cross(first, u))
        algebra.put_pair(angular, add(scale(mass, u), cross(omega, first)), momenta, b)


@kernel
def outward_loads(
    links: Integers, bodies: Floats, rotation: Floats, origin: Floats, qd: Floats, qdd: Floats, loads: Floats
) -> None:
    """Write the loads of :func:`inertial_loads`."""
    motions = np.empty((len(bodies), 9))
    put_motions(links, bodies, rotation, origin, qd, qdd, motions)
    for b in range(len(bodies)):
        rigid = algebra.rigid_inertia(algebra.matrix(rotation, b), bodies, b)
        moment, force = load(rigid, motion_of(motions, b))
        algebra.put_pair(moment, force, loads, b)


@kernel
def put_motions(
    links: Integers, bodies: Floats, rotation: Floats, origin: Floats, qd: Floats, qdd: Floats,
    motions: Floats,
) -> None:  # fmt: skip
    """Write the motion of each body, as the loads of :func:`inertial_loads` come from."""
    for b in range(len(bodies)):
        p, k = links[b, PARENT], links[b, V]
        n_v = links[b + 1, V] - k
        motion = AT_REST
        if p >= 0:
            motion = carried_along(motion_of(motions, p), algebra.lever(origin, b, p))
        if n_v == 1:
            axis = algebra.hinge_axis(rotation, b)
            motion = moved_by_hinge(motion, axis, bodies[b, TURN], bodies[b, SLIDE], qd[k], qdd[k])
        elif n_v == 6:
            motion = algebra.vector_at(qd, k), algebra.vector_at(qdd, k), algebra.vector_at(qdd, k + 3)
        put_motion(motion, motions, b)


@kernel
def carried_along(motion: Motion, arm: Vector) -> Motion:
    """Motion of a point of a body, from the motion of the body's origin."""
    omega, alpha, a = motion
    return omega, alpha, add(a, add(cross(alpha, arm), cross(omega, cross(omega, arm))))


@kernel
def moved_by_hinge(motion: Motion, axis: Vector, turn: float, slide: float, qd: float, qdd: float) -> Motion:
    """Motion of a body whose hinge moves, from its motion with the hinge at rest."""
    omega, alpha, a = motion
    # The axis rotates with the parent.
    rate = cross(omega, scale(qd, axis))
    alpha = add(alpha, scale(turn, add(scale(qdd, axis), rate)))
    a = add(a, scale(slide, add(scale(qdd, axis), scale(2.0, rate))))
    return add(omega, scale(turn * qd, axis)), alpha, a


@kernel
def load(rigid: tuple[float, Vector, algebra.Symmetric], motion: Motion) -> tuple[Vector, Vector]:
    """Moment about its origin and force that give a body this motion."""
    mass, first, second = rigid
    omega, alpha, a = motion
    centripetal = cross(omega, cross(omega, first))
    force = add(scale(mass, a), add(cross(alpha, first), centripetal))
    moment = add(algebra.symmetric_times(second, alpha), cross(first, a))
    return add(moment, cross(omega, algebra.symmetric_times(second, omega))), force


@kernel
def motion_of(motions: Floats, b: int) -> Motion:
    """Read the motion of body b."""
    return algebra.vector(motions, b, 0), algebra.vector(motions, b, 3), algebra.vector(motions, b, 6)


@kernel
def put_motion(motion: Motion, motions: Floats, b: int) -> None:
    """Write the motion of body b."""
    algebra.put(motion[0], motions, b, 0)
    algebra.put(motion[1], motions, b, 3)
    algebra.put(motion[2], motions, b, 6)
