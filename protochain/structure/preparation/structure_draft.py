"""Molecules of a file while they are prepared, and the options of a preparation."""

from collections import Counter
from collections.abc import Generator, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import gemmi

from protochain.core import checks, defaults
from protochain.ligands import Ligand
from protochain.ligands.molecule import Molecule
from protochain.ligands.protonation import Charged
from protochain.structure.molecule import residues
from protochain.structure.molecule.links import Link
from protochain.structure.molecule.member import Address, Member
from protochain.structure.molecule.repairs import Loss, Reason, Repair
from protochain.structure.molecule.templates import (
    HAS_GLYCAM,
    HAS_SAGE,
    PHOSPHATE_END,
    Template,
    template_name,
    templates,
)

ChargedMolecule = tuple[Molecule, tuple[Charged, ...]]
"""A molecule as it is at a pH, and what was charged."""


@dataclass(frozen=True)
class Chemistry:
    """Where the chemistry of molecules kept with the protein comes from."""

    # What the user gives: the name of a residue, or none for a pose that is added; SMILES, or a path.
    sources: tuple[checks.LigandSource, ...] = ()
    charges: str = defaults.LIGAND_CHARGES  # As for :func:`protochain.ligand`.
    ph: float = defaults.PH
    has_glycam: bool = True  # Whether the force field is one that GLYCAM-06j goes with.
    has_sage: bool = True  # Whether it is one that Sage goes with where molecules are bonded to residues.
    # Poses that were added, by the name of the residue.
    posed: Mapping[str, ChargedMolecule] = field(default_factory=dict, compare=False)

    @classmethod
    def parse(cls, ligands: Any, ligand_charges: Any, ph: float, forcefield: Sequence[str]) -> "Chemistry":
        """Chemistry of the options of :func:`protochain.load`, checked; of a force field its parts."""
        sources = checks.ligands(ligands, "ligands")
        charges = checks.charges_of_ligands(ligand_charges, "ligand_charges")
        glycam = not forcefield or HAS_GLYCAM in forcefield
        return cls(sources, charges, ph, glycam, glycam or HAS_SAGE in forcefield)

    @property
    def user_sources(self) -> dict[str, str]:
        """What is given, by the name of the residue."""
        return {name: source for name, source in self.sources if name}

    @property
    def moving(self) -> set[str]:
        """Names of residues that are to move, whatever else is kept."""
        return {*self.user_sources, *self.posed}

    @property
    def poses(self) -> list[str]:
        """Paths of the molecules to add."""
        return [source for name, source in self.sources if not name]


DEFAULT_CHEMISTRY = Chemistry()
"""Of the file, or of the dictionary."""


@dataclass(frozen=True)
class Reading:
    """Options of a preparation, as those of :func:`protochain.load`."""

    model: int | None = None  # Number of the model in the file; the first by default.
    # Preferred alternate location, which some atom must have; by default, and where it is absent, the one of
    # highest occupancy.
    altloc: str = ""
    # Molecules kept as fixed obstacles, as in :func:`protochain.load`; none by default.
    keep: tuple[str, ...] = ()
    strict: bool = False  # Refuse chain breaks and residues that would be left out of a chain.
    # Force-field files whose residues are recognised besides the bundled ones.
    forcefield: tuple[Path, ...] = ()
    chains: tuple[str, ...] = ()  # Names of the chains to take; all by default.
    chemistry: Chemistry = DEFAULT_CHEMISTRY  # Of ligands.
    # Convert modified residues to their standard parents, also those that have parameters.
    standard_residues: bool = False
    assembly: str = ""  # Name of the biological assembly to build; none by default.
    disulfide: tuple[checks.Bond, ...] = ()  # Disulfide bonds that are asked for.
    ph: float | str = defaults.PH

    def __post_init__(self) -> None:
        checks.check_fields(
            self, model=checks.optional(checks.integer), altloc=checks.text, keep=checks.words,
            strict=checks.flag, chains=checks.words, standard_residues=checks.flag, assembly=checks.text,
        )  # fmt: skip


@dataclass(eq=False)
class HeteroResidue:
    """A residue that is no part of the protein."""

    member: Member
    raw_name: str  # Its name in the file.
    notes: list[Repair] = field(default_factory=list)  # Repairs to report if it is kept.

    @property
    def kind(self) -> str:
        """Kind, as a word of ``KINDS``."""
        if self.member.name == "HOH":
            return "water"
        if len(self.member.atoms) == 1:
            return "ions"
        return "nucleic" if self.member.name in residues.NUCLEOTIDES else "ligands"


class Role(Enum):
    """What a molecule is, and so whether it moves."""

    PROTEIN = "protein"
    NUCLEIC = "nucleic"  # A strand, which moves.
    GLYCAN = "glycan"  # It moves with the residue that bears it.
    FLEXIBLE = "flexible"  # Another molecule that moves.
    FIXED = "fixed"
    TIED = "tied"  # Fixed, though its parameters are known: it is bonded to another molecule.


