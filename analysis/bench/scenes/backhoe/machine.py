"""The vehicle: tracks that stand on the ground, a house that slews, boom, stick and bucket on cylinders.

The arm is that of the scene ``bucket``. Each cylinder is a barrel that turns about its foot and a rod that
slides in it, whose eye closes a loop with what it moves; lengths are prescribed, so that forces are found.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import make_interp_spline

from bench.scenes.bucket.backhoe import BODIES, BOOM, HINGES, PIN, STICK, reach
from protochain.core.arrays import Floats
from protochain.mechanisms import Ball, Friction, Law, Mechanism, Plane, Surface

G = 9.81
LOWER, HOUSE = 14.0, 16.0
"""kg. Tracks with their frame, and all on it but the arm and the counterweight."""
LOWER_AT, HOUSE_AT, WEIGHT_AT = (0.0, 0.0, 0.06), (-0.12, 0.0, 0.12), (-0.26, 0.0, 0.15)
"""m. Centres of mass, the latter two in the house's axes."""
RING = 0.1
"""m. Height of the slewing ring, the house's origin, above the ground."""
BEHIND = 0.1
"""m. How far the ring is behind the boom's pin."""
PAD = 0.03
"""m. Radius of what touches the ground, at five places along each track."""
BARREL, ROD = (0.25, 0.1), (0.15, -0.08)
"""Mass (kg) and centre of mass (m along the cylinder, of the rod from its eye)."""
GROUND = Law(2e5, 1.0, 40.0)
GRIP = Friction(0.6, 2e5, 200.0)


@dataclass(frozen=True)
class Cylinder:
    """A cylinder: the bodies that it joins, and the points of foot and eye in their axes, (x, z)."""

    parent: str
    child: str
    foot: tuple[float, float]
    eye: tuple[float, float]

    @property
    def pivot(self) -> tuple[float, float]:
        """Where the child's hinge is in the parent's axes."""
        if self.child == "boom":
            return BEHIND, PIN[2] - RING
        return HINGES[self.child][1][0], HINGES[self.child][1][2]

    def length(self, angle: float, rate: float = 0.0, acceleration: float = 0.0) -> Floats:
        """(3,) float: length, rate and acceleration of the cylinder, of those of its hinge's angle."""
        c, s = np.cos(angle), np.sin(angle)
        (x, z), (px, pz) = self.eye, self.pivot
        arm = np.array([c * x + s * z, c * z - s * x])
        across = np.array([arm[1], -arm[0]])
        line = arm + np.array([px - self.foot[0], pz - self.foot[1]])
        length = float(np.hypot(*line))
        # Of l^2 = line . line, twice: d line = across, d across = -arm.
        first = float(line @ across) / length
        second = (float(across @ across) - float(line @ arm) - first**2) / length
        return np.array([length, first * rate, first * acceleration + second * rate**2])

    def lever(self, angle: float) -> float:
        """Lever of its force about the hinge, by virtual work: dl/dq."""
        return float(self.length(angle, 1.0)[1])

    def direction(self, angle: float) -> float:
        """Angle about y of the cylinder, from foot to eye, in the parent's axes."""
        c, s = np.cos(angle), np.sin(angle)
        (x, z), (px, pz) = self.eye, self.pivot
        return -float(np.arctan2(pz - self.foot[1] + c * z - s * x, px - self.foot[0] + c * x + s * z))


CYLINDERS = {
    "boom": Cylinder("house", "boom", (BEHIND + 0.1, PIN[2] - RING - 0.22), (0.22, 0.0)),
    "stick": Cylinder("boom", "stick", (BOOM - 0.3, 0.1), (-0.08, 0.03)),
    "bucket": Cylinder("stick", "bucket", (STICK - 0.35, 0.06), (0.077, -0.021)),
}
ARM = tuple(CYLINDERS)
Path = Callable[[float], tuple[Floats, Floats, Floats]]
"""Time -> angles, rates and accelerations (4,) of slew, boom, stick and bucket."""


@dataclass(frozen=True)
class Design:
    """What differs from machine to machine.

    counterweight kg.
    length, gauge m: Of the tracks on the ground; of their middles.
    """

    name: str
    counterweight: float = 0.0
    length: float = 0.5
    gauge: float = 0.36

    @property
    def mass(self) -> float:
        """Mass of all of it."""
        arm = sum(mass for mass, _, _ in BODIES.values()) + len(CYLINDERS) * (BARREL[0] + ROD[0])
        return LOWER + HOUSE + self.counterweight + arm

    @property
    def feet(self) -> Floats:
        """(10, 3) float: where the tracks stand, in the axes of the tracks: lowest points of the balls."""
        x = np.linspace(-0.5, 0.5, 5) * self.length
        return np.array([(a, 0.5 * side * self.gauge, 0.0) for side in (1.0, -1.0) for a in x])

    @property
    def corners(self) -> Floats:
        """(4, 3) float: corners of what it stands on, counterclockwise from front right."""
        x, y = 0.5 * self.length, 0.5 * self.gauge
        return np.array([(x, -y, 0.0), (x, y, 0.0), (-x, y, 0.0), (-x, -y, 0.0)])


DESIGNS = (
    Design("as built"),
    Design("counterweight of 8 kg", counterweight=8.0),
    Design("tracks a fifth longer and wider", length=0.6, gauge=0.432),
)


def hold(angles: Floats) -> Path:
    """Path that stays at four angles."""
    still = np.asarray(angles, dtype=float)
    return lambda t: (still, np.zeros(4), np.zeros(4))


