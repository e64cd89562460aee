"""M^-1 in O(n) by articulated bodies: hinges are eliminated one by one from the leaves to the root.

Featherstone (1983). Jain, Vaidehi, Rodriguez, J. Comput. Phys. 106:258 (1993), whose factors are
M = [1 + H phi K] D [1 + H phi K]^T and M^-1 = [1 - H psi K]^T D^-1 [1 - H psi K].
"""

from dataclasses import dataclass

import numpy as np

from protochain.core.arrays import Floats, Integers, floats, freeze
from protochain.core.errors import BodyError
from protochain.mechanics.multibody import algebra
from protochain.mechanics.multibody.algebra import ZERO, Vector, add, cross, dot, kernel, scale
from protochain.mechanics.multibody.kinematics import Frames
from protochain.mechanics.multibody.massless import find_slack
from protochain.mechanics.multibody.small import cholesky, dense_inertia, solve_lower, solve_upper
from protochain.mechanics.multibody.tree import ARMATURE, PARENT, SLIDE, TURN, HingeKind, Q, Tree, V

ROUND_OFF = 1e-15
"""A pivot below this fraction of the trace of its articulated inertia is rounding error."""


@dataclass(frozen=True, eq=False)
class Articulated:
    """Factors of M at one pose."""

    tree: Tree  # tree, frames: Rigid bodies and their world frames.
    frames: Frames
    # (nb, 21): Articulated-body inertia P = [[I, C], [C^T, M]] of each body about its origin along world
    # axes, with its own hinge locked: upper triangle of I, C row by row, upper triangle of M.
    inertia: Floats
    # (nb, 6): Gain G = P h / D, with h the hinge's twist, about the parent's origin (of a root: its own); 0
    # where the hinge is driven.
    gain: Floats
    # (nb,): Pivot D = h^T P h plus the armature; 1 where there is no hinge, or a driven one.
    pivot: Floats
    root: Floats  # (n_free, 6, 6): Cholesky factors of P of the free roots, plus their armature.


def articulate(tree: Tree, frames: Frames) -> Articulated:
    """Factorise M at one pose, by one inward sweep."""
    # After Jain, Vaidehi, Rodriguez (1993); Featherstone (2008). O(n).
    n = tree.n_bodies
    packed, gain, pivot = np.empty((n, 21)), np.empty((n, 6)), np.empty(n)
    root = np.empty((tree.n_q - tree.n_v, 6, 6))
    put_rigid(frames.rotation, tree.bodies, packed)
    failed = factorise(
        tree.locked_links, tree.bodies, frames.rotation, frames.origin, packed, gain, pivot, root,
        np.zeros((n, 6)), np.zeros(tree.n_v),
    )  # fmt: skip
    refuse_singular(failed, frames.rotation)
    if tree.driven is not None:
        gain[tree.driven] = 0.0
    if len(tree.massless):
        refuse_singular(
            find_slack(tree.locked_links, tree.bodies, frames.rotation, frames.origin, packed, pivot, root),
            frames.rotation,
        )
    return Articulated(tree, frames, freeze(packed), freeze(gain), freeze(pivot), freeze(root))


def solve(factors: Articulated, tau: Floats, loads: Floats | None = None) -> Floats:
    """Solve M x = tau - J^T loads by one inward and one outward sweep."""
    # tau (n_v,), loads (nb, 6) -> (n_v,): Solution, 0 where hinges are driven; what tau has there is not
    # read.
    tree, frames = factors.tree, factors.frames
    wrench = np.zeros((tree.n_bodies, 6)) if loads is None else loads.copy()
    x = floats(tau, (tree.n_v,), "tau").copy()
    if tree.driven is not None:
        x = x[tree.undriven_v]
    inward_loads(
        tree.locked_links, tree.bodies, frames.rotation, frames.origin, factors.gain, factors.pivot, wrench, x
    )
    outward_rates(
        tree.locked_links, tree.bodies, frames.rotation, frames.origin, factors.gain, factors.root, wrench, x
    )
    return x if tree.driven is None else _among_all(tree, x)


