"""Residues that no template fits, with their own chemistry: modified, cross-linked, or bonded beside a chain.

A fragment is what bonds other than those along a chain join, capped as by acetyl and methylamide where chains
go on. A backbone like alanine's keeps the parameters of alanine, and residues that the force field knows keep
theirs; SMIRNOFF has all terms that touch another atom.
"""

from collections.abc import Collection, Generator, Iterable, Iterator, Mapping, Sequence

import gemmi
import numpy as np
from scipy.spatial import KDTree

from protochain.core.errors import Argument, Fault, ProtochainError, StructureError
from protochain.core.graph import components
from protochain.core.markup import listed
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
from protochain.structure.preparation.capping import FragmentBuilder, Place
from protochain.structure.preparation.hetero_molecules import cut_strand
from protochain.structure.preparation.ligand_chemistry import (
    LigandChemistry,
    charged_metals,
    report_metals,
    template_of,
)
from protochain.structure.preparation.linkage import SHORTEST, STATED_SLACK
from protochain.structure.preparation.parents import convert_to_parent
from protochain.structure.preparation.sites import stated_hetero_links
from protochain.structure.preparation.structure_draft import Changes, Draft, Evidence, Fragment, Part, losses

_H, _C, _N, _O, _P, _S = 1, 6, 7, 8, 15, 16

_AMIDE = 1.7
"""Angstrom: an amine nearer than this to the carbon of a carboxyl is bonded to it (1.33)."""
_AMINES = {"LYS": "NZ", "ORN": "NE", "DAB": "ND"}
_ACYLS = {
    "ASP": ("CG", "OD1", "OD2"), "GLU": ("CD", "OE1", "OE2"), "ASN": ("CG", "OD1", "ND2"),
    "GLN": ("CD", "OE1", "NE2"),
}  # fmt: skip
"""With the atoms of which an amide bond takes the place of one: where both are there, two side chains of a
poor model overlap."""


def assign_chemistry(draft: Draft) -> Changes:
    """Give residues that no template fits their parameters, and report them."""
    where = {
        id(m): Place(part, i, *part.neighbours(i)) for part in draft.parts for i, m in enumerate(part.members)
    }
    cross = yield from _believe(_stated_across(draft, where))
    cross += _amides(draft, where)
    for link in cross:
        link.member.links.append(link.atom)
        link.hetero.links.append(link.hetero_atom)
    beside = [x for x in draft.links if not x.is_metal and x not in draft.contacts.spring_links]
    beside += yield from _believe(_between(draft))
    bonds = beside + cross
    chemist = LigandChemistry(draft)
    special = _special(draft, chemist, where, bonds)
    odd = {id(m) for m in special}
    unknown: list[tuple[Member, ProtochainError | ValueError]] = []
    still: list[Member] = []
    for members in _groups(draft, chemist, where, special, bonds):
        own = [link for link in bonds if any(link.member is m for m in members)]
        around = [m for m in members if where[id(m)].part.obstacle]
        try:
            if around and not chemist.chemistry.has_sage:
                raise StructureError(f"OpenFF Sage goes with {HAS_GLYCAM} and {HAS_SAGE} only")
            made = FragmentBuilder(chemist, members, own, where, odd).build()
            yield from _take_in(draft, chemist, made, odd)
        except (ProtochainError, ValueError) as error:  # RDKit's, of rings that it cannot kekulize.
            if given := next((m for m in around if chemist.name(m) in chemist.chemistry.moving), None):
                raise StructureError(f"{draft.source}: {given}: ", *_parts(error)) from None
            for m in around:
                if not (m.is_unknown and where[id(m)].part.mobile):
                    where[id(m)].part.evidence = Evidence.ELEMENTS
                if m.is_unknown:
                    yield Repair.of(Kind.STAYS_UNKNOWN, residue=m.residue, why=error)
                    still.append(m)
            unknown += [(m, error) for m in members if m.is_unknown and not m.parent and m not in still]
            yield from _refuse_or_tie(draft, own, error)
            why = Reason.INCOMPLETE if getattr(error, "fault", None) is Fault.INCOMPLETE else Reason.PARENT
            for m in (m for m in members if m.parent):
                yield from convert_to_parent(draft, m, why)
            continue
        bonds = [link for link in bonds if link not in own]
    if unknown:
        raise StructureError(f"{draft.source}: ", *_about_unknown(draft, unknown))
    if still:
        pieces = list[Part]()
        for part in draft.parts:
            pieces += yield from cut_strand(part, [m for m in part.members if m in still])
        draft.parts = pieces
    # Bonds of fragments are part of their energy, and a residue that became its parent has lost atoms.
    gone = {link for link in beside if link not in bonds}
    draft.links = [
        link for link in draft.links
        if link in draft.contacts.spring_links
        or (link not in gone and all(a in m.atoms for m, a, *_ in _both_ways(link)))
    ]  # fmt: skip


