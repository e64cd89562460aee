"""Read the molecules of a structure file: one model, one conformation, chains split at their breaks.

gemmi parses the file. Whatever is left out or changed is reported in ``repairs``; whatever cannot be used
raises an error of one line.
"""

import sys
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import gemmi
import numpy as np
from scipy.spatial import KDTree

from protochain.core.checks import check_fields, flag, integer, optional, text, words
from protochain.core.errors import Argument, OnlyAlphaError, StructureError
from protochain.core.markup import counted, listed
from protochain.ligands.tables import of_header
from protochain.structure.formats.apart import refuse_crowds
from protochain.structure.formats.files import STANDARD_INPUT, in_file_order, parse, place_in_file, split_name
from protochain.structure.formats.tie_records import springs
from protochain.structure.molecule import residues
from protochain.structure.molecule.chirality import WELL_FORMED, handedness
from protochain.structure.molecule.header import take_header
from protochain.structure.molecule.member import Address, Member, address_of
from protochain.structure.molecule.repairs import EVERYTHING, Kind, Repair, Why
from protochain.structure.molecule.templates import (
    archive_parent,
    named,
    rename,
    standard_name,
    template_name,
    templates,
)
from protochain.structure.preparation import fragments, parents
from protochain.structure.preparation.backbone import complete_backbone
from protochain.structure.preparation.bound import AS_KNOWN, Chemist, Chemistry, with_pose
from protochain.structure.preparation.choose import assemble, choose_chains, choose_model
from protochain.structure.preparation.conformation import (
    Conformation,
    agreed,
    check_altloc,
    likeliest,
    same_place,
    with_elements_of_names,
    without_deuterium,
    without_nan,
)
from protochain.structure.preparation.draft import Draft, Part, losses
from protochain.structure.preparation.kept import Candidate, choose, note_unresolved, report, water_named
from protochain.structure.preparation.periodic import make_whole
from protochain.structure.preparation.pseudo_atoms import remove_pseudo_atoms
from protochain.structure.preparation.sites import find_links

PEPTIDE_BREAK = 2.0
"""Angstrom: C and N further apart than this are not bonded (a peptide bond is 1.33)."""
PEPTIDE_TORN = 3.0
"""Angstrom: C and N of consecutive numbers are bonded up to here, as in models whose bonds are off. Atoms of
two chain ends do not come that near: C and N that are not bonded touch at 3.25."""
_UPON, _BESIDE, _FAR = 0.01, 2.0, 15.0
"""Angstrom: atoms nearer than the first are in one place, those that are bonded nearer than the second; the
last from the middle of a residue is twice what an extended arginine has."""
SMALLEST_RING = 2
"""Fewest residues of a head-to-tail cyclic peptide."""
_BONDS = (gemmi.ConnectionType.Disulf, gemmi.ConnectionType.Covale, gemmi.ConnectionType.MetalC)


@dataclass(frozen=True)
class Reading:
    """Options for reading a file."""

    model: int | None = None  # Number of the model in the file; the first by default.
    # Preferred alternate location, which some atom must have; by default, and where it is absent, the one of
    # highest occupancy.
    altloc: str = ""
    # Molecules kept as fixed obstacles, as in :func:`protochain.load`; none by default.
    keep: tuple[str, ...] = ()
    strict: bool = False  # Refuse chain breaks and residues that would be left out of a chain.
    # Force-field files whose residues are recognised besides the bundled ones.
    forcefield: tuple[Path, ...] = ()
    chains: tuple[str, ...] = ()  # Names of the chains to take; all by default.
    chemistry: Chemistry = AS_KNOWN  # Of ligands.
    # Convert modified residues to their standard parents, also those that have parameters.
    standard_residues: bool = False
    assembly: str = ""  # Name of the biological assembly to build; none by default.

    def __post_init__(self) -> None:
        check_fields(
            self, model=optional(integer), altloc=text, keep=words, strict=flag, chains=words,
            standard_residues=flag, assembly=text,
        )  # fmt: skip


