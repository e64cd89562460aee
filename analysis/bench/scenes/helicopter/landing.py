"""Cases: touchdown, run-up, gust and a step of the pitch, with their traces; and their closed forms."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pandas as pd
from scipy.linalg import expm

from bench.scenes.helicopter.lift import Motion
from bench.scenes.helicopter.parts import (
    BLADE_MASS,
    BLADES,
    FUSELAGE,
    GRAVITY,
    HEIGHT,
    MOUNT,
    RATE,
    TRANSMISSION,
    WEIGHT,
    Design,
    Helicopter,
    build,
    flying,
    settled,
)  # fmt: skip
from protochain.core.arrays import Floats
from protochain.mechanics import multibody
from protochain.mechanics.motion import Integrator
from protochain.mechanisms import Run, State

MASS = WEIGHT / GRAVITY
RIGID = Design(cells=0, mounts=False)
SINKS = (0.5, 1.0, 2.0, 3.0)
LIFT = 2.0 / 3.0


def touchdown(
    given: Design, sink: float, until: float, time_step: float,
    integrator: Integrator | None = None, drift: float = 0.0, every: int = 1, share: float = LIFT,
) -> tuple[Helicopter, Run]:  # fmt: skip
    """Let a helicopter touch the ground at time zero, at a rate of sinking, and drifting sideways.

    On a slope, its shaft upright, it touches with the feet that are uphill.
    """
    helicopter = flying(given, share, -sink) if share else build(given)
    # In the air still, where the legs do nothing.
    above = replace(helicopter.given, legs=None)
    start = settled(build(above).model, (0.0, drift, -sink))
    q = _raised(helicopter, start.q)
    start = helicopter.model.system.at(q, start.qd)
    return helicopter, helicopter.model.simulate(until, time_step, integrator, every, start)


def _raised(helicopter: Helicopter, q: Floats) -> Floats:
    """Coordinates at which the first foot just touches, if it would stand in a slope."""
    legs, tree = helicopter.given.legs, helicopter.model.tree
    if legs is None or not legs.slope:
        return q
    depths = -np.add(np.asarray(legs.feet), (0.0, 0.0, HEIGHT)) @ legs.normal
    up = np.zeros(tree.n_v)
    up[tree.v_start[:-1][tree.parent < 0] + 5] = np.max(depths) / legs.normal[2]
    return multibody.integrate(tree, q, up)


def traced(helicopter: Helicopter, run: Run) -> pd.DataFrame:
    """Legs' forces, height, tilt, and how far the tips of the blades are above the hub, along the shaft."""
    legs, rows = helicopter.given.legs, []
    for time, q, qd in zip(run.time, run.q, run.qd, strict=True):
        state = _state(helicopter, time, q, qd)
        turn = state.rotation("fuselage")
        shaft = state.rotation("hub")[:, 2]
        hub = state.point("hub")
        forces = legs.forces(state) if legs else np.zeros(4)
        tips = [float(shaft @ (state.point(*blade.tip) - hub)) for blade in helicopter.blades]
        place, speed = state.point("fuselage"), state.velocity("fuselage")
        tilt = float(np.degrees(np.arccos(np.clip(turn[2, 2], -1.0, 1.0))))
        rows.append((time, *forces, np.sum(forces), place[2], speed[2], place[1], tilt, *tips))
    names = [f"leg {k + 1}" for k in range(4)] + ["legs", "height", "climb", "drift", "tilt"]
    return pd.DataFrame(rows, columns=["time", *names, *(f"tip {k + 1}" for k in range(BLADES))])


def _state(helicopter: Helicopter, time: float, q: Floats, qd: Floats) -> State:
    bodies = helicopter.model.bodies
    return State(bodies, time, q, qd, multibody.pose(bodies.tree, q))


def heave_damping(helicopter: Helicopter) -> float:
    """Loss of lift for unit speed of climbing."""
    return helicopter.lift.thrust(0.0, 0.0) - helicopter.lift.thrust(0.0, 1.0)


def oscillator(
    times: Floats, stiffness: float, damping: float, air: float, sink: float, down: float, mass: float = MASS
) -> tuple[Floats, Floats]:
    """Depth of the feet and force of linear legs (n,) of a rigid helicopter: a damped oscillator.

    times (n,).
    -> (n,): Valid until the force is zero.
    """
    # m d'' + (c + air) d' + k d = down + air sink, from d = 0, d' = sink.
    both = damping + air
    at_rest = (down + air * sink) / stiffness
    a = 0.5 * both / mass
    w = np.emath.sqrt(stiffness / mass - a * a)
    swing = np.exp(-a * times)
    sine = swing * np.sin(w * times) / w
    cosine = swing * np.cos(w * times)
    lead = sink - a * at_rest
    depth = np.real(at_rest - at_rest * cosine + lead * sine)
    rate = np.real(sink * cosine + (stiffness / mass * at_rest - a * sink) * sine)
    return depth, stiffness * depth + damping * rate


