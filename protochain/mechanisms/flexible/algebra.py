"""Small parts of the sweeps over bodies that bend."""

import numpy as np

from protochain.core.arrays import Floats, Integers
from protochain.mechanics.multibody import algebra
from protochain.mechanics.multibody.algebra import ZERO, Vector, add, cross, dot, kernel, scale
from protochain.mechanics.multibody.tree import SLIDE, TURN

CARRIER, Q, V, NODE, SHAPE, LOCKED = range(6)
"""Columns of ``links`` (nb + 1, 6): node that carries the body (-1 for the world), first coordinate, freedom,
node, and rate of amplitudes, whether the hinge is driven."""
_SMALL = 1e-2
"""rad. Below it quotients of differences lose digits, while three terms of their series do not."""


@kernel
def shortening_of(shortening: Floats, i: int, s: int, n: int, amounts: Floats, first: int) -> Vector:
    """Sum of the shortening of shape s with each of n amounts."""
    x, y, z = 0.0, 0.0, 0.0
    for t in range(n):
        x += amounts[first + t] * shortening[i, s, t, 0]
        y += amounts[first + t] * shortening[i, s, t, 1]
        z += amounts[first + t] * shortening[i, s, t, 2]
    return x, y, z


@kernel
def along(columns: Floats, i: int, s: int, wrench: Floats) -> float:
    """Product of a column and the wrench of its node."""
    moment, force = algebra.pair(wrench, i)
    angular, linear = algebra.pair(columns[i], s)
    return dot(angular, moment) + dot(linear, force)


@kernel
def sum_wrenches(links: Integers, origin: Floats, wrench: Floats, b: int) -> tuple[Vector, Vector]:
    """Wrenches of all nodes of body b, as one about its origin."""
    frame, moment_sum, total = links[b, NODE], ZERO, ZERO
    for i in range(frame, links[b + 1, NODE]):
        moment, force = algebra.pair(wrench, i)
        moment_sum = add(moment_sum, add(moment, cross(algebra.lever(origin, i, frame), force)))
        total = add(total, force)
    return moment_sum, total


@kernel
def base_twist(
    links: Integers, seats: Floats, rotation: Floats, origin: Floats, b: int, motion: Floats, rates: Floats
) -> tuple[Vector, Vector]:
    """Twist of body b about its origin, from the twist of its carrier and the rates of its hinge."""
    c, frame, k = links[b, CARRIER], links[b, NODE], links[b, V]
    n_v = links[b + 1, V] - k
    omega, u = ZERO, ZERO
    if c >= 0:
        omega, u = algebra.pair(motion, c)
        u = add(u, cross(omega, algebra.lever(origin, frame, c)))
    if n_v == 1:
        axis = scale(rates[k], algebra.hinge_axis(rotation, frame))
        omega, u = add(omega, scale(seats[b, TURN], axis)), add(u, scale(seats[b, SLIDE], axis))
    elif n_v == 6:
        omega, u = algebra.vector_at(rates, k), algebra.vector_at(rates, k + 3)
    return omega, u


@kernel
def inertia_times(rotation: Floats, inertia: Floats, i: int, x: Vector) -> Vector:
    """Product of a section's inertia, given along its own axes, with a vector along the world's."""
    turn = algebra.matrix(rotation, i)
    return algebra.rotate(turn, algebra.rotate(algebra.matrix(inertia, i), algebra.rotate_back(turn, x)))


@kernel
def times(matrices: Floats, i: int, f: Floats, r: int, start: int) -> Vector:
    """Three rows of the i-th 6x6 matrix, times row r of f."""
    x, y, z = 0.0, 0.0, 0.0
    for m in range(6):
        x += matrices[i, start, m] * f[r, m]
        y += matrices[i, start + 1, m] * f[r, m]
        z += matrices[i, start + 2, m] * f[r, m]
    return x, y, z


@kernel
def spread(columns: Floats, arm: Vector, i: int, n: int, f: Floats) -> None:
    """Write the rows of [columns, X]^T for node i, an arm away from its body's origin."""
    for s in range(n):
        angular, linear = algebra.pair(columns[i], s)
        algebra.put_pair(angular, linear, f, s)
    for m in range(3):
        unit = 1.0 * (m == 0), 1.0 * (m == 1), 1.0 * (m == 2)
        algebra.put_pair(unit, cross(unit, arm), f, n + m)
        algebra.put_pair(ZERO, unit, f, n + 3 + m)


@kernel
def tangent_rate(theta: Vector, rate: Vector, x: Vector) -> Vector:
    """Time derivative of dexp_theta x, for theta that changes at a rate."""
    # dexp = 1 + a K + b K^2 with a = (1 - cos t) / t^2, b = (t - sin t) / t^3: see ``multibody.rotations``.
    t2 = dot(theta, theta)
    t = np.sqrt(t2)
    if t < _SMALL:
        a = 1 / 2 - t2 / 24 + t2 * t2 / 720
        b = 1 / 6 - t2 / 120 + t2 * t2 / 5040
        # Derivatives by t, over t.
        a_slope = -1 / 12 + t2 / 180 - t2 * t2 / 6720
        b_slope = -1 / 60 + t2 / 1260 - t2 * t2 / 60480
    else:
        sine, cosine = np.sin(t), np.cos(t)
        a, b = (1.0 - cosine) / t2, (t - sine) / (t2 * t)
        a_slope = (t * sine - 2.0 * (1.0 - cosine)) / (t2 * t2)
        b_slope = (3.0 * sine - 2.0 * t - t * cosine) / (t2 * t2 * t)
    grows, y = dot(theta, rate), cross(theta, x)
    first = add(scale(a_slope * grows, y), scale(a, cross(rate, x)))
    second = add(cross(rate, y), cross(theta, cross(rate, x)))
    return add(first, add(scale(b_slope * grows, cross(theta, y)), scale(b, second)))
