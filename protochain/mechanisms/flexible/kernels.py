"""Sweeps over bodies that bend: frames, twists, inertial loads, solutions with the mass matrix. O(n).

Shapes are padded to the most of any body: ``turns`` and ``moves`` (nn, K, 3), ``shortening`` (nn, K, K, 3).
"""

import numpy as np

from protochain.core.arrays import Floats, Integers
from protochain.mechanics.multibody import algebra
from protochain.mechanics.multibody.algebra import ZERO, add, cross, dot, kernel, scale, subtract
from protochain.mechanics.multibody.kinematics import WORLD, moved_freely, seat, turned_by_hinge
from protochain.mechanics.multibody.rotations import tangent, turn_by
from protochain.mechanics.multibody.tree import ARMATURE, SLIDE, TURN, Q, V
from protochain.mechanisms.flexible import algebra as nodes
from protochain.mechanisms.flexible.algebra import CARRIER, LOCKED, NODE, SHAPE

ROUND_OFF = 1e-15
"""A pivot below this fraction of its diagonal is rounding error."""


@kernel
def put_frames(
    links: Integers, seats: Floats, place: Floats, moves: Floats, turns: Floats, shortening: Floats,
    q: Floats, rotation: Floats, origin: Floats, columns: Floats,
) -> None:  # fmt: skip
    """Write frames of all nodes and the twists ``columns`` (nn, K, 6) of each for its body's amplitudes."""
    shift = links[-1, Q] - links[-1, V]
    for b in range(len(links) - 1):
        c, k, first = links[b, CARRIER], links[b, Q], links[b, SHAPE] + shift
        n_q, n_shapes = links[b + 1, Q] - k, links[b + 1, SHAPE] - links[b, SHAPE]
        above, start = (algebra.matrix(rotation, c), algebra.vector(origin, c)) if c >= 0 else WORLD
        turn, at = seat(seats, b, above, start)
        if n_q == 1:
            sine, cosine = np.sin(q[k]), np.cos(q[k])
            turn, at = turned_by_hinge(turn, at, seats[b, TURN], seats[b, SLIDE], q[k], cosine, sine)
        elif n_q == 7:
            turn, at = moved_freely(at, q, k)
        for i in range(links[b, NODE], links[b + 1, NODE]):
            theta, x = ZERO, algebra.vector(place, i)
            for s in range(n_shapes):
                eta = q[first + s]
                theta = add(theta, scale(eta, algebra.vector(turns[i], s)))
                short = nodes.shortening_of(shortening, i, s, n_shapes, q, first)
                x = add(x, scale(eta, subtract(algebra.vector(moves[i], s), scale(0.5, short))))
            for s in range(n_shapes):
                short = nodes.shortening_of(shortening, i, s, n_shapes, q, first)
                algebra.put_pair(
                    algebra.rotate(turn, tangent(theta, algebra.vector(turns[i], s))),
                    algebra.rotate(turn, subtract(algebra.vector(moves[i], s), short)), columns[i], s,
                )  # fmt: skip
            algebra.put(add(at, algebra.rotate(turn, x)), origin, i, 0)
            u = algebra.rotate(turn, turn_by(theta, (1.0, 0.0, 0.0)))
            v = algebra.rotate(turn, turn_by(theta, (0.0, 1.0, 0.0)))
            w = cross(u, v)
            algebra.put_matrix((u[0], v[0], w[0], u[1], v[1], w[1], u[2], v[2], w[2]), rotation, i)


