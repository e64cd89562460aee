"""Integrators of constrained dynamics: error of energy and of trajectory at constant energy."""

from collections.abc import Iterator
from time import process_time

import numpy as np

from bench.cases import Point
from bench.studies.precision.peptides import Peptide, peptide
from protochain.dynamics import DormandPrince, ImplicitMidpoint, Leapfrog, RungeKutta4, StepTooLargeError
from protochain.mechanics.motion.lobatto import drift as lobatto_drift
from protochain.mechanics.motion.system import Integrator

FIXED: dict[str, Integrator] = {
    "leapfrog": Leapfrog(),
    "lobatto": Leapfrog(lobatto_drift),
    "midpoint": ImplicitMidpoint(),
    "rk4": RungeKutta4(),
}
TOLERANCES = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10)


def measure(quick: bool) -> Iterator[Point]:
    """Both errors of every integrator and step."""
    of = peptide("GAG" if quick else "YGGFM", "vacuum", "free")
    time = 0.032 if quick else 0.128
    exact, _, _, _ = _run(of, DormandPrince(1e-12), time, 1)
    for name, integrator in FIXED.items():
        for fs in (4.0, 2.0, 1.0) if quick else (8.0, 4.0, 2.0, 1.0, 0.5, 0.25):
            yield from _points(of, name, f"{fs:g} fs", integrator, time, round(1000 * time / fs), exact)
    for tolerance in TOLERANCES[:: 3 if quick else 1]:
        integrator = DormandPrince(tolerance)
        yield from _points(of, "dormand-prince", f"{tolerance:g}", integrator, time, 2, exact)


def _points(
    of: Peptide, name: str, parameter: str, integrator: Integrator, time: float, n: int, exact: np.ndarray
) -> Iterator[Point]:
    try:
        q, energy, seconds, count = _run(of, integrator, time, n)
        angle = float(np.abs(q - exact).max())
    except StepTooLargeError:
        angle, energy, seconds, count = np.inf, np.inf, np.nan, np.nan
    where, n_v = f"{of.name}, {1000 * time:g} fs at 300 K", of.chain.n_v
    against = "Dormand-Prince at a tolerance of 1e-12"
    yield Point(name, parameter, seconds, angle, f"angles, {where}", "rad", against, count, n_v)
    against = "its own start"
    yield Point(name, parameter, seconds, energy, f"total energy, {where}", "kJ/mol", against, count, n_v)


def _run(of: Peptide, integrator: Integrator, time: float, n: int) -> tuple[np.ndarray, float, float, float]:
    """Angles at the end, largest change of the energy, processor seconds and evaluations."""
    at = integrator.init(of.system, of.q, of.qd)
    start, change = at.total, 0.0
    # Compiled or loaded before the clock starts.
    integrator.step(of.system, at, 1e-4)
    before, began = of.potential.n, process_time()
    for _ in range(n):
        at = integrator.step(of.system, at, time / n)
        change = max(change, abs(at.total - start))
    return at.q[of.angles], change, process_time() - began, float(of.potential.n - before)
