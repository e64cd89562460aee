"""Sources of the chemistry of a small molecule: the user, a file's bonds, the dictionary.

Distances are not used: orders of bonds, charges and hydrogens do not follow from coordinates.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from protochain.core.arrays import read_only
from protochain.core.checks import MOLECULE_SUFFIXES, file_and_record
from protochain.core.errors import Argument, StructureError
from protochain.core.graph import components
from protochain.core.optional_libraries import library
from protochain.core.storage import regular
from protochain.core.units import ANGSTROM_PER_NM
from protochain.ligands.dictionary import component
from protochain.ligands.molecule import Molecule, build_mol, from_rdkit, quietly, to_rdkit
from protochain.ligands.tables import CATEGORY, of_header, stereo

_LARGEST = 10_000_000  # Bytes of a molecule. A model with its ligand is larger.
_MOL2 = "@<TRIPOS>MOLECULE"
_LISTED = ", ".join(MOLECULE_SUFFIXES)
_AROMATIC = 12
_ORDERS = {"sing": 1, "doub": 2, "trip": 3, "arom": _AROMATIC, "delo": _AROMATIC}
"""Of mmCIF's bond tables, by the first four letters. Aromatic bonds have RDKit's number."""


def of_residue(
    name: str,
    header: str = "",
    atoms: Mapping[str, tuple[str, int]] = MappingProxyType({}),
    source: str | Path | None = None,
) -> Molecule:
    """Return the chemistry of a residue of a model, from the first of three sources that has it."""
    if source is not None:
        return read(source)
    molecule, is_charged = _of_tables(header, name, atoms)
    if molecule is None:
        return from_dictionary(name)
    try:
        component_molecule = from_dictionary(name)
    except StructureError:
        return molecule
    if is_charged:
        # Tables of the dictionary's own molecule lack its stereocentres.
        is_same = name not in of_header(header) and _drawing(molecule) == _drawing(component_molecule)
        return component_molecule if is_same else molecule
    # Bonds without charges do not tell a sulphate from its acid, nor a part of a molecule from the whole.
    return component_molecule if _heavy_bonds(molecule) <= _heavy_bonds(component_molecule) else molecule


def _drawing(molecule: Molecule) -> tuple[dict[str, int], dict[frozenset[str], int]]:
    """Charges of the heavy atoms and orders of their bonds, by name."""
    charges = {molecule.names[i]: int(molecule.formal_charges[i]) for i in molecule.heavy.tolist()}
    ends = (frozenset(molecule.names[i] for i in pair) for pair in molecule.bonds.tolist())
    orders = dict(zip(ends, molecule.orders.tolist(), strict=True))
    return charges, {pair: order for pair, order in orders.items() if pair <= charges.keys()}


def _heavy_bonds(molecule: Molecule) -> set[frozenset[str]]:
    """Names of heavy atoms that are bonded, and of each by itself."""
    pairs = (*molecule.bonds.tolist(), *zip(molecule.heavy, molecule.heavy, strict=True))
    return {
        frozenset(molecule.names[i] for i in pair) for pair in pairs if 1 not in molecule.elements[[*pair]]
    }


def read(source: str | Path) -> Molecule:
    """Read a user's molecule: path of an SDF or MOL2 file, perhaps with ``#2`` for a record, or SMILES."""
    path, record = file_and_record(source)
    if isinstance(source, Path) or path.suffix.lower() in MOLECULE_SUFFIXES:
        return _from_file(path, record)
    mol = quietly(library("rdkit.Chem").MolFromSmiles, source)
    if mol is None or not mol.GetNumAtoms():
        raise StructureError(
            f"{_short(source)} is neither SMILES nor the name of a file with suffix {_LISTED}; "
            "give one of them"
        )
    return from_rdkit(mol, _short(source))


