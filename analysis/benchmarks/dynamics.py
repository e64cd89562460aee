"""Constrained dynamics: energy error, largest steps, cost of a step, nanoseconds a day against OpenMM.

    python analysis/benchmarks/dynamics.py [STUDY ...] [-o DIR] [--quick] [--more FOLDER]

STUDY is any of energy, steps, cost, speed (all by default). Each prints a table; with -o they are
written, as dynamics_STUDY.csv. The largest structure, 1ake_A.pdb, comes
from --more.
"""

import argparse
import copy
from collections.abc import Callable, Iterable
from pathlib import Path
from time import perf_counter

import made
import numpy as np
import openmm
import pandas as pd
from made import SAMPLES
from openmm import unit
from scipy import constants

import protochain as pc
from bench import in_turn
from protochain.dynamics import (
    Isolated,
    Langevin,
    Leapfrog,
    Propagator,
    State,
    System,
    Thermostat,
    advance,
    chain_potential,
)  # fmt: skip
from protochain.energies import constrain_hydrogens
from protochain.mechanics.multibody import sample_velocities

LARGEST = "1ake_A.pdb"
THREADS = 2
KT = 300.0 * constants.R / 1000.0
MODELS = {
    "phi psi chi": ("phi psi chi", None), "+ omega": ("phi psi omega chi", None),
    "+ rotors": ("phi psi chi rotors", None), "+ rotors, 4 amu hydrogens": ("phi psi chi rotors", 4.0),
    "+ angles": ("phi psi chi angles", None), "all": ("phi psi omega chi rotors angles", None),
}  # fmt: skip


def at_a_minimum(path: Path, hinges: str, solvent: str = "obc2"):
    """Chain, energy, and coordinates of a minimum in these hinges."""
    structure = pc.load(path)
    chain = pc.build_chain(structure, hinges)
    energy = pc.energy(structure, solvent=solvent, threads=THREADS)
    return chain, energy, pc.minimise(chain, energy, "lbfgs", 10.0, max_evaluations=1500).q


def energy_error(options: argparse.Namespace) -> pd.DataFrame:
    """Constant energy, Trp-cage: error and cost by integrator and time step, 100 ps at 2 fs."""
    chain, energy, q = at_a_minimum(SAMPLES / "1l2y.pdb", "phi psi chi")
    warm = pc.simulate(chain, energy, q, n_steps=2500, friction=10.0, seed=1)
    runs = [("leapfrog", h, 10.0) for h in (0.5, 1.0, 2.0, 4.0, 8.0, 12.0)]
    runs += [("lobatto", h, 10.0) for h in (0.5, 1.0, 2.0, 4.0, 8.0)]
    runs += [("midpoint", h, 1.0) for h in (4.0, 8.0)] + [("rk4", h, 2.0) for h in (1.0, 2.0, 4.0, 8.0)]
    runs += [("dormand-prince", h, 2.0) for h in (4.0,)] + [("leapfrog", 2.0, 100.0)]
    if options.quick:
        runs = [(name, h, ps / 20) for name, h, ps in runs]
    rows = []
    for name, h, ps in runs:
        m = pc.simulate(
            warm.chain, energy, warm.q, time_step=h / 1000, n_steps=round(1000 * ps / h), thermostat="none",
            integrator=name, every=max(1, round(20 / h)), seed=2,
        )  # fmt: skip
        total = m.trace["total_kj_mol"]
        rows.append(
            {
                "integrator": name, "step_fs": h, "time_ps": ps, "status": str(m.ending),
                "error_kj_mol": total.std(), "drift_kj_mol_ps_100_atoms": m.drift,
                "ms_per_step": 1000 * m.seconds / max(1, m.n_steps),
            }
        )  # fmt: skip
    return pd.DataFrame(rows)


