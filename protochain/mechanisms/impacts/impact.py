"""Impacts of trees of rigid bodies, with and without loops: instantaneous impulses at points of contact.

M (qd+ - qd-) = G^T L, with G the rows of the points' relative velocities u = G qd, so that u+ = u- + W L,
W = G M^-1 G^T. After Lidstrom (2015), instantaneous impulses. Keller, J. Appl. Mech. 53:1 (1986). Stronge,
*Impact Mechanics* (2000). Glocker, Pfeiffer, Nonlinear Dyn. 7:471 (1995).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from protochain.core import defaults
from protochain.core.arrays import Floats, Value, floats, freeze, read_only
from protochain.core.errors import Fault, MechanicsError
from protochain.core.settings import document_fields
from protochain.mechanics.multibody.articulated import Articulated
from protochain.mechanics.multibody.operational import Rows
from protochain.mechanisms.impacts import complementarity
from protochain.mechanisms.impacts import path as impulse_path
from protochain.mechanisms.impacts.bodies import (
    Bending,
    Bodies,
    External,
    bodies_of,
    loads_of,
    row_speeds,
    strike,
)
from protochain.mechanisms.impacts.points import ContactPoint, Struck

Law = Literal["newton", "poisson", "stronge"]
"""Law of restitution: of velocities, of normal impulses, of the work of the normal impulse."""
Order = Literal["together", "in turn"]
"""Several points at once, or one after the other, the fastest first, until none approaches."""
_LAWS = {"newton": impulse_path.NEWTON, "poisson": impulse_path.POISSON, "stronge": impulse_path.STRONGE}
_ROUND_OFF = 1e-12
"""Of the largest inverse inertia. Smaller ones count as zero."""


@document_fields
@dataclass(frozen=True, eq=False)
class Impact(Value):
    """Result of an impact."""

    qd: Floats  # (n_v,) float: Velocities after it.
    impulse: Floats  # (k, 3) float: Impulse on the second body of each point, world axes.
    # (k, 3) float: Velocities of the second body relative to the first at each point before the impact, world
    # axes, with external impulses.
    before: Floats
    after: Floats  # (k, 3) float: The same velocities after the impact.
    # (k,) float: Normal impulse up to the end of the compression, the sum of all for points in turn.
    compression: Floats
    loops: Floats  # (m,) float: Impulses of the rows of the loops.
    work: float  # Change of the kinetic energy.
    # Energy loss by contacts and closing loops: -P (u- + u+)/2 over their impulses P. By Poisson's and
    # Stronge's laws it is not negative. By Newton's it may be, with friction.
    dissipation: float


def impact(
    factors: Articulated | Bending,
    qd: Floats,
    points: Sequence[ContactPoint],
    law: Law = "poisson",
    loops: Rows | None = None,
    order: Order = "together",
    external: External | None = None,
) -> Impact:
    """Find impulses and velocities of an impact with Coulomb friction.

    Parameters
    ----------
    factors : Articulated or Bending
        Rigid bodies, their frames, and factors of M there (``State.factors``), or bodies that bend.
    qd : (n_v,) float
        Velocities before.
    points : sequence of ContactPoint
        Points of contact, also those that do not approach.
    law : str
        Law of restitution: ``newton`` u_n+ = -e u_n-, ``poisson`` p = (1 + e) p_c, ``stronge`` work of
        restitution = e^2 times the work of compression. Poisson's and Stronge's never add energy.
    loops : Rows, optional
        Constraint rows that act at all times.
    order : str
        Whether several points act ``together``, by Poisson's law, or ``in turn``, as if the bodies were a
        little apart: the fastest first, until none approaches, by any law.
    external : mapping of int to ((3,) float, (3,) float), optional
        Given impulses, as of a hammer: body -> world point and impulse on it, world axes. They act first, and
        may make separate points approach. Without points they act alone.

    Returns
    -------
    Impact
        Velocities after, impulses, change of energy.

    Raises
    ------
    MechanicsError
        If a point cannot move, friction is too high for one solution, M is singular, or rows of loops are
        dependent. If a law or order is unknown, or the law of several points together is not Poisson's. If
        bodies of ``external`` are unknown, or values are not finite.

    Notes
    -----
    One point: du/dp = W (1, t) over the normal impulse p (:mod:`impulse_path`), exact in the plane. Several
    together: two complementarity problems, of compression and of restitution (:mod:`complementarity`).
    Velocities are unique, impulses at redundant points have the least norm. If coefficients of restitution
    differ, all are lowered by a common factor if the impact would add energy otherwise. O(n + k^2), and the
    solution for k points.
    """
    bodies = bodies_of(factors)
    _check(bodies, points, law, order)
    qd = floats(qd, (bodies.n_v,), "qd")
    if not np.isfinite(qd).all():
        raise MechanicsError("the velocities before an impact are not finite", fault=Fault.NOT_FINITE)
    qd, work = (qd, 0.0) if external is None else strike(bodies, qd, external)
    struck = Struck.of(factors, qd, points, loops)
    local = np.zeros((2, 3 * len(points)))
    approaching = struck.u[::3] < -struck.slow
    for i in np.flatnonzero(approaching & ~struck.movable):
        _refuse(impulse_path.IMMOVABLE, points[int(i)])
    if np.any(approaching):
        # Points that cannot move have no impulse.
        take = np.flatnonzero(struck.movable)
        rows = (3 * take[:, None] + np.arange(3)).ravel()
        subset, chosen = struck.part(rows, take), [points[int(i)] for i in take]
        if len(points) == 1:
            local = _one(subset, points[0], law)
        elif order == "together":
            local[:, rows] = _together(subset, chosen)
        else:
            local[:, rows] = _in_turn(subset, chosen, law)
    return _after(struck, local[0], local[1, ::3], work)


def close_loops(factors: Articulated, qd: Floats, rows: Rows) -> Floats:
    """Close loops by a plastic impulse: G qd = 0.

    Parameters
    ----------
    factors : Articulated
        Rigid bodies, their frames, and factors of M there.
    qd : (n_v,) float
        Velocities before.
    rows : Rows
        Constraint rows G of the loops.

    Returns
    -------
    (n_v,) float
        Velocities after, the nearest in kinetic energy that the loops allow.

    Raises
    ------
    MechanicsError
        If the rows are linearly dependent.
    """
    return impact(factors, qd, (), loops=rows).qd


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


def _after(struck: Struck, local: Floats, compression: Floats, work: float) -> Impact:
    """Result of impulses (3 k,) along the points' axes. Work done before is added."""
    bodies, k = struck.bodies, len(struck.axes)
    loops = struck.closed + struck.closing @ local
    impulses = np.concatenate([loops, local])
    change = bodies.change(loads_of(bodies, struck.rows, impulses)) if np.any(impulses) else 0.0
    qd = struck.qd + change
    m = len(loops)
    before, after = struck.before, row_speeds(bodies, struck.rows, qd)
    impulse, seen, left = (
        freeze(np.einsum("kij,ki->kj", struck.axes, x.reshape(k, 3))) for x in (local, before[m:], after[m:])
    )
    lost = -0.5 * float(impulses @ (before + after))
    return Impact(freeze(qd), impulse, seen, left, read_only(compression), freeze(loops), work - lost, lost)


