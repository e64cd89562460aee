"""Residues of a file and their chains, which are split at breaks and joined at bonded ends."""

import sys
from collections import Counter
from collections.abc import Generator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import gemmi
import numpy as np
from scipy.spatial import KDTree

from protochain.core.errors import Argument, OnlyAlphaError
from protochain.ligands.tables import CATEGORY, of_header
from protochain.structure.formats.chain_splitting import refuse_crowds
from protochain.structure.formats.files import parse, places_in_file
from protochain.structure.molecule import residues, templates
from protochain.structure.molecule.chirality import WELL_FORMED, chirality
from protochain.structure.molecule.member import Address, Member, Unknown, address_of, residue_in_file
from protochain.structure.molecule.repairs import Kind, Reason, Repair
from protochain.structure.preparation.complete import complete_backbone
from protochain.structure.preparation.hetero_molecules import rename_water, report_unresolved
from protochain.structure.preparation.ligand_chemistry import with_pose
from protochain.structure.preparation.model_choice import Conformation, pick_altloc
from protochain.structure.preparation.structure_draft import Changes, Draft, HeteroResidue, Omission, Part

PEPTIDE_BREAK = 2.0
"""Angstrom: C and N further apart than this are not bonded (a peptide bond is 1.33)."""
PEPTIDE_LONGEST = 3.0
"""Angstrom: C and N of consecutive numbers are bonded up to this distance, as in models with distorted bonds.
Chain ends are further apart: C and N that are not bonded touch at 3.25."""
_COINCIDENT, _BONDED, _FAR = 0.01, 2.0, 15.0
"""Angstrom: atoms closer than the first coincide, and bonded atoms are closer than the second. The last is
twice the extent of an arginine from its centre."""
_BONDS = (gemmi.ConnectionType.Disulf, gemmi.ConnectionType.Covale, gemmi.ConnectionType.MetalC)


def read_bonds(draft: Draft) -> Changes:
    """Read the bonds between residues that the file states, by connections and by serial numbers."""
    images: list[residues.Atom] = []
    for bond in (connection for connection in draft.file.connections if connection.type in _BONDS):
        ends = address_of(bond.partner1), address_of(bond.partner2)
        # An atom on a symmetry axis is bonded to its own image, whatever the file states.
        if bond.asu == gemmi.Asu.Different or ends[0] == ends[1]:
            residue = residues.Residue(*ends[0][:2], bond.partner1.res_id.name)
            images.append(residues.Atom(ends[0][2], residue))
        else:
            draft.stated_bonds.append(ends)
    if images:
        yield Repair.of(Kind.IMAGES, count=len(images), atoms=tuple(dict.fromkeys(images)))
    draft.stated_bonds += _serial_bonds(draft.file, draft.model)


def _serial_bonds(structure: gemmi.Structure, model: gemmi.Model) -> list[tuple[Address, Address]]:
    """Return the bonds between residues that CONECT records state by serial numbers."""
    bonds = {frozenset((a, b)) for a, partners in structure.conect_map.items() for b in partners if a != b}
    serials = {serial for bond in bonds for serial in bond}
    places = [place for place in model.all() if place.atom.serial in serials] if serials else []
    count = Counter(place.atom.serial for place in places)
    at = {
        place.atom.serial: (place.chain.name.strip(), str(place.residue.seqid).strip(), place.atom.name)
        for place in places
        # Repeated serial numbers are ambiguous.
        if count[place.atom.serial] == 1
    }
    pairs = [sorted(bond) for bond in bonds if bond <= at.keys()]
    return [(at[a], at[b]) for a, b in sorted(pairs) if at[a][:2] != at[b][:2]]


def split_chains(draft: Draft) -> Changes:
    """Read the residues of the protein, in unbroken pieces, and the hetero molecules."""
    # The atoms of a component do not rename it if the file states its bonds.
    components = of_header(draft.header) if CATEGORY in draft.header else set[str]()
    components |= draft.reading.chemistry.moving
    for chain, places in draft.places.items():
        run: list[Member] = []
        for group, letter in places:
            conformer = pick_altloc(group, letter)
            naming = templates.name_by_atoms(
                conformer.residue.name.strip().upper(), [*conformer.residue], draft.templates, components
            )
            notes = _report_altlocs(chain, conformer)
            if naming[0] in {*residues.CAPS, *residues.STANDARD} or templates.archive_parent(naming[0]):
                yield from notes
                if conformer.unused_altlocs:
                    yield Omission("alternate locations", len(conformer.unused_altlocs))
                elif conformer.repeated:
                    yield Omission("repeated atoms", len(conformer.repeated))
                notes = []
            member, is_protein = yield from _read_residue(draft, chain, conformer.residue, *naming)
            if is_protein:
                run.append(member)
            else:
                candidate = rename_water(member, member.raw_name)
                draft.hetero_residues.append(HeteroResidue(candidate, member.raw_name, notes))
        run = yield from _complete_backbones(draft, chain, run)
        yield from report_unresolved(run)
        yield from _split_at_breaks(draft, run)


