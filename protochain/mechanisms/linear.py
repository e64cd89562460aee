"""Small motions about a state: the matrix of their equations, and frequencies."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Self

import numpy as np
from scipy.linalg import cholesky, eigh, null_space, solve_triangular, svdvals

from protochain.core.arrays import Floats
from protochain.core.checks import brief
from protochain.core.errors import MechanicsError
from protochain.core.settings import document_fields
from protochain.mechanics import multibody
from protochain.mechanics.motion import Phase
from protochain.mechanics.multibody import HingeKind
from protochain.mechanics.multibody.articulated import Articulated
from protochain.mechanisms.bodies import State
from protochain.mechanisms.element_arguments import answer, number
from protochain.mechanisms.loads import n_parameters
from protochain.mechanisms.loop_joints import least_change
from protochain.mechanisms.model import Model

_NUDGE = 1e-5
"""Displacement for the derivatives by central differences, in radians and sizes of the tree: the cube root of
rounding. There both errors of a derivative are about 1e-10."""
_RIGID = 1e-9
"""Square of a frequency, relative to the lowest one, that is rounding of a motion without resistance."""


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
        For displacements and velocities along the k :attr:`Model.directions`: of all freedoms without
        drives, or of modes. Displacements of balls and free bodies are turns from their orientations in
        the reference motion.
    """
    return _about(model, at)[0]


