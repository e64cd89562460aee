"""Chemistry of residues without matching templates: modified, cross-linked, or bonded to a chain.

A fragment is a group of residues joined by bonds not along a chain, with caps at continuing chains. Backbones
like alanine's, and residues of the force field, have its parameters. SMIRNOFF has all terms with other atoms.
"""

from collections.abc import Collection, Generator, Iterable, Iterator, Sequence

import gemmi
import numpy as np
from scipy.spatial import KDTree

from protochain.core.errors import Argument, Fault, ProtochainError, StructureError
from protochain.core.graph import components
from protochain.core.markup import abridge
from protochain.core.units import ANGSTROM_PER_NM
from protochain.ligands import tables
from protochain.ligands.matching import inverted_atoms
from protochain.structure.formats.records import with_component
from protochain.structure.molecule.bonding import Graph
from protochain.structure.molecule.links import Link
from protochain.structure.molecule.member import Member
from protochain.structure.molecule.repairs import Kind, Loss, Reason, Repair
from protochain.structure.molecule.residues import Atom
from protochain.structure.molecule.templates import HAS_GLYCAM, HAS_SAGE
from protochain.structure.preparation.capping import FragmentBuilder, Place, Places
from protochain.structure.preparation.hetero_molecules import cut_strand
from protochain.structure.preparation.ligand_chemistry import (
    LigandChemistry,
    charged_metals,
    report_metals,
    template_of,
)
from protochain.structure.preparation.linkage import SHORTEST, STATED_SLACK
from protochain.structure.preparation.read import convert_to_parent
from protochain.structure.preparation.sites import stated_hetero_links
from protochain.structure.preparation.structure_draft import Changes, Draft, Evidence, Fragment, Part

_H, _C, _N, _O, _P, _S = 1, 6, 7, 8, 15, 16

_AMIDE = 1.7  # Angstrom. An amine closer than this to the carbon of a carboxyl is bonded to it (1.33).
_AMINES = {"LYS": "NZ", "ORN": "NE", "DAB": "ND"}
_ACYLS = {
    "ASP": ("CG", "OD1", "OD2"), "GLU": ("CD", "OE1", "OE2"), "ASN": ("CG", "OD1", "ND2"),
    "GLN": ("CD", "OE1", "NE2"),
}  # fmt: skip
"""Carbon, and two atoms of which an amide bond replaces one. If both are present, the side chains overlap."""


