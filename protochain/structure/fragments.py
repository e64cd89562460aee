"""Residues that no template fits, with their own chemistry: modified, cross-linked, or bonded beside a chain.

A fragment is what bonds other than those along a chain join, capped as by acetyl and methylamide where chains
go on. A backbone like alanine's keeps the parameters of alanine, and residues that the force field knows keep
theirs; SMIRNOFF has all terms that touch another atom.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import chain, count
from typing import NamedTuple

import gemmi
import numpy as np
from scipy.spatial import KDTree

from protochain.core import defaults
from protochain.core.checks import CHARGE_RULES
from protochain.core.errors import Argument, Fault, ProtochainError, StructureError
from protochain.core.graph import components, neighbours
from protochain.core.markup import listed
from protochain.ligands import Ligand, parametrised
from protochain.ligands.dictionary import leaving
from protochain.ligands.molecule import Molecule, assembled, from_rdkit, library, quietly
from protochain.ligands.protonation import at_ph
from protochain.structure.bound import Chemist, template_of
from protochain.structure.chirality import WELL_FORMED, hand
from protochain.structure.draft import Draft, Fragment, Member, Part, losses
from protochain.structure.kept import cut
from protochain.structure.linkage import SHORTEST, STATED_SLACK, Link, usual_length
from protochain.structure.repairs import Kind, Loss, Why
from protochain.structure.residues import BACKBONE, NUCLEOTIDES, OF_ALANINE, Atom, name_in_file
from protochain.structure.sites import stated_beside
from protochain.structure.templates import (
    HAS_GLYCAM,
    HAS_SAGE,
    PHOSPHATE_END,
    Template,
    archive_parent,
    other_names,
)

_H, _C, _N, _O, _P, _S = 1, 6, 7, 8, 15, 16
_MONOVALENT = (_N, _O, 9, 16, 17, 35, 53)
"""Elements of atoms at the end of a single bond that may leave, hydrogens aside."""
_DOUBLE = 0.03
"""Angstrom by which a bond that may be double is shorter than the sum of its covalent radii, if it is: by
0.12 in C=C, 0.06 in aromatic rings; single ones are longer by 0.05."""
_AMIDE = 1.7
"""Angstrom: an amine nearer than this to the carbon of a carboxyl is bonded to it (1.33)."""
_AMINES = {"LYS": "NZ", "ORN": "NE", "DAB": "ND"}
_ACYLS = {
    "ASP": ("CG", "OD1", "OD2"), "GLU": ("CD", "OE1", "OE2"), "ASN": ("CG", "OD1", "ND2"),
    "GLN": ("CD", "OE1", "NE2"),
}  # fmt: skip
"""With the atoms of which an amide bond takes the place of one: where both are there, two side chains of a
poor model overlap."""


class _Place(NamedTuple):
    """Where a residue is: the molecule, its place there, and the residues that its N and C are bonded to."""

    part: Part
    i: int
    before: Member | None
    after: Member | None


def settle(draft: Draft, chemist: Chemist, links: Sequence[Link]) -> list[Link]:
    """Give residues that no template fits their parameters, and report them.

    Parameters
    ----------
    draft : Draft
        Receives the fragments, and their bonds.
    chemist : Chemist
    links : sequence of Link
        Bonds of the protein to molecules beside it.

    Returns
    -------
    list of Link
        Those that springs are to hold.

    Raises
    ------
    StructureError
        If residues have no parameters, and no standard parent to become.
    """
    where = {id(m): at for part in draft.parts for m, at in _places(part)}
    cross = list(_crosslinks(draft, where))
    for link in cross:
        link.member.links.append(link.atom)
        link.other.links.append(link.other_atom)
    beside = [link for link in links if not link.is_metal] + [*_between(draft)]
    bonds = beside + cross
    ends: dict[int, set[str]] = {}
    for link in bonds:
        ends.setdefault(id(link.member), set()).add(link.atom.name)
        ends.setdefault(id(link.other), set()).add(link.other_atom.name)
    special = [
        m for m in draft.members
        if m.odd or (id(m) in ends and not _is_whole(where[id(m)], m, ends[id(m)]))
    ]  # fmt: skip
    odd = {id(m) for m in special}
    number = {key: k for k, key in enumerate(where)}
    pairs = [(number[a], number[b]) for link in bonds for a, b in [link.owners]]
    for m in special:
        _, _, before, after = where[id(m)]
        wide: list[Member | None] = []
        if where[id(m)].part.obstacle:
            wide = [before] if before and before.odd and not _is_phosphodiester(before, m) else []
        elif (before or after) and not _is_like_alanine(chemist, m):
            wide = [before, after]
        pairs += [(number[id(m)], number[id(each)]) for each in wide if each]
    group = components(np.array(pairs, dtype=np.int64).reshape(-1, 2), len(number))
    unknown: list[tuple[Member, ProtochainError | ValueError]] = []
    still: list[Member] = []
    for g in dict.fromkeys(int(group[number[id(m)]]) for m in special):
        mine = [m for m in draft.members if group[number[id(m)]] == g]
        own = [link for link in bonds if any(link.member is m for m in mine)]
        around = [m for m in mine if where[id(m)].part.obstacle]
        try:
            if around and not chemist.chemistry.has_sage:
                raise StructureError(f"OpenFF Sage goes with {HAS_GLYCAM} and {HAS_SAGE} only")
            _take_in(draft, chemist, _Maker(chemist, mine, own, where, odd).fragment(), odd)
        except (ProtochainError, ValueError) as error:  # RDKit's, of rings that it cannot kekulize.
            if given := next((m for m in around if chemist.name(m) in chemist.chemistry.moving), None):
                raise StructureError(f"{draft.source}: {given}: ", *_parts(error)) from None
            for m in around:
                where[id(m)].part.is_small = False
                where[id(m)].part.mobile &= m.odd
                if m.odd:
                    draft.note(Kind.STAYS_UNKNOWN, residue=m.residue, why=error)
                    still.append(m)
            unknown += [(m, error) for m in mine if m.odd and not m.parent and m not in still]
            _refuse_or_tie(draft, own, error)
            why = Why.INCOMPLETE if getattr(error, "fault", None) is Fault.INCOMPLETE else Why.PARENT
            for m in (m for m in mine if m.parent):
                to_parent(draft, chemist.templates, m, why)
            continue
        bonds = [link for link in bonds if link not in own]
    if unknown:
        raise StructureError(f"{draft.source}: ", *_unknown_told(draft, unknown))
    draft.parts = [
        piece for part in draft.parts for piece in cut(draft, part, [m for m in part.members if m in still])
    ]
    return [link for link in links if link in bonds or link not in beside]


def _between(draft: Draft) -> Iterator[Link]:
    """Bonds that the file states between molecules beside the protein, but of metals and known glycans.

    Those that are too long are reported.
    """
    parts = {id(m): part for part in draft.parts for m in part.members}
    for link in stated_beside(draft):
        (one, other), names = (parts[each] for each in link.owners), {link.atom.name, link.other_atom.name}
        if (
            link.atom.element.is_metal or link.is_metal or (one.glycan and other.glycan)
            or min(len(link.member.atoms), len(link.other.atoms)) == 1
            or (one is other and names == {"O3'", "P"})
        ):  # fmt: skip
            continue
        if link.length < SHORTEST or link.excess > STATED_SLACK:
            draft.note(Kind.BOND_IGNORED, atoms=link.atoms, why=f"it is {link.length:.2f} angstrom long")
        else:
            yield link


def _places(part: Part) -> Iterator[tuple[Member, _Place]]:
    members = part.members
    for i, member in enumerate(members):
        before = members[i - 1] if i or part.cyclic else None
        after = members[(i + 1) % len(members)] if i + 1 < len(members) or part.cyclic else None
        yield member, _Place(part, i, before, after)


def _is_whole(at: _Place, member: Member, ends: set[str]) -> bool:
    """Whether a template fits a residue of a chain all the same: its bond goes on where the chain ends."""
    open_ends = {name for name, other in (("N", at.before), ("C", at.after)) if other is None}
    return not at.part.obstacle and ends <= open_ends and not member.odd


def _is_phosphodiester(before: Member, after: Member) -> bool:
    """Whether two nucleotides are joined as usual, so that no term has changed atoms of both."""
    return before.atom("O3'") is not None and all(map(after.atom, ("P", "OP1", "OP2", "O5'")))


def _is_dna(members: Sequence[Member]) -> bool:
    """Whether most standard nucleotides are those of DNA; without such, whether none has O2'."""
    known = [m.name for m in members if m.name in NUCLEOTIDES]
    if not known:
        return not any(m.atom("O2'") for m in members)
    return 2 * sum(name[0] == "D" for name in known) > len(known)