def two_masses(times: Floats, helicopter: Helicopter, sink: float, share: float = LIFT) -> Floats:
    """(n,) float: force of linear legs under a fuselage on which all else moves on the mounts."""
    legs = helicopter.given.legs
    assert legs is not None
    k, c = 4.0 * legs.stiffness, 4.0 * legs.damping
    mount = TRANSMISSION * MOUNT**2
    loss = 0.06 / MOUNT * mount
    air = heave_damping(helicopter)
    above = TRANSMISSION + BLADES * BLADE_MASS
    # Downward displacements from the touch of the fuselage and of what it carries, their rates, and one.
    a = np.zeros((5, 5))
    a[0, 2] = a[1, 3] = 1.0
    a[2] = [-(k + mount) / FUSELAGE, mount / FUSELAGE, -(c + loss) / FUSELAGE, loss / FUSELAGE, GRAVITY]
    a[3] = [mount / above, -mount / above, loss / above, -(loss + air) / above, 0.0]
    lift = share * WEIGHT
    a[3, 4] = GRAVITY - (lift - air * sink) / above
    # The mounts are pressed, or pulled, as they are when all of it falls together.
    fall = (1.0 - share) * GRAVITY
    state = np.array([0.0, above * (a[3, 4] - air * sink / above - fall) / mount, sink, sink, 1.0])
    found = np.array([expm(a * t) @ state for t in times])
    return np.asarray(k * found[:, 0] + c * found[:, 2])


def spun_up(until: float) -> Callable[[float], tuple[float, float, float]]:
    """Motion of a shaft that reaches its rate at a time, smoothly: time -> angle, rate and acceleration."""

    def motion(t: float) -> tuple[float, float, float]:
        if t >= until:
            return RATE * (t - 0.5 * until), RATE, 0.0
        s = t / until
        angle = RATE * until * s**3 * (1.0 - 0.5 * s)
        return angle, RATE * s * s * (3.0 - 2.0 * s), 6.0 * RATE / until * s * (1.0 - s)

    return motion


def run_up(given: Design, until: float, time_step: float, every: int) -> tuple[Helicopter, Run]:
    """Spin the rotor up on the ground, without lift, smoothly to its rate."""
    helicopter = build(replace(given, motion=spun_up(until)))
    depth = WEIGHT / (4.0 * given.legs.stiffness) if given.legs else None
    start = settled(helicopter.model, (0.0, 0.0, 0.0), depth)
    return helicopter, helicopter.model.simulate(until, time_step, every=every, start=start)


def gust(time: float, size: float = 5.0, length: float = 0.5) -> float:
    """Upward gust, size (1 - cos) / 2 over its length."""
    return 0.5 * size * (1.0 - np.cos(2.0 * np.pi * time / length)) if 0.0 < time < length else 0.0


def step(time: float, size: float = 0.02, length: float = 0.1) -> float:
    """Pitch that rises by a size over a length of time, with a smooth rate."""
    share = min(max(time / length, 0.0), 1.0)
    return size * (share - np.sin(2.0 * np.pi * share) / (2.0 * np.pi))


def hovering(
    given: Design, until: float, time_step: float, every: int = 1,
    wind: Motion | None = None, change: Motion | None = None, integrator: Integrator | None = None,
) -> tuple[Helicopter, Run]:  # fmt: skip
    """Hover far from the ground, through a gust or a change of the pitch."""
    given = replace(given, legs=None, gust=wind or (lambda t: 0.0))
    helicopter = flying(given, 1.0, 0.0, change or (lambda t: 0.0))
    start = settled(helicopter.model, (0.0, 0.0, 0.0))
    return helicopter, helicopter.model.simulate(until, time_step, integrator, every, start)


def climbing(helicopter: Helicopter, until: float, wind: Motion | None, change: Motion | None) -> float:
    """Speed of a rigid helicopter after a hover, of M z'' = - air (z' - w) + dL/dtheta theta."""
    air = heave_damping(helicopter)
    r, dr = np.array([(strip.radius, strip.width) for strip in helicopter.lift.strips]).T
    by_pitch = helicopter.lift.constant * float(np.sum((RATE * r) ** 2 * dr))
    nodes, weights = np.polynomial.legendre.leggauss(40)
    total, pieces = 0.0, 40
    for piece in range(pieces):
        t = until * (piece + 0.5 * (nodes + 1.0)) / pieces
        pushing = np.array(
            [(air * wind(x) if wind else 0.0) + (by_pitch * change(x) if change else 0.0) for x in t]
        )
        total += float(weights @ (pushing * np.exp(-air / MASS * (until - t)))) * 0.5 * until / pieces / MASS
    return total