@kernel
def put_twists(
    links: Integers, seats: Floats, rotation: Floats, origin: Floats, columns: Floats, qd: Floats,
    twists: Floats,
) -> None:  # fmt: skip
    """Write twists (nn, 6) of the nodes about their places."""
    for b in range(len(links) - 1):
        frame, j = links[b, NODE], links[b, SHAPE]
        omega, u = nodes.base_twist(links, seats, rotation, origin, b, twists, qd)
        for i in range(frame, links[b + 1, NODE]):
            spin, moving = omega, add(u, cross(omega, algebra.lever(origin, i, frame)))
            for s in range(links[b + 1, SHAPE] - j):
                angular, linear = algebra.pair(columns[i], s)
                spin, moving = add(spin, scale(qd[j + s], angular)), add(moving, scale(qd[j + s], linear))
            algebra.put_pair(spin, moving, twists, i)


@kernel
def put_changes(
    links: Integers, turns: Floats, shortening: Floats, rotation: Floats, columns: Floats, q: Floats,
    qd: Floats, twists: Floats, changes: Floats,
) -> None:  # fmt: skip
    """Write the rates of change of the columns (nn, K, 6), for twists of the nodes."""
    shift = links[-1, Q] - links[-1, V]
    for b in range(len(links) - 1):
        frame, j = links[b, NODE], links[b, SHAPE]
        n_shapes = links[b + 1, SHAPE] - j
        omega, _ = algebra.pair(twists, frame)
        turn = algebra.matrix(rotation, frame)
        for i in range(frame, links[b + 1, NODE]):
            theta, rate = ZERO, ZERO
            for s in range(n_shapes):
                theta = add(theta, scale(q[j + shift + s], algebra.vector(turns[i], s)))
                rate = add(rate, scale(qd[j + s], algebra.vector(turns[i], s)))
            for s in range(n_shapes):
                angular, linear = algebra.pair(columns[i], s)
                bent = nodes.tangent_rate(theta, rate, algebra.vector(turns[i], s))
                short = nodes.shortening_of(shortening, i, s, n_shapes, qd, j)
                algebra.put_pair(
                    add(cross(omega, angular), algebra.rotate(turn, bent)),
                    subtract(cross(omega, linear), algebra.rotate(turn, short)), changes[i], s,
                )  # fmt: skip


@kernel
def put_loads(
    links: Integers, seats: Floats, rotation: Floats, origin: Floats, columns: Floats, mass: Floats,
    inertia: Floats, twists: Floats, changes: Floats, qd: Floats, qdd: Floats, loads: Floats,
) -> None:  # fmt: skip
    """Write the moments and forces (nn, 6) that give the nodes their accelerations."""
    motion = np.empty((len(origin), 6))
    for b in range(len(links) - 1):
        c, frame, j = links[b, CARRIER], links[b, NODE], links[b, SHAPE]
        n_shapes = links[b + 1, SHAPE] - j
        alpha, a = nodes.base_twist(links, seats, rotation, origin, b, motion, qdd)
        if c >= 0:
            above, _ = algebra.pair(twists, c)
            a = add(a, cross(above, cross(above, algebra.lever(origin, frame, c))))
            if links[b + 1, V] - links[b, V] == 1:
                # The axis turns with what carries it.
                axis = scale(qd[links[b, V]], algebra.hinge_axis(rotation, frame))
                alpha = add(alpha, scale(seats[b, TURN], cross(above, axis)))
                a = add(a, scale(2.0 * seats[b, SLIDE], cross(above, axis)))
        omega, _ = algebra.pair(twists, frame)
        for i in range(frame, links[b + 1, NODE]):
            arm = algebra.lever(origin, i, frame)
            quick, pulled = alpha, add(a, add(cross(alpha, arm), cross(omega, cross(omega, arm))))
            for s in range(n_shapes):
                angular, linear = algebra.pair(columns[i], s)
                spin, slip = algebra.pair(changes[i], s)
                quick = add(quick, add(scale(qdd[j + s], angular), scale(qd[j + s], spin)))
                # The change of a column has one of the two terms of Coriolis.
                slip = add(slip, cross(omega, linear))
                pulled = add(pulled, add(scale(qdd[j + s], linear), scale(qd[j + s], slip)))
            algebra.put_pair(quick, pulled, motion, i)
            spin, _ = algebra.pair(twists, i)
            moment = add(
                nodes.inertia_times(rotation, inertia, i, quick),
                cross(spin, nodes.inertia_times(rotation, inertia, i, spin)),
            )
            algebra.put_pair(moment, scale(mass[i], pulled), loads, i)


