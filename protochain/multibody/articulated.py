"""M^-1 in O(n) by articulated bodies: hinges are eliminated one by one, from the leaves to the root.

Featherstone (1983); Jain, Vaidehi, Rodriguez, J. Chem. Phys. 106:258 (1993), whose factors are
M = [1 + H phi K] D [1 + H phi K]^T and M^-1 = [1 - H psi K]^T D^-1 [1 - H psi K].
"""

from dataclasses import dataclass

import numpy as np

from protochain.arrays import Floats, Integers, floats, frozen
from protochain.errors import MechanicsError
from protochain.multibody.algebra import (
    add,
    add_inertia,
    add_pair,
    add_rigid,
    cross,
    dot,
    hinge_axis,
    inertia,
    inertia_times,
    kernel,
    lever,
    minus_outer,
    pair,
    put_inertia,
    put_pair,
    rigid_inertia,
    scale,
    shifted_inertia,
    symmetric_times,
    turned_back,
)  # fmt: skip
from protochain.multibody.kinematics import Frames
from protochain.multibody.newton_euler import outward_loads
from protochain.multibody.small import cholesky, dense_inertia, solve_lower, solve_upper
from protochain.multibody.tree import Tree

ROUND_OFF = 1e-15
"""A pivot below this share of the articulated inertia it was taken from is rounding, not inertia."""


@dataclass(frozen=True, eq=False)
class Articulated:
    """The factors of M at one pose.

    Parameters
    ----------
    tree : Tree
    frames : Frames
    inertia : (nb, 21) float
        Articulated-body inertia P = [[I, C], [C^T, M]] of each body about its origin along world axes, its
        hinge still locked: upper triangle of I, C row by row, upper triangle of M.
    gain : (nb, 6) float
        P h / D, with h the hinge's twist.
    pivot : (nb,) float
        D = h^T P h; 1 where there is no hinge.
    root : (n_free, 6, 6) float
        Cholesky factors of P of the free roots.
    """

    tree: Tree
    frames: Frames
    inertia: Floats
    gain: Floats
    pivot: Floats
    root: Floats


def articulate(tree: Tree, frames: Frames) -> Articulated:
    """Factorise M at one pose, by one inward sweep.

    Parameters
    ----------
    tree : Tree
    frames : Frames

    Returns
    -------
    Articulated

    Raises
    ------
    MechanicsError
        If something that a hinge moves has no inertia against it: M is singular.

    Notes
    -----
    Jain, Vaidehi, Rodriguez (1993), equation 21; Featherstone (2008), table 7.1. O(n).
    """
    n = tree.n_bodies
    packed, gain, pivot = np.zeros((n, 21)), np.empty((n, 6)), np.empty(n)
    root = np.empty((tree.n_q - tree.n_v, 6, 6))
    failed = _factorise(
        tree.parent, tree.q_start, tree.v_start, tree.twist, tree.rigid, frames.rotation, frames.origin,
        packed, gain, pivot, root, np.zeros((n, 6)), np.zeros(tree.n_v),
    )  # fmt: skip
    _refuse(failed)
    return Articulated(tree, frames, frozen(packed), frozen(gain), frozen(pivot), frozen(root))


def solve(factors: Articulated, tau: Floats, loads: Floats | None = None) -> Floats:
    """M^-1 (tau - J^T loads), by one inward and one outward sweep.

    Parameters
    ----------
    factors : Articulated
    tau : (n_v,) float
    loads : (nb, 6) float, optional
        What tau has to carry besides accelerating: moments about the bodies' origins, forces.

    Returns
    -------
    (n_v,) float
    """
    tree, frames = factors.tree, factors.frames
    wrench = np.zeros((tree.n_bodies, 6)) if loads is None else loads.copy()
    x = floats(tau, (tree.n_v,), "tau").copy()
    _substitute(
        tree.parent, tree.q_start, tree.v_start, tree.twist, frames.rotation, frames.origin, factors.gain,
        factors.pivot, factors.root, wrench, x,
    )  # fmt: skip
    return x


def solve_at_once(tree: Tree, frames: Frames, tau: Floats) -> Floats:
    """M^-1 tau for one tau: :func:`articulate` and :func:`solve` in one call.

    Parameters
    ----------
    tree : Tree
    frames : Frames
    tau : (n_v,) float

    Returns
    -------
    (n_v,) float

    Raises
    ------
    MechanicsError
        As :func:`articulate`.
    """
    x = floats(tau, (tree.n_v,), "tau").copy()
    failed = _accelerate(
        tree.parent, tree.q_start, tree.v_start, tree.twist, tree.rigid, frames.rotation, frames.origin,
        np.zeros((tree.n_bodies, 6)), x,
    )  # fmt: skip
    _refuse(failed)
    return x


