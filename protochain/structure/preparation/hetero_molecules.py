"""Molecules kept with the protein: ligands, cofactors, glycans, ions, nucleic acids, waters."""

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
from protochain.core.markup import counted, listed
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
    losses,
)

KINDS = ("none", "near", "all", "water", "ions", "nucleic", "ligands")
"""Words that choose molecules by kind; any other word is the name of a residue."""
JOIN_CUTOFF = 2.0
"""Angstrom: molecules with atoms nearer than this are parts of one, as the sugars of a glycan (1.4)."""
_PAIRED, _ABOVE = 3.4, 1.5
"""Angstrom: length of hydrogen bonds of paired bases, and their rise from the plane of a base; stacked bases
are 3.4 apart. (Lu, Bussemaker, Olson, Nucleic Acids Res. 43:e142, 2015, allow 4.0 and 2.5.)"""
_UPON = 0.5
"""Angstrom: atoms of two molecules nearer than this are in one place."""
_FARTHEST = max(_PAIRED, STATED)
_PHOSPHATE_BREAK, _PHOSPHATE_TORN = 2.5, 10.0
"""Angstrom: O3' and P further apart than this are not bonded (1.6), where numbers go on not than the second:
then the strand is torn. Ends of two strands of a duplex are 15 apart and more."""
_PHOSPHATE = ("P", "OP1", "OP2", "OP3", "O1P", "O2P", "O3P")
_LARGEST = 2000
"""Atoms of a molecule by element, none of which interact: memory grows with their square. The largest of the
archive have some hundreds."""
_NAMED = 20
_DUMMY = ("DUM", "MMB")
"""Marks of a membrane by OPM (Lomize et al., Nucleic Acids Res. 40:D370, 2012), and LightDock's beads."""


def check_words(words: Iterable[str]) -> None:
    """Refuse a word that is neither a kind of molecule nor can be the name of a residue."""
    for word in words:
        if word not in KINDS and not re.fullmatch(r"[A-Z0-9+-]{1,5}", word):
            raise StructureError(
                Argument("keep"), f" {word!r} is not known; give {', '.join(KINDS)} or names of residues"
            )


def choose_hetero(draft: Draft) -> Changes:
    """Choose the molecules to keep beside the protein; count and report the others."""
    keep, chemistry, candidates = draft.reading.keep, draft.reading.chemistry, draft.hetero_residues
    check_words(keep)
    _refuse_unknown_names(draft, candidates, keep, "keep ")
    # The chemistry of an amino acid in a chain may be given, too.
    of_chains = {member.raw_name or member.name for member in draft.members if member.is_unknown}
    _refuse_unknown_names(draft, candidates, [*{*chemistry.user_sources} - of_chains], "ligand ")
    usable = [candidate for candidate in candidates if not _why_unusable(candidate.member)]
    strands = {
        id(each)
        for pair in pairwise(candidates) if _is_bonded(*(each.member for each in pair))
        for each in pair
    }  # fmt: skip
    near = _near(draft, usable, chemistry.moving, strands) if "near" in keep else set()
    chosen = []
    gone: Counter[tuple[str, Reason | None]] = Counter()
    lost: list[Loss] = []
    for candidate in candidates:
        words = {"all", candidate.kind, candidate.member.name, candidate.raw_name}
        words |= {"nucleic"} if id(candidate) in strands else set()
        is_given = candidate.raw_name in chemistry.moving
        # A result names what it kept, which may have come further away.
        if id(candidate) in near or draft.lists(candidate.member):
            words.add("near")
        why = _why_unusable(candidate.member)
        if (is_given or words & {*keep}) and not why:
            chosen.append(candidate)
            continue
        draft.omitted.append(candidate.member)
        if not why and "near" in keep and candidate.kind != "water":
            why = Reason.FAR
        if why:
            lost += losses(candidate.member, candidate.member.atoms, why)
        gone[("waters" if candidate.kind == "water" else candidate.raw_name, why)] += 1
    for (kind, _), count in gone.items():
        yield Omission(kind, count)
    yield from _report_coincident([each.member for each in chosen])
    yield from report_unresolved([each.member for each in chosen])
    draft.parts += yield from _group(draft, chosen)
    if gone:
        counts = tuple(Count(n, kind, why or "") for (kind, why), n in gone.items())
        facts = {"counts": counts, "count": counts[0].n, "remedy": KEEP_ALL}
        dry = any(count.kind != "waters" for count in counts)
        left = Kind.LEFT_OUT if dry else Kind.WATERS_LEFT_OUT
        yield Repair(left, facts, tuple(lost))


