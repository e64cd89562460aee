"""cartesian and hybrid against OpenMM's LocalEnergyMinimizer: how long to an energy at least as low.

    python analysis/benchmarks/race.py [-o DIR] [--solvents obc2,gbn2,vacuum] [STRUCTURE ...]

OpenMM runs on its CPU platform on the System as the force field builds it, with tolerances of 10 and 1
kJ/mol/nm, from the same start and on the same threads; its seconds are those of LocalEnergyMinimizer.minimize
alone. Ours are those until the trace is first as low as where OpenMM ended (both judged by the native
engine), "never" if it ends above.
"""

import argparse
from pathlib import Path
from time import perf_counter

import numpy as np
import openmm
import pandas as pd
from openmm import unit

import protochain as pc
from protochain.energies import build_system

SAMPLES = Path(__file__).parents[2] / "structures"
DEFAULT = ("1l2y", "1ejg", "1vii", "3i40", "4pti", "1ubq")
TOLERANCES = (10.0, 1.0)
THREADS = 2


def openmm_ends(structure: pc.Structure, solvent: str, energy) -> list[tuple[float, float]]:
    """Energy at the end and seconds of LocalEnergyMinimizer, for each tolerance."""
    system = build_system(structure, "amber14", solvent)
    ends = []
    for tolerance in TOLERANCES:
        platform = openmm.Platform.getPlatform("CPU")
        context = openmm.Context(system, openmm.VerletIntegrator(0.001), platform, {"Threads": str(THREADS)})
        context.setPositions(structure.positions)
        context.getState(forces=True)
        began = perf_counter()
        openmm.LocalEnergyMinimizer.minimize(context, tolerance)
        seconds = perf_counter() - began
        x = context.getState(positions=True).getPositions(asNumpy=True).value_in_unit(unit.nanometer)
        ends.append((energy(np.array(x))[0], seconds))
        del context
    return ends


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("structures", nargs="*", type=Path, default=[SAMPLES / f"{n}.pdb" for n in DEFAULT])
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--solvents", default="vacuum,obc2,gbn2")
    options = parser.parse_args()
    rows = []
    print(
        "| structure | solvent | tolerance | OpenMM kJ/mol | s "
        "| cartesian kJ/mol | s | ratio | hybrid kJ/mol | s | ratio |"
    )
    print("|---|---|--:|--:|--:|--:|--:|--:|--:|--:|--:|")
    for solvent in options.solvents.split(","):
        for path in options.structures:
            structure = pc.load(path)
            chain = pc.build_chain(structure)
            energy = pc.energy(structure, solvent=solvent, threads=THREADS)
            runs = {method: pc.minimise(chain, energy, method) for method in ("cartesian", "hybrid")}
            for tolerance, (end, seconds) in zip(
                TOLERANCES, openmm_ends(structure, solvent, energy), strict=True
            ):
                cells = []
                for method, solution in runs.items():
                    trace = solution.trace
                    low = trace[trace.energy_kj_mol <= end]
                    need = low.seconds.iloc[0] if len(low) else np.inf
                    rows.append((structure.name, solvent, tolerance, method, seconds / need))
                    cells += [f"{solution.end.energy:.1f}", f"{need:.2f}", f"{seconds / need:.1f}"]
                shown = " | ".join(cells).replace("inf | 0.0", "never | -")
                print(
                    f"| {structure.name} | {solvent} | {tolerance:g} | {end:.1f} | {seconds:.2f} | {shown} |",
                    flush=True,
                )
    table = pd.DataFrame(rows, columns=["structure", "solvent", "tolerance", "method", "ratio"])
    best = (
        table.groupby(["structure", "solvent", "tolerance"])["ratio"]
        .max()
        .reset_index()
        .assign(method="either")
    )
    medians = pd.concat([table, best]).groupby(["solvent", "tolerance", "method"])["ratio"].median()
    print("\nMedian ratios (0: never):\n")
    print(medians.unstack().round(1).to_string())
    if options.output:
        options.output.mkdir(parents=True, exist_ok=True)
        table.to_csv(options.output / "race.csv", index=False)


if __name__ == "__main__":
    main()
