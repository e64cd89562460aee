"""Superposition, and root-mean-square deviation after it."""

from typing import Any

import numpy as np

from protochain.core.arrays import Floats, floats
from protochain.core.errors import ProtochainError
from protochain.core.units import ANGSTROM_PER_NM
from protochain.structure.convert import as_structure, final_structure
from protochain.structure.molecule.model import Structure


def superpose(x: Floats, reference: Floats) -> Floats:
    """Superpose x (n, 3) onto a reference with least RMSD (Kabsch, Acta Cryst. A32:922, 1976)."""
    turn, shift = motion(x, reference)
    return x @ turn.T + shift


def motion(x: Floats, reference: Floats) -> tuple[Floats, Floats]:
    """Rotation (3, 3) and translation (3,) that superpose points onto a reference, trivial without points."""
    if not len(x):
        return np.eye(3), np.zeros(3)
    centre, x_centre = reference.mean(axis=0), x.mean(axis=0)
    return motion_of((reference - centre).T @ (x - x_centre), x_centre, centre)


def motion_of(covariance: Floats, x_centre: Floats, centre: Floats) -> tuple[Floats, Floats]:
    """Rotation and translation, by Kabsch, from the sum (3, 3) of reference times points about centres."""
    # Not scipy's align_vectors, which warns that one or two points fix no rotation. Their RMSD is unique.
    u, _, vt = np.linalg.svd(covariance)
    flip = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    turn = np.asarray(u @ flip @ vt)
    return turn, centre - turn @ x_centre


def rmsd(x: Floats, reference: Floats) -> float:
    """Root-mean-square deviation after superposition, in the unit of the points: x, reference (n, 3)."""
    if not len(x):
        return np.nan
    return float(np.sqrt(np.mean(np.sum((superpose(x, reference) - reference) ** 2, axis=1))))


def deviation_angstrom(x: Floats, reference: Floats) -> float:
    """Root-mean-square deviation in angstrom of points (n, 3) in nm as they are, without superposition."""
    if not len(x):
        return np.nan
    return float(ANGSTROM_PER_NM * np.sqrt(np.mean(np.sum((x - reference) ** 2, axis=1))))


def rmsd_angstrom(x: Floats, reference: Floats) -> float:
    """RMSD in angstrom of points (n, 3) in nm after superposition."""
    return ANGSTROM_PER_NM * rmsd(x, reference)


def ca_rmsd(structure: Any, x: Any, reference: Any) -> float:
    """C-alpha RMSD between two sets of positions of a structure, after superposition.

    Parameters
    ----------
    structure : Structure, or anything that :func:`protochain.as_structure` accepts
        Structure whose C-alpha atoms are compared.
    x, reference : (na, 3) float, nm, or Structure
        Positions of all its atoms.

    Returns
    -------
    float, angstrom
        In double precision, by Kabsch's rotation (Acta Cryst. A32:922, 1976).

    Raises
    ------
    ProtochainError
        If positions are of other atoms.

    Examples
    --------
    >>> s = pc.from_sequence("GAG")
    >>> pc.ca_rmsd(s, s.positions, s.positions + 1.0) < 1e-6
    True
    """
    structure = as_structure(structure)
    alpha = structure.alpha_carbons
    first, second = (_positions(structure, p, name) for p, name in ((x, "x"), (reference, "reference")))
    return rmsd_angstrom(first[alpha], second[alpha])


def displacements(structure: Structure, x: Floats, reference: Floats) -> Floats:
    """Displacement (nca,) of each C-alpha in angstrom between positions (na, 3) in nm, superposed on all."""
    alpha = structure.alpha_carbons
    away = superpose(x[alpha], reference[alpha]) - reference[alpha]
    return np.asarray(ANGSTROM_PER_NM * np.linalg.norm(away, axis=1))


def _positions(structure: Structure, x: Any, name: str) -> Floats:
    """Positions of all atoms of a structure. Positions of another molecule are refused."""
    source = final_structure(x)
    if source is not None:
        if source.fingerprint != structure.fingerprint:
            raise ProtochainError(
                f"{name}: {source.name} has other atoms than {structure.name}; pc.rmsd matches their residues"
            )
        return source.positions
    return floats(x, (structure.n_atoms, 3), name, "nanometer")
