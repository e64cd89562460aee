"""Parameters of a molecule as arrays, and its energy by term: slow and clear, all pairs, no cutoff."""

from dataclasses import dataclass

import numpy as np

from protochain.core.arrays import Floats, Integers, Value
from protochain.core.graph import neighbours
from protochain.core.units import COULOMB


@dataclass(frozen=True, eq=False)
class Term(Value):
    """Bonded terms of one kind."""

    atoms: Integers  # (n, k) int.
    parameters: Floats  # (n, m).


@dataclass(frozen=True, eq=False)
class Parameters(Value):
    """Parameters of the potential energy, in nm, kJ/mol, rad and e, columns as in an OpenMM System."""

    bonds: Term  # Length and spring.
    angles: Term  # Angle and spring.
    torsions: Term  # Periodicity, phase and k, impropers included.
    charge: Floats  # (na,).
    sigma: Floats  # (na,).
    epsilon: Floats  # (na,).
    scale_lj: float  # Factors of pairs three bonds apart. Nearer ones are left out.
    scale_coulomb: float

    def pairs(self) -> tuple[Integers, Floats, Floats]:
        """Pairs (m, 2) that are not left out, and the factors (m,) of their two energies."""
        n = len(self.charge)
        near = neighbours(self.bonds.atoms, n)
        close = np.eye(n, dtype=bool)
        reach = [close]
        for _ in range(3):
            close = close | np.array([close[list(around)].any(0) for around in near]).reshape(n, n)
            reach.append(close)
        i, j = np.nonzero(np.triu(~reach[2], 1))
        third = reach[3][i, j]
        lj, coulomb = np.where(third, self.scale_lj, 1.0), np.where(third, self.scale_coulomb, 1.0)
        return np.column_stack([i, j]), lj, coulomb


def terms(parameters: Parameters, x: Floats) -> dict[str, float]:
    """Energies at positions: x (na, 3) nm."""
    i, j = x[parameters.bonds.atoms.T]
    angles, dihedrals = _angles(x[parameters.angles.atoms]), _dihedrals(x[parameters.torsions.atoms])
    length, k_bond = parameters.bonds.parameters.T
    angle, k_angle = parameters.angles.parameters.T
    periodicity, phase, k_torsion = parameters.torsions.parameters.T
    pairs, lj, coulomb = parameters.pairs()
    one, other = pairs.T
    r = np.linalg.norm(x[one] - x[other], axis=1)
    sigma = 0.5 * (parameters.sigma[one] + parameters.sigma[other])
    well = np.sqrt(parameters.epsilon[one] * parameters.epsilon[other])
    s6 = (sigma / r) ** 6
    qq = parameters.charge[one] * parameters.charge[other]
    found = {
        "bonds": 0.5 * k_bond * (np.linalg.norm(i - j, axis=1) - length) ** 2,
        "angles": 0.5 * k_angle * (angles - angle) ** 2,
        "torsions": k_torsion * (1.0 + np.cos(periodicity * dihedrals - phase)),
        "lj": lj * 4.0 * well * (s6 * s6 - s6),
        "coulomb": coulomb * COULOMB * qq / r,
    }
    return {name: float(np.sum(values)) for name, values in found.items()}


def _angles(at: Floats) -> Floats:
    """Angles (n,) at the middle of three points (n, 3, 3)."""
    u, v = at[:, 0] - at[:, 1], at[:, 2] - at[:, 1]
    across = np.linalg.norm(np.cross(u, v), axis=1)
    found: Floats = np.arctan2(across, np.sum(u * v, axis=1))
    return found


def _dihedrals(at: Floats) -> Floats:
    """Dihedrals (n,) of four points (n, 4, 3)."""
    u, v, w = at[:, 1] - at[:, 0], at[:, 2] - at[:, 1], at[:, 3] - at[:, 2]
    m, n = np.cross(u, v), np.cross(v, w)
    y = np.sum(u * n, axis=1) * np.linalg.norm(v, axis=1)
    found: Floats = np.arctan2(y, np.sum(m * n, axis=1))
    return found