def read(path: str | Path, reading: Reading | None = None) -> Draft:
    """Read the molecules of one model of a PDB or mmCIF file."""
    path = Path(path)
    structure, overlooked, ends, records = parse(path)
    name = "stdin" if path == STANDARD_INPUT else split_name(path)[0]
    source = "standard input" if path == STANDARD_INPUT else str(path)
    draft = Draft(name, source, repairs=overlooked, springs=springs(records), header=records)
    draft = read_structure(structure, draft, reading or Reading())
    chains = [part for part in draft.parts if not part.obstacle] or draft.parts
    last = chains[-1].members[-1]
    if not ends and not last.atom("OXT"):
        draft.note(Kind.NO_END, residue=last.residue)
    return draft


def read_structure(structure: gemmi.Structure, draft: Draft, reading: Reading) -> Draft:
    """Fill a draft from a gemmi structure."""
    if reading.assembly:
        assemble(draft, structure, reading.assembly)
    draft.header = take_header(structure, draft.header)
    model = choose_model(draft, structure, reading.model)
    draft.filed = tuple(name for name, _ in in_file_order(model))
    check_altloc(model, reading.altloc, draft.source)
    remove_pseudo_atoms(draft, model)
    make_whole(draft, structure, model)
    if atoms := without_nan(model):
        draft.note(Kind.NOT_A_NUMBER, count=atoms)
    if atoms := without_deuterium(model):
        draft.note(Kind.DEUTERIUM, count=atoms)
    if corrected := with_elements_of_names(model):
        draft.note(Kind.ELEMENTS, count=len(corrected), atom=corrected[0])
    images: list[residues.Atom] = []
    for bond in (each for each in structure.connections if each.type in _BONDS):
        ends = address_of(bond.partner1), address_of(bond.partner2)
        # That of an atom on an axis is to its own image, whatever the file says.
        if bond.asu == gemmi.Asu.Different or ends[0] == ends[1]:
            residue = residues.Residue(*ends[0][:2], bond.partner1.res_id.name)
            images.append(residues.Atom(ends[0][2], residue))
        else:
            draft.stated.append(ends)
    if images:
        draft.note(Kind.IMAGES, count=len(images), atoms=tuple(dict.fromkeys(images)))
    draft.stated += _of_serials(structure, model)
    beside: list[Candidate] = []
    chains = choose_chains(draft, model, reading.chains)
    places = [(chain.name, group) for chain in chains for group in same_place(chain)]
    letters, gives_way = agreed([group for _, group in places], reading.altloc)
    of_chain: dict[str, list[tuple[list[gemmi.Residue], str]]] = {chain.name: [] for chain in chains}
    for k, (name, group) in enumerate(places):
        if k not in gives_way:
            of_chain[name].append((group, letters[k]))
            continue
        draft.left_out["alternate locations"] += 1
        its, other = (_in_file(places[each][0], places[each][1][0]) for each in (k, gives_way[k]))
        if not group[0].is_water():
            draft.note(Kind.EXCLUDED, residue=its, other=other, occupancy=group[0][0].occ)
    reader = _Reader(draft, reading, beside)
    for name, mine in of_chain.items():
        reader.take(name, mine)
    reader.join()
    draft.left_out = Counter({kind: count for kind, count in draft.left_out.items() if count})
    # As in a file written of it, where chains are whole: protein chains come first.
    order = list(dict.fromkeys(part.chain_id for part in draft.parts))
    order += [chain.name for chain in model if chain.name not in order]
    beside.sort(key=lambda each: order.index(each.member.chain_id))
    chemistry = reading.chemistry
    for path in chemistry.poses:
        used = {(each.chain_id, each.number) for each in (*draft.members, *(b.member for b in beside))}
        names = {*chemistry.moving, *(each.given for each in beside)}
        chemistry, member = with_pose(chemistry, path, {chain for chain, _ in used}, names)
        beside.append(Candidate(member, member.name))
    there = [*draft.members, *(each.member for each in beside)]
    refuse_crowds([atom for member in there for atom in member.atoms], draft.source)
    known = templates(reading.forcefield)
    draft.parts += choose(draft, beside, reading.keep, known, chemistry)
    # A trace of single atoms is no strand.
    usable = [p for p in draft.parts if not p.obstacle or (p.is_strand and len(p.members[0].atoms) > 1)]
    if not usable:
        raise StructureError(f"{draft.source}: ", *_nothing_told(beside))
    chemist = Chemist(draft, chemistry, known)
    draft.links = find_links(draft, partial(fragments.settle, draft, chemist))
    for part in draft.parts:
        if part.is_small:
            chemist.settle(part)
    report(draft)
    draft.parts.sort(key=_place)
    return draft


