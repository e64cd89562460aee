"""Restraint on chiral atoms, which corrects inverted stereocentres and preserves the others."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from protochain.core.arrays import Floats, Integers, cross
from protochain.structure.molecule.chirality import volume
from protochain.structure.molecule.model import Structure
from protochain.validation.stereocentres import expected_stereocentres

_STIFFNESS = 1e8
"""kJ/mol/nm^6. Inverting an atom costs about 1000 kJ/mol, more than overlaps and springs provide."""
_HEAVY, _WITH_HYDROGEN = 1.4e-3, 0.9e-3
"""nm^3, volumes below which an atom is pushed: of three heavy neighbours, and with a hydrogen. Ideal residues
have 2.5e-3 and 1.8e-3. Frames of dynamics have more than 1.6e-3 and 1.0e-3."""


@dataclass(frozen=True, eq=False)
class ChiralityRestraint:
    """Harmonic restraint on signed volumes: E = k/2 sum (v0 - v)^2 over the volumes v that are below v0.

    Three bonds of an atom span a volume. All triples of its bonds count, so that its hydrogen also moves to
    the correct side. The restraint is zero at an atom of usual shape.

    atoms (n, 4) int: Centre and three neighbours, ordered for a positive volume.
    least (n,) nm^3: Volumes v0, below which they are pushed.
    """

    atoms: Integers
    least: Floats

    @staticmethod
    @lru_cache(maxsize=2)
    def of(structure: Structure) -> "ChiralityRestraint":
        """Find the chiral atoms of a protein and its ligands, and the expected signs of their volumes."""
        rows = list[tuple[int, ...]]()
        for centre, a, b, c in expected_stereocentres(structure).atoms.tolist():
            rows.append((centre, a, b, c))
            for d in {*structure.neighbours[centre]} - {a, b, c}:
                rows += [(centre, b, a, d), (centre, c, b, d), (centre, a, c, d)]
        atoms = np.array(rows, dtype=np.int64).reshape(-1, 4)
        hydrogen = (structure.atom_element[atoms] == "H").any(axis=1)
        return ChiralityRestraint(atoms, np.where(hydrogen, _WITH_HYDROGEN, _HEAVY))

    @classmethod
    def preserving(cls, structure: Structure) -> "ChiralityRestraint":
        """Find the chiral atoms whose configuration is correct at the structure's positions."""
        restraint = cls.of(structure)
        is_correct = ~np.isin(restraint.atoms[:, 0], restraint.inversions(structure.positions))
        return cls(restraint.atoms[is_correct], restraint.least[is_correct])

    def inversions(self, x: Floats) -> Integers:
        """(n,) int: inverted stereocentres at positions x (na, 3), nm."""
        heavy = self.atoms[self.least == _HEAVY]
        return np.unique(heavy[volume(x[heavy]) < 0.0, 0])

    def low_volumes(self, x: Floats) -> Integers:
        """(n,) int: chiral atoms that are pushed at positions x (na, 3), nm."""
        return np.unique(self.atoms[volume(x[self.atoms]) < self.least, 0])

    def __call__(self, x: Floats) -> tuple[float, Floats]:
        """Energy and forces."""
        forces, short = np.zeros_like(x), self.least - volume(x[self.atoms])
        low = short > 0.0
        atoms, short = self.atoms[low], short[low]
        a, b, c = (x[atoms[:, k]] - x[atoms[:, 0]] for k in (1, 2, 3))
        push = _STIFFNESS * short[:, None]
        for k, gradient in enumerate((cross(b, c), cross(c, a), cross(a, b)), start=1):
            np.add.at(forces, atoms[:, k], push * gradient)
            np.subtract.at(forces, atoms[:, 0], push * gradient)
        return float(0.5 * _STIFFNESS * short @ short), forces
