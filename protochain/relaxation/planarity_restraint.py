"""Planar atoms with three neighbours during a relaxation: folded atoms are flattened."""

from dataclasses import dataclass

import numpy as np

from protochain.core.arrays import Floats, Integers
from protochain.structure.molecule.model import Structure, per_structure

_STIFFNESS = 2000.0
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
        pull = -2.0 * _STIFFNESS * beyond[far, None, None] * across / np.maximum(length, 1e-6)
        np.add.at(forces, self.atoms[far, 1:], pull)
        np.subtract.at(forces, self.atoms[far, 0], pull.sum(axis=1))
        return float(0.5 * _STIFFNESS * beyond @ beyond), forces