def _is_like_alanine(chemist: Chemist, member: Member) -> bool:
    try:
        free = chemist.free(member)
    except ProtochainError:
        return True  # Told later.
    graph = _Graph()
    graph.add("", free)
    return graph.backbone("")


def _crosslinks(draft: Draft, where: dict[int, _Place]) -> Iterator[Link]:
    """Bonds between residues of chains, but those along a chain and disulfides, that the file states or has.

    Those stated that are too long are reported.
    """
    chains = [m for m in draft.members if not where[id(m)].part.obstacle]
    there = {m.address(a.name): (m, a) for m in chains for a in m.atoms if not a.is_hydrogen()}
    along = {frozenset((m.address("C"), after.address("N"))) for m in chains if (after := where[id(m)].after)}
    done = {*along}
    for first, second in draft.stated:
        pair = frozenset((first, second))
        if pair in done or not pair <= there.keys() or len(pair) < 2:
            continue
        done.add(pair)
        link = Link(*there[first], *there[second], stated=True)
        is_disulfide = link.member.name == link.other.name == "CYS" and first[2] == second[2] == "SG"
        if link.member is link.other or is_disulfide:
            continue
        if link.length < SHORTEST or link.excess > STATED_SLACK:
            draft.note(Kind.BOND_IGNORED, atoms=link.atoms, why=f"it is {link.length:.2f} angstrom long")
        else:
            yield link
    nitrogens = [(m, m.atom(_AMINES.get(m.name, ""))) for m in chains]
    nitrogens += [(m, m.atom("N")) for m in chains if where[id(m)].before is None]
    amines = [(m, a) for m, a in nitrogens if a]
    open_acids = [m for m in chains if m.name in _ACYLS and not all(map(m.atom, _ACYLS[m.name][1:]))]
    carbons = [(m, m.atom(_ACYLS[m.name][0])) for m in open_acids]
    carbons += [(m, m.atom("C")) for m in chains if where[id(m)].after is None and not m.atom("OXT")]
    acyls = [(m, a) for m, a in carbons if a]
    tree = KDTree(np.array([a.pos.tolist() for _, a in acyls]).reshape(-1, 3))
    for m, a in amines:
        for k in sorted(tree.query_ball_point(a.pos.tolist(), _AMIDE)):
            other, its = acyls[k]
            if other is not m and frozenset((m.address(a.name), other.address(its.name))) not in done:
                yield Link(m, a, other, its)


