"""Springs, dampers and stops on hinges."""

from dataclasses import dataclass

import numpy as np

from protochain.core.arrays import Floats, Integers, read_only
from protochain.core.checks import optional
from protochain.core.errors import MechanicsError
from protochain.core.settings import document_fields
from protochain.mechanics.motion import Applied
from protochain.mechanics.multibody import Frames
from protochain.mechanics.multibody.algebra import kernel
from protochain.mechanisms.bodies import Bodies
from protochain.mechanisms.compiled_loads import STOP, HingeLoad, HingeRow
from protochain.mechanisms.element_arguments import amount, number
from protochain.mechanisms.elements import Acting, Named, Rows
from protochain.mechanisms.linear_springs import DAMPING, REST, STIFFNESS, check_constants


@document_fields
@dataclass(frozen=True, eq=False)
class Torsion(Named, noun="torsion"):
    """Spring, damper, or both, on the angle or slide of a hinge, with energy k (q - rest)^2 / 2.

    Raises
    ------
    MechanicsError
        If the name is already in use, or a constant is negative.
    """

    hinge: str  # Name of the hinge.
    stiffness: float = 0.0  # Torque per radian (force per length).
    rest: float | None = 0.0  # Coordinate without torque. None is the coordinate as built.
    damping: float = 0.0  # Torque per rate.

    def __post_init__(self) -> None:
        check_constants(self)
        self.check(rest=optional(number))

    def bind(self, bodies: Bodies) -> Acting:
        """Return its torques."""
        place, freedom = bodies.freedom(self.hinge, self.label)
        rest_angle = bodies.q[place] if self.rest is None else self.rest * bodies.unit(self.hinge)
        values = read_only([(self.stiffness, rest_angle, self.damping)])
        row = Torsions(read_only([place], np.int64), read_only([freedom], np.int64), values)
        return Acting(row if self.stiffness else None, damping=row if self.damping else None, inside=True)


@dataclass(frozen=True, eq=False)
class Torsions(Rows):
    """Torsions, bound: torques -k (q - rest) and -c qd."""

    coordinates: Integers  # coordinates, freedoms: (n,) int: Places of the hinges in q and in qd.
    freedoms: Integers
    constants: Floats  # (n, 3): Stiffness, coordinate at rest, damping.

    def add(self, q: Floats, frames: Frames, wrenches: Floats, torques: Floats) -> float:
        """Add the torques of the springs."""
        energy: float = wind(self.coordinates, self.freedoms, self.constants, q, torques)
        return energy

    def resist(self, frames: Frames, twists: Floats, qd: Floats, wrenches: Floats, torques: Floats) -> None:
        """Add the torques of the dampers."""
        slow(self.freedoms, self.constants, qd, torques)


@document_fields
@dataclass(frozen=True, eq=False)
class Stop(Named, noun="stop"):
    """Stops of a hinge: a spring and a damper beyond its limits, which push back and never pull.

    Raises
    ------
    MechanicsError
        If the name is already in use, there are no limits, or a constant is negative.
    """

    hinge: str  # Name of the hinge.
    low: float = -np.inf  # Lower limit of its coordinate. By default none.
    high: float = np.inf  # Upper limit of its coordinate. By default none.
    stiffness: float = 0.0  # Torque by angle beyond a limit (force by length).
    damping: float = 0.0  # Torque by rate there.

    def __post_init__(self) -> None:
        label = f"{self.label}: its"
        self.check(stiffness=amount, damping=amount)
        if not self.stiffness > 0.0:
            raise MechanicsError(f"{label} stiffness is zero; give one above, which stops the hinge")
        low, high = (
            value if isinstance(value, float) and np.isinf(value) else number(value, f"{label} limit")
            for value in (self.low, self.high)
        )
        if not low < high or (low, high) == (-np.inf, np.inf):
            raise MechanicsError(f"{label} limits {low:g} and {high:g}: give a low, a high above it, or both")
        self.fix(low=low, high=high)

    def bind(self, bodies: Bodies) -> Acting:
        """Return its elastic torque, and the torque of the damper as a load."""
        place, freedom = bodies.freedom(self.hinge, self.label)
        unit = bodies.unit(self.hinge)
        bound = Stopped(place, freedom, self.low * unit, self.high * unit, self.stiffness, self.damping)
        if bound.depth(bodies.q):
            raise self.refusal(
                f'hinge "{self.hinge}" begins at {bodies.q[place] / unit:g}, beyond its limits '
                f"{self.low:g} and {self.high:g}; start between them"
            )
        constants = bound.low, bound.high, bound.stiffness, bound.damping
        rows = (HingeRow(STOP, place, freedom, constants),)
        load = HingeLoad(bound.resist, rows=rows, computed=bound.resist) if self.damping else None
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


@kernel
def wind(coordinates: Integers, freedoms: Integers, constants: Floats, q: Floats, torques: Floats) -> float:
    """Add the torques of the springs. Return their energy."""
    energy = 0.0
    for i in range(len(coordinates)):
        turn = q[coordinates[i]] - constants[i, REST]
        pull = constants[i, STIFFNESS] * turn
        energy += 0.5 * pull * turn
        torques[freedoms[i]] -= pull
    return energy


@kernel
def push_back(places: Integers, limits: Floats, q: Floats, torques: Floats) -> float:
    """Add the elastic torques of stops, of :class:`Stopped`. Return their energy."""
    energy = 0.0
    for i in range(len(places)):
        at = q[places[i, 0]]
        depth = at - min(max(at, limits[i, 0]), limits[i, 1])
        torques[places[i, 1]] -= limits[i, 2] * depth
        energy += 0.5 * limits[i, 2] * depth * depth
    return energy


@kernel
def slow(freedoms: Integers, constants: Floats, qd: Floats, torques: Floats) -> None:
    """Add the torques of the dampers."""
    for i in range(len(freedoms)):
        torques[freedoms[i]] -= constants[i, DAMPING] * qd[freedoms[i]]
