"""Lennard-Jones and Coulomb energies of pairs, in tiles of blocks and in lists.

Tiles compute all pairs at ``near`` or further, bonded or not, as vectors. Closer pairs come from a list
without excluded pairs, whose repulsion would drown all other digits. Exceptions are corrected one by one.
"""

import numpy as np

from protochain.core.arrays import Floats, Integers
from protochain.energies.native.layout import (
    CHARGE,
    FX,
    FY,
    FZ,
    PULL,
    S2,
    S3,
    Share,
    W,
    X,
    Y,
    Z,
    box_distance2,
    chunk_kernel,
    far_rows2,
    part,
    scalar,
    tile_kernel,
    variant,
)  # fmt: skip
from protochain.energies.native.series import inverse_root, slope_series

# Arrays are separate arguments. NamedTuples give the same bits, but numba's dispatch then costs 1 to 6 % of
# an energy of 1l2y (7 to 22 us) and 1 to 3 % of an energy of 1ubq, on 2 threads.

CLOSEST = 1e-12
"""nm^2. Smallest squared distance, so that coincident atoms give large, not infinite, numbers."""


@chunk_kernel
def pair_sums(
    chunks: Share, atoms: Floats, lj: Floats, lj_type: Integers, tiles: Integers, is_near: np.ndarray,
    near: float, block_near: Floats, cutoff: float, krf: float, crf: float, sums: Floats, energies: Floats,
) -> None:  # fmt: skip
    """Add Lennard-Jones and Coulomb forces and energies of all tiles, by chunk."""
    for c in range(*chunks):
        begin, end = part(len(tiles), c)
        energy, inverses = 0.0, np.empty(W)
        for k in range(begin, end):
            i, j = tiles[k, 0], tiles[k, 1]
            far2 = far_rows2(is_near[k], block_near[i], block_near[j], cutoff)
            energy += _pair_tile(
                atoms[i], atoms[j], lj[j], lj_type[i], i == j, near * near, far2, cutoff * cutoff, krf, crf,
                inverses, sums[c, i], sums[c, j],
            )  # fmt: skip
        energies[c] += energy


@chunk_kernel
def solvated_pair_sums(
    chunks: Share, atoms: Floats, lj: Floats, lj_type: Integers, tiles: Integers, is_near: np.ndarray,
    near: float, block_near: Floats, cutoff: float, krf: float, crf: float, sums: Floats, energies: Floats,
) -> None:  # fmt: skip
    """As :func:`pair_sums`, with the forces of the Born integrals, given dE/d(integral) of each atom."""
    # Together, because both require inverse distances.
    for c in range(*chunks):
        begin, end = part(len(tiles), c)
        energy, inverses = 0.0, np.empty(W)
        for k in range(begin, end):
            i, j = tiles[k, 0], tiles[k, 1]
            far2 = far_rows2(is_near[k], block_near[i], block_near[j], cutoff)
            energy += _solvated_tile(
                atoms[i], atoms[j], lj[j], lj_type[i], i == j, near * near, far2, cutoff * cutoff, krf, crf,
                inverses, sums[c, i], sums[c, j],
            )  # fmt: skip
        energies[c] += energy


@tile_kernel
def _pair_tile(
    a: Floats, b: Floats, lj: Floats, lj_type: Integers, same: bool, near2: float, far2: float,
    cutoff2: float, krf: float, crf: float, inverses: Floats, a_sums: Floats, b_sums: Floats,
) -> float:  # fmt: skip
    """Energy of two blocks in vacuum."""
    return _tile(
        a, b, lj, lj_type, same, near2, far2, cutoff2, False, krf, crf, inverses, a_sums, b_sums
    )  # fmt: skip


@tile_kernel
def _solvated_tile(
    a: Floats, b: Floats, lj: Floats, lj_type: Integers, same: bool, near2: float, far2: float,
    cutoff2: float, krf: float, crf: float, inverses: Floats, a_sums: Floats, b_sums: Floats,
) -> float:  # fmt: skip
    """As :func:`_pair_tile`, with the forces of the Born integrals."""
    return _tile(a, b, lj, lj_type, same, near2, far2, cutoff2, True, krf, crf, inverses, a_sums, b_sums)


