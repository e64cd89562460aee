"""Quality of a structure: size, secondary structure, outliers, overlaps, hydrogen bonds, geometry."""

from functools import cache
from typing import Any

import mdtraj
import numpy as np
from numpy.typing import NDArray

from protochain.arrays import Floats, Integers
from protochain.chain import Chain
from protochain.checks import checked, instance
from protochain.contacts import overlaps
from protochain.minimisers import Solution
from protochain.structure import Structure, as_structure, ca_rmsd
from protochain.structure.matching import tm_score
from protochain.units import ANGSTROM_PER_NM

_RARE = 1.0
"""Count in MDAnalysis' reference below which phi and psi are an outlier: the limit of "marginally allowed" in
its Ramachandran plot (after Lovell et al., Proteins 50:437, 2003)."""
_CELL = 4.0
"""Degrees, grid spacing of that reference."""


@checked(chain=instance(Chain, "pc.build_chain(structure)"))
def quality(structure: Any, start: Any = None, chain: Chain | None = None) -> dict[str, Any]:
    """Measure the quality of a structure, alone and against a start.

    Parameters
    ----------
    structure : Structure, Solution, path, or anything that :func:`protochain.as_structure` takes
        Structure to measure. A solution is measured against its own start.
    start : the same, with the same atoms, optional
        Structure that it came from; without one, the measures of change are left out.
    chain : Chain, optional
        Chain of the start, which tells what could part the overlaps.

    Returns
    -------
    dict of str to float
        ``radius_of_gyration_angstrom``; ``ramachandran_outliers``, residues whose phi and psi MDAnalysis'
        reference calls rarer than marginally allowed; ``overlaps`` of nonbonded atoms; ``hydrogen_bonds``
        (Baker, Hubbard, 1984). With a start also ``ca_rmsd_to_start_angstrom``, ``tm_score_to_start``,
        ``secondary_structure_kept`` (fraction of residues, by DSSP), ``bond_length_change_rms_angstrom`` and
        ``bond_angle_change_rms_degrees``.

    Raises
    ------
    ProtochainError
        If the start has other atoms.
    """
    if start is None and isinstance(structure, Solution):
        start, chain = structure.chain, chain or structure.chain
    structure = as_structure(structure)
    if start is None:
        return _alone(structure, chain)
    start = as_structure(start)
    off = ca_rmsd(structure, structure.positions, start)
    lengths = _bond_lengths(structure) - _bond_lengths(start)
    angles = _bond_angles(structure) - _bond_angles(start)
    score = tm_score(start, structure)
    alone = _alone(structure, chain)
    return {
        "radius_of_gyration_angstrom": alone.pop("radius_of_gyration_angstrom"),
        "ca_rmsd_to_start_angstrom": off,
        "tm_score_to_start": score if np.isfinite(score) else None,
        "secondary_structure_kept": float(np.mean(dssp(structure) == dssp(start))),
        **alone,
        "bond_length_change_rms_angstrom": ANGSTROM_PER_NM * _root_mean_square(lengths),
        "bond_angle_change_rms_degrees": float(np.degrees(_root_mean_square(angles))),
    }


def _alone(structure: Structure, chain: Chain | None) -> dict[str, Any]:
    """Measures that need no start."""
    return {
        "radius_of_gyration_angstrom": radius_of_gyration(structure),
        "ramachandran_outliers": int(ramachandran_outliers(structure).sum()),
        "overlaps": len(overlaps(structure, structure.positions, chain)),
        "hydrogen_bonds": hydrogen_bonds(structure),
    }


def radius_of_gyration(structure: Structure) -> float:
    """Mass-weighted radius of gyration of all atoms in angstrom (mdtraj centres without masses)."""
    share = structure.atom_mass / structure.atom_mass.sum()
    arms = structure.positions - share @ structure.positions
    return float(ANGSTROM_PER_NM * np.sqrt(share @ np.sum(arms**2, axis=1)))


def dssp(structure: Structure) -> NDArray[np.str_]:
    """Secondary structure (nr,), H, E, C, or NA outside proteins: mdtraj's DSSP (Kabsch, Sander 1983)."""
    return np.asarray(mdtraj.compute_dssp(_trajectory(structure), simplified=True)[0])


def hydrogen_bonds(structure: Structure) -> int:
    """Number of hydrogen bonds by mdtraj's Baker-Hubbard criterion (120 degrees, 2.5 angstrom)."""
    return len(mdtraj.baker_hubbard(_trajectory(structure), freq=0.0, periodic=False))


def ramachandran(structure: Structure) -> tuple[Integers, Floats]:
    """Residues with both phi and psi, and these angles in degrees.

    Returns
    -------
    (n,) int, (n, 2) float
    """
    trajectory = _trajectory(structure)
    angles: dict[int, dict[str, float]] = {}
    residue = structure.atom_residue
    for name, compute, own in (("phi", mdtraj.compute_phi, 1), ("psi", mdtraj.compute_psi, 0)):
        atoms, values = compute(trajectory, periodic=False)
        for quadruple, value in zip(atoms, values[0], strict=True):
            angles.setdefault(int(residue[quadruple[own]]), {})[name] = float(np.degrees(value))
    both = sorted(r for r, its in angles.items() if len(its) == 2)
    return np.array(both, dtype=np.int64), np.array(
        [(angles[r]["phi"], angles[r]["psi"]) for r in both]
    ).reshape(-1, 2)


def ramachandran_outliers(structure: Structure) -> NDArray[np.bool_]:
    """Whether each pair (n,) of phi and psi is a Ramachandran outlier; glycine never is."""
    residues, angles = ramachandran(structure)
    if not len(residues):
        return np.zeros(0, dtype=bool)
    cell = np.floor((angles + 180.0) / _CELL).astype(int) % len(ramachandran_reference())
    rare = ramachandran_reference()[cell[:, 1], cell[:, 0]] < _RARE
    return np.asarray(rare & (structure.residue_name[residues] != "GLY"))


@cache
def ramachandran_reference() -> Floats:
    """Counts (90, 90) at psi (rows) and phi (columns) from -180 degrees in steps of 4."""
    from MDAnalysis.analysis.data.filenames import Rama_ref

    return np.asarray(np.load(Rama_ref), dtype=float)


def _trajectory(structure: Structure) -> Any:
    topology = mdtraj.Topology.from_openmm(structure.topology)
    return mdtraj.Trajectory(structure.positions[None].astype(np.float32), topology)


def _bond_lengths(structure: Structure) -> Floats:
    first, second = structure.bonds.T
    return np.linalg.norm(structure.positions[first] - structure.positions[second], axis=1)


def _bond_angles(structure: Structure) -> Floats:
    triples = _triples(structure)
    x = structure.positions
    u, v = x[triples[:, 0]] - x[triples[:, 1]], x[triples[:, 2]] - x[triples[:, 1]]
    return np.arctan2(np.linalg.norm(np.cross(u, v), axis=1), np.sum(u * v, axis=1))


def _triples(structure: Structure) -> Integers:
    """Atoms (n, 3) of every bond angle, its vertex in the middle."""
    neighbours: list[list[int]] = [[] for _ in range(structure.n_atoms)]
    for first, second in structure.bonds.tolist():
        neighbours[first].append(second)
        neighbours[second].append(first)
    found = [
        (a, b, c)
        for b, around in enumerate(neighbours)
        for i, a in enumerate(around)
        for c in around[i + 1 :]
    ]
    return np.array(found, dtype=np.int64).reshape(-1, 3)


def _root_mean_square(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))
