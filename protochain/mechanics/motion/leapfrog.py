"""Kick-drift-kick leapfrog of a tree: reversible, symplectic, one energy evaluation a step.

The kinetic energy depends on q, so the Hamiltonian is not separable and plain leapfrog (velocity Verlet)
would be neither. Here the drift is one step of the midpoint rule without potential: its discrete Lagrangian
is h L(exp(xi/2) q, xi/h), with xi the displacement of the step and L the kinetic energy (Marsden, West, Acta
Numerica 10:357, 2001, sections 1.3 and 2.6). Free roots follow the exponential map, so an isolated chain
conserves momentum to rounding. The step is implicit in the velocities only, which Newton's method finds in
O(n), without the energy.
"""

from dataclasses import dataclass, field, replace
from typing import ClassVar, NamedTuple, Self

import numpy as np

from protochain.core.arrays import Floats, Integers, freeze
from protochain.core.errors import MechanicsError
from protochain.core.settings import document_fields
from protochain.mechanics.motion.correction import correct
from protochain.mechanics.motion.system import (
    Drift,
    Drifted,
    Equations,
    Integrator,
    Phase,
    StepTooLargeError,
    System,
    canonical,
    refuse_departure,
)
from protochain.mechanics.multibody import Frames
from protochain.mechanics.multibody.algebra import add, cross, kernel, put_at, scale, subtract, vector_at
from protochain.mechanics.multibody.articulated import Articulated, factorise, put_rigid, solve
from protochain.mechanics.multibody.hamilton import put_momenta
from protochain.mechanics.multibody.kinematics import move_along, outward_frames
from protochain.mechanics.multibody.rotations import tangent, tangent_inverse
from protochain.mechanics.multibody.tree import Tree, V

_ITERATIONS = 40
_SETTLED = 1e-13
"""Tolerance of Newton's method: error of a velocity relative to the largest."""
_NOISE = 1e-9
"""Below this a change that no longer decreases is rounding error."""


@document_fields
@dataclass(frozen=True)
class Leapfrog(Integrator):
    """Kick-drift-kick leapfrog: order two, one evaluation of the potential a step."""

    reversible: ClassVar[bool] = True
    # Motion without potential, by default one step of the midpoint rule.
    drift: Drift = field(default_factory=lambda: drift)

    def step(self, system: Equations, at: Phase, time_step: float) -> Phase:
        """Kick for half a step, drift for a step, kick for half a step.

        Raises
        ------
        StepTooLargeError
            If Newton's method for the velocities of the drift does not converge.
        MechanicsError
            If a load depends on velocities, or hinges are driven.
        """
        system = canonical(system, "leapfrog")
        if system.depends_on_velocity:
            raise MechanicsError(
                "the leapfrog requires loads without velocities; use the midpoint rule or Rosenbrock"
            )
        kicked = system.kick(at, *self._drift_by_factors(system, at, time_step), time_step)
        if system.constraint is None:
            return kicked
        workspace = system.with_velocities(kicked, kicked.qd)
        # The power at the end is that of velocities on the constraint.
        work = kicked.work + 0.5 * time_step * (workspace.power - kicked.power)
        return workspace if kicked.loads is None else replace(workspace, work=work)

    def check_return(self, system: Equations, before: Phase, after: Phase, time_step: float) -> None:
        """Check without an energy that a step backwards ends at the start of the step, by its drift."""
        system = canonical(system, "leapfrog")
        refuse_departure(system, self._drift_by_factors(system, after, -time_step)[0], before.q)

    def _drift_by_factors(self, system: System, at: Phase, time_step: float) -> Drifted:
        """Kick for half a step and drift for a step."""
        kicked = at.p + 0.5 * time_step * at.torque
        if system.constraint is None:
            return self.drift(at, kicked, time_step)
        return system.constraint.drift(self.drift, at, kicked, time_step)


def drift(at: Phase, p: Floats, time_step: float) -> Drifted:
    """Move for one time step without a potential, by the midpoint rule."""
    # p (n_v,) -> (n_q,): Coordinates, momenta and factors of M at the end.
    tree, workspace = at.factors.tree, Workspace.like(at)
    q, p = at.q.copy(), p.copy()
    try:
        failed = _drift(tree.links, tree.bodies, time_step, q, solve(at.factors, p), p, *workspace)
    except np.linalg.LinAlgError:
        failed = True
    return q, p, workspace.factors(tree, failed)


