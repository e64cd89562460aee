"""Deviation of one structure from another: residue matching, superposition, RMSD and TM-score."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gemmi
import numpy as np
import pandas as pd
from scipy.optimize import linear_sum_assignment

from protochain.arrays import Floats, Integers
from protochain.checks import checked, text
from protochain.errors import OnlyAlphaError, ProtochainError, StructureError
from protochain.residues import STANDARD
from protochain.structure import Structure, as_structure
from protochain.structure.files import STANDARD_INPUT, parse
from protochain.structure.select import select
from protochain.structure.superpose import motion
from protochain.structure.trace import alpha_trace
from protochain.units import ANGSTROM_PER_NM

ALPHA = "name CA"
"""Selection of the C-alpha atoms, in MDAnalysis syntax."""


@dataclass(frozen=True, eq=False)
class Match:
    """Corresponding residues of two structures.

    Parameters
    ----------
    reference, model : (n,) int
        Indices of paired residues, in the order of the reference.
    how : str
        ``numbers`` if chains, numbers and names agree; ``sequence`` if sequences were aligned.
    identity : float
        Fraction of pairs with the same residue name.
    coverage : float
        Fraction of the reference's amino acids that are matched.
    """

    reference: Integers
    model: Integers
    how: str
    identity: float
    coverage: float


@dataclass(frozen=True)
class Deviation:
    """Deviation of a model from a reference, in angstrom.

    Parameters
    ----------
    rmsd : float
        Of the measured atoms, after superposition on the aligned ones.
    rmsd_unsuperposed : float
        Of the same atoms, without superposition.
    tm_score : float
        Of the C-alphas, normalised by the reference's length, with tmtools' own alignment (Zhang, Skolnick,
        Nucleic Acids Res. 33:2302, 2005); NaN below three residues.
    n_aligned, n_measured : int
        Numbers of atoms.
    match : Match
    """

    rmsd: float
    rmsd_unsuperposed: float
    tm_score: float
    n_aligned: int
    n_measured: int
    match: Match

    def record(self) -> dict[str, Any]:
        """Flat row, with units in the names."""
        return {
            "rmsd_angstrom": self.rmsd,
            "rmsd_unsuperposed_angstrom": self.rmsd_unsuperposed,
            "tm_score": self.tm_score if np.isfinite(self.tm_score) else None,
            "matched_residues": len(self.match.reference),
            "coverage": self.match.coverage,
            "identity": self.match.identity,
            "matched_by": self.match.how,
            "aligned_atoms": self.n_aligned,
            "measured_atoms": self.n_measured,
        }


def match(reference: Structure, model: Structure) -> Match:
    """Pair residues by chain, number and name if all agree, otherwise by sequence alignment.

    Alignments are global, by gemmi with BLOSUM62. Chains are paired for the largest sum of scores.

    Parameters
    ----------
    reference, model : Structure

    Returns
    -------
    Match

    Raises
    ------
    ProtochainError
        If no residue matches.
    """
    ours, theirs = _names(reference), _names(model)
    place = {name: r for r, name in enumerate(theirs)}
    pairs = [(r, place[name]) for r, name in enumerate(ours) if name in place]
    how = "numbers"
    if len(pairs) < min(len(ours), len(theirs)) or len(place) < len(theirs):
        pairs, how = sorted(_aligned(reference, model)), "sequence"
    amino = [r for r in range(reference.n_residues) if str(reference.residue_name[r]) in STANDARD]
    pairs = [(r, s) for r, s in pairs if str(reference.residue_name[r]) in STANDARD]
    if not pairs:
        raise ProtochainError(f"{model.name}: no residue matches {reference.name}")
    first, second = np.array(pairs, dtype=np.int64).T
    same = reference.residue_name[first] == model.residue_name[second]
    return Match(first, second, how, float(same.mean()), len(pairs) / len(amino))


@checked(align=text, measure=text)
def deviation(reference: Any, model: Any, align: str = ALPHA, measure: str = ALPHA) -> Deviation:
    """Measure the deviation of a model from a reference.

    Parameters
    ----------
    reference, model : Structure, Solution, path, or anything that :func:`protochain.as_structure` takes
        Their sequences may differ. A file may hold only C-alpha atoms.
    align, measure : str
        Selections of the reference's atoms: those superposed, and those whose RMSD is measured. Atoms are
        matched by name within matched residues.

    Returns
    -------
    Deviation
        RMSD with and without superposition, TM-score, and the residues matched.

    Raises
    ------
    ProtochainError
        If nothing matches.
    StructureError
        If a selection cannot be read or names no atom.
    """
    reference, model = _measured(reference), _measured(model)
    found = match(reference, model)
    aligned = _atoms(reference, model, found, align)
    measured = aligned if measure == align else _atoms(reference, model, found, measure)
    turn, shift = motion(model.positions[aligned[1]], reference.positions[aligned[0]])
    off = model.positions[measured[1]] - reference.positions[measured[0]]
    moved = model.positions[measured[1]] @ turn.T + shift - reference.positions[measured[0]]
    return Deviation(
        _root_mean_square(moved), _root_mean_square(off), tm_score(reference, model),
        len(aligned[0]), len(measured[0]), found,
    )  # fmt: skip


def rmsd(reference: Any, model: Any, align: str = ALPHA, measure: str | None = None) -> float:
    """RMSD of one structure from another after superposition; their sequences may differ.

    Parameters
    ----------
    reference, model : Structure, Solution, path, or anything that :func:`protochain.as_structure` takes
        Residues are matched by chain, number and name if all agree, otherwise by sequence alignment. A file
        may hold only C-alpha atoms.
    align, measure : str
        Selections of the reference's atoms in the language of MDAnalysis: those superposed, and those whose
        RMSD is measured, by default the same.

    Returns
    -------
    float, angstrom
        By Kabsch's rotation (Acta Cryst. A32:922, 1976). :func:`protochain.deviation` tells the TM-score too,
        and what was matched.

    Raises
    ------
    ProtochainError
        If nothing matches, or a selection cannot be read.
    """
    return deviation(reference, model, align, measure or align).rmsd


def tm_score(reference: Structure, model: Structure) -> float:
    """TM-score of the C-alphas, by tmtools, normalised by the reference's length."""
    import tmtools

    (x, sequence), (y, other) = _trace(reference), _trace(model)
    if min(len(sequence), len(other)) < 3:
        return float("nan")
    return float(tmtools.tm_align(y, x, other, sequence).tm_norm_chain2)


