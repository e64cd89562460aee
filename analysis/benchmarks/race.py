"""cartesian and hybrid against OpenMM's LocalEnergyMinimizer: how long to an energy at least as low.

    python analysis/benchmarks/race.py [-o DIR] [--quick] [--forces obc2,gbsa,gbn2,vacuum] [STRUCTURE ...]

OpenMM runs on its CPU platform, with tolerances of 10 and 1 kJ/mol/nm, from the same start and on the same
threads. "obc2" and "gbn2" are CustomGBForces, as OpenMM's force field builds them; "gbsa" is OBC2 by its
quicker GBSAOBCForce. Energies are judged by the native engine. Two ratios, OpenMM's seconds over ours:

- stop: OpenMM until it stops, seconds of LocalEnergyMinimizer.minimize alone; ours until the trace is first
  as low as where OpenMM ended.
- passage: both until first within 1 kJ/mol per 100 residues of where OpenMM ended. OpenMM's share of its
  seconds by then is taken from a second run with a reporter, or, with a CustomGBForce, which takes so long
  that the reporter does not count, from the one run.

"never", and 0 in the medians: ours ends above.
"""

import argparse
from dataclasses import asdict, dataclass
from pathlib import Path
from time import perf_counter

import made
import numpy as np
import openmm
import pandas as pd
from engines import with_gbsa_obc
from made import SAMPLES
from openmm import unit

import protochain as pc
from protochain.energies import Energy, build_system

DEFAULT = ("1l2y", "1ejg", "1vii", "3i40", "4pti", "1ubq", "1hel")
TOLERANCES = (10.0, 1.0)
METHODS = ("cartesian", "hybrid")
NEAR = 0.01
"""kJ/mol a residue above OpenMM's end: passage."""
THREADS = 2
QUICK = ("gbsa", "vacuum")
"""Forces whose energy takes so little that a reporter would count."""


@dataclass(frozen=True)
class Race:
    """One method against one run of OpenMM; seconds of neither are comparable between machines."""

    structure: str
    atoms: int
    force: str
    tolerance: float
    method: str
    openmm_end_kj_mol: float
    end_kj_mol: float
    openmm_stop_s: float
    stop_s: float
    openmm_passage_s: float
    passage_s: float

    @property
    def stop(self) -> float:
        """OpenMM's seconds over ours, to its end."""
        return self.openmm_stop_s / self.stop_s

    @property
    def passage(self) -> float:
        """OpenMM's seconds over ours, until near its end."""
        return self.openmm_passage_s / self.passage_s


class Trace(openmm.MinimizationReporter):
    """Seconds and positions of each iteration."""

    def __init__(self) -> None:
        super().__init__()
        self.began = perf_counter()
        self.seconds: list[float] = []
        self.positions: list[np.ndarray] = []

    def report(self, iteration: int, x: list[float], grad: list[float], args: dict[str, float]) -> bool:
        """Note an iteration."""
        self.seconds.append(perf_counter() - self.began)
        self.positions.append(np.array(x).reshape(-1, 3))
        return False


def openmm_run(system: openmm.System, x: np.ndarray, tolerance: float, trace: Trace | None = None):
    """Positions at the end and seconds of LocalEnergyMinimizer."""
    platform = openmm.Platform.getPlatform("CPU")
    context = openmm.Context(system, openmm.VerletIntegrator(0.001), platform, {"Threads": str(THREADS)})
    context.setPositions(x)
    context.getState(forces=True)
    began = perf_counter()
    openmm.LocalEnergyMinimizer.minimize(context, tolerance, 0, *([trace] if trace else []))
    seconds = perf_counter() - began
    end = context.getState(positions=True).getPositions(asNumpy=True).value_in_unit(unit.nanometer)
    return np.array(end), seconds


