"""Acetyl and methylamide caps in place of the charged ends of chains."""

from collections.abc import Generator, Iterator
from string import ascii_uppercase
from typing import NamedTuple

import gemmi
import numpy as np
from scipy.spatial import KDTree

from protochain.core import defaults
from protochain.core.arrays import Floats, dihedral
from protochain.core.errors import Argument, StructureError
from protochain.structure.molecule import residues
from protochain.structure.molecule.header import with_header
from protochain.structure.molecule.member import Member, atom
from protochain.structure.molecule.repairs import Kind, Repair
from protochain.structure.preparation.structure_draft import Changes, Draft, Part
from protochain.structure.sidechains.ideal import Places, place_points, unit

_BONDED = 1.3  # Angstrom: a hydrogen closer than this to N, or to OXT, is removed with the charged end.
_CONTACT, _CLASH, _OVERLAP = 2.9, 2.4, 1.9
"""Angstrom: a cap turns until no heavy atom is closer than the first. It turns away from the direction of the
file if a heavy atom is closer than the second. It is not built if one is closer than the last."""
_TURNS = np.deg2rad([0.0, *(sign * turn for turn in range(10, 180, 10) for sign in (1.0, -1.0)), 180.0])


class _Cap(NamedTuple):
    """Internal coordinates of a cap: Engh, Huber, International Tables for Crystallography F, 18.3 (2001)."""

    name: str
    step: int  # From the residue to the cap.
    frame: tuple[str, str, str]  # Atoms of the residue. The last one is bonded to the cap.
    opposite: tuple[str, ...]  # Atoms of the residue, of which the first present one determines the torsion.
    share: float  # Fraction of the angles of the cap at the last atom of the frame, next to the frame.
    # Name, bond (angstrom), angle and dihedral (degrees) of the atoms. The first is bonded to the residue.
    atoms: tuple[tuple[str, float, float, float], ...]


_CAPS = (
    _Cap("ACE", -1, ("C", "CA", "N"), ("CD",), 119.3 / (119.3 + 128.4),
         (("C", 1.336, 121.7, -65.0), ("O", 1.229, 122.7, 0.0), ("CH3", 1.525, 117.2, 180.0))),
    _Cap("NME", 1, ("N", "CA", "C"), ("O", "OXT"), 117.2 / (117.2 + 122.7),
         (("N", 1.336, 117.2, 140.0), ("C", 1.459, 121.7, 180.0))),
)  # fmt: skip
_CARBONYL = 1.229, np.deg2rad(120.1)


class _End(NamedTuple):
    """An end of a chain."""

    part: Part
    member: Member
    cap: _Cap
    gap: Repair | None  # Break of the chain at this end.


def cap_ends(draft: Draft) -> Changes:
    """Build caps at the requested ends of chains."""
    requested = draft.reading.cap
    if requested == defaults.CAP:
        return
    entities = with_header(draft.header).entities
    lengths = {name: len(entity.full_sequence) for entity in entities for name in entity.subchains}
    capped, charged = list[Repair](), list[Repair]()
    # Caps with more freedom are later: acetyl at proline, methylamide, which turns with O, acetyl.
    for end in sorted(_ends(draft), key=lambda end: len(end.cap.opposite) or 3):
        if requested not in ("all", "breaks" if end.gap else "ends"):
            continue
        length = lengths.get(end.member.label[0], 0)
        is_stated = length and end.member.label[1] == (1 if end.cap.step < 0 else length)
        try:
            if is_stated and not end.gap and requested != "all":
                remedy = Argument("cap", "all"), " caps it"
                raise StructureError("the sequence of the file ends there; ", *remedy)
            cap = yield from _build(draft, end)
        except StructureError as error:
            yield Repair.of(Kind.NOT_CAPPED, residue=end.member.residue, why=error)
            charged += [end.gap] if end.gap else []
            continue
        end.part.members.insert(0 if end.cap.step < 0 else len(end.part.members), cap)
        capped += [end.gap] if end.gap else []
        facts = end.gap.facts if end.gap else {}
        yield Repair.of(Kind.CAP_AT_BREAK if end.gap else Kind.CAP_AT_END, residue=cap.residue, **facts)
    # A break with caps has no charged termini.
    neutral = {id(gap) for gap in capped} - {id(gap) for gap in charged}
    draft.repairs = [repair for repair in draft.repairs if id(repair) not in neutral]


def _ends(draft: Draft) -> Iterator[_End]:
    """Yield the ends of chains without a cap, a ring closure, or another bond."""
    gaps = [repair for repair in draft.repairs if repair.kind is Kind.GAP and repair.facts["goes_on"]]
    for part in (part for part in draft.parts if not (part.obstacle or part.cyclic)):
        for cap, k, side in zip(_CAPS, (0, -1), ("first", "last"), strict=True):
            member = part.members[k]
            ends = [gap for gap in gaps if gap.facts[side].place == member.residue.place]
            if cap.name == "ACE" and member.name != "PRO":
                cap = cap._replace(opposite=())
            if not (member.is_cap or {cap.frame[-1], "OXT"} & member.bonded_names):
                yield _End(part, member, cap, ends[0] if ends else None)


