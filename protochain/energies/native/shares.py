"""Energies of all pairs of atoms, by pairs of residues, for analysis without forces.

The terms are as in ``pairs`` and ``born``. Every pair is visited, independent of the neighbour lists.
"""

import numpy as np

from protochain.core.arrays import Floats, Integers
from protochain.energies.native.layout import chunk_kernel, variant
from protochain.energies.native.pairs import CLOSEST
from protochain.energies.native.series import inverse_root, power_of_two

LENNARD_JONES, COULOMB, POLAR = range(3)  # Rows of the sums.
_LOG2E = float(1.0 / np.log(2.0))


@chunk_kernel
def residue_sums(
    first: int, last: int, start: Integers, x: Floats, charge: Floats, lj_type: Integers, a12: Floats,
    b6: Floats, partner_start: Integers, partners: Integers, cutoff: float, krf: float, crf: float,
    gb_charge: Floats, born: Floats, gb_cutoff: float, share: float, kappa: float, matrix: Floats,
) -> None:  # fmt: skip
    """Put the energies of the pairs of residues first to last with all that follow, and within them."""
    # ``start`` (nr + 1,) are the first atoms of the residues, ``x`` is (3, na). ``partners`` of atom i, from
    # ``partner_start[i]`` on, have separate terms, except generalised Born. ``matrix`` (3, last - first, nr)
    # receives the energies on and above the diagonal.
    n_residues, n_atoms = len(start) - 1, x.shape[1]
    free = np.ones(n_atoms)
    row = np.empty((3, n_residues))
    for r in range(first, last):
        # Element by element, because an assignment of slices would compile for seconds.
        for s in range(r, n_residues):
            for kind in range(3):
                row[kind, s] = 0.0
        for i in range(start[r], start[r + 1]):
            for k in range(partner_start[i], partner_start[i + 1]):
                free[partners[k]] = 0.0
            a, b = a12[lj_type[i]], b6[lj_type[i]]
            for s in range(r, n_residues):
                begin, end = max(start[s], i + 1), start[s + 1]
                lj, coulomb = _pairs(i, begin, end, x, charge, lj_type, a, b, free, cutoff, krf, crf)
                row[LENNARD_JONES, s] += lj
                row[COULOMB, s] += coulomb
                if kappa > 0.0:
                    row[POLAR, s] += _polar(i, begin, end, x, gb_charge, born, gb_cutoff, True, share, kappa)
                elif len(born):
                    row[POLAR, s] += _polar(i, begin, end, x, gb_charge, born, gb_cutoff, False, 0.0, 0.0)
            for k in range(partner_start[i], partner_start[i + 1]):
                free[partners[k]] = 1.0
        for kind in range(3):
            for s in range(r, n_residues):
                matrix[kind, r - first, s] = row[kind, s]


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
        weight = free[j] if r2 < cutoff * cutoff else 0.0
        lj += weight * sixth * (a12[lj_type[j]] * sixth - b6[lj_type[j]])
        coulomb += weight * charge[j] * (inverse + krf * r2 - crf)
    return lj, charge[i] * coulomb


@variant
def _polar(
    i: int, begin: int, end: int, x: Floats, gb_charge: Floats, born: Floats, cutoff: float, salted: bool,
    share: float, kappa: float,
) -> float:  # fmt: skip
    """Generalised-Born energy of an atom with consecutive ones."""
    xi, yi, zi, energy = x[0, i], x[1, i], x[2, i], 0.0
    shift = 1.0 / cutoff
    for j in range(begin, end):
        dx, dy, dz = xi - x[0, j], yi - x[1, j], zi - x[2, j]
        r2 = dx * dx + dy * dy + dz * dz
        born_product = born[i] * born[j]
        inverse_f = inverse_root(r2 + born_product * power_of_two(-_LOG2E * 0.25 * r2 / born_product))
        term = gb_charge[j] * (inverse_f - shift)
        if salted:
            term *= 1.0 + share - share * power_of_two(-_LOG2E * kappa / inverse_f)
        energy -= term if r2 < cutoff * cutoff else 0.0
    return gb_charge[i] * energy
