"""Rigid and flexible bodies in an impact: their velocities, and the changes of these by impulses."""

from dataclasses import dataclass

import numpy as np

from protochain.core.arrays import Floats, Value
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


@dataclass(frozen=True, eq=False)
class Bending(Value):
    """Bodies of which some bend, at one q: input of an impact in place of factors.

    An instantaneous impulse moves all shapes at once. Elastic forces are finite, so they have no impulse.

    Parameters
    ----------
    flexible, bent : Flexible, Bent
        Bodies, and the places of their nodes. The nodes are the bodies of points of contact
        (:meth:`Flexible.node`).
    """

    flexible: Flexible
    bent: Bent

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
        for i, (bodies, wrenches) in enumerate(zip(rows.body, rows.wrench, strict=True)):
            load = np.zeros((len(self.origin), 6))
            on = bodies >= 0
            np.add.at(load, bodies[on], wrenches[on])
            inverse[:, i] = row_speeds(self, rows, self.change(load))
        return inverse


Bodies = RigidBodies | Bending
"""Bodies at one pose. Those that bend count node by node."""


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
