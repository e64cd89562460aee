"""Restraints of one form: values, energies, forces and violations of distances, dihedrals and positions."""

import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from functools import cached_property
from itertools import pairwise
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from protochain.chains.cns_selection import parse_selection
from protochain.chains.restraint import Restraint, both_sides
from protochain.chains.restraint_lines import read_restraints
from protochain.core import arrays
from protochain.core.arrays import Floats, Integers, Value, read_only
from protochain.core.errors import ProtochainError, StructureError
from protochain.core.lazy_pandas import pd
from protochain.core.markup import plural
from protochain.core.units import ANGSTROM_PER_NM
from protochain.structure.molecule.dihedrals import dihedral_finder
from protochain.structure.molecule.model import Structure, per_structure
from protochain.structure.select import atoms_at

VIOLATED = {"angstrom": 0.5, "degrees": 10.0}
"""A restraint is violated if its coordinate is farther outside the bounds."""
Groups = Sequence[list[Integers]]  # Atoms of the places of each restraint.
_IN_FILE = re.compile(r"(:\d+)?@[^\s@]+(,(:\d+)?@[^\s@]+)*")


@dataclass(frozen=True, eq=False)
class Distances(Value):
    """Distances (sum w r^-6)^(-1/6) over pairs of atoms, whose weights are 1, or 1/n of a mean."""

    kinds: ClassVar[tuple[str, ...]] = ("distance", "mean-distance")

    pairs: Integers  # (p, 2) int: Atoms.
    row: Integers  # (p,) int: The distance of each pair.
    weight: Floats  # (p,).

    @classmethod
    def of(cls, structure: Structure, restraints: Sequence[Restraint], groups: Groups) -> Self:
        """Combine all atoms of each pair of places."""
        pairs, row, weight = list[Any](), list[int](), list[float]()
        for k, (restraint, places) in enumerate(zip(restraints, groups, strict=True)):
            couples = zip(places[::2], places[1::2], strict=True)
            meshes = [np.stack(np.meshgrid(*c, indexing="ij"), axis=-1).reshape(-1, 2) for c in couples]
            pairs += meshes
            n = sum(map(len, meshes))
            row += [k] * n
            weight += [1.0 / n if restraint.kind == "mean-distance" else 1.0] * n
        return cls(read_only(np.concatenate(pairs), np.int64), read_only(row, np.int64), read_only(weight))

    def _sums(self, x: Floats) -> tuple[Floats, Floats, Floats]:
        """Weighted r^-6 (p,) of the pairs, their vectors (p, 3), and sums (m,)."""
        across = x[self.pairs[:, 0]] - x[self.pairs[:, 1]]
        r6 = self.weight * np.maximum(arrays.dots(across, across), 1e-12) ** -3.0
        return r6, across, np.maximum(np.bincount(self.row, r6), 1e-300)

    def values(self, x: Floats) -> Floats:
        """Distances (m,), nm."""
        return np.asarray(self._sums(x)[2] ** (-1.0 / 6.0))

    def forces(self, x: Floats, slope: Floats) -> Floats:
        """Forces (na, 3): d R / d r_i is w_i R^7 / r_i^7."""
        r6, across, sums = self._sums(x)
        pull = (-slope * sums ** (-7.0 / 6.0))[self.row] * r6 * np.cbrt(r6 / self.weight)
        vectors = pull[:, None] * across
        return _at(self.pairs[:, 0], vectors, len(x)) - _at(self.pairs[:, 1], vectors, len(x))