def _special(
    draft: Draft, chemist: LigandChemistry, where: Mapping[int, Place], bonds: Sequence[Link]
) -> list[Member]:
    """Residues that no template fits: modified ones, and those whose bonds do not go on with a chain."""
    ends: dict[int, set[str]] = {}
    for link in bonds:
        for m, a, other, its in _both_ways(link):
            is_amine = a.name == "N" and not _is_acyl(chemist, other, its.name)
            ends.setdefault(id(m), set()).add("amine" if is_amine else a.name)
    for m in (m for m in draft.members if m.is_unknown):
        after, graph = where[id(m)].after, _graph(chemist, m)
        # The nitrogen after a C with single bonds is an amine.
        if after and graph and {graph.order("C", x) for x in graph.near("C")} == {1}:
            ends.setdefault(id(after), set()).add("amine")
    return [
        m for m in draft.members
        if m.is_unknown or (id(m) in ends and not _is_whole(where[id(m)], m, ends[id(m)]))
    ]  # fmt: skip


def _groups(
    draft: Draft,
    chemist: LigandChemistry,
    where: Mapping[int, Place],
    special: Sequence[Member],
    bonds: Sequence[Link],
) -> Iterator[list[Member]]:
    """Residues that bonds join to those that no template fits, or whose terms these change."""
    if not special:
        return
    number = {key: k for k, key in enumerate(where)}
    pairs = [(number[a], number[b]) for link in bonds for a, b in [link.owners]]
    for m in special:
        _, _, before, after = where[id(m)]
        wide: list[Member | None] = []
        if where[id(m)].part.obstacle:
            # Joined as usual, no term has changed atoms of both.
            is_usual = before and before.atom("O3'") and all(map(m.atom, ("P", "OP1", "OP2", "O5'")))
            wide = [before] if before and before.is_unknown and not is_usual else []
        elif (before or after) and (graph := _graph(chemist, m)) and not graph.backbone(""):
            wide = [before, after]
        pairs += [(number[id(m)], number[id(each)]) for each in wide if each]
    group = components(np.array(pairs, dtype=np.int64).reshape(-1, 2), len(number))
    for g in dict.fromkeys(int(group[number[id(m)]]) for m in special):
        yield [m for m in draft.members if group[number[id(m)]] == g]


def _between(draft: Draft) -> Iterator[Link]:
    """Bonds that the file states between kept molecules, but of metals and known glycans."""
    parts = {id(m): part for part in draft.parts for m in part.members}
    for link in stated_hetero_links(draft):
        (one, other), names = (parts[each] for each in link.owners), {link.atom.name, link.hetero_atom.name}
        if (
            link.atom.element.is_metal or link.is_metal or (one.glycam_code and other.glycam_code)
            or min(len(link.member.atoms), len(link.hetero.atoms)) == 1
            or (one is other and names == {"O3'", "P"})
        ):  # fmt: skip
            continue
        yield link


def _believe(links: Iterable[Link]) -> Generator[Repair, None, list[Link]]:
    """Return those bonds that the file states and that have the length of one; report the others."""
    believed = []
    for link in links:
        if link.length >= SHORTEST and link.excess <= STATED_SLACK:
            believed.append(link)
        else:
            yield Repair.of(Kind.BOND_IGNORED, atoms=link.atoms, why=f"it is {link.length:.2f} angstrom long")
    return believed


def _is_whole(at: Place, member: Member, ends: set[str]) -> bool:
    """Whether a template fits a residue of a chain all the same: its bond goes on where the chain ends."""
    open_ends = {name for name, other in (("N", at.before), ("C", at.after)) if other is None}
    return not at.part.obstacle and ends <= open_ends and not member.is_unknown


def _both_ways(link: Link) -> Iterator[tuple[Member, gemmi.Atom, Member, gemmi.Atom]]:
    """Residue and atom of either end of a bond, with those of the other."""
    yield link.member, link.atom, link.hetero, link.hetero_atom
    yield link.hetero, link.hetero_atom, link.member, link.atom


def _is_acyl(chemist: LigandChemistry, member: Member, name: str) -> bool:
    """Whether nitrogen bonded to an atom is that of an amide: the file has a doubly bonded oxygen there."""
    if (graph := _graph(chemist, member)) is None:
        return True
    oxygens = [x for x in graph.heavy(name) if graph.atoms[x][0] == _O]
    there = [x for x in oxygens if member.atom(x) and graph.heavy(x) == [name]]
    return bool(there) and any(graph.order(name, x) == 2 for x in oxygens)


