"""Joints that close loops: their errors, the rows of these on the twists, and what velocities add."""

from dataclasses import dataclass

import numpy as np

from protochain.core.arrays import Floats, Integers, read_only
from protochain.core.errors import MechanicsError
from protochain.mechanics.multibody.algebra import (
    ZERO,
    Vector,
    add,
    add_pair,
    cross,
    dot,
    hinge_axis,
    kernel,
    lever,
    matrix,
    pair,
    put,
    scale,
    subtract,
    turned,
    vector,
)  # fmt: skip
from protochain.mechanics.multibody.articulated import Articulated, solve
from protochain.mechanics.multibody.kinematics import Frames, outward_twists, velocities
from protochain.mechanics.multibody.newton_euler import AT_REST, Motion, carried_along, motion_of, put_motions
from protochain.mechanics.multibody.operational import Rows
from protochain.mechanics.multibody.rotations import hinge_accelerations
from protochain.mechanics.multibody.small import solve_lower
from protochain.mechanics.multibody.tree import PARENT, SLIDE, TURN, Q, Tree, V

_PROXIMAL = 1e-7
"""e, added to a diagonal of one: far above rounding, so small that few iterations take it off."""
_ITERATIONS = 100
_NOTHING = 1e-14
"""Of what is left of an equation, and of the square of what changes none, relative to what there was."""
_IMMOVABLE = 1e-24
"""Square of what rounding leaves of an equation that no motion changes, by its size."""


@dataclass(frozen=True, eq=False)
class LoopJoints:
    """Scalar equations between two bodies each, all zero where the loops are closed.

    A turn is the cosine of the angle between a direction of the first body and one of the second; a slide is
    the component of the way from a point of the first body to one of the second, along a direction of the
    first. They may depend on each other, as three of the five of a revolute joint in the plane do.
    """

    body: Integers  # (m, 2) int: Bodies; -1 for the world.
    turns: np.ndarray  # (m,) bool: Whether the equation is a turn.
    point: Floats  # (m, 2, 3): Points, in the frames of their bodies.
    along: Floats  # (m, 2, 3): Directions, in the frames of their bodies; the second is not read of a slide.
    # Number of independent equations where the loops are closed, if it is larger nearby; else None.
    rank: int | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "body", read_only(self.body, np.int64))
        object.__setattr__(self, "turns", read_only(self.turns, np.bool_))
        object.__setattr__(self, "point", read_only(self.point))
        object.__setattr__(self, "along", read_only(self.along))

    def rows(self, frames: Frames) -> tuple[Floats, Rows]:
        """(m,) float: errors, in lengths and cosines; their rates as rows on the twists of the bodies."""
        error, wrench = np.empty(len(self.body)), np.zeros((len(self.body), 2, 6))
        put_rows(frames.rotation, frames.origin, self.body, self.turns, self.point, self.along, error, wrench)
        return error, Rows(self.body, wrench)

    def accelerations(self, tree: Tree, frames: Frames, qd: Floats, qdd: Floats) -> Floats:
        """(m,) float: second derivatives of the errors by time, of a motion."""
        found: Floats = bends(
            tree.links, tree.bodies, frames.rotation, frames.origin, self.body, self.turns, self.point,
            self.along, qd, hinge_accelerations(tree, qd, qdd),
        )  # fmt: skip
        return found


@dataclass(frozen=True, eq=False)
class FactoredLoops:
    """Loop joints at one pose, and what holds them."""

    factors: Articulated  # Rigid bodies, their frames, and factors of M there.
    error: Floats  # (m,): Errors of the joints.
    rows: Rows  # Rates of these.
    scales: Floats  # (m,): What scales A = G M^-1 G^T to a diagonal of one.
    inverse: Floats  # inverse, factor: (m, m): A, scaled; Cholesky's factor of A + e, the upper.
    factor: Floats
    last: Integers  # (m,) int: One past the last number of each row of the factor that is not zero.
    rank: int | None  # As of :class:`LoopJoints`.

    def rates(self, qd: Floats) -> Floats:
        """(m,) float: rates of the errors at velocities (n_v,)."""
        twists = velocities(self.factors.tree, self.factors.frames, qd)
        # Wrenches of the world, body -1, are zero.
        return np.asarray(np.einsum("mei,mei->m", self.rows.wrench, twists[self.rows.body]))

    def impulses(self, wanted: Floats) -> Floats:
        """Impulses (m,) of the joints that change the rates of the errors by (m,) wanted."""
        # Those of joints that depend on others have the least norm.
        # x <- x + (A + e)^-1 (b - A x) until nothing is left, the proximal method (of mechanisms: Carpentier,
        # Budhiraja, Mansard, RSS 2021), by conjugate gradients (Saad, Iterative Methods, 2003, algorithm
        # 9.1), which need no more iterations than A has eigenvalues below e. At constant rank by
        # eigenvectors.
        if self.rank is not None:
            values, vectors = (part[..., -self.rank :] for part in np.linalg.eigh(self.inverse))
            return np.asarray(self.scales * (vectors @ (vectors.T @ (self.scales * wanted) / values)))
        x = proximal(self.inverse, self.factor, self.last, self.scales * wanted)
        if not np.all(np.isfinite(x)) and np.all(np.isfinite(wanted)):
            values = np.linalg.eigvalsh(self.inverse)
            worst = values[-1] / values[values > _NOTHING][0]
            raise MechanicsError(
                f"the forces of loops are not found: the condition number of their equations is {worst:.1g}; "
                "shorten the chain of loops, or close some by bushings"
            )
        return np.asarray(self.scales * x)

    def wrenches(self, impulses: Floats) -> Floats:
        """Impulses of the joints (m,) as those on the bodies, (nb, 6)."""
        out = np.zeros((self.factors.tree.n_bodies, 6))
        gather(self.rows.body, self.rows.wrench, impulses, out)
        return out

    def change(self, wanted: Floats) -> Floats:
        """Change of velocities (n_v,), of least kinetic energy, that changes the rates by (m,) wanted."""
        wrenches = self.wrenches(self.impulses(wanted))
        return solve(self.factors, np.zeros(self.factors.tree.n_v), -wrenches)


