"""Bonds between the protein and hetero molecules: metal sites, glycans, covalent ligands.

Force fields have no parameters for these bonds. Springs restrain each bond to the distance and angles of the
input. The bonded atoms do not repel one another.
"""

from collections import Counter
from collections.abc import Generator, Iterable, Iterator, Mapping, Sequence
from itertools import combinations, pairwise

import gemmi
import numpy as np
from scipy.spatial import KDTree

from protochain.core.arrays import Floats, Integers, angle, distance
from protochain.core.checks import NO_BONDS
from protochain.core.errors import Argument
from protochain.core.graph import neighbours
from protochain.structure.formats.records import DIGITS
from protochain.structure.molecule.links import Link, is_metal, usual_length
from protochain.structure.molecule.member import Address, Member
from protochain.structure.molecule.model import Tie
from protochain.structure.molecule.repairs import AtomDistance, Count, Kind, Repair
from protochain.structure.preparation.hetero_molecules import JOIN_CUTOFF
from protochain.structure.preparation.linkage import COVALENT_SLACK, STATED, classify_pairs
from protochain.structure.preparation.structure_draft import Changes, Contacts, Draft, Evidence, Part

_MAX_DEVIATION = 0.25  # Angstrom: a covalent bond that deviates by more is restrained to its usual length.
_MIN_ANGLE, _MAX_ANGLE = np.deg2rad(90.0), np.deg2rad(140.0)
"""Rad: angles of a covalent bond beyond these limits are restrained to the limits."""
_STRAIGHT = np.deg2rad(170.0)
"""Rad: a larger angle gets no spring, because the force would have no direction."""
_SEARCH_RADIUS = 2.5
"""Angstrom: search radius of overlapping atoms. Only two selenium atoms can be bonded further apart."""
_SHELL_SIZE = {"Na": 5, "Mg": 6, "K": 6, "Ca": 6, "Mn": 6}
_OTHER_SHELL_SIZE = 4
"""Donors that surround an ion on all sides (Harding, Acta Cryst. D60:849, 2004)."""

_METAL_BOND, _METAL_ANGLE, _DONOR_ANGLE = 4.8e5, 300.0, 540.0
"""kJ/mol/nm^2, kJ/mol/rad^2. Angles are ZAFF's for Zn(CYS)4 (Peters, Yang, Wang, Fusti-Molnar, Weaver, Merz,
J. Chem. Theory Comput. 6:2935, 2010: S-Zn-S 299, C-S-Zn 539). Charges stretch ZAFF's bond, 2.7e4, by 0.2
angstrom. The C=O constant of ff14SB stretches by less than 0.05, also at a porphyrin of another size."""
_BOND, _ANGLE = 2.7e5, 500.0
"""kJ/mol/nm^2, kJ/mol/rad^2: as for typical bonds and angles between first-row atoms in ff14SB."""

DISULFIDE = 3.0
"""Angstrom: sulphurs nearer than this are bonded, as in OpenMM (a disulfide bond is 2.05)."""
Bridge = tuple[Member, Member]
_OwnedAtoms = Sequence[tuple[Member, gemmi.Atom]]
_Indices = Mapping[int, Mapping[str, int]]
"""Index of each atom, by ``id`` of its residue and by name."""


