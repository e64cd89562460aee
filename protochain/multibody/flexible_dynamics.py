"""Dynamics of trees of which some bodies bend: mass matrix in blocks, accelerations, momenta."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from protochain.arrays import Floats, floats
from protochain.errors import MechanicsError
from protochain.multibody.articulated import ROUND_OFF
from protochain.multibody.flexible import (
    Bent,
    Flexible,
    amplitudes,
    bend,
    carrier_of,
    dexp_rate,
    hinge_columns,
    inertias,
    shifts,
)  # fmt: skip


@dataclass(frozen=True)
class Blocks:
    """Mass matrix by hinges (r) and amplitudes (f): [[rr, rf], [fr, ff]], fr the transpose of rf.

    Parameters
    ----------
    rr, rf, ff : (r, r), (r, f) and (f, f) float
    """

    rr: Floats
    rf: Floats
    ff: Floats


def jacobian(flexible: Flexible, bent: Bent) -> Floats:
    """Dense Jacobian of the nodes: their twists about their places are J qd.

    Returns
    -------
    (nn, 6, n_v) float
        Columns are the freedoms. O(n^2): for tests and small studies.
    """
    tree, out = flexible.tree, np.zeros((len(bent.origin), 6, flexible.n_v))
    for b in range(tree.n_bodies):
        nodes, frame = slice(*flexible.node_start[b : b + 2]), flexible.node_start[b]
        carrier = carrier_of(flexible, b)
        own = np.zeros((6, flexible.n_v))
        if carrier >= 0:
            own = shifts(bent.origin[frame] - bent.origin[carrier]) @ out[carrier]
        own[:, tree.v_start[b] : tree.v_start[b + 1]] = hinge_columns(flexible, bent, b)
        out[nodes] = shifts(bent.origin[nodes] - bent.origin[frame]) @ own
        out[nodes, :, flexible.shape_start[b] : flexible.shape_start[b + 1]] = bent.columns[b]
    return out


def mass_matrix(flexible: Flexible, bent: Bent) -> Blocks:
    """Mass matrix: the sum of J^T I J over all nodes. O(n^2).

    Parameters
    ----------
    flexible, bent : Flexible, Bent
        Bodies and their frames.

    Returns
    -------
    Blocks
        By hinges and amplitudes.
    """
    j, r = jacobian(flexible, bent), flexible.tree.n_v
    m = np.einsum("nik,nil->kl", j, inertias(flexible, bent) @ j, optimize=True)
    return Blocks(m[:r, :r], m[:r, r:], m[r:, r:])


def pull_back(flexible: Flexible, bent: Bent, wrench: Floats) -> Floats:
    """Torques (n_v,) of wrenches (nn, 6) on the nodes about their places, world axes: J^T wrench. O(n)."""
    tree, tau = flexible.tree, np.empty(flexible.n_v)
    felt = floats(wrench, (len(bent.origin), 6), "wrench").copy()
    for b in range(tree.n_bodies - 1, -1, -1):
        nodes, frame = slice(*flexible.node_start[b : b + 2]), flexible.node_start[b]
        own = slice(*flexible.shape_start[b : b + 2])
        tau[own] = np.einsum("nik,ni->k", bent.columns[b], felt[nodes])
        whole = _gathered(bent.origin[nodes] - bent.origin[frame], felt[nodes])
        tau[tree.v_start[b] : tree.v_start[b + 1]] = hinge_columns(flexible, bent, b).T @ whole
        carrier = carrier_of(flexible, b)
        if carrier >= 0:
            lever = bent.origin[frame] - bent.origin[carrier]
            felt[carrier] += _gathered(lever[None], whole[None])
    return tau


def inverse_dynamics(
    flexible: Flexible, q: Floats, qd: Floats, qdd: Floats, wrench: Floats | None = None
) -> Floats:
    """Torques M qdd + c(q, qd) - J^T wrench, without elastic ones.

    Parameters
    ----------
    flexible, q : Flexible and (n_q,) float
        Bodies and their coordinates.
    qd, qdd : (n_v,) float
        Velocities and accelerations.
    wrench : (nn, 6) float, optional
        External moment and force on each node, world axes.

    Returns
    -------
    (n_v,) float
        Torques. O(n).
    """
    bent = bend(flexible, q)
    loads = _inertial_loads(flexible, bent, q, qd, qdd)
    return pull_back(flexible, bent, loads if wrench is None else loads - wrench)


def forward_dynamics(
    flexible: Flexible, q: Floats, qd: Floats, tau: Floats, wrench: Floats | None = None
) -> Floats:
    """Accelerations, which solve M qdd + c(q, qd) = tau + J^T wrench.

    Parameters
    ----------
    flexible, q : Flexible and (n_q,) float
        Bodies and their coordinates.
    qd, tau : (n_v,) float
        Velocities, and torques with the elastic ones, see :func:`~protochain.multibody.flexible.elastic`; of
        driven hinges their accelerations.
    wrench : (nn, 6) float, optional
        External moment and force on each node, world axes.

    Returns
    -------
    (n_v,) float
        Accelerations, by articulated bodies: O of the sum of cubes of the numbers of shapes.

    Raises
    ------
    MechanicsError
        If M is singular.
    """
    bent, given = bend(flexible, q), np.zeros(flexible.n_v)
    driven = flexible.tree.driven_v
    given[driven] = tau[driven]
    loads = _inertial_loads(flexible, bent, q, qd, given)
    bias = pull_back(flexible, bent, loads if wrench is None else loads - wrench)
    return solve(flexible, bent, tau - bias) + given


def solve(flexible: Flexible, bent: Bent, tau: Floats) -> Floats:
    """Solve M x = tau by one inward and one outward sweep; x is 0 where hinges are driven.

    Parameters
    ----------
    flexible, bent : Flexible, Bent
        Bodies and their frames.
    tau : (n_v,) float

    Returns
    -------
    (n_v,) float

    Raises
    ------
    MechanicsError
        If M is singular; the message names the body.

    Notes
    -----
    As :mod:`~protochain.multibody.articulated`, with a body's amplitudes eliminated before its hinge.
    """
    tree, tau = flexible.tree, floats(tau, (flexible.n_v,), "tau")
    inertia, load = inertias(flexible, bent), np.zeros((len(bent.origin), 6))
    steps = {}
    for b in range(tree.n_bodies - 1, -1, -1):
        nodes, frame = slice(*flexible.node_start[b : b + 2]), flexible.node_start[b]
        x, columns = shifts(bent.origin[nodes] - bent.origin[frame]), bent.columns[b]
        onto, own = inertia[nodes] @ x, slice(*flexible.shape_start[b : b + 2])
        p, z = np.einsum("nki,nkj->ij", x, onto), np.einsum("nki,nk->i", x, load[nodes])
        coupling = np.einsum("nik,nij->kj", columns, onto)
        of_shapes = np.einsum("nik,nij,njl->kl", columns, inertia[nodes], columns, optimize=True)
        rest = tau[own] - np.einsum("nik,ni->k", columns, load[nodes])
        bending = _eliminated(b, of_shapes, np.column_stack([coupling, rest]), "bending")
        p, z = p - coupling.T @ bending[:, :6], z + coupling.T @ bending[:, 6]
        h, at = hinge_columns(flexible, bent, b), slice(tree.v_start[b], tree.v_start[b + 1])
        if tree.driven is not None and tree.driven[b]:
            h = h[:, :0]
            at = slice(at.start, at.start)
        gain = p @ h
        rates = _eliminated(b, h.T @ gain, np.column_stack([gain.T, tau[at] - h.T @ z]), "hinge")
        p, z = p - gain @ rates[:, :6], z + gain @ rates[:, 6]
        steps[b] = h, at, rates, own, bending
        carrier = carrier_of(flexible, b)
        if carrier >= 0:
            back = shifts(bent.origin[frame] - bent.origin[carrier])
            inertia[carrier] += back.T @ p @ back
            load[carrier] += back.T @ z
    out, motion = np.zeros(flexible.n_v), load
    for b in range(tree.n_bodies):
        h, at, rates, own, bending = steps[b]
        nodes, frame = slice(*flexible.node_start[b : b + 2]), flexible.node_start[b]
        carrier, base = carrier_of(flexible, b), np.zeros(6)
        if carrier >= 0:
            base = shifts(bent.origin[frame] - bent.origin[carrier]) @ motion[carrier]
        out[at] = rates[:, 6] - rates[:, :6] @ base
        base = base + h @ out[at]
        out[own] = bending[:, 6] - bending[:, :6] @ base
        motion[nodes] = shifts(bent.origin[nodes] - bent.origin[frame]) @ base + bent.columns[b] @ out[own]
    return out


def momenta(flexible: Flexible, q: Floats, qd: Floats) -> tuple[Floats, Floats]:
    """Canonical momenta p = M qd, and the gradient of the kinetic energy at constant velocities. O(n).

    Parameters
    ----------
    flexible, q : Flexible and (n_q,) float
        Bodies and their coordinates.
    qd : (n_v,) float
        Velocities.

    Returns
    -------
    (n_v,) float; (n_v,) float
        Momenta; gradient, the sum over all nodes of (dJ/dt)^T times momentum. Lagrange's equations are
        dp/dt = tau + gradient.
    """
    bent = bend(flexible, q)
    twists, changes = _twists(flexible, bent, q, qd)
    p = np.einsum("nij,nj->ni", inertias(flexible, bent), twists)
    tree, gradient = flexible.tree, np.empty(flexible.n_v)
    momenta_ = pull_back(flexible, bent, p)
    felt = p.copy()
    for b in range(tree.n_bodies - 1, -1, -1):
        nodes, frame = slice(*flexible.node_start[b : b + 2]), flexible.node_start[b]
        v, columns = twists[nodes], bent.columns[b]
        swept = np.einsum("nik,ni->k", columns[:, :3], np.cross(v[:, 3:], felt[nodes, 3:]))
        own = slice(*flexible.shape_start[b : b + 2])
        gradient[own] = np.einsum("nik,ni->k", changes[b], felt[nodes]) - swept
        whole = _gathered(bent.origin[nodes] - bent.origin[frame], felt[nodes])
        carrier = carrier_of(flexible, b)
        above = twists[carrier] if carrier >= 0 else np.zeros(6)
        lever = bent.origin[frame] - bent.origin[carrier] if carrier >= 0 else np.zeros(3)
        at, h = slice(tree.v_start[b], tree.v_start[b + 1]), hinge_columns(flexible, bent, b)
        # Axes of hinges turn with what carries them, those of a free root do not.
        turning = above[:3] if h.shape[1] == 1 else np.zeros(3)
        change = np.concatenate([np.cross(turning, h[:3], axisb=0).T, np.cross(turning, h[3:], axisb=0).T])
        gradient[at] = change.T @ whole - h[:3].T @ np.cross(v[0, 3:], whole[3:])
        if carrier >= 0:
            felt[carrier] += _gathered(lever[None], whole[None])
    return momenta_, gradient


def _gathered(lever: Floats, wrench: Floats) -> Floats:
    """(6,) float: wrenches (n, 6) at the ends of levers (n, 3), as one at their start."""
    whole = wrench.sum(axis=0)
    whole[:3] += np.cross(lever, wrench[:, 3:]).sum(axis=0)
    return whole


def _eliminated(b: int, matrix: Floats, right: Floats, what: str) -> Floats:
    """Solution for some right-hand sides with a body's own block of the mass matrix."""
    if not len(matrix):
        return right
    try:
        factor = cho_factor(matrix)
        # Cholesky's pivots against the diagonal: what is left of it.
        if not np.all(np.diagonal(factor[0]) ** 2 > ROUND_OFF * np.diagonal(matrix)):
            raise LinAlgError
    except (LinAlgError, ValueError):
        raise MechanicsError(f"body {b}: its {what} has no inertia at this pose") from None
    return np.asarray(cho_solve(factor, right))


