"""Deviation of one structure from another: superposition, RMSD and TM-score."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from protochain.core.arrays import Integers
from protochain.core.checks import check_arguments, selection
from protochain.core.errors import ProtochainError, StructureError
from protochain.core.lazy_pandas import pd
from protochain.results.columns import Column, record
from protochain.structure import Structure
from protochain.structure.matching import Match, match, models_of, pair_atoms, structure_to_measure, tm_score
from protochain.structure.select import select
from protochain.structure.superpose import deviation_angstrom, motion

ALPHA = "name CA"
"""Selection of the C-alpha atoms, in MDAnalysis syntax."""


@dataclass(frozen=True)
class Deviation:
    """Deviation of a model from a reference, in angstrom."""

    rmsd: float  # RMSD of the measured atoms, after superposition of the aligned atoms.
    rmsd_unsuperposed: float  # RMSD of the same atoms, without superposition.
    # TM-score of the C-alphas, normalised by the reference's length, with tmtools' own alignment (Zhang,
    # Skolnick, Nucleic Acids Res. 33:2302, 2005), NaN below three residues.
    tm_score: float
    n_aligned: int  # n_aligned, n_measured: Numbers of atoms.
    n_measured: int
    match: Match

    def record(self) -> dict[str, Any]:
        """Flat row, with units in the names."""
        return record(COLUMNS, self)


COLUMNS = (
    Column("rmsd_angstrom", lambda d: d.rmsd),
    Column("rmsd_unsuperposed_angstrom", lambda d: d.rmsd_unsuperposed),
    Column("tm_score", lambda d: d.tm_score, kind=float | None),
    Column("matched_residues", lambda d: len(d.match.reference), kind=int),
    Column("coverage", lambda d: d.match.coverage, kind=float | None),
    Column("identity", lambda d: d.match.identity, kind=float | None),
    Column("matched_by", lambda d: d.match.how),
    Column("chain_mapping", lambda d: d.match.chain_mapping),
    Column("aligned_atoms", lambda d: d.n_aligned, kind=int),
    Column("measured_atoms", lambda d: d.n_measured, kind=int),
)


@check_arguments(align=selection, measure=selection)
def deviation(reference: Any, model: Any, align: str = ALPHA, measure: str = ALPHA) -> Deviation:
    """Measure the deviation of a model from a reference.

    Parameters
    ----------
    reference, model : Structure, Solution, path, or anything that :func:`protochain.as_structure` accepts
        Their sequences may differ, but must be related. A file may contain only C-alpha atoms.
    align, measure : str
        Selections of the reference's atoms: for the superposition, and for the RMSD. Atoms are matched by
        name within matched residues.

    Returns
    -------
    Deviation
        RMSD with and without superposition, TM-score, and the matched residues.

    Raises
    ------
    ProtochainError
        If nothing matches, or the sequences are unrelated.
    StructureError
        If a selection cannot be read or names no atom.

    Examples
    --------
    >>> found = pc.deviation("structures/ala10.pdb", "structures/ala10.pdb")
    >>> round(float(found.tm_score), 3)
    1.0
    """
    reference, model = structure_to_measure(reference), structure_to_measure(model)
    matches = match(reference, model)
    aligned = _atoms(reference, model, matches, align)
    measured = aligned if measure == align else _atoms(reference, model, matches, measure)
    turn, shift = motion(model.positions[aligned[1]], reference.positions[aligned[0]])
    x, y = model.positions[measured[1]], reference.positions[measured[0]]
    return Deviation(
        deviation_angstrom(x @ turn.T + shift, y), deviation_angstrom(x, y),
        tm_score(reference, model, matches), len(aligned[0]), len(measured[0]), matches,
    )  # fmt: skip


def rmsd(reference: Any, model: Any, align: str = ALPHA, measure: str | None = None) -> float:
    """RMSD of one structure from another after superposition. Their sequences may differ.

    Parameters
    ----------
    reference, model : Structure, Solution, path, or anything that :func:`protochain.as_structure` accepts
        Residues are matched by chain, number and name if all agree, otherwise by sequence alignment. Equal
        chains of a homomer are matched by the least RMSD. A file may contain only C-alpha atoms.
    align, measure : str
        Selections of the reference's atoms in the language of MDAnalysis: for the superposition, and for the
        RMSD, by default the same.

    Returns
    -------
    float, angstrom
        By Kabsch's rotation (Acta Cryst. A32:922, 1976). :func:`protochain.deviation` also returns the
        TM-score and the matched residues.

    Raises
    ------
    ProtochainError
        If nothing matches, the sequences are unrelated, or a selection cannot be read.

    Examples
    --------
    >>> pc.rmsd("structures/ala10.pdb", "structures/ala10.pdb") < 1e-6
    True
    """
    return deviation(reference, model, align, measure or align).rmsd


def rmsd_table(
    reference: str | Path, models: Sequence[str | Path], align: str = ALPHA, measure: str = ALPHA
) -> "pd.DataFrame":
    """Measure many files against a reference: one row per model of each file, failures included.

    A reference with several chains or with ligands has further columns, ``docking.QUALITY``.
    """
    from protochain.comparison.docking import QUALITY, complex_quality, is_complex

    first = structure_to_measure(reference)
    select(first, align), select(first, measure)
    with_quality = is_complex(first)
    rows = []
    for path in models:
        for number, structure in models_of(path):
            row: dict[str, Any] = {"reference": str(reference), "file": str(path), "model": number}
            try:
                if isinstance(structure, StructureError):
                    raise structure
                row |= deviation(first, structure, align, measure).record()
                if with_quality:
                    measured = complex_quality(first, structure)
                    row |= {key: measured[key] for key in QUALITY}
                row["message"] = ""
            except ProtochainError as error:
                row["message"] = str(error)
            rows.append(row)
    return pd.DataFrame(rows)


def _atoms(reference: Structure, model: Structure, matches: Match, query: str) -> tuple[Integers, Integers]:
    chosen = select(reference, query)
    pairs = pair_atoms(reference, model, (matches.reference, matches.model), chosen)
    if not len(pairs):
        raise ProtochainError(f"{model.name}: no atom of {query!r} matches {reference.name}")
    return pairs[:, 0], pairs[:, 1]
