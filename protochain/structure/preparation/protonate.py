"""Protonation states, and the hydrogens of each residue.

PROPKA computes the pKa of side chains in their surroundings: Olsson, Soendergaard, Rostkowski, Jensen,
J. Chem. Theory Comput. 7:525 (2011), and Soendergaard, Olsson, Rostkowski, Jensen, ibid. 7:2284 (2011).
"""

import logging
from collections.abc import Generator, Mapping, Sequence
from io import StringIO
from string import ascii_letters, digits

import gemmi
import numpy as np

from protochain.core.checks import AUTO
from protochain.core.optional_libraries import library
from protochain.structure.molecule import residues
from protochain.structure.molecule.member import Member, atom
from protochain.structure.molecule.repairs import Kind, Repair
from protochain.structure.molecule.templates import Template, rename
from protochain.structure.preparation.flips import choose_flips
from protochain.structure.preparation.structure_draft import Changes, Draft, Part

BONDED = 1.5
"""Angstrom: a hydrogen further than this from every heavy atom of its residue is removed."""
_HYDROXYL = 1.3  # Angstrom: a hydrogen nearer than this to an oxygen of a phosphate is bonded to it.
_BRIDGED_NAME = "CYX"  # Amber's name of a cysteine in a disulfide.
_NO_PKA: Mapping[int, float] = {}
"""pKa of single residues. Without entries, the pKa of the kind of residue applies."""
_UNPLACED = [float("nan")] * 3
_PER_CHAIN = 9000  # Residues per chain of the PDB text.
_CHAINS = ascii_letters + digits  # Names of the chains of the PDB text.
_GROUPS = {"ASP", "GLU", "HIS", "CYS", "LYS"}


def protonate(draft: Draft) -> Changes:
    """Choose protonation states by names and hydrogens, or else by pH. Positions of new hydrogens are NaN."""
    templates, ph = draft.templates, draft.reading.chemistry.ph
    bridged = {id(member) for pair in draft.bridges for member in pair}
    pka = _compute_pka(draft) if draft.reading.ph == AUTO else _NO_PKA
    shown = {id(m): "CYX" if id(m) in bridged else _lone_pair(m) or _state_in_file(m) for m in draft.members}
    states = {id(m): shown[id(m)] or _state_at_ph(m, ph, pka) for m in draft.members}
    templated = list[tuple[Member, Template | None]]()
    for part in draft.parts:
        for i, m in enumerate(part.members):
            is_open = m.name == "HIS" and not states[id(m)] and m.template is None
            fitting = part.template(templates, i, states[id(m)]) or part.template(templates, i)
            templated.append((m, None if is_open else fitting))
    chosen, turned = choose_flips(templated)
    states |= chosen
    added = present = renamed = 0
    for part in draft.parts:
        for i, member in enumerate(part.members):
            n_before = sum(a.is_hydrogen() for a in member.atoms)
            if id(member) in turned:
                kind = Kind.RING_TURNED if member.name == "HIS" else Kind.AMIDE_TURNED
                yield Repair.of(kind, residue=member.residue)
            state = states[id(member)]
            residue_pka = pka.get(id(member)) if state == _state_at_ph(member, ph, pka) else None
            template = yield from _template(templates, part, i, shown[id(member)], state, residue_pka)
            renamed += yield from _match_hydrogens(member, template)
            n_placed = sum(a.is_hydrogen() and not np.isnan(a.pos.x) for a in member.atoms)
            present += min(n_before, n_placed)
            added += sum(a.is_hydrogen() for a in member.atoms) - n_placed
            draft.states.append((member, template))
    if renamed:
        yield Repair.of(Kind.HYDROGENS_RENAMED, count=renamed)
    if added:
        yield Repair.of(Kind.HYDROGENS_ADDED, count=added, ph=ph, present=present)


