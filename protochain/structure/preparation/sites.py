"""Bonds between the protein and the molecules kept with it: metal sites, glycans, covalent ligands.

Force fields have no parameters for them. Each is held at the input's distance and angles by springs, and the
atoms it joins do not repel one another.
"""

from collections import Counter
from collections.abc import Generator, Iterable, Iterator, Mapping, Sequence
from itertools import combinations, pairwise

import gemmi
import numpy as np
from scipy.spatial import KDTree

from protochain.core.arrays import Floats, Integers
from protochain.core.checks import NO_BONDS
from protochain.core.errors import Argument, StructureError
from protochain.core.graph import neighbours
from protochain.structure.formats.tie_records import DIGITS
from protochain.structure.molecule.links import Link, is_metal, usual_length
from protochain.structure.molecule.member import Address, Member
from protochain.structure.molecule.model import Tie
from protochain.structure.molecule.repairs import Apart, Count, Kind, Repair
from protochain.structure.preparation.hetero_molecules import JOINED
from protochain.structure.preparation.linkage import COVALENT_SLACK, STATED, bonds_and_overlaps
from protochain.structure.preparation.structure_draft import Changes, Contacts, Draft, Evidence, Part

_BEYOND = 0.25
"""Angstrom: a covalent bond that is off by more is drawn to its usual length."""
_LEAST, _MOST = np.deg2rad(90.0), np.deg2rad(140.0)
"""Angles of a covalent bond that are beyond these are drawn to them."""
_STRAIGHT = np.deg2rad(170.0)
"""Angles beyond this get no spring, whose force would have no direction."""
_NEAREST = 2.5
"""Angstrom: no atoms of the protein further apart are as near as bonded ones, but two of selenium."""
_SHELL = {"Na": 5, "Mg": 6, "K": 6, "Ca": 6, "Mn": 6}
_OTHER_SHELL = 4
"""Donors that hold an ion on all sides (Harding, Acta Cryst. D60:849, 2004)."""

_METAL_BOND, _METAL_ANGLE, _DONOR_ANGLE = 4.8e5, 300.0, 540.0
"""kJ/mol/nm^2, kJ/mol/rad^2: angles are those of Zn(CYS)4 in ZAFF (Peters, Yang, Wang, Fusti-Molnar, Weaver,
Merz, J. Chem. Theory Comput. 6:2935, 2010: S-Zn-S 299, C-S-Zn 539). Its bond, 2.7e4, gives way to charges by
0.2 angstrom. That of C=O in ff14SB gives way by less than 0.05, also to a porphyrin of another size."""
_BOND, _ANGLE = 2.7e5, 500.0
"""kJ/mol/nm^2, kJ/mol/rad^2: of the size of bonds and angles between first-row atoms in ff14SB."""

DISULFIDE = 3.0
"""Angstrom: sulphurs nearer than this are bonded, as in OpenMM (a disulfide bond is 2.05)."""
Bridge = tuple[Member, Member]


def find_links(draft: Draft) -> tuple[()]:
    """Find the bonds of the protein with molecules outside it, and the atoms of both that overlap."""
    protein, beside = (
        [(m, a) for part in draft.parts if part.obstacle is kept for m in part.members if m.name != "HOH"
         for a in m.heavy]
        for kept in (False, True)
    )  # fmt: skip
    free = {*draft.glycosidic}
    near = [link for link in _near(draft, protein, beside) if _ends(link) not in free]
    # A result says which bonds its molecules have.
    words = {link for link in near if draft.says_of(link.other) and (link.is_metal or not _has_metal(link))}
    sprung = {link for link in words if _ends(link) in draft.springs}
    refused = list[tuple[Link, str]]()
    overlapping = list[Link]()
    bonded = {*sprung}
    if pairs := [link for link in near if not link.is_metal and link not in sprung]:
        close = bonds_and_overlaps(draft, pairs)
        refused, overlapping, bonded = close.refused, close.overlapping, {*close.bonded} - words | sprung
    refused = [*refused, *_far(draft, protein, beside)]
    for link in near:
        if link in words:
            continue
        if link.is_metal and link.is_coordinated:
            bonded.add(link)
        elif link.is_metal and link.stated:
            refused.append((link, f"it is {link.length:.2f} angstrom long"))
    draft.links = [link for link in near if link in bonded]
    draft.contacts = Contacts(protein, [link for link in near if link in sprung], refused, overlapping)
    for link in draft.links:
        (link.member.metals if link.is_metal else link.member.links).append(link.atom)
    return ()


