"""Legs that stand on the ground: springs and dampers that push only, with friction."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from protochain.core.arrays import Floats
from protochain.core.errors import Fault, MechanicsError
from protochain.mechanics import multibody
from protochain.mechanics.motion import Applied, Load
from protochain.mechanics.multibody import Frames
from protochain.mechanics.multibody.algebra import add, dot, kernel, scale, subtract, vector
from protochain.mechanics.multibody.kinematics import end_of
from protochain.mechanisms import Acting, Bodies, State
from protochain.mechanisms.linear_springs import push, speed_of


@dataclass(frozen=True)
class Legs:
    """Feet on a plane ground, each with a force F = max(0, k d + c d' + c2 d'|d'|) along its normal.

    d is the depth of a foot, and nothing acts above the ground. Friction is mu F v / sqrt(v^2 + slip^2),
    against the velocity v along the ground.

    body: Body that has the legs.
    feet: Where they end, in the body's axes.
    stiffness, damping, squared: Constants k, c and c2 of a leg.
    friction: Coefficient mu.
    slip: Speed at which friction has 0.7 of its full size.
    slope: Angle, rad, by which the ground rises with y from the origin: it is z = y tan(slope).
    """

    body: str
    feet: Sequence[ArrayLike]
    stiffness: float
    damping: float = 0.0
    squared: float = 0.0
    friction: float = 0.0
    slip: float = 0.05
    slope: float = 0.0

    def __post_init__(self) -> None:
        constants = (self.stiffness, self.damping, self.squared, self.friction)
        if not (self.stiffness > 0.0 and min(constants) >= 0.0 and np.all(np.isfinite(constants))):
            raise MechanicsError(
                "legs: a stiffness must be above zero, damping and friction not below it, all of them finite",
                fault=Fault.NO_STIFFNESS,
            )
        if not 0.0 < self.slip < np.inf:
            raise MechanicsError(f"legs: slip {self.slip:g}; give a speed above zero")
        if not abs(self.slope) < 0.5 * np.pi:
            raise MechanicsError(f"legs: slope {self.slope:g}; give an angle below a right one")

    @property
    def normal(self) -> Floats:
        """(3,) float: normal of the ground."""
        return np.array([0.0, -np.sin(self.slope), np.cos(self.slope)])

    def bind(self, bodies: Bodies) -> Acting:
        """Return what acts: the springs have an energy, all else is counted as dissipation."""
        number = bodies.number(self.body, "legs")
        if number < 0:
            raise MechanicsError("legs: the world has none; name a body")
        feet = np.array([bodies.inside(number, foot) for foot in self.feet])
        constants = np.array([
            self.stiffness, self.damping, self.squared, self.friction, self.slip, *self.normal
        ])  # fmt: skip
        standing = _Standing(number, feet, constants)

        def applied(time: float, q: Floats, qd: Floats, frames: Frames) -> Applied:
            wrenches = np.zeros((bodies.tree.n_bodies, 6))
            twists = multibody.velocities(bodies.tree, frames, qd)
            _resist(frames.rotation, frames.origin, twists, number, feet, constants, wrenches)
            return Applied(wrenches)

        silent = not (self.damping or self.squared or self.friction)
        return Acting(standing, None if silent else Load(applied), dissipates=True)

    def forces(self, state: State) -> Floats:
        """(n,) float: forces of the legs on the ground, in a state."""
        depth = -np.array([state.point(self.body, foot) for foot in self.feet]) @ self.normal
        rate = -np.array([state.velocity(self.body, foot) for foot in self.feet]) @ self.normal
        force = self.stiffness * depth + self.damping * rate + self.squared * rate * np.abs(rate)
        return np.where(depth >= 0.0, np.maximum(force, 0.0), 0.0)


@dataclass(frozen=True, eq=False)
class _Standing:
    """Springs of the legs: energy k d^2 / 2 below the ground."""

    body: int
    feet: Floats
    constants: Floats

    def add(self, q: Floats, frames: Frames, wrenches: Floats, torques: Floats) -> float:
        """Add the forces of the springs."""
        energy: float = _stand(frames.rotation, frames.origin, self.body, self.feet, self.constants, wrenches)
        return energy


@kernel
def _stand(
    rotation: Floats, origin: Floats, body: int, feet: Floats, constants: Floats, wrenches: Floats
) -> float:
    energy, stiffness, up = 0.0, constants[0], (constants[5], constants[6], constants[7])
    for i in range(len(feet)):
        arm, place = end_of(rotation, origin, body, vector(feet, i, 0))
        depth = max(0.0, -dot(up, place))
        energy += 0.5 * stiffness * depth * depth
        push(scale(stiffness * depth, up), arm, body, wrenches)
    return energy


@kernel
def _resist(
    rotation: Floats, origin: Floats, twists: Floats, body: int, feet: Floats, constants: Floats,
    wrenches: Floats,
) -> None:  # fmt: skip
    stiffness, damping, squared, friction, slip, x, y, z = constants
    up = x, y, z
    for i in range(len(feet)):
        arm, place = end_of(rotation, origin, body, vector(feet, i, 0))
        depth = -dot(up, place)
        if depth >= 0.0:
            speed = speed_of(twists, body, arm)
            rising = dot(up, speed)
            along = subtract(speed, scale(rising, up))
            elastic = stiffness * depth
            force = max(0.0, elastic - damping * rising - squared * rising * abs(rising))
            drag = -friction * force / np.sqrt(dot(along, along) + slip * slip)
            push(add(scale(drag, along), scale(force - elastic, up)), arm, body, wrenches)
