"""Rows of tiles beyond all masks in single precision: eight pairs at a time where double takes four.

An atom and a block are far from each other there, and no term is large beside the sum. Positions are taken
from an atom of the block, in double: distances are rounded, places are not, and a complex a thousand nm away
loses nothing. Sums of 32 pairs are single, what they are added to is double. Nearer pairs, exceptions, bonded
terms, necks and what a tree sums stay in double.
"""

from typing import Any

import numpy as np

from protochain.core.arrays import Floats, Integers
from protochain.energies.native.born import add_integrals, add_polar
from protochain.energies.native.layout import (
    BORN,
    CHARGE,
    FX,
    FY,
    FZ,
    GB_CHARGE,
    HALF_INVERSE_BORN,
    PULL,
    ROWS,
    S2,
    S3,
    SCALAR,
    SUMS,
    Share,
    W,
    X,
    Y,
    Z,
    apart2,
    far_rows2,
    inlined,
    ordered,
    part,
    scalar,
    shared,
    tiled,
    variant,
)
from protochain.energies.native.pairs import add_pairs, put_inverses
from protochain.energies.native.series import FAR_RATIO, interpolated, of_integral, of_slope

Singles = np.ndarray
"""Array of float32."""
_ZERO, _ONE, _QUARTER, _SIXTH, _TWELFTH = (np.float32(x) for x in (0.0, 1.0, 0.25, 1.0 / 6.0, 1.0 / 12.0))
_LN2, _MINUS_LOG2E = np.float32(np.log(2.0)), np.float32(-1.0 / np.log(2.0))
_G0, _G1, _G2, _G3 = (np.float32(c) for c in interpolated(of_integral, 3, 0.0, FAR_RATIO**2))
_H0, _H1, _H2, _H3 = (np.float32(c) for c in interpolated(of_slope, 3, 0.0, FAR_RATIO**2))
_P0, _P1, _P2, _P3, _P4, _P5 = (np.float32(c) for c in interpolated(np.exp2, 5, -0.5, 0.5))
_SMALLEST_POWER = np.float32(-60.0)
_ROUNDING = np.float32(2.0**23 + 2.0**22)
"""Added to a float32, rounds it to a whole number, which its last bits then hold."""
_MANTISSA = np.uint32(23)


@scalar
def put_small(begin: int, end: int, atoms: Floats, small: Singles) -> None:
    """Write some blocks in single precision, each with its positions from its first atom."""
    for block in range(begin, end):
        for k in range(ROWS * W):
            small[block, k] = atoms[block, k]
        for row in (X, Y, Z):
            for k in range(row * W, (row + 1) * W):
                small[block, k] = atoms[block, k] - atoms[block, row * W]


@inlined
def _put_sums(small: Singles, sums: Floats) -> None:
    """Add single sums to double ones, and begin them anew."""
    for k in range(SUMS * W):
        sums[k] += small[k]
        small[k] = _ZERO


@shared
def pair_sums(
    mine: Share, atoms: Floats, small: Singles, lj: Floats, small_lj: Singles, lj_type: Integers,
    tiles: Integers, is_near: np.ndarray, near: float, block_near: Floats, cutoff: float, krf: float,
    crf: float, in_solvent: bool, sums: Floats, energies: Floats,
) -> None:  # fmt: skip
    """As :func:`pairs.pair_sums`; in a solvent as :func:`pairs.solvated_pair_sums`."""
    for c in range(*mine):
        begin, end = part(len(tiles), c)
        energy, inverses = 0.0, np.empty(W)
        small_inverses, small_sums = np.empty(W, np.float32), np.zeros(SUMS * W, np.float32)
        for k in range(begin, end):
            i, j = tiles[k, 0], tiles[k, 1]
            far2 = far_rows2(is_near[k], block_near[i], block_near[j], cutoff)
            energy += _pair_tile(
                atoms[i], atoms[j], small[j], lj[j], small_lj[j], lj_type[i], i == j, near * near, far2,
                cutoff * cutoff, in_solvent, krf, crf, inverses, small_inverses, sums[c, i], sums[c, j],
                small_sums,
            )  # fmt: skip
            _put_sums(small_sums, sums[c, j])
        energies[c] += energy


