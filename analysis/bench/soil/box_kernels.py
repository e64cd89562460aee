"""Contact of two boxes, and of a box with a plane: separating axes, then the points where they press.

Of two convex bodies that overlap, the shortest way apart is along a normal of a face of either, or across an
edge of each: 3 + 3 + 9 axes for boxes (Gottschalk, Lin, Manocha, SIGGRAPH 1996). Along a face's normal, the
face of the other that looks most against it is cut to the face's prism (Sutherland, Hodgman, Commun. ACM
17:32, 1974), and the corners of what remains are the points; across edges it is one point between them.

Kernels: vectors and rotations are tuples, points go into work space that is given.
"""

import numpy as np

from protochain.core.arrays import Floats
from protochain.mechanics.multibody.algebra import (
    Matrix,
    Vector,
    add,
    cross,
    dot,
    kernel,
    rotate_back,
    scale,
    subtract,
)

MOST_POINTS = 8
"""Points of one contact: corners of a rectangle cut by four lines, or corners of a box below a plane."""
POINT_SHARE = 0.25
"""Share of a corner: that of one of the four of a square face."""
EDGE_SHARE = 0.5
"""Share of two crossed edges: that of one of the four sides of a square face."""
FACES = 6
"""Axes that are normals of faces; those after them lie across edges."""
STEEPEST = 2.0
"""Largest gradient of the depth along a face, where edges cross; beyond it they are almost parallel."""
_PARALLEL = 1e-10
"""Squared sine of the angle between edges, below which they span no axis that a face does not have."""


@kernel
def box_on_plane(
    up: Vector, offset: float, c: Vector, r: Matrix, half: Vector, found: Floats
) -> tuple[int, float]:
    """Put corners below a plane into ``found`` (8, 8): place, depth, share, force; their number, depth."""
    x = scale(half[0], (r[0], r[3], r[6]))
    y = scale(half[1], (r[1], r[4], r[7]))
    z = scale(half[2], (r[2], r[5], r[8]))
    a, b, d = dot(up, x), dot(up, y), dot(up, z)
    level = dot(up, c) - offset
    deepest = abs(a) + abs(b) + abs(d) - level
    number = 0
    if deepest > 0.0:
        for corner in range(8):
            sx = 1.0 if corner & 1 else -1.0
            sy = 1.0 if corner & 2 else -1.0
            sz = 1.0 if corner & 4 else -1.0
            depth = -(level + sx * a + sy * b + sz * d)
            if depth > 0.0:
                p = add(add(c, scale(sx, x)), add(scale(sy, y), scale(sz, z)))
                p = add(p, scale(0.5 * depth, up))
                found[number, 0], found[number, 1], found[number, 2] = p
                found[number, 3], found[number, 4] = depth, POINT_SHARE
                found[number, 5], found[number, 6], found[number, 7] = up
                number += 1
    return number, deepest


@kernel
def along_face(t: float, a: float, row: Vector, half: Vector) -> float:
    """Gap along a face's normal: distance of the centres there, minus both half widths."""
    return abs(t) - a - half[0] * abs(row[0]) - half[1] * abs(row[1]) - half[2] * abs(row[2])


@kernel
def across(t: float, own: float, other: float, c: float) -> float:
    """Gap across two edges with cosine c; none known where they are parallel."""
    s2 = 1.0 - c * c
    if s2 < _PARALLEL:
        return -np.inf
    return (abs(t) - own - other) / np.sqrt(s2)


@kernel
def best_face(t: Vector, m: Matrix, a: Vector, b: Vector) -> tuple[float, int]:
    """Largest gap along normals of the first box, in its axes, and which; m turns the second's to them."""
    x, y = along_face(t[0], a[0], (m[0], m[1], m[2]), b), along_face(t[1], a[1], (m[3], m[4], m[5]), b)
    z = along_face(t[2], a[2], (m[6], m[7], m[8]), b)
    if x >= y and x >= z:
        return x, 0
    return (y, 1) if y >= z else (z, 2)


