"""The generalised leapfrog on the coordinates of a tree: reversible, symplectic, one energy a step.

Kinetic energies that depend on q do not separate, so the plain leapfrog (velocity Verlet) would be neither.
In canonical coordinates this is the Lobatto IIIA-B pair of order two (Hairer, Lubich, Wanner, *Geometric
Numerical Integration*, 2006, VI.3, equation 3.4); free roots follow the exponential map (Bou-Rabee, Marsden,
Found. Comput. Math. 9:197, 2009), which keeps the momenta of an isolated chain to rounding. Its two halves
are implicit in velocities and in positions only: fixed points of O(n) sweeps, without the energy.
"""

from dataclasses import dataclass

import numpy as np

from protochain.arrays import Floats, Integers, frozen
from protochain.dynamics.system import Phase, StepTooLargeError, System
from protochain.multibody import Frames
from protochain.multibody.algebra import kernel, put_at, scale, vector_at
from protochain.multibody.articulated import (
    Articulated,
    factorise,
    inward_loads,
    outward_rates,
    put_rigid,
    refuse_singular,
    solve,
)  # fmt: skip
from protochain.multibody.hamilton import put_momenta
from protochain.multibody.kinematics import move_along, outward_frames
from protochain.multibody.rotations import tangent, turn_by
from protochain.multibody.tree import Tree, V

_ITERATIONS = 60
_SETTLED = 1e-12
"""Change of a velocity, relative to the largest, at which a fixed point is found."""
_NOISE = 1e-10
"""Below this a change that no longer shrinks is rounding."""
_NO_FIXED_POINT = -2
"""Returned by kernels; -1 is success, and a body's index a singular matrix."""


@dataclass(frozen=True)
class Leapfrog:
    """Generalised leapfrog of order two."""

    def init(self, system: System, q: Floats, qd: Floats) -> Phase:
        """Return the phase at q, moving with qd."""
        return system.at(q, qd)

    def step(self, system: System, at: Phase, time_step: float) -> Phase:
        """One step, with one evaluation of the potential.

        Raises
        ------
        StepTooLargeError
            If the velocities of the step cannot be found.
        """
        pushed = at.p + 0.5 * time_step * at.torque
        if system.closure is None:
            q, p, factors = leap(system.tree, at, pushed, time_step)
        else:
            q, p, factors = system.closure.leap(at, pushed, time_step)
        potential, torque = system.potential(q, factors)
        p = p + 0.5 * time_step * torque
        there = Phase(q, solve(factors, p), p, potential, torque, factors)
        return there if system.closure is None else system.moving(there, there.qd)


def leap(tree: Tree, at: Phase, pushed: Floats, time_step: float) -> tuple[Floats, Floats, Articulated]:
    """Move for one time step without further torques.

    Parameters
    ----------
    tree : Tree
    at : Phase
        Where the step begins.
    pushed : (n_v,) float
        Momenta after the potential's push there.
    time_step : float, ps

    Returns
    -------
    (n_q,) float, (n_v,) float, Articulated
        Coordinates, momenta before the push there, and the factors of M there.

    Raises
    ------
    StepTooLargeError
        If one of the two fixed points is not found.
    MechanicsError
        If M is singular on the way.
    """
    n = tree.n_bodies
    q, qd, p = at.q.copy(), at.qd.copy(), np.empty(tree.n_v)
    rotation, origin, packed = np.empty((n, 3, 3)), np.empty((n, 3)), np.empty((n, 21))
    gain, pivot, root = np.empty((n, 6)), np.empty(n), np.empty_like(at.factors.root)
    old = at.factors
    failed = _leap(
        tree.links, tree.bodies, old.frames.rotation, old.frames.origin, old.gain, old.pivot, old.root,
        pushed, 0.5 * time_step, q, qd, p, rotation, origin, packed, gain, pivot, root,
    )  # fmt: skip
    if failed == _NO_FIXED_POINT:
        raise StepTooLargeError(
            f"no velocities solve the equations of a time step of {1000 * abs(time_step):g} fs"
        )
    refuse_singular(failed)
    frames = Frames(frozen(rotation), frozen(origin))
    factors = Articulated(tree, frames, frozen(packed), frozen(gain), frozen(pivot), frozen(root))
    return q, p, factors