def find_links(draft: Draft) -> tuple[()]:
    """Find the bonds between the protein and hetero molecules, and the overlapping atoms of the two."""
    protein, hetero_atoms = (
        [(m, a) for part in draft.parts if part.obstacle is is_hetero for m in part.members if m.name != "HOH"
         for a in m.heavy]
        for is_hetero in (False, True)
    )  # fmt: skip
    glycosidic = {*draft.glycosidic}
    near = [link for link in _close_pairs(draft, protein, hetero_atoms) if _ends(link) not in glycosidic]
    # An input written by protochain lists the bonds of its hetero molecules.
    listed = {link for link in near if draft.lists(link.hetero) and (link.is_metal or not _has_metal(link))}
    sprung = {link for link in listed if _ends(link) in draft.springs}
    refused = list[tuple[Link, str]]()
    overlapping = list[Link]()
    bonded = {*sprung}
    if pairs := [link for link in near if not link.is_metal and link not in sprung]:
        close = classify_pairs(draft, pairs)
        refused, overlapping, bonded = close.refused, close.overlapping, {*close.bonded} - listed | sprung
    refused = [*refused, *_long_stated_bonds(draft, protein, hetero_atoms)]
    for link in near:
        if link in listed:
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
    """Report the bonds with springs, the ignored bonds, and overlaps."""
    sites: dict[int, list[Link]] = {}
    for link in draft.links:
        sites.setdefault(id(link.hetero_atom), []).append(link)
    for site in sites.values():
        kind = Kind.COORDINATED if site[0].is_metal else Kind.BONDED
        if moves(draft, site[0].hetero, draft.links):
            kind = Kind.ION_MOVES
        elif site[0].is_metal and len(site[0].hetero.atoms) == 1:
            kind = Kind.ION_HELD
        yield _report_site(kind, site)
    for link, reason in draft.contacts.refused:
        yield Repair.of(Kind.BOND_IGNORED, atoms=link.atoms, why=reason)
    if overlapping := [*draft.contacts.overlapping, *_overlapping_pairs(draft, draft.contacts.protein)]:
        overlapping.sort(key=lambda link: link.length)
        pairs = tuple(AtomDistance(link.atoms, link.length) for link in overlapping)
        yield Repair.of(Kind.NEAR, count=len(pairs), pairs=pairs)


def _report_site(kind: Kind, site: Sequence[Link]) -> Repair:
    ends = tuple(AtomDistance(link.atoms[:1], link.length) for link in site)
    return Repair.of(kind, atom=site[0].atoms[1], ends=ends)


def _has_metal(link: Link) -> bool:
    """Whether a hetero residue has a metal and other atoms. Springs of the metal do not list other bonds."""
    return len(link.hetero.atoms) > 1 and any(a.element.is_metal for a in link.hetero.atoms)


def _close_pairs(draft: Draft, protein: _OwnedAtoms, hetero_atoms: _OwnedAtoms) -> list[Link]:
    """Return pairs that may be bonded: at bond distance, stated by the file, or with a metal."""
    if not (protein and hetero_atoms):
        return []
    tree, bonds = KDTree([atom.pos.tolist() for _, atom in hetero_atoms]), {*draft.stated_bonds}
    links = []
    near = tree.query_ball_point([atom.pos.tolist() for _, atom in protein], STATED, return_sorted=True)
    for (member, atom), places in zip(protein, near, strict=True):
        for k in places:
            hetero, hetero_atom = hetero_atoms[k]
            ends = member.address(atom.name), hetero.address(hetero_atom.name)
            link = Link(member, atom, hetero, hetero_atom, ends in bonds or ends[::-1] in bonds)
            if link.stated or link.is_metal or link.excess <= COVALENT_SLACK:
                links.append(link)
    return links


def _overlapping_pairs(draft: Draft, protein: _OwnedAtoms) -> Iterator[Link]:
    """Yield pairs of protein atoms at bond distance in unbonded residues. Disulfides are found later."""
    if not protein:
        return
    number = {id(m): r for r, m in enumerate(draft.members)}
    joined = {frozenset(link.owners) for fragment in draft.fragments for link in fragment.bonds}
    joined |= {frozenset((id(p.members[0]), id(p.members[-1]))) for p in draft.parts if p.cyclic}
    owner = np.array([number[id(m)] for m, _ in protein])
    pairs = KDTree([a.pos.tolist() for _, a in protein]).query_pairs(_SEARCH_RADIUS, output_type="ndarray")
    for i, j in sorted(pairs[np.abs(owner[pairs[:, 0]] - owner[pairs[:, 1]]) > 1].tolist()):
        link = Link(*protein[i], *protein[j])
        is_bond = frozenset(link.owners) in joined or link.atom.name == link.hetero_atom.name == "SG"
        if not is_bond and link.excess <= COVALENT_SLACK:
            yield link


