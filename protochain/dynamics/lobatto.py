"""The generalised leapfrog in canonical coordinates: the Lobatto IIIA-B pair of order two.

Hairer, Lubich, Wanner, *Geometric Numerical Integration* (2006), VI.3, equation 3.4; free roots follow the
exponential map (Bou-Rabee, Marsden, Found. Comput. Math. 9:197, 2009), which keeps the momenta of an isolated
chain to rounding. Its halves are implicit in velocities and in positions only: fixed points of O(n) sweeps,
without the energy.

Its inner velocities solve M(q) v = p for a q and a p half a step apart. In long, open chains that puts them
far from any velocity of the motion: errors of the energy are large, and at some length no solution is found.
:mod:`protochain.dynamics.leapfrog` takes both half-way, and is what to use.
"""

import numpy as np

from protochain.arrays import Floats, Integers
from protochain.dynamics.leapfrog import Landing
from protochain.dynamics.system import Flown, Phase
from protochain.multibody.algebra import kernel, put_at, scale, vector_at
from protochain.multibody.articulated import factorise, inward_loads, outward_rates, put_rigid
from protochain.multibody.hamilton import put_momenta
from protochain.multibody.kinematics import move_along, outward_frames
from protochain.multibody.rotations import tangent, turn_by
from protochain.multibody.tree import V

_ITERATIONS = 60
_SETTLED = 1e-12
"""Change of a velocity, relative to the largest, at which a fixed point is found."""
_NOISE = 1e-10
"""Below this a change that no longer shrinks is rounding."""


def fly(at: Phase, p: Floats, time_step: float) -> Flown:
    """Move for one time step without a potential: as :func:`protochain.dynamics.leapfrog.fly`."""
    tree, there = at.factors.tree, Landing.on(at)
    q, qd, end, old = at.q.copy(), at.qd.copy(), np.empty_like(p), at.factors
    failed = _leap(
        tree.links, tree.bodies, old.frames.rotation, old.frames.origin, old.gain, old.pivot, old.root,
        p, 0.5 * time_step, q, qd, end, *there,
    )  # fmt: skip
    return q, end, there.factors(tree, failed, time_step)


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
        found = change < _SETTLED or (change < _NOISE and change >= 0.5 * before)
        if found:
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
        found = change < _SETTLED or (change < _NOISE and change >= 0.5 * before)
        if found:
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
