"""Mobile glycans: sugars linked to Asn, Ser, Thr and one another, with the parameters of GLYCAM-06j.

A glycan with an unknown sugar or link is parametrised like any other molecule.
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
from protochain.structure.molecule import sugars
from protochain.structure.molecule.chirality import volume
from protochain.structure.molecule.links import Link, is_metal
from protochain.structure.molecule.member import Address, Member
from protochain.structure.molecule.repairs import Kind, Reason, Repair
from protochain.structure.molecule.residues import Atom
from protochain.structure.molecule.templates import GLYCAM, HAS_GLYCAM, Template
from protochain.structure.preparation.linkage import COVALENT_SLACK, SHORTEST, STATED_SLACK, has_usual_angles
from protochain.structure.preparation.structure_draft import Changes, Draft, Evidence, Part

_BEARING_ATOMS = {"ASN": "ND2", "SER": "OG", "THR": "OG1"}  # Protein atoms that bear sugars.
_REDUCING = "-ROH"  # Suffix of the code of a sugar at a free reducing end.
_REACH = 2.0  # Angstrom: search radius of bonds.
_RESIDUE = re.compile(r'(<Residue name="(\w+)".*?</Residue>)', re.DOTALL)
_MAX_DEVIATION = 0.1
"""Angstrom: largest deviation of a bond's length if the hydroxyl that the bond replaces is present."""

_OwnedAtom = tuple[Member, gemmi.Atom]


def select_glycans(draft: Draft, parts: Sequence[Part], names: Collection[str], has_glycam: bool) -> Changes:
    """Make glycans mobile if GLYCAM-06j has their sugars and links. Sugars with these names are skipped."""
    sugar_parts = [part for part in parts if part.members[0].name in sugars.SUGARS.keys() - {*names}]
    if not sugar_parts:
        return
    surroundings = _Surroundings(draft, parts, sugar_parts)
    row = {id(part.members[0]): k for k, part in enumerate(sugar_parts)}
    links = [link for part in sugar_parts if (link := surroundings.link(part.members[0])) is not None]
    for link in links:
        yield from _remove_hydroxyl(link)
    pairs = [(row[id(a)], row[id(b)]) for a, b in ((x.member, x.hetero) for x in links) if id(a) in row]
    group = components(np.array(pairs, dtype=np.int64).reshape(-1, 2), len(sugar_parts))
    for g in range(group.max() + 1):
        glycan = [part for part, index in zip(sugar_parts, group, strict=True) if index == g]
        bonds = [link for link in links if any(link.hetero is part.members[0] for part in glycan)]
        if not bonds:
            continue
        codes = {id(part.members[0]): _sugar_code(part.members[0], bonds) for part in glycan}
        refusal = next(surroundings.refusals([part.members[0] for part in glycan], bonds, codes), "")
        refusal = refusal if has_glycam else f"GLYCAM-06j goes with {HAS_GLYCAM} only"
        # Bonds found by geometry count as bonds that the file states.
        ends = [(x.member.address(x.atom.name), x.hetero.address(x.hetero_atom.name)) for x in bonds]
        if refusal:
            draft.stated_bonds += ends
            continue
        draft.glycosidic += ends
        facts: dict[str, Any] = {"count": len(glycan), "codes": (*dict.fromkeys(codes.values()),)}
        root = next((link for link in bonds if id(link.member) not in row), None)
        if root is not None:
            yield Repair.of(Kind.GLYCAN, atoms=root.atoms, **facts)
        else:
            yield Repair.of(Kind.SACCHARIDE, residue=glycan[0].members[0].residue, **facts)
        for part in glycan:
            (member,) = part.members
            part.glycam_code, part.evidence = codes[id(member)], Evidence.SUGARS
            member.source = _template(member, part.glycam_code)
            letters = sugars.letters_of(part.glycam_code)
            if letters != sugars.SUGARS[member.name]:
                yield Repair.of(Kind.OTHER_ANOMER, residue=member.residue)
            if inverted := (*_inverted_atoms(member, letters, bonds),):
                yield Repair.of(Kind.SUGAR_INVERTED, residue=member.residue, atoms=inverted)


def _sugar_code(member: Member, links: Sequence[Link]) -> str:
    """Return the GLYCAM code of a sugar with these bonds. Its atoms determine the anomer."""
    letters = sugars.SUGARS[member.name]
    if sugars.anomeric_carbon(member.name) in _inverted_atoms(member, letters, links):
        letters = sugars.other_anomer(letters)
    bearing = [link.atom for link in links if link.member is member]
    is_linked = any(link.hetero is member for link in links)
    hydroxyl = _hydroxyl(member)
    is_free = not is_linked and hydroxyl is not None and hydroxyl not in bearing
    return sugars.glycam_code(letters, (atom.name for atom in bearing)) + (_REDUCING if is_free else "")