def _twists(flexible: Flexible, bent: Bent, q: Floats, qd: Floats) -> tuple[Floats, list[Floats]]:
    """Twists (nn, 6) of the nodes, and of each body the rates (n, 6, k) at which its columns change."""
    tree, twists = flexible.tree, np.empty((len(bent.origin), 6))
    changes = []
    for b, shapes in enumerate(flexible.bodies):
        nodes, frame = slice(*flexible.node_start[b : b + 2]), flexible.node_start[b]
        carrier, base = carrier_of(flexible, b), np.zeros(6)
        if carrier >= 0:
            base = shifts(bent.origin[frame] - bent.origin[carrier]) @ twists[carrier]
        base = base + hinge_columns(flexible, bent, b) @ qd[tree.v_start[b] : tree.v_start[b + 1]]
        rate, eta = qd[flexible.shape_start[b] : flexible.shape_start[b + 1]], amplitudes(flexible, q, b)
        columns, turn = bent.columns[b], bent.rotation[frame]
        twists[nodes] = shifts(bent.origin[nodes] - bent.origin[frame]) @ base + columns @ rate
        local = dexp_rate(shapes.turns @ eta, shapes.turns @ rate) @ shapes.turns
        change = np.concatenate([turn @ local, -turn @ (shapes.shortening @ rate)], axis=1)
        change[:, :3] += np.cross(base[:3], columns[:, :3], axisb=1).swapaxes(1, 2)
        change[:, 3:] += np.cross(base[:3], columns[:, 3:], axisb=1).swapaxes(1, 2)
        changes.append(change)
    return twists, changes


