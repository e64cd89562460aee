"""Stereocentres that differ from the residues' names, and D-amino acids under names of L.

Older files name D-amino acids as L. Inverted residues with a well-formed C-alpha are D-amino acids
by their coordinates if phi is positive. In chains that are mirror images all residues are.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from protochain.core.arrays import Floats, Integers, read_only
from protochain.structure.molecule.chirality import WELL_FORMED, chiral_atoms, mirror_images, volume
from protochain.structure.molecule.model import Structure
from protochain.validation.layout import peptides


class Expected(NamedTuple):
    """Expected stereocentres of a structure."""

    # (n, 4) int: Stereocentre, and three neighbours in an order that should span a positive volume.
    atoms: Integers
    unnamed: Integers  # (m,) int: Residues that are D-amino acids by their coordinates, under names of L.


@lru_cache(maxsize=2)
def expected_stereocentres(structure: Structure) -> Expected:
    """Find the stereocentres expected from names of residues or sources. D under names of L stay."""
    atoms, x = chiral_atoms(structure), structure.positions
    residue, size = structure.atom_residue[atoms[:, 0]], volume(x[atoms])
    is_d = structure.mirrored[residue]
    phi = peptides(structure, x)[0][residue]
    alpha = np.isin(atoms[:, 0], structure.alpha_carbons)
    # A missing phi, at the start of a chain, does not exclude D.
    meant = alpha & ~is_d & (size < -WELL_FORMED) & ~(phi < 0.0)
    unnamed = np.unique(np.concatenate([residue[meant], *mirror_images(structure).values()])).astype(np.int64)
    is_positive = np.where(np.isin(residue, unnamed), size >= 0.0, ~is_d)
    swapped = atoms[:, [0, 2, 1, 3]]
    return Expected(read_only(np.where(is_positive[:, None], atoms, swapped), np.int64), unnamed)


def inverted_stereocentres(structure: Structure, x: Floats) -> Integers:
    """(n,) int: stereocentres whose chirality at positions x (na, 3), nm, differs from the expected."""
    atoms = expected_stereocentres(structure).atoms
    return np.unique(atoms[volume(x[atoms]) < 0.0, 0])