def _check(bodies: Bodies, points: Sequence[ContactPoint], law: str, order: str) -> None:
    if isinstance(points, ContactPoint) or not all(isinstance(p, ContactPoint) for p in points):
        raise MechanicsError("points: give a list of them, as [ContactPoint(...)]")
    if not (isinstance(law, str) and law in _LAWS):
        raise MechanicsError(f"law {law!r} is not known; choose newton, poisson or stronge")
    if not (isinstance(order, str) and order in ("together", "in turn")):
        raise MechanicsError(f"order {order!r} is not known; choose together or in turn")
    if len(points) > 1 and order == "together" and law != "poisson":
        raise MechanicsError(
            f"several points together follow Poisson's law, not {law}; choose law poisson or order in turn"
        )
    for point in points:
        for body in point.bodies:
            if not -1 <= body < len(bodies.origin):
                raise MechanicsError(f"contact {point.name!r}: there is no body {body}")


def _one(struck: Struck, point: ContactPoint, law: Law) -> Floats:
    """(2, 3) float: impulse of one point, and its (normal) impulse of the compression."""
    out = np.empty(8)
    coefficients = point.friction, point.restitution
    status = impulse_path.follow(
        struck.w, struck.u, *coefficients, _LAWS[law], struck.slow[0], defaults.IMPACT_TOLERANCE, out
    )
    _refuse(status, point)
    return np.array([out[:3], (out[3], 0.0, 0.0)])


def _together(struck: Struck, points: Sequence[ContactPoint], plastic: bool = False) -> Floats:
    """(2, 3 k) float: impulses, and impulses of the compression. Without restitution if plastic."""
    friction, restitution = _coefficients(points)
    out = np.zeros((2, 3 * len(points)))
    bounce = np.zeros(len(points)) if plastic else restitution
    status = complementarity.restitute(struck.w, struck.u, friction, bounce, out)
    if status != complementarity.SOLVED:
        # Name the point at which two solutions differ most, or else the point of highest friction.
        differ = np.linalg.norm(out[0].reshape(-1, 3), axis=1) * (friction > 0.0)
        worst = points[int(np.argmax(differ if status == complementarity.SEVERAL else friction))]
        sure = bound_of(struck.w)
        below = f" (below {sure:.2g} there is one)" if sure else ""
        raise MechanicsError(
            f"contact {worst.name!r}: friction {worst.friction:g} is too high for a unique solution with "
            f"the others; lower it{below}, or choose order in turn",
            fault=Fault.FRICTION,
        )
    return out


def _in_turn(struck: Struck, points: Sequence[ContactPoint], law: Law) -> Floats:
    """(2, 3 k) float: impulses, and impulses of the compressions, of one point after the other."""
    friction, restitution = _coefficients(points)
    out = np.zeros((2, 3 * len(points)))
    status, i = impulse_path.follow_in_turn(
        struck.w, struck.u, friction, restitution, _LAWS[law], struck.slow, defaults.IMPACT_TOLERANCE,
        1000, out,
    )  # fmt: skip
    # After 1000 turns, points that still approach stop together: endless impacts have ever less effect.
    if status != impulse_path.ENDLESS:
        _refuse(status, points[i])
        return out
    later = _together(replace(struck, u=struck.u + struck.w @ out[0]), points, plastic=True)
    return out + later


def _coefficients(points: Sequence[ContactPoint]) -> tuple[Floats, Floats]:
    """Friction and restitution, (k,) each."""
    return np.array([point.friction for point in points]), np.array([point.restitution for point in points])


def _refuse(status: int, point: ContactPoint) -> None:
    reasons = {
        impulse_path.IMMOVABLE: "neither body can move along its normal; remove this contact",
        impulse_path.JAMMED: f"it sticks, by friction {point.friction:g}, and cannot leave as "
        "Newton's law asks; choose law poisson or stronge",
        impulse_path.LOST: "its path does not end within the allowed steps; lower its friction",
    }
    faults = {impulse_path.IMMOVABLE: Fault.IMMOVABLE, impulse_path.JAMMED: Fault.JAMMED}
    if status in reasons:
        raise MechanicsError(f"contact {point.name!r}: {reasons[status]}", fault=faults.get(status))
