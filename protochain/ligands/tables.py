"""Chemistry of a small molecule as tables of mmCIF, from which :mod:`protochain.ligands.sources` reads it.

A table of stereo, next to the PDB's tables of atoms and bonds, names neighbours in their order. R and S are
for readers, because programs differ in the finer rules of these letters.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from itertools import combinations, pairwise

import gemmi
import numpy as np

from protochain.core.graph import neighbours
from protochain.ligands.molecule import Molecule, to_rdkit

Rows = list[dict[str, str]]

CATEGORY = "_protochain_ligand."
_REMARK = "REMARK 981"  # A number that the PDB does not use.
_ATOMS, _BONDS = "_chem_comp_atom.", "_chem_comp_bond."
_IN_REMARKS = {
    _ATOMS: ("atom", ("atom_id", "type_symbol", "charge")),
    _BONDS: ("bond", ("atom_id_1", "atom_id_2", "value_order")),
}
"""First word of a remark, and the columns of the table that follow it."""
ORDERS = {1: "sing", 2: "doub", 3: "trip"}
_KNOWN, _CLOCKWISE, _COUNTER, _CIS, _TRANS = "known", "clockwise", "counterclockwise", "cis", "trans"


def rows(component: str, molecule: Molecule) -> dict[str, Rows]:
    """Rows of ``_chem_comp_atom``, ``_chem_comp_bond`` and of our own table of stereo."""
    mol, letters = to_rdkit(molecule), dict(molecule.stereo)
    names = [_quote(name) for name in molecule.names]
    comp_id = _quote(component)
    atoms = [
        {
            "comp_id": comp_id, "atom_id": names[k], "type_symbol": atom.GetSymbol().upper(),
            "charge": f"{atom.GetFormalCharge()}", "pdbx_aromatic_flag": _flag(atom.GetIsAromatic()),
            "pdbx_stereo_config": letters.get(molecule.names[k], "N"), "pdbx_ordinal": f"{k + 1}",
        }
        for k, atom in enumerate(mol.GetAtoms())
    ]  # fmt: skip
    bonds = []
    for k, ((i, j), order) in enumerate(zip(molecule.bonds.tolist(), molecule.orders.tolist(), strict=True)):
        ends = (f"{molecule.names[a]}={molecule.names[b]}" for a, b in ((i, j), (j, i)))
        bonds.append({
            "comp_id": comp_id, "atom_id_1": names[i], "atom_id_2": names[j], "value_order": ORDERS[order],
            "pdbx_aromatic_flag": _flag(mol.GetBondBetweenAtoms(i, j).GetIsAromatic()),
            "pdbx_stereo_config": next((letters[end] for end in ends if end in letters), "N"),
            "pdbx_ordinal": f"{k + 1}",
        })  # fmt: skip
    stereo_rows = [
        {"comp_id": comp_id, "kind": kind, "atoms": _quote(" ".join(members)) if members else "."}
        for kind, members in _stereo_rows(molecule)
    ]
    return {_ATOMS: atoms, _BONDS: bonds, CATEGORY: stereo_rows}


def heavy_rows(component: str, molecule: Molecule) -> dict[str, Rows]:
    """Rows without hydrogens, which follow from orders and charges."""
    tables = rows(component, molecule)
    heavy = [row for row in tables[_ATOMS] if row["type_symbol"] != "H"]
    names = {row["atom_id"] for row in heavy}
    bonds = [row for row in tables[_BONDS] if {row["atom_id_1"], row["atom_id_2"]} <= names]
    return {**tables, _ATOMS: heavy, _BONDS: bonds}


def _stereo_rows(molecule: Molecule) -> Iterator[tuple[str, list[str]]]:
    """Rows that state known bonds with orders, stereocentres, and double bonds, with their neighbours."""
    near = neighbours(molecule.bonds, molecule.n_atoms)
    yield _KNOWN, []
    for centre in np.flatnonzero(molecule.handedness).tolist():
        kind = _CLOCKWISE if molecule.handedness[centre] == 1 else _COUNTER
        yield kind, [molecule.names[i] for i in (centre, *near[centre])]
    for *about, cis in molecule.double_bonds.tolist():
        yield _CIS if cis else _TRANS, [molecule.names[i] for i in about]


def stereo(
    table: Iterable[Mapping[str, str]], names: Sequence[str], bonds: Iterable[Sequence[int]]
) -> tuple[list[int], list[list[int]]]:
    """Handedness of each atom and rows of double bonds, as a molecule has them."""
    place = {name: k for k, name in enumerate(names)}
    near = neighbours(np.array(list(bonds), dtype=np.int64).reshape(-1, 2), len(names))
    parity, double = [0] * len(names), []
    for row in table:
        kind, atoms = row.get("kind", ""), [place.get(name, -1) for name in row.get("atoms", "").split()]
        if kind in (_CLOCKWISE, _COUNTER) and atoms and atoms[0] >= 0:
            around = near[atoms[0]]
            # A hydrogen that the file has not gets another name.
            unnamed = [i for i in around if i not in atoms]
            order = [unnamed[0] if i < 0 and len(unnamed) == 1 else i for i in atoms[1:]]
            if sorted(order) == sorted(around):
                places = [order.index(i) for i in around]
                is_even = sum(a > b for a, b in combinations(places, 2)) % 2 == 0
                same = (kind == _CLOCKWISE) == is_even
                parity[atoms[0]] = 1 if same else 2
        bonded = -1 not in atoms and all(j in near[i] for i, j in pairwise(atoms))
        if kind in (_CIS, _TRANS) and len(atoms) == 4 and bonded:
            double.append([*atoms, int(kind == _CIS)])
    return parity, double


def as_remarks(tables: Mapping[str, Rows], complete: Collection[str]) -> list[str]:
    """Return the remarks of a PDB file: our own table, and atoms and bonds of some components."""
    plain = {
        category: [{item: gemmi.cif.as_string(value) for item, value in row.items()} for row in table]
        for category, table in tables.items() if category in (CATEGORY, _ATOMS, _BONDS)
    }  # fmt: skip
    selected = [row for row in plain.get(CATEGORY, []) if row.keys() >= {"comp_id", "kind", "atoms"}]
    lines = [[row["comp_id"], row["kind"], row["atoms"]] for row in selected]
    for category, (kind, items) in _IN_REMARKS.items():
        lines += [
            [row["comp_id"], kind, *(row[item] for item in items)]
            for row in plain.get(category, [])
            if row["comp_id"] in complete and row.keys() >= {*items}
        ]
    return [f"{_REMARK} {component:>3} {' '.join(words)}".rstrip() for component, *words in lines]


def of_remarks(lines: Iterable[str]) -> dict[str, Rows]:
    """Return the tables that the remarks of a PDB file have."""
    cells = [line[len(_REMARK) :].split() for line in lines if line.startswith(_REMARK)]
    tables: dict[str, Rows] = {category: [] for category in (CATEGORY, *_IN_REMARKS)}
    categories = {kind: (category, items) for category, (kind, items) in _IN_REMARKS.items()}
    for component, kind, *words in (row for row in cells if len(row) > 1):
        category, items = categories.get(kind, (CATEGORY, ()))
        if items and len(words) == len(items):
            values = dict(zip(items, map(_quote, words), strict=True))
            tables[category].append({"comp_id": _quote(component), **values})
        elif not items:
            atoms = _quote(" ".join(words)) if words else "."
            tables[CATEGORY].append({"comp_id": _quote(component), "kind": _quote(kind), "atoms": atoms})
    return tables


def complete_components(table: Iterable[Mapping[str, str]]) -> set[str]:
    """Components whose bonds a file states completely, with their orders."""
    return {gemmi.cif.as_string(row["comp_id"]) for row in table if row["kind"] == _KNOWN}


def of_header(header: str) -> set[str]:
    """Components of our own table in a header."""
    block = gemmi.cif.read_string(header if CATEGORY in header else "data_none").sole_block()
    return {row.str(0) for row in block.find(CATEGORY, ["comp_id"])}


def _flag(is_so: bool) -> str:
    return "Y" if is_so else "N"


def _quote(value: str) -> str:
    return str(gemmi.cif.quote(value))
