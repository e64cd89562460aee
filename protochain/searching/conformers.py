"""Conformers of the backbone: Ramachandran regions of residues, and the share of helix."""

import numpy as np
from numpy.typing import NDArray

from protochain.chains.chain import Chain
from protochain.core.arrays import Floats
from protochain.searching.moves import NONE, Moves
from protochain.structure.build import PROLINE_PHI

REGIONS = "ABL"
"""Alpha (phi < 0, psi from -150 to 60 degrees), beta and polyproline II (other psi), left (phi >= 0)."""

_HELIX = (-100.0, -30.0), (-67.0, -7.0)
"""Degrees of phi and psi of a residue in a helix, if its neighbours are in it: three in a row (Best, Hummer,
J. Phys. Chem. B 113:9004, 2009)."""


def backbone(chain: Chain, q: Floats) -> tuple[Floats, Floats]:
    """Phi and psi, degrees, (..., r) of all residues except the termini, at torsions (..., n)."""
    residues = [res for res in Moves.of(chain).residues if res.psi != NONE]
    residues = [res for res in residues if not (res.is_first or res.is_last)]
    residues = [res for res in residues if res.phi != NONE or res.name == "PRO"]
    phi, psi = np.empty((2, *q.shape[:-1], len(residues)))
    for k, res in enumerate(residues):
        phi[..., k] = np.rad2deg(q[..., res.phi]) if res.phi != NONE else res.mirror * PROLINE_PHI
        psi[..., k] = np.rad2deg(q[..., res.psi])
    return phi, psi


def regions(phi: Floats, psi: Floats) -> NDArray[np.int64]:
    """Region of each residue, as an index of ``REGIONS``."""
    alpha = (psi > -150.0) & (psi <= 60.0)
    return np.where(phi >= 0.0, 2, np.where(alpha, 0, 1))


def names(phi: Floats, psi: Floats) -> NDArray[np.str_]:
    """Regions of all residues in a row, as ``BAAB``: phi and psi (..., r) -> (...)."""
    letters = np.array([*REGIONS])[regions(phi, psi)]
    *shape, r = letters.shape
    rows = letters.reshape(np.prod(shape, dtype=int), r)  # r is 0 for a dipeptide
    return np.array(["".join(row) for row in rows], dtype=object).reshape(shape)


def helix(phi: Floats, psi: Floats) -> Floats:
    """Share of the residues in a helix: phi and psi (..., r) -> (...). NaN of fewer than three residues."""
    (a, b), (c, d) = _HELIX
    helical = (phi >= a) & (phi <= b) & (psi >= c) & (psi <= d)
    if helical.shape[-1] < 3:
        return np.full(helical.shape[:-1], np.nan)
    three = helical[..., :-2] & helical[..., 1:-1] & helical[..., 2:]
    inside = np.zeros_like(helical)
    for k in range(3):
        inside[..., k : helical.shape[-1] - 2 + k] |= three
    return np.asarray(inside.mean(axis=-1))
