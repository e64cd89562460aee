"""Minima of a search: equality, clusters, and free energies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from protochain.batches.ensembles import cluster_distances, rmsds
from protochain.chains.chain import Chain
from protochain.core.arrays import Floats, Integers, Value
from protochain.core.lazy_pandas import pd
from protochain.core.units import ANGSTROM_PER_NM, MOLAR_GAS

if TYPE_CHECKING:
    from protochain.chains.hinges import Hinge

SAME_ENERGY, SAME_TORSION = 0.5, 0.2
"""Tolerances of equal minima: kJ/mol, and rad of the torsion that differs most. Descents end at torques of
0.1 kJ/mol/rad, a hundredth of a radian from the minimum along soft torsions. Rings are not exactly
symmetric under half turns."""

ALIKE = 1.0
"""angstrom. C-alpha RMSD at which average linkage cuts clusters."""

HALF_TURNS = {("PHE", "chi2"), ("ASP", "chi2"), ("GLU", "chi3"), ("ARG", "chi5")}
"""Torsions whose half turn exchanges equivalent atoms."""


@dataclass(frozen=True, eq=False)
class Symmetry(Value):
    """Turns of the torsions of a chain that only exchange atoms of one element in a symmetric group."""

    period: Floats  # (n,) rad: Turn of each single coordinate.
    paired: Integers  # (k, 2): Coordinates whose joint half turns exchange equivalent atoms, as in tyrosine.

    @classmethod
    def of(cls, chain: Chain) -> Symmetry:
        """Find the symmetric groups of a chain: methyl, NH3+, carboxylate, guanidinium, aromatic rings."""
        structure = chain.structure
        period, paired = np.full(chain.n_q, 2.0 * np.pi), []
        coordinates = chain.tree.q_start[chain.hinge_body].tolist()
        rotors = {h.atoms[1]: q for h, q in zip(chain.hinges, coordinates, strict=True) if h.kind == "rotor"}
        for hinge, coordinate in zip(chain.hinges, coordinates, strict=True):
            residue = _atoms_of(chain, hinge)
            # psi of the last residue turns a carboxylate.
            of_carboxylate = hinge.kind == "psi" and structure.atom_name[hinge.atoms[3]] == "O"
            is_half = (hinge.residue_name, hinge.kind) in HALF_TURNS and not _is_acid(hinge, residue)
            if of_carboxylate or is_half:
                period[coordinate] = np.pi
            near = structure.neighbours[hinge.atoms[2]] if hinge.kind == "rotor" else ()
            if sum(structure.atom_element[k] == "H" for k in near) == 3:
                period[coordinate] = 2.0 * np.pi / 3.0
            if (hinge.residue_name, hinge.kind) == ("TYR", "chi2"):
                # The ring is symmetric if its hydroxyl turns too, or has no hydrogen.
                if "HH" not in residue:
                    period[coordinate] = np.pi
                elif residue["CZ"] in rotors:
                    paired.append((coordinate, rotors[residue["CZ"]]))
        return cls(period, np.array(paired, dtype=np.int64).reshape(-1, 2))

    def farthest(self, q: Floats, q_other: Floats) -> Floats:
        """Largest difference, rad, of a torsion of q (..., n) and q_other (..., n)."""
        return np.asarray(np.max(self._differences(q, q_other), axis=-1))

    def distance(self, q: Floats, q_other: Floats) -> Floats:
        """Sum of the differences, rad, of all torsions of q (..., n) and q_other (..., n)."""
        return np.asarray(np.sum(self._differences(q, q_other), axis=-1))

    def _differences(self, q: Floats, q_other: Floats) -> Floats:
        """Smallest differences (..., n), rad, over the symmetric images of each group."""
        turn = q - q_other
        differences = np.abs(turn - self.period * np.rint(turn / self.period))
        for pair in self.paired:
            image = np.pi - differences[..., pair]
            nearer = image.sum(axis=-1) < differences[..., pair].sum(axis=-1)
            differences[..., pair] = np.where(nearer[..., None], image, differences[..., pair])
        return differences


def _atoms_of(chain: Chain, hinge: Hinge) -> dict[str, int]:
    """Atoms of the residue of a hinge by name."""
    structure = chain.structure
    atoms = np.flatnonzero(structure.atom_residue == structure.atom_residue[hinge.atoms[1]])
    return {str(structure.atom_name[k]): int(k) for k in atoms}


def _is_acid(hinge: Hinge, residue: dict[str, int]) -> bool:
    """Whether the hinge turns a carboxyl group that has its hydrogen."""
    hydrogens = {"ASP": {"HD1", "HD2"}, "GLU": {"HE1", "HE2"}}.get(hinge.residue_name, set())
    return not hydrogens.isdisjoint(residue)


def unique(q: Floats, energy: Floats, symmetry: Symmetry) -> Integers:
    """Indices of the minima that differ from all lower minima, the lowest first."""
    # q (m, n) rad, energy (m,) kJ/mol -> (k,) int.
    distinct: list[int] = []
    first = 0
    for k in np.argsort(energy, kind="stable").tolist():
        if not np.isfinite(energy[k]):
            break
        while first < len(distinct) and energy[distinct[first]] < energy[k] - SAME_ENERGY:
            first += 1
        near = distinct[first:]
        if not near or np.min(symmetry.farthest(q[near], q[k])) > SAME_TORSION:
            distinct.append(k)
    return np.array(distinct, dtype=np.int64)


def clusters(positions: Sequence[Floats]) -> Integers:
    """Cluster, from 1, of each of m sets of C-alphas (n, 3), nm, in the order of first members."""
    # Average linkage over the RMSD of superposed pairs.
    if len(positions) < 2:
        return np.ones(len(positions), dtype=np.int64)
    labels, _ = cluster_distances(ANGSTROM_PER_NM * rmsds(positions), ALIKE)
    return np.asarray(1 + pd.factorize(labels)[0], dtype=np.int64)


def free_energy(energy: float, hessian: Floats, temperature: float, log_det_mass: float = 0.0) -> float:
    """Harmonic free energy of a minimum, kJ/mol."""
    # energy kJ/mol, hessian (n, n) kJ/mol/rad^2, temperature K.
    kt = MOLAR_GAS * temperature
    sign, log_det = np.linalg.slogdet(hessian / (2.0 * np.pi * kt))
    if sign <= 0.0 or np.linalg.eigvalsh(hessian)[0] <= 0.0:
        return np.nan
    return float(energy + 0.5 * kt * (log_det - log_det_mass))
