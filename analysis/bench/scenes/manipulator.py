"""An arm of three flexible links: cells, explicit and implicit integrators, rigid ends.

After Megahed, Hamza, Robotica 22:285 (2004), of which no data were found. What is known of it from others,
and where it is:

===========================================  ====================================================
flexible links as rigid segments on springs  ``mechanisms.segments``; frequencies: scene ``beam``
links with rigid ends                        ``Beam.rigid``, here and in the scene ``beam``
an arm whose motors move as prescribed       here, against Exudyn and scipy
===========================================  ====================================================

Chosen are steel links of 1, 0.8 and 0.6 m, 40 mm high and 10 mm thick, on a smooth table, whose motors turn
with a sin(2 pi t) for a second. Left out: its own figures, which are not known.
"""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from scipy.integrate import solve_ivp

from bench.cases import WORK, Found, Point, Scene, check, judged, left_out, table, tried, vanishes
from bench.cost import timed
from bench.fits import extrapolated, order
from protochain.core.arrays import Floats
from protochain.core.errors import Fault
from protochain.mechanics.motion import DormandPrince, ImplicitMidpoint, Integrator, RungeKutta4
from protochain.mechanisms import Beam, Mechanism, Model, Rosenbrock, add_beam, frequencies, state_matrix

LENGTHS, TORQUES, START = (1.0, 0.8, 0.6), (60.0, 20.0, 5.0), (0.0, 0.3, 0.3)
"""m, N m, and rad from the link before, at the start."""
BENDING, MASS = 2.1e11 * 0.04 * 0.01**3 / 12.0, 7850.0 * 0.04 * 0.01
"""N m^2 and kg/m of steel, 40 mm x 10 mm, bent across the 10 mm."""
TWIST, POLAR = 8.0e10 * 0.04 * 0.01**3 / 3.0, 7850.0 * (0.04 * 0.01**3 + 0.01 * 0.04**3) / 12.0
"""N m^2 and kg m of the same section in twist."""
DAMPING = 1e-3
"""s. Time constant of dampers at all hinges between rods, where there are any."""
SHARES = (0.0, 0.0125, 0.03125, 0.0625)
"""Of the length, rigid at each end."""
UNTIL = 1.0
STABLE = 2.8
"""Frequency times step up to which Kutta's method is stable."""
EXUDYN = (1.301284, 1.573364)
"""m. End of the arm after a second, by Exudyn 1.13.6: four ANCF cable elements a link, with EA of the steel,
4000 steps of the generalised-alpha method; with 2000 steps, or three elements, the same to 4e-6."""
IMPLICIT: tuple[tuple[str, str, Integrator, float], ...] = (
    *(("midpoint", f"{1e3 * h:g} ms", ImplicitMidpoint(), h) for h in (0.02, 0.01, 0.005, 0.0025)),
    *(("Rosenbrock", f"{t:g}", Rosenbrock(t), 0.02) for t in (1e-3, 1e-4, 1e-5)),
)
"""Method, setting, and step: Rosenbrock's substeps follow its tolerance."""
Tip = tuple[str, tuple[float, float, float]]


def motor(torque: float) -> Callable[[float], float]:
    """Torque of a motor over time."""
    return lambda t: torque * float(np.sin(2.0 * np.pi * t / UNTIL))


def arm(
    cells: int, rigid: float = 0.0, factor: float = 1.0, torque: float = 1.0, **more: Any
) -> tuple[Model, Tip]:
    """Build the arm; return its end, too."""
    payload, polar = more.pop("payload", 0.0), more.pop("polar", 0.0)
    mechanism, above, at = Mechanism(), "world", (0.0, 0.0, 0.0)
    for k, (length, size, angle) in enumerate(zip(LENGTHS, TORQUES, START, strict=True)):
        name, joint = f"link {k}", dict[str, Any](at=at, q=angle)
        if cells:
            bending = factor * 16.0 * BENDING, factor * BENDING
            beam = Beam(length, MASS, bending, rigid=rigid, twist=TWIST, polar=polar)
            segments = add_beam(mechanism, name, beam, cells, above, joint, **more)
            above, at = segments.tip
        else:
            inertia = MASS * length**3 / 12.0
            mechanism.body(name, MASS * length, com=(0.5 * length, 0, 0), inertia=(0.0, inertia, inertia))
            mechanism.hinge(name, parent=above, child=name, **joint)
            above, at = name, (length, 0.0, 0.0)
        mechanism.torque(f"motor {k}", name, motor(torque * size))
    if payload:
        mechanism.body("payload", payload)
        mechanism.hinge("grip", parent=above, child="payload", kind="fixed", at=at)
    return mechanism.build(), (above, at)