def _report_altlocs(chain: str, conformer: Conformation) -> list[Repair]:
    if not (conformer.unused_altlocs or conformer.repeated):
        return []
    residue = residue_in_file(chain, conformer.residue)
    if not conformer.unused_altlocs:
        return [Repair.of(Kind.REPEATED, residue=residue, atoms=tuple(conformer.repeated))]
    used, occupancy, others = conformer.altloc, conformer.occupancy, tuple(conformer.unused_altlocs)
    return [Repair.of(Kind.ALTERNATES, residue=residue, used=used, occupancy=occupancy, others=others)]


def _read_residue(
    draft: Draft, chain: str, residue: gemmi.Residue, name: str, state: str
) -> Generator[Repair, None, tuple[Member, bool]]:
    """Return a residue under its standard name, and whether it belongs to the protein."""
    original, is_standard = residue.name.strip().upper(), name in residues.STANDARD
    if is_standard or name in residues.CAPS:
        for atom in residue:
            atom.element = _corrected_element(atom)
    atoms = [*residue]
    if is_standard and (misplaced := _misplaced_atoms(atoms)):
        atoms = [atom for atom in atoms if atom not in misplaced]
        names = tuple(atom.name for atom in misplaced)
        yield Repair.of(Kind.NO_PLACE, residue=residue_in_file(chain, residue), atoms=names)
    if name in residues.NUCLEOTIDES:
        templates.rename(atoms, draft.templates[name])
    has_backbone = {*residues.BACKBONE} <= {atom.name for atom in atoms}
    for atom in atoms if has_backbone else ():
        # Without element columns gemmi has no element for 1HB of a modified residue.
        atom.element = atom.element if atom.element.atomic_number else _corrected_element(atom)
    member = Member(
        name, str(residue.seqid.num), residue.seqid.icode.strip(), chain, atoms, state,
        is_d=gemmi.find_tabulated_residue(name).kind == gemmi.ResidueKind.AAD,
        label=(residue.subchain, residue.label_seq), raw_name=original,
    )  # fmt: skip
    by_atoms = is_standard and templates.standard_name(original)[0] != name
    member.is_d = member.is_d or (by_atoms and chirality(member) < 0)
    if state or by_atoms or (is_standard and original[-3:] in residues.LINKED):
        kind = Kind.STATE_NAMED if state else Kind.RENAMED
        yield Repair.of(kind, residue=residue_in_file(chain, residue), name=name, state=state)
    if name in residues.CAPS:
        templates.rename(member.atoms, draft.templates[templates.template_name(name)])
    if is_standard or name in residues.CAPS or not has_backbone:
        return member, is_standard or name in residues.CAPS
    # DGN: D-glutamine in the archive, a nucleoside in Amber's files. HIP with a phosphate is not Amber's.
    template = draft.templates.get(name) if name not in residues.STATE_PARENT else None
    if not (template and {*residues.BACKBONE} <= template.element.keys()):
        # A residue without a parent may be a ligand, if it is alone.
        member.source = Unknown(templates.archive_parent(name))
        draft.orphans |= set() if member.parent else {id(member)}
    return member, True


def _complete_backbones(
    draft: Draft, chain: str, run: list[Member]
) -> Generator[Repair | Omission, None, list[Member]]:
    """Return the residues of a chain that have N, CA and C, also after building missing ones."""
    atom_names = [{atom.name for atom in member.atoms} for member in run]
    is_incomplete = [not {*residues.BACKBONE} <= names for names in atom_names]
    built = [
        complete_backbone(run, i) if is_incomplete[i] and member.name in residues.STANDARD else ()
        for i, member in enumerate(run)
    ]
    is_alpha_only = [[atom.name for atom in member.atoms] == ["CA"] for member in run if not member.is_cap]
    if is_alpha_only and all(is_alpha_only):
        raise OnlyAlphaError(
            f"{draft.source}: chain {chain or '(blank)'} holds only C-alpha atoms; "
            "rebuild the others first, by PULCHRA or cg2all"
        )
    complete = []
    for member, names, before in zip(run, built, atom_names, strict=True):
        missing = [] if member.is_cap else [name for name in residues.BACKBONE if name not in before]
        if missing and draft.reading.strict:
            raise draft.error(
                f"{member}: atom {missing[0]} missing; rebuild the backbone or remove the residue"
            )
        if missing and not names:
            lost = member.losses(member.atoms, Reason.BACKBONE)
            yield Repair.of(Kind.NO_BACKBONE, lost, residue=member.residue, atom=missing[0])
            yield Omission("incomplete residues", 1)
            continue
        if missing:
            yield Repair.of(Kind.ATOMS_ADDED, residue=member.residue, atoms=names)
        complete.append(member)
    return complete


