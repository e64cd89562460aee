"""Impacts of trees of rigid bodies, with and without loops: instantaneous impulses at points of contact.

M (qd+ - qd-) = G^T L, with G the rows of the points' relative velocities u = G qd, so that u+ = u- + W L,
W = G M^-1 G^T. After Lidstrom (2015), instantaneous impulses; Keller, J. Appl. Mech. 53:1 (1986); Stronge,
*Impact Mechanics* (2000); Glocker, Pfeiffer, Nonlinear Dyn. 7:471 (1995).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.linalg import cho_solve

from protochain import defaults
from protochain.arrays import Floats, Value, floats, frozen, read_only
from protochain.errors import MechanicsError
from protochain.multibody import complementarity, impulse_path
from protochain.multibody.articulated import Articulated, solve
from protochain.multibody.kinematics import velocities
from protochain.multibody.loops import factor_closed
from protochain.multibody.operational import Rows, operational_inverse, point_rows

Law = Literal["newton", "poisson", "stronge"]
"""Law of restitution: of velocities, of normal impulses, of the work of the normal impulse."""
Order = Literal["together", "in turn"]
"""Several points at once, or one after the other, the fastest first, until none approaches."""
_LAWS = {
    "newton": impulse_path.NEWTON, "poisson": impulse_path.POISSON, "stronge": impulse_path.STRONGE,
}  # fmt: skip
_ORDERS = ("together", "in turn")
_APART = 1e-12
"""Speed of approach, relative to the largest velocity before, that is rounding error."""
_TURNS = 100_000


@dataclass(frozen=True, eq=False)
class ContactPoint(Value):
    """A point at which two bodies, or a body and the world, touch.

    Parameters
    ----------
    name : str
        Name, for messages.
    bodies : tuple of 2 int
        Bodies; -1 for the world.
    point : (3,) float
        Its world position.
    normal : (3,) float
        Direction from the first body to the second, in the world, of any length.
    friction : float
        Coulomb's coefficient.
    restitution : float
        Coefficient of restitution, 0 to 1.

    Raises
    ------
    MechanicsError
        If a number cannot be what it stands for.
    """

    name: str
    bodies: tuple[int, int]
    point: Floats
    normal: Floats
    friction: float = 0.0
    restitution: float = 0.0

    def __post_init__(self) -> None:
        for name in ("point", "normal"):
            value = floats(getattr(self, name), (3,), f"{self.name}: {name}")
            if not np.isfinite(value).all():
                raise MechanicsError(f"contact {self.name!r}: its {name} is not finite")
            object.__setattr__(self, name, read_only(value))
        length = float(np.linalg.norm(self.normal))
        if not length > 0.0:
            raise MechanicsError(f"contact {self.name!r}: its normal has no direction")
        object.__setattr__(self, "normal", frozen(self.normal / length))
        if not 0.0 <= self.friction < np.inf:
            raise MechanicsError(
                f"contact {self.name!r}: its friction {self.friction:g} must be 0 or more, and finite"
            )
        if not 0.0 <= self.restitution <= 1.0:
            raise MechanicsError(f"contact {self.name!r}: its restitution {self.restitution:g} is not 0 to 1")
        if self.bodies[0] == self.bodies[1]:
            raise MechanicsError(f"contact {self.name!r}: a body cannot touch itself")


@dataclass(frozen=True, eq=False)
class Impact(Value):
    """What an impact does.

    Parameters
    ----------
    qd : (n_v,) float
        Velocities after it.
    impulse : (k, 3) float
        Impulse on the second body of each point, world axes.
    before, after : (k, 3) float
        Velocities of the second body relative to the first at each point, world axes.
    compression : (k,) float
        Normal impulse up to the end of the compression; of points in turn, the sum of all.
    loops : (m,) float
        Impulses of the rows of the loops.
    work : float
        Change of the kinetic energy.
    """

    qd: Floats
    impulse: Floats
    before: Floats
    after: Floats
    compression: Floats
    loops: Floats
    work: float


def impact(
    factors: Articulated,
    qd: Floats,
    points: Sequence[ContactPoint],
    law: Law = "poisson",
    loops: Rows | None = None,
    order: Order = "together",
) -> Impact:
    """Impulses and velocities of an impact with Coulomb friction.

    Parameters
    ----------
    factors : Articulated
        Rigid bodies, their frames, and factors of M there (:func:`articulate`).
    qd : (n_v,) float
        Velocities before.
    points : sequence of ContactPoint
        Points of contact, also those that do not approach.
    law : str
        Law of restitution: ``newton`` u_n+ = -e u_n-, ``poisson`` p = (1 + e) p_c, ``stronge`` work of
        restitution = e^2 times that of compression. Poisson's and Stronge's never add energy.
    loops : Rows, optional
        Constraint rows that hold all the time.
    order : str
        Whether several points act ``together``, by Poisson's law, or ``in turn``, as if the bodies were a
        little apart: the fastest first, until none approaches, by any law.

    Returns
    -------
    Impact
        Velocities after, impulses, change of energy.

    Raises
    ------
    MechanicsError
        If a point cannot be met, named with the reason: nothing gives way, friction too high for one
        solution; M singular, rows of loops dependent; unknown laws and orders, and laws other than Poisson's
        for several points together.

    Notes
    -----
    One point: du/dp = W (1, t) over the normal impulse p (:mod:`impulse_path`), exact in the plane. Several
    together: two complementarity problems, of compression and of restitution (:mod:`complementarity`);
    velocities are unique, impulses at redundant points those of least norm. Where coefficients of restitution
    differ, all are lowered by a common factor if the impact would add energy otherwise. O(n + k^2), and the
    solution for k points.
    """
    _check(factors, points, law, order)
    struck = _Struck.of(factors, floats(qd, (factors.tree.n_v,), "qd"), points, loops)
    local = np.zeros((2, 3 * len(points)))
    if np.min(struck.u[::3], initial=0.0) < -_APART * np.max(np.abs(struck.u), initial=0.0):
        if len(points) == 1:
            local = _one(struck, points[0], law)
        elif order == "together":
            local = _together(struck, points)
        else:
            local = _in_turn(struck, points, law)
    return struck.with_impulses(local[0], local[1, ::3])


def close_loops(factors: Articulated, qd: Floats, rows: Rows) -> Floats:
    """Velocities after a plastic impulse that closes loops: G qd = 0.

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


