"""Corresponding residues of two structures, and what can be measured of files of C-alpha atoms only."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import gemmi
import numpy as np

from protochain.core.arrays import Floats, Integers, Value
from protochain.core.errors import OnlyAlphaError, ProtochainError, StructureError
from protochain.core.units import ANGSTROM_PER_NM
from protochain.structure.chains import PairSums, least_deviation
from protochain.structure.convert import as_structure
from protochain.structure.formats.files import STANDARD_INPUT, parse
from protochain.structure.molecule.model import Structure
from protochain.structure.molecule.residues import STANDARD
from protochain.structure.preparation.trace import alpha_trace

_RELATED = 0.3
"""Of the positions of an alignment, gaps between them included: identity from which on sequences are related.
Sander, Schneider, Proteins 9:56 (1991), and Rost, Protein Eng. 12:85 (1999), for some 80 residues. Of some
2500 unrelated pairs of chains of 20 to 750 residues one had more; hundreds would, if gaps did not count."""
_ONE_FOLD = 0.5
"""TM-score from which on two chains have one fold: Xu, Zhang, Bioinformatics 26:889 (2010)."""
_AS_ALIKE = 0.95
"""Share of the identity with the likest chain from which on a chain may stand in its place; OpenStructure
takes chains for equal from an identity of 0.95 on."""


@dataclass(frozen=True, eq=False)
class Match(Value):
    """Corresponding residues of two structures."""

    reference: Integers  # (n,) int: Indices of paired residues, in the order of the reference.
    model: Integers
    # ``numbers`` if chains, numbers and names agree; ``sequence`` if sequences were aligned; ``fold`` if they
    # are unrelated, but one fold has both: then by numbers if these agree, whatever the names.
    how: str
    identity: float  # Fraction of pairs with the same residue name.
    coverage: float  # Fraction of the reference's amino acids that are matched.
    chains: tuple[tuple[str, str], ...] = ()  # Ids of paired chains, of the reference and of the model.

    @property
    def chain_mapping(self) -> str:
        """Paired chains in one text, as ``A:B,B:A``; a blank id is ``_``."""
        return ",".join(f"{own or '_'}:{other or '_'}" for own, other in self.chains)


class _Alignment(NamedTuple):
    """Score of an alignment of two chains, pairs of residues, and the share of identical positions."""

    score: float
    pairs: list[tuple[int, int]]
    identity: float


def match(reference: Structure, model: Structure) -> Match:
    """Pair residues by chain, number and name, else by alignment (BLOSUM62); like chains for least RMSD."""
    ours, theirs = _by_chain(reference), _by_chain(model)
    numbered = _numbered(reference, model)
    if not ours or not theirs:
        raise ProtochainError(f"{model.name}: no residue matches {reference.name}")
    if numbered and len(ours) == len(theirs) == 1:
        return _matched(reference, model, numbered, "numbers", [(0, 0)])
    aligned = _alignments(ours, theirs, reference, model)
    place = {name: j for j, name in enumerate(theirs)}
    by_id = np.array([place.get(name, -1) for name in ours])
    first = by_id if numbered else _by_score(ours, theirs, aligned)
    mapping = _least(reference, model, aligned, first)
    columns = [(i, j) for i, j in enumerate(mapping.tolist()) if j >= 0]
    if numbered and (mapping == first).all():
        return _matched(reference, model, numbered, "numbers", columns)
    pairs, kept, refused, how = list[tuple[int, int]](), list[tuple[int, int]](), list[str](), "fold"
    for i, j in columns:
        own, other = list(ours)[i], list(theirs)[j]
        its, score = aligned[i, j].pairs, 1.0
        if aligned[i, j].identity >= _RELATED:
            how = "sequence"
        else:
            its, score = _of_one_fold(reference, model, ours[own], theirs[other], its)
        if its and score >= _ONE_FOLD:
            pairs, kept = pairs + its, [*kept, (i, j)]
        else:
            percent = f"{100 * aligned[i, j].identity:.0f} %"
            refused.append(
                f"chains {own or '_'} and {other or '_'}: {percent} identical, TM-score {score:.2f}"
            )
    if not pairs:
        raise ProtochainError(
            f"{model.name}: its sequence is unrelated to that of {reference.name} ({'; '.join(refused)}); "
            f"give one at least {100 * _RELATED:.0f} % identical, or of the same fold (TM-score {_ONE_FOLD})"
        )
    return _matched(reference, model, sorted(pairs), how, kept)


def _matched(
    reference: Structure,
    model: Structure,
    pairs: Sequence[tuple[int, int]],
    how: str,
    columns: Sequence[tuple[int, int]],
) -> Match:
    ours, theirs = list(_by_chain(reference)), list(_by_chain(model))
    amino = sum(name in STANDARD for name in reference.residue_name.tolist())
    first, second = np.array(pairs, dtype=np.int64).T
    same = reference.residue_name[first] == model.residue_name[second]
    chains = tuple((ours[i], theirs[j]) for i, j in columns)
    return Match(first, second, how, float(same.mean()), len(pairs) / amino, chains)


def tm_score(reference: Structure, model: Structure, found: Match | None = None) -> float:
    """TM-score of the C-alphas, by tmtools, normalised by the reference's length, in its order."""
    ids = [other for _, other in found.chains] if found else []
    rank = {name: k for k, name in enumerate(ids)}
    alpha = model.alpha_carbons
    place = [rank.get(name, len(ids)) for name in model.residue_chain[model.atom_residue[alpha]].tolist()]
    ordered = alpha[np.argsort(place, kind="stable")]
    return _aligned_by_shape(_trace(reference, reference.alpha_carbons), _trace(model, ordered))[0]