def end_of(model: Model, tip: Tip, integrator: Integrator, time_step: float, until: float = UNTIL) -> Floats:
    """(2,) float: end of the arm at a time, without the table and audit of a run."""
    at, n = model.start(), max(1, round(until / time_step))
    for _ in range(n):
        at = integrator.step(model.system, at, until / n)
    return model.state(at).point(*tip)[:2]


def explicit(cells: int, share: float = 0.43, **more: Any) -> Floats:
    """End of the arm by Kutta's method, with a step of this share of the longest that is stable."""
    model, tip = arm(cells, **more)
    return end_of(model, tip, RungeKutta4(), share * STABLE / frequencies(model)[-1])


def rigid_arm() -> Floats:
    """End of the arm with rigid links, from its equations in absolute angles, by DOP853 (scipy)."""
    length, n = np.array(LENGTHS), len(LENGTHS)
    mass = MASS * length
    beyond = np.cumsum(mass[::-1])[::-1] - mass
    half = 0.5 * mass + beyond
    inertia = np.array([
        [length[i] * length[j] * half[max(i, j)] for j in range(n)] for i in range(n)
    ])  # fmt: skip
    inertia[np.diag_indices(n)] = length**2 * (mass / 3.0 + beyond)

    def rates(t: float, y: Floats) -> Floats:
        apart = y[:n, None] - y[None, :n]
        torques = np.array(TORQUES) * np.sin(2.0 * np.pi * t / UNTIL)
        # Each motor turns its own link, and the link before it back.
        force = torques - np.append(torques[1:], 0.0) - (inertia * np.sin(apart)) @ y[n:] ** 2
        return np.concatenate([y[n:], np.linalg.solve(inertia * np.cos(apart), force)])

    start = np.concatenate([np.cumsum(START), np.zeros(n)])
    angles = solve_ivp(rates, (0.0, UNTIL), start, "DOP853", rtol=1e-12, atol=1e-12).y[:n, -1]
    return np.array([length @ np.cos(angles), length @ np.sin(angles)])


def run(quick: bool = False) -> Scene:
    """Run the scene; quick: up to four cells a link: some seconds."""
    numbers = (1, 2, 4) if quick else (1, 2, 4, 8)
    ends = {n: explicit(n, 0.86 if quick else 0.43) for n in numbers}
    exact = extrapolated(ends[numbers[-2]], ends[numbers[-1]])
    shares, found = _by_share(SHARES[3:] if quick else SHARES)
    cells = pd.DataFrame(
        [(n, *at, np.linalg.norm(at - exact)) for n, at in ends.items()], columns=["cells", "x", "y", "error"]
    )
    return Scene(
        "manipulator", "an arm of three flexible links: where its end is after a second",
        (*_checks(ends, exact, quick), *found), _work(exact, quick), tuple(_extremes(quick)),
        tuple(_left_out(0.1 if quick else 1.0)),
        {
            "cells": cells, "rigid_ends": shares, "motion": _motion(2 if quick else 4),
            "dampers": _dampers(0.05 if quick else UNTIL),
        },
        "error of the end, m",
    )  # fmt: skip


