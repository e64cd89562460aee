"""The helicopter: fuselage, transmission on its mounts, shaft, blades, legs and lift."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bench.scenes.helicopter.legs import Legs
from bench.scenes.helicopter.lift import Lift, Motion, Strip
from bench.scenes.helicopter.modes import in_modes
from protochain.core.arrays import Floats
from protochain.mechanics import multibody
from protochain.mechanics.motion import Phase
from protochain.mechanisms import Mechanism, Model
from protochain.mechanisms.segments import Beam, Segments, add_beam

GRAVITY = 9.81
RADIUS, CHORD, BLADE_MASS, BLADES = 4.4, 0.2, 22.0, 3
FLAP, LAG = 2e4, 1.5e5
POLAR = 0.02
"""kg m. Of a blade about its axis, per length: a plate of its mass and chord has 0.017."""
TWIST = POLAR * (180.0 * 2.0 * RADIUS / np.pi) ** 2
"""N m^2. So that the first frequency of torsion, pi/2 sqrt(GJ / I l^2), is 180 rad/s."""
BLADE = Beam(RADIUS, BLADE_MASS / RADIUS, (FLAP, LAG), TWIST, POLAR)
FUSELAGE, INERTIA = 1000.0, (350.0, 1200.0, 1100.0)
TRANSMISSION, MOUNT = 150.0, 2.0 * np.pi * 20.0
MAST = 0.9
"""m. The transmission above the fuselage's centre of mass; the rotor is 0.4 m higher."""
HEIGHT = 1.2
"""m. The fuselage's centre of mass above the feet."""
RATE = 45.0
AIR, SLOPE = 1.225, 5.7
MODES = {"y": 3, "z": 1, "x": 1}
"""Modes of a blade: flap, lag and torsion. With three of flap the tip swings as free, to 1 %."""
WEIGHT = (FUSELAGE + TRANSMISSION + BLADES * BLADE_MASS) * GRAVITY
LEGS = Legs(
    "fuselage", [(x, y, -HEIGHT) for x in (1.0, -1.0) for y in (1.0, -1.0)], 6e4, 3e3, 500.0, 0.8
)  # fmt: skip


@dataclass(frozen=True)
class Design:
    """What differs from case to case.

    cells: Cells of each blade; 0 for rigid ones.
    modes: Whether blades bend in three modes of flap, and one of lag and torsion each, instead of freely.
    mounts: Whether the transmission is on its mounts, instead of fixed.
    legs: Legs, if the ground is near.
    speed: Rate of the shaft, unless ``motion`` gives it.
    motion: Time -> angle, rate and acceleration of the shaft.
    pitch, gust: Time -> pitch, upward gust.
    inflow: Induced velocity.
    beam: A blade.
    damping: Time constant of the blades' own damping, s.
    loads: Arguments of :meth:`Mechanism.load`.
    """

    cells: int = 6
    modes: bool = True
    mounts: bool = True
    legs: Legs | None = LEGS
    speed: float = RATE
    motion: Callable[[float], tuple[float, float, float]] | None = None
    pitch: Motion = lambda t: 0.0
    gust: Motion = lambda t: 0.0
    inflow: float = 0.0
    beam: Beam = BLADE
    damping: float = 2e-4
    loads: tuple[dict[str, Any], ...] = ()
    gravity: float = GRAVITY


@dataclass(frozen=True)
class Helicopter:
    """A helicopter as built, its lift, and names of the hinges of its blades."""

    model: Model
    lift: Lift
    blades: tuple[Segments, ...]
    given: Design


def build(given: Design) -> Helicopter:
    """Build a helicopter that stands with its feet at the height of the ground."""
    m = Mechanism(gravity=(0.0, 0.0, -given.gravity))
    m.body("fuselage", FUSELAGE, inertia=INERTIA, position=(0, 0, HEIGHT))
    if given.mounts:
        m.body("transmission", TRANSMISSION, inertia=8.0, position=(0, 0, HEIGHT + MAST))
        across = TRANSMISSION * MOUNT**2
        # Mounts 0.4 m from the shaft.
        stiffness = np.array([0.16] * 3 + [1.0] * 3) * across
        m.bushing(
            "mounts", ("transmission", (0, 0, 0)), ("fuselage", (0, 0, MAST)), stiffness,
            0.06 / MOUNT * stiffness,
        )  # fmt: skip
    else:
        m.body("transmission", TRANSMISSION, inertia=8.0)
        m.hinge("mounts", parent="fuselage", child="transmission", kind="fixed", at=(0, 0, MAST))
    m.body("hub", 0.0)
    m.hinge("shaft", parent="transmission", child="hub", at=(0, 0, 0.4))
    motion = given.motion or (lambda t: (given.speed * t, given.speed, 0.0))
    m.drive("shaft", motion)
    blades = tuple(_add_blade(m, given, k) for k in range(BLADES))
    lift = Lift(
        "hub", tuple(s for k in range(BLADES) for s in _strips(given, k)), 0.5 * AIR * CHORD * SLOPE,
        lambda t: motion(t)[1], given.pitch, given.gust, given.inflow,
    )  # fmt: skip
    m.force("lift", lift)
    if given.legs is not None:
        m.force("legs", given.legs)
    for load in given.loads:
        m.load(**load)
    model = m.build()
    if given.modes and given.cells:
        model = in_modes(model, groups(blades))
    return Helicopter(model, lift, blades, given)