def _among_all(tree: Tree, x: Floats) -> Floats:
    """(n_v,) float: x, of the freedoms that are not driven, and zeros."""
    out = np.zeros(tree.n_v)
    out[tree.undriven_v] = x
    return out


def solve_at_once(tree: Tree, frames: Frames, tau: Floats) -> Floats:
    """Solve M x = tau for one tau: :func:`articulate` and :func:`solve` in one call: tau (n_v,) -> (n_v,)."""
    if not tree.is_plain:
        return solve(articulate(tree, frames), tau)
    return solve_for_bodies(tree, tree.bodies, frames, tau)


def solve_for_bodies(tree: Tree, bodies: Floats, frames: Frames, tau: Floats) -> Floats:
    """Solve M x = tau for another table of bodies, in the form of ``tree.bodies``: tau (n_v,) -> (n_v,).

    Masses and armatures may differ from the tree's, which has no driven hinges. O(n).
    """
    x = floats(tau, (tree.n_v,), "tau").copy()
    refuse_singular(_solve(tree.links, bodies, frames.rotation, frames.origin, x), frames.rotation)
    return x


def log_det(factors: Articulated) -> float:
    """Logarithm of det M: sum of ln D over hinges and of ln det P over free roots."""
    roots = np.diagonal(factors.root, axis1=1, axis2=2)
    return float(np.sum(np.log(factors.pivot)) + 2.0 * np.sum(np.log(roots)))


def sample(factors: Articulated, noise: Floats) -> Floats:
    """[1 - H psi K]^T D^-1/2 noise, whose covariance is M^-1 for independent unit noise."""
    # noise (n_v,) -> (n_v,): Sample, 0 where hinges are driven.
    # Outward sweep of a solution, for D^-1/2 noise: the rate of a hinge is its noise minus the gain times the
    # motion of its parent. After Jain, Vaidehi, Rodriguez (1993). O(n).
    tree, frames = factors.tree, factors.frames
    x = floats(noise, (tree.n_v,), "noise").copy()
    x[tree.v_start[tree.hinge_bodies]] /= np.sqrt(factors.pivot[tree.hinge_bodies])
    for factor, b in zip(factors.root, np.flatnonzero(tree.kind == HingeKind.FREE), strict=True):
        freedoms = slice(tree.v_start[b], tree.v_start[b + 1])
        x[freedoms] = np.tril(factor) @ x[freedoms]
    x = x[tree.undriven_v]
    outward_rates(
        tree.locked_links, tree.bodies, frames.rotation, frames.origin, factors.gain, factors.root,
        np.empty((tree.n_bodies, 6)), x,
    )  # fmt: skip
    return _among_all(tree, x)


def refuse_singular(failed: int, pose: Floats) -> None:
    """Raise MechanicsError if a sweep returned a body rather than -1. ``pose`` is q, or the rotations."""
    if failed >= 0 and not np.isfinite(pose).all():
        raise BodyError(
            failed,
            "its position is not finite; if it was finite before, the motion has diverged: use shorter steps",
        )
    if failed >= 0:
        raise BodyError(failed, "its hinge has no inertia at this pose, so accelerations are undefined")


@kernel
def put_rigid(rotation: Floats, bodies: Floats, packed: Floats) -> None:
    """Write the spatial inertia of each rigid body, from which :func:`factorise` starts."""
    for b in range(len(bodies)):
        rigid = algebra.rigid_inertia(algebra.matrix(rotation, b), bodies, b)
        algebra.put_inertia(algebra.add_rigid(algebra.MASSLESS, rigid), packed, b)


