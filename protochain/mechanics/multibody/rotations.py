"""Exponential map of rotations and its tangent, as kernels without a singularity at zero.

With K = [xi]x and t = |xi|: exp = 1 + a K + b K^2, dexp = 1 + b K + c K^2, dexp^-1 = 1 - K/2 + d K^2. Here
a = sin t / t, b = (1 - cos t) / t^2, c = (t - sin t) / t^3, d = (1 - t/2 cot t/2) / t^2. Iserles,
Munthe-Kaas, Norsett, Zanna, Acta Numerica 9:215 (2000), appendix B.
"""

import numpy as np

from protochain.core.arrays import Floats, Integers, floats
from protochain.mechanics.multibody.algebra import Vector, add, cross, dot, kernel, put_at, scale, vector_at
from protochain.mechanics.multibody.tree import Q, Tree, V

_SMALL = 0.1
"""rad. Below it the quotients lose digits, while five terms of their series are exact to rounding."""


def displacement_rates(tree: Tree, step: Floats, qd: Floats) -> Floats:
    """Time derivative of a displacement from a fixed q, for velocities qd at its end."""
    # step (n_v,), qd (n_v,) -> (n_v,): Rates qd, with dexp^-1 applied to the angular velocities of free
    # roots, as in Munthe-Kaas methods.
    rates = floats(qd, (tree.n_v,), "qd").copy()
    put_rates(tree.links, floats(step, (tree.n_v,), "step"), rates)
    return rates


def hinge_accelerations(tree: Tree, qd: Floats, qdd: Floats) -> Floats:
    """Accelerations (n_v,) along the hinges one after the other, of the time derivatives of velocities."""
    # The two differ for balls, whose axes move with the body beyond them: by the products a_j x a_i qd_j
    # qd_i, j < i, by which the second and third axis are carried along.
    if not len(tree.balls):
        return qdd
    accelerations, (x, y, z) = qdd.copy(), qd[tree.balls].T
    accelerations[tree.balls] -= np.column_stack([y * z, -x * z, x * y])
    return accelerations


@kernel
def put_rates(links: Integers, step: Floats, rates: Floats) -> None:
    """Overwrite velocities by the rates of :func:`displacement_rates`."""
    for b in range(len(links) - 1):
        k = links[b, V]
        if links[b + 1, V] - k == 6:
            put_at(tangent_inverse(vector_at(step, k), vector_at(rates, k)), rates, k)
        elif links[b + 1, Q] - links[b, Q] == 3:
            back = scale(-1.0, vector_at(step, k))
            put_at(tangent_inverse(back, vector_at(rates, k)), rates, k)


@kernel
def turn_by(xi: Vector, x: Vector) -> Vector:
    """exp([xi]x) x."""
    t2 = dot(xi, xi)
    t = np.sqrt(t2)
    if t < _SMALL:
        a = 1.0 - t2 / 6.0 * (1.0 - t2 / 20.0 * (1.0 - t2 / 42.0 * (1.0 - t2 / 72.0)))
    else:
        a = np.sin(t) / t
    return _series_map(xi, x, a, _versine(t2))


@kernel
def tangent(xi: Vector, x: Vector) -> Vector:
    """dexp_xi x: d exp(xi(t)) / dt = [dexp_xi xi']x exp(xi)."""
    t2 = dot(xi, xi)
    t = np.sqrt(t2)
    if t < _SMALL:
        c = (1.0 - t2 / 20.0 * (1.0 - t2 / 42.0 * (1.0 - t2 / 72.0 * (1.0 - t2 / 110.0)))) / 6.0
    else:
        c = (t - np.sin(t)) / (t2 * t)
    return _series_map(xi, x, _versine(t2), c)


@kernel
def tangent_inverse(xi: Vector, x: Vector) -> Vector:
    """dexp_xi^-1 x. The angle must be below a full turn."""
    t2 = dot(xi, xi)
    t = np.sqrt(t2)
    if t < _SMALL:
        d = 1.0 / 12.0 + t2 / 720.0 + t2 * t2 / 30240.0 + t2 * t2 * t2 / 1209600.0
    else:
        d = (1.0 - 0.5 * t / np.tan(0.5 * t)) / t2
    return _series_map(xi, x, -0.5, d)


@kernel
def _series_map(xi: Vector, x: Vector, first: float, second: float) -> Vector:
    """Sum x + first K x + second K^2 x."""
    y = cross(xi, x)
    return add(x, add(scale(first, y), scale(second, cross(xi, y))))


@kernel
def _versine(t2: float) -> float:
    """(1 - cos t) / t^2, from t^2."""
    if t2 < _SMALL * _SMALL:
        return 0.5 - t2 / 24.0 * (1.0 - t2 / 30.0 * (1.0 - t2 / 56.0 * (1.0 - t2 / 90.0)))
    return (1.0 - np.cos(np.sqrt(t2))) / t2
