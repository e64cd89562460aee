"""Contacts and steric overlaps of nonbonded atoms."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from protochain.chains.chain import Chain
from protochain.core import graph
from protochain.core.arrays import Floats, Integers, read_only
from protochain.core.units import ANGSTROM_PER_NM
from protochain.structure.molecule.links import is_metal, usual_length
from protochain.structure.molecule.model import Structure, per_positions, per_structure
from protochain.structure.molecule.residues import VAN_DER_WAALS
from protochain.structure.preparation.linkage import COVALENT_SLACK

OVERLAP = 0.5
"""Nonbonded atoms closer than this fraction of the sum of their van der Waals radii overlap. Hydrogen bonds
stay above 0.6."""
_NEAR = 0.8  # Fraction that includes all pairs of atoms as close as bonded atoms.
ALPHA_REACH, SEPARATION = 0.8, 3
"""nm between C-alphas in contact, and least number of residues from one to the other in a chain."""


@dataclass(frozen=True)
class Overlap:
    """Two nonbonded atoms that overlap."""

    first: str  # Descriptions of the atoms.
    second: str
    distance_angstrom: float
    share: float  # Distance as a fraction of the sum of the van der Waals radii.
    remedy: str  # Methods that can separate them.
    atoms: tuple[int, int]  # Indices.

    def __str__(self) -> str:
        return (
            f"{self.first} and {self.second} are {self.distance_angstrom:.2f} angstrom apart, "
            f"{100 * self.share:.0f} % of contact"
        )


def alpha_contacts(structure: Structure, x: Floats) -> Integers:
    """Pairs (n, 2) of C-alphas that are in contact at positions x (na, 3), nm."""
    alphas = structure.alpha_carbons
    if not len(alphas):
        return np.empty((0, 2), dtype=int)
    pairs = alphas[cKDTree(x[alphas]).query_pairs(ALPHA_REACH, output_type="ndarray")]
    residues = structure.atom_residue[pairs]
    is_one_chain = np.diff(structure.residue_chain_index[residues])[:, 0] == 0
    return np.asarray(pairs[~is_one_chain | (np.abs(np.diff(residues)[:, 0]) >= SEPARATION)])


@per_structure
def radii(structure: Structure) -> Floats:
    """(na,) float, nm: van der Waals radii."""
    return read_only(np.array([VAN_DER_WAALS.get(str(element), 0.17) for element in structure.atom_element]))


def near_pairs(structure: Structure, x: Floats, share: float, bonds: int = 3) -> tuple[Integers, Floats]:
    """Sorted pairs (n, 2) closer than a share of summed radii (n,), nm, and over ``bonds`` bonds apart."""
    radius = radii(structure)
    pairs = cKDTree(x).query_pairs(2 * share * radius.max(), output_type="ndarray")
    # Obstacles do not move relative to each other.
    pairs = pairs[~structure.obstacle[pairs].all(axis=1)]
    touch = radius[pairs].sum(axis=1)
    close = np.linalg.norm(x[pairs[:, 0]] - x[pairs[:, 1]], axis=1) < share * touch
    pairs, touch = pairs[close], touch[close]
    n = structure.n_atoms
    keys = pairs[:, 0] * n + pairs[:, 1]
    excluded = _keys(structure, bonds)
    place = np.minimum(np.searchsorted(excluded, keys), len(excluded) - 1)
    order = np.flatnonzero(excluded[place] != keys) if len(excluded) else np.arange(len(keys))
    order = order[np.argsort(keys[order])]
    return pairs[order].astype(np.int64), touch[order]


@per_structure
def _keys(structure: Structure, bonds: int) -> Integers:
    """Ascending numbers i na + j of the pairs of :func:`bonded_pairs`."""
    return np.sort(bonded_pairs(structure, bonds) @ [structure.n_atoms, 1])


@per_structure
def bonded_pairs(structure: Structure, bonds: int) -> Integers:
    """(n, 2) int: pairs of atoms separated by at most this many bonds, the smaller index first."""
    return graph.pairs_within(structure.bonds, structure.n_atoms, bonds)


@per_positions
def overlapping(structure: Structure, x: Floats) -> tuple[Integers, Floats]:
    """Find the nonbonded pairs of atoms that overlap, as :func:`near_pairs` returns them."""
    # Atoms closer than ``OVERLAP``, and heavy atoms of the protein and of a hetero molecule that are as close
    # as bonded atoms without being bonded.
    if not structure.kept.any():
        pairs, touch = near_pairs(structure, x, OVERLAP)
        return read_only(pairs, np.int64), read_only(touch)
    pairs, touch, reach = *near_pairs(structure, x, _NEAR), _covalent(structure)
    distance = np.linalg.norm(x[pairs[:, 0]] - x[pairs[:, 1]], axis=1)
    # One atom is of the protein, the other of a hetero molecule.
    is_mixed = structure.kept[pairs[:, 0]] != structure.kept[pairs[:, 1]]
    as_bonded = is_mixed & (distance < reach[pairs].sum(axis=1))
    is_overlap = as_bonded | (distance < OVERLAP * touch)
    return read_only(pairs[is_overlap], np.int64), read_only(touch[is_overlap])


@per_structure
def _covalent(structure: Structure) -> Floats:
    """(na,) float, nm: radii whose sum is the longest bond of two atoms, -inf for hydrogens and metals."""
    radius = {
        symbol: -np.inf
        if symbol == "H" or is_metal(symbol)
        else 0.5 * (usual_length(symbol, symbol) + COVALENT_SLACK) / ANGSTROM_PER_NM
        for symbol in {*structure.atom_element.tolist()}
    }
    return read_only([radius[symbol] for symbol in structure.atom_element.tolist()])


def overlaps(structure: Structure, x: Floats, chain: Chain | None = None) -> list[Overlap]:
    """List the overlapping nonbonded pairs, worst first, and whether torsions can separate them."""
    pairs, touch = overlapping(structure, x)
    distance = np.linalg.norm(x[pairs[:, 0]] - x[pairs[:, 1]], axis=1)
    share = distance / touch
    groups = chain.rigid_groups if chain is not None and len(pairs) else None
    listed = []
    for k in np.argsort(share, kind="stable"):
        i, j = (int(atom) for atom in pairs[k])
        if distance[k] < 1e-4:
            remedy = "they coincide, so no force separates them: move one of them"
        elif groups is not None and set(groups[i]) & set(groups[j]) - {-1}:
            remedy = "they are in one rigid body: only cartesian, hybrid or openmm can separate them"
        else:
            remedy = "turning bonds can separate them: cartesian, hybrid, lbfgs and newton do so first"
        ends, away = (structure.describe(i), structure.describe(j)), float(ANGSTROM_PER_NM * distance[k])
        listed.append(Overlap(*ends, away, float(share[k]), remedy, (i, j)))
    return listed