def _aligned_by_shape(reference: tuple[Floats, str], model: tuple[Floats, str]) -> tuple[float, float]:
    """TM-scores of two traces, normalised by the length of the reference, and by that of the shorter one."""
    import tmtools

    (x, sequence), (y, other) = reference, model
    # Its time grows with their extents, of which it says nothing.
    if (
        min(len(sequence), len(other)) < 3
        or max(np.ptp(x, axis=0).max(), np.ptp(y, axis=0).max()) > _FARTHEST
    ):
        return float("nan"), float("nan")
    done = tmtools.tm_align(y, x, other, sequence)
    return float(done.tm_norm_chain2), float(max(done.tm_norm_chain1, done.tm_norm_chain2))


_FARTHEST = 1000.0
"""Angstrom; no assembly is that long."""


def measurable(source: Any) -> Structure:
    """Structure of anything that can be measured; of a file, its first model."""
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


def _numbered(reference: Structure, model: Structure) -> list[tuple[int, int]]:
    """Pairs of amino acids of equal chain, number and name, if every residue of one structure is in one."""
    ours, theirs = _names(reference), _names(model)
    place = {name: r for r, name in enumerate(theirs)}
    pairs = [(r, place[name]) for r, name in enumerate(ours) if name in place]
    if len(pairs) < min(len(ours), len(theirs)) or len(place) < len(theirs):
        return []
    return [(r, s) for r, s in pairs if str(reference.residue_name[r]) in STANDARD]


def _names(s: Structure) -> list[tuple[str, ...]]:
    columns = (s.residue_chain, s.residue_number, s.residue_insertion_code, s.residue_name)
    return [tuple(map(str, row)) for row in zip(*columns, strict=True)]


def _by_chain(s: Structure) -> dict[str, list[int]]:
    """Amino acids of each chain id; a broken chain is one sequence."""
    found: dict[str, list[int]] = {}
    for r in range(s.n_residues):
        if str(s.residue_name[r]) in STANDARD:
            found.setdefault(str(s.residue_chain[r]), []).append(r)
    return found


def _alignments(
    ours: dict[str, list[int]], theirs: dict[str, list[int]], reference: Structure, model: Structure
) -> dict[tuple[int, int], _Alignment]:
    """Alignments of all pairs of chains; those of equal sequences are made once."""
    made: dict[tuple[tuple[str, ...], tuple[str, ...]], _Alignment] = {}
    found = {}
    for i, own in enumerate(ours.values()):
        first = tuple(reference.residue_name[own].tolist())
        for j, other in enumerate(theirs.values()):
            second = tuple(model.residue_name[other].tolist())
            if (first, second) not in made:
                made[first, second] = _align(first, second)
            done = made[first, second]
            found[i, j] = done._replace(pairs=[(own[a], other[b]) for a, b in done.pairs])
    return found


def _by_score(
    ours: dict[str, list[int]], theirs: dict[str, list[int]], aligned: Mapping[tuple[int, int], _Alignment]
) -> Integers:
    """Chains (k,) of the model for the largest sum of scores, -1 for none; unrelated ones by their ids."""
    from scipy.optimize import linear_sum_assignment

    related = np.array(
        [[aligned[i, j].identity >= _RELATED for j in range(len(theirs))] for i in range(len(ours))]
    )
    scores = np.array([[aligned[i, j].score for j in range(len(theirs))] for i in range(len(ours))])
    lowest = float(scores.min()) - 1.0
    same = np.array([[own == other for other in theirs] for own in ours])
    first, second = linear_sum_assignment(-np.where(related, scores, lowest + 0.5 * same))
    mapping = np.full(len(ours), -1)
    mapping[first] = second
    return mapping