def _place(part: Part) -> int:
    """Where a part begins in the file; behind all of it, if it comes from elsewhere."""
    places = (place for m in part.members for a in m.atoms if (place := place_in_file(a)) >= 0)
    return min(places, default=sys.maxsize)


def _nothing_told(beside: Iterable[Candidate]) -> tuple[object, ...]:
    """What there is where there is no chain to work with, and what to do."""
    kinds = Counter("waters" if each.kind == "water" else each.given for each in beside)
    each = [
        counted(n, "water") if kind == "waters" else f"{counted(n, 'residue')} {kind}"
        for kind, n in kinds.items()
    ]
    found = listed(each, 8)
    what = f"no protein found{found and f', only {found}'}; "
    if any(each.kind == "nucleic" for each in beside):
        return what, "keep them by ", EVERYTHING
    single = any(each.given in residues.STANDARD for each in beside)
    return what, "a chain has two amino acids or more" if single else "give a file with protein, DNA or RNA"


def model_numbers(path: str | Path) -> list[int]:
    """List the numbers of the models in a file."""
    return [model.num for model in parse(Path(path))[0]]


def _in_file(chain: str, residue: gemmi.Residue) -> residues.Residue:
    return residues.Residue(chain, str(residue.seqid).strip(), residue.name)


def _of_serials(structure: gemmi.Structure, model: gemmi.Model) -> list[tuple[Address, Address]]:
    """Bonds between residues that CONECT records state, by serial numbers."""
    bonds = {frozenset((a, b)) for a, partners in structure.conect_map.items() for b in partners if a != b}
    wanted = {serial for bond in bonds for serial in bond}
    places = [place for place in model.all() if place.atom.serial in wanted] if wanted else []
    count = Counter(place.atom.serial for place in places)
    at = {
        place.atom.serial: (place.chain.name.strip(), str(place.residue.seqid).strip(), place.atom.name)
        for place in places
        # Of files with more atoms than numbers nothing can be said.
        if count[place.atom.serial] == 1
    }
    pairs = [sorted(bond) for bond in bonds if bond <= at.keys()]
    return [(at[a], at[b]) for a, b in sorted(pairs) if at[a][:2] != at[b][:2]]


