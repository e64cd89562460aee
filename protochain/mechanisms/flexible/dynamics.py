"""Dynamics of trees of which some bodies bend: mass matrix in blocks, accelerations, and canonical form.

The canonical form has momenta p = M qd in place of velocities, and three ways back to these. dp/dt is what
:func:`momenta` gives as the gradient, plus torques: no accelerations, no Coriolis terms, and the momentum of
a cyclic coordinate does not change at all.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from protochain.core.arrays import Floats, Integers, floats
from protochain.core.errors import BodyError, Fault, MechanicsError
from protochain.mechanics.multibody.rotations import hinge_accelerations
from protochain.mechanisms.flexible import kernels
from protochain.mechanisms.flexible.flexible import Bent, Flexible, bend

Route = Literal["articulated", "blocks", "dense"]
"""Rates from momenta: leaf to root, O(n), or amplitudes before hinges, or the whole matrix at once."""


@dataclass(frozen=True)
class Blocks:
    """Mass matrix by hinges (r) and amplitudes (f): [[rr, rf], [fr, ff]], fr the transpose of rf."""

    rr: Floats
    rf: Floats
    ff: Floats


def velocities(flexible: Flexible, bent: Bent, qd: Floats) -> Floats:
    """Twists (nn, 6) of all nodes about their places, world axes, for velocities qd (n_v,). O(n)."""
    twists = np.empty((len(bent.origin), 6))
    kernels.put_twists(*_nodes(flexible, bent), floats(qd, (flexible.n_v,), "qd"), twists)
    return twists


def _nodes(flexible: Flexible, bent: Bent) -> tuple[Integers, Floats, Floats, Floats, Floats]:
    """Arguments of the sweeps for bodies and their nodes."""
    return flexible.links, flexible.seats, bent.rotation, bent.origin, bent.columns


def jacobian(flexible: Flexible, bent: Bent) -> Floats:
    """Dense Jacobian of the nodes: their twists about their places are J qd."""
    # -> (nn, 6, n_v): Columns are the freedoms. O(n^2): for tests and small studies.
    return np.stack([velocities(flexible, bent, unit) for unit in np.eye(flexible.n_v)], axis=2)


def mass_matrix(flexible: Flexible, bent: Bent) -> Blocks:
    """Mass matrix: the sum of J^T I J over all nodes. O(n^3)."""
    j, r, mass = jacobian(flexible, bent), flexible.tree.n_v, flexible.sections.mass
    inertia = bent.rotation @ flexible.sections.inertia @ bent.rotation.swapaxes(1, 2)
    moved = np.concatenate([inertia @ j[:, :3], mass[:, None, None] * j[:, 3:]], axis=1)
    m = j.reshape(-1, flexible.n_v).T @ moved.reshape(-1, flexible.n_v)
    return Blocks(m[:r, :r] + np.diag(flexible.tree.rotors), m[:r, r:], m[r:, r:])


def pull_back(flexible: Flexible, bent: Bent, wrench: Floats) -> Floats:
    """Torques (n_v,) of wrenches (nn, 6) on the nodes about their places, world axes: J^T wrench. O(n)."""
    return _pull_back(flexible, bent, floats(wrench, (len(bent.origin), 6), "wrench").copy())


def inverse_dynamics(
    flexible: Flexible, q: Floats, qd: Floats, qdd: Floats, wrench: Floats | None = None
) -> Floats:
    """Torques M qdd + c(q, qd) - J^T wrench, without elastic ones."""
    # qd, qdd (n_v,), wrench (nn, 6) -> (n_v,): Torques. O(n).
    return _torques(flexible, bend(flexible, q), q, qd, qdd, wrench)


def forward_dynamics(
    flexible: Flexible, q: Floats, qd: Floats, tau: Floats, wrench: Floats | None = None
) -> Floats:
    """Accelerations, which solve M qdd + c(q, qd) = tau + J^T wrench."""
    # qd, tau (n_v,), wrench (nn, 6) -> (n_v,): Accelerations; those of driven hinges as given. O of the sum
    # of cubes of the numbers of shapes.
    bent, prescribed, driven = bend(flexible, q), np.zeros(flexible.n_v), flexible.tree.driven_v
    prescribed[driven] = tau[driven]
    return solve(flexible, bent, tau - _torques(flexible, bent, q, qd, prescribed, wrench)) + prescribed


def solve(flexible: Flexible, bent: Bent, tau: Floats) -> Floats:
    """Solve M x = tau by one inward and one outward sweep. x is 0 at driven hinges."""
    # tau (n_v,) -> (n_v,).
    # As ``multibody.articulated``, with a body's amplitudes eliminated before its hinge.
    x = floats(tau, (flexible.n_v,), "tau").copy()
    failed = kernels.solve_bent(*_nodes(flexible, bent), *flexible.arrays[1:3], x)
    if failed >= 0:
        raise BodyError(
            failed,
            "its hinge or one of its shapes has no inertia at this pose, so accelerations are undefined",
        )
    return x


def momenta(flexible: Flexible, q: Floats, qd: Floats) -> tuple[Floats, Floats]:
    """Canonical momenta p = M qd, and the gradient of the kinetic energy at constant velocities. O(n)."""
    # qd (n_v,) -> (n_v,): Momenta; gradient, the sum over all nodes of (dJ/dt)^T times momentum, also for a
    # free root. Lagrange's equations are dp/dt = tau + gradient.
    bent = bend(flexible, q)
    twists, changes = _twists(flexible, bent, q, qd)
    felt = _momenta_of_nodes(flexible, bent, twists)
    p, gradient = _pull_back(flexible, bent, felt) + flexible.rotors * qd, np.empty(flexible.n_v)
    kernels.put_gradient(*_nodes(flexible, bent), twists, changes, felt, gradient)
    return p, gradient


def rates_of(flexible: Flexible, bent: Bent, p: Floats, route: Route = "articulated") -> Floats:
    """Velocities qd of momenta p = M qd, p (n_v,) -> (n_v,): Velocities."""
    p = floats(p, (flexible.n_v,), "p")
    if flexible.tree.driven is not None:
        raise MechanicsError(
            "driven hinges have velocities, not momenta; use forward_dynamics", fault=Fault.DRIVEN
        )
    if route == "articulated":
        return solve(flexible, bent, p)
    if route not in ("blocks", "dense"):
        raise MechanicsError(f"route {route!r} is not known; choose articulated, blocks or dense")
    m, n = mass_matrix(flexible, bent), flexible.tree.n_v
    try:
        if route == "dense":
            return np.asarray(cho_solve(cho_factor(np.block([[m.rr, m.rf], [m.rf.T, m.ff]])), p))
        bending = cho_solve(cho_factor(m.ff), np.column_stack([m.rf.T, p[n:]]))
        hinges = cho_solve(cho_factor(m.rr - m.rf @ bending[:, :n]), p[:n] - m.rf @ bending[:, n])
    except LinAlgError:
        raise MechanicsError("the mass matrix is singular at this pose") from None
    return np.concatenate([hinges, bending[:, n] - bending[:, :n] @ hinges])


def canonical_rates(
    flexible: Flexible, q: Floats, p: Floats, tau: Floats, route: Route = "articulated"
) -> tuple[Floats, Floats]:
    """Right-hand sides of Hamilton's equations.

    Parameters
    ----------
    flexible, q : Flexible and (n_q,) float
        Bodies and their coordinates.
    p, tau : (n_v,) float
        Momenta, and torques with the elastic ones.
    route : str
        Way of solution, as in :func:`rates_of`.

    Returns
    -------
    (n_v,) float, (n_v,) float
        Velocities qd, and dp/dt.
    """
    qd = rates_of(flexible, bend(flexible, q), p, route)
    return qd, tau + momenta(flexible, q, qd)[1]


def multiply_mass(flexible: Flexible, bent: Bent, x: Floats) -> Floats:
    """Product M x (n_v,) without forming M. O(n)."""
    felt = _momenta_of_nodes(flexible, bent, velocities(flexible, bent, x))
    return _pull_back(flexible, bent, felt) + flexible.rotors * x


def _momenta_of_nodes(flexible: Flexible, bent: Bent, twists: Floats) -> Floats:
    """(nn, 6) float: each node's angular momentum about its place, and linear momentum."""
    turn, sections = bent.rotation, flexible.sections
    angular = (twists[:, None, :3] @ turn) @ sections.inertia @ turn.swapaxes(1, 2)
    return np.concatenate([angular[:, 0], sections.mass[:, None] * twists[:, 3:]], axis=1)


