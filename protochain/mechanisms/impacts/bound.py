"""Bound on friction below which an impact of several points has one solution."""

from collections.abc import Sequence

import numpy as np

from protochain.core.arrays import Floats
from protochain.mechanics.multibody.articulated import Articulated
from protochain.mechanics.multibody.operational import Rows
from protochain.mechanisms.impacts.bodies import Bending, bodies_of
from protochain.mechanisms.impacts.points import ContactPoint, Struck

_ROUND_OFF = 1e-12
"""Of the largest inverse inertia. Smaller ones count as zero."""


def friction_bound(
    factors: Articulated | Bending, points: Sequence[ContactPoint], loops: Rows | None = None
) -> float:
    """Coefficient of friction below which impacts of points together have one solution, whatever the speeds.

    Parameters
    ----------
    factors : Articulated or Bending
        Bodies, as for :func:`impact`.
    points : sequence of ContactPoint
        Points of contact. Their own friction is not read.
    loops : Rows, optional
        Constraint rows that act at all times.

    Returns
    -------
    float
        Bound sqrt(s / w): s the least eigenvalue of W_nn - W_nt W_tt^-1 W_tn, w the largest of W_tt. Infinite
        without points or tangential motion. 0, without information, if impulses of points are dependent.

    Raises
    ------
    MechanicsError
        If M is singular.

    Notes
    -----
    Friction of bounds g = mu L_n is the least of a convex function of u, whose solutions of two g are apart
    by e with ``e^T W^-1 e <= |dg| |e_t|``. As ``|e_t|^2 <= w e^T W^-1 e`` and ``s |dL_n|^2 <= e^T W^-1 e``, a
    round of g -> mu L_n leaves at most mu sqrt(w / s) of the distance of two g: below 1 there is one fixed
    point, by Banach. Sufficient, not necessary. As Haslinger, Math. Methods Appl. Sci. 5:422 (1983), of
    elastic bodies.
    """
    struck = Struck.of(factors, np.zeros(bodies_of(factors).n_v), points, loops)
    return bound_of(struck.w)


def bound_of(w: Floats) -> float:
    """Bound of :func:`friction_bound` for an inverse inertia (3 k, 3 k)."""
    normal = np.arange(len(w)) % 3 == 0
    if not len(w):
        return np.inf
    nn, nt, tt = w[np.ix_(normal, normal)], w[np.ix_(normal, ~normal)], w[np.ix_(~normal, ~normal)]
    largest = float(np.linalg.eigvalsh(tt)[-1])
    if largest <= _ROUND_OFF * np.abs(w).max():
        return np.inf
    least = float(np.linalg.eigvalsh(nn - nt @ np.linalg.pinv(tt, _ROUND_OFF, hermitian=True) @ nt.T)[0])
    return float(np.sqrt(least / largest)) if least > _ROUND_OFF * np.abs(w).max() else 0.0
