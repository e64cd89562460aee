"""Bushings: elastic joints of six stiffnesses between two bodies."""

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from protochain.core.arrays import Floats, Integers, read_only
from protochain.core.checks import optional
from protochain.core.errors import Fault, MechanicsError
from protochain.core.settings import document_fields
from protochain.mechanics.multibody import Frames, algebra
from protochain.mechanics.multibody.algebra import ZERO, Vector, add, dot, kernel, scale, subtract
from protochain.mechanics.multibody.kinematics import WORLD, end_of
from protochain.mechanics.multibody.rotations import tangent_inverse
from protochain.mechanisms.bodies import Bodies
from protochain.mechanisms.element_arguments import not_negative, rotation_matrix
from protochain.mechanisms.elements import Acting, Between, Rows
from protochain.mechanisms.linear_springs import push, speed_of

HALF_A_TURN = 3.1
"""rad. Largest rotation of a bushing: at pi its rotation vector jumps to the other side."""


@document_fields
@dataclass(frozen=True, eq=False)
class Bushing(Between, noun="bushing"):
    """Elastic joint of two bodies, at rest if the points meet, turned as built.

    Its energy is (theta K_r theta + d K_t d) / 2 in the axes of the second body: theta is the rotation vector
    of the first body relative to the second, away from rest, and d the place of the first body's point from
    the second's. The gradient along a rotation omega is exp's tangent transposed, dexp_theta^-T K_r theta, so
    that the energy is exact for large rotations, up to half a turn.

    Raises
    ------
    MechanicsError
        If the name is already in use, or a constant is negative.
    """

    # (6,) float: Of three rotations, by the rotation vector of a in b, and three translations, in b's axes.
    stiffness: Any
    damping: Any = 0.0  # (6,) float: As the stiffness, by rates.
    # (3, 3) float, optional: Axes of b, as columns, in the axes of a, at which the bushing is at rest. By
    # default as built.
    rotation: Any = None

    def __post_init__(self) -> None:
        super().__post_init__()
        six = partial(not_negative, shape=(6,))
        self.check(rotation=optional(rotation_matrix), stiffness=six, damping=six)

    def bind(self, bodies: Bodies) -> Acting:
        """Return its wrenches."""
        ends, points = self.ends(bodies)
        a, b = ends[0].tolist()
        # The axes of b as they lie in a at rest.
        rest_rotation = self.rotation
        if rest_rotation is None:
            rest_rotation = bodies.built.rotation(self.a[0]).T @ bodies.built.rotation(self.b[0])
        row = Bushings(
            np.array([self.name]), ends, points, read_only([bodies.axes(a) @ rest_rotation]),
            read_only([bodies.axes(b)]), read_only([self.stiffness]), read_only([self.damping]),
        )  # fmt: skip
        elastic, damping = row if np.any(self.stiffness) else None, row if np.any(self.damping) else None
        return Acting(elastic, damping=damping, inside=bool(np.all(ends >= 0)))


@dataclass(frozen=True, eq=False)
class Bushings(Rows):
    """Bushings, bound."""

    names: np.ndarray  # (n,) str: Names, for messages.
    ends: Integers  # (n, 2) int: Bodies of each; -1 is the world.
    points: Floats  # (n, 6): Points of both bodies, along the axes of the tree's frames.
    # axes_a, axes_b: (n, 3, 3): Axes, as columns, in the tree's frame of each body, which coincide at rest.
    axes_a: Floats
    axes_b: Floats
    # stiffness, damping: (n, 6): Of rotations and translations along the second body's axes.
    stiffness: Floats
    damping: Floats

    def add(self, q: Floats, frames: Frames, wrenches: Floats, torques: Floats) -> float:
        """Add the wrenches of the springs."""
        rotation, origin = frames.rotation, frames.origin
        energy: float = bend_bushings(
            rotation, origin, self.ends, self.points, self.axes_a, self.axes_b, self.stiffness, wrenches
        )
        if energy < 0.0:
            raise MechanicsError(
                f'bushing "{self.names[round(-energy) - 1]}": at a rotation of half a turn its torque '
                "has no direction; use a hinge with a torsion for large rotations",
                fault=Fault.HALF_TURN,
            )
        return energy

    def resist(self, frames: Frames, twists: Floats, qd: Floats, wrenches: Floats, torques: Floats) -> None:
        """Add the wrenches of the dampers."""
        rotation, origin = frames.rotation, frames.origin
        resist_bushings(rotation, origin, twists, self.ends, self.points, self.axes_b, self.damping, wrenches)


@kernel
def axes_of(rotation: Floats, b: int, axes: algebra.Matrix) -> algebra.Matrix:
    """Axes fixed in a body, in the world, as rows of the result, so that ``turned`` resolves along them."""
    turn = algebra.matrix(rotation, b) if b >= 0 else WORLD[0]
    x = algebra.rotate(turn, (axes[0], axes[3], axes[6]))
    y = algebra.rotate(turn, (axes[1], axes[4], axes[7]))
    z = algebra.rotate(turn, (axes[2], axes[5], axes[8]))
    return x[0], x[1], x[2], y[0], y[1], y[2], z[0], z[1], z[2]