def _split_at_breaks(draft: Draft, run: list[Member]) -> Changes:
    last: Member | None = None
    for member in run:
        gap = _gap(last, member) if last else np.inf
        if last and gap >= PEPTIDE_BREAK and _is_stretched_bond(last, member, gap):
            yield Repair.of(Kind.TORN, last=last.residue, first=member.residue, length=gap)
        elif gap >= PEPTIDE_BREAK:
            draft.runs.append([])
        draft.runs[-1].append(member)
        last = member


def join_chains(draft: Draft) -> Changes:
    """Join pieces with bonded ends to chains, whatever their ids, numbers or order."""
    following, before = _bonded_ends(draft, draft.runs)
    for i, (run, after) in enumerate(pairwise(draft.runs)):
        is_same_chain = run[-1].chain_id == after[0].chain_id and len(run) + len(after) > 2
        if is_same_chain and i not in following and i + 1 not in before:
            yield from _report_break(draft, run[-1], after[0])
    heads = [i for i in range(len(draft.runs)) if i not in before]
    visited: set[int] = set()
    # The remaining pieces, none of which is a head, form rings.
    for head in (*heads, *range(len(draft.runs))):
        chain: list[Member] = []
        piece: int | None = head
        while piece is not None and piece not in visited:
            visited.add(piece)
            chain += draft.runs[piece]
            piece = following.get(piece)
        for last, first in pairwise(chain):
            if last.chain_id != first.chain_id:
                yield Repair.of(Kind.CHAIN_GOES_ON, last=last.residue, first=first.residue)
        yield from _add_chain(draft, chain)


def _report_break(draft: Draft, last: Member, first: Member) -> Changes:
    """Report a chain break, unless the file has termini there."""
    gap = _gap(last, first)
    if last.atom("OXT") or last.is_cap or first.is_cap or {id(last), id(first)} & draft.orphans:
        return
    if draft.reading.strict:
        raise draft.error(
            f"chain {last.residue.chain_name} is broken between {last.seqid} and "
            f"{first.seqid} ({gap:.1f} angstrom); model the missing residues, or leave out ",
            Argument("strict", True),
        )
    goes_on = _goes_on(last, first)
    caps = Argument("cap", "breaks" if goes_on else "ends")
    yield Repair.of(Kind.GAP, last=last.residue, first=first.residue, length=gap, goes_on=goes_on, caps=caps)


def _goes_on(last: Member, first: Member) -> bool:
    """Whether a residue follows another in one sequence, by the sequence in the file or by the numbers."""
    if last.label[1] and first.label[1] and last.label[0] == first.label[0]:
        return last.label[1] < first.label[1]
    return (int(last.number), last.insertion_code) < (int(first.number), first.insertion_code)


def _add_chain(draft: Draft, chain: list[Member]) -> Changes:
    """Add an unbroken chain to the protein, or a single residue to the hetero molecules."""
    n, members = len(chain), list[Member]()
    for i, member in enumerate(chain):
        if not member.is_cap or (n > 1 and (i == 0 if member.name == "ACE" else i == n - 1)):
            members.append(member)
        elif any(member.address(a.name) in ends for ends in draft.stated_bonds for a in member.heavy):
            # A cap with stated bonds, but not at the end of a chain, is a hetero molecule.
            draft.hetero_residues.append(HeteroResidue(member, member.name))
        else:
            lost = member.losses(member.atoms, Reason.CAP)
            yield Repair.of(Kind.CAP, lost, residue=member.residue)
            yield Omission(member.name, 1)
    if len(members) == 1:
        if id(members[0]) not in draft.orphans:
            yield Repair.of(Kind.ALONE, residue=members[0].residue)
        members[0].source = None
        draft.hetero_residues.append(HeteroResidue(members[0], members[0].name))
    elif members:
        part = Part(members[0].chain_id, members)
        last, first = members[-1], members[0]
        part.cyclic = _gap(last, first) < PEPTIDE_BREAK
        for i, member in enumerate(members):
            if reason := _conversion_reason(draft, part, i):
                yield from convert_to_parent(draft, member, reason)
        if part.cyclic and not draft.has_bond(last.address("C"), first.address("N")):
            yield Repair.of(Kind.CYCLIC, last=last.residue, first=first.residue)
        draft.parts.append(part)


