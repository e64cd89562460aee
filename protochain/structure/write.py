"""Writing of structures to PDB or mmCIF files, whole or not at all."""

from collections.abc import Iterable
from pathlib import Path

import gemmi
import numpy as np

from protochain.errors import StructureError
from protochain.storage import write_atomically
from protochain.structure.files import SUFFIXES
from protochain.structure.model import Structure
from protochain.units import ANGSTROM_PER_NM

_REMARK_WIDTH = 68
_PDB_LOWEST, _PDB_HIGHEST = -999.999, 9999.999
"""Angstrom: range of eight columns with three decimals."""


def save(structure: Structure, path: str | Path, remarks: Iterable[str] = ()) -> None:
    """Write a structure to a file, with the chain ids, numbers and insertion codes of its source.

    Parameters
    ----------
    structure : Structure
        Structure to write.
    path : path-like
        PDB for ``.pdb`` and ``.ent``, mmCIF for ``.cif`` and ``.mmcif``. No CRYST1 record is written, which
        would make some programs treat the chain as periodic.
    remarks : iterable of str
        Lines of provenance, written as REMARK 3 or in the category ``_protochain_provenance``.

    Raises
    ------
    StructureError
        If the suffix is unknown, or the structure does not fit the format.
    """
    path = Path(path)
    check_format(path)
    check_fits(structure, path)
    text = as_text(structure, path.suffix, remarks)
    write_atomically(path, lambda target: target.write_text(text, encoding="utf-8"))


def as_text(structure: Structure, suffix: str, remarks: Iterable[str] = (), *, hydrogens: bool = True) -> str:
    """Return the text that :func:`save` writes, in the format of the suffix."""
    out = _gemmi_structure(structure)
    if not hydrogens:
        out.remove_hydrogens()
    return _WRITERS[SUFFIXES[suffix.lower()]](out, remarks)


def check_format(path: Path) -> None:
    """Refuse an unknown suffix.

    Raises
    ------
    StructureError
        Naming the suffix.
    """
    if SUFFIXES.get(path.suffix.lower()) not in _WRITERS:
        raise StructureError(f"{path}: unknown suffix {path.suffix!r}; use {' or '.join(SUFFIXES)}")


def check_fits(structure: Structure, path: Path) -> None:
    """Refuse a structure that does not fit the columns of a PDB file.

    Raises
    ------
    StructureError
        Naming the chain or the atom.
    """
    if SUFFIXES[path.suffix.lower()] != "PDB":
        return
    long = [str(chain_id) for chain_id in structure.residue_chain if len(chain_id) > 1]
    if long:
        raise StructureError(f"{path}: chain id {long[0]!r} does not fit a PDB file; write .cif instead")
    x = ANGSTROM_PER_NM * structure.positions
    far = np.flatnonzero(((x < _PDB_LOWEST) | (x > _PDB_HIGHEST)).any(axis=1))
    if len(far):
        raise StructureError(
            f"{path}: the coordinates of {structure.describe(int(far[0]))} do not fit a PDB file; write .cif"
        )


def common_suffix(structures: Iterable[Structure]) -> str:
    """Return ``.pdb`` if all structures fit that format, else ``.cif``."""
    try:
        for structure in structures:
            check_fits(structure, Path("x.pdb"))
    except StructureError:
        return ".cif"
    return ".pdb"


def _gemmi_structure(structure: Structure) -> gemmi.Structure:
    out = gemmi.Structure()
    out.name = structure.name
    model = gemmi.Model(1)
    addresses = {}
    for chain in structure.topology.chains():
        gemmi_chain = gemmi.Chain(chain.id or " ")
        for residue in chain.residues():
            made = gemmi.Residue()
            made.name = residue.name
            made.seqid = gemmi.SeqId(int(residue.id), residue.insertionCode.strip() or " ")
            obstacle = structure.kept[next(residue.atoms()).index]
            made.het_flag = "H" if obstacle else "A"
            # Parts of a broken chain share its id; the subchain tells them apart.
            made.subchain = f"{chain.index}"
            made.entity_type = gemmi.EntityType.NonPolymer if obstacle else gemmi.EntityType.Polymer
            for atom in residue.atoms():
                new = gemmi.Atom()
                new.name, new.element = atom.name, gemmi.Element(atom.element.symbol)
                new.b_iso = float(structure.b_factor[atom.index])
                new.pos = gemmi.Position(*(ANGSTROM_PER_NM * structure.positions[atom.index]))
                made.add_atom(new)
                if atom.name in ("SG", "C", "N"):
                    addresses[atom.index] = gemmi.AtomAddress(
                        gemmi_chain.name, made.seqid, made.name, new.name
                    )
            gemmi_chain.add_residue(made)
        model.add_chain(gemmi_chain)
    out.add_model(model)
    for first, second in structure.bonds.tolist():
        apart = structure.atom_residue[second] - structure.atom_residue[first]
        names = {str(structure.atom_name[end]) for end in (first, second)}
        if names == {"SG"} or (names == {"C", "N"} and apart > 1):
            link = gemmi.Connection()
            disulfide = names == {"SG"}
            link.type = gemmi.ConnectionType.Disulf if disulfide else gemmi.ConnectionType.Covale
            link.name = f"{'disulf' if disulfide else 'covale'}{len(out.connections) + 1}"
            link.partner1, link.partner2 = addresses[first], addresses[second]
            out.connections.append(link)
    return out


def _mmcif(out: gemmi.Structure, remarks: Iterable[str]) -> str:
    out.setup_entities()
    out.assign_label_seq_id()
    document = out.make_mmcif_document()
    block = document.sole_block()
    loop = block.init_loop("_protochain_provenance.", ["ordinal", "text"])
    for i, line in enumerate(remarks, 1):
        loop.add_row([str(i), gemmi.cif.quote(line)])
    # As in the PDB archive, every category ends with '#', so that a truncated file can be recognised.
    return document.as_string(gemmi.cif.WriteOptions(gemmi.cif.Style.Pdbx))


def _pdb(out: gemmi.Structure, remarks: Iterable[str]) -> str:
    options = gemmi.PdbWriteOptions(
        minimal=True, ssbond_records=True, link_records=True, cryst1_record=False, end_record=True
    )
    lines = [
        f"REMARK   3 {text[i : i + _REMARK_WIDTH]}"
        for text in remarks
        for i in range(0, max(len(text), 1), _REMARK_WIDTH)
    ]
    return "".join(f"{line}\n" for line in lines) + out.make_pdb_string(options)


_WRITERS = {"PDB": _pdb, "mmCIF": _mmcif}
