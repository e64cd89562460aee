"""M^-1 in O(n) by Fixman's method: constraints of hinges are eliminated from the leaves to the root.

Fixman, PNAS 71:3050 (1974), for rigid bodies as Lee, Wang, Chirikjian, Robotica 25:739 (2007). Each hinge's
relative twist y = E V is split into one soft row (the free direction) and five hard rows (the locked ones).
With W = M0^-1 the bodies' inverse inertias, A = E_s W E_s^T, B = E_s W E_h^T and H = E_h W E_h^T:

    M^-1 = A - B H^-1 B^T,    ln det M = sum of ln det M_b + ln det H.

A rotor of armature a makes the soft row of its hinge one more row of H, whose diagonal it adds 1/a to: its
torque is -a times the acceleration of that row. ln det M has ln a besides.

Two hinges couple in H only through a common body. Eliminating a hinge therefore changes only its parent
body's W, whatever the number of its siblings: no fill-in, O(n).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from protochain.core.arrays import Floats, Integers, floats, freeze, read_only
from protochain.core.errors import BodyError, Fault, MechanicsError
from protochain.mechanics.multibody import algebra
from protochain.mechanics.multibody.algebra import Vector, add, cross, dot, kernel, scale, subtract
from protochain.mechanics.multibody.kinematics import Frames
from protochain.mechanics.multibody.newton_euler import multiply_mass
from protochain.mechanics.multibody.small import cholesky, solve_lower, solve_upper
from protochain.mechanics.multibody.tree import ARMATURE, PARENT, SLIDE, TURN, HingeKind, Tree, V

EPS = float(np.finfo(float).eps)


@dataclass(frozen=True, eq=False)
class Eliminated:
    """Factors of H at one pose."""

    tree: Tree  # tree, frames: Rigid bodies and their world frames.
    frames: Frames
    # (nb, 6, 6): Inverse inertia W of each body about its origin, world axes: wrench -> twist.
    inverse_inertia: Floats
    factor: Floats  # (nb, 6, 6): Cholesky factor of each hinge's block of H at its elimination.
    # (nb, 6, 6): Inverse of that block times the block that couples the hinge to its parent body.
    gain: Floats
    n_hard: Integers  # (nb,) int: Rows of each hinge: locked directions; six with a rotor, or driven.


def eliminate(tree: Tree, frames: Frames) -> Eliminated:
    """Factorise H at one pose, by one inward sweep."""
    # Block elimination of H (after Lee, Wang, Chirikjian 2007), leaf to root. O(n).
    n = tree.n_bodies
    # Such squared radii of gyration are of bodies a hundred-thousandth of the mechanism wide. Each refinement
    # gains about as many digits as eps over this leaves.
    thin = _thinness(tree) <= 1e-10
    if np.any(thin):
        raise BodyError(
            int(np.argmax(thin)),
            "a body that is (nearly) a point or a line has no usable inverse inertia; "
            "share the mass of an atom on its hinge's axis with it, or use method articulated",
            Fault.NO_INVERSE,
        )
    inverse = _inverse_inertias(tree, frames)
    factor, gain, n_hard = np.empty((n, 6, 6)), np.empty((n, 6, 6)), 6 - np.diff(tree.locked_links[:, V])
    rotors, soft = _rotors(tree), np.zeros(n)
    n_hard[rotors] = 6
    soft[rotors] = 1.0 / tree.bodies[rotors, ARMATURE]
    failed = _eliminate(
        tree.links, n_hard, soft, tree.bodies, frames.rotation, frames.origin, inverse.copy(), factor, gain
    )
    if failed >= 0:
        raise BodyError(failed, "its hinge's block of H is singular to round-off")
    return Eliminated(
        tree, frames, freeze(inverse), freeze(factor), freeze(gain), read_only(n_hard, np.int64)
    )


def _rotors(tree: Tree) -> NDArray[np.bool_]:
    """(nb,) bool: hinges of one freedom with armature that are not driven."""
    return (tree.bodies[:, ARMATURE] > 0.0) & (np.diff(tree.locked_links[:, V]) == 1)


def _heavier(tree: Tree) -> NDArray[np.bool_]:
    """(nb,) bool: free roots with armature, which is part of their inertia."""
    return (tree.bodies[:, ARMATURE] > 0.0) & (tree.kind == HingeKind.FREE)


def respond(factors: Eliminated, wrench: Floats) -> Floats:
    """Twists due to impulses on the bodies and reactions of the hinges: (W - W E_h^T H^-1 E_h W) wrench."""
    # wrench (nb, 6) -> (nb, 6).
    tree, frames = factors.tree, factors.frames
    impulse = floats(wrench, (tree.n_bodies, 6), "wrench").copy()
    twists = np.empty((tree.n_bodies, 6))
    _respond(
        tree.links, factors.n_hard, tree.bodies, frames.rotation, frames.origin, factors.inverse_inertia,
        factors.factor, factors.gain, impulse, twists,
    )  # fmt: skip
    return twists


def solve(factors: Eliminated, tau: Floats) -> Floats:
    """Solve M x = tau by x = (A - B H^-1 B^T) tau, from tau (n_v,) to (n_v,)."""
    # A tau is the response of unconnected bodies, often far larger than that of the chain, so that digits
    # cancel. Iterative refinement with M x from Newton-Euler recovers them (Higham, *Accuracy and Stability
    # of Numerical Algorithms*, 2002, theorem 12.3): one step, and more for bodies that are almost lines or
    # points. Its last change is an estimate of the error, by which a mechanism is refused.
    tree, frames = factors.tree, factors.frames
    tau = floats(tau, (tree.n_v,), "tau")
    x, change = _solve_once(factors, tau), 0.0
    for _ in range(5):
        step = _solve_once(factors, tau - multiply_mass(tree, frames, x))
        x = x + step
        change = float(np.linalg.norm(step) / max(np.linalg.norm(x), np.finfo(float).tiny))
        if change <= 4.0 * EPS:
            break
    # Far above rounding.
    if not change <= 1e-8:
        raise MechanicsError(
            f"Fixman's method has a relative error of {change:.1g}, as masses or inertias of the bodies "
            "differ too much; use method articulated",
            fault=Fault.NO_INVERSE,
        )
    return x


def _thinness(tree: Tree) -> Floats:
    """(nb,) float: squared radius of gyration about the worst axis, in squared lengths of the mechanism."""
    length = np.linalg.norm(tree.offset[tree.parent >= 0], axis=1)
    reach = np.maximum(np.linalg.norm(tree.com, axis=1), np.max(length, initial=0.0))
    moments = np.linalg.eigvalsh(tree.inertia)
    # A point at its reach origin, alone, or a body without mass has nothing to compare with: nor any inertia.
    return np.asarray(moments[:, 0] / (tree.mass * reach**2 + moments[:, 2] + np.finfo(float).tiny))


def _solve_once(factors: Eliminated, tau: Floats) -> Floats:
    tree, frames = factors.tree, factors.frames
    wrench = np.zeros((tree.n_bodies, 6))
    _add_soft_loads(tree.links, tree.bodies, frames.rotation, frames.origin, tau, wrench)
    rates = soft_rates(tree, frames, respond(factors, wrench))
    if tree.driven is not None:
        # No solution depends on their torques; of their rates rounding is left.
        rates[tree.driven_v] = 0.0
    return rates


def soft_rates(tree: Tree, frames: Frames, twists: Floats) -> Floats:
    """Hinge rates E_s V of bodies that move with these twists: twists (nb, 6) -> (n_v,)."""
    rates = np.empty(tree.n_v)
    _soft_rates(
        tree.links, tree.bodies, frames.rotation, frames.origin,
        floats(twists, (tree.n_bodies, 6), "twists"), rates,
    )  # fmt: skip
    return rates


def log_det(factors: Eliminated) -> float:
    """Logarithm of det M: sum of ln det M_b plus ln det H, of factors with which equations are solved."""
    tree = factors.tree
    solve(factors, tree.units)
    bodies = 3.0 * np.log(tree.mass) + np.linalg.slogdet(tree.inertia)[1]
    heavier = _heavier(tree)
    bodies[heavier] = -np.linalg.slogdet(factors.inverse_inertia[heavier])[1]
    rotors = np.log(tree.bodies[_rotors(tree), ARMATURE])
    pivots = np.diagonal(factors.factor, axis1=1, axis2=2)
    used = np.arange(6) < factors.n_hard[:, None]
    logs = np.log(pivots, where=used, out=np.zeros_like(pivots))
    return float(np.sum(bodies) + np.sum(rotors) + 2.0 * np.sum(logs))


def _inverse_inertias(tree: Tree, frames: Frames) -> Floats:
    """(nb, 6, 6): [[J, -J [c]x], [[c]x J, 1/m - [c]x J [c]x]], J = I^-1 about the centre of mass at c."""
    r = frames.rotation
    inverse = r @ np.linalg.inv(tree.inertia) @ r.swapaxes(1, 2)
    c = np.cross(np.eye(3), np.einsum("bij,bj->bi", r, tree.com)[:, None, :])
    out = np.empty((tree.n_bodies, 6, 6))
    out[:, :3, :3] = inverse
    out[:, 3:, :3] = c @ inverse
    out[:, :3, 3:] = out[:, 3:, :3].swapaxes(1, 2)
    out[:, 3:, 3:] = np.eye(3) / tree.mass[:, None, None] - c @ inverse @ c
    heavier = _heavier(tree)
    rotors = tree.bodies[heavier, ARMATURE, None, None] * np.eye(6)
    out[heavier] = np.linalg.inv(np.linalg.inv(out[heavier]) + rotors)
    return out


@kernel
def _hard_rows(rotation: Floats, bodies: Floats, b: int, rows: Floats) -> None:
    """Write an orthogonal basis of the hinge's locked directions, of determinant one with its soft row."""
    # The soft row is rotation about z, or translation along z if the hinge does not turn: the sixth row. A
    # screw locks translation other than by its pitch.
    rows[:] = 0.0
    for i in range(3):
        rows[0, i] = rotation[b, i, 0]
        rows[1, i] = rotation[b, i, 1]
        rows[2, 3 + i] = rotation[b, i, 0]
        rows[3, 3 + i] = rotation[b, i, 1]
        if bodies[b, TURN] != 0.0:
            rows[4, i] = -bodies[b, SLIDE] * rotation[b, i, 2]
            rows[4, 3 + i] = rotation[b, i, 2]
            rows[5, i] = rotation[b, i, 2]
        else:
            rows[4, i] = rotation[b, i, 2]
            rows[5, 3 + i] = rotation[b, i, 2]