def _hydroxyl(member: Member) -> gemmi.Atom | None:
    """Return the oxygen at the anomeric carbon, which only a sugar without an acceptor residue has."""
    return member.atom("O" + sugars.anomeric_carbon(member.name)[1:])


def _remove_hydroxyl(link: Link) -> Changes:
    """Remove the oxygen at an anomeric carbon if another bond replaces it."""
    sugar, oxygen = link.hetero, _hydroxyl(link.hetero)
    if oxygen is not None:
        lost = sugar.losses([oxygen], Reason.BONDED)
        sugar.atoms = [a for a in sugar.atoms if a is not oxygen]
        removed = (f"{oxygen.name} of {sugar.name}",)
        yield Repair.of(Kind.LINKED, lost, atoms=link.atoms, length=link.length, gone=removed)


def _inverted_atoms(member: Member, letters: str, links: Sequence[Link]) -> Iterator[str]:
    """Yield the chiral atoms of a sugar whose configuration contradicts its letters."""
    acceptor = next((link.atom for link in links if link.hetero is member), _hydroxyl(member))
    for centre, ends in sugars.sugar_centres(letters).items():
        # The anomeric hydrogen may have no position yet. The link is on the opposite side.
        atoms = [acceptor if name == "H1" else member.atom(name) for name in (centre, *ends)]
        x = np.array([a.pos.tolist() for a in atoms if a is not None])
        if len(x) == 4 and (-1.0 if "H1" in ends else 1.0) * volume(x) < 0.0:
            yield centre


class _Surroundings:
    """Atoms that may be bonded to sugars, and the bonds that the file states."""

    def __init__(self, draft: Draft, parts: Sequence[Part], sugar_parts: Sequence[Part]) -> None:
        self.sugars = {id(part.members[0]) for part in sugar_parts}
        protein = [part for part in draft.parts if not part.obstacle]
        self.protein = {id(m) for part in protein for m in part.members}
        self.residues = self.protein | self.sugars
        self.heavy: list[_OwnedAtom] = [
            (m, a)
            for part in (*protein, *parts) for m in part.members if m.name != "HOH"
            for a in m.heavy
        ]  # fmt: skip
        self.tree = KDTree([a.pos.tolist() for _, a in self.heavy])
        self.at = {m.address(a.name): (m, a) for m, a in self.heavy}
        self.stated: dict[Address, list[Address]] = {}
        for first, second in draft.stated_bonds:
            if first[:2] != second[:2]:
                self.stated.setdefault(first, []).append(second)
                self.stated.setdefault(second, []).append(first)

    def stated_partners(self, member: Member, atom: gemmi.Atom) -> list[_OwnedAtom]:
        """Return the atoms of other residues, except metals, to which the file states a bond."""
        ends = (self.at.get(address) for address in self.stated.get(member.address(atom.name), ()))
        return [end for end in ends if end is not None and not is_metal(end[1].element.name)]

    def link(self, sugar: Member) -> Link | None:
        """Return the bond of a sugar's anomeric carbon: stated, or else found by length and angles."""
        carbon = sugar.atom(sugars.anomeric_carbon(sugar.name))
        if carbon is None:
            return None
        stated = self.stated_partners(sugar, carbon)
        if stated:
            return Link(*stated[0], sugar, carbon, stated=True)
        hydroxyl = _hydroxyl(sugar)
        inner = [a for a in _bonded_atoms(sugar, carbon) if a is not hydroxyl]
        if len([a for a in inner if a.element.name == "O"]) > 1:
            return None
        candidates = [
            link
            for link in self._pairs(sugar, carbon)
            if self._can_bear(link.member, link.atom)
            and (hydroxyl is None or abs(link.excess) <= _MAX_DEVIATION)
            and has_usual_angles(_bonded_atoms(link.member, link.atom), link.atom, carbon)
            and has_usual_angles(inner, carbon, link.atom)
        ]
        return min(candidates, key=lambda link: abs(link.excess), default=None)

    def _pairs(self, member: Member, atom: gemmi.Atom) -> list[Link]:
        """Return links to the atoms of other residues at bond distance, except metals."""
        near = (self.heavy[k] for k in sorted(self.tree.query_ball_point(atom.pos.tolist(), _REACH)))
        links = (Link(m, a, member, atom) for m, a in near if m is not member)
        return [x for x in links if not is_metal(x.atom.element.name) and abs(x.excess) <= COVALENT_SLACK]

    def _can_bear(self, member: Member, atom: gemmi.Atom) -> bool:
        """Whether an atom can bear a sugar."""
        if id(member) in self.protein:
            return _BEARING_ATOMS.get(member.name) == atom.name
        if id(member) not in self.sugars:
            return False
        return sugars.glycam_code(sugars.SUGARS[member.name], [atom.name]) in _residues()

    def refusals(
        self, members: Sequence[Member], links: Sequence[Link], codes: Mapping[int, str]
    ) -> Iterator[str]:
        """Yield the reasons why GLYCAM-06j cannot parametrise a glycan."""
        n_sugars = Counter(id(link.atom) for link in links)
        modelled = {frozenset((id(link.atom), id(link.hetero_atom))) for link in links}
        for link in links:
            first, second = link.atoms
            if not self._can_bear(link.member, link.atom) or n_sugars[id(link.atom)] > 1:
                yield f"GLYCAM-06j has no bond of {second} to {first}"
            if link.length < SHORTEST or link.excess > STATED_SLACK:
                yield f"the bond of {second} to {first} is {link.length:.2f} angstrom long"
        for member in members:
            code = codes[id(member)]
            if not any(link.hetero is member for link in links) and code[0] != "1" and _REDUCING not in code:
                yield f"{sugars.anomeric_carbon(member.name)} of {member} is bonded to no other residue"
            if code.removesuffix(_REDUCING) not in _residues():
                yield f"GLYCAM-06j has no residue {code}, as {member} with its bonds would be"
                continue
            heavy_names = {a.name for a in member.heavy}
            if differences := heavy_names ^ {*_template(member, code).heavy}:
                yield f"{member} has not the atoms of that name: {', '.join(sorted(differences))}"
            for atom in member.heavy:
                partners = [*self.stated_partners(member, atom)]
                if atom.element.name in ("O", "N"):
                    # Protein residues and sugars at bond distance overlap, and are not substituents.
                    neighbours = (x for x in self._pairs(member, atom) if id(x.member) not in self.residues)
                    partners += [(x.member, x.atom) for x in neighbours]
                for partner, partner_atom in partners:
                    if frozenset((id(atom), id(partner_atom))) not in modelled:
                        yield (
                            f"GLYCAM-06j has no bond of {Atom(atom.name, member.residue)} to "
                            f"{Atom(partner_atom.name, partner.residue)}"
                        )


