"""Bodies without mass: whether the outward bodies resist their hinges."""

import numpy as np

from protochain.core.arrays import Floats, Integers
from protochain.mechanics.multibody import algebra
from protochain.mechanics.multibody.algebra import dot, kernel
from protochain.mechanics.multibody.tree import MASS, PARENT, SLIDE, TURN, Q, V

_LEFT = 1e-12
"""A pivot below this fraction of its minuend has too few digits."""


@kernel
def find_slack(
    links: Integers, bodies: Floats, rotation: Floats, origin: Floats, packed: Floats, pivot: Floats,
    root: Floats,
) -> int:  # fmt: skip
    """Return the first body without mass whose pivot is rounding error, or -1."""
    # Its inertia is what the hinges outward of it leave of the bodies' there, so that its pivot is held
    # against that of the same bodies with these hinges locked: at a gimbal lock nothing but rounding is left.
    total = np.zeros((len(bodies), 21))
    for b in range(len(bodies) - 1, -1, -1):
        p, n_v = links[b, PARENT], links[b + 1, V] - links[b, V]
        if bodies[b, MASS] > 0.0:
            for i in range(21):
                total[b, i] = packed[b, i]
        else:
            axis, locked = algebra.hinge_axis(rotation, b), algebra.inertia(total, b)
            for j in range(n_v):
                omega, u = algebra.freedom(axis, bodies[b, TURN], bodies[b, SLIDE], n_v, j)
                moment, force = algebra.inertia_times(locked, omega, u)
                left = pivot[b] if n_v == 1 else root[links[b, Q] - links[b, V], j, j] ** 2
                if not left > _LEFT * (dot(omega, moment) + dot(u, force)):
                    return b
        if p >= 0:
            arm = algebra.lever(origin, b, p)
            algebra.add_inertia(algebra.shifted_inertia(algebra.inertia(total, b), arm), total, p)
    return -1
