"""Temperatures as far apart as energies are wide: ladders of replicas, and schedules of cooling."""

import numpy as np
from scipy.special import erfc, erfcinv

from protochain.core.arrays import Floats
from protochain.core.units import MOLAR_GAS

_RAREST, _MOST_FREQUENT = 1e-3, 0.999
"""Acceptances that are told apart from 0 and 1: more need more trials than a pilot has."""


def geometric(low: float, high: float, n: int) -> Floats:
    """Temperatures (n,) with constant ratios, K: right where the heat capacity is constant."""
    return np.geomspace(low, high, n)


def length_of_acceptance(acceptance: Floats) -> Floats:
    """Thermodynamic length between temperatures of which exchanges are accepted this often.

    For energies with normal distributions of one width s it is L = s |1/kT - 1/kT'|, and the mean acceptance
    is erfc(L/2) (Predescu, Predescu, Ciobanu, J. Chem. Phys. 120:4119, 2004).
    """
    return np.asarray(2.0 * erfcinv(np.clip(acceptance, _RAREST, _MOST_FREQUENT)))


def acceptance_of_length(length: Floats) -> Floats:
    """Mean acceptance of exchanges across a thermodynamic length."""
    return np.asarray(erfc(0.5 * np.asarray(length)))


def length_of_widths(temperatures: Floats, widths: Floats) -> Floats:
    """Thermodynamic length (n - 1,) between temperatures (n,), K, from the widths (n,) of energies, kJ/mol.

    The heat capacity is width^2 / kT^2: a schedule with equal lengths cools at constant thermodynamic speed
    (Salamon, Nulton, Harland, Pedersen, Ruppeiner, Liao, Comput. Phys. Commun. 49:423, 1988).
    """
    beta = 1.0 / (MOLAR_GAS * temperatures)
    return np.asarray(0.5 * (widths[1:] + widths[:-1]) * np.abs(np.diff(beta)))


def equally_spaced(temperatures: Floats, lengths: Floats) -> Floats:
    """As many temperatures between the same ends, with equal thermodynamic lengths between neighbours."""
    along = np.concatenate([[0.0], np.cumsum(lengths)])
    wanted = np.linspace(0.0, along[-1], len(temperatures))
    found = np.exp(np.interp(wanted, along, np.log(temperatures)))
    found[[0, -1]] = temperatures[[0, -1]]
    return np.asarray(found)