def factor_loops(factors: Articulated, joints: LoopJoints) -> FactoredLoops:
    """Find what holds loop joints at one pose."""
    # With M^-1 = [1 - H psi K]^T D^-1 [1 - H psi K], A = Y^T D^-1 Y, and the column y of a joint has but the
    # freedoms on the paths from its bodies to the root. A is dense, O(m^2); its factor, O(m^3) at most, is a
    # band where loops follow each other in the order of the tree.
    tree, frames = factors.tree, factors.frames
    error, rows = joints.rows(frames)
    found = factor_loops_at(
        tree.locked_links, tree.bodies, frames.rotation, frames.origin, factors.gain, factors.pivot,
        factors.root, rows.body, rows.wrench, tree.size,
    )  # fmt: skip
    return FactoredLoops(factors, error, rows, *found, joints.rank)


@kernel
def factor_loops_at(
    links: Integers, bodies: Floats, rotation: Floats, origin: Floats, gain: Floats, pivot: Floats,
    root: Floats, body: Integers, wrench: Floats, size: float,
) -> tuple[Floats, Floats, Floats, Integers]:  # fmt: skip
    """Scales, inverse, factor and last of :class:`FactoredLoops`."""
    m, n_v = len(body), links[-1, V]
    y, first, past = np.zeros((m, n_v)), np.full(m, n_v), np.zeros(m, np.int64)
    for i in range(m):
        # Of y, as large as it could be: what is left of less is rounding, and the equation nobody's to move.
        # Loads of both bodies go their ways alone, since those of bodies that are fixed to each other cancel.
        most = 0.0
        for side in range(2):
            moment, force = pair(wrench[i], side)
            b = body[i, side]
            while b >= 0:
                k = links[b, V]
                width = links[b + 1, V] - k
                if width > 0:
                    first[i], past[i] = min(first[i], k), max(past[i], k + width)
                if width == 6:
                    x = np.array([moment[0], moment[1], moment[2], force[0], force[1], force[2]])
                    solve_lower(root[links[b, Q] - k], 6, x)
                    y[i, k : k + 6] += x
                    most += np.dot(x, x)
                along = 0.0
                if width == 1:
                    axis = hinge_axis(rotation, b)
                    along = bodies[b, TURN] * dot(axis, moment) + bodies[b, SLIDE] * dot(axis, force)
                    y[i, k] += along / np.sqrt(pivot[b])
                    turn, slide = bodies[b, TURN] * bodies[b, TURN], bodies[b, SLIDE] * bodies[b, SLIDE]
                    push = dot(force, force)
                    most += (turn * (dot(moment, moment) + size * size * push) + slide * push) / pivot[b]
                p = links[b, PARENT]
                if p >= 0:
                    moment = add(moment, cross(lever(origin, b, p), force))
                    g, h = pair(gain, b)
                    moment, force = subtract(moment, scale(along, g)), subtract(force, scale(along, h))
                b = p
        if np.dot(y[i], y[i]) <= _IMMOVABLE * most:
            y[i] = 0.0
    inverse = np.zeros((m, m))
    for i in range(m):
        for j in range(i, m):
            for k in range(max(first[i], first[j]), min(past[i], past[j])):
                inverse[i, j] += y[i, k] * y[j, k]
    scales = np.ones(m)
    for i in range(m):
        if inverse[i, i] > 0.0:
            scales[i] = 1.0 / np.sqrt(inverse[i, i])
    for i in range(m):
        for j in range(i, m):
            inverse[i, j] *= scales[i] * scales[j]
            inverse[j, i] = inverse[i, j]
    factor, last = inverse.copy(), np.empty(m, np.int64)
    for i in range(m):
        factor[i, i] += _PROXIMAL
        last[i] = i + 1
        for j in range(i + 1, m):
            if factor[i, j] != 0.0:
                last[i] = j + 1
    _factorise(factor, last)
    return scales, inverse, factor, last


