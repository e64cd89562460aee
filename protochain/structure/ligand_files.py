"""Write ligands to SDF files, with bond orders and charges, and read files of poses."""

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from protochain.core.arrays import Floats, Integers
from protochain.core.checks import MOLECULE_SUFFIXES, file_and_record, flag, several
from protochain.core.checks import path as as_path
from protochain.core.errors import Argument, StructureError
from protochain.core.graph import components, neighbours
from protochain.core.optional_libraries import library
from protochain.core.storage import write_text
from protochain.ligands.matching import copy_names
from protochain.ligands.molecule import Molecule, to_rdkit
from protochain.ligands.sources import as_filed, records, text_of, title_of
from protochain.structure.convert import as_structure
from protochain.structure.molecule.model import Structure

_PREFIX = "protochain_"


def save_ligands(
    structure: Any, path: str | Path, sources: Sequence[str | Path] = (), *, others: bool = False
) -> None:
    """Write the ligands of a structure to an SDF file, a record for each.

    Title, fields and the order of atoms are from the input file. Hydrogens added for the pH come last. The
    default title is name, chain and number of the residue, and for a pose its file and record, as ``LIG B 1
    poses.sdf#2``. The field ``source`` is the source of orders and charges, and ``protochain_residue`` the
    residue. For a ligand bonded to the protein, ``protochain_bonds`` lists the bonds. Their valences are open
    in the record, and leaving atoms are absent. A result adds ``protochain_energy_kj_mol`` of the structure,
    ``protochain_status``, ``protochain_rmsd_angstrom`` of the ligand, and ``protochain_strain_kj_mol`` if
    the ligand is not bonded.

    Parameters
    ----------
    structure : Structure, Solution, Relaxation, or anything that :func:`protochain.as_structure` accepts
        A structure with ``ligands``, or a result, whose end is written.
    path : path-like
        Ends in ``.sdf``.
    sources : path-like, or sequence of such
        Files of poses whose records are written. By default all ligands are written.
    others : bool
        Whether records of the other ligands follow the records of ``sources``.

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
    chosen = [as_path(p, "sources") for p in several(sources, "sources")]
    measured = getattr(structure, "ligand_properties", ())
    text = ligand_text(as_structure(structure), chosen, flag(others, "others"), measured)
    write_text(path, text)


def check_ligand_file(path: Path) -> None:
    """Refuse a name with the suffix of another format."""
    if path.suffix.lower() != ".sdf":
        raise StructureError(f"{path}: ligands are written as SDF; give a name that ends in .sdf")


def check_ligands(structure: Structure) -> None:
    """Refuse a structure without ligands whose chemistry is known."""
    if not structure.ligands and not bonded_ligands(structure):
        raise StructureError(
            f"{structure.name}: has no ligand whose chemistry is known, so no SDF can be written; name its "
            "molecules with ", Argument("ligands"),
        )  # fmt: skip


def ligand_text(
    structure: Structure,
    sources: Sequence[str | Path] = (),
    include_others: bool = False,
    measured: Sequence[Mapping[str, str]] = (),
) -> str:
    """Return the text that :func:`save_ligands` writes. ``measured`` has fields of each ligand."""
    check_ligands(structure)
    chem, blocks, chosen = library("rdkit.Chem"), [], {str(Path(p)) for p in sources}
    ligands = [(ligand.ligand.molecule, ligand.atoms, ligand.posed) for ligand in structure.ligands]
    ligands += [(molecule, atoms, False) for molecule, atoms in bonded_ligands(structure)]
    order = sorted(range(len(ligands)), key=lambda k: ligands[k][0].source not in chosen)
    for k in order if include_others or not chosen else (k for k in order if ligands[k][0].source in chosen):
        molecule, atoms, posed = ligands[k]
        x = structure.positions[atoms]
        mol, filed = to_rdkit(molecule, x), as_filed(molecule.source)
        if filed:
            mol = chem.RenumberAtoms(mol, _order(molecule, filed[0], x))
        residues = map(structure.residue, dict.fromkeys(structure.atom_residue[atoms].tolist()))
        residue = " and ".join(f"{res.name} {res.chain} {res.number}" for res in residues)
        source = " ".join(molecule.source.split())
        pose = f" {Path(source).name}" if posed else ""
        fields = {"source": source, "protochain_residue": residue}
        if bonds := _bonds_outward(structure, atoms):
            fields["protochain_bonds"] = ", ".join(bonds)
        fields |= dict(measured[k]) if measured else {}
        mol.SetProp("_Name", (filed and filed[1]) or f"{residue}{pose}")
        blocks.append(chem.MolToMolBlock(mol) + _fields(filed[2] if filed else "", fields) + "$$$$\n")
    return "".join(blocks)


def bonded_ligands(structure: Structure) -> list[tuple[Molecule, Integers]]:
    """Return the hetero molecules bonded to other molecules, with their atoms in the structure.

    Bond orders and charges are of the bonded state. Valences of the bonds to other molecules are open.
    Nucleotides of strands are not among the molecules.
    """
    ligands = []
    for fragment in structure.fragments:
        molecule, residue = fragment.ligand.molecule, structure.atom_residue[fragment.atoms]
        of_field = residue[[bool(core) for core in fragment.core]]
        is_hetero = (fragment.atoms >= 0) & structure.kept[fragment.atoms] & ~np.isin(residue, of_field)
        piece = components(molecule.bonds[is_hetero[molecule.bonds].all(axis=1)], molecule.n_atoms)
        for number in np.unique(piece[is_hetero]).tolist():
            atoms = np.flatnonzero(is_hetero & (piece == number))
            ligands.append((_part(molecule, atoms), fragment.atoms[atoms]))
    return ligands


def _part(molecule: Molecule, atoms: Integers) -> Molecule:
    """Some atoms of a molecule, without stereochemistry, which follows from the positions."""
    place = np.full(molecule.n_atoms, -1)
    place[atoms] = np.arange(len(atoms))
    inside = (place[molecule.bonds] >= 0).all(axis=1)
    return Molecule(
        tuple(molecule.names[i].partition(":")[2] for i in atoms),
        molecule.elements[atoms], molecule.formal_charges[atoms],
        place[molecule.bonds[inside]], molecule.orders[inside],
        np.zeros(len(atoms), dtype=np.int64), np.empty((0, 5), dtype=np.int64), (), None, molecule.source,
    )  # fmt: skip


def _bonds_outward(structure: Structure, atoms: Integers) -> list[str]:
    """Bonds of a molecule to other molecules, without springs of metals."""
    is_end = np.isin(structure.bonds, atoms)
    rows = structure.bonds[(is_end[:, 0] != is_end[:, 1]) & ~structure.coordination]
    return [f"{structure.atom(j)} and {structure.atom_name[i]}" for i, j in (
        pair if pair[0] in atoms else pair[::-1] for pair in rows.tolist()
    )]  # fmt: skip


def _order(molecule: Molecule, filed: Molecule, x: Floats) -> list[int]:
    """Atoms of a molecule at x (na, 3) nm in the order of the file, with additional atoms last."""
    heavy = molecule.heavy
    names = tuple(molecule.names[i] for i in heavy)
    if _heavy_graph(molecule) != _heavy_graph(filed):
        # The names are from a model, so coordinates identify the atoms.
        try:
            filed = copy_names(filed, molecule.elements[heavy], names, x[heavy])
        except StructureError:
            return list(range(molecule.n_atoms))
    order: list[int] = []
    bonded, filed_bonded = (neighbours(m.bonds, m.n_atoms) for m in (molecule, filed))
    for k, name in enumerate(filed.names):
        if filed.elements[k] != 1:
            at = [molecule.names.index(name)]
        else:
            (parent,) = filed_bonded[k]
            at = [j for j in bonded[molecule.names.index(filed.names[parent])] if molecule.elements[j] == 1]
            # The hydrogen of this name, or else the next one with an unused name.
            siblings = {filed.names[i] for i in filed_bonded[parent]}
            at = [j for j in at if molecule.names[j] == name] or [
                j for j in at if j not in order and molecule.names[j] not in siblings
            ]
        order += [j for j in at[:1] if j not in order]
    return order + [j for j in range(molecule.n_atoms) if j not in order]


def _heavy_graph(molecule: Molecule) -> tuple[dict[str, int], set[frozenset[str]]]:
    """Elements of the heavy atoms of a molecule and bonds between them, by name."""
    heavy = {molecule.names[i]: int(molecule.elements[i]) for i in molecule.heavy.tolist()}
    pairs = (frozenset(molecule.names[k] for k in pair) for pair in molecule.bonds.tolist())
    return heavy, {pair for pair in pairs if pair <= heavy.keys()}


def _fields(filed: str, added: Mapping[str, object]) -> str:
    """Fields of a record: the fields of the file without earlier results, then the added fields."""
    blocks = [block for block in re.split(r"\n(?=>)", filed) if block.strip()]
    names = [re.search(r"<([^<>]*)>", block.split("\n")[0]) for block in blocks]
    stated = {name[1] for name in names if name}
    remain = [b for b, name in zip(blocks, names, strict=True) if not (name and name[1].startswith(_PREFIX))]
    new = {name: value for name, value in added.items() if name.startswith(_PREFIX) or name not in stated}
    texts = [f"{block.rstrip()}\n\n" for block in remain]
    return "".join(texts + [f">  <{name}>\n{value}\n\n" for name, value in new.items()])


def poses(path: Path) -> list[str]:
    """Sources of the poses of a folder or file. A file with one molecule is its own source."""
    if path.is_dir():
        files = sorted(child for child in path.iterdir() if child.suffix.lower() in MOLECULE_SUFFIXES)
        return [pose for file in files for pose in poses(file)]
    n = 1 if file_and_record(path)[1] else len(records(text_of(path), path.suffix.lower()))
    return [f"{path}#{k}" for k in range(1, n + 1)] if n > 1 else [str(path)]


def title_of_last(sources: Sequence[str]) -> str:
    """Title of the last of some poses, empty without poses or if its file cannot be read."""
    with suppress(StructureError):
        return title_of(sources[-1]) if sources else ""
    return ""


def has_poses(source: str) -> bool:
    """Whether a source is a folder of poses or a readable file with several poses."""
    try:
        return Path(source).is_dir() or len(poses(Path(source))) > 1
    except StructureError:
        return False