def _conversion_reason(draft: Draft, part: Part, i: int) -> Reason | None:
    """Return the reason why a modified residue of a chain becomes its standard parent, or None."""
    member = part.members[i]
    if not member.parent and member.name not in residues.PHOSPHORYLATED:
        return None
    if draft.reading.standard_residues:
        return Reason.ASKED
    heavy_names = {atom.name for atom in member.heavy} - {"OXT"}
    if member.parent:
        member.is_d = member.is_d or chirality(member, least=WELL_FORMED) < 0
        is_mirrored = member.is_d and heavy_names == {*draft.templates[full_state(member.parent)].heavy}
        return Reason.PARENT if member.name == "MSE" or is_mirrored else None
    template = part.template(draft.templates, i)
    if template is None:
        return Reason.END
    is_complete = {template.synonyms.get(name, name) for name in heavy_names} - {"OXT"} == {*template.heavy}
    return None if is_complete else Reason.INCOMPLETE


def full_state(name: str) -> str:
    """Return the protonation state of an amino acid with all atoms of its other states."""
    return "HIP" if name == "HIS" else name


def convert_to_parent(draft: Draft, member: Member, reason: Reason) -> Changes:
    """Convert a modified residue of a chain to its standard parent."""
    residue, original = member.residue, member.name
    parent = member.parent or templates.archive_parent(original)
    usual = draft.templates[full_state(parent)]
    expected = {*usual.element, *templates.other_names(member.atoms, usual), "OXT", "H1", "H2", "H3", "H"}
    for name in set(usual.heavy) - {atom.name for atom in member.atoms}:
        # Selenium, or a sulphur of another name, becomes the parent's sulphur.
        chalcogens = [a for a in member.atoms if a.element.name in ("S", "Se") and a.name not in expected]
        if usual.element[name] == "S" and len(chalcogens) == 1:
            chalcogens[0].name, chalcogens[0].element = name, gemmi.Element("S")
    extra = [a for a in member.heavy if a.name not in expected]
    member.atoms = [a for a in member.atoms if a.name in expected and not (extra and a.is_hydrogen())]
    member.name, member.state, member.source = parent, "", None
    removed = tuple(a.name for a in extra)
    lost = member.losses(extra, reason)
    if gemmi.find_tabulated_residue(original).kind not in (gemmi.ResidueKind.AA, gemmi.ResidueKind.AAD):
        # The table does not contain its configuration.
        member.is_d = chirality(member, least=WELL_FORMED) < 0
    if original == "MSE":
        yield Repair.of(Kind.SELENOMETHIONINE, lost, residue=residue)
    elif original != residues.name_in_file(parent, member.is_d):
        if removed:
            kind = Kind.CUT_TO_D if member.is_d else Kind.CUT_TO_PARENT
        else:
            kind = Kind.CONVERTED_TO_D if member.is_d else Kind.CONVERTED
        name = residues.name_in_file(parent, member.is_d)
        yield Repair.of(kind, lost, residue=residue, name=name, atoms=removed)
    elif removed or chirality(member) < 1:  # Other inversions are reported together.
        kind = Kind.MIRRORED_CUT if removed else Kind.MIRRORED
        yield Repair.of(kind, lost, residue=residue, atoms=removed)


def add_poses(draft: Draft) -> tuple[()]:
    """Add the user's molecules with coordinates, and order the hetero molecules."""
    # As in written files, protein chains come first.
    order = list(dict.fromkeys(part.chain_id for part in draft.parts))
    order += [chain.name for chain in draft.model if chain.name not in order]
    draft.hetero_residues.sort(key=lambda candidate: order.index(candidate.member.chain_id))
    chemistry = draft.reading.chemistry
    for path in chemistry.poses:
        used = {(m.chain_id, m.number) for m in (*draft.members, *(b.member for b in draft.hetero_residues))}
        names = {*chemistry.moving, *(candidate.raw_name for candidate in draft.hetero_residues)}
        chemistry, member = with_pose(chemistry, path, {chain for chain, _ in used}, names)
        draft.hetero_residues.append(HeteroResidue(member, member.name))
    if chemistry is not draft.reading.chemistry:
        draft.reading = replace(draft.reading, chemistry=chemistry)
    members = [*draft.members, *(candidate.member for candidate in draft.hetero_residues)]
    refuse_crowds([atom for member in members for atom in member.atoms], draft.source)
    return ()