def assign_chemistry(draft: Draft) -> Changes:
    """Parametrise residues without matching templates, and report them."""
    # Find the bonds of residues other than along a chain.
    places = {id(m): Place(p, *p.neighbours(i)) for p in draft.parts for i, m in enumerate(p.members)}
    cross = yield from _accept_bonds(_stated_cross_links(draft, places))
    cross += _amides(draft, places)
    for link in cross:
        link.member.links.append(link.atom)
        link.hetero.links.append(link.hetero_atom)
    hetero_links = [x for x in draft.links if not x.is_metal and x not in draft.contacts.spring_links]
    hetero_links += yield from _accept_bonds(_hetero_bonds(draft))
    bonds = hetero_links + cross
    # Parametrise each group of bonded residues as a fragment, or tie or convert its residues.
    chemist = LigandChemistry(draft)
    special = _find_special(draft, chemist, places, bonds)
    special_ids = {id(m) for m in special}
    unknown: list[tuple[Member, ProtochainError | ValueError]] = []
    fixed: list[Member] = []
    for members in _groups(draft, chemist, places, special, bonds):
        links = [link for link in bonds if any(link.member is m for m in members)]
        hetero = [m for m in members if places[id(m)].part.obstacle]
        try:
            if hetero and not chemist.chemistry.has_sage:
                raise StructureError(f"OpenFF Sage goes with {HAS_GLYCAM} and {HAS_SAGE} only")
            fragment = FragmentBuilder(chemist, members, links, places, special_ids).build()
            yield from _assign(draft, chemist, fragment, special_ids)
        except (ProtochainError, ValueError) as error:  # ValueError: rings that RDKit cannot kekulize.
            if requested := next((m for m in hetero if chemist.name(m) in chemist.chemistry.moving), None):
                raise draft.error(f"{requested}: ", *_parts(error)) from None
            for m in hetero:
                if not (m.is_unknown and places[id(m)].part.mobile):
                    places[id(m)].part.evidence = Evidence.ELEMENTS
                if m.is_unknown:
                    yield Repair.of(Kind.STAYS_UNKNOWN, residue=m.residue, why=error)
                    fixed.append(m)
            unknown += [(m, error) for m in members if m.is_unknown and not m.parent and m not in fixed]
            yield from _refuse_or_tie(draft, links, error)
            reason = Reason.INCOMPLETE if getattr(error, "fault", None) is Fault.INCOMPLETE else Reason.PARENT
            for m in (m for m in members if m.parent):
                yield from convert_to_parent(draft, m, reason)
            continue
        bonds = [link for link in bonds if link not in links]
    if unknown:
        raise draft.error(*_unknown_message(draft, unknown))
    if fixed:
        pieces = list[Part]()
        for part in draft.parts:
            pieces += yield from cut_strand(part, [m for m in part.members if m in fixed])
        draft.parts = pieces
    # Fragments include their bonds in the energy. Conversion to parents may have removed bonded atoms.
    resolved = {link for link in hetero_links if link not in bonds}
    draft.links = [
        link for link in draft.links
        if link in draft.contacts.spring_links
        or (link not in resolved and all(a in m.atoms for m, a, *_ in _both_ways(link)))
    ]  # fmt: skip


def _find_special(
    draft: Draft, chemist: LigandChemistry, places: Places, bonds: Sequence[Link]
) -> list[Member]:
    """Return residues without matching templates: modified ones, and ones with bonds not along a chain."""
    ends: dict[int, set[str]] = {}
    for link in bonds:
        for m, a, partner, partner_atom in _both_ways(link):
            is_amine = a.name == "N" and not _is_acyl(chemist, partner, partner_atom.name)
            ends.setdefault(id(m), set()).add("amine" if is_amine else a.name)
    for m in (m for m in draft.members if m.is_unknown):
        after, graph = places[id(m)].after, _graph(chemist, m)
        # A nitrogen bonded to a C with only single bonds is an amine.
        if after and graph and {graph.order("C", x) for x in graph.near("C")} == {1}:
            ends.setdefault(id(after), set()).add("amine")
    return [
        m for m in draft.members
        if m.is_unknown or (id(m) in ends and not _keeps_template(places[id(m)], m, ends[id(m)]))
    ]  # fmt: skip


def _groups(
    draft: Draft, chemist: LigandChemistry, places: Places, special: Sequence[Member], bonds: Sequence[Link]
) -> Iterator[list[Member]]:
    """Yield groups of residues without templates, bonded residues, and neighbours with changed terms."""
    if not special:
        return
    number = {key: k for k, key in enumerate(places)}
    pairs = [(number[a], number[b]) for link in bonds for a, b in [link.owners]]
    for m in special:
        _, before, after = places[id(m)]
        neighbours: list[Member | None] = []
        if places[id(m)].part.obstacle:
            # In usual phosphodiester bonds no term includes changed atoms of both residues.
            is_usual = before and before.atom("O3'") and all(map(m.atom, ("P", "OP1", "OP2", "O5'")))
            neighbours = [before] if before and before.is_unknown and not is_usual else []
        elif (before or after) and (graph := _graph(chemist, m)) and not graph.backbone(""):
            neighbours = [before, after]
        pairs += [(number[id(m)], number[id(neighbour)]) for neighbour in neighbours if neighbour]
    group = components(np.array(pairs, dtype=np.int64).reshape(-1, 2), len(number))
    for g in dict.fromkeys(int(group[number[id(m)]]) for m in special):
        yield [m for m in draft.members if group[number[id(m)]] == g]


