"""Ligands of a structure as an SDF file, with orders and charges that its files may lack; files of poses."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from protochain.core.checks import MOLECULE_SUFFIXES, file_and_record, flag, several
from protochain.core.checks import path as as_path
from protochain.core.errors import Argument, StructureError
from protochain.core.extras import library
from protochain.core.storage import write_text
from protochain.ligands.molecule import to_rdkit
from protochain.ligands.sources import records, text_of
from protochain.structure.convert import as_structure
from protochain.structure.model import Structure


def save_ligands(
    structure: Any, path: str | Path, sources: Sequence[str | Path] = (), *, others: bool = False
) -> None:
    """Write the ligands of a structure to an SDF file, a record for each.

    Atoms are in the order of the molecule that was given, then come its hydrogens. Titles are name, chain and
    number of the residue, and of a pose the file and record it is from, as ``LIG B 1 poses.sdf#2``; the field
    ``source`` tells where orders and charges are from.

    Parameters
    ----------
    structure : Structure, Solution, Relaxation, or anything that :func:`protochain.as_structure` takes
        One with ``ligands``; of a result, its end.
    path : path-like
        Ends in ``.sdf``.
    sources : path-like, or sequence of such
        Files of poses, of which alone records are written; by default of all.
    others : bool
        Whether records of the other ligands follow those of ``sources``.

    Raises
    ------
    StructureError
        If the suffix is another, or the structure has no ligand whose chemistry is known.

    Examples
    --------
    >>> s = pc.load("structures/ala10.pdb", ligands=[("", "structures/1P2Y_NCT.sdf")])
    >>> pc.save_ligands(s, "ligand.sdf")
    """
    path = as_path(path, "path")
    check_ligand_file(path)
    wanted = [as_path(each, "sources") for each in several(sources, "sources")]
    text = ligand_text(as_structure(structure), wanted, flag(others, "others"))
    write_text(path, text)


def check_ligand_file(path: Path) -> None:
    """Refuse a name that tells another format."""
    if path.suffix.lower() != ".sdf":
        raise StructureError(f"{path}: ligands are written as SDF; give a name that ends in .sdf")


def check_ligands(structure: Structure) -> None:
    """Refuse a structure without ligands whose chemistry is known."""
    if not structure.ligands:
        raise StructureError(
            f"{structure.name}: has no ligand whose chemistry is known, so no SDF can be written; name its "
            "molecules with ", Argument("ligands"),
        )  # fmt: skip


def ligand_text(structure: Structure, sources: Sequence[str | Path] = (), others: bool = False) -> str:
    """Return the text that :func:`save_ligands` writes."""
    check_ligands(structure)
    chem, found, wanted = library("rdkit.Chem"), [], {str(Path(each)) for each in sources}
    chosen = [each for each in structure.ligands if each.ligand.molecule.source in wanted]
    if others or not wanted:
        chosen += [each for each in structure.ligands if each not in chosen]
    for each in chosen:
        molecule = each.ligand.molecule
        made = to_rdkit(molecule, structure.positions[each.atoms])
        its = structure.residue(int(structure.atom_residue[each.atoms[0]]))
        source = " ".join(molecule.source.split())
        pose = f" {Path(source).name}" if each.posed else ""
        made.SetProp("_Name", f"{its.name} {its.chain} {its.number}{pose}")
        found.append(f"{chem.MolToMolBlock(made)}>  <source>\n{source}\n\n$$$$\n")
    return "".join(found)


def poses(path: Path) -> list[str]:
    """Sources of the poses of a folder, or of the molecules of a file: the file itself if it has one."""
    if path.is_dir():
        files = sorted(each for each in path.iterdir() if each.suffix.lower() in MOLECULE_SUFFIXES)
        return [pose for file in files for pose in poses(file)]
    n = 1 if file_and_record(path)[1] else len(records(text_of(path), path.suffix.lower()))
    return [f"{path}#{k}" for k in range(1, n + 1)] if n > 1 else [str(path)]


def are_several(given: str) -> bool:
    """Whether a source is a folder of poses, or a file with several; one that cannot be read is none."""
    try:
        return Path(given).is_dir() or len(poses(Path(given))) > 1
    except StructureError:
        return False