def _pull_back(flexible: Flexible, bent: Bent, felt: Floats) -> Floats:
    """J^T felt (nn, 6), which is overwritten by the loads that the nodes carry."""
    tau = np.empty(flexible.n_v)
    kernels.put_torques(*_nodes(flexible, bent), felt, tau)
    return tau


def _twists(flexible: Flexible, bent: Bent, q: Floats, qd: Floats) -> tuple[Floats, Floats]:
    """Twists (nn, 6) of the nodes, and the rates at which their columns change (nn, K, 6)."""
    _, _, _, _, turns, shortening = flexible.arrays
    twists, changes = velocities(flexible, bent, qd), np.zeros_like(bent.columns)
    kernels.put_changes(
        flexible.links, turns, shortening, bent.rotation, bent.columns, floats(q, (flexible.n_q,), "q"),
        floats(qd, (flexible.n_v,), "qd"), twists, changes,
    )  # fmt: skip
    return twists, changes


def _torques(
    flexible: Flexible, bent: Bent, q: Floats, qd: Floats, qdd: Floats, wrench: Floats | None
) -> Floats:
    twists, changes = _twists(flexible, bent, q, qd)
    loads, qd = np.empty_like(twists), floats(qd, (flexible.n_v,), "qd")
    qdd = floats(qdd, (flexible.n_v,), "qdd")
    along = hinge_accelerations(flexible.tree, qd, qdd)
    inertial = *_nodes(flexible, bent), *flexible.arrays[1:3]
    kernels.put_loads(*inertial, twists, changes, qd, along, loads)
    if wrench is not None:
        loads -= floats(wrench, loads.shape, "wrench")
    return _pull_back(flexible, bent, loads) + flexible.rotors * qdd
