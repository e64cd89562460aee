"""Data model of a preparation: options, and the molecules of a file while passes complete them."""

from collections import Counter
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import gemmi
import numpy as np

from protochain.core import checks, defaults
from protochain.core.arrays import Integers
from protochain.core.errors import StructureError
from protochain.ligands import Ligand
from protochain.ligands.molecule import Molecule
from protochain.ligands.protonation import Charged
from protochain.structure.molecule import residues
from protochain.structure.molecule.links import Link
from protochain.structure.molecule.member import Address, Member
from protochain.structure.molecule.repairs import Repair
from protochain.structure.molecule.templates import (
    HAS_GLYCAM,
    HAS_SAGE,
    PHOSPHATE_END,
    Template,
    template_name,
    templates,
)

MoleculeAtPh = tuple[Molecule, tuple[Charged, ...]]
"""A molecule at a pH, and the atoms whose charges the pH changed."""


@dataclass(frozen=True)
class Chemistry:
    """Sources and options of the chemistry of hetero molecules."""

    # User input: residue name (empty for an added pose), and SMILES or path.
    sources: tuple[checks.LigandSource, ...] = ()
    charges: str = defaults.LIGAND_CHARGES  # As for :func:`protochain.ligand`.
    ph: float = defaults.PH
    has_glycam: bool = True  # Whether the force field is compatible with GLYCAM-06j.
    has_sage: bool = True  # Whether it is compatible with Sage for molecules bonded to residues.
    # Added poses by residue name.
    posed: Mapping[str, MoleculeAtPh] = field(default_factory=dict, compare=False)

    @classmethod
    def parse(cls, ligands: Any, ligand_charges: Any, ph: float, forcefield: Sequence[str]) -> "Chemistry":
        """Check the options of :func:`protochain.load`. ``forcefield`` lists the parts of a force field."""
        sources = checks.ligands(ligands, "ligands")
        charges = checks.charges_of_ligands(ligand_charges, "ligand_charges")
        glycam = not forcefield or HAS_GLYCAM in forcefield
        return cls(sources, charges, ph, glycam, glycam or HAS_SAGE in forcefield)

    @property
    def user_sources(self) -> dict[str, str]:
        """SMILES or paths from the user, by residue name."""
        return {name: source for name, source in self.sources if name}

    @property
    def moving(self) -> set[str]:
        """Names of residues that must move."""
        return {*self.user_sources, *self.posed}

    @property
    def poses(self) -> list[str]:
        """Paths of the poses to add."""
        return [source for name, source in self.sources if not name]


DEFAULT_CHEMISTRY = Chemistry()
"""Chemistry without user input: from the file or the component dictionary."""


@dataclass(frozen=True)
class Reading:
    """Options of a preparation, as in :func:`protochain.load`."""

    model: int | None = None  # Number of the model in the file; the first by default.
    altloc: str = ""  # Preferred altloc, which an atom must have. Default: highest occupancy.
    keep: tuple[str, ...] = ()  # Hetero molecules to include, as in :func:`protochain.load`.
    strict: bool = False  # Refuse chain breaks and residues that would be removed from a chain.
    # Force-field files whose residues are recognised in addition to the bundled ones.
    forcefield: tuple[Path, ...] = ()
    chains: tuple[str, ...] = ()  # Names of the chains to use. All by default.
    chemistry: Chemistry = DEFAULT_CHEMISTRY  # Of ligands.
    # Convert modified residues to their standard parents, also if parameters are available.
    standard_residues: bool = False
    assembly: str = ""  # Name of the biological assembly to build. None by default.
    disulfide: tuple[checks.Bond, ...] = ()  # Requested disulfide bonds.
    ph: float | str = defaults.PH
    cap: str = defaults.CAP  # Ends of chains to cap.

    def __post_init__(self) -> None:
        checks.check_fields(
            self, model=checks.optional(checks.integer), altloc=checks.text, keep=checks.words,
            strict=checks.flag, chains=checks.words, standard_residues=checks.flag, assembly=checks.text,
            cap=checks.one_of(defaults.CAPPED),
        )  # fmt: skip