def order_parts(draft: Draft) -> Changes:
    """Sort chains and molecules in the order of the file. Report a file without an end mark."""
    draft.parts.sort(key=_file_position)
    chains = [part for part in draft.parts if not part.obstacle] or draft.parts
    last = chains[-1].members[-1]
    if not draft.is_ended and not last.atom("OXT"):
        yield Repair.of(Kind.NO_END, residue=last.residue)


def _file_position(part: Part) -> int:
    """Return the first position of a molecule's atoms in the file, or a maximum if it has none there."""
    places = places_in_file([atom for member in part.members for atom in member.atoms])
    return min((place for place in places if place >= 0), default=sys.maxsize)


def model_numbers(path: str | Path) -> list[int]:
    """List the numbers of the models in a file."""
    return [model.num for model in parse(Path(path))[0]]


def _corrected_element(atom: gemmi.Atom) -> gemmi.Element:
    """Return the element by the atom's name if the element read contradicts it: CHARMM shifts HD1."""
    letter = atom.name.lstrip("0123456789")[:1]
    is_element = atom.element.name in ("C", "H", "N", "O", "S") and atom.element.name == letter
    return atom.element if is_element or letter not in "CHNOS" or not letter else gemmi.Element(letter)


def _misplaced_atoms(atoms: list[gemmi.Atom]) -> list[gemmi.Atom]:
    """Return misplaced atoms of an amino acid: on its CA, far from most atoms, or several at the origin."""
    origin = [atom for atom in atoms if atom.pos.length() < _COINCIDENT]
    placed = [atom for atom in atoms if atom not in origin]
    if not placed or (len(origin) == 1 and any(origin[0].pos.dist(atom.pos) < _BONDED for atom in placed)):
        origin = []
    if any(atom.pos.dist(placed[0].pos) > _FAR for atom in placed):
        x = np.array([atom.pos.tolist() for atom in placed])
        is_far = np.linalg.norm(x - np.median(x, axis=0), axis=1) > _FAR
        origin += [placed[i] for i in np.flatnonzero(is_far) if 2 * is_far.sum() < len(placed)]
    alpha = next((atom for atom in placed if atom.name == "CA" and atom not in origin), None)
    return origin + [a for a in placed if alpha and a is not alpha and a.pos.dist(alpha.pos) < _COINCIDENT]


def _gap(last: Member, first: Member) -> float:
    """Return the distance (angstrom) from C of one residue to N of another, infinite if they cannot bond."""
    end, start = last.atom("C"), first.atom("N")
    if end is None or start is None or last.name in ("NME", "NH2") or first.name == "ACE":
        return np.inf
    return float(end.pos.dist(start.pos))


def _bonded_ends(draft: Draft, runs: list[list[Member]]) -> tuple[dict[int, int], dict[int, int]]:
    """Map each piece to the next and to the previous one, by ends at bond distance."""
    ends = {i: a for i, run in enumerate(runs) if (a := run[-1].atom("C"))}
    starts = {i: a for i, run in enumerate(runs) if (a := run[0].atom("N"))}
    tree, pieces = KDTree(np.array([a.pos.tolist() for a in starts.values()]).reshape(-1, 3)), [*starts]
    near = []
    for i, a in ends.items():
        for j in (pieces[k] for k in tree.query_ball_point(a.pos.tolist(), PEPTIDE_BREAK)):
            last, first = runs[i][-1], runs[j][0]
            is_terminus = last.atom("OXT") and not draft.has_bond(last.address("C"), first.address("N"))
            if i != j and not is_terminus and (gap := _gap(last, first)) < PEPTIDE_BREAK:
                near.append((gap, i, j))
    following: dict[int, int] = {}
    before: dict[int, int] = {}
    for _, i, j in sorted(near):
        if i not in following and j not in before:
            following[i], before[j] = j, i
    return following, before


def _is_stretched_bond(last: Member, first: Member, gap: float) -> bool:
    """Whether two residues are bonded despite a long distance."""
    follows = int(first.number) == int(last.number) + 1
    return follows and gap < PEPTIDE_LONGEST and not last.atom("OXT") and not last.is_cap and not first.is_cap