class _Reader:
    """Reader of chains, which adds their parts and repairs to the draft."""

    def __init__(self, draft: Draft, reading: Reading, beside: list[Candidate]) -> None:
        self.draft, self.reading, self.beside, self.chain_id = draft, reading, beside, ""
        self.known = templates(reading.forcefield)
        self.own = of_header(draft.header) | reading.chemistry.moving
        self.runs: list[list[Member]] = []
        self.unknown: set[int] = set()

    def take(self, chain_id: str, places: Iterable[tuple[list[gemmi.Residue], str]]) -> None:
        """Take the protein of a chain, in pieces without a break, and the molecules outside it."""
        self.chain_id = chain_id
        run: list[Member] = []
        for group, letter in places:
            found = likeliest(group, letter)
            self.notes: list[Repair] = []
            if self._is_protein(found.residue):
                self.draft.repairs += self._alternates(found)
                if found.others:
                    self.draft.left_out["alternate locations"] += len(found.others)
                elif found.repeated:
                    self.draft.left_out["repeated atoms"] += len(found.repeated)
            else:
                self.notes = self._alternates(found)
            member = self._member(found.residue)
            if member is not None:
                run.append(member)
        built = [
            complete_backbone(run, i) if member.name in residues.STANDARD else ()
            for i, member in enumerate(run)
        ]
        bare = [[atom.name for atom in member.atoms] == ["CA"] for member in run if not member.is_cap]
        if bare and all(bare):
            raise OnlyAlphaError(
                f"{self.draft.source}: chain {self._chain} holds only C-alpha atoms; "
                "rebuild the others first, by PULCHRA or cg2all"
            )
        run = [member for member, name in zip(run, built, strict=True) if self._has_backbone(member, name)]
        note_unresolved(self.draft, run)
        self.runs += self._unbroken(run)

    @property
    def _chain(self) -> str:
        return self.chain_id or "(blank)"

    def _alternates(self, found: Conformation) -> list[Repair]:
        """Describe the choice among the alternate locations of a residue."""
        facts: dict[str, Any] = {"residue": _in_file(self.chain_id, found.residue)}
        if found.others:
            facts |= {"used": found.altloc, "occupancy": found.occupancy, "others": tuple(found.others)}
            return [Repair(Kind.ALTERNATES, facts)]
        if found.repeated:
            return [Repair(Kind.REPEATED, facts | {"atoms": tuple(found.repeated)})]
        return []

    def _is_protein(self, residue: gemmi.Residue) -> bool:
        name, _ = named(residue.name.strip().upper(), [*residue], self.known, self.own)
        return name in residues.CAPS or name in residues.STANDARD or bool(archive_parent(name))

    def _member(self, residue: gemmi.Residue) -> Member | None:
        """Return a residue of the protein under its standard name, or None for another molecule."""
        given = residue.name.strip().upper()
        name, state = named(given, [*residue], self.known, self.own)
        if name in residues.STANDARD or name in residues.CAPS:
            for atom in residue:
                atom.element = _element(atom)
        atoms = [*residue]
        if name in residues.STANDARD and (nowhere := _nowhere(atoms)):
            atoms = [atom for atom in atoms if atom not in nowhere]
            names = tuple(atom.name for atom in nowhere)
            self.draft.note(Kind.NO_PLACE, residue=_in_file(self.chain_id, residue), atoms=names)
        if name in residues.NUCLEOTIDES:
            rename(atoms, self.known[name])
        backbone = {*residues.BACKBONE} <= {atom.name for atom in atoms}
        for atom in atoms if backbone else ():
            # Without columns of elements gemmi knows none for 1HB of a modified residue.
            atom.element = atom.element if atom.element.atomic_number else _element(atom)
        member = Member(
            name, str(residue.seqid.num), residue.seqid.icode.strip(), self.chain_id, atoms, state,
            is_d=gemmi.find_tabulated_residue(name).kind == gemmi.ResidueKind.AAD,
            label=(residue.subchain, residue.label_seq), given=given,
        )  # fmt: skip
        by_atoms = name in residues.STANDARD and standard_name(given)[0] != name
        member.is_d = member.is_d or (by_atoms and handedness(member) < 0)
        if state or by_atoms or (name in residues.STANDARD and given[-3:] in residues.LINKED):
            kind = Kind.STATE_NAMED if state else Kind.RENAMED
            self.draft.note(kind, residue=_in_file(self.chain_id, residue), name=name, state=state)
        if name in residues.STANDARD or name in residues.CAPS:
            if member.is_cap:
                rename(member.atoms, self.known[template_name(name)])
            return member
        # DGN: D-glutamine in the archive, a nucleoside in Amber's files. HIP with a phosphate is not Amber's.
        template = self.known.get(name) if name not in residues.STATE_PARENT else None
        if backbone and template and {*residues.BACKBONE} <= template.element.keys():
            return member
        if backbone:
            # One without a parent may be a ligand, if it stands alone.
            member.odd, member.parent = True, archive_parent(name)
            self.unknown |= set() if member.parent else {id(member)}
            return member
        self.beside.append(Candidate(water_named(member, given), given, self.notes))
        return None

    def _why_converted(self, part: Part, i: int) -> Why | None:
        """Why a modified residue of a chain becomes its standard parent, if it does."""
        member = part.members[i]
        if member.parent:
            if self.reading.standard_residues:
                return Why.ASKED
            there = {atom.name for atom in member.heavy} - {"OXT"}
            member.is_d = member.is_d or handedness(member, least=WELL_FORMED) < 0
            is_mirrored = member.is_d and there == {*self.known[parents.fullest(member.parent)].heavy}
            return Why.PARENT if member.name == "MSE" or is_mirrored else None
        if member.name not in residues.PHOSPHORYLATED:
            return None
        if self.reading.standard_residues:
            return Why.ASKED
        template = part.template(self.known, i)
        if template is None:
            return Why.END
        there = {template.synonyms.get(atom.name, atom.name) for atom in member.heavy}
        return None if there - {"OXT"} == {*template.heavy} else Why.INCOMPLETE

    def _has_backbone(self, member: Member, built: tuple[str, ...]) -> bool:
        """Whether a residue has N, CA and C, some of which may have been built."""
        missing = [name for name in residues.BACKBONE if name in built or not member.atom(name)]
        if member.is_cap or not missing:
            return True
        if self.reading.strict:
            raise StructureError(
                f"{self.draft.source}: {member}: atom {missing[0]} missing; "
                "rebuild the backbone or remove the residue"
            )
        if built:
            self.draft.note(Kind.ATOMS_ADDED, residue=member.residue, atoms=built)
            return True
        lost = losses(member, member.atoms, Why.BACKBONE)
        self.draft.note(Kind.NO_BACKBONE, lost, residue=member.residue, atom=missing[0])
        self.draft.left_out["incomplete residues"] += 1
        return False

    def _unbroken(self, run: list[Member]) -> list[list[Member]]:
        """Pieces of a chain whose residues are bonded one after the other."""
        pieces: list[list[Member]] = []
        for member in run:
            gap = _gap(pieces[-1][-1], member) if pieces else np.inf
            if gap >= PEPTIDE_BREAK and not (pieces and _is_torn(pieces[-1][-1], member, gap)):
                pieces.append([])
            elif gap >= PEPTIDE_BREAK:
                self.draft.note(Kind.TORN, last=pieces[-1][-1].residue, first=member.residue, length=gap)
            pieces[-1].append(member)
        return pieces

    def join(self) -> None:
        """Add the chains: pieces whose ends are bonded are one, whatever their ids, numbers or order."""
        following, before = _bonded_ends(self.draft, self.runs)
        for i, (run, after) in enumerate(pairwise(self.runs)):
            is_one = run[-1].chain_id == after[0].chain_id and len(run) + len(after) > 2
            if is_one and i not in following and i + 1 not in before:
                self._break(run[-1], after[0], _gap(run[-1], after[0]))
        heads = [i for i in range(len(self.runs)) if i not in before]
        done: set[int] = set()
        # What is left after all that begin somewhere is in rings.
        for head in (*heads, *range(len(self.runs))):
            part: list[Member] = []
            at: int | None = head
            while at is not None and at not in done:
                done.add(at)
                part += self.runs[at]
                at = following.get(at)
            for last, first in pairwise(part):
                if last.chain_id != first.chain_id:
                    self.draft.note(Kind.CHAIN_GOES_ON, last=last.residue, first=first.residue)
            if part:
                self._add(part)

    def _break(self, last: Member, first: Member, gap: float) -> None:
        """Report a chain break, unless the file has termini there."""
        if last.atom("OXT") or last.is_cap or first.is_cap or {id(last), id(first)} & self.unknown:
            return
        if self.reading.strict:
            raise StructureError(
                f"{self.draft.source}: chain {last.residue.chain_name} is broken between {last.seqid} and "
                f"{first.seqid} ({gap:.1f} angstrom); model the missing residues, or leave out ",
                Argument("strict", True),
            )
        self.draft.note(Kind.GAP, last=last.residue, first=first.residue, length=gap)

    def _add(self, part: list[Member]) -> None:
        """Add an unbroken chain, or leave out a single residue."""
        part = [
            member
            for i, member in enumerate(part)
            if not member.is_cap or self._is_in_place(member, i, len(part))
        ]
        if len(part) == 1:
            if id(part[0]) not in self.unknown:
                self.draft.note(Kind.ALONE, residue=part[0].residue)
            part[0].odd = False
            self.beside.append(Candidate(part[0], part[0].name))
        elif part:
            made = Part(part[0].chain_id, part)
            made.cyclic = len(part) >= SMALLEST_RING and _gap(part[-1], part[0]) < PEPTIDE_BREAK
            for i, member in enumerate(part):
                if why := self._why_converted(made, i):
                    parents.to_parent(self.draft, self.known, member, why)
            if made.cyclic and not self.draft.states(part[-1].address("C"), part[0].address("N")):
                self.draft.note(Kind.CYCLIC, last=part[-1].residue, first=part[0].residue)
            self.draft.parts.append(made)

    def _is_in_place(self, member: Member, i: int, n: int) -> bool:
        if n > 1 and (i == 0 if member.name == "ACE" else i == n - 1):
            return True
        if any(member.address(a.name) in ends for ends in self.draft.stated for a in member.heavy):
            # Bonded elsewhere than at the end of a chain, it is a molecule as any other.
            self.beside.append(Candidate(member, member.name))
            return False
        self.draft.note(Kind.CAP, losses(member, member.atoms, Why.CAP), residue=member.residue)
        self.draft.left_out[member.name] += 1
        return False


