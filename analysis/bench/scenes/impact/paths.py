"""The velocity at one point over the normal impulse, by other means, and what an error costs."""

from collections.abc import Iterator
from functools import partial

import numpy as np
import pandas as pd
from scipy.integrate import solve_ivp

from bench.cases import Found, Point, check, tried
from bench.scenes.impact.systems import TIP, UP, Blow, brick, rods, two_rods
from protochain.core.arrays import Floats
from protochain.mechanisms import Ball, Model, Plane, flores, real_restitution
from protochain.mechanisms.impacts.path import POISSON, follow
from protochain.mechanisms.impacts.points import Struck

SMOOTH = (1e-1, 3e-2, 1e-2, 3e-3, 1e-3, 3e-4)
"""Slip, relative to the speed of approach, below which smoothed friction falls off."""
STIFF = (1e5, 1e7, 1e9, 1e11)
"""N/m^1.5, of a floor that gives way."""
TOLERANCES = (1e-2, 1e-3, 1e-4, 1e-6, 1e-8, 1e-10, 1e-12)
KEPT = 1e-13
"""Tolerance of the reference."""
Local = tuple[Floats, Floats, float, float]
"""Inverse inertia, velocities (normal, two tangential), friction and restitution."""


def point_of(model: Model, blow: Blow) -> Local:
    """Local of a blow to a mechanism as it starts."""
    state = model.state()
    of = Struck.of(state.factors, state.qd, [blow.point(state)], None)
    return of.w, of.u, blow.friction, blow.restitution


def along(point: Local, tolerance: float) -> Floats:
    """(3,) float: velocities after, by Poisson's law, along the path as the library follows it."""
    w, u, mu, e = point
    out = np.empty(8)
    follow(w, u, mu, e, POISSON, 0.0, tolerance, out)
    return np.asarray(u + w @ out[:3])


def integrated(point: Local, tolerance: float, smooth: float = 0.0) -> tuple[Floats, Floats, Floats]:
    """Integrate du/dp = W (1, t) by scipy, t = -mu u_t/|u_t|, to the end by Poisson's law.

    -> (3,): Velocities after; normal impulses and velocities on the way.
    """
    w, u, mu, e = point
    least = (smooth * u[0]) ** 2

    def slope(p: float, y: Floats) -> Floats:
        slip = np.sqrt(y[1] ** 2 + y[2] ** 2 + least)
        return np.asarray(w @ np.array([1.0, -mu * y[1] / slip, -mu * y[2] / slip]))

    def pressed(p: float, y: Floats) -> float:
        return float(y[0])

    pressed.terminal, pressed.direction = True, 1.0  # type: ignore[attr-defined]  # as scipy reads them
    solve = partial(
        solve_ivp, slope, method="Radau" if smooth else "DOP853", rtol=tolerance, atol=tolerance * abs(u[0])
    )
    first = solve((0.0, -100.0 * u[0] / w[0, 0]), u, events=pressed)
    end = first.t[-1]
    second = solve((end, (1.0 + e) * end), first.y[:, -1])
    return second.y[:, -1], np.append(first.t, second.t[1:]), np.hstack([first.y, second.y[:, 1:]]).T


def rods_by_hand() -> Floats:
    """(2,) float: normal and tangential velocity of the rods' tip after, friction 0.7, restitution 0.5.

    The equations of the double pendulum, in extended precision: the tip is compressed while it slips, sticks
    on the way back, and leaves by Poisson's law.
    """
    real = np.longdouble
    a, b = (real(degrees) * (np.arctan(real(1)) / 45) for degrees in (20, 30))
    # In angles from the vertical: M of two uniform rods; the tip is at (sin a + sin b, -cos a - cos b).
    m11, m12, m22 = real(4) / 3, np.cos(a - b) / 2, real(1) / 3
    det = m11 * m22 - m12 * m12
    inverse = np.array([[m22, -m12], [-m12, m11]]) / det
    g = np.array([[np.sin(a), np.sin(b)], [np.cos(a), np.cos(b)]])
    w = g @ inverse @ g.T
    normal, slip = g @ np.array([real(-1) / 10, real(-1) / 5])
    friction = real(7) / 10
    # The tip slips towards -x, so that friction points to +x; the slip ends after the compression.
    fast, steep = w[0, 0] + friction * w[0, 1], w[0, 0] - w[0, 1] ** 2 / w[1, 1]
    compressed, stopped = -normal / fast, -slip / (w[0, 1] + friction * w[1, 1])
    return np.array([normal + fast * stopped + steep * (1.5 * compressed - stopped), 0.0], dtype=float)


