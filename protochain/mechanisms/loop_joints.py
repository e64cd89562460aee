"""Joints that close loops: errors, rows of these on the twists, accelerations, and equations of motion."""

from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from protochain.core.arrays import Floats, Integers, read_only
from protochain.core.errors import Fault
from protochain.mechanics.motion.system import Equations, Phase, StepTooLargeError
from protochain.mechanics.multibody import algebra
from protochain.mechanics.multibody.algebra import ZERO, Vector, add, cross, dot, kernel, scale, subtract
from protochain.mechanics.multibody.articulated import Articulated, solve
from protochain.mechanics.multibody.kinematics import Frames, end_of, outward_twists, pull_back, velocities
from protochain.mechanics.multibody.newton_euler import AT_REST, Motion, carried_along, motion_of, put_motions
from protochain.mechanics.multibody.operational import Rows, row_matrix
from protochain.mechanics.multibody.rotations import hinge_accelerations
from protochain.mechanics.multibody.tree import Tree
from protochain.mechanisms.loop_factors import DEPENDENT, factor_loops_at, find_fronts, least_impulses

CLOSED = 1e-12
"""Largest error of a loop after a step, in cosines and sizes of the tree: a thousand times rounding."""
ITERATIONS = 20


@dataclass(frozen=True, eq=False)
class LoopJoints:
    """Scalar equations between two bodies each, all zero for closed loops.

    A turn is the cosine of the angle between a direction of the first body and one of the second. A slide is
    the component of the way from a point of the first body to one of the second, along a direction of the
    first. They may depend on each other, as three of the five of a revolute joint in the plane do.
    """

    body: Integers  # (m, 2) int: Bodies; -1 for the world.
    turns: np.ndarray  # (m,) bool: Whether the equation is a turn.
    point: Floats  # (m, 2, 3): Points, in the frames of their bodies.
    along: Floats  # (m, 2, 3): Directions, in the frames of their bodies; the second is not read of a slide.
    # Number of independent equations where the loops are closed, if it is larger nearby; else None.
    rank: int | None = None
    _fronts: dict[str, Any] = field(default_factory=dict, init=False, repr=False)

    def __post_init__(self) -> None:
        for name, dtype in (("body", np.int64), ("turns", np.bool_), ("point", float), ("along", float)):
            object.__setattr__(self, name, read_only(getattr(self, name), dtype))

    def rows(self, frames: Frames) -> tuple[Floats, Rows]:
        """(m,) float: errors, in lengths and cosines, and their rates as rows on the twists of the bodies."""
        error, wrench = np.empty(len(self.body)), np.zeros((len(self.body), 2, 6))
        put_rows(frames.rotation, frames.origin, self.body, self.turns, self.point, self.along, error, wrench)
        return error, Rows(self.body, wrench)

    def fronts(self, tree: Tree) -> tuple[Any, ...]:
        """Order in which :func:`factor_loops_at` eliminates the equations."""
        saved = self._fronts.get("of")
        if saved is None or saved[0] is not tree:
            saved = self._fronts["of"] = tree, tuple(find_fronts(tree.locked_links, self.body))
        fronts: tuple[Any, ...] = saved[1]
        return fronts

    def matrix(self, tree: Tree, frames: Frames) -> Floats:
        """(m, n_v) float: derivatives of the errors by the freedoms, in radians and sizes of the tree."""
        rates = row_matrix(tree, frames, self.rows(frames)[1]) * tree.units
        return np.asarray(rates / np.where(self.turns, 1.0, tree.size)[:, None])

    def accelerations(self, tree: Tree, frames: Frames, qd: Floats, qdd: Floats) -> Floats:
        """(m,) float: second derivatives of the errors by time, of a motion."""
        accelerations: Floats = bends(
            tree.links, tree.bodies, frames.rotation, frames.origin, self.body, self.turns, self.point,
            self.along, qd, hinge_accelerations(tree, qd, qdd),
        )  # fmt: skip
        return accelerations


def least_change(matrix: Floats, target: Floats) -> Floats:
    """Least x with matrix x = target, for a matrix in radians and sizes, without its rounding."""
    left, sizes, right = np.linalg.svd(matrix, full_matrices=False)
    counts = sizes > DEPENDENT * max(1.0, np.max(sizes, initial=0.0))
    return np.asarray(right[counts].T @ ((left.T @ target)[counts].T / sizes[counts]).T)


