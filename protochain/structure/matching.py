"""Corresponding residues of two structures, and what can be measured of files of C-alpha atoms only."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gemmi
import numpy as np
from scipy.optimize import linear_sum_assignment

from protochain.arrays import Floats, Integers
from protochain.errors import OnlyAlphaError, ProtochainError, StructureError
from protochain.residues import STANDARD
from protochain.structure.convert import as_structure
from protochain.structure.files import STANDARD_INPUT, parse
from protochain.structure.model import Structure
from protochain.structure.trace import alpha_trace
from protochain.units import ANGSTROM_PER_NM


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


def tm_score(reference: Structure, model: Structure) -> float:
    """TM-score of the C-alphas, by tmtools, normalised by the reference's length."""
    import tmtools

    (x, sequence), (y, other) = _trace(reference), _trace(model)
    if min(len(sequence), len(other)) < 3:
        return float("nan")
    return float(tmtools.tm_align(y, x, other, sequence).tm_norm_chain2)


def measurable(source: Any) -> Structure:
    """Structure of anything that can be measured; of a file, its first model.

    Raises
    ------
    StructureError
        If it cannot be used; a file of C-alpha atoms only can.
    """
    if not isinstance(source, str | Path):
        return as_structure(source)
    found = next(structure for _, structure in models_of(source, first=True))
    if isinstance(found, StructureError):
        raise found
    return found


def models_of(
    path: str | Path, first: bool = False
) -> Iterator[tuple[int | None, Structure | StructureError]]:
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


def _trace(s: Structure) -> tuple[Floats, str]:
    alpha = s.alpha_carbons
    names = s.residue_name[s.atom_residue[alpha]]
    return ANGSTROM_PER_NM * s.positions[alpha], "".join(STANDARD.get(str(name), "X") for name in names)
