"""Restraints of one form: energies of distances, dihedrals and positions outside their bounds."""

import re
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Any, Self

import numpy as np

from protochain.chains.restraint_lines import PLACES, Restraint, read_restraints
from protochain.core.arrays import Floats, Integers, Value, dihedral, dihedral_slopes, dots, read_only
from protochain.core.errors import StructureError
from protochain.core.units import ANGSTROM_PER_NM
from protochain.structure.dihedrals import finder
from protochain.structure.model import Structure
from protochain.structure.select import atoms_at


@dataclass(frozen=True, eq=False)
class Restraints(Value):
    """Restraints of a structure: positions (na, 3) in nm to energy in kJ/mol and forces.

    lower, upper, stiffness, linear (r,): nm, rad, kJ/mol.
    """

    listed: tuple[Restraint, ...]  # In their order.
    pairs: Integers  # (p, 2) int: Atoms of distances.
    of_pair: Integers  # (p,) int: The row of each.
    fours: Integers  # (m, 4) int: Atoms of dihedrals.
    of_four: Integers  # (m,) int: The row of each.
    atoms: Integers  # (n,) int: Atoms of positions.
    of_atom: Integers  # (n,) int: The row of each.
    home: Floats  # (na, 3) nm: Of positions.

    @classmethod
    def of(cls, structure: Structure, given: Any) -> Self:
        """Find the atoms of restraints, as :func:`read_restraints` takes them."""
        listed = read_restraints(given)
        found: dict[str, list[Any]] = {kind: [[], []] for kind in PLACES}
        for row, each in enumerate(listed):
            groups = _groups(structure, each)
            made = groups[0]
            if each.kind == "distance":
                made = np.stack(np.meshgrid(*groups, indexing="ij"), axis=-1).reshape(-1, 2)
                if {*groups[0].tolist()} & {*groups[1].tolist()}:
                    raise StructureError(f"{structure.name}: restraint {each}: an atom is on both sides")
            elif each.kind == "dihedral":
                made = np.array([[atoms[0] for atoms in groups]])
            found[each.kind][0] += made.tolist()
            found[each.kind][1] += [row] * len(made)
        shapes = {"distance": (-1, 2), "dihedral": (-1, 4), "position": (-1,)}
        pairs, fours, atoms = (read_only(np.reshape(found[k][0], shapes[k]), np.int64) for k in shapes)
        rows = [read_only(found[kind][1], np.int64) for kind in shapes]
        return cls(listed, pairs, rows[0], fours, rows[1], atoms, rows[2], structure.positions)

    def values(self, x: Floats) -> Floats:
        """Values (r,) of distances and dihedrals at positions, nm or rad; zero of positions."""
        n = len(self.listed)
        found = np.zeros(n) + np.bincount(self.of_pair, self._inverse(x)[0], n)
        found[self.of_pair] = found[self.of_pair] ** (-1.0 / 6.0)
        found[self.of_four] = dihedral(*x[self.fours.T])
        return np.asarray(found)

    def _inverse(self, x: Floats) -> tuple[Floats, Floats]:
        """r^-6 (p,) of the pairs, and the vectors (p, 3)."""
        across = x[self.pairs[:, 0]] - x[self.pairs[:, 1]]
        return np.maximum(dots(across, across), 1e-12) ** -3.0, across

    def __call__(self, x: Floats) -> tuple[float, Floats]:
        """Energy and forces."""
        n, forces, value = len(self.listed), np.zeros_like(x), 0.0
        if len(self.pairs):
            r6, across = self._inverse(x)
            whole = np.bincount(self.of_pair, r6, n)
            distance = np.maximum(whole, 1e-300) ** (-1.0 / 6.0)
            energy, slope = self._outside(distance[self.of_pair], self.of_pair, 1.0 / ANGSTROM_PER_NM)
            share = r6 / whole[self.of_pair]
            value += float(np.sum(energy * share))
            # d R / d r_i is R^7 / r_i^7.
            pull = (-slope * share * distance[self.of_pair] * np.cbrt(r6))[:, None] * across
            forces += _at(self.pairs[:, 0], pull, len(x)) - _at(self.pairs[:, 1], pull, len(x))
        if len(self.fours):
            energy, slope = self._outside(dihedral(*x[self.fours.T]), self.of_four, np.pi / 180.0, turns=True)
            value += float(energy.sum())
            pull = slope[:, None, None] * dihedral_slopes(x[self.fours])
            forces -= _at(self.fours.ravel(), pull.reshape(-1, 3), len(x))
        if len(self.atoms):
            away = x[self.atoms] - self.home[self.atoms]
            distance = np.linalg.norm(away, axis=1)
            energy, slope = self._outside(distance, self.of_atom, 1.0 / ANGSTROM_PER_NM)
            value += float(energy.sum())
            forces -= _at(self.atoms, (slope / np.maximum(distance, 1e-12))[:, None] * away, len(x))
        return value, forces

    def _outside(
        self, at: Floats, rows: Integers, unit: float, *, turns: bool = False
    ) -> tuple[Floats, Floats]:
        """Energies and slopes of values of some rows, whose bounds are in a unit."""
        low, high, k, linear = (
            np.array([getattr(each, name) for each in self.listed])[rows]
            for name in ("lower", "upper", "stiffness", "linear")
        )
        low, high, linear = unit * low, unit * high, unit * np.where(linear > 0.0, linear, np.inf)
        if turns:
            middle = 0.5 * (low + high)
            at = middle + (at - middle + np.pi) % (2.0 * np.pi) - np.pi
        out = np.maximum(at - high, 0.0) - np.maximum(low - at, 0.0)
        near = np.clip(out, -linear, linear)
        return k * near * (out - 0.5 * near), k * near


