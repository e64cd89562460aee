"""The leapfrog of a tree: push, free flight, push; reversible, symplectic, one energy a step.

Kinetic energies that depend on q do not separate, so the plain leapfrog (velocity Verlet) would be neither.
Here the flight without potential is one step of the midpoint rule: its discrete Lagrangian is h L(exp(xi/2)
q, xi/h), with xi the displacement of the step and L the kinetic energy (Marsden, West, Acta Numerica 10:357,
2001, sections 1.3 and 2.6). Free roots follow the exponential map, so the momenta of an isolated chain are
kept to rounding. The step is implicit in velocities only, for which Newton's method solves in O(n), without
the energy.
"""

from dataclasses import dataclass, field
from typing import NamedTuple, Self

import numpy as np

from protochain.arrays import Floats, Integers, frozen
from protochain.dynamics.correction import correct
from protochain.dynamics.system import Flight, Flown, Integrator, Phase, StepTooLargeError, System
from protochain.multibody import Frames
from protochain.multibody.algebra import add, cross, kernel, put_at, scale, subtract, vector_at
from protochain.multibody.articulated import Articulated, factorise, put_rigid, solve
from protochain.multibody.hamilton import put_momenta
from protochain.multibody.kinematics import move_along, outward_frames
from protochain.multibody.rotations import tangent, tangent_inverse
from protochain.multibody.tree import Tree, V

_ITERATIONS = 40
_SETTLED = 1e-13
"""Error of a velocity, relative to the largest, at which a solution is found."""
_NOISE = 1e-9
"""Below this a change that no longer shrinks is rounding."""


@dataclass(frozen=True)
class Leapfrog(Integrator):
    """Push, flight, push: of order two, with one evaluation of the potential.

    Parameters
    ----------
    flight : callable
        By the midpoint rule, unless another is given.
    """

    flight: Flight = field(default_factory=lambda: fly)

    def step(self, system: System, at: Phase, time_step: float) -> Phase:
        """One step.

        Raises
        ------
        StepTooLargeError
            If the velocities of the flight cannot be found.
        """
        pushed = at.p + 0.5 * time_step * at.torque
        if system.closure is None:
            return system.arrived(*self.flight(at, pushed, time_step), time_step)
        there = system.arrived(*system.closure.fly(self.flight, at, pushed, time_step), time_step)
        return system.moving(there, there.qd)


def fly(at: Phase, p: Floats, time_step: float) -> Flown:
    """Move for one time step without a potential, by the midpoint rule.

    Parameters
    ----------
    at : Phase
        Where it begins.
    p : (n_v,) float
        Momenta it begins with.
    time_step : float, ps

    Returns
    -------
    (n_q,) float, (n_v,) float, Articulated
        Coordinates, momenta, and the factors of M after it.

    Raises
    ------
    StepTooLargeError
        If the velocities are not found.
    """
    tree, there = at.factors.tree, Landing.on(at)
    q, p = at.q.copy(), p.copy()
    try:
        failed = _fly(tree.links, tree.bodies, time_step, q, solve(at.factors, p), p, *there)
    except np.linalg.LinAlgError:
        failed = True
    return q, p, there.factors(tree, failed, time_step)


class Landing(NamedTuple):
    """Room for frames and factors where a flight ends: as :class:`Articulated` has them."""

    rotation: Floats
    origin: Floats
    inertia: Floats
    gain: Floats
    pivot: Floats
    root: Floats

    @classmethod
    def on(cls, at: Phase) -> Self:
        """Make room for a flight that begins there."""
        n = at.factors.tree.n_bodies
        roots = np.empty_like(at.factors.root)
        return cls(
            np.empty((n, 3, 3)), np.empty((n, 3)), np.empty((n, 21)), np.zeros((n, 6)), np.empty(n), roots
        )

    def factors(self, tree: Tree, failed: bool, time_step: float) -> Articulated:
        """Return what was written, unless the flight failed.

        Raises
        ------
        StepTooLargeError
            If it did. M was not singular where it began: what is singular is what an iteration ran off to.
        """
        if failed:
            raise StepTooLargeError(
                f"no velocities solve the equations of a time step of {1000 * abs(time_step):g} fs"
            )
        rotation, origin, *rest = (frozen(array) for array in self)
        return Articulated(tree, Frames(rotation, origin), *rest)