def _refuse_or_tie(draft: Draft, links: Sequence[Link], error: Exception) -> None:
    """Report bonds without parameters: springs hold those to molecules beside a chain, others are ignored.

    Raises
    ------
    StructureError
        For one that the file does not state.
    """
    beside = {id(m) for part in draft.parts if part.obstacle for m in part.members}
    for link in links:
        if id(link.other) in beside:
            draft.note(Kind.NO_PARAMETERS, atoms=link.atoms, why=error)
        elif link.stated:
            draft.note(Kind.BOND_IGNORED, atoms=link.atoms, why=error)
        else:
            a, b = link.atoms
            raise StructureError(
                f"{draft.source}: {a.residue} and {b.residue} are joined by an amide bond "
                f"({a.name}-{b.name}), which has no parameters: ", *_parts(error), "; remove that bond",
            ) from None  # fmt: skip


def _parts(error: Exception) -> tuple[object, ...]:
    return error.parts if isinstance(error, ProtochainError) else (str(error),)


def _unknown_told(draft: Draft, unknown: Sequence[tuple[Member, Exception]]) -> tuple[object, ...]:
    """What residues have no parameters and why, what to do; other chains are offered if they hold none."""
    chains = dict.fromkeys(part.chain_id for part in draft.parts if not part.obstacle)
    free = [name for name in chains if name and name not in {member.chain_id for member, _ in unknown}]
    said = "is an unknown amino acid" if len(unknown) == 1 else "are unknown amino acids"
    it = "it" if len(unknown) == 1 else "them"
    others = (", or take only what has none: ", Argument("chains", ",".join(free))) if free else ()
    return (
        f"{listed([str(member) for member, _ in unknown])} {said} without a standard parent (",
        *_parts(unknown[0][1]),
        f"); replace or remove {it}, or give a force field that defines {it}",
        *others,
    )


