"""Lennard-Jones, Coulomb and generalised-Born energies of pairs, in tiles of blocks and in lists.

Tiles compute all pairs at ``near`` or further, four at a time, bonded or not. Nearer pairs, among which the
repulsion of excluded ones would drown all other digits, come from a list without them. Exceptions are then
corrected one by one.
"""

import numpy as np
from numba import prange

from protochain.arrays import Floats, Integers
from protochain.energies.native.layout import (
    BORN,
    CHARGE,
    CHUNKS,
    FX,
    FY,
    FZ,
    GB_CHARGE,
    HALF_INVERSE_BORN,
    SCALAR,
    W,
    X,
    Y,
    Z,
    part,
    scalar,
    shared,
    tiled,
    variant,
)  # fmt: skip
from protochain.energies.native.series import exponential, sixteen

# Arrays are passed one by one: NamedTuples of them give the same bits, but numba's dispatch then costs 1 to
# 6 % of an energy of 1l2y (7 to 22 us) and 1 to 3 % of one of 1ubq, on 2 threads.

CLOSEST = 1e-12
"""nm^2. Smallest squared distance: coincident atoms give large, not infinite, numbers."""


@shared
def pair_sums(
    atoms: Floats, lj: Floats, lj_type: Integers, tiles: Integers, is_near: np.ndarray, near: float,
    cutoff: float, krf: float, crf: float, sums: Floats, energies: Floats,
) -> None:  # fmt: skip
    """Add Lennard-Jones and Coulomb forces and energies of all tiles, by chunk."""
    for c in prange(CHUNKS):
        begin, end = part(len(tiles), c)
        energy = 0.0
        for k in range(begin, end):
            i, j = tiles[k, 0], tiles[k, 1]
            masked = is_near[k] or cutoff < np.inf
            energy += pair_tile(
                atoms[i], atoms[j], lj[j], lj_type[i], i == j, masked, near * near, cutoff * cutoff, krf, crf,
                sums[c, i], sums[c, j],
            )  # fmt: skip
        energies[c] += energy


@tiled
def pair_tile(
    a: Floats, b: Floats, lj: Floats, lj_type: Integers, same: bool, masked: bool, near2: float,
    cutoff2: float, krf: float, crf: float, a_sums: Floats, b_sums: Floats,
) -> float:  # fmt: skip
    """Energy of two blocks in vacuum, without masks where all pairs are apart."""
    if masked:
        return _pairs(a, b, lj, lj_type, same, True, near2, cutoff2, krf, crf, a_sums, b_sums)
    return _pairs(a, b, lj, lj_type, same, False, near2, cutoff2, krf, crf, a_sums, b_sums)


@variant
def _pairs(
    a: Floats, b: Floats, lj: Floats, lj_type: Integers, same: bool, masked: bool, near2: float,
    cutoff2: float, krf: float, crf: float, a_sums: Floats, b_sums: Floats,
) -> float:  # fmt: skip
    """Add forces, return the energy.

    ``lj`` holds, for each type of the atom in a, 12 A and 6 B of its A/r^12 - B/r^6 with each atom of b.
    """
    repulsion, attraction, coulomb = 0.0, 0.0, 0.0
    for i in range(W):
        xi, yi, zi, qi, first = a[X * W + i], a[Y * W + i], a[Z * W + i], a[CHARGE * W + i], i if same else -1
        row = lj[lj_type[i]]
        fx, fy, fz = 0.0, 0.0, 0.0
        for j in range(W):
            dx, dy, dz = xi - b[X * W + j], yi - b[Y * W + j], zi - b[Z * W + j]
            r2 = dx * dx + dy * dy + dz * dz
            inverse, qq = 1.0 / np.sqrt(r2), qi * b[CHARGE * W + j]
            if masked:
                inside = (r2 >= near2) & (r2 < cutoff2) & (j > first)
                inverse, qq = inverse if inside else 0.0, qq if inside else 0.0
            inverse2 = inverse * inverse
            inverse6 = inverse2 * inverse2 * inverse2
            twelve, six = row[j] * inverse6 * inverse6, row[W + j] * inverse6
            repulsion += twelve
            attraction += six
            coulomb += qq * inverse
            f = (twelve - six + qq * inverse) * inverse2
            if masked:
                coulomb += qq * (krf * r2 - crf)
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
    return repulsion / 12.0 - attraction / 6.0 + coulomb


@shared
def solvated_pair_sums(
    atoms: Floats, lj: Floats, lj_type: Integers, tiles: Integers, is_near: np.ndarray, near: float,
    cutoff: float, krf: float, crf: float, exp: Floats, sums: Floats, energies: Floats,
    gb_energies: Floats,
) -> None:  # fmt: skip
    """As :func:`pair_sums`, with the generalised-Born energy and its derivatives by Born radii."""
    for c in prange(CHUNKS):
        begin, end = part(len(tiles), c)
        energy, gb_energy = 0.0, 0.0
        for k in range(begin, end):
            i, j = tiles[k, 0], tiles[k, 1]
            masked = is_near[k] or cutoff < np.inf
            pair, gb = solvated_tile(
                atoms[i], atoms[j], lj[j], lj_type[i], i == j, masked, near * near, cutoff * cutoff, krf, crf,
                1.0 / cutoff, exp, sums[c, i], sums[c, j],
            )  # fmt: skip
            energy += pair
            gb_energy += gb
        energies[c] += energy
        gb_energies[c] += gb_energy


