"""Uniform beams as flexible bodies: sections, clamped bending and torsion as their shapes."""

import numpy as np
from scipy.optimize import brentq

from protochain.core.arrays import Floats
from protochain.core.errors import MechanicsError
from protochain.mechanisms.flexible.flexible import Shapes
from protochain.mechanisms.segments import Beam


def clamped_roots(k: int) -> Floats:
    """(k,) float: wave numbers of a clamped beam of unit length, the roots of 1 + cos b cosh b."""
    return np.array(
        [brentq(lambda b: np.cos(b) + 1.0 / np.cosh(b), np.pi * i, np.pi * (i + 1.0)) for i in range(k)]
    )


def clamp_shapes(x: Floats, k: int) -> tuple[Floats, Floats, Floats]:
    """Shapes of a clamped beam of unit length, of unit mean square, with two derivatives."""
    # x (n,) -> (n, k): Displacement, slope and curvature.
    b = clamped_roots(k)
    y = b * x[:, None]
    # cosh y - s sinh y = (u e^(y - b) + (1 + s) e^-y) / 2, where u = (1 - s) e^b does not cancel.
    denominator = np.sinh(b) + np.sin(b)
    u = (np.sin(b) - np.cos(b) - np.exp(-b)) / denominator * np.exp(b)
    s = 1.0 - u * np.exp(-b)
    up, down = 0.5 * u * np.exp(y - b), 0.5 * (1.0 + s) * np.exp(-y)
    shape = up + down - np.cos(y) + s * np.sin(y)
    slope = b * (up - down + np.sin(y) + s * np.cos(y))
    curvature = b**2 * (up + down + np.cos(y) - s * np.sin(y))
    return shape, slope, curvature


def assumed_modes(
    of: Beam, flap: int = 0, lag: int = 0, twist: int = 0, sections: int | None = None
) -> Shapes:
    """Make sections and shapes of a beam along the x axis of its body, clamped there at x = 0.

    Parameters
    ----------
    of : Beam
        Without rigid zones, and its mass spread along it.
    flap, lag, twist : int
        Numbers of shapes of each kind, which come in this order: bending along z (about y), bending along y
        (about z), and torsion.
    sections : int, optional
        Number of lumps, at the points of Gauss and Legendre with their weights as masses. By default enough
        for the products of the shapes. One without mass at the tip follows them.

    Returns
    -------
    Shapes
        Sections from the clamped end to the tip. A beam that flaps and lags shortens by both.

    Raises
    ------
    MechanicsError
        If a shape has no stiffness, or a torsion shape no inertia, or if zones are rigid, or masses lumped.
    """
    if of.rigid or of.lumped:
        raise MechanicsError("shapes require beams without rigid zones and lumped masses; use segments")
    for name, axis, count in (("flap", "y", flap), ("lag", "z", lag), ("twist", "x", twist)):
        if count and not of.stiffness(axis) > 0.0:
            raise MechanicsError(f"a beam with shapes of {name} needs a stiffness {name} above zero")
    if twist and not of.polar > 0.0:
        raise MechanicsError("a beam with shapes of twist needs a moment of inertia polar above zero")
    n = sections or 4 + 3 * max(flap, lag, twist)
    points, weights = np.polynomial.legendre.leggauss(n)
    x, k = np.append(0.5 * (1.0 + points), 1.0), flap + lag + twist
    mass = of.mass * of.length * np.append(0.5 * weights, 0.0)
    moves, turns = np.zeros((n + 1, 3, k)), np.zeros((n + 1, 3, k))
    short, stiff = np.zeros((n + 1, 3, k, k)), np.zeros((k, k))
    start = 0
    # Bending along z turns about -y, along y about z.
    for along, about, sign, count, stiffness in (
        (2, 1, -1.0, flap, of.stiffness("y")), (1, 2, 1.0, lag, of.stiffness("z"))
    ):  # fmt: skip
        columns = slice(start, start + count)
        shape, slope, _ = clamp_shapes(x, count)
        moves[:, along, columns], turns[:, about, columns] = shape, sign * slope / of.length
        short[:, 0, columns, columns] = _shortening(x, count) / of.length
        stiff[columns, columns] = np.diag(stiffness / of.length**3 * clamped_roots(count) ** 4)
        start += count
    wave = np.pi * (np.arange(twist) + 0.5)
    turns[:, 0, start:] = np.sin(wave * x[:, None])
    stiff[start:, start:] = np.diag(0.5 * of.twist / of.length * wave**2)
    place = of.length * x[:, None] * np.array([1.0, 0.0, 0.0])
    inertia = np.zeros((n + 1, 3, 3))
    inertia[:, 0, 0] = of.polar * of.length * np.append(0.5 * weights, 0.0)
    return Shapes(place, mass, inertia, moves, turns, short, stiff)


def _shortening(x: Floats, k: int) -> Floats:
    """(n, k, k) float: integrals from 0 to x of products of slopes, of unit length."""
    points, weights = np.polynomial.legendre.leggauss(8 + 3 * k)
    out = np.empty((len(x), k, k))
    for i, end in enumerate(x):
        slope = clamp_shapes(0.5 * end * (1.0 + points), k)[1]
        out[i] = 0.5 * end * np.einsum("n,nk,nl->kl", weights, slope, slope)
    return out