@kernel
def _carry(arm: Vector, inverse: Floats, out: Floats) -> None:
    """Move a parent's W to a child's origin: X W, X = [[1, 0], [-[arm]x, 1]]."""
    for j in range(6):
        x, y, z = cross(arm, (inverse[0, j], inverse[1, j], inverse[2, j]))
        out[0, j], out[1, j], out[2, j] = inverse[0, j], inverse[1, j], inverse[2, j]
        out[3, j], out[4, j], out[5, j] = inverse[3, j] - x, inverse[4, j] - y, inverse[5, j] - z


@kernel
def _eliminate(
    links: Integers, n_hard: Integers, soft: Floats, bodies: Floats, rotation: Floats, origin: Floats,
    inverse: Floats, factor: Floats, gain: Floats,
) -> int:  # fmt: skip
    """Return the first body whose block fails, or -1. Overwrite ``inverse``."""
    rows, carried, relative = np.empty((6, 6)), np.zeros((6, 6)), np.empty((6, 6))
    for b in range(len(bodies) - 1, -1, -1):
        p, m = links[b, PARENT], n_hard[b]
        _hard_rows(rotation, bodies, b, rows)
        relative[:] = inverse[b]
        if p >= 0:
            arm = algebra.lever(origin, b, p)
            _carry(arm, inverse[p], carried)
            for i in range(6):
                x, y, z = cross(arm, (carried[i, 0], carried[i, 1], carried[i, 2]))
                for j in range(3):
                    relative[i, j] += carried[i, j]
                relative[i, 3] += carried[i, 3] - x
                relative[i, 4] += carried[i, 4] - y
                relative[i, 5] += carried[i, 5] - z
        for i in range(m):
            for j in range(i + 1):
                factor[b, i, j] = 0.0
                for k in range(6):
                    for n in range(6):
                        factor[b, i, j] += rows[i, k] * relative[k, n] * rows[j, n]
        factor[b, 5, 5] += soft[b]
        if not cholesky(factor[b], m):
            return b
        if p >= 0:
            coupling = rows[:m] @ carried
            for j in range(6):
                column = coupling[:, j].copy()
                solve_lower(factor[b], m, column)
                solve_upper(factor[b], m, column)
                gain[b, :m, j] = column
            inverse[p] -= coupling.T @ gain[b, :m]
    return -1