def _long_stated_bonds(draft: Draft, protein: _OwnedAtoms, hetero: _OwnedAtoms) -> Iterator[tuple[Link, str]]:
    """Yield stated bonds between the protein and hetero molecules that are too long, with the reason."""
    if not draft.stated_bonds:
        return
    protein_at, hetero_at = ({m.address(a.name): (m, a) for m, a in atoms} for atoms in (protein, hetero))
    for ends in draft.stated_bonds:
        for first, second in (ends, ends[::-1]):
            if first in protein_at and second in hetero_at:
                link = Link(*protein_at[first], *hetero_at[second], stated=True)
                if link.length > STATED:
                    yield link, f"it is {link.length:.2f} angstrom long"


def _ends(link: Link) -> tuple[Address, Address]:
    """Return the addresses of the linked atoms, the protein's first."""
    return link.member.address(link.atom.name), link.hetero.address(link.hetero_atom.name)


def list_bonds(draft: Draft) -> Changes:
    """List the bonds that are not along a chain. Report mobile molecules and unused bonds."""
    hetero_links, sugars = stated_hetero_links(draft), _glycosidic(draft)
    yield from _settle_mobility(draft)
    draft.links += _strand_links(draft)
    draft.other_links = [*sugars, *(link for fragment in draft.fragments for link in fragment.bonds)]
    draft.metal_links = _metal_links(draft)
    sites: dict[int, list[Link]] = {}
    for link in draft.metal_links:
        if link.member is not link.hetero:
            sites.setdefault(id(link.hetero_atom), []).append(link)
    for site in sites.values():
        yield _report_site(Kind.ION_HELD if len(site[0].hetero.atoms) == 1 else Kind.COORDINATED, site)
    yield from _report_unused(draft, [*draft.links, *draft.other_links, *hetero_links, *draft.metal_links])


def _settle_mobility(draft: Draft) -> Changes:
    """Fix the mobile molecules that are bonded to other molecules. Report the fixed and the mobile ones."""
    tied = {id(link.hetero) for link in draft.links}
    bonded = {id(link.hetero) for link in draft.links if not link.is_metal}
    hetero_atoms = [(part, a) for part, _, a in heavy_hetero_atoms(draft)]
    tree = KDTree([a.pos.tolist() for _, a in hetero_atoms]) if hetero_atoms else None
    in_fragments = {id(m) for fragment in draft.fragments for m, _ in fragment.owners}
    counts: Counter[str] = Counter()
    for part in draft.parts:
        is_in_fragment = not part.is_strand and id(part.members[0]) in in_fragments
        if tree is None or not part.mobile or part.glycam_code or is_in_fragment:
            continue
        # Atoms near a ligand of known chemistry are not bonded to it.
        joined = part.ligand is None and not part.is_strand and any(
            hetero_atoms[k][0] is not part
            for m in part.members for a in m.heavy for k in tree.query_ball_point(a.pos.tolist(), JOIN_CUTOFF)
        )  # fmt: skip
        if joined or (tied if part.ligand is None else bonded) & {id(m) for m in part.members}:
            part.evidence = Evidence.BONDED
            yield Repair.of(Kind.STAYS, residue=part.members[0].residue)
        elif part.is_strand:
            first, last = part.members[0].residue, part.members[-1].residue
            yield Repair.of(Kind.STRAND, first=first, last=last, count=len(part.members))
        elif part.ligand is None:
            counts[part.members[0].name] += 1
    if counts:
        yield Repair.of(Kind.MOBILE, counts=tuple(Count(n, name) for name, n in counts.items()))


