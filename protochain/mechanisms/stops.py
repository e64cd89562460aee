"""Limits of a hinge: stops that push back beyond them."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from protochain.core.arrays import Floats
from protochain.core.errors import MechanicsError
from protochain.mechanics.motion import Applied, Load
from protochain.mechanics.multibody import Frames
from protochain.mechanisms.bodies import Bodies
from protochain.mechanisms.element_arguments import not_negative, number
from protochain.mechanisms.elements import Acting, Named


@dataclass(frozen=True, eq=False)
class Stop(Named):
    """Stops of a hinge: a spring and a damper beyond its limits, which push back and never pull.

    Parameters
    ----------
    name, hinge : str
        Name of the stop, and name of the hinge.
    low, high : float
        Limits of its coordinate. By default none.
    stiffness : float
        Torque by angle beyond a limit (force by length).
    damping : float
        Torque by rate there.

    Raises
    ------
    MechanicsError
        If the name is already in use, there are no limits, or a constant is negative.
    """

    noun: ClassVar[str] = "stop"

    hinge: str
    low: float = -np.inf
    high: float = np.inf
    stiffness: float = 0.0
    damping: float = 0.0

    def __post_init__(self) -> None:
        label = f"{self.label}: its"
        k, c = (float(not_negative(getattr(self, x), f"{label} {x}")) for x in ("stiffness", "damping"))
        if not k > 0.0:
            raise MechanicsError(f"{label} stiffness is zero; give one above, which stops the hinge")
        low, high = (
            value if isinstance(value, float) and np.isinf(value) else number(value, f"{label} limit")
            for value in (self.low, self.high)
        )
        if not low < high or (low, high) == (-np.inf, np.inf):
            raise MechanicsError(f"{label} limits {low:g} and {high:g}: give a low, a high above it, or both")
        self.fix(low=low, high=high, stiffness=k, damping=c)

    def bind(self, bodies: Bodies) -> Acting:
        """Return its elastic torque, and the torque of the damper as a load."""
        place, freedom = bodies.freedom(self.hinge, self.label)
        unit = bodies.unit(self.hinge)
        bound = Stopped(place, freedom, self.low * unit, self.high * unit, self.stiffness, self.damping)
        if bound.depth(bodies.q):
            raise MechanicsError(
                f'{self.label}: hinge "{self.hinge}" begins at {bodies.q[place] / unit:g}, beyond its limits '
                f"{self.low:g} and {self.high:g}; start between them"
            )
        load = Load(bound.resist) if self.damping else None
        return Acting(bound, load, dissipates=True, inside=True)


@dataclass(frozen=True, eq=False)
class Stopped:
    """A stop, bound: torque -k d - c d' at depth d, as long as it pushes back."""

    coordinate: int  # coordinate, freedom: Places of the hinge in q and in qd.
    freedom: int
    low: float
    high: float
    stiffness: float
    damping: float

    def depth(self, q: Floats) -> float:
        """How far beyond a limit, with a sign."""
        at = q[self.coordinate]
        return float(at - np.clip(at, self.low, self.high))

    def add(self, q: Floats, frames: Frames, wrenches: Floats, torques: Floats) -> float:
        """Add the elastic torque. Return its energy."""
        depth = self.depth(q)
        torques[self.freedom] -= self.stiffness * depth
        return 0.5 * self.stiffness * depth * depth

    def resist(self, time: float, q: Floats, qd: Floats, frames: Frames) -> Applied:
        """Torque of the damper: it does not pull a hinge that leaves faster than the spring pushes."""
        depth, torques = self.depth(q), np.zeros(len(qd))
        if depth:
            sign = np.sign(depth)
            push = self.damping * sign * qd[self.freedom]
            torques[self.freedom] = -sign * max(push, -self.stiffness * abs(depth))
        return Applied(torques=torques)
