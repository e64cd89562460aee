"""Conversion from and to objects of other libraries: gemmi, OpenMM, mdtraj, MDAnalysis."""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from protochain.core.arrays import Floats, floats
from protochain.core.checks import plain
from protochain.core.errors import StructureError
from protochain.core.timings import part
from protochain.core.units import ANGSTROM_PER_NM
from protochain.structure.formats.files import check, number_atoms, places_in_file
from protochain.structure.formats.foreign import as_gemmi
from protochain.structure.molecule.model import Structure
from protochain.structure.preparation.prepare import READING, load, prepare, reading_of, run
from protochain.structure.preparation.structure_draft import Draft

if TYPE_CHECKING:
    import MDAnalysis
    import mdtraj


@part("preparing")
def as_structure(source: Any, name: str = "structure", **settings: Any) -> Structure:
    """Prepare a protein from a file or from an object of another library.

    Parameters
    ----------
    source : Structure, path-like, or an object of another library
        A gemmi Structure, an mdtraj Trajectory (first frame), an MDAnalysis Universe or AtomGroup (current
        frame), or a pair of an OpenMM Topology and its positions. A Structure is returned unchanged. A Chain
        or a result returns its structure, of several solutions or minima the lowest. Its energy and hinges
        are not included. To reuse them, pass on the result itself.
    name : str
        Short name for a source other than a file.
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

    Examples
    --------
    >>> pc.as_structure("structures/ala10.pdb").n_residues
    10
    """
    final = final_structure(source)
    if final is not None:
        return final
    if isinstance(source, str | Path):
        return load(source, **settings)
    parsed = as_gemmi(source)
    if len(parsed) and max(places_in_file(place.atom for place in parsed[0].all()), default=-1) < 0:
        number_atoms(parsed)
    parsed.merge_chain_parts()
    check(parsed, name)
    draft = Draft(name, name, reading=reading_of(**settings), file=parsed)
    return prepare(run(draft, READING))


def final_structure(source: Any) -> Structure | None:
    """Structure of a result: of several solutions or minima the lowest. None for other objects."""
    result = getattr(source, "best", source) if hasattr(source, "solutions") else source
    content = getattr(result, "structure", result)
    content = content() if inspect.ismethod(content) else content
    return content if isinstance(content, Structure) else None


def as_frames(source: Any) -> Any:
    """Return the frames of a result, of a structure or of several. Return any other source unchanged.

    A result without frames has its final structure as a single frame.
    """
    several = isinstance(source, list | tuple) and not hasattr(source, "structure")
    ends = [final_structure(part) for part in (source if several else [source])]
    if not ends or None in ends:
        return source
    if len({end.n_atoms for end in ends if end}) > 1:
        raise StructureError("frames: the structures have different atoms; give structures of the same atoms")
    stored = getattr(source, "frames", ())
    return stored if len(stored) else np.array([end.positions for end in ends if end])


def to_mdtraj(structure: Any, frames: Floats | None = None) -> mdtraj.Trajectory:
    """Convert a structure to an mdtraj trajectory.

    Parameters
    ----------
    structure : Structure, or anything that :func:`as_structure` accepts
        Structure with the topology.
    frames : (n, na, 3) float, nm, optional
        Positions of each frame, as ``Solution.frames``. By default one frame with the structure's positions.

    Returns
    -------
    mdtraj.Trajectory
        In nm and single precision.

    Examples
    --------
    >>> pc.to_mdtraj(pc.from_sequence("GAG")).n_residues
    3
    """
    import mdtraj

    structure = as_structure(structure)
    xyz = structure.positions[None] if frames is None else _frames(structure, frames)
    topology = mdtraj.Topology.from_openmm(structure.topology)
    return mdtraj.Trajectory(xyz.astype(np.float32), topology)


def _frames(structure: Structure, frames: Any) -> Floats:
    """Positions (n, na, 3) of frames, nm."""
    xyz = np.asarray(plain(as_frames(frames), "nanometer", "frames"))
    return floats(xyz, (max(1, xyz.size // (3 * structure.n_atoms)), structure.n_atoms, 3), "frames")


def to_mdanalysis(structure: Any, frames: Floats | None = None) -> MDAnalysis.Universe:
    """Convert a structure to an MDAnalysis Universe in memory.

    Parameters
    ----------
    structure : Structure, or anything that :func:`as_structure` accepts
        Structure to convert.
    frames : (n, na, 3) float, nm, optional
        Positions of each frame, as for :func:`to_mdtraj`.

    Returns
    -------
    MDAnalysis.Universe
        In angstrom.

    Examples
    --------
    >>> len(pc.to_mdanalysis(pc.from_sequence("GAG")).select_atoms("name CA"))
    3
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
    if frames is None:
        universe.atoms.positions = ANGSTROM_PER_NM * structure.positions
    else:
        universe.load_new(ANGSTROM_PER_NM * _frames(structure, frames), order="fac")
    return universe