def _checks(ends: dict[int, Floats], exact: Floats, quick: bool) -> Iterator[Found]:
    a, b, c = list(ends.values())[-3:]
    numbers = list(ends)[-3:]
    name = "order of the error in cells, {}, {} and {}".format(*numbers)
    yield check(name, order(a, b, c), 2.0, 0.1, "1/n^2", "absolute")
    off = float(np.linalg.norm(exact - extrapolated(a, b)))
    name = "limit from the last two, and from the two before, m"
    yield vanishes(name, off, 1e-4 if quick else 1e-5, "1/n^2")
    for k, axis in enumerate("xy"):
        source = "Exudyn: ANCF cables, generalised alpha"
        yield check(f"end of the arm, {axis}, m", exact[k], EXUDYN[k], 1e-5, source, "absolute")
    model, tip = arm(0)
    found, oracle = end_of(model, tip, DormandPrince(1e-11), 0.1), rigid_arm()
    for k, axis in enumerate("xy"):
        name = f"end of the arm with rigid links, {axis}, m"
        yield check(name, found[k], oracle[k], 1e-9, "its equations in absolute angles, DOP853", "absolute")
    model, tip = arm(2)
    until = 0.2 * UNTIL if quick else UNTIL
    error = model.simulate(until, 0.05, DormandPrince(1e-9)).audit().energy
    yield vanishes("energy that is no work of the motors", error, 1e-8, "their work")


def _by_share(shares: tuple[float, ...]) -> tuple[pd.DataFrame, list[Found]]:
    """End of the arm by the share of the links that is rigid, and the order with the largest."""
    rows: list[tuple[float, ...]] = []
    for share in shares:
        ends = [explicit(n, 0.86, rigid=share) for n in (1, 2, 4)]
        at = extrapolated(*ends[1:])
        moved = float(np.linalg.norm(at - rows[0][1:3])) if rows else 0.0
        rows.append((share, *at, moved, order(*ends)))
    table = pd.DataFrame(rows, columns=["rigid", "x", "y", "moved", "order"])
    name = f"order of the error in cells, ends of {100 * shares[-1]:g} %"
    return table, [check(name, table["order"].iloc[-1], 2.0, 0.1, "1/n^2", "absolute")]


def _motion(cells: int) -> pd.DataFrame:
    """Path of the end, and energies, of the flexible arm and of the rigid one."""
    parts = []
    for label, n in (("flexible", cells), ("rigid", 0)):
        model, tip = arm(n)
        step = 0.4 * STABLE / frequencies(model)[-1] if n else 0.01
        run = model.simulate(UNTIL, min(step, 0.01), RungeKutta4(), every=max(1, int(0.01 / step)))
        path = [model.state(model.system.at(q, qd)).point(*tip) for q, qd in zip(run.q, run.qd, strict=True)]
        x, y, _ = np.transpose(path)
        own = {"arm": label, "time": run.time, "x": x, "y": y, "kinetic": run.kinetic}
        parts.append(pd.DataFrame({**own, "potential": run.potential, "work": run.work.sum(axis=1)}))
    return pd.concat(parts, ignore_index=True)


def _work(exact: Floats, quick: bool) -> list[Point]:
    apart = partial(_apart, exact)
    numbers = (1, 2, 4) if quick else (1, 2, 4, 8)
    rows = [tried("Kutta, longest step", _said(n), partial(explicit, n, 0.86), apart) for n in numbers]
    for n in (1,) if quick else (1, 4):
        model, tip = arm(n)
        for label, setting, integrator, h in IMPLICIT[::2] if quick else IMPLICIT:
            end = partial(end_of, model, tip, integrator, h)
            rows.append(tried(f"{label}, {_said(n)}", setting, end, apart))
    return rows


def _apart(exact: Floats, at: Floats) -> float:
    return float(np.linalg.norm(at - exact))


def _said(cells: int) -> str:
    return f"{cells} cell" if cells == 1 else f"{cells} cells"


def _damped_limit(cells: int) -> float:
    """Longest stable step of Kutta's method with dampers: of the quickest decay, some tau w^2."""
    return 2.785 / -float(np.linalg.eigvals(state_matrix(arm(cells, damping=DAMPING)[0])).real.min())


def _dampers(until: float) -> pd.DataFrame:
    """Seconds and error of integrators with four cells a link and dampers, against Kutta's method."""
    model, tip = arm(4, damping=DAMPING)
    step = 0.9 * _damped_limit(4)
    exact, seconds = timed(partial(end_of, model, tip, RungeKutta4(), step, until))
    rows = [Point("Kutta, longest step", f"{1e3 * step:.2g} ms", seconds, 0.0)]
    for label, setting, integrator, h in IMPLICIT[1:]:
        end = partial(end_of, model, tip, integrator, h, until)
        rows.append(tried(label, setting, end, partial(_apart, exact)))
    return table(rows, WORK)


