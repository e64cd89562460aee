"""Conversion of objects of other libraries, and of files that only these read, to gemmi structures."""

import io
import warnings
from collections.abc import Iterable, Sequence
from itertools import islice
from math import nan
from pathlib import Path
from typing import Any

import gemmi
import numpy as np
from openmm import app, unit

from protochain.core.checks import brief
from protochain.core.errors import StructureError
from protochain.core.optional_libraries import library
from protochain.core.storage import regular
from protochain.core.units import ANGSTROM_PER_NM
from protochain.structure.molecule.member import atom

_POSITIONS = {
    ".prmtop": (".inpcrd", ".rst7", ".crd"), ".parm7": (".inpcrd", ".rst7", ".crd"),
    ".psf": (".crd", ".cor", ".pdb", ".coor"),
}  # fmt: skip
"""Suffixes of coordinate files by the suffix of an Amber or CHARMM topology."""
_ALONE = {".gro": "GRO", ".pqr": "PQR", ".crd": "CRD", ".cor": "CRD"}
"""Files that contain topology and coordinates, and their format in MDAnalysis."""
_TOPOLOGY = {suffix: topology for topology in (".parm7", ".prmtop") for suffix in (".inpcrd", ".rst7")}
SUFFIXES = (*_POSITIONS, *_ALONE, *_TOPOLOGY)
"""Suffixes of the files that :func:`by_mdanalysis` reads."""

_LIGHTEST = 0.9  # amu. Lighter particles of a topology are lone pairs, Drude particles or virtual sites.
_NO_SEGMENT = "SYSTEM"  # Segment name that MDAnalysis uses for files without segments.


def by_mdanalysis(path: Path) -> gemmi.Structure:
    """Read a GRO, PQR, Amber or CHARMM file. Amber and CHARMM need topology and coordinates of one stem."""
    import MDAnalysis

    suffix = path.suffix.lower()
    if suffix in _TOPOLOGY:
        topology = _companion_file(path, (".prmtop", ".parm7"), "topology")
        files = [topology, path]
    elif suffix in _POSITIONS:
        files = [path, _companion_file(path, _POSITIONS[suffix], "coordinate")]
    else:
        # A .crd file with an Amber topology is Amber's. A CHARMM topology identifies Drude particles.
        topologies = [p for end in _POSITIONS if suffix == ".crd" and (p := path.with_suffix(end)).exists()]
        files = [*topologies[:1], path]
    formats = {"topology_format": _ALONE[suffix]} if len(files) == 1 else {}
    if len(files) == 2 and files[0].suffix != ".psf":
        formats = {"format": "INPCRD"}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            if files[0].suffix.lower() in (".prmtop", ".parm7") and _is_charmm_prmtop(files[0]):
                # MDAnalysis finds no charges in these files.
                prmtop, positions = app.AmberPrmtopFile(str(files[0])), app.AmberInpcrdFile(str(files[1]))
                return _from_openmm(prmtop.topology, positions.positions)
            atoms = MDAnalysis.Universe(*map(str, files), **formats).atoms
            return _from_mdanalysis(atoms, light=len(files) > 1)
    except Exception as error:  # MDAnalysis raises many types.
        reason = " ".join(str(error).split()) or type(error).__name__
        raise StructureError(f"{path}: cannot be read ({reason}); convert it to PDB or mmCIF") from None


def _is_charmm_prmtop(topology: Path) -> bool:
    """Return whether an Amber topology has CHARMM's force field, marked by a CTITLE flag."""
    with regular(topology).open(encoding="utf-8", errors="replace") as file:
        # The title is the first flag, after the version.
        return any(line.startswith("%FLAG CTITLE") for line in islice(file, 10))


def text_of_binary(data: bytes, source: str) -> str:
    """Return a BinaryCIF file as mmCIF text."""
    pdbx = library("biotite.structure.io.pdbx")
    document = gemmi.cif.Document()
    try:
        for name, block in pdbx.BinaryCIFFile.read(io.BytesIO(data)).items():
            output = document.add_new_block(name)
            for category, columns in block.items():
                values = {item: _values(column) for item, column in columns.items()}
                output.set_mmcif_category(f"_{category}.", values)
    except Exception as error:  # biotite raises many types.
        raise StructureError(f"{source}: not a whole BinaryCIF file ({error}); download it again") from None
    return str(document.as_string(gemmi.cif.WriteOptions(gemmi.cif.Style.Pdbx)))


def _values(column: Any) -> list[Any]:
    """Return a BinaryCIF column in gemmi's convention: strings, False for ``.`` and None for ``?``."""
    texts = column.data.array.astype(str).tolist()
    marks = [0] * len(texts) if column.mask is None else column.mask.array.tolist()
    return [(text, False, None)[mark] for text, mark in zip(texts, marks, strict=True)]