def require_chain(draft: Draft) -> tuple[()]:
    """Refuse a file without protein and nucleic acids."""
    # A trace of single atoms is no strand.
    if not any(not p.obstacle or (p.is_strand and len(p.members[0].atoms) > 1) for p in draft.parts):
        raise StructureError(f"{draft.source}: ", *_about_rest(draft.hetero_residues))
    return ()


def _about_rest(beside: Iterable[HeteroResidue]) -> tuple[object, ...]:
    """What there is where there is no chain to work with, and what to do."""
    kinds = Counter("waters" if each.kind == "water" else each.raw_name for each in beside)
    each = [
        counted(n, "water") if kind == "waters" else f"{counted(n, 'residue')} {kind}"
        for kind, n in kinds.items()
    ]
    found = listed(each, 8)
    what = f"no protein found{found and f', only {found}'}; "
    if any(each.kind == "nucleic" for each in beside):
        return what, "keep them by ", KEEP_ALL
    single = any(each.raw_name in residues.STANDARD for each in beside)
    return what, "a chain has two amino acids or more" if single else "give a file with protein, DNA or RNA"


def report_unresolved(members: Sequence[Member]) -> Changes:
    """Report heavy atoms that the experiment did not resolve."""
    unseen = [sum(a.occ == 0.0 for a in member.heavy) for member in members]
    places = tuple(member.residue for member, n in zip(members, unseen, strict=True) if n)
    if places:
        yield Repair.of(Kind.UNRESOLVED, count=sum(unseen), residues=places)


def _report_coincident(members: Sequence[Member]) -> Changes:
    """Report molecules that lie upon one another and are no alternates by their occupancies."""
    ends = [(m, a) for m in members for a in m.heavy]
    near = KDTree([a.pos.tolist() for _, a in ends]).query_pairs(_UPON) if ends else set()
    pairs = Counter((ends[i][0].residue, ends[j][0].residue) for i, j in sorted(near))
    for (first, second), number in pairs.items():
        if first != second and number > 1:
            yield Repair.of(Kind.COINCIDENT, residue=second, other=first)


def _refuse_unknown_names(
    draft: Draft, candidates: Sequence[HeteroResidue], asked: Sequence[str], why: str
) -> None:
    """Refuse the name of a residue that no molecule has: it would keep, or tell, nothing."""
    names = {name for candidate in candidates for name in (candidate.raw_name, candidate.member.name)}
    unknown = next((word for word in asked if word not in KINDS and word not in names), None)
    if unknown is not None:
        count = Counter("" if each.kind == "water" else each.raw_name for each in candidates)
        there = [f"{n} {name}" if name else counted(n, "water") for name, n in count.most_common(_NAMED)]
        more = f" and {counted(len(count) - _NAMED, 'more kind')}" if len(count) > _NAMED else ""
        raise StructureError(
            f"{draft.source}: {why}{unknown}: no molecule kept with the protein has this name; those there: "
            f"{', '.join(there) or 'none'}{more}"
        )


def _why_unusable(member: Member) -> Reason | None:
    if member.name in _DUMMY:
        return Reason.DUMMY
    if not all(atom.element.atomic_number for atom in member.atoms) or all(
        atom.is_hydrogen() for atom in member.atoms
    ):
        return Reason.ELEMENT
    return Reason.CHARGE if len(member.atoms) == 1 and not has_known_charge(member.atoms[0]) else None


def _near(
    draft: Draft, candidates: Sequence[HeteroResidue], given: Container[str], strands: Container[int]
) -> set[int]:
    """``id`` of the candidates with an atom near the protein, and of all that is joined to one that has.

    Molecules that the user gives, poses among them, count as the protein does: their site is kept whole.
    """
    # Of a file without protein, its nucleic acids.
    nucleic = [each.member for each in candidates if each.kind == "nucleic" or id(each) in strands]
    whole = draft.members or nucleic
    whole = [*whole, *(each.member for each in candidates if each.raw_name in given)]
    protein = [a.pos.tolist() for member in whole for a in member.heavy]
    dry = [candidate for candidate in candidates if candidate.kind != "water"]
    if not dry or not protein:
        return set()
    ends = [(k, a) for k, candidate in enumerate(dry) for a in candidate.member.atoms]
    owner, x = np.array([k for k, _ in ends]), np.array([a.pos.tolist() for _, a in ends])
    distance, _ = KDTree(protein).query(x, distance_upper_bound=defaults.KEEP_WITHIN)
    group = components(_joined(draft, [each.member for each in dry], ends, owner, x), len(dry))
    touching = np.unique(group[owner[np.isfinite(distance)]])
    return {id(candidate) for candidate, its in zip(dry, group, strict=True) if its in touching}


