"""Energies that keep a run near its start or part atoms gently; never part of the result's."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from protochain.arrays import Floats
from protochain.contacts import near_pairs
from protochain.minimisers.problem import Force
from protochain.structure import Structure
from protochain.structure.superpose import superpose
from protochain.units import ANGSTROM_PER_NM

SOFT_SHARE = 0.7
"""Of contact: soft repulsion parts atoms up to here, which is where hydrogen bonds are."""

SOFT_STIFFNESS = 1e4
"""kJ/mol/nm^2: an overlap of an angstrom costs 50 kJ/mol, whatever the depth of the wall behind it."""

SOFT_TETHER = 10.0
"""kJ/mol/nm^2 on each atom: of all ways to part atoms, take one that moves little."""

_LEASH_START = 0.9
_LEASH_ENERGY = 10.0
"""kJ/mol per residue at the end of a leash."""


@dataclass(frozen=True, eq=False)
class Tethers:
    """Springs from heavy atoms to where they start: E = k/2 sum |x - x0|^2.

    Parameters
    ----------
    home : (na, 3) float, nm
    weight : (na,) float, kJ/mol/nm^2
    """

    home: Floats
    weight: Floats

    @classmethod
    def of_heavy_atoms(cls, structure: Structure, strength: float) -> "Tethers":
        """Tether all atoms but hydrogens, strength in kJ/mol/nm^2."""
        return cls(structure.positions, np.where(structure.atom_element == "H", 0.0, strength))

    def __call__(self, x: Floats) -> tuple[float, Floats]:
        """Energy and forces."""
        away = x - self.home
        pull = -self.weight[:, None] * away
        return float(-0.5 * np.sum(pull * away)), pull


@dataclass(frozen=True, eq=False)
class Leash:
    """A wall that rises before the C-alpha RMSD to the start, superposed, comes to its limit.

    Parameters
    ----------
    structure : Structure
    limit : float, angstrom
    """

    structure: Structure
    limit: float

    def rmsd(self, x: Floats) -> tuple[float, Floats]:
        """RMSD in nm, and its gradient (n, 3) on the C-alpha atoms.

        The best superposition is at a minimum, so that its own change counts for nothing.
        """
        alpha = self.structure.alpha_carbons
        away = x[alpha] - superpose(self.structure.positions[alpha], x[alpha])
        size = float(np.sqrt(np.mean(np.sum(away**2, axis=1))))
        return size, away / max(size * len(alpha), 1e-12)

    def allows(self, x: Floats) -> bool:
        """Whether positions lie within the limit."""
        return ANGSTROM_PER_NM * self.rmsd(x)[0] <= self.limit

    def __call__(self, x: Floats) -> tuple[float, Floats]:
        """Energy and forces."""
        size, gradient = self.rmsd(x)
        limit = self.limit / ANGSTROM_PER_NM
        beyond = max(0.0, size - _LEASH_START * limit)
        strength = 2.0 * _LEASH_ENERGY * self.structure.n_residues / ((1.0 - _LEASH_START) * limit) ** 2
        pull = np.zeros_like(x)
        pull[self.structure.alpha_carbons] = -strength * beyond * gradient
        return 0.5 * strength * beyond**2, pull


@dataclass(frozen=True, eq=False)
class SoftRepulsion:
    """What parts overlapping atoms without a wall: E = k/2 sum (r0 - r)^2 over unbonded pairs nearer than r0.

    Parameters
    ----------
    structure : Structure
    """

    structure: Structure

    def __call__(self, x: Floats) -> tuple[float, Floats]:
        """Energy and forces. Atoms at one point are not pushed: nothing says which way."""
        pairs, touch = near_pairs(self.structure, x, SOFT_SHARE)
        across = x[pairs[:, 0]] - x[pairs[:, 1]]
        distance = np.linalg.norm(across, axis=1)
        short = SOFT_SHARE * touch - distance
        push = (SOFT_STIFFNESS * short / np.maximum(distance, 1e-9))[:, None] * across
        forces = np.zeros_like(x)
        np.add.at(forces, pairs[:, 0], push)
        np.subtract.at(forces, pairs[:, 1], push)
        return float(0.5 * SOFT_STIFFNESS * np.sum(short**2)), forces


@dataclass(frozen=True)
class Sum:
    """Several energies as one."""

    parts: Sequence[Force]

    def __call__(self, x: Floats) -> tuple[float, Floats]:
        """Energy and forces."""
        energies, forces = zip(*(part(x) for part in self.parts), strict=True)
        return sum(energies), np.sum(forces, axis=0)