@kernel
def _respond(
    links: Integers, n_hard: Integers, bodies: Floats, rotation: Floats, origin: Floats, inverse: Floats,
    factor: Floats, gain: Floats, impulse: Floats, twists: Floats,
) -> None:  # fmt: skip
    """Write the twists due to ``impulse`` and the reactions of the hinges."""
    n = len(bodies)
    rows, relative = np.empty((6, 6)), np.empty((1, 6))
    reaction, later = np.zeros((n, 6)), np.zeros((n, 6))
    for b in range(n):
        twists[b] = inverse[b] @ impulse[b]
    for b in range(n - 1, -1, -1):
        p, m = links[b, PARENT], n_hard[b]
        _hard_rows(rotation, bodies, b, rows)
        omega, u = _relative_twist(origin, twists, b, p)
        algebra.put_pair(omega, u, relative, 0)
        reaction[b, :m] = rows[:m] @ relative[0]
        if p >= 0:
            twists[p] += gain[b, :m].T @ reaction[b, :m]
        solve_lower(factor[b], m, reaction[b])
        solve_upper(factor[b], m, reaction[b])
    for b in range(n):
        # Reactions found so far act on the parent after this hinge's elimination: subtract their share.
        p, m = links[b, PARENT], n_hard[b]
        _hard_rows(rotation, bodies, b, rows)
        locked = -reaction[b, :m]
        if p >= 0:
            locked += gain[b, :m] @ later[p]
        load = rows[:m].T @ locked
        later[b] += load
        if p >= 0:
            moment, force = algebra.vector_at(load, 0), algebra.vector_at(load, 3)
            moment = add(moment, cross(algebra.lever(origin, b, p), force))
            algebra.add_pair(scale(-1.0, moment), scale(-1.0, force), later, p)
    for b in range(n):
        twists[b] = inverse[b] @ (impulse[b] + later[b])


