"""How far a minimum lies from its start, how low and at what cost, against tolerance; and against OpenMM's.

    python analysis/benchmarks/near.py [STRUCTURE ...] [--more FOLDER] [-o DIR] [--quick] [--check]
                                       [--basins STRUCTURE ...] [--limit SECONDS] [--kept FOLDER]

Starts are structures as prepared, nothing beside the protein: by default 12 that no minimiser was tuned on
(MORE, --more). Two tables, of counts and energies, which do not depend on the load of the machine:

near: each method runs once, to 0.1 (OpenMM's to 1). Where its trace (RMS force, kJ/mol/nm; where hinges turn
the largest torque, kJ/mol/rad) first meets a tolerance, a run to it ends, for the way does not depend on it
(--check: shows it). Energies are above the minimum that the way leads to: its last point, polished by
`cartesian` to 0.001 kJ/mol/nm, or, where hinges turn, the lowest of the way.

near_ends: `cartesian` and the real ends of OpenMM's minimiser, whose tolerance is of the RMS length
of the forces on atoms, sqrt(3) times that of their components: at 10 it ends at 5.8 or below. Compared are
(1) the ends of both runs, (2) that of OpenMM and where `cartesian` first has as small an RMS force, and
(3) that of OpenMM and the lowest point of `cartesian` no farther from the start (C-alpha RMSD).
Structures whose rows are in a folder (--kept) are not run again.

With --basins, instead: starts are also taken down dx/dt = -grad E by scipy's BDF of orders 1 to 5
with variable step, whose Jacobian is the Hessian by differences (Asenjo, Stevenson, Wales, Frenkel, J. Phys.
Chem. B 117:12717, 2013: only an accurate solution leads to the minimum whose basin a point is in). Its end
and those of the methods are polished and compared. A descent that takes longer than the limit is left out.
"""

import argparse
import tempfile
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from time import process_time

import made
import numpy as np
import pandas as pd
from made import HELD_OUT, SAMPLES
from scipy.integrate import BDF
from scipy.spatial.transform import Rotation

import protochain as pc
from protochain.energies import Energy
from protochain.minimisers import RECIPES

METHODS = ("cartesian", "hybrid", "lbfgs", "openmm")
TOLERANCES = (30.0, 10.0, 5.0, 3.0, 1.0, 0.3, 0.1)
SMALLEST = {"openmm": 1.0}
"""Tolerance of a run; OpenMM's takes thousands of evaluations below it, or single precision stops it."""
OWN = (10.0, 1.0)
"""Tolerances of runs whose ends are compared: OpenMM's default, and that of comparisons of minima."""
MOST = 20_000
"""Evaluations allowed."""
ERROR = 1e-6
"""Tolerance of the ODE solver: nm, and relative. Ends are the same at 1e-8 (--check)."""
POLISHED = 1e-3
SAME = (0.01, 0.05)
"""kJ/mol, and angstrom (all atoms, superposed), within which two polished ends are one minimum."""


Row = dict[str, object]


def run(structure: pc.Structure, energy: Energy, method: str, tolerance: float) -> pc.Solution:
    """A run of a method to its own end."""
    return pc.minimise(structure, energy, method, tolerance, MOST, curvature=False)


def residual(method: str) -> str:
    """Column of a trace by which a method converges."""
    return "max_torque_kj_mol_rad" if RECIPES[method].keeps_geometry else "rms_force_kj_mol_nm"


def first(trace: pd.DataFrame, column: str, tolerance: float) -> pd.Series:
    """First row of a trace whose residual is no larger; all missing if there is none."""
    met = trace[trace[column] <= tolerance]
    return met.iloc[0] if len(met) else pd.Series(np.nan, trace.columns)


def polished(structure: pc.Structure, energy: Energy, x: np.ndarray) -> pc.Solution:
    """Nearest minimum of an end, by small steps near it."""
    return run(structure.with_positions(x), energy, "cartesian", POLISHED)