@dataclass(frozen=True, eq=False)
class Centroids(Value):
    """Distances between centres of mass."""

    kinds: ClassVar[tuple[str, ...]] = ("centroid-distance",)

    atoms: Integers  # (k,) int.
    row: Integers  # (k,) int: The distance of each atom.
    weight: Floats  # (k,): Share of the mass, negative of the second centre.

    @classmethod
    def of(cls, structure: Structure, restraints: Sequence[Restraint], groups: Groups) -> Self:
        """Share the mass of each place among its atoms."""
        mass = structure.atom_mass
        signed = [
            (k, sign, group)
            for k, places in enumerate(groups)
            for sign, group in zip((1.0, -1.0), places, strict=True)
        ]
        return cls(
            read_only(np.concatenate([group for *_, group in signed]), np.int64),
            read_only(np.concatenate([np.full(len(group), k) for k, _, group in signed]), np.int64),
            read_only(np.concatenate([sign * mass[group] / mass[group].sum() for _, sign, group in signed])),
        )

    def _vectors(self, x: Floats) -> Floats:
        return _at(self.row, self.weight[:, None] * x[self.atoms], int(self.row[-1]) + 1)

    def values(self, x: Floats) -> Floats:
        """Distances (m,), nm."""
        return np.asarray(np.linalg.norm(self._vectors(x), axis=1))

    def forces(self, x: Floats, slope: Floats) -> Floats:
        """Forces (na, 3), distributed among the atoms by mass."""
        vectors = self._vectors(x)
        pull = (-slope / np.maximum(np.linalg.norm(vectors, axis=1), 1e-12))[:, None] * vectors
        return _at(self.atoms, self.weight[:, None] * pull[self.row], len(x))


@dataclass(frozen=True, eq=False)
class Dihedrals(Value):
    """Dihedrals of four atoms."""

    kinds: ClassVar[tuple[str, ...]] = ("dihedral",)

    atoms: Integers  # (m, 4) int.

    @classmethod
    def of(cls, structure: Structure, restraints: Sequence[Restraint], groups: Groups) -> Self:
        """Use the four atoms of each dihedral."""
        return cls(read_only(np.reshape(groups, (-1, 4)), np.int64))

    def values(self, x: Floats) -> Floats:
        """Dihedrals (m,), rad, -pi to pi."""
        return arrays.dihedral(*x[self.atoms.T])

    def forces(self, x: Floats, slope: Floats) -> Floats:
        """Forces (na, 3)."""
        pull = -slope[:, None, None] * arrays.dihedral_slopes(x[self.atoms])
        return _at(self.atoms.ravel(), pull.reshape(-1, 3), len(x))


@dataclass(frozen=True, eq=False)
class Displacements(Value):
    """Distances of atoms from their initial positions."""

    kinds: ClassVar[tuple[str, ...]] = ("position",)

    atoms: Integers  # (m,) int.
    initial: Floats  # (m, 3) nm.

    @classmethod
    def of(cls, structure: Structure, restraints: Sequence[Restraint], groups: Groups) -> Self:
        """Restrain each atom of a place separately."""
        atoms = np.concatenate([places[0] for places in groups])
        return cls(read_only(atoms, np.int64), read_only(structure.positions[atoms]))

    def values(self, x: Floats) -> Floats:
        """Distances (m,), nm."""
        return arrays.distance(x[self.atoms], self.initial)

    def forces(self, x: Floats, slope: Floats) -> Floats:
        """Forces (na, 3)."""
        pull = (-slope / np.maximum(self.values(x), 1e-12))[:, None] * (x[self.atoms] - self.initial)
        return _at(self.atoms, pull, len(x))


Coordinates = Distances | Centroids | Dihedrals | Displacements
"""Restrained coordinates of one form: values (m,), nm or rad, at x (na, 3), and forces of slopes (m,)."""
FORMS: tuple[type[Coordinates], ...] = (Distances, Centroids, Dihedrals, Displacements)


@dataclass(frozen=True)
class RestraintValue:
    """Value of a restrained coordinate, and its violation of the bounds."""

    restraint: str  # Restraint, as its line.
    # value, bound, violation: Coordinate, nearest bound, distance outside the bounds, or 0.
    value: float
    bound: float
    violation: float
    unit: str  # ``angstrom`` or ``degrees``, of all three.

    @property
    def excess(self) -> float:
        """Violation in units of the smallest reported violation."""
        return self.violation / VIOLATED[self.unit]

    @property
    def is_violated(self) -> bool:
        """Whether it is outside by more than 0.5 angstrom or 10 degrees."""
        return self.excess > 1.0

    def __str__(self) -> str:
        return (
            f"{self.restraint}: {self.value:.2f} {self.unit}, bound {self.bound:g}, "
            f"violated by {self.violation:.2f} {self.unit}"
        )


