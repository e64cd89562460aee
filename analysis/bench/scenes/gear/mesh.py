"""The flanks' forces as an element of mechanisms, and the mechanism: wheels, and teeth on springs."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from types import MappingProxyType

import numpy as np

from bench.scenes.gear.geometry import STEEL, GearPair, overlap
from bench.scenes.gear.teeth import Springs
from protochain.core.arrays import Floats, Integers, read_only
from protochain.core.checks import brief, check_fields, number
from protochain.core.errors import MechanicsError
from protochain.mechanics.motion import Applied, Load
from protochain.mechanics.multibody import Frames
from protochain.mechanics.multibody.algebra import kernel
from protochain.mechanisms import Acting, Bodies, Mechanism, Model
from protochain.mechanisms.assembly import Assembly
from protochain.mechanisms.contact import Law, lankarani_nikravesh

NO_TOOTH = -1
SLOW = 1e-3
"""m/s, below which friction falls to nothing."""


@dataclass(frozen=True)
class Gear:
    """Numbers of the scene; m, kg, s, N.

    pair: Geometry.
    stiffness: c' of one pair of teeth by width, N/m^2: 14 N/(mm um) by ISO 6336.
    torque: On the driving wheel, N m; that on the driven one holds against it.
    speed: Of the driving wheel, rad/s.
    flank: Normal force of flanks: by default as stiff at the torque as a line contact of steel, some 2 N/nm.
    damping: Of a tooth on its spring, relative to critical damping of the wheels on one pair of teeth.
    tooth: Inertia of the teeth relative to steel; what they lack is the wheel's, so that both together stay.
    backlash: Play between the back flanks, m along their line of action, while the front ones touch;
        infinite: they are left out.
    friction: Coulomb's, of flanks that slide on each other.
    along: Whether the stiffness of a tooth follows the point of contact, after Weber and Banaschek; then
        ``stiffness`` sets the damping alone.
    """

    pair: GearPair = field(default_factory=GearPair)
    stiffness: float = 14e9
    torque: float = 100.0
    speed: float = 100.0
    flank: Law = field(default_factory=lambda: lankarani_nikravesh(1e12, 0.8, 0.1))
    damping: float = 0.07
    tooth: float = 1.0
    backlash: float = np.inf
    friction: float = 0.0
    along: bool = False

    def __post_init__(self) -> None:
        check_fields(self, torque=number)
        if not self.backlash >= 0.0:
            raise MechanicsError(f"backlash {brief(self.backlash)}: give a length, 0 or more")

    @property
    def ratio(self) -> float:
        """Of the numbers of teeth."""
        return self.pair.teeth[1] / self.pair.teeth[0]

    @cached_property
    def inertias(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Of each wheel, all of it, and of one of its teeth, about its axis.

        Steel discs up to the pitch circle, of which the ring beyond the root circle is the teeth's.
        """
        found = []
        for wheel in self.pair.wheels:
            whole, body = (
                0.5 * np.pi * STEEL * self.pair.width * radius**4 for radius in (wheel.pitch, wheel.root)
            )
            found.append((float(whole), float(self.tooth * (whole - body) / wheel.teeth)))
        return found[0], found[1]

    @property
    def tooth_stiffness(self) -> tuple[float, float]:
        """k_t = 2 c' b r_b^2 of each wheel: a pair of teeth in series has c' b along the line of action."""
        one, other = (2.0 * self.stiffness * self.pair.width * wheel.base**2 for wheel in self.pair.wheels)
        return one, other

    def frequency(self, pairs: int) -> float:
        """Of the wheels on stiff flanks and teeth without inertia, rad/s: sqrt(k (r1^2/I1 + r2^2/I2))."""
        inverse = sum(
            wheel.base**2 / whole for wheel, (whole, _) in zip(self.pair.wheels, self.inertias, strict=True)
        )
        return float(np.sqrt(pairs * self.stiffness * self.pair.width * inverse))

    @property
    def tooth_damping(self) -> tuple[float, float]:
        """Of each wheel's teeth on their springs."""
        one, other = (2.0 * self.damping * k / self.frequency(1) for k in self.tooth_stiffness)
        return one, other

    def error(self, pairs: int) -> float:
        """Quasi-static transmission error of the driving wheel, rad: T / (r_b^2 c' b N), flanks stiff."""
        return self.torque / (self.pair.wheels[0].base ** 2 * self.stiffness * self.pair.width * pairs)

    def stiffer(self, factor: float) -> "Gear":
        """The same with stiffer teeth, and flanks such that both give way in proportion."""
        flank = replace(self.flank, stiffness=self.flank.stiffness * factor**self.flank.exponent)
        return replace(self, stiffness=self.stiffness * factor, flank=flank)


