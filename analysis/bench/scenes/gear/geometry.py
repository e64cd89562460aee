"""Involute spur gears: where flanks meet on the line of action, and how far apart they are."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from protochain.core.arrays import Floats
from protochain.core.checks import at_least
from protochain.core.errors import Fault, MechanicsError
from protochain.mechanics.multibody.algebra import kernel

STEEL = 7850.0
"""kg/m^3."""
FILLET = 0.38
"""Modules: radius of the root fillet of the basic rack of ISO 53."""


@dataclass(frozen=True)
class Wheel:
    """Involute wheel.

    teeth: Number of teeth.
    module, pressure_angle: m and rad: pitch diameter by teeth, and angle of the line of action.
    shift: Outward shift of its teeth's profile, in modules.
    """

    teeth: int
    module: float
    pressure_angle: float
    shift: float = 0.0

    @property
    def pitch(self) -> float:
        """Pitch radius."""
        return 0.5 * self.teeth * self.module

    @property
    def base(self) -> float:
        """Base radius."""
        return self.pitch * float(np.cos(self.pressure_angle))

    @property
    def tip(self) -> float:
        """Tip radius: addendum of one module, and the shift."""
        return self.pitch + (1.0 + self.shift) * self.module

    @property
    def root(self) -> float:
        """Root radius: dedendum of 1.25 modules, less the shift."""
        return self.pitch - (1.25 - self.shift) * self.module

    @property
    def thickness(self) -> float:
        """Of a tooth on the pitch circle, along the arc."""
        return self.module * (0.5 * np.pi + 2.0 * self.shift * float(np.tan(self.pressure_angle)))

    @property
    def land(self) -> float:
        """Width of a tooth at its tip: 2 r_a (s/2r + inv a - inv a_a), inv x = tan x - x."""
        at_tip = float(np.arccos(self.base / self.tip))
        involutes = [float(np.tan(angle) - angle) for angle in (self.pressure_angle, at_tip)]
        return 2.0 * self.tip * (0.5 * self.thickness / self.pitch + involutes[0] - involutes[1])

    def half_angle(self, radius: Floats) -> Floats:
        """Half of a tooth's angle at radii: involute, radial below its base, with a fillet at the root."""
        lean = np.arccos(self.base / np.maximum(radius, self.base))
        half = 0.5 * self.thickness / self.pitch + np.tan(self.pressure_angle) - self.pressure_angle
        fillet = FILLET * self.module
        low = np.maximum(fillet - (radius - self.root), 0.0)
        return np.asarray(half - np.tan(lean) + lean + (fillet - np.sqrt(fillet**2 - low**2)) / radius)

    def touched(self, place: float) -> float:
        """Radius at which a flank is touched, by the place on the line of action, away from the root."""
        return float(np.hypot(self.base, self.pitch * np.sin(self.pressure_angle) + place))

    @property
    def reach(self) -> float:
        """From the pitch point along the line of action to the tip circle."""
        return float(np.sqrt(self.tip**2 - self.base**2) - self.pitch * np.sin(self.pressure_angle))


