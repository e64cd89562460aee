"""Strain of a small molecule: its energy in a pose above that of the minimum nearest to the pose.

Energies are bonds, angles, torsions and Lennard-Jones of the molecule alone. Its own Coulomb energy is left
out: in vacuum it would fold charged groups onto one another, which they do not do in a pocket or in water.
Hydrogens, whose places a model seldom knows, are first put where the energy is lowest with the other atoms in
place. What is left is the same however they were added.
"""

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from protochain.core.arrays import Floats, Integers
from protochain.ligands.energy import Parameters

_MOST_ITERATIONS = 2000
_RELATIVE = 1e-7
"""Change of the energy in an iteration at which it ends, too."""
_TOLERANCE = 1.0
"""kJ/mol/nm of the largest force component at the minimum."""


def strain(parameters: Parameters, x: Floats, elements: Integers) -> float:
    """Strain of a molecule at x (na, 3), kJ/mol; NaN where the energy is not finite, as at one place."""
    every = np.ones(len(x), dtype=bool)
    placed = nearest_minimum(parameters, x, np.asarray(elements) == 1)
    free = nearest_minimum(parameters, placed, every)
    with np.errstate(all="ignore"):
        there, least = (energy_and_gradient(parameters, each)[0] for each in (placed, free))
    return max(there - least, 0.0) if np.isfinite(there) and np.isfinite(least) else float("nan")


def nearest_minimum(parameters: Parameters, x: Floats, moving: NDArray[np.bool_]) -> Floats:
    """Return the positions of the minimum to which L-BFGS goes, where some atoms (na,) bool may move."""
    if not moving.any():
        return x
    function = _Function(parameters)

    from scipy.optimize import minimize

    def value(free: Floats) -> tuple[float, Floats]:
        at = x.copy()
        at[moving] = free.reshape(-1, 3)
        energy, gradient = function(at)
        return (energy, gradient[moving].ravel()) if np.isfinite(energy) else (1e300, np.zeros(free.size))

    with np.errstate(all="ignore"), threadpool_limits(1, "blas"):
        found = minimize(
            value, x[moving].ravel(), jac=True, method="L-BFGS-B",
            options={"maxiter": _MOST_ITERATIONS, "gtol": _TOLERANCE, "ftol": _RELATIVE, "maxcor": 20},
        )  # fmt: skip
    at = x.copy()
    at[moving] = found.x.reshape(-1, 3)
    return at


def energy_and_gradient(parameters: Parameters, x: Floats) -> tuple[float, Floats]:
    """Return the energy (kJ/mol) that strain is about and its gradient (na, 3), kJ/mol/nm."""
    return _Function(parameters)(x)


class _Function:
    """The energy of some parameters, with what does not depend on positions."""

    def __init__(self, parameters: Parameters) -> None:
        self.of = parameters
        pairs, scale, _ = parameters.pairs()
        self.pairs = pairs.T
        one, other = self.pairs
        self.sigma = 0.5 * (parameters.sigma[one] + parameters.sigma[other])
        self.well = scale * np.sqrt(parameters.epsilon[one] * parameters.epsilon[other])

    def __call__(self, x: Floats) -> tuple[float, Floats]:
        gradient = np.zeros_like(x)
        energy = self._bonds(x, gradient) + self._angles(x, gradient)
        return float(energy + self._torsions(x, gradient) + self._wells(x, gradient)), gradient

    def _bonds(self, x: Floats, gradient: Floats) -> float:
        (i, j), (rest, k) = self.of.bonds.atoms.T, self.of.bonds.parameters.T
        along = x[i] - x[j]
        r = np.linalg.norm(along, axis=1)
        pull = (k * (r - rest) / r)[:, None] * along
        np.add.at(gradient, i, pull)
        np.add.at(gradient, j, -pull)
        return float(0.5 * np.sum(k * (r - rest) ** 2))

    def _angles(self, x: Floats, gradient: Floats) -> float:
        (i, j, k), (rest, stiffness) = self.of.angles.atoms.T, self.of.angles.parameters.T
        u, v = x[i] - x[j], x[k] - x[j]
        normal = np.cross(u, v)
        across = np.linalg.norm(normal, axis=1)
        angle = np.arctan2(across, np.sum(u * v, axis=1))
        slope = (stiffness * (angle - rest) / np.maximum(across, 1e-12))[:, None]
        at_i = slope * np.cross(u, normal) / np.sum(u * u, axis=1)[:, None]
        at_k = slope * np.cross(normal, v) / np.sum(v * v, axis=1)[:, None]
        for atoms, force in ((i, at_i), (k, at_k), (j, -at_i - at_k)):
            np.add.at(gradient, atoms, force)
        return float(0.5 * np.sum(stiffness * (angle - rest) ** 2))

    def _torsions(self, x: Floats, gradient: Floats) -> float:
        (i, j, k, m), (n, phase, height) = self.of.torsions.atoms.T, self.of.torsions.parameters.T
        u, v, w = x[j] - x[i], x[k] - x[j], x[m] - x[k]
        a, b = np.cross(u, v), np.cross(v, w)
        length = np.linalg.norm(v, axis=1)
        turn = np.arctan2(np.sum(u * b, axis=1) * length, np.sum(a * b, axis=1))
        slope = -n * height * np.sin(n * turn - phase)
        # Blondel, Karplus, J. Comput. Chem. 17:1132 (1996).
        at_i = -(slope * length / np.maximum(np.sum(a * a, axis=1), 1e-18))[:, None] * a
        at_m = (slope * length / np.maximum(np.sum(b * b, axis=1), 1e-18))[:, None] * b
        square = length**2
        first, last = ((np.sum(each * v, axis=1) / square)[:, None] for each in (u, w))
        at_j = -(1.0 + first) * at_i + last * at_m
        at_k = first * at_i - (1.0 + last) * at_m
        for atoms, force in ((i, at_i), (j, at_j), (k, at_k), (m, at_m)):
            np.add.at(gradient, atoms, force)
        return float(np.sum(height * (1.0 + np.cos(n * turn - phase))))

    def _wells(self, x: Floats, gradient: Floats) -> float:
        i, j = self.pairs
        along = x[i] - x[j]
        square = np.sum(along * along, axis=1)
        s6 = (self.sigma**2 / square) ** 3
        push = (self.well * (24.0 * s6 - 48.0 * s6 * s6) / square)[:, None] * along
        np.add.at(gradient, i, push)
        np.add.at(gradient, j, -push)
        return float(np.sum(4.0 * self.well * (s6 * s6 - s6)))
