"""Lift of blades in strips, along the shaft."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from protochain.core.arrays import Floats, Integers
from protochain.mechanics import multibody
from protochain.mechanics.motion import Applied, Load
from protochain.mechanics.multibody import Frames
from protochain.mechanics.multibody.algebra import dot, kernel, scale, vector
from protochain.mechanics.multibody.kinematics import end_of
from protochain.mechanisms import Acting, Bodies
from protochain.mechanisms.linear_springs import push, speed_of

Motion = Callable[[float], float]


@dataclass(frozen=True)
class Strip:
    """Piece of a blade: body and point in it, its distance from the shaft and its length along the blade.

    The blade leads with the y axis of the body.
    """

    body: str
    at: tuple[float, float, float]
    radius: float
    width: float


@dataclass(frozen=True)
class Lift:
    """Lift (rho/2) c a (theta - (v_i + z' - w) / W r) (W r)^2 dr of each strip, along the shaft.

    z' is the speed of the strip along the shaft, theta the pitch with the sine of its twist from the hub.

    hub: Body whose z axis is the shaft.
    strips: Pieces of all blades.
    constant: Density / 2, times chord, times slope of the lift.
    rate, pitch, gust: Time -> rate of the shaft W, pitch theta, upward gust w.
    inflow: Induced velocity v_i.
    """

    hub: str
    strips: tuple[Strip, ...]
    constant: float
    rate: Motion
    pitch: Motion
    gust: Motion
    inflow: float = 0.0

    def bind(self, bodies: Bodies) -> Acting:
        """Return what acts."""
        hub = bodies.number(self.hub, "lift")
        numbers = np.array([bodies.number(strip.body, "lift") for strip in self.strips])
        points = np.array([bodies.inside(b, s.at) for b, s in zip(numbers, self.strips, strict=True)])
        leading = np.array([bodies.inside(b, (0.0, 1.0, 0.0)) for b in numbers])
        spans = np.array([(strip.radius, strip.width) for strip in self.strips])
        shaft = bodies.inside(hub, (0.0, 0.0, 1.0))

        def applied(time: float, q: Floats, qd: Floats, frames: Frames) -> Applied:
            wrenches = np.zeros((bodies.tree.n_bodies, 6))
            twists = multibody.velocities(bodies.tree, frames, qd)
            along = frames.rotation[hub] @ shaft
            air = np.array(
                [*along, self.constant, self.rate(time), self.pitch(time), self.inflow - self.gust(time)]
            )
            _lift(frames.rotation, frames.origin, twists, numbers, points, leading, spans, air, wrenches)
            return Applied(wrenches)

        return Acting(load=Load(applied))

    def thrust(self, time: float, climb: float = 0.0) -> float:
        """Lift of straight blades that climb at a speed."""
        r, dr = np.array([(strip.radius, strip.width) for strip in self.strips]).T
        speed = self.rate(time) * r
        through = self.inflow + climb - self.gust(time)
        return float(self.constant * np.sum((self.pitch(time) * speed - through) * speed * dr))


@kernel
def _lift(
    rotation: Floats, origin: Floats, twists: Floats, bodies: Integers, points: Floats, leading: Floats,
    spans: Floats, air: Floats, wrenches: Floats,
) -> None:  # fmt: skip
    along = air[0], air[1], air[2]
    constant, rate, pitch, through = air[3], air[4], air[5], air[6]
    for i in range(len(bodies)):
        b = bodies[i]
        arm, _ = end_of(rotation, origin, b, vector(points, i, 0))
        edge, _ = end_of(rotation, origin, b, vector(leading, i, 0))
        speed = rate * spans[i, 0]
        climb = dot(along, speed_of(twists, b, arm)) + through
        force = constant * ((pitch + dot(along, edge)) * speed - climb) * speed * spans[i, 1]
        push(scale(force, along), arm, b, wrenches)
