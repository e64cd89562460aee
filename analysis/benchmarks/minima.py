"""Search for low minima in torsions: three methods beside scipy's, and what a step costs.

    python analysis/benchmarks/minima.py [STUDY ...] [-o DIR] [--quick] [--evaluations N] [--seeds N]

found: Met-enkephalin (YGGFM, ff14SB, OBC2) from the extended chain, by five walks of each method, and by
scipy's basinhopping and dual_annealing on the same energy and torques, with as many evaluations each. A walk
succeeds where it comes within 0.5 kJ/mol of the lowest that any of them found.
truth: trialanine with two hinges against quadrature.
cost: processor time of a round of replica exchange in torsions, and of one by OpenMM of all atoms.
"""

import argparse
import os
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from functools import partial
from multiprocessing import get_context
from time import process_time

import made
import numpy as np
import openmm
import pandas as pd
from openmm import unit
from scipy import constants
from scipy.optimize import basinhopping, dual_annealing
from threadpoolctl import threadpool_limits

import protochain as pc
from protochain.energies import constrain_hydrogens

KT = 300.0 * constants.R / 1000.0
NEAR = 0.5
"""kJ/mol above the lowest that any walk found."""
PEPTIDE = "YGGFM"
TEMPERATURES = {"csa": "300-600", "hopping": "300-600", "tempering": "300-600"}
TRAJECTORY = 20
"""Steps between exchanges in torsions."""
CORES = min(2, len(os.sched_getaffinity(0)))
WORKERS = CORES if CORES > 1 else None
"""Processes; all bits are the same with any number."""


class SpentError(Exception):
    """The evaluations allowed are used up."""


class Counted:
    """Energy over torsions as scipy takes it, which counts and keeps the lowest of all."""

    def __init__(self, chain: pc.Chain, energy, budget: int) -> None:
        self.chain, self.energy, self.budget = chain, energy, budget
        self.n, self.falls = 0, []

    def __call__(self, q: np.ndarray) -> tuple[float, np.ndarray]:
        """Energy and gradient, counted."""
        if self.n == self.budget:
            raise SpentError
        self.n += 1
        return self.at(q)

    def slope(self, q: np.ndarray) -> np.ndarray:
        """Gradient where the energy was called before: no evaluation of its own."""
        return self.at(q)[1]

    def at(self, q: np.ndarray) -> tuple[float, np.ndarray]:
        """Energy and gradient; a new low is kept."""
        at = pc.pose(self.chain, q)
        value, forces = self.energy(at.x)
        if not self.falls or value < self.falls[-1][1]:
            self.falls.append((self.n, value))
        return value, -pc.pull_back(self.chain, at, forces)


def wrapped(q: np.ndarray) -> np.ndarray:
    """Torsions between -pi and pi."""
    return (q + np.pi) % (2 * np.pi) - np.pi


def by_scipy(method: str, chain: pc.Chain, energy, budget: int, seed: int) -> list[tuple[int, float]]:
    """Evaluations and energy of each new low, by scipy's method with its defaults and L-BFGS-B."""
    counted = Counted(chain, energy, budget)
    local = {"method": "L-BFGS-B", "jac": True}
    # On all cores its small matrices take a hundred times as long where others compute.
    with threadpool_limits(1), suppress(SpentError):
        if method == "basinhopping":
            basinhopping(counted, chain.q0, 10**9, KT, minimizer_kwargs=local, rng=seed)
        else:
            local = {"method": "L-BFGS-B", "jac": counted.slope}
            dual_annealing(
                lambda q: counted(q)[0], [(-np.pi, np.pi)] * chain.n_q, maxiter=10**9, maxfun=10**9,
                x0=wrapped(chain.q0), minimizer_kwargs=local, rng=seed,
            )  # fmt: skip
    return counted.falls


def falls_of(found: pc.Search, walker: int) -> list[tuple[int, float]]:
    """Evaluations and energy of each new low of a walk."""
    its = found.findings[walker].minima[:, :2]
    low = np.minimum.accumulate(its[:, 1])
    new = np.concatenate([[True], np.diff(low) < 0.0])
    return [(int(n), float(e)) for n, e in its[new]]


