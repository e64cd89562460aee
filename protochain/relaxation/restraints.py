"""Restraints of a relaxation: peptide bonds are turned to trans or cis, folded planar atoms are flattened."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from protochain.core.arrays import Floats, Integers, dihedral_slopes
from protochain.structure.molecule.model import Structure, per_structure
from protochain.validation.layout import dihedrals, layout
from protochain.validation.omega import PERPENDICULAR, PLANAR, omegas

_STIFFNESS = 1000.0
"""kJ/mol/rad^2. ff14SB resists the twist by springs to a bad model with at most 84 kJ/mol/rad. At 5 degrees
beyond the usual range this term has the same torque."""
_USUAL = 25.0  # Degrees from the target form up to which the energy is 0. In crystals 6 degrees are usual.
_HARMONIC = np.radians(15.0)
"""Range beyond which the torque is constant: three times ff14SB's, which does not straighten angles."""
_NEAR = 0.34
"""nm between the C-alphas: 0.29 in cis bonds, 0.38 in trans bonds. Noise changes omega more than this."""
_SHORTEST = 0.01  # nm. Lower limit of bond lengths in the slopes of dihedrals.


@dataclass(frozen=True, eq=False)
class PeptideBonds:
    """Restraint of peptide bonds to trans or cis: E = k/2 sum max(0, d - d0)^2, d the angle from that form.

    The energy of bonds of usual shape is 0. At large d, E is linear (Huber's function).
    """

    atoms: Integers  # (n, 4) int: C-alpha, C, N and C-alpha of each bond.
    cis: NDArray[np.bool_]  # (n,) bool: Whether it should be cis.

    @staticmethod
    @lru_cache(maxsize=2)
    def of(structure: Structure) -> "PeptideBonds":
        """Find the peptide bonds of a protein, and their target forms.

        A cis target requires C-alphas as close as in a cis bond. The bond must also be cis in the file, or
        nearer to cis before a proline. All other targets are trans.
        """
        bonds, amino = omegas(structure), layout(structure)
        before, after = amino.atoms("CA", "C")[amino.before], amino.atoms("N", "CA")
        atoms = np.hstack([before, after])[bonds.residue]
        distance = np.linalg.norm(structure.positions[atoms[:, 0]] - structure.positions[atoms[:, 3]], axis=1)
        nearer = bonds.proline & (np.abs(bonds.omega) < PERPENDICULAR)
        return PeptideBonds(atoms, (bonds.cis | nearer) & (distance < _NEAR))

    def deviations(self, x: Floats) -> Floats:
        """Angles (n,) from the target forms, degrees, at positions x (na, 3), nm."""
        return self._deviations(dihedrals(x, self.atoms))

    def _deviations(self, angles: Floats) -> Floats:
        return np.where(self.cis, np.abs(angles), 180.0 - np.abs(angles))

    def twisted_bonds(self, x: Floats) -> Integers:
        """(n,) int: nitrogens of bonds that are twisted, or have the other form."""
        return self.atoms[self.deviations(x) > PLANAR, 2]

    def reversed_bonds(self, x: Floats) -> Integers:
        """(n,) int: nitrogens of twisted bonds that are nearer to the other form, beyond a barrier."""
        return self.atoms[self.deviations(x) > PERPENDICULAR, 2]

    def __call__(self, x: Floats) -> tuple[float, Floats]:
        """Energy and forces."""
        forces, angles = np.zeros_like(x), dihedrals(x, self.atoms)
        beyond = np.radians(self._deviations(angles) - _USUAL)
        far = beyond > 0.0
        if not far.any():
            return 0.0, forces
        atoms, beyond = self.atoms[far], beyond[far]
        outward = np.where(self.cis[far], 1.0, -1.0) * np.sign(angles[far])
        slopes = dihedral_slopes(x[atoms], _SHORTEST)
        bent = np.minimum(beyond, _HARMONIC)
        np.subtract.at(forces, atoms, (_STIFFNESS * bent * outward)[:, None, None] * slopes)
        return float(_STIFFNESS * bent @ (beyond - 0.5 * bent)), forces


_FLATTENING = 2000.0
"""kJ/mol. A force field maintains angles of 90 and 180 degrees. There torques are about 700 kJ/mol/rad."""
_UNUSUAL = 0.3
"""Threshold of the squared length of the sum of the three directions. It is 0 for angles of 120 degrees, at
most 0.05 in rings of usual shape, and above 1 if all neighbours are on one side."""


@dataclass(frozen=True, eq=False)
class Planes:
    """Restraint of planar atoms to the centre of their neighbours: E = k/2 sum max(0, |s|^2 - s0)^2.

    s is the sum of the unit vectors to the three neighbours. If all neighbours are on one side of the atom,
    harmonic angles have another minimum, with angles of 80 to 90 degrees, which no force leaves. The energy
    of atoms of usual shape is 0.
    """

    atoms: Integers  # (n, 4) int: Centre and its three neighbours.

    @staticmethod
    @per_structure
    def of(structure: Structure) -> "Planes":
        """Find carbons with three bonds, and nitrogens with three bonds next to such a carbon."""
        neighbours = structure.neighbours
        three = np.array([len(bonded) == 3 for bonded in neighbours]) & ~structure.obstacle
        carbon = three & (structure.atom_element == "C")
        next_to_carbon = np.array([any(carbon[i] for i in bonded) for bonded in neighbours])
        planar = carbon | (three & (structure.atom_element == "N") & next_to_carbon)
        rows = [(centre, *sorted(neighbours[centre])) for centre in np.flatnonzero(planar).tolist()]
        return Planes(np.array(rows, dtype=np.int64).reshape(-1, 4))

    def __call__(self, x: Floats) -> tuple[float, Floats]:
        """Energy and forces."""
        forces = np.zeros_like(x)
        vectors = x[self.atoms[:, 1:]] - x[self.atoms[:, :1]]
        length = np.linalg.norm(vectors, axis=2, keepdims=True)
        units = vectors / np.maximum(length, 1e-6)
        total = units.sum(axis=1)
        beyond = np.maximum((total**2).sum(axis=1) - _UNUSUAL, 0.0)
        far = beyond > 0.0
        units, length, total = units[far], length[far], total[far, None]
        across = total - units * (units * total).sum(axis=2, keepdims=True)
        pull = -2.0 * _FLATTENING * beyond[far, None, None] * across / np.maximum(length, 1e-6)
        np.add.at(forces, self.atoms[far, 1:], pull)
        np.subtract.at(forces, self.atoms[far, 0], pull.sum(axis=1))
        return float(0.5 * _FLATTENING * beyond @ beyond), forces
