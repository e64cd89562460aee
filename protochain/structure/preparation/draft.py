"""Molecules of a file while they are prepared."""

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import gemmi

from protochain.ligands import Ligand
from protochain.structure.molecule import residues
from protochain.structure.molecule.links import Link
from protochain.structure.molecule.member import Address, Member
from protochain.structure.molecule.repairs import Kind, Loss, Repair, Why
from protochain.structure.molecule.templates import PHOSPHATE_END, Template, template_name


@dataclass(eq=False)
class Part:
    """Unbroken chain, or a molecule kept with the protein."""

    chain_id: str
    members: list[Member]
    obstacle: bool = False  # Whether it is kept with the protein: fixed, unless it is mobile.
    # Whether it moves: the user's force field has its parameters, or it is a ligand of known chemistry.
    mobile: bool = False
    ligand: Ligand | None = None  # Chemistry and parameters of such a ligand, under the names of its atoms.
    # Its stereocentres, and double bonds, that the file has the other way round.
    inverted: tuple[str, ...] = ()
    posed: bool = False  # Whether it is a pose that was added.
    cyclic: bool = False  # Whether the last residue is bonded to the first.
    glycan: str = ""  # GLYCAM's code of a sugar of a glycan that moves.
    is_small: bool = False  # Whether it is a small molecule that no force field has.

    @property
    def is_strand(self) -> bool:
        """Whether it is of nucleotides, also modified ones."""
        return self.members[0].name in residues.NUCLEOTIDES or (self.obstacle and len(self.members) > 1)

    def around(self, i: int) -> tuple[Member | None, Member | None]:
        """Residues before and after one, if there are any."""
        n = len(self.members)
        before = self.members[i - 1] if i or self.cyclic else None
        return before, self.members[(i + 1) % n] if i + 1 < n or self.cyclic else None

    def template(self, known: Mapping[str, Template], i: int, state: str = "") -> Template | None:
        """Template of residue i in a protonation state, or the usual: at ends ``N...``, ``C...``, 5, 3."""
        member = self.members[i]
        if member.own is not None:
            return member.own
        name = state or {"HIS": "HIE"}.get(member.name, template_name(member.name))
        # An end that is bonded to a molecule outside the chain is none.
        linked = {atom.name for atom in member.links}
        ends = (i == 0 and not linked & {"N", "P"}, i == len(self.members) - 1 and not linked & {"C", "O3'"})
        if ends == (True, False) and member.name in residues.NUCLEOTIDES and member.atom("P"):
            return known.get(PHOSPHATE_END + member.name)
        if member.name in residues.NUCLEOTIDES:
            return known.get(
                member.name + {(True, True): "N", (True, False): "5", (False, True): "3"}.get(ends, "")
            )
        if self.obstacle or self.cyclic or member.is_cap or not any(ends):
            return known.get(name)
        return known.get(("N" if ends[0] else "C") + name)


@dataclass(frozen=True, eq=False)
class Fragment:
    """Residues that no template fits, as one molecule, with caps where chains go on."""

    ligand: Ligand  # Chemistry and parameters.
    # Residue of each atom of the molecule, and its name there; None for atoms of caps that stand for none.
    owners: tuple[tuple[Member | None, str], ...]
    core: tuple[str, ...]  # What the force field calls each atom that keeps its parameters; empty for others.
    # Its bonds otherwise than along a chain, and the atoms that left there.
    bonds: Mapping[Link, tuple[tuple[Member, str], ...]]


@dataclass(eq=False)
class Draft:
    """Molecules of a file, completed step by step."""

    name: str  # Short name, and the name of the file in messages.
    source: str
    parts: list[Part] = field(default_factory=list)
    # Bonds between residues that the file states.
    stated: list[tuple[Address, Address]] = field(default_factory=list)
    # Bonds of the glycans that move: the atom that bears a sugar, and its anomeric carbon.
    glycosidic: list[tuple[Address, Address]] = field(default_factory=list)
    # Bonds of the protein to molecules outside it that springs hold.
    links: list[Link] = field(default_factory=list)
    fragments: list[Fragment] = field(default_factory=list)
    repairs: list[Repair] = field(default_factory=list)  # Changes made so far.
    left_out: Counter[str] = field(default_factory=Counter)  # Molecules and atoms left out, by kind.
    # Those that the file says hold the bonds to molecules kept with the protein: rest, nm or rad, and
    # stiffness; one of its atoms for a molecule that stays in place. Empty if the file does not say.
    springs: Mapping[tuple[Address, ...], tuple[float, float]] = field(default_factory=dict)
    absent: list[Member] = field(default_factory=list)  # The molecules left out.
    header: str = ""  # What the file says beside its atoms, as mmCIF text.
    model_number: int = 1  # Number of the model in the file.
    filed: tuple[str, ...] = ()  # Atoms of the model in the file, in its order.

    @property
    def members(self) -> list[Member]:
        """Every residue, in order."""
        return [member for part in self.parts for member in part.members]

    def note(self, kind: Kind, lost: tuple[Loss, ...] = (), **facts: Any) -> None:
        """Note a change, and what it takes away; of a residue that stays, its atoms are counted."""
        self.repairs.append(Repair(kind, facts, lost))
        for each in lost:
            if not each.why.is_of_whole:
                self.left_out[f"atoms of {each.name}"] += len(each.atoms)

    def states(self, first: Address, second: Address) -> bool:
        """Whether the file states this bond."""
        return (first, second) in self.stated or (second, first) in self.stated

    def says_of(self, member: Member) -> bool:
        """Whether the file says which springs hold a molecule kept with the protein, or that none does."""
        return (member.chain_id, member.seqid) in self._held

    def says_stays(self, member: Member) -> bool:
        """Whether the file says that a molecule kept with the protein stays in place."""
        return 1 in self._held.get((member.chain_id, member.seqid), ())

    @cached_property
    def _held(self) -> Mapping[tuple[str, str], set[int]]:
        """Numbers of atoms, one or two, of what the file says of each molecule kept with the protein."""
        found: dict[tuple[str, str], set[int]] = {}
        for atoms in self.springs:
            if len(atoms) < 3:
                found.setdefault(atoms[-1][:2], set()).add(len(atoms))
        return found


def losses(member: Member, atoms: Iterable[gemmi.Atom], why: Why) -> tuple[Loss, ...]:
    """Tell of the heavy atoms among those of a residue, if there are any, that they are lost."""
    names = tuple(atom.name for atom in atoms if not atom.is_hydrogen())
    return (Loss(member.chain_id, member.seqid, member.given or member.name, names, why),) if names else ()
