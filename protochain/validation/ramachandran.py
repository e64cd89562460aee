"""Ramachandran plot: favoured, allowed and outlier regions of six classes of residues."""

from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from protochain.core.arrays import Floats, Integers, read_only
from protochain.structure.molecule.model import Structure
from protochain.structure.molecule.residues import STANDARD
from protochain.validation.layout import NONE, layout, peptides, positions

CLASSES = ("general", "glycine", "cis_proline", "trans_proline", "pre_proline", "ile_val")
"""Classes of residues, as their tables are called."""
REGIONS = ("outlier", "allowed", "favoured")
FAVOURED = 0.02
ALLOWED = np.array([0.0005, 0.001, 0.002, 0.001, 0.001, 0.001])
"""Least score of a favoured and, by class, of an allowed residue, as in mmtbx's ramalyze."""
_CIS = 90.0
"""Degrees of omega below which a proline counts as cis here, as in ramalyze, without a third class."""
_CELL = 2.0  # Degrees between the points of the tables, which lie at odd degrees.
_TABLES = Path(__file__).parent / "data" / "ramachandran.npz"


class Ramachandran(NamedTuple):
    """Residues with both phi and psi on the Ramachandran plot."""

    residue: Integers  # (n,) int.
    phi: Floats  # (n,) degrees.
    psi: Floats  # (n,) degrees.
    kind: Integers  # (n,) int: Index of the class in ``CLASSES``.
    score: Floats  # (n,): Share of the residues of its class that are rarer, from 0 to 1.
    region: Integers  # (n,) int: 0 outlier, 1 allowed, 2 favoured.

    @property
    def outliers(self) -> Integers:
        """Residues that are outliers."""
        return self.residue[self.region == 0]

    @property
    def favoured_percent(self) -> float:
        """Percentage of residues in favoured regions, NaN without residues."""
        return 100.0 * float(np.mean(self.region == 2)) if len(self.region) else float("nan")


def ramachandran(structure: Structure, x: Floats | None = None) -> Ramachandran:
    """Place residues on the Ramachandran plot, as MolProbity (tables Top8000), at x (na, 3) or their own."""
    phi, psi, omega = peptides(structure, positions(structure, x))
    standard = np.isin(structure.residue_name, list(STANDARD))
    residue = np.flatnonzero(standard & np.isfinite(phi) & np.isfinite(psi))
    kind = residue_classes(structure, omega)[residue]
    phi, psi = phi[residue], psi[residue]
    mirror = np.where(structure.mirrored[residue], -1.0, 1.0)
    values = score(kind, mirror * phi, mirror * psi)
    region = (values >= ALLOWED[kind]).astype(np.int64) + (values >= FAVOURED)
    return Ramachandran(residue, phi, psi, kind, values, region)


def score(kind: Integers, phi: Floats, psi: Floats) -> Floats:
    """Interpolate the tables of kind (n,) between the four points nearest to phi, psi (n,), degrees."""
    # As map_coordinates of scipy.ndimage, which is a slow import.
    table = tables()
    n = table.shape[1]
    places = np.array([phi + 179.0, psi + 179.0]) / _CELL % n
    below = np.floor(places)
    first, index = 1.0 - (places - below), below.astype(np.int64)
    weights, total = (first, 1.0 - first), np.zeros(len(kind))
    for i, j in ((0, 0), (0, 1), (1, 0), (1, 1)):
        points = table[kind, (index[0] + i) % n, (index[1] + j) % n]
        total += points * weights[i][0] * weights[j][1]
    return total


@cache
def tables() -> Floats:
    """(6, 180, 180) float: score by class, phi and psi, at -179, -177, ... degrees."""
    with np.load(_TABLES) as stored:
        return read_only([stored[name] for name in CLASSES])


def residue_classes(structure: Structure, omega: Floats | float = 180.0) -> NDArray[np.int64]:
    """Class of each residue (nr,): glycine and proline (omega in degrees), then residues before a proline."""
    name, after = structure.residue_name, layout(structure).after
    before_proline = (after != NONE) & (name[after] == "PRO")
    cis = np.abs(omega) < _CIS
    proline = name == "PRO"
    return np.select(
        [name == "GLY", proline & cis, proline, before_proline, np.isin(name, ("ILE", "VAL"))],
        [1, 2, 3, 4, 5],
        0,
    )
