"""A helicopter that lands and takes off: resonance, gusts, slopes, where it is safe.

After Stanislawski, Trans. Aerosp. Res. 2019(2):59, whose data were not found: those of ``parts`` are chosen.
What is known of it from others, and where it is:

=======================================  ==================================================================
fuselage, transmission on mounts, rotor  ``parts``: free bodies; the shaft turns as prescribed
blades that bend                         ``parts``: segments, in modes: three of flap, one of lag, torsion
legs with springs, dampers and friction  ``legs``: they push only
touchdown, limits of sink and drift      ``landing``, ``safety``: by bisection, with a map of what is safe
landing on a slope                       ``safety``
run-up, take-off; gust, pitch on ground  ``ground``: what each leg bears
ground resonance                         ``resonance``: Hammond's, J. Am. Helicopter Soc. 19(4):14 (1974)
=======================================  ==================================================================

Rigid blades have a closed form. Left out: cyclic pitch and forward flight, whose lift is not that of a hover;
an engine, its torque and what the rotor's speed does in take-off: the shaft turns as prescribed, and drag of
the blades, which an engine works against, is not modelled.
"""

from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd

from bench.cases import Found, Point, Scene, tried
from bench.fits import extrapolated
from bench.scenes.beam.parts import at_rest
from bench.scenes.helicopter import checks, ground, landing, safety
from bench.scenes.helicopter.extremes import limits, without
from bench.scenes.helicopter.parts import BLADE, Design
from protochain.core.arrays import Floats
from protochain.mechanics.motion import Integrator, RungeKutta4
from protochain.mechanisms import Rosenbrock

FULL = Design(cells=6)


def run(quick: bool = False) -> Scene:
    """Run the scene; quick: few cells, cases and rates: some seconds."""
    rates = (258.0,) if quick else tuple(np.arange(100.0, 401.0, 25.0))
    resonance, found = checks.ground_resonance(rates, 3 if quick else 12)
    sinks = landing.SINKS[-1:] if quick else landing.SINKS
    found += [*checks.rigid_landing(sinks), *checks.flight(), *checks.blades(8 if quick else 12)]
    found += [*ground.against_heave(quick), *safety.on_a_slope(), *safety.against_eigenvalues(quick)]
    tables, energies = _cases(quick)
    stood, legs, more = ground.leg_loads(FULL, quick)
    most = safety.limits(quick)
    return Scene(
        "helicopter", "a landing helicopter: the blades' tips after a step of the pitch",
        (*found, *energies, *more, safety.largest_sink(most)),
        _work(quick), tuple(limits(quick)), tuple(without(quick)),
        {
            "resonance": resonance, **tables, **stood, "legs": legs, "limits": most,
            "map": safety.safe_map(quick),
        },
        "error of the flap of a blade's tip, m",
    )  # fmt: skip


def _cases(quick: bool) -> tuple[dict[str, pd.DataFrame], list[Found]]:
    """Traces of all cases, and the balance of their energies."""
    tables, found, until = {}, [], 0.3 if quick else 1.5
    traces = []
    for sink in landing.SINKS[1:2] if quick else landing.SINKS:
        helicopter, run = landing.touchdown(FULL, sink, until, 1e-3, every=5)
        traces.append(landing.traced(helicopter, run).assign(sink=sink))
        found.append(checks.balance(f"touchdown at {sink:g} m/s", run, 0.01))
    tables["touchdown"] = pd.concat(traces, ignore_index=True)
    for name, wind, change in (("gust", landing.gust, None), ("pitch", None, landing.step)):
        helicopter, run = landing.hovering(FULL, 2.0 * until / 3.0, 1e-3, 5, wind, change)
        tables[name] = landing.traced(helicopter, run)
        found.append(checks.balance(name, run, 1e-8))
    helicopter, run = landing.run_up(FULL, 0.5 if quick else 6.0, 1e-3, 20)
    tables["run_up"] = landing.traced(helicopter, run).assign(rate=[
        helicopter.lift.rate(t) for t in run.time
    ])  # fmt: skip
    # In half a second its torque makes the feet slide, and friction is rough.
    found.append(checks.balance("run-up", run, 1e-8 if not quick else 1e-6))
    return tables, found


def _work(quick: bool) -> list[Point]:
    """Error of the flap of a tip by cells and steps, of segments and modes, explicit and implicit.

    After a step of the pitch, since at a touch forces jump, and only the error there would be seen.
    """
    until, points = 0.1, 5

    def flap(given: Design, h: float, integrator: Integrator) -> Floats:
        every = max(1, round(until / (points * h)))
        flown = landing.hovering(given, until, h, every, change=landing.step, integrator=integrator)
        return landing.traced(*flown)["tip 1"].to_numpy()[1:]

    def segments(cells: int) -> Design:
        return Design(cells=cells, modes=False, damping=0.0)

    def stable(cells: int) -> float:
        """Explicit step, two thirds of the longest for the highest frequency of the segments, in lag."""
        return until / (points * np.ceil(until / points * 0.5 * at_rest(BLADE, cells)[-1]))

    fine = 4 if quick else 12
    coarse, finer = (flap(segments(n), stable(n), RungeKutta4()) for n in (fine, 2 * fine))
    exact = extrapolated(coarse, finer)
    plans: list[tuple[str, Design, float, Integrator]] = []
    for cells in (2, 4) if quick else (2, 4, 8, 16):
        bending = segments(cells)
        plans.append(("segments, Runge-Kutta", bending, min(2e-3, stable(cells)), RungeKutta4()))
        plans.append(("modes, Runge-Kutta", replace(bending, modes=True), 2e-3, RungeKutta4()))
        if cells < (4 if quick else 8):
            plans.append(("segments, Rosenbrock", bending, 2e-3, Rosenbrock()))
    return [
        tried(
            method, f"{given.cells} cells, {1e3 * h:g} ms", partial(flap, given, h, integrator),
            lambda value: np.max(np.abs(value - exact)), 1 if quick else 2,
        )
        for method, given, h, integrator in plans
    ]  # fmt: skip
