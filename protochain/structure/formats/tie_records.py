"""Springs between the protein and hetero molecules, as mmCIF rows and PDB remarks that restore them."""

from collections.abc import Iterable, Iterator, Mapping
from math import isfinite

import gemmi
import numpy as np

from protochain.core.graph import components
from protochain.structure.molecule.member import Address
from protochain.structure.molecule.model import Structure

CATEGORY = "_protochain_tie."
_REMARK = "REMARK 980"
"""Remark number that the PDB does not use."""
_ENDS = ("auth_asym_id_{}", "auth_seq_id_{}", "PDB_ins_code_{}", "auth_atom_id_{}")
DIGITS = 9
"""Decimals of nm and rad in a remark. All springs are rounded to them, so that reading restores them."""
_START, _WIDTH = 11, 12
"""Columns of a remark: chain, residue number, insertion code and name of three atoms, rest, stiffness."""

Spring = tuple[tuple[Address, ...], float, float]
"""Atoms, rest (nm, rad), stiffness (kJ/mol/nm^2, kJ/mol/rad^2). One atom alone marks a fixed molecule."""


def springs(records: str) -> Mapping[tuple[Address, ...], tuple[float, float]]:
    """Return rest and stiffness of the springs in a file, by their atoms."""
    block = gemmi.cif.read_string(records).sole_block() if CATEGORY in records else gemmi.cif.Block("")
    columns = block.get_mmcif_category(CATEGORY, raw=True)
    constants: dict[tuple[Address, ...], tuple[float, float]] = {}
    for values in zip(*columns.values(), strict=True):
        row = {item: gemmi.cif.as_string(value) for item, value in zip(columns, values, strict=True)}
        ends = [[row.get(item.format(k), "") for item in _ENDS] for k in (1, 2, 3)]
        atoms = tuple((chain, number + code, name) for chain, number, code, name in ends if name)
        r0, stiffness = (_number(row.get(item, "")) for item in ("rest", "stiffness"))
        if atoms and isfinite(r0) and isfinite(stiffness) and r0 >= 0.0 and stiffness >= 0.0:
            constants[atoms] = (r0, stiffness)
    return constants


def of_structure(structure: Structure) -> list[Spring]:
    """Return springs, and one atom of each fixed or free hetero molecule except waters and glycosides."""
    residue = structure.atom_residue

    def address(atom: int) -> Address:
        r = int(residue[atom])
        number = f"{structure.residue_number[r]}{structure.residue_insertion_code[r]}"
        return str(structure.residue_chain[r]), number, str(structure.atom_name[atom])

    records: list[Spring] = [
        (tuple(address(atom) for atom in tie.atoms), tie.rest, tie.stiffness) for tie in structure.ties
    ]
    restrained = {int(residue[tie.atoms[1]]) for tie in structure.ties if len(tie.atoms) == 2}
    waters = set(np.flatnonzero(structure.residue_name == "HOH").tolist())
    molecule = components(structure.bonds[~structure.coordination], structure.n_atoms)
    glycosides = structure.mobile & np.isin(molecule, molecule[~structure.kept])
    is_candidate = structure.kept & (structure.atom_element != "H") & ~glycosides
    residues, first = np.unique(residue[is_candidate], return_index=True)
    for r, k in zip(residues.tolist(), np.flatnonzero(is_candidate)[first].tolist(), strict=True):
        if r not in waters and (structure.obstacle[k] or r not in restrained):
            records.append(((address(k),), 0.0, 0.0))
    return records


def as_rows(records: Iterable[Spring]) -> list[dict[str, str]]:
    """Return springs as rows of the mmCIF category."""
    return [
        {
            "ordinal": f"{n}",
            **{
                item.format(k + 1): _value(atoms, k, part)
                for k in range(3)
                for part, item in enumerate(_ENDS)
            },
            "rest": repr(r0),
            "stiffness": repr(stiffness),
        }
        for n, (atoms, r0, stiffness) in enumerate(records, 1)
    ]


def as_remarks(records: Iterable[Spring]) -> list[str]:
    """Return springs as remarks of a PDB file."""
    remarks = []
    for atoms, r0, stiffness in records:
        cells = "".join(f"{chain:1}{_pad_number(number):>5} {name:<4} " for chain, number, name in atoms)
        remarks.append(f"{_REMARK} {cells.ljust(3 * _WIDTH)}{r0:12.{DIGITS}f}{stiffness:11.1f}")
    return remarks


def of_remarks(lines: Iterable[str]) -> list[dict[str, str]]:
    """Return the remarks of a PDB file as rows of the mmCIF category."""
    return as_rows(_of_remarks(lines))


def _of_remarks(lines: Iterable[str]) -> Iterator[Spring]:
    for line in lines:
        if line.startswith(_REMARK):
            cells = [line[_START + k * _WIDTH : _START + (k + 1) * _WIDTH] for k in range(3)]
            atoms = tuple(
                (cell[:1].strip(), cell[1:6].strip(), cell[7:11].strip()) for cell in cells if cell.strip()
            )
            r0, _, stiffness = line[_START + 3 * _WIDTH :].strip().partition(" ")
            yield atoms, _number(r0), _number(stiffness)


def _number(text: str) -> float:
    return float(gemmi.cif.as_number(text.strip() or "?", float("nan")))


def _pad_number(number: str) -> str:
    """Return residue number and insertion code, with a separate column for the code."""
    return number if number[-1:].isalpha() else f"{number} "


def _value(atoms: tuple[Address, ...], k: int, part: int) -> str:
    if k >= len(atoms):
        return "."
    chain, number, name = atoms[k]
    code = number[-1:] if number[-1:].isalpha() else ""
    value = (chain, number.removesuffix(code), code, name)[part]
    return str(gemmi.cif.quote(value)) if value else "?"
