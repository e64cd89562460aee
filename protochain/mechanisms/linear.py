"""Small motions about a state: the matrix of their equations, and frequencies."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from protochain.core.arrays import Floats
from protochain.core.checks import shown
from protochain.core.errors import MechanicsError
from protochain.mechanics import multibody
from protochain.mechanics.motion import Phase
from protochain.mechanisms.bodies import State
from protochain.mechanisms.element_arguments import answer, number
from protochain.mechanisms.loads import n_parameters
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
    return _about(model, at)[0]


class Linear(NamedTuple):
    """Small motions dx/dt = A x + B u with outputs y = y0 + C x + D u.

    Parameters
    ----------
    a : (2 k, 2 k) float
        As of :func:`state_matrix`.
    b : (2 k, n) float
        Of each input.
    c, d : (m, 2 k) and (m, n) float
        Of each output.
    """

    a: Floats
    b: Floats
    c: Floats
    d: Floats


def linearise(
    model: Model,
    inputs: Sequence[str] = (),
    outputs: Sequence[Callable[..., Any]] = (),
    at: Phase | None = None,
) -> Linear:
    """Linearise a mechanism about a state, as control needs it.

    Parameters
    ----------
    model : Model
        The mechanism.
    inputs : sequence of str
        Hinges at which torques act, forces at slides, beside those that do already.
    outputs : sequence of callable
        Functions of the :class:`State`, or of the state and the accelerations (n_v,), that return a number.
    at : Phase, optional
        As of :func:`state_matrix`.

    Returns
    -------
    Linear
        Matrices A, B, C, D; state and A as of :func:`state_matrix`. D is not zero for accelerations only.
    """
    freedoms = [model.bodies.freedom(each, "linearise")[1] for each in inputs]
    for function in outputs:
        if not callable(function) or n_parameters(function) not in (1, 2):
            raise MechanicsError(f"output {shown(function)}: give a function of the state")

    def seen(state: State, qdd: Floats) -> Floats:
        given = (state, qdd)
        found = [answer("output", each, *given[: n_parameters(each)]) for each in outputs]
        return np.array([number(each, "output") for each in found])

    whole, k = _about(model, at, seen, freedoms)
    return Linear(
        whole[: 2 * k, : 2 * k], whole[: 2 * k, 2 * k :], whole[2 * k :, : 2 * k], whole[2 * k :, 2 * k :]
    )


def _about(
    model: Model, at: Phase | None, seen: Callable[[State, Floats], Floats] | None = None,
    freedoms: Sequence[int] = (),
) -> tuple[Floats, int]:  # fmt: skip
    """Derivatives of rates and outputs by state and torques, and the number of directions."""
    if not isinstance(model, Model):
        raise MechanicsError(f"model {shown(model)}: give one, as build() makes it")
    system, tree = model.system, model.tree
    at = model.start() if at is None else at
    directions = model.directions
    back = np.linalg.pinv(directions)
    still, k = np.zeros(tree.n_v), directions.shape[1]

    def found(move: Floats, rate: Floats, push: Floats) -> Floats:
        q, qd = multibody.integrate(tree, at.q, move), at.qd + rate
        factors = system.factors(q)
        _, torque, loads = system.forces(at.time, q, qd, factors)
        qdd = system.accelerations(at.time, q, qd, torque + push, loads, factors)[0]
        qdd[tree.driven_v] = 0.0
        out = back @ qdd
        if seen is None:
            return np.asarray(out)
        return np.append(out, seen(State(model.bodies, at.time, q, qd, factors.frames), qdd))

    def slope(step: float, *change: Floats) -> Floats:
        up, down = (found(*(sign * each for each in change)) for sign in (1.0, -1.0))
        return (up - down) / (2.0 * step)

    columns = []
    for kind in range(2):
        for column in directions.T:
            step = _NUDGE / np.max(np.abs(column) / tree.units)
            one = step * column
            columns.append(slope(step, *((one, still) if kind == 0 else (still, one)), still))
    # Linear in torques, so that any will do: such as move a hinge by one.
    columns += [slope(1.0, still, still, unit) for unit in np.eye(tree.n_v)[list(freedoms)]]
    lower = np.array(columns).T
    upper = np.zeros((k, lower.shape[1]))
    upper[:, k : 2 * k] = np.eye(k)
    return np.vstack([upper, lower]), k


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
