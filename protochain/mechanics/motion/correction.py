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
from protochain.mechanics.multibody.algebra import (
    ZERO,
    Vector,
    add,
    cross,
    freedom,
    hinge_axis,
    kernel,
    lever,
    matrix,
    pair,
    put_pair,
    rigid_inertia,
    scale,
    vector_at,
)  # fmt: skip
from protochain.mechanics.multibody.tree import ARMATURE, PARENT, SLIDE, TURN, V


@kernel
def correct(
    links: Integers, bodies: Floats, rotation: Floats, origin: Floats, twists: Floats, momenta: Floats,
    h: float, x: Floats,
) -> None:  # fmt: skip
    """Overwrite the residual of the momenta, ``x`` (n_v,), by a Newton step; h is half the time step."""
    # Frames, ``twists`` (nb, 6) of the bodies and ``momenta`` (nb, 6) of each body with all beyond it belong
    # to the midpoint.
    n = len(bodies)
    inertia, load = np.zeros((n, 6, 6)), np.zeros((n, 6))
    column, row = np.zeros((n, 6)), np.zeros((n, 6))
    left, right, feel = np.empty(6), np.empty(6), np.empty(6)
    for b in range(n - 1, -1, -1):
        parent, k = links[b, PARENT], links[b, V]
        n_v = links[b + 1, V] - k
        p, z = inertia[b], load[b]
        _add_rigid(p, rotation, bodies, b)
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
            _hand_inward(p, z, lever(origin, b, parent), inertia[parent], load[parent])

    for b in range(n):
        parent, k = links[b, PARENT], links[b, V]
        n_v = links[b + 1, V] - k
        moved = load[b]
        moved[:] = 0.0
        if parent >= 0:
            omega, u0 = pair(load, parent)
            u0 = add(u0, cross(omega, lever(origin, b, parent)))
            for i in range(3):
                moved[i], moved[3 + i] = omega[i], u0[i]
        if n_v == 1:
            _hinge_twists(rotation, bodies, twists, momenta, b, h, left, right, feel)
            for i in range(6):
                x[k] -= row[b, i] * moved[i]
            for i in range(6):
                moved[i] += right[i] * x[k]
        elif n_v == 6:
            omega, u = pair(twists, b)
            turn, slide = vector_at(x, k), vector_at(x, k + 3)
            put_pair(
                add(turn, scale(h, cross(omega, turn))),
                add(slide, scale(h, cross(u, turn))), load, b,
            )  # fmt: skip


@kernel
def _hinge_twists(
    rotation: Floats, bodies: Floats, twists: Floats, momenta: Floats, b: int, h: float, left: Floats,
    right: Floats, feel: Floats,
) -> None:  # fmt: skip
    """Write s - h V x s, s + h V x s and s x* Pi for the twist s of a hinge."""
    axis = hinge_axis(rotation, b)
    turn, slide = scale(bodies[b, TURN], axis), scale(bodies[b, SLIDE], axis)
    omega, u = pair(twists, b)
    angular, linear = pair(momenta, b)
    spin, shift = cross(omega, turn), add(cross(omega, slide), cross(u, turn))
    moment, force = add(cross(turn, angular), cross(slide, linear)), cross(turn, linear)
    for i in range(3):
        left[i], left[3 + i] = turn[i] - h * spin[i], slide[i] - h * shift[i]
        right[i], right[3 + i] = turn[i] + h * spin[i], slide[i] + h * shift[i]
        feel[i], feel[3 + i] = moment[i], force[i]


@kernel
def _solve_root(
    p: Floats, z: Floats, twists: Floats, momenta: Floats, b: int, h: float, x: Floats
) -> None:  # fmt: skip
    """Overwrite the residual of a free root's momenta by a Newton step in its velocities: a 6x6 system."""
    # These momenta are about the origin at the start of the step, h u before the midpoint, and rotate with
    # the root.
    a, r = np.empty((6, 6)), np.empty(6)
    omega, u = pair(twists, b)
    angular, linear = pair(momenta, b)
    shifted = cross(u, vector_at(x, 3))
    for i in range(3):
        r[i], r[3 + i] = x[i] - h * shifted[i] - z[i], x[3 + i] - z[3 + i]
    for j in range(6):
        turn, slide = freedom(ZERO, 0.0, 0.0, 6, j)
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
def _add_rigid(p: Floats, rotation: Floats, bodies: Floats, b: int) -> None:
    """Add the spatial inertia of body b about its origin to a 6x6 matrix."""
    mass, (x, y, z), s = rigid_inertia(matrix(rotation, b), bodies, b)
    p[0, 0] += s[0]
    p[0, 1] += s[1]
    p[0, 2] += s[2]
    p[1, 0] += s[1]
    p[1, 1] += s[3]
    p[1, 2] += s[4]
    p[2, 0] += s[2]
    p[2, 1] += s[4]
    p[2, 2] += s[5]
    for i, j, c in ((0, 4, -z), (0, 5, y), (1, 3, z), (1, 5, -x), (2, 3, -y), (2, 4, x)):
        p[i, j] += c
        p[j, i] += c
    for i in range(3, 6):
        p[i, i] += mass


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