@dataclass(frozen=True)
class GearPair:
    """Two wheels at their standard distance, whose teeth fill each other's gaps but for play.

    A flank's place s is where it crosses the line of action, from the pitch point in the direction in which
    it moves. With base radius r and angle a of its wheel, positive in that direction, s = r a + n p for
    flank n, p the base pitch: the gap of two flanks is linear in the angles.

    teeth: Of the driving and of the driven wheel.
    module, pressure_angle, width: m, rad and m.
    shift: Of the teeth of the driving wheel outwards, and of the driven one's inwards, in modules.
    """

    teeth: tuple[int, int] = (20, 40)
    module: float = 4e-3
    pressure_angle: float = float(np.radians(20.0))
    width: float = 20e-3
    shift: float = 0.0

    def __post_init__(self) -> None:
        if len(self.teeth) != 2:
            raise MechanicsError("gears: give two numbers of teeth, of the driving and of the driven wheel")
        for count in self.teeth:
            at_least(3)(count, "teeth")
        for name in ("module", "pressure_angle", "width"):
            if not 0.0 < getattr(self, name) < (0.5 * np.pi if name == "pressure_angle" else np.inf):
                raise MechanicsError(f"the {name} of gears must be positive")
        if not abs(self.shift) < 1.0:
            raise MechanicsError(f"gears: teeth shifted by {self.shift:g} modules; give less than 1")
        for one, other in (self.wheels, self.wheels[::-1]):
            if not one.land > 0.0:
                raise MechanicsError(
                    f"the {one.teeth} teeth of a wheel, shifted by {one.shift:g} modules, end in points "
                    "below its tip circle; shift them less",
                    fault=Fault.POINTED,
                )
            if other.reach >= one.pitch * np.sin(self.pressure_angle):
                raise MechanicsError(
                    f"a wheel of {one.teeth} teeth is undercut by one of {other.teeth}: its involute begins "
                    "beyond the other's tip; take more teeth, a larger angle or a shift",
                    fault=Fault.UNDERCUT,
                )

    @cached_property
    def wheels(self) -> tuple[Wheel, Wheel]:
        """Driving and driven wheel."""
        one, other = (
            Wheel(z, self.module, self.pressure_angle, x)
            for z, x in zip(self.teeth, (self.shift, -self.shift), strict=True)
        )
        return one, other

    @property
    def base_pitch(self) -> float:
        """From a flank to the next along the line of action."""
        return float(np.pi * self.module * np.cos(self.pressure_angle))

    @property
    def across(self) -> float:
        """From a flank of the driving wheel to the other of its tooth, along the base circle."""
        one = self.wheels[0]
        return one.base * one.thickness / one.pitch

    @property
    def path(self) -> tuple[float, float]:
        """Where contact begins, at the tip of the driven wheel, and ends, at that of the driving one."""
        return -self.wheels[1].reach, self.wheels[0].reach

    @property
    def contact_ratio(self) -> float:
        """Length of the path of contact in base pitches."""
        begin, end = self.path
        return (end - begin) / self.base_pitch

    @cached_property
    def corners(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Numbers of :func:`outer` for the tip of the driven wheel, and for that of the driving one."""
        one, other = self.wheels
        return _corner(other, one), _corner(one, other)


def _corner(own: Wheel, other: Wheel) -> tuple[float, ...]:
    """Base and tip radius, the tip's angle where contact begins; distance; the other's base, pitch, angle."""
    distance, alpha, begin = own.pitch + other.pitch, own.pressure_angle, -own.reach
    # In axes from the other wheel's centre to its own; the line of action goes along (sin, cos) of its angle.
    x, y = other.pitch + begin * np.sin(alpha) - distance, begin * np.cos(alpha)
    return own.base, own.tip, float(np.arctan2(y, x)), distance, other.base, other.pitch, alpha, begin


@kernel
def outer(s: float, corner: tuple[float, ...]) -> tuple[float, float]:
    """Place of the flank of the other wheel that would touch a driven flank at s, and its derivative.

    That is s itself on the path of contact. Before it the flank's tip corner is off the line of action, and
    lags behind: the gap opens with the square of the way. Exact, by the involute through the corner:
    involutes of one base circle are parallel curves.
    """
    base, tip, angle, distance, other, pitch, alpha, begin = corner
    if s >= begin:
        return s, 1.0
    # The driven wheel turns clockwise.
    turned = angle - (s - begin) / base
    px, py = tip * np.cos(turned), tip * np.sin(turned)
    x, y = distance + px, py
    tangent = np.sqrt(x * x + y * y - other * other)
    lean, roll = np.arctan2(y, x), np.arctan(tangent / other)
    place = tangent - pitch * np.sin(alpha) + other * (alpha + lean - roll)
    # Along the tangent of the base circle, the normal of the involute.
    foot = lean - roll
    slope = (-np.sin(foot) * py - np.cos(foot) * px) / base
    return place, slope


@kernel
def overlap(
    driving: float, driven: float, first: tuple[float, ...], second: tuple[float, ...]
) -> tuple[float, float, float]:
    """Overlap of two flanks at their places, negative where they are apart, and its slopes by both places."""
    back, by_back = outer(driven, first)
    front, by_front = outer(-driving, second)
    return -front - back, by_front, -by_back
