"""Canonical momenta p = M qd and the gradient of the kinetic energy. O(n)."""

import numpy as np

from protochain.core.arrays import Floats, Integers, floats
from protochain.mechanics.multibody import algebra
from protochain.mechanics.multibody.algebra import add, cross, dot, kernel, scale
from protochain.mechanics.multibody.kinematics import Frames, outward_twists
from protochain.mechanics.multibody.newton_euler import body_momenta
from protochain.mechanics.multibody.tree import ARMATURE, PARENT, SLIDE, TURN, Tree, V


def momenta(tree: Tree, frames: Frames, qd: Floats) -> tuple[Floats, Floats]:
    """Canonical momenta, and the gradient of the kinetic energy at constant velocities."""
    # qd (n_v,) -> (n_v,): Momenta p = M qd. A free root has the angular momentum of its whole tree about its
    # origin, then the linear momentum; world axes -> (n_v,): Gradient d(qd^T M(q) qd / 2)/dq at constant qd;
    # of a free root along rotations about world axes and translations.
    # With V the twist of a body, h that of its hinge and Pi the momentum of the body and all beyond it, about
    # its origin: p = h . Pi, and the gradient is (V x h) . Pi, since rotating the bodies beyond a hinge is
    # equivalent to rotating its parent's twist back. Lagrange's equations are dp/dt = tau + gradient. O(n).
    p, gradient = np.empty(tree.n_v), np.empty(tree.n_v)
    put_momenta(
        tree.links, tree.bodies, frames.rotation, frames.origin, floats(qd, (tree.n_v,), "qd"),
        np.empty((tree.n_bodies, 6)), np.empty((tree.n_bodies, 6)), p, gradient,
    )  # fmt: skip
    return p, gradient


@kernel
def put_momenta(
    links: Integers, bodies: Floats, rotation: Floats, origin: Floats, qd: Floats, twists: Floats,
    carried: Floats, p: Floats, gradient: Floats,
) -> None:  # fmt: skip
    """Write momenta and gradient. ``twists`` and ``carried`` are workspaces (nb, 6)."""
    outward_twists(links, bodies, rotation, origin, qd, twists)
    body_momenta(bodies, rotation, twists, carried)
    _inward_products(links, bodies, rotation, origin, twists, carried, p, gradient)
    for b in range(len(bodies)):
        for k in range(links[b, V], links[b + 1, V]):
            p[k] += bodies[b, ARMATURE] * qd[k]


def turning_gradient(tree: Tree, frames: Frames, twists: Floats, loads: Floats) -> Floats:
    """Gradient of the sum of loads times twists at constant velocities, when loads turn with their bodies."""
    # twists (nb, 6), loads (nb, 6) -> (n_v,): Gradient along q; with the bodies' momenta as loads that of the
    # kinetic energy.
    # As in :func:`momenta`: (V x h) . Pi, with Pi the load of a body and all beyond it. O(n).
    product, gradient = np.empty(tree.n_v), np.empty(tree.n_v)
    _inward_products(
        tree.links, tree.bodies, frames.rotation, frames.origin, twists, loads.copy(), product, gradient
    )
    return gradient


@kernel
def _inward_products(
    links: Integers, bodies: Floats, rotation: Floats, origin: Floats, twists: Floats, carried: Floats,
    p: Floats, gradient: Floats,
) -> None:  # fmt: skip
    """Write h . Pi and (V x h) . Pi of every hinge. Pi is the sum over the bodies beyond it."""
    for b in range(len(bodies) - 1, -1, -1):
        parent, k = links[b, PARENT], links[b, V]
        n_v = links[b + 1, V] - k
        angular, linear = algebra.pair(carried, b)
        omega, u = algebra.pair(twists, b)
        if n_v == 1:
            axis = algebra.hinge_axis(rotation, b)
            turn, slide = scale(bodies[b, TURN], axis), scale(bodies[b, SLIDE], axis)
            p[k] = dot(turn, angular) + dot(slide, linear)
            shift = add(cross(omega, slide), cross(u, turn))
            gradient[k] = dot(cross(omega, turn), angular) + dot(shift, linear)
        elif n_v == 6:
            p[k], p[k + 1], p[k + 2] = angular
            p[k + 3], p[k + 4], p[k + 5] = linear
            gradient[k], gradient[k + 1], gradient[k + 2] = add(cross(angular, omega), cross(linear, u))
            gradient[k + 3], gradient[k + 4], gradient[k + 5] = 0.0, 0.0, 0.0
        if parent >= 0:
            angular = add(angular, cross(algebra.lever(origin, b, parent), linear))
            algebra.add_pair(angular, linear, carried, parent)
