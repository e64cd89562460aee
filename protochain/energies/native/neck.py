"""Necks of GBn and GBn2: gaps between two atoms too narrow for water.

Mongan, Simmerling, McCammon, Case, Onufriev, J. Chem. Theory Comput. 3:156 (2007).
"""

from protochain.core.arrays import Floats, Integers
from protochain.energies.native.layout import (
    FX,
    FY,
    FZ,
    PULL,
    SCALAR,
    Share,
    W,
    X,
    Y,
    Z,
    box_distance2,
    chunk_kernel,
    part,
    tile_kernel,
)  # fmt: skip
from protochain.energies.native.series import inverse_root

REACH = 0.68  # nm. Largest distance between the surfaces of two atoms with a neck.
HEIGHT_I, PLACE_I, HEIGHT_J, PLACE_J, REACH2 = range(5)
"""Rows for each type of atom i with a block of atoms j: height and position of the neck's peak for i and for
j, and square of the distance at which the neck ends."""
_WIDE, _STEEP = 100.0, 0.3e6  # 1/nm^2 and 1/nm^6: a neck of unit height is 1 / (1 + 100 d^2 + 300000 d^6).


@chunk_kernel
def neck_sums(
    chunks: Share, atoms: Floats, necks: Floats, neck_type: Integers, tiles: Integers, reach: float,
    cutoff: float, sums: Floats,
) -> None:  # fmt: skip
    """Add the necks' contributions to the Born integrals to row SCALAR of the sums."""
    for c in range(*chunks):
        begin, end = part(len(tiles), c)
        for k in range(begin, end):
            i, j = tiles[k, 0], tiles[k, 1]
            _neck_tile(
                atoms[i], atoms[j], necks[j], neck_type[i], i == j, reach, cutoff * cutoff, sums[c, i],
                sums[c, j],
            )  # fmt: skip


@tile_kernel
def _neck_tile(
    a: Floats, b: Floats, necks: Floats, neck_type: Integers, same: bool, reach: float, cutoff2: float,
    a_sums: Floats, b_sums: Floats,
) -> None:  # fmt: skip
    for i in range(W):
        if box_distance2(a, i, b) > reach * reach:
            continue
        xi, yi, zi, first = a[X * W + i], a[Y * W + i], a[Z * W + i], i if same else -1
        row = necks[neck_type[i]]
        total = 0.0
        for j in range(W):
            dx, dy, dz = xi - b[X * W + j], yi - b[Y * W + j], zi - b[Z * W + j]
            r2 = dx * dx + dy * dy + dz * dz
            r = r2 * inverse_root(r2)
            inside = (r2 <= row[REACH2 * W + j]) & (r2 < cutoff2) & (j > first)
            di, dj = r - row[PLACE_I * W + j], r - row[PLACE_J * W + j]
            di2, dj2 = di * di, dj * dj
            ui, uj = 1.0 + di2 * (_WIDE + _STEEP * di2 * di2), 1.0 + dj2 * (_WIDE + _STEEP * dj2 * dj2)
            # One division for both.
            inverse_product = 1.0 / (ui * uj) if inside else 0.0
            total += row[HEIGHT_I * W + j] * uj * inverse_product
            b_sums[SCALAR * W + j] += row[HEIGHT_J * W + j] * ui * inverse_product
        a_sums[SCALAR * W + i] += total


@chunk_kernel
def neck_force_sums(
    chunks: Share, atoms: Floats, necks: Floats, neck_type: Integers, tiles: Integers, reach: float,
    cutoff: float, sums: Floats,
) -> None:  # fmt: skip
    """Add the forces of the necks, given dE/d(integral) of each atom."""
    for c in range(*chunks):
        begin, end = part(len(tiles), c)
        for k in range(begin, end):
            i, j = tiles[k, 0], tiles[k, 1]
            _neck_force_tile(
                atoms[i], atoms[j], necks[j], neck_type[i], i == j, reach, cutoff * cutoff, sums[c, i],
                sums[c, j],
            )  # fmt: skip


@tile_kernel
def _neck_force_tile(
    a: Floats, b: Floats, necks: Floats, neck_type: Integers, same: bool, reach: float, cutoff2: float,
    a_sums: Floats, b_sums: Floats,
) -> None:  # fmt: skip
    for i in range(W):
        if box_distance2(a, i, b) > reach * reach:
            continue
        xi, yi, zi, first = a[X * W + i], a[Y * W + i], a[Z * W + i], i if same else -1
        row, pull = necks[neck_type[i]], a[PULL * W + i]
        fx, fy, fz = 0.0, 0.0, 0.0
        for j in range(W):
            dx, dy, dz = xi - b[X * W + j], yi - b[Y * W + j], zi - b[Z * W + j]
            r2 = dx * dx + dy * dy + dz * dz
            inside = (r2 <= row[REACH2 * W + j]) & (r2 < cutoff2) & (j > first) & (r2 > 0.0)
            inverse = inverse_root(r2)
            inverse = inverse if inside else 0.0
            r = r2 * inverse
            di, dj = r - row[PLACE_I * W + j], r - row[PLACE_J * W + j]
            di2, dj2 = di * di, dj * dj
            di4, dj4 = di2 * di2, dj2 * dj2
            ui, uj = 1.0 + di2 * (_WIDE + _STEEP * di4), 1.0 + dj2 * (_WIDE + _STEEP * dj4)
            inverse_product = 1.0 / (ui * uj)
            fi = pull * row[HEIGHT_I * W + j] * uj * uj * di * (_WIDE + 3.0 * _STEEP * di4)
            fj = b[PULL * W + j] * row[HEIGHT_J * W + j] * ui * ui * dj * (_WIDE + 3.0 * _STEEP * dj4)
            f = 2.0 * (fi + fj) * inverse_product * inverse_product * inverse
            fx += f * dx
            fy += f * dy
            fz += f * dz
            b_sums[FX * W + j] -= f * dx
            b_sums[FY * W + j] -= f * dy
            b_sums[FZ * W + j] -= f * dz
        a_sums[FX * W + i] += fx
        a_sums[FY * W + i] += fy
        a_sums[FZ * W + i] += fz
