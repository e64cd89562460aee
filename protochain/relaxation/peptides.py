"""Peptide bonds while a structure is relaxed: twisted ones are turned to trans or cis, and none is lost."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from protochain.core.arrays import Floats, Integers, dihedral_slopes
from protochain.structure.molecule.model import Structure
from protochain.validation.layout import dihedrals, layout
from protochain.validation.omega import PERPENDICULAR, PLANAR, omegas

_STIFFNESS = 1000.0
"""kJ/mol/rad^2. Springs to a bad model twist against the 84 kJ/mol/rad with which ff14SB resists at most; as
much again holds them 5 degrees beyond the usual."""
_USUAL = 25.0
"""Degrees from the form that a bond should have up to which it feels nothing: 6 are usual in crystals."""
_HARMONIC = np.radians(15.0)
"""Beyond it the torque grows no more: three times that of ff14SB, which draws no angle straight."""
_NEAR = 0.34
"""nm between the C-alphas: 0.29 where a bond is cis, 0.38 where it is trans. Noise turns omega the more."""
_SHORTEST = 0.01
"""nm. Shorter bonds turn no faster."""


@dataclass(frozen=True, eq=False)
class PeptideBonds:
    """Push of peptide bonds to trans or cis: E = k/2 sum max(0, d - d0)^2, d the angle from that form.

    A bond of usual shape feels nothing. Where d is large, E grows in proportion to it (Huber's function).
    """

    atoms: Integers  # (n, 4) int: C-alpha, C, N and C-alpha of each bond.
    cis: NDArray[np.bool_]  # (n,) bool: Whether it should be cis.

    @staticmethod
    @lru_cache(maxsize=2)
    def of(structure: Structure) -> "PeptideBonds":
        """Find the peptide bonds of a protein, and the form that each should have.

        That is trans, but where the file has it cis, and before proline where cis is nearer; and then only if
        the C-alphas are as near as in a cis bond.
        """
        bonds, amino = omegas(structure), layout(structure)
        before, after = amino.atoms("CA", "C")[amino.before], amino.atoms("N", "CA")
        atoms = np.hstack([before, after])[bonds.residue]
        distance = np.linalg.norm(structure.positions[atoms[:, 0]] - structure.positions[atoms[:, 3]], axis=1)
        nearer = bonds.proline & (np.abs(bonds.omega) < PERPENDICULAR)
        return PeptideBonds(atoms, (bonds.cis | nearer) & (distance < _NEAR))

    def away(self, x: Floats) -> Floats:
        """Angles (n,) from the form that each bond should have, degrees, at positions x (na, 3), nm."""
        return self._away(dihedrals(x, self.atoms))

    def _away(self, angles: Floats) -> Floats:
        return np.where(self.cis, np.abs(angles), 180.0 - np.abs(angles))

    def twisted_bonds(self, x: Floats) -> Integers:
        """(n,) int: nitrogens of the bonds that are twisted, or cis for trans, or trans for cis."""
        return self.atoms[self.away(x) > PLANAR, 2]

    def reversed_bonds(self, x: Floats) -> Integers:
        """(n,) int: nitrogens of the twisted bonds that are nearer to the other form, beyond a barrier."""
        return self.atoms[self.away(x) > PERPENDICULAR, 2]

    def __call__(self, x: Floats) -> tuple[float, Floats]:
        """Energy and forces."""
        forces, angles = np.zeros_like(x), dihedrals(x, self.atoms)
        beyond = np.radians(self._away(angles) - _USUAL)
        far = beyond > 0.0
        if not far.any():
            return 0.0, forces
        atoms, beyond = self.atoms[far], beyond[far]
        outward = np.where(self.cis[far], 1.0, -1.0) * np.sign(angles[far])
        slopes = dihedral_slopes(x[atoms], _SHORTEST)
        bent = np.minimum(beyond, _HARMONIC)
        np.subtract.at(forces, atoms, (_STIFFNESS * bent * outward)[:, None, None] * slopes)
        return float(_STIFFNESS * bent @ (beyond - 0.5 * bent)), forces
