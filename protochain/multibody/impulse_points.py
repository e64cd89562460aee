"""Points of contact, and what of the bodies an impact there sees: rows, inverse inertia, velocities."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_solve

from protochain.arrays import Floats, Integers, Value, floats, frozen, read_only
from protochain.errors import MechanicsError
from protochain.multibody.articulated import Articulated
from protochain.multibody.kinematics import velocities
from protochain.multibody.loops import factor_closed
from protochain.multibody.operational import Rows, operational_inverse, point_rows

_APART, _LOCKED = 1e-12, 1e-13
"""Speed of approach, relative to those of the bodies there, and inverse inertia, relative to that without
loops, that are rounding errors."""


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
class Struck:
    """Points and loops at one moment: rows, inverse inertia, velocities.

    Parameters
    ----------
    factors, qd, rows : Articulated, (n_v,) float, Rows
        Rows: of the loops, then of the points along their own axes (normal, two tangential).
    axes : (k, 3, 3) float
        Axes of the points, as rows.
    w, u : (3 k, 3 k) float, (3 k,) float
        Inverse inertia and velocities of the points, with the loops closed.
    slow : (k,) float
        Speeds of approach that are rounding errors.
    movable : (k,) bool
        Whether anything gives way along the normal.
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
    slow: Floats
    movable: np.ndarray
    closing: Floats
    closed: Floats

    @classmethod
    def of(
        cls, factors: Articulated, qd: Floats, points: Sequence[ContactPoint], loops: Rows | None
    ) -> "Struck":
        """Of points in the frames of the factors; the velocities are those after the loops have closed."""
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
        before = rates_along(factors, rows, qd)
        w, u = whole[m:, m:], before[m:]
        closing, closed = np.zeros((m, len(u))), np.zeros(m)
        if m:
            upper = factor_closed(whole[:m, :m])
            closing, closed = -cho_solve(upper, whole[:m, m:]), -cho_solve(upper, before[:m])
            w, u = w + whole[m:, :m] @ closing, u + whole[m:, :m] @ closed
        w = np.ascontiguousarray(0.5 * (w + w.T))
        slow = _APART * rates_along(factors, rows, qd, np.abs)[m:].reshape(-1, 3).max(axis=1, initial=0.0)
        free = np.diagonal(whole)[m:].reshape(-1, 3).max(axis=1, initial=0.0)
        movable = np.diagonal(w)[::3] > _LOCKED * free
        return cls(factors, qd, rows, axes, w, u.copy(), slow, movable, closing, closed)

    def part(self, rows: Integers, take: Integers) -> "Struck":
        """Some of the points: inverse inertia and velocities only."""
        w, u = np.ascontiguousarray(self.w[np.ix_(rows, rows)]), self.u[rows]
        return replace(self, w=w, u=u, slow=self.slow[take])


def _axes(normal: Floats) -> Floats:
    """(3, 3) float: the normal and two directions across it, as rows."""
    across = np.zeros(3)
    across[np.argmin(np.abs(normal))] = 1.0
    # What is left of the axis most across it, so that plane problems along world axes stay in their plane.
    first = across - (across @ normal) * normal
    first /= np.linalg.norm(first)
    return np.stack([normal, first, np.cross(normal, first)])


def rates_along(
    factors: Articulated, rows: Rows, qd: Floats, of: Callable[[Floats], Floats] = np.asarray
) -> Floats:
    """(m,) float: velocities G qd along the rows; of the absolute values, what they can be at most."""
    twists = velocities(factors.tree, factors.frames, qd)
    # A row of zeros for the world, which index -1 finds.
    twists = np.concatenate([twists, np.zeros((1, 6))])
    return np.asarray(np.einsum("msk,msk->m", of(rows.wrench), of(twists)[rows.body]))