def _damped(share: float) -> Found:
    """Run of Kutta's method with dampers and a step of this share of the longest."""
    model, _ = arm(3, damping=DAMPING)
    run = model.simulate(0.05, share * _damped_limit(3), RungeKutta4())
    return vanishes("energy", run.audit().energy, 1e-2, "work and dissipation")


def _stiff(factor: float) -> Found:
    """Arm so stiff that it is rigid, by an L-stable method: its bend is that of EI over the factor."""
    model, tip = arm(2, factor=factor)
    at = end_of(model, tip, Rosenbrock(), 0.001)
    off = float(np.linalg.norm(at - rigid_arm()))
    # What bends for the steel itself is 0.03 m; and the error of the steps.
    return vanishes("end, m", off, 0.05 / factor + 1e-5, "rigid links, DOP853")


def _heavy(payload: float) -> Found:
    """Arm with a payload that hardly moves, against the motors' work."""
    model, _ = arm(1, payload=payload)
    error = model.simulate(0.2, 0.01, DormandPrince(1e-9)).audit().energy
    return vanishes("energy", error, 1e-7, "work of the motors")


def _unmoved() -> Found:
    model, tip = arm(4, torque=0.0)
    start = model.state().point(*tip)[:2]
    off = float(np.linalg.norm(end_of(model, tip, ImplicitMidpoint(), 0.01, 0.1) - start))
    return vanishes("end, m", off, 1e-12, "the start")


def _many(cells: int) -> Found:
    """Arm of many cells for a moment, by steps that are far too long for an explicit method."""
    model, tip = arm(cells)
    at = end_of(model, tip, Rosenbrock(), 0.002, 0.02)
    coarse, rest = arm(4)
    other = end_of(coarse, rest, Rosenbrock(), 0.002, 0.02)
    return vanishes("end, m", float(np.linalg.norm(at - other)), 1e-5, "four cells")


def _too_long() -> Found:
    model, _ = arm(2)
    run = model.simulate(UNTIL, 3.0 * STABLE / frequencies(model)[-1], RungeKutta4())
    return vanishes("energy", run.audit().energy, 1e-2, "work")


def _extremes(quick: bool) -> Iterator[Found]:
    for factor in (1e6,) if quick else (1e2, 1e6):
        yield judged(f"{factor:g} times as stiff, 1 ms steps", partial(_stiff, factor))
    for payload in (1e-6, 1e6):
        yield judged(f"payload of {payload:g} kg", partial(_heavy, payload))
    yield judged("no torque", _unmoved)
    cells = 16 if quick else 64
    yield judged(f"{cells} cells a link, 2 ms steps", partial(_many, cells))
    name = f"dampers of {1e3 * DAMPING:g} ms, explicit steps of {{}} of the longest"
    yield judged(name.format("0.9"), partial(_damped, 0.9))
    yield judged(name.format("1.1"), partial(_damped, 1.1), Fault.STEP)
    yield judged("steps three times too long for Kutta's method", _too_long, Fault.STEP)


def _left_out(until: float) -> Iterator[Found]:
    """Bending out of the plane and twist, and the springs of links that may as well be rigid."""

    def moved(bends: str) -> Floats:
        model, tip = arm(2, bends=bends, polar=POLAR)
        return end_of(model, tip, RungeKutta4(), 2e-4, 0.02)

    what = "bending out of the plane, and twist"
    yield left_out(what, partial(moved, "xyz"), partial(moved, "z"), 1e-9, 2)

    def hard(cells: int) -> Floats:
        model, tip = arm(cells, factor=1e6)
        return end_of(model, tip, Rosenbrock() if cells else RungeKutta4(), 0.001, until)

    what = "springs of links a million times as stiff: rigid links instead"
    yield left_out(what, partial(hard, 2), partial(hard, 0), 1e-5, 1)
