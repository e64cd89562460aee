"""Likeness of a structure to a reference: lDDT, TM-score, RMSDs."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from protochain.core.arrays import Floats, Integers, Value, distance, means_by, read_only
from protochain.core.units import ANGSTROM_PER_NM
from protochain.structure.matching import Match, match, tm_score
from protochain.structure.molecule.model import Structure
from protochain.structure.molecule.residues import STANDARD
from protochain.structure.superpose import rmsd_angstrom
from protochain.validation.layout import NONE, layout

RADIUS = 15.0  # Angstrom within which distances of the reference count.
_TOLERANCES = (0.5, 1.0, 2.0, 4.0)
"""Angstrom by which a distance may differ to count as preserved. The score is the mean over the four."""
_TWINS = {
    "ARG": {"NH1": "NH2"}, "ASP": {"OD1": "OD2"}, "GLU": {"OE1": "OE2"}, "LEU": {"CD1": "CD2"},
    "PHE": {"CD1": "CD2", "CE1": "CE2"}, "TYR": {"CD1": "CD2", "CE1": "CE2"}, "VAL": {"CG1": "CG2"},
}  # fmt: skip
"""Atoms whose names may be exchanged, by residue."""
LIKENESS = {
    "lddt": ("lDDT", "lDDT of all heavy atoms, 0 to 1"),
    "lddt_ca": ("C-alphas", "lDDT of the C-alphas, 0 to 1"),
    "tm_score": ("TM", "TM-score, 0 to 1"),
    "ca_rmsd_to_reference_angstrom": ("RMSD", "RMSD of the C-alphas after superposition, angstrom"),
    "heavy_rmsd_to_reference_angstrom": ("heavy", "RMSD of all heavy atoms after superposition, angstrom"),
    "matched_percent": ("matched %", "residues of the reference that were matched, per cent"),
}
"""Keys of ``Likeness.measures``, with their headings in tables of a terminal, and descriptions."""


@dataclass(frozen=True, eq=False)
class Likeness(Value):
    """Likeness of a structure to a reference."""

    measures: Mapping[str, Any]  # The keys of ``LIKENESS``; None where nothing can be measured.
    lddt: Floats  # (nr,): lDDT of each residue of the structure, NaN where it matches none.
    match: Match  # Residues of both.

    def __post_init__(self) -> None:
        object.__setattr__(self, "measures", MappingProxyType(dict(self.measures)))
        object.__setattr__(self, "lddt", read_only(self.lddt))


def likeness(structure: Structure, reference: Structure) -> Likeness:
    """Measure the likeness of a structure to a reference.

    Residues are matched as by :func:`protochain.rmsd`. Atoms that preparation added to either count as
    missing. Distances of atoms that the structure lacks do not count as preserved. Names of equivalent atoms
    (in Arg, Asp, Glu, Leu, Phe, Tyr, Val) are exchanged in a residue if more distances agree so.

    Parameters
    ----------
    structure, reference : Structure
        The reference may have C-alphas only.

    Returns
    -------
    Likeness
        Numbers, lDDT by residue, and the residues matched.

    Raises
    ------
    ProtochainError
        If no residue matches, or the sequences are unrelated.

    Notes
    -----
    lDDT: Mariani, Biasini, Barbato, Schwede, Bioinformatics 29:2722 (2013). Each distance of the reference
    below 15 angstrom between atoms of different residues counts once.
    """
    matched = match(reference, structure)
    atoms, model, pairs, preserved = preserved_distances(structure, reference, matched)
    residue = reference.atom_residue[atoms]
    of_residue = means_by(residue[pairs].ravel(), np.repeat(preserved, 2), reference.n_residues)
    lddt = np.full(structure.n_residues, np.nan)
    lddt[matched.model] = of_residue[matched.reference]
    alpha = reference.atom_name[atoms] == "CA"
    of_alphas = alpha[pairs].all(axis=1)
    present, x, y = model != NONE, structure.positions[model], reference.positions[atoms]
    score = tm_score(reference, structure, matched)
    values = {
        "lddt": _mean(preserved),
        "lddt_ca": _mean(preserved[of_alphas]),
        "tm_score": score,
        "ca_rmsd_to_reference_angstrom": rmsd_angstrom(x[present & alpha], y[present & alpha]),
        "heavy_rmsd_to_reference_angstrom": rmsd_angstrom(x[present], y[present]),
        "matched_percent": 100.0 * matched.coverage,
    }
    plain = {name: float(value) if np.isfinite(value) else None for name, value in values.items()}
    return Likeness(plain, lddt, matched)


def preserved_distances(
    structure: Structure, reference: Structure, matched: Match
) -> tuple[Integers, Integers, Integers, Floats]:
    """Atoms (n,) of the reference and the structure, pairs (m, 2) of them, and their lDDT (m,)."""
    atoms, model, twin = _correspondence(structure, reference, matched)
    place, residue = ANGSTROM_PER_NM * reference.positions[atoms], reference.atom_residue[atoms]
    pairs = cKDTree(place).query_pairs(RADIUS, output_type="ndarray")
    pairs = np.asarray(pairs[residue[pairs[:, 0]] != residue[pairs[:, 1]]], dtype=np.int64)
    model = _exchange_twins(structure, place, residue, pairs, model, twin)
    return atoms, model, pairs, _agreement(structure, place, pairs, model)


def _correspondence(
    structure: Structure, reference: Structure, matched: Match
) -> tuple[Integers, Integers, Integers]:
    """Heavy atoms of the reference, and of the structure by name (-1: none) and by the twin's name."""
    amino, kinds = layout(structure), reference.residue_name[reference.atom_residue]
    # Of a reference of C-alphas nothing has a backbone.
    usable = (
        (reference.atom_element != "H") & np.isin(kinds, list(STANDARD)) & ~reference.kept & ~reference.built
    )
    atoms = np.flatnonzero(usable)
    counterpart = np.full(reference.n_residues, NONE)
    counterpart[matched.reference] = matched.model
    residue, name = counterpart[reference.atom_residue[atoms]], reference.atom_name[atoms]
    absent = structure.built

    def find_atoms(names: NDArray[np.str_]) -> Integers:
        index = np.full(len(atoms), NONE)
        for name in np.unique(names).tolist():
            mask = names == name
            index[mask] = amino.atoms(name)[residue[mask], 0]
        index[(residue == NONE) | absent[index]] = NONE
        return index

    twins_of = {kind: twins | {b: a for a, b in twins.items()} for kind, twins in _TWINS.items()}
    pairs = zip(kinds[atoms].tolist(), name.tolist(), strict=True)
    twin_names = [twins_of.get(kind, {}).get(atom, atom) for kind, atom in pairs]
    return atoms, find_atoms(name), find_atoms(np.array(twin_names, dtype=name.dtype))