@kernel
def _leap(
    links: Integers, bodies: Floats, rotation: Floats, origin: Floats, gain: Floats, pivot: Floats,
    root: Floats, pushed: Floats, h: float, q: Floats, qd: Floats, p: Floats, new_rotation: Floats,
    new_origin: Floats, packed: Floats, new_gain: Floats, new_pivot: Floats, new_root: Floats,
) -> int:  # fmt: skip
    """Half a step from q, known, and half a step to the new q, unknown; h is half the time step."""
    n, n_v = len(bodies), len(qd)
    twists, carried = np.empty((n, 6)), np.empty((n, 6))
    gradient, half, rates = np.empty(n_v), np.empty(n_v), np.empty(n_v)
    before, found = np.inf, False
    for _ in range(_ITERATIONS):
        put_momenta(links, bodies, rotation, origin, qd, twists, carried, p, gradient)
        for k in range(n_v):
            half[k] = pushed[k] + h * gradient[k]
            rates[k] = half[k]
        _turn_roots(links, h, qd, rates)
        _solve(links, bodies, rotation, origin, gain, pivot, root, carried, rates)
        change = _replace(qd, rates)
        if change < _SETTLED or (change < _NOISE and change >= 0.5 * before):
            found = True
            break
        before = change
    if not found:
        return _NO_FIXED_POINT
    _carry_roots(links, h, qd, half)

    for k in range(n_v):
        rates[k] = h * qd[k]
    move_along(links, rates, q)
    middle = q.copy()
    before, found = np.inf, False
    for _ in range(_ITERATIONS):
        q[:] = middle
        for k in range(n_v):
            rates[k] = h * qd[k]
        move_along(links, rates, q)
        outward_frames(links, bodies, q, new_rotation, new_origin)
        put_rigid(new_rotation, bodies, packed)
        for k in range(n_v):
            rates[k] = half[k]
        _turn_roots(links, h, qd, rates)
        carried[:] = 0.0
        failed = factorise(
            links, bodies, new_rotation, new_origin, packed, new_gain, new_pivot, new_root, carried, rates
        )
        if failed >= 0:
            return failed
        outward_rates(links, bodies, new_rotation, new_origin, new_gain, new_root, carried, rates)
        change = _replace(qd, rates)
        if change < _SETTLED or (change < _NOISE and change >= 0.5 * before):
            found = True
            break
        before = change
    if not found:
        return _NO_FIXED_POINT
    put_momenta(links, bodies, new_rotation, new_origin, qd, twists, carried, p, gradient)
    _carry_roots(links, h, qd, half)
    for k in range(n_v):
        p[k] = half[k] + h * gradient[k]
    return -1


@kernel
def _solve(
    links: Integers, bodies: Floats, rotation: Floats, origin: Floats, gain: Floats, pivot: Floats,
    root: Floats, room: Floats, x: Floats,
) -> None:  # fmt: skip
    """Overwrite x by M^-1 x."""
    room[:] = 0.0
    inward_loads(links, bodies, rotation, origin, gain, pivot, room, x)
    outward_rates(links, bodies, rotation, origin, gain, root, room, x)


@kernel
def _replace(old: Floats, new: Floats) -> float:
    """Copy new into old; return the largest change relative to the largest value, NaN if there is one."""
    change, size = 0.0, 0.0
    for k in range(len(old)):
        # Sums, not comparisons, so that what is not a number shows.
        change = max(change, abs(new[k] - old[k])) + 0.0 * new[k]
        size = max(size, abs(new[k]))
        old[k] = new[k]
    return change / size if size > 0.0 else 0.0


@kernel
def _turn_roots(links: Integers, h: float, qd: Floats, p: Floats) -> None:
    """Angular momentum of free roots at either end of half a step -> M's, dexp of the turn."""
    for b in range(len(links) - 1):
        k = links[b, V]
        if links[b + 1, V] - k == 6:
            put_at(tangent(scale(h, vector_at(qd, k)), vector_at(p, k)), p, k)


@kernel
def _carry_roots(links: Integers, h: float, qd: Floats, p: Floats) -> None:
    """Carry the angular momentum of free roots along the turn of half a step."""
    for b in range(len(links) - 1):
        k = links[b, V]
        if links[b + 1, V] - k == 6:
            put_at(turn_by(scale(h, vector_at(qd, k)), vector_at(p, k)), p, k)
