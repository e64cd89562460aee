"""Beams of the scene, and what they are held against."""

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from numpy.polynomial import Legendre
from scipy.linalg import eigh, eigvalsh

from protochain.core.arrays import Floats
from protochain.mechanics.multibody import mass_matrix, multiply_mass, pose
from protochain.mechanisms import Mechanism, Model
from protochain.mechanisms.segments import Beam, add_beam

UNIT = Beam(length=1.0, mass=1.0, bending=1.0)
ROOTS = np.array([1.8751040687119611, 4.6940911329741746, 7.8547574382376126])
"""Of cos b cosh b = -1: the frequencies of a cantilever are their squares."""
EULER = "Euler-Bernoulli"
SPUN = Beam(length=10.0, mass=1.2, bending=1.4e4)
SPIN_TIME, SPIN_RATE = 15.0, 6.0


def built(beam: Beam, cells: int, joint: dict[str, Any] | None = None, **more: Any) -> Model:
    """Build a beam at the world's origin, by default clamped."""
    mechanism = Mechanism()
    add_beam(mechanism, "beam", beam, cells, joint=joint or {"kind": "fixed"}, **more)
    return mechanism.build()


def spun(beam: Beam, cells: int, motion: Callable[[float], tuple[float, float, float]], bends: str) -> Model:
    """Build a beam whose root is turned about z, in a given motion."""
    mechanism = Mechanism()
    add_beam(mechanism, "beam", beam, cells, joint={"axis": (0, 0, 1)}, bends=bends)
    mechanism.drive("beam", motion)
    return mechanism.build()


def steady(rate: float) -> Callable[[float], tuple[float, float, float]]:
    """Turn at a constant rate."""
    return lambda t: (rate * t, rate, 0.0)


def spin_up(t: float) -> tuple[float, float, float]:
    """Angle, rate and acceleration of the root: smoothly from rest to 6 rad/s in 15 s."""
    if t >= SPIN_TIME:
        return SPIN_RATE * (t - 0.5 * SPIN_TIME), SPIN_RATE, 0.0
    share, w = SPIN_RATE / SPIN_TIME, 2.0 * np.pi / SPIN_TIME
    angle = share * (0.5 * t * t + (np.cos(w * t) - 1.0) / w**2)
    return angle, share * (t - np.sin(w * t) / w), share * (1.0 - np.cos(w * t))


def deflections(q: Floats, lengths: Floats) -> Floats:
    """(n,) float: deflection of the tip from the root's line, of hinge angles (n, cells) about z."""
    angles = np.cumsum(q, axis=1)
    return np.asarray(np.sin(angles) @ lengths[1:])


def at_rest(beam: Beam, cells: int, point: float = 0.0) -> Floats:
    """Frequencies of a clamped beam, perhaps with a mass at its tip: all springs are alike, and on hinges."""
    mechanism = Mechanism()
    segments = add_beam(mechanism, "beam", beam, cells)
    if point:
        mechanism.body("point", point)
        mechanism.hinge("end", parent=segments.tip[0], child="point", kind="fixed", at=segments.tip[1])
    model = mechanism.build()
    mass = mass_matrix(model.tree, pose(model.tree, model.q))
    # The largest eigenvalues are the exact ones, and belong to the lowest frequencies.
    return np.sqrt(_stiffness(beam, cells) / eigvalsh(mass)[::-1])


def _stiffness(beam: Beam, cells: int) -> float:
    return beam.stiffness("z") * cells / ((1.0 - 2.0 * beam.rigid) * beam.length)


@cache
def ritz(rate: float, count: int = 40) -> tuple[float, ...]:
    """Flap frequencies of a clamped beam that rotates, by Ritz in x^2 times Legendre's polynomials."""
    nodes, weights = np.polynomial.legendre.leggauss(2 * count)
    x, weights = 0.5 * (nodes + 1.0), 0.5 * weights
    value, slope, bend = [], [], []
    for k in range(count):
        p = Legendre.basis(k, [0.0, 1.0])
        first, second = p.deriv(1), p.deriv(2)
        value.append(x * x * p(x))
        slope.append(2.0 * x * p(x) + x * x * first(x))
        bend.append(2.0 * p(x) + 4.0 * x * first(x) + x * x * second(x))
    f, df, ddf = np.array(value), np.array(slope), np.array(bend)
    stiffness = (ddf * weights) @ ddf.T + rate**2 * (df * weights * 0.5 * (1.0 - x * x)) @ df.T
    return tuple(np.sqrt(eigh(stiffness, (f * weights) @ f.T, eigvals_only=True))[:6])


def lowest(beam: Beam, cells: int) -> float:
    """First frequency in O(n) a step: inverse iteration, with M x by Newton-Euler; K is diagonal."""
    model = built(beam, cells)
    frames, k = pose(model.tree, model.q), _stiffness(beam, cells)
    x, w = np.linspace(1.0, 0.0, cells), 0.0
    for _ in range(30):
        product = multiply_mass(model.tree, frames, x) / k
        w, before = float(np.sqrt((x @ x) / (x @ product))), w
        x = product / np.linalg.norm(product)
        if abs(w - before) <= 1e-14 * w:
            break
    return w
