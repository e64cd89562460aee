"""Newton's method for the velocities of the leapfrog's drift, in O(n).

They satisfy p(q + k qd, qd) - k g(q + k qd, qd) = p0, with k half the time step and g the gradient of the
kinetic energy. The momentum of a hinge is h . Pi, with h its twist and Pi the momentum of all bodies beyond
it, and g is (V x h) . Pi: sums of local terms over these bodies, so that the derivative is factorised by one
inward sweep, as the mass matrix is by articulated bodies. But momenta are collected with h - k V x h and
velocities propagated with h + k V x h, and Pi acts on a moving hinge: the articulated inertia is not
symmetric. To first order in k the derivative is M plus an antisymmetric matrix, invertible however long the
chain. A fixed-point iteration with M alone diverges in open chains of a hundred residues.
"""

import numpy as np

from protochain.core.arrays import Floats, Integers
from protochain.mechanics.multibody import algebra
from protochain.mechanics.multibody.algebra import ZERO, Vector, add, cross, kernel, scale
from protochain.mechanics.multibody.articulated import put_rigid
from protochain.mechanics.multibody.small import dense_inertia
from protochain.mechanics.multibody.tree import ARMATURE, PARENT, SLIDE, TURN, V


@kernel
def correct(
    links: Integers, bodies: Floats, rotation: Floats, origin: Floats, twists: Floats, momenta: Floats,
    h: float, x: Floats,
) -> None:  # fmt: skip
    """Overwrite the residual of the momenta, ``x`` (n_v,), by a Newton step. h is half the time step."""
    # Frames, ``twists`` (nb, 6) of the bodies and ``momenta`` (nb, 6) of each body with all beyond it belong
    # to the midpoint.
    n = len(bodies)
    inertia, load = np.zeros((n, 6, 6)), np.zeros((n, 6))
    packed, rigid = np.empty((n, 21)), np.empty((6, 6))
    put_rigid(rotation, bodies, packed)
    column, row = np.zeros((n, 6)), np.zeros((n, 6))
    left, right, feel = np.empty(6), np.empty(6), np.empty(6)
    for b in range(n - 1, -1, -1):
        parent, k = links[b, PARENT], links[b, V]
        n_v = links[b + 1, V] - k
        p, z = inertia[b], load[b]
        dense_inertia(packed[b], rigid)
        p += rigid
        if n_v == 1:
            _hinge_twists(rotation, bodies, twists, momenta, b, h, left, right, feel)
            u, y = column[b], row[b]
            pivot, used = bodies[b, ARMATURE], 0.0
            for i in range(6):
                u[i] = h * feel[i]
                y[i] = -h * feel[i]
                for j in range(6):
                    u[i] += p[i, j] * right[j]
                    y[i] += p[j, i] * left[j]
                pivot += left[i] * u[i] - h * feel[i] * right[i]
                used += left[i] * z[i]
            for i in range(6):
                y[i] /= pivot
            x[k] = (x[k] - used) / pivot
            for i in range(6):
                for j in range(6):
                    p[i, j] -= u[i] * y[j]
                z[i] += u[i] * x[k]
        elif n_v == 6:
            for i in range(6):
                p[i, i] += bodies[b, ARMATURE]
            _solve_root(p, z, twists, momenta, b, h, x[k : k + 6])
        if parent >= 0:
            _hand_inward(p, z, algebra.lever(origin, b, parent), inertia[parent], load[parent])

    for b in range(n):
        parent, k = links[b, PARENT], links[b, V]
        n_v = links[b + 1, V] - k
        moved = load[b]
        moved[:] = 0.0
        if parent >= 0:
            omega, u0 = algebra.pair(load, parent)
            u0 = add(u0, cross(omega, algebra.lever(origin, b, parent)))
            for i in range(3):
                moved[i], moved[3 + i] = omega[i], u0[i]
        if n_v == 1:
            _hinge_twists(rotation, bodies, twists, momenta, b, h, left, right, feel)
            for i in range(6):
                x[k] -= row[b, i] * moved[i]
            for i in range(6):
                moved[i] += right[i] * x[k]
        elif n_v == 6:
            omega, u = algebra.pair(twists, b)
            turn, slide = algebra.vector_at(x, k), algebra.vector_at(x, k + 3)
            algebra.put_pair(
                add(turn, scale(h, cross(omega, turn))), add(slide, scale(h, cross(u, turn))), load, b
            )


@kernel
def _hinge_twists(
    rotation: Floats, bodies: Floats, twists: Floats, momenta: Floats, b: int, h: float, left: Floats,
    right: Floats, feel: Floats,
) -> None:  # fmt: skip
    """Write s - h V x s, s + h V x s and s x* Pi for the twist s of a hinge."""
    axis = algebra.hinge_axis(rotation, b)
    turn, slide = scale(bodies[b, TURN], axis), scale(bodies[b, SLIDE], axis)
    omega, u = algebra.pair(twists, b)
    angular, linear = algebra.pair(momenta, b)
    spin, shift = cross(omega, turn), add(cross(omega, slide), cross(u, turn))
    moment, force = add(cross(turn, angular), cross(slide, linear)), cross(turn, linear)
    for i in range(3):
        left[i], left[3 + i] = turn[i] - h * spin[i], slide[i] - h * shift[i]
        right[i], right[3 + i] = turn[i] + h * spin[i], slide[i] + h * shift[i]
        feel[i], feel[3 + i] = moment[i], force[i]


@kernel
def _solve_root(p: Floats, z: Floats, twists: Floats, momenta: Floats, b: int, h: float, x: Floats) -> None:
    """Overwrite the residual of a free root's momenta by a Newton step in its velocities: a 6x6 system."""
    # These momenta are about the origin at the start of the step, h u before the midpoint, and rotate with
    # the root.
    a, r = np.empty((6, 6)), np.empty(6)
    omega, u = algebra.pair(twists, b)
    angular, linear = algebra.pair(momenta, b)
    shifted = cross(u, algebra.vector_at(x, 3))
    for i in range(3):
        r[i], r[3 + i] = x[i] - h * shifted[i] - z[i], x[3 + i] - z[3 + i]
    for j in range(6):
        turn, slide = algebra.freedom(ZERO, 0.0, 0.0, 6, j)
        spin = add(turn, scale(h, cross(omega, turn)))
        shift = add(slide, scale(h, cross(u, turn)))
        moment, force = add(cross(turn, angular), cross(slide, linear)), cross(turn, linear)
        for i in range(3):
            a[i, j], a[3 + i, j] = h * moment[i], h * force[i]
        for i in range(6):
            for k in range(3):
                a[i, j] += p[i, k] * spin[k] + p[i, 3 + k] * shift[k]
    x[:] = np.linalg.solve(a, r)


@kernel
def _hand_inward(p: Floats, z: Floats, arm: Vector, onto: Floats, load: Floats) -> None:
    """Add the child's matrix and load about the parent's origin, X^T p X and X^T z, to the parent's."""
    for i in range(6):
        # Columns: a twist (omega, u) of the parent is (omega, u + omega x arm) here.
        shifted = cross(arm, (p[i, 3], p[i, 4], p[i, 5]))
        for j in range(3):
            p[i, j] += shifted[j]
    for j in range(6):
        shifted = cross(arm, (p[3, j], p[4, j], p[5, j]))
        for i in range(3):
            p[i, j] += shifted[i]
    for i in range(6):
        for j in range(6):
            onto[i, j] += p[i, j]
    moment = cross(arm, (z[3], z[4], z[5]))
    for i in range(3):
        load[i] += z[i] + moment[i]
        load[3 + i] += z[3 + i]
