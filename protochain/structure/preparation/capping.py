"""Building and parametrisation of the molecule of a fragment, with caps at continuing chains.

Residues are bonded to one another and to caps, which are acetyl, methylamide or phosphates. A backbone like
alanine's has the parameters of alanine, sugar and phosphate of a nucleotide have force-field parameters.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import chain, combinations, count
from typing import NamedTuple

import gemmi
import numpy as np

from protochain.core import defaults
from protochain.core.arrays import read_only
from protochain.core.checks import CHARGE_RULES
from protochain.core.errors import StructureError
from protochain.core.graph import neighbours
from protochain.ligands import Ligand, assign_parameters
from protochain.ligands.dictionary import leaving
from protochain.ligands.molecule import Molecule
from protochain.ligands.protonation import at_ph
from protochain.structure.molecule.bonding import Graph
from protochain.structure.molecule.links import Link, usual_length
from protochain.structure.molecule.member import Member
from protochain.structure.molecule.residues import NUCLEOTIDES, OF_ALANINE
from protochain.structure.molecule.templates import PHOSPHATE_END
from protochain.structure.preparation.ligand_chemistry import LigandChemistry, inner_donors
from protochain.structure.preparation.structure_draft import Fragment, Part

_H, _C, _N, _O, _P = 1, 6, 7, 8, 15
_DOUBLE_BOND = 0.03
"""Angstrom. A possible double bond is double if it is shorter than the covalent radii by more than this. C=C
is shorter by 0.12, aromatic bonds by 0.06. Single bonds are longer by 0.05."""
_STRAND_BEFORE = {"O3'-": _O, "C3'-": _C}, {("O3'-", "C3'-"): 1}
_STRAND_AFTER = (
    {"P+": _P, "OP1+": _O, "OP2+": _O, "O5'+": _O, "C5'+": _C},
    {("P+", "OP1+"): 2, ("P+", "OP2+"): 1, ("P+", "O5'+"): 1, ("O5'+", "C5'+"): 1},
)
"""Atoms and bonds of the caps of a nucleotide."""
_HYDROGENS = {"N": (("H",), ("H1", "H2", "H3")), "CA": (("HA",), ("HA2", "HA3")), "O5'": (("HO5'",), ())}
"""Names of backbone hydrogens, for one hydrogen and for several."""


class Place(NamedTuple):
    """Location of a residue: molecule, and the residues bonded to its N and C."""

    part: Part
    before: Member | None
    after: Member | None


Places = Mapping[int, Place]
"""Locations by ``id`` of the residue."""


class FragmentBuilder:
    """Builder of the molecule of one fragment. Atom names have the tag of their residue as prefix."""

    def __init__(
        self,
        chemist: LigandChemistry,
        members: Sequence[Member],
        links: Sequence[Link],
        places: Places,
        special: Collection[int],
    ) -> None:
        self.chemist, self.members, self.links, self.places = chemist, members, links, places
        self.special = special
        tags = [f"{m.name}-{k}" if k else m.name for k, m in enumerate(members)]
        self.tag = {id(m): f"{tag}:" for m, tag in zip(members, tags, strict=True)}
        self.member_of = dict(zip(tags, members, strict=True))
        self.graph, self.flagged = Graph(), set[str]()
        self.acids, self.amines = list[str](), list[str]()
        self.in_file: dict[str, gemmi.Atom] = {}
        self.hydrogens = {self.tag[id(m)] + a.name for m in members for a in m.atoms if a.is_hydrogen()}

    def build(self) -> Fragment:
        """Return the fragment: chemistry, parameters, owners of atoms, and leaving atoms of each bond."""
        # Add the molecules of the residues to the graph.
        sources = {self.tag[id(m)]: self.chemist.lookup(m) for m in self.members}
        for m in self.members:
            tag = self.tag[id(m)]
            free = sources[tag]
            self.graph.add(tag, free)
            self.in_file |= {tag + a.name: a for a in m.heavy}
            self.flagged |= {tag + name for name in (*leaving(self.chemist.name(m)), "OXT", "OP3")}
            if self.places[id(m)].part.obstacle:
                self._drop_far_atoms(tag)
        # Bond them, and cap continuing chains.
        bonds = {}
        for link in self.links:
            ends = (link.member, link.atom), (link.hetero, link.hetero_atom)
            first, second = (self.tag[id(m)] + a.name for m, a in ends)
            leavers = self._join(first, second)
            fields = (atom.split(":") for atom in leavers)
            bonds[link] = tuple((self.member_of[tag], name) for tag, name in fields)
        for m in self.members:
            self._bond_and_cap(self.tag[id(m)], m)
        chemistry = self.chemist.chemistry
        ligand = _parametrise(
            tuple((name, z, q) for name, (z, q) in self.graph.atoms.items()),
            tuple((*sorted(bond), order) for bond, order in self.graph.bonds.items()),
            " and ".join(dict.fromkeys(molecule.source for molecule in sources.values())),
            tuple(self.acids), tuple(self.amines),
            frozenset(self.tag[id(m)] + name for m in self.members for name in inner_donors(m)),
            chemistry.charges if chemistry.charges in CHARGE_RULES else defaults.LIGAND_CHARGES, chemistry.ph,
        )  # fmt: skip
        ligand = replace(ligand, molecule=_with_stereo(ligand.molecule, sources))
        # Find the residue of each atom, and its name in the force field.
        graph = Graph()
        graph.add("", ligand.molecule)
        owners, core = list[tuple[Member | None, str]](), list[str]()
        strands = [m for m in self.members if self.places[id(m)].part.is_strand and id(m) in self.special]
        cores = {id(m): self._nucleic_core(graph, m) for m in strands}
        for name in graph.atoms:
            prefix, _, short = name.partition(":")
            m = self.member_of[prefix]
            owners.append(self._cap_owner(m, short) if short[-1] in "+-" else (m, short))
            is_core = id(m) not in self.special or (
                not self.places[id(m)].part.obstacle and _is_core(graph, f"{prefix}:", short)
            )
            core.append(cores[id(m)].get(short, "") if id(m) in cores else short if is_core else "")
        return Fragment(ligand, tuple(owners), tuple(core), bonds)

    def _drop_far_atoms(self, tag: str) -> None:
        """Remove absent heavy atoms that are not bonded to an atom in the file, with their hydrogens."""
        graph = self.graph
        absent = [
            a for a, (z, _) in graph.atoms.items() if a.startswith(tag) and z != _H and a not in self.in_file
        ]
        graph.remove([a for a in absent if not self.in_file.keys() & {*graph.heavy(a)}])

    def _leaver(self, a: str) -> list[str]:
        """Return the oxygen of a nucleotide that leaves if the strand continues, under any name."""
        if not self.places[id(self.member_of[a.partition(":")[0]])].part.is_strand:
            return []
        return [x for x in self.graph.heavy(a) if x not in self.in_file and self.graph.atoms[x][0] == _O][:1]

    def _cap_owner(self, member: Member, name: str) -> tuple[Member | None, str]:
        """Return the residue and atom that a cap atom represents, if any."""
        part, before, after = self.places[id(member)]
        short = name[:-1]
        if part.obstacle:
            return before if name[-1] == "-" else after, short
        if name == "CA-" and before is not None and before.atom("CH3"):
            short = "CH3"
        neighbour = before if name in ("C-", "O-", "CA-") else after if name == "N+" else None
        return neighbour, short

    def _nucleic_core(self, graph: Graph, member: Member) -> dict[str, str]:
        """Return force-field names of atoms of a nucleotide, or of a modified nucleotide's backbone."""
        tag, (part, before, after) = self.tag[id(member)], self.places[id(member)]
        is_standard = member.name in NUCLEOTIDES
        kind = member.name if is_standard else "DA" if _is_dna(part.members) else "A"
        bond_ends = [end for x in self.links for end in ((x.member, x.atom), (x.hetero, x.hetero_atom))]
        bonded = {a.name for m, a in bond_ends if m is member}
        is_first, is_last = not (before or "P" in bonded), not (after or "O3'" in bonded)
        ends = {(True, True): "N", (True, False): "5", (False, True): "3"}.get((is_first, is_last), "")
        if is_first and f"{tag}P" in graph.atoms:
            kind, ends = PHOSPHATE_END + kind, ""
        template = self.chemist.templates.get(kind + ends)
        if template is None:
            return {}
        # The force field has no parameters for bonds between DNA and RNA.
        across = {
            name
            for name, neighbour in (("P", before), ("O3'", after))
            if neighbour and neighbour.name in NUCLEOTIDES and _is_dna([neighbour]) != ("D" in kind)
        }
        atom_of = {template.synonyms.get(n, n): tag + n for n in (a.name for a in member.atoms)}
        inner = [name for name in template.heavy if is_standard or {*name} & {"'", "P"}]
        core: dict[str, str] = {}
        for name in (name for name in inner if name not in across and atom_of.get(name) in graph.atoms):
            a, light = atom_of[name], template.hydrogens.get(name, [])
            outer = {"P": not is_first, "O3'": not is_last, "C1'": not is_standard}.get(name, False)
            near = {atom_of.get(n, "") for n in template.neighbours(name) if n in inner}
            heavy = {*graph.heavy(a)}
            if (
                gemmi.Element(graph.atoms[a][0]).name == template.element[name]
                and near <= heavy and len(heavy - near) == outer and len(graph.light(a)) == len(light)
            ):  # fmt: skip
                names = (x.removeprefix(tag) for x in (a, *graph.light(a)))
                core |= dict(zip(names, (f"{template.name}/{n}" for n in (name, *light)), strict=True))
        return core

    def _join(self, a: str, b: str, along: bool = False) -> tuple[str, ...]:
        """Bond two atoms, and return the leaving atoms."""
        graph = self.graph
        if not {a, b} <= graph.atoms.keys():
            raise StructureError(f"its chemistry has no {(b if a in graph.atoms else a).partition(':')[2]}")
        absent = {*self._leaver(a), *self._leaver(b)} if along else graph.atoms.keys() - self.in_file.keys()
        # A carbon absent from a ligand is missing. It has not left.
        absent -= {
            x
            for x in absent
            if graph.atoms[x][0] == _C and self.places[id(self.member_of[x.partition(":")[0]])].part.obstacle
        }
        # Only C-C: poor models have amide and glycosidic bonds of nitrogen as short as double bonds.
        carbons = graph.atoms[a][0] == graph.atoms[b][0] == _C
        is_short = not along and carbons and self._excess(a, b) < -_DOUBLE_BOND
        for end in () if along else (a, b):
            graph.swap_oxygens(end)
        left = {end: graph.drop_groups(end, absent, self.flagged) for end in (a, b)}
        free = {end: freed for end, (_, freed) in left.items()}
        is_double = (max(free.values()) > 1 or is_short) and all(
            free[end] + len(graph.light(end)) > 1
            and graph.atoms[end][0] in (_C, _N)
            and all(graph.order(end, x) == 1 for x in graph.near(end))
            for end in (a, b)
        )
        leavers = [x for atoms, _ in left.values() for x in atoms]
        adds = not carbons and not leavers and not self.flagged & {*graph.light(a), *graph.light(b)}
        for end in (a, b):
            # Neighbours at the distance of a single bond.
            single = [x for x in graph.heavy(end) if self._excess(end, x) > -_DOUBLE_BOND]
            single += graph.acceptors(end) if adds else []
            leavers += graph.free_valences(end, 1 + is_double, free[end], single, self.hydrogens)
        graph.bonds[frozenset((a, b))] = 1 + is_double
        return tuple(leavers)

    def _excess(self, a: str, b: str) -> float:
        """Return the distance beyond a single bond, angstrom, or NaN if an atom is absent from the file."""
        if not {a, b} <= self.in_file.keys():
            return float("nan")
        first, second = self.in_file[a], self.in_file[b]
        return first.pos.dist(second.pos) - usual_length(first.element.name, second.element.name)

    def _bond_and_cap(self, prefix: str, member: Member) -> None:
        """Bond a residue to the next residue of the fragment, and cap bonds to residues outside it."""
        part, before, after = self.places[id(member)]
        end, start = ("O3'", "P") if part.obstacle else ("C", "N")
        c, n, graph = prefix + end, prefix + start, self.graph
        if after is not None and id(after) in self.tag:
            self._join(c, self.tag[id(after)] + start, along=True)
        if part.obstacle:
            if after is not None and id(after) not in self.tag:
                self._cap(c, *_STRAND_AFTER)
            if before is not None and id(before) not in self.tag:
                self._cap(n, *_STRAND_BEFORE)
            elif before is None and part.is_strand and n in graph.atoms and n not in self.in_file:
                # The strand begins with a hydroxyl.
                graph.remove([n, *(x for x in graph.heavy(n) if len(graph.heavy(x)) == 1)])
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
        """Bond an atom to the first atom of a cap."""
        prefix, _, short = a.partition(":")
        prefix += ":"
        if a not in self.graph.atoms:
            raise StructureError(f"its chemistry has no {short}")
        _, freed = self.graph.drop_groups(a, self._leaver(a), self.flagged)
        self.graph.free_valences(a, 1, freed, ())
        for name, z in atoms.items():
            self.graph.atoms[prefix + name] = [z, 0]
        self.graph.bonds[frozenset((a, prefix + next(iter(atoms))))] = 1
        for ends, order in bonds.items():
            self.graph.bonds[frozenset(prefix + end for end in ends)] = order