def report_links(draft: Draft) -> Changes:
    """Report the bonds that springs hold, those that are ignored, and overlaps."""
    sites: dict[int, list[Link]] = {}
    for link in draft.links:
        sites.setdefault(id(link.other_atom), []).append(link)
    for site in sites.values():
        kind = Kind.COORDINATED if site[0].is_metal else Kind.BONDED
        if moves(draft, site[0].other, draft.links):
            kind = Kind.ION_MOVES
        elif site[0].is_metal and len(site[0].other.atoms) == 1:
            kind = Kind.ION_HELD
        yield _report_site(kind, site)
    for link, why in draft.contacts.refused:
        yield Repair.of(Kind.BOND_IGNORED, atoms=link.atoms, why=why)
    if overlapping := [*draft.contacts.overlapping, *_within(draft, draft.contacts.protein)]:
        pairs = tuple(Apart(link.atoms, link.length) for link in overlapping)
        yield Repair.of(Kind.NEAR, count=len(pairs), pairs=pairs)


def _report_site(kind: Kind, site: Sequence[Link]) -> Repair:
    """Report the bonds of an atom outside the protein."""
    ends = tuple(Apart(each.atoms[:1], each.length) for each in site)
    return Repair.of(kind, atom=site[0].atoms[1], ends=ends)


def _has_metal(link: Link) -> bool:
    """Whether springs of a metal, which a result has, are no word on the other bonds of its residue."""
    return len(link.other.atoms) > 1 and any(a.element.is_metal for a in link.other.atoms)


_Owned = Sequence[tuple[Member, gemmi.Atom]]


def _near(draft: Draft, protein: _Owned, beside: _Owned) -> list[Link]:
    """Pairs that may be bonded: as near as bonded atoms, or nearer than stated bonds may be."""
    if not (protein and beside):
        return []
    tree, bonds = KDTree([a.pos.tolist() for _, a in beside]), {*draft.stated}
    found = []
    near = tree.query_ball_point([a.pos.tolist() for _, a in protein], STATED, return_sorted=True)
    for (member, a), places in zip(protein, near, strict=True):
        for k in places:
            other, its = beside[k]
            ends = member.address(a.name), other.address(its.name)
            link = Link(member, a, other, its, ends in bonds or ends[::-1] in bonds)
            if link.stated or link.is_metal or link.excess <= COVALENT_SLACK:
                found.append(link)
    return found


def _within(draft: Draft, protein: _Owned) -> Iterator[Link]:
    """Pairs of the protein as near as bonded atoms, of residues that nothing joins; disulfides come later."""
    if not protein:
        return
    number = {id(m): r for r, m in enumerate(draft.members)}
    joined = {frozenset(link.owners) for made in draft.fragments for link in made.bonds}
    joined |= {frozenset((id(p.members[0]), id(p.members[-1]))) for p in draft.parts if p.cyclic}
    owner = np.array([number[id(m)] for m, _ in protein])
    pairs = KDTree([a.pos.tolist() for _, a in protein]).query_pairs(_NEAREST, output_type="ndarray")
    for i, j in sorted(pairs[np.abs(owner[pairs[:, 0]] - owner[pairs[:, 1]]) > 1].tolist()):
        link = Link(*protein[i], *protein[j])
        is_bond = frozenset(link.owners) in joined or link.atom.name == link.other_atom.name == "SG"
        if not is_bond and link.excess <= COVALENT_SLACK:
            yield link