def _joined(
    draft: Draft,
    members: Sequence[Member],
    ends: Sequence[tuple[int, gemmi.Atom]],
    owner: Integers,
    x: Floats,
) -> Integers:
    """Pairs (n, 2) of residues: bonded ones, a metal and what holds it, and nucleotides with paired bases."""
    near = KDTree(x).query_pairs(_FARTHEST, output_type="ndarray")
    # Hydrogens, which a file may have or not, decide nothing: those of hydrogen bonds are nearer than JOINED.
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
            (k, atom), (other, its) = ends[donor], ends[ion]
            is_joined[row] = Link(members[k], atom, members[other], its, is_stated).is_coordinated
        else:
            is_joined[row] = is_stated
    return np.vstack([owner[near[is_joined]], _paired(members, ends, owner, x, near[length <= _PAIRED])])


def _paired(
    members: Sequence[Member],
    ends: Sequence[tuple[int, gemmi.Atom]],
    owner: Integers,
    x: Floats,
    near: Integers,
) -> Integers:
    """Pairs (n, 2) of nucleotides two of whose base atoms are at hydrogen bonds in the plane of a base."""
    sugar = np.array([member.atom("C1'") is not None for member in members])
    in_base = np.array([sugar[k] and "'" not in a.name and a.name not in _PHOSPHATE for k, a in ends])
    polar = in_base & np.array([atom.element.name in ("N", "O") for _, atom in ends])
    bonds: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for i, j in near[polar[near].all(axis=1)].tolist():
        i, j = (i, j) if owner[i] < owner[j] else (j, i)
        base = x[in_base & (owner == owner[i])]
        normal = np.linalg.svd(base - base.mean(axis=0))[2][2]
        if abs(normal @ (x[j] - x[i])) <= _ABOVE:
            bonds.setdefault((int(owner[i]), int(owner[j])), []).append((i, j))
    found = [pair for pair, its in bonds.items() if min(len({*end}) for end in zip(*its, strict=True)) > 1]
    return np.array(found, dtype=np.int64).reshape(-1, 2)


def _group(draft: Draft, chosen: Sequence[HeteroResidue]) -> Generator[Repair | Omission, None, list[Part]]:
    """Group residues into molecules: bonded nucleotides form a strand, all others stand alone."""
    known, chemistry = draft.templates, draft.reading.chemistry
    parts: list[Part] = []
    for candidate in chosen:
        member = candidate.member
        yield from candidate.notes
        if parts and _is_bonded(parts[-1].members[-1], member):
            parts[-1].members.append(member)
        else:
            parts.append(Part(member.chain_id, [member], Evidence.ELEMENTS))
    if parts:
        yield from glycans.select_glycans(draft, parts, known.keys() | chemistry.moving, chemistry.has_glycam)
    for part in (each for each in parts if not each.glycam_code):
        yield from _trim(part)
    pieces = list[Part]()
    for part in parts:
        pieces += yield from _pieces(part, known, chemistry.has_sage)
    for part in pieces:
        first, whole = part.members[0], [*part.members[0].atoms]
        if first.template is not None:
            continue
        if len(part.members) == 1 and part.is_strand and not first.links:
            first.atoms = [atom for atom in whole if atom.name not in _PHOSPHATE]
        found = [part.template(known, i) for i in range(len(part.members))]
        fits = all(m.is_unknown or _fits(m, its) for m, its in zip(part.members, found, strict=True))
        if fits:
            is_users = len(found) == 1 and found[0] is not None and found[0].is_users
            strand = Evidence.NUCLEOTIDES if part.is_strand else Evidence.BUNDLED_TEMPLATE
            part.evidence = Evidence.USERS_TEMPLATE if is_users else strand
        else:
            first.atoms = whole
            for member in part.members:
                if len(member.atoms) > _LARGEST:
                    raise StructureError(
                        f"{draft.source}: {member} has {len(member.atoms)} atoms, more than {_LARGEST}; "
                        "give each molecule in it a number of its own, or leave it out by keep"
                    )
                charge_cluster(member.name, member.atoms)
                member.source = member.source if member.is_unknown else template_by_element(member)
            if len(part.members) == 1:
                users = (t for t in known.values() if t.is_users and t.name not in residues.STANDARD)
                is_ion = len(first.heavy) < 2 and not {a.element.name for a in first.heavy} & {"N", "O", "S"}
                seen = first.template
                if template := seen and find_template(first, seen, users):
                    first.source, part.evidence = template, Evidence.USERS_TEMPLATE
                elif not (is_ion or first.name in residues.NUCLEOTIDES):
                    part.evidence = Evidence.SMALL
        if fits and len(whole) > len(first.atoms):
            lost = losses(first, [atom for atom in whole if atom not in first.atoms], Reason.PHOSPHATE)
            yield Repair.of(Kind.PHOSPHATE, lost, residue=first.residue)
    return pieces