def _hetero_bonds(draft: Draft) -> Iterator[Link]:
    """Yield bonds between hetero molecules in the file, except bonds of metals and known glycans."""
    parts = {id(m): part for part in draft.parts for m in part.members}
    for link in stated_hetero_links(draft):
        (first, second), names = (parts[m] for m in link.owners), {link.atom.name, link.hetero_atom.name}
        if (
            link.atom.element.is_metal or link.is_metal or (first.glycam_code and second.glycam_code)
            or min(len(link.member.atoms), len(link.hetero.atoms)) == 1
            or (first is second and names == {"O3'", "P"})
        ):  # fmt: skip
            continue
        yield link


def _accept_bonds(links: Iterable[Link]) -> Generator[Repair, None, list[Link]]:
    """Return bonds of the file with plausible lengths, and report the others."""
    accepted = []
    for link in links:
        if link.length >= SHORTEST and link.excess <= STATED_SLACK:
            accepted.append(link)
        else:
            yield Repair.of(Kind.BOND_IGNORED, atoms=link.atoms, why=f"it is {link.length:.2f} angstrom long")
    return accepted


def _keeps_template(at: Place, member: Member, ends: set[str]) -> bool:
    """Return whether a residue still matches a template because its bonds are at open ends of a chain."""
    open_ends = {name for name, neighbour in (("N", at.before), ("C", at.after)) if neighbour is None}
    return not at.part.obstacle and ends <= open_ends and not member.is_unknown


def _both_ways(link: Link) -> Iterator[tuple[Member, gemmi.Atom, Member, gemmi.Atom]]:
    """Yield residue and atom of each end of a bond, followed by the other end."""
    yield link.member, link.atom, link.hetero, link.hetero_atom
    yield link.hetero, link.hetero_atom, link.member, link.atom


def _is_acyl(chemist: LigandChemistry, member: Member, name: str) -> bool:
    """Return whether an atom is an acyl carbon in the file, so that a nitrogen bonded to it is an amide."""
    if (graph := _graph(chemist, member)) is None:
        return True
    oxygens = [x for x in graph.heavy(name) if graph.atoms[x][0] == _O]
    present = [x for x in oxygens if member.atom(x) and graph.heavy(x) == [name]]
    return bool(present) and any(graph.order(name, x) == 2 for x in oxygens)


def _graph(chemist: LigandChemistry, member: Member) -> Graph | None:
    """Return the graph of a residue, or None without chemistry, which is reported later."""
    graph = Graph()
    try:
        graph.add("", chemist.lookup(member))
    except ProtochainError:
        return None
    return graph


def _stated_cross_links(draft: Draft, places: Places) -> Iterator[Link]:
    """Yield bonds in the file between residues of chains, except along a chain and disulfides."""
    if not draft.stated_bonds:
        return
    chains = [m for m in draft.members if not places[id(m)].part.obstacle]
    atom_at = {m.address(a.name): (m, a) for m in chains for a in m.heavy}
    seen = {frozenset((m.address("C"), after.address("N"))) for m in chains if (after := places[id(m)].after)}
    for first, second in draft.stated_bonds:
        pair = frozenset((first, second))
        if pair in seen or not pair <= atom_at.keys():
            continue
        seen.add(pair)
        link = Link(*atom_at[first], *atom_at[second], stated=True)
        is_disulfide = link.member.name == link.hetero.name == "CYS" and first[2] == second[2] == "SG"
        if link.member is not link.hetero and not is_disulfide:
            yield link