def velocities(point: Local, tolerance: float, smooth: float = 0.0) -> Floats:
    """(3,) float: velocities after, as :func:`integrated` finds them."""
    return integrated(point, tolerance, smooth)[0]


def work(quick: bool) -> Iterator[Point]:
    """Error of the velocities after, relative to those before, against seconds."""
    plane, space = point_of(*rods(0.7)), point_of(*brick())
    exact, reference = rods_by_hand(), integrated(space, KEPT)[0]
    fast, slow = float(np.linalg.norm(plane[1])), float(np.linalg.norm(space[1]))
    repeats, few, more = (20, 2, 3) if quick else (200, None, None)

    def of_rods(after: Floats) -> float:
        return (abs(after[0] - exact[0]) + float(np.linalg.norm(after[1:]))) / fast

    def of_brick(after: Floats) -> float:
        return float(np.linalg.norm(after - reference)) / slow

    ways = [("rods: exact pieces", "", partial(along, plane, 1e-10), of_rods, repeats)]
    label = "rods: smoothed friction, Radau"
    ways += [(label, f"{w:g}", partial(velocities, plane, 1e-8, w), of_rods, 1) for w in SMOOTH[:few]]
    yield from (tried(*way) for way in ways)
    for k in STIFF[:few]:
        floor, label = partial(soft_floor, k, 300), "rods without friction: soft floor"
        yield tried(label, f"{k:g}", floor, lambda ends: abs(ends[0] - ends[1]) / fast, 2)
    label = "brick: path, Dormand-Prince"
    ways = [(label, f"{t:g}", partial(along, space, t), of_brick, repeats) for t in TOLERANCES]
    label = "brick: du/dp, DOP853 of scipy"
    ways += [(label, f"{t:g}", partial(velocities, space, t), of_brick, 1) for t in TOLERANCES[:more]]
    label = "brick: smoothed friction, Radau"
    ways += [(label, f"{w:g}", partial(velocities, space, 1e-8, w), of_brick, 1) for w in SMOOTH[:few]]
    yield from (tried(*way) for way in ways)


def soft_floor(stiffness: float, steps: int) -> tuple[float, float]:
    """Let the rods' tip sink into a floor without friction, and come out of it."""
    model, blow = rods(0.0)
    (w, *_), (u, *_) = point_of(model, blow)[:2]
    law = flores(stiffness, 0.5, -u)
    height = float(model.state().point("lower", TIP)[2])
    m = two_rods()
    m.contact("floor", [Ball("lower", 0.0, TIP)], Plane("world", (0.0, 0.0, height), UP), law)
    # Hertz' time of contact; damped, it is longer.
    until = 2.0 * 3.0 * ((1.0 / w[0]) ** 2 / (stiffness**2 * -u)) ** 0.2
    soft = m.build()
    run = soft.simulate(until, until / steps, every=steps)
    after = float(soft.state(run.end).velocity("lower", TIP)[2])
    return after, -u * real_restitution(law.damping * -u)


def path_checks() -> Iterator[Found]:
    """Both problems of the work against their references."""
    after = along(point_of(*rods(0.7)), 1e-10)
    yield check(
        "tip of the rods after, mu 0.7, m/s", after[0], rods_by_hand()[0], 1e-13,
        "double pendulum by hand, in extended precision",
    )  # fmt: skip
    point = point_of(*brick())
    found, expected = along(point, 1e-10), integrated(point, KEPT)[0]
    for name, i in (("normal", 0), ("first tangential", 1), ("second tangential", 2)):
        yield check(
            f"corner of the brick after, {name}, m/s", found[i], expected[i], 1e-9, "DOP853 over the impulse"
        )


def traces() -> pd.DataFrame:
    """Velocities over the normal impulse: rods, of either friction, and the brick."""
    parts = []
    for name, made in (("rods, mu 0.7", rods(0.7)), ("rods, mu 0.5", rods(0.5)), ("brick", brick())):
        _, p, u = integrated(point_of(*made), 1e-8, 0.0 if name == "brick" else 1e-4)
        columns = {"normal": u[:, 0], "first": u[:, 1], "second": u[:, 2]}
        parts.append(pd.DataFrame({"of": name, "impulse": p, **columns}))
    return pd.concat(parts, ignore_index=True)