@tiled
def _pair_tile(
    a: Floats, b: Floats, small: Singles, lj: Floats, small_lj: Singles, lj_type: Integers, same: bool,
    near2: float, far2: float, cutoff2: float, in_solvent: bool, krf: float, crf: float, inverses: Floats,
    small_inverses: Singles, a_sums: Floats, b_sums: Floats, small_sums: Singles,
) -> float:  # fmt: skip
    energy = 0.0
    for i in range(W):
        kind, first = lj_type[i], i if same else -1
        if apart2(a, i, b) < far2:
            put_inverses(a, i, b, first, True, near2, cutoff2, inverses)
            if in_solvent:
                energy += add_pairs(a, i, b, lj[kind], True, True, krf, crf, inverses, a_sums, b_sums)
            else:
                energy += add_pairs(a, i, b, lj[kind], True, False, krf, crf, inverses, a_sums, b_sums)
        elif in_solvent:
            energy += _pairs(a, i, b, small, small_lj[kind], True, small_inverses, a_sums, small_sums)
        else:
            energy += _pairs(a, i, b, small, small_lj[kind], False, small_inverses, a_sums, small_sums)
    return energy


@variant
def _pairs(
    a: Floats, i: int, b: Floats, small: Singles, row: Singles, in_solvent: bool, inverses: Singles,
    a_sums: Floats, b_sums: Singles,
) -> float:  # fmt: skip
    """As :func:`pairs.put_inverses` and :func:`pairs.add_pairs` without masks."""
    xi, yi, zi = _place(a, i, b)
    qi, pull = np.float32(a[CHARGE * W + i]), np.float32(a[PULL * W + i])
    s2, s3 = np.float32(a[S2 * W + i]), np.float32(a[S3 * W + i])
    for j in range(W):
        dx, dy, dz = xi - small[X * W + j], yi - small[Y * W + j], zi - small[Z * W + j]
        inverses[j] = _ONE / np.sqrt(dx * dx + dy * dy + dz * dz)
    energy, fx, fy, fz = _ZERO, _ZERO, _ZERO, _ZERO
    for j in range(W):
        dx, dy, dz = xi - small[X * W + j], yi - small[Y * W + j], zi - small[Z * W + j]
        inverse = inverses[j]
        inverse2 = inverse * inverse
        inverse6 = inverse2 * inverse2 * inverse2
        twelve, six = row[j] * inverse6 * inverse6, row[W + j] * inverse6
        coulomb = qi * small[CHARGE * W + j] * inverse
        energy += twelve * _TWELFTH - six * _SIXTH + coulomb
        f = (twelve - six + coulomb) * inverse2
        if in_solvent:
            g, h = _slope(small[S2 * W + j] * inverse2), _slope(s2 * inverse2)
            f += (pull * small[S3 * W + j] * g + small[PULL * W + j] * s3 * h) * inverse6
        fx += f * dx
        fy += f * dy
        fz += f * dz
        b_sums[FX * W + j] -= f * dx
        b_sums[FY * W + j] -= f * dy
        b_sums[FZ * W + j] -= f * dz
    a_sums[FX * W + i] += fx
    a_sums[FY * W + i] += fy
    a_sums[FZ * W + i] += fz
    return float(energy)


@shared
def integral_sums(
    mine: Share, atoms: Floats, small: Singles, tiles: Integers, is_near: np.ndarray, near: float,
    block_near: Floats, cutoff: float, sums: Floats,
) -> None:  # fmt: skip
    """As :func:`born.integral_sums`."""
    for c in range(*mine):
        begin, end = part(len(tiles), c)
        small_sums = np.zeros(SUMS * W, np.float32)
        for k in range(begin, end):
            i, j = tiles[k, 0], tiles[k, 1]
            far2 = far_rows2(is_near[k], block_near[i], block_near[j], cutoff)
            _integral_tile(
                atoms[i], atoms[j], small[j], i == j, near * near, far2, cutoff * cutoff, sums[c, i],
                sums[c, j], small_sums,
            )  # fmt: skip
            _put_sums(small_sums, sums[c, j])


@tiled
def _integral_tile(
    a: Floats, b: Floats, small: Singles, same: bool, near2: float, far2: float, cutoff2: float,
    a_sums: Floats, b_sums: Floats, small_sums: Singles,
) -> None:  # fmt: skip
    for i in range(W):
        if apart2(a, i, b) < far2:
            add_integrals(a, i, b, same, True, near2, cutoff2, a_sums, b_sums)
        else:
            _integrals(a, i, b, small, a_sums, small_sums)


@variant
def _integrals(a: Floats, i: int, b: Floats, small: Singles, a_sums: Floats, b_sums: Singles) -> None:
    """As :func:`born.add_integrals` without masks."""
    xi, yi, zi = _place(a, i, b)
    s2, s3, total = np.float32(a[S2 * W + i]), np.float32(a[S3 * W + i]), _ZERO
    for j in range(W):
        dx, dy, dz = xi - small[X * W + j], yi - small[Y * W + j], zi - small[Z * W + j]
        inverse2 = _ONE / (dx * dx + dy * dy + dz * dz)
        inverse4 = inverse2 * inverse2
        total += small[S3 * W + j] * inverse4 * _integral(small[S2 * W + j] * inverse2)
        b_sums[SCALAR * W + j] += s3 * inverse4 * _integral(s2 * inverse2)
    a_sums[SCALAR * W + i] += total


