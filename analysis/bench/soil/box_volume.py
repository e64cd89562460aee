"""Volume of the overlap of two boxes, and where its surface presses: a contact with an energy.

The energy k V^2 / (2 S^2), with V the volume of the overlap and S the smallest face of the two boxes, is
smooth whatever meets: faces that lie flat press as springs of stiffness k, edges and corners more softly. Its
gradient is a pressure k V / S^2 on that part of a box's surface that lies in the other (the derivative of a
volume by a motion of its boundary), so that forces come from no choice of an axis. Feng, Comput. Methods
Appl. Mech. Eng. 373:113454 (2021), on energies of overlaps.
"""

import numpy as np

from bench.soil.box_kernels import at, best_axis, column
from protochain.core.arrays import Floats
from protochain.mechanics.multibody.algebra import (
    Matrix,
    Vector,
    add,
    cross,
    dot,
    kernel,
    rotate,
    rotate_back,
    scale,
    subtract,
)

FACETS = 6
"""Of a box's surface in another: one of each face."""
WHOLE = 1e300
"""Depth of a box that lies in another, from which no side is the way out."""


@kernel
def facets(
    c1: Vector, r1: Matrix, h1: Vector, c2: Vector, r2: Matrix, h2: Vector, closed: bool,
    polygon: Floats, other: Floats, out: Floats,
) -> int:  # fmt: skip
    """Put the parts of the first box's faces that lie in the second into ``out`` (6, 8); return their number.

    Columns as of contact points: middle, area, nothing, outward normal. Faces of both that lie in one plane
    count where ``closed``, so that one of the two does. Sutherland, Hodgman, Commun. ACM 17:32 (1974).
    """
    number = 0
    for face in range(FACETS):
        k, sign = face // 2, 1.0 if face % 2 else -1.0
        n = scale(sign, column(r1, k))
        u = scale(at(h1, (k + 1) % 3), column(r1, (k + 1) % 3))
        v = scale(at(h1, (k + 2) % 3), column(r1, (k + 2) % 3))
        middle = add(subtract(c1, c2), scale(at(h1, k), n))
        for corner in range(4):
            su = 1.0 if corner == 1 or corner == 2 else -1.0
            sv = 1.0 if corner > 1 else -1.0
            p = rotate_back(r2, add(middle, add(scale(su, u), scale(sv, v))))
            polygon[corner, 0], polygon[corner, 1], polygon[corner, 2] = p
        count = 4
        for side in range(6):
            axis, bound = side // 2, at(h2, side // 2)
            if not closed:
                bound *= 1.0 - 1e-14
            count = _cut(polygon, count, axis, 1.0 if side % 2 else -1.0, bound, other)
            for i in range(count):
                for c in range(3):
                    polygon[i, c] = other[i, c]
        if count < 3:
            continue
        # Area and middle from triangles, along the normal in the second's axes.
        m = rotate_back(r2, n)
        area, place = 0.0, (0.0, 0.0, 0.0)
        p = (polygon[0, 0], polygon[0, 1], polygon[0, 2])
        for i in range(1, count - 1):
            a = (polygon[i, 0], polygon[i, 1], polygon[i, 2])
            b = (polygon[i + 1, 0], polygon[i + 1, 1], polygon[i + 1, 2])
            part = 0.5 * abs(dot(m, cross(subtract(a, p), subtract(b, p))))
            area += part
            place = add(place, scale(part / 3.0, add(p, add(a, b))))
        if area > 0.0:
            place = add(c2, rotate(r2, scale(1.0 / area, place)))
            out[number, 0], out[number, 1], out[number, 2] = place
            out[number, 3], out[number, 4] = area, 0.0
            out[number, 5], out[number, 6], out[number, 7] = n
            number += 1
    return number


@kernel
def _cut(polygon: Floats, count: int, axis: int, sign: float, bound: float, out: Floats) -> int:
    """Keep the part of a polygon where sign times a coordinate is at most the bound; count its corners."""
    kept = 0
    for i in range(count):
        j = i + 1 if i + 1 < count else 0
        a, b = bound - sign * polygon[i, axis], bound - sign * polygon[j, axis]
        if a >= 0.0 and kept < len(out):
            for c in range(3):
                out[kept, c] = polygon[i, c]
            kept += 1
        if (a >= 0.0) != (b >= 0.0) and kept < len(out):
            s = a / (a - b)
            for c in range(3):
                out[kept, c] = polygon[i, c] + s * (polygon[j, c] - polygon[i, c])
            kept += 1
    return kept


@kernel
def overlap(
    c1: Vector, r1: Matrix, h1: Vector, c2: Vector, r2: Matrix, h2: Vector, polygon: Floats, other: Floats,
    found: Floats, spare: Floats,
) -> tuple[int, float]:  # fmt: skip
    """Facets of the first box in the second, in ``found``, and the volume that both have in common."""
    number = facets(c1, r1, h1, c2, r2, h2, True, polygon, other, found)
    more = facets(c2, r2, h2, c1, r1, h1, False, polygon, other, spare)
    # Gauss's theorem, from a point between the two.
    origin, volume = scale(0.5, add(c1, c2)), 0.0
    for a in range(number):
        arm = subtract((found[a, 0], found[a, 1], found[a, 2]), origin)
        volume += found[a, 3] * dot(arm, (found[a, 5], found[a, 6], found[a, 7])) / 3.0
    for a in range(more):
        arm = subtract((spare[a, 0], spare[a, 1], spare[a, 2]), origin)
        volume += spare[a, 3] * dot(arm, (spare[a, 5], spare[a, 6], spare[a, 7])) / 3.0
    return number, max(volume, 0.0)


@kernel
def smallest_face(h: Vector) -> float:
    """Area of a box's smallest face."""
    return 4.0 * min(h[0] * h[1], min(h[1] * h[2], h[2] * h[0]))


@kernel
def box_in_box(
    c1: Vector, r1: Matrix, h1: Vector, c2: Vector, r2: Matrix, h2: Vector, polygon: Floats, other: Floats,
    found: Floats, spare: Floats,
) -> tuple[int, float, Vector]:  # fmt: skip
    """Points of a contact by its overlap, in ``found``: their number, depth, and normal from first to second.

    Springs with half of depth times share times depth hold V^2 / (2 S^2) together, and push with V / S^2 on
    each facet. The depth that is returned is V / S, of faces that lie flat.
    """
    n = (0.0, 0.0, 0.0)
    gap, _ = best_axis(c1, r1, h1, c2, r2, h2, 0.0, 0.0)
    if gap >= 0.0:
        return 0, 0.0, n
    number, volume = overlap(c1, r1, h1, c2, r2, h2, polygon, other, found, spare)
    whole = 0.0
    for a in range(number):
        whole += found[a, 3]
        n = add(n, scale(found[a, 3], (found[a, 5], found[a, 6], found[a, 7])))
    face, size = min(smallest_face(h1), smallest_face(h2)), np.sqrt(dot(n, n))
    if number == 0 or volume == 0.0:
        return 0, 0.0, n
    if size <= 1e-9 * whole:
        return number, WHOLE, n
    for a in range(number):
        found[a, 4] = found[a, 3] * whole / (face * face)
        found[a, 3] = volume / whole
    return number, volume / face, scale(1.0 / size, n)