@dataclass(frozen=True, eq=False)
class Flanks:
    """All flanks of a pair of wheels, an element of a mechanism.

    pair: Geometry.
    law: Normal force.
    backlash: Play of the back flanks.
    friction: Coulomb's.
    wheels: Hinges of the driving and of the driven wheel.
    teeth: Hinge of each tooth, empty for one that is part of its wheel.
    """

    pair: GearPair
    law: Law
    backlash: float
    friction: float
    wheels: tuple[str, str]
    teeth: tuple[tuple[str, ...], tuple[str, ...]]

    def bind(self, bodies: Bodies) -> Acting:
        """Elastic force, and its damping as a load."""
        if bodies.tree.n_q != bodies.tree.n_v:
            raise MechanicsError("gears turn on hinges; hold every wheel by one")
        freedoms = [[bodies.freedom(wheel)[1]] for wheel in self.wheels]
        for own, names in zip(freedoms, self.teeth, strict=True):
            own += [bodies.freedom(name)[1] if name else NO_TOOTH for name in names]
        bases = [wheel.base for wheel in self.pair.wheels]
        arms = [wheel.pitch * np.sin(wheel.pressure_angle) for wheel in self.pair.wheels]
        numbers = (
            *bases, self.pair.base_pitch, *self.pair.path, self.pair.across, self.backlash, self.friction,
            *arms,
        )  # fmt: skip
        meshing = Meshing(
            read_only(freedoms[0], np.int64), read_only(freedoms[1], np.int64), read_only(numbers),
            self.pair.corners, read_only([self.law.stiffness, self.law.exponent, self.law.damping]),
        )  # fmt: skip
        loses = self.law.damping or self.friction
        return Acting(meshing, Load(meshing.resist) if loses else None, True, True)


@dataclass(frozen=True, eq=False)
class Meshing:
    """Flanks in a mechanism.

    one, other (1 + teeth,) int: Freedoms of each wheel and of its teeth, -1 for a tooth that is part of the
        wheel.
    numbers (10,): Base radii, base pitch, beginning and end of the path of contact; across a tooth, play;
        friction, from the pitch point along the line of action to either base circle.
    corners: Tip corners: :attr:`GearPair.corners`.
    law (3,): Stiffness, exponent, damping.
    """

    one: Integers
    other: Integers
    numbers: Floats
    corners: tuple[tuple[float, ...], tuple[float, ...]]
    law: Floats

    def add(self, q: Floats, frames: Frames, wrenches: Floats, torques: Floats) -> float:
        """Add the elastic torques."""
        return self._press(q, q, torques, 0)[0]

    def resist(self, time: float, q: Floats, qd: Floats, frames: Frames) -> Applied:
        """Torques of damping and friction."""
        torques = np.zeros(len(qd))
        self._press(q, qd, torques, 1)
        return Applied(torques=torques)

    def pressing(self, q: Floats, qd: Floats) -> Floats:
        """(k, 4) float: place on the line of action, overlap and force of each pair of teeth near it.

        Last, 0 of front flanks, 1 of back flanks, whose line of action is the other one.
        """
        return self._press(q, qd, np.zeros(len(qd)), 2)[1]

    def _press(self, q: Floats, qd: Floats, torques: Floats, part: int) -> tuple[float, Floats]:
        found: tuple[float, Floats] = _press(
            self.one, self.other, self.numbers, *self.corners, self.law, q, qd, torques, part
        )
        return found