def _far(draft: Draft, protein: _Owned, beside: _Owned) -> Iterator[tuple[Link, str]]:
    """Bonds between the protein and others that the file states, and that are no bonds by their length."""
    if not draft.stated:
        return
    mine, its = ({m.address(a.name): (m, a) for m, a in atoms} for atoms in (protein, beside))
    for ends in draft.stated:
        for first, second in (ends, ends[::-1]):
            if first in mine and second in its:
                link = Link(*mine[first], *its[second], stated=True)
                if link.length > STATED:
                    yield link, f"it is {link.length:.2f} angstrom long"


def _ends(link: Link) -> tuple[Address, Address]:
    """Addresses of its atoms, the protein's first."""
    return link.member.address(link.atom.name), link.other.address(link.other_atom.name)


def list_bonds(draft: Draft) -> Changes:
    """List the bonds that are not along a chain; report molecules that move, and unused bonds."""
    beside, sugars = stated_beside(draft), _glycosidic(draft)
    yield from _settle_mobile(draft)
    draft.links += _strand_links(draft)
    draft.other_links = [*sugars, *(link for made in draft.fragments for link in made.bonds)]
    draft.metal_links = _metal_links(draft)
    sites: dict[int, list[Link]] = {}
    for link in draft.metal_links:
        if link.member is not link.other:
            sites.setdefault(id(link.other_atom), []).append(link)
    for site in sites.values():
        yield _report_site(Kind.ION_HELD if len(site[0].other.atoms) == 1 else Kind.COORDINATED, site)
    yield from _report_unused(draft, [*draft.links, *draft.other_links, *beside, *draft.metal_links])


def _settle_mobile(draft: Draft) -> Changes:
    """Leave mobile only molecules that are whole, not bonded to the protein or another, and report them."""
    tied = {id(link.other) for link in draft.links}
    bonded = {id(link.other) for link in draft.links if not link.is_metal}
    beside = [(part, a) for part, _, a in beside_of(draft)]
    tree = KDTree([a.pos.tolist() for _, a in beside]) if beside else None
    framed = {id(m) for made in draft.fragments for m, _ in made.owners}
    names: Counter[str] = Counter()
    for part in draft.parts:
        is_framed = not part.is_strand and id(part.members[0]) in framed
        if tree is None or not part.mobile or part.glycam_code or is_framed:
            continue
        # Of a whole molecule near others are no bonds.
        joined = part.ligand is None and not part.is_strand and any(
            beside[k][0] is not part
            for m in part.members for a in m.heavy for k in tree.query_ball_point(a.pos.tolist(), JOINED)
        )  # fmt: skip
        if joined or (tied if part.ligand is None else bonded) & {id(m) for m in part.members}:
            part.evidence = Evidence.BONDED
            yield Repair.of(Kind.STAYS, residue=part.members[0].residue)
        elif part.is_strand:
            first, last = part.members[0].residue, part.members[-1].residue
            yield Repair.of(Kind.STRAND, first=first, last=last, count=len(part.members))
        elif part.ligand is None:
            names[part.members[0].name] += 1
    if names:
        yield Repair.of(Kind.MOBILE, counts=tuple(Count(n, name) for name, n in names.items()))


def _report_unused(draft: Draft, used: Iterable[Link]) -> Changes:
    """Report the bonds of the file that are neither used nor reported: too long, or to what is left out."""
    if not draft.stated:
        return
    there = {m.address(a.name): (m, a) for m in draft.members for a in m.atoms}
    noted = {frozenset(repair.facts["atoms"]) for repair in draft.repairs if repair.kind is Kind.BOND_IGNORED}
    done = {frozenset(link.atoms) for link in used} | noted
    gone = 0
    for first, second in dict.fromkeys((min(ends), max(ends)) for ends in draft.stated):
        if not {first, second} <= there.keys():
            gone += 1
            continue
        link = Link(*there[first], *there[second])
        is_chains = {first[2], second[2]} in ({"C", "N"}, {"O3'", "P"}) and link.length <= STATED
        # Those of cysteines are told with disulfides.
        is_chains |= {first[2], second[2]} == {"SG"} and not (link.member.metals or link.other.metals)
        if not is_chains and link.member is not link.other and frozenset(link.atoms) not in done:
            yield Repair.of(Kind.BOND_IGNORED, atoms=link.atoms, why=f"it is {link.length:.2f} angstrom long")
    if gone:
        yield Repair.of(Kind.BONDS_LEFT_OUT, count=gone)