class Evidence(Enum):
    """What is known of a molecule, with the role that it gives; each pass that learns more replaces it."""

    CHAIN = Role.PROTEIN, "amino acids that are bonded to one another"
    NUCLEOTIDES = Role.NUCLEIC, "the force field has every nucleotide of the strand"
    SUGARS = Role.GLYCAN, "GLYCAM-06j has its sugar and its bonds"
    USERS_TEMPLATE = Role.FLEXIBLE, "the user's force field has it"
    CHEMISTRY = Role.FLEXIBLE, "a source has its chemistry, the force field of small molecules its parameters"
    FRAGMENT = Role.FLEXIBLE, "the same, of residues that bonds join to others"
    BUNDLED_TEMPLATE = Role.FIXED, "a water or an ion of the force field"
    SMALL = Role.FIXED, "a small molecule whose chemistry is not looked up yet"
    ELEMENTS = Role.FIXED, "no parameters: by its elements"
    BONDED = Role.TIED, "springs hold it to another molecule"

    def __init__(self, role: Role, reason: str) -> None:
        self.role, self.reason = role, reason


@dataclass(eq=False)
class Part:
    """Unbroken chain, or a molecule kept with the protein."""

    chain_id: str
    members: list[Member]
    evidence: Evidence = Evidence.CHAIN  # What is known of it, which gives its role.
    ligand: Ligand | None = None  # Chemistry and parameters of such a ligand, under the names of its atoms.
    # Its stereocentres, and double bonds, that the file has the other way round.
    inverted: tuple[str, ...] = ()
    posed: bool = False  # Whether it is a pose that was added.
    cyclic: bool = False  # Whether the last residue is bonded to the first.
    glycam_code: str = ""  # Of a sugar of a glycan that moves.

    @property
    def obstacle(self) -> bool:
        """Whether it is kept with the protein: fixed, unless it is mobile."""
        return self.evidence.role is not Role.PROTEIN

    @property
    def mobile(self) -> bool:
        """Whether it is kept with the protein, and moves."""
        return self.evidence.role in (Role.NUCLEIC, Role.GLYCAN, Role.FLEXIBLE)

    @property
    def is_strand(self) -> bool:
        """Whether it is of nucleotides, also modified ones."""
        return self.members[0].name in residues.NUCLEOTIDES or (self.obstacle and len(self.members) > 1)

    def neighbours(self, i: int) -> tuple[Member | None, Member | None]:
        """Residues before and after one, if there are any."""
        n = len(self.members)
        before = self.members[i - 1] if i or self.cyclic else None
        return before, self.members[(i + 1) % n] if i + 1 < n or self.cyclic else None

    def template(self, force_field: Mapping[str, Template], i: int, state: str = "") -> Template | None:
        """Template of residue i in a protonation state, or the usual: at ends ``N...``, ``C...``, 5, 3."""
        member = self.members[i]
        if isinstance(member.source, Template):
            return member.source
        name = state or {"HIS": "HIE"}.get(member.name, template_name(member.name))
        # An end that is bonded to a molecule outside the chain is none.
        linked = {atom.name for atom in member.links}
        ends = (i == 0 and not linked & {"N", "P"}, i == len(self.members) - 1 and not linked & {"C", "O3'"})
        if ends == (True, False) and member.name in residues.NUCLEOTIDES and member.atom("P"):
            return force_field.get(PHOSPHATE_END + member.name)
        if member.name in residues.NUCLEOTIDES:
            return force_field.get(
                member.name + {(True, True): "N", (True, False): "5", (False, True): "3"}.get(ends, "")
            )
        if self.obstacle or self.cyclic or member.is_cap or not any(ends):
            return force_field.get(name)
        return force_field.get(("N" if ends[0] else "C") + name)


@dataclass(frozen=True, eq=False)
class Fragment:
    """Residues that no template fits, as one molecule, with caps where chains go on."""

    ligand: Ligand  # Chemistry and parameters.
    # Residue of each atom of the molecule, and its name there; None for atoms of caps that stand for none.
    owners: tuple[tuple[Member | None, str], ...]
    core: tuple[str, ...]  # What the force field calls each atom that keeps its parameters; empty for others.
    # Its bonds otherwise than along a chain, and the atoms that left there.
    bonds: Mapping[Link, tuple[tuple[Member, str], ...]]


@dataclass(frozen=True, eq=False)
class Contacts:
    """Close pairs of atoms of the protein and molecules outside it, as they are before their chemistry."""

    protein: list[tuple[Member, gemmi.Atom]] = field(default_factory=list)  # Heavy atoms.
    spring_links: list[Link] = field(default_factory=list)  # Bonds that the file says springs hold.
    refused: list[tuple[Link, str]] = field(default_factory=list)  # Bonds of the file that cannot be.
    overlapping: list[Link] = field(default_factory=list)  # As near as bonded atoms, and not bonded.


