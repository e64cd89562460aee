"""What dynamics samples: temperature, and the distribution of a dihedral, against their exact values."""

from collections.abc import Iterator
from functools import partial
from time import process_time

import numpy as np

from bench.cases import Point
from bench.studies.precision.peptides import KT, Peptide, peptide
from protochain.core.units import MOLAR_GAS
from protochain.dynamics import (
    HybridMonteCarlo,
    Langevin,
    Leapfrog,
    NoseHoover,
    Propagator,
    Thermostat,
    advance,
    initial,
)  # fmt: skip
from protochain.mechanics.multibody.articulated import log_det

BINS = 12
_FRICTION = 10.0
"""1/ps."""


def methods() -> dict[str, tuple[Thermostat, float]]:
    """Thermostats with a time step in ps."""
    langevin = partial(Langevin, KT, _FRICTION)
    return {
        "langevin, 5 fs": (langevin(), 0.005),
        "langevin, 10 fs": (langevin(), 0.010),
        "langevin, 20 fs": (langevin(), 0.020),
        "nose-hoover, 10 fs": (NoseHoover(KT, 2, _FRICTION), 0.010),
        "hmc, 20 fs": (HybridMonteCarlo(KT), 0.020),
    }


def exact_shares(of: Peptide, n: int) -> np.ndarray:
    """(bins,) probability that the last angle is in each bin, by the midpoint rule on n x n angles.

    Rigid bodies sample angles with density sqrt(det M) exp(-V / kT).
    """
    grid = (np.arange(n) + 0.5) * 2 * np.pi / n
    log_density = np.empty((n, n))
    for i, first in enumerate(grid):
        for j, last in enumerate(grid):
            q = of.q.copy()
            q[of.angles] = first, last
            factors = of.system.factors(q)
            log_density[i, j] = 0.5 * log_det(factors) - of.potential.of(q, factors)[0] / KT
    density = np.exp(log_density - log_density.max())
    return np.asarray(density.sum(axis=0).reshape(BINS, -1).sum(axis=1) / density.sum())


def measure(quick: bool) -> Iterator[Point]:
    """Root mean square over the seeds of both errors, after growing numbers of steps."""
    of = peptide("AAA", "obc2", "fixed", "resid 2")
    shares = exact_shares(of, 24 if quick else 120)
    seeds = range(2 if quick else 6)
    marks = [250, 1000] if quick else [625, 1250, 2500, 5000, 10_000, 20_000]
    for name, (thermostat, step) in list(methods().items())[:: 2 if quick else 1]:
        runs = [_run(of, thermostat, step, seed, marks, shares) for seed in seeds]
        for k, mark in enumerate(marks):
            hot, off, seconds, count = np.array([run[k] for run in runs]).T
            cost = float(seconds.mean()), float(count.mean())
            for case, errors, unit, against in (
                ("temperature", hot, "K", "300 K, the mean of the Gamma law"),
                ("distribution of psi", off, "of all time in a wrong bin", f"quadrature of {BINS} bins"),
            ):
                error = float(np.sqrt(np.mean(errors**2)))
                where = f"{case}, {of.name}, two hinges"
                yield Point(
                    name, f"{mark} steps", cost[0], error, where, unit, against, cost[1], of.chain.n_v
                )


def _run(
    of: Peptide, thermostat: Thermostat, step: float, seed: int, marks: list[int], shares: np.ndarray
) -> list[tuple[float, float, float, float]]:
    """Error of the temperature, share in wrong bins, processor seconds and evaluations at each mark."""
    propagator = Propagator(of.system, Leapfrog(), thermostat, step, KT, seed, False)
    state, out = initial(propagator, of.q), []
    heat, visits = 0.0, np.zeros(BINS)
    before, seconds = of.potential.n, 0.0
    for k in range(1, marks[-1] + 1):
        began = process_time()
        state = advance(propagator, state)
        seconds += process_time() - began
        heat += state.at.kinetic
        visits[int(state.at.q[of.angles[-1]] % (2 * np.pi) / (2 * np.pi) * BINS) % BINS] += 1
        if k in marks:
            hot = 2.0 * heat / k / (of.chain.n_v * MOLAR_GAS) - 300.0
            wrong = 0.5 * float(np.abs(visits / k - shares).sum())
            out.append((hot, wrong, seconds, float(of.potential.n - before)))
    return out
