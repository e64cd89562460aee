"""The same gears without trees or kernels: two wheels and their teeth on one axis each, by scipy's DOP853."""

from collections.abc import Callable

import numpy as np
from scipy.integrate import solve_ivp

from bench.scenes.gear.geometry import Wheel
from bench.scenes.gear.mesh import Gear
from protochain.core.arrays import Floats


def corner_place(s: float, own: Wheel, other: Wheel) -> tuple[float, float]:
    """Place of the involute of the other wheel through a tip corner whose flank is at s, and its derivative.

    In complex numbers, the other wheel's centre at zero: the tangent from the corner to the base circle is as
    long as the arc that it unwinds.
    """
    if s >= -own.reach:
        return s, 1.0
    alpha, distance = own.pressure_angle, own.pitch + other.pitch
    line = np.sin(alpha) + 1j * np.cos(alpha)
    arm = (other.pitch - own.reach * line - distance) * np.exp(-1j * (s + own.reach) / own.base)
    corner = distance + arm
    tangent = np.sqrt(abs(corner) ** 2 - other.base**2)
    # The foot of the tangent, whose angle is that by which the base circle is unwound.
    foot = np.angle(corner) - np.arctan2(tangent, other.base)
    place = tangent - other.pitch * np.sin(alpha) + other.base * (alpha + foot)
    moving = -1j * arm / own.base
    slope = float((moving * np.conj(1j * np.exp(1j * foot))).real)
    return place, slope


def rates(gear: Gear, live: tuple[range, range]) -> tuple[Callable[[float, Floats], Floats], int, int]:
    """Time derivative of angles and rates of wheel 0, its teeth, wheel 1 and its teeth; bodies of each."""
    wheels, law, pitch = gear.pair.wheels, gear.flank, gear.pair.base_pitch
    sizes = [1 + len(numbers) for numbers in live]
    own = [whole - len(n) * tooth for (whole, tooth), n in zip(gear.inertias, live, strict=True)]

    def derivative(time: float, y: Floats) -> Floats:
        angle, rate = y[: sum(sizes)], y[sum(sizes) :]
        # Of wheels torques from outside, of teeth all torques, those of flanks below.
        first = (0, sizes[0])
        torque = np.zeros_like(angle)
        for k, start in enumerate(first):
            teeth = slice(start + 1, start + sizes[k])
            torque[teeth] = -gear.tooth_stiffness[k] * angle[teeth] - gear.tooth_damping[k] * rate[teeth]
        for number, n in enumerate(live[0]):
            a, b = 1 + number, sizes[0] + 1 + number
            one = wheels[0].base * (angle[0] + angle[a]) + n * pitch
            two = wheels[1].base * (angle[sizes[0]] + angle[b]) + n * pitch
            front, by_front = corner_place(-one, wheels[0], wheels[1])
            back, by_back = corner_place(two, wheels[1], wheels[0])
            depth = -front - back
            if depth <= 0.0:
                continue
            closing = by_front * wheels[0].base * (rate[0] + rate[a])
            closing -= by_back * wheels[1].base * (rate[sizes[0]] + rate[b])
            force = max(0.0, law.stiffness * depth**law.exponent * (1.0 + law.damping * closing))
            torque[a] -= force * by_front * wheels[0].base
            torque[b] += force * by_back * wheels[1].base
        out = np.zeros_like(angle)
        for k, start in enumerate(first):
            teeth = slice(start + 1, start + sizes[k])
            tooth = gear.inertias[k][1]
            held = gear.tooth_stiffness[k] * angle[teeth] + gear.tooth_damping[k] * rate[teeth]
            outside = gear.torque if k == 0 else -gear.torque * gear.ratio
            # The wheel's body feels the springs; teeth turn by themselves.
            out[start] = (outside + held.sum()) / own[k]
            out[teeth] = torque[teeth] / tooth - out[start]
        return np.concatenate([rate, out])

    return derivative, sizes[0], sizes[1]


def reference(gear: Gear, live: tuple[range, range], start: Floats, times: Floats) -> Floats:
    """(n, k) float: angles and rates at some times, from those at the start, to a tolerance of 1e-12."""
    derivative, _, _ = rates(gear, live)
    half = len(start) // 2
    scale = np.concatenate([np.full(half, gear.error(1)), np.full(half, gear.error(1) * gear.frequency(1))])
    found = solve_ivp(
        derivative, (times[0], times[-1]), start, "DOP853", times, rtol=1e-12, atol=1e-12 * scale
    )
    return np.asarray(found.y.T)