def _build(draft: Draft, end: _End) -> Generator[Repair, None, Member]:
    """Return a cap at the torsion closest to the usual one that has room, and remove the charged end."""
    member, cap = end.member, end.cap
    if member.name not in residues.STANDARD or member.source is not None:
        raise StructureError("it is a modified residue")
    at = {a.name: np.array(a.pos.tolist()) for a in member.heavy}
    a, b, c = (at[name] for name in cap.frame)
    (first, bond, angle, torsion), *outer = ((*row[:2], *np.deg2rad(row[2:])) for row in cap.atoms)
    turns = _TURNS + (-torsion if member.is_d else torsion)
    opposite = [at[name] for name in cap.opposite if name in at]
    if opposite:
        stays = cap.step < 0 or "O" in member.bonded_names
        turns = _TURNS[: 1 if stays else None] + float(dihedral(a, b, c, opposite[0])) + np.pi
        inner = float(np.arccos(np.clip(unit(b - c) @ unit(opposite[0] - c), -1.0, 1.0)))
        angle = cap.share * (2.0 * np.pi - inner)
    # Positions (n, 3) at n torsions. O turns with a methylamide.
    x: Places = {first: place_points(a, b, c, bond, angle, turns)}
    for name, bond, angle, turn in outer:
        x[name] = place_points(b, c, x[first], bond, angle, np.full(len(turns), turn))
    oxygen = member.atom("O") if cap.step > 0 else None
    turned = {"O": place_points(a, b, c, *_CARBONYL, turns + np.pi)} if oxygen is not None else {}
    room = _room(draft, member, cap, x | turned)
    chosen = 0 if opposite and room[0] >= _CLASH else int(np.argmax(np.minimum(room, _CONTACT)))
    if room[chosen] < _OVERLAP:
        raise StructureError("a cap has no room there")
    if oxygen is not None and chosen:
        oxygen.pos = gemmi.Position(*np.round(turned["O"][chosen], 4).tolist())
        yield Repair.of(Kind.OXYGEN_TURNED, residue=member.residue)
    charged = member.atom("N" if cap.step < 0 else "OXT")
    if charged is not None:
        light = {p.name for p in member.atoms if p.is_hydrogen() and p.pos.dist(charged.pos) < _BONDED}
        member.atoms = [p for p in member.atoms if p.name not in light | ({charged.name} - {"N"})]
    b_iso = member.atoms[0].b_iso
    atoms = [atom(name, name[0], np.round(p[chosen], 4).tolist(), b_iso) for name, p in x.items()]
    number, code = _free_number(draft, member, cap.step)
    label = member.label[0], (member.label[1] or -1) + cap.step
    is_free = label[1] > 0 and label not in {m.label for m in draft.members}
    new_label = label if is_free else (label[0], None)
    return Member(cap.name, f"{number}", code, member.chain_id, atoms, label=new_label, raw_name=cap.name)


def _free_number(draft: Draft, member: Member, step: int) -> tuple[int, str]:
    """Return an unused number and insertion code next to a residue, in the order of the chain if possible."""
    used = {(int(m.number), m.insertion_code) for m in draft.members if m.chain_id == member.chain_id}
    n, own = int(member.number), member.insertion_code
    codes = ("", *ascii_uppercase)
    if step > 0:
        # The next number would be after further residues with the same number.
        goes_on = any(number == n and code > own for number, code in used)
        choices = [*([] if goes_on else [(n + 1, "")]), *((n, code) for code in codes if code > own)]
    else:
        choices = [*((n, code) for code in reversed(codes) if code < own), *((n - 1, code) for code in codes)]
    return next(choice for choice in choices if choice not in used)


def _room(draft: Draft, member: Member, cap: _Cap, x: Places) -> Floats:
    """Return distances (n,), angstrom, between n positions of a cap and heavy atoms over three bonds away."""
    tree = KDTree([a.pos.tolist() for m in draft.members for a in m.heavy if m is not member])
    distances = list[Floats]()
    for name, places in x.items():
        # Atoms bonded to the residue have fixed distances to more atoms of the residue.
        is_inner = name == cap.atoms[0][0] or name in cap.opposite
        near = {*cap.opposite, *cap.frame[1:], *((cap.frame[0], "CB") if is_inner else ())}
        own = [np.array(a.pos.tolist()) for a in member.heavy if a.name not in near]
        distances += [np.asarray(tree.query(places)[0]), *(np.linalg.norm(places - y, axis=1) for y in own)]
    return np.asarray(np.round(np.min(distances, axis=0), 4))