def forward_dynamics(
    tree: Tree, frames: Frames, qd: Floats, tau: Floats, wrench: Floats | None = None
) -> Floats:
    """Accelerations that the torques tau and external loads give: M qdd + c(q, qd) = tau + J^T wrench.

    Parameters
    ----------
    tree : Tree
    frames : Frames
    qd : (n_v,) float, rad/ps (nm/ps for slides)
    tau : (n_v,) float, kJ/mol
    wrench : (nb, 6) float, optional, kJ/mol/rad and kJ/mol/nm
        Moment on each body about its origin, force; world axes.

    Returns
    -------
    (n_v,) float, rad/ps^2 (nm/ps^2 for slides)

    Raises
    ------
    MechanicsError
        If M is singular.

    Notes
    -----
    The loads that velocities need at qdd = 0 (Newton-Euler) are taken off, and articulated bodies solve
    for the rest: Featherstone (2008), table 7.1. O(n).
    """
    if wrench is None:
        loads = np.zeros((tree.n_bodies, 6))
    else:
        loads = floats(wrench, (tree.n_bodies, 6), "wrench").copy()
    x = floats(tau, (tree.n_v,), "tau").copy()
    failed = _forward(
        tree.parent, tree.q_start, tree.v_start, tree.twist, tree.rigid, frames.rotation, frames.origin,
        floats(qd, (tree.n_v,), "qd"), loads, x,
    )  # fmt: skip
    _refuse(failed)
    return x


def _refuse(failed: int) -> None:
    if failed >= 0:
        raise MechanicsError(
            f"body {failed}: nothing resists its hinge at this pose, so accelerations have no value"
        )


def log_det(factors: Articulated) -> float:
    """Ln det M = sum of ln D, and of ln det P of free roots.

    Parameters
    ----------
    factors : Articulated

    Returns
    -------
    float
        Of M in amu nm^2 (amu for slides).
    """
    roots = np.diagonal(factors.root, axis1=1, axis2=2)
    return float(np.sum(np.log(factors.pivot)) + 2.0 * np.sum(np.log(roots)))


def sample(factors: Articulated, noise: Floats) -> Floats:
    """[1 - H psi K]^T D^-1/2 noise, whose covariance is M^-1 for independent unit noise.

    Parameters
    ----------
    factors : Articulated
    noise : (n_v,) float

    Returns
    -------
    (n_v,) float

    Notes
    -----
    The outward half of a solution, for D^1/2 noise: a hinge's rate is its noise less what the motion of its
    parent already gives.
    Jain, Vaidehi, Rodriguez (1993), equation 27. O(n).
    """
    tree, frames = factors.tree, factors.frames
    x = floats(noise, (tree.n_v,), "noise").copy()
    n_v = np.diff(tree.v_start)
    hinges = np.flatnonzero(n_v == 1)
    x[tree.v_start[hinges]] *= np.sqrt(factors.pivot[hinges])
    for factor, b in zip(factors.root, np.flatnonzero(n_v == 6), strict=True):
        own = slice(tree.v_start[b], tree.v_start[b + 1])
        x[own] = np.tril(factor) @ x[own]
    _outward_rates(
        tree.parent, tree.q_start, tree.v_start, tree.twist, frames.rotation, frames.origin, factors.gain,
        factors.pivot, factors.root, np.empty((tree.n_bodies, 6)), x,
    )  # fmt: skip
    return x


@kernel
def _factorise(
    parent: Integers, q_start: Integers, v_start: Integers, twist: Floats, rigid: Floats, rotation: Floats,
    origin: Floats, packed: Floats, gain: Floats, pivot: Floats, root: Floats, wrench: Floats, x: Floats,
) -> int:  # fmt: skip
    """Return the first body whose hinge has no pivot, or -1. ``packed`` starts as zeros.

    One right-hand side is carried inward on the way, as :func:`_substitute` does: the processor has the time
    for it while it waits for the factors.
    """
    for b in range(len(parent) - 1, -1, -1):
        p, k = parent[b], v_start[b]
        n_v = v_start[b + 1] - k
        carried_moment, carried_force = pair(wrench, b)
        articulated = add_rigid(inertia(packed, b), rigid_inertia(rotation, rigid, b))
        put_inertia(articulated, packed, b)
        pivot[b] = 1.0
        if n_v == 1:
            axis = hinge_axis(rotation, b)
            turn, slide = twist[b, 0], twist[b, 1]
            i, c, m = articulated
            if slide == 0.0:
                # Most hinges only turn: half the work.
                moment, force = symmetric_times(i, axis), turned_back(c, axis)
                d, whole = dot(axis, moment), i[0] + i[3] + i[5]
            else:
                moment, force = inertia_times(articulated, scale(turn, axis), scale(slide, axis))
                d = turn * dot(axis, moment) + slide * dot(axis, force)
                whole = turn * turn * (i[0] + i[3] + i[5]) + slide * slide * (m[0] + m[3] + m[5])
            if not d > ROUND_OFF * whole:
                return b
            pivot[b] = d
            inverse = 1.0 / d
            articulated = minus_outer(articulated, moment, force, inverse)
            put_pair(scale(inverse, moment), scale(inverse, force), gain, b)
            x[k] -= turn * dot(axis, carried_moment) + slide * dot(axis, carried_force)
            carried_moment = add(carried_moment, scale(x[k] * inverse, moment))
            carried_force = add(carried_force, scale(x[k] * inverse, force))
        elif n_v == 6:
            # A free root has one coordinate more than freedoms, so this difference counts the free roots.
            factor = root[q_start[b] - k]
            dense_inertia(packed[b], factor)
            if not cholesky(factor, 6):
                return b
            for j in range(6):
                x[k + j] -= wrench[b, j]
        if p >= 0:
            arm = lever(origin, b, p)
            add_pair(add(carried_moment, cross(arm, carried_force)), carried_force, wrench, p)
            add_inertia(shifted_inertia(articulated, arm), packed, p)
    return -1


