"""Hetero molecules of a structure: ligands, cofactors, glycans, ions, nucleic acids, waters."""

import re
from collections import Counter
from collections.abc import Container, Generator, Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import gemmi
import numpy as np
from scipy.spatial import KDTree

from protochain.core import defaults
from protochain.core.arrays import Floats, Integers
from protochain.core.errors import Argument, StructureError
from protochain.core.graph import components
from protochain.core.markup import abridge, plural
from protochain.structure.formats.ions import charge_cluster, has_known_charge
from protochain.structure.molecule import residues
from protochain.structure.molecule.links import Link, is_metal
from protochain.structure.molecule.member import Member, Unknown
from protochain.structure.molecule.repairs import KEEP_ALL, Count, Kind, Loss, Reason, Repair
from protochain.structure.molecule.templates import Template
from protochain.structure.preparation import glycans
from protochain.structure.preparation.linkage import STATED
from protochain.structure.preparation.recognise import find_template, template_by_element
from protochain.structure.preparation.structure_draft import (
    Changes,
    Draft,
    Evidence,
    HeteroResidue,
    Omission,
    Part,
)

KINDS = ("none", "near", "all", "water", "ions", "nucleic", "ligands")
"""Words that select molecules by kind. Any other word is a residue name."""
JOIN_CUTOFF = 2.0
"""Angstrom. Molecules with atoms closer than this are parts of one, such as sugars of a glycan (1.4)."""
_H_BOND, _MAX_RISE = 3.4, 1.5
"""Angstrom. Largest length of hydrogen bonds of base pairs, and largest height above the plane of a base.
Stacked bases are 3.4 apart. (Lu, Bussemaker, Olson, Nucleic Acids Res. 43:e142, 2015, allow 4.0 and 2.5.)"""
_OVERLAP = 0.5  # Angstrom. Atoms of two molecules closer than this coincide.
_FARTHEST = max(_H_BOND, STATED)
_PHOSPHATE_BREAK, _PHOSPHATE_TORN = 2.5, 10.0
"""Angstrom. O3' and P further apart than the first are not bonded (1.6). For consecutive numbers the second
limit applies, because a strand may be torn. Ends of two strands of a duplex are at least 15 apart."""
_PHOSPHATE = ("P", "OP1", "OP2", "OP3", "O1P", "O2P", "O3P")
_LARGEST = 2000
"""Maximum size of a molecule with parameters by element (memory is quadratic). The PDB has some hundreds."""
_SHOWN = 20
_DUMMY = ("DUM", "MMB")
"""Membrane markers of OPM (Lomize et al., Nucleic Acids Res. 40:D370, 2012), and beads of LightDock."""


def check_words(words: Iterable[str]) -> None:
    """Refuse a word that is neither a kind of molecule nor a possible residue name."""
    for word in words:
        if word not in KINDS and not re.fullmatch(r"[A-Z0-9+-]{1,5}", word):
            raise StructureError(
                Argument("keep"), f" {word!r} is not known; give {', '.join(KINDS)} or names of residues"
            )


