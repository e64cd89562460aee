"""Springs and dampers between two points."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from protochain.core.arrays import Floats, Integers, read_only
from protochain.core.checks import optional
from protochain.core.errors import Fault, MechanicsError
from protochain.core.settings import document_fields
from protochain.mechanics.multibody import Frames, algebra
from protochain.mechanics.multibody.algebra import Vector, add, cross, dot, kernel, scale, subtract
from protochain.mechanics.multibody.kinematics import end_of
from protochain.mechanisms.bodies import Bodies
from protochain.mechanisms.element_arguments import amount
from protochain.mechanisms.elements import Acting, Between, Rows

STIFFNESS, REST, DAMPING = range(3)
"""Columns of ``constants``."""


def check_constants(element: Any) -> None:
    """Check stiffness and damping, of which one at least is above zero."""
    element.check(stiffness=amount, damping=amount)
    if element.stiffness == element.damping == 0.0:
        raise element.refusal("it has no effect; give a stiffness or a damping", fault=Fault.NO_STIFFNESS)


@document_fields
@dataclass(frozen=True, eq=False)
class Spring(Between, noun="spring"):
    """Spring, damper, or both, between two points: energy k (length - rest)^2 / 2, force along the line.

    Raises
    ------
    MechanicsError
        If the name is already in use, or a constant is negative.
    """

    stiffness: float = 0.0  # Force per length.
    rest: float | None = None  # Length without force. By default the length as built.
    damping: float = 0.0  # Force per speed, along the line.

    def __post_init__(self) -> None:
        super().__post_init__()
        check_constants(self)
        self.check(rest=optional(amount))

    def bind(self, bodies: Bodies) -> Acting:
        """Return its forces."""
        ends, points = self.ends(bodies)
        places = [bodies.built.point(*end) for end in (self.a, self.b)]
        built = float(np.linalg.norm(places[1] - places[0]))
        neutral = built if self.rest is None else self.rest
        if self.stiffness > 0.0 and built == 0.0 < neutral:
            raise self.refusal(
                "its ends coincide as built, so its force has no direction; give rest=0, or move one end"
            )
        row = Springs(
            np.array([self.name]), ends, points, read_only([(self.stiffness, neutral, self.damping)])
        )
        elastic, damping = row if self.stiffness else None, row if self.damping else None
        return Acting(elastic, damping=damping, inside=bool(np.all(ends >= 0)))


@dataclass(frozen=True, eq=False)
class Springs(Rows):
    """Springs, bound."""

    names: np.ndarray  # (n,) str: Names, for messages.
    ends: Integers  # (n, 2) int: Bodies of each; -1 is the world.
    points: Floats  # (n, 6): Points of both bodies, along the axes of the tree's frames.
    constants: Floats  # (n, 3): Stiffness, length at rest, damping.

    def add(self, q: Floats, frames: Frames, wrenches: Floats, torques: Floats) -> float:
        """Add the forces of the springs."""
        energy: float = pull(frames.rotation, frames.origin, self.ends, self.points, self.constants, wrenches)
        if energy < 0.0:
            raise MechanicsError(
                f'spring "{self.names[round(-energy) - 1]}": its ends coincide, so its force has no '
                "direction; give it rest=0, or keep its ends apart"
            )
        return energy

    def resist(self, frames: Frames, twists: Floats, qd: Floats, wrenches: Floats, torques: Floats) -> None:
        """Add the forces of the dampers."""
        resist(frames.rotation, frames.origin, twists, self.ends, self.points, self.constants, wrenches)


@kernel
def push(force: Vector, arm: Vector, b: int, wrenches: Floats) -> None:
    """Add a force at the end of a lever arm to those on body b, unless it is the world."""
    if b >= 0:
        algebra.add_pair(cross(arm, force), force, wrenches, b)


@kernel
def speed_of(twists: Floats, b: int, arm: Vector) -> Vector:
    """Velocity of a point of a body."""
    if b < 0:
        return 0.0, 0.0, 0.0
    omega, u = algebra.pair(twists, b)
    return add(u, cross(omega, arm))


@kernel
def pull(
    rotation: Floats, origin: Floats, ends: Integers, points: Floats, constants: Floats, wrenches: Floats
) -> float:
    """Add the forces. Return the energy, or minus the number, from 1, of a spring without a direction."""
    energy = 0.0
    for i in range(len(ends)):
        a, b = ends[i, 0], ends[i, 1]
        arm_a, place_a = end_of(rotation, origin, a, algebra.vector(points, i, 0))
        arm_b, place_b = end_of(rotation, origin, b, algebra.vector(points, i, 3))
        separation = subtract(place_b, place_a)
        length = np.sqrt(dot(separation, separation))
        k, rest_length = constants[i, STIFFNESS], constants[i, REST]
        stretch = length - rest_length
        energy += 0.5 * k * stretch * stretch
        if length == 0.0 and rest_length > 0.0:
            return -1.0 - i
        force = scale(k, separation) if rest_length == 0.0 else scale(k * stretch / length, separation)
        push(force, arm_a, a, wrenches)
        push(scale(-1.0, force), arm_b, b, wrenches)
    return energy


@kernel
def resist(
    rotation: Floats, origin: Floats, twists: Floats, ends: Integers, points: Floats, constants: Floats,
    wrenches: Floats,
) -> None:  # fmt: skip
    """Add the forces of the dampers."""
    for i in range(len(ends)):
        a, b = ends[i, 0], ends[i, 1]
        arm_a, place_a = end_of(rotation, origin, a, algebra.vector(points, i, 0))
        arm_b, place_b = end_of(rotation, origin, b, algebra.vector(points, i, 3))
        moving = subtract(speed_of(twists, b, arm_b), speed_of(twists, a, arm_a))
        separation = subtract(place_b, place_a)
        squared = dot(separation, separation)
        force = scale(constants[i, DAMPING], moving)
        if squared > 0.0:
            force = scale(constants[i, DAMPING] * dot(moving, separation) / squared, separation)
        push(force, arm_a, a, wrenches)
        push(scale(-1.0, force), arm_b, b, wrenches)
