"""Conversion from and to objects of other libraries: gemmi, OpenMM, mdtraj, MDAnalysis."""

from __future__ import annotations

import inspect
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gemmi
import numpy as np
from openmm import app, unit

from protochain.core import defaults
from protochain.core.arrays import Floats, floats
from protochain.core.checks import acidity_or_auto, plain, shown
from protochain.core.errors import StructureError
from protochain.core.units import ANGSTROM_PER_NM
from protochain.structure.bound import Chemistry
from protochain.structure.draft import Draft, atom
from protochain.structure.files import check, number_atoms, place_in_file
from protochain.structure.model import Structure
from protochain.structure.pka import value_of
from protochain.structure.prepare import load, parts_of, prepare, user_files
from protochain.structure.read import Reading, read_structure

if TYPE_CHECKING:
    import MDAnalysis
    import mdtraj


def as_structure(source: Any, name: str = "structure", **settings: Any) -> Structure:
    """Prepare a protein from a file or from an object of another library.

    Parameters
    ----------
    source : Structure, path-like, or an object of another library
        A gemmi Structure, an mdtraj Trajectory (first frame), an MDAnalysis Universe or AtomGroup (current
        frame), or a pair of an OpenMM Topology and its positions. A Structure is returned unchanged; of a
        Chain or a result, that which it holds, of several minima the lowest. Energy and hinges do not come
        along: hand on the result itself where they should.
    name : str
        Short name for a source that is no file.
    **settings
        Options of :func:`protochain.load`.

    Returns
    -------
    Structure
        Complete, all-atom protein.

    Raises
    ------
    StructureError
        If the type of the source is unknown, or it cannot be used.
    """
    held = getattr(source, "structure", source)
    held = held() if inspect.ismethod(held) else held  # Of a search the first, lowest minimum.
    # A comparison has several ends beside the structure of its start, and no best.
    if isinstance(held, Structure) and (hasattr(source, "best") or not hasattr(source, "solutions")):
        return held
    if isinstance(source, str | Path):
        return load(source, **settings)
    made = _as_gemmi(source)
    if len(made) and not any(place_in_file(place.atom) >= 0 for place in made[0].all()):
        number_atoms(made)
    made.merge_chain_parts()
    check(made, name)
    parts, ph = settings.pop("forcefield", None), settings.pop("ph", defaults.PH)
    forcefield = user_files(parts)
    disulfide = settings.pop("disulfide", None)
    settings.setdefault("keep", defaults.KEEP)
    ph = acidity_or_auto(ph, "ph")
    given, charges = settings.pop("ligands", ()), settings.pop("ligand_charges", defaults.LIGAND_CHARGES)
    settings["chemistry"] = Chemistry.asked(given, charges, value_of(ph), parts_of(parts))
    draft = read_structure(made, Draft(name, name), Reading(**settings, forcefield=forcefield))
    return prepare(draft, disulfide, ph, forcefield)