@kernel
def _substitute(
    parent: Integers, q_start: Integers, v_start: Integers, twist: Floats, rotation: Floats, origin: Floats,
    gain: Floats, pivot: Floats, root: Floats, wrench: Floats, x: Floats,
) -> None:  # fmt: skip
    """Overwrite tau in ``x`` by M^-1 (tau - J^T wrench), and ``wrench`` by the bodies' accelerations."""
    for b in range(len(parent) - 1, -1, -1):
        p, k = parent[b], v_start[b]
        n_v = v_start[b + 1] - k
        moment, force = pair(wrench, b)
        if n_v == 1:
            axis = hinge_axis(rotation, b)
            x[k] -= twist[b, 0] * dot(axis, moment) + twist[b, 1] * dot(axis, force)
            g, h = pair(gain, b)
            moment, force = add(moment, scale(x[k], g)), add(force, scale(x[k], h))
        elif n_v == 6:
            for i in range(6):
                x[k + i] -= wrench[b, i]
        if p >= 0:
            add_pair(add(moment, cross(lever(origin, b, p), force)), force, wrench, p)
    _outward_rates(parent, q_start, v_start, twist, rotation, origin, gain, pivot, root, wrench, x)


@kernel
def _outward_rates(
    parent: Integers, q_start: Integers, v_start: Integers, twist: Floats, rotation: Floats, origin: Floats,
    gain: Floats, pivot: Floats, root: Floats, motion: Floats, x: Floats,
) -> None:  # fmt: skip
    """Overwrite ``x``, carried inward, by the solution, and ``motion`` by the bodies' accelerations."""
    for b in range(len(parent)):
        p, k = parent[b], v_start[b]
        n_v = v_start[b + 1] - k
        omega, u = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        if p >= 0:
            omega, u = pair(motion, p)
            u = add(u, cross(omega, lever(origin, b, p)))
        if n_v == 1:
            g, h = pair(gain, b)
            x[k] = x[k] / pivot[b] - dot(g, omega) - dot(h, u)
            axis = hinge_axis(rotation, b)
            omega, u = add(omega, scale(twist[b, 0] * x[k], axis)), add(u, scale(twist[b, 1] * x[k], axis))
        elif n_v == 6:
            factor = root[q_start[b] - k]
            solve_lower(factor, 6, x[k : k + 6])
            solve_upper(factor, 6, x[k : k + 6])
            omega, u = (x[k], x[k + 1], x[k + 2]), (x[k + 3], x[k + 4], x[k + 5])
        put_pair(omega, u, motion, b)


@kernel
def _accelerate(
    parent: Integers, q_start: Integers, v_start: Integers, twist: Floats, rigid: Floats, rotation: Floats,
    origin: Floats, wrench: Floats, x: Floats,
) -> int:  # fmt: skip
    """Factorise and substitute in one call, for one right-hand side."""
    n = len(parent)
    packed, gain, pivot = np.zeros((n, 21)), np.empty((n, 6)), np.empty(n)
    root = np.empty((q_start[n] - v_start[n], 6, 6))
    failed = _factorise(
        parent, q_start, v_start, twist, rigid, rotation, origin, packed, gain, pivot, root, wrench, x
    )  # fmt: skip
    if failed < 0:
        _outward_rates(parent, q_start, v_start, twist, rotation, origin, gain, pivot, root, wrench, x)
    return failed


@kernel
def _forward(
    parent: Integers, q_start: Integers, v_start: Integers, twist: Floats, rigid: Floats, rotation: Floats,
    origin: Floats, qd: Floats, wrench: Floats, x: Floats,
) -> int:  # fmt: skip
    """Overwrite tau in ``x`` by accelerations, and the external ``wrench``."""
    loads = np.empty((len(parent), 6))
    outward_loads(parent, v_start, twist, rigid, rotation, origin, qd, np.zeros(len(qd)), loads)
    for b in range(len(parent)):
        for i in range(6):
            wrench[b, i] = loads[b, i] - wrench[b, i]
    return _accelerate(parent, q_start, v_start, twist, rigid, rotation, origin, wrench, x)
