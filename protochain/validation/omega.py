"""Peptide bonds that are not trans."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from protochain.core.arrays import Floats, Integers
from protochain.structure.molecule.model import Structure
from protochain.validation.layout import peptides, positions

PLANAR = 30.0  # Degrees from planarity beyond which a peptide bond is twisted, as in mmtbx's omegalyze.
PERPENDICULAR = 90.0  # Degrees: between cis and trans.


class Peptides(NamedTuple):
    """Peptide bonds, each named after the residue of its nitrogen."""

    residue: Integers  # (n,) int.
    omega: Floats  # (n,) degrees.
    proline: NDArray[np.bool_]  # (n,) bool: Whether that residue is a proline.
    cis: NDArray[np.bool_]  # (n,) bool: Within 30 degrees of 0, and farther than that from both 0 and 180.
    twisted: NDArray[np.bool_]


def omegas(structure: Structure, x: Floats | None = None) -> Peptides:
    """Measure omegas, at x (na, 3) or its own (Williams et al., Protein Sci. 27:293, 2018)."""
    omega = peptides(structure, positions(structure, x))[2]
    residue = np.flatnonzero(np.isfinite(omega))
    omega = omega[residue]
    size = np.abs(omega)
    cis, proline = size < PLANAR, structure.residue_name[residue] == "PRO"
    return Peptides(residue, omega, proline, cis, ~cis & (size <= 180.0 - PLANAR))


def isomerised_bonds(structure: Structure, x: Floats, reference: Floats) -> list[str]:
    """Name the peptide bonds that changed: ``before A:LYS14 (omega 178, now 4)``."""
    now, then = omegas(structure, x), omegas(structure, reference)
    size = np.abs(now.omega)
    crossed = np.where(then.cis, size > PERPENDICULAR, size < PERPENDICULAR)
    return describe_bonds(structure, x, reference, now.residue[crossed & ~then.twisted])


def twisted_bonds(structure: Structure, x: Floats, reference: Floats) -> list[str]:
    """Name the peptide bonds that became twisted, as :func:`isomerised_bonds` does."""
    now, then = omegas(structure, x), omegas(structure, reference)
    return describe_bonds(structure, x, reference, now.residue[now.twisted & ~then.twisted])


def describe_bonds(structure: Structure, x: Floats, reference: Floats, residues: Integers) -> list[str]:
    """Name the peptide bonds before residues, with their dihedrals then and now."""
    now, then = omegas(structure, x), omegas(structure, reference)
    return [
        f"before {structure.describe_residue(int(now.residue[k]))} "
        f"(omega {then.omega[k]:.0f}, now {now.omega[k]:.0f})"
        for k in np.flatnonzero(np.isin(now.residue, residues))
    ]