def largest_steps(options: argparse.Namespace) -> pd.DataFrame:
    """Largest step of 10 ps at constant energy and 300 K within the drift allowed, and within stability."""
    rows = []
    models = {name: MODELS[name] for name in list(MODELS)[: 1 if options.quick else None]}
    ps = 0.2 if options.quick else 10.0
    for name, (hinges, hydrogen_mass) in models.items():
        chain, energy, q = at_a_minimum(SAMPLES / "1l2y.pdb", hinges)
        warm = pc.simulate(
            chain, energy, q, time_step=0.001, n_steps=round(500 * ps), friction=10.0, seed=1,
            hydrogen_mass=hydrogen_mass,
        )  # fmt: skip
        quiet = stable = 0
        for h in (1, 2, 3, 4, 5, 6, 8, 10, 12, 14, 16, 20):
            m = pc.simulate(
                warm.chain, energy, warm.q, time_step=h / 1000, n_steps=round(1000 * ps) // h,
                thermostat="none", every=max(1, 20 // h), seed=2,
            )  # fmt: skip
            if not m.is_sound:
                break
            if abs(m.drift) < 0.01 and quiet == stable:
                quiet = h
            stable = h
        rows.append(
            {
                "hinges": name,
                "freedoms": warm.chain.n_v,
                "quiet_fs": quiet,
                "stable_fs": stable,
            }
        )
    return pd.DataFrame(rows)


def median_seconds(function: Callable[[], object]) -> float:
    """Median time of some calls."""
    function()
    return in_turn([function], turns=70, clock=perf_counter)[0].median


def one_step(chain: pc.Chain, energy) -> tuple[float, float, float, float]:
    """Seconds of the energy, of what moves with torques, and of the rest of a step: Langevin's, isolated."""
    x = chain.structure.positions
    system = System(chain.tree, chain_potential(chain, energy.without_constants(chain.rigid_groups, x)))
    at = system.at(chain.q0, np.zeros(chain.n_v))
    qd = sample_velocities(chain.tree, at.factors.frames, KT, np.random.default_rng(0))
    at = system.with_velocities(at, qd)
    # No torques: with constant ones the energy would jump, which ends a run.
    idle = np.zeros(chain.n_v)
    still = System(chain.tree, lambda q, f: (at.potential, idle))
    at = still.at(chain.q0, at.qd)

    def step(thermostat: Thermostat) -> Callable[[], object]:
        propagator = Propagator(still, Leapfrog(), thermostat, 0.004, KT, 0, False)
        now = State(0, at, thermostat.init(at))
        return lambda: advance(propagator, now)

    return (
        median_seconds(lambda: energy(x)),
        median_seconds(lambda: system.potential(at.q, at.factors)),
        median_seconds(step(Langevin(KT))),
        median_seconds(step(Isolated())),
    )


def cost(options: argparse.Namespace) -> pd.DataFrame:
    """Cost of a whole step of 4 fs, beyond the energy and its torques."""
    rows = []
    for path in sizes(("1l2y", "4pti", "1ubq", "1hel"), options):
        structure = pc.load(path)
        chain = pc.build_chain(structure, root="free")
        energy = pc.energy(structure, threads=THREADS)
        whole, potential, bathed, isolated = one_step(chain, energy)
        rows.append(
            {
                "structure": path.stem.split("_")[0], "atoms": structure.n_atoms, "hinges": chain.n_hinges,
                "energy_ms": 1000 * whole, "energy_and_torques_ms": 1000 * potential,
                "rest_ms": 1000 * bathed, "rest_without_langevin_ms": 1000 * isolated,
                "rest_percent": 100 * bathed / potential,
            }
        )  # fmt: skip
    return pd.DataFrame(rows)


def openmm_ns_per_day(system: openmm.System, x: np.ndarray, seconds: float) -> float:
    """OpenMM on its CPU platform: Langevin middle, 2 fs, bonds of hydrogens constrained."""
    constrain_hydrogens(system)
    integrator = openmm.LangevinMiddleIntegrator(300, 1, 0.002)
    platform = openmm.Platform.getPlatform("CPU")
    context = openmm.Context(system, integrator, platform, {"Threads": str(THREADS)})
    context.setPositions(x)
    context.applyConstraints(1e-6)
    context.setVelocitiesToTemperature(300 * unit.kelvin, 1)
    integrator.step(5)
    steps, began = 0, perf_counter()
    while perf_counter() - began < seconds:
        integrator.step(5)
        steps += 5
    return 86.4 * steps * 0.002 / (perf_counter() - began)


def speed(options: argparse.Namespace) -> pd.DataFrame:
    """Nanoseconds a day: OpenMM at 2 fs, ours at 2, 4, 8 fs; and ratios."""
    rows = []
    seconds = 0.5 if options.quick else 12.0
    for path in sizes(("1l2y", "1ubq"), options):
        for solvent in ("obc2", "gbn2"):
            chain, energy, q = at_a_minimum(path, "phi psi chi", solvent)
            x = pc.pose(chain, q).x
            row = {
                "structure": path.stem.split("_")[0],
                "residues": chain.structure.n_residues,
                "solvent": solvent,
                "openmm_2_fs": openmm_ns_per_day(copy.deepcopy(energy.system), x, seconds),
            }
            for h in (2, 4, 8):
                m = pc.simulate(chain, energy, q, time_step=h / 1000, n_steps=60, every=60)
                n = max(100, round(60 * 0.4 * seconds / m.seconds))
                m = pc.simulate(m.chain, energy, m.q, time_step=h / 1000, n_steps=n, every=n)
                row[f"ours_{h}_fs"] = m.ns_per_day if m.is_sound else np.nan
            row |= {f"ratio_{h}_fs": row[f"ours_{h}_fs"] / row["openmm_2_fs"] for h in (2, 4, 8)}
            rows.append(row)
    return pd.DataFrame(rows)


def sizes(samples: tuple[str, ...], options: argparse.Namespace) -> list[Path]:
    """Files of growing size; the smallest alone if it has to be quick."""
    files = [SAMPLES / f"{name}.pdb" for name in samples] + [options.more / LARGEST]
    return files[:1] if options.quick else files


STUDIES = {"energy": energy_error, "steps": largest_steps, "cost": cost, "speed": speed}


def parser() -> argparse.ArgumentParser:
    return made.parser(__doc__, STUDIES, more=True)


def main() -> None:
    options = parser().parse_args()

    def of(_: str, table: pd.DataFrame) -> Iterable[object]:
        return table["structure"].unique() if "structure" in table else ["1l2y"]

    made.study(options, STUDIES, "dynamics", of, THREADS)


if __name__ == "__main__":
    main()