@kernel
def _add_soft_loads(
    links: Integers, bodies: Floats, rotation: Floats, origin: Floats, tau: Floats, wrench: Floats
) -> None:
    """Add E_s^T tau: the torque of each hinge on its body, and the opposite on the parent."""
    for b in range(len(bodies)):
        p, k = links[b, PARENT], links[b, V]
        n_v = links[b + 1, V] - k
        if n_v == 6:
            wrench[b] += tau[k : k + 6]
        elif n_v == 1:
            axis = scale(tau[k], algebra.hinge_axis(rotation, b))
            if bodies[b, TURN] != 0.0:
                moment, force = axis, (0.0, 0.0, 0.0)
            else:
                moment, force = (0.0, 0.0, 0.0), axis
            algebra.add_pair(moment, force, wrench, b)
            if p >= 0:
                moment = add(moment, cross(algebra.lever(origin, b, p), force))
                algebra.add_pair(scale(-1.0, moment), scale(-1.0, force), wrench, p)


@kernel
def _soft_rates(
    links: Integers, bodies: Floats, rotation: Floats, origin: Floats, twists: Floats, rates: Floats
) -> None:
    for b in range(len(bodies)):
        p, k = links[b, PARENT], links[b, V]
        n_v = links[b + 1, V] - k
        if n_v == 6:
            rates[k : k + 6] = twists[b]
        elif n_v == 1:
            omega, u = _relative_twist(origin, twists, b, p)
            axis = algebra.hinge_axis(rotation, b)
            rates[k] = dot(axis, omega) if bodies[b, TURN] != 0.0 else dot(axis, u)


@kernel
def _relative_twist(origin: Floats, twists: Floats, b: int, p: int) -> tuple[Vector, Vector]:
    """Twist of body b relative to its parent p, about the origin of b."""
    omega, u = algebra.pair(twists, b)
    if p >= 0:
        above, moving = algebra.pair(twists, p)
        moving = add(moving, cross(above, algebra.lever(origin, b, p)))
        omega, u = subtract(omega, above), subtract(u, moving)
    return omega, u