def _with_stereo(molecule: Molecule, sources: Mapping[str, Molecule]) -> Molecule:
    """Return the molecule with the stereochemistry of its sources (by tag) at atoms with equal bonds."""
    place = {name: i for i, name in enumerate(molecule.names)}
    order = dict(zip(map(frozenset, molecule.bonds.tolist()), molecule.orders.tolist(), strict=True))
    near = neighbours(molecule.bonds, molecule.n_atoms)
    now = [[-1 if molecule.elements[k] == _H else k for k in row] for row in near]
    handedness, double = molecule.handedness.copy(), molecule.double_bonds.tolist()
    for tag, free in sources.items():
        source_atoms = zip(free.names, free.elements, strict=True)
        at = [-1 if z == _H else place.get(tag + name, -2) for name, z in source_atoms]
        mapped = [[at[k] for k in row] for row in neighbours(free.bonds, free.n_atoms)]
        same = [i >= 0 and sorted(row) == sorted(now[i]) for i, row in zip(at, mapped, strict=True)]
        for k in np.flatnonzero(free.handedness).tolist():
            if same[k] and mapped[k].count(-1) < 2:
                ways = [now[at[k]].index(j) for j in mapped[k]]
                is_odd = sum(a > b for a, b in combinations(ways, 2)) % 2
                handedness[at[k]] = 3 - free.handedness[k] if is_odd else free.handedness[k]
        for *quad, cis in free.double_bonds.tolist():
            first, begin, end, last = (at[k] for k in quad)
            is_same = same[quad[1]] and same[quad[2]] and min(first, last) >= 0
            if is_same and order[frozenset((begin, end))] == 2:
                double.append([first, begin, end, last, cis])
    rows = read_only(double, np.int64).reshape(-1, 5)
    return replace(molecule, handedness=read_only(handedness, np.int64), double_bonds=rows)