def _bonded_atoms(member: Member, atom: gemmi.Atom) -> list[gemmi.Atom]:
    """Return the heavy atoms of a residue at bond distance from one of its atoms."""
    others = (a for a in member.heavy if a is not atom)
    return [a for a in others if Link(member, a, member, atom).excess <= COVALENT_SLACK]


@cache
def _residues() -> Mapping[str, str]:
    """Return the text of each residue of GLYCAM's file, by code."""
    return {name: text for text, name in _RESIDUE.findall(GLYCAM.read_text())}


@cache
def parameters(codes: frozenset[str]) -> bytes:
    """Return GLYCAM's file with these residues only. All residues are slow, and replace hydroxyproline."""
    names = codes | {f"{end}{name}" for end in ("", "N", "C") for name in sugars.GLYCOSYLATED.values()}
    text = _RESIDUE.sub(lambda match: match[1] if match[2] in names else "", GLYCAM.read_text())
    free = "".join(_residue_text(code) for code in sorted(codes) if _REDUCING in code)
    return text.replace("</Residues>", f"{free}</Residues>", 1).encode()


def _residue_text(code: str) -> str:
    """Return the text of a residue. A reducing end includes the hydroxyl, a separate GLYCAM residue."""
    if _REDUCING not in code:
        return _residues()[code]
    node, hydroxyl = (ElementTree.fromstring(_residues()[name]) for name in code.split("-"))
    (end,) = (bond for bond in node.iterfind("ExternalBond") if bond.get("atomName", "")[0] == "C")
    node.remove(end)
    node.extend([*hydroxyl.iterfind("Atom"), *hydroxyl.iterfind("Bond")])
    ElementTree.SubElement(node, "Bond", atomName1=end.get("atomName", ""), atomName2="O1")
    node.set("name", code)
    return ElementTree.tostring(node, encoding="unicode")


def _template(member: Member, code: str) -> Template:
    """Return the template of a sugar with names of the PDB archive: HO4 is at O4, H61 and H62 are at C6."""
    node = ElementTree.fromstring(_residue_text(code))
    charges = {str(a.get("name")): float(a.get("charge", 0.0)) for a in node.iterfind("Atom")}
    ends = [(str(bond.get("atomName1")), str(bond.get("atomName2"))) for bond in node.iterfind("Bond")]
    pdb_name = {glycam: name for name, glycam in sugars.glycam_names(member.name).items()}
    pdb_name = {name: pdb_name.get(name, name) for name in charges}
    if _REDUCING in code:
        pdb_name["O1"] = "O" + sugars.anomeric_carbon(member.name)[1:]
    for parent in (name for name in charges if name[0] != "H"):
        hydrogens = [end for bond in ends if parent in bond for end in bond if end[0] == "H"]
        stem = "H" + pdb_name[parent].removeprefix("C")
        for k, name in enumerate(sorted(hydrogens), 1):
            pdb_name[name] = f"{stem}{k}" if len(hydrogens) > 1 else stem
    elements = {pdb_name[name]: name[0] for name in charges}
    charges = {pdb_name[name]: charge for name, charge in charges.items()}
    return Template(member.name, elements, charges, tuple((pdb_name[a], pdb_name[b]) for a, b in ends))
