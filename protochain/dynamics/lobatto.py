"""The generalised leapfrog in canonical coordinates: the Lobatto IIIA-B pair of order two.

Hairer, Lubich, Wanner, *Geometric Numerical Integration* (2006), VI.3, equation 3.4; free roots follow the
exponential map (Bou-Rabee, Marsden, Found. Comput. Math. 9:197, 2009), which keeps the momenta of an isolated
chain to rounding. Its halves are implicit in velocities and in positions only: fixed points of O(n) sweeps,
without the energy.

Its inner velocities solve M(q) v = p for a q and a p half a step apart. In long, open chains that puts them
far from any velocity of the motion: errors of the energy are large, and at some length no solution is found.
:mod:`protochain.dynamics.leapfrog` takes both half-way, and is what to use.
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


@dataclass(frozen=True)
class Lobatto:
    """Generalised leapfrog of order two; it does not keep constraints."""

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
        q, p, factors = _leap_by(system.tree, at, pushed, time_step)
        potential, torque = system.potential(q, factors)
        p = p + 0.5 * time_step * torque
        return Phase(q, solve(factors, p), p, potential, torque, factors)


def _leap_by(tree: Tree, at: Phase, pushed: Floats, time_step: float) -> tuple[Floats, Floats, Articulated]:
    """Coordinates, momenta before the potential's push, and factors of M after one time step."""
    n = tree.n_bodies
    q, qd, p = at.q.copy(), at.qd.copy(), np.empty(tree.n_v)
    rotation, origin, packed = np.empty((n, 3, 3)), np.empty((n, 3)), np.empty((n, 21))
    gain, pivot, root = np.empty((n, 6)), np.empty(n), np.empty_like(at.factors.root)
    old = at.factors
    failed = _leap(
        tree.links, tree.bodies, old.frames.rotation, old.frames.origin, old.gain, old.pivot, old.root,
        pushed, 0.5 * time_step, q, qd, p, rotation, origin, packed, gain, pivot, root,
    )  # fmt: skip
    if failed:
        # M was not singular where the step began: what is singular is what the iteration has run off to.
        raise StepTooLargeError(
            f"no velocities solve the equations of a time step of {1000 * abs(time_step):g} fs"
        )
    frames = Frames(frozen(rotation), frozen(origin))
    factors = Articulated(tree, frames, frozen(packed), frozen(gain), frozen(pivot), frozen(root))
    return q, p, factors


@kernel
def _leap(
    links: Integers, bodies: Floats, rotation: Floats, origin: Floats, gain: Floats, pivot: Floats,
    root: Floats, pushed: Floats, h: float, q: Floats, qd: Floats, p: Floats, new_rotation: Floats,
    new_origin: Floats, packed: Floats, new_gain: Floats, new_pivot: Floats, new_root: Floats,
) -> bool:  # fmt: skip
    """Half a step from q, known, and half a step to the new q, unknown; h is half the time step.

    Returns whether it failed.
    """
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
        return True
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
            return True
        outward_rates(links, bodies, new_rotation, new_origin, new_gain, new_root, carried, rates)
        change = _replace(qd, rates)
        if change < _SETTLED or (change < _NOISE and change >= 0.5 * before):
            found = True
            break
        before = change
    if not found:
        return True
    put_momenta(links, bodies, new_rotation, new_origin, qd, twists, carried, p, gradient)
    _carry_roots(links, h, qd, half)
    for k in range(n_v):
        p[k] = half[k] + h * gradient[k]
    return False


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