@kernel
def best_edges(t: Vector, m: Matrix, a: Vector, b: Vector) -> tuple[float, int]:
    """Largest gap across an edge of each box, and which two: 3 i + j."""
    n = (abs(m[0]), abs(m[1]), abs(m[2]), abs(m[3]), abs(m[4]), abs(m[5]), abs(m[6]), abs(m[7]), abs(m[8]))
    best, which = -np.inf, 0
    # The axis of edge i of the first and j of the second is e_i x m_j.
    gap = across(t[2] * m[3] - t[1] * m[6], a[1] * n[6] + a[2] * n[3], b[1] * n[2] + b[2] * n[1], m[0])
    if gap > best:
        best, which = gap, 0
    gap = across(t[2] * m[4] - t[1] * m[7], a[1] * n[7] + a[2] * n[4], b[2] * n[0] + b[0] * n[2], m[1])
    if gap > best:
        best, which = gap, 1
    gap = across(t[2] * m[5] - t[1] * m[8], a[1] * n[8] + a[2] * n[5], b[0] * n[1] + b[1] * n[0], m[2])
    if gap > best:
        best, which = gap, 2
    gap = across(t[0] * m[6] - t[2] * m[0], a[2] * n[0] + a[0] * n[6], b[1] * n[5] + b[2] * n[4], m[3])
    if gap > best:
        best, which = gap, 3
    gap = across(t[0] * m[7] - t[2] * m[1], a[2] * n[1] + a[0] * n[7], b[2] * n[3] + b[0] * n[5], m[4])
    if gap > best:
        best, which = gap, 4
    gap = across(t[0] * m[8] - t[2] * m[2], a[2] * n[2] + a[0] * n[8], b[0] * n[4] + b[1] * n[3], m[5])
    if gap > best:
        best, which = gap, 5
    gap = across(t[1] * m[0] - t[0] * m[3], a[0] * n[3] + a[1] * n[0], b[1] * n[8] + b[2] * n[7], m[6])
    if gap > best:
        best, which = gap, 6
    gap = across(t[1] * m[1] - t[0] * m[4], a[0] * n[4] + a[1] * n[1], b[2] * n[6] + b[0] * n[8], m[7])
    if gap > best:
        best, which = gap, 7
    gap = across(t[1] * m[2] - t[0] * m[5], a[0] * n[5] + a[1] * n[2], b[0] * n[7] + b[1] * n[6], m[8])
    if gap > best:
        best, which = gap, 8
    return best, which


@kernel
def transposed(m: Matrix) -> Matrix:
    """Transpose."""
    return m[0], m[3], m[6], m[1], m[4], m[7], m[2], m[5], m[8]


@kernel
def product(a: Matrix, b: Matrix) -> Matrix:
    """A^T B."""
    x = rotate_back(a, (b[0], b[3], b[6]))
    y = rotate_back(a, (b[1], b[4], b[7]))
    z = rotate_back(a, (b[2], b[5], b[8]))
    return x[0], y[0], z[0], x[1], y[1], z[1], x[2], y[2], z[2]


@kernel
def column(m: Matrix, k: int) -> Vector:
    """Column k."""
    if k == 0:
        return m[0], m[3], m[6]
    return (m[1], m[4], m[7]) if k == 1 else (m[2], m[5], m[8])


@kernel
def at(v: Vector, k: int) -> float:
    """Component k."""
    if k == 0:
        return v[0]
    return v[1] if k == 1 else v[2]


@kernel
def best_axis(
    c1: Vector, r1: Matrix, h1: Vector, c2: Vector, r2: Matrix, h2: Vector, prefer_faces: float, gap: float
) -> tuple[float, int]:
    """Largest gap, and its axis; if it is wider than ``gap`` along some axis, that is the last tried."""
    d = subtract(c2, c1)
    t, m = rotate_back(r1, d), product(r1, r2)
    best, axis = best_face(t, m, h1, h2)
    if best > gap:
        return best, axis
    second, which = best_face(rotate_back(r2, d), transposed(m), h2, h1)
    if second > gap:
        return second, 3 + which
    if second > best + prefer_faces:
        best, axis = second, 3 + which
    edges, which = best_edges(t, m, h1, h2)
    # Without a contact, the largest gap says most.
    if edges > best + (prefer_faces if edges <= 0.0 else 0.0):
        return edges, FACES + which
    return best, axis


