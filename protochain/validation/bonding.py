"""Hydrogen bonds, salt bridges, and secondary structure."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from protochain.core.arrays import Integers
from protochain.core.units import ANGSTROM_PER_NM
from protochain.structure.convert import to_mdtraj
from protochain.structure.model import Structure

_SALT = 4.0
"""Angstrom from a nitrogen of Arg or Lys to an oxygen of Asp, Glu or a phosphate: Barlow, Thornton, J. Mol.
Biol. 168:867 (1983)."""
_CATION, _ANION = ("NZ", "NE", "NH1", "NH2"), ("OD1", "OD2", "OE1", "OE2")
_PHOSPHATE = ("OP1", "OP2", "OP3", "O1P", "O2P", "O3P")


def hydrogen_bonds(structure: Structure, some: NDArray[np.bool_] | None = None) -> Integers:
    """(n, 3) int: donor, hydrogen, acceptor by Baker and Hubbard (2.5 angstrom, 120 degrees), by mdtraj."""
    import mdtraj

    whole = to_mdtraj(structure)
    if some is None:
        return np.asarray(mdtraj.baker_hubbard(whole, periodic=False), dtype=np.int64).reshape(-1, 3)
    atoms = np.flatnonzero(some)
    found = mdtraj.baker_hubbard(whole.atom_slice(atoms), periodic=False)
    return np.asarray(atoms[np.asarray(found, dtype=np.int64).reshape(-1, 3)])


def salt_bridges(structure: Structure) -> set[tuple[int, int]]:
    """Residues of Arg or Lys, and of Asp, Glu or a nucleotide with charged oxygens within 4 angstrom."""
    of, name = structure.atom_residue, structure.residue_name[structure.atom_residue]
    plus = np.flatnonzero(np.isin(name, ["ARG", "LYS"]) & np.isin(structure.atom_name, _CATION))
    acid = np.isin(name, ["ASP", "GLU"]) & np.isin(structure.atom_name, _ANION)
    minus = np.flatnonzero(acid | np.isin(structure.atom_name, _PHOSPHATE))
    if not len(plus) or not len(minus):
        return set()
    x = structure.positions * ANGSTROM_PER_NM
    near = cKDTree(x[plus]).query_ball_tree(cKDTree(x[minus]), _SALT)
    return {(int(of[plus[i]]), int(of[minus[j]])) for i, its in enumerate(near) for j in its}


def secondary_structure(structure: Structure) -> NDArray[np.str_]:
    """(nr,) helix, strand or loop by mdtraj's DSSP (Kabsch, Sander 1983); empty for what is no amino acid."""
    import mdtraj

    codes = mdtraj.compute_dssp(to_mdtraj(structure))[0]
    return np.array([FOLD.get(str(code), "") for code in codes])


FOLD = {"H": "helix", "E": "strand", "C": "loop"}
