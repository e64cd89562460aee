"""Deviation of C-beta from its ideal place, which follows from the backbone."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from protochain.core.arrays import Floats, Integers
from protochain.core.units import ANGSTROM_PER_NM
from protochain.structure.molecule.model import Structure
from protochain.structure.sidechains.ideal import place_points, unit
from protochain.validation.layout import NONE, layout, positions

LIMIT = 0.25  # Angstrom from which a deviation is an outlier.

_IDEAL = {
    "ALA": (1.536, 110.1, 122.9, 110.6, -122.6),
    "PRO": (1.530, 112.2, 115.1, 103.0, -120.7),
    "VAL": (1.540, 109.1, 123.4, 111.5, -122.0),
    "": (1.530, 110.1, 122.8, 110.5, -122.6),
}
"""CA-CB in angstrom, and in degrees C-CA-CB with the dihedral N-C-CA-CB, N-CA-CB with C-N-CA-CB."""
_CLASS = {"ALA": "ALA", "PRO": "PRO", "VAL": "VAL", "THR": "VAL", "ILE": "VAL"}


class Deviations(NamedTuple):
    """C-beta deviations of the residues that have one."""

    residue: Integers  # (n,) int.
    deviation: Floats  # (n,) angstrom.

    @property
    def outliers(self) -> NDArray[np.int64]:
        """Residues whose deviation is 0.25 angstrom or more."""
        return self.residue[self.deviation >= LIMIT]


def cbeta_deviations(structure: Structure, x: Floats | None = None) -> Deviations:
    """Measure the distance of each C-beta from its ideal place, at x (na, 3) or its own. D are mirrored."""
    # Lovell et al., Proteins 50:437 (2003); ideal values as in mmtbx's cbetadev: the mean of two places,
    # built with ideal bond, angle and dihedral from either side of the backbone.
    amino = layout(structure)
    atoms = amino.atoms("N", "CA", "C", "CB")
    # A planar C-alpha, as of dehydroamino acids, has another place for it.
    tetrahedral = np.bincount(structure.bonds.ravel(), minlength=structure.n_atoms)[atoms[:, 1]] > 3
    complete = (atoms != NONE).all(axis=1) & tetrahedral
    residue = np.flatnonzero(complete & (structure.residue_name != "GLY"))
    n, alpha, c, beta = ANGSTROM_PER_NM * positions(structure, x)[atoms[residue].T]
    ideal = [_IDEAL[_CLASS.get(name, "")] for name in structure.residue_name[residue].tolist()]
    length, from_c, round_c, from_n, round_n = np.array(ideal).reshape(-1, 5).T
    sign = np.where(structure.mirrored[residue], -1.0, 1.0)
    middle = 0.5 * (
        place_points(n, c, alpha, length, np.radians(from_c), np.radians(sign * round_c))
        + place_points(c, n, alpha, length, np.radians(from_n), np.radians(sign * round_n))
    )
    arm = middle - alpha
    arm[~arm.any(axis=1), 0] = 1.0  # Atoms at one point have no direction.
    arm = length[:, None] * unit(arm)
    return Deviations(residue, np.linalg.norm(beta - alpha - arm, axis=1))
