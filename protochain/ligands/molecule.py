"""A small molecule as a value, and the same as RDKit has it."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import count
from typing import Any

import numpy as np

from protochain.core.arrays import Floats, Integers, Value, read_only
from protochain.core.errors import StructureError
from protochain.core.optional_libraries import library
from protochain.core.units import ANGSTROM_PER_NM

_MOST_ATOMS = 2000  # Memory grows with their square.


def quietly(call: Callable[..., Any], *args: Any, **keywords: Any) -> Any:
    """Call RDKit without its log, which goes to the terminal. Its exceptions are not caught."""
    with library("rdkit.rdBase").BlockLogs():
        return call(*args, **keywords)


@dataclass(frozen=True, eq=False)
class Molecule(Value):
    """A molecule with all its hydrogens."""

    names: tuple[str, ...]  # Unique. Element and number if the source has none.
    elements: Integers  # (na,) int: Atomic numbers.
    formal_charges: Integers  # (na,) int.
    bonds: Integers  # (m, 2) int.
    orders: Integers  # (m,) int: 1, 2 or 3: one Kekule structure.
    # (na,) int: 0, or for a stereocentre RDKit's tag: 1 if the other atoms of its bonds, in their order,
    # follow clockwise as seen from the first, 2 if counter-clockwise.
    handedness: Integers
    # (k, 5) int: Four atoms about a double bond with stereo, and 1 if the outer two are cis, else 0.
    double_bonds: Integers
    # Labels of these: atoms with R or S, as ``("C3", "R")``, and bonds with E or Z.
    stereo: tuple[tuple[str, str], ...]
    positions: Floats | None  # (na, 3): None if the source has no coordinates in space.
    source: str

    @property
    def n_atoms(self) -> int:
        """Number of atoms, hydrogens included."""
        return len(self.names)

    @property
    def charge(self) -> int:
        """Sum of the formal charges."""
        return int(self.formal_charges.sum())

    @property
    def heavy(self) -> Integers:
        """Numbers of the atoms that are not hydrogen."""
        return np.flatnonzero(self.elements != 1)


def to_rdkit(molecule: Molecule, positions: Floats | None = None) -> Any:
    """Return the molecule as RDKit's, sanitised, with other positions if they are given."""
    chem = library("rdkit.Chem")
    mol = build_mol(
        molecule.names, molecule.elements, molecule.formal_charges, molecule.bonds, molecule.orders,
        molecule.positions if positions is None else positions,
    )  # fmt: skip
    for atom, tag in zip(mol.GetAtoms(), molecule.handedness.tolist(), strict=True):
        atom.SetNoImplicit(True)
        atom.SetChiralTag(chem.ChiralType.values[tag])
    chem.SanitizeMol(mol)
    for first, begin, end, last, cis in molecule.double_bonds.tolist():
        bond = mol.GetBondBetweenAtoms(begin, end)
        ends = (first, last) if bond.GetBeginAtomIdx() == begin else (last, first)
        bond.SetStereoAtoms(*ends)
        bond.SetStereo(chem.BondStereo.STEREOCIS if cis else chem.BondStereo.STEREOTRANS)
    chem.AssignStereochemistry(mol)
    return mol


def in_mdl_aromaticity(molecule: Molecule) -> Any:
    """Return the molecule as RDKit's, with the aromaticity that patterns of SMIRNOFF mean."""
    chem, mol = library("rdkit.Chem"), to_rdkit(molecule)
    chem.Kekulize(mol, clearAromaticFlags=True)
    chem.SetAromaticity(mol, chem.AromaticityModel.AROMATICITY_MDL)
    return mol


def build_mol(
    names: Sequence[str], elements: Any, charges: Any, bonds: Any, orders: Any, positions: Floats | None
) -> Any:
    """Return RDKit's molecule, not sanitised, with orders 1, 2, 3, or 12 (aromatic), and positions in nm."""
    chem = library("rdkit.Chem")
    mol = chem.RWMol()
    for name, element, charge in zip(names, elements, charges, strict=True):
        atom = chem.Atom(int(element))
        atom.SetFormalCharge(int(charge))
        atom.SetProp("name", name)
        mol.AddAtom(atom)
    for (i, j), order in zip(bonds, orders, strict=True):
        mol.AddBond(int(i), int(j), chem.BondType.values[int(order)])
        if order == 12:
            bond = mol.GetBondBetweenAtoms(int(i), int(j))
            for part in (bond, bond.GetBeginAtom(), bond.GetEndAtom()):
                part.SetIsAromatic(True)
    if positions is not None:
        place(mol, positions)
    return mol


def place(mol: Any, positions: Floats) -> None:
    """Give a molecule of RDKit these positions, in nm, in place of those it has."""
    conformer = library("rdkit.Chem").Conformer(mol.GetNumAtoms())
    conformer.SetPositions(np.array(positions * ANGSTROM_PER_NM))
    conformer.Set3D(True)
    mol.RemoveAllConformers()
    mol.AddConformer(conformer)


