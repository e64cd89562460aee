"""Covalent bonds of a wrong length: bonds of all molecules to all elements but metals, hydrogen included.

The reference is the equilibrium length of Amber ff14SB, of its phosphates, and of OL15 and OL3 for
nucleotides. Bonds of ligands and of residues without template have their own parameters. All other bonds are
compared with the sum of covalent radii (Cordero et al., Dalton Trans. 2832, 2008).
"""

import gemmi
import numpy as np
from numpy.typing import NDArray

from protochain.core.arrays import Floats, Integers, distance
from protochain.core.units import ANGSTROM_PER_NM
from protochain.structure.molecule.model import Structure, per_structure
from protochain.structure.molecule.templates import DNA, PHOSPHATES, PROTEIN, RNA
from protochain.validation.strain import norms

WINDOW = 0.03
"""nm from the reference, 11 thermal standard deviations of a C-H bond. Hydrogens of sound files are up to
0.024 farther away (OpenMM's Modeller), bonds of DNA in crystals are off by up to 0.011."""
_LONG, _SHORT = 0.045, 0.65
"""Limits of bonds to hydrogen and of bonds that the force field does not have: nm beyond the reference of
fixed molecules, slightly above the reader's limit, and the smallest share of the reference.
By convention hydrogens of files are nearer: C-H 0.93 angstrom for 1.09 (X-ray), S-H 0.96 for 1.34 (NMR)."""
_FILES = (PROTEIN, PHOSPHATES["amber14"], DNA, RNA)


def wrong_bonds(structure: Structure, x: Floats) -> Integers:
    """(n, 2) int: covalent bonds off their reference by 0.3 angstrom, or to hydrogen too short by a third."""
    bonds, _, lower, upper = _references(structure)
    length = distance(*x[bonds.T])
    return np.asarray(bonds[(length < lower) | (length > upper)])


def bond_lines(structure: Structure, x: Floats, bonds: Integers) -> list[str]:
    """Describe bonds (n, 2) by their lengths: ``CD1 of A:ILE13 to HD11, 10.33 angstrom long, not 1.09``."""
    pairs, reference, _, _ = _references(structure)
    usual = {tuple(atoms): length for atoms, length in zip(pairs.tolist(), reference.tolist(), strict=True)}
    lines, residue_index = [], structure.atom_residue
    for (i, j), length in zip(bonds.tolist(), distance(*x[bonds.T]).tolist(), strict=True):
        first, second = structure.atom(i), structure.atom(j)
        partner_residue = "" if residue_index[i] == residue_index[j] else f" of {second.residue.label}"
        sizes = f"{ANGSTROM_PER_NM * length:.2f} angstrom long, not {ANGSTROM_PER_NM * usual[i, j]:.2f}"
        lines.append(f"{first.name} of {first.residue.label} to {second.name}{partner_residue}, {sizes}")
    return lines


@per_structure
def _references(structure: Structure) -> tuple[Integers, Floats, Floats, Floats]:
    """Bonds (n, 2) without metals, their reference lengths and bounds (n,), nm."""
    bonds = structure.bonds[~metals(structure)[structure.bonds].any(axis=1)]
    length = norms(structure, bonds, *_FILES)[:, 0]
    # A molecule with parameters of its own is not described by the names of its residue.
    key = bonds @ [structure.n_atoms, 1]
    order = np.argsort(key)
    for molecule in (*structure.ligands, *structure.fragments):
        term = molecule.ligand.parameters.bonds
        pairs = np.sort(molecule.atoms[term.atoms], axis=1)
        term_key = pairs @ [structure.n_atoms, 1]
        place = order[np.minimum(np.searchsorted(key, term_key, sorter=order), len(key) - 1)]
        is_bond = (key[place] == term_key) & (pairs >= 0).all(axis=1)
        length[place[is_bond]] = term.parameters[is_bond, 0]
    reach = covalent_radii(structure)[bonds].sum(axis=1) / ANGSTROM_PER_NM
    loose = np.isnan(length) | (structure.atom_element[bonds] == "H").any(axis=1)
    slack = np.where(loose & structure.obstacle[bonds].all(axis=1), _LONG, WINDOW)
    length = np.where(np.isnan(length), reach, length)
    return bonds, length, np.where(loose, _SHORT * length, length - WINDOW), length + slack


@per_structure
def covalent_radii(structure: Structure) -> Floats:
    """(na,) float, angstrom: covalent radii."""
    return np.array([gemmi.Element(str(symbol)).covalent_r for symbol in structure.atom_element])


@per_structure
def metals(structure: Structure) -> NDArray[np.bool_]:
    """(na,) bool: metals."""
    symbols = np.unique(structure.atom_element)
    return np.isin(structure.atom_element, [s for s in symbols if gemmi.Element(str(s)).is_metal])
