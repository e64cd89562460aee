"""Stiffness of a tooth by the point at which it is touched, after Weber and Banaschek.

Formaenderung und Profilruecknahme bei gerad- und schraegverzahnten Raedern, Schriftenreihe Antriebstechnik
11, Vieweg (1953): a tooth bends and shears as a plate of varying thickness, and its foot turns and shifts in
the wheel. Both are for plane strain. The law of contact has the flattening of the flanks at their contact.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.polynomial import Chebyshev
from scipy.integrate import simpson

from bench.scenes.gear.geometry import GearPair, Wheel
from protochain.core.arrays import Floats, Integers, read_only
from protochain.mechanics.multibody import Frames
from protochain.mechanics.multibody.algebra import kernel
from protochain.mechanisms import Acting, Bodies

ELASTICITY, POISSON = 206e9, 0.3
"""N/m^2, and 1: steel."""
DEGREE = 14
"""Of the polynomial of a compliance along the flank: its error is below 1e-5."""
POINTS = 4001
"""Of a profile, and of the integrals over it."""


@lru_cache(maxsize=16)
def profile(wheel: Wheel) -> tuple[Floats, Floats]:
    """Heights (n,) along the middle of a tooth and its thickness there, m, from the section of the foot up.

    The section is at the tangents of 30 degrees to the fillets, as in ISO 6336-3.
    """
    radius = np.linspace(wheel.root, wheel.tip, POINTS)
    half = wheel.half_angle(radius)
    height, thickness = radius * np.cos(half), 2.0 * radius * np.sin(half)
    steep = -0.5 * np.diff(thickness) / np.diff(height) < np.tan(np.pi / 6)
    first = int(np.argmax(steep))
    return height[first:], thickness[first:]


def compliance(wheel: Wheel, place: float) -> float:
    """Way of a tooth along the line of action for a force per width, m^2/N, without flattening.

    Parameters
    ----------
    wheel : Wheel
    place : float, m
        Of the contact on the line of action, from the pitch point towards the tip.
    """
    radius = wheel.touched(place)
    # The line of action leans by this angle against the normal of the middle of the tooth.
    lean = float(np.arccos(wheel.base / radius) - wheel.half_angle(np.array(radius)))
    # Height and thickness along the tooth, from the section of the foot.
    height, thickness = profile(wheel)
    arm = wheel.base / np.cos(lean) - height[0]
    width = thickness[0]
    y = np.linspace(0.0, arm, POINTS)
    across = np.interp(y, height - height[0], thickness)
    bent, sheared = (simpson(f, x=y) for f in ((arm - y) ** 2 / across**3, 1.0 / across))
    tangent = np.tan(lean) ** 2
    # Bending, shear and compression of the tooth.
    tooth = 12.0 * bent + (2.4 / (1.0 - POISSON) + tangent) * sheared
    # Rotation, coupling and shift of the foot.
    by_width = arm / width
    rim = 18.0 / np.pi * by_width**2 + 2.0 * (1.0 - 2.0 * POISSON) / (1.0 - POISSON) * by_width
    rim += 4.8 / np.pi * (1.0 + (1.0 - POISSON) / 2.4 * tangent)
    return float((1.0 - POISSON**2) / ELASTICITY * np.cos(lean) ** 2 * (tooth + rim))


@dataclass(frozen=True, eq=False)
class Springs:
    """Springs of teeth whose stiffness follows the point of contact, an element of a mechanism.

    Parameters
    ----------
    pair : GearPair
    wheels : tuple of str
        Hinges of the driving and of the driven wheel.
    teeth : tuple of tuple of str
        Hinge of each tooth, empty for one that is part of its wheel.
    """

    pair: GearPair
    wheels: tuple[str, str]
    teeth: tuple[tuple[str, ...], tuple[str, ...]]

    def bind(self, bodies: Bodies) -> Acting:
        """Return the elastic torques of both wheels' teeth."""
        rows, springs = [], along(self.pair)
        for k, (wheel, names) in enumerate(zip(self.wheels, self.teeth, strict=True)):
            hinge = bodies.freedom(wheel)[1]
            rows += [
                (k, hinge, n, len(names), bodies.freedom(name)[1]) for n, name in enumerate(names) if name
            ]
        numbers = (self.pair.base_pitch, *self.pair.path, self.pair.width)
        bases = [wheel.base for wheel in self.pair.wheels]
        return Acting(
            Bent(
                read_only(np.reshape(rows, (-1, 5)), np.int64), read_only(numbers), read_only(bases),
                read_only([spring.coef for spring in springs]),
            ),
            inside=True,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Bent:
    """Springs of teeth in a mechanism.

    rows (k, 5) int: Wheel, its freedom, number of the tooth, teeth of the wheel and freedom of the tooth.
    numbers (4,): Base pitch, beginning and end of the path of contact, width.
    bases (2,): Base radii.
    series (2, n): Chebyshev coefficients of the compliances along the path.
    """

    rows: Integers
    numbers: Floats
    bases: Floats
    series: Floats

    def add(self, q: Floats, frames: Frames, wrenches: Floats, torques: Floats) -> float:
        """Add the elastic torques and return the energy."""
        return float(_bend(self.rows, self.numbers, self.bases, self.series, q, torques))


@lru_cache(maxsize=16)
def along(pair: GearPair) -> tuple[Chebyshev, Chebyshev]:
    """Compliance of a tooth of each wheel by the place on the line of action, over the path of contact."""
    one, other = pair.wheels
    first = Chebyshev.interpolate(np.vectorize(lambda s: compliance(one, s)), DEGREE, pair.path)
    second = Chebyshev.interpolate(np.vectorize(lambda s: compliance(other, -s)), DEGREE, pair.path)
    return first, second


def flattening(pair: GearPair, force: float) -> float:
    """Way of two flanks about their contact for a force per width, m^2/N, at the pitch point.

    Parameters
    ----------
    pair : GearPair
    force : float, N/m
        By the width.
    """
    one, other = (wheel.pitch * np.sin(wheel.pressure_angle) for wheel in pair.wheels)
    by_modulus = (1.0 - POISSON**2) / (np.pi * ELASTICITY)
    half = np.sqrt(8.0 * force * by_modulus / (1.0 / one + 1.0 / other))
    middle = 0.5 * pair.wheels[0].thickness / np.cos(pair.pressure_angle)
    return float(2.0 * by_modulus * (2.0 * np.log(2.0 * middle / half) - POISSON / (1.0 - POISSON)))


def pair_stiffness(pair: GearPair, place: Floats, flattening: float = 0.0) -> Floats:
    """Stiffness of one pair of teeth by its width, N/m^2, with a compliance of flattened flanks, m^2/N."""
    one, other = along(pair)
    return np.asarray(1.0 / (one(place) + other(place) + flattening))


def mesh_stiffness(pair: GearPair, flattening: float = 0.0, n: int = 400) -> float:
    """Mean stiffness of all pairs that touch over a base pitch, by the width, N/m^2: c_gamma of ISO 6336."""
    begin, end = pair.path
    place = begin + (np.arange(n) + 0.5) / n * (end - begin)
    return float(pair_stiffness(pair, place, flattening).mean() * pair.contact_ratio)


@kernel
def _bend(
    rows: Integers, numbers: Floats, bases: Floats, series: Floats, q: Floats, torques: Floats
) -> float:
    """Add torques of springs k(s) = r^2 b / c(s), at the place s of the contact; energy k a^2 / 2."""
    pitch, begin, end, width = numbers
    energy = 0.0
    for wheel, turning, number, teeth, bending in rows:
        base = bases[wheel]
        turned = base * q[turning] / pitch + number
        place = (turned - teeth * np.rint(turned / teeth)) * pitch
        at = min(max(place, begin), end)
        x = (2.0 * at - begin - end) / (end - begin)
        # Chebyshev's recurrence for the compliance and its derivative.
        before, term, slope_before, slope = 1.0, x, 0.0, 1.0
        give = series[wheel, 0] + series[wheel, 1] * x
        by_x = series[wheel, 1]
        for k in range(2, series.shape[1]):
            slope_before, slope = slope, 2.0 * term + 2.0 * x * slope - slope_before
            before, term = term, 2.0 * x * term - before
            give += series[wheel, k] * term
            by_x += series[wheel, k] * slope
        stiffness = base * base * width / give
        angle = q[bending]
        energy += 0.5 * stiffness * angle * angle
        torques[bending] -= stiffness * angle
        if begin < place < end:
            by_angle = by_x * 2.0 / (end - begin) * base
            torques[turning] += 0.5 * stiffness / give * by_angle * angle * angle
    return energy
