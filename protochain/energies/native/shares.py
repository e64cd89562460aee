"""Energies of all pairs of atoms, by atom or by pair of residues: to tell, not to follow, a force.

The terms are those of ``pairs`` and ``born``; every pair is visited, whatever the neighbour lists, and none
has a force.
"""

import numpy as np

from protochain.core.arrays import Floats, Integers
from protochain.energies.native.layout import (
    BORN,
    CHARGE,
    GB_CHARGE,
    HALF_INVERSE_BORN,
    Share,
    W,
    X,
    Y,
    Z,
    part,
    shared,
    tiled,
    variant,
)
from protochain.energies.native.pairs import CLOSEST
from protochain.energies.native.series import inverse_root, power_of_two

LENNARD_JONES, COULOMB, POLAR = range(3)
"""Rows of the sums."""
HALVES = 3
_LOG2E = float(1.0 / np.log(2.0))


@shared
def atom_sums(
    mine: Share, atoms: Floats, lj: Floats, lj_type: Integers, tiles: Integers, begin: Integers,
    excluded: Integers, cutoff: float, krf: float, crf: float, gb_cutoff: float, sums: Floats,
) -> None:  # fmt: skip
    """Add half of each pair's energy to either atom, tile by tile; generalised Born if it has a cutoff."""
    # ``tiles`` (n, 2) are all pairs of blocks; those that are ``excluded`` (m, 2) in tile k, atoms of its two
    # blocks counted from 0, begin at ``begin[k]``. ``sums`` (CHUNKS, blocks, HALVES * W).
    counts = np.ones(W * W)
    for c in range(*mine):
        first, last = part(len(tiles), c)
        for k in range(first, last):
            i, j = tiles[k, 0], tiles[k, 1]
            for e in range(begin[k], begin[k + 1]):
                counts[W * excluded[e, 0] + excluded[e, 1]] = 0.0
            _pair_halves(
                atoms[i], atoms[j], lj[j], lj_type[i], i == j, counts, cutoff * cutoff, krf, crf, sums[c, i],
                sums[c, j],
            )  # fmt: skip
            if gb_cutoff > 0.0:
                _polar_halves(
                    atoms[i], atoms[j], i == j, gb_cutoff * gb_cutoff, 1.0 / gb_cutoff, sums[c, i], sums[c, j]
                )
            for e in range(begin[k], begin[k + 1]):
                counts[W * excluded[e, 0] + excluded[e, 1]] = 1.0


@tiled
def _pair_halves(
    a: Floats, b: Floats, lj: Floats, lj_type: Integers, same: bool, counts: Floats, cutoff2: float,
    krf: float, crf: float, a_sums: Floats, b_sums: Floats,
) -> None:  # fmt: skip
    """Lennard-Jones and Coulomb of a tile; ``counts`` is 0 for pairs with terms of their own."""
    for i in range(W):
        xi, yi, zi, qi = a[X * W + i], a[Y * W + i], a[Z * W + i], 0.5 * a[CHARGE * W + i]
        row, which, first = lj[lj_type[i]], counts[W * i : W * i + W], i if same else -1
        of_lj, of_charges = 0.0, 0.0
        for j in range(W):
            dx, dy, dz = xi - b[X * W + j], yi - b[Y * W + j], zi - b[Z * W + j]
            r2 = max(dx * dx + dy * dy + dz * dz, CLOSEST)
            inverse = inverse_root(r2)
            sixth = (inverse * inverse) ** 3
            counted = which[j] if (r2 < cutoff2) & (j > first) else 0.0
            # Rows hold 12 A and 6 B.
            mine = counted * sixth * (row[j] * sixth * (1.0 / 24.0) - row[W + j] * (1.0 / 12.0))
            other = counted * qi * b[CHARGE * W + j] * (inverse + krf * r2 - crf)
            of_lj += mine
            of_charges += other
            b_sums[LENNARD_JONES * W + j] += mine
            b_sums[COULOMB * W + j] += other
        a_sums[LENNARD_JONES * W + i] += of_lj
        a_sums[COULOMB * W + i] += of_charges