class Omission(NamedTuple):
    """Molecules or atoms of a file that a pass removes without a repair of their own."""

    kind: str
    number: int


Changes = Generator[Repair | Omission, None, None]
"""What a pass changes in a draft."""


@dataclass(eq=False)
class Draft:
    """Molecules of a file, completed pass by pass."""

    name: str  # Short name, and the name of the file in messages.
    source: str
    parts: list[Part] = field(default_factory=list)
    reading: Reading = field(default_factory=Reading)
    file: gemmi.Structure = field(default_factory=gemmi.Structure)
    is_ended: bool = True  # Whether the file has a mark of its end.
    model: gemmi.Model = field(default_factory=lambda: gemmi.Model(1))  # The model that is used.
    chains: list[gemmi.Chain] = field(default_factory=list)  # The chains that are used.
    # Residues of each chain, as the copies that share a number, and the alternate location to use.
    places: dict[str, list[tuple[list[gemmi.Residue], str]]] = field(default_factory=dict)
    runs: list[list[Member]] = field(default_factory=list)  # Unbroken pieces of the protein's chains.
    orphans: set[int] = field(default_factory=set)  # ``id`` of unknown amino acids without a parent.
    hetero_residues: list[HeteroResidue] = field(default_factory=list)  # Residues outside the protein.
    # Bonds between residues that the file states.
    stated_bonds: list[tuple[Address, Address]] = field(default_factory=list)
    # Bonds of the glycans that move: the atom that bears a sugar, and its anomeric carbon.
    glycosidic: list[tuple[Address, Address]] = field(default_factory=list)
    contacts: Contacts = field(default_factory=Contacts)
    # Bonds of the protein to molecules outside it that springs hold.
    links: list[Link] = field(default_factory=list)
    metal_links: list[Link] = field(default_factory=list)  # Bonds of metals to donors outside the protein.
    fragments: list[Fragment] = field(default_factory=list)
    other_links: list[Link] = field(default_factory=list)  # Other bonds with parameters, but along a chain.
    bridges: list[tuple[Member, Member]] = field(default_factory=list)  # Disulfide bonds.
    states: list[tuple[Member, Template]] = field(default_factory=list)  # Residues, protonated.
    repairs: list[Repair] = field(default_factory=list)  # Changes made so far.
    left_out: Counter[str] = field(default_factory=Counter)  # Molecules and atoms left out, by kind.
    # Those that the file says hold the bonds to molecules kept with the protein: rest, nm or rad, and
    # stiffness; one of its atoms for a molecule that stays in place. Empty if the file does not say.
    springs: Mapping[tuple[Address, ...], tuple[float, float]] = field(default_factory=dict)
    omitted: list[Member] = field(default_factory=list)  # The molecules left out.
    header: str = ""  # What the file says beside its atoms, as mmCIF text.
    model_number: int = 1  # Number of the model in the file.
    file_atoms: tuple[str, ...] = ()  # Atoms of the model in the file, in its order.

    @cached_property
    def templates(self) -> Mapping[str, Template]:
        """Templates of the force field."""
        return templates(self.reading.forcefield)

    @property
    def members(self) -> list[Member]:
        """Every residue, in order."""
        return [member for part in self.parts for member in part.members]

    def has_bond(self, first: Address, second: Address) -> bool:
        """Whether the file states a bond."""
        return (first, second) in self.stated_bonds or (second, first) in self.stated_bonds

    def lists(self, member: Member) -> bool:
        """Whether the file says which springs hold a molecule kept with the protein, or that none does."""
        return (member.chain_id, member.seqid) in self._recorded_atoms

    def lists_as_fixed(self, member: Member) -> bool:
        """Whether the file says that a molecule kept with the protein stays in place."""
        return 1 in self._recorded_atoms.get((member.chain_id, member.seqid), ())

    @cached_property
    def _recorded_atoms(self) -> Mapping[tuple[str, str], set[int]]:
        """Numbers of atoms, one or two, of what the file says of each molecule kept with the protein."""
        counts: dict[tuple[str, str], set[int]] = {}
        for atoms in self.springs:
            if len(atoms) < 3:
                counts.setdefault(atoms[-1][:2], set()).add(len(atoms))
        return counts


def losses(member: Member, atoms: Iterable[gemmi.Atom], cause: Reason) -> tuple[Loss, ...]:
    """Tell of the heavy atoms among those of a residue, if there are any, that they are lost."""
    lost = tuple(atom.name for atom in atoms if not atom.is_hydrogen())
    return (Loss(member.chain_id, member.seqid, member.raw_name or member.name, lost, cause),) if lost else ()
