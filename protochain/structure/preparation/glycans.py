"""Glycans that move: sugars linked to Asn, Ser, Thr and to one another, with the parameters of GLYCAM-06j.

A glycan of which any sugar or link is unknown has its own chemistry, as other molecules.
"""

import re
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from functools import cache
from typing import Any
from xml.etree import ElementTree

import gemmi
import numpy as np
from scipy.spatial import KDTree

from protochain.core.graph import components
from protochain.structure.molecule.chirality import volume
from protochain.structure.molecule.links import Link, is_metal
from protochain.structure.molecule.member import Address, Member
from protochain.structure.molecule.repairs import Kind, Repair, Why
from protochain.structure.molecule.residues import Atom
from protochain.structure.molecule.sugars import (
    GLYCOSYLATED,
    SUGARS,
    anomeric_carbon,
    glycam_code,
    glycam_names,
    letters_of,
    other_anomer,
    sugar_centres,
)
from protochain.structure.molecule.templates import GLYCAM, HAS_GLYCAM, Template
from protochain.structure.preparation.linkage import COVALENT_SLACK, SHORTEST, STATED_SLACK, is_usual
from protochain.structure.preparation.structure_draft import Changes, Draft, Evidence, Part, losses

_BEARING = {"ASN": "ND2", "SER": "OG", "THR": "OG1"}
"""Atoms of the protein that bear sugars."""
_FREE = "-ROH"
"""What the code of a sugar at a free reducing end has in addition."""
_REACH = 2.0
"""Angstrom: no bond that is looked for is longer."""

_CLEAR = 0.1
"""Angstrom by which the length of a bond may be off if the hydroxyl that it takes the place of is there."""

_Owned = tuple[Member, gemmi.Atom]


def settle(draft: Draft, parts: Sequence[Part], others: Collection[str], has_glycam: bool) -> Changes:
    """Let glycans move whose sugars and links GLYCAM-06j knows; links of others are as if stated."""
    sugars = [part for part in parts if part.members[0].name in SUGARS.keys() - {*others}]
    if not sugars:
        return
    near = _Surroundings(draft, parts, sugars)
    place = {id(part.members[0]): k for k, part in enumerate(sugars)}
    links = [link for part in sugars if (link := near.link(part.members[0])) is not None]
    for link in links:
        yield from _without_hydroxyl(link)
    pairs = [(place[id(a)], place[id(b)]) for a, b in ((x.member, x.other) for x in links) if id(a) in place]
    group = components(np.array(pairs, dtype=np.int64).reshape(-1, 2), len(sugars))
    for g in range(group.max() + 1):
        mine = [part for part, its in zip(sugars, group, strict=True) if its == g]
        own = [link for link in links if any(link.other is part.members[0] for part in mine)]
        if not own:
            continue
        codes = {id(part.members[0]): _code(part.members[0], own) for part in mine}
        why = next(near.refusals([part.members[0] for part in mine], own, codes), "")
        why = why if has_glycam else f"GLYCAM-06j goes with {HAS_GLYCAM} only"
        if why:
            # Those found by their geometry are as if the file stated them.
            draft.stated += [(x.member.address(x.atom.name), x.other.address(x.other_atom.name)) for x in own]
            continue
        draft.glycosidic += [(x.member.address(x.atom.name), x.other.address(x.other_atom.name)) for x in own]
        facts: dict[str, Any] = {"count": len(mine), "codes": (*dict.fromkeys(codes.values()),)}
        root = next((link for link in own if id(link.member) not in place), None)
        if root is not None:
            yield Repair.of(Kind.GLYCAN, atoms=root.atoms, **facts)
        else:
            yield Repair.of(Kind.SACCHARIDE, residue=mine[0].members[0].residue, **facts)
        for part in mine:
            (member,) = part.members
            part.glycam_code, part.evidence = codes[id(member)], Evidence.SUGARS
            member.source = _template(member, part.glycam_code)
            letters = letters_of(part.glycam_code)
            if letters != SUGARS[member.name]:
                yield Repair.of(Kind.OTHER_ANOMER, residue=member.residue)
            if wrong := (*_inverted(member, letters, own),):
                yield Repair.of(Kind.SUGAR_INVERTED, residue=member.residue, atoms=wrong)


def _code(member: Member, links: Sequence[Link]) -> str:
    """Code of a sugar with these bonds; of two anomers, that which its atoms are."""
    letters = SUGARS[member.name]
    if anomeric_carbon(member.name) in _inverted(member, letters, links):
        letters = other_anomer(letters)
    bearing = [link.atom for link in links if link.member is member]
    is_linked = any(link.other is member for link in links)
    hydroxyl = _hydroxyl(member)
    is_free = not is_linked and hydroxyl is not None and hydroxyl not in bearing
    return glycam_code(letters, (atom.name for atom in bearing)) + (_FREE if is_free else "")


