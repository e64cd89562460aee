"""Bond lengths and angles of the amino acids, from data/geometry.csv, and the heavy atoms that it names."""

import csv
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from protochain.core.arrays import Floats, Integers, freeze, read_only
from protochain.structure.molecule.model import Structure, per_structure
from protochain.structure.molecule.residues import STANDARD, STATE_PARENT

WIDTH = 14
"""Heavy atoms of the largest amino acid, without the second oxygen of a terminus."""
TYPES = tuple(STANDARD)
"""Amino acids, in the order of the tables below."""

_TABLE = Path(__file__).parent / "data" / "geometry.csv"


@dataclass(frozen=True)
class Norm:
    """Usual value of a bond length or angle within a residue."""

    residue: str
    atoms: tuple[str, ...]  # Two of a bond, three of an angle.
    mean: float
    sigma: float


@cache
def norms() -> tuple[Norm, ...]:
    """Rows of the table of bond lengths and angles within residues."""
    with _TABLE.open(newline="") as file:
        rows = list(csv.reader(file))[1:]
    return tuple(Norm(row[0], tuple(row[1].split("-")), float(row[2]), float(row[3])) for row in rows)


@cache
def slots() -> dict[tuple[str, str], int]:
    """Place (0 to 13) of each heavy atom in its residue, by names of residue and atom: N, CA, C, O first."""
    place_of: dict[tuple[str, str], int] = {}
    for residue in TYPES:
        first = dict.fromkeys(("N", "CA", "C", "O"))
        names = first | dict.fromkeys(name for row in norms() if row.residue == residue for name in row.atoms)
        place_of |= {(residue, name): place for place, name in enumerate(names)}
    return place_of


@cache
def distances() -> tuple[Floats, Floats]:
    """Usual distances (20, 14, 14), angstrom, one or two bonds apart, and deviations, or NaN."""
    shape = (len(TYPES), WIDTH, WIDTH)
    mean, sigma = np.full(shape, np.nan), np.full(shape, np.nan)
    for n_atoms in (2, 3):
        for row in norms():
            if len(row.atoms) != n_atoms:
                continue
            kind, places = TYPES.index(row.residue), [slots()[row.residue, name] for name in row.atoms]
            value = (row.mean, row.sigma)
            if n_atoms == 3:
                i, j, k = places
                arms = ((mean[kind, i, j], sigma[kind, i, j]), (mean[kind, j, k], sigma[kind, j, k]))
                value = _opposite(*arms, (np.radians(row.mean), np.radians(row.sigma)))
            first, last = places[0], places[-1]
            mean[kind, first, last] = mean[kind, last, first] = value[0]
            sigma[kind, first, last] = sigma[kind, last, first] = value[1]
    return freeze(mean), freeze(sigma)


def _opposite(
    a: tuple[float, float], b: tuple[float, float], angle: tuple[float, float]
) -> tuple[float, float]:
    """Side of a triangle opposite to the angle between sides a and b, each with its standard deviation."""
    cosine, sine = np.cos(angle[0]), np.sin(angle[0])
    side = np.sqrt(a[0] ** 2 + b[0] ** 2 - 2 * a[0] * b[0] * cosine)
    parts = ((a[0] - b[0] * cosine) * a[1], (b[0] - a[0] * cosine) * b[1], a[0] * b[0] * sine * angle[1])
    return float(side), float(np.sqrt(sum(part**2 for part in parts)) / side)


@per_structure
def places(structure: Structure) -> tuple[Integers, Integers]:
    """Atom in each place of each residue (nr, 14), or -1, and its type (nr,), -1 of caps and molecules."""
    names = [STATE_PARENT.get(name, (name, ""))[0] for name in structure.residue_name.tolist()]
    kind = np.array([TYPES.index(name) if name in STANDARD else -1 for name in names], dtype=np.int64)
    kind[structure.atom_residue[structure.kept]] = -1
    atom_at = np.full((structure.n_residues, WIDTH), -1, dtype=np.int64)
    residue = structure.atom_residue
    heavy = np.flatnonzero((structure.atom_element != "H") & (kind[residue] >= 0))
    table = slots()
    for atom, r, name in zip(
        heavy.tolist(), residue[heavy].tolist(), structure.atom_name[heavy].tolist(), strict=True
    ):
        place = table.get((names[r], name))
        if place is not None:
            atom_at[r, place] = atom
    return read_only(atom_at, np.int64), read_only(kind, np.int64)