@kernel
def _press(
    one: Integers, other: Integers, numbers: Floats, first: tuple[float, ...], second: tuple[float, ...],
    law: Floats, q: Floats, qd: Floats, torques: Floats, part: int,
) -> tuple[float, Floats]:  # fmt: skip
    """Add torques of the elastic force (part 0), of what loses energy (1) or of both (2); energy, each pair.

    Back flanks are the front flanks of the mirror image, in which everything turns the other way.
    """
    r1, r2, pitch, begin, end, across, play, friction, arm_1, arm_2 = numbers
    sides = 1 if play == np.inf else 2
    most = int((end - begin) / pitch) + 3
    pairs, energy, count = np.zeros((sides * most, 4)), 0.0, 0
    for side in range(sides):
        sign, ahead, behind = (1.0, 0.0, 0.0) if side == 0 else (-1.0, across, across + play)
        middle = 0.5 * (sign * (r1 * q[one[0]] + r2 * q[other[0]]) + ahead + behind)
        # Half a pitch beyond either tip circle the gap is half a millimetre, far more than teeth give way.
        lowest, highest = np.ceil((begin - middle) / pitch - 0.5), np.floor((end - middle) / pitch + 0.5)
        for k in range(int(highest - lowest) + 1):
            n = int(lowest) + k
            # Flank n of the mirror image is of tooth -n; it meets the tooth before that.
            n1, n2 = (n, n) if side == 0 else (-n, -n - 1)
            tooth_1, tooth_2 = one[1 + n1 % (len(one) - 1)], other[1 + n2 % (len(other) - 1)]
            a1, a2, rate_1, rate_2 = q[one[0]], q[other[0]], qd[one[0]], qd[other[0]]
            if tooth_1 >= 0:
                a1, rate_1 = a1 + q[tooth_1], rate_1 + qd[tooth_1]
            if tooth_2 >= 0:
                a2, rate_2 = a2 + q[tooth_2], rate_2 + qd[tooth_2]
            place_1, place_2 = sign * r1 * a1 + ahead + n * pitch, sign * r2 * a2 + behind + n * pitch
            depth, by_1, by_2 = overlap(place_1, place_2, first, second)
            pairs[count, 0], pairs[count, 1], pairs[count, 3] = 0.5 * (place_1 + place_2), depth, side
            count += 1
            if depth <= 0.0:
                continue
            elastic = law[0] * depth ** law[1]
            energy += elastic * depth / (law[1] + 1.0)
            closing = sign * (by_1 * r1 * rate_1 + by_2 * r2 * rate_2)
            pressed = max(0.0, elastic * (1.0 + law[2] * closing))
            force = elastic if part == 0 else pressed - elastic if part == 1 else pressed
            pairs[count - 1, 2] = force
            turn_1, turn_2 = force * by_1 * r1, force * by_2 * r2
            if part > 0 and friction > 0.0:
                # Across the line of action, at the flanks' radii of curvature.
                rho_1, rho_2 = arm_1 + pairs[count - 1, 0], arm_2 - pairs[count - 1, 0]
                slide = sign * (rho_1 * rate_1 - rho_2 * rate_2)
                drag = friction * pressed * slide / np.sqrt(slide * slide + SLOW * SLOW)
                turn_1, turn_2 = turn_1 + drag * rho_1, turn_2 - drag * rho_2
            torques[one[0]] -= sign * turn_1
            torques[other[0]] -= sign * turn_2
            if tooth_1 >= 0:
                torques[tooth_1] -= sign * turn_1
            if tooth_2 >= 0:
                torques[tooth_2] -= sign * turn_2
    return energy, pairs[:count]


def meshing_of(model: Assembly) -> Meshing:
    """What presses in a model of gears."""
    return next(part for part in model.conservative if isinstance(part, Meshing))


def gears(
    gear: Gear,
    live: tuple[range, range] | None = None,
    rigid: bool = False,
    start: Mapping[str, float] = MappingProxyType({}),
    drive: Callable[[float], tuple[float, float, float]] | None = None,
) -> Model:
    """Build the mechanism."""
    m = Mechanism()
    everything = tuple(range(teeth) for teeth in gear.pair.teeth)
    live = (range(0), range(0)) if rigid else live or (everything[0], everything[1])
    distance = sum(wheel.pitch for wheel in gear.pair.wheels)
    names = []
    for k, wheel in enumerate(gear.pair.wheels):
        whole, tooth = gear.inertias[k]
        axis = (0, 0, 1 - 2 * k)
        own = sorted({n % wheel.teeth for n in live[k]})
        body = f"wheel {k}"
        inertia = whole - len(own) * tooth
        m.body(body, STEEL * np.pi * wheel.pitch**2 * gear.pair.width, inertia=(inertia, inertia, inertia))
        pin = partial(m.hinge, body, "world", body, at=(k * distance, 0, 0), axis=axis)
        if k == 0 and drive:
            pin()
            m.drive(body, drive)
        else:
            one = k == 0
            pin(q=start.get(body, 0.0), qd=gear.speed / (1.0 if one else gear.ratio))
            m.torque(f"torque {k}", body, gear.torque * (1.0 if one else -gear.ratio))
        for n in own:
            name = f"tooth {k} {n}"
            # Its inertia about the wheel's axis, where its hinge is.
            m.body(name, tooth / wheel.pitch**2, inertia=(tooth, tooth, tooth))
            m.hinge(name, body, name, axis=axis, q=start.get(name, 0.0))
            spring = 0.0 if gear.along else gear.tooth_stiffness[k]
            m.torsion(name, name, spring, damping=gear.tooth_damping[k])
        names.append(tuple(f"tooth {k} {n}" if n in own else "" for n in range(wheel.teeth)))
    if gear.along and any(live):
        m.force("teeth", Springs(gear.pair, ("wheel 0", "wheel 1"), (names[0], names[1])))
    m.force("flanks", Flanks(
        gear.pair, gear.flank, gear.backlash, gear.friction, ("wheel 0", "wheel 1"), (names[0], names[1])
    ))  # fmt: skip
    return m.build()
