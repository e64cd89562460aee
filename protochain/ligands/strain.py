"""Strain of a small molecule: its energy in a pose above the energy of the nearest minimum.

Energies are bonds, angles, torsions and Lennard-Jones of the molecule alone. Its Coulomb energy is not
included: in vacuum it would fold charged groups onto one another, unlike in a pocket or in water. Models
seldom have reliable hydrogens. These are first put at the lowest energy with the other atoms in place. The
strain does not depend on their original places.
"""

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from protochain.core.arrays import Floats, Integers
from protochain.ligands.energy import Function, Parameters

_MOST = 20000
"""Iterations and evaluations."""
_TOLERANCE = 1e-3
"""kJ/mol/nm of the largest gradient component. The energy is then within 1e-8 kJ/mol of the minimum."""
_UNIT = 0.01
"""nm. The first step of L-BFGS-B has a norm of one, and atoms that move by 1 nm are out of the molecule."""


def strain(parameters: Parameters, x: Floats, elements: Integers) -> float:
    """Strain of a molecule at x (na, 3), kJ/mol. NaN if it is not finite, as for atoms at one place."""
    all_atoms = np.ones(len(x), dtype=bool)
    placed = nearest_minimum(parameters, x, np.asarray(elements) == 1)
    free = nearest_minimum(parameters, placed, all_atoms)
    with np.errstate(all="ignore"):
        energy, minimum = (energy_and_gradient(parameters, positions)[0] for positions in (placed, free))
    return max(energy - minimum, 0.0) if np.isfinite(energy) and np.isfinite(minimum) else float("nan")


def nearest_minimum(parameters: Parameters, x: Floats, moving: NDArray[np.bool_]) -> Floats:
    """Return the positions of the minimum to which L-BFGS goes, if some atoms (na,) bool may move."""
    if not moving.any():
        return x
    function = Function(parameters)

    from scipy.optimize import minimize

    def value(scaled: Floats) -> tuple[float, Floats]:
        positions = x.copy()
        positions[moving] = _UNIT * scaled.reshape(-1, 3)
        terms, gradient = function(positions)
        energy = sum(terms.values())
        return (energy, _UNIT * gradient[moving].ravel()) if np.isfinite(energy) else (1e300, 0.0 * scaled)

    # An end by the change of the energy would depend on round-off, so only the gradient ends it.
    with np.errstate(all="ignore"), threadpool_limits(1, "blas"):
        result = minimize(
            value, x[moving].ravel() / _UNIT, jac=True, method="L-BFGS-B",
            options={"gtol": _UNIT * _TOLERANCE, "ftol": 0, "maxiter": _MOST, "maxfun": _MOST, "maxcor": 20},
        )  # fmt: skip
    positions = x.copy()
    positions[moving] = _UNIT * result.x.reshape(-1, 3)
    return positions


def energy_and_gradient(parameters: Parameters, x: Floats) -> tuple[float, Floats]:
    """Return the energy (kJ/mol) that strain is about and its gradient (na, 3), kJ/mol/nm."""
    terms, gradient = Function(parameters)(x)
    return sum(terms.values()), gradient
