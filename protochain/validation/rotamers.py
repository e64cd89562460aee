"""Side chains far from every usual rotamer.

The rotamers are those of the penultimate library (Lovell, Word, Richardson, Richardson, Proteins 40:389, 2000),
and what counts is the distance to the nearest. MolProbity instead takes the density of the Top8000 set, whose
contours have no licence that would allow to distribute them: its outliers are others in part.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from protochain.arrays import Floats, Integers
from protochain.residues import CHI
from protochain.structure.model import Structure
from protochain.structure.rotamers import rotamers
from protochain.validation.layout import NONE, dihedrals, layout

LIMIT = 40.0
"""Degrees from the nearest rotamer, in that of its dihedrals which is farthest off, beyond which it is none."""
_SYMMETRIC = {"ASP": 180.0, "GLU": 180.0, "PHE": 180.0, "TYR": 180.0}
"""Period of the last dihedral in degrees, where not 360."""


class SideChains(NamedTuple):
    """Side chains with all their dihedrals.

    Parameters
    ----------
    residue : (n,) int
    distance : (n,) float, degrees
        Distance from the nearest rotamer, in the dihedral that is farthest off.
    """

    residue: Integers
    distance: Floats

    @property
    def outliers(self) -> Integers:
        """Residues farther from every rotamer than the limit."""
        return self.residue[self.distance > LIMIT]


def side_chains(structure: Structure, x: Floats | None = None) -> SideChains:
    """Measure how far each side chain is from the nearest rotamer of its residue.

    Parameters
    ----------
    structure : Structure
    x : (na, 3) float, nm, optional
        Other positions of its atoms.

    Returns
    -------
    SideChains
        Those of D-amino acids, if the file names them so, by their mirror image.
    """
    x = structure.positions if x is None else x
    mirrored = layout(structure).mirrored
    residue, distance = [], []
    for name, its, quadruples in _dihedrals(structure):
        usual = np.degrees(rotamers(name)[0])
        chi = dihedrals(x, quadruples.reshape(-1, 4)).reshape(len(its), -1)
        chi *= np.where(mirrored[its], -1.0, 1.0)[:, None]
        period = np.full(chi.shape[1], 360.0)
        period[-1] = _SYMMETRIC.get(name, 360.0)
        off = np.abs((chi[:, None] - usual + period / 2) % period - period / 2)
        residue.append(its)
        distance.append(off.max(axis=2).min(axis=1))
    order = np.argsort(np.concatenate([[], *residue]))
    return SideChains(
        np.concatenate([np.zeros(0, np.int64), *residue])[order], np.concatenate([[], *distance])[order]
    )


@lru_cache(maxsize=16)
def _dihedrals(structure: Structure) -> list[tuple[str, Integers, Integers]]:
    """Name, residues (n,), and atoms (n, n_chi, 4) of their dihedrals, for each kind of residue with rotamers."""
    found = layout(structure)
    kinds = []
    for name in np.unique(structure.residue_name[found.amino]).tolist():
        if name not in CHI:
            continue
        its = np.flatnonzero(found.amino & (structure.residue_name == name))
        n_chi = rotamers(name)[0].shape[1]
        atoms = np.stack([found.atoms(*names)[its] for names in CHI[name][:n_chi]], axis=1)
        whole = (atoms != NONE).all(axis=(1, 2))
        kinds.append((name, its[whole], atoms[whole]))
    return kinds
