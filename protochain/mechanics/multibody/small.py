"""Dense matrices of up to six rows inside kernels: Cholesky's factor and its triangular solves."""

import numpy as np

from protochain.core.arrays import Floats
from protochain.mechanics.multibody.algebra import kernel


@kernel
def cholesky(a: Floats, n: int) -> bool:
    """Overwrite the lower triangle of a's first n rows by L, L L^T = a. Return False if a is not positive."""
    for j in range(n):
        diagonal = a[j, j]
        for k in range(j):
            a[j, j] -= a[j, k] * a[j, k]
        # A pivot whose digits have all cancelled is rounding error.
        if not a[j, j] > 1e-15 * diagonal:
            return False
        a[j, j] = np.sqrt(a[j, j])
        for i in range(j + 1, n):
            for k in range(j):
                a[i, j] -= a[i, k] * a[j, k]
            a[i, j] /= a[j, j]
    return True


@kernel
def solve_lower(factor: Floats, n: int, x: Floats) -> None:
    """Overwrite x by L^-1 x."""
    for i in range(n):
        for k in range(i):
            x[i] -= factor[i, k] * x[k]
        x[i] /= factor[i, i]


@kernel
def solve_upper(factor: Floats, n: int, x: Floats) -> None:
    """Overwrite x by L^-T x."""
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            x[i] -= factor[k, i] * x[k]
        x[i] /= factor[i, i]


@kernel
def dense_inertia(packed: Floats, out: Floats) -> None:
    """Packed spatial inertia (I, C, M) -> the 6x6 matrix [[I, C], [C^T, M]]."""
    for block, start in ((0, 0), (3, 15)):
        k = start
        for i in range(3):
            for j in range(i, 3):
                out[block + i, block + j] = packed[k]
                out[block + j, block + i] = packed[k]
                k += 1
    for i in range(3):
        for j in range(3):
            out[i, 3 + j] = packed[6 + 3 * i + j]
            out[3 + j, i] = packed[6 + 3 * i + j]