@kernel
def put_torques(
    links: Integers, seats: Floats, rotation: Floats, origin: Floats, columns: Floats, felt: Floats,
    tau: Floats,
) -> None:  # fmt: skip
    """Write J^T wrench. Overwrite the wrenches ``felt`` (nn, 6) by the loads that their nodes carry."""
    for b in range(len(links) - 2, -1, -1):
        c, frame, j, k = links[b, CARRIER], links[b, NODE], links[b, SHAPE], links[b, V]
        for s in range(links[b + 1, SHAPE] - j):
            tau[j + s] = 0.0
            for i in range(frame, links[b + 1, NODE]):
                tau[j + s] += nodes.along(columns, i, s, felt)
        moment, force = nodes.sum_wrenches(links, origin, felt, b)
        n_v, axis = links[b + 1, V] - k, algebra.hinge_axis(rotation, frame)
        for m in range(n_v):
            turn, slide = algebra.freedom(axis, seats[b, TURN], seats[b, SLIDE], n_v, m)
            tau[k + m] = dot(turn, moment) + dot(slide, force)
        if c >= 0:
            algebra.add_pair(add(moment, cross(algebra.lever(origin, frame, c), force)), force, felt, c)


@kernel
def put_gradient(
    links: Integers, seats: Floats, rotation: Floats, origin: Floats, columns: Floats, twists: Floats,
    changes: Floats, felt: Floats, gradient: Floats,
) -> None:  # fmt: skip
    """Write the sum of (dJ/dt)^T times momentum. ``felt`` has the momenta that nodes carry."""
    for b in range(len(links) - 1):
        c, frame, j, k = links[b, CARRIER], links[b, NODE], links[b, SHAPE], links[b, V]
        for s in range(links[b + 1, SHAPE] - j):
            gradient[j + s] = 0.0
            for i in range(frame, links[b + 1, NODE]):
                angular, _ = algebra.pair(columns[i], s)
                _, moving = algebra.pair(twists, i)
                _, force = algebra.pair(felt, i)
                gradient[j + s] += nodes.along(changes, i, s, felt) - dot(angular, cross(moving, force))
        moment, force = nodes.sum_wrenches(links, origin, felt, b)
        n_v, above, axis = links[b + 1, V] - k, ZERO, algebra.hinge_axis(rotation, frame)
        if c >= 0 and n_v == 1:
            above, _ = algebra.pair(twists, c)
        _, moving = algebra.pair(twists, frame)
        for m in range(n_v):
            turn, slide = algebra.freedom(axis, seats[b, TURN], seats[b, SLIDE], n_v, m)
            gradient[k + m] = dot(cross(above, turn), moment) + dot(cross(above, slide), force)
            gradient[k + m] -= dot(turn, cross(moving, force))