def _glycosidic(draft: Draft) -> list[Link]:
    """Bonds of the glycans that move, and tell the residues of the protein about them."""
    if not draft.glycosidic:
        return []
    there = {member.address(atom.name): (member, atom) for member in draft.members for atom in member.atoms}
    links = [Link(*there[first], *there[second]) for first, second in draft.glycosidic]
    for link in links:
        link.member.links.append(link.atom)
    return links


def stated_beside(draft: Draft) -> list[Link]:
    """Bonds between residues kept with the protein that the file states, and that are short enough."""
    there = {
        member.address(atom.name): (member, atom)
        for part in draft.parts if part.obstacle for member in part.members for atom in member.atoms
    }  # fmt: skip
    pairs = {frozenset(ends) for ends in draft.stated if {*ends} <= there.keys()}
    links = (Link(*there[first], *there[second]) for first, second in sorted(map(sorted, pairs)))
    return [link for link in links if link.atom.pos.dist(link.other_atom.pos) <= STATED]


def moves(draft: Draft, member: Member, links: Sequence[Link]) -> bool:
    """Whether a kept molecule moves: an ion that the protein alone holds, on all sides."""
    ion = member.atoms[0]
    donors = sum(link.other_atom is ion and link.is_metal for link in links)
    if len(member.atoms) > 1 or donors < _SHELL.get(ion.element.name, _OTHER_SHELL):
        return False
    if draft.says_of(member):
        return not draft.says_stays(member)
    others = (m for part in draft.parts if part.obstacle for m in part.members if m is not member)
    # Hydrogens have no positions yet.
    heavy = (a for m in (*others, *draft.absent) for a in m.heavy)
    return all(ion.pos.dist(a.pos) > STATED for a in heavy)


def beside_of(draft: Draft) -> list[tuple[Part, Member, gemmi.Atom]]:
    """Heavy atoms of the molecules kept with the protein."""
    return [(part, m, a) for part in draft.parts if part.obstacle for m in part.members for a in m.heavy]


def _strand_links(draft: Draft) -> list[Link]:
    """Bonds between strands that move and the nucleotides within them that stay in place."""
    found = []
    for before, after in pairwise(part for part in draft.parts if part.obstacle):
        (end, o3), (start, p) = (
            (m, m.atom(name)) for m, name in ((before.members[-1], "O3'"), (after.members[0], "P"))
        )
        if o3 and p and before.mobile != after.mobile:
            if before.mobile and o3 in end.links:
                found.append(Link(end, o3, start, p))
            elif after.mobile and p in start.links:
                found.append(Link(start, p, end, o3))
    return found


def _metal_links(draft: Draft) -> list[Link]:
    """Bonds of metals to donors outside the protein, also of one residue, if the metal or donor moves."""
    atoms = beside_of(draft)
    metals = [(m, a) for _, m, a in atoms if is_metal(a.element.name)]
    tree = KDTree([a.pos.tolist() for _, a in metals]) if metals else None
    moving = {id(m) for part in draft.parts if part.mobile for m in part.members}
    found = []
    for part, member, donor in atoms:
        if tree is None or is_metal(donor.element.name):
            continue
        for k in sorted(tree.query_ball_point(donor.pos.tolist(), STATED)):
            other, metal = metals[k]
            if not (part.mobile or id(other) in moving) or member.name == "HOH":
                continue
            ends = member.address(donor.name), other.address(metal.name)
            link = Link(member, donor, other, metal, draft.has_bond(*ends))
            # A result says which bonds its metals have.
            if ends in draft.springs if draft.says_of(other) else link.is_coordinated:
                found.append(link)
    return found


