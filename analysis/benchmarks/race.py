"""cartesian and hybrid against OpenMM's LocalEnergyMinimizer: how long to where it ends.

    python analysis/benchmarks/race.py [STRUCTURE ...] [--more FOLDER] [-o DIR] [--quick]
                                       [--forces gbsa,obc2,vacuum] [--custom ATOMS]

Structures are prepared, nothing beside the protein: by default 12 that no minimiser was tuned on (MORE,
--more). OpenMM runs on its CPU platform, to its own end at tolerances of 10 and 1 kJ/mol/nm, from the same
start and on the same threads. "obc2" and "gbn2" are CustomGBForces, as OpenMM's force field builds them, of
at most so many atoms (--custom); "gbsa" is OBC2 by its quicker GBSAOBCForce. Ends are judged by the native
engine. Ours run once, to 0.1 kJ/mol/nm, until

- energy: they are first as low as where OpenMM ended; infinite if they never are;
- force: their RMS force is first as small as there.

Seconds are those of the loop (of OpenMM all of LocalEnergyMinimizer.minimize), and of the whole call, from
the structure to the result: for OpenMM createSystem, Context, the first forces, the loop, and the state; for
ours System, energy, chain, warming up (kernels are compiled beforehand), loop, judging. Force fields are read
beforehand by both. Of three structures, also commands from shell to shell, from a file with all hydrogens to
one of the end: `protochain minimise` to the RMS force at which OpenMM ended, and race_openmm.py.
"""

import argparse
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from time import perf_counter

import made
import numpy as np
import openmm
import pandas as pd
import race_openmm
from made import HELD_OUT, SAMPLES
from openmm import app, unit

import protochain as pc

TOLERANCES = (10.0, 1.0)
SMALLEST = 0.1
METHODS = ("cartesian", "hybrid")
THREADS = 2
FROM_SHELL = ("1v6p_cobrotoxin_amber", "4cup_missing", "dhfr_jac_amber")


@dataclass(frozen=True)
class Race:
    """One method against one run of OpenMM; seconds of neither are comparable between machines."""

    structure: str
    atoms: int
    force: str
    gb_class: str
    tolerance: float
    method: str
    openmm_end_kj_mol: float
    openmm_rms_force_kj_mol_nm: float
    end_kj_mol: float
    openmm_loop_s: float
    openmm_whole_s: float
    energy_loop_s: float
    energy_whole_s: float
    force_loop_s: float
    force_whole_s: float
    openmm_shell_s: float = np.nan
    shell_s: float = np.nan


@dataclass(frozen=True)
class Theirs:
    """A run of OpenMM's."""

    gb_class: str
    x: np.ndarray
    loop: float
    whole: float


def theirs(structure: pc.Structure, force: str, tolerance: float) -> Theirs:
    """LocalEnergyMinimizer to its own end."""
    began = perf_counter()
    built = race_openmm.built(structure.topology, force)
    context = race_openmm.context(built, THREADS)
    context.setPositions(structure.positions)
    context.getState(forces=True)
    looped = perf_counter()
    openmm.LocalEnergyMinimizer.minimize(context, tolerance)
    loop = perf_counter() - looped
    state = context.getState(positions=True, energy=True)
    x = state.getPositions(asNumpy=True).value_in_unit(unit.nanometer)
    return Theirs(race_openmm.gb_class(built), np.array(x), loop, perf_counter() - began)


def ours(structure: pc.Structure, solvent: str, method: str) -> tuple[pc.Solution, float]:
    """Our run, and the seconds of the whole call without the loop."""
    began = perf_counter()
    energy = pc.energy(structure, solvent=solvent, threads=THREADS)
    solution = pc.minimise(structure, energy, method, SMALLEST)
    return solution, perf_counter() - began - solution.seconds


