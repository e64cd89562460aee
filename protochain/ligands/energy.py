"""Parameters of a molecule as arrays, its energy by term (slow and clear, all pairs), and its strain."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from protochain.core.arrays import Floats, Integers, Value, cross, dihedral, dihedral_slopes
from protochain.core.graph import neighbours
from protochain.core.processors import one_blas_thread
from protochain.core.units import COULOMB

_MOST = 20000  # Iterations and evaluations.
_TOLERANCE = 1e-3
"""kJ/mol/nm of the largest gradient component. The energy is then within 1e-8 kJ/mol of the minimum."""
_UNIT = 0.01
"""nm. The first step of L-BFGS-B has a norm of one, and atoms that move by 1 nm are out of the molecule."""


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
    scale_lj: float  # Factors of pairs three bonds apart. Nearer pairs are excluded.
    scale_coulomb: float

    def pairs(self) -> tuple[Integers, Floats, Floats]:
        """Interacting pairs (m, 2), and the factors (m,) of their two energies."""
        n = len(self.charge)
        near = neighbours(self.bonds.atoms, n)
        within = np.eye(n, dtype=bool)
        reach = [within]
        for _ in range(3):
            within = within | np.array([within[list(around)].any(0) for around in near]).reshape(n, n)
            reach.append(within)
        i, j = np.nonzero(np.triu(~reach[2], 1))
        third = reach[3][i, j]
        lj, coulomb = np.where(third, self.scale_lj, 1.0), np.where(third, self.scale_coulomb, 1.0)
        return np.column_stack([i, j]), lj, coulomb


def terms(parameters: Parameters, x: Floats) -> dict[str, float]:
    """Energies at positions: x (na, 3) nm."""
    function = Function(parameters)
    with np.errstate(all="ignore"):
        coulomb = float(np.sum(function.charges / np.linalg.norm(function.incidence @ x, axis=1)))
        return function(x)[0] | {"coulomb": coulomb}


class Function:
    """Energies by term, without Coulomb's, and their gradient, with arrays that positions do not change."""

    def __init__(self, parameters: Parameters) -> None:
        self.parameters = parameters
        pairs, lj, coulomb = parameters.pairs()
        i, j = pairs.T
        self.sigma = 0.5 * (parameters.sigma[i] + parameters.sigma[j])
        self.well = lj * np.sqrt(parameters.epsilon[i] * parameters.epsilon[j])
        self.charges = coulomb * COULOMB * parameters.charge[i] * parameters.charge[j]
        # A row per pair, 1 and -1, since scattering by index costs ten times as much as this product.
        rows = np.tile([1.0, -1.0], len(pairs)), pairs.ravel(), 2 * np.arange(len(pairs) + 1)
        self.incidence = csr_array(rows, shape=(len(pairs), len(parameters.charge)))
        self.scatter = self.incidence.T.tocsr()

    def __call__(self, x: Floats) -> tuple[dict[str, float], Floats]:
        """Energies, kJ/mol, and gradient (na, 3), kJ/mol/nm, at x (na, 3) nm."""
        gradient = np.zeros_like(x)
        parts = {"bonds": self._bonds, "angles": self._angles, "torsions": self._torsions, "lj": self._wells}
        return {name: part(x, gradient) for name, part in parts.items()}, gradient

    def _bonds(self, x: Floats, gradient: Floats) -> float:
        (i, j), (r0, k) = self.parameters.bonds.atoms.T, self.parameters.bonds.parameters.T
        along = x[i] - x[j]
        r = np.linalg.norm(along, axis=1)
        pull = (k * (r - r0) / r)[:, None] * along
        np.add.at(gradient, i, pull)
        np.add.at(gradient, j, -pull)
        return float(0.5 * np.sum(k * (r - r0) ** 2))

    def _angles(self, x: Floats, gradient: Floats) -> float:
        (i, j, k), (angle0, stiffness) = self.parameters.angles.atoms.T, self.parameters.angles.parameters.T
        u, v = x[i] - x[j], x[k] - x[j]
        normal = cross(u, v)
        across = np.linalg.norm(normal, axis=1)
        angle = np.arctan2(across, np.sum(u * v, axis=1))
        slope = (stiffness * (angle - angle0) / np.maximum(across, 1e-12))[:, None]
        at_i = slope * cross(u, normal) / np.sum(u * u, axis=1)[:, None]
        at_k = slope * cross(normal, v) / np.sum(v * v, axis=1)[:, None]
        for atoms, force in ((i, at_i), (k, at_k), (j, -at_i - at_k)):
            np.add.at(gradient, atoms, force)
        return float(0.5 * np.sum(stiffness * (angle - angle0) ** 2))

    def _torsions(self, x: Floats, gradient: Floats) -> float:
        atoms, (n, phase, height) = self.parameters.torsions.atoms, self.parameters.torsions.parameters.T
        turn = dihedral(*x[atoms.T])
        slope = -n * height * np.sin(n * turn - phase)
        np.add.at(gradient, atoms, slope[:, None, None] * dihedral_slopes(x[atoms]))
        return float(np.sum(height * (1.0 + np.cos(n * turn - phase))))

    def _wells(self, x: Floats, gradient: Floats) -> float:
        along = self.incidence @ x
        square = np.sum(along * along, axis=1)
        s6 = (self.sigma**2 / square) ** 3
        gradient += self.scatter @ ((self.well * (24.0 * s6 - 48.0 * s6 * s6) / square)[:, None] * along)
        return float(np.sum(4.0 * self.well * (s6 * s6 - s6)))


def strain(parameters: Parameters, x: Floats, elements: Integers) -> float:
    """Energy of a molecule at x (na, 3) nm above the nearest minimum, kJ/mol, or NaN if it is not finite.

    Energies are bonds, angles, torsions and Lennard-Jones of the molecule alone. Its Coulomb energy is not
    included: in vacuum it would fold charged groups onto one another, unlike in a pocket or in water. Models
    seldom have reliable hydrogens. These are first put at the lowest energy with the other atoms in place.
    The strain does not depend on their original places.
    """
    placed = nearest_minimum(parameters, x, np.asarray(elements) == 1)
    free = nearest_minimum(parameters, placed, np.ones(len(x), dtype=bool))
    function = Function(parameters)
    with np.errstate(all="ignore"):
        energy, minimum = (sum(function(positions)[0].values()) for positions in (placed, free))
    return max(energy - minimum, 0.0) if np.isfinite(energy) and np.isfinite(minimum) else float("nan")


def nearest_minimum(parameters: Parameters, x: Floats, moving: NDArray[np.bool_]) -> Floats:
    """Return the positions of the minimum to which L-BFGS goes, if some atoms (na,) bool may move."""
    if not moving.any():
        return x
    function = Function(parameters)

    from scipy.optimize import minimize

    def place(scaled: Floats) -> Floats:
        positions = x.copy()
        positions[moving] = _UNIT * scaled.reshape(-1, 3)
        return positions

    def value(scaled: Floats) -> tuple[float, Floats]:
        terms, gradient = function(place(scaled))
        energy = sum(terms.values())
        return (energy, _UNIT * gradient[moving].ravel()) if np.isfinite(energy) else (1e300, 0.0 * scaled)

    # An end by the change of the energy would depend on round-off, so only the gradient ends it.
    with np.errstate(all="ignore"), one_blas_thread():
        result = minimize(
            value, x[moving].ravel() / _UNIT, jac=True, method="L-BFGS-B",
            options={"gtol": _UNIT * _TOLERANCE, "ftol": 0, "maxiter": _MOST, "maxfun": _MOST, "maxcor": 20},
        )  # fmt: skip
    return place(result.x)
