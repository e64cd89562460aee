"""Planar atoms with three neighbours while a structure is relaxed: folded ones are opened."""

from dataclasses import dataclass

import numpy as np

from protochain.core.arrays import Floats, Integers
from protochain.structure.molecule.model import Structure, of_atoms

_STIFFNESS = 2000.0
"""kJ/mol. Against it, angles of 90 and 180 degrees, which a force field keeps, gain some 700 kJ/mol/rad."""
_UNUSUAL = 0.3
"""Squared length of the sum of the three directions from which on an atom is pushed. It is 0 for angles of
120 degrees, at most 0.05 in rings of usual shape, and above 1 where all neighbours lie on one side."""


@dataclass(frozen=True, eq=False)
class Planes:
    """Push of planar atoms into the middle of their neighbours: E = k/2 sum max(0, |s|^2 - s0)^2.

    s is the sum of the unit vectors to the three neighbours. Where these lie on one side, one of them between
    the others, harmonic angles hold the atom in a minimum of their own, with angles of 80 to 90 degrees, and
    no force leads out of it. An atom of usual shape feels nothing.
    """

    atoms: Integers  # (n, 4) int: Centre and its three neighbours.

    @staticmethod
    @of_atoms
    def of(structure: Structure) -> "Planes":
        """Find carbons of three bonds, and nitrogens of three bonds beside one."""
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
