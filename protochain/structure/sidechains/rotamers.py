"""Rotamers of side chains: the usual dihedrals of each residue, and the frequency of each combination.

The library of Shapovalov, Dunbrack, Structure 19:844 (2011), has steps of 10 degrees in phi and psi. See
README.md in data. Rotamers of less than 0.3 per cent, and the rarest 1.5 per cent, are removed.
"""

from functools import cache
from pathlib import Path

import numpy as np

from protochain.core.arrays import Floats, read_only

BACKBONE = (-60.0, 60.0)
"""Degrees: phi and psi at the ends of a chain, as in SCWRL4 (Krivov et al., Proteins 77:778, 2009)."""
_STEP, _BINS = 10.0, 36  # Degrees between values of phi, and of psi, from -180 on, and the number of values.
_FINENESS = 40.0  # Steps of the logarithm of a frequency in a unit.
_TURN = 256  # Steps of a dihedral in a turn.


def rotamers(residue: str, phi: float = BACKBONE[0], psi: float = BACKBONE[1]) -> tuple[Floats, Floats]:
    """Dihedrals (n, n_chi), rad, of an L-amino acid at phi, psi (degrees), and frequencies (n,) of sum 1."""
    return _rotamers_in_bin(residue, *(int(np.rint((angle + 180.0) / _STEP)) % _BINS for angle in (phi, psi)))


@cache
def _rotamers_in_bin(residue: str, i: int, j: int) -> tuple[Floats, Floats]:
    if residue not in _library():
        return read_only(np.zeros(0)), read_only(np.zeros(0))
    start, chi, rarity = _library()[residue]
    k = i * _BINS + j
    of_bin = slice(start[k], start[k + 1])
    frequency = np.exp(-rarity[of_bin] / _FINENESS)
    return read_only(chi[of_bin] * (2 * np.pi / _TURN)), read_only(frequency / frequency.sum())


@cache
def _library() -> dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Read the start of each bin, the dihedrals and the rarities of the rotamers of each residue."""
    with np.load(Path(__file__).parent / "data" / "rotamers.npz") as file:
        names = [key.removesuffix("_chi") for key in file if key.endswith("_chi")]
        return {
            name: (
                np.concatenate([[0], np.cumsum(file[f"{name}_count"], dtype=np.int64)]),
                file[f"{name}_chi"],
                file[f"{name}_rarity"],
            )
            for name in names
        }