def through(times: Floats, angles: Floats) -> Path:
    """Smooth path through four angles (n, 4) at some times, at rest at both ends and beyond them.

    Of order five, so that accelerations, and forces, do not jump where it begins and ends.
    """
    still = [(1, np.zeros(4)), (2, np.zeros(4))]
    spline = make_interp_spline(times, angles, k=5, bc_type=(still, still))  # type: ignore[arg-type]  # its stubs know one kind only
    rates, accelerations = spline.derivative(1), spline.derivative(2)

    def path(t: float) -> tuple[Floats, Floats, Floats]:
        if not times[0] < t < times[-1]:
            return spline(np.clip(t, times[0], times[-1])), np.zeros(4), np.zeros(4)
        return spline(t), rates(t), accelerations(t)

    return path


def posture(edge: tuple[float, float], tilt: float, slew: float = 0.0) -> Floats:
    """(4,) float: angles that bring the cutting edge to (x, z) before the boom's pin, the bucket tilted."""
    return np.append(slew, reach(np.array(edge), tilt))


def vehicle(
    design: Design, path: Path, ground: Surface | Plane | None, law: Law = GROUND,
    grip: Friction | None = GRIP, gravity: tuple[float, float, float] = (0.0, 0.0, -G),
) -> Mechanism:  # fmt: skip
    """Build the machine, the boom's pin above the world's origin, standing on a ground or, of none, held."""
    m = Mechanism(gravity)
    deep = design.mass * G / (len(design.feet) * law.stiffness)
    at = (-BEHIND, 0.0, -deep if ground is not None else 0.0)
    x, y = 0.5 * design.length, 0.5 * design.gauge
    inertia = LOWER / 3.0 * np.array([y**2 + 0.0012, x**2 + 0.0012, x**2 + y**2])
    if ground is None:
        m.body("tracks", LOWER, LOWER_AT, inertia)
        m.hinge("ground", "world", "tracks", kind="fixed", at=at)
    else:
        m.body("tracks", LOWER, LOWER_AT, inertia, position=at)
        balls = [Ball("tracks", PAD, (*foot[:2], PAD)) for foot in design.feet]
        m.contact("ground", balls, ground, law, grip)
    m.body("house", HOUSE, HOUSE_AT, (0.25, 0.3, 0.35))
    m.hinge("slew", "tracks", "house", at=(0.0, 0.0, RING))
    m.drive("slew", lambda t: tuple(float(each[0]) for each in path(t)))  # type: ignore[arg-type, return-value]  # mypy does not count them
    if design.counterweight:
        m.body("counterweight", design.counterweight, inertia=0.01 * design.counterweight)
        m.hinge("bolts", "house", "counterweight", kind="fixed", at=WEIGHT_AT)
    q = path(0.0)[0]
    for k, (name, cylinder) in enumerate(CYLINDERS.items()):
        add_link(m, name, float(q[k + 1]), _length_of(path, cylinder, k + 1))
    return m


def _length_of(path: Path, cylinder: Cylinder, k: int) -> Callable[[float], tuple[float, float, float]]:
    def motion(t: float) -> tuple[float, float, float]:
        q, qd, qdd = path(t)
        length, rate, acceleration = cylinder.length(float(q[k]), float(qd[k]), float(qdd[k]))
        return float(length), float(rate), float(acceleration)

    return motion


def add_link(
    m: Mechanism, name: str, angle: float, motion: Callable[[float], tuple[float, float, float]]
) -> None:
    """Add a body of the arm on its hinge, at an angle, and its cylinder with a prescribed length."""
    cylinder, (mass, com, inertia) = CYLINDERS[name], BODIES[name]
    (x, z), (fx, fz) = cylinder.pivot, cylinder.foot
    m.body(name, mass, com, inertia)
    m.hinge(name, cylinder.parent, name, at=(x, 0.0, z), axis=(0.0, 1.0, 0.0), q=angle)
    slant = cylinder.direction(angle)
    c, s = np.cos(slant), np.sin(slant)
    for part, (own, at) in (("barrel", BARREL), ("rod", ROD)):
        m.body(f"{name} {part}", own, (at, 0.0, 0.0), own * np.array([1e-4, 2e-3, 2e-3]))
    m.hinge(
        f"{name} barrel", cylinder.parent, f"{name} barrel", at=(fx, 0.0, fz), axis=(0.0, 1.0, 0.0),
        rotation=[[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]],
    )  # fmt: skip
    m.hinge(f"{name} cylinder", f"{name} barrel", f"{name} rod", kind="prismatic", axis=(1.0, 0.0, 0.0))
    m.drive(f"{name} cylinder", motion)
    eye = (cylinder.eye[0], 0.0, cylinder.eye[1])
    m.close(f"{name} eye", (f"{name} rod", (0.0, 0.0, 0.0)), (name, eye), kind="spherical")


def mesh(low: tuple[float, float], high: tuple[float, float], pitch: float) -> Surface:
    """Flat ground of triangles."""
    x, y = (np.arange(a, b + 0.5 * pitch, pitch) for a, b in zip(low, high, strict=True))
    vertices = np.array([(a, b, 0.0) for a in x for b in y])
    n = len(y)
    corner = np.array([i * n + j for i in range(len(x) - 1) for j in range(n - 1)])
    both = [(corner, corner + n, corner + n + 1), (corner, corner + n + 1, corner + 1)]
    return Surface("world", vertices, np.concatenate([np.column_stack(each) for each in both]))