@lru_cache(maxsize=64)
def from_dictionary(name: str) -> Molecule:
    """Return a molecule of the Chemical Component Dictionary, which biotite carries, without its metals."""
    try:
        atoms = component(_DRAWN_AS.get(name, name))
    except KeyError:
        raise _unknown_chemistry(name) from None
    if name in _CATIONS:
        atoms = atoms[atoms.atom_name != "H82"]
    kinds = library("biotite.structure").BondType
    orders = dict.fromkeys((kinds.SINGLE, kinds.AROMATIC_SINGLE), 1)
    orders |= dict.fromkeys((kinds.DOUBLE, kinds.AROMATIC_DOUBLE), 2) | {kinds.TRIPLE: 3}
    table = atoms.bonds.as_array()
    ends, redrawn = atoms.atom_name[table[:, :2]].tolist(), _REDRAWN.get(name, {})
    kekule = [redrawn.get(frozenset(a), orders.get(kinds(k))) for a, k in zip(ends, table[:, 2], strict=True)]
    if None in kekule:
        raise _unknown_chemistry(name)
    elements = [_atomic_number(symbol) for symbol in atoms.element]
    # Spin labels are taken for their hydroxylamines, NH2 ends a chain; nitric oxide is not nitroxyl.
    is_open = not {1, 6} & {*elements} and (sum(elements) - int(sum(atoms.charge))) % 2
    if is_open or len(elements) == 1:
        problem = "a radical" if is_open else "one atom"
        raise StructureError(
            f"{name} of the Chemical Component Dictionary: is {problem}, without parameters; "
            "give the chemistry of what is meant"
        )
    x = np.asarray(atoms.coord, dtype=float) / ANGSTROM_PER_NM
    charges = (atoms.charge + ((atoms.atom_name == "N7") & (name in _CATIONS))).tolist()
    source, names = f"{name} of the Chemical Component Dictionary", list(map(str, atoms.atom_name))
    ends = table[:, :2].tolist()
    indices, organic = _without_metals(source, names, elements, charges, ends, [k or 0 for k in kekule])
    return _sanitise(build_mol(*organic, x[indices]), source)


def text_of(path: Path) -> str:
    """Return the text of a file of bounded size."""
    try:
        if regular(path).stat().st_size > _LARGEST:
            raise StructureError(
                f"{path}: is too large for molecules; split it into files of up to {_LARGEST // 1_000_000} MB"
            )
        return path.read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        raise StructureError(f"{path}: cannot be read ({error.strerror}); give another file") from None


def records(text: str, suffix: str) -> list[str]:
    """Molecules of an SDF or MOL2 file."""
    if suffix == ".mol2":
        blocks = text.split(_MOL2)[1:]
        return [f"{_MOL2}{block}" for block in blocks]
    # As RDKit, ignore what follows the signs on their line.
    return [block for block in re.split(r"\n\$\$\$\$.*", text.replace("\r\n", "\n")) if block.strip()]


_FARTHEST = 1e5  # Angstrom, as of structures.


def as_filed(source: str) -> tuple[Molecule, str, str] | None:
    """Return the molecule of a file, the title, and the text of the fields of SDF. None without a file."""
    path, number = file_and_record(source)
    if path.suffix.lower() not in MOLECULE_SUFFIXES or not path.exists():
        return None
    text = _record(path, number)
    fields = text.partition("M  END")[2].partition("\n")[2].strip("\n")
    return read(source), title_of(source), f"{fields}\n\n" if fields else ""


def title_of(source: str) -> str:
    """Title of a molecule of a file, which need not be readable otherwise."""
    path, number = file_and_record(source)
    return _record(path, number).removeprefix(f"{_MOL2}\n").split("\n")[0].strip()


def _record(path: Path, number: int) -> str:
    """Text of one molecule of a file."""
    suffix = path.suffix.lower()
    if suffix not in MOLECULE_SUFFIXES:
        raise StructureError(f"{path}: is none of {_LISTED}; give one of them, or SMILES")
    blocks = records(text_of(path), suffix)
    if number > len(blocks) or (not number and len(blocks) != 1):
        one = f", as {path}#1" if blocks else ""
        raise StructureError(f"{path}: has {len(blocks)} molecules; give a file with one, or one of its{one}")
    return blocks[max(number, 1) - 1].removeprefix("\n" if number > 1 else "")