@tiled
def solvated_tile(
    a: Floats, b: Floats, lj: Floats, lj_type: Integers, same: bool, masked: bool, near2: float,
    cutoff2: float, krf: float, crf: float, shift: float, exp: Floats, a_sums: Floats, b_sums: Floats,
) -> tuple[float, float]:  # fmt: skip
    """Energies of two blocks: as :func:`pair_tile`, and -q q / f with f^2 = r^2 + P exp(-r^2 / 4P), P = B B.

    Still, Tempczyk, Hawley, Hendrickson, JACS 112:6127 (1990).
    """
    if masked:
        return _solvated(a, b, lj, lj_type, same, True, near2, cutoff2, krf, crf, shift, exp, a_sums, b_sums)
    return _solvated(a, b, lj, lj_type, same, False, near2, cutoff2, krf, crf, shift, exp, a_sums, b_sums)


@variant
def _solvated(
    a: Floats, b: Floats, lj: Floats, lj_type: Integers, same: bool, masked: bool, near2: float,
    cutoff2: float, krf: float, crf: float, shift: float, exp: Floats, a_sums: Floats, b_sums: Floats,
) -> tuple[float, float]:  # fmt: skip
    """Add forces and dE/dB, return the energies."""
    c = sixteen(exp)
    repulsion, attraction, coulomb, polar = 0.0, 0.0, 0.0, 0.0
    for i in range(W):
        xi, yi, zi, qi, first = a[X * W + i], a[Y * W + i], a[Z * W + i], a[CHARGE * W + i], i if same else -1
        gi, born, half = a[GB_CHARGE * W + i], a[BORN * W + i], a[HALF_INVERSE_BORN * W + i]
        row = lj[lj_type[i]]
        fx, fy, fz, slope = 0.0, 0.0, 0.0, 0.0
        for j in range(W):
            dx, dy, dz = xi - b[X * W + j], yi - b[Y * W + j], zi - b[Z * W + j]
            r2 = dx * dx + dy * dy + dz * dz
            d = r2 * half * b[HALF_INVERSE_BORN * W + j]
            decay = exponential(d, c)
            inverse_f = 1.0 / np.sqrt(r2 + born * b[BORN * W + j] * decay)
            inverse, qq, g = 1.0 / np.sqrt(r2), qi * b[CHARGE * W + j], gi * b[GB_CHARGE * W + j]
            if masked:
                inside = (r2 < cutoff2) & (j > first)
                apart = inside & (r2 >= near2)
                inverse, qq, g = inverse if apart else 0.0, qq if apart else 0.0, g if inside else 0.0
            inverse2 = inverse * inverse
            inverse6 = inverse2 * inverse2 * inverse2
            twelve, six = row[j] * inverse6 * inverse6, row[W + j] * inverse6
            repulsion += twelve
            attraction += six
            coulomb += qq * inverse
            polar += g * inverse_f
            cube = g * inverse_f * inverse_f * inverse_f
            with_born = 0.5 * cube * decay * (1.0 + d)
            slope += with_born * b[BORN * W + j]
            f = (twelve - six + qq * inverse) * inverse2 - cube * (1.0 - 0.25 * decay)
            if masked:
                coulomb += qq * (krf * r2 - crf)
                polar -= g * shift
                f -= 2.0 * krf * qq
            fx += f * dx
            fy += f * dy
            fz += f * dz
            b_sums[FX * W + j] -= f * dx
            b_sums[FY * W + j] -= f * dy
            b_sums[FZ * W + j] -= f * dz
            b_sums[SCALAR * W + j] += with_born * born
        a_sums[FX * W + i] += fx
        a_sums[FY * W + i] += fy
        a_sums[FZ * W + i] += fz
        a_sums[SCALAR * W + i] += slope
    return repulsion / 12.0 - attraction / 6.0 + coulomb, -polar


@shared
def near_sums(
    x: Floats, charge: Floats, a12: Floats, b6: Floats, lj_type: Integers, pairs: Integers, near: float,
    krf: float, crf: float, sums: Floats, energies: Floats,
) -> None:  # fmt: skip
    """Add Lennard-Jones and Coulomb of the listed pairs nearer than ``near``."""
    for c in prange(CHUNKS):
        begin, end = part(len(pairs), c)
        energy = 0.0
        for k in range(begin, end):
            i, j = pairs[k, 0], pairs[k, 1]
            dx, dy, dz, r2 = difference(x, i, j)
            if r2 < near * near:
                kind, other = lj_type[i], lj_type[j]
                e, f = lj_coulomb(r2, a12[kind, other], b6[kind, other], charge[i] * charge[j], krf, crf)
                energy += e
                push(sums[c], i, j, f * dx, f * dy, f * dz)
        energies[c] += energy


@shared
def exception_sums(
    x: Floats, charge: Floats, a12: Floats, b6: Floats, lj_type: Integers, pairs: Integers,
    parameters: Floats, near: float, cutoff: float, krf: float, crf: float, sums: Floats, energies: Floats,
) -> None:  # fmt: skip
    """Add exceptions, pairs with their own parameters (A, B, q q), and subtract what the tiles computed."""
    for c in prange(CHUNKS):
        begin, end = part(len(pairs), c)
        energy = 0.0
        for k in range(begin, end):
            i, j = pairs[k, 0], pairs[k, 1]
            dx, dy, dz, r2 = difference(x, i, j)
            e, f = lj_coulomb(r2, parameters[k, 0], parameters[k, 1], parameters[k, 2], 0.0, 0.0)
            if near * near <= r2 < cutoff * cutoff:
                kind, other = lj_type[i], lj_type[j]
                had = lj_coulomb(r2, a12[kind, other], b6[kind, other], charge[i] * charge[j], krf, crf)
                e, f = e - had[0], f - had[1]
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