def _inertial_loads(flexible: Flexible, bent: Bent, q: Floats, qd: Floats, qdd: Floats) -> Floats:
    """(nn, 6) float: moments and forces that give the nodes their accelerations."""
    tree = flexible.tree
    qd, qdd = floats(qd, (flexible.n_v,), "qd"), floats(qdd, (flexible.n_v,), "qdd")
    twists, changes = _twists(flexible, bent, q, qd)
    quickened = np.empty_like(twists)
    for b in range(tree.n_bodies):
        nodes, frame = slice(*flexible.node_start[b : b + 2]), flexible.node_start[b]
        at, own = slice(tree.v_start[b], tree.v_start[b + 1]), slice(*flexible.shape_start[b : b + 2])
        carrier, base, h = carrier_of(flexible, b), np.zeros(6), hinge_columns(flexible, bent, b)
        omega, lever = np.zeros(3), np.zeros(3)
        if carrier >= 0:
            omega, lever = twists[carrier, :3], bent.origin[frame] - bent.origin[carrier]
            base = shifts(lever) @ quickened[carrier]
            base[3:] += np.cross(omega, np.cross(omega, lever))
        base = base + h @ qdd[at]
        if h.shape[1] == 1:
            moved = (h @ qd[at]).reshape(2, 3)
            base += np.concatenate([np.cross(omega, moved[0]), 2.0 * np.cross(omega, moved[1])])
        base_omega, arms = twists[frame, :3], bent.origin[nodes] - bent.origin[frame]
        quick = shifts(arms) @ base + bent.columns[b] @ qdd[own] + changes[b] @ qd[own]
        # The columns' own change has one of the two Coriolis terms.
        quick[:, 3:] += np.cross(base_omega, np.cross(base_omega, arms))
        quick[:, 3:] += np.cross(base_omega, bent.columns[b][:, 3:] @ qd[own])
        quickened[nodes] = quick
    inertia = inertias(flexible, bent)
    loads = np.einsum("nij,nj->ni", inertia, quickened)
    spin = np.einsum("nij,nj->ni", inertia[:, :3, :3], twists[:, :3])
    loads[:, :3] += np.cross(twists[:, :3], spin)
    return loads