def choose_hetero(draft: Draft) -> Changes:
    """Choose the hetero molecules of the structure, and count and report the omitted ones."""
    keep, chemistry, candidates = draft.reading.keep, draft.reading.chemistry, draft.hetero_residues
    check_words(keep)
    _refuse_unknown_names(draft, keep, "keep ")
    # The user may also define amino acids in a chain.
    of_chains = {member.raw_name or member.name for member in draft.members if member.is_unknown}
    _refuse_unknown_names(draft, [*{*chemistry.user_sources} - of_chains], "ligand ")
    # Find strands, and candidates near the protein.
    usable = [candidate for candidate in candidates if not _unusable_reason(candidate.member)]
    strands = {
        id(residue)
        for pair in pairwise(candidates) if _is_bonded(*(residue.member for residue in pair))
        for residue in pair
    }  # fmt: skip
    near = _near_protein(draft, usable, chemistry.moving, strands) if "near" in keep else set()
    chosen = []
    omitted: Counter[tuple[str, Reason | None]] = Counter()
    lost: list[Loss] = []
    # Select candidates by the words of ``keep``, and count the others.
    for candidate in candidates:
        words = {"all", candidate.kind, candidate.member.name, candidate.raw_name}
        words |= {"nucleic"} if id(candidate) in strands else set()
        is_given = candidate.raw_name in chemistry.moving
        # An input written by protochain lists its hetero molecules, which may have moved away.
        if id(candidate) in near or draft.lists(candidate.member):
            words.add("near")
        reason = _unusable_reason(candidate.member)
        if (is_given or words & {*keep}) and not reason:
            chosen.append(candidate)
            continue
        draft.omitted.append(candidate.member)
        if not reason and "near" in keep and candidate.kind != "water":
            reason = Reason.FAR
        if reason:
            lost += candidate.member.losses(candidate.member.atoms, reason)
        omitted[("waters" if candidate.kind == "water" else candidate.raw_name, reason)] += 1
    for (kind, _), count in omitted.items():
        yield Omission(kind, count)
    yield from _report_coincident([residue.member for residue in chosen])
    yield from report_unresolved([residue.member for residue in chosen])
    draft.parts += yield from _group(draft, chosen)
    if omitted:
        counts = tuple(Count(n, kind, reason or "") for (kind, reason), n in omitted.items())
        facts = {"counts": counts, "count": counts[0].n, "remedy": KEEP_ALL}
        has_others = any(count.kind != "waters" for count in counts)
        repair_kind = Kind.LEFT_OUT if has_others else Kind.WATERS_LEFT_OUT
        yield Repair(repair_kind, facts, tuple(lost))


def require_chain(draft: Draft) -> tuple[()]:
    """Refuse a file without protein and nucleic acids."""
    # A trace of single atoms is not a strand.
    if not any(not p.obstacle or (p.is_strand and len(p.members[0].atoms) > 1) for p in draft.parts):
        raise draft.error(*_no_chain_message(draft.hetero_residues))
    return ()


def _no_chain_message(candidates: Iterable[HeteroResidue]) -> tuple[object, ...]:
    """Return a message that lists the molecules of a file without a chain, and the remedy."""
    kinds = Counter("waters" if residue.kind == "water" else residue.raw_name for residue in candidates)
    counts = [
        plural(n, "water") if kind == "waters" else f"{plural(n, 'residue')} {kind}"
        for kind, n in kinds.items()
    ]
    listing = abridge(counts, 8)
    text = f"no protein found{listing and f', only {listing}'}; "
    if any(residue.kind == "nucleic" for residue in candidates):
        return text, "keep them by ", KEEP_ALL
    single = any(residue.raw_name in residues.STANDARD for residue in candidates)
    return text, "a chain has two amino acids or more" if single else "give a file with protein, DNA or RNA"


def report_unresolved(members: Sequence[Member]) -> Changes:
    """Report heavy atoms that the experiment did not resolve."""
    unseen = [sum(a.occ == 0.0 for a in member.heavy) for member in members]
    places = tuple(member.residue for member, n in zip(members, unseen, strict=True) if n)
    if places:
        yield Repair.of(Kind.UNRESOLVED, count=sum(unseen), residues=places)


def _report_coincident(members: Sequence[Member]) -> Changes:
    """Report molecules that coincide although their occupancies do not mark them as alternates."""
    ends = [(m, a) for m in members for a in m.heavy]
    near = KDTree([a.pos.tolist() for _, a in ends]).query_pairs(_OVERLAP) if ends else set()
    pairs = Counter((ends[i][0].residue, ends[j][0].residue) for i, j in sorted(near))
    for (first, second), number in pairs.items():
        if first != second and number > 1:
            yield Repair.of(Kind.COINCIDENT, residue=second, other=first)