@kernel
def solve_bent(
    links: Integers, seats: Floats, rotation: Floats, origin: Floats, columns: Floats, mass: Floats,
    inertia: Floats, x: Floats,
) -> int:  # fmt: skip
    """Overwrite tau in x by M^-1 tau. Return the first body without a pivot, or -1."""
    # The rates of a body's amplitudes and its twist V have the matrix summed over its nodes of F^T I F, with
    # F = [columns, X] and X what moves V to the node. Amplitudes are eliminated first, then the hinge.
    n, n_most = len(links) - 1, columns.shape[1]
    carried, load = np.zeros((len(origin), 6, 6)), np.zeros((len(origin), 6))
    rows, gains = np.empty((n, n_most, n_most + 7)), np.zeros((n, 7))
    roots, f, g = np.empty((n, 6, 7)), np.empty((n_most + 6, 6)), np.empty((n_most + 6, 6))
    system_matrix, h, weighs = np.empty((n_most + 6, n_most + 7)), np.empty(6), mass > 0.0
    for b in range(n - 1, -1, -1):
        c, frame, j, k = links[b, CARRIER], links[b, NODE], links[b, SHAPE], links[b, V]
        n_shapes, n_v = links[b + 1, SHAPE] - j, links[b + 1, V] - k
        size = n_shapes + 6
        system_matrix[:] = 0.0
        for i in range(frame, links[b + 1, NODE]):
            if weighs[i] or inertia[i, 0, 0] + inertia[i, 1, 1] + inertia[i, 2, 2] > 0.0:
                nodes.spread(columns, algebra.lever(origin, i, frame), i, n_shapes, f)
                _add_node(i, size, mass[i], rotation, inertia, carried, load, f, g, system_matrix)
        for s in range(n_shapes):
            system_matrix[s, size] += x[j + s]
        if not _eliminate(system_matrix, 0, n_shapes, size):
            return b
        for s in range(n_shapes):
            for m in range(s, size + 1):
                rows[b, s, m] = system_matrix[s, m]
        if n_v == 6:
            for m in range(6):
                system_matrix[n_shapes + m, size] += x[k + m]
                system_matrix[n_shapes + m, n_shapes + m] += seats[b, ARMATURE]
            if not _eliminate(system_matrix, n_shapes, size, size):
                return b
            for r in range(6):
                for m in range(r, 7):
                    roots[b, r, m] = system_matrix[n_shapes + r, n_shapes + m]
            continue
        p = _mirror(system_matrix[n_shapes:, n_shapes:])
        if n_v == 1 and links[b, LOCKED] == 0:
            axis = algebra.hinge_axis(rotation, frame)
            turn, slide = algebra.freedom(axis, seats[b, TURN], seats[b, SLIDE], 1, 0)
            h[0], h[1], h[2] = turn
            h[3], h[4], h[5] = slide
            if not _pass_hinge(p, h, seats[b, ARMATURE], x[k], gains[b]):
                return b
        if c >= 0:
            weighs[c] = True
            nodes.spread(columns, algebra.lever(origin, frame, c), 0, 0, f)
            _carry(c, p, f, g, carried, load)
    _outward(links, seats, rotation, origin, columns, rows, gains, roots, x)
    return -1


@kernel
def _add_node(
    i: int, size: int, mass: float, rotation: Floats, inertia: Floats, carried: Floats, load: Floats,
    f: Floats, g: Floats, system_matrix: Floats,
) -> None:  # fmt: skip
    """Add F^T I F of a node, with its carried bodies, to its body's matrix. The load is the last column."""
    for r in range(size):
        moment = add(
            nodes.inertia_times(rotation, inertia, i, algebra.vector(f, r, 0)),
            nodes.times(carried, i, f, r, 0),
        )
        force = add(scale(mass, algebra.vector(f, r, 3)), nodes.times(carried, i, f, r, 3))
        algebra.put_pair(moment, force, g, r)
    for r in range(size):
        for s in range(r, size):
            for m in range(6):
                system_matrix[r, s] += f[r, m] * g[s, m]
        for m in range(6):
            system_matrix[r, size] -= f[r, m] * load[i, m]


@kernel
def _mirror(p: Floats) -> Floats:
    """Copy the upper triangle of a body's 6x6 matrix to the lower one, in place."""
    for r in range(6):
        for m in range(r):
            p[r, m] = p[m, r]
    return p


@kernel
def _carry(c: int, p: Floats, f: Floats, g: Floats, carried: Floats, load: Floats) -> None:
    """Add the inertia of a body, and its load, to the node that carries it."""
    for r in range(6):
        for m in range(6):
            g[r, m] = 0.0
            for s in range(6):
                g[r, m] += p[m, s] * f[r, s]
    for r in range(6):
        for s in range(6):
            load[c, r] -= f[r, s] * p[s, 6]
            for m in range(6):
                carried[c, r, s] += f[r, m] * g[s, m]