def passage(trace: Trace, energy: Energy, seconds: float, near: float) -> tuple[float, float]:
    """Lowest energy of a traced run, and its seconds until within ``near`` of that, scaled to ``seconds``."""
    energies = np.array([energy(x)[0] for x in trace.positions])
    first = np.flatnonzero(energies <= energies.min() + near)[0]
    return energies.min(), seconds * trace.seconds[first] / trace.seconds[-1]


def until(trace: pd.DataFrame, level: float) -> float:
    """Seconds until a run is first as low as this; infinite if never."""
    low = trace[trace.energy_kj_mol <= level]
    return float(low.seconds.iloc[0]) if len(low) else np.inf


def races(path: Path, force: str):
    """All methods against OpenMM with each tolerance."""
    structure = pc.load(path)
    chain = pc.build_chain(structure)
    solvent = "obc2" if force == "gbsa" else force
    if force == "gbsa":
        system = with_gbsa_obc(structure.topology)
    else:
        system = build_system(structure, "amber14", solvent)
    energy = pc.energy(structure, solvent=solvent, threads=THREADS)
    ours = {method: pc.minimise(chain, energy, method, TOLERANCES[-1]) for method in METHODS}
    near = NEAR * structure.n_residues
    for tolerance in TOLERANCES:
        trace = Trace()
        x, seconds = openmm_run(system, structure.positions, tolerance, trace)
        if force in QUICK:
            x, seconds = openmm_run(system, structure.positions, tolerance)
        lowest, passed = passage(trace, energy, seconds, near)
        end = energy(x)[0]
        for method, solution in ours.items():
            yield Race(
                structure.name, structure.n_atoms, force, tolerance, method, end, solution.end.energy,
                seconds, until(solution.trace, end), passed, until(solution.trace, lowest + near),
            )  # fmt: skip


def parser() -> argparse.ArgumentParser:
    own = made.parser(__doc__)
    own.add_argument("structures", nargs="*", type=Path, default=[SAMPLES / f"{n}.pdb" for n in DEFAULT])
    own.add_argument("--forces", default="gbsa,obc2,gbn2,vacuum")
    return own


def main() -> None:
    options = parser().parse_args()
    if options.quick:
        options.structures = [SAMPLES / "ala10.pdb"]
    warm_up = pc.load(SAMPLES / "1l2y.pdb")
    for force in options.forces.split(","):
        energy = pc.energy(warm_up, solvent="obc2" if force == "gbsa" else force, threads=THREADS)
        pc.minimise(pc.build_chain(warm_up), energy, max_evaluations=30)
    ran = []
    print(
        "| structure | atoms | force | tolerance | method | OpenMM kJ/mol | kJ/mol "
        "| OpenMM s | s | stop | passage |"
    )
    print("|---|--:|---|--:|---|--:|--:|--:|--:|--:|--:|")
    for force in options.forces.split(","):
        for path in options.structures:
            for race in races(path, force):
                ran.append(race)
                need = f"{race.stop_s:.2f} | {race.stop:.1f}x" if race.stop else "never | -"
                print(
                    f"| {race.structure} | {race.atoms} | {force} | {race.tolerance:g} | {race.method} "
                    f"| {race.openmm_end_kj_mol:.1f} | {race.end_kj_mol:.1f} | {race.openmm_stop_s:.2f} "
                    f"| {need} | {race.passage:.1f}x |",
                    flush=True,
                )
    table = pd.DataFrame([asdict(race) | {"stop": race.stop, "passage": race.passage} for race in ran])
    by = ["force", "tolerance", "method"]
    medians = table.groupby(by)[["stop", "passage"]].median()
    medians["first"] = table.groupby(by)["stop"].apply(lambda ratios: np.mean(ratios > 1.0))
    print("\nMedian ratios (0: never), and the share of structures in which ours is first to OpenMM's end:\n")
    print(medians.round(2).to_string())
    if options.output:
        for force, rows in table.groupby("force"):
            made.write(rows, options.output / f"race_{force}.csv", options.structures, THREADS)


if __name__ == "__main__":
    main()