@tiled
def _polar_halves(
    a: Floats, b: Floats, same: bool, cutoff2: float, shift: float, a_sums: Floats, b_sums: Floats
) -> None:
    """Generalised Born of a tile."""
    for i in range(W):
        xi, yi, zi, qi = a[X * W + i], a[Y * W + i], a[Z * W + i], 0.5 * a[GB_CHARGE * W + i]
        born, half = a[BORN * W + i], -_LOG2E * a[HALF_INVERSE_BORN * W + i]
        first, total = i if same else -1, 0.0
        for j in range(W):
            dx, dy, dz = xi - b[X * W + j], yi - b[Y * W + j], zi - b[Z * W + j]
            r2 = dx * dx + dy * dy + dz * dz
            decay = power_of_two(r2 * (half * b[HALF_INVERSE_BORN * W + j]))
            inverse_f = inverse_root(r2 + born * b[BORN * W + j] * decay)
            counted = qi if (r2 < cutoff2) & (j > first) else 0.0
            mine = counted * b[GB_CHARGE * W + j] * (shift - inverse_f)
            total += mine
            b_sums[POLAR * W + j] += mine
        a_sums[POLAR * W + i] += total


@shared
def residue_sums(
    first: int, last: int, start: Integers, x: Floats, charge: Floats, lj_type: Integers, a12: Floats,
    b6: Floats, partner_start: Integers, partners: Integers, cutoff: float, krf: float, crf: float,
    gb_charge: Floats, born: Floats, gb_cutoff: float, matrix: Floats,
) -> None:  # fmt: skip
    """Put the energies of the pairs of residues first to last with all that follow, and within them."""
    # ``start`` (nr + 1,) are the first atoms of the residues; ``x`` (3, na); ``partners`` of atom i, from
    # ``partner_start[i]`` on, have terms of their own, but generalised Born. ``matrix`` (3, nr, nr) gets them
    # on and above the diagonal.
    n_residues, n_atoms = len(start) - 1, x.shape[1]
    free = np.ones(n_atoms)
    row = np.empty((3, n_residues))
    for r in range(first, last):
        row[:] = 0.0
        for i in range(start[r], start[r + 1]):
            for k in range(partner_start[i], partner_start[i + 1]):
                free[partners[k]] = 0.0
            a, b = a12[lj_type[i]], b6[lj_type[i]]
            for s in range(r, n_residues):
                begin, end = max(start[s], i + 1), start[s + 1]
                lj, coulomb = _pairs(i, begin, end, x, charge, lj_type, a, b, free, cutoff, krf, crf)
                row[LENNARD_JONES, s] += lj
                row[COULOMB, s] += coulomb
                if len(born):
                    row[POLAR, s] += _polar(i, begin, end, x, gb_charge, born, gb_cutoff)
            for k in range(partner_start[i], partner_start[i + 1]):
                free[partners[k]] = 1.0
        for kind in range(3):
            matrix[kind, r, r:] = row[kind, r:]


@variant
def _pairs(
    i: int, begin: int, end: int, x: Floats, charge: Floats, lj_type: Integers, a12: Floats, b6: Floats,
    free: Floats, cutoff: float, krf: float, crf: float,
) -> tuple[float, float]:  # fmt: skip
    """Lennard-Jones and Coulomb energies of an atom with consecutive ones."""
    xi, yi, zi, lj, coulomb = x[0, i], x[1, i], x[2, i], 0.0, 0.0
    for j in range(begin, end):
        dx, dy, dz = xi - x[0, j], yi - x[1, j], zi - x[2, j]
        r2 = max(dx * dx + dy * dy + dz * dz, CLOSEST)
        inverse = inverse_root(r2)
        sixth = (inverse * inverse) ** 3
        counts = free[j] if r2 < cutoff * cutoff else 0.0
        lj += counts * sixth * (a12[lj_type[j]] * sixth - b6[lj_type[j]])
        coulomb += counts * charge[j] * (inverse + krf * r2 - crf)
    return lj, charge[i] * coulomb


@variant
def _polar(
    i: int, begin: int, end: int, x: Floats, gb_charge: Floats, born: Floats, cutoff: float
) -> float:  # fmt: skip
    """Generalised-Born energy of an atom with consecutive ones."""
    xi, yi, zi, energy = x[0, i], x[1, i], x[2, i], 0.0
    shift = 1.0 / cutoff
    for j in range(begin, end):
        dx, dy, dz = xi - x[0, j], yi - x[1, j], zi - x[2, j]
        r2 = dx * dx + dy * dy + dz * dz
        both = born[i] * born[j]
        inverse_f = inverse_root(r2 + both * power_of_two(-_LOG2E * 0.25 * r2 / both))
        energy -= gb_charge[j] * (inverse_f - shift) if r2 < cutoff * cutoff else 0.0
    return gb_charge[i] * energy