def _refuse_unknown_names(draft: Draft, requested: Sequence[str], kind: str) -> None:
    """Refuse a residue name without any molecule, because it would have no effect."""
    candidates = draft.hetero_residues
    names = {name for candidate in candidates for name in (candidate.raw_name, candidate.member.name)}
    unknown = next((word for word in requested if word not in KINDS and word not in names), None)
    if unknown is not None:
        count = Counter("" if residue.kind == "water" else residue.raw_name for residue in candidates)
        present = [f"{n} {name}" if name else plural(n, "water") for name, n in count.most_common(_SHOWN)]
        remainder = f" and {plural(len(count) - _SHOWN, 'more kind')}" if len(count) > _SHOWN else ""
        raise draft.error(
            f"{kind}{unknown}: no molecule kept with the protein has this name; those there: "
            f"{', '.join(present) or 'none'}{remainder}"
        )


def _unusable_reason(member: Member) -> Reason | None:
    if member.name in _DUMMY:
        return Reason.DUMMY
    if not (member.heavy and all(atom.element.atomic_number for atom in member.atoms)):
        return Reason.ELEMENT
    return Reason.CHARGE if len(member.atoms) == 1 and not has_known_charge(member.atoms[0]) else None


def _near_protein(
    draft: Draft, candidates: Sequence[HeteroResidue], user_names: Container[str], strands: Container[int]
) -> set[int]:
    """Return ``id`` of candidates near the protein or user molecules, and of all connected to these."""
    # Without protein, use the nucleic acids.
    nucleic = [r.member for r in candidates if r.kind == "nucleic" or id(r) in strands]
    site = draft.members or nucleic
    site = [*site, *(r.member for r in candidates if r.raw_name in user_names)]
    protein = [a.pos.tolist() for member in site for a in member.heavy]
    non_water = [candidate for candidate in candidates if candidate.kind != "water"]
    if not non_water or not protein:
        return set()
    ends = [(k, a) for k, candidate in enumerate(non_water) for a in candidate.member.atoms]
    owner, x = np.array([k for k, _ in ends]), np.array([a.pos.tolist() for _, a in ends])
    distance, _ = KDTree(protein).query(x, distance_upper_bound=defaults.KEEP_WITHIN)
    group = components(_bonded_pairs(draft, [r.member for r in non_water], ends, owner, x), len(non_water))
    touching = np.unique(group[owner[np.isfinite(distance)]])
    return {id(candidate) for candidate, g in zip(non_water, group, strict=True) if g in touching}


_Ends = Sequence[tuple[int, gemmi.Atom]]
"""Atoms, each with the index of its molecule."""


def _bonded_pairs(draft: Draft, members: list[Member], ends: _Ends, owner: Integers, x: Floats) -> Integers:
    """Return pairs (n, 2) of bonded residues, of metals with their donors, and of paired nucleotides."""
    near = KDTree(x).query_pairs(_FARTHEST, output_type="ndarray")
    # Hydrogens are ignored: not all files have them, and hydrogen bonds are shorter than JOIN_CUTOFF.
    heavy = np.array([not atom.is_hydrogen() for _, atom in ends])
    near = near[(owner[near[:, 0]] != owner[near[:, 1]]) & heavy[near].all(axis=1)]
    length = np.linalg.norm(x[near[:, 0]] - x[near[:, 1]], axis=1)
    is_joined = length <= JOIN_CUTOFF
    stated = {frozenset(pair) for pair in draft.stated_bonds}
    metal = np.array([is_metal(atom.element.name) for _, atom in ends])
    address = [members[k].address(atom.name) for k, atom in ends] if stated or metal.any() else []
    for row in np.flatnonzero(~is_joined & (length <= STATED)).tolist() if address else ():
        i, j = near[row].tolist()
        is_stated = {address[i], address[j]} in stated
        if metal[i] != metal[j]:
            donor, ion = (i, j) if metal[j] else (j, i)
            (k, atom), (ion_owner, ion_atom) = ends[donor], ends[ion]
            is_joined[row] = Link(members[k], atom, members[ion_owner], ion_atom, is_stated).is_coordinated
        else:
            is_joined[row] = is_stated
    return np.vstack([owner[near[is_joined]], _base_pairs(members, ends, owner, x, near[length <= _H_BOND])])