@dataclass(eq=False)
class HeteroResidue:
    """A residue outside the protein."""

    member: Member
    raw_name: str  # Name in the file.
    notes: list[Repair] = field(default_factory=list)  # Repairs to report if the residue is used.

    @property
    def kind(self) -> str:
        """Kind of molecule, one of ``KINDS``."""
        if self.member.name == "HOH":
            return "water"
        if len(self.member.atoms) == 1:
            return "ions"
        return "nucleic" if self.member.name in residues.NUCLEOTIDES else "ligands"


class Role(Enum):
    """Role of a molecule, which determines whether it moves."""

    PROTEIN = "protein"
    NUCLEIC = "nucleic"  # A strand, which moves.
    GLYCAN = "glycan"  # It moves with the glycosylated residue.
    FLEXIBLE = "flexible"  # Another molecule that moves.
    FIXED = "fixed"
    TIED = "tied"  # Fixed although parameters are known, because springs bond it to another molecule.


class Evidence(Enum):
    """Evidence for the role of a molecule. Passes replace it when they learn more."""

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
    """Unbroken chain, or a hetero molecule."""

    chain_id: str
    members: list[Member]
    evidence: Evidence = Evidence.CHAIN  # Determines the role.
    ligand: Ligand | None = None  # Chemistry and parameters of a ligand, with the atom names of the file.
    inverted: tuple[str, ...] = ()  # Stereocentres and double bonds that are inverted in the file.
    posed: bool = False  # Whether this is an added pose.
    cyclic: bool = False  # Whether the last residue is bonded to the first.
    glycam_code: str = ""  # Code of a sugar in a mobile glycan.

    @property
    def obstacle(self) -> bool:
        """Whether this is a hetero molecule. It is fixed unless it is mobile."""
        return self.evidence.role is not Role.PROTEIN

    @property
    def mobile(self) -> bool:
        """Whether this is a hetero molecule that moves."""
        return self.evidence.role in (Role.NUCLEIC, Role.GLYCAN, Role.FLEXIBLE)

    @property
    def is_strand(self) -> bool:
        """Whether this is a strand of nucleotides, which may be modified."""
        return self.members[0].name in residues.NUCLEOTIDES or (self.obstacle and len(self.members) > 1)

    def neighbours(self, i: int) -> tuple[Member | None, Member | None]:
        """Return the previous and the next residue of residue i."""
        n = len(self.members)
        before = self.members[i - 1] if i or self.cyclic else None
        return before, self.members[(i + 1) % n] if i + 1 < n or self.cyclic else None

    def template(self, force_field: Mapping[str, Template], i: int, state: str = "") -> Template | None:
        """Return the template of residue i in a protonation state or the usual one. Ends: N, C, 5, 3."""
        member = self.members[i]
        if isinstance(member.source, Template):
            return member.source
        name = state or {"HIS": "HIE"}.get(member.name, template_name(member.name))
        # An end bonded to a molecule outside the chain has no end template.
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
    """Residues without matching templates, as one molecule with caps at continuing chains."""

    ligand: Ligand  # Chemistry and parameters.
    # Residue and name of each atom of the molecule. None for cap atoms that represent no residue.
    owners: tuple[tuple[Member | None, str], ...]
    core: tuple[str, ...]  # Force-field name of each atom with the parameters of its template, or empty.
    # Bonds other than along a chain, and the leaving atoms of each.
    bonds: Mapping[Link, tuple[tuple[Member, str], ...]]

    def atoms(self, at: Mapping[int, Mapping[str, int]]) -> Integers:
        """Return the indices (n,) of its atoms. Atoms of caps belong to neighbouring residues."""
        return np.array([-1 if m is None else at[id(m)].get(name, -1) for m, name in self.owners])


@dataclass(frozen=True, eq=False)
class Contacts:
    """Close pairs of protein and hetero atoms before the assignment of chemistry."""

    protein: list[tuple[Member, gemmi.Atom]] = field(default_factory=list)  # Heavy atoms.
    spring_links: list[Link] = field(default_factory=list)  # Bonds for which the file lists springs.
    refused: list[tuple[Link, str]] = field(default_factory=list)  # Impossible bonds of the file.
    overlapping: list[Link] = field(default_factory=list)  # At bonding distance but not bonded.


