"""Vectors and 3x3 matrices as tuples, which the compiler stores in registers.

A symmetric matrix is (xx, xy, xz, yy, yz, zz), a general one row by row. Spatial quantities are pairs,
rotation first, about a hinge point and along world axes: a twist is (omega, u), a wrench (moment, force).
"""

from collections.abc import Callable
from typing import Any, TypeVar, cast

from protochain.core.arrays import Floats
from protochain.core.compilation import njit
from protochain.mechanics.multibody.tree import FIRST_MOMENT, MASS, SECOND_MOMENTS

Vector = tuple[float, float, float]
Symmetric = tuple[float, float, float, float, float, float]
Matrix = tuple[float, float, float, float, float, float, float, float, float]
Inertia = tuple[Symmetric, Matrix, Symmetric]
"""6x6 spatial inertia (I, C, M): moment = I omega + C u, force = C^T omega + M u."""

ZERO: Vector = (0.0, 0.0, 0.0)
IDENTITY: Matrix = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
MASSLESS: Inertia = (
    (0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    (0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
)

F = TypeVar("F", bound=Callable[..., Any])


def kernel(function: F) -> F:
    """Compile a sweep, with fused products and sums, which round once instead of twice."""
    # Functions that a sweep calls are inlined. Otherwise libraries with copies of one function share the copy
    # that was loaded first, and copies round differently: results would depend on earlier calls.
    # Arrays are separate arguments: a NamedTuple of them costs 1.7 us a call (solve at 100 hinges: + 60 %).
    compile_it = njit(cache=True, error_model="numpy", fastmath={"contract"}, forceinline=True)
    return cast(F, compile_it(function))


def inner_kernel(function: F) -> F:
    """Compile a part of other kernels, without machine code unless Python calls it."""
    compile_it = njit(inner=True, cache=True, error_model="numpy", fastmath={"contract"}, forceinline=True)
    return cast(F, compile_it(function))


@inner_kernel
def vector(array: Floats, b: int, start: int = 0) -> Vector:
    return array[b, start], array[b, start + 1], array[b, start + 2]


@inner_kernel
def vector_at(array: Floats, k: int) -> Vector:
    return array[k], array[k + 1], array[k + 2]


@inner_kernel
def hinge_axis(rotation: Floats, b: int) -> Vector:
    return rotation[b, 0, 2], rotation[b, 1, 2], rotation[b, 2, 2]


@inner_kernel
def lever(origin: Floats, b: int, p: int) -> Vector:
    """Vector from the origin of body p to the origin of body b."""
    return origin[b, 0] - origin[p, 0], origin[b, 1] - origin[p, 1], origin[b, 2] - origin[p, 2]


@inner_kernel
def matrix(array: Floats, b: int) -> Matrix:
    return (
        array[b, 0, 0], array[b, 0, 1], array[b, 0, 2],
        array[b, 1, 0], array[b, 1, 1], array[b, 1, 2],
        array[b, 2, 0], array[b, 2, 1], array[b, 2, 2],
    )  # fmt: skip


@inner_kernel
def put(v: Vector, array: Floats, b: int, start: int) -> None:
    array[b, start], array[b, start + 1], array[b, start + 2] = v


@inner_kernel
def put_at(v: Vector, array: Floats, k: int) -> None:
    array[k], array[k + 1], array[k + 2] = v


@inner_kernel
def put_matrix(m: Matrix, array: Floats, b: int) -> None:
    array[b, 0, 0], array[b, 0, 1], array[b, 0, 2] = m[0], m[1], m[2]
    array[b, 1, 0], array[b, 1, 1], array[b, 1, 2] = m[3], m[4], m[5]
    array[b, 2, 0], array[b, 2, 1], array[b, 2, 2] = m[6], m[7], m[8]


@inner_kernel
def pair(array: Floats, b: int) -> tuple[Vector, Vector]:
    """Twist or wrench of body b."""
    return (array[b, 0], array[b, 1], array[b, 2]), (array[b, 3], array[b, 4], array[b, 5])


@inner_kernel
def put_pair(first: Vector, second: Vector, array: Floats, b: int) -> None:
    array[b, 0], array[b, 1], array[b, 2] = first
    array[b, 3], array[b, 4], array[b, 5] = second


@inner_kernel
def add_pair(first: Vector, second: Vector, array: Floats, b: int) -> None:
    array[b, 0] += first[0]
    array[b, 1] += first[1]
    array[b, 2] += first[2]
    array[b, 3] += second[0]
    array[b, 4] += second[1]
    array[b, 5] += second[2]


@inner_kernel
def add(a: Vector, b: Vector) -> Vector:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@inner_kernel
def subtract(a: Vector, b: Vector) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@inner_kernel
def scale(s: float, a: Vector) -> Vector:
    return s * a[0], s * a[1], s * a[2]


@inner_kernel
def freedom(axis: Vector, turn: float, slide: float, n_v: int, j: int) -> tuple[Vector, Vector]:
    """Twist of a body per unit of its j-th velocity."""
    if n_v == 1:
        return scale(turn, axis), scale(slide, axis)
    return (
        (1.0 * (j == 0), 1.0 * (j == 1), 1.0 * (j == 2)),
        (1.0 * (j == 3), 1.0 * (j == 4), 1.0 * (j == 5)),
    )


@inner_kernel
def dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inner_kernel
def cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inner_kernel
def rotate(r: Matrix, a: Vector) -> Vector:
    """Product R a."""
    return (
        r[0] * a[0] + r[1] * a[1] + r[2] * a[2],
        r[3] * a[0] + r[4] * a[1] + r[5] * a[2],
        r[6] * a[0] + r[7] * a[1] + r[8] * a[2],
    )


@inner_kernel
def rotate_back(r: Matrix, a: Vector) -> Vector:
    """Product R^T a."""
    return (
        r[0] * a[0] + r[3] * a[1] + r[6] * a[2],
        r[1] * a[0] + r[4] * a[1] + r[7] * a[2],
        r[2] * a[0] + r[5] * a[1] + r[8] * a[2],
    )


@inner_kernel
def symmetric_times(s: Symmetric, a: Vector) -> Vector:
    return (
        s[0] * a[0] + s[1] * a[1] + s[2] * a[2],
        s[1] * a[0] + s[3] * a[1] + s[4] * a[2],
        s[2] * a[0] + s[4] * a[1] + s[5] * a[2],
    )


@inner_kernel
def rotate_inertia(r: Matrix, s: Symmetric) -> Symmetric:
    """Product R S R^T."""
    x = symmetric_times(s, (r[0], r[1], r[2]))
    y = symmetric_times(s, (r[3], r[4], r[5]))
    z = symmetric_times(s, (r[6], r[7], r[8]))
    return (
        r[0] * x[0] + r[1] * x[1] + r[2] * x[2],
        r[3] * x[0] + r[4] * x[1] + r[5] * x[2],
        r[6] * x[0] + r[7] * x[1] + r[8] * x[2],
        r[3] * y[0] + r[4] * y[1] + r[5] * y[2],
        r[6] * y[0] + r[7] * y[1] + r[8] * y[2],
        r[6] * z[0] + r[7] * z[1] + r[8] * z[2],
    )


@inner_kernel
def inertia(p: Floats, b: int) -> Inertia:
    return (
        (p[b, 0], p[b, 1], p[b, 2], p[b, 3], p[b, 4], p[b, 5]),
        (p[b, 6], p[b, 7], p[b, 8], p[b, 9], p[b, 10], p[b, 11], p[b, 12], p[b, 13], p[b, 14]),
        (p[b, 15], p[b, 16], p[b, 17], p[b, 18], p[b, 19], p[b, 20]),
    )


@inner_kernel
def put_inertia(p: Inertia, out: Floats, b: int) -> None:
    i, c, m = p
    out[b, 0], out[b, 1], out[b, 2], out[b, 3], out[b, 4], out[b, 5] = i
    out[b, 6], out[b, 7], out[b, 8], out[b, 9], out[b, 10], out[b, 11] = c[0], c[1], c[2], c[3], c[4], c[5]
    out[b, 12], out[b, 13], out[b, 14] = c[6], c[7], c[8]
    out[b, 15], out[b, 16], out[b, 17], out[b, 18], out[b, 19], out[b, 20] = m


@inner_kernel
def add_inertias(p: Inertia, q: Inertia) -> Inertia:
    i, c, m = p
    j, d, n = q
    return (
        (i[0] + j[0], i[1] + j[1], i[2] + j[2], i[3] + j[3], i[4] + j[4], i[5] + j[5]),
        (
            c[0] + d[0], c[1] + d[1], c[2] + d[2], c[3] + d[3], c[4] + d[4], c[5] + d[5], c[6] + d[6],
            c[7] + d[7], c[8] + d[8],
        ),
        (m[0] + n[0], m[1] + n[1], m[2] + n[2], m[3] + n[3], m[4] + n[4], m[5] + n[5]),
    )  # fmt: skip


@inner_kernel
def add_inertia(p: Inertia, out: Floats, b: int) -> None:
    put_inertia(add_inertias(inertia(out, b), p), out, b)


@inner_kernel
def rigid_inertia(turn: Matrix, bodies: Floats, b: int) -> tuple[float, Vector, Symmetric]:
    """Mass, first moment and moments of inertia of body b about its origin, along world axes."""
    first = vector(bodies, b, FIRST_MOMENT)
    x, y = vector(bodies, b, SECOND_MOMENTS), vector(bodies, b, SECOND_MOMENTS + 3)
    return bodies[b, MASS], rotate(turn, first), rotate_inertia(turn, (x[0], x[1], x[2], y[0], y[1], y[2]))


@inner_kernel
def add_rigid(p: Inertia, rigid: tuple[float, Vector, Symmetric]) -> Inertia:
    """Sum of a spatial inertia and the inertia of a rigid body: C = [m c]x, M = m 1."""
    i, c, m = p
    mass, (x, y, z), s = rigid
    return (
        (i[0] + s[0], i[1] + s[1], i[2] + s[2], i[3] + s[3], i[4] + s[4], i[5] + s[5]),
        (c[0], c[1] - z, c[2] + y, c[3] + z, c[4], c[5] - x, c[6] - y, c[7] + x, c[8]),
        (m[0] + mass, m[1], m[2], m[3] + mass, m[4], m[5] + mass),
    )


@inner_kernel
def inertia_times(p: Inertia, omega: Vector, u: Vector) -> tuple[Vector, Vector]:
    """Wrench of a twist."""
    i, c, m = p
    return (add(symmetric_times(i, omega), rotate(c, u)), add(rotate_back(c, omega), symmetric_times(m, u)))


@inner_kernel
def minus_outer(p: Inertia, moment: Vector, force: Vector, weight: float) -> Inertia:
    """P - weight w w^T for the wrench w = (moment, force)."""
    i, c, m = p
    nx, ny, nz = moment
    fx, fy, fz = force
    ax, ay, az = weight * nx, weight * ny, weight * nz
    bx, by, bz = weight * fx, weight * fy, weight * fz
    return (
        (i[0] - ax * nx, i[1] - ax * ny, i[2] - ax * nz, i[3] - ay * ny, i[4] - ay * nz, i[5] - az * nz),
        (
            c[0] - ax * fx, c[1] - ax * fy, c[2] - ax * fz,
            c[3] - ay * fx, c[4] - ay * fy, c[5] - ay * fz,
            c[6] - az * fx, c[7] - az * fy, c[8] - az * fz,
        ),
        (m[0] - bx * fx, m[1] - bx * fy, m[2] - bx * fz, m[3] - by * fy, m[4] - by * fz, m[5] - bz * fz),
    )  # fmt: skip


@inner_kernel
def shifted_inertia(p: Inertia, lever: Vector) -> Inertia:
    """Return the same inertia about a point that lies ``-lever`` away."""
    # With L = [lever]x: C' = C + L M and I' = I + L C^T - C' L.
    i, c, m = p
    x = cross(lever, (m[0], m[1], m[2]))
    y = cross(lever, (m[1], m[3], m[4]))
    z = cross(lever, (m[2], m[4], m[5]))
    d = (
        c[0] + x[0], c[1] + y[0], c[2] + z[0],
        c[3] + x[1], c[4] + y[1], c[5] + z[1],
        c[6] + x[2], c[7] + y[2], c[8] + z[2],
    )  # fmt: skip
    c0, c1, c2 = (c[0], c[1], c[2]), (c[3], c[4], c[5]), (c[6], c[7], c[8])
    a0, a1, a2 = cross(lever, c0), cross(lever, c1), cross(lever, c2)
    b0, b1 = cross(lever, (d[0], d[1], d[2])), cross(lever, (d[3], d[4], d[5]))
    b2 = cross(lever, (d[6], d[7], d[8]))
    return (
        (
            i[0] + a0[0] + b0[0], i[1] + a1[0] + b0[1], i[2] + a2[0] + b0[2],
            i[3] + a1[1] + b1[1], i[4] + a2[1] + b1[2], i[5] + a2[2] + b2[2],
        ),
        d,
        m,
    )  # fmt: skip
