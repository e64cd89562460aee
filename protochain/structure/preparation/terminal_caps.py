"""Acetyl and methylamide caps in place of the charged ends of chains.

A cap has the bond lengths and angles of a peptide (Engh, Huber, International Tables for Crystallography F,
18.3, 2001). The oxygen of the last residue determines the place of a methylamide. An acetyl turns about N-CA.
"""

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

_BONDED = 1.3
"""Angstrom: a hydrogen closer than this to N, or to OXT, is removed with the charged end."""
_CONTACT, _CLASH, _OVERLAP = 2.9, 2.4, 1.9
"""Angstrom: a cap turns until no heavy atom is closer than the first. It turns away from the direction of the
file if a heavy atom is closer than the second. It is not built if one is closer than the last."""
_TURNS = np.deg2rad([0.0, *(sign * turn for turn in range(10, 180, 10) for sign in (1.0, -1.0)), 180.0])


class _Geometry(NamedTuple):
    """Internal coordinates of a cap, in angstrom and rad, and the atoms of its residue."""

    first: str  # Atom of the cap that is bonded to the residue.
    frame: tuple[str, str, str]  # The last one is bonded to the cap.
    opposite: tuple[
        str, ...
    ]  # Atoms opposite to the cap, of which the first present one determines its torsion.
    share: float  # Fraction of both angles with the cap, of which the first one is in the frame.
    torsion: float  # Usual torsion of the frame and the cap in an L-amino acid.
    angle: float  # In the frame, if no atom is opposite.
    # Atoms of the cap after the first: name, bond, angle, and dihedral with CA.
    outer: tuple[tuple[str, float, float, float], ...]


_LENGTH, _CARBONYL = 1.336, (1.229, np.deg2rad(120.1))
"""Angstrom: peptide bond, and C=O with its angle, rad."""
_GEOMETRIES = {
    "ACE": _Geometry(
        "C", ("C", "CA", "N"), ("CD",), 119.3 / (119.3 + 128.4), np.deg2rad(-65.0), np.deg2rad(121.7),
        (("O", 1.229, np.deg2rad(122.7), 0.0), ("CH3", 1.525, np.deg2rad(117.2), np.pi)),
    ),
    "NME": _Geometry(
        "N", ("N", "CA", "C"), ("O", "OXT"), 117.2 / (117.2 + 122.7), np.deg2rad(140.0), np.deg2rad(117.2),
        (("C", 1.459, np.deg2rad(121.7), np.pi),),
    ),
}  # fmt: skip


class _End(NamedTuple):
    """An end of a chain."""

    part: Part
    member: Member
    cap: str  # Name of its cap: ACE at the first residue, NME at the last one.
    gap: Repair | None  # Break of the chain at this end.

    @property
    def is_ring(self) -> bool:
        """Whether the cap does not turn, because N is in the ring of proline."""
        return self.cap == "ACE" and self.member.name == "PRO"


def cap_ends(draft: Draft) -> Changes:
    """Build caps at the requested ends of chains."""
    requested = draft.reading.cap
    if requested == defaults.CAP:
        return
    entities = with_header(draft.header).entities
    length = {name: len(entity.full_sequence) for entity in entities for name in entity.subchains}
    capped: list[Repair] = []
    # Caps that turn are placed later than others: acetyl at proline, methylamide with its O, acetyl.
    for end in sorted(_ends(draft), key=lambda end: (end.cap == "ACE") - 2 * end.is_ring):
        if requested not in ("all", "breaks" if end.gap else "ends"):
            continue
        label, place = end.member.label
        is_stated = place and place == (1 if end.cap == "ACE" else length.get(label))
        try:
            if is_stated and not end.gap and requested != "all":
                raise StructureError(
                    "the sequence of the file ends there; ", Argument("cap", "all"), " caps it"
                )
            cap = yield from _build(draft, end)
        except StructureError as error:
            yield Repair.of(Kind.NOT_CAPPED, residue=end.member.residue, why=error)
            continue
        _remove_charged_end(end)
        end.part.members.insert(0 if end.cap == "ACE" else len(end.part.members), cap)
        if end.gap:
            capped.append(end.gap)
            yield Repair.of(Kind.CAP_AT_BREAK, residue=cap.residue, **end.gap.facts)
        else:
            yield Repair.of(Kind.CAP_AT_END, residue=cap.residue)
    # A break with two caps has no charged termini.
    draft.repairs = [repair for repair in draft.repairs if sum(repair is gap for gap in capped) < 2]