class _Graph:
    """Atoms and bonds by name, as they are put together."""

    def __init__(self) -> None:
        self.atoms: dict[str, list[int]] = {}
        self.bonds: dict[frozenset[str], int] = {}

    def add(self, prefix: str, of: Molecule) -> None:
        """Add a molecule under names with a prefix."""
        names = [prefix + name for name in of.names]
        for name, z, q in zip(names, of.elements.tolist(), of.formal_charges.tolist(), strict=True):
            self.atoms[name] = [z, q]
        for (i, j), order in zip(of.bonds.tolist(), of.orders.tolist(), strict=True):
            self.bonds[frozenset((names[i], names[j]))] = order

    def near(self, a: str) -> list[str]:
        """Atoms bonded to one."""
        return [end for bond in self.bonds if a in bond for end in bond if end != a]

    def heavy(self, a: str) -> list[str]:
        """Heavy atoms bonded to one."""
        return [each for each in self.near(a) if self.atoms[each][0] != _H]

    def light(self, a: str) -> list[str]:
        """Hydrogens bonded to one."""
        return [each for each in self.near(a) if self.atoms[each][0] == _H]

    def order(self, a: str, b: str) -> int:
        """Order of a bond; 0 if there is none."""
        return self.bonds.get(frozenset((a, b)), 0)

    def drop(self, gone: Sequence[str]) -> None:
        """Take away atoms with their bonds."""
        for each in gone:
            del self.atoms[each]
        self.bonds = {bond: order for bond, order in self.bonds.items() if not bond & {*gone}}

    def backbone(self, prefix: str) -> bool:
        """Whether N, CA, C and O are bonded as in alanine: CA is tetrahedral, C that of an acid or amide."""
        n, alpha, c, o = (prefix + name for name in (*BACKBONE, "O"))
        if not {n, alpha, c, o} <= self.atoms.keys():
            return False
        around = self.near(alpha)
        return (
            [self.order(alpha, n), self.order(alpha, c), self.order(c, o)] == [1, 1, 2]
            and len(around) == 4
            and all(self.order(alpha, each) == 1 for each in around)
            and self.atoms[n][0] == _N and self.atoms[c][0] == _C and self.atoms[o][0] == _O
            and len(self.heavy(c)) == 3
            and any(self.atoms[each][0] in (_N, _O) for each in self.heavy(c) if each not in (alpha, o))
        )  # fmt: skip

    def is_acyl(self, n: str) -> bool:
        """Whether a nitrogen has the carbonyl of an amide within its residue."""
        return any(
            self.order(c, o) == 2 and self.atoms[o][0] == _O
            for c in self.heavy(n) if c[-1] not in "+-" for o in self.heavy(c)
        )  # fmt: skip

    def leave(self, a: str, absent: Collection[str], flagged: Collection[str]) -> tuple[list[str], int]:
        """Take away groups that are absent at an atom, or else one that its component says may leave.

        Returns
        -------
        gone : list of str
        freed : int
            Valences of the atom that this frees.
        """
        groups = {x: self.beyond(a, x) for x in self.heavy(a)}
        marked = sorted((x for x in groups if groups[x].keys() <= {*flagged}), key=lambda x: self.order(a, x))
        at = [x for x in groups if groups[x].keys() <= {*absent} and (x in marked or len(groups[x]) == 1)]
        at = at or marked[:1]
        for x in at:  # Of an acid a hydroxyl leaves, whatever its oxygens are called.
            self.turn(x)
        gone = [each for x in at for each in groups[x]]
        freed = sum(self.order(a, x) for x in at)
        self.drop([each for x in gone for each in (x, *self.light(x))])
        return gone, freed

    def beyond(self, a: str, x: str) -> dict[str, None]:
        """Heavy atoms of a group: a neighbour of an atom, and all that only this holds."""
        found = {x: None}
        ends = [x]
        while ends:
            ends = [y for end in ends for y in self.heavy(end) if (end, y) != (x, a) and y not in found]
            found |= dict.fromkeys(ends)
        return found

    def turn(self, a: str) -> None:
        """Give a doubly bonded oxygen of an acid the hydrogen and the charge of one of its others."""
        for c in self.heavy(a) if self.atoms[a][0] == _O else ():
            single = (x for x in self.heavy(c) if self.order(x, c) == 1 and self.heavy(x) == [c])
            x = next((x for x in single if self.atoms[x][0] == _O), a)
            if self.order(a, c) == 2 and x != a:
                self.bonds |= {frozenset((a, c)): 1, frozenset((x, c)): 2}
                self.bonds |= {frozenset((a, h)): self.bonds.pop(frozenset((x, h))) for h in self.light(x)}
                self.atoms[a], self.atoms[x] = self.atoms[x], self.atoms[a]

    def acceptors(self, a: str) -> list[str]:
        """Neighbours whose double bond is used up when a nucleophile adds to a carbon, as of acrylamides.

        They hold a carbonyl or the like. Distances have to show it in quinones, where more carbons are
        conjugated, and in but-2-enamides, as which the archive has bonded but-2-ynamides.
        """

        def is_multiple(x: str, *elements: int) -> bool:
            return any(self.order(x, y) > 1 and self.atoms[y][0] in elements for y in self.heavy(x) if y != a)

        carbons = [x for x in self.heavy(a) if self.atoms[a][0] == self.atoms[x][0] == _C]
        if any(is_multiple(x, _C) or self.heavy(x) == [a] for x in carbons):
            return []
        double = [x for x in carbons if self.order(a, x) > 1]
        return [x for x in double if any(is_multiple(y, _N, _O) for y in self.heavy(x) if y != a)]

    def give(self, a: str, order: int, freed: int, single: Sequence[str]) -> list[str]:
        """Free valences of an atom for a bond; ``single`` are neighbours whose bonds are used up first.

        Returns
        -------
        list of str
            Atoms that leave.

        Raises
        ------
        StructureError
            If it has none.
        """
        z, q = self.atoms[a]
        light, heavy = self.light(a), self.heavy(a)
        room = 3 - sum(self.order(a, x) for x in heavy) - order
        if z == _N and room >= 0:
            self.atoms[a][1] = 0
            self.drop(light[room:])
            return light[room:]
        # A bond that another has used up may have left it one free.
        freed = max(freed, 4 - sum(self.order(a, x) for x in (*light, *heavy)) if z == _C and not q else 0)
        need = order - freed
        if q < 0 < need:
            self.atoms[a][1], need = q + 1, need - 1
        multiple = [x for x in heavy if self.order(a, x) > 1 and z == _C]
        # An acid keeps its carbonyl: a group of it leaves.
        is_acid = any(self.order(a, x) == 1 and self.atoms[x][0] in (_N, _O, _S) for x in heavy)
        for x in multiple:
            is_kept = is_acid and self.atoms[x][0] == _O
            if need > 0 and (x in single or (len(light) < need and not is_kept)):
                self.bonds[frozenset((a, x))] -= 1
                need -= 1
        alone = [x for x in heavy if self.order(a, x) == 1 and self.heavy(x) == [a]]
        ends = [x for x in alone if self.atoms[x][0] in _MONOVALENT]
        gone = [*light, *ends][: max(need, 0)]
        if len(gone) < need == 1 and z == _S and len(heavy) == 2 and not q:
            self.atoms[a][1], need = 1, 0  # A sulphonium, as of methionine and tyrosine of catalases.
        if len(gone) < need:
            raise StructureError(f"{a.partition(':')[2]} has no valence left for a bond")
        self.drop([y for x in gone for y in (x, *(self.light(x) if x in ends else ()))])
        return gone

    def molecule(self, source: str) -> Molecule:
        """As a value, with the hydrogens that lack.

        Raises
        ------
        StructureError
            If it is no molecule.
        """
        names = [*self.atoms]
        place = {name: k for k, name in enumerate(names)}
        made = assembled(
            names, [z for z, _ in self.atoms.values()], [q for _, q in self.atoms.values()],
            [sorted(place[end] for end in bond) for bond in self.bonds], [*self.bonds.values()], None,
        )  # fmt: skip
        try:
            quietly(library("rdkit.Chem").SanitizeMol, made)
        except ValueError as error:
            reason = " ".join(str(error).split())
            raise StructureError(f"{source}: cannot be bonded as the file has it ({reason})") from None
        return from_rdkit(made, source)