@dataclass(frozen=True, eq=False)
class FactoredLoops:
    """Loop joints at one pose, with their factors."""

    factors: Articulated  # Rigid bodies, their frames, and factors of M there.
    error: Floats  # (m,): Errors of the joints.
    rows: Rows  # Rates of these.
    # (m,): Factors that scale the rows Y of G M^-1/2 to a length of one, 0 if no motion changes them.
    scales: Floats
    lengths: Floats  # (m,): Lengths of rows, by what they could be.
    # (r, k): Y = C Q, with r orthonormal rows Q; of column p of C the rows from spans[p, 0] to spans[p, 1].
    # The rows ``order`` (r,) of C are lower triangular.
    columns: Floats
    spans: Integers
    order: Integers
    rank: int | None  # As of :class:`LoopJoints`.

    def rates(self, qd: Floats) -> Floats:
        """(m,) float: rates of the errors at velocities (n_v,)."""
        twists = velocities(self.factors.tree, self.factors.frames, qd)
        # Wrenches of the world, body -1, are zero.
        return np.asarray(np.einsum("mei,mei->m", self.rows.wrench, twists[self.rows.body]))

    @property
    def coefficients(self) -> Floats:
        """(m, r) float: C."""
        out = np.zeros((len(self.scales), len(self.order)))
        for p, (start, end) in enumerate(self.spans):
            out[start:end, p] = self.columns[p, : end - start]
        return out

    def impulses(self, target: Floats) -> Floats:
        """Impulses (m,) of the joints that change the rates of the errors by ``target`` (m,)."""
        if self.rank is None:
            impulses: Floats = least_impulses(self.scales, self.columns, self.spans, self.order, target)
            return impulses
        # Of a matrix of the rank of closed loops, which counts what an equation changes by what it could.
        scales, weighted = self.scales * self.lengths, self.coefficients * self.lengths[:, None]
        left, sizes, _ = (part[..., : self.rank] for part in np.linalg.svd(weighted))
        return np.asarray(scales * (left @ (left.T @ (scales * target) / sizes**2)))

    def wrenches(self, impulses: Floats) -> Floats:
        """Impulses of the joints (m,) as wrenches on the bodies, (nb, 6)."""
        out = np.zeros((self.factors.tree.n_bodies, 6))
        gather(self.rows.body, self.rows.wrench, impulses, out)
        return out

    def change(self, target: Floats) -> Floats:
        """Change of velocities (n_v,), of least kinetic energy, that changes the rates by ``target`` (m,)."""
        wrenches = self.wrenches(self.impulses(target))
        return solve(self.factors, np.zeros(self.factors.tree.n_v), -wrenches)


def factor_loops(factors: Articulated, joints: LoopJoints) -> FactoredLoops:
    """Factorise loop joints at one pose."""
    tree, frames = factors.tree, factors.frames
    error, rows = joints.rows(frames)
    parts = factor_loops_at(
        tree.locked_links, tree.bodies, frames.rotation, frames.origin, factors.gain, factors.pivot,
        factors.root, rows.body, rows.wrench, tree.size, joints.fronts(tree),
    )  # fmt: skip
    return FactoredLoops(factors, error, rows, *parts, joints.rank)


@dataclass(frozen=True, eq=False)
class ClosedEquations(Equations):
    """Forest of rigid bodies with loops, whose joints constrain accelerations, velocities and places.

    Parameters
    ----------
    tree : Tree
        Rigid bodies.
    potential : callable
        Energy and torques at q.
    loads, drive : tuple of Load, and callable, optional
        As of :class:`Equations`.
    joints : LoopJoints
        Joints that close the loops.

    Notes
    -----
    Accelerations are those without loops plus the effect of the joints' least forces (Gauss's principle). The
    projections after a step are smallest by the kinetic energy, so that neither lets the loops drift.
    """

    beyond: ClassVar[str] = "closed loops"

    joints: LoopJoints = field(kw_only=True)

    def prescribe(self, time: float, q: Floats, qd: Floats) -> tuple[Floats, Floats, Articulated]:
        """Coordinates, velocities and factors, with the loops closed.

        Raises
        ------
        StepTooLargeError
            If no coordinates nearby close them.
        """
        q, qd, factors = super().prescribe(time, q, qd)
        units = np.where(self.joints.turns, 1.0, self.tree.size)
        for _ in range(ITERATIONS):
            loops = factor_loops(factors, self.joints)
            gap = float(np.max(np.abs(loops.error) / units))
            if not gap > CLOSED:
                return q, qd - loops.change(loops.rates(qd)), factors
            q = self.integrate(q, -loops.change(loops.error))
            factors = self.factors(q)
        raise StepTooLargeError(f"a loop does not close: gap {gap:.2g} of its size", fault=Fault.OPEN)

    def constrain(self, qd: Floats, qdd: Floats, factors: Articulated) -> tuple[Floats, Floats]:
        """Accelerations (n_v,) with the loops closed, and the torques (n_v,) of their joints."""
        loops = factor_loops(factors, self.joints)
        impulses = loops.impulses(-self.joints.accelerations(self.tree, factors.frames, qd, qdd))
        torques = pull_back(self.tree, factors.frames, loops.wrenches(impulses))
        return qdd + solve(factors, torques), torques

    def with_velocities(self, at: Phase, qd: Floats) -> Phase:
        """Return the phase with other velocities, projected on the loops, except at driven hinges."""
        return self.at(at.q, qd, at.time, at.work)