def _graph(chemist: LigandChemistry, member: Member) -> Graph | None:
    """None where there is no chemistry, which is told later."""
    graph = Graph()
    try:
        graph.add("", chemist.lookup(member))
    except ProtochainError:
        return None
    return graph


def _stated_across(draft: Draft, where: Mapping[int, Place]) -> Iterator[Link]:
    """Bonds that the file states between residues of chains, but those along it and disulfides."""
    if not draft.stated_bonds:
        return
    chains = [m for m in draft.members if not where[id(m)].part.obstacle]
    there = {m.address(a.name): (m, a) for m in chains for a in m.heavy}
    done = {frozenset((m.address("C"), after.address("N"))) for m in chains if (after := where[id(m)].after)}
    for first, second in draft.stated_bonds:
        pair = frozenset((first, second))
        if pair in done or not pair <= there.keys():
            continue
        done.add(pair)
        link = Link(*there[first], *there[second], stated=True)
        is_disulfide = link.member.name == link.hetero.name == "CYS" and first[2] == second[2] == "SG"
        if link.member is not link.hetero and not is_disulfide:
            yield link


def _amides(draft: Draft, where: Mapping[int, Place]) -> Iterator[Link]:
    """Bonds between amines and carboxyls of chains that the file does not state: one lacks an oxygen."""
    chains = [m for m in draft.members if not where[id(m)].part.obstacle]
    open_acids = [m for m in chains if m.name in _ACYLS and not all(map(m.atom, _ACYLS[m.name][1:]))]
    carbons = [(m, m.atom(_ACYLS[m.name][0])) for m in open_acids]
    carbons += [(m, m.atom("C")) for m in chains if where[id(m)].after is None and not m.atom("OXT")]
    acyls = [(m, a) for m, a in carbons if a]
    if not acyls:
        return
    nitrogens = [(m, m.atom(_AMINES[m.name])) for m in chains if m.name in _AMINES]
    nitrogens += [(m, m.atom("N")) for m in chains if where[id(m)].before is None]
    tree = KDTree([a.pos.tolist() for _, a in acyls])
    for m, a in ((m, a) for m, a in nitrogens if a):
        for k in sorted(tree.query_ball_point(a.pos.tolist(), _AMIDE)):
            other, its = acyls[k]
            if other is not m and not draft.has_bond(m.address(a.name), other.address(its.name)):
                yield Link(m, a, other, its)


def _refuse_or_tie(draft: Draft, links: Sequence[Link], error: Exception) -> Changes:
    """Report bonds without parameters: springs hold those to molecules beside a chain, others are ignored."""
    beside = {id(m) for part in draft.parts if part.obstacle for m in part.members}
    for link in links:
        if id(link.hetero) in beside:
            yield Repair.of(Kind.NO_PARAMETERS, atoms=link.atoms, why=error)
        elif link.stated:
            yield Repair.of(Kind.BOND_IGNORED, atoms=link.atoms, why=error)
        else:
            a, b = link.atoms
            raise StructureError(
                f"{draft.source}: {a.residue} and {b.residue} are joined by an amide bond "
                f"({a.name}-{b.name}), which has no parameters: ", *_parts(error), "; remove that bond",
            ) from None  # fmt: skip


def _parts(error: Exception) -> tuple[object, ...]:
    return error.parts if isinstance(error, ProtochainError) else (str(error),)


def _about_unknown(draft: Draft, unknown: Sequence[tuple[Member, Exception]]) -> tuple[object, ...]:
    """What residues have no parameters and why, what to do; other chains are offered if they hold none."""
    chains = dict.fromkeys(part.chain_id for part in draft.parts if not part.obstacle)
    free = [name for name in chains if name and name not in {member.chain_id for member, _ in unknown}]
    stated = "is an unknown amino acid" if len(unknown) == 1 else "are unknown amino acids"
    it = "it" if len(unknown) == 1 else "them"
    others = (", or take only what has none: ", Argument("chains", ",".join(free))) if free else ()
    return (
        f"{listed([str(member) for member, _ in unknown])} {stated} without a standard parent (",
        *_parts(unknown[0][1]),
        f"); replace or remove {it}, or give a force field that defines {it}",
        *others,
    )