def _base_pairs(members: list[Member], ends: _Ends, owner: Integers, x: Floats, near: Integers) -> Integers:
    """Return pairs (n, 2) of nucleotides with two or more hydrogen bonds in the plane of a base."""
    sugar = np.array([member.atom("C1'") is not None for member in members])
    in_base = np.array([sugar[k] and "'" not in a.name and a.name not in _PHOSPHATE for k, a in ends])
    polar = in_base & np.array([atom.element.name in ("N", "O") for _, atom in ends])
    bonds: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for i, j in near[polar[near].all(axis=1)].tolist():
        i, j = (i, j) if owner[i] < owner[j] else (j, i)
        base = x[in_base & (owner == owner[i])]
        normal = np.linalg.svd(base - base.mean(axis=0))[2][2]
        if abs(normal @ (x[j] - x[i])) <= _MAX_RISE:
            bonds.setdefault((int(owner[i]), int(owner[j])), []).append((i, j))
    pairs = [pair for pair, ij in bonds.items() if min(len({*end}) for end in zip(*ij, strict=True)) > 1]
    return np.array(pairs, dtype=np.int64).reshape(-1, 2)


def _group(draft: Draft, chosen: Sequence[HeteroResidue]) -> Generator[Repair | Omission, None, list[Part]]:
    """Group residues into molecules. Bonded nucleotides form a strand, others are single residues."""
    ff, chemistry = draft.templates, draft.reading.chemistry
    parts: list[Part] = []
    for candidate in chosen:
        member = candidate.member
        yield from candidate.notes
        if parts and _is_bonded(parts[-1].members[-1], member):
            parts[-1].members.append(member)
        else:
            parts.append(Part(member.chain_id, [member], Evidence.ELEMENTS))
    if parts:
        yield from glycans.select_glycans(draft, parts, ff.keys() | chemistry.moving, chemistry.has_glycam)
    for part in (p for p in parts if not p.glycam_code):
        yield from _trim(part)
    # Cut strands at nucleotides without parameters.
    pieces = list[Part]()
    for part in parts:
        pieces += yield from _split(part, ff, chemistry.has_sage)
    for part in pieces:
        first, all_atoms = part.members[0], [*part.members[0].atoms]
        if first.template is not None:
            continue
        if len(part.members) == 1 and part.is_strand and not first.links:
            first.atoms = [atom for atom in all_atoms if atom.name not in _PHOSPHATE]
        templates = [part.template(ff, i) for i in range(len(part.members))]
        fits = all(m.is_unknown or _fits(m, fit) for m, fit in zip(part.members, templates, strict=True))
        # Use the templates of the force field if all fit, or else parameters by element.
        if fits:
            is_users = len(templates) == 1 and templates[0] is not None and templates[0].is_users
            strand = Evidence.NUCLEOTIDES if part.is_strand else Evidence.BUNDLED_TEMPLATE
            part.evidence = Evidence.USERS_TEMPLATE if is_users else strand
        else:
            first.atoms = all_atoms
            for member in part.members:
                if len(member.atoms) > _LARGEST:
                    raise draft.error(
                        f"{member} has {len(member.atoms)} atoms, more than {_LARGEST}; "
                        "give each molecule in it a number of its own, or leave it out by keep"
                    )
                charge_cluster(member.name, member.atoms)
                member.source = member.source if member.is_unknown else template_by_element(member)
            if len(part.members) == 1:
                users = (t for t in ff.values() if t.is_users and t.name not in residues.STANDARD)
                is_ion = len(first.heavy) < 2 and not {a.element.name for a in first.heavy} & {"N", "O", "S"}
                seen = first.template
                if template := seen and find_template(first, seen, users):
                    first.source, part.evidence = template, Evidence.USERS_TEMPLATE
                elif not (is_ion or first.name in residues.NUCLEOTIDES):
                    part.evidence = Evidence.SMALL
        if fits and len(all_atoms) > len(first.atoms):
            lost = first.losses([atom for atom in all_atoms if atom not in first.atoms], Reason.PHOSPHATE)
            yield Repair.of(Kind.PHOSPHATE, lost, residue=first.residue)
    return pieces


