"""One track of the vehicle: a closed chain of 24 shoes on a sprocket and an idler, driven over the ground.

Shoes are joined by pins; the chain hangs on no hinge of the frame, but on the teeth of two wheels, and its
pads stick to the ground. The pins touch a wheel where they are nearer to its axis than its outline, which
has a seat for every pin; the force is the gradient of an energy, so that it pushes both ways and turns.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from protochain.core.arrays import Floats, Integers
from protochain.core.errors import Fault, MechanicsError
from protochain.mechanics import multibody
from protochain.mechanics.motion import Applied, Load
from protochain.mechanics.multibody import Frames
from protochain.mechanisms import Acting, Ball, Bodies, Friction, Law, Mechanism, Plane

SHOES, TEETH = 24, 8
PITCH = 0.05
SEATS = 0.5 * PITCH / np.sin(np.pi / TEETH)
"""m. From a wheel's axis to the pins in its seats."""
APART = 0.5 * (SHOES - TEETH) * PITCH
"""m. Distance of the wheels, with which the chain is closed."""
ROLLING = TEETH * PITCH / (2.0 * np.pi)
"""m. Way of the vehicle per radian: one pitch to a tooth. Larger than the height of the pins, cos(pi/8) of
``SEATS``, and smaller than ``SEATS``."""
SHOE, WHEEL, FRAME = 0.2, 1.0, 14.0
"""kg. Of one shoe, one wheel, and half of the machine."""
THICK = 0.012
"""m. Pads are below the pins."""
TIGHT = 1e-3
"""m. By which wheels are too large for the chain, so that it is tight."""
G = 9.81


@dataclass(frozen=True)
class Wheel:
    """A wheel with seats.

    body: Whose y axis is the wheel's.
    radius: Of the seats.
    height: Of the teeth between them; 0 of a round wheel.
    """

    body: str
    radius: float
    height: float
    teeth: int = TEETH


@dataclass(frozen=True)
class Teeth:
    """Pins of bodies on wheels with teeth: force k d (1 + a d') where a pin is d inside the outline.

    pins: Bodies and points; all move in planes of constant y.
    stiffness, damping: Constants k and a.
    """

    pins: tuple[tuple[str, tuple[float, float, float]], ...]
    wheels: tuple[Wheel, ...]
    stiffness: float
    damping: float = 0.0

    def __post_init__(self) -> None:
        if not (0.0 < self.stiffness < np.inf and 0.0 <= self.damping < np.inf):
            raise MechanicsError(
                f"teeth: stiffness {self.stiffness:g} and damping {self.damping:g}: give a stiffness above "
                "zero, a damping not below it, both finite",
                fault=Fault.NO_STIFFNESS,
            )

    def bind(self, bodies: Bodies) -> Acting:
        """Return springs, which have an energy, and dampers."""
        found = _Engaged(bodies, self)
        return Acting(found, Load(found.resist) if self.damping else None, dissipates=True)


class _Engaged:
    """Teeth, bound."""

    def __init__(self, bodies: Bodies, teeth: Teeth) -> None:
        self.tree, self.k, self.a = bodies.tree, teeth.stiffness, teeth.damping
        self.of: Integers = np.array([bodies.number(body, "teeth") for body, _ in teeth.pins])
        self.at = np.array([
            bodies.inside(b, point) for b, (_, point) in zip(self.of, teeth.pins, strict=True)
        ])  # fmt: skip
        self.wheels = [(bodies.number(w.body, "teeth"), bodies.axes(bodies.number(w.body)), w)
                       for w in teeth.wheels]  # fmt: skip

    def touches(self, frames: Frames, b: int, axes: Floats, wheel: Wheel) -> tuple[Any, ...]:
        """Of pins in a wheel: numbers, arms, depths, and gradients by place and the wheel's angle."""
        arm = np.einsum("kij,kj->ki", frames.rotation[self.of], self.at)
        off = frames.origin[self.of] + arm - frames.origin[b]
        turn = frames.rotation[b] @ axes
        x, z = off @ turn[:, 0], off @ turn[:, 2]
        r, angle = np.hypot(x, z), np.arctan2(z, x)
        phase = wheel.teeth * angle
        depth = wheel.radius + 0.5 * wheel.height * (1.0 - np.cos(phase)) - r
        k = np.flatnonzero(depth > 0.0)
        x, z, r = x[k], z[k], r[k]
        rise = 0.5 * wheel.height * wheel.teeth * np.sin(phase[k])
        out = (x[:, None] * turn[:, 0] + z[:, None] * turn[:, 2]) / r[:, None]
        along = (x[:, None] * turn[:, 2] - z[:, None] * turn[:, 0]) / r[:, None]
        # A turn about y takes z to x, and a pin back in the wheel's angle by as much as one forth.
        return k, arm[k], depth[k], (rise / r)[:, None] * along - out, rise

    def push(self, frames: Frames, twists: Floats | None, wrenches: Floats) -> float:
        """Add forces: elastic ones without twists, those of dampers with them; return the energy."""
        energy = 0.0
        for b, axes, wheel in self.wheels:
            k, arm, depth, slope, turning = self.touches(frames, b, axes, wheel)
            force = self.k * depth
            energy += 0.5 * float(force @ depth)
            axis = (frames.rotation[b] @ axes)[:, 1]
            own = self.of[k]
            if twists is not None:
                speed = twists[own, 3:] + np.cross(twists[own, :3], arm) - twists[b, 3:]
                rate = np.einsum("ki,ki->k", slope, speed) + turning * float(twists[b, :3] @ axis)
                # Together with the spring it never pulls.
                force = force * np.maximum(self.a * rate, -1.0)
            on_pins = -force[:, None] * slope
            np.add.at(wrenches[:, 3:], own, on_pins)
            np.add.at(wrenches[:, :3], own, np.cross(arm, on_pins))
            wrenches[b, 3:] -= on_pins.sum(axis=0)
            wrenches[b, :3] -= float(force @ turning) * axis
        return energy

    def add(self, q: Floats, frames: Frames, wrenches: Floats, torques: Floats) -> float:
        """Add the springs."""
        return self.push(frames, None, wrenches)

    def resist(self, time: float, q: Floats, qd: Floats, frames: Frames) -> Applied:
        """Dampers."""
        wrenches = np.zeros((self.tree.n_bodies, 6))
        self.push(frames, multibody.velocities(self.tree, frames, qd), wrenches)
        return Applied(wrenches)