def ties_of(
    draft: Draft,
    links: Sequence[Link],
    at: Mapping[int, Mapping[str, int]],
    x: Floats,
    element: Sequence[str],
    bonds: Integers,
) -> tuple[Tie, ...]:
    """Springs of bonds as the file has them, or else as they are in the input; arguments as of ties."""
    return (_stated_ties(draft, links, at) or ties(links, at, x, element, bonds)) if links else ()


def ties(
    links: Sequence[Link],
    at: Mapping[int, Mapping[str, int]],
    x: Floats,
    element: Sequence[str],
    bonds: Integers,
) -> tuple[Tie, ...]:
    """Springs that hold bonds (n, 2) as they are in the input x (na, 3), nm, if these are lengths."""
    heavy = np.array(element) != "H"
    near = neighbours(bonds[heavy[bonds].all(axis=1)], len(element))
    found: dict[tuple[int, ...], float] = {}
    own = {at[id(link.member)][link.atom.name] for link in links}
    for link in links:
        mine = at[id(link.member)][link.atom.name]
        its = at[id(link.other)][link.other_atom.name]
        found[mine, its] = _METAL_BOND if link.is_metal else _BOND
        for k in near[mine]:
            if k != its:
                found[k, mine, its] = _DONOR_ANGLE if link.is_metal else _ANGLE
        for j, k in combinations(sorted(near[its]), 2):
            if mine in (j, k) and (j in own or k in own):
                found[j, its, k] = _METAL_ANGLE if link.is_metal else _ANGLE
    made = []
    for atoms, stiffness in found.items():
        rest = measure(x[list(atoms)])
        if stiffness == _BOND:
            usual = 0.1 * usual_length(*(element[k] for k in atoms))
            rest = rest if abs(rest - usual) < 0.1 * _BEYOND else usual
        elif stiffness == _ANGLE:
            rest = float(np.clip(rest, _LEAST, _MOST))
        made.append(Tie(atoms, round(rest, DIGITS), stiffness))
    return tuple(tie for tie in made if len(tie.atoms) == 2 or tie.rest < _STRAIGHT)


def _stated_ties(draft: Draft, links: Sequence[Link], at: Mapping[int, Mapping[str, int]]) -> tuple[Tie, ...]:
    """Springs as the file has them; none if it lacks one of these bonds. Arguments as for :func:`ties`."""
    if not all(_ends(link) in draft.springs for link in links):
        return ()
    index: dict[Address, int] = {}
    for member in draft.members:
        for name, k in at[id(member)].items():
            index.setdefault((member.chain_id, member.seqid, name), k)
    return tuple(
        Tie(tuple(index[each] for each in atoms), rest, stiffness)
        for atoms, (rest, stiffness) in draft.springs.items()
        if len(atoms) > 1 and all(each in index for each in atoms)
    )


def measure(x: Floats) -> float:
    """Distance of two points (nm), or angle at the middle one of three (rad)."""
    if len(x) == 2:
        return float(np.linalg.norm(x[1] - x[0]))
    u, v = x[0] - x[1], x[2] - x[1]
    return float(np.arctan2(np.linalg.norm(np.cross(u, v)), u @ v))


def bond_disulfides(draft: Draft) -> Changes:
    """Find the disulfide bonds: between sulphurs that are close, and those that are asked for."""
    asked = draft.reading.disulfide
    cysteines = [member for member in draft.members if member.name == "CYS"]
    wanted = [bond for bond in asked if bond != NO_BONDS]
    found = _near_sulphurs(cysteines)
    only = len(wanted) < len(asked)
    if only and found:
        in_order = sorted(found, key=lambda pair: cysteines.index(pair[0]))
        pairs = tuple(f"{_place(first)}-{_place(second)}" for first, second in in_order)
        yield Repair.of(Kind.BRIDGES_DROPPED, pairs=pairs)
    found = [] if only else found
    for first, second in found:
        if not draft.has_bond(first.address("SG"), second.address("SG")):
            yield Repair.of(Kind.BRIDGE, first=first.residue, second=second.residue)
    for bond in wanted:
        bridge = yield from _asked(draft, cysteines, found, bond)
        if bridge is not None:
            found.append(bridge)
    if not only:
        yield from _report_ignored(draft, cysteines, found)
    draft.bridges = sorted(found, key=lambda pair: cysteines.index(pair[0]))