def _report_unused(draft: Draft, used: Iterable[Link]) -> Changes:
    """Report stated bonds that are not used: they are too long, or their atoms were removed."""
    if not draft.stated_bonds:
        return
    atom_at = {m.address(a.name): (m, a) for m in draft.members for a in m.atoms}
    noted = {frozenset(repair.facts["atoms"]) for repair in draft.repairs if repair.kind is Kind.BOND_IGNORED}
    reported = {frozenset(link.atoms) for link in used} | noted
    n_missing = 0
    for first, second in dict.fromkeys((min(ends), max(ends)) for ends in draft.stated_bonds):
        if not {first, second} <= atom_at.keys():
            n_missing += 1
            continue
        link = Link(*atom_at[first], *atom_at[second])
        is_skipped = {first[2], second[2]} in ({"C", "N"}, {"O3'", "P"}) and link.length <= STATED
        # Bonds between cysteines are reported with the disulfides.
        is_skipped |= {first[2], second[2]} == {"SG"} and not (link.member.metals or link.hetero.metals)
        if not is_skipped and link.member is not link.hetero and frozenset(link.atoms) not in reported:
            yield Repair.of(Kind.BOND_IGNORED, atoms=link.atoms, why=f"it is {link.length:.2f} angstrom long")
    if n_missing:
        yield Repair.of(Kind.BONDS_LEFT_OUT, count=n_missing)


def _glycosidic(draft: Draft) -> list[Link]:
    """Return the bonds of mobile glycans, and add their atoms to the links of the residues."""
    if not draft.glycosidic:
        return []
    atom_at = {member.address(atom.name): (member, atom) for member in draft.members for atom in member.atoms}
    links = [Link(*atom_at[first], *atom_at[second]) for first, second in draft.glycosidic]
    for link in links:
        link.member.links.append(link.atom)
    return links


def stated_hetero_links(draft: Draft) -> list[Link]:
    """Return the stated bonds between hetero residues that are short enough."""
    atom_at = {
        member.address(atom.name): (member, atom)
        for part in draft.parts if part.obstacle for member in part.members for atom in member.atoms
    }  # fmt: skip
    pairs = {frozenset(ends) for ends in draft.stated_bonds if {*ends} <= atom_at.keys()}
    links = (Link(*atom_at[first], *atom_at[second]) for first, second in sorted(map(sorted, pairs)))
    return [link for link in links if link.atom.pos.dist(link.hetero_atom.pos) <= STATED]


def moves(draft: Draft, member: Member, links: Sequence[Link]) -> bool:
    """Whether a hetero molecule moves with the protein: an ion that only the protein surrounds."""
    ion = member.atoms[0]
    donors = sum(link.hetero_atom is ion and link.is_metal for link in links)
    if len(member.atoms) > 1 or donors < _SHELL_SIZE.get(ion.element.name, _OTHER_SHELL_SIZE):
        return False
    if draft.lists(member):
        return not draft.lists_as_fixed(member)
    other_hetero = (m for part in draft.parts if part.obstacle for m in part.members if m is not member)
    # Hydrogens have no positions yet.
    heavy = (a for m in (*other_hetero, *draft.omitted) for a in m.heavy)
    return all(ion.pos.dist(a.pos) > STATED for a in heavy)


def heavy_hetero_atoms(draft: Draft) -> list[tuple[Part, Member, gemmi.Atom]]:
    """Return the heavy atoms of the hetero molecules."""
    return [(part, m, a) for part in draft.parts if part.obstacle for m in part.members for a in m.heavy]


def _strand_links(draft: Draft) -> list[Link]:
    """Return the bonds between mobile pieces of strands and their fixed nucleotides."""
    links = []
    for before, after in pairwise(part for part in draft.parts if part.obstacle):
        (end, o3), (start, p) = (
            (m, m.atom(name)) for m, name in ((before.members[-1], "O3'"), (after.members[0], "P"))
        )
        if o3 and p and before.mobile != after.mobile:
            if before.mobile and o3 in end.links:
                links.append(Link(end, o3, start, p))
            elif after.mobile and p in start.links:
                links.append(Link(start, p, end, o3))
    return links


