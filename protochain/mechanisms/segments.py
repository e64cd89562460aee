"""Flexible beams as finite segments: rigid rods in a row, with springs at the hinges between them.

Megahed, Hamza, Robotica 22:285 (2004). The beam, less a rigid zone at either end, is cut into equal cells.
The middle of each is a hinge whose spring is as stiff as the cell, and the rods between are rigid. The error
of frequencies and deflections falls as one over the square of the number of cells. The result is an
ordinary tree of revolute hinges.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from protochain.core.arrays import Floats
from protochain.core.checks import brief
from protochain.core.errors import Fault, MechanicsError
from protochain.core.settings import document_fields
from protochain.mechanisms.bodies import WORLD
from protochain.mechanisms.element_arguments import amount, not_negative
from protochain.mechanisms.mechanism import Mechanism

AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
FIXED: Mapping[str, Any] = {"kind": "fixed"}


@document_fields
@dataclass(frozen=True)
class Beam:
    """A uniform straight beam along x, in any consistent units.

    Raises
    ------
    MechanicsError
        If a number is negative or not finite, or nothing is left to bend.
    """

    length: float  # Length, with its rigid zones.
    mass: float  # Mass per length.
    bending: float | tuple[float, float]  # Stiffness EI about y and about z.
    twist: float = 0.0  # Stiffness GJ about x, needed only for beams that twist.
    # Moment of inertia about x per length, half of which is about y and z. A beam that twists needs some.
    polar: float = 0.0
    rigid: float = 0.0  # Share of the length that is rigid, at each end.
    # Whether half of the mass of each rod sits at either end, instead of being spread along it.
    lumped: bool = False

    def __post_init__(self) -> None:
        for name in ("length", "mass", "twist", "polar", "rigid"):
            not_negative(getattr(self, name), f"beam: its {name}")
        not_negative(self.bending, "beam: its bending stiffness", (2,))
        if self.length == 0.0 or self.mass == 0.0:
            raise MechanicsError("beam: its length and its mass must be above zero")
        if self.rigid >= 0.5:
            raise MechanicsError(
                f"beam: rigid {self.rigid:g} at each end leaves no free part; give less", fault=Fault.BENDS
            )

    def stiffness(self, axis: str) -> float:
        """EI or GJ about an axis, ``x``, ``y`` or ``z``."""
        about_y, about_z = np.broadcast_to(self.bending, 2)
        return float({"x": self.twist, "y": about_y, "z": about_z}[axis])

    def lengths(self, cells: int) -> Floats:
        """(cells + 1,) float: lengths of the rods. The outer ones are half cells with the rigid zones."""
        cell = (1.0 - 2.0 * self.rigid) * self.length / cells
        out = np.full(cells + 1, cell)
        out[[0, -1]] = 0.5 * cell + self.rigid * self.length
        return out

    def inertia(self, length: float) -> tuple[float, float, float]:
        """Moments of inertia of a rod of this length about its centre of mass."""
        across = self.mass * length**3 / (4.0 if self.lumped else 12.0) + 0.5 * self.polar * length
        return self.polar * length, across, across


@document_fields
@dataclass(frozen=True)
class Segments:
    """A beam as part of a mechanism."""

    bodies: tuple[str, ...]  # Names of the rods, from the root outwards.
    hinges: tuple[str, ...]  # Names of the hinges between the rods, from the root outwards.
    # Last rod, and the end of the beam in its axes: a point for loads, springs and the next hinge.
    tip: tuple[str, tuple[float, float, float]]


def add_beam(
    mechanism: Mechanism,
    name: str,
    beam: Beam,
    cells: int,
    parent: str = WORLD,
    joint: Mapping[str, Any] = FIXED,
    bends: str = "z",
    damping: float = 0.0,
) -> Segments:
    """Add a beam to a mechanism, as finite segments.

    Parameters
    ----------
    mechanism : Mechanism
        Which gets rods ``NAME 0``, ``NAME 1``... and hinges with springs ``NAME 1z``, ``NAME 2z``...
    name : str
        Name of the beam, and of the hinge at its root.
    beam : Beam
        Its properties.
    cells : int
        Number of cells: of hinges, for each axis.
    parent : str
        Body to which its root is fixed, or "world".
    joint : mapping
        Arguments of :meth:`Mechanism.hinge` for its root: kind, at, axis, rotation, q, qd. By default fixed
        at the parent's origin. The beam leaves along x of the parent.
    bends : str
        Axes about which it bends (``y``, ``z``) or twists (``x``): in each cell one hinge after the other.
    damping : float
        Time constant of the dampers: their constant is the spring's times it.

    Returns
    -------
    Segments
        Names, and the end of the beam.

    Raises
    ------
    MechanicsError
        If there is no cell, an axis is invalid or not stiff, or a name is already in use.
    """
    if not isinstance(cells, int) or cells < 1:
        raise MechanicsError(f'beam "{name}": {brief(cells)} cells; give a whole number from 1')
    if not bends or len(set(bends)) < len(bends) or not set(bends) <= set(AXES):
        raise MechanicsError(f'beam "{name}": bends {bends!r}; give axes of xyz, as "z" or "xyz"')
    soft = [axis for axis in bends if beam.stiffness(axis) == 0.0]
    if soft:
        raise MechanicsError(
            f'beam "{name}": it has no stiffness about {soft[0]}; give one, or remove this axis',
            fault=Fault.NO_STIFFNESS,
        )
    time = amount(damping, f'beam "{name}": its damping')
    lengths = beam.lengths(cells)
    # A rigid zone is no part of a cell.
    cell = (1.0 - 2.0 * beam.rigid) * beam.length / cells
    bodies, hinges, above, at = [], [], parent, (0.0, 0.0, 0.0)
    for k, length in enumerate(lengths):
        rod = f"{name} {k}"
        for axis in bends if k else ():
            hinge = f"{rod}{axis}"
            last = axis == bends[-1]
            child = rod if last else f"{rod} after {axis}"
            if not last:
                mechanism.body(child, mass=0.0)
            mechanism.hinge(hinge, parent=above, child=child, at=at, axis=AXES[axis])
            k_axis = beam.stiffness(axis) / cell
            mechanism.torsion(hinge, hinge, stiffness=k_axis, damping=time * k_axis)
            hinges.append(hinge)
            above, at = child, (0.0, 0.0, 0.0)
        if k == 0:
            mechanism.hinge(name, parent=parent, child=rod, **joint)
        mechanism.body(rod, beam.mass * length, com=(0.5 * length, 0, 0), inertia=beam.inertia(length))
        bodies.append(rod)
        above, at = rod, (float(length), 0.0, 0.0)
    return Segments(tuple(bodies), tuple(hinges), (above, at))