def _trim(part: Part) -> Changes:
    """Leave out the end of a strand of which only the phosphate was seen."""
    while (
        len(part.members) > 1
        and part.is_strand
        and all(atom.name in (*_PHOSPHATE, "O5'") for atom in part.members[-1].atoms)
    ):
        last = part.members.pop()
        lost = losses(last, last.atoms, Reason.BACKBONE)
        yield Repair.of(Kind.NO_BACKBONE, lost, residue=last.residue, atom="C1'")


def _pieces(part: Part, known: Mapping[str, Template], has_sage: bool) -> Generator[Repair, None, list[Part]]:
    """Cut a strand at the nucleotides without parameters; modified ones are to get their own."""
    if len(part.members) == 1:
        return [part]
    strange = [m for i, m in enumerate(part.members) if not _fits(m, part.template(known, i))]
    for member in strange:
        if has_sage and member.name not in residues.NUCLEOTIDES:
            member.source = Unknown()
    return (yield from cut(part, [member for member in strange if not member.is_unknown]))


def cut(part: Part, strange: Sequence[Member]) -> Generator[Repair, None, list[Part]]:
    """Cut a strand at nucleotides without parameters, which stay in place, and report it."""
    if not strange:
        return [part]
    pieces: list[Part] = []
    for i, member in enumerate(part.members):
        moves, before = member not in strange, part.members[i - 1]
        if not i or moves == (before in strange):
            pieces.append(Part(part.chain_id, [], Evidence.NUCLEOTIDES if moves else Evidence.ELEMENTS))
            if i:
                # Beside it, the strand goes on.
                one, name = (member, "P") if moves else (before, "O3'")
                one.links += [atom for atom in one.atoms if atom.name == name]
        pieces[-1].members.append(member)
    for member in strange:
        member.source = template_by_element(member)
    yield Repair.of(
        Kind.NUCLEOTIDES_STAY, count=len(strange), residues=tuple(each.residue for each in strange)
    )
    return pieces


def _is_bonded(last: Member, first: Member) -> bool:
    end, start = last.atom("O3'"), first.atom("P")
    of_strand = {last.name, first.name} <= {*residues.NUCLEOTIDES}
    follows = of_strand and last.chain_id == first.chain_id and int(first.number) == int(last.number) + 1
    farthest = _PHOSPHATE_TORN if follows else _PHOSPHATE_BREAK
    return bool(end and start and end.pos.dist(start.pos) < farthest)


def _fits(member: Member, template: Template | None) -> bool:
    """Whether a template has exactly the heavy atoms of a residue, which is no amino acid."""
    if template is None or member.name in residues.STANDARD or member.name in residues.CAPS:
        return False
    heavy = {template.synonyms.get(a.name, a.name) for a in member.heavy}
    # The third oxygen of a 5' phosphate can be built.
    return heavy | {"OP3"} == {*template.heavy, "OP3"}


def report_hetero(draft: Draft) -> Changes:
    """Report the molecules that are kept."""
    its = [(part, m) for part in draft.parts if part.obstacle for m in part.members]
    if its:
        counts = Counter("waters" if m.name == "HOH" else m.raw_name or m.name for _, m in its).most_common()
        bare = {m.raw_name or m.name for part, m in its if m.template and not part.mobile}
        facts = {"counts": tuple(Count(n, name) for name, n in counts), "bare": tuple(sorted(bare))}
        yield Repair(Kind.KEPT_BY_ELEMENT if bare else Kind.KEPT, facts)


def rename_water(member: Member, given: str) -> Member:
    """Return a residue that is water in the tables under the name of water, or as unknown by its atoms."""
    if not gemmi.find_tabulated_residue(given).is_water():
        return member
    is_water = {a.element.name for a in member.heavy if a.element.atomic_number} <= {"O"}
    return replace(member, name="HOH" if is_water else "UNL")