@dataclass(frozen=True, eq=False)
class _Struck:
    """Points and loops at one moment: rows, inverse inertia, velocities.

    Parameters
    ----------
    factors, qd, rows : Articulated, (n_v,) float, Rows
        Rows: of the loops, then of the points along their own axes (normal, two tangential).
    axes : (k, 3, 3) float
        Axes of the points, as rows.
    w, u : (3 k, 3 k) float, (3 k,) float
        Inverse inertia and velocities of the points, with the loops closed.
    closing : (m, 3 k) float
        Impulses of the loops per impulse of the points.
    closed : (m,) float
        Impulses of the loops without those.
    """

    factors: Articulated
    qd: Floats
    rows: Rows
    axes: Floats
    w: Floats
    u: Floats
    closing: Floats
    closed: Floats

    @classmethod
    def of(
        cls, factors: Articulated, qd: Floats, points: Sequence[ContactPoint], loops: Rows | None
    ) -> "_Struck":
        tree, frames = factors.tree, factors.frames
        axes = np.array([_axes(point.normal) for point in points]).reshape(-1, 3, 3)
        parts = [Rows(np.zeros((0, 2), dtype=np.int64), np.zeros((0, 2, 6))) if loops is None else loops]
        for point, own in zip(points, axes, strict=True):
            along = point_rows(frames, point.bodies, np.stack([point.point, point.point]))
            parts.append(Rows(along.body, np.einsum("ij,jsk->isk", own, along.wrench)))
        rows = Rows(
            np.concatenate([part.body for part in parts]), np.concatenate([part.wrench for part in parts])
        )
        m = len(parts[0].body)
        whole = operational_inverse(tree, frames, rows, factors)
        rates = _rates(factors, rows, qd)
        w, u = whole[m:, m:], rates[m:]
        closing, closed = np.zeros((m, len(u))), np.zeros(m)
        if m:
            upper = factor_closed(whole[:m, :m])
            closing, closed = -cho_solve(upper, whole[:m, m:]), -cho_solve(upper, rates[:m])
            w, u = w + whole[m:, :m] @ closing, u + whole[m:, :m] @ closed
        w = np.ascontiguousarray(0.5 * (w + w.T))
        return cls(factors, qd, rows, axes, w, np.ascontiguousarray(u), closing, closed)

    def with_impulses(self, local: Floats, compression: Floats) -> Impact:
        """What impulses (3 k,) along the points' axes do."""
        tree, k = self.factors.tree, len(self.axes)
        loops = self.closed + self.closing @ local
        impulses = np.concatenate([loops, local])
        loads = np.zeros((tree.n_bodies, 6))
        for side in (0, 1):
            on = self.rows.body[:, side] >= 0
            np.add.at(loads, self.rows.body[on, side], -impulses[on, None] * self.rows.wrench[on, side])
        change = solve(self.factors, np.zeros(tree.n_v), loads) if np.any(impulses) else np.zeros(tree.n_v)
        qd = self.qd + change
        m = len(loops)
        before, after = (_rates(self.factors, self.rows, x) for x in (self.qd, qd))
        impulse, seen, left = (
            frozen(np.einsum("kij,ki->kj", self.axes, x.reshape(k, 3)))
            for x in (local, before[m:], after[m:])
        )
        work = 0.5 * float(impulses @ (before + after))
        return Impact(frozen(qd), impulse, seen, left, read_only(compression), frozen(loops), work)