@kernel
def rotation_vector(r: algebra.Matrix) -> Vector:
    """Logarithm of a rotation, of an angle up to pi, by its quaternion."""
    trace = r[0] + r[4] + r[8]
    # Of the four, the largest component of the quaternion is found without cancellation.
    if trace >= max(r[0], max(r[4], r[8])):
        w, v = 1.0 + trace, (r[7] - r[5], r[2] - r[6], r[3] - r[1])
    elif r[0] >= max(r[4], r[8]):
        w, v = r[7] - r[5], (1.0 + r[0] - r[4] - r[8], r[1] + r[3], r[2] + r[6])
    elif r[4] >= r[8]:
        w, v = r[2] - r[6], (r[1] + r[3], 1.0 + r[4] - r[0] - r[8], r[5] + r[7])
    else:
        w, v = r[3] - r[1], (r[2] + r[6], r[5] + r[7], 1.0 + r[8] - r[0] - r[4])
    if w < 0.0:
        w, v = -w, scale(-1.0, v)
    half = np.sqrt(dot(v, v))
    if half < 1e-8 * w:
        return scale(2.0 / w, v)
    return scale(2.0 * np.arctan2(half, w) / half, v)


@kernel
def _turned_away(rotation: Floats, a: int, axes_a: algebra.Matrix, along: algebra.Matrix) -> Vector:
    """Rotation vector of a's axes in the axes of b, whose rows are ``along``."""
    rows = axes_of(rotation, a, axes_a)
    x = algebra.rotate(along, (rows[0], rows[1], rows[2]))
    y = algebra.rotate(along, (rows[3], rows[4], rows[5]))
    z = algebra.rotate(along, (rows[6], rows[7], rows[8]))
    return rotation_vector((x[0], y[0], z[0], x[1], y[1], z[1], x[2], y[2], z[2]))


@kernel
def bend_bushings(
    rotation: Floats, origin: Floats, ends: Integers, points: Floats, axes_a: Floats, axes_b: Floats,
    stiffness: Floats, wrenches: Floats,
) -> float:  # fmt: skip
    """Add the wrenches. Return the energy, or minus the number, from 1, of one at half a turn."""
    energy = 0.0
    for i in range(len(ends)):
        a, b = ends[i, 0], ends[i, 1]
        arm_a, place_a = end_of(rotation, origin, a, algebra.vector(points, i, 0))
        arm_b, place_b = end_of(rotation, origin, b, algebra.vector(points, i, 3))
        along = axes_of(rotation, b, algebra.matrix(axes_b, i))
        theta = _turned_away(rotation, a, algebra.matrix(axes_a, i), along)
        if dot(theta, theta) > HALF_A_TURN * HALF_A_TURN:
            return -1.0 - i
        gap = subtract(place_a, place_b)
        d = algebra.rotate(along, gap)
        k, s = algebra.vector(stiffness, i, 0), algebra.vector(stiffness, i, 3)
        moment = (k[0] * theta[0], k[1] * theta[1], k[2] * theta[2])
        force = (s[0] * d[0], s[1] * d[1], s[2] * d[2])
        energy += 0.5 * (dot(moment, theta) + dot(force, d))
        # The tangent at -theta is the transposed one.
        moment = algebra.rotate_back(along, tangent_inverse(scale(-1.0, theta), moment))
        force = algebra.rotate_back(along, force)
        _apply(scale(-1.0, moment), scale(-1.0, force), a, b, arm_a, add(arm_b, gap), wrenches)
    return energy


@kernel
def resist_bushings(
    rotation: Floats, origin: Floats, twists: Floats, ends: Integers, points: Floats, axes: Floats,
    damping: Floats, wrenches: Floats,
) -> None:  # fmt: skip
    """Add the wrenches of the dampers."""
    for i in range(len(ends)):
        a, b = ends[i, 0], ends[i, 1]
        arm_a, place_a = end_of(rotation, origin, a, algebra.vector(points, i, 0))
        arm_b, place_b = end_of(rotation, origin, b, algebra.vector(points, i, 3))
        # Where a's point is, both bodies have a velocity; their difference is the rate of d in b's axes.
        arm_b = add(arm_b, subtract(place_a, place_b))
        along = axes_of(rotation, b, algebra.matrix(axes, i))
        spin_a = algebra.vector(twists, a, 0) if a >= 0 else ZERO
        spin_b = algebra.vector(twists, b, 0) if b >= 0 else ZERO
        speed = subtract(speed_of(twists, a, arm_a), speed_of(twists, b, arm_b))
        w, u = algebra.rotate(along, subtract(spin_a, spin_b)), algebra.rotate(along, speed)
        c, e = algebra.vector(damping, i, 0), algebra.vector(damping, i, 3)
        moment = algebra.rotate_back(along, (-c[0] * w[0], -c[1] * w[1], -c[2] * w[2]))
        force = algebra.rotate_back(along, (-e[0] * u[0], -e[1] * u[1], -e[2] * u[2]))
        _apply(moment, force, a, b, arm_a, arm_b, wrenches)


@kernel
def _apply(
    moment: Vector, force: Vector, a: int, b: int, arm_a: Vector, arm_b: Vector, wrenches: Floats
) -> None:
    """Add a wrench on a, and its reaction on b. The force acts at one place of both."""
    push(force, arm_a, a, wrenches)
    push(scale(-1.0, force), arm_b, b, wrenches)
    if a >= 0:
        algebra.add_pair(moment, ZERO, wrenches, a)
    if b >= 0:
        algebra.add_pair(scale(-1.0, moment), ZERO, wrenches, b)