class _Maker:
    """Puts the molecule of one fragment together."""

    def __init__(
        self,
        chemist: Chemist,
        members: Sequence[Member],
        links: Sequence[Link],
        where: Mapping[int, _Place],
        special: Collection[int],
    ) -> None:
        self.chemist, self.members, self.links, self.where = chemist, members, links, where
        self.special = special
        tags = [f"{m.name}-{k}" if k else m.name for k, m in enumerate(members)]
        self.tag = {id(m): f"{tag}:" for m, tag in zip(members, tags, strict=True)}
        self.of_tag = dict(zip(tags, members, strict=True))
        self.graph, self.flagged = _Graph(), set[str]()
        self.acids, self.amines = list[str](), list[str]()
        self.at: dict[str, gemmi.Atom] = {}

    def fragment(self) -> Fragment:
        """Chemistry and parameters, whose atoms these are, and what leaves at each bond.

        Raises
        ------
        ProtochainError
            If it has no chemistry or no parameters; with ``Fault.INCOMPLETE`` if the file lacks atoms.
        """
        sources: dict[str, None] = {}
        for m in self.members:
            free, tag = self.chemist.free(m), self.tag[id(m)]
            sources[free.source] = None
            self.graph.add(tag, free)
            self.at |= {tag + a.name: a for a in m.atoms if not a.is_hydrogen()}
            self.flagged |= {tag + name for name in (*leaving(self.chemist.name(m)), "OXT", "OP3")}
            if self.where[id(m)].part.obstacle:
                self._without_far(tag)
        bonds = {}
        for link in self.links:
            ends = (link.member, link.atom), (link.other, link.other_atom)
            first, second = (self.tag[id(m)] + a.name for m, a in ends)
            gone = self._join(first, second)
            parted = (each.split(":") for each in gone)
            bonds[link] = tuple((self.of_tag[tag], name) for tag, name in parted)
        for m in self.members:
            self._go_on(self.tag[id(m)], m)
        chemistry = self.chemist.chemistry
        ligand = _parametrised(
            tuple((name, z, q) for name, (z, q) in self.graph.atoms.items()),
            tuple((*sorted(bond), order) for bond, order in self.graph.bonds.items()),
            " and ".join(sources), tuple(self.acids), tuple(self.amines),
            chemistry.charges if chemistry.charges in CHARGE_RULES else defaults.LIGAND_CHARGES, chemistry.ph,
        )  # fmt: skip
        graph = _Graph()
        graph.add("", ligand.molecule)
        owners, core = list[tuple[Member | None, str]](), list[str]()
        strands = [m for m in self.members if self.where[id(m)].part.is_strand and id(m) in self.special]
        cores = {id(m): self._nucleic_core(graph, m) for m in strands}
        for name in graph.atoms:
            prefix, _, own = name.partition(":")
            m = self.of_tag[prefix]
            owners.append(self._cap_owner(m, own) if own[-1] in "+-" else (m, own))
            is_core = id(m) not in self.special or (
                not self.where[id(m)].part.obstacle and _is_core(graph, f"{prefix}:", own)
            )
            core.append(cores[id(m)].get(own, "") if id(m) in cores else own if is_core else "")
        return Fragment(ligand, tuple(owners), tuple(core), bonds)

    def _without_far(self, tag: str) -> None:
        """Take away atoms that the file lacks, but those next to one that it has, which may leave there."""
        graph = self.graph
        absent = [
            a for a, (z, _) in graph.atoms.items() if a.startswith(tag) and z != _H and a not in self.at
        ]
        far = [a for a in absent if not self.at.keys() & {*graph.heavy(a)}]
        graph.drop([y for x in far for y in (x, *graph.light(x))])

    def _absent_at(self, a: str) -> list[str]:
        """An oxygen of a nucleotide, by whatever name, that leaves where its strand goes on."""
        if not self.where[id(self.of_tag[a.partition(":")[0]])].part.is_strand:
            return []
        return [x for x in self.graph.heavy(a) if x not in self.at and self.graph.atoms[x][0] == _O][:1]

    def _cap_owner(self, member: Member, name: str) -> tuple[Member | None, str]:
        """Residue and atom that an atom of a cap stands for, if it does."""
        part, _, before, after = self.where[id(member)]
        own = name[:-1]
        if part.obstacle:
            return before if name[-1] == "-" else after, own
        if name == "CA-" and before is not None and before.atom("CH3"):
            own = "CH3"
        other = before if name in ("C-", "O-", "CA-") else after if name == "N+" else None
        return other, own

    def _nucleic_core(self, graph: _Graph, member: Member) -> dict[str, str]:
        """What the force field calls atoms of a nucleotide, if their neighbours are those it has there.

        Of a modified one only those of sugar and phosphate.
        """
        tag, (part, _, before, after) = self.tag[id(member)], self.where[id(member)]
        is_standard = member.name in NUCLEOTIDES
        kind = member.name if is_standard else "DA" if _is_dna(part.members) else "A"
        both = [end for x in self.links for end in ((x.member, x.atom), (x.other, x.other_atom))]
        bonded = {a.name for m, a in both if m is member}
        is_first, is_last = not (before or "P" in bonded), not (after or "O3'" in bonded)
        ends = {(True, True): "N", (True, False): "5", (False, True): "3"}.get((is_first, is_last), "")
        if is_first and f"{tag}P" in graph.atoms:
            kind, ends = PHOSPHATE_END + kind, ""
        its = self.chemist.templates.get(kind + ends)
        if its is None:
            return {}
        # There are no parameters of bonds between DNA and RNA.
        across = {
            name
            for name, other in (("P", before), ("O3'", after))
            if other and other.name in NUCLEOTIDES and _is_dna([other]) != ("D" in kind)
        }
        called = {its.synonyms.get(own, own): tag + own for own in (a.name for a in member.atoms)}
        inner = [name for name in its.heavy if is_standard or {*name} & {"'", "P"}]
        found: dict[str, str] = {}
        for name in (name for name in inner if name not in across and called.get(name) in graph.atoms):
            a, light = called[name], its.hydrogens.get(name, [])
            outer = {"P": not is_first, "O3'": not is_last, "C1'": not is_standard}.get(name, False)
            near = {called.get(each, "") for each in its.neighbours(name) if each in inner}
            heavy = {*graph.heavy(a)}
            if (
                gemmi.Element(graph.atoms[a][0]).name == its.element[name]
                and near <= heavy and len(heavy - near) == outer and len(graph.light(a)) == len(light)
            ):  # fmt: skip
                mine = (each.removeprefix(tag) for each in (a, *graph.light(a)))
                found |= dict(zip(mine, (f"{its.name}/{each}" for each in (name, *light)), strict=True))
        return found

    def _join(self, a: str, b: str, along: bool = False) -> tuple[str, ...]:
        """Bond two atoms; return those that leave."""
        graph = self.graph
        if not {a, b} <= graph.atoms.keys():
            raise StructureError(f"its chemistry has no {(b if a in graph.atoms else a).partition(':')[2]}")
        absent = {*self._absent_at(a), *self._absent_at(b)} if along else graph.atoms.keys() - self.at.keys()
        # Carbon that a ligand lacks has not left: it is missing.
        absent -= {
            x
            for x in absent
            if graph.atoms[x][0] == _C and self.where[id(self.of_tag[x.partition(":")[0]])].part.obstacle
        }
        # Poor models have amide and glycosidic bonds of nitrogen as short as double ones.
        carbons = graph.atoms[a][0] == graph.atoms[b][0] == _C
        is_short = not along and carbons and self._excess(a, b) < -_DOUBLE
        for end in () if along else (a, b):
            graph.turn(end)
        left = {end: graph.leave(end, absent, self.flagged) for end in (a, b)}
        free = {end: freed for end, (_, freed) in left.items()}
        is_double = (max(free.values()) > 1 or is_short) and all(
            free[end] + len(graph.light(end)) > 1
            and graph.atoms[end][0] in (_C, _N)
            and all(graph.order(end, x) == 1 for x in graph.near(end))
            for end in (a, b)
        )
        gone = [x for each, _ in left.values() for x in each]
        adds = not carbons and not gone and not self.flagged & {*graph.light(a), *graph.light(b)}
        for end in (a, b):
            single = self._single(end) + (graph.acceptors(end) if adds else [])
            gone += graph.give(end, 1 + is_double, free[end], single)
        graph.bonds[frozenset((a, b))] = 1 + is_double
        return tuple(gone)

    def _single(self, a: str) -> list[str]:
        """Neighbours of an atom as far away from it as by a single bond."""
        return [x for x in self.graph.heavy(a) if self._excess(a, x) > -_DOUBLE]

    def _excess(self, a: str, b: str) -> float:
        """How much further apart two atoms are than by a single bond, angstrom; NaN if one is not there."""
        if not {a, b} <= self.at.keys():
            return float("nan")
        one, other = self.at[a], self.at[b]
        return one.pos.dist(other.pos) - usual_length(one.element.name, other.element.name)

    def _go_on(self, prefix: str, member: Member) -> None:
        """Bond a residue to the next one of its chain, and put caps in the place of others."""
        part, _, before, after = self.where[id(member)]
        end, start = ("O3'", "P") if part.obstacle else ("C", "N")
        c, n, graph = prefix + end, prefix + start, self.graph
        if after is not None and id(after) in self.tag:
            self._join(c, self.tag[id(after)] + start, along=True)
        if part.obstacle:
            if after is not None and id(after) not in self.tag:
                self._cap(c, *_STRAND_AFTER)
            if before is not None and id(before) not in self.tag:
                self._cap(n, *_STRAND_BEFORE)
            elif before is None and part.is_strand and n in graph.atoms and n not in self.at:
                # The strand begins with a hydroxyl.
                ends = [x for x in graph.heavy(n) if len(graph.heavy(x)) == 1]
                graph.drop(
                    [y for x in (n, *ends) for y in ((x, *graph.light(x)) if x in graph.atoms else ())]
                )
            return
        linked = {a.name for a in member.links}
        if (after is not None and id(after) not in self.tag) or (
            after is None and "C" not in linked and graph.heavy(f"{prefix}OXT") == [c]
        ):
            self.acids += [prefix] * (after is None)
            self._cap(c, {"N+": _N, "CA+": _C}, {("N+", "CA+"): 1})
        is_amine = bool(graph.light(n)) and not graph.is_acyl(n)
        if (before is not None and id(before) not in self.tag) or (
            before is None and "N" not in linked and is_amine
        ):
            self.amines += [prefix] * (before is None)
            self._cap(n, {"C-": _C, "O-": _O, "CA-": _C}, {("C-", "O-"): 2, ("C-", "CA-"): 1})

    def _cap(self, a: str, atoms: Mapping[str, int], bonds: Mapping[tuple[str, str], int]) -> None:
        """Bond an atom to the first of those that stand for a neighbour."""
        prefix, _, own = a.partition(":")
        prefix += ":"
        if a not in self.graph.atoms:
            raise StructureError(f"its chemistry has no {own}")
        _, freed = self.graph.leave(a, self._absent_at(a), self.flagged)
        self.graph.give(a, 1, freed, ())
        for name, z in atoms.items():
            self.graph.atoms[prefix + name] = [z, 0]
        self.graph.bonds[frozenset((a, prefix + next(iter(atoms))))] = 1
        for ends, order in bonds.items():
            self.graph.bonds[frozenset(prefix + end for end in ends)] = order