def _hydroxyl(member: Member) -> gemmi.Atom | None:
    """Oxygen at the anomeric carbon, which a sugar has that no other residue bears."""
    return member.atom("O" + anomeric_carbon(member.name)[1:])


def _without_hydroxyl(link: Link) -> Changes:
    """Take away the oxygen at an anomeric carbon that another bond takes the place of."""
    sugar, oxygen = link.other, _hydroxyl(link.other)
    if oxygen is not None:
        lost = losses(sugar, [oxygen], Why.BONDED)
        sugar.atoms = [a for a in sugar.atoms if a is not oxygen]
        gone = (f"{oxygen.name} of {sugar.name}",)
        yield Repair.of(Kind.LINKED, lost, atoms=link.atoms, length=link.length, gone=gone)


def _inverted(member: Member, letters: str, links: Sequence[Link]) -> Iterator[str]:
    """Name the chiral atoms of a sugar whose configuration is not that of its letters."""
    acceptor = next((link.atom for link in links if link.other is member), _hydroxyl(member))
    for centre, ends in sugar_centres(letters).items():
        # The anomeric hydrogen may have no place yet; the link is on the other side.
        places = [acceptor if name == "H1" else member.atom(name) for name in (centre, *ends)]
        x = np.array([a.pos.tolist() for a in places if a is not None])
        if len(x) == 4 and (-1.0 if "H1" in ends else 1.0) * volume(x) < 0.0:
            yield centre


class _Surroundings:
    """Atoms that sugars may be bonded to, and the bonds that the file states."""

    def __init__(self, draft: Draft, parts: Sequence[Part], sugars: Sequence[Part]) -> None:
        self.sugars = {id(part.members[0]) for part in sugars}
        protein = [part for part in draft.parts if not part.obstacle]
        self.protein = {id(m) for part in protein for m in part.members}
        self.known = self.protein | self.sugars
        self.heavy: list[_Owned] = [
            (m, a)
            for part in (*protein, *parts) for m in part.members if m.name != "HOH"
            for a in m.heavy
        ]  # fmt: skip
        self.tree = KDTree([a.pos.tolist() for _, a in self.heavy])
        self.at = {m.address(a.name): (m, a) for m, a in self.heavy}
        self.stated: dict[Address, list[Address]] = {}
        for first, second in draft.stated:
            if first[:2] != second[:2]:
                self.stated.setdefault(first, []).append(second)
                self.stated.setdefault(second, []).append(first)

    def bonds_stated(self, member: Member, atom: gemmi.Atom) -> list[_Owned]:
        """Atoms of other residues, metals left out, to which the file states a bond."""
        ends = (self.at.get(each) for each in self.stated.get(member.address(atom.name), ()))
        return [end for end in ends if end is not None and not is_metal(end[1].element.name)]

    def link(self, sugar: Member) -> Link | None:
        """Bond of the anomeric carbon of a sugar, stated or else found by its length and angles."""
        carbon = sugar.atom(anomeric_carbon(sugar.name))
        if carbon is None:
            return None
        stated = self.bonds_stated(sugar, carbon)
        if stated:
            return Link(*stated[0], sugar, carbon, stated=True)
        hydroxyl = _hydroxyl(sugar)
        inner = [a for a in _inner(sugar, carbon) if a is not hydroxyl]
        if len([a for a in inner if a.element.name == "O"]) > 1:
            return None
        found = [
            link
            for link in self._pairs(sugar, carbon)
            if self._bears(link.member, link.atom)
            and (hydroxyl is None or abs(link.excess) <= _CLEAR)
            and is_usual(_inner(link.member, link.atom), link.atom, carbon)
            and is_usual(inner, carbon, link.atom)
        ]
        return min(found, key=lambda link: abs(link.excess), default=None)

    def _pairs(self, member: Member, atom: gemmi.Atom) -> list[Link]:
        """Atoms of other residues as near as bonded ones, metals left out."""
        near = (self.heavy[k] for k in sorted(self.tree.query_ball_point(atom.pos.tolist(), _REACH)))
        links = (Link(m, a, member, atom) for m, a in near if m is not member)
        return [x for x in links if not is_metal(x.atom.element.name) and abs(x.excess) <= COVALENT_SLACK]

    def _bears(self, member: Member, atom: gemmi.Atom) -> bool:
        """Whether an atom can bear a sugar."""
        if id(member) in self.protein:
            return _BEARING.get(member.name) == atom.name
        return id(member) in self.sugars and glycam_code(SUGARS[member.name], [atom.name]) in _residues()

    def refusals(
        self, members: Sequence[Member], links: Sequence[Link], codes: Mapping[int, str]
    ) -> Iterator[str]:
        """Why a glycan cannot have the parameters of GLYCAM-06j."""
        borne = Counter(id(link.atom) for link in links)
        known = {frozenset((id(link.atom), id(link.other_atom))) for link in links}
        for link in links:
            first, second = link.atoms
            if not self._bears(link.member, link.atom) or borne[id(link.atom)] > 1:
                yield f"GLYCAM-06j has no bond of {second} to {first}"
            if link.length < SHORTEST or link.excess > STATED_SLACK:
                yield f"the bond of {second} to {first} is {link.length:.2f} angstrom long"
        for member in members:
            code = codes[id(member)]
            if not any(link.other is member for link in links) and code[0] != "1" and _FREE not in code:
                yield f"{anomeric_carbon(member.name)} of {member} is bonded to no other residue"
            if code.removesuffix(_FREE) not in _residues():
                yield f"GLYCAM-06j has no residue {code}, as {member} with its bonds would be"
                continue
            there = {a.name for a in member.heavy}
            if strange := there ^ {*_template(member, code).heavy}:
                yield f"{member} has not the atoms of that name: {', '.join(sorted(strange))}"
            for atom in member.heavy:
                joined = [*self.bonds_stated(member, atom)]
                if atom.element.name in ("O", "N"):
                    # What is known to be no substituent of a sugar overlaps with it.
                    near = (x for x in self._pairs(member, atom) if id(x.member) not in self.known)
                    joined += [(x.member, x.atom) for x in near]
                for other, its in joined:
                    if frozenset((id(atom), id(its))) not in known:
                        yield (
                            f"GLYCAM-06j has no bond of {Atom(atom.name, member.residue)} to "
                            f"{Atom(its.name, other.residue)}"
                        )