def found(options: argparse.Namespace) -> pd.DataFrame:
    """Evaluations to within 0.5 kJ/mol of the lowest that any walk found, and how many came there."""
    structure = pc.from_sequence(PEPTIDE)
    chain, energy = pc.build_chain(structure, root="fixed"), pc.energy(structure, threads=1)
    budget, seeds = (1500, 2) if options.quick else (options.evaluations, options.seeds)
    falls, seconds = {}, {}
    for method in (*TEMPERATURES, "basinhopping", "dual_annealing"):
        began = sum(os.times()[:4])
        if method in TEMPERATURES:
            done = pc.search(
                chain, energy, method, budget * seeds, temperatures=TEMPERATURES[method], n_walkers=seeds,
                n_replicas=3, workers=WORKERS,
            )  # fmt: skip
            falls[method] = [falls_of(done, walker) for walker in range(seeds)]
        else:
            walk = partial(by_scipy, method, chain, energy, budget)
            with ProcessPoolExecutor(CORES, get_context("spawn")) as pool:
                falls[method] = list(pool.map(walk, range(seeds)))
        seconds[method] = (sum(os.times()[:4]) - began) / seeds
        print(method, [round(its[-1][1], 2) for its in falls[method]], flush=True)
    lowest = min(its[-1][1] for each in falls.values() for its in each)
    rows = []
    for method, each in falls.items():
        to = [next((n for n, e in its if e <= lowest + NEAR), np.inf) for its in each]
        ends = np.array([its[-1][1] for its in each]) - lowest
        first, middle, third = np.quantile(to, [0.25, 0.5, 0.75], method="nearest")
        rows.append({
            "method": method, "walks": seeds, "evaluations": budget, "reached": int(np.isfinite(to).sum()),
            "first_quartile": first, "median": middle, "third_quartile": third,
            "lowest_kj_mol": ends.min() + lowest, "above_lowest_median_kj_mol": np.median(ends),
            "above_lowest_worst_kj_mol": ends.max(), "seconds_of_a_core": seconds[method],
        })  # fmt: skip
    return pd.DataFrame(rows)


def truth(options: argparse.Namespace) -> pd.DataFrame:
    """Two hinges of trialanine by tempering, against quadrature over a grid."""
    structure = pc.from_sequence("AAA")
    chain, energy = pc.build_chain(structure, "phi", "fixed"), pc.energy(structure, threads=1)
    n = 30 if options.quick else 90
    at = 2.0 * np.pi * (np.arange(n) + 0.5) / n - np.pi
    grid = np.array([[energy(pc.pose(chain, np.array([a, b])).x)[0] for b in at] for a in at])
    budget = 16_000 if options.quick else 600_000
    done = pc.search(chain, energy, "tempering", budget, n_walkers=2, n_replicas=2, workers=WORKERS)
    rows = []
    for row in done.populations.to_dict("records"):
        weight = np.exp(-(grid - grid.min()) * 1000.0 / (constants.R * row["temperature_k"]))
        exact = float((weight * grid).sum() / weight.sum())
        rows.append({
            "temperature_k": row["temperature_k"], "energy_kj_mol": row["energy_kj_mol"],
            "energy_error_kj_mol": row["energy_error_kj_mol"], "by_quadrature_kj_mol": exact,
            "errors_away": (row["energy_kj_mol"] - exact) / row["energy_error_kj_mol"],
            "slope": row["slope"], "slope_error": row["slope_error"], "exchanges": row["exchanges"],
        })  # fmt: skip
    return pd.DataFrame(rows)