@kernel
def _fly(
    links: Integers, bodies: Floats, time_step: float, q: Floats, qd: Floats, p: Floats, rotation: Floats,
    origin: Floats, packed: Floats, gain: Floats, pivot: Floats, root: Floats,
) -> bool:  # fmt: skip
    """Overwrite q and p; write frames and factors at the new q; return whether no velocities were found."""
    n, n_v = len(bodies), len(qd)
    twists, carried = np.empty((n, 6)), np.empty((n, 6))
    mu, gradient, lack, middle = np.empty(n_v), np.empty(n_v), np.empty(n_v), np.empty(len(q))
    before, found = np.inf, False
    for _ in range(_ITERATIONS):
        middle[:] = q
        for k in range(n_v):
            lack[k] = 0.5 * time_step * qd[k]
        move_along(links, lack, middle)
        outward_frames(links, bodies, middle, rotation, origin)
        put_momenta(links, bodies, rotation, origin, qd, twists, carried, mu, gradient)
        put_end(links, time_step, qd, mu, gradient, lack)
        for k in range(n_v):
            lack[k] = p[k] - lack[k]
        correct(links, bodies, rotation, origin, twists, carried, 0.5 * time_step, lack)
        change = _add_on(lack, qd)
        # What the next change would be, if they go on to shrink as they do.
        left = change * change / before if change < before < np.inf else change
        if left < _SETTLED or (change < _NOISE and change >= 0.5 * before):
            found = True
            break
        if not change < np.inf:
            break
        before = change
    if not found:
        return True
    _push_by_inertia(links, time_step, qd, gradient, p)
    for k in range(n_v):
        lack[k] = time_step * qd[k]
    move_along(links, lack, q)
    outward_frames(links, bodies, q, rotation, origin)
    put_rigid(rotation, bodies, packed)
    carried[:] = 0.0
    return factorise(links, bodies, rotation, origin, packed, gain, pivot, root, carried, lack) >= 0


@kernel
def put_end(links: Integers, h: float, qd: Floats, mu: Floats, push: Floats, p: Floats) -> None:
    """Write the momenta at the start of a step h whose velocities, half-way, have momenta mu under a push.

    With a negative h, those at its end.
    """
    for k in range(len(p)):
        p[k] = mu[k] - 0.5 * h * push[k]
    for b in range(len(links) - 1):
        k = links[b, V]
        if links[b + 1, V] - k == 6:
            xi = scale(h, vector_at(qd, k))
            pushed = tangent(scale(0.5, xi), scale(0.5 * h, vector_at(push, k)))
            put_at(tangent_inverse(xi, subtract(vector_at(mu, k), pushed)), p, k)


@kernel
def _push_by_inertia(links: Integers, h: float, qd: Floats, gradient: Floats, p: Floats) -> None:
    """Overwrite momenta by those after a flight of time h.

    A free root's are those of all that hangs on it: what they are about the world's origin does not change.
    """
    for b in range(len(links) - 1):
        k = links[b, V]
        n_v = links[b + 1, V] - k
        if n_v == 1:
            p[k] += h * gradient[k]
        elif n_v == 6:
            moved = scale(h, vector_at(qd, k + 3))
            put_at(add(vector_at(p, k), cross(vector_at(p, k + 3), moved)), p, k)


@kernel
def _add_on(step: Floats, x: Floats) -> float:
    """Add a step; return its largest entry relative to that of x, NaN if there is one."""
    change, size = 0.0, 0.0
    for k in range(len(x)):
        x[k] += step[k]
        # Sums, not comparisons, so that what is not a number shows.
        change = max(change, abs(step[k])) + 0.0 * step[k]
        size = max(size, abs(x[k]))
    return change / size if size > 0.0 else 0.0
