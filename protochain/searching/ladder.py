"""Temperatures as far apart as energies are wide: ladders of replicas."""

import numpy as np
from scipy.special import erfcinv

from protochain.core.arrays import Floats

_RAREST, _MOST_FREQUENT = 1e-3, 0.999
"""Acceptances that are distinguished from 0 and 1: more need more trials than a pilot has."""


def geometric(low: float, high: float, n: int) -> Floats:
    """Temperatures (n,) with constant ratios, K: right where the heat capacity is constant."""
    return np.geomspace(low, high, n)


def length_of_acceptance(acceptance: Floats) -> Floats:
    """Thermodynamic length between temperatures of which exchanges are accepted this often."""
    # For energies with normal distributions of one width s it is L = s |1/kT - 1/kT'|, and the mean
    # acceptance is erfc(L/2) (Predescu, Predescu, Ciobanu, J. Chem. Phys. 120:4119, 2004).
    return np.asarray(2.0 * erfcinv(np.clip(acceptance, _RAREST, _MOST_FREQUENT)))


def equally_spaced(temperatures: Floats, lengths: Floats) -> Floats:
    """As many temperatures between the same ends, with equal thermodynamic lengths between neighbours."""
    along = np.concatenate([[0.0], np.cumsum(lengths)])
    targets = np.linspace(0.0, along[-1], len(temperatures))
    ladder = np.exp(np.interp(targets, along, np.log(temperatures)))
    ladder[[0, -1]] = temperatures[[0, -1]]
    return np.asarray(ladder)