def _least(
    reference: Structure, model: Structure, aligned: Mapping[tuple[int, int], _Alignment], first: Integers
) -> Integers:
    """Mapping of chains with the least RMSD, of chains that are as alike as those of the first one."""
    k, m = (1 + max(pair[side] for pair in aligned) for side in (0, 1))
    identity = np.array([[aligned[i, j].identity for j in range(m)] for i in range(k)])
    n_matched = np.array([[len(aligned[i, j].pairs) for j in range(m)] for i in range(k)])
    # A pair of identical pieces is not one of equal chains.
    alike = np.where(identity >= _RELATED, identity * n_matched, 0.0)
    likest = np.maximum(alike.max(axis=1)[:, None], alike.max(axis=0)[None])
    most = np.maximum(identity.max(axis=1)[:, None], identity.max(axis=0)[None])
    exchangeable = (identity >= _AS_ALIKE * most) & (alike >= 0.5 * likest) & (alike > 0.0)
    exchangeable[np.flatnonzero(first >= 0), first[first >= 0]] = True
    if (exchangeable.sum(axis=0) < 2).all() and (exchangeable.sum(axis=1) < 2).all():
        return first
    points = {}
    own, other = _alphas(reference), _alphas(model)
    for i, j in np.argwhere(exchangeable).tolist():
        pairs = np.array(aligned[i, j].pairs, dtype=np.int64).reshape(-1, 2)
        x, y = other[pairs[:, 1]], own[pairs[:, 0]]
        there = np.isfinite(x).all(axis=1) & np.isfinite(y).all(axis=1)
        if there.any():
            points[i, j] = x[there], y[there]
    sums = PairSums.of(points, k, m)
    if not (sums.weight[first >= 0, first[first >= 0]] > 0).all():
        return first  # Of files without C-alphas nothing is measured here.
    return least_deviation(sums, first)


def _alphas(s: Structure) -> Floats:
    """Positions (nr, 3) of the C-alphas about their centre, nm; NaN where there is none."""
    alpha = s.alpha_carbons
    x = np.full((s.n_residues, 3), np.nan)
    if len(alpha):
        x[s.atom_residue[alpha]] = s.positions[alpha] - s.positions[alpha].mean(axis=0)
    return x


def _of_one_fold(
    reference: Structure, model: Structure, own: list[int], other: list[int], aligned: list[tuple[int, int]]
) -> tuple[list[tuple[int, int]], float]:
    """Pairs of residues of chains of unrelated sequences, as of designs on one backbone, and the TM-score."""

    def numbers(s: Structure, residues: list[int]) -> dict[tuple[str, str], int]:
        codes = s.residue_insertion_code
        return {(str(s.residue_number[r]), str(codes[r])): r for r in residues}

    first, second = numbers(reference, own), numbers(model, other)
    both = [(r, second[name]) for name, r in first.items() if name in second]
    traces = []
    for s, residues in ((reference, own), (model, other)):
        alpha = s.alpha_carbons
        traces.append(_trace(s, alpha[np.isin(s.atom_residue[alpha], residues)]))
    _, score = _aligned_by_shape(*traces)
    return (both if len(both) == min(len(own), len(other)) else aligned), score


def _align(first: tuple[str, ...], second: tuple[str, ...]) -> _Alignment:
    result = gemmi.align_string_sequences(list(first), list(second), [], gemmi.AlignmentScoring("b"))
    pairs, i, j = [], 0, 0
    for digits, kind in re.findall(r"(\d+)(\D)", result.cigar_str()):
        length = int(digits)
        if kind == "M":
            pairs += [(i + k, j + k) for k in range(length)]
        i += length if kind in "MI" else 0
        j += length if kind in "MD" else 0
    same = sum(first[a] == second[b] for a, b in pairs)
    # From the first aligned residue to the last: what a sequence has beyond the other is no difference.
    positions = sum(pairs[-1]) - sum(pairs[0]) - len(pairs) + 2 if pairs else 1
    return _Alignment(float(result.score), pairs, same / positions)


def _trace(s: Structure, alpha: Integers) -> tuple[Floats, str]:
    names = s.residue_name[s.atom_residue[alpha]]
    return ANGSTROM_PER_NM * s.positions[alpha], "".join(STANDARD.get(str(name), "X") for name in names)