def _trim(part: Part) -> Changes:
    """Remove the last nucleotides of a strand if only their phosphates are resolved."""
    ends = {*_PHOSPHATE, "O5'"}
    while len(part.members) > 1 and part.is_strand and {a.name for a in part.members[-1].atoms} <= ends:
        last = part.members.pop()
        lost = last.losses(last.atoms, Reason.BACKBONE)
        yield Repair.of(Kind.NO_BACKBONE, lost, residue=last.residue, atom="C1'")


def _split(part: Part, ff: Mapping[str, Template], has_sage: bool) -> Generator[Repair, None, list[Part]]:
    """Cut a strand at nucleotides without parameters, except modified ones, which are parametrised later."""
    if len(part.members) == 1:
        return [part]
    unmatched = [m for i, m in enumerate(part.members) if not _fits(m, part.template(ff, i))]
    for member in unmatched:
        if has_sage and member.name not in residues.NUCLEOTIDES:
            member.source = Unknown()
    return (yield from cut_strand(part, [member for member in unmatched if not member.is_unknown]))


def cut_strand(part: Part, fixed: Sequence[Member]) -> Generator[Repair, None, list[Part]]:
    """Cut a strand at nucleotides without parameters, which become fixed, and report them."""
    if not fixed:
        return [part]
    pieces: list[Part] = []
    for i, member in enumerate(part.members):
        moves, before = member not in fixed, part.members[i - 1]
        if not i or moves == (before in fixed):
            pieces.append(Part(part.chain_id, [], Evidence.NUCLEOTIDES if moves else Evidence.ELEMENTS))
            if i:
                # The strand continues next to the fixed nucleotide.
                one, name = (member, "P") if moves else (before, "O3'")
                one.links += [atom for atom in one.atoms if atom.name == name]
        pieces[-1].members.append(member)
    for member in fixed:
        member.source = template_by_element(member)
    yield Repair.of(Kind.NUCLEOTIDES_STAY, count=len(fixed), residues=tuple(m.residue for m in fixed))
    return pieces


def _is_bonded(last: Member, first: Member) -> bool:
    end, start = last.atom("O3'"), first.atom("P")
    of_strand = {last.name, first.name} <= {*residues.NUCLEOTIDES}
    follows = of_strand and last.chain_id == first.chain_id and int(first.number) == int(last.number) + 1
    farthest = _PHOSPHATE_TORN if follows else _PHOSPHATE_BREAK
    return bool(end and start and end.pos.dist(start.pos) < farthest)


def _fits(member: Member, template: Template | None) -> bool:
    """Return whether a template has exactly the heavy atoms of a residue that is not an amino acid."""
    if template is None or member.name in residues.STANDARD or member.name in residues.CAPS:
        return False
    heavy = {template.synonyms.get(a.name, a.name) for a in member.heavy}
    # The third oxygen of a 5' phosphate can be built.
    return heavy | {"OP3"} == {*template.heavy, "OP3"}


def report_hetero(draft: Draft) -> Changes:
    """Report the hetero molecules."""
    rows = [(part, m) for part in draft.parts if part.obstacle for m in part.members]
    if rows:
        counts = Counter("waters" if m.name == "HOH" else m.raw_name or m.name for _, m in rows).most_common()
        bare = {m.raw_name or m.name for part, m in rows if m.template and not part.mobile}
        facts = {"counts": tuple(Count(n, name) for name, n in counts), "bare": tuple(sorted(bare))}
        yield Repair(Kind.KEPT_BY_ELEMENT if bare else Kind.KEPT, facts)


def rename_water(member: Member, name: str) -> Member:
    """Rename a residue with a name of water to HOH, or to UNL if its atoms are not water."""
    if not gemmi.find_tabulated_residue(name).is_water():
        return member
    is_water = {a.element.name for a in member.heavy if a.element.atomic_number} <= {"O"}
    return replace(member, name="HOH" if is_water else "UNL")
