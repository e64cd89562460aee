"""Structure: a prepared, all-atom protein, the input of the rest of the library."""

import hashlib
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, wraps
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Concatenate, ParamSpec, TypeVar

import numpy as np
from numpy.typing import NDArray

from protochain.core.arrays import Floats, Integers, Value, read_only
from protochain.core.errors import Fault, StructureError
from protochain.core.graph import Neighbours, neighbours
from protochain.core.markup import facts
from protochain.core.settings import document_fields
from protochain.ligands import Ligand
from protochain.structure.molecule.header import Label, with_header
from protochain.structure.molecule.links import is_metal
from protochain.structure.molecule.repairs import Loss, Repair, summarise
from protochain.structure.molecule.residues import Atom, Residue, name_in_file

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class Tie:
    """Spring of a bond between the protein and a hetero molecule."""

    atoms: tuple[int, ...]  # Two for a distance, or three for an angle at the second.
    rest: float
    stiffness: float  # E = stiffness/2 (value - rest)^2.


@dataclass(frozen=True, eq=False)
class BoundLigand(Value):
    """A mobile small molecule, or residues that no template fits, of known chemistry."""

    ligand: Ligand  # Chemistry and parameters, with names and positions of the file.
    atoms: Integers  # (n,) int: The structure's atom of each atom of the molecule, hydrogens included.
    # Stereocentres, and double bonds as ``C1=C2``, whose configuration differs between file and source.
    inverted: tuple[str, ...] = ()
    # Force-field names of the atoms of residues that retain its parameters, empty for other atoms.
    core: tuple[str, ...] = ()
    posed: bool = False  # Whether it is a pose that was added to the file's structure.

    def __post_init__(self) -> None:
        object.__setattr__(self, "atoms", read_only(self.atoms, np.int64))

    def in_energy(self) -> str:
        """Text of all that determines the energy, independent of the order of atoms and terms."""
        parameters = self.ligand.parameters
        rows = []
        for term in (parameters.bonds, parameters.angles, parameters.torsions):
            for atoms, values in zip(self.atoms[term.atoms].tolist(), term.parameters, strict=True):
                rows.append((min(atoms, atoms[::-1]), _round(values)))
        single = np.column_stack([parameters.charge, parameters.sigma, parameters.epsilon])
        rows += zip(([k] for k in self.atoms.tolist()), _round(single), strict=True)
        core = sorted(zip(self.atoms.tolist(), self.core, strict=True)) if self.core else ""
        return f"{sorted(rows)!r}{core}"


def _round(values: Floats) -> list[Any]:
    """Round numbers to digits that do not depend on the order of sums, without negative zeros."""
    numbers: list[Any] = (np.round(values, _DIGITS) + 0.0).tolist()
    return numbers


_DIGITS = 9  # Digits of compared parameters, because the last digits of sums of charges differ.


@dataclass(frozen=True, eq=False)
class Origin(Value):
    """Origin of the atoms of a structure, which maps positions of a file to the structure."""

    # Atoms of the model in the file, or in the object of another library, in order: ``A/17/GLU/CG``.
    atoms: tuple[str, ...]
    # (na,) int: Place of each atom of the structure among these, or -1 for an added atom.
    place: Integers
    charge: Floats  # (na,) e: Charges of the templates, which orient added hydroxyls.

    def __post_init__(self) -> None:
        object.__setattr__(self, "place", read_only(self.place, np.int64))
        object.__setattr__(self, "charge", read_only(self.charge))


B_FACTOR = "B factor"
"""Quantity in the column of B factors of a crystal structure."""