_STRAND_BEFORE = {"O3'-": _O, "C3'-": _C}, {("O3'-", "C3'-"): 1}
_STRAND_AFTER = (
    {"P+": _P, "OP1+": _O, "OP2+": _O, "O5'+": _O, "C5'+": _C},
    {("P+", "OP1+"): 2, ("P+", "OP2+"): 1, ("P+", "O5'+"): 1, ("O5'+", "C5'+"): 1},
)
"""Atoms and bonds that stand for the neighbours of a nucleotide."""


def _is_core(graph: _Graph, prefix: str, name: str) -> bool:
    """Whether an atom of a residue is one of alanine."""
    a = prefix + name
    if name not in (*OF_ALANINE, "CB") or not graph.backbone(prefix):
        return False
    if name == "CB":
        return graph.atoms[a][0] == _C and len(graph.near(a)) == 4 and f"{prefix}CA" in graph.near(a)
    n, alpha = prefix + "N", prefix + "CA"
    if a in (n, *graph.light(n)):
        # An amine at the start of a chain is that of alanine, unless it bears more.
        return len(graph.heavy(n)) == 1 or graph.atoms[n][1] == 0
    return graph.atoms[a][0] != _H or a in graph.light(alpha)


@lru_cache(maxsize=256)
def _parametrised(
    atoms: tuple[tuple[str, int, int], ...],
    bonds: tuple[tuple[str, str, int], ...],
    source: str,
    acids: tuple[str, ...],
    amines: tuple[str, ...],
    rule: str,
    ph: float,
) -> Ligand:
    """Charge a capped fragment for a pH, put charged ends where chains end, and give it its parameters."""
    graph = _Graph()
    graph.atoms = {name: [z, q] for name, z, q in atoms}
    graph.bonds = {frozenset((a, b)): order for a, b, order in bonds}
    made, charged = at_ph(graph.molecule(source), ph)
    graph = _Graph()
    graph.add("", made)
    for prefix in amines:
        caps = [prefix + name for name in ("C-", "O-", "CA-")]
        graph.drop([y for x in caps for y in (x, *graph.light(x))])
        graph.atoms[prefix + "N"][1] = 1
    for prefix in acids:
        caps = [prefix + name for name in ("N+", "CA+")]
        graph.drop([y for x in caps for y in (x, *graph.light(x))])
        graph.atoms[prefix + "OXT"] = [_O, -1]
        graph.bonds[frozenset((prefix + "C", prefix + "OXT"))] = 1
    molecule = graph.molecule(source) if acids or amines else made
    return parametrised(replace(molecule, names=_names(molecule)), rule, charged=charged)