def _take_in(draft: Draft, chemist: LigandChemistry, made: Fragment, special: Collection[int]) -> Changes:
    """Give the residues of a fragment their templates, take away what leaves, and report both."""
    called: dict[int, dict[int, str]] = {}
    mine: dict[int, Member] = {}
    names = made.ligand.molecule.names
    for i, ((m, own), name) in enumerate(zip(made.owners, names, strict=True)):
        if m is not None and id(m) in special and name[-1] not in "+-":
            mine[id(m)] = m
            called.setdefault(id(m), {})[i] = own
    # Charges of the templates only turn hydroxyls while hydrogens are placed.
    metals = {k: charged_metals(m, chemist.name(m), called[k].values()) for k, m in mine.items()}
    found = {k: (m, template_of(m.name, made.ligand, called[k], metals[k])) for k, m in mine.items()}
    leavers = {(id(m), name) for gone in made.bonds.values() for m, name in gone}
    for m, template in found.values():
        there = {a.name for a in m.heavy if (id(m), a.name) not in leavers}
        if strange := (there ^ {*template.heavy}) - {"OXT", "OP3"}:
            odd = ", ".join(sorted(strange))
            raise StructureError(f"{m}: {odd} missing or unknown", fault=Fault.INCOMPLETE)
    parts = {id(m): part for part in draft.parts for m in part.members}
    formal, wrong = made.ligand.molecule.formal_charges.tolist(), _inverted(made)
    for m, template in found.values():
        m.source = template
        states = {name: q for (owner, name), q in zip(made.owners, formal, strict=True) if owner is m}
        charge = sum(states.values()) + sum(a.charge for a in metals[id(m)])
        source = chemist.lookup(m).source
        yield Repair.of(Kind.MODIFIED, residue=m.residue, source=source, charge=f"{charge:+d}")
        yield from report_metals(m, metals[id(m)])
        for a in m.atoms if parts[id(m)].obstacle else ():
            a.charge = states.get(a.name, a.charge)
        if not m.is_d and (its := tuple(name for owner, name in wrong if owner is m)):
            yield Repair.of(Kind.INVERTED, residue=m.residue, atoms=its)
        if parts[id(m)].obstacle:
            parts[id(m)].evidence = Evidence.FRAGMENT
        if chemist.name(m) in chemist.chemistry.user_sources:
            # The file written has to give the same chemistry again.
            draft.header = with_component(draft.header, tables.heavy_rows(chemist.name(m), chemist.lookup(m)))
    for link, left in made.bonds.items():
        back = [(m, x) for m, a, *_ in _both_ways(link) for x in _back(chemist, m, a.name, left)]
        gone = [each for each in left if each not in back]
        lost = [loss for m in (link.member, link.hetero) for loss in _lost(m, {n for o, n in gone if o is m})]
        names = tuple(f"{name} of {m.residue.name}" for m, name in gone)
        yield Repair.of(Kind.LINKED, tuple(lost), atoms=link.atoms, length=link.length, gone=names)
    # A chain goes on through what both of its ends are bonded to, as GFP's through the chromophore.
    ends = {end for link in made.bonds for end in link.atoms}
    draft.repairs = [
        each
        for each in draft.repairs
        if each.kind is not Kind.GAP
        or not {Atom("C", each.facts["last"]), Atom("N", each.facts["first"])} <= ends
    ]
    draft.fragments.append(made)


def _inverted(made: Fragment) -> list[tuple[Member | None, str]]:
    """Stereocentres, and double bonds as ``C1=C2``, that are not as in their sources, by residue."""
    molecule, own = made.ligand.molecule, made.owners
    there = [m.atom(name) if m else None for m, name in (own[i] for i in molecule.heavy)]
    x = np.array([a.pos.tolist() if a else [np.nan] * 3 for a in there]) / ANGSTROM_PER_NM
    return [(own[its[0]][0], "=".join(own[i][1] for i in its)) for its in inverted_atoms(molecule, x)]


def _back(
    chemist: LigandChemistry, member: Member, name: str, gone: Collection[tuple[Member, str]]
) -> list[str]:
    """Hydrogens that leave an atom and that the charge of an amine brings back."""
    if member.template is None or (graph := _graph(chemist, member)) is None:
        return []
    light, now = graph.light(name), member.template.hydrogens.get(name, ())
    leaving = [x for x in light if (member, x) in gone]
    return leaving[: max(len(now) + len(leaving) - len(light), 0)]


def _lost(member: Member, names: Collection[str]) -> tuple[Loss, ...]:
    """Take atoms away from a residue, as far as the file has them."""
    gone = [a for a in member.atoms if a.name in names]
    member.atoms = [a for a in member.atoms if a.name not in names]
    return losses(member, gone, Reason.BONDED)