def from_rdkit(mol: Any, source: str) -> Molecule:
    """Return a sanitised molecule of RDKit as a value, with the hydrogens that it lacks."""
    chem = library("rdkit.Chem")
    if mol.GetNumAtoms() > _MOST_ATOMS:
        raise StructureError(f"{source}: has {mol.GetNumAtoms()} atoms; give a small molecule")
    # Complete the molecule, and refuse fragments and radicals.
    _draw_thiophosphates(mol)
    in_space = mol.GetNumConformers() > 0 and mol.GetConformer().Is3D()
    if in_space and not np.isfinite(mol.GetConformer().GetPositions()).all():
        raise StructureError(f"{source}: has coordinates that are not finite numbers; mend them")
    mol = chem.AddHs(mol, addCoords=in_space)
    names = _names(mol)
    n_pieces = len(chem.GetMolFrags(mol))
    if n_pieces != 1:
        raise StructureError(f"{source}: has {n_pieces} molecules; give one, without its salt and water")
    for name, atom in zip(names, mol.GetAtoms(), strict=True):
        if atom.GetNumRadicalElectrons():
            raise StructureError(f"{source}: atom {name} lacks a bond or a charge; complete the file")
    # Stereo from coordinates, except at acids.
    if in_space:
        chem.AssignStereochemistryFrom3D(mol)
    for atom in mol.GetAtoms():
        if _acid(atom):
            atom.SetChiralTag(chem.ChiralType.CHI_UNSPECIFIED)
            atom.ClearProp("_CIPCode")
    chem.Kekulize(mol, clearAromaticFlags=True)
    double_bonds, stereo = _double_bonds(mol, names)
    atoms, bonds = mol.GetAtoms(), mol.GetBonds()
    named = zip(names, atoms, strict=True)
    centres = [(name, atom.GetProp("_CIPCode")) for name, atom in named if atom.HasProp("_CIPCode")]
    tags = {chem.ChiralType.values[tag]: tag for tag in (1, 2)}
    positions = mol.GetConformer().GetPositions() / ANGSTROM_PER_NM if in_space else None
    return Molecule(
        names,
        read_only([a.GetAtomicNum() for a in atoms], np.int64),
        read_only([a.GetFormalCharge() for a in atoms], np.int64),
        read_only([(b.GetBeginAtomIdx(), b.GetEndAtomIdx()) for b in bonds], np.int64).reshape(-1, 2),
        read_only([round(b.GetBondTypeAsDouble()) for b in bonds], np.int64),
        read_only([tags.get(a.GetChiralTag(), 0) for a in atoms], np.int64),
        read_only(double_bonds, np.int64).reshape(-1, 5),
        (*centres, *stereo),
        None if positions is None else read_only(positions),
        source,
    )


def _draw_thiophosphates(mol: Any) -> None:
    """Draw P(=O)[S-] as P(=S)[O-], the same anion: its bond of P and S has the length of a double one."""
    chem = library("rdkit.Chem")
    query = chem.MolFromSmarts("[OX1;+0]=[PX4]-[SX1-]")
    while match := mol.GetSubstructMatch(query):
        oxygen, phosphorus, sulphur = match
        for end, kind, charge in ((oxygen, "SINGLE", -1), (sulphur, "DOUBLE", 0)):
            mol.GetBondBetweenAtoms(phosphorus, end).SetBondType(chem.BondType.names[kind])
            mol.GetAtomWithIdx(end).SetFormalCharge(charge)


def _acid(atom: Any) -> bool:
    """Whether two oxygens end at this atom. The place of an acid's proton makes no stereocentre."""
    ends = [near for near in atom.GetNeighbors() if near.GetAtomicNum() == 8]
    return sum(all(o.GetAtomicNum() in (1, atom.GetAtomicNum()) for o in e.GetNeighbors()) for e in ends) > 1


def _double_bonds(mol: Any, names: tuple[str, ...]) -> tuple[list[list[int]], list[tuple[str, str]]]:
    """Rows of ``double_bonds``, and the same as E and Z."""
    rows, letters = [], []
    for bond in mol.GetBonds():
        kind = str(bond.GetStereo())
        if kind in ("STEREOE", "STEREOZ", "STEREOCIS", "STEREOTRANS"):
            first, last = bond.GetStereoAtoms()
            begin, end = bond.GetBeginAtomIdx(), bond.GetEndAtomIdx()
            cis = kind in ("STEREOZ", "STEREOCIS")
            rows.append([first, begin, end, last, int(cis)])
            letters.append((f"{names[begin]}={names[end]}", "Z" if cis else "E"))
    return rows, letters


def _names(mol: Any) -> tuple[str, ...]:
    """Names of the atoms, if they are unique. Other names are made of element and number."""
    source_names = [atom.GetProp("name") if atom.HasProp("name") else "" for atom in mol.GetAtoms()]
    often = Counter(source_names)
    used = {name for name in source_names if name and often[name] == 1}
    names = []
    for name, atom in zip(source_names, mol.GetAtoms(), strict=True):
        if name not in used:
            made_up = (f"{atom.GetSymbol()}{number}" for number in count(1))
            name = next(candidate for candidate in made_up if candidate not in used)
            used.add(name)
        names.append(name)
    return tuple(names)