def _check(factors: Articulated, points: Sequence[ContactPoint], law: str, order: str) -> None:
    if law not in _LAWS:
        raise MechanicsError(f"law {law!r} is not known; choose newton, poisson or stronge")
    if order not in _ORDERS:
        raise MechanicsError(f"order {order!r} is not known; choose together or in turn")
    if len(points) > 1 and order == "together" and law != "poisson":
        raise MechanicsError(
            f"several points together follow Poisson's law, not {law}; choose law poisson or order in turn"
        )
    for point in points:
        for body in point.bodies:
            if not -1 <= body < factors.tree.n_bodies:
                raise MechanicsError(f"contact {point.name!r}: there is no body {body}")


def _axes(normal: Floats) -> Floats:
    """(3, 3) float: the normal and two directions across it, as rows."""
    across = np.zeros(3)
    across[np.argmin(np.abs(normal))] = 1.0
    # What is left of the axis most across it, so that plane problems along world axes stay in their plane.
    first = across - (across @ normal) * normal
    first /= np.linalg.norm(first)
    return np.stack([normal, first, np.cross(normal, first)])


def _rates(factors: Articulated, rows: Rows, qd: Floats) -> Floats:
    """(m,) float: velocities G qd along the rows."""
    twists = velocities(factors.tree, factors.frames, qd)
    # A row of zeros for the world, which index -1 finds.
    twists = np.concatenate([twists, np.zeros((1, 6))])
    return np.asarray(np.einsum("msk,msk->m", rows.wrench, twists[rows.body]))


def _one(struck: _Struck, point: ContactPoint, law: Law) -> Floats:
    """(2, 3) float: impulse of one point, and that of its compression (normal)."""
    out = np.empty(8)
    status = impulse_path.follow(
        struck.w, struck.u, point.friction, point.restitution, _LAWS[law], defaults.IMPACT_TOLERANCE, out
    )
    _refuse(status, point)
    return np.array([out[:3], (out[3], 0.0, 0.0)])


def _together(struck: _Struck, points: Sequence[ContactPoint]) -> Floats:
    """(2, 3 k) float: impulses, and those of the compression."""
    for i, point in enumerate(points):
        _refuse_immovable(struck, 3 * i, point)
    friction, restitution = _coefficients(points)
    out = np.zeros((2, 3 * len(points)))
    status = complementarity.restitute(struck.w, struck.u, friction, restitution, out)
    if status != complementarity.SOLVED:
        # Of several solutions, where they differ most; otherwise where friction is highest.
        differ = np.linalg.norm(out[0].reshape(-1, 3), axis=1) * (friction > 0.0)
        worst = points[int(np.argmax(differ if status == complementarity.SEVERAL else friction))]
        raise MechanicsError(
            f"contact {worst.name!r}: friction {worst.friction:g} is too high for one solution together with "
            "the others; lower it, or take the points in turn"
        )
    return out


def _in_turn(struck: _Struck, points: Sequence[ContactPoint], law: Law) -> Floats:
    """(2, 3 k) float: impulses, and those of the compressions, of one point after the other."""
    friction, restitution = _coefficients(points)
    out = np.zeros((2, 3 * len(points)))
    status, i = impulse_path.follow_in_turn(
        struck.w, struck.u, friction, restitution, _LAWS[law], defaults.IMPACT_TOLERANCE, _APART, _TURNS, out
    )
    _refuse(status, points[i])
    return out


def _coefficients(points: Sequence[ContactPoint]) -> tuple[Floats, Floats]:
    """Friction and restitution, (k,) each."""
    return np.array([point.friction for point in points]), np.array([point.restitution for point in points])


def _refuse_immovable(struck: _Struck, i: int, point: ContactPoint) -> None:
    if not struck.w[i, i] > 1e-24 * np.max(np.abs(struck.w)):
        _refuse(impulse_path.IMMOVABLE, point)


def _refuse(status: int, point: ContactPoint) -> None:
    reasons = {
        impulse_path.IMMOVABLE: "nothing that touches there can move along its normal; leave it out",
        impulse_path.JAMMED: f"it sticks, by friction {point.friction:g}, and cannot leave as "
        "Newton's law asks; choose law poisson or stronge",
        impulse_path.LOST: "its path has no end within the steps allowed; lower its friction",
    }  # fmt: skip
    if status in reasons:
        raise MechanicsError(f"contact {point.name!r}: {reasons[status]}")
