"""Hydrogen bonds, salt bridges, and secondary structure."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from protochain.core.arrays import Integers, angle
from protochain.core.graph import both_ways
from protochain.core.units import ANGSTROM_PER_NM
from protochain.structure.convert import to_mdtraj
from protochain.structure.molecule.model import Structure

_REACH, _ANGLE = 0.25, np.radians(120.0)
"""nm from a hydrogen to its acceptor, and rad at the hydrogen: within and beyond."""
_SALT = 4.0
"""Angstrom from a nitrogen of Arg or Lys to an oxygen of Asp, Glu or a phosphate: Barlow, Thornton, J. Mol.
Biol. 168:867 (1983)."""
_CATION, _ANION = ("NZ", "NE", "NH1", "NH2"), ("OD1", "OD2", "OE1", "OE2")
_PHOSPHATE = ("OP1", "OP2", "OP3", "O1P", "O2P", "O3P")
FOLD = {"H": "helix", "E": "strand", "C": "loop"}


def hydrogen_bonds(structure: Structure) -> Integers:
    """(n, 3) int: donor, hydrogen, acceptor. All counts, changes and scores use this definition."""
    # That of mdtraj.baker_hubbard, after Baker, Hubbard, Prog. Biophys. Mol. Biol. 44:97 (1984): the hydrogen
    # of an N or O within 2.5 angstrom of another N or O, at an angle above 120 degrees, and no waters.
    x, element = structure.positions, structure.atom_element
    polar = np.isin(element, ["N", "O"]) & (structure.residue_name != "HOH")[structure.atom_residue]
    ends = both_ways(structure.bonds)
    donor, hydrogen = ends[polar[ends[:, 0]] & (element[ends[:, 1]] == "H")].T
    acceptor = np.flatnonzero(polar)
    if not len(donor):
        return np.empty((0, 3), dtype=np.int64)
    pairs = cKDTree(x[hydrogen]).sparse_distance_matrix(cKDTree(x[acceptor]), _REACH, output_type="ndarray")
    pairs = pairs[pairs["v"] < _REACH]
    near = np.column_stack([donor[pairs["i"]], hydrogen[pairs["i"]], acceptor[pairs["j"]]])
    near = near[near[:, 0] != near[:, 2]]
    bonds = near[angle(*x[near.T]) > _ANGLE]
    return np.asarray(bonds[np.lexsort((bonds[:, 2], bonds[:, 1]))])


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
    return {(int(of[plus[i]]), int(of[minus[j]])) for i, partners in enumerate(near) for j in partners}


def secondary_structure(structure: Structure) -> NDArray[np.str_]:
    """(nr,) helix, strand or loop by mdtraj's DSSP (Kabsch, Sander 1983), empty for other residues."""
    import mdtraj

    codes = mdtraj.compute_dssp(to_mdtraj(structure))[0]
    return np.array([FOLD.get(str(code), "") for code in codes])
