"""Energies that restrain a run to its start, separate overlaps, or preserve stereocentres; not in results."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache, partial
from typing import Any

import numpy as np

from protochain.chains.contacts import near_pairs
from protochain.chains.restraint import Restraint
from protochain.chains.restraint_lines import are_restraints, is_missing, read_restraints
from protochain.chains.restraint_list import Restraints
from protochain.core.arrays import Floats, Integers, cross
from protochain.core.errors import refusal
from protochain.core.units import ANGSTROM_PER_NM
from protochain.energies.custom import call_user, check_forces, name_of
from protochain.minimisers.problem import Force
from protochain.structure import Structure
from protochain.structure.molecule.chirality import volume
from protochain.structure.superpose import superpose
from protochain.validation.stereocentres import expected_stereocentres

SOFT_SHARE = 0.7  # Range of soft repulsion, as a share of the contact distance. Hydrogen bonds are longer.
SOFT_STIFFNESS = 1e4  # kJ/mol/nm^2. An overlap of an angstrom costs 50 kJ/mol.
SOFT_TETHER = 10.0  # kJ/mol/nm^2 on each atom, so that separating overlaps moves little else.
_LEASH_START = 0.9
_LEASH_ENERGY = 10.0  # kJ/mol per residue at the end of a leash.
_CHIRAL_STIFFNESS = 1e8
"""kJ/mol/nm^6. Inverting an atom costs about 1000 kJ/mol, more than overlaps and springs provide."""
_HEAVY, _WITH_HYDROGEN = 1.4e-3, 0.9e-3
"""nm^3, volumes below which an atom is pushed: of three heavy neighbours, and with a hydrogen. Ideal residues
have 2.5e-3 and 1.8e-3. Frames of dynamics have more than 1.6e-3 and 1.0e-3."""


@dataclass(frozen=True, eq=False)
class Tethers:
    """Springs from atoms to their initial positions: E = k/2 sum |x - x0|^2."""

    home: Floats  # (na, 3) nm.
    weight: Floats  # (na,) kJ/mol/nm^2.

    @classmethod
    def of_heavy_atoms(cls, structure: Structure, strength: float) -> "Tethers":
        """Tether all atoms except hydrogens, strength in kJ/mol/nm^2."""
        return cls(structure.positions, np.where(structure.atom_element == "H", 0.0, strength))

    def __call__(self, x: Floats) -> tuple[float, Floats]:
        """Energy and forces."""
        displacement = x - self.home
        pull = -self.weight[:, None] * displacement
        return float(-0.5 * np.sum(pull * displacement)), pull


@dataclass(frozen=True, eq=False)
class Bound:
    """Wall around the initial position of every atom: E = k/2 sum (d - limit)^2 over atoms beyond it."""

    home: Floats  # (na, 3) nm.
    limit: float  # nm.

    def __call__(self, x: Floats) -> tuple[float, Floats]:
        """Energy and forces."""
        displacement = x - self.home
        distance = np.linalg.norm(displacement, axis=1)
        beyond = np.maximum(0.0, distance - self.limit)
        pull = (-SOFT_STIFFNESS * beyond / np.maximum(distance, 1e-9))[:, None] * displacement
        return float(0.5 * SOFT_STIFFNESS * np.sum(beyond**2)), pull


@dataclass(frozen=True, eq=False)
class Leash:
    """Harmonic wall that begins at 0.9 of the limit of the C-alpha RMSD to the start, superposed."""

    structure: Structure
    limit: float  # angstrom.

    def rmsd(self, x: Floats) -> tuple[float, Floats]:
        """RMSD in nm, and its gradient (n, 3) on the C-alpha atoms."""
        # At the best superposition the RMSD is stationary, so that its change adds nothing to the gradient.
        alpha = self.structure.alpha_carbons
        displacement = x[alpha] - superpose(self.structure.positions[alpha], x[alpha])
        size = float(np.sqrt(np.mean(np.sum(displacement**2, axis=1))))
        return size, displacement / max(size * len(alpha), 1e-12)

    def allows(self, x: Floats) -> bool:
        """Whether positions are within the limit."""
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
    """Soft repulsion of overlapping atoms: E = k/2 sum (r0 - r)^2 over unbonded pairs nearer than r0."""

    structure: Structure
    # (n, 2) int: Pairs of residues without repulsion.
    passing: Integers = field(default_factory=lambda: np.empty((0, 2), dtype=np.int64))
    share: float = SOFT_SHARE  # Range r0, as a share of the contact distance.
    stiffness: float = SOFT_STIFFNESS  # kJ/mol/nm^2.

    def __call__(self, x: Floats) -> tuple[float, Floats]:
        """Energy and forces. Coinciding atoms have none, as the direction is undefined."""
        pairs, touch = near_pairs(self.structure, x, self.share)
        if len(self.passing):
            residue, n = self.structure.atom_residue, self.structure.n_residues
            residue_pairs, passing = np.sort(residue[pairs], axis=1), np.sort(self.passing, axis=1)
            repel = ~np.isin(residue_pairs @ [n, 1], passing @ [n, 1])
            pairs, touch = pairs[repel], touch[repel]
        across = x[pairs[:, 0]] - x[pairs[:, 1]]
        distance = np.linalg.norm(across, axis=1)
        short = self.share * touch - distance
        push = (self.stiffness * short / np.maximum(distance, 1e-9))[:, None] * across
        forces = np.zeros_like(x)
        np.add.at(forces, pairs[:, 0], push)
        np.subtract.at(forces, pairs[:, 1], push)
        return float(0.5 * self.stiffness * np.sum(short**2)), forces


@dataclass(frozen=True)
class Sum:
    """Sum of several energies."""

    parts: Sequence[Force]

    def __call__(self, x: Floats) -> tuple[float, Floats]:
        """Energy and forces."""
        energies, forces = zip(*(part(x) for part in self.parts), strict=True)
        return sum(energies), np.sum(forces, axis=0)


def tethers_in(restraint: Force | None) -> Floats | None:
    """Stiffness (na,) in kJ/mol/nm^2 of the tethers in a restraint, or None without any."""
    parts = restraint.parts if isinstance(restraint, Sum) else [restraint]
    weights = [part.weight for part in parts if isinstance(part, Tethers)]
    return np.sum(weights, axis=0) if weights else None


@dataclass(frozen=True)
class Hold:
    """Restraints of a minimisation to its start."""

    # kJ/mol/nm^2: Springs from the heavy atoms to their initial positions, in this order.
    strengths: tuple[float, ...] = ()
    max_rmsd: float = np.inf  # angstrom: C-alpha RMSD to the start that may not be exceeded.
    term: Force | None = None  # Any other restraint: positions (na, 3) in nm to energy and forces.
    listed: tuple[Restraint, ...] = ()  # Distances, dihedrals and positions.

    def __post_init__(self) -> None:
        if not all(0 <= strength < np.inf for strength in self.strengths):
            strengths = " ".join(f"{strength:g}" for strength in self.strengths)
            raise refusal("restraints", strengths, "give strengths in kJ/mol/nm^2, none below 0")
        if not self.max_rmsd > 0:
            raise refusal("max_rmsd", f"{self.max_rmsd:g}", "give a number of angstrom above 0")

    @classmethod
    def of(cls, restraints: Any, max_rmsd: float = np.inf) -> "Hold":
        """Read one strength, several, a string of them, a callable, or restraints, also from a file."""
        if callable(restraints):
            return cls((), max_rmsd, restraints)
        if are_restraints(restraints):
            return cls((), max_rmsd, listed=read_restraints(restraints))
        try:
            values = restraints.split() if isinstance(restraints, str) else np.atleast_1d(restraints)
            strengths = tuple(float(strength) for strength in values)
        except (TypeError, ValueError):
            remedy = "give strengths in kJ/mol/nm^2, as '1000 100 0', or a file of restraints"
            missing = "no such file; " * (isinstance(restraints, str) and is_missing(restraints))
            raise refusal("restraints", f"{restraints!r}", missing + remedy) from None
        return cls(strengths, max_rmsd)

    @property
    def place(self) -> str:
        """Restraint that fixes a run in space to its end, in words, or empty."""
        if self.term is not None or self.listed:
            return "a restraint"
        return "springs to the start" if self.strengths and self.strengths[-1] > 0.0 else ""

    def restraints(self, structure: Structure) -> list[Force | None]:
        """Energies of restraints, one for each strength, or None for no restraint."""
        always: list[Force] = []
        if self.term is not None:
            name = f"restraint {name_of(self.term)}"
            always.append(partial(call_user, self.term, name=name))
            check_forces(self.term, structure.positions, name)
        if self.listed:
            always.append(Restraints.of(structure, self.listed))
        if self.max_rmsd < np.inf:
            always.append(Leash(structure, self.max_rmsd))
        sums: list[Force | None] = []
        for strength in self.strengths or (0.0,):
            tethers: list[Force] = [Tethers.of_heavy_atoms(structure, strength)] if strength > 0.0 else []
            parts = [*tethers, *always]
            sums.append(Sum(parts) if parts else None)
        return sums

    def record(self) -> list[float | str]:
        """Strengths, and the name of any other restraint."""
        term = [] if self.term is None else [name_of(self.term)]
        return [*self.strengths, *term, *map(str, self.listed)]


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
        push = _CHIRAL_STIFFNESS * short[:, None]
        for k, gradient in enumerate((cross(b, c), cross(c, a), cross(a, b)), start=1):
            np.add.at(forces, atoms[:, k], push * gradient)
            np.subtract.at(forces, atoms[:, 0], push * gradient)
        return float(0.5 * _CHIRAL_STIFFNESS * short @ short), forces