def way(structure: pc.Structure, energy: Energy, method: str, solution: pc.Solution) -> Iterator[Row]:
    """A row for each tolerance: where the way first meets it, and how much of it is left to its minimum."""
    trace = solution.trace
    if RECIPES[method].keeps_geometry:
        lowest = trace["energy_kj_mol"].min()
    else:
        lowest = polished(structure, energy, solution.x).end.energy
    for tolerance in TOLERANCES:
        if tolerance >= solution.tolerance:
            at = first(trace, residual(method), tolerance)
            yield {
                "method": method, "tolerance": tolerance, "evaluations": at["evaluations"],
                "energy_kj_mol": at["energy_kj_mol"], "above_kj_mol": at["energy_kj_mol"] - lowest,
                "rms_force_kj_mol_nm": at["rms_force_kj_mol_nm"],
                "max_force_kj_mol_nm": at["max_force_kj_mol_nm"], "ca_rmsd_angstrom": at["ca_rmsd_angstrom"],
                "status": str(solution.status), "status_evaluations": solution.n_evaluations,
            }  # fmt: skip


def ends(trace: pd.DataFrame, ours: pc.Solution, theirs: pc.Solution) -> Row:
    """Our way to its smallest tolerance and our own end against OpenMM's own end, of the same tolerance."""
    met = first(theirs.trace, "rms_force_kj_mol_nm", theirs.tolerance)
    force = first(trace, "rms_force_kj_mol_nm", theirs.end.rms_force)
    within = trace[trace["ca_rmsd_angstrom"] <= theirs.ca_rmsd_angstrom]
    distance = within.loc[within["energy_kj_mol"].idxmin()]
    of_ends = {
        f"{which}_{name}": value
        for which, end in (("openmm", theirs), ("end", ours))
        for name, value in (
            ("kj_mol", end.end.energy), ("rms_force_kj_mol_nm", end.end.rms_force),
            ("max_force_kj_mol_nm", end.end.sizes["max_force_kj_mol_nm"]),
            ("ca_rmsd_angstrom", end.ca_rmsd_angstrom), ("evaluations", end.n_evaluations),
        )
    }  # fmt: skip
    return {
        "tolerance": theirs.tolerance, "openmm_status": str(theirs.status), **of_ends,
        "openmm_first_met_kj_mol": met["energy_kj_mol"],
        "equal_force_kj_mol": force["energy_kj_mol"],
        "equal_force_ca_rmsd_angstrom": force["ca_rmsd_angstrom"],
        "equal_force_evaluations": force["evaluations"],
        "equal_distance_kj_mol": distance["energy_kj_mol"],
        "equal_distance_ca_rmsd_angstrom": distance["ca_rmsd_angstrom"],
        "equal_distance_rms_force_kj_mol_nm": distance["rms_force_kj_mol_nm"],
    }  # fmt: skip


def compared(structure: pc.Structure) -> tuple[list[Row], list[Row]]:
    """Rows of both tables."""
    energy = pc.energy(structure, threads=1)
    runs = {m: run(structure, energy, m, SMALLEST.get(m, TOLERANCES[-1])) for m in METHODS}
    ways = [row for method, solution in runs.items() for row in way(structure, energy, method, solution)]
    own = {t: runs["openmm"] if t == SMALLEST["openmm"] else run(structure, energy, "openmm", t) for t in OWN}
    trace = runs["cartesian"].trace
    return ways, [
        ends(trace, run(structure, energy, "cartesian", t), theirs) for t, theirs in own.items()
    ]  # fmt: skip


def descent(structure: pc.Structure, limit: float, error: float = ERROR) -> np.ndarray | None:
    """End of steepest descent by an ODE solver, to the smallest tolerance; None if it takes too long."""
    energy = pc.energy(structure, threads=1)
    began = process_time()

    def forces(t: float, x: np.ndarray) -> np.ndarray:
        return energy(x.reshape(-1, 3))[1].ravel()

    solver = BDF(forces, 0.0, structure.positions.ravel(), np.inf, rtol=error, atol=error)
    while np.sqrt(np.mean(forces(solver.t, solver.y) ** 2)) > TOLERANCES[-1]:
        if process_time() - began > limit or solver.status != "running":
            return None
        solver.step()
    return solver.y.reshape(-1, 3)