@document_fields
@dataclass(frozen=True, eq=False)
class Structure(Value):
    """Atoms of a prepared protein.

    Raises
    ------
    StructureError
        If the positions do not fit the topology or are not finite.

    Examples
    --------
    >>> pc.load("structures/1l2y.pdb")
    <Structure 1l2y: 1 chains, 20 residues, 304 atoms, 0 repairs>
    """

    name: str  # Short name, from the file's name or the sequence.
    # ``openmm.app.Topology``: chains, residues, atoms and bonds, with chain ids, numbers and insertion codes
    # of the file.
    topology: Any
    positions: Floats  # (na, 3) float, nm: Positions of the atoms.
    repairs: tuple[Repair, ...] = ()  # Every change to the contents of the file. The text of each is a line.
    # Numbers of removed molecules and atoms of the file, by kind.
    left_out: Mapping[str, int] = field(default_factory=dict)
    # (na,) float, angstrom^2: B factors of the file, NaN if it has none. An added atom has the B factor of
    # its neighbour.
    b_factor: Floats = field(default_factory=lambda: np.empty(0))
    # (na,) bool: Fixed atoms: ligands, ions and other hetero molecules.
    obstacle: NDArray[np.bool_] = field(default_factory=lambda: np.empty(0, dtype=bool))
    # (na,) float: Occupancies of the file. An added hydrogen has the occupancy of its parent, any other added
    # atom 1.
    occupancy: Floats = field(default_factory=lambda: np.empty(0))
    # ``label_asym_id`` of each residue, and its place in the sequence of the file, or empty if unknown.
    residue_label: tuple[Label, ...] = ()
    header: str = ""  # Header of the file (title, cell, sequences, secondary structure), as mmCIF text.
    model_number: int = 1  # Number of the model in the file.
    ties: tuple[Tie, ...] = ()  # Springs between the protein and hetero molecules, part of every energy.
    # (na,) bool: Atoms of molecules that move with the protein: molecules with parameters in the user's force
    # field, and ligands of known chemistry.
    mobile: NDArray[np.bool_] = field(default_factory=lambda: np.empty(0, dtype=bool))
    # (n, 2) int: Bonds of the protein to atoms outside it, coordinated metals included, the protein's atom
    # first. Bonds between residues outside it that the file states (LINK, CONECT, ``_struct_conn``) follow.
    # Bonds with a metal are coordination.
    links: Integers = field(default_factory=lambda: np.empty((0, 2), dtype=np.int64))
    # (nr,) bool: D-amino acids. Their ``residue_name`` is the name of the mirror image. Files have the D
    # name.
    mirrored: NDArray[np.bool_] = field(default_factory=lambda: np.empty(0, dtype=bool))
    # (na,) bool: Heavy atoms missing from the file.
    built: NDArray[np.bool_] = field(default_factory=lambda: np.empty(0, dtype=bool))
    # Mobile small molecules near the protein with parameters of their own.
    ligands: tuple[BoundLigand, ...] = ()
    # Residues that no template fits, with the force field of small molecules: modified, cross-linked, or
    # bonded to the protein. Capping atoms of the molecule are atoms of its neighbours, or -1.
    fragments: tuple[BoundLigand, ...] = ()
    # Codes in GLYCAM-06j, as ``4YB``, of the mobile sugars of glycosylated proteins, by residue.
    glycans: Mapping[int, str] = field(default_factory=dict)
    origin: Origin | None = None  # Atoms of the file, or None for a sequence.

    def __post_init__(self) -> None:
        object.__setattr__(self, "positions", read_only(self.positions))
        object.__setattr__(self, "left_out", MappingProxyType(dict(self.left_out)))
        object.__setattr__(self, "glycans", MappingProxyType(dict(self.glycans)))
        b_factor = self.b_factor if len(self.b_factor) else np.zeros(self.n_atoms)
        object.__setattr__(self, "b_factor", read_only(b_factor))
        for name in ("obstacle", "mobile", "mirrored", "built"):
            values = getattr(self, name)
            n = self.n_residues if name == "mirrored" else self.n_atoms
            mask = values if len(values) else np.zeros(n, dtype=bool)
            object.__setattr__(self, name, read_only(mask, np.bool_))
        object.__setattr__(self, "links", read_only(self.links, np.int64))
        occupancy = self.occupancy if len(self.occupancy) else np.ones(self.n_atoms)
        object.__setattr__(self, "occupancy", read_only(occupancy))
        if self.positions.shape != (self.n_atoms, 3):
            raise StructureError(
                f"{self.name}: {self.n_atoms} atoms but positions of shape {self.positions.shape}"
            )
        if not np.isfinite(self.positions).all():
            atom = int(np.flatnonzero(~np.isfinite(self.positions).all(axis=1))[0])
            raise StructureError(
                f"{self.name}: {self.describe(atom)}: its position is not a number", fault=Fault.NOT_FINITE
            )

    @property
    def n_atoms(self) -> int:
        """Number of atoms."""
        return self.topology.getNumAtoms()

    @property
    def n_protein_residues(self) -> int:
        """Number of residues of the protein, without hetero molecules."""
        return len(np.unique(self.atom_residue[~self.kept]))

    @property
    def n_residues(self) -> int:
        """Number of residues."""
        return self.topology.getNumResidues()

    @property
    def n_chains(self) -> int:
        """Number of unbroken chains of the protein."""
        return len(np.unique(self.residue_chain_index[self.atom_residue[~self.kept]]))

    @cached_property
    def atom_name(self) -> NDArray[np.str_]:
        """(na,) str: atom names."""
        return np.array([atom.name for atom in self.topology.atoms()])

    @cached_property
    def atom_element(self) -> NDArray[np.str_]:
        """(na,) str: element symbols."""
        return np.array([atom.element.symbol for atom in self.topology.atoms()])

    @cached_property
    def atom_mass(self) -> Floats:
        """(na,) float, amu."""
        return read_only([atom.element.mass._value for atom in self.topology.atoms()])

    @cached_property
    def atom_residue(self) -> Integers:
        """(na,) int: residue index of each atom."""
        return read_only([atom.residue.index for atom in self.topology.atoms()], np.int64)

    @cached_property
    def residue_name(self) -> NDArray[np.str_]:
        """(nr,) str: residue names."""
        return np.array([residue.name for residue in self.topology.residues()])

    @cached_property
    def residue_name_in_file(self) -> NDArray[np.str_]:
        """(nr,) str: residue names in files, with D names for D-amino acids."""
        pairs = zip(self.residue_name.tolist(), self.mirrored.tolist(), strict=True)
        return np.array([name_in_file(name, is_d) for name, is_d in pairs])

    @cached_property
    def residue_number(self) -> NDArray[np.str_]:
        """(nr,) str: residue numbers of the file."""
        return np.array([residue.id for residue in self.topology.residues()])

    @cached_property
    def residue_insertion_code(self) -> NDArray[np.str_]:
        """(nr,) str: insertion codes, mostly empty."""
        return np.array([residue.insertionCode.strip() for residue in self.topology.residues()])

    @cached_property
    def residue_chain(self) -> NDArray[np.str_]:
        """(nr,) str: chain ids of the file, shared by the parts of a broken chain."""
        return np.array([residue.chain.id for residue in self.topology.residues()])

    @cached_property
    def residue_chain_index(self) -> Integers:
        """(nr,) int: index of the unbroken chain of each residue. The chain id may change within."""
        chain = np.array([residue.chain.index for residue in self.topology.residues()], dtype=np.int64)
        starts = np.diff(chain, prepend=-1) != 0
        (i, j), residue = self.bonds.T, self.atom_residue
        along = (residue[j] == residue[i] + 1) & (self.atom_name[i] == "C") & (self.atom_name[j] == "N")
        starts[residue[j[along & ~self.kept[i] & ~self.kept[j]]]] = False
        return read_only(np.cumsum(starts) - 1, np.int64)

    @cached_property
    def bonds(self) -> Integers:
        """(nbonds, 2) int: bonded atoms, the smaller index first."""
        pairs = [(bond.atom1.index, bond.atom2.index) for bond in self.topology.bonds()]
        return read_only(np.sort(np.array(pairs, dtype=np.int64).reshape(-1, 2), axis=1), np.int64)

    @cached_property
    def coordination(self) -> NDArray[np.bool_]:
        """(nbonds,) bool: bonds of metals with springs."""
        pairs = (tie.atoms for tie in self.ties if len(tie.atoms) == 2)
        ends = {tuple(sorted(pair)) for pair in pairs if is_metal(str(self.atom_element[pair[1]]))}
        return read_only([(i, j) in ends for i, j in self.bonds.tolist()], np.bool_)

    @property
    def neighbours(self) -> Neighbours:
        """Atoms bonded to each atom, in the order of the bonds, computed once for all frames."""
        if neighbours not in self.shared_cache:
            self.shared_cache[neighbours] = neighbours(self.bonds, self.n_atoms)
        table: Neighbours = self.shared_cache[neighbours]
        return table

    @cached_property
    def alpha_carbons(self) -> Integers:
        """(nca,) int: the C-alpha atoms of the protein."""
        alpha = (self.atom_name == "CA") & (self.atom_element == "C") & ~self.kept
        return read_only(np.flatnonzero(alpha), np.int64)

    @cached_property
    def kept(self) -> NDArray[np.bool_]:
        """(na,) bool: atoms outside the protein: obstacles, mobile ones, ions that move with the protein."""
        hetero = self.obstacle | self.mobile
        hetero[[tie.atoms[1] for tie in self.ties if len(tie.atoms) == 2]] = True
        return read_only(hetero, np.bool_)

    @cached_property
    def formal_charge(self) -> Integers:
        """(na,) int: formal charges in the file of atoms outside the protein, and of ions and thiolates."""
        return read_only([atom.formalCharge or 0 for atom in self.topology.atoms()], np.int64)

    @cached_property
    def shared_cache(self) -> dict[Any, Any]:
        """Cache of values independent of positions, shared with structures of :meth:`with_positions`."""
        return {}

    @cached_property
    def fingerprint(self) -> str:
        """SHA-256 of all inputs of the energy function: atoms, residues, bonds, obstacles, ties."""
        seen = hashlib.sha256()
        for values in (
            self.atom_name, self.atom_element, self.atom_residue, self.residue_name,
            self.residue_chain_index, self.bonds, self.obstacle, self.formal_charge,
        ):  # fmt: skip
            seen.update(f"{values.dtype.str}{values.shape}".encode() + values.tobytes())
        seen.update(repr(self.ties).encode())
        if self.mobile.any():
            seen.update(self.mobile.tobytes())
        for ligand in (*self.ligands, *self.fragments):
            seen.update(ligand.in_energy().encode())
        if self.glycans:
            seen.update(repr(sorted(self.glycans.items())).encode())
        return seen.hexdigest()

    @property
    def positions_fingerprint(self) -> str:
        """SHA-256 of the positions."""
        return hashlib.sha256(self.positions.tobytes()).hexdigest()

    @property
    def losses(self) -> tuple[Loss, ...]:
        """Heavy atoms lost from the file, without waters and atoms excluded by options."""
        return tuple(loss for repair in self.repairs for loss in repair.lost)

    @cached_property
    def b_factor_quantity(self) -> str:
        """Quantity in ``b_factor`` by the file: pLDDT, B factor, deviation between models, or unknown."""
        if "_ma_" in self.header:
            return "pLDDT"
        if with_header(self.header).cell.is_crystal():
            return B_FACTOR
        is_of_nmr = "models" in self.left_out and "NMR" in self.header.upper()
        return "deviation between models" if is_of_nmr else "unknown"

    @cached_property
    def changes(self) -> tuple[str, ...]:
        """Summary of the repairs: losses first, similar changes in one line."""
        return summarise(self.repairs)

    def describe_residue(self, residue: int) -> str:
        """Describe a residue: ``A:GLU17``."""
        return str(self.residue(residue))

    def residue(self, residue: int) -> Residue:
        """Chain, number and name of a residue in files."""
        number = f"{self.residue_number[residue]}{self.residue_insertion_code[residue]}"
        name = name_in_file(str(self.residue_name[residue]), bool(self.mirrored[residue]))
        return Residue(str(self.residue_chain[residue]), number, name)

    def describe(self, atom: int) -> str:
        """Describe an atom: ``atom CG of A:GLU17``."""
        return f"atom {self.atom(atom)}"

    def atom(self, atom: int) -> Atom:
        """Name and residue of an atom in files."""
        return Atom(str(self.atom_name[atom]), self.residue(int(self.atom_residue[atom])))

    def with_positions(self, x: Floats) -> "Structure":
        """Return the same structure with positions x (na, 3), nm."""
        moved, _ = replace(self, positions=x), self.shared_cache
        # Cached attributes do not depend on the positions.
        moved.__dict__.update({name: value for name, value in vars(self).items() if name not in vars(moved)})
        return moved

    def dihedrals(self) -> "pd.DataFrame":
        """Dihedrals of the protein, in degrees, one row per residue, as hinges are named and measured.

        Columns ``chain``, ``residue`` (number and insertion code), ``name``, ``phi``, ``psi``, ``omega`` (of
        the bond after it), ``chi1`` to ``chi5``. Missing dihedrals are NaN.
        """
        from protochain.structure.molecule.dihedrals import dihedrals

        return dihedrals(self)

    def __repr__(self) -> str:
        return (
            f"<Structure {self.name}: {self.n_chains} chains, {self.n_residues} residues, "
            f"{self.n_atoms} atoms, {len(self.repairs)} repairs>"
        )

    def _repr_html_(self) -> str:
        left_out = "; ".join(f"{count} {kind}" for kind, count in self.left_out.items())
        counts = {"chains": self.n_chains, "residues": self.n_residues, "atoms": self.n_atoms}
        changes = {"left out": left_out or "nothing", "repairs": "; ".join(self.changes) or "none"}
        return facts(f"Structure {self.name}", {**counts, **changes})


P = ParamSpec("P")
R = TypeVar("R")


def per_structure(find: Callable[Concatenate[Structure, P], R]) -> Callable[Concatenate[Structure, P], R]:
    """Cache the results of a function that ignores positions, for all structures with the same atoms."""

    @wraps(find)
    def lookup(structure: Structure, *args: P.args, **kwargs: P.kwargs) -> R:
        key = (find, args, *kwargs.items())
        if key not in structure.shared_cache:
            structure.shared_cache[key] = find(structure, *args, **kwargs)
        value: R = structure.shared_cache[key]
        return value

    return lookup


def per_positions(find: Callable[[Structure, Floats], R]) -> Callable[[Structure, Floats], R]:
    """Cache the results of a function at the last two positions x (na, 3): start and end of a run."""

    @wraps(find)
    def lookup(structure: Structure, x: Floats) -> R:
        last = structure.shared_cache.setdefault(find, deque(maxlen=2))
        for position, stored in (*last,):
            if np.array_equal(position, x):
                value: R = stored
                return value
        last.append((np.array(x), find(structure, x)))
        result: R = last[-1][1]
        return result

    return lookup
