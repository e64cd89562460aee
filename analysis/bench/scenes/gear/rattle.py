"""Gears that rattle: the driving wheel shakes, the driven one goes to and fro in the play of its teeth.

With its drag T, inertia I and base radius r, it leaves a wheel that shakes by A sin wt (m, on the line of
action) where A w^2 > T r / I; while they turn, pairs that come and go shake it too, and it leaves before.
Without drag it flies from flank to flank (Karagiannis, Pfeiffer, Nonlinear Dyn. 2:367, 1991). Of its motions
that of two blows a period, alike but for the sign, has a closed form: with restitution e, play D, phase f of
the blows and k = (1 + e) / (1 - e), D = 2 A sin f + pi k A cos f, and its speed is k A w cos f. It is stable
only where tan f < 2 / (pi k).
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pandas as pd
from scipy.optimize import brentq

from bench.cases import Found, check
from bench.scenes.gear.mesh import Gear, gears, meshing_of
from bench.scenes.gear.quasi import near
from protochain.core.arrays import Floats
from protochain.mechanics.motion import DormandPrince
from protochain.mechanisms import Run
from protochain.mechanisms.contact import Law, real_restitution

AMPLITUDE = 20e-6
"""m, along the line of action."""
RATE = 2.0 * np.pi * 50.0
"""rad/s: firing of an engine of four cylinders at 1500 rpm."""
PLAY = 100e-6
"""m: some 0.1 mm is left between teeth of module 4."""
HARD = 1e14
"""N/m^1.5. Flanks so hard that blows take a thousandth of the motion."""
DRAG = Gear(torque=0.1, backlash=PLAY)
"""Idling: a thousandth of the torque."""


def shaken(
    gear: Gear, amplitude: float, periods: float, phase: float, give: float, turning: float = 0.0,
    rigid: bool = True, step: float = 1e-4,
) -> Run:  # fmt: skip
    """Run of gears whose driving wheel turns, and shakes by A sin(wt + f) along the line of action.

    The driven wheel begins so far behind, and turns as ``gear.speed`` says.
    """
    one, other = gear.pair.wheels
    a, w = amplitude / one.base, RATE

    def motion(t: float) -> tuple[float, float, float]:
        sine, cosine = a * np.sin(w * t + phase), a * np.cos(w * t + phase)
        return turning * t + sine, turning + w * cosine, -w * w * sine

    until = periods * 2.0 * np.pi / w
    live = near(gear, min(0.0, -amplitude), turning * one.base * until + amplitude + PLAY)
    start = (amplitude * np.sin(phase) - give) / other.base
    model = gears(gear, live, rigid, {"wheel 1": start}, motion)
    return model.simulate(until, step, DormandPrince(1e-11))


def dragged(
    amplitude: float, periods: float, turning: float = 0.0, rigid: bool = True, along: bool = False
) -> Run:
    """Run from where the driving wheel is farthest back, and its flanks bear the other."""
    gear = replace(DRAG, speed=turning, along=along)
    force = gear.torque * gear.ratio / gear.pair.wheels[1].base * (1.0 + amplitude / threshold())
    give = (force / gear.flank.stiffness) ** (1.0 / gear.flank.exponent)
    return shaken(gear, amplitude, periods, -0.5 * np.pi, give, turning, rigid)


def threshold() -> float:
    """Amplitude from which the driven wheel leaves the flanks that shake it: T r / (I w^2)."""
    wheel, inertia = DRAG.pair.wheels[1], DRAG.inertias[1][0]
    return DRAG.torque * DRAG.ratio * wheel.base / (inertia * RATE**2)


def parts_at() -> float:
    """Amplitude from which front flanks part within two periods."""
    low, high = 0.96 * threshold(), 1.04 * threshold()
    for _ in range(4):
        middle = 0.5 * (low + high)
        front, _ = forces(dragged(middle, 2.0))
        low, high = (low, middle) if np.any(front == 0.0) else (middle, high)
    return 0.5 * (low + high)


def forces(run: Run) -> tuple[Floats, Floats]:
    """(n,) float each: force of all front flanks over time, and of all back flanks."""
    meshing = meshing_of(run.model)
    pairs = [meshing.pressing(q, qd) for q, qd in zip(run.q, run.qd, strict=True)]
    front, back = (np.array([each[each[:, 3] == side, 2].sum() for each in pairs]) for side in (0, 1))
    return front, back


def orbit(restitution: float) -> tuple[float, float]:
    """Phase and speed, rad and m/s, of the stable motion of two blows a period."""
    k = (1.0 + restitution) / (1.0 - restitution)
    turn = float(np.arctan(2.0 / (np.pi * k)))

    def lack(f: float) -> float:
        return float(AMPLITUDE * (2.0 * np.sin(f) + np.pi * k * np.cos(f)) - PLAY)

    phase = float(brentq(lack, turn - 0.5 * np.pi, turn))
    return phase, float(k * AMPLITUDE * RATE * np.cos(phase))


def flying(restitution: float, periods: int) -> tuple[Run, float]:
    """Run without drag from near a blow of that motion, and its speed."""
    phase, speed = orbit(restitution)
    loss = float(brentq(lambda c: real_restitution(c) - restitution, 0.0, 100.0))
    # Wheel and flank approach each other.
    closing = speed + AMPLITUDE * RATE * np.cos(phase)
    wheel = DRAG.pair.wheels[1]
    gear = replace(
        DRAG, torque=0.0, flank=Law(HARD, 1.5, loss / closing), speed=speed * DRAG.ratio / wheel.base
    )
    return shaken(gear, AMPLITUDE, periods, phase + 0.1, 0.0, step=5e-4), speed


def checks(quick: bool) -> Iterator[Found]:
    """Where flanks part, and the motion of two blows a period."""
    yield check("amplitude at which gears part, m", parts_at(), threshold(), 0.01, "T r / (I w^2)")
    run, speed = flying(0.4, 3 if quick else 12)
    rates = run.qd[:, run.model.bodies.freedom("wheel 1")[1]] * DRAG.pair.wheels[1].base
    last = rates[run.time > run.time[-1] - 2.0 * np.pi / RATE]
    source = "2 A sin f + pi k A cos f = D, k A w cos f"
    # Blows take time, which they have not in the closed form; and the motion begins beside it.
    bound = 0.02 if quick else 0.003
    found = float(np.median(np.abs(last)))
    yield check("speed between blows, without drag, m/s", found, speed, bound, source)
    # Of 41 rows.
    yield check("share of the time to and fro", float(np.mean(last > 0.0)), 0.5, 0.05, "two blows alike")


def rattling(quick: bool) -> pd.DataFrame:
    """What the driven wheel does, by amplitude, while its driver stands and while it turns."""
    rows = []
    for turning in (0.0, 10.0):
        for amplitude in (AMPLITUDE,) if quick else (5e-6, 10e-6, AMPLITUDE, 40e-6):
            run = dragged(amplitude, 1.0 if quick else 3.0, turning)
            front, back = forces(run)
            gap = [overlap.max() for overlap in _overlaps(run)]
            rows.append((
                turning, 1e6 * amplitude, amplitude / threshold(), float(np.mean(front + back == 0.0)),
                -1e6 * min(gap), _blows(front), _blows(back),
            ))  # fmt: skip
    names = ["turning", "amplitude_um", "of_threshold", "apart", "gap_um", "blows_front", "blows_back"]
    return pd.DataFrame(rows, columns=names)


def rattling_teeth(quick: bool) -> pd.DataFrame:
    """Share of the time without contact for rigid teeth, one stiffness, and stiffness along the flank."""
    rows = []
    for name, rigid, along in (
        ("rigid", True, False),
        ("one stiffness", False, False),
        ("along", False, True),
    ):
        for turning in (0.0,) if quick else (0.0, 10.0):
            run = dragged(AMPLITUDE, 0.1 if quick else 1.0, turning, rigid, along)
            front, back = forces(run)
            apart = float(np.mean(front + back == 0.0))
            rows.append((name, turning, apart, _blows(front), _blows(back), run.audit().energy))
    names = ["teeth", "turning", "apart", "blows_front", "blows_back", "audit"]
    return pd.DataFrame(rows, columns=names)


def _overlaps(run: Run) -> Iterator[Floats]:
    """Overlaps of front flanks, time by time."""
    meshing = meshing_of(run.model)
    for q, qd in zip(run.q, run.qd, strict=True):
        pairs = meshing.pressing(q, qd)
        yield pairs[pairs[:, 3] == 0, 1]


def _blows(force: Floats) -> int:
    """How often flanks come to touch."""
    return int(np.sum((force[1:] > 0.0) & (force[:-1] == 0.0)))
