"""Canonical form of bodies that bend: momenta p = M qd in place of velocities, and three ways back to these.

dp/dt is what ``dynamics.momenta`` gives as the gradient, plus torques: no
accelerations, no Coriolis terms, and the momentum of a cyclic coordinate does not change at all.
"""

from typing import Literal

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from protochain.core.arrays import Floats, floats
from protochain.core.errors import Fault, MechanicsError
from protochain.mechanisms.flexible.dynamics import mass_matrix, momenta, solve
from protochain.mechanisms.flexible.flexible import Bent, Flexible, bend

Route = Literal["articulated", "blocks", "dense"]
"""Rates from momenta: leaf to root, O(n), or amplitudes before hinges, or the whole matrix at once."""


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
