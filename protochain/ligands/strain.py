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
from protochain.ligands.energy import Function, Parameters

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
    function = Function(parameters)

    from scipy.optimize import minimize

    def value(free: Floats) -> tuple[float, Floats]:
        at = x.copy()
        at[moving] = free.reshape(-1, 3)
        energy, gradient = _summed(function, at)
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
    return _summed(Function(parameters), x)


def _summed(function: Function, x: Floats) -> tuple[float, Floats]:
    terms, gradient = function(x)
    return sum(terms.values()), gradient