def to_mdtraj(structure: Any, frames: Floats | None = None) -> mdtraj.Trajectory:
    """Convert a structure to an mdtraj trajectory.

    Parameters
    ----------
    structure : Structure, or anything that :func:`as_structure` takes
        Structure that gives the topology.
    frames : (n, na, 3) float, nm, optional
        Positions of each frame, as ``Solution.frames``; by default one frame, the structure's.

    Returns
    -------
    mdtraj.Trajectory
        In nm and single precision.
    """
    import mdtraj

    structure = as_structure(structure)
    xyz = structure.positions[None] if frames is None else np.asarray(plain(frames, "nanometer", "frames"))
    xyz = floats(xyz, (xyz.size // (3 * structure.n_atoms), structure.n_atoms, 3), "frames")
    topology = mdtraj.Topology.from_openmm(structure.topology)
    return mdtraj.Trajectory(xyz.astype(np.float32), topology)


def to_mdanalysis(structure: Any) -> MDAnalysis.Universe:
    """Convert a structure to an MDAnalysis Universe of one frame, in memory.

    Parameters
    ----------
    structure : Structure, or anything that :func:`as_structure` takes
        Structure to convert.

    Returns
    -------
    MDAnalysis.Universe
        In angstrom.
    """
    import MDAnalysis

    structure = as_structure(structure)
    chains, chain_of = np.unique(structure.residue_chain, return_inverse=True)
    universe = MDAnalysis.Universe.empty(
        structure.n_atoms, structure.n_residues, len(chains),
        atom_resindex=structure.atom_residue, residue_segindex=chain_of, trajectory=True,
    )  # fmt: skip
    for name, values in (
        ("names", structure.atom_name), ("elements", structure.atom_element), ("masses", structure.atom_mass),
        ("chainIDs", structure.residue_chain[structure.atom_residue]), ("resnames", structure.residue_name),
        ("resids", [int(number) for number in structure.residue_number]),
        ("icodes", structure.residue_insertion_code), ("segids", chains), ("tempfactors", structure.b_factor),
    ):  # fmt: skip
        universe.add_TopologyAttr(name, values)
    universe.add_TopologyAttr("bonds", structure.bonds.tolist())
    universe.atoms.positions = ANGSTROM_PER_NM * structure.positions
    return universe


def _as_gemmi(source: Any) -> gemmi.Structure:
    if isinstance(source, gemmi.Structure):
        return source.clone()
    if isinstance(source, tuple | list) and len(source) == 2 and isinstance(source[0], app.Topology):
        return _from_openmm(*source)
    # Recognised by attributes: a test of the type would have to import the library.
    if hasattr(source, "xyz") and hasattr(source, "topology"):
        return _from_openmm(source.topology.to_openmm(), np.asarray(source.xyz[0], dtype=float))
    if hasattr(source, "atoms") and hasattr(source.atoms, "residues"):
        return _from_mdanalysis(source.atoms)
    raise StructureError(
        f"{shown(source)}: give a file, a Structure, a gemmi Structure, an mdtraj Trajectory, an "
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
        made = gemmi.Chain(chain.id or " ")
        for residue in chain.residues():
            atoms = [
                atom(each.name, each.element.symbol if each.element else "X", x[each.index].tolist())
                for each in residue.atoms()
            ]
            made.add_residue(_residue(residue.name, str(residue.id), residue.insertionCode.strip(), atoms))
        model.add_chain(made)
    return _structure(model)


def _from_mdanalysis(group: Any) -> gemmi.Structure:
    model = gemmi.Model(1)
    has = {name: hasattr(group, name) for name in ("chainIDs", "icodes", "elements", "tempfactors")}
    chains: dict[str, gemmi.Chain] = {}
    for residue in group.residues:
        mine = group[group.resindices == residue.resindex]
        chain_id = str(mine[0].chainID if has["chainIDs"] and mine[0].chainID else residue.segid)
        atoms = [
            atom(
                str(each.name),
                str(each.element)
                if has["elements"] and each.element
                else str(each.name).lstrip("0123456789")[:1],
                [float(value) for value in each.position],
                float(each.tempfactor) if has["tempfactors"] else 0.0,
            )
            for each in mine
        ]
        code = str(residue.icode).strip() if has["icodes"] else ""
        made = chains.setdefault(chain_id, gemmi.Chain(chain_id or " "))
        made.add_residue(_residue(str(residue.resname), str(residue.resid), code, atoms))
    for made in chains.values():
        model.add_chain(made)
    return _structure(model)


def _residue(name: str, number: str, insertion_code: str, atoms: Iterable[gemmi.Atom]) -> gemmi.Residue:
    made = gemmi.Residue()
    made.name = name
    made.seqid = gemmi.SeqId(int(number), insertion_code or " ")
    for each in atoms:
        each.occ = 1.0
        made.add_atom(each)
    return made


def _structure(model: gemmi.Model) -> gemmi.Structure:
    made = gemmi.Structure()
    made.add_model(model)
    return made