def _ends(draft: Draft) -> Iterator[_End]:
    """Yield the ends of chains without a cap, a ring closure, or another bond."""
    gaps = [repair for repair in draft.repairs if repair.kind is Kind.GAP and repair.facts["goes_on"]]
    after, before = (
        {(gap.facts[side].chain, gap.facts[side].number): gap for gap in gaps} for side in ("last", "first")
    )
    for part in draft.parts:
        first, last = part.members[0], part.members[-1]
        for member, cap, gaps_at, names in (
            (first, "ACE", before, {"N"}),
            (last, "NME", after, {"C", "OXT"}),
        ):
            is_bonded = not names.isdisjoint(a.name for a in (*member.links, *member.metals))
            if not (part.obstacle or part.cyclic or member.is_cap or is_bonded):
                yield _End(part, member, cap, gaps_at.get((member.chain_id, member.seqid)))


def _build(draft: Draft, end: _End) -> Generator[Repair, None, Member]:
    """Return a cap at the torsion closest to the usual one that has room. O turns with a methylamide."""
    member, geometry = end.member, _GEOMETRIES[end.cap]
    if member.name not in residues.STANDARD or member.source is not None:
        raise StructureError("it is a modified residue")
    at = {a.name: np.array(a.pos.tolist()) for a in member.heavy}
    a, b, c = (at[name] for name in geometry.frame)
    opposite = [at[name] for name in geometry.opposite if name in at and (end.is_ring or name != "CD")]
    turns = _TURNS + (-geometry.torsion if member.is_d else geometry.torsion)
    angle = geometry.angle
    if opposite:
        turns = _TURNS[: 1 if end.is_ring else None] + float(dihedral(a, b, c, opposite[0])) + np.pi
        inner = float(np.arccos(np.clip(unit(b - c) @ unit(opposite[0] - c), -1.0, 1.0)))
        angle = geometry.share * (2.0 * np.pi - inner)
    # Positions (n, 3) at n torsions.
    x: Places = {geometry.first: place_points(a, b, c, _LENGTH, angle, turns)}
    for name, bond, bend, turn in geometry.outer:
        x[name] = place_points(b, c, x[geometry.first], bond, bend, np.full(len(turns), turn))
    oxygen = member.atom("O") if end.cap == "NME" else None
    if oxygen is not None:
        x["O"] = place_points(a, b, c, *_CARBONYL, turns + np.pi)
    room = _room(draft, end, x)
    chosen = int(np.argmax(np.minimum(room, _CONTACT)))
    if opposite and room[0] >= _CLASH:
        chosen = 0
    if room[chosen] < _OVERLAP:
        raise StructureError("a cap has no room there")
    if oxygen is not None:
        place = x.pop("O")[chosen]
        if chosen:
            oxygen.pos = gemmi.Position(*np.round(place, 4).tolist())
            yield Repair.of(Kind.OXYGEN_TURNED, residue=member.residue)
    b_iso = next(p.b_iso for p in member.atoms if p.name == geometry.frame[-1])
    atoms = [atom(name, name[0], np.round(p[chosen], 4).tolist(), b_iso) for name, p in x.items()]
    number, code = _free_number(draft, member, -1 if end.cap == "ACE" else 1)
    label = member.label[0], None
    return Member(end.cap, number, code, member.chain_id, atoms, label=label, raw_name=end.cap)


def _room(draft: Draft, end: _End, x: Places) -> Floats:
    """Return distances (n,), angstrom, between n positions of a cap and heavy atoms over three bonds away."""
    geometry = _GEOMETRIES[end.cap]
    distances = []
    for name, places in x.items():
        near = (
            {*geometry.frame, "CB"} if name in (geometry.first, *geometry.opposite) else {*geometry.frame[1:]}
        )
        near |= {*geometry.opposite}
        others = [
            a.pos.tolist()
            for m in draft.members
            for a in m.heavy
            if m is not end.member or a.name not in near
        ]
        distances.append(KDTree(np.reshape(others, (-1, 3))).query(places)[0])
    return np.asarray(np.round(np.min(distances, axis=0), 4))


def _free_number(draft: Draft, member: Member, step: int) -> tuple[str, str]:
    """Return the number next to a residue, or the lower one of both with an insertion code if it is used."""
    used = {m.seqid for m in draft.members if m.chain_id == member.chain_id}
    number = int(member.number) + step
    lower = min(number, int(member.number))
    choices = [(number, ""), *((lower, code) for code in ascii_uppercase)]
    return next((str(n), code) for n, code in choices if f"{n}{code}" not in used)


def _remove_charged_end(end: _End) -> None:
    """Remove the hydrogens of the first N, or the last OXT with its hydrogen."""
    centre = end.member.atom("N" if end.cap == "ACE" else "OXT")
    if centre is not None:
        light = [a for a in end.member.atoms if a.is_hydrogen() and a.pos.dist(centre.pos) < _BONDED]
        removed = light if end.cap == "ACE" else [centre, *light]
        end.member.atoms = [a for a in end.member.atoms if a not in removed]