def _metal_links(draft: Draft) -> list[Link]:
    """Return bonds of metals to hetero donors, also in one residue, if the metal or the donor moves."""
    atoms = heavy_hetero_atoms(draft)
    metals = [(m, a) for _, m, a in atoms if is_metal(a.element.name)]
    tree = KDTree([a.pos.tolist() for _, a in metals]) if metals else None
    moving = {id(m) for part in draft.parts if part.mobile for m in part.members}
    links = []
    for part, member, donor in atoms:
        if tree is None or is_metal(donor.element.name):
            continue
        for k in sorted(tree.query_ball_point(donor.pos.tolist(), STATED)):
            metal_residue, metal = metals[k]
            if not (part.mobile or id(metal_residue) in moving) or member.name == "HOH":
                continue
            ends = member.address(donor.name), metal_residue.address(metal.name)
            link = Link(member, donor, metal_residue, metal, draft.has_bond(*ends))
            # An input written by protochain lists the bonds of its metals.
            if ends in draft.springs if draft.lists(metal_residue) else link.is_coordinated:
                links.append(link)
    return links


def ties(
    links: Sequence[Link], at: _Indices, x: Floats, element: Sequence[str], bonds: Integers
) -> tuple[Tie, ...]:
    """Return springs that restrain links to their geometry in x (na, 3), nm, or to a usual one."""
    heavy = np.array(element) != "H"
    near = neighbours(bonds[heavy[bonds].all(axis=1)], len(element))
    stiffness_of: dict[tuple[int, ...], float] = {}
    first_atoms = {at[id(link.member)][link.atom.name] for link in links}
    for link in links:
        first = at[id(link.member)][link.atom.name]
        second = at[id(link.hetero)][link.hetero_atom.name]
        stiffness_of[first, second] = _METAL_BOND if link.is_metal else _BOND
        for k in near[first]:
            if k != second:
                stiffness_of[k, first, second] = _DONOR_ANGLE if link.is_metal else _ANGLE
        for j, k in combinations(sorted(near[second]), 2):
            if first in (j, k) and (j in first_atoms or k in first_atoms):
                stiffness_of[j, second, k] = _METAL_ANGLE if link.is_metal else _ANGLE
    springs = []
    for atoms, stiffness in stiffness_of.items():
        rest_value = measure(x[list(atoms)])
        if stiffness == _BOND:
            usual = 0.1 * usual_length(*(element[k] for k in atoms))
            rest_value = rest_value if abs(rest_value - usual) < 0.1 * _MAX_DEVIATION else usual
        elif stiffness == _ANGLE:
            rest_value = float(np.clip(rest_value, _MIN_ANGLE, _MAX_ANGLE))
        springs.append(Tie(atoms, round(rest_value, DIGITS), stiffness))
    return tuple(tie for tie in springs if len(tie.atoms) == 2 or tie.rest < _STRAIGHT)


def stated_ties(draft: Draft, links: Sequence[Link], at: _Indices) -> tuple[Tie, ...]:
    """Return the file's springs, or none if it lacks one of the links. Arguments as for :func:`ties`."""
    if not links or any(_ends(link) not in draft.springs for link in links):
        return ()
    index: dict[Address, int] = {}
    for member in draft.members:
        for name, k in at[id(member)].items():
            index.setdefault((member.chain_id, member.seqid, name), k)
    return tuple(
        Tie(tuple(index[address] for address in atoms), rest_value, stiffness)
        for atoms, (rest_value, stiffness) in draft.springs.items()
        if len(atoms) > 1 and all(address in index for address in atoms)
    )


def measure(x: Floats) -> float:
    """Return the distance of two points (nm), or the angle at the middle one of three (rad)."""
    return float(distance(*x) if len(x) == 2 else angle(*x))


def bond_disulfides(draft: Draft) -> Changes:
    """Find disulfide bonds between close sulphurs, and add the requested ones."""
    options = draft.reading.disulfide
    cysteines = [member for member in draft.members if member.name == "CYS"]
    requested = [bond for bond in options if bond != NO_BONDS]
    bridges = _pair_sulphurs(cysteines)
    only_requested = len(requested) < len(options)
    if only_requested and bridges:
        in_order = sorted(bridges, key=lambda pair: cysteines.index(pair[0]))
        pairs = tuple(f"{_label(first)}-{_label(second)}" for first, second in in_order)
        yield Repair.of(Kind.BRIDGES_DROPPED, pairs=pairs)
    bridges = [] if only_requested else bridges
    for first, second in bridges:
        if not draft.has_bond(first.address("SG"), second.address("SG")):
            yield Repair.of(Kind.BRIDGE, first=first.residue, second=second.residue)
    for bond in requested:
        bridge = yield from _requested_bridge(draft, cysteines, bridges, bond)
        if bridge is not None:
            bridges.append(bridge)
    if not only_requested:
        yield from _report_ignored(draft, cysteines, bridges)
    draft.bridges = sorted(bridges, key=lambda pair: cysteines.index(pair[0]))