def _names(molecule: Molecule) -> tuple[str, ...]:
    """Names in which hydrogens have the prefix of their residue, those of a backbone the archive's names."""
    near = neighbours(molecule.bonds, molecule.n_atoms)
    names = [*molecule.names]
    parents = [
        (i, *names[i].split(":"), [j for j in near[i] if molecule.elements[j] == _H])
        for i in molecule.heavy.tolist()
    ]
    taken = {names[i] for i in molecule.heavy}
    done: set[int] = set()
    for _, prefix, own, light in parents:
        if own in _CALLED and (own == "O5'" or f"{prefix}:C" in taken):
            for j, name in zip(light, _CALLED[own][len(light) > 1], strict=False):
                names[j] = f"{prefix}:{name}"
                taken.add(names[j])
                done.add(j)
    for _, prefix, own, light in parents:
        mark = own[-1] if own[-1] in "+-" else ""
        for j in (j for j in light if j not in done):
            short = names[j].split(":")[-1]
            tried = (f"{prefix}:{each}{mark}" for each in chain((short,), (f"H{k}" for k in count(1))))
            names[j] = next(each for each in tried if each not in taken)
            taken.add(names[j])
    return tuple(names)


_CALLED = {"N": (("H",), ("H1", "H2", "H3")), "CA": (("HA",), ("HA2", "HA3")), "O5'": (("HO5'",), ())}
"""Hydrogens of a backbone, if it is one, and if there are several."""