def _is_core(graph: Graph, prefix: str, name: str) -> bool:
    """Return whether an atom of a residue corresponds to an atom of alanine."""
    a = prefix + name
    if name not in (*OF_ALANINE, "CB") or not graph.backbone(prefix):
        return False
    if name == "CB":
        return graph.atoms[a][0] == _C and len(graph.near(a)) == 4 and f"{prefix}CA" in graph.near(a)
    n, alpha = prefix + "N", prefix + "CA"
    if a in (n, *graph.light(n)):
        # An amine at the start of a chain is alanine's unless it has substituents.
        return len(graph.heavy(n)) == 1 or (graph.atoms[n][1] == 0 and graph.is_acyl(n))
    return graph.atoms[a][0] != _H or a in graph.light(alpha)


@lru_cache(maxsize=256)
def _parametrise(
    atoms: tuple[tuple[str, int, int], ...], bonds: tuple[tuple[str, str, int], ...], source: str,
    acids: tuple[str, ...], amines: tuple[str, ...], donors: frozenset[str], rule: str, ph: float,
) -> Ligand:  # fmt: skip
    """Protonate a capped fragment for a pH, replace caps at chain ends by charged ends, and parametrise."""
    graph = Graph()
    graph.atoms = {name: [z, q] for name, z, q in atoms}
    graph.bonds = {frozenset((a, b)): order for a, b, order in bonds}
    protonated, charged = at_ph(graph.molecule(source), ph, donors)
    graph = Graph()
    graph.add("", protonated)
    for prefix in amines:
        graph.remove([prefix + name for name in ("C-", "O-", "CA-")])
        graph.atoms[prefix + "N"][1] = 1
    for prefix in acids:
        graph.remove([prefix + name for name in ("N+", "CA+")])
        graph.atoms[prefix + "OXT"] = [_O, -1]
        graph.bonds[frozenset((prefix + "C", prefix + "OXT"))] = 1
    molecule = graph.molecule(source) if acids or amines else protonated
    return assign_parameters(replace(molecule, names=_assign_names(molecule)), rule, charged=charged)