@kernel
def axis_normal(c1: Vector, r1: Matrix, c2: Vector, r2: Matrix, axis: int) -> Vector:
    """Direction of an axis, from the first box to the second; none across parallel edges."""
    if axis < FACES:
        n = column(r1, axis) if axis < 3 else column(r2, axis - 3)
    else:
        n = cross(column(r1, (axis - FACES) // 3), column(r2, (axis - FACES) % 3))
        square = dot(n, n)
        n = scale(1.0 / np.sqrt(square) if square >= _PARALLEL else 0.0, n)
    return scale(1.0 if dot(n, subtract(c2, c1)) >= 0.0 else -1.0, n)


@kernel
def box_on_axis(
    c1: Vector, r1: Matrix, h1: Vector, c2: Vector, r2: Matrix, h2: Vector, axis: int, n: Vector,
    polygon: Floats, other: Floats, found: Floats,
) -> tuple[int, int]:  # fmt: skip
    """Put points of a contact along an axis with normal n in ``found`` (8, 8): place, depth, share, force.

    Returns their number, and which face of the other box a face meets.
    """
    if axis >= FACES:
        return crossing(c1, r1, h1, c2, r2, h2, (axis - FACES) // 3, (axis - FACES) % 3, n, found), 0
    if axis < 3:
        c, r, h, k, sign = c1, r1, h1, axis, 1.0
        c1, r1, h1 = c2, r2, h2
    else:
        c, r, h, k, sign = c2, r2, h2, axis - 3, -1.0
    return on_face(c, r, h, k, c1, r1, h1, scale(sign, n), sign, polygon, other, found)


@kernel
def box_on_box(
    c1: Vector, r1: Matrix, h1: Vector, c2: Vector, r2: Matrix, h2: Vector, prefer_faces: float,
    polygon: Floats, other: Floats, found: Floats,
) -> tuple[int, float, Vector, int]:  # fmt: skip
    """Contact of two boxes: the number of its points in ``found``, depth, normal, axis."""
    gap, axis = best_axis(c1, r1, h1, c2, r2, h2, prefer_faces, np.inf)
    n = axis_normal(c1, r1, c2, r2, axis)
    number = 0
    if gap < 0.0:
        number, _ = box_on_axis(c1, r1, h1, c2, r2, h2, axis, n, polygon, other, found)
    return number, -gap, n, axis


@kernel
def crossing(
    c1: Vector, r1: Matrix, h1: Vector, c2: Vector, r2: Matrix, h2: Vector, i: int, j: int, n: Vector,
    found: Floats,
) -> int:  # fmt: skip
    """Put the point between edge i of one box and edge j of the other into ``found``, if they cross."""
    e, f = column(r1, i), column(r2, j)
    # Middles of the two edges: the outermost ones along the normal.
    x, y = c1, c2
    for k in range(3):
        u, v = column(r1, k), column(r2, k)
        if k != i:
            x = add(x, scale(at(h1, k) if dot(u, n) > 0.0 else -at(h1, k), u))
        if k != j:
            y = add(y, scale(-at(h2, k) if dot(v, n) > 0.0 else at(h2, k), v))
    w, c = subtract(y, x), dot(e, f)
    depth, s2 = -dot(w, n), 1.0 - c * c
    if depth <= 0.0 or s2 < _PARALLEL:
        return 0
    s, t = (dot(w, e) - c * dot(w, f)) / s2, (c * dot(w, e) - dot(w, f)) / s2
    if abs(s) > at(h1, i) + depth or abs(t) > at(h2, j) + depth:
        return 0
    found[0, 0], found[0, 1], found[0, 2] = add(add(x, scale(s, e)), scale(-0.5 * depth, n))
    found[0, 3], found[0, 4] = depth, EDGE_SHARE
    found[0, 5], found[0, 6], found[0, 7] = n
    return 1


@kernel
def on_face(
    c1: Vector, r1: Matrix, h1: Vector, axis: int, c2: Vector, r2: Matrix, h2: Vector, n: Vector, sign: float,
    polygon: Floats, other: Floats, found: Floats,
) -> tuple[int, int]:  # fmt: skip
    """Put points of a box's face with outward normal n and of the other box into ``found``.

    Returns their number, and which face of the other box it is.

    Rows of ``polygon``: two coordinates and the height above the face, what the depth there loses as the
    other box moves along either, and on which sides of the face it is. Forces, on the other box times the
    sign, follow the gradient of the depth: a corner of the face is pushed along the normal of what it presses
    on.
    """
    u, v = column(r1, (axis + 1) % 3), column(r1, (axis + 2) % 3)
    hu, hv = at(h1, (axis + 1) % 3), at(h1, (axis + 2) % 3)
    face = add(c1, scale(at(h1, axis), n))
    # The face of the other that looks most against n.
    a = rotate_back(r2, n)
    k = 0
    if abs(a[1]) > abs(a[0]):
        k = 1
    if abs(a[2]) > abs(at(a, k)):
        k = 2
    e = scale(at(h2, (k + 1) % 3), column(r2, (k + 1) % 3))
    f = scale(at(h2, (k + 2) % 3), column(r2, (k + 2) % 3))
    m = column(r2, k)
    side = k + (3 if at(a, k) > 0.0 else 0)
    middle = subtract(add(c2, scale(-at(h2, k) if at(a, k) > 0.0 else at(h2, k), m)), face)
    for corner in range(4):
        se = 1.0 if corner == 1 or corner == 2 else -1.0
        sf = 1.0 if corner > 1 else -1.0
        p = add(middle, add(scale(se, e), scale(sf, f)))
        polygon[corner, 0], polygon[corner, 1], polygon[corner, 2] = dot(p, u), dot(p, v), dot(p, n)
        for c in range(3, 7):
            polygon[corner, c] = 0.0
    slope_u, slope_v = dot(m, u) / dot(m, n), dot(m, v) / dot(m, n)
    count = cut(polygon, 4, 0, 1.0, hu, slope_u, slope_v, other)
    count = cut(other, count, 0, -1.0, hu, slope_u, slope_v, polygon)
    count = cut(polygon, count, 1, 1.0, hv, slope_u, slope_v, other)
    count = cut(other, count, 1, -1.0, hv, slope_u, slope_v, polygon)
    around = 0.0
    for i in range(count):
        j = i + 1 if i + 1 < count else 0
        x, y = polygon[j, 0] - polygon[i, 0], polygon[j, 1] - polygon[i, 1]
        other[i, 0] = np.sqrt(x * x + y * y)
        around += other[i, 0]
    number = 0
    for i in range(count):
        depth = -polygon[i, 2]
        if depth > 0.0 and number < MOST_POINTS:
            before = other[i - 1 if i > 0 else count - 1, 0]
            p = add(face, add(scale(polygon[i, 0], u), add(scale(polygon[i, 1], v), scale(-0.5 * depth, n))))
            found[number, 0], found[number, 1], found[number, 2] = p
            found[number, 3] = depth
            # A corner stands for half of each side beside it, so that points may join or part without a jump.
            found[number, 4] = 0.5 * (before + other[i, 0]) / around if around > 0.0 else POINT_SHARE
            push = add(n, add(scale(polygon[i, 3], u), scale(polygon[i, 4], v)))
            found[number, 5], found[number, 6], found[number, 7] = scale(sign, push)
            number += 1
    return number, side


@kernel
def cut(
    polygon: Floats,
    count: int,
    k: int,
    sign: float,
    bound: float,
    slope_u: float,
    slope_v: float,
    out: Floats,
) -> int:
    """Keep the part of a polygon where sign times coordinate k is at most the bound; count its corners."""
    kept = 0
    for i in range(count):
        j = i + 1 if i + 1 < count else 0
        a, b = bound - sign * polygon[i, k], bound - sign * polygon[j, k]
        if a >= 0.0 and kept < len(out):
            for c in range(7):
                out[kept, c] = polygon[i, c]
            kept += 1
        # A line cuts a convex polygon twice, but rounding may see more of it.
        if (a >= 0.0) != (b >= 0.0) and kept < len(out):
            s = a / (a - b)
            for c in range(3):
                out[kept, c] = polygon[i, c] + s * (polygon[j, c] - polygon[i, c])
            for c in range(3, 7):
                out[kept, c] = 0.0
            # Between two points on one side of the face lies that side, and a corner of the face.
            side = 5 + 1 - k
            if polygon[i, side] != 0.0 and polygon[i, side] == polygon[j, side]:
                out[kept, 3], out[kept, 4], out[kept, side] = slope_u, slope_v, polygon[i, side]
            else:
                steep = (polygon[i, 2] - polygon[j, 2]) / (polygon[j, k] - polygon[i, k])
                out[kept, 3 + k] = min(max(steep, -STEEPEST), STEEPEST)
            out[kept, 5 + k] = sign
            kept += 1
    return kept
