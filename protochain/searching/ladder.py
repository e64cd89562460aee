"""Temperature ladders of replica exchange."""

import numpy as np
from scipy.special import erfcinv

from protochain.core.arrays import Floats

_RAREST, _MOST_FREQUENT = 1e-3, 0.999
"""Limits of acceptances. Values closer to 0 or 1 would need more trials than a pilot has."""


def geometric(low: float, high: float, n: int) -> Floats:
    """Temperatures (n,) with constant ratios, K, which is optimal for a constant heat capacity."""
    return np.geomspace(low, high, n)


def length_of_acceptance(acceptance: Floats) -> Floats:
    """Thermodynamic length between temperatures with this acceptance of exchanges."""
    # For energies with normal distributions of one width s it is L = s |1/kT - 1/kT'|, and the mean
    # acceptance is erfc(L/2) (Predescu, Predescu, Ciobanu, J. Chem. Phys. 120:4119, 2004).
    return np.asarray(2.0 * erfcinv(np.clip(acceptance, _RAREST, _MOST_FREQUENT)))


def equally_spaced(temperatures: Floats, lengths: Floats) -> Floats:
    """Replace inner temperatures so that thermodynamic lengths between neighbours are equal."""
    along = np.concatenate([[0.0], np.cumsum(lengths)])
    targets = np.linspace(0.0, along[-1], len(temperatures))
    ladder = np.exp(np.interp(targets, along, np.log(temperatures)))
    ladder[[0, -1]] = temperatures[[0, -1]]
    return np.asarray(ladder)