@kernel
def _factorise(a: Floats, last: Integers) -> None:
    """Overwrite the upper triangle of a by U with U^T U = a, by rows; ``last`` grows where U fills in."""
    for k in range(len(a)):
        a[k, k] = np.sqrt(a[k, k])
        for j in range(k + 1, last[k]):
            a[k, j] /= a[k, k]
        for i in range(k + 1, last[k]):
            part = a[k, i]
            if part != 0.0:
                last[i] = max(last[i], last[k])
                for j in range(i, last[k]):
                    a[i, j] -= part * a[k, j]


@kernel
def _solve(factor: Floats, last: Integers, x: Floats) -> None:
    """Overwrite x by what U^T U = factor makes it of."""
    n = len(x)
    for k in range(n):
        x[k] /= factor[k, k]
        for j in range(k + 1, last[k]):
            x[j] -= factor[k, j] * x[k]
    for k in range(n - 1, -1, -1):
        for j in range(k + 1, last[k]):
            x[k] -= factor[k, j] * x[j]
        x[k] /= factor[k, k]


@kernel
def proximal(a: Floats, factor: Floats, last: Integers, b: Floats) -> Floats:
    """Least x with a x = b, of which ``factor`` has that of a + e; no numbers if it is not found."""
    n = len(b)
    x, left, way, moved = np.zeros(n), b.copy(), np.zeros(n), np.empty(n)
    before, largest = 1.0, np.max(np.abs(b))
    for _ in range(_ITERATIONS):
        step = left.copy()
        _solve(factor, last, step)
        now = np.dot(step, left)
        way *= now / before
        way += step
        # The factor has no fewer numbers than a.
        for k in range(n):
            moved[k] = a[k, k] * way[k]
        for k in range(n):
            for j in range(k + 1, last[k]):
                moved[k] += a[k, j] * way[j]
                moved[j] += a[k, j] * way[k]
        along = np.dot(way, moved)
        # What is left is a rate that no impulse changes.
        if not along > _NOTHING * np.dot(way, way):
            return x
        x += now / along * way
        left -= now / along * moved
        before = now
        if np.max(np.abs(left)) <= _NOTHING * max(largest, np.max(np.abs(x))):
            return x
    return np.full(n, np.nan)


@kernel
def gather(body: Integers, wrench: Floats, x: Floats, out: Floats) -> None:
    """Add wrenches on the bodies, times x."""
    for i in range(len(body)):
        for side in range(2):
            if body[i, side] >= 0:
                out[body[i, side]] += x[i] * wrench[i, side]


@kernel
def _end(rotation: Floats, origin: Floats, b: int, at: Vector) -> tuple[Vector, Vector]:
    """Arm and place of a point of a body, or of the world."""
    if b < 0:
        return at, at
    arm = turned(matrix(rotation, b), at)
    return arm, add(vector(origin, b), arm)


@kernel
def put_rows(
    rotation: Floats, origin: Floats, body: Integers, turns: np.ndarray, point: Floats, along: Floats,
    error: Floats, wrench: Floats,
) -> None:  # fmt: skip
    """Write errors, and the rows of their rates; nothing for the world."""
    for i in range(len(body)):
        a, b = body[i, 0], body[i, 1]
        s, _ = _end(rotation, origin, a, vector(along[i], 0))
        if turns[i]:
            t, _ = _end(rotation, origin, b, vector(along[i], 1))
            error[i] = dot(s, t)
            moment = cross(t, s)
            first, second, force = scale(-1.0, moment), moment, ZERO
        else:
            arm_a, from_ = _end(rotation, origin, a, vector(point[i], 0))
            arm_b, to = _end(rotation, origin, b, vector(point[i], 1))
            way = subtract(to, from_)
            error[i], force = dot(way, s), s
            # The direction turns with the first body.
            first, second = cross(s, add(arm_a, way)), cross(arm_b, s)
        if a >= 0:
            put(first, wrench[i], 0, 0)
            put(scale(-1.0, force), wrench[i], 0, 3)
        if b >= 0:
            put(second, wrench[i], 1, 0)
            put(force, wrench[i], 1, 3)


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
        s, _ = _end(rotation, origin, a, vector(along[i], 0))
        s_rate, s_bend = _turning(motion_a, s)
        if turns[i]:
            t, _ = _end(rotation, origin, b, vector(along[i], 1))
            t_rate, t_bend = _turning(motion_b, t)
            out[i] = dot(s_bend, t) + 2.0 * dot(s_rate, t_rate) + dot(s, t_bend)
            continue
        arm_a, from_ = _end(rotation, origin, a, vector(point[i], 0))
        arm_b, to = _end(rotation, origin, b, vector(point[i], 1))
        speed_a = vector(twists, a, 3) if a >= 0 else ZERO
        speed_b = vector(twists, b, 3) if b >= 0 else ZERO
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