def _amides(draft: Draft, places: Places) -> Iterator[Link]:
    """Yield bonds between amines and carboxyls without an oxygen, which the file does not list."""
    chains = [m for m in draft.members if not places[id(m)].part.obstacle]
    open_acids = [m for m in chains if m.name in _ACYLS and not all(map(m.atom, _ACYLS[m.name][1:]))]
    carbons = [(m, m.atom(_ACYLS[m.name][0])) for m in open_acids]
    carbons += [(m, m.atom("C")) for m in chains if places[id(m)].after is None and not m.atom("OXT")]
    acyls = [(m, a) for m, a in carbons if a]
    if not acyls:
        return
    nitrogens = [(m, m.atom(_AMINES[m.name])) for m in chains if m.name in _AMINES]
    nitrogens += [(m, m.atom("N")) for m in chains if places[id(m)].before is None]
    tree = KDTree([a.pos.tolist() for _, a in acyls])
    for m, a in ((m, a) for m, a in nitrogens if a):
        for k in sorted(tree.query_ball_point(a.pos.tolist(), _AMIDE)):
            acid, carbon = acyls[k]
            if acid is not m and not draft.has_bond(m.address(a.name), acid.address(carbon.name)):
                yield Link(m, a, acid, carbon)


def _refuse_or_tie(draft: Draft, links: Sequence[Link], error: Exception) -> Changes:
    """Report bonds without parameters. Bonds to hetero molecules become springs, others are ignored."""
    hetero = {id(m) for part in draft.parts if part.obstacle for m in part.members}
    for link in links:
        if id(link.hetero) in hetero:
            yield Repair.of(Kind.NO_PARAMETERS, atoms=link.atoms, why=error)
        elif link.stated:
            yield Repair.of(Kind.BOND_IGNORED, atoms=link.atoms, why=error)
        else:
            a, b = link.atoms
            raise draft.error(
                f"{a.residue} and {b.residue} are joined by an amide bond "
                f"({a.name}-{b.name}), which has no parameters: ", *_parts(error), "; remove that bond",
            ) from None  # fmt: skip


def _parts(error: Exception) -> tuple[object, ...]:
    return error.parts if isinstance(error, ProtochainError) else (str(error),)


def _unknown_message(draft: Draft, unknown: Sequence[tuple[Member, Exception]]) -> tuple[object, ...]:
    """Return a message about residues without parameters, with the reason and remedies."""
    chains = dict.fromkeys(part.chain_id for part in draft.parts if not part.obstacle)
    free = [name for name in chains if name and name not in {member.chain_id for member, _ in unknown}]
    stated = "is an unknown amino acid" if len(unknown) == 1 else "are unknown amino acids"
    it = "it" if len(unknown) == 1 else "them"
    option = (", or take only what has none: ", Argument("chains", ",".join(free))) if free else ()
    return (
        f"{abridge([str(member) for member, _ in unknown])} {stated} without a standard parent (",
        *_parts(unknown[0][1]),
        f"); replace or remove {it}, or give a force field that defines {it}",
        *option,
    )