@kernel
def factorise(
    links: Integers, bodies: Floats, rotation: Floats, origin: Floats, packed: Floats, gain: Floats,
    pivot: Floats, root: Floats, wrench: Floats, x: Floats,
) -> int:  # fmt: skip
    """Factorise M. Return the first body whose hinge has no pivot, or -1. ``packed``, I_b, becomes P."""
    # From the leaves inward, with h_b the twist of hinge b and X_c what moves twists from b to its child c::
    #     P_b = I_b + sum over children c of X_c^T P_c+ X_c
    #     D_b = h_b^T P_b h_b + a_b,    G_b = P_b h_b / D_b,    P_b+ = P_b - G_b D_b G_b^T
    # An armature a_b is of the hinge alone (Featherstone 2008, section 9.6: a rotor at its gear ratio).
    # ``slow_articulated_inverse`` in tests/fixtures/slow_mechanics.py states the same in 6x6 matrices. One
    # right-hand side is carried inward as in :func:`inward_loads`, while the processor waits for the factors.
    # Inertia and gain are shifted to the parent's origin before the pivot is known, and stay in registers for
    # the parent.
    carried, moment_below, force_below = algebra.MASSLESS, ZERO, ZERO
    for b in range(len(bodies) - 1, -1, -1):
        p, k = links[b, PARENT], links[b, V]
        n_v = links[b + 1, V] - k
        articulated = algebra.add_inertias(algebra.inertia(packed, b), carried)
        algebra.put_inertia(articulated, packed, b)
        moment, force = algebra.pair(wrench, b)
        moment, force = add(moment, moment_below), add(force, force_below)
        arm = algebra.lever(origin, b, p) if p >= 0 else ZERO
        carried = algebra.shifted_inertia(articulated, arm)
        moment_below, force_below = add(moment, cross(arm, force)), force
        pivot[b] = 1.0
        if n_v == 1:
            axis = algebra.hinge_axis(rotation, b)
            turn, slide = bodies[b, TURN], bodies[b, SLIDE]
            i, c, m = articulated
            if slide == 0.0:
                # Most hinges only turn: half the work.
                g, h = algebra.symmetric_times(i, axis), algebra.rotate_back(c, axis)
                d, total_inertia = dot(axis, g), i[0] + i[3] + i[5]
            else:
                g, h = algebra.inertia_times(articulated, scale(turn, axis), scale(slide, axis))
                d = turn * dot(axis, g) + slide * dot(axis, h)
                total_inertia = turn * turn * (i[0] + i[3] + i[5]) + slide * slide * (m[0] + m[3] + m[5])
            if bodies[b, ARMATURE] > 0.0:
                d += bodies[b, ARMATURE]
            if not d > ROUND_OFF * total_inertia:
                return b
            pivot[b] = d
            inverse = 1.0 / d
            g = add(g, cross(arm, h))
            carried = algebra.minus_outer(carried, g, h, inverse)
            algebra.put_pair(scale(inverse, g), scale(inverse, h), gain, b)
            x[k] = inverse * (x[k] - (turn * dot(axis, moment) + slide * dot(axis, force)))
            moment_below, force_below = add(moment_below, scale(x[k], g)), add(force_below, scale(x[k], h))
        elif n_v == 6:
            # A free root has one coordinate more than freedoms, so this difference counts the free roots.
            factor = root[links[b, Q] - k]
            dense_inertia(packed[b], factor)
            for j in range(6):
                factor[j, j] += bodies[b, ARMATURE]
            if not cholesky(factor, 6):
                return b
            take_off(moment, force, x, k)
        if p != b - 1:
            if p >= 0:
                algebra.add_pair(moment_below, force_below, wrench, p)
                algebra.add_inertia(carried, packed, p)
            carried, moment_below, force_below = algebra.MASSLESS, ZERO, ZERO
    return -1


