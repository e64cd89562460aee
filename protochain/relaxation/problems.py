"""Problems of a structure during its relaxation, computed once per set of positions."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from protochain.chains.contacts import overlapping
from protochain.core.arrays import Floats, Integers
from protochain.minimisers.restraints import ChiralityRestraint
from protochain.relaxation.restraints import PeptideBonds
from protochain.structure import Structure
from protochain.validation import threaded_rings, violations
from protochain.validation.rings import ThreadedRing
from protochain.validation.violations import Violations


@dataclass(frozen=True, eq=False)
class Problems:
    """Problems at positions x (na, 3), nm. Each is computed on first access."""

    structure: Structure
    x: Floats
    moving: NDArray[np.bool_] | None = None  # (na,) bool: Peptides and violations have one of these atoms.
    fixed: bool = False  # Whether they have none of these atoms instead.

    def concerns(self, atoms: Integers) -> NDArray[np.bool_]:
        """(n,) bool: rows of atoms (n, k) that count."""
        if self.moving is None:
            return np.ones(len(atoms), dtype=bool)
        return np.asarray(self.moving[atoms].any(axis=1) != self.fixed)

    @cached_property
    def overlaps(self) -> Integers:
        """(n, 2) int: pairs of atoms."""
        return overlapping(self.structure, self.x)[0]

    @property
    def n_hetero_overlaps(self) -> int:
        """Number of overlapping pairs of an atom of the protein and an atom of a hetero molecule."""
        is_hetero = self.structure.kept[self.overlaps]
        return int((is_hetero[:, 0] != is_hetero[:, 1]).sum())

    @cached_property
    def rings(self) -> list[ThreadedRing]:
        """Rings with a bond through them."""
        return threaded_rings(self.structure, self.x)

    @cached_property
    def inversions(self) -> Integers:
        """(n,) int: inverted stereocentres."""
        return ChiralityRestraint.of(self.structure).inversions(self.x)

    @cached_property
    def peptides(self) -> Integers:
        """(n,) int: nitrogens of twisted peptide bonds."""
        bonds = PeptideBonds.of(self.structure)
        counted = bonds.atoms[self.concerns(bonds.atoms), 2]
        return np.intersect1d(bonds.twisted_bonds(self.x), counted)

    @cached_property
    def reversed_peptides(self) -> Integers:
        """(n,) int: nitrogens of the twisted peptide bonds that are nearer to the other form."""
        return PeptideBonds.of(self.structure).reversed_bonds(self.x)

    @cached_property
    def violations(self) -> Violations:
        """Bonds, angles and distances beyond their limits."""
        return violations(self.structure, self.x)

    @property
    def counted_rings(self) -> list[ThreadedRing]:
        """Threaded rings that count."""
        return [ring for ring in self.rings if self.concerns(np.array([[*ring.atoms, *ring.bond]]))[0]]

    def of_rings(self) -> list[int]:
        """Residues of threaded rings that count, and of the bonds through them."""
        rings = self.counted_rings
        return [int(self.structure.atom_residue[i]) for ring in rings for i in (*ring.atoms, *ring.bond)]

    def mendable(self) -> NDArray[np.bool_]:
        """(nr,) bool: residues with violations, except violations of absent bonds at chain breaks only."""
        structure, outliers = self.structure, self.violations
        n, residue_of = structure.n_atoms, structure.atom_residue
        bonded = np.sort(structure.bonds, axis=1) @ [n, 1]
        excused, counted = np.zeros((2, structure.n_residues), dtype=bool)
        joints = (outliers.bonds, (0, 1)), (outliers.angles_ca_c_n, (1, 2)), (outliers.angles_c_n_ca, (0, 1))
        rows = [
            (atoms, np.isin(np.sort(atoms[:, ends], axis=1) @ [n, 1], bonded) & self.concerns(atoms))
            for atoms, ends in joints
        ]
        rows += [(a, self.concerns(a)) for a in (outliers.clashes, outliers.within, outliers.covalent)]
        for atoms, counts in rows:
            excused[residue_of[atoms[~counts]]] = counted[residue_of[atoms[counts]]] = True
        return np.asarray(outliers.per_residue & ~(excused & ~counted))

    def residues(self, planar: bool) -> NDArray[np.bool_]:
        """(nr,) bool: residues with problems to mend, with twisted peptide bonds if ``planar``."""
        has_problem, residue_of = self.mendable(), self.structure.atom_residue
        has_problem[self.of_rings()] = True
        overlaps = self.overlaps[self.concerns(self.overlaps)]
        for atoms in (overlaps, self.inversions, *([self.peptides] if planar else [])):
            has_problem[residue_of[atoms]] = True
        return has_problem