@shared
def polar_sums(
    mine: Share, atoms: Floats, small: Singles, tiles: Integers, cutoff: float, sums: Floats, energies: Floats
) -> None:
    """As :func:`born.polar_sums`."""
    for c in range(*mine):
        begin, end = part(len(tiles), c)
        energy, rows = 0.0, np.empty(3 * W)
        small_rows, small_sums = np.empty(3 * W, np.float32), np.zeros(SUMS * W, np.float32)
        for k in range(begin, end):
            i, j = tiles[k, 0], tiles[k, 1]
            if i == j or cutoff < np.inf:
                energy -= _polar_in_double(
                    atoms[i], atoms[j], i == j, cutoff * cutoff, 1.0 / cutoff, rows, sums[c, i], sums[c, j]
                )
            else:
                energy -= _polar_tile(atoms[i], atoms[j], small[j], small_rows, sums[c, i], small_sums)
                _put_sums(small_sums, sums[c, j])
        energies[c] += energy


@tiled
def _polar_in_double(
    a: Floats, b: Floats, same: bool, cutoff2: float, shift: float, rows: Floats, a_sums: Floats,
    b_sums: Floats,
) -> float:  # fmt: skip
    return add_polar(a, b, same, True, cutoff2, shift, rows, a_sums, b_sums)


@tiled
def _polar_tile(
    a: Floats, b: Floats, small: Singles, rows: Singles, a_sums: Floats, b_sums: Singles
) -> float:
    """As :func:`born.add_polar` without masks."""
    energy = 0.0
    for i in range(W):
        xi, yi, zi = _place(a, i, b)
        born = np.float32(a[BORN * W + i])
        half = _MINUS_LOG2E * np.float32(a[HALF_INVERSE_BORN * W + i])
        for j in range(W):
            dx, dy, dz = xi - small[X * W + j], yi - small[Y * W + j], zi - small[Z * W + j]
            r2 = dx * dx + dy * dy + dz * dz
            exponent = r2 * (half * small[HALF_INVERSE_BORN * W + j])
            decay = _power_of_two(exponent)
            rows[j] = r2 + born * small[BORN * W + j] * decay
            rows[W + j] = decay
            rows[2 * W + j] = decay - decay * exponent * _LN2
        qi, of_row = np.float32(a[GB_CHARGE * W + i]), _ZERO
        fx, fy, fz, slope = _ZERO, _ZERO, _ZERO, _ZERO
        for j in range(W):
            dx, dy, dz = xi - small[X * W + j], yi - small[Y * W + j], zi - small[Z * W + j]
            inverse_f = _ONE / np.sqrt(rows[j])
            pair = qi * small[GB_CHARGE * W + j] * inverse_f
            of_row += pair
            cube = pair * (inverse_f * inverse_f)
            f = cube - _QUARTER * cube * rows[W + j]
            with_born = cube * rows[2 * W + j]
            slope += with_born * small[BORN * W + j]
            fx += f * dx
            fy += f * dy
            fz += f * dz
            b_sums[FX * W + j] += f * dx
            b_sums[FY * W + j] += f * dy
            b_sums[FZ * W + j] += f * dz
            b_sums[SCALAR * W + j] += with_born * born
        a_sums[FX * W + i] -= fx
        a_sums[FY * W + i] -= fy
        a_sums[FZ * W + i] -= fz
        a_sums[SCALAR * W + i] += slope
        energy += float(of_row)
    return energy


@variant
def _place(a: Floats, i: int, b: Floats) -> tuple[np.float32, np.float32, np.float32]:
    """Position of an atom from the first of a block."""
    return (
        np.float32(a[X * W + i] - b[X * W]),
        np.float32(a[Y * W + i] - b[Y * W]),
        np.float32(a[Z * W + i] - b[Z * W]),
    )


@variant
def _integral(y: np.float32) -> np.float32:
    return _G0 + y * (_G1 + y * (_G2 + y * _G3))


@variant
def _slope(y: np.float32) -> np.float32:
    return _H0 + y * (_H1 + y * (_H2 + y * _H3))


@ordered
def _power_of_two(y: Any) -> Any:
    """As :func:`series.power_of_two`."""
    least = max(y, _SMALLEST_POWER)
    rounded = least + _ROUNDING
    z = least - (rounded - _ROUNDING)
    value = _P0 + z * (_P1 + z * (_P2 + z * (_P3 + z * (_P4 + z * _P5))))
    bits = np.float32(value).view(np.uint32) + np.uint32(np.float32(rounded).view(np.uint32) << _MANTISSA)
    return np.uint32(bits).view(np.float32)