def _template(
    templates: Mapping[str, Template], part: Part, i: int, shown: str, state: str, pka: float | None
) -> Generator[Repair, None, Template]:
    """Return the template of a residue in a shown or chosen state, and report which."""
    member = part.members[i]
    if member.template is not None:
        return member.template
    template = part.template(templates, i, state)
    usual = part.template(templates, i)
    assert usual is not None
    if member.raw_name.endswith(_BRIDGED_NAME) and not shown:
        yield Repair.of(Kind.NO_PARTNER, residue=member.residue, name=member.raw_name)
    if template is None:
        yield Repair.of(Kind.USUAL_STATE, residue=member.residue, state=state)
    elif state and not shown and pka is not None:
        yield Repair.of(Kind.STATE_BY_PKA, residue=member.residue, state=state, pka=pka)
    elif state and not shown:
        yield Repair.of(Kind.STATE_CHOSEN, residue=member.residue, state=state)
    template = template or usual
    if shown and member.name in residues.PHOSPHORYLATED:
        template = template.exchange("O1P", _acid_oxygens(member)[0])
    if member.name == "HIS" and {"ND1", "NE2"} <= {a.name for a in member.metals}:
        # Both nitrogens bind metals, as in superoxide dismutase.
        template = template.without_hydrogen("NE2")
        yield Repair.of(Kind.IMIDAZOLATE, residue=member.residue)
    for linked in member.links:
        if linked.name != "N":
            template = template.without_hydrogen(linked.name)
    return template


def _lone_pair(member: Member) -> str:
    """Return the state of a residue with a bonded lone pair. Empty for the usual state."""
    bonded = member.bonded_names
    if member.name == "HIS" and bonded & {"ND1", "NE2"}:
        return "HIE" if "ND1" in bonded else "HID"
    if member.name == "CYS" and "SG" in bonded:
        return "CYM"
    if member.name == "LYS" and any(a.name == "NZ" for a in member.metals):
        return "LYN"
    return ""


def _state_in_file(member: Member) -> str:
    """Return the protonation state that the residue's name or hydrogens in the file show."""
    if member.state:
        return member.state
    names = {a.name for a in member.atoms}
    if member.name == "HIS":
        state_of = {(True, True): "HIP", (True, False): "HID", (False, True): "HIE"}
        return state_of.get(("HD1" in names, "HE2" in names), "")
    if member.name == "ASP" and names & {"HD1", "HD2"}:
        return "ASH"
    if member.name == "GLU" and names & {"HE1", "HE2"}:
        return "GLH"
    if member.name == "LYS" and len(names & {"HZ1", "HZ2", "HZ3"}) == 2 and {"HE2", "HE3"} <= names:
        return "LYN"
    if member.name == "CYS" and any(a.name == "SG" and a.charge < 0 for a in member.atoms):
        return "CYM"
    if member.name in residues.PHOSPHORYLATED and _acid_oxygens(member):
        return residues.PKA[member.name][1]
    return ""


def _acid_oxygens(member: Member) -> list[str]:
    """Return the names of the oxygens of a phosphate that have a hydrogen in the file."""
    hydrogens = [a for a in member.atoms if a.is_hydrogen()]
    oxygens = [a for a in member.atoms if a.name in ("O1P", "O2P", "O3P")]
    return [a.name for a in oxygens if any(a.pos.dist(h.pos) <= _HYDROXYL for h in hydrogens)]


def _state_at_ph(member: Member, ph: float, pka: Mapping[int, float] = _NO_PKA) -> str:
    """Return the protonation state at a pH. Empty for the usual state."""
    acid, base = residues.PKA.get(member.name), residues.PKA_BASE.get(member.name)
    if acid and not member.metals and ph <= pka.get(id(member), acid[0]):
        return acid[1]
    return base[1] if base and ph > pka.get(id(member), base[0]) else ""