@kernel
def _outward(
    links: Integers, seats: Floats, rotation: Floats, origin: Floats, columns: Floats, rows: Floats,
    gains: Floats, roots: Floats, x: Floats,
) -> None:  # fmt: skip
    """Overwrite x by the solution, from rows of the eliminations."""
    motion, y = np.empty((len(origin), 6)), np.empty(columns.shape[1] + 6)
    for b in range(len(links) - 1):
        frame, j, k = links[b, NODE], links[b, SHAPE], links[b, V]
        n_shapes, n_v = links[b + 1, SHAPE] - j, links[b + 1, V] - k
        if n_v == 6:
            for r in range(5, -1, -1):
                x[k + r] = roots[b, r, 6]
                for m in range(r + 1, 6):
                    x[k + r] -= roots[b, r, m] * x[k + m]
                x[k + r] /= roots[b, r, r]
        elif n_v == 1:
            x[k] = 0.0
            if links[b, LOCKED] == 0:
                omega, u = nodes.base_twist(links, seats, rotation, origin, b, motion, x)
                turning, sliding = algebra.pair(gains, b)
                x[k] = gains[b, 6] - dot(turning, omega) - dot(sliding, u)
        omega, u = nodes.base_twist(links, seats, rotation, origin, b, motion, x)
        for m in range(3):
            y[n_shapes + m], y[n_shapes + 3 + m] = omega[m], u[m]
        for s in range(n_shapes - 1, -1, -1):
            y[s] = rows[b, s, n_shapes + 6]
            for m in range(s + 1, n_shapes + 6):
                y[s] -= rows[b, s, m] * y[m]
            y[s] /= rows[b, s, s]
            x[j + s] = y[s]
        for i in range(frame, links[b + 1, NODE]):
            spin, moving = omega, add(u, cross(omega, algebra.lever(origin, i, frame)))
            for s in range(n_shapes):
                angular, linear = algebra.pair(columns[i], s)
                spin, moving = add(spin, scale(y[s], angular)), add(moving, scale(y[s], linear))
            algebra.put_pair(spin, moving, motion, i)


@kernel
def _eliminate(a: Floats, first: int, end: int, size: int) -> bool:
    """Eliminate rows of a symmetric matrix in its upper triangle. The column after it is the right side."""
    for r in range(first, end):
        # The diagonal before the rows above were subtracted.
        before = a[r, r]
        for m in range(first, r):
            before += a[m, r] * a[m, r] / a[m, m]
        if not a[r, r] > ROUND_OFF * before:
            return False
        for s in range(r + 1, size):
            weight = a[r, s] / a[r, r]
            for m in range(s, size + 1):
                a[s, m] -= weight * a[r, m]
    return True


@kernel
def _pass_hinge(p: Floats, h: Floats, armature: float, tau: float, gain: Floats) -> bool:
    """Overwrite P, and its last column -z, by their remainders past a hinge h. Write P h / D and its rate."""
    pivot, passed, total_inertia = armature, 0.0, 0.0
    for r in range(6):
        gain[r] = 0.0
        for m in range(6):
            gain[r] += p[r, m] * h[m]
            if r // 3 == m // 3:
                total_inertia += h[m] * h[m] * p[r, r]
        pivot += h[r] * gain[r]
        passed += h[r] * p[r, 6]
    if not pivot > ROUND_OFF * total_inertia:
        return False
    remainder = tau + passed
    for r in range(6):
        p[r, 6] -= gain[r] / pivot * remainder
        for m in range(6):
            p[r, m] -= gain[r] * gain[m] / pivot
    for r in range(6):
        gain[r] /= pivot
    gain[6] = remainder / pivot
    return True