@kernel
def inward_loads(
    links: Integers, bodies: Floats, rotation: Floats, origin: Floats, gain: Floats, pivot: Floats,
    wrench: Floats, x: Floats,
) -> None:  # fmt: skip
    """Overwrite tau in ``x`` by the input of :func:`outward_rates`, and add loads to ``wrench``."""
    for b in range(len(bodies) - 1, -1, -1):
        p, k = links[b, PARENT], links[b, V]
        n_v = links[b + 1, V] - k
        moment, force = algebra.pair(wrench, b)
        arm = algebra.lever(origin, b, p) if p >= 0 else ZERO
        moment_below, force_below = add(moment, cross(arm, force)), force
        if n_v == 1:
            axis = algebra.hinge_axis(rotation, b)
            x[k] -= bodies[b, TURN] * dot(axis, moment) + bodies[b, SLIDE] * dot(axis, force)
            g, h = algebra.pair(gain, b)
            moment_below, force_below = add(moment_below, scale(x[k], g)), add(force_below, scale(x[k], h))
            x[k] /= pivot[b]
        elif n_v == 6:
            take_off(moment, force, x, k)
        if p >= 0:
            algebra.add_pair(moment_below, force_below, wrench, p)


@kernel
def take_off(moment: Vector, force: Vector, x: Floats, k: int) -> None:
    """Subtract a wrench from the six freedoms of a free root."""
    for i in range(3):
        x[k + i] -= moment[i]
        x[k + 3 + i] -= force[i]


@kernel
def outward_rates(
    links: Integers, bodies: Floats, rotation: Floats, origin: Floats, gain: Floats, root: Floats,
    motion: Floats, x: Floats,
) -> None:  # fmt: skip
    """Overwrite ``x``, from :func:`inward_loads`, by the solution. Write the motion of the bodies."""
    omega, u = ZERO, ZERO
    for b in range(len(bodies)):
        p, k = links[b, PARENT], links[b, V]
        n_v = links[b + 1, V] - k
        if p < 0:
            omega, u = ZERO, ZERO
        elif p != b - 1:
            omega, u = algebra.pair(motion, p)
        arm = algebra.lever(origin, b, p) if p >= 0 else ZERO
        carried = add(u, cross(omega, arm))
        if n_v == 1:
            g, h = algebra.pair(gain, b)
            rate = x[k] - (dot(g, omega) + dot(h, u))
            x[k] = rate
            axis = algebra.hinge_axis(rotation, b)
            omega = add(omega, scale(bodies[b, TURN] * rate, axis))
            carried = add(carried, scale(bodies[b, SLIDE] * rate, axis))
        elif n_v == 6:
            factor = root[links[b, Q] - k]
            solve_lower(factor, 6, x[k : k + 6])
            solve_upper(factor, 6, x[k : k + 6])
            omega, carried = (x[k], x[k + 1], x[k + 2]), (x[k + 3], x[k + 4], x[k + 5])
        u = carried
        algebra.put_pair(omega, u, motion, b)


@kernel
def accelerate(
    links: Integers, bodies: Floats, rotation: Floats, origin: Floats, packed: Floats, wrench: Floats,
    x: Floats,
) -> int:  # fmt: skip
    """Overwrite tau in ``x`` by M^-1 (tau - J^T wrench), factors and solution in one call."""
    n = len(bodies)
    gain, pivot = np.empty((n, 6)), np.empty(n)
    root = np.empty((links[n, Q] - links[n, V], 6, 6))
    failed = factorise(links, bodies, rotation, origin, packed, gain, pivot, root, wrench, x)
    if failed < 0:
        outward_rates(links, bodies, rotation, origin, gain, root, wrench, x)
    return failed


@kernel
def _solve(links: Integers, bodies: Floats, rotation: Floats, origin: Floats, x: Floats) -> int:
    packed = np.empty((len(bodies), 21))
    put_rigid(rotation, bodies, packed)
    return accelerate(links, bodies, rotation, origin, packed, np.zeros((len(bodies), 6)), x)