def _match_hydrogens(member: Member, template: Template) -> Generator[Repair, None, int]:
    """Rename and order the hydrogens of the file, remove hydrogens that do not fit, and add missing ones."""
    before = {a.name for a in member.atoms if a.is_hydrogen()}
    rename(member.atoms, template)
    heavy = member.heavy
    bonded: dict[str, list[gemmi.Atom]] = {a.name: [] for a in heavy}
    unmatched, expected = list[str](), template.hydrogens
    named_for = {name: parent for parent, names in expected.items() for name in names}
    for h in (a for a in member.atoms if a.is_hydrogen()):
        # If atoms overlap, another heavy atom may be nearer than the parent of that name.
        parents = [a for a in heavy if a.name == named_for.get(h.name) and a.pos.dist(h.pos) <= BONDED]
        nearest = min(parents or heavy, key=lambda a: a.pos.dist(h.pos))
        if nearest.pos.dist(h.pos) <= BONDED:
            bonded[nearest.name].append(h)
        else:
            unmatched.append(h.name)
    member.atoms = []
    for parent in heavy:
        names = list(expected.get(parent.name, []))
        hydrogens = bonded[parent.name]
        by_name = {a.name: a for a in hydrogens if a.name in names}
        unnamed = [a for a in hydrogens if a.name not in names]
        for name in names:
            if name not in by_name and unnamed:
                by_name[name] = unnamed.pop(0)
                by_name[name].name = name
        unmatched += [a.name for a in hydrogens if a not in by_name.values()]
        member.atoms.append(parent)
        member.atoms += [by_name.get(name) or atom(name, "H", _UNPLACED, parent.b_iso) for name in names]
    if unmatched:
        yield Repair.of(Kind.STRANGE_HYDROGENS, residue=member.residue, atoms=tuple(unmatched))
    return len({a.name for a in member.atoms if a.is_hydrogen() and not np.isnan(a.pos.x)} - before)


def _compute_pka(draft: Draft) -> Mapping[int, float]:
    """Compute the pKa of a protein's acids and bases, in the presence of the hetero molecules."""
    run = library("propka.run", "pka")
    members = draft.members
    if len(members) > _PER_CHAIN * len(_CHAINS):
        raise draft.error(f"ph auto: {len(members)} residues are too many for PROPKA")
    logging.getLogger("propka").setLevel(logging.ERROR)
    try:
        result = run.single("x.pdb", ["-q"], StringIO(_as_pdb(draft, members)), write_pka=False)
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        raise draft.error(f"PROPKA fails ({error}); give ph a number") from None
    groups = [group for group in result.conformations["AVR"].groups if group.residue_type in _GROUPS]
    places = {_chain_and_number(k): id(member) for k, member in enumerate(members)}
    return {places[g.atom.chain_id, g.atom.res_num]: float(g.pka_value) for g in groups}


def _chain_and_number(k: int) -> tuple[str, int]:
    """Return the chain and number of a residue in the input of PROPKA."""
    return _CHAINS[k // _PER_CHAIN], k % _PER_CHAIN + 1


def _as_pdb(draft: Draft, members: Sequence[Member]) -> str:
    """Return the heavy atoms as PDB records, with a TER after each piece of a chain."""
    number = {id(member): _chain_and_number(k) for k, member in enumerate(members)}
    lines = list[str]()
    for part in draft.parts:
        record = "HETATM" if part.obstacle else "ATOM"
        for member in part.members:
            chain, n = number[id(member)]
            for a in member.heavy:
                # Names of elements with one letter begin in the second column.
                name = a.name[:4] if len(a.element.name) > 1 or len(a.name) > 3 else f" {a.name}"
                place = "".join(f"{coordinate:8.3f}" for coordinate in a.pos.tolist())
                lines.append(
                    f"{record:6}{1:5d} {name:4} {member.name[:3]:>3} {chain}{n:4d}    {place}"
                    f"{1.0:6.2f}{0.0:6.2f}          {a.element.name.upper():>2}"
                )
        lines.append("TER")
    return "\n".join([*lines, "END", ""])
