"""Rigid and flexible bodies in an impact: velocities, and their changes by impulses, also by given ones."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from protochain.core.arrays import Floats, Value, floats
from protochain.core.checks import brief
from protochain.core.errors import Fault, MechanicsError
from protochain.core.settings import document_fields
from protochain.mechanics.multibody.articulated import Articulated, solve
from protochain.mechanics.multibody.kinematics import velocities
from protochain.mechanics.multibody.operational import Rows, operational_inverse
from protochain.mechanisms.flexible import dynamics as flexible_dynamics
from protochain.mechanisms.flexible.flexible import Bent, Flexible, bend


@dataclass(frozen=True, eq=False)
class RigidBodies:
    """Rigid bodies, by factors of M."""

    factors: Articulated

    @property
    def n_v(self) -> int:
        """Number of freedoms."""
        return self.factors.tree.n_v

    @property
    def origin(self) -> Floats:
        """(nb, 3) float: origins of the bodies."""
        return self.factors.frames.origin

    def twists(self, qd: Floats) -> Floats:
        """(nb, 6) float: twists of the bodies."""
        return velocities(self.factors.tree, self.factors.frames, qd)

    def change(self, wrench: Floats) -> Floats:
        """(n_v,) float: M^-1 J^T wrench."""
        return solve(self.factors, np.zeros(self.n_v), -wrench)

    def inverse(self, rows: Rows) -> Floats:
        """(m, m) float: inverse inertia G M^-1 G^T of rows G, O(n + m^2)."""
        return operational_inverse(self.factors.tree, self.factors.frames, rows, self.factors)


@document_fields
@dataclass(frozen=True, eq=False)
class Bending(Value):
    """Bodies of which some bend, at one q: input of an impact in place of factors.

    An instantaneous impulse moves all shapes at once. Elastic forces are finite, so they have no impulse.
    """

    flexible: Flexible  # Bodies. Their nodes are the bodies of points of contact (:meth:`Flexible.node`).
    bent: Bent  # Places of the nodes.

    @classmethod
    def at(cls, flexible: Flexible, q: Floats) -> "Bending":
        """Of bodies at their coordinates (n_q,)."""
        return cls(flexible, bend(flexible, q))

    @property
    def n_v(self) -> int:
        """Number of freedoms."""
        return self.flexible.n_v

    @property
    def origin(self) -> Floats:
        """(nn, 3) float: origins of the nodes."""
        return self.bent.origin

    def twists(self, qd: Floats) -> Floats:
        """(nn, 6) float: twists of the nodes."""
        return flexible_dynamics.velocities(self.flexible, self.bent, qd)

    def change(self, wrench: Floats) -> Floats:
        """(n_v,) float: M^-1 J^T wrench."""
        pulled = flexible_dynamics.pull_back(self.flexible, self.bent, wrench)
        return flexible_dynamics.solve(self.flexible, self.bent, pulled)

    def inverse(self, rows: Rows) -> Floats:
        """(m, m) float: inverse inertia G M^-1 G^T of rows G, O(n m)."""
        inverse = np.empty((len(rows.body), len(rows.body)))
        for i, unit in enumerate(np.eye(len(inverse))):
            inverse[:, i] = row_speeds(self, rows, self.change(loads_of(self, rows, unit)))
        return inverse


Bodies = RigidBodies | Bending
"""Bodies at one pose. Those that bend count node by node."""
External = Mapping[int, tuple[ArrayLike, ArrayLike]]
"""Given impulses, as of a hammer. Body -> world point (3,) and impulse on the body there (3,), world axes."""


def bodies_of(factors: Articulated | Bending) -> Bodies:
    """Bodies of the first argument of an impact."""
    return factors if isinstance(factors, Bending) else RigidBodies(factors)


def twists_of(bodies: Bodies, rows: Rows, qd: Floats) -> Floats:
    """(m, 2, 6) float: twists of the two bodies of each row, zero for the world."""
    # Index -1 finds the last, of the world.
    twists = np.vstack([bodies.twists(qd), np.zeros(6)])
    return np.asarray(twists[rows.body])


def row_speeds(bodies: Bodies, rows: Rows, qd: Floats) -> Floats:
    """(m,) float: velocities along the rows."""
    return np.asarray(np.einsum("msk,msk->m", rows.wrench, twists_of(bodies, rows, qd)))


def loads_of(bodies: Bodies, rows: Rows, impulses: Floats) -> Floats:
    """(nb, 6) float: impulses (m,) along rows as wrenches on the bodies."""
    loads = np.zeros((len(bodies.origin), 6))
    for side in (0, 1):
        on = rows.body[:, side] >= 0
        np.add.at(loads, rows.body[on, side], impulses[on, None] * rows.wrench[on, side])
    return loads


def strike(bodies: Bodies, qd: Floats, external: External) -> tuple[Floats, float]:
    """Velocities (n_v,) after given impulses, from velocities qd (n_v,), and the work of the impulses."""
    wrench = np.zeros((len(bodies.origin), 6))
    for body, (point, impulse) in check_external(external, len(wrench)).items():
        wrench[body] = *np.cross(point - bodies.origin[body], impulse), *impulse
    after = qd + bodies.change(wrench)
    return after, 0.5 * float(np.sum(wrench * bodies.twists(qd + after)))


def check_external(external: External, n: int) -> dict[int, tuple[Floats, Floats]]:
    """Body -> world point and impulse, of n bodies. Raise MechanicsError for invalid ones."""
    if not isinstance(external, Mapping):
        raise MechanicsError(f"external {brief(external)}: give {{body: (point, impulse)}}")
    impulses = {}
    for body, blow in external.items():
        if isinstance(body, bool) or not isinstance(body, int | np.integer) or not 0 <= body < n:
            raise MechanicsError(f"external: there is no body {brief(body)}; give a number from 0 to {n - 1}")
        label = f"external, body {body}"
        if not (isinstance(blow, tuple | list | np.ndarray) and len(blow) == 2):
            raise MechanicsError(f"{label}: give a pair, (point, impulse)")
        pair = floats(blow[0], (3,), f"{label}: point"), floats(blow[1], (3,), f"{label}: impulse")
        for quantity, values in zip(("point", "impulse"), pair, strict=True):
            if not np.isfinite(values).all():
                raise MechanicsError(f"{label}: its {quantity} is not finite", fault=Fault.NOT_FINITE)
        impulses[int(body)] = pair
    return impulses