def _assign_names(molecule: Molecule) -> tuple[str, ...]:
    """Return names in which hydrogens have the tag of their residue. Backbone hydrogens have PDB names."""
    near = neighbours(molecule.bonds, molecule.n_atoms)
    names = [*molecule.names]
    parents = [
        (i, *names[i].split(":"), [j for j in near[i] if molecule.elements[j] == _H])
        for i in molecule.heavy.tolist()
    ]
    used = {names[i] for i in molecule.heavy}
    assigned: set[int] = set()
    for _, prefix, parent, light in parents:
        if parent in _HYDROGENS and (parent == "O5'" or f"{prefix}:C" in used):
            for j, name in zip(light, _HYDROGENS[parent][len(light) > 1], strict=False):
                names[j] = f"{prefix}:{name}"
                used.add(names[j])
                assigned.add(j)
    for _, prefix, parent, light in parents:
        mark = parent[-1] if parent[-1] in "+-" else ""
        for j in (j for j in light if j not in assigned):
            short = names[j].split(":")[-1]
            labels = (f"{prefix}:{label}{mark}" for label in chain((short,), (f"H{k}" for k in count(1))))
            names[j] = next(label for label in labels if label not in used)
            used.add(names[j])
    return tuple(names)


def _is_dna(members: Sequence[Member]) -> bool:
    """Return whether most standard nucleotides are DNA, or, without standard ones, whether none has O2'."""
    names = [m.name for m in members if m.name in NUCLEOTIDES]
    if not names:
        return not any(m.atom("O2'") for m in members)
    return 2 * sum(name[0] == "D" for name in names) > len(names)
