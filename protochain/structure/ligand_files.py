"""Ligands of a structure as an SDF file, with the orders and charges that the structure's files may lack."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from protochain.core.checks import path as as_path
from protochain.core.errors import Argument, StructureError
from protochain.core.storage import write_text
from protochain.ligands.molecule import library, to_rdkit
from protochain.structure.convert import as_structure
from protochain.structure.model import Structure


def save_ligands(structure: Any, path: str | Path, sources: Sequence[str | Path] = ()) -> None:
    """Write the ligands of a structure to an SDF file, a record for each.

    Atoms are in the order of the molecule that was given, then come its hydrogens. Titles are name, chain and
    number of the residue; the field ``source`` tells where orders and charges are from.

    Parameters
    ----------
    structure : Structure, Solution, Relaxation, or anything that :func:`protochain.as_structure` takes
        One with ``ligands``; of a result, its end.
    path : path-like
        Ends in ``.sdf``.
    sources : sequence of str or path-like
        Files of poses, of which alone records are written; by default of all.

    Raises
    ------
    StructureError
        If the suffix is another, or the structure has no ligand whose chemistry is known.
    """
    path = as_path(path, "path")
    check_ligand_file(path)
    text = ligand_text(as_structure(structure), sources)
    write_text(path, text)


def check_ligand_file(path: Path) -> None:
    """Refuse a name that tells another format.

    Raises
    ------
    StructureError
        Naming the path.
    """
    if path.suffix.lower() != ".sdf":
        raise StructureError(f"{path}: ligands are written as SDF; give a name that ends in .sdf")


def check_ligands(structure: Structure) -> None:
    """Refuse a structure without ligands whose chemistry is known.

    Raises
    ------
    StructureError
        Naming it.
    """
    if not structure.ligands:
        raise StructureError(
            f"{structure.name}: has no ligand whose chemistry is known, so no SDF can be written; name its "
            "molecules with ", Argument("ligands"),
        )  # fmt: skip


def ligand_text(structure: Structure, sources: Sequence[str | Path] = ()) -> str:
    """Return the text that :func:`save_ligands` writes.

    Raises
    ------
    StructureError
        If there are none.
    """
    check_ligands(structure)
    chem, records, wanted = library("rdkit.Chem"), [], {str(Path(each)) for each in sources}
    for each in structure.ligands:
        molecule = each.ligand.molecule
        if wanted and molecule.source not in wanted:
            continue
        made = to_rdkit(molecule, structure.positions[each.atoms])
        its = structure.residue(int(structure.atom_residue[each.atoms[0]]))
        made.SetProp("_Name", f"{its.name} {its.chain} {its.number}")
        source = " ".join(molecule.source.split())
        records.append(f"{chem.MolToMolBlock(made)}>  <source>\n{source}\n\n$$$$\n")
    return "".join(records)