def _near_sulphurs(cysteines: list[Member]) -> list[Bridge]:
    """Pair the sulphurs that are close, the nearest first."""
    # Two that hold one metal may be near each other; one bonded to a molecule outside it has no valence left.
    sulphurs = [
        member
        for member in cysteines
        if member.atom("SG") and not member.metals and all(a.name != "SG" for a in member.links)
    ]
    x = [_sulphur(member) for member in sulphurs]
    near = KDTree(x).query_pairs(DISULFIDE) if x else set()
    distances = sorted((_apart(sulphurs[i], sulphurs[j]), i, j) for i, j in near)
    bonded: set[int] = set()
    found: list[Bridge] = []
    for _, i, j in distances:
        if not bonded & {i, j}:
            bonded |= {i, j}
            found.append((sulphurs[i], sulphurs[j]))
    return found


def _report_ignored(draft: Draft, cysteines: list[Member], found: list[Bridge]) -> Changes:
    """Report bonds of the file that are too long."""
    at = {(m.chain_id, m.seqid, "SG"): m for m in cysteines if m.atom("SG") and not m.metals}
    used = [set(map(id, pair)) for pair in found]
    for first, second in [(at[a], at[b]) for a, b in draft.stated if a in at and b in at]:
        if {id(first), id(second)} not in used:
            yield Repair.of(
                Kind.BRIDGE_IGNORED, first=first.residue, second=second.residue,
                length=_apart(first, second), remedy=Argument("disulfide"),
            )  # fmt: skip


def _asked(
    draft: Draft, cysteines: list[Member], found: Sequence[Bridge], pair: tuple[str, str]
) -> Generator[Repair, None, Bridge | None]:
    """Return a bond that is asked for; None if it is found already."""
    at = {_place(member): member for member in cysteines}
    bond = f"{draft.source}: disulfide {pair[0]}-{pair[1]}"
    for name in pair:
        if name not in at:
            other = next((member for member in draft.members if _place(member) == name), None)
            what = f"{other} is no cysteine" if other else f"no cysteine {name}"
            raise StructureError(f"{bond}: {what}; its cysteines are {', '.join(at) or 'none'}")
    if pair[0] == pair[1]:
        raise StructureError(f"{bond}: one cysteine is no bond; give two")
    ends = {id(at[name]) for name in pair}
    if any({id(first), id(second)} == ends for first, second in found):
        return None
    for first, second in found:
        if {id(first), id(second)} & ends:
            raise StructureError(
                f"{bond}: {_place(first)} and {_place(second)} are bonded, and no cysteine has two bonds; "
                "leave one out, or drop the bonds that are found: ",
                Argument("disulfide", NO_BONDS),
            )
    held = next((name for name in pair if any(a.name == "SG" for a in at[name].links + at[name].metals)), "")
    if held:
        raise StructureError(
            f"{bond}: {held} is bonded to a molecule kept with the protein; leave one of them out"
        )
    first, second = (at[name] for name in pair)
    apart = _apart(first, second)
    kind = Kind.BRIDGE_FAR if apart >= DISULFIDE else Kind.BRIDGE_ASKED
    yield Repair.of(kind, first=first.residue, second=second.residue, length=apart)
    return first, second


def _place(member: Member) -> str:
    return f"{member.chain_id}:{member.seqid}"


def _sulphur(member: Member) -> list[float]:
    sulphur = member.atom("SG")
    assert sulphur is not None
    return sulphur.pos.tolist()


def _apart(first: Member, second: Member) -> float:
    a, b = first.atom("SG"), second.atom("SG")
    return float(a.pos.dist(b.pos)) if a and b else float("inf")
