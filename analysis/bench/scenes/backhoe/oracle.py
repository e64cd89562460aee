"""The arm in a plane, by the principle of d'Alembert: places by trigonometry, the rest by differences.

It shares nothing with the mechanics but masses and lengths.
"""

import numpy as np

from bench.scenes.backhoe.machine import (
    ARM,
    BARREL,
    CYLINDERS,
    HOUSE,
    HOUSE_AT,
    LOWER,
    LOWER_AT,
    RING,
    ROD,
    WEIGHT_AT,
    Design,
    G,
    Path,
)
from bench.scenes.bucket.backhoe import BODIES
from protochain.core.arrays import Floats

_NUDGE = 1e-5
_TICK = 1e-4


def parts(angles: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Bodies of the arm and its cylinders, in the plane of the house's axes x and z: angles (3,)."""
    masses, inertias, places, turns = [], [], [], []
    pin: Floats = np.zeros(2)
    base: Floats = np.zeros(2)
    slant = 0.0
    for k, name in enumerate(ARM):
        cylinder = CYLINDERS[name]
        # The hinge, the foot and the eye; what turns about y by a turns (x, z) to (c x + s z, c z - s x).
        pin = base + _turned(slant, cylinder.pivot)
        foot, outer = base + _turned(slant, cylinder.foot), slant + float(angles[k])
        line = pin + _turned(outer, cylinder.eye) - foot
        length, along = float(np.hypot(*line)), -float(np.arctan2(line[1], line[0]))
        mass, com, inertia = BODIES[name]
        masses += [mass, BARREL[0], ROD[0]]
        inertias += [inertia[1], 2e-3 * BARREL[0], 2e-3 * ROD[0]]
        places += [
            pin + _turned(outer, (com[0], com[2])),
            foot + _turned(along, (BARREL[1], 0.0)),
            foot + _turned(along, (length + ROD[1], 0.0)),
        ]
        turns += [outer, along, along]
        base, slant = pin, outer
    return np.array(masses), np.array(inertias), np.array(places), np.array(turns)


def _turned(angle: float, point: tuple[float, float]) -> Floats:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([c * point[0] + s * point[1], c * point[1] - s * point[0]])


def cylinder_forces(path: Path, t: float) -> Floats:
    """(3,) float: forces of the cylinders while the house stands still, by virtual work of each angle."""
    q = path(t)[0][1:]
    masses, inertias, *_ = parts(q)
    here, before, after = (parts(path(t + dt)[0][1:]) for dt in (0.0, -_TICK, _TICK))
    pull = (after[2] - 2.0 * here[2] + before[2]) / _TICK**2 + [0.0, G]
    spin = (after[3] - 2.0 * here[3] + before[3]) / _TICK**2
    forces = []
    for k, name in enumerate(ARM):
        step = np.eye(3)[k] * _NUDGE
        up, down = parts(q + step), parts(q - step)
        moved, turned = (up[2] - down[2]) / (2.0 * _NUDGE), (up[3] - down[3]) / (2.0 * _NUDGE)
        work = float(np.sum(masses * np.sum(pull * moved, axis=1)) + np.sum(inertias * spin * turned))
        forces.append(work / CYLINDERS[name].lever(float(q[k])))
    return np.array(forces)


def middle(design: Design, angles: Floats) -> Floats:
    """(3,) float: centre of mass above the ground, in the axes of the tracks, at four angles."""
    masses, _, places, _ = parts(angles[1:])
    c, s = np.cos(angles[0]), np.sin(angles[0])
    of_house = np.vstack([
        np.column_stack([places[:, 0], 0.0 * masses, places[:, 1]]), HOUSE_AT, WEIGHT_AT,
    ])  # fmt: skip
    turned = of_house @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) + [0.0, 0.0, RING]
    all_masses = np.array([*masses, HOUSE, design.counterweight, LOWER])
    return np.asarray(all_masses @ np.vstack([turned, LOWER_AT]) / np.sum(all_masses))


def tipping_load(design: Design, angles: Floats, edge: Floats) -> float:
    """Weight at a place (3,) of the tracks' axes that takes all load off the rear."""
    front = 0.5 * design.length
    lever = float(edge[0]) - front
    return design.mass * G * (front - float(middle(design, angles)[0])) / lever