@variant
def _tile(
    a: Floats, b: Floats, lj: Floats, lj_type: Integers, same: bool, near2: float, far2: float,
    cutoff2: float, in_solvent: bool, krf: float, crf: float, inverses: Floats, a_sums: Floats,
    b_sums: Floats,
) -> float:  # fmt: skip
    """Compute the rows of a tile, with masks only for atoms near the block."""
    energy = 0.0
    for i in range(W):
        row, first = lj[lj_type[i]], i if same else -1
        if box_distance2(a, i, b) < far2:
            put_inverses(a, i, b, first, True, near2, cutoff2, inverses)
            energy += add_pairs(a, i, b, row, True, in_solvent, krf, crf, inverses, a_sums, b_sums)
        else:
            put_inverses(a, i, b, first, False, near2, cutoff2, inverses)
            energy += add_pairs(a, i, b, row, False, in_solvent, krf, crf, inverses, a_sums, b_sums)
    return energy


@variant
def put_inverses(
    a: Floats, i: int, b: Floats, first: int, masked: bool, near2: float, cutoff2: float, inverses: Floats
) -> None:
    """Write inverse distances of an atom from a block, 0 if masked."""
    # In a separate loop, because the processor executes shorter chains of dependences in parallel.
    xi, yi, zi = a[X * W + i], a[Y * W + i], a[Z * W + i]
    for j in range(W):
        dx, dy, dz = xi - b[X * W + j], yi - b[Y * W + j], zi - b[Z * W + j]
        r2 = dx * dx + dy * dy + dz * dz
        inverse = inverse_root(r2)
        if masked:
            inverse = inverse if (r2 >= near2) & (r2 < cutoff2) & (j > first) else 0.0
        inverses[j] = inverse


@variant
def add_pairs(
    a: Floats, i: int, b: Floats, row: Floats, masked: bool, in_solvent: bool, krf: float, crf: float,
    inverses: Floats, a_sums: Floats, b_sums: Floats,
) -> float:  # fmt: skip
    """Add the forces between an atom and a block, and return the energy."""
    # ``row`` has 12 A and 6 B of A/r^12 - B/r^6 of the atom with each atom of b.
    xi, yi, zi, qi = a[X * W + i], a[Y * W + i], a[Z * W + i], a[CHARGE * W + i]
    s2, s3, pull = a[S2 * W + i], a[S3 * W + i], a[PULL * W + i]
    energy, fx, fy, fz = 0.0, 0.0, 0.0, 0.0
    for j in range(W):
        dx, dy, dz = xi - b[X * W + j], yi - b[Y * W + j], zi - b[Z * W + j]
        inverse, qq = inverses[j], qi * b[CHARGE * W + j]
        inverse2 = inverse * inverse
        inverse6 = inverse2 * inverse2 * inverse2
        twelve, six, coulomb = row[j] * inverse6 * inverse6, row[W + j] * inverse6, qq * inverse
        energy += twelve * (1.0 / 12.0) - six * (1.0 / 6.0) + coulomb
        f = (twelve - six + coulomb) * inverse2
        if in_solvent:
            g, h = slope_series(b[S2 * W + j] * inverse2, masked), slope_series(s2 * inverse2, masked)
            f += (pull * b[S3 * W + j] * g + b[PULL * W + j] * s3 * h) * inverse6
        if masked:
            qq = qq if inverse > 0.0 else 0.0
            energy += qq * (krf * (dx * dx + dy * dy + dz * dz) - crf)
            f -= 2.0 * krf * qq
        fx += f * dx
        fy += f * dy
        fz += f * dz
        b_sums[FX * W + j] -= f * dx
        b_sums[FY * W + j] -= f * dy
        b_sums[FZ * W + j] -= f * dz
    a_sums[FX * W + i] += fx
    a_sums[FY * W + i] += fy
    a_sums[FZ * W + i] += fz
    return energy