def rmsd_table(
    reference: str | Path, models: Sequence[str | Path], align: str = ALPHA, measure: str = ALPHA
) -> pd.DataFrame:
    """Measure many files against one: one row per model of each file, failures included.

    Parameters
    ----------
    reference : path-like
        Its first model; ``-`` is standard input.
    models : sequence of path-like
        A file that holds only C-alpha atoms is measured by these.
    align, measure : str
        As in :func:`deviation`.

    Returns
    -------
    pandas.DataFrame
        ``reference``, ``file``, ``model``, the columns of :meth:`Deviation.record`, and ``message``, the
        reason if nothing could be measured.

    Raises
    ------
    StructureError
        If the reference cannot be used.
    """
    first = _measured(reference)
    select(first, align), select(first, measure)
    rows = []
    for path in models:
        for number, structure in _models(path):
            row: dict[str, Any] = {"reference": str(reference), "file": str(path), "model": number}
            try:
                if isinstance(structure, StructureError):
                    raise structure
                row |= {**deviation(first, structure, align, measure).record(), "message": ""}
            except ProtochainError as error:
                row["message"] = str(error)
            rows.append(row)
    return pd.DataFrame(rows)


def _measured(source: Any) -> Structure:
    """Structure of anything that can be measured; of a file, its first model."""
    if not isinstance(source, str | Path):
        return as_structure(source)
    found = next(structure for _, structure in _models(source, first=True))
    if isinstance(found, StructureError):
        raise found
    return found


