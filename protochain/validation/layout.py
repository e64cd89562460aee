"""Places of the atoms of each residue, residues joined by peptide bonds, and dihedrals of many at once."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from protochain.core.arrays import Floats, Integers, dihedral, floats, read_only
from protochain.core.graph import both_ways
from protochain.structure.molecule.model import Structure, per_positions, per_structure
from protochain.structure.molecule.residues import BACKBONE

NONE = -1  # Index for an atom or residue that does not exist.


class Layout(NamedTuple):
    """Amino acids of a structure, their atoms and neighbours."""

    # (nr,) bool: Residues with a backbone, without caps and hetero molecules.
    amino: NDArray[np.bool_]
    atom: dict[str, Integers]  # Index of the atom of that name in each amino acid, -1 if missing.
    # (nr,) int: Amino acids that a peptide bond joins to N and to C, -1 if missing.
    before: Integers
    after: Integers

    def atoms(self, *names: str) -> Integers:
        """(nr, len(names)) int: atoms of these names in each residue."""
        absent = np.full(len(self.amino), NONE)
        return np.stack([self.atom.get(name, absent) for name in names], axis=1)


def positions(structure: Structure, x: Floats | None) -> Floats:
    """(na, 3) float, nm: positions to measure, checked, or the structure's own."""
    return structure.positions if x is None else floats(x, (structure.n_atoms, 3), "x", "nanometer")


@per_structure
def layout(structure: Structure) -> Layout:
    """Find the amino acids of a structure, their atoms and neighbours, independent of positions."""
    n, of = structure.n_residues, structure.atom_residue
    backbone = [
        np.isin(np.arange(n), of[(structure.atom_name == name) & ~structure.kept]) for name in BACKBONE
    ]
    amino = np.all(backbone, axis=0)
    of_amino = np.flatnonzero(amino[of])
    names = structure.atom_name[of_amino]
    atom: dict[str, Integers] = {}
    for name in np.unique(names).tolist():
        index = np.full(n, NONE)
        atoms = of_amino[names == name]
        index[of[atoms]] = atoms
        atom[name] = read_only(index, np.int64)
    before, after = np.full(n, NONE), np.full(n, NONE)
    ends = both_ways(structure.bonds)
    # Not of a carbon with four neighbours. Some are within one residue.
    is_flat = np.bincount(structure.bonds.ravel(), minlength=structure.n_atoms) < 4
    first, second = of[ends[(structure.atom_name[ends] == ["C", "N"]).all(axis=1) & is_flat[ends[:, 0]]]].T
    real = amino[first] & amino[second] & (first != second)
    after[first[real]], before[second[real]] = second[real], first[real]
    return Layout(amino, atom, read_only(before, np.int64), read_only(after, np.int64))


def dihedrals(x: Floats, atoms: Integers) -> Floats:
    """Dihedrals (n,), degrees, -180 to 180, of atoms (n, 4) at x (na, 3), with the sign of IUPAC-IUB."""
    angles = np.degrees(dihedral(*x[atoms.T]))
    return np.where((atoms == NONE).any(axis=1), np.nan, angles)


@per_positions
def peptides(structure: Structure, x: Floats) -> tuple[Floats, Floats, Floats]:
    """phi, psi, and omega of the bond before each residue (nr,), in degrees, NaN if missing."""
    amino = layout(structure)
    backbone = amino.atoms("N", "CA", "C")
    before, after = backbone[amino.before], backbone[amino.after]
    before[amino.before == NONE], after[amino.after == NONE] = NONE, NONE
    phi, psi, omega = (
        read_only(dihedrals(x, np.column_stack(atoms)))
        for atoms in ((before[:, 2], backbone), (backbone, after[:, 0]), (before[:, 1:], backbone[:, :2]))
    )
    return phi, psi, omega
