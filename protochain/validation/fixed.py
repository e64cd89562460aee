"""Faults outside the protein: broken bonds of nucleotides and fixed molecules, and clashes of the latter."""

from collections import Counter
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from protochain.chains.contacts import radii
from protochain.core.arrays import Floats, Integers
from protochain.core.graph import components, pairs_within
from protochain.core.markup import abridge, plural
from protochain.core.units import ANGSTROM_PER_NM
from protochain.structure.molecule.model import Structure
from protochain.structure.molecule.residues import NUCLEOTIDES
from protochain.validation.layout import positions
from protochain.validation.strain import covalent_radii, metals, wrong_bonds

_CLASH = 0.15  # nm of overlap of heavy atoms, as AlphaFold counts clashes between residues.
_BOND_SLACK = 0.3
"""Angstrom beyond the sum of the covalent radii up to which atoms of two molecules are bonded."""


class FixedFaults(NamedTuple):
    """Faults of the molecules around the protein."""

    # (n, 2) int: Atoms of their broken bonds: far longer or shorter than usual, or, of a molecule in pieces,
    # the nearest ones.
    bonds: Integers
    # (m, 2) int: Their heavy atoms that overlap with each other or with the protein by 1.5 angstrom.
    clashes: Integers

    def lines(self, structure: Structure, x: Floats) -> list[str]:
        """Describe each fault in a line."""
        pairs = np.vstack([self.bonds, self.clashes])
        distance = ANGSTROM_PER_NM * np.linalg.norm(x[pairs[:, 0]] - x[pairs[:, 1]], axis=1)
        ends = [[str(structure.atom(atom)) for atom in pair] for pair in pairs.tolist()]
        return [f"{a} and {b}, {by:.2f} angstrom apart" for (a, b), by in zip(ends, distance, strict=True)]

    def summary(self, structure: Structure, x: Floats) -> str:
        """Number of faults, and the first of them. Empty without any."""
        kinds = ((len(self.bonds), "broken bond"), (len(self.clashes), "overlap"))
        if not (counts := [plural(*kind) for kind in kinds if kind[0]]):
            return ""
        return f"{' and '.join(counts)} outside the protein: {abridge(self.lines(structure, x))}"


def fixed_counts(structure: Structure) -> dict[str, int]:
    """Count the fixed residues outside the protein, by name, the most frequent first."""
    return dict(Counter(structure.residue_name[_obstacle_residues(structure)].tolist()).most_common())


def fixed_residues(structure: Structure) -> Integers:
    """(n,) int: fixed residues outside the protein, without waters."""
    residues = _obstacle_residues(structure)
    return np.asarray(residues[structure.residue_name[residues] != "HOH"])


def count_fixed(structure: Structure) -> tuple[int, int]:
    """Count the amino acids of fixed chains, and all amino acids."""
    backbone = np.isin(structure.atom_name, ["N", "CA", "C"]) & np.isin(structure.atom_element, ["N", "C"])
    complete = np.bincount(structure.atom_residue[backbone], minlength=structure.n_residues) == 3
    still = _obstacle_residues(structure)
    return int(complete[still].sum()), int(complete.sum())


def _obstacle_residues(structure: Structure) -> Integers:
    return np.unique(structure.atom_residue[structure.obstacle])


def fixed_faults(structure: Structure, x: Floats | None = None) -> FixedFaults:
    """Find broken bonds and clashes of fixed molecules, at positions x (na, 3) or the structure's own."""
    # Bonds of fixed molecules except nucleotides follow from distances. A broken one leaves the molecule in
    # pieces.
    none = np.empty((0, 2), dtype=np.int64)
    if not structure.kept.any():
        return FixedFaults(none, none)
    x = positions(structure, x)
    bonds = wrong_bonds(structure, x)
    broken = np.vstack([bonds[structure.kept[bonds].all(axis=1)], _torn_bonds(structure, x)])
    return FixedFaults(broken, _clashes(structure, x) if structure.obstacle.any() else none)


def _torn_bonds(structure: Structure, x: Floats) -> Integers:
    """(n, 2) int: nearest atoms of pieces of fixed molecules, except nucleotides and metal complexes."""
    of, element = structure.atom_residue, structure.atom_element
    skipped = np.isin(structure.residue_name, [*NUCLEOTIDES])
    skipped[of[metals(structure)]] = True
    fixed = structure.obstacle & (element != "H") & ~skipped[of]
    bonds = structure.bonds[fixed[structure.bonds].all(axis=1)]
    piece, pairs = components(bonds[of[bonds[:, 0]] == of[bonds[:, 1]]], structure.n_atoms), []
    for residue in np.unique(of[fixed]).tolist():
        atoms = np.flatnonzero(fixed & (of == residue))
        for number in np.unique(piece[atoms])[1:]:
            loose, earlier = atoms[piece[atoms] == number], atoms[piece[atoms] < number]
            distance = np.linalg.norm(x[loose][:, None] - x[earlier], axis=2)
            i, j = np.unravel_index(np.argmin(distance), distance.shape)
            pairs.append(sorted((int(loose[i]), int(earlier[j]))))
    return np.array(pairs, dtype=np.int64).reshape(-1, 2)


def _clashes(structure: Structure, x: Floats) -> Integers:
    """Overlapping heavy atoms (n, 2), one of each pair fixed, without metals and alternate states."""
    heavy = np.flatnonzero((structure.atom_element != "H") & ~metals(structure))
    radius = radii(structure)
    near = heavy[cKDTree(x[heavy]).query_pairs(2.0 * radius[heavy].max() - _CLASH, output_type="ndarray")]
    near = np.sort(near[structure.obstacle[near].any(axis=1)], axis=1)
    distance = np.linalg.norm(x[near[:, 0]] - x[near[:, 1]], axis=1)
    # Molecules of two alternate states may lie in one place.
    together = structure.occupancy[near].sum(axis=1) > 1.0
    close = (radius[near].sum(axis=1) - distance > _CLASH) & together
    pairs, n = near[close], structure.n_atoms
    near_by = pairs_within(np.vstack([structure.bonds, _bonds_between(structure, x)]), n, 3)
    return pairs[~np.isin(pairs @ [n, 1], near_by @ [n, 1])]


def _bonds_between(structure: Structure, x: Floats) -> Integers:
    """Bonds (n, 2) between fixed residues, for example of a glycan. Only one pair of atoms may be so near."""
    fixed = np.flatnonzero(structure.obstacle & (structure.atom_element != "H"))
    radius, of = covalent_radii(structure), structure.atom_residue
    farthest = (2.0 * radius[fixed].max() + _BOND_SLACK) / ANGSTROM_PER_NM
    near = fixed[cKDTree(x[fixed]).query_pairs(farthest, output_type="ndarray")]
    near = near[of[near[:, 0]] != of[near[:, 1]]]
    length = ANGSTROM_PER_NM * np.linalg.norm(x[near[:, 0]] - x[near[:, 1]], axis=1)
    near = near[length <= radius[near].sum(axis=1) + _BOND_SLACK]
    index, count = np.unique(np.sort(of[near], axis=1), axis=0, return_inverse=True, return_counts=True)[1:]
    return near[count[index.ravel()] == 1]
