"""A residue in one conformation, during the preparation of a file."""

from collections.abc import Iterable
from dataclasses import dataclass, field

import gemmi

from protochain.structure.molecule import residues
from protochain.structure.molecule.header import NO_LABEL, Label
from protochain.structure.molecule.repairs import Loss, Reason
from protochain.structure.molecule.templates import Template

Address = tuple[str, str, str]
"""Chain id, number with insertion code, and atom name in the file."""


@dataclass(frozen=True)
class Unknown:
    """Mark of an amino acid, or a nucleotide of a strand, without force-field parameters."""

    parent: str = ""  # Standard amino acid that replaces it without parameters, or empty.


@dataclass(eq=False)
class Member:
    """A residue in one conformation, under its standard name."""

    name: str
    number: str
    insertion_code: str
    chain_id: str
    atoms: list[gemmi.Atom]  # Positions in angstrom.
    state: str = ""  # Protonation state that its name in the file implies, or empty.
    # Whether it is a D-amino acid: by its name in the file, or by its atoms if the name is ambiguous.
    is_d: bool = False
    # Of its parameters: a template by its chemistry or elements, or None if the force field has them.
    source: Template | Unknown | None = None
    # Its atoms that are bonded to a hetero molecule, and to a metal.
    links: list[gemmi.Atom] = field(default_factory=list)
    metals: list[gemmi.Atom] = field(default_factory=list)
    label: Label = NO_LABEL  # Label ids of the file.
    raw_name: str = ""  # Its name in the file, if different.
    order: tuple[str, ...] = ()  # Names of its atoms, if added atoms have places in the order.

    def __str__(self) -> str:
        return str(self.residue)

    @property
    def template(self) -> Template | None:
        """Template outside the force field, if it has one."""
        return self.source if isinstance(self.source, Template) else None

    @property
    def is_unknown(self) -> bool:
        """Whether it is an amino acid, or a nucleotide of a strand, without force-field parameters."""
        return isinstance(self.source, Unknown)

    @property
    def parent(self) -> str:
        """Standard amino acid that replaces an unknown one without parameters, or empty."""
        return self.source.parent if isinstance(self.source, Unknown) else ""

    @property
    def residue(self) -> residues.Residue:
        """Chain, number and name in files."""
        return residues.Residue(self.chain_id, self.seqid, residues.name_in_file(self.name, self.is_d))

    @property
    def is_cap(self) -> bool:
        """Whether it is a terminal cap."""
        return self.name in residues.CAPS

    @property
    def bonded_names(self) -> set[str]:
        """Names of its atoms with bonds to metals and other molecules."""
        return {atom.name for atom in (*self.links, *self.metals)}

    @property
    def heavy(self) -> list[gemmi.Atom]:
        """Its atoms without hydrogens."""
        return [atom for atom in self.atoms if not atom.is_hydrogen()]

    @property
    def seqid(self) -> str:
        """Number and insertion code."""
        return self.number + self.insertion_code

    def address(self, name: str) -> Address:
        """Address of one of its atoms in the file."""
        return self.chain_id, self.seqid, name

    def losses(self, atoms: Iterable[gemmi.Atom], why: Reason) -> tuple[Loss, ...]:
        """Return a loss that lists the heavy ones of some of its atoms, or nothing without any."""
        lost = tuple(atom.name for atom in atoms if not atom.is_hydrogen())
        return (Loss(self.chain_id, self.seqid, self.raw_name or self.name, lost, why),) if lost else ()

    def atom(self, name: str) -> gemmi.Atom | None:
        """Return the atom of that name, if there is one."""
        return next((atom for atom in self.atoms if atom.name == name), None)


def residue_in_file(chain: str, residue: gemmi.Residue) -> residues.Residue:
    """Return a residue with its names in the file."""
    return residues.Residue(chain.strip(), str(residue.seqid).strip(), residue.name)


def address_of(place: gemmi.AtomAddress) -> Address:
    """Address of an atom of a bond in gemmi."""
    return place.chain_name.strip(), str(place.res_id.seqid).strip(), place.atom_name


def atom(name: str, element: str, position: list[float], b_iso: float = 0.0) -> gemmi.Atom:
    """Make an atom (angstrom)."""
    new = gemmi.Atom()
    new.name, new.element, new.b_iso = name, gemmi.Element(element), b_iso
    new.pos = gemmi.Position(*position)
    return new