def _at(atoms: Integers, pull: Floats, n: int) -> Floats:
    """Sums (n, 3) of vectors (m, 3) at atoms (m,)."""
    return np.column_stack([np.bincount(atoms, each, n) for each in pull.T])


def _groups(structure: Structure, each: Restraint) -> list[Integers]:
    """Atoms of the places of a restraint."""
    if each.kind == "dihedral" and len(each.places) == 1:
        kind, _, place = each.places[0].replace("@", " ").partition(" ")
        r = int(structure.atom_residue[atoms_at(structure, place)[0]])
        _, named = finder(structure, ("phi", "psi", "omega", "chi", "nucleic"))
        found = {label: atoms for _, label, atoms in named(r) if None not in atoms}
        if kind not in found:
            raise StructureError(
                f"{structure.name}: {each}: {place} has {', '.join(found) or 'no dihedrals'}"
            )
        return [np.array([k]) for k in found[kind]]
    groups = [_atoms(structure, place) for place in each.places]
    if each.kind == "dihedral" and any(len(atoms) != 1 for atoms in groups):
        raise StructureError(f"{structure.name}: restraint {each}: give single atoms")
    return groups


def _atoms(structure: Structure, place: str) -> Integers:
    """Atoms of ``A:3:CA``, ``@12`` (its number in the file), ``resid 3 and name HB#``, or a selection."""
    if place.startswith("@"):
        where = np.arange(structure.n_atoms) if structure.origin is None else structure.origin.place
        (found,) = np.nonzero(where == int(place[1:]) - 1)
    elif _CNS.fullmatch(place):
        # MDAnalysis reads these too, but takes a tenth of a second for each.
        each = [_of_cns(structure, part) for part in re.split(r"(?i)\s+or\s+", place)]
        found = np.unique(np.concatenate(each))
    else:
        return atoms_at(structure, place)
    if not len(found):
        raise StructureError(f"{structure.name}: restraint: there are no atoms {place}")
    return found


_CNS = re.compile(r"(?i)(\W*\b(resid?|name|segid?|resname?)\s+[^\s()]+[\s)]*((and|or)\b)?)+\W*")


def _of_cns(structure: Structure, place: str) -> Integers:
    """Atoms of ``resid 3 and name HB# and segid A``."""
    of, chosen = structure.atom_residue, np.ones(structure.n_atoms, dtype=bool)
    columns = {
        "resi": structure.residue_number[of], "name": structure.atom_name,
        "segi": structure.residue_chain[of], "resn": structure.residue_name[of],
    }  # fmt: skip
    for key, value in re.findall(r"(?i)\b(resid?|name|segid?|resname?)\s+([^\s()]+)", place):
        asked = value.strip("\"'").upper().replace("#", "*").replace("%", "?")
        asked = "H" if asked == "HN" else asked
        chosen &= [fnmatchcase(str(each).upper(), asked) for each in columns[key.lower()[:4]]]
    return np.flatnonzero(chosen)