def cost(options: argparse.Namespace) -> pd.DataFrame:
    """Processor time of replica exchange on one thread: in torsions, and by OpenMM of all atoms.

    OpenMM's replicas are contexts with Langevin dynamics (bonds to hydrogen constrained, 2 fs), at the same
    temperatures, exchanged by Metropolis' criterion after the same time as those in torsions.
    """
    structure = pc.from_sequence(PEPTIDE)
    energy = pc.energy(structure, threads=1)
    few, many = (13_000, 16_000) if options.quick else (16_000, 60_000)
    spent, done = [], []
    for n in (few, few, many):  # Once for what is compiled and read.
        began = process_time()
        done.append(pc.search(structure, energy, "tempering", n, n_walkers=1, n_replicas=4))
        spent.append(process_time() - began)
    _, first, last = done
    rounds = last.states[0].n_done - first.states[0].n_done
    own = (spent[2] - spent[1]) / rounds
    steps = last.states[0].time_steps
    length = TRAJECTORY * float(np.mean(steps))
    n_steps = round(length / 0.002)
    replicas = Exchange(energy.system, structure.positions, last.temperatures, n_steps)
    replicas.round()
    n = 3 if options.quick else 100
    began = process_time()
    for _ in range(n):
        replicas.round()
    theirs = (process_time() - began) / n
    return pd.DataFrame([
        {"engine": name, "replicas": len(steps), "fs_a_step": 1000.0 * ps / k, "steps_a_round": k,
         "ps_a_round": ps, "ms_a_step": 1000.0 * seconds / (k * len(steps)), "rounds_a_second": 1.0 / seconds,
         "ps_a_second": ps / seconds, "exchanges": share}
        for name, k, ps, seconds, share in (
            ("torsions: hybrid Monte Carlo with Fixman's potential", TRAJECTORY, length, own,
             last.states[0].acceptance),
            ("OpenMM: all atoms, Langevin", n_steps, 0.002 * n_steps, theirs, replicas.share),
        )
    ])  # fmt: skip


class Exchange:
    """Replicas by OpenMM's CPU platform, on one thread: plain replica exchange."""

    def __init__(self, system, positions: np.ndarray, temperatures: np.ndarray, n_steps: int) -> None:
        system = openmm.XmlSerializer.clone(system)
        constrain_hydrogens(system)
        self.beta, self.n_steps = 1000.0 / (constants.R * temperatures), n_steps
        self.random, self.n, self.exchanged = np.random.default_rng(0), 0, 0.0
        self.contexts = []
        for temperature in temperatures:
            integrator = openmm.LangevinMiddleIntegrator(float(temperature), 1, 0.002)
            platform = openmm.Platform.getPlatform("CPU")
            context = openmm.Context(system, integrator, platform, {"Threads": "1"})
            context.setPositions(positions)
            openmm.LocalEnergyMinimizer.minimize(context)
            context.setVelocitiesToTemperature(float(temperature), 0)
            self.contexts.append(context)

    @property
    def share(self) -> float:
        """Mean probability of exchanges."""
        return self.exchanged / self.n

    def round(self) -> None:
        """Steps of each replica, then exchanges of every other pair of neighbours, in turn."""
        for context in self.contexts:
            context.getIntegrator().step(self.n_steps)
        at = [c.getState(getEnergy=True, getPositions=True, getVelocities=True) for c in self.contexts]
        energies = [each.getPotentialEnergy() for each in at]
        energy = np.array([each.value_in_unit(unit.kilojoule_per_mole) for each in energies])
        odds = np.exp(np.minimum(0.0, np.diff(self.beta) * np.diff(energy)))
        self.n, self.exchanged = self.n + 1, self.exchanged + float(odds.mean())
        for k in range(self.n % 2, len(odds), 2):
            if self.random.random() < odds[k]:
                scale = np.sqrt(self.beta[k] / self.beta[k + 1])
                for mine, other, by in ((k, k + 1, 1.0 / scale), (k + 1, k, scale)):
                    self.contexts[mine].setPositions(at[other].getPositions())
                    self.contexts[mine].setVelocities(at[other].getVelocities(asNumpy=True) * by)


TABLES = {
    "found": found,
    "truth": truth,
    "cost": cost,
}


def parser() -> argparse.ArgumentParser:
    own = made.parser(__doc__ or "", TABLES)
    own.add_argument("--evaluations", type=int, default=120_000, help="of each walk")
    own.add_argument("--seeds", type=int, default=5, help="walks of each method")
    return own


def main() -> None:
    options = parser().parse_args()
    made.study(options, TABLES, "minima", lambda name, table: (), CORES)


if __name__ == "__main__":
    main()
