"""Bonds between the protein and the molecules kept beside it: metal sites, glycans, covalent ligands.

Force fields have no parameters for them. Each is held at the input's distance and angles by springs, and the
atoms it joins do not repel one another.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import gemmi
import numpy as np
from scipy.spatial import KDTree

from protochain.arrays import Floats, Integers
from protochain.structure.draft import Draft, Member
from protochain.structure.kept import JOINED
from protochain.structure.model import Tie

_OXYGEN_DISTANCE = {
    "Na": 2.38, "Mg": 2.07, "K": 2.74, "Ca": 2.36, "Mn": 2.15, "Fe": 2.04, "Co": 2.05, "Ni": 2.06,
    "Cu": 1.99, "Zn": 1.99,
}  # fmt: skip
"""Angstrom, usual distance of oxygen in proteins: Harding, Acta Cryst. D62:678 (2006); Ni by its radius."""
_OTHER_METAL = 2.3
"""Angstrom: of metals that are not in the table."""
_SLACK = {"O": 0.5, "N": 0.5, "S": 0.75, "Se": 0.85}
"""Angstrom beyond the usual distance of oxygen up to which a donor is bonded; sulphur is larger."""
STATED = 3.3
"""Angstrom: bonds that the file states are believed up to this length."""
_COVALENT_SLACK = 0.3
"""Angstrom beyond the sum of the covalent radii up to which other atoms are bonded."""
_OVERLAP = 0.8
"""Angstrom: atoms nearer than this lie on one another and are no bond."""
_STRAIGHT = np.deg2rad(170.0)
"""Angles beyond this get no spring, whose force would have no direction."""

_METAL_BOND, _METAL_ANGLE, _DONOR_ANGLE = 8.0e4, 300.0, 540.0
"""kJ/mol/nm^2, kJ/mol/rad^2: angles are those of Zn(CYS)4 in ZAFF (Peters, Yang, Wang, Fusti-Molnar, Weaver,
Merz, J. Chem. Theory Comput. 6:2935, 2010: S-Zn-S 299, C-S-Zn 539). Its bond has 2.7e4; three times that
keeps the distances of the input where charges pull."""
_BOND, _ANGLE = 2.7e5, 500.0
"""kJ/mol/nm^2, kJ/mol/rad^2: of the size of bonds and angles between first-row atoms in ff14SB."""


@dataclass(frozen=True, eq=False)
class Link:
    """Bond of an atom of the protein to an atom kept beside it.

    Parameters
    ----------
    member : Member
    atom : gemmi.Atom
    other : Member
        Kept beside the protein.
    other_atom : gemmi.Atom
    """

    member: Member
    atom: gemmi.Atom
    other: Member
    other_atom: gemmi.Atom

    @property
    def is_metal(self) -> bool:
        """Whether a metal is bonded."""
        return is_metal(self.other_atom.element.name)


def is_metal(symbol: str) -> bool:
    """Whether an element is a metal."""
    return bool(gemmi.Element(symbol).is_metal)


def find_links(draft: Draft) -> list[Link]:
    """Find the bonds between protein and obstacles, tell the residues about them, and report them.

    Parameters
    ----------
    draft : Draft

    Returns
    -------
    list of Link
    """
    beside = [
        (member, a)
        for part in draft.parts if part.obstacle for member in part.members if member.name != "HOH"
        for a in _heavy(member)
    ]  # fmt: skip
    if not beside:
        return []
    tree = KDTree([a.pos.tolist() for _, a in beside])
    links = []
    for part in draft.parts:
        for member in [] if part.obstacle else part.members:
            for a in member.atoms:
                if a.is_hydrogen():
                    continue
                for k in sorted(tree.query_ball_point(a.pos.tolist(), STATED)):
                    link = Link(member, a, *beside[k])
                    if _is_bonded(draft, link):
                        links.append(link)
    sites: dict[int, list[Link]] = {}
    for link in links:
        (link.member.metals if link.is_metal else link.member.links).append(link.atom)
        sites.setdefault(id(link.other_atom), []).append(link)
    for site in sites.values():
        ends = ", ".join(
            f"{each.atom.name} of {each.member} ({each.atom.pos.dist(each.other_atom.pos):.2f} angstrom)"
            for each in site
        )
        how = "coordinated by" if site[0].is_metal else "bonded to"
        along = ", and moves with them" if moves(draft, site[0].other, links) else ""
        draft.repairs.append(
            f"{site[0].other_atom.name} of {site[0].other} is {how} {ends}: held at these distances by "
            f"springs{along}"
        )
    return links


def stated_beside(draft: Draft) -> list[Link]:
    """Bonds between residues kept beside the protein that the file states, and that are short enough."""
    there = {
        (member.chain_id, member.seqid, atom.name): (member, atom)
        for part in draft.parts if part.obstacle for member in part.members for atom in member.atoms
    }  # fmt: skip
    pairs = {frozenset(ends) for ends in draft.stated if all(end in there for end in ends)}
    links = (Link(*there[first], *there[second]) for first, second in sorted(map(sorted, pairs)))
    return [link for link in links if link.atom.pos.dist(link.other_atom.pos) <= STATED]


def moves(draft: Draft, member: Member, links: Sequence[Link]) -> bool:
    """Whether a kept molecule moves: an ion that the protein alone holds."""
    ion = member.atoms[0]
    if len(member.atoms) > 1 or not any(link.other_atom is ion and link.is_metal for link in links):
        return False
    others = (m for part in draft.parts if part.obstacle for m in part.members if m is not member)
    # Hydrogens have no positions yet.
    heavy = (a for m in others for a in m.atoms if not a.is_hydrogen())
    return all(ion.pos.dist(a.pos) > STATED for a in heavy)


def settle_mobile(draft: Draft, links: Sequence[Link]) -> None:
    """Leave mobile only molecules that are whole, not bonded to the protein or another, and report them."""
    tied = {id(link.other) for link in links}
    beside = [(part, a) for part in draft.parts if part.obstacle for m in part.members for a in _heavy(m)]
    tree = KDTree([a.pos.tolist() for _, a in beside]) if beside else None
    names: Counter[str] = Counter()
    for part in draft.parts:
        if tree is None or not part.mobile:
            continue
        near = {
            k for m in part.members for a in _heavy(m) for k in tree.query_ball_point(a.pos.tolist(), JOINED)
        }
        if any(beside[k][0] is not part for k in near) or tied & {id(m) for m in part.members}:
            part.mobile = False
            draft.repairs.append(
                f"{part.members[0]} stays in place, though the force field has its parameters: it is bonded "
                "to another molecule"
            )
        else:
            names[part.members[0].name] += 1
    if names:
        said = ", ".join(f"{count} {name}" for name, count in names.items())
        draft.repairs.append(
            f"{said} with parameters of the force field: free to move, in torsions as a rigid body"
        )


def _heavy(member: Member) -> list[gemmi.Atom]:
    return [a for a in member.atoms if not a.is_hydrogen()]


def _is_bonded(draft: Draft, link: Link) -> bool:
    first, second = link.atom, link.other_atom
    distance = first.pos.dist(second.pos)
    if distance < _OVERLAP:
        return False
    if draft.states(
        *(
            (member.chain_id, member.seqid, a.name)
            for member, a in ((link.member, first), (link.other, second))
        )
    ):
        return True
    if link.is_metal:
        usual = _OXYGEN_DISTANCE.get(second.element.name, _OTHER_METAL)
        slack = _SLACK.get(first.element.name)
        # An amide nitrogen of the chain has no free pair of electrons.
        is_amide = first.name == "N" and bool(link.member.atom("CA"))
        return slack is not None and not is_amide and distance <= usual + slack
    return distance <= first.element.covalent_r + second.element.covalent_r + _COVALENT_SLACK


def ties(
    links: Sequence[Link],
    at: Mapping[int, Mapping[str, int]],
    x: Floats,
    element: Sequence[str],
    bonds: Integers,
) -> tuple[Tie, ...]:
    """Springs that hold the bonds at the distances and angles of the input.

    Parameters
    ----------
    links : sequence of Link
    at : mapping of int to mapping of str to int
        Index of each atom, by ``id`` of its residue and by name.
    x : (na, 3) float, nm
    element : sequence of str
    bonds : (n, 2) int
        With those of the links.

    Returns
    -------
    tuple of Tie
    """
    neighbours: dict[int, list[int]] = {}
    for first, second in bonds.tolist():
        if "H" not in (element[first], element[second]):
            neighbours.setdefault(first, []).append(second)
            neighbours.setdefault(second, []).append(first)
    found: dict[tuple[int, ...], float] = {}
    own = {at[id(link.member)][link.atom.name] for link in links}
    for link in links:
        mine = at[id(link.member)][link.atom.name]
        its = at[id(link.other)][link.other_atom.name]
        found[mine, its] = _METAL_BOND if link.is_metal else _BOND
        for k in neighbours[mine]:
            if k != its:
                found[k, mine, its] = _DONOR_ANGLE if link.is_metal else _ANGLE
        for j, k in combinations(sorted(neighbours[its]), 2):
            if mine in (j, k) and (j in own or k in own):
                found[j, its, k] = _METAL_ANGLE if link.is_metal else _ANGLE
    made = (Tie(atoms, measure(x[list(atoms)]), stiffness) for atoms, stiffness in found.items())
    return tuple(tie for tie in made if len(tie.atoms) == 2 or tie.rest < _STRAIGHT)


def measure(x: Floats) -> float:
    """Distance of two points (nm), or angle at the middle one of three (rad)."""
    if len(x) == 2:
        return float(np.linalg.norm(x[1] - x[0]))
    u, v = x[0] - x[1], x[2] - x[1]
    return float(np.arctan2(np.linalg.norm(np.cross(u, v)), u @ v))
