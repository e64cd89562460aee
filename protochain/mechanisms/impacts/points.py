"""Points of contact, and the rows, inverse inertia and velocities of the bodies at them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_solve

from protochain.core.arrays import Floats, Integers, Value, floats, freeze, read_only
from protochain.core.checks import brief, number
from protochain.core.errors import MechanicsError
from protochain.core.settings import document_fields
from protochain.mechanics.multibody.articulated import Articulated
from protochain.mechanics.multibody.loops import factor_closed
from protochain.mechanics.multibody.operational import Rows
from protochain.mechanisms.impacts.bodies import Bending, Bodies, bodies_of, twists_of

_APART, _LOCKED = 1e-12, 1e-13
"""Rounding errors: speed of approach, relative to the bodies' speeds, and inverse inertia, relative to it
without loops."""


@document_fields
@dataclass(frozen=True, eq=False)
class ContactPoint(Value):
    """A point at which two bodies, or a body and the world, touch.

    Raises
    ------
    MechanicsError
        If a number is not valid for its quantity.
    """

    name: str  # Name, for messages.
    bodies: tuple[int, int]  # Bodies, or nodes of bodies that bend, -1 for the world.
    point: Floats  # (3,) float: Its world position.
    normal: Floats  # (3,) float: Direction from the first body to the second, in the world, of any length.
    friction: float = 0.0  # Coulomb's coefficient.
    restitution: float = 0.0  # Coefficient of restitution, 0 to 1.

    def __post_init__(self) -> None:
        for name in ("point", "normal"):
            value = floats(getattr(self, name), (3,), f"{self.name}: {name}")
            if not np.isfinite(value).all():
                raise MechanicsError(f"contact {self.name!r}: its {name} is not finite")
            object.__setattr__(self, name, read_only(value))
        length = float(np.linalg.norm(self.normal))
        if not length > 0.0:
            raise MechanicsError(f"contact {self.name!r}: its normal has no direction")
        object.__setattr__(self, "normal", freeze(self.normal / length))
        for name in ("friction", "restitution"):
            number(getattr(self, name), f"contact {self.name!r}: its {name}")
        if not 0.0 <= self.friction < np.inf:
            raise MechanicsError(
                f"contact {self.name!r}: its friction {self.friction:g} must be 0 or more, and finite"
            )
        if not 0.0 <= self.restitution <= 1.0:
            raise MechanicsError(f"contact {self.name!r}: its restitution {self.restitution:g} is not 0 to 1")
        if not (len(self.bodies) == 2 and all(isinstance(b, int | np.integer) for b in self.bodies)):
            raise MechanicsError(
                f"contact {self.name!r}: bodies {brief(self.bodies)}: give two numbers, of which -1 is the "
                "world"
            )
        if self.bodies[0] == self.bodies[1]:
            raise MechanicsError(f"contact {self.name!r}: a body cannot touch itself")


@dataclass(frozen=True, eq=False)
class Struck:
    """Points and loops at one moment: rows, inverse inertia, velocities."""

    # rows: of the loops, then of the points along their own axes (normal, two tangential).
    bodies: Bodies
    qd: Floats
    rows: Rows
    axes: Floats  # (k, 3, 3): Axes of the points, as rows.
    before: Floats  # (m + 3 k,): Velocities along the rows.
    w: Floats  # w (3 k, 3 k), u (3 k,): Inverse inertia and velocities of the points, with the loops closed.
    u: Floats
    slow: Floats  # (k,): Speeds of approach that are rounding errors.
    movable: np.ndarray  # (k,) bool: Whether anything gives way along the normal.
    closing: Floats  # (m, 3 k): Impulses of the loops per impulse of the points.
    closed: Floats  # (m,): Impulses of the loops without impulses of the points.

    @classmethod
    def of(
        cls, factors: Articulated | Bending, qd: Floats, points: Sequence[ContactPoint], loops: Rows | None
    ) -> "Struck":
        """Of points in the frames of the factors, with the velocities after the loops have closed."""
        bodies = bodies_of(factors)
        axes = np.array([_axes(*point.normal.tolist()) for point in points]).reshape(-1, 3, 3)
        rows = _rows(bodies.origin, points, axes)
        m = 0
        if loops is not None:
            m = len(loops.body)
            rows = Rows(np.concatenate([loops.body, rows.body]), np.concatenate([loops.wrench, rows.wrench]))
        inverse_inertia = bodies.inverse(rows)
        twists = twists_of(bodies, rows, qd)
        before = np.einsum("msk,msk->m", rows.wrench, twists)
        w, u = inverse_inertia[m:, m:], before[m:]
        closing, closed = np.zeros((m, len(u))), np.zeros(m)
        if m:
            upper = factor_closed(inverse_inertia[:m, :m])
            closing, closed = -cho_solve(upper, inverse_inertia[:m, m:]), -cho_solve(upper, before[:m])
            w, u = w + inverse_inertia[m:, :m] @ closing, u + inverse_inertia[m:, :m] @ closed
        w = np.ascontiguousarray(0.5 * (w + w.T))
        largest = np.einsum("msk,msk->m", np.abs(rows.wrench[m:]), np.abs(twists[m:]))
        slow = _APART * largest.reshape(-1, 3).max(axis=1, initial=0.0)
        free = np.diagonal(inverse_inertia)[m:].reshape(-1, 3).max(axis=1, initial=0.0)
        movable = np.diagonal(w)[::3] > _LOCKED * free
        return cls(bodies, qd, rows, axes, before, w, u.copy(), slow, movable, closing, closed)

    def part(self, rows: Integers, take: Integers) -> "Struck":
        """Some of the points: inverse inertia and velocities only."""
        w, u = np.ascontiguousarray(self.w[np.ix_(rows, rows)]), self.u[rows]
        return replace(self, w=w, u=u, slow=self.slow[take])


def _axes(x: float, y: float, z: float) -> list[list[float]]:
    """Normal and two directions across it, (3, 3), one in the plane of two world axes that has the normal."""
    a, b, c = abs(x), abs(y), abs(z)
    # Part across the normal of the world axis that is most across it.
    if a <= b and a <= c:
        h = np.hypot(y, z)
        first = [h, -x * y / h, -x * z / h]
    elif b <= c:
        h = np.hypot(x, z)
        first = [-x * y / h, h, -y * z / h]
    else:
        h = np.hypot(x, y)
        first = [-x * z / h, -y * z / h, h]
    p, q, r = first
    return [[x, y, z], first, [y * r - z * q, z * p - x * r, x * q - y * p]]


def _rows(origin: Floats, points: Sequence[ContactPoint], axes: Floats) -> Rows:
    """Rows of the velocities of the second bodies relative to the first, along the points' axes."""
    k = len(points)
    bodies = np.array([point.bodies for point in points], dtype=np.int64).reshape(k, 2)
    at = np.array([point.point for point in points]).reshape(k, 1, 3)
    # (k, 3, 2, 3): forces of 1 along each axis on the second body, of -1 on the first.
    force = axes[:, :, None, :] * np.array([[-1.0], [1.0]])
    arm = (at - origin[bodies])[:, None]
    wrench = np.concatenate([np.cross(arm, force), force], axis=3)
    wrench[np.broadcast_to((bodies < 0)[:, None], (k, 3, 2))] = 0.0
    return Rows(np.repeat(bodies, 3, axis=0), wrench.reshape(3 * k, 2, 6))
