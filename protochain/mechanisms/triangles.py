"""Nearest points of triangles, and which of them are nearest points of a surface."""

import numpy as np

from protochain.core.arrays import Floats, Integers
from protochain.mechanics.multibody.algebra import Vector, add, dot, kernel, scale, subtract

SAME = 1e-9
"""Distance of two points that count as one, relative to the ball."""


@kernel
def corner(corners: Floats, m: int, k: int) -> Vector:
    """Corner k of triangle m."""
    return corners[m, k, 0], corners[m, k, 1], corners[m, k, 2]


@kernel
def nearest(p: Vector, corners: Floats, m: int) -> tuple[Vector, bool]:
    """Nearest point of triangle m to p, and whether it lies inside, not on an edge."""
    # Ericson, *Real-Time Collision Detection* (2005), section 5.1.5.
    a, b, c = corner(corners, m, 0), corner(corners, m, 1), corner(corners, m, 2)
    ab, ac = subtract(b, a), subtract(c, a)
    ap, bp, cp = subtract(p, a), subtract(p, b), subtract(p, c)
    d1, d2, d3, d4, d5, d6 = dot(ab, ap), dot(ac, ap), dot(ab, bp), dot(ac, bp), dot(ab, cp), dot(ac, cp)
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    if d1 <= 0.0 and d2 <= 0.0:
        return a, False
    if d3 >= 0.0 and d4 <= d3:
        return b, False
    if d6 >= 0.0 and d5 <= d6:
        return c, False
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        return add(a, scale(d1 / (d1 - d3), ab)), False
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        return add(a, scale(d2 / (d2 - d6), ac)), False
    if va <= 0.0 and d4 >= d3 and d5 >= d6:
        along = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        return add(b, scale(along, subtract(c, b))), False
    one = 1.0 / (va + vb + vc)
    return add(a, add(scale(vb * one, ab), scale(vc * one, ac))), True


@kernel
def length(a: Vector) -> float:
    """Length of a vector."""
    return np.sqrt(dot(a, a))


@kernel
def least_distances(
    near: Integers, centre: Floats, radius: Floats, corners: Floats
) -> tuple[Integers, Floats, Floats]:
    """Points of a surface within balls to which nothing around them on the surface is nearer."""
    # near (n, 2) int, centre, radius (balls, 3), corners (m, 3, 3) -> point (k, 3) -> pair (k, 2) int: Ball
    # and triangle -> distance (k,): From the centre of the ball, below its radius.
    # The nearest point of a triangle is no such point if it lies on an edge beyond which another triangle
    # comes nearer: a ball on the middle of a triangle does not touch the edges of its neighbours. Where it
    # touches an edge from outside, it touches it once.
    n = len(near)
    points, distance, inside = np.empty((n, 3)), np.empty(n), np.empty(n, np.bool_)
    hits = np.empty(n, np.int64)
    count = 0
    for k in range(n):
        i = near[k, 0]
        p = (centre[i, 0], centre[i, 1], centre[i, 2])
        at, inside[k] = nearest(p, corners, near[k, 1])
        points[k, 0], points[k, 1], points[k, 2] = at
        distance[k] = length(subtract(p, at))
    for k in range(n):
        i = near[k, 0]
        if not distance[k] < radius[i]:
            continue
        if not inside[k]:
            at, hidden = (points[k, 0], points[k, 1], points[k, 2]), False
            same = SAME * radius[i]
            # The other triangles of this ball.
            rival = k
            while rival > 0 and near[rival - 1, 0] == i:
                rival -= 1
            while rival < n and near[rival, 0] == i and not hidden:
                if rival != k and length(subtract(at, nearest(at, corners, near[rival, 1])[0])) <= same:
                    nearest_other = (points[rival, 0], points[rival, 1], points[rival, 2])
                    hidden = rival < k or inside[rival] or length(subtract(at, nearest_other)) > same
                rival += 1
            if hidden:
                continue
        hits[count] = k
        count += 1
    pair, point, gap = np.empty((count, 2), np.int64), np.empty((count, 3)), np.empty(count)
    for k in range(count):
        pair[k, 0], pair[k, 1], gap[k] = (near[hits[k], 0], near[hits[k], 1], distance[hits[k]])
        point[k, 0], point[k, 1], point[k, 2] = (points[hits[k], 0], points[hits[k], 1], points[hits[k], 2])
    return pair, point, gap