@kernel
def gather(body: Integers, wrench: Floats, x: Floats, out: Floats) -> None:
    """Add wrenches on the bodies, times x."""
    for i in range(len(body)):
        for side in range(2):
            if body[i, side] >= 0:
                moment, force = algebra.pair(wrench[i], side)
                algebra.add_pair(scale(x[i], moment), scale(x[i], force), out, body[i, side])


@kernel
def put_rows(
    rotation: Floats, origin: Floats, body: Integers, turns: np.ndarray, point: Floats, along: Floats,
    error: Floats, wrench: Floats,
) -> None:  # fmt: skip
    """Write errors, and the rows of their rates, nothing for the world."""
    for i in range(len(body)):
        a, b = body[i, 0], body[i, 1]
        s, _ = end_of(rotation, origin, a, algebra.vector(along[i], 0))
        if turns[i]:
            t, _ = end_of(rotation, origin, b, algebra.vector(along[i], 1))
            error[i] = dot(s, t)
            moment = cross(t, s)
            first, second, force = scale(-1.0, moment), moment, ZERO
        else:
            arm_a, from_ = end_of(rotation, origin, a, algebra.vector(point[i], 0))
            arm_b, to = end_of(rotation, origin, b, algebra.vector(point[i], 1))
            way = subtract(to, from_)
            error[i], force = dot(way, s), s
            # The direction turns with the first body.
            first, second = cross(s, add(arm_a, way)), cross(arm_b, s)
        if a >= 0:
            algebra.put(first, wrench[i], 0, 0)
            algebra.put(scale(-1.0, force), wrench[i], 0, 3)
        if b >= 0:
            algebra.put(second, wrench[i], 1, 0)
            algebra.put(force, wrench[i], 1, 3)


@kernel
def bends(
    links: Integers, bodies: Floats, rotation: Floats, origin: Floats, body: Integers, turns: np.ndarray,
    point: Floats, along: Floats, qd: Floats, qdd: Floats,
) -> Floats:  # fmt: skip
    """Second derivatives of the errors: of s . t, and of way . s."""
    n, out = len(bodies), np.empty(len(body))
    motions, twists = np.empty((n, 9)), np.empty((n, 6))
    outward_twists(links, bodies, rotation, origin, qd, twists)
    put_motions(links, bodies, rotation, origin, qd, qdd, motions)
    for i in range(len(body)):
        a, b = body[i, 0], body[i, 1]
        motion_a = motion_of(motions, a) if a >= 0 else AT_REST
        motion_b = motion_of(motions, b) if b >= 0 else AT_REST
        s, _ = end_of(rotation, origin, a, algebra.vector(along[i], 0))
        s_rate, s_bend = _turning(motion_a, s)
        if turns[i]:
            t, _ = end_of(rotation, origin, b, algebra.vector(along[i], 1))
            t_rate, t_bend = _turning(motion_b, t)
            out[i] = dot(s_bend, t) + 2.0 * dot(s_rate, t_rate) + dot(s, t_bend)
            continue
        arm_a, from_ = end_of(rotation, origin, a, algebra.vector(point[i], 0))
        arm_b, to = end_of(rotation, origin, b, algebra.vector(point[i], 1))
        speed_a = algebra.vector(twists, a, 3) if a >= 0 else ZERO
        speed_b = algebra.vector(twists, b, 3) if b >= 0 else ZERO
        end_a, end_b = add(speed_a, cross(motion_a[0], arm_a)), add(speed_b, cross(motion_b[0], arm_b))
        parting = subtract(end_b, end_a)
        _, _, curved_a = carried_along(motion_a, arm_a)
        _, _, curved_b = carried_along(motion_b, arm_b)
        way = subtract(to, from_)
        out[i] = dot(subtract(curved_b, curved_a), s) + 2.0 * dot(parting, s_rate) + dot(way, s_bend)
    return out


@kernel
def _turning(motion: Motion, fixed: Vector) -> tuple[Vector, Vector]:
    """First and second derivative of a direction fixed in a body."""
    omega, alpha, _ = motion
    rate = cross(omega, fixed)
    return rate, add(cross(alpha, fixed), cross(omega, rate))
