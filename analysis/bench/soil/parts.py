"""What piles are made of: laws of contact, sleep, plates and their motion, and the state of a heap."""

from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np

from bench.soil.contact import DAMPED, RUBBED, SLEPT, STORED, WORK
from protochain.core.arrays import Floats, Integers, Value, floats, read_only
from protochain.core.checks import brief, number
from protochain.core.errors import MechanicsError
from protochain.mechanics.multibody.tree import is_rotation


@dataclass(frozen=True)
class Law:
    """How contacts push and rub.

    stiffness: Force per depth of a face that lies flat; that of one corner is a fourth.
    friction: Largest tangential force, in normal ones.
    damping: Of normal and tangential springs, relative to the critical one of the pair.
    tangential: Stiffness against sliding, relative to ``stiffness``.
    by: What of two boxes presses: points along an axis that the contact keeps, or the volume of their
        overlap, whose forces are the gradient of an energy (:mod:`protochain.mechanisms.box_volume`).

    Take points for heaps, whose contacts are damped: they are quick, and stiff at edges and corners, but
    have no energy when the axis changes, so that an impact without loss may change its own by a quarter.
    Take the volume for few bodies, slow or undamped, whose energy matters: it is kept to 0.1 % at the
    longest step, for twice the seconds of an impact, and seven times those of a heap, where edges and
    corners sink in deeper.
    """

    stiffness: float
    friction: float
    damping: float = 0.2
    tangential: float = 0.5
    by: Literal["points", "volume"] = "points"

    def __post_init__(self) -> None:
        if self.by not in ("points", "volume"):
            raise MechanicsError(f"by {brief(self.by)}: give points or volume")
        for name in ("stiffness", "friction", "damping", "tangential"):
            value = number(getattr(self, name), name)
            least = "positive" if name in ("stiffness", "tangential") else "not negative"
            if not (0.0 <= value < np.inf) or (value == 0.0 and least == "positive"):
                raise MechanicsError(f"{name} {value:g} of contacts must be {least} and finite")


@dataclass(frozen=True)
class Sleep:
    """When cubes are left out: they rest until a force on them changes.

    speed: Speed of its corners below which a cube may fall asleep.
    acceleration: Acceleration of its corners, by the forces on it, above which it wakes.
    time: How long it must have been slow.
    """

    speed: float
    acceleration: float
    time: float

    @classmethod
    def under(cls, gravity: float, edge: float) -> "Sleep":
        """Usual numbers for cubes of an edge under a gravity: small beside a fall of one edge."""
        return cls(0.02 * np.sqrt(gravity * edge), 0.2 * gravity, 0.5 * np.sqrt(edge / gravity))


@dataclass(frozen=True, eq=False)
class Plates(Value):
    """Boxes fixed to bodies that move.

    body (m,) int: Body of each.
    centre (m, 3): In the body's frame.
    rotation (m, 3, 3): Columns are the directions of its edges, in the body's frame.
    half (m, 3): Half lengths of the edges.
    """

    body: Integers = field(default_factory=lambda: np.empty(0, np.int64))
    centre: Floats = field(default_factory=lambda: np.empty((0, 3)))
    rotation: Floats = field(default_factory=lambda: np.empty((0, 3, 3)))
    half: Floats = field(default_factory=lambda: np.empty((0, 3)))

    def __post_init__(self) -> None:
        m = len(self.body)
        object.__setattr__(self, "body", read_only(self.body, np.int64))
        for name, shape in (("centre", (m, 3)), ("rotation", (m, 3, 3)), ("half", (m, 3))):
            object.__setattr__(self, name, read_only(floats(getattr(self, name), shape, f"plates: {name}")))
        check_boxes(self.centre, self.rotation, self.half)

    @property
    def n_bodies(self) -> int:
        """Number of bodies that plates may be on."""
        return int(np.max(self.body, initial=-1)) + 1


class Motion(NamedTuple):
    """Motion of bodies, prescribed: s + 1 moments of s steps, the first one now.

    origin (s + 1, nb, 3): Origins of the bodies' frames.
    rotation (s + 1, nb, 3, 3): Rotations of the bodies.
    twist (s + 1, nb, 6): Angular velocity, velocity of the origin; world axes.
    """

    origin: Floats
    rotation: Floats
    twist: Floats


@dataclass(frozen=True, eq=False)
class Heap(Value):
    """State of a pile, from which it goes on as if it had not stopped.

    position, velocity, spin (n, 3): Centres, their velocities and angular velocities; world axes.
    quaternion (n, 4): Rotations, (w, x, y, z).
    acceleration (n, 6): Of the centres, and angular.
    asleep (n,) int: 1 for cubes that sleep.
    still (n,): How long each has been slow.
    start, other (n + 1,): Neighbours of cube i: ``other[start[i]:start[i + 1]]``; those from n on are plates.
    memory, plane_memory (c, 17): What is remembered of each contact.
    sums (5,): See the properties.
    """

    time: float
    position: Floats
    quaternion: Floats
    velocity: Floats
    spin: Floats
    acceleration: Floats
    asleep: Integers
    still: Floats
    start: Integers
    other: Integers
    memory: Floats
    plane_memory: Floats
    sums: Floats

    @property
    def rotation(self) -> Floats:
        """(n, 3, 3) float: rotations."""
        w, x, y, z = self.quaternion.T
        rows = (
            (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
            (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
            (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
        )
        return np.moveaxis(np.array(rows), 2, 0)

    @property
    def dissipated(self) -> float:
        """Energy lost since the start to dampers, to friction and by falling asleep."""
        return float(self.sums[DAMPED] + self.sums[RUBBED] + self.sums[SLEPT])

    @property
    def stored(self) -> float:
        """Energy in the springs of the contacts."""
        return float(self.sums[STORED])

    @property
    def work(self) -> float:
        """Work that the plates have done since the start."""
        return float(self.sums[WORK])


def check_boxes(centre: Floats, rotation: Floats, half: Floats) -> None:
    """Raise if arrays (n, 3), (n, 3, 3), (n, 3) are no boxes; the message names the first."""
    finite = np.isfinite(centre).all(axis=1) & np.isfinite(half).all(axis=1)
    finite = np.asarray(finite & np.isfinite(rotation).all(axis=(1, 2)))
    for bad, why in (
        (~finite, "its centre, rotation and edges must be finite"),
        (~(half > 0.0).all(axis=1), "its edges must be longer than nothing"),
        (~is_rotation(np.where(finite[:, None, None], rotation, np.eye(3))), "its rotation is none"),
    ):
        if np.any(bad):
            raise MechanicsError(f"box {int(np.argmax(bad))}: {why}")
