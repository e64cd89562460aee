"""Closed loops: what is left of M^-1 when m constraint rows have to hold as well."""

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from protochain.arrays import Floats, floats
from protochain.errors import MechanicsError
from protochain.multibody import articulated, fixman
from protochain.multibody.kinematics import Frames
from protochain.multibody.mass import Method, checked
from protochain.multibody.operational import Rows, operational_inverse, row_loads, row_matrix
from protochain.multibody.tree import Tree


def solve_closed(
    tree: Tree, frames: Frames, tau: Floats, rows: Rows, method: Method = "articulated"
) -> Floats:
    """Accelerations from rest that the torques tau give when the rows hold: G x = 0.

    Parameters
    ----------
    tree : Tree
    frames : Frames
    tau : (n_v,) float, kJ/mol
    rows : Rows
    method : str
        As in :func:`solve_mass`.

    Returns
    -------
    (n_v,) float
        (M^-1 - M^-1 G^T (G M^-1 G^T)^-1 G M^-1) tau, the projected inverse.

    Raises
    ------
    MechanicsError
        If M is singular or the rows depend on one another.

    Notes
    -----
    With Fixman's method the rows are appended to the hard ones: one more block of H, eliminated last
    (Fixman 1974; Lee, Wang, Chirikjian 2007). O(m n + m^3).
    """
    g = row_matrix(tree, frames, rows)
    if checked(method) == "fixman":
        eliminated = fixman.eliminate(tree, frames)
        free = fixman.solve(eliminated, tau)
        moved = np.array(
            [
                fixman.soft_rates(tree, frames, fixman.respond(eliminated, load))
                for load in row_loads(tree, rows)
            ]
        )
    else:
        factors = articulated.articulate(tree, frames)
        free = articulated.solve(factors, floats(tau, (tree.n_v,), "tau"))
        moved = np.array([articulated.solve(factors, row) for row in g])
    if len(g) == 0:
        return free
    return np.asarray(free - moved.T @ cho_solve(_factor(moved @ g.T), g @ free))


def log_det_closed(tree: Tree, frames: Frames, rows: Rows, method: Method = "articulated") -> float:
    """Ln det (G M^-1 G^T): what closing loops adds to the metric's determinant.

    Parameters
    ----------
    tree : Tree
    frames : Frames
    rows : Rows
    method : str
        ``fixman`` takes it from the block that the appended rows leave in H: ln det H_x - ln det H.

    Returns
    -------
    float

    Raises
    ------
    MechanicsError
        As :func:`solve_closed`.
    """
    if checked(method) == "fixman":
        eliminated = fixman.eliminate(tree, frames)
        loads = row_loads(tree, rows)
        felt = np.array([fixman.respond(eliminated, load) for load in loads])
        inverse = np.einsum("ibk,jbk->ij", loads, felt)
    else:
        inverse = operational_inverse(tree, frames, rows)
    return float(2.0 * np.sum(np.log(np.diagonal(_factor(inverse)[0]))))


def _factor(inverse: Floats) -> tuple[Floats, bool]:
    size = np.sqrt(np.maximum(np.diagonal(inverse), 0.0))
    try:
        factor, lower = cho_factor(inverse)
        # A row that the others already hold leaves a pivot of rounding only.
        if np.any(np.diagonal(factor) <= 1e-7 * size):
            raise LinAlgError
    except LinAlgError:
        raise MechanicsError(
            "the constraint rows depend on one another; leave the redundant ones out"
        ) from None
    return factor, lower