def _pair_sulphurs(cysteines: list[Member]) -> list[Bridge]:
    """Pair the close sulphurs, the nearest first."""
    # Sulphurs at one metal may be close to each other. One bonded to a hetero molecule has no free valence.
    free = [m for m in cysteines if not m.metals and all(a.name != "SG" for a in m.links)]
    sulphurs = [(member, sulphur) for member in free if (sulphur := member.atom("SG"))]
    x = [sulphur.pos.tolist() for _, sulphur in sulphurs]
    near = KDTree(x).query_pairs(DISULFIDE) if x else set()
    distances = sorted((sulphurs[i][1].pos.dist(sulphurs[j][1].pos), i, j) for i, j in near)
    bonded: set[int] = set()
    bridges: list[Bridge] = []
    for _, i, j in distances:
        if not bonded & {i, j}:
            bonded |= {i, j}
            bridges.append((sulphurs[i][0], sulphurs[j][0]))
    return bridges


def _report_ignored(draft: Draft, cysteines: list[Member], bridges: list[Bridge]) -> Changes:
    """Report stated disulfide bonds that are too long."""
    at = {(m.chain_id, m.seqid, "SG"): m for m in cysteines if m.atom("SG") and not m.metals}
    used = [set(map(id, pair)) for pair in bridges]
    for first, second in [(at[a], at[b]) for a, b in draft.stated_bonds if a in at and b in at]:
        if {id(first), id(second)} not in used:
            yield Repair.of(
                Kind.BRIDGE_IGNORED, first=first.residue, second=second.residue,
                length=_sulphur_distance(first, second), remedy=Argument("disulfide"),
            )  # fmt: skip


def _requested_bridge(
    draft: Draft, cysteines: list[Member], bridges: Sequence[Bridge], pair: tuple[str, str]
) -> Generator[Repair, None, Bridge | None]:
    """Return a requested bond, or None if it is found already."""
    at = {_label(member): member for member in cysteines}
    bond = f"disulfide {pair[0]}-{pair[1]}"
    for name in pair:
        if name not in at:
            residue = next((member for member in draft.members if _label(member) == name), None)
            problem = f"{residue} is no cysteine" if residue else f"no cysteine {name}"
            raise draft.error(f"{bond}: {problem}; its cysteines are {', '.join(at) or 'none'}")
    if pair[0] == pair[1]:
        raise draft.error(f"{bond}: one cysteine is no bond; give two")
    ends = {id(at[name]) for name in pair}
    if any({id(first), id(second)} == ends for first, second in bridges):
        return None
    for first, second in bridges:
        if {id(first), id(second)} & ends:
            raise draft.error(
                f"{bond}: {_label(first)} and {_label(second)} are bonded, and no cysteine has two bonds; "
                "leave one out, or drop the bonds that are found: ",
                Argument("disulfide", NO_BONDS),
            )
    if end := next((name for name in pair if "SG" in at[name].bonded_names), ""):
        raise draft.error(
            f"{bond}: {end} is bonded to a molecule kept with the protein; leave one of them out"
        )
    first, second = (at[name] for name in pair)
    length = _sulphur_distance(first, second)
    kind = Kind.BRIDGE_FAR if length >= DISULFIDE else Kind.BRIDGE_ASKED
    yield Repair.of(kind, first=first.residue, second=second.residue, length=length)
    return first, second


def _label(member: Member) -> str:
    return f"{member.chain_id}:{member.seqid}"


def _sulphur_distance(first: Member, second: Member) -> float:
    a, b = first.atom("SG"), second.atom("SG")
    return float(a.pos.dist(b.pos)) if a and b else float("inf")