def groups(blades: tuple[Segments, ...]) -> list[tuple[list[str], int]]:
    """Hinges of each blade about each axis, and how many modes they have."""
    return [
        (names := [name for name in blade.hinges if name[-1] == axis], min(count, len(names)))
        for blade in blades
        for axis, count in MODES.items()
    ]


def _add_blade(m: Mechanism, given: Design, k: int) -> Segments:
    c, s = np.cos(2.0 * np.pi * k / BLADES), np.sin(2.0 * np.pi * k / BLADES)
    joint: dict[str, Any] = {"kind": "fixed", "rotation": [[c, -s, 0], [s, c, 0], [0, 0, 1]]}
    name, beam = f"blade {k}", given.beam
    if given.cells:
        return add_beam(m, name, beam, given.cells, "hub", joint, "yzx", given.damping)
    mass = beam.mass * beam.length
    m.body(f"{name} 0", mass, com=(0.5 * beam.length, 0, 0), inertia=beam.inertia(beam.length))
    m.hinge(name, parent="hub", child=f"{name} 0", **joint)
    return Segments((f"{name} 0",), (), (f"{name} 0", (beam.length, 0.0, 0.0)))


def _strips(given: Design, k: int, least: int = 24) -> list[Strip]:
    """Strips of a blade: as many of each rod as give the number at least; places by Gauss's rule of two."""
    lengths = given.beam.lengths(given.cells) if given.cells else np.array([given.beam.length])
    out, start = [], 0.0
    for number, length in enumerate(lengths):
        pieces = max(1, round(0.5 * least * length / given.beam.length))
        width = length / pieces
        for piece in range(pieces):
            for side in (-1.0, 1.0):
                x = (piece + 0.5 * (1.0 + side / np.sqrt(3.0))) * width
                out.append(Strip(f"blade {k} {number}", (x, 0.0, 0.0), start + x, 0.5 * width))
        start += length
    return out


def trimmed(lift: Lift, wanted: float, climb: float) -> float:
    """Pitch with which straight blades that climb at a speed have a lift."""
    r, dr = np.array([(strip.radius, strip.width) for strip in lift.strips]).T
    speed = lift.rate(0.0) * r
    return float(
        (wanted / lift.constant + np.sum((lift.inflow + climb) * speed * dr)) / np.sum(speed**2 * dr)
    )


def flying(given: Design, share: float, climb: float = 0.0, change: Motion = lambda t: 0.0) -> Helicopter:
    """Build a helicopter whose straight blades lift a share of its weight, climbing at a speed.

    ``change`` is added to the pitch.
    """
    lift = share * WEIGHT
    given = replace(given, inflow=induced(lift))
    collective = trimmed(build(given).lift, lift, climb)
    return build(replace(given, pitch=lambda t: collective + change(t)))


def induced(thrust: float) -> float:
    """Induced velocity of a thrust, by the momentum of the air."""
    return float(np.sqrt(thrust / (2.0 * AIR * np.pi * RADIUS**2)))


def settled(model: Model, velocity: tuple[float, float, float], depth: float | None = None) -> Phase:
    """Phase in which nothing vibrates: blades coned, mounts pressed, by Newton's method: velocity (3,)."""
    tree, b = model.tree, model.directions
    roots = [int(tree.v_start[k]) for k in np.flatnonzero(tree.parent < 0)]
    qd = model.qd.copy()
    for root in roots:
        qd[root + 3 : root + 6] = velocity
    fixed = np.arange(roots[0], roots[0] + 6)
    # On the ground nothing says where it stands, or which way it looks.
    held = fixed if depth is None else fixed[2:5]
    moves = b[:, [k for k in range(b.shape[1]) if not np.any(b[held, k])]]
    system = model.system

    def lacking(q: Floats) -> Floats:
        at = system.at(q, qd)
        qdd = system.accelerations(0.0, at.q, at.qd, at.torque, at.loads, at.factors)[0].copy()
        if depth is None:
            # All roots with the first; by symmetry it does not turn.
            for root in roots[1:]:
                qdd[root : root + 6] -= qdd[fixed]
            qdd[fixed] = 0.0
        qdd[tree.driven_v] = 0.0
        return qdd

    down = np.zeros(tree.n_v)
    down[[root + 5 for root in roots]] = -(depth or 0.0)
    q = multibody.integrate(tree, model.q, down)
    for _ in range(12 if moves.shape[1] else 0):
        found = lacking(q)
        # A step of 1e-6 in each direction.
        slopes = [(lacking(multibody.integrate(tree, q, 1e-6 * m)) - found) / 1e-6 for m in moves.T]
        step = np.linalg.lstsq(np.array(slopes).T, -found, rcond=1e-9)[0]
        q = multibody.integrate(tree, q, moves @ step)
        if np.max(np.abs(step)) < 1e-10:
            break
    return system.at(q, qd)