def until(trace: pd.DataFrame, column: str, level: float) -> float:
    """Seconds until a run is first as low as this; infinite if never."""
    low = trace[trace[column] <= level]
    return float(low["seconds"].iloc[0]) if len(low) else np.inf


def solvent_of(force: str) -> str:
    """Name of a force's solvent in protochain."""
    return "obc2" if force == "gbsa" else force


def races(structure: pc.Structure, force: str, from_shell: bool) -> Iterator[Race]:
    """All methods against OpenMM with each tolerance."""
    energy = pc.energy(structure, solvent=solvent_of(force), threads=THREADS)
    runs = {method: ours(structure, solvent_of(force), method) for method in METHODS}
    for tolerance in TOLERANCES:
        of = theirs(structure, force, tolerance)
        end, forces = energy(of.x)
        size = float(np.sqrt(np.mean(forces**2)))
        for method, (solution, outside) in runs.items():
            by_energy = until(solution.trace, "energy_kj_mol", end)
            by_force = until(solution.trace, "rms_force_kj_mol_nm", size)
            shells = (np.nan, np.nan)
            if from_shell and force == "gbsa" and method == METHODS[0]:
                shells = shell(structure, tolerance, size)
            yield Race(
                structure.name, structure.n_atoms, force, of.gb_class, tolerance, method, end, size,
                solution.end.energy, of.loop, of.whole, by_energy, outside + by_energy, by_force,
                outside + by_force, *shells,
            )  # fmt: skip


def shell(structure: pc.Structure, tolerance: float, size: float) -> tuple[float, float]:
    """Seconds of commands: OpenMM's to a tolerance, ours to the RMS force at which OpenMM ended."""
    with tempfile.TemporaryDirectory() as folder:
        file, out = Path(folder) / "start.pdb", Path(folder) / "end.pdb"
        with file.open("w") as text:
            app.PDBFile.writeFile(structure.topology, structure.positions * unit.nanometer, text)
        options = [file, out, "--threads", THREADS, "--tolerance", tolerance]
        return (
            seconds([sys.executable, race_openmm.__file__, *options]),
            seconds([
                shutil.which("protochain") or "protochain", "minimise", file, "-o", out, "--force",
                "--threads", THREADS, "--tolerance", size,
            ]),
        )  # fmt: skip


def seconds(words: list[object]) -> float:
    """Seconds of a command."""
    began = perf_counter()
    done = subprocess.run([*map(str, words)], env=made.surroundings(), capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{' '.join(map(str, words))}: {done.stderr}")
    return perf_counter() - began


def parser() -> argparse.ArgumentParser:
    own = made.parser(__doc__, more=True)
    own.add_argument("structures", nargs="*", type=Path, metavar="STRUCTURE")
    own.add_argument("--forces", default="gbsa,obc2,vacuum", help="of gbsa, obc2, gbn2, vacuum")
    own.add_argument("--custom", type=int, default=1000, metavar="ATOMS", help="with CustomGBForce, at most")
    return own


def main() -> None:
    options = parser().parse_args()
    files = options.structures or [options.more / name for name in HELD_OUT]
    if options.quick:
        files = [SAMPLES / "ala10.pdb"]
    structures = [pc.load(path, keep="none") for path in files]
    warm_up = pc.load(SAMPLES / "1l2y.pdb")
    ran = []
    for force in options.forces.split(","):
        theirs(warm_up, force, 1000.0)
        for method in METHODS:
            ours(warm_up, solvent_of(force), method)
        for structure in structures:
            if force in ("obc2", "gbn2") and structure.n_atoms > options.custom:
                continue
            for race in races(structure, force, options.quick or structure.name in FROM_SHELL):
                ran.append(race)
                print(asdict(race), flush=True)
    table = pd.DataFrame(map(asdict, ran))
    if options.output:
        for force, rows in table.groupby("force"):
            made.write(rows.round(4), options.output / f"race_{force}.csv", files, THREADS)


if __name__ == "__main__":
    main()