class Workspace(NamedTuple):
    """Arrays for the frames and factors at the end of a drift, as in :class:`Articulated`."""

    rotation: Floats
    origin: Floats
    inertia: Floats
    gain: Floats
    pivot: Floats
    root: Floats

    @classmethod
    def like(cls, at: Phase) -> Self:
        """Allocate arrays for a drift that starts there."""
        n = at.factors.tree.n_bodies
        roots = np.empty_like(at.factors.root)
        return cls(
            np.empty((n, 3, 3)), np.empty((n, 3)), np.empty((n, 21)), np.zeros((n, 6)), np.empty(n), roots
        )

    def factors(self, tree: Tree, failed: bool) -> Articulated:
        """Return the frames and factors of a drift that has succeeded."""
        if failed:
            raise StepTooLargeError("no velocities solve the equations of the time step")
        rotation, origin, *arrays = (freeze(array) for array in self)
        return Articulated(tree, Frames(rotation, origin), *arrays)


@kernel
def _drift(
    links: Integers, bodies: Floats, time_step: float, q: Floats, qd: Floats, p: Floats, rotation: Floats,
    origin: Floats, packed: Floats, gain: Floats, pivot: Floats, root: Floats,
) -> bool:  # fmt: skip
    """Overwrite q and p. Write frames and factors at the new q. Return whether Newton's method failed."""
    n, n_v = len(bodies), len(qd)
    twists, carried = np.empty((n, 6)), np.empty((n, 6))
    mu, gradient, lack, middle = np.empty(n_v), np.empty(n_v), np.empty(n_v), np.empty(len(q))
    before = np.inf
    for _ in range(_ITERATIONS):
        middle[:] = q
        for k in range(n_v):
            lack[k] = 0.5 * time_step * qd[k]
        move_along(links, lack, middle)
        outward_frames(links, bodies, middle, rotation, origin)
        put_momenta(links, bodies, rotation, origin, qd, twists, carried, mu, gradient)
        put_end_momenta(links, time_step, qd, mu, gradient, lack)
        for k in range(n_v):
            lack[k] = p[k] - lack[k]
        correct(links, bodies, rotation, origin, twists, carried, 0.5 * time_step, lack)
        change = _add_step(lack, qd)
        # Estimate of the next change, if convergence continues at this rate.
        left = change * change / before if change < before < np.inf else change
        if left < _SETTLED or (change < _NOISE and change >= 0.5 * before):
            break
        if not change < np.inf:
            return True
        before = change
    else:
        return True
    _advance_momenta(links, time_step, qd, gradient, p)
    for k in range(n_v):
        lack[k] = time_step * qd[k]
    move_along(links, lack, q)
    outward_frames(links, bodies, q, rotation, origin)
    put_rigid(rotation, bodies, packed)
    carried[:] = 0.0
    return factorise(links, bodies, rotation, origin, packed, gain, pivot, root, carried, lack) >= 0


@kernel
def put_end_momenta(links: Integers, h: float, qd: Floats, mu: Floats, force: Floats, p: Floats) -> None:
    """Write the momenta at the start of a step h, from the momenta mu and the force at its midpoint."""
    # With a negative h, those at its end.
    for k in range(len(p)):
        p[k] = mu[k] - 0.5 * h * force[k]
    for b in range(len(links) - 1):
        k = links[b, V]
        if links[b + 1, V] - k == 6:
            xi = scale(h, vector_at(qd, k))
            change = tangent(scale(0.5, xi), scale(0.5 * h, vector_at(force, k)))
            put_at(tangent_inverse(xi, subtract(vector_at(mu, k), change)), p, k)


@kernel
def _advance_momenta(links: Integers, h: float, qd: Floats, gradient: Floats, p: Floats) -> None:
    """Overwrite momenta by those after a drift of time h."""
    # A free root's momenta are those of its whole tree, which about the world's origin do not change.
    for b in range(len(links) - 1):
        k = links[b, V]
        n_v = links[b + 1, V] - k
        if n_v == 1:
            p[k] += h * gradient[k]
        elif n_v == 6:
            moved = scale(h, vector_at(qd, k + 3))
            put_at(add(vector_at(p, k), cross(vector_at(p, k + 3), moved)), p, k)


@kernel
def _add_step(step: Floats, x: Floats) -> float:
    """Add a step to x. Return its largest entry relative to the largest of x, NaN if any entry is NaN."""
    change, size = 0.0, 0.0
    for k in range(len(x)):
        x[k] += step[k]
        # A sum, not a comparison, so that NaN propagates.
        change = max(change, abs(step[k])) + 0.0 * step[k]
        size = max(size, abs(x[k]))
    return change / size if size > 0.0 else 0.0
