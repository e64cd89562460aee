"""Side chains far from every usual rotamer.

The rotamers are from the Top8000 set (Hintze, Lewis, Richardson, Richardson, Proteins 84:1177, 2016), and
the distance to the nearest counts. MolProbity uses the density of the same set. Its contours may not be
distributed. On 20 structures this module finds 251 of MolProbity's 319 outliers, and 74 more.
"""

import csv
from collections import defaultdict
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from protochain.core.arrays import Floats, Integers
from protochain.structure.molecule.model import Structure, per_structure
from protochain.structure.molecule.residues import CHI, SYMMETRIC
from protochain.validation.layout import NONE, dihedrals, layout, positions

_LIMITS = {
    **dict.fromkeys(("CYS", "ILE", "SER", "THR", "VAL"), 26.0),
    **dict.fromkeys(("ASN", "ASP", "GLU", "HIS", "LEU", "PHE", "TRP", "TYR"), 38.0),
    **dict.fromkeys(("ARG", "GLN", "LYS", "MET"), 42.0),
}
"""Degrees from a rotamer within which each dihedral of a side chain must be."""
_WIDE = {
    **dict.fromkeys(("HIS", "TRP"), 95.0), "ASN": 114.0, "GLN": 152.0,
    **dict.fromkeys(("ASP", "GLU", "PHE", "TYR"), 90.0),
}  # fmt: skip
"""The same for the last dihedral at a planar group. For a symmetric group, 90 covers all angles."""


class SideChains(NamedTuple):
    """Side chains with all their dihedrals."""

    residue: Integers  # (n,) int.
    rotamer: NDArray[np.str_]  # (n,) str: Name of the nearest rotamer.
    # (n,): Distance from it in the dihedral that is farthest off, as a fraction of the limit.
    distance: Floats

    @property
    def outliers(self) -> Integers:
        """Residues farther from every rotamer than the limit."""
        return self.residue[self.distance > 1.0]


def side_chains(structure: Structure, x: Floats | None = None) -> SideChains:
    """Find the nearest rotamer of each side chain, at positions x (na, 3) or the structure's own."""
    # The limits were chosen for agreement with MolProbity's contours on 20 structures, without Arg and Lys.
    x = positions(structure, x)
    mirrored = structure.mirrored
    n = structure.n_residues
    name, distance = np.zeros(n, dtype="U8"), np.full(n, np.nan)
    kinds, quadruples = _dihedrals(structure)
    chis = iter(dihedrals(x, quadruples))
    for kind, residues in kinds:
        names, usual = rotamers()[kind]
        chi = np.fromiter(chis, float, usual.shape[1] * len(residues)).reshape(len(residues), -1)
        chi *= np.where(mirrored[residues], -1.0, 1.0)[:, None]
        period, limit = np.full(chi.shape[1], 360.0), np.full(chi.shape[1], _LIMITS[kind])
        period[-1] = 180.0 if kind in SYMMETRIC else 360.0
        limit[-1] = _WIDE.get(kind, limit[-1])
        deviation = (np.abs((chi[:, None] - usual + period / 2) % period - period / 2) / limit).max(axis=2)
        name[residues], distance[residues] = names[deviation.argmin(axis=1)], deviation.min(axis=1)
    residue = np.flatnonzero(np.isfinite(distance))
    return SideChains(residue, name[residue], distance[residue])


@cache
def rotamers() -> dict[str, tuple[NDArray[np.str_], Floats]]:
    """Names (n,) of the rotamers of each residue, and their dihedrals (n, n_chi) in degrees."""
    names, dihedrals_of = defaultdict[str, list[str]](list), defaultdict[str, list[list[float]]](list)
    with (Path(__file__).parent / "data" / "rotamers.csv").open(newline="", encoding="utf-8") as file:
        for residue, name, _, *chi in list(csv.reader(file))[1:]:
            names[residue].append(name)
            dihedrals_of[residue].append([float(angle) for angle in chi if angle])
    return {residue: (np.array(names[residue]), np.array(rows)) for residue, rows in dihedrals_of.items()}


@per_structure
def _dihedrals(structure: Structure) -> tuple[list[tuple[str, Integers]], Integers]:
    """Name and residues (n,) of each kind with rotamers, and atoms (m, 4) of all dihedrals, in order."""
    amino = layout(structure)
    kinds, quadruples = [], [np.zeros((0, 4), dtype=np.int64)]
    for name in sorted(CHI.keys() & set(structure.residue_name[amino.amino].tolist())):
        residues = np.flatnonzero(amino.amino & (structure.residue_name == name))
        n_chi = rotamers()[name][1].shape[1]
        atoms = np.stack([amino.atoms(*names)[residues] for names in CHI[name][:n_chi]], axis=1)
        complete = (atoms != NONE).all(axis=(1, 2))
        kinds.append((name, residues[complete]))
        quadruples.append(atoms[complete].reshape(-1, 4))
    return kinds, np.concatenate(quadruples)
