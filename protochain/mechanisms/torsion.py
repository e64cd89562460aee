"""Springs and dampers on hinges."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from protochain.core.arrays import Floats, Integers, read_only
from protochain.mechanics.multibody import Frames
from protochain.mechanics.multibody.algebra import kernel
from protochain.mechanisms.bodies import Bodies
from protochain.mechanisms.element_arguments import number
from protochain.mechanisms.elements import Acting, Named, Rows
from protochain.mechanisms.linear_springs import DAMPING, REST, STIFFNESS, constants


@dataclass(frozen=True, eq=False)
class Torsion(Named):
    """Spring, damper, or both, on the angle or slide of a hinge, with energy k (q - rest)^2 / 2.

    Parameters
    ----------
    name, hinge : str
        Name of the torsion, and name of the hinge.
    stiffness : float
        Torque per radian (force per length).
    rest : float, optional
        Coordinate without torque. None is the coordinate as built.
    damping : float
        Torque per rate.

    Raises
    ------
    MechanicsError
        If the name is already in use, or a constant is negative.
    """

    noun: ClassVar[str] = "torsion"

    hinge: str
    stiffness: float = 0.0
    rest: float | None = 0.0
    damping: float = 0.0

    def __post_init__(self) -> None:
        self.fix(**constants(self.stiffness, self.damping, self))
        if self.rest is not None:
            self.fix(rest=number(self.rest, f"{self.label}: its rest"))

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
def slow(freedoms: Integers, constants: Floats, qd: Floats, torques: Floats) -> None:
    """Add the torques of the dampers."""
    for i in range(len(freedoms)):
        torques[freedoms[i]] -= constants[i, DAMPING] * qd[freedoms[i]]