def _agreement(structure: Structure, place: Floats, pairs: Integers, model: Integers) -> Floats:
    """Fraction (n,) of the tolerances within which the distance of each pair agrees."""
    x = ANGSTROM_PER_NM * structure.positions
    i, j = pairs.T
    difference = np.abs(distance(x[model[i]], x[model[j]]) - distance(place[i], place[j]))
    difference[(model[i] == NONE) | (model[j] == NONE)] = np.inf
    return np.asarray(sum((difference <= tolerance) * 0.25 for tolerance in _TOLERANCES), dtype=float)


def _exchange_twins(
    structure: Structure, place: Floats, residue: Integers, pairs: Integers, model: Integers, twin: Integers
) -> Integers:
    """Atoms (n,), twins exchanged in residues whose distances to atoms without twins agree better so."""
    ambiguous = model != twin
    mixed = pairs[ambiguous[pairs].sum(axis=1) == 1]
    owner = residue[np.where(ambiguous[mixed[:, 0]], mixed[:, 0], mixed[:, 1])]
    n = int(residue.max(initial=-1)) + 1
    as_named, exchanged = (
        np.bincount(owner, _agreement(structure, place, mixed, names), minlength=n) for names in (model, twin)
    )
    return np.where((exchanged > as_named)[residue], twin, model)


def _mean(values: Floats) -> float:
    return float(values.mean()) if len(values) else float("nan")