@document_fields
class Linear(NamedTuple):
    """Small motions dx/dt = A x + B u with outputs y = y0 + C x + D u."""

    a: Floats  # (2 k, 2 k) float: As of :func:`state_matrix`.
    b: Floats  # (2 k, n) float: Of each input.
    c: Floats  # (m, 2 k) float: Of each output.
    d: Floats  # (m, n) float: Of each output.


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
        Hinges at which torques act, forces at slides, in addition to the model's own.
    outputs : sequence of callable
        Functions of the :class:`State`, or of the state and the accelerations (n_v,), that return a number.
    at : Phase, optional
        As of :func:`state_matrix`.

    Returns
    -------
    Linear
        Matrices A, B, C, D, with state and A as of :func:`state_matrix`. D is 0 if no output uses qdd.
    """
    freedoms = [model.bodies.freedom(hinge, "linearise")[1] for hinge in inputs]
    for function in outputs:
        if not callable(function) or n_parameters(function) not in (1, 2):
            raise MechanicsError(f"output {brief(function)}: give a function of the state")

    def observe(state: State, qdd: Floats) -> Floats:
        arguments = (state, qdd)
        values = [answer("output", output, *arguments[: n_parameters(output)]) for output in outputs]
        return np.array([number(value, "output") for value in values])

    matrix, k = _about(model, at, observe, freedoms)
    return Linear(
        matrix[: 2 * k, : 2 * k], matrix[: 2 * k, 2 * k :], matrix[2 * k :, : 2 * k], matrix[2 * k :, 2 * k :]
    )


@dataclass(frozen=True, eq=False)
class _Nearby:
    """States near a state, by displacements and velocities along the directions of a mechanism."""

    model: Model
    at: Phase
    ways: Floats  # (n_v, k): Directions.
    back: Floats  # (k, n_v): Velocities -> amplitudes of directions.
    aside: Floats  # (n_v, r): All other directions of hinges without drives. Loops allow none of them.

    @classmethod
    def of(cls, model: Model, at: Phase | None) -> Self:
        """States near one, by default near the start."""
        if not isinstance(model, Model):
            raise MechanicsError(f"model {brief(model)}: give one, as build() makes it")
        at = model.start() if at is None else at
        ways = model.directions_at(at)
        free = np.eye(model.tree.n_v)[:, model.tree.undriven_v]
        back = np.asarray(np.linalg.pinv(ways), dtype=np.float64)
        return cls(model, at, ways, back, free @ null_space(ways.T @ free))

    def place(self, move: Floats, rate: Floats) -> tuple[Floats, Floats, Articulated, Floats]:
        """Coordinates, velocities and factors there, and the directions (n_v, k) that loops allow there."""
        system = self.model.system
        q, qd = multibody.integrate(system.tree, self.at.q, move), self.at.qd + rate
        factors = system.factors(q)
        if self.model.bodies.joints is None:
            return q, qd, factors, self.ways
        return q, qd + self.follow(factors, qd), factors, self.ways + self.follow(factors, self.ways)

    def follow(self, factors: Articulated, qd: Floats, bends: Floats | None = None) -> Floats:
        """Velocities along ``aside`` that loops need in addition to qd. With ``bends``, accelerations."""
        joints, tree = self.model.bodies.joints, self.model.tree
        assert joints is not None
        rates = joints.matrix(tree, factors.frames)
        opening = rates @ (qd.T / tree.units).T
        if bends is not None:
            opening = opening + bends / np.where(joints.turns, 1.0, tree.size)
        return np.asarray(self.aside @ least_change(rates @ (self.aside / tree.units[:, None]), -opening))

    def lack(self, move: Floats, rate: Floats, qdd: Floats) -> Floats:
        """(k,) float: forces along the directions there, less the forces that accelerations need."""
        model, system = self.model, self.model.system
        q, qd, factors, directions = self.place(move, rate)
        torque, joints = system.forces(self.at.time, q, qd, factors)[1], model.bodies.joints
        if joints is not None:
            bends = joints.accelerations(model.tree, factors.frames, qd, np.zeros_like(qd))
            qdd = qdd + self.follow(factors, qdd, bends)
        return np.asarray(directions.T @ (torque - system.inverse_dynamics(q, qd, qdd)))

    def slopes(self, function: Callable[[Floats, Floats], Floats], kind: int) -> Floats:
        """Derivatives by displacements (kind 0) or velocities (1) along the directions, as columns."""
        columns = []
        for way in self.ways.T:
            step = _NUDGE / np.max(np.abs(way) / self.model.tree.units)
            ends = [function(*np.roll([sign * step * way, 0.0 * way], kind, axis=0)) for sign in (1.0, -1.0)]
            columns.append((ends[0] - ends[1]) / (2.0 * step))
        return np.array(columns).T if columns else np.zeros((0, 0))

    @property
    def turning(self) -> Floats:
        """(k, k) float: rates of displacements at unchanged velocities: balls and free bodies may turn."""
        # With R = R0 exp(d) of a ball d' = dw - w x d along its axes. With R = exp(d) R0 of a free body
        # d' = dw + w x d along the world's.
        tree, out = self.model.tree, np.zeros_like(self.ways)
        roots = tree.v_start[:-1][tree.kind == HingeKind.FREE]
        for sign, freedoms in ((-1.0, tree.balls), (1.0, roots[:, None] + np.arange(3))):
            for triple in freedoms:
                out[triple] = sign * np.cross(self.at.qd[triple], self.ways[triple].T).T
        return np.asarray(self.back @ out)


def _about(
    model: Model, at: Phase | None, observe: Callable[[State, Floats], Floats] | None = None,
    freedoms: Sequence[int] = (),
) -> tuple[Floats, int]:  # fmt: skip
    """Derivatives of rates and outputs by state and torques, and the number of directions."""
    near = _Nearby.of(model, at)
    system, tree, k = model.system, model.tree, near.ways.shape[1]
    still = np.zeros(tree.n_v)

    def respond(move: Floats, rate: Floats, push: Floats = still) -> Floats:
        q, qd, factors, _ = near.place(move, rate)
        _, torque, loads = system.forces(near.at.time, q, qd, factors)
        qdd = system.accelerations(near.at.time, q, qd, torque + push, loads, factors)[0]
        out = near.back @ qdd
        if observe is None:
            return np.asarray(out)
        return np.append(out, observe(State(model.bodies, near.at.time, q, qd, factors.frames), qdd))

    # Rates are linear in torques, so unit torques give their derivatives.
    units = np.eye(tree.n_v)[list(freedoms)]
    pushed = [0.5 * (respond(still, still, unit) - respond(still, still, -unit)) for unit in units]
    rows = len(respond(still, still))
    lower = [near.slopes(respond, 0), near.slopes(respond, 1), np.reshape(pushed, (len(units), rows)).T]
    upper = np.hstack([near.turning, np.eye(k), np.zeros((k, len(units)))])
    return np.vstack([upper, np.hstack([part.reshape(rows, -1) for part in lower])]), k


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

    Notes
    -----
    Of M x'' + C x' + K x = 0, whose eigenvalues are found by their inverses, in coordinates by Cholesky's
    factors of K and M, so the lowest frequencies of a fine beam have all digits. If K is not positive
    definite, as of a free beam, the eigenvalues are shifted first (Tisseur, Meerbergen, SIAM Rev. 43:235,
    2001, sections 3.4 and 5.1).
    """
    near = _Nearby.of(model, at)
    system, ways, start, k = model.system, near.ways, near.at, near.ways.shape[1]
    if not k or np.any(near.turning):
        imaginary = np.linalg.eigvals(state_matrix(model, at)).imag
        return np.sort(imaginary[imaginary > 0.0])
    qdd = system.accelerations(start.time, start.q, start.qd, start.torque, start.loads, start.factors)[0]
    mass = ways.T @ multibody.mass_matrix(model.tree, start.factors.frames) @ ways
    stiffness, damping = (
        -near.slopes(lambda move, rate: near.lack(move, rate, qdd), kind) for kind in range(2)
    )
    # A stiffness by differences is symmetric but for rounding.
    skew = np.max(np.abs(stiffness - stiffness.T)) > 1e-9 * np.max(np.abs(stiffness))
    conservative = not (model.loads or np.any(start.qd) or skew)
    root, (shift, factor) = cholesky(mass, lower=True), _shift_eigenvalues(mass, damping, stiffness)
    # Rates of z = L_K^T x and L_M^T x', over the eigenvalue less its shift.
    across = solve_triangular(factor, root, lower=True)
    if conservative:
        squares = svdvals(across) ** -2.0 - shift**2
        return np.sort(np.sqrt(squares[squares > _RIGID * shift**2]))
    moved = damping + 2.0 * shift * mass
    back = factor.T @ np.linalg.inv(stiffness + shift * damping + shift**2 * mass)
    first = back @ solve_triangular(factor, moved.T, lower=True).T
    inverse = np.block([[-first, -back @ root], [across.T, np.zeros((k, k))]])
    imaginary = (1.0 / np.linalg.eigvals(inverse)).imag
    return np.sort(imaginary[imaginary > np.sqrt(_RIGID) * shift])


def _shift_eigenvalues(mass: Floats, damping: Floats, stiffness: Floats) -> tuple[float, Floats]:
    """Shift s, 0 if possible, for which K + s C + s^2 M is positive definite, and Cholesky's factor."""
    parts = [0.5 * (part + part.T) for part in (stiffness, damping, mass)]
    squares = eigh(parts[0], mass, eigvals_only=True)
    # Smaller ones are rounding.
    counts = np.abs(squares) > 1e-13 * np.max(np.abs(squares))
    low = squares[counts] if np.any(counts) else np.ones(1)
    least = np.sqrt(max(-2.0 * low[0], np.min(np.abs(low))))
    shift = 0.0 if np.all(counts) and low[0] > 0.0 else least
    while True:
        try:
            return shift, cholesky(parts[0] + shift * parts[1] + shift**2 * parts[2], lower=True)
        except np.linalg.LinAlgError:
            shift = 2.0 * shift or least