def _models(path: str | Path, first: bool = False) -> Iterator[tuple[int | None, Structure | StructureError]]:
    """Numbers and structures of all models of a file, or of its first; standard input is read only once."""
    source = "standard input" if Path(path) == STANDARD_INPUT else str(path)
    try:
        parsed = parse(Path(path))[0]
    except StructureError as error:
        yield None, error
        return
    for number in [model.num for model in parsed][: 1 if first else None]:
        try:
            yield number, as_structure(parsed, source, model=number)
        except OnlyAlphaError:
            yield number, alpha_trace(parsed, source, number)
        except StructureError as error:
            yield number, error


def _names(s: Structure) -> list[tuple[str, ...]]:
    columns = (s.residue_chain, s.residue_number, s.residue_insertion_code, s.residue_name)
    return [tuple(map(str, row)) for row in zip(*columns, strict=True)]


def _aligned(reference: Structure, model: Structure) -> Iterator[tuple[int, int]]:
    """Pairs of residues from sequence alignments of paired chains."""
    ours, theirs = _by_chain(reference), _by_chain(model)
    results = [[_align(a, b, reference, model) for b in theirs] for a in ours]
    scores = np.array([[score for score, _ in row] for row in results])
    for i, j in zip(*linear_sum_assignment(-scores), strict=True):
        yield from results[i][j][1]


def _by_chain(s: Structure) -> list[list[int]]:
    """Amino acids of each chain id; a broken chain is one sequence."""
    found: dict[str, list[int]] = {}
    for r in range(s.n_residues):
        if str(s.residue_name[r]) in STANDARD:
            found.setdefault(str(s.residue_chain[r]), []).append(r)
    return list(found.values())


def _align(
    first: list[int], second: list[int], reference: Structure, model: Structure
) -> tuple[float, list[tuple[int, int]]]:
    result = gemmi.align_string_sequences(
        [str(reference.residue_name[r]) for r in first],
        [str(model.residue_name[r]) for r in second],
        [],
        gemmi.AlignmentScoring("b"),
    )
    pairs, i, j = [], 0, 0
    for length, kind in _cigar(result.cigar_str()):
        if kind == "M":
            pairs += [(first[i + k], second[j + k]) for k in range(length)]
        i += length if kind in "MI" else 0
        j += length if kind in "MD" else 0
    return float(result.score), pairs


def _cigar(text: str) -> Iterator[tuple[int, str]]:
    digits = ""
    for letter in text:
        if letter.isdigit():
            digits += letter
        else:
            yield int(digits), letter
            digits = ""


def _atoms(reference: Structure, model: Structure, found: Match, selection: str) -> tuple[Integers, Integers]:
    chosen = select(reference, selection)
    counterpart = dict(zip(found.reference.tolist(), found.model.tolist(), strict=True))
    at = {
        (int(r), str(name)): k
        for k, (r, name) in enumerate(zip(model.atom_residue, model.atom_name, strict=True))
    }
    pairs = [
        (k, at[key])
        for k in np.flatnonzero(chosen).tolist()
        if (key := (counterpart.get(int(reference.atom_residue[k]), -1), str(reference.atom_name[k]))) in at
    ]
    if not pairs:
        raise ProtochainError(f"{model.name}: no atom of {selection!r} matches {reference.name}")
    first, second = np.array(pairs, dtype=np.int64).T
    return first, second


def _trace(s: Structure) -> tuple[Floats, str]:
    alpha = s.alpha_carbons
    names = s.residue_name[s.atom_residue[alpha]]
    return ANGSTROM_PER_NM * s.positions[alpha], "".join(STANDARD.get(str(name), "X") for name in names)


def _root_mean_square(off: Floats) -> float:
    return float(ANGSTROM_PER_NM * np.sqrt(np.mean(np.sum(off**2, axis=1))))