def _element(atom: gemmi.Atom) -> gemmi.Element:
    """Element by the atom's name where it contradicts the element read: CHARMM puts HD1 in columns 13-15."""
    letter = atom.name.lstrip("0123456789")[:1]
    known = atom.element.name in ("C", "H", "N", "O", "S") and atom.element.name == letter
    return atom.element if known or letter not in "CHNOS" or not letter else gemmi.Element(letter)


def _nowhere(atoms: list[gemmi.Atom]) -> list[gemmi.Atom]:
    """Atoms of an amino acid without a place: upon its CA, far from most others, or several at the origin."""
    origin = [atom for atom in atoms if atom.pos.length() < _UPON]
    others = [atom for atom in atoms if atom not in origin]
    if not others or (len(origin) == 1 and any(origin[0].pos.dist(atom.pos) < _BESIDE for atom in others)):
        origin = []
    if any(atom.pos.dist(others[0].pos) > _FAR for atom in others):
        x = np.array([atom.pos.tolist() for atom in others])
        is_far = np.linalg.norm(x - np.median(x, axis=0), axis=1) > _FAR
        origin += [others[i] for i in np.flatnonzero(is_far) if 2 * is_far.sum() < len(others)]
    alpha = next((atom for atom in others if atom.name == "CA" and atom not in origin), None)
    return origin + [
        atom for atom in others if alpha and atom is not alpha and atom.pos.dist(alpha.pos) < _UPON
    ]