def _inner(member: Member, atom: gemmi.Atom) -> list[gemmi.Atom]:
    """Heavy atoms of a residue that are as near to one of it as bonded atoms."""
    return [
        a
        for a in member.atoms
        if a is not atom and not a.is_hydrogen() and Link(member, a, member, atom).excess <= COVALENT_SLACK
    ]


@cache
def _residues() -> Mapping[str, str]:
    """Residues of GLYCAM's file, by their codes, as text."""
    return {name: text for text, name in _RESIDUE.findall(GLYCAM.read_text())}


_RESIDUE = re.compile(r'(<Residue name="(\w+)".*?</Residue>)', re.DOTALL)


@cache
def parameters(codes: frozenset[str]) -> bytes:
    """GLYCAM's file with these residues only: all take a second to read, and would replace hydroxyproline."""
    wanted = codes | {f"{end}{name}" for end in ("", "N", "C") for name in GLYCOSYLATED.values()}
    text = _RESIDUE.sub(lambda found: found[1] if found[2] in wanted else "", GLYCAM.read_text())
    free = "".join(_text(code) for code in sorted(codes) if _FREE in code)
    return text.replace("</Residues>", f"{free}</Residues>", 1).encode()


def _text(code: str) -> str:
    """Text of a residue; at a reducing end with the hydroxyl, which GLYCAM has as a residue of its own."""
    if _FREE not in code:
        return _residues()[code]
    node, hydroxyl = (ElementTree.fromstring(_residues()[name]) for name in code.split("-"))
    (end,) = (each for each in node.iterfind("ExternalBond") if each.get("atomName", "")[0] == "C")
    node.remove(end)
    node.extend([*hydroxyl.iterfind("Atom"), *hydroxyl.iterfind("Bond")])
    ElementTree.SubElement(node, "Bond", atomName1=end.get("atomName", ""), atomName2="O1")
    node.set("name", code)
    return ElementTree.tostring(node, encoding="unicode")


def _template(member: Member, code: str) -> Template:
    """Template of a sugar under the names of the PDB archive: HO4 is at O4, H61 and H62 are at C6."""
    node = ElementTree.fromstring(_text(code))
    given = {str(a.get("name")): float(a.get("charge", 0.0)) for a in node.iterfind("Atom")}
    ends = [(str(bond.get("atomName1")), str(bond.get("atomName2"))) for bond in node.iterfind("Bond")]
    called = {glycam: name for name, glycam in glycam_names(member.name).items()}
    called = {name: called.get(name, name) for name in given}
    if _FREE in code:
        called["O1"] = "O" + anomeric_carbon(member.name)[1:]
    for parent in (name for name in given if name[0] != "H"):
        light = [end for bond in ends if parent in bond for end in bond if end[0] == "H"]
        stem = "H" + called[parent].removeprefix("C")
        for k, name in enumerate(sorted(light), 1):
            called[name] = f"{stem}{k}" if len(light) > 1 else stem
    return Template(
        member.name,
        {called[name]: name[0] for name in given},
        {called[name]: charge for name, charge in given.items()},
        tuple((called[a], called[b]) for a, b in ends),
        {},
    )
