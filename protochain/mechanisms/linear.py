"""Small motions about a state: the matrix of their equations, and frequencies."""

import numpy as np

from protochain.core.arrays import Floats
from protochain.core.checks import shown
from protochain.core.errors import MechanicsError
from protochain.mechanics import multibody
from protochain.mechanics.motion import Phase
from protochain.mechanisms.model import Model

_NUDGE = 1e-5
"""Displacement for the derivatives by central differences, in radians and sizes of the tree: the cube root of
rounding, where both errors of a derivative are about 1e-10."""


def state_matrix(model: Model, at: Phase | None = None) -> Floats:
    """Matrix A of small motions d(x, v)/dt = A (x, v) about a state, driven hinges going on as they do.

    Parameters
    ----------
    model : Model
        The mechanism.
    at : Phase, optional
        State about which it moves, by default the start: at rest, or in steady motion.

    Returns
    -------
    (2 k, 2 k) float
        For displacements and velocities along the k :attr:`Model.directions`: of all freedoms that are not
        driven, or of modes. A free root must be at rest.
    """
    if not isinstance(model, Model):
        raise MechanicsError(f"model {shown(model)}: give one, as build() makes it")
    system, tree = model.system, model.tree
    at = model.start() if at is None else at
    directions = model.directions
    back = np.linalg.pinv(directions)

    def acceleration(move: Floats, rate: Floats) -> Floats:
        q, qd = multibody.integrate(tree, at.q, move), at.qd + rate
        factors = system.factors(q)
        _, torque, loads = system.forces(at.time, q, qd, factors)
        qdd = system.accelerations(at.time, q, qd, torque, loads, factors)[0]
        qdd[tree.driven_v] = 0.0
        return np.asarray(back @ qdd)

    k, still = directions.shape[1], np.zeros(tree.n_v)
    out = np.zeros((2 * k, 2 * k))
    out[:k, k:] = np.eye(k)
    for i, column in enumerate(directions.T):
        step = _NUDGE / np.max(np.abs(column) / tree.units)
        one = step * column
        out[k:, i] = (acceleration(one, still) - acceleration(-one, still)) / (2.0 * step)
        out[k:, k + i] = (acceleration(still, one) - acceleration(still, -one)) / (2.0 * step)
    return out


def frequencies(model: Model, at: Phase | None = None) -> Floats:
    """Angular frequencies of small motions about a state, ascending.

    Parameters
    ----------
    model : Model
        Mechanism.
    at : Phase, optional
        As of :func:`state_matrix`.

    Returns
    -------
    (m,) float
        Imaginary parts of the eigenvalues that have one, in pairs counted once.
    """
    found = np.linalg.eigvals(state_matrix(model, at)).imag
    return np.sort(found[found > 0.0])