def standard_parent(name: str) -> str:
    """Return the standard amino acid that a residue is or derives from, or an empty string."""
    standard = standard_name(name)[0]
    return standard if standard in residues.STANDARD else archive_parent(name)


def _gap(last: Member, first: Member) -> float:
    """Distance in angstrom from C of one residue to N of another; infinite where either cannot bond."""
    end, start = last.atom("C"), first.atom("N")
    if end is None or start is None or last.name in ("NME", "NH2") or first.name == "ACE":
        return np.inf
    return float(end.pos.dist(start.pos))


def _bonded_ends(draft: Draft, runs: list[list[Member]]) -> tuple[dict[int, int], dict[int, int]]:
    """Piece that follows a piece, and piece before it, where their ends are as near as bonded atoms."""
    ends = {i: a for i, run in enumerate(runs) if (a := run[-1].atom("C"))}
    starts = {i: a for i, run in enumerate(runs) if (a := run[0].atom("N"))}
    tree, number = KDTree(np.array([a.pos.tolist() for a in starts.values()]).reshape(-1, 3)), [*starts]
    near = []
    for i, a in ends.items():
        for j in (number[k] for k in tree.query_ball_point(a.pos.tolist(), PEPTIDE_BREAK)):
            last, first = runs[i][-1], runs[j][0]
            ended = last.atom("OXT") and not draft.states(last.address("C"), first.address("N"))
            if i != j and not ended and (gap := _gap(last, first)) < PEPTIDE_BREAK:
                near.append((gap, i, j))
    following: dict[int, int] = {}
    before: dict[int, int] = {}
    for _, i, j in sorted(near):
        if i not in following and j not in before:
            following[i], before[j] = j, i
    return following, before


def _is_torn(last: Member, first: Member, gap: float) -> bool:
    """Whether two residues, too far apart, are nevertheless bonded."""
    follows = int(first.number) == int(last.number) + 1
    return follows and gap < PEPTIDE_TORN and not last.atom("OXT") and not last.is_cap and not first.is_cap
