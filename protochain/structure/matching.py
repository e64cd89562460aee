"""Corresponding residues of two structures, and structures of files with only C-alpha atoms."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import gemmi
import numpy as np
from numpy.typing import NDArray
from openmm import app

from protochain.core import defaults
from protochain.core.arrays import Floats, Integers, Value
from protochain.core.errors import OnlyAlphaError, ProtochainError, StructureError
from protochain.core.units import ANGSTROM_PER_NM
from protochain.structure.chains import PairSums, least_rmsd_mappings
from protochain.structure.convert import as_structure
from protochain.structure.formats.files import STANDARD_INPUT, parse
from protochain.structure.molecule.model import Structure
from protochain.structure.molecule.residues import STANDARD
from protochain.structure.molecule.templates import archive_parent, standard_name
from protochain.structure.preparation.model_choice import group_alternates, pick_altloc

_RELATED = 0.3
"""Least identity of related sequences, over the positions of an alignment with inner gaps. Sander, Schneider,
Proteins 9:56 (1991), and Rost, Protein Eng. 12:85 (1999), for some 80 residues. One of some 2500 unrelated
pairs of chains of 20 to 750 residues had more. Hundreds would have more if gaps did not count."""
_ONE_FOLD = 0.5  # Least TM-score of chains with the same fold: Xu, Zhang, Bioinformatics 26:889 (2010).
_FARTHEST = 1000.0  # Angstrom. Every assembly is shorter.
_EXCHANGEABLE = 0.95
"""Least identity relative to the most similar chain. In OpenStructure chains are equal from 0.95 on."""


@dataclass(frozen=True, eq=False)
class Match(Value):
    """Corresponding residues of two structures."""

    reference: Integers  # (n,) int: Indices of paired residues, in the order of the reference.
    model: Integers
    # ``numbers`` if chains, numbers and names agree, ``sequence`` if sequences were aligned, ``fold`` for
    # unrelated sequences of the same fold, paired by numbers if these agree, whatever the names.
    how: str
    identity: float  # Fraction of pairs with the same residue name.
    coverage: float  # Fraction of the reference's amino acids that are matched.
    chains: tuple[tuple[str, str], ...] = ()  # Ids of paired chains, of the reference and of the model.

    @property
    def chain_mapping(self) -> str:
        """Paired chains in one text, as ``A:B,B:A``, with ``_`` for a blank id."""
        return ",".join(f"{first or '_'}:{second or '_'}" for first, second in self.chains)


class _Alignment(NamedTuple):
    """Score of an alignment of two chains, pairs of residues, and the share of identical positions."""

    score: float
    pairs: list[tuple[int, int]]
    identity: float


_Pairs = Sequence[tuple[int, int]]
_Alignments = Mapping[tuple[int, int], _Alignment]
"""Alignments by the indices of a chain of the reference and one of the model."""


def match(reference: Structure, model: Structure) -> Match:
    """Pair residues by chain, number and name, or by alignment (BLOSUM62), equal chains by least RMSD."""
    return next(matches(reference, model))


def matches(reference: Structure, model: Structure) -> Iterator[Match]:
    """Pair residues as :func:`match`, then with the chains of a symmetric complex in other orders."""
    refs, models = _by_chain(reference), _by_chain(model)
    numbered = _numbered_pairs(reference, model)
    if not refs or not models:
        raise ProtochainError(f"{model.name}: no residue matches {reference.name}")
    if numbered and len(refs) == len(models) == 1:
        yield _make_match(reference, model, numbered, "numbers", [(0, 0)])
        return
    aligned = _alignments(refs, models, reference, model)
    place = {name: j for j, name in enumerate(models)}
    by_id = np.array([place.get(name, -1) for name in refs])
    first = by_id if numbered else _by_score(refs, models, aligned)
    for mapping in _mappings(reference, model, aligned, first):
        columns = [(i, j) for i, j in enumerate(mapping.tolist()) if j >= 0]
        if numbered and (mapping == first).all():
            yield _make_match(reference, model, numbered, "numbers", columns)
        else:
            yield _match_chains(reference, model, aligned, columns)


def _match_chains(reference: Structure, model: Structure, aligned: _Alignments, columns: _Pairs) -> Match:
    """Pair residues of chains by alignment, or by their fold."""
    refs, models = _by_chain(reference), _by_chain(model)
    pairs, matched, refused, how = list[tuple[int, int]](), list[tuple[int, int]](), list[str](), "fold"
    for i, j in columns:
        ref_id, model_id = list(refs)[i], list(models)[j]
        chain_pairs, score = aligned[i, j].pairs, 1.0
        if aligned[i, j].identity >= _RELATED:
            how = "sequence"
        else:
            chain_pairs, score = _pairs_of_fold(reference, model, refs[ref_id], models[model_id], chain_pairs)
        if chain_pairs and score >= _ONE_FOLD:
            pairs, matched = pairs + chain_pairs, [*matched, (i, j)]
        else:
            alike = f"{100 * aligned[i, j].identity:.0f} % identical, TM-score {score:.2f}"
            refused.append(f"chains {ref_id or '_'} and {model_id or '_'}: {alike}")
    if not pairs:
        raise ProtochainError(
            f"{model.name}: its sequence is unrelated to that of {reference.name} ({'; '.join(refused)}); "
            f"give one at least {100 * _RELATED:.0f} % identical, or of the same fold (TM-score {_ONE_FOLD})"
        )
    return _make_match(reference, model, sorted(pairs), how, matched)


def _make_match(reference: Structure, model: Structure, pairs: _Pairs, how: str, columns: _Pairs) -> Match:
    ref_ids, model_ids = list(_by_chain(reference)), list(_by_chain(model))
    amino = sum(name in STANDARD for name in reference.residue_name.tolist())
    first, second = np.array(pairs, dtype=np.int64).T
    same = reference.residue_name[first] == model.residue_name[second]
    chains = tuple((ref_ids[i], model_ids[j]) for i, j in columns)
    return Match(first, second, how, float(same.mean()), len(pairs) / amino, chains)


def pair_atoms(
    reference: Structure, model: Structure, residues: tuple[Integers, Integers], chosen: NDArray[np.bool_]
) -> Integers:
    """Pairs (n, 2) of chosen atoms (na,) of the reference and atoms of the same names in paired residues."""
    counterpart = dict(zip(*(index.tolist() for index in residues), strict=True))
    rows = zip(model.atom_residue.tolist(), model.atom_name.tolist(), strict=True)
    place = {row: k for k, row in enumerate(rows)}
    pairs = []
    for k in np.flatnonzero(chosen).tolist():
        row = counterpart.get(int(reference.atom_residue[k]), -1), str(reference.atom_name[k])
        if row in place:
            pairs.append((k, place[row]))
    return np.array(pairs, dtype=np.int64).reshape(-1, 2)


def tm_score(reference: Structure, model: Structure, matching: Match | None = None) -> float:
    """TM-score of the C-alphas by tmtools, normalised by and in the order of the reference."""
    ids = [chain for _, chain in matching.chains] if matching else []
    rank = {name: k for k, name in enumerate(ids)}
    alpha = model.alpha_carbons
    place = [rank.get(name, len(ids)) for name in model.residue_chain[model.atom_residue[alpha]].tolist()]
    ordered = alpha[np.argsort(place, kind="stable")]
    return _tm_scores(_trace(reference, reference.alpha_carbons), _trace(model, ordered))[0]


def _tm_scores(reference: tuple[Floats, str], model: tuple[Floats, str]) -> tuple[float, float]:
    """TM-scores of two traces, normalised by the length of the reference, and of the shorter trace."""
    import tmtools

    (x, sequence), (y, model_sequence) = reference, model
    # The run time of tmtools grows with the extents, which it does not document.
    if (
        min(len(sequence), len(model_sequence)) < 3
        or max(np.ptp(x, axis=0).max(), np.ptp(y, axis=0).max()) > _FARTHEST
    ):
        return float("nan"), float("nan")
    result = tmtools.tm_align(y, x, model_sequence, sequence)
    return float(result.tm_norm_chain2), float(max(result.tm_norm_chain1, result.tm_norm_chain2))


def structure_to_measure(source: Any, keep: Sequence[str] | None = None) -> Structure:
    """Return the structure of a measurable source, or the first model of a file, with hetero molecules."""
    if not isinstance(source, str | Path):
        return as_structure(source)
    first_model = next(structure for _, structure in models_of(source, True, keep))
    if isinstance(first_model, StructureError):
        raise first_model
    return first_model


def models_of(
    path: str | Path, first: bool = False, keep: Sequence[str] | None = None
) -> Iterator[tuple[int | None, Structure | StructureError]]:
    """Numbers and structures of all models of a file, or of its first. Standard input is read once."""
    source = "standard input" if Path(path) == STANDARD_INPUT else str(path)
    try:
        parsed = parse(Path(path))[0]
    except StructureError as error:
        yield None, error
        return
    for number in [model.num for model in parsed][: 1 if first else None]:
        try:
            # Parts of strands that are far from the protein of one model are near in another.
            kinds = (*defaults.KEEP, "nucleic") if keep is None else keep
            yield number, as_structure(parsed, source, model=number, keep=kinds)
        except OnlyAlphaError:
            yield number, alpha_trace(parsed, source, number)
        except StructureError as error:
            yield number, error


def alpha_trace(parsed: gemmi.Structure, source: str, model: int) -> Structure:
    """Return the C-alpha atoms of the amino acids of a model as a structure."""
    topology, x = app.Topology(), list[list[float]]()
    carbon = app.Element.getBySymbol("C")
    for chain in next(m for m in parsed if m.num == model):
        added_chain = topology.addChain(chain.name.strip())
        for group in group_alternates(chain):
            residue = pick_altloc(group, "").residue
            code = residue.name.strip().upper()
            standard = standard_name(code)[0]
            name = standard if standard in STANDARD else archive_parent(code)
            atom = residue.find_atom("CA", "*")
            if name in STANDARD and atom:
                number, insertion_code = str(residue.seqid.num), residue.seqid.icode.strip()
                place = topology.addResidue(name, added_chain, number, insertion_code)
                topology.addAtom("CA", carbon, place)
                x.append([coordinate / ANGSTROM_PER_NM for coordinate in atom.pos.tolist()])
    if not x:
        raise StructureError(f"{source}: no C-alpha atom found; give a file with amino acids")
    return Structure(source, topology, np.array(x))


def _numbered_pairs(reference: Structure, model: Structure) -> list[tuple[int, int]]:
    """Pairs of amino acids of equal chain, number and name, if one structure is paired completely."""
    names, model_names = _names(reference), _names(model)
    place = {name: r for r, name in enumerate(model_names)}
    pairs = [(r, place[name]) for r, name in enumerate(names) if name in place]
    if len(pairs) < min(len(names), len(model_names)) or len(place) < len(model_names):
        return []
    return [(r, s) for r, s in pairs if str(reference.residue_name[r]) in STANDARD]


def _names(s: Structure) -> list[tuple[str, ...]]:
    columns = (s.residue_chain, s.residue_number, s.residue_insertion_code, s.residue_name)
    return [tuple(map(str, row)) for row in zip(*columns, strict=True)]


def _by_chain(s: Structure) -> dict[str, list[int]]:
    """Amino acids of each chain id. A broken chain is one sequence."""
    chains: dict[str, list[int]] = {}
    for r in range(s.n_residues):
        if str(s.residue_name[r]) in STANDARD:
            chains.setdefault(str(s.residue_chain[r]), []).append(r)
    return chains


def _alignments(
    refs: dict[str, list[int]], models: dict[str, list[int]], reference: Structure, model: Structure
) -> _Alignments:
    """Alignments of all pairs of chains, row by row, computed once for equal sequences."""
    unique: dict[tuple[tuple[str, ...], tuple[str, ...]], _Alignment] = {}
    alignments = {}
    for i, ref in enumerate(refs.values()):
        first = tuple(reference.residue_name[ref].tolist())
        for j, query in enumerate(models.values()):
            second = tuple(model.residue_name[query].tolist())
            if (first, second) not in unique:
                unique[first, second] = _align(first, second)
            alignment = unique[first, second]
            alignments[i, j] = alignment._replace(pairs=[(ref[a], query[b]) for a, b in alignment.pairs])
    return alignments


def _by_score(refs: dict[str, list[int]], models: dict[str, list[int]], aligned: _Alignments) -> Integers:
    """Chains (k,) of the model with the largest sum of scores, or -1. Unrelated chains pair by id."""
    from scipy.optimize import linear_sum_assignment

    shape = len(refs), len(models)
    related = np.reshape([alignment.identity >= _RELATED for alignment in aligned.values()], shape)
    scores = np.reshape([alignment.score for alignment in aligned.values()], shape)
    lowest = float(scores.min()) - 1.0
    same = np.array([[ref_id == model_id for model_id in models] for ref_id in refs])
    first, second = linear_sum_assignment(-np.where(related, scores, lowest + 0.5 * same))
    mapping = np.full(len(refs), -1)
    mapping[first] = second
    return mapping


def _mappings(
    reference: Structure, model: Structure, aligned: _Alignments, first: Integers
) -> list[Integers]:
    """Mappings of chains with the least RMSD, among chains as similar as in the first mapping."""
    k, m = (1 + max(pair[side] for pair in aligned) for side in (0, 1))
    identity = np.reshape([alignment.identity for alignment in aligned.values()], (k, m))
    n_matched = np.reshape([len(alignment.pairs) for alignment in aligned.values()], (k, m))
    # Chains with identical pieces need not be equal.
    alike = np.where(identity >= _RELATED, identity * n_matched, 0.0)
    likest = np.maximum(alike.max(axis=1)[:, None], alike.max(axis=0)[None])
    highest = np.maximum(identity.max(axis=1)[:, None], identity.max(axis=0)[None])
    exchangeable = (identity >= _EXCHANGEABLE * highest) & (alike >= 0.5 * likest) & (alike > 0.0)
    exchangeable[np.flatnonzero(first >= 0), first[first >= 0]] = True
    if (exchangeable.sum(axis=0) < 2).all() and (exchangeable.sum(axis=1) < 2).all():
        return [first]
    points = {}
    ref_x, model_x = _alphas(reference), _alphas(model)
    for i, j in np.argwhere(exchangeable).tolist():
        pairs = np.array(aligned[i, j].pairs, dtype=np.int64).reshape(-1, 2)
        x, y = model_x[pairs[:, 1]], ref_x[pairs[:, 0]]
        present = np.isfinite(x).all(axis=1) & np.isfinite(y).all(axis=1)
        if present.any():
            points[i, j] = x[present], y[present]
    sums = PairSums.of(points, k, m)
    if not (sums.weight[first >= 0, first[first >= 0]] > 0).all():
        return [first]  # Without C-alphas there is no RMSD.
    return least_rmsd_mappings(sums, first)


def _alphas(s: Structure) -> Floats:
    """Positions (nr, 3) of the C-alphas about their centre, nm, or NaN."""
    alpha = s.alpha_carbons
    x = np.full((s.n_residues, 3), np.nan)
    if len(alpha):
        x[s.atom_residue[alpha]] = s.positions[alpha] - s.positions[alpha].mean(axis=0)
    return x


def _pairs_of_fold(
    reference: Structure, model: Structure, ref: list[int], query: list[int], aligned: list[tuple[int, int]]
) -> tuple[list[tuple[int, int]], float]:
    """Pairs of residues of chains with unrelated sequences, as designs on one backbone, and the TM-score."""

    def numbers(s: Structure, residues: list[int]) -> dict[tuple[str, str], int]:
        codes = s.residue_insertion_code
        return {(str(s.residue_number[r]), str(codes[r])): r for r in residues}

    first, second = numbers(reference, ref), numbers(model, query)
    pairs = [(r, second[name]) for name, r in first.items() if name in second]
    traces = []
    for s, residues in ((reference, ref), (model, query)):
        alpha = s.alpha_carbons
        traces.append(_trace(s, alpha[np.isin(s.atom_residue[alpha], residues)]))
    _, score = _tm_scores(*traces)
    return (pairs if len(pairs) == min(len(ref), len(query)) else aligned), score


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
    # From the first aligned residue to the last, because overhangs are not differences.
    positions = sum(pairs[-1]) - sum(pairs[0]) - len(pairs) + 2 if pairs else 1
    return _Alignment(float(result.score), pairs, same / positions)


def _trace(s: Structure, alpha: Integers) -> tuple[Floats, str]:
    names = s.residue_name[s.atom_residue[alpha]]
    return ANGSTROM_PER_NM * s.positions[alpha], "".join(STANDARD.get(str(name), "X") for name in names)