def _companion_file(path: Path, suffixes: Iterable[str], kind: str) -> Path:
    candidates = [path.with_suffix(suffix) for suffix in suffixes]
    companion = next((candidate for candidate in candidates if candidate.is_file()), None)
    if companion is None:
        names = ", ".join(candidate.name for candidate in candidates)
        raise StructureError(f"{path}: its {kind} file is missing; put one of {names} into the same folder")
    return companion


def as_gemmi(source: Any) -> gemmi.Structure:
    """Convert an object of another library that :func:`protochain.as_structure` accepts."""
    if isinstance(source, gemmi.Structure):
        return source.clone()
    if isinstance(source, tuple | list) and len(source) == 2 and isinstance(source[0], app.Topology):
        return _from_openmm(*source)
    # Recognise objects by attributes, because isinstance would import the library.
    if hasattr(source, "xyz") and hasattr(source, "topology"):
        return _from_openmm(source.topology.to_openmm(), np.asarray(source.xyz[0], dtype=float))
    if hasattr(source, "atoms") and hasattr(source.atoms, "residues"):
        return _from_mdanalysis(source.atoms)
    raise StructureError(
        f"{brief(source)}: give a file, a Structure, a gemmi Structure, an mdtraj Trajectory, an "
        "MDAnalysis Universe or AtomGroup, or an OpenMM Topology with its positions"
    )


def _from_openmm(topology: app.Topology, positions: Any) -> gemmi.Structure:
    if unit.is_quantity(positions):
        positions = positions.value_in_unit(unit.nanometer)
    x = ANGSTROM_PER_NM * np.asarray(positions, dtype=float).reshape(-1, 3)
    if len(x) != topology.getNumAtoms():
        raise StructureError(f"{len(x)} positions do not fit a topology of {topology.getNumAtoms()} atoms")
    model = gemmi.Model(1)
    for chain in topology.chains():
        copy = gemmi.Chain(chain.id or " ")
        for residue in chain.residues():
            atoms = [
                atom(a.name, a.element.symbol if a.element else "X", x[a.index].tolist())
                for a in residue.atoms()
            ]
            copy.add_residue(_residue(residue.name, str(residue.id), residue.insertionCode.strip(), atoms))
        model.add_chain(copy)
    vectors = topology.getPeriodicBoxVectors()
    if vectors is None:
        return _structure(model)
    lengths = app.internal.unitcell.computeLengthsAndAngles(vectors)
    return _structure(model, [*(ANGSTROM_PER_NM * np.array(lengths[:3])), *np.degrees(lengths[3:])])


def _from_mdanalysis(group: Any, light: bool = False) -> gemmi.Structure:
    """Convert atoms. With ``light``, particles lighter than hydrogen are marked as pseudo-atoms."""
    guess = library("MDAnalysis.guesser.default_guesser").DefaultGuesser(None).guess_atom_element
    model = gemmi.Model(1)
    has = {name: hasattr(group, name) for name in ("chainIDs", "icodes", "elements", "tempfactors")}
    chains: dict[str, gemmi.Chain] = {}
    for residue in group.residues:
        members = group[group.resindices == residue.resindex]
        chain_id = str(members[0].chainID if has["chainIDs"] and members[0].chainID else residue.segid)
        chain_id = "" if chain_id == _NO_SEGMENT else chain_id
        atoms = []
        for a in members:
            element = str((has["elements"] and a.element) or guess(str(a.name)))
            b_iso = float(a.tempfactor) if has["tempfactors"] else nan
            atoms.append(atom(str(a.name), element, a.position.tolist(), b_iso))
            if light and a.mass < _LIGHTEST:
                atoms[-1].element, atoms[-1].calc_flag = gemmi.Element("X"), gemmi.CalcFlag.Dummy
        code = str(residue.icode).strip() if has["icodes"] else ""
        chain = chains.setdefault(chain_id, gemmi.Chain(chain_id or " "))
        chain.add_residue(_residue(str(residue.resname), str(residue.resid), code, atoms))
    for chain in chains.values():
        model.add_chain(chain)
    return _structure(model, getattr(group, "dimensions", None))


def _residue(name: str, number: str, insertion_code: str, atoms: Iterable[gemmi.Atom]) -> gemmi.Residue:
    residue = gemmi.Residue()
    residue.name = name
    residue.seqid = gemmi.SeqId(int(number), insertion_code or " ")
    for a in atoms:
        a.occ = 1.0
        residue.add_atom(a)
    return residue


def _structure(model: gemmi.Model, cell: Sequence[float] | None = None) -> gemmi.Structure:
    """Return a structure with one model and the lengths (angstrom) and angles (degrees) of its box."""
    structure = gemmi.Structure()
    structure.add_model(model)
    if cell is not None and all(cell):
        structure.cell = gemmi.UnitCell(*map(float, cell))
    return structure
