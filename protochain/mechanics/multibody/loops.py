"""Closed loops: the inverse of M projected onto m constraint rows."""

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from protochain.core.arrays import Floats, floats
from protochain.core.errors import Fault, MechanicsError
from protochain.mechanics.multibody import articulated, fixman
from protochain.mechanics.multibody.articulated import Articulated
from protochain.mechanics.multibody.kinematics import Frames
from protochain.mechanics.multibody.mass import Method, check_method
from protochain.mechanics.multibody.operational import Rows, operational_inverse, row_loads, row_matrix
from protochain.mechanics.multibody.tree import Tree


def solve_closed(
    tree: Tree,
    frames: Frames,
    tau: Floats,
    rows: Rows,
    method: Method = "articulated",
    factors: Articulated | None = None,
) -> Floats:
    """Solve for the accelerations from rest under torques tau and constraints G x = 0.

    Parameters
    ----------
    tree, frames : Tree, Frames
        Rigid bodies and their world frames.
    tau : (n_v,) float, kJ/mol
        Torques.
    rows : Rows
        Constraint rows.
    method : str
        Method as in :func:`solve_mass`.
    factors : Articulated, optional
        Factors of M at these frames, if they are known. ``fixman`` has its own.

    Returns
    -------
    (n_v,) float
        Accelerations (M^-1 - M^-1 G^T (G M^-1 G^T)^-1 G M^-1) tau.

    Raises
    ------
    MechanicsError
        If M is singular or the rows are linearly dependent.

    Notes
    -----
    In Fixman's method the rows are appended to the hard rows: one more block of H, eliminated last
    (Fixman 1974, Lee, Wang, Chirikjian 2007). O(m n + m^3).
    """
    g = row_matrix(tree, frames, rows)
    if check_method(method) == "fixman":
        eliminated = fixman.eliminate(tree, frames)
        free = fixman.solve(eliminated, tau)
        twists = [fixman.respond(eliminated, load) for load in row_loads(tree, rows)]
        moved = np.array([fixman.soft_rates(tree, frames, twist) for twist in twists])
    else:
        factors = articulated.articulate(tree, frames) if factors is None else factors
        free = articulated.solve(factors, floats(tau, (tree.n_v,), "tau"))
        moved = np.array([articulated.solve(factors, row) for row in g])
    if len(g) == 0:
        return free
    return np.asarray(free - moved.T @ cho_solve(factor_closed(moved @ g.T), g @ free))


def log_det_closed(tree: Tree, frames: Frames, rows: Rows, method: Method = "articulated") -> float:
    """Logarithm of det(G M^-1 G^T), the contribution of loop closure to the metric determinant.

    Parameters
    ----------
    tree, frames : Tree, Frames
        Rigid bodies and their world frames.
    rows : Rows
        Constraint rows.
    method : str
        Method as in :func:`solve_mass`. ``fixman`` obtains it from the appended block of H.

    Returns
    -------
    float
        Value of ln det(G M^-1 G^T).

    Raises
    ------
    MechanicsError
        As :func:`solve_closed`.
    """
    if check_method(method) == "fixman":
        eliminated = fixman.eliminate(tree, frames)
        loads = row_loads(tree, rows)
        felt = np.array([fixman.respond(eliminated, load) for load in loads])
        inverse = np.einsum("ibk,jbk->ij", loads, felt)
    else:
        inverse = operational_inverse(tree, frames, rows)
    return float(2.0 * np.sum(np.log(np.diagonal(factor_closed(inverse)[0]))))


def factor_closed(inverse: Floats) -> tuple[Floats, bool]:
    """Cholesky's factor of G M^-1 G^T, as scipy's ``cho_factor`` gives it: upper."""
    size = np.sqrt(np.maximum(np.diagonal(inverse), 0.0))
    try:
        factor, lower = cho_factor(inverse)
        # A row that depends on the others leaves a pivot of rounding error only.
        if np.any(np.diagonal(factor) <= 1e-7 * size):
            raise LinAlgError
    except LinAlgError:
        raise MechanicsError(
            "the constraint rows are linearly dependent; remove the redundant ones", fault=Fault.DEPENDENT
        ) from None
    return factor, lower
