"""Generalised leapfrog in canonical coordinates: the Lobatto IIIA-B pair of order two.

Hairer, Lubich, Wanner, *Geometric Numerical Integration* (2006). Free roots follow the
exponential map (Bou-Rabee, Marsden, Found. Comput. Math. 9:197, 2009), which conserves the momentum of an
isolated chain to rounding. One half step is implicit in the velocities, the other in the positions: both are
solved by fixed-point iteration of O(n) sweeps, without the energy.

The stage velocities solve M(q) v = p with q and p half a step apart. In long, open chains they are far from
any velocity of the motion: energy errors are large, and beyond some length the iteration diverges.
:mod:`protochain.mechanics.motion.leapfrog` evaluates both at the midpoint and is the default.
"""

import numpy as np

from protochain.core.arrays import Floats, Integers
from protochain.mechanics.motion.leapfrog import Workspace
from protochain.mechanics.motion.system import Drifted, Phase
from protochain.mechanics.multibody.algebra import kernel, put_at, scale, vector_at
from protochain.mechanics.multibody.articulated import factorise, inward_loads, outward_rates, put_rigid
from protochain.mechanics.multibody.hamilton import put_momenta
from protochain.mechanics.multibody.kinematics import move_along, outward_frames
from protochain.mechanics.multibody.rotations import tangent, turn_by
from protochain.mechanics.multibody.tree import V

_ITERATIONS = 60
_SETTLED = 1e-12
"""Tolerance of the fixed-point iterations: change of a velocity relative to the largest."""
_NOISE = 1e-10
"""Below this a change that no longer decreases is rounding error."""


def drift(at: Phase, p: Floats, time_step: float) -> Drifted:
    """Drift by the Lobatto pair. Parameters as for :func:`protochain.mechanics.motion.leapfrog.drift`."""
    tree, workspace = at.factors.tree, Workspace.like(at)
    q, qd, end, old = at.q.copy(), at.qd.copy(), np.empty_like(p), at.factors
    failed = _drift(
        tree.links, tree.bodies, old.frames.rotation, old.frames.origin, old.gain, old.pivot, old.root,
        p, 0.5 * time_step, q, qd, end, *workspace,
    )  # fmt: skip
    return q, end, workspace.factors(tree, failed)


@kernel
def _drift(
    links: Integers, bodies: Floats, rotation: Floats, origin: Floats, gain: Floats, pivot: Floats,
    root: Floats, kicked: Floats, h: float, q: Floats, qd: Floats, p: Floats, new_rotation: Floats,
    new_origin: Floats, packed: Floats, new_gain: Floats, new_pivot: Floats, new_root: Floats,
) -> bool:  # fmt: skip
    """Half a step explicit in q and half a step implicit in q, of h each. Return whether it failed."""
    n, n_v = len(bodies), len(qd)
    twists, carried = np.empty((n, 6)), np.empty((n, 6))
    gradient, half, rates = np.empty(n_v), np.empty(n_v), np.empty(n_v)
    before = np.inf
    for _ in range(_ITERATIONS):
        put_momenta(links, bodies, rotation, origin, qd, twists, carried, p, gradient)
        for k in range(n_v):
            half[k] = kicked[k] + h * gradient[k]
            rates[k] = half[k]
        _rotate_roots(links, h, qd, rates, True)
        _solve(links, bodies, rotation, origin, gain, pivot, root, carried, rates)
        change = _replace(qd, rates)
        if change < _SETTLED or (change < _NOISE and change >= 0.5 * before):
            break
        before = change
    else:
        return True
    _rotate_roots(links, h, qd, half, False)

    for k in range(n_v):
        rates[k] = h * qd[k]
    move_along(links, rates, q)
    middle = q.copy()
    before = np.inf
    for _ in range(_ITERATIONS):
        q[:] = middle
        for k in range(n_v):
            rates[k] = h * qd[k]
        move_along(links, rates, q)
        outward_frames(links, bodies, q, new_rotation, new_origin)
        put_rigid(new_rotation, bodies, packed)
        for k in range(n_v):
            rates[k] = half[k]
        _rotate_roots(links, h, qd, rates, True)
        carried[:] = 0.0
        failed = factorise(
            links, bodies, new_rotation, new_origin, packed, new_gain, new_pivot, new_root, carried, rates
        )
        if failed >= 0:
            return True
        outward_rates(links, bodies, new_rotation, new_origin, new_gain, new_root, carried, rates)
        change = _replace(qd, rates)
        if change < _SETTLED or (change < _NOISE and change >= 0.5 * before):
            break
        before = change
    else:
        return True
    put_momenta(links, bodies, new_rotation, new_origin, qd, twists, carried, p, gradient)
    _rotate_roots(links, h, qd, half, False)
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
    """Copy new into old. Return the largest change relative to the largest value, NaN if any is NaN."""
    change, size = 0.0, 0.0
    for k in range(len(old)):
        # A sum, not a comparison, so that NaN propagates.
        change = max(change, abs(new[k] - old[k])) + 0.0 * new[k]
        size = max(size, abs(new[k]))
        old[k] = new[k]
    return change / size if size > 0.0 else 0.0


@kernel
def _rotate_roots(links: Integers, h: float, qd: Floats, p: Floats, by_tangent: bool) -> None:
    """Apply the rotation over half a step, or its dexp, to the angular momenta of free roots."""
    for b in range(len(links) - 1):
        k = links[b, V]
        if links[b + 1, V] - k == 6:
            xi, angular = scale(h, vector_at(qd, k)), vector_at(p, k)
            put_at(tangent(xi, angular) if by_tangent else turn_by(xi, angular), p, k)