def _take_in(draft: Draft, chemist: Chemist, made: Fragment, special: Collection[int]) -> None:
    """Give the residues of a fragment their templates, take away what leaves, and report both.

    Raises
    ------
    StructureError
        With ``Fault.INCOMPLETE``, if the file lacks atoms of one.
    """
    mine = {
        id(m): m
        for (m, _), name in zip(made.owners, made.ligand.molecule.names, strict=True)
        if name[-1] not in "+-"
    }
    found = {key: (m, _template(m, made)) for key, m in mine.items() if m is not None and key in special}
    leavers = {(id(m), name) for gone in made.bonds.values() for m, name in gone}
    for m, template in found.values():
        there = {a.name for a in m.atoms if not a.is_hydrogen() and (id(m), a.name) not in leavers}
        if strange := (there ^ {*template.heavy}) - {"OXT", "OP3"}:
            odd = ", ".join(sorted(strange))
            raise StructureError(f"{m}: {odd} missing or unknown", fault=Fault.INCOMPLETE)
    parts = {id(m): part for part in draft.parts for m in part.members}
    formal = made.ligand.molecule.formal_charges.tolist()
    for m, template in found.values():
        m.own = template
        charge = sum(q for (owner, _), q in zip(made.owners, formal, strict=True) if owner is m)
        source = chemist.free(m).source
        draft.note(Kind.MODIFIED, residue=m.residue, source=source, charge=f"{charge:+d}")
        if parts[id(m)].obstacle:
            parts[id(m)].mobile, parts[id(m)].is_small = True, False
        m.odd, m.parent = False, ""
    for link, gone in made.bonds.items():
        lost = [loss for m in (link.member, link.other) for loss in _lost(m, {n for o, n in gone if o is m})]
        names = tuple(f"{name} of {m.residue.name}" for m, name in gone)
        draft.note(Kind.LINKED, tuple(lost), atoms=link.atoms, length=link.length, gone=names)
    # A chain goes on through what both of its ends are bonded to, as GFP's through the chromophore.
    ends = {end for link in made.bonds for end in link.atoms}
    draft.repairs = [
        each
        for each in draft.repairs
        if each.kind is not Kind.GAP
        or not {Atom("C", each.facts["last"]), Atom("N", each.facts["first"])} <= ends
    ]
    draft.fragments.append(made)


def _lost(member: Member, names: Collection[str]) -> tuple[Loss, ...]:
    """Take atoms away from a residue, as far as the file has them."""
    gone = [a for a in member.atoms if a.name in names]
    member.atoms = [a for a in member.atoms if a.name not in names]
    return losses(member, gone, Why.BONDED)


def _template(member: Member, made: Fragment) -> Template:
    """Atoms and bonds of a residue; charges only turn hydroxyls while hydrogens are placed."""
    called = {
        i: name for i, (owner, name) in enumerate(made.owners)
        if owner is member and made.ligand.molecule.names[i][-1] not in "+-"
    }  # fmt: skip
    return template_of(member.name, made.ligand, called)


def fullest(name: str) -> str:
    """Name of the state of an amino acid that has the atoms of all."""
    return "HIP" if name == "HIS" else name


def to_parent(draft: Draft, known: Mapping[str, Template], member: Member, why: Why) -> None:
    """Convert a modified residue of a chain to its standard parent."""
    residue, parent, given = member.residue, member.parent or archive_parent(member.name), member.name
    usual = known[fullest(parent)]
    expected = {*usual.element, *other_names(member.atoms, usual), "OXT", "H1", "H2", "H3", "H"}
    for name in set(usual.heavy) - {atom.name for atom in member.atoms}:
        # Selenium, or a sulphur of another name, becomes the parent's sulphur.
        chalcogens = [a for a in member.atoms if a.element.name in ("S", "Se") and a.name not in expected]
        if usual.element[name] == "S" and len(chalcogens) == 1:
            chalcogens[0].name, chalcogens[0].element = name, gemmi.Element("S")
    strange = [atom for atom in member.atoms if atom.name not in expected and not atom.is_hydrogen()]
    member.atoms = [
        atom for atom in member.atoms if atom.name in expected and not (strange and atom.is_hydrogen())
    ]
    member.name, member.parent, member.state, member.odd = parent, "", "", False
    gone = tuple(a.name for a in strange)
    lost = losses(member, strange, why)
    if gemmi.find_tabulated_residue(given).kind not in (gemmi.ResidueKind.AA, gemmi.ResidueKind.AAD):
        # The table does not say of which hand it is.
        member.is_d = hand(member, least=WELL_FORMED) < 0
    if given == "MSE":
        draft.note(Kind.SELENOMETHIONINE, lost, residue=residue)
    elif given != name_in_file(parent, member.is_d):
        cut, whole = _TO_D if member.is_d else _TO_PARENT
        name = name_in_file(parent, member.is_d)
        draft.note(cut if gone else whole, lost, residue=residue, name=name, atoms=gone)
    elif gone or hand(member) < 1:  # One of the other hand is told with all that are.
        kind = Kind.MIRRORED_CUT if gone else Kind.MIRRORED
        draft.note(kind, lost, residue=residue, atoms=gone)


_TO_D = Kind.CUT_TO_D, Kind.CONVERTED_TO_D
_TO_PARENT = Kind.CUT_TO_PARENT, Kind.CONVERTED
"""With atoms left out, and whole."""