def _assign(draft: Draft, chemist: LigandChemistry, fragment: Fragment, ids: Collection[int]) -> Changes:
    """Assign templates to the residues of a fragment, remove leaving atoms, and report both."""
    # Find the atoms of each residue, and build its template.
    atom_names: dict[int, dict[int, str]] = {}
    by_id: dict[int, Member] = {}
    names = fragment.ligand.molecule.names
    for i, ((m, atom_name), name) in enumerate(zip(fragment.owners, names, strict=True)):
        if m is not None and id(m) in ids and name[-1] not in "+-":
            by_id[id(m)] = m
            atom_names.setdefault(id(m), {})[i] = atom_name
    # Template charges are used only to orient hydroxyls when hydrogens are placed.
    metals = {k: charged_metals(m, chemist.name(m), atom_names[k].values()) for k, m in by_id.items()}
    pairs = {k: (m, template_of(m.name, fragment.ligand, atom_names[k], metals[k])) for k, m in by_id.items()}
    leavers = {(id(m), name) for atoms in fragment.bonds.values() for m, name in atoms}
    for m, template in pairs.values():
        present = {a.name for a in m.heavy if (id(m), a.name) not in leavers}
        if unmatched := (present ^ {*template.heavy}) - {"OXT", "OP3"}:
            listing = ", ".join(sorted(unmatched))
            raise StructureError(f"{m}: {listing} missing or unknown", fault=Fault.INCOMPLETE)
    parts = {id(m): part for part in draft.parts for m in part.members}
    formal, inverted = fragment.ligand.molecule.formal_charges.tolist(), _find_inverted(fragment)
    for m, template in pairs.values():
        m.source = template
        states = {name: q for (owner, name), q in zip(fragment.owners, formal, strict=True) if owner is m}
        charge = sum(states.values()) + sum(a.charge for a in metals[id(m)])
        source = chemist.lookup(m).source
        yield Repair.of(Kind.MODIFIED, residue=m.residue, source=source, charge=f"{charge:+d}")
        yield from report_metals(m, metals[id(m)])
        for a in m.atoms if parts[id(m)].obstacle else ():
            a.charge = states.get(a.name, a.charge)
        if not m.is_d and (stereo := tuple(name for owner, name in inverted if owner is m)):
            yield Repair.of(Kind.INVERTED, residue=m.residue, atoms=stereo)
        if parts[id(m)].obstacle:
            parts[id(m)].evidence = Evidence.FRAGMENT
        if chemist.name(m) in chemist.chemistry.user_sources:
            # A written file must contain this chemistry.
            draft.header = with_component(draft.header, tables.heavy_rows(chemist.name(m), chemist.lookup(m)))
    for link, left in fragment.bonds.items():
        stays = [(m, x) for m, a, *_ in _both_ways(link) for x in _keep_hydrogens(chemist, m, a.name, left)]
        atoms = [atom for atom in left if atom not in stays]
        lost = [x for m in (link.member, link.hetero) for x in _remove(m, {n for o, n in atoms if o is m})]
        names = tuple(f"{name} of {m.residue.name}" for m, name in atoms)
        yield Repair.of(Kind.LINKED, tuple(lost), atoms=link.atoms, length=link.length, gone=names)
    # A gap between two ends that are bonded to a fragment is not a gap, as in GFP's chromophore.
    ends = {end for link in fragment.bonds for end in link.atoms}
    draft.repairs = [
        r for r in draft.repairs
        if r.kind is not Kind.GAP or not {Atom("C", r.facts["last"]), Atom("N", r.facts["first"])} <= ends
    ]  # fmt: skip
    draft.fragments.append(fragment)


def _find_inverted(fragment: Fragment) -> list[tuple[Member | None, str]]:
    """Return residue and name of inverted stereocentres, and of inverted double bonds as ``C1=C2``."""
    molecule, owners = fragment.ligand.molecule, fragment.owners
    atoms = [m.atom(name) if m else None for m, name in (owners[i] for i in molecule.heavy)]
    x = np.array([a.pos.tolist() if a else [np.nan] * 3 for a in atoms]) / ANGSTROM_PER_NM
    return [(owners[ids[0]][0], "=".join(owners[i][1] for i in ids)) for ids in inverted_atoms(molecule, x)]


def _keep_hydrogens(
    chemist: LigandChemistry, member: Member, name: str, left: Collection[tuple[Member, str]]
) -> list[str]:
    """Return leaving hydrogens of an atom that it regains because an amine is charged."""
    if member.template is None or (graph := _graph(chemist, member)) is None:
        return []
    light, now = graph.light(name), member.template.hydrogens.get(name, ())
    leaving = [x for x in light if (member, x) in left]
    return leaving[: max(len(now) + len(leaving) - len(light), 0)]


def _remove(member: Member, names: Collection[str]) -> tuple[Loss, ...]:
    """Remove atoms from a residue, and return the losses."""
    removed = [a for a in member.atoms if a.name in names]
    member.atoms = [a for a in member.atoms if a.name not in names]
    return member.losses(removed, Reason.BONDED)