def measure_restraints(
    structure: Structure, restraints: Sequence[Restraint], x: Floats
) -> tuple[RestraintValue, ...]:
    """Values and violations of restraints of a structure at positions (na, 3), nm."""
    return Restraints.of(structure, restraints).measure(x) if restraints else ()


def select_violated(values: Sequence[RestraintValue]) -> list[RestraintValue]:
    """Restraints that are violated, worst first."""
    return sorted((value for value in values if value.is_violated), key=lambda value: -value.excess)


def describe_violations(values: Sequence[RestraintValue]) -> list[str]:
    """Number and worst of the violated restraints, for a message. Empty without violations."""
    if not (worst := select_violated(values)):
        return []
    number = plural(len(worst), "restraint is violated", "restraints are violated")
    return [f"{number}, the worst by {worst[0].violation:.2f} {worst[0].unit} ({worst[0].restraint})"]


class ViolationsAtEnd:
    """Result of a run whose restraints were measured at the end."""

    restraint_values: tuple[RestraintValue, ...]

    def violation_rows(self) -> list[dict[str, Any]]:
        """Fields of the violated restraints, worst first."""
        return [asdict(value) for value in select_violated(self.restraint_values)]

    @property
    def restraint_violations(self) -> "pd.DataFrame":
        """Restraints that the end violates by more than 0.5 angstrom or 10 degrees, worst first.

        Columns ``restraint``, ``value``, ``bound``, ``violation`` and ``unit``, angstrom or degrees.
        """
        return _table(select_violated(self.restraint_values))

    @property
    def restraint_table(self) -> "pd.DataFrame":
        """All restraints at the end, worst first, with the columns of ``restraint_violations``."""
        return _table(sorted(self.restraint_values, key=lambda value: -value.excess))


def _table(values: Sequence[RestraintValue]) -> "pd.DataFrame":
    names = [field.name for field in fields(RestraintValue)]
    return pd.DataFrame([asdict(value) for value in values], columns=names)


