"""Torsion maps as bicubic splines."""

import numpy as np

from protochain.core.arrays import Floats

_HERMITE = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [-3, 3, -2, -1], [2, -2, 1, 1]])
"""Coefficients of 1, u, u^2, u^3 from values at 0 and 1 and slopes at 0 and 1."""


def spline_coefficients(grid: Floats) -> Floats:
    """Fit the periodic bicubic spline through a map."""
    # grid (size, size) kJ/mol -> (size, size, 4, 4): Coefficients of u^a v^b, u and v from 0 to 1 in a cell.
    # First and cross derivatives are from periodic cubic splines along each axis: MacKerell, Feig,
    # Brooks, J. Comput. Chem. 25:1400 (2004).
    along = _slopes(grid, 0)
    across = _slopes(grid, 1)
    cross = _slopes(along, 1)
    corners = np.empty((*grid.shape, 4, 4))
    for a, (value, slope) in enumerate(((grid, across), (along, cross))):
        for i in (0, 1):
            for j in (0, 1):
                corners[..., 2 * a + i, j] = np.roll(value, (-i, -j), (0, 1))
                corners[..., 2 * a + i, 2 + j] = np.roll(slope, (-i, -j), (0, 1))
    return np.einsum("ap,ijpq,bq->ijab", _HERMITE, corners, _HERMITE)


def _slopes(values: Floats, axis: int) -> Floats:
    """Differentiate the periodic spline along one axis, per grid step."""
    # Imported only for force fields with maps, because the import is as slow as minimising a small protein.
    from scipy.interpolate import CubicSpline

    size = values.shape[axis]
    closed = np.concatenate([values, np.take(values, [0], axis)], axis)
    spline = CubicSpline(np.arange(size + 1), closed, axis=axis, bc_type="periodic")
    return np.asarray(spline(np.arange(size), 1))