def _from_file(path: Path, number: int) -> Molecule:
    text, suffix = _record(path, number), path.suffix.lower()
    source = f"{path}#{number}" if number else str(path)
    chem = library("rdkit.Chem")
    parse: Callable[..., Any] = chem.MolFromMol2Block if suffix == ".mol2" else chem.MolFromMolBlock
    mol = quietly(parse, text, removeHs=False)
    if mol is None:  # Without its checks RDKit reports the problem.
        mol = quietly(parse, text, removeHs=False, sanitize=False)
        if mol is None:
            raise StructureError(f"{source}: is no {suffix[1:].upper()} file that can be read; mend it")
        return _sanitise(mol, source)
    for atom in mol.GetAtoms():
        if atom.HasProp("_TriposAtomName"):
            atom.SetProp("name", atom.GetProp("_TriposAtomName"))
    if not mol.GetNumAtoms():
        raise StructureError(f"{source}: has no atoms; give a file with one molecule")
    if mol.GetNumConformers() and np.abs(mol.GetConformer().GetPositions()).max() > _FARTHEST:
        raise StructureError(f"{source}: an atom lies beyond {_FARTHEST:g} angstrom; correct it")
    return from_rdkit(mol, source)


def _of_tables(header: str, name: str, model: Mapping[str, tuple[str, int]]) -> tuple[Molecule | None, bool]:
    """Chemistry by ``_chem_comp_bond`` and ``_chem_comp_atom``, and whether the file has charges."""
    import gemmi

    if "_chem_comp_bond." not in header:
        return None, False
    source, block = f"{name} of the file's bonds", gemmi.cif.read_string(header).sole_block()
    columns = ["comp_id", "atom_id_1", "atom_id_2", "value_order"]
    bonds = [[row.str(i) for i in range(4)] for row in block.find("_chem_comp_bond.", columns)]
    bonds = [row[1:] for row in bonds if row[0] == name]
    if not bonds:
        return None, False
    atoms: dict[str, tuple[str, int]] = {}
    is_charged = any(charge for _, charge in model.values())
    for row in block.find("_chem_comp_atom.", ["comp_id", "atom_id", "type_symbol", "?charge"]):
        if row.str(0) == name:
            charge = row.str(3) if row.has(3) else ""
            is_charged |= bool(charge)
            atoms[row.str(1)] = (row.str(2), int(charge) if charge.lstrip("+-").isdigit() else 0)
    bonded = {end for row in bonds for end in row[:2]}
    # Hydrogens of which the table has no bond follow from the others.
    atoms = atoms or {a: atom for a, atom in model.items() if a in bonded or atom[0] not in ("H", "D")}
    # The table of bonds has leaving atoms and hydrogens, which a model may lack.
    bonds = [row for row in bonds if row[0] in atoms and row[1] in atoms]
    names = list(atoms)
    pairs = [(names.index(row[0]), names.index(row[1])) for row in bonds]
    if np.ptp(components(np.array(pairs, dtype=int).reshape(-1, 2), len(names))) > 0:
        return None, False  # A table of some bonds only.
    orders = [_ORDERS.get(row[2].lower()[:4], 0) for row in bonds]
    if 0 in orders:
        raise StructureError(f"{source}: has bonds of an unknown order; mend value_order")
    elements = [_atomic_number(symbol) for symbol, _ in atoms.values()]
    charges = [charge for _, charge in atoms.values()]
    if not is_charged:
        charges = _by_valence(elements, pairs, orders)
    # The molecule without stereo, then with the stereo of our own table.
    _, organic = _without_metals(source, names, elements, charges, pairs, orders)
    plain = _sanitise(build_mol(*organic, None), source)
    table = block.find(CATEGORY, ["comp_id", "kind", "atoms"])
    stereo_rows = [{"kind": row.str(1), "atoms": row.str(2)} for row in table if row.str(0) == name]
    parity, double = stereo(stereo_rows, plain.names, plain.bonds.tolist())
    if not any(parity) and not double:
        return plain, is_charged
    double_bonds = read_only(double, np.int64).reshape(-1, 5)
    handed = replace(plain, handedness=read_only(parity, np.int64), double_bonds=double_bonds)
    return from_rdkit(to_rdkit(handed), source), is_charged