@dataclass(frozen=True, eq=False)
class Restraints(Value):
    """Restraints of a structure: positions (na, 3) in nm to energy in kJ/mol and forces."""

    listed: tuple[Restraint, ...]  # In their order.
    coordinates: tuple[Coordinates, ...]
    row: Integers  # (m,) int: The restraint of each value of the coordinates.

    @classmethod
    def of(cls, structure: Structure, source: Any) -> Self:
        """Find the atoms of restraints. The source is an argument of :func:`read_restraints`."""
        listed = read_restraints(source)
        groups = [_groups(structure, restraint) for restraint in listed]
        coordinates, rows = list[Coordinates](), list[int]()
        for form in FORMS:
            if part := [row for row, restraint in enumerate(listed) if restraint.kind in form.kinds]:
                chosen = [listed[row] for row in part], [groups[row] for row in part]
                coordinates.append(form.of(structure, *chosen))
            # Each atom of a position restraint has a value.
            rows += [row for row in part for _ in (groups[row][0] if listed[row].kind == "position" else "1")]
        return cls(listed, tuple(coordinates), read_only(rows, np.int64))

    def values(self, x: Floats) -> Floats:
        """Values (m,) of the coordinates at positions, nm or rad, in the order of ``row``."""
        return np.concatenate([part.values(x) for part in self.coordinates] or [np.empty(0)])

    def energies(self, values: Floats) -> Floats:
        """Energies (m,), kJ/mol, of values (m,) of the coordinates."""
        return self._walls.energies(values)[0]

    def __call__(self, x: Floats) -> tuple[float, Floats]:
        """Energy and forces."""
        values = [part.values(x) for part in self.coordinates]
        energy, slope = self._walls.energies(np.concatenate(values))
        slopes = np.split(slope, np.cumsum([len(part) for part in values[:-1]]))
        parts = zip(self.coordinates, slopes, strict=True)
        return float(energy.sum()), np.sum([part.forces(x, slope) for part, slope in parts], axis=0)

    @cached_property
    def _walls(self) -> "_Walls":
        return _Walls.of([self.listed[row] for row in self.row.tolist()])

    def measure(self, x: Floats) -> tuple[RestraintValue, ...]:
        """Value and violation of each restraint at positions. Of several atoms, the worst is returned."""
        values = self.values(x)
        outside, walls = self._walls.outside(values), self._walls
        # A side without stiffness does not restrain.
        violation = np.abs(outside) * (walls.of_side(walls.stiffness, outside) > 0.0)
        is_high = walls.wrap(values) > 0.5 * (walls.low + walls.high)
        bound = np.where(is_high, walls.high, walls.low)
        order = np.lexsort((-violation, self.row))
        _, first = np.unique(self.row[order], return_index=True)
        return tuple(
            RestraintValue(
                str(self.listed[self.row[i]]), float(values[i] / walls.unit[i]),
                float(bound[i] / walls.unit[i]), float(violation[i] / walls.unit[i]),
                "degrees" if walls.turns[i] else "angstrom",
            )
            for i in order[first].tolist()
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Walls:
    """Bounds of coordinates (m,), nm or rad, and the energy outside. Values of both sides have (2, m)."""

    low: Floats
    high: Floats
    stiffness: Floats
    linear: Floats
    exponent: Floats
    tail: Floats
    unit: Floats  # nm of an angstrom, or rad of a degree.
    turns: NDArray[np.bool_]

    @classmethod
    def of(cls, restraints: Sequence[Restraint]) -> Self:
        turns = np.array([restraint.kind == "dihedral" for restraint in restraints], dtype=bool)
        unit = np.where(turns, np.pi / 180.0, 1.0 / ANGSTROM_PER_NM)
        stiffness, linear = (
            np.reshape([both_sides(getattr(r, name)) for r in restraints], (-1, 2)).T
            for name in ("stiffness", "linear")
        )
        low, high, exponent, tail = (
            np.array([getattr(r, name) for r in restraints], dtype=float)
            for name in ("lower", "upper", "exponent", "tail")
        )
        linear = unit * np.where(linear > 0.0, linear, np.inf)
        return cls(unit * low, unit * high, stiffness, linear, exponent, tail, unit, turns)

    def wrap(self, values: Floats) -> Floats:
        """Values. Dihedrals are within half a turn of the middle of their bounds."""
        middle = 0.5 * (self.low + self.high)
        near = middle + (values - middle + np.pi) % (2.0 * np.pi) - np.pi
        return np.where(self.turns, near, values)

    def outside(self, values: Floats) -> Floats:
        """Signed distance of values outside the bounds, negative below the lower bound."""
        at = self.wrap(values)
        return np.asarray(np.maximum(at - self.high, 0.0) - np.maximum(self.low - at, 0.0))

    def of_side(self, sides: Floats, outside: Floats) -> Floats:
        """Constants (m,) of the sides (2, m) on which values are."""
        return np.where(outside > 0.0, sides[1], sides[0])

    def energies(self, values: Floats) -> tuple[Floats, Floats]:
        """Energies and slopes (m,) of values."""
        outside = self.outside(values)
        e, k = np.abs(outside), self.of_side(self.stiffness, outside)
        near = np.minimum(e, self.of_side(self.linear, outside))
        energy = 0.5 * k * near**self.exponent
        slope = np.where(e > 0.0, 0.5 * k * self.exponent * near ** (self.exponent - 1.0), 0.0)
        # Beyond, the energy continues as a power of e, with the same slope.
        ratio = np.where(e > near, e / np.maximum(near, 1e-300), 1.0)
        energy = energy + near * slope * (ratio**self.tail - 1.0) / self.tail
        return energy, np.sign(outside) * slope * ratio ** (self.tail - 1.0)


def _at(atoms: Integers, vectors: Floats, n: int) -> Floats:
    """Sums (n, 3) of vectors (m, 3) at atoms (m,)."""
    return np.column_stack([np.bincount(atoms, column, n) for column in vectors.T])


def _groups(structure: Structure, restraint: Restraint) -> list[Integers]:
    """Atoms of the places of a restraint, whose label precedes an error."""
    try:
        return _atoms_of_places(structure, restraint)
    except StructureError as error:
        if not restraint.label:
            raise
        remedy = "; correct its atoms, or remove it"
        raise StructureError(f"{restraint.label}: ", *error.parts, remedy) from None


def _atoms_of_places(structure: Structure, restraint: Restraint) -> list[Integers]:
    subject = f"{structure.name}: restraint {restraint}"
    if restraint.kind == "dihedral" and len(restraint.places) == 1:
        kind, _, place = restraint.places[0].replace("@", " ").partition(" ")
        r = int(structure.atom_residue[atoms_at(structure, place)[0]])
        _, dihedrals_of = dihedral_finder(structure, ("phi", "psi", "omega", "chi", "nucleic"))
        dihedrals = {label: atoms for _, label, atoms in dihedrals_of(r) if None not in atoms}
        if kind not in dihedrals:
            raise StructureError(f"{subject}: {place} has {', '.join(dihedrals) or 'no dihedrals'}")
        return [np.array([k]) for k in dihedrals[kind]]
    groups = [_atoms(structure, place) for place in restraint.places]
    if restraint.kind == "dihedral" and any(len(atoms) != 1 for atoms in groups):
        raise StructureError(f"{subject}: give single atoms")
    if "distance" in restraint.kind and any(
        np.intersect1d(*pair).size for pair in zip(groups[::2], groups[1::2], strict=True)
    ):
        raise StructureError(f"{subject}: an atom is on both sides")
    return groups


def _atoms(structure: Structure, place: str) -> Integers:
    """Atoms of ``A:3:CA``, of ``@12`` and ``:8@CA``, by their order in the file, or of a selection."""
    if _IN_FILE.fullmatch(place):
        atoms = np.unique([_atom_in_file(structure, part) for part in place.split(",")])
        return atoms.astype(np.int64)
    selected = _selected_atoms(structure, place)
    if selected is None:
        return atoms_at(structure, place)
    if not len(selected):
        raise StructureError(f"{structure.name}: restraint: there are no atoms {place}")
    return selected


@per_structure
def _selected_atoms(structure: Structure, place: str) -> Integers | None:
    """Atoms of a selection in the language of CNS, or None for any other place."""
    # MDAnalysis reads most of these selections, too, but takes a tenth of a second for each.
    try:
        return read_only(np.flatnonzero(parse_selection(place)(structure)), np.int64)
    except ProtochainError:
        return None


def _atom_in_file(structure: Structure, place: str) -> int:
    """Atom ``@12``, or atom CA of the eighth residue, ``:8@CA``, of the file."""
    residue, _, name = place.partition("@")
    number, of_residue = _number_in_file(structure)
    if residue:
        (atoms,) = np.nonzero((of_residue == int(residue[1:])) & (structure.atom_name == name))
    else:
        (atoms,) = np.nonzero(number == (int(name) if name.isdigit() else -1))
    if len(atoms) != 1:
        raise StructureError(f"{structure.name}: restraint: there are no atoms {place}")
    return int(atoms[0])


@per_structure
def _number_in_file(structure: Structure) -> tuple[Integers, Integers]:
    """Number of each atom and residue in the order of the file, from 1. Added atoms have 0."""
    if structure.origin is None:
        return np.arange(structure.n_atoms) + 1, structure.atom_residue + 1
    residues = [atom.rpartition("/")[0] for atom in structure.origin.atoms]
    order = np.cumsum([residue != before for residue, before in pairwise([None, *residues])])
    place = structure.origin.place
    # Atoms that were added belong to the residue of the others.
    of_residue = np.zeros(structure.n_residues, dtype=np.int64)
    present = place >= 0
    of_residue[structure.atom_residue[present]] = order[place[present]]
    return place + 1, of_residue[structure.atom_residue]
