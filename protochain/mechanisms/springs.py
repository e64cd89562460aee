"""Springs and dampers between two points, and on hinges."""

from dataclasses import dataclass

import numpy as np

from protochain.arrays import Floats, Integers
from protochain.errors import MechanicsError
from protochain.multibody import Frames
from protochain.multibody.algebra import (
    Vector,
    add,
    add_pair,
    cross,
    dot,
    kernel,
    matrix,
    pair,
    scale,
    subtract,
    turned,
    vector,
)  # fmt: skip
from protochain.multibody.kinematics import WORLD

STIFFNESS, REST, DAMPING = range(3)
"""Columns of ``constants``."""


@dataclass(frozen=True, eq=False)
class Springs:
    """Springs between pairs of points: energy k (length - rest)^2 / 2, and dampers along the line.

    Parameters
    ----------
    names : tuple of str
        Names, for messages.
    ends : (n, 2) int
        Bodies of each; -1 is the world.
    points : (n, 6) float
        Points of both bodies, along the axes of the tree's frames.
    constants : (n, 3) float
        Stiffness, length at rest, damping.
    """

    names: tuple[str, ...]
    ends: Integers
    points: Floats
    constants: Floats

    def add(self, q: Floats, frames: Frames, wrenches: Floats, torques: Floats) -> float:
        """Add the forces of the springs.

        Raises
        ------
        MechanicsError
            If the ends of a spring meet that has a length at rest.
        """
        energy: float = _pull(
            frames.rotation, frames.origin, self.ends, self.points, self.constants, wrenches
        )
        if energy < 0.0:
            raise MechanicsError(
                f'spring "{self.names[round(-energy) - 1]}": its ends meet, where its force has no '
                "direction; give it rest=0, or keep its ends apart"
            )
        return energy

    def resist(self, frames: Frames, twists: Floats, qd: Floats, wrenches: Floats, torques: Floats) -> None:
        """Add the forces of the dampers."""
        _resist(frames.rotation, frames.origin, twists, self.ends, self.points, self.constants, wrenches)


@dataclass(frozen=True, eq=False)
class Torsions:
    """Springs and dampers on hinges: energy k (q - rest)^2 / 2, torque -c qd.

    Parameters
    ----------
    coordinates, freedoms : (n,) int
        Places of the hinges in q and in qd.
    constants : (n, 3) float
        Stiffness, coordinate at rest, damping.
    """

    coordinates: Integers
    freedoms: Integers
    constants: Floats

    def add(self, q: Floats, frames: Frames, wrenches: Floats, torques: Floats) -> float:
        """Add the torques of the springs."""
        energy: float = _wind(self.coordinates, self.freedoms, self.constants, q, torques)
        return energy

    def resist(self, frames: Frames, twists: Floats, qd: Floats, wrenches: Floats, torques: Floats) -> None:
        """Add the torques of the dampers."""
        _slow(self.freedoms, self.constants, qd, torques)


@kernel
def _wind(coordinates: Integers, freedoms: Integers, constants: Floats, q: Floats, torques: Floats) -> float:
    energy = 0.0
    for i in range(len(coordinates)):
        turn = q[coordinates[i]] - constants[i, REST]
        pull = constants[i, STIFFNESS] * turn
        energy += 0.5 * pull * turn
        torques[freedoms[i]] -= pull
    return energy


@kernel
def _slow(freedoms: Integers, constants: Floats, qd: Floats, torques: Floats) -> None:
    for i in range(len(freedoms)):
        torques[freedoms[i]] -= constants[i, DAMPING] * qd[freedoms[i]]


@kernel
def end_of(rotation: Floats, origin: Floats, b: int, point: Vector) -> tuple[Vector, Vector]:
    """Lever arm of a point from its body's origin, and its place in the world."""
    turn, at = (matrix(rotation, b), vector(origin, b)) if b >= 0 else WORLD
    arm = turned(turn, point)
    return arm, add(at, arm)


@kernel
def push(force: Vector, arm: Vector, b: int, wrenches: Floats) -> None:
    """Add a force at the end of a lever arm to those on body b, unless it is the world."""
    if b >= 0:
        add_pair(cross(arm, force), force, wrenches, b)


@kernel
def speed_of(twists: Floats, b: int, arm: Vector) -> Vector:
    """Velocity of a point of a body."""
    if b < 0:
        return 0.0, 0.0, 0.0
    omega, u = pair(twists, b)
    return add(u, cross(omega, arm))


@kernel
def _pull(
    rotation: Floats, origin: Floats, ends: Integers, points: Floats, constants: Floats, wrenches: Floats
) -> float:
    """Add the forces; return the energy, or minus the number, from 1, of a spring without a direction."""
    energy = 0.0
    for i in range(len(ends)):
        a, b = ends[i, 0], ends[i, 1]
        arm_a, place_a = end_of(rotation, origin, a, vector(points, i, 0))
        arm_b, place_b = end_of(rotation, origin, b, vector(points, i, 3))
        apart = subtract(place_b, place_a)
        length = np.sqrt(dot(apart, apart))
        k, rest = constants[i, STIFFNESS], constants[i, REST]
        stretch = length - rest
        energy += 0.5 * k * stretch * stretch
        if length == 0.0 and rest > 0.0:
            return -1.0 - i
        force = scale(k, apart) if rest == 0.0 else scale(k * stretch / length, apart)
        push(force, arm_a, a, wrenches)
        push(scale(-1.0, force), arm_b, b, wrenches)
    return energy


@kernel
def _resist(
    rotation: Floats, origin: Floats, twists: Floats, ends: Integers, points: Floats, constants: Floats,
    wrenches: Floats,
) -> None:  # fmt: skip
    for i in range(len(ends)):
        a, b = ends[i, 0], ends[i, 1]
        arm_a, place_a = end_of(rotation, origin, a, vector(points, i, 0))
        arm_b, place_b = end_of(rotation, origin, b, vector(points, i, 3))
        apart, moving = (
            subtract(place_b, place_a),
            subtract(speed_of(twists, b, arm_b), speed_of(twists, a, arm_a)),
        )
        squared = dot(apart, apart)
        force = scale(constants[i, DAMPING], moving)
        if squared > 0.0:
            force = scale(constants[i, DAMPING] * dot(moving, apart) / squared, apart)
        push(force, arm_a, a, wrenches)
        push(scale(-1.0, force), arm_b, b, wrenches)