class Omission(NamedTuple):
    """Molecules or atoms of a file that a pass removes without a separate repair."""

    kind: str
    number: int


Changes = Generator[Repair | Omission, None, None]
"""Changes of a draft by a pass."""


@dataclass(eq=False)
class Draft:
    """Structure under preparation: molecules of a file, which passes complete."""

    name: str
    source: str  # Name of the file in messages.
    parts: list[Part] = field(default_factory=list)
    reading: Reading = field(default_factory=Reading)
    file: gemmi.Structure = field(default_factory=gemmi.Structure)
    is_ended: bool = True  # Whether the file has an end record.
    model: gemmi.Model = field(default_factory=lambda: gemmi.Model(1))  # Selected model.
    chains: list[gemmi.Chain] = field(default_factory=list)  # Selected chains.
    # Residues of each chain, grouped by number, with the altloc to use.
    places: dict[str, list[tuple[list[gemmi.Residue], str]]] = field(default_factory=dict)
    runs: list[list[Member]] = field(default_factory=list)  # Unbroken pieces of the protein's chains.
    orphans: set[int] = field(default_factory=set)  # ``id`` of unknown amino acids without a parent.
    hetero_residues: list[HeteroResidue] = field(default_factory=list)  # Residues outside the protein.
    stated_bonds: list[tuple[Address, Address]] = field(default_factory=list)  # Bonds in the file.
    # Bonds of mobile glycans: glycosylated atom and anomeric carbon.
    glycosidic: list[tuple[Address, Address]] = field(default_factory=list)
    contacts: Contacts = field(default_factory=Contacts)
    links: list[Link] = field(default_factory=list)  # Bonds of the protein to hetero molecules, by springs.
    metal_links: list[Link] = field(default_factory=list)  # Bonds of metals to donors outside the protein.
    fragments: list[Fragment] = field(default_factory=list)
    other_links: list[Link] = field(default_factory=list)  # Other parametrised bonds not along a chain.
    bridges: list[tuple[Member, Member]] = field(default_factory=list)  # Disulfide bonds.
    states: list[tuple[Member, Template]] = field(default_factory=list)  # Residues, protonated.
    repairs: list[Repair] = field(default_factory=list)  # Changes so far.
    left_out: Counter[str] = field(default_factory=Counter)  # Omitted molecules and atoms by kind.
    # Springs to hetero molecules that the file lists: rest, nm or rad, and stiffness. One atom alone marks a
    # fixed molecule. Empty for files without springs.
    springs: Mapping[tuple[Address, ...], tuple[float, float]] = field(default_factory=dict)
    omitted: list[Member] = field(default_factory=list)  # Omitted molecules.
    header: str = ""  # Metadata of the file as mmCIF text.
    model_number: int = 1  # Number of the model in the file.
    file_atoms: tuple[str, ...] = ()  # Atoms of the model in the order of the file.

    @cached_property
    def templates(self) -> Mapping[str, Template]:
        """Templates of the force field."""
        return templates(self.reading.forcefield)

    @property
    def members(self) -> list[Member]:
        """All residues, in order."""
        return [member for part in self.parts for member in part.members]

    def error(self, *parts: object) -> StructureError:
        """Return the refusal of the file, with its name before the message."""
        return StructureError(f"{self.source}: ", *parts)

    def has_bond(self, first: Address, second: Address) -> bool:
        """Return whether the file lists a bond."""
        return (first, second) in self.stated_bonds or (second, first) in self.stated_bonds

    def lists(self, member: Member) -> bool:
        """Return whether the file lists the springs of a hetero molecule, or that it has none."""
        return (member.chain_id, member.seqid) in self._recorded_atoms

    def lists_as_fixed(self, member: Member) -> bool:
        """Return whether the file lists a hetero molecule as fixed."""
        return 1 in self._recorded_atoms.get((member.chain_id, member.seqid), ())

    @cached_property
    def _recorded_atoms(self) -> Mapping[tuple[str, str], set[int]]:
        """Numbers of atoms (1 or 2) in the spring records of each hetero molecule."""
        counts: dict[tuple[str, str], set[int]] = {}
        for atoms in self.springs:
            if len(atoms) < 3:
                counts.setdefault(atoms[-1][:2], set()).add(len(atoms))
        return counts
