"""Necks of GBn and GBn2: gaps between two atoms too narrow for water.

Mongan, Simmerling, McCammon, Case, Onufriev, J. Chem. Theory Comput. 3:156 (2007).
"""

import numpy as np
from numba import prange

from protochain.arrays import Floats, Integers
from protochain.energies.native.layout import (
    CHUNKS,
    FX,
    FY,
    FZ,
    PULL,
    SCALAR,
    W,
    X,
    Y,
    Z,
    part,
    shared,
    tiled,
)  # fmt: skip

REACH = 0.68
"""nm. Largest distance between the surfaces of two atoms with a neck."""
HEIGHT_I, PLACE_I, HEIGHT_J, PLACE_J, REACH2 = range(5)
"""Rows for each type of atom i beside a block of atoms j: height and position of the neck's peak for i and
for j, square of the distance at which it ends."""
_WIDE, _STEEP = 100.0, 0.3e6
"""1/nm^2 and 1/nm^6: a neck of unit height is 1 / (1 + 100 d^2 + 300000 d^6)."""


@shared
def neck_sums(
    atoms: Floats, necks: Floats, neck_type: Integers, tiles: Integers, cutoff: float, sums: Floats
) -> None:
    """Add the necks' contributions to the Born integrals to row SCALAR of the sums."""
    for c in prange(CHUNKS):
        begin, end = part(len(tiles), c)
        for k in range(begin, end):
            i, j = tiles[k, 0], tiles[k, 1]
            _neck_tile(
                atoms[i], atoms[j], necks[j], neck_type[i], i == j, cutoff * cutoff, sums[c, i], sums[c, j]
            )


@tiled
def _neck_tile(
    a: Floats, b: Floats, necks: Floats, neck_type: Integers, same: bool, cutoff2: float, a_sums: Floats,
    b_sums: Floats,
) -> None:  # fmt: skip
    for i in range(W):
        xi, yi, zi, first = a[X * W + i], a[Y * W + i], a[Z * W + i], i if same else -1
        row = necks[neck_type[i]]
        total = 0.0
        for j in range(W):
            dx, dy, dz = xi - b[X * W + j], yi - b[Y * W + j], zi - b[Z * W + j]
            r2 = dx * dx + dy * dy + dz * dz
            r = np.sqrt(r2)
            inside = (r2 <= row[REACH2 * W + j]) & (r2 < cutoff2) & (j > first)
            di, dj = r - row[PLACE_I * W + j], r - row[PLACE_J * W + j]
            di2, dj2 = di * di, dj * dj
            of_i = row[HEIGHT_I * W + j] / (1.0 + di2 * (_WIDE + _STEEP * di2 * di2))
            of_j = row[HEIGHT_J * W + j] / (1.0 + dj2 * (_WIDE + _STEEP * dj2 * dj2))
            total += of_i if inside else 0.0
            b_sums[SCALAR * W + j] += of_j if inside else 0.0
        a_sums[SCALAR * W + i] += total


@shared
def neck_force_sums(
    atoms: Floats, necks: Floats, neck_type: Integers, tiles: Integers, cutoff: float, sums: Floats
) -> None:
    """Add the forces of the necks, given dE/d(integral) of each atom."""
    for c in prange(CHUNKS):
        begin, end = part(len(tiles), c)
        for k in range(begin, end):
            i, j = tiles[k, 0], tiles[k, 1]
            _neck_force_tile(
                atoms[i], atoms[j], necks[j], neck_type[i], i == j, cutoff * cutoff, sums[c, i], sums[c, j]
            )


@tiled
def _neck_force_tile(
    a: Floats, b: Floats, necks: Floats, neck_type: Integers, same: bool, cutoff2: float, a_sums: Floats,
    b_sums: Floats,
) -> None:  # fmt: skip
    for i in range(W):
        xi, yi, zi, first = a[X * W + i], a[Y * W + i], a[Z * W + i], i if same else -1
        row, pull = necks[neck_type[i]], a[PULL * W + i]
        fx, fy, fz = 0.0, 0.0, 0.0
        for j in range(W):
            dx, dy, dz = xi - b[X * W + j], yi - b[Y * W + j], zi - b[Z * W + j]
            r2 = dx * dx + dy * dy + dz * dz
            inside = (r2 <= row[REACH2 * W + j]) & (r2 < cutoff2) & (j > first) & (r2 > 0.0)
            inverse = 1.0 / np.sqrt(r2)
            inverse = inverse if inside else 0.0
            r = r2 * inverse
            di, dj = r - row[PLACE_I * W + j], r - row[PLACE_J * W + j]
            di2, dj2 = di * di, dj * dj
            ui = 1.0 / (1.0 + di2 * (_WIDE + _STEEP * di2 * di2))
            uj = 1.0 / (1.0 + dj2 * (_WIDE + _STEEP * dj2 * dj2))
            fi = pull * row[HEIGHT_I * W + j] * ui * ui * di * (_WIDE + 3.0 * _STEEP * di2 * di2)
            fj = b[PULL * W + j] * row[HEIGHT_J * W + j] * uj * uj * dj * (_WIDE + 3.0 * _STEEP * dj2 * dj2)
            f = 2.0 * (fi + fj) * inverse
            fx += f * dx
            fy += f * dy
            fz += f * dz
            b_sums[FX * W + j] -= f * dx
            b_sums[FY * W + j] -= f * dy
            b_sums[FZ * W + j] -= f * dz
        a_sums[FX * W + i] += fx
        a_sums[FY * W + i] += fy
        a_sums[FZ * W + i] += fz