def loop() -> Floats:
    """(24, 2) float: places (x, z) of the pins about the middle of the wheels' axes, bottom run first."""
    x, half = PITCH * np.arange(1, (SHOES - TEETH) // 2), 0.5 * APART
    turn = np.pi / TEETH * (2.0 * np.arange(TEETH // 2 + 1) - 0.5 * TEETH)
    front = np.column_stack([half + SEATS * np.cos(turn), SEATS * np.sin(turn)])
    bottom = np.column_stack([x - half, np.full(len(x), -SEATS)])
    both = np.concatenate([bottom, front])
    return np.concatenate([both, -both])


def crawler(
    drive: Callable[[float], tuple[float, float, float]], slope: float = 0.0, grip: float = 0.8,
    stiffness: float = 1e5,
) -> Mechanism:  # fmt: skip
    """Build half of the vehicle on one track, in a plane."""
    m = Mechanism(G * np.array([-np.sin(slope), 0.0, -np.cos(slope)]))
    wheels = tuple(Wheel(name, SEATS + TIGHT, 0.3 * SEATS) for name in ("sprocket", "idler"))
    chained = tuple((f"shoe {k}", (0.0, 0.0, 0.0)) for k in range(SHOES))
    m.force("teeth", Teeth(chained, wheels, stiffness, 1.0))
    pins = loop()
    # All of the weight is on the pads of the bottom run.
    sag = (FRAME + 2.0 * WHEEL + SHOES * SHOE) * G / (stiffness * (SHOES - TEETH))
    height = SEATS + THICK - sag
    for name, mass, z in (("frame", FRAME, height), ("shoe 0", SHOE, height + pins[0, 1])):
        x = 0.0 if name == "frame" else float(pins[0, 0])
        m.body(f"{name} aside", 0.0)
        m.body(f"{name} up", 0.0)
        m.hinge(f"{name} x", "world", f"{name} aside", "prismatic", at=(x, 0.0, z), axis=(1.0, 0.0, 0.0))
        m.hinge(f"{name} z", f"{name} aside", f"{name} up", "prismatic", axis=(0.0, 0.0, 1.0))
        if name == "frame":
            m.body(name, mass, inertia=mass * 0.02)
        m.hinge(name, f"{name} up", name, axis=(0.0, 1.0, 0.0))
    for name, x in (("sprocket", -0.5 * APART), ("idler", 0.5 * APART)):
        m.body(name, WHEEL, inertia=0.5 * WHEEL * SEATS**2)
        m.hinge(name, "frame", name, at=(x, 0.0, 0.0), axis=(0.0, 1.0, 0.0))
    m.drive("sprocket", drive)
    steps = np.roll(pins, -1, axis=0) - pins
    slants = -np.arctan2(steps[:, 1], steps[:, 0])
    turns = (np.diff(slants, prepend=0.0) + np.pi) % (2.0 * np.pi) - np.pi
    inertia = SHOE / 12.0 * PITCH**2
    for k in range(SHOES):
        m.body(f"shoe {k}", SHOE, (0.5 * PITCH, 0.0, -0.25 * THICK), inertia)
        if k:
            m.hinge(
                f"pin {k}", f"shoe {k - 1}", f"shoe {k}", at=(PITCH, 0.0, 0.0), axis=(0.0, 1.0, 0.0),
                q=float(turns[k]),
            )  # fmt: skip
    end = (f"shoe {SHOES - 1}", (PITCH, 0.0, 0.0))
    m.close("master pin", end, ("shoe 0", (0.0, 0.0, 0.0)), "spherical")
    pads = [
        Ball(f"shoe {k}", 0.0, (part * PITCH, 0.0, -THICK)) for k in range(SHOES) for part in (0.25, 0.75)
    ]
    friction = Friction(grip, stiffness, 2e-4 * stiffness)
    m.contact("ground", pads, Plane(), Law(stiffness, 1.0, 5.0), friction)
    return m