def basins(structure: pc.Structure, limit: float) -> Iterator[Row]:
    """Whether the polished end of each method is that of the descent."""
    energy = pc.energy(structure, threads=1)
    down = descent(structure, limit)
    home = None if down is None else polished(structure, energy, down)
    for method in METHODS:
        row: Row = {"method": method}
        if home is not None:
            last = run(structure, energy, method, SMALLEST.get(method, TOLERANCES[-1]))
            end = polished(structure, energy, last.x)
            above = end.end.energy - home.end.energy
            apart = all_atoms(end.x, home.x)
            row |= {
                "above_kj_mol": above, "apart_angstrom": apart,
                "same": bool(abs(above) < SAME[0] and apart < SAME[1]),
                "converged": end.status == "converged" and home.status == "converged",
            }  # fmt: skip
        yield row


def all_atoms(x: np.ndarray, y: np.ndarray) -> float:
    """RMSD of all atoms after superposition, angstrom."""
    _, apart = Rotation.align_vectors(x - x.mean(axis=0), y - y.mean(axis=0))
    return float(10.0 * apart / np.sqrt(len(x)))


def load(path: Path) -> pc.Structure:
    """Protein of a file, nothing beside it."""
    return pc.load(path, keep="none")


def check(structure: pc.Structure, limit: float) -> None:
    """Print how runs to 10 and 1 end, and where longer ones first met these: alike, but for OpenMM's."""
    energy = pc.energy(structure, threads=1)
    for method in METHODS:
        whole = run(structure, energy, method, SMALLEST.get(method, TOLERANCES[-1]))
        for tolerance in OWN:
            at = first(whole.trace, residual(method), tolerance)
            end = run(structure, energy, method, tolerance)
            size = end.end.max_torque if end.keeps_geometry else end.end.rms_force
            print(
                f"{structure.name} {method} {tolerance:g}: ends {end.end.energy - at['energy_kj_mol']:+.2g} "
                f"kJ/mol from where it is first met, with a residual of {size:.3g} for "
                f"{at[residual(method)]:.3g}, {end.n_evaluations - at['evaluations']:.0f} evaluations later",
                flush=True,
            )
    rough, fine = (descent(structure, 10.0 * limit, error) for error in (ERROR, ERROR / 100.0))
    if rough is not None and fine is not None:
        print(f"{structure.name} descent: {all_atoms(rough, fine):.1e} angstrom apart", flush=True)


def parser() -> argparse.ArgumentParser:
    own = made.parser(__doc__, more=True)
    own.add_argument("structures", nargs="*", type=Path, metavar="STRUCTURE")
    own.add_argument("--basins", nargs="+", type=Path, metavar="STRUCTURE", help="only these, by descents")
    own.add_argument("--limit", type=float, default=1000.0, metavar="SECONDS", help="of a descent, at most")
    own.add_argument("--kept", type=Path, metavar="FOLDER", help="of finished structures")
    own.add_argument("--check", action="store_true", help="only: that the way is that of each tolerance")
    return own


def main() -> None:
    options = parser().parse_args()
    files = options.structures or [options.more / name for name in HELD_OUT]
    if options.quick:
        files = [SAMPLES / "ala10.pdb"]
        options.basins = options.basins and files
    ways, own = [], []
    with tempfile.TemporaryDirectory() as scratch:
        folder = options.kept or Path(scratch)
        for path in options.basins or files:
            structure = load(path)
            about = {
                "structure": structure.name, "residues": structure.n_residues, "atoms": structure.n_atoms
            }  # fmt: skip
            if options.check:
                check(structure, options.limit)
            elif options.basins:
                ways += [about | row for row in basins(structure, options.limit)]
            else:
                parts = tuple(folder / f"{path.stem}-{table}.csv" for table in ("ways", "ends"))
                if not all(part.exists() for part in parts):
                    for part, rows in zip(parts, compared(structure), strict=True):
                        made.kept_rows(part, partial(list, [about | row for row in rows]))
                ways.append(pd.read_csv(parts[0]))
                own.append(pd.read_csv(parts[1]))
            print(structure.name, flush=True)
    if options.output and options.basins:
        made.write(pd.DataFrame(ways).round(4), options.output / "near_basins.csv", options.basins)
    elif options.output and not options.check:
        made.write(pd.concat(ways).round(4), options.output / "near.csv", files)
        made.write(pd.concat(own).round(4), options.output / "near_ends.csv", files)


if __name__ == "__main__":
    main()