def _by_valence(elements: list[int], pairs: list[tuple[int, int]], orders: list[int]) -> list[int]:
    """Charges of atoms of a table that has none: a nitrogen with four bonds, and an oxide at such a one."""
    bonds = np.zeros(len(elements))
    for pair, order in zip(pairs, orders, strict=True):
        bonds[list(pair)] += 1.5 if order == _AROMATIC else order
    charges = [int(z == 7 and n == 4) for z, n in zip(elements, bonds, strict=True)]
    for ends in (*pairs, *(pair[::-1] for pair in pairs)):
        nitrogen, oxygen = ends
        if charges[nitrogen] == 1 and elements[oxygen] == 8 and bonds[oxygen] == 1:
            charges[oxygen] = -1
    return charges


def _without_metals(
    source: str,
    names: list[str],
    elements: list[int],
    charges: list[int],
    pairs: list[Any],
    orders: list[int],
) -> tuple[list[int], tuple[list[str], list[int], list[int], list[list[int]], list[int]]]:
    """Atoms that stay, and an organic molecule without metals: donors get the electrons of their bonds."""
    import gemmi

    metal = [gemmi.Element(z).is_metal for z in elements]
    bonds = [(*pair, order) for pair, order in zip(pairs, orders, strict=True)]
    donors = {(j if metal[i] else i) for i, j, _ in bonds if metal[i] != metal[j]}
    if not donors or 6 not in elements:
        return [*range(len(names))], (names, elements, charges, pairs, orders)
    bonds = [bond for bond in bonds if not (metal[bond[0]] or metal[bond[1]])]
    charges = list(charges)
    for k in donors:
        charges[k] = sum(order for *ends, order in bonds if k in ends) - _VALENCE.get(elements[k], 0)
    indices = [k for k, is_metal in enumerate(metal) if not is_metal]
    place = {k: n for n, k in enumerate(indices)}
    ends = [[place[i], place[j]] for i, j, _ in bonds]
    n_molecules = len({*components(np.array(ends, dtype=int).reshape(-1, 2), len(indices)).tolist()})
    if n_molecules > 1 or sum(elements[k] == 7 and charges[k] < 0 for k in indices) > _RING_ANIONS:
        reason = f"of {n_molecules} molecules" if n_molecules > 1 else "drawn without the charge of its ring"
        raise StructureError(f"{source}: is a complex of a metal, {reason}, without parameters")
    fields = [names[k] for k in indices], [elements[k] for k in indices], [charges[k] for k in indices]
    return indices, (*fields, ends, [order for *_, order in bonds])


_VALENCE = {6: 4, 7: 3, 8: 2, 16: 2}
_RING_ANIONS = 2  # Anions at most among the nitrogens of a macrocycle.
_DRAWN_AS = {"HEC": "HEM"}
_CATIONS = ("7MG", "MGT")
"""7-Methylguanines that are drawn with a second hydrogen at C8 in the place of their charge."""
_REDRAWN: dict[str, dict[frozenset[str], int]] = {
    "HEC": {frozenset(("CAB", "CBB")): 1, frozenset(("CAC", "CBC")): 1},
    **{name: {frozenset(("N7", "C8")): 2} for name in _CATIONS},
}
"""Other orders of bonds. Heme c is drawn without its thioethers and with ethylidene groups, which charge all
nitrogens of its ring. The chemistry equals heme b with ethyl for vinyl groups: a cysteine replaces a
hydrogen."""


def _sanitise(mol: Any, source: str) -> Molecule:
    chem = library("rdkit.Chem")
    try:
        quietly(chem.SanitizeMol, mol)
    except ValueError as error:
        reason = " ".join(str(error).split())
        raise StructureError(f"{source}: is no molecule ({reason}); give its SDF or SMILES") from None
    return from_rdkit(mol, source)


def _atomic_number(symbol: str) -> int:
    import gemmi

    element = gemmi.Element(str(symbol))
    return 1 if element.atomic_number == 1 or str(symbol).upper() == "D" else int(element.atomic_number)


def _unknown_chemistry(name: str) -> StructureError:
    return StructureError(
        f"the chemistry of {name!r} is unknown: neither its file nor the Chemical Component Dictionary has "
        "its bonds; give them as ", Argument("ligands", f"{name}=FILE.sdf"),
    )  # fmt: skip


def _short(text: object) -> str:
    escaped = ascii(str(text))
    return escaped if len(escaped) <= 60 else f"{escaped[:57]}..."
