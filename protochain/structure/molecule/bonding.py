"""Join molecules by bonds: remove leaving groups, free valences and adjust charges."""

from collections.abc import Collection, Sequence

from protochain.core.errors import StructureError
from protochain.core.optional_libraries import library
from protochain.ligands.molecule import Molecule, build_mol, from_rdkit, quietly
from protochain.structure.molecule.residues import BACKBONE

_H, _C, _N, _O, _S = 1, 6, 7, 8, 16
_MONOVALENT = (_N, _O, 9, 16, 17, 35, 53)  # Elements of terminal, singly bonded heavy atoms that may leave.


class Graph:
    """Atoms and bonds by name, during assembly."""

    def __init__(self) -> None:
        self.atoms: dict[str, list[int]] = {}
        self.bonds: dict[frozenset[str], int] = {}

    def add(self, prefix: str, mol: Molecule) -> None:
        """Add a molecule under names with a prefix."""
        names = [prefix + name for name in mol.names]
        for name, z, q in zip(names, mol.elements.tolist(), mol.formal_charges.tolist(), strict=True):
            self.atoms[name] = [z, q]
        for (i, j), order in zip(mol.bonds.tolist(), mol.orders.tolist(), strict=True):
            self.bonds[frozenset((names[i], names[j]))] = order

    def near(self, a: str) -> list[str]:
        """Atoms bonded to an atom."""
        return [end for bond in self.bonds if a in bond for end in bond if end != a]

    def heavy(self, a: str) -> list[str]:
        """Heavy atoms bonded to an atom."""
        return [neighbour for neighbour in self.near(a) if self.atoms[neighbour][0] != _H]

    def light(self, a: str) -> list[str]:
        """Hydrogens bonded to an atom."""
        return [neighbour for neighbour in self.near(a) if self.atoms[neighbour][0] == _H]

    def order(self, a: str, b: str) -> int:
        """Order of a bond, or 0 without a bond."""
        return self.bonds.get(frozenset((a, b)), 0)

    def remove(self, atoms: Sequence[str]) -> None:
        """Remove atoms with their hydrogens and bonds."""
        removed = {*atoms}.union(*map(self.light, atoms))
        self.atoms = {name: atom for name, atom in self.atoms.items() if name not in removed}
        self.bonds = {bond: order for bond, order in self.bonds.items() if not bond & removed}

    def backbone(self, prefix: str) -> bool:
        """Whether N, CA, C and O are bonded as in alanine, with tetrahedral CA and C of an acid or amide."""
        n, alpha, c, o = (prefix + name for name in (*BACKBONE, "O"))
        if not {n, alpha, c, o} <= self.atoms.keys():
            return False
        around = self.near(alpha)
        return (
            [self.order(alpha, n), self.order(alpha, c), self.order(c, o)] == [1, 1, 2]
            and len(around) == 4
            and all(self.order(alpha, x) == 1 for x in around)
            and self.atoms[n][0] == _N and self.atoms[c][0] == _C and self.atoms[o][0] == _O
            and len(self.heavy(c)) == 3
            and any(self.atoms[x][0] in (_N, _O) for x in self.heavy(c) if x not in (alpha, o))
        )  # fmt: skip

    def is_acyl(self, n: str) -> bool:
        """Whether a nitrogen is bonded to the carbonyl of an amide."""
        return any(
            self.order(c, o) == 2 and self.atoms[o][0] == _O for c in self.heavy(n) for o in self.heavy(c)
        )

    def drop_groups(self, a: str, absent: Collection[str], flagged: Collection[str]) -> tuple[list[str], int]:
        """Remove absent groups at an atom, or a leaving group. Return them and the freed valences."""
        groups = {x: self.beyond(a, x) for x in self.heavy(a)}
        marked = sorted((x for x in groups if groups[x].keys() <= {*flagged}), key=lambda x: self.order(a, x))
        at = [x for x in groups if groups[x].keys() <= {*absent} and (x in marked or len(groups[x]) == 1)]
        at = at or marked[:1]
        if len(at) > 1 and self.atoms[a][0] == _C:  # A carbonyl has not left as well.
            at = [x for x in at if self.atoms[x][0] != _O or self.order(a, x) == 1]
        for x in at:  # The hydroxyl of an acid leaves, whatever the names of its oxygens.
            self.swap_oxygens(x)
        removed = [atom for x in at for atom in groups[x]]
        freed = sum(self.order(a, x) for x in at)
        self.remove(removed)
        return removed, freed

    def beyond(self, a: str, x: str) -> dict[str, None]:
        """Heavy atoms of a group: neighbour x of atom a, and all atoms behind x."""
        group = {x: None}
        ends = [x]
        while ends:
            ends = [y for end in ends for y in self.heavy(end) if (end, y) != (x, a) and y not in group]
            group |= dict.fromkeys(ends)
        return group

    def swap_oxygens(self, a: str) -> None:
        """Exchange a doubly bonded oxygen of an acid with a singly bonded one, hydrogen included."""
        for c in self.heavy(a) if self.atoms[a][0] == _O else ():
            single = (x for x in self.heavy(c) if self.order(x, c) == 1 and self.heavy(x) == [c])
            x = next((x for x in single if self.atoms[x][0] == _O), a)
            if self.order(a, c) == 2 and x != a:
                self.bonds |= {frozenset((a, c)): 1, frozenset((x, c)): 2}
                self.bonds |= {frozenset((a, h)): self.bonds.pop(frozenset((x, h))) for h in self.light(x)}
                self.atoms[a], self.atoms[x] = self.atoms[x], self.atoms[a]

    def acceptors(self, a: str) -> list[str]:
        """Neighbours whose double bond a nucleophile consumes when it adds to a carbon, as in acrylamides."""
        # Distances decide for quinones, with more conjugated carbons, and for but-2-enamides, as which the
        # archive has bonded but-2-ynamides.

        def is_multiple(x: str, *elements: int) -> bool:
            return any(self.order(x, y) > 1 and self.atoms[y][0] in elements for y in self.heavy(x) if y != a)

        carbons = [x for x in self.heavy(a) if self.atoms[a][0] == self.atoms[x][0] == _C]
        if any(is_multiple(x, _C) or self.heavy(x) == [a] for x in carbons):
            return []
        double = [x for x in carbons if self.order(a, x) > 1]
        return [x for x in double if any(is_multiple(y, _N, _O) for y in self.heavy(x) if y != a)]

    def free_valences(
        self, a: str, order: int, freed: int, single: Sequence[str], filed: Collection[str] = ()
    ) -> list[str]:
        """Free valences of an atom for a bond, first from bonds to ``single`` neighbours."""
        z, q = self.atoms[a]
        # Hydrogens of the file leave last.
        light, heavy = sorted(self.light(a), key=lambda x: x in filed), self.heavy(a)
        room = 3 - sum(self.order(a, x) for x in heavy) - order
        if z == _N and room >= 0:
            self.atoms[a][1] = 0
            removed = sorted(self.light(a), key=lambda x: x not in filed)[room:]
            self.remove(removed)
            return removed
        # A bond consumed by another atom may have freed one valence.
        freed = max(freed, 4 - sum(self.order(a, x) for x in (*light, *heavy)) if z == _C and not q else 0)
        need = order - freed
        if q < 0 < need:
            self.atoms[a][1], need = q + 1, need - 1
        multiple = [x for x in heavy if self.order(a, x) > 1 and z == _C]
        # The carbonyl of an acid stays. One of its groups leaves.
        is_acid = any(self.order(a, x) == 1 and self.atoms[x][0] in (_N, _O, _S) for x in heavy)
        for x in multiple:
            is_carbonyl = is_acid and self.atoms[x][0] == _O
            if need > 0 and (x in single or (len(light) < need and not is_carbonyl)):
                self.bonds[frozenset((a, x))] -= 1
                need -= 1
        alone = [x for x in heavy if self.order(a, x) == 1 and self.heavy(x) == [a]]
        ends = [x for x in alone if self.atoms[x][0] in _MONOVALENT]
        removed = [*light, *ends][: max(need, 0)]
        if len(removed) < need == 1 and z == _S and len(heavy) == 2 and not q:
            self.atoms[a][1], need = 1, 0  # A sulphonium, as of methionine and tyrosine of catalases.
        if len(removed) < need:
            raise StructureError(f"{a.partition(':')[2]} has no valence left for a bond")
        self.remove(removed)
        return removed

    def molecule(self, source: str) -> Molecule:
        """Return the molecule with its missing hydrogens."""
        names = [*self.atoms]
        place = {name: k for k, name in enumerate(names)}
        assembly = build_mol(
            names, [z for z, _ in self.atoms.values()], [q for _, q in self.atoms.values()],
            [sorted(place[end] for end in bond) for bond in self.bonds], [*self.bonds.values()], None,
        )  # fmt: skip
        try:
            quietly(library("rdkit.Chem").SanitizeMol, assembly)
        except ValueError as error:
            reason = " ".join(str(error).split())
            raise StructureError(f"{source}: cannot be bonded as the file has it ({reason})") from None
        return from_rdkit(assembly, source)