@chunk_kernel
def near_sums(
    chunks: Share, x: Floats, charge: Floats, a12: Floats, b6: Floats, lj_type: Integers, pairs: Integers,
    near: float, krf: float, crf: float, sums: Floats, energies: Floats,
) -> None:  # fmt: skip
    """Add Lennard-Jones and Coulomb of the listed pairs nearer than ``near``."""
    for c in range(*chunks):
        begin, end = part(len(pairs), c)
        energy = 0.0
        for k in range(begin, end):
            i, j = pairs[k, 0], pairs[k, 1]
            dx, dy, dz, r2 = difference(x, i, j)
            if r2 < near * near:
                ti, tj = lj_type[i], lj_type[j]
                e, f = lj_coulomb(r2, a12[ti, tj], b6[ti, tj], charge[i] * charge[j], krf, crf)
                energy += e
                push(sums[c], i, j, f * dx, f * dy, f * dz)
        energies[c] += energy


@chunk_kernel
def exception_sums(
    chunks: Share, x: Floats, charge: Floats, a12: Floats, b6: Floats, lj_type: Integers, pairs: Integers,
    parameters: Floats, near: float, cutoff: float, krf: float, crf: float, sums: Floats, energies: Floats,
) -> None:  # fmt: skip
    """Add exceptions, pairs with their own parameters (A, B, q q), and subtract the values from tiles."""
    for c in range(*chunks):
        begin, end = part(len(pairs), c)
        energy = 0.0
        for k in range(begin, end):
            i, j = pairs[k, 0], pairs[k, 1]
            dx, dy, dz, r2 = difference(x, i, j)
            e, f = lj_coulomb(r2, parameters[k, 0], parameters[k, 1], parameters[k, 2], 0.0, 0.0)
            if near * near <= r2 < cutoff * cutoff:
                ti, tj = lj_type[i], lj_type[j]
                tile = lj_coulomb(r2, a12[ti, tj], b6[ti, tj], charge[i] * charge[j], krf, crf)
                e, f = e - tile[0], f - tile[1]
            energy += e
            push(sums[c], i, j, f * dx, f * dy, f * dz)
        energies[c] += energy


@scalar
def lj_coulomb(r2: float, a12: float, b6: float, qq: float, krf: float, crf: float) -> tuple[float, float]:
    """Energy, and force over distance, of A/r^12 - B/r^6 + q q (1/r + krf r^2 - crf)."""
    inverse2 = 1.0 / max(r2, CLOSEST)
    inverse6 = inverse2 * inverse2 * inverse2
    inverse = np.sqrt(inverse2)
    twelve, six = a12 * inverse6 * inverse6, b6 * inverse6
    energy = twelve - six + qq * (inverse + krf * r2 - crf)
    return energy, (12.0 * twelve - 6.0 * six + qq * inverse) * inverse2 - 2.0 * krf * qq


@scalar
def difference(x: Floats, i: int, j: int) -> tuple[float, float, float, float]:
    """Vector from atom j to atom i, and its squared length."""
    dx, dy, dz = x[i, 0] - x[j, 0], x[i, 1] - x[j, 1], x[i, 2] - x[j, 2]
    return dx, dy, dz, dx * dx + dy * dy + dz * dz


@scalar
def push(sums: Floats, i: int, j: int, fx: float, fy: float, fz: float) -> None:
    """Add a force to atom i and its opposite to atom j."""
    bi, ki, bj, kj = i // W, i % W, j // W, j % W
    sums[bi, FX * W + ki] += fx
    sums[bi, FY * W + ki] += fy
    sums[bi, FZ * W + ki] += fz
    sums[bj, FX * W + kj] -= fx
    sums[bj, FY * W + kj] -= fy
    sums[bj, FZ * W + kj] -= fz
