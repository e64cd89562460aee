"""How far a minimum lies from its start: RMSD, energy and cost against tolerance, and the nearest minimum.

    python analysis/benchmarks/near.py STRUCTURE ... [--models MODEL ...] [--made N] [-o DIR] [--quick]
                                       [--kept FOLDER] [--basins ATOMS] [--limit SECONDS]

Starts are the structures as prepared, and models after `relax`: those given, and N samples, each damaged in
a way of its own. Each method runs once, to the smallest tolerance; where its residual (RMS force, kJ/mol/nm,
of the last stage in all atoms; largest torque, kJ/mol/rad, in torsions) first meets each larger one, a run
to that tolerance would have ended, for the way does not depend on it (--check runs a few again to show it).
Residuals, energies and RMSDs are those of the native engine in double precision, and seconds are processor
time of one thread. A run that is longer than the limit is broken off.

Starts of at most so many atoms (--basins) are also taken down dx/dt = -grad E by scipy's BDF of orders 1 to 5
with variable step, whose Jacobian is the Hessian by differences (Asenjo, Stevenson, Wales, Frenkel, J. Phys.
Chem. B 117:12717, 2013: only an accurate solution leads to the minimum whose basin a point is in). Its end
and those of the methods are polished by `cartesian` to 0.001 kJ/mol/nm and compared.

What is done is kept in a folder (--kept), and not done again.
"""

import argparse
import tempfile
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from time import process_time

import made
import numpy as np
import pandas as pd
from made import SAMPLES
from matplotlib.figure import Figure
from relax import MANY_OF, models
from scipy.integrate import BDF
from scipy.spatial.transform import Rotation

import protochain as pc
from protochain.energies import Energy
from protochain.minimisers import RECIPES

METHODS = ("cartesian", "hybrid", "lbfgs", "openmm")
TOLERANCES = (100.0, 30.0, 10.0, 3.0, 1.0, 0.1)
MOST = 5000
"""Evaluations allowed."""
ERROR = 1e-6
"""Tolerance of the ODE solver: nm, and relative. Ends are the same at 1e-8 (--check)."""
POLISHED = 1e-3
SAME = (0.01, 0.05)
"""kJ/mol, and angstrom (all atoms, superposed), within which two polished ends are one minimum."""


Row = dict[str, object]
Ends = dict[str, np.ndarray]
"""Positions (na, 3), nm, by tolerance."""


class Watch:
    """Notes the residual of each point of a run that could be its last, and where it first meets a tolerance.

    What it computes is left out of the seconds.
    """

    wants_positions = False

    def __init__(self, energy: Energy, in_torsions: bool, limit: float) -> None:
        self.energy, self.in_torsions, self.limit = energy, in_torsions, limit
        self.stage, self.own = "", 0.0
        self.met: dict[float, tuple[float, float, np.ndarray]] = {}
        self.began = process_time()

    def at_stage(self, name: str, evaluations: int) -> None:
        """Remember the stage."""
        self.stage = name

    def at_warning(self, line: str) -> None:
        """Say nothing of what the table tells."""

    def __call__(self, row: dict[str, float], x: np.ndarray) -> None:
        """Note a point, unless all tolerances are met."""
        now = process_time()
        seconds = now - self.began - self.own
        if self.stage == ("torsions" if self.in_torsions else "all atoms"):
            residual = row["max_torque_kj_mol_rad"] if self.in_torsions else rms(self.energy(x)[1])
            for tolerance in TOLERANCES:
                if residual <= tolerance and tolerance not in self.met:
                    self.met[tolerance] = row["evaluations"], seconds, x.copy()
        self.own += process_time() - now
        if seconds > self.limit:
            raise KeyboardInterrupt


def rms(forces: np.ndarray) -> float:
    return float(np.sqrt(np.mean(forces**2)))


def ends(
    structure: pc.Structure, method: str, limit: float, smallest: float = TOLERANCES[-1]
) -> tuple[list[Row], Ends]:
    """Rows of one method, one for each tolerance, and where it first met those that it met."""
    energy, own = pc.energy(structure, threads=1), pc.energy(structure, threads=1)
    chain = pc.build_chain(structure)
    in_torsions = RECIPES[method].keeps_geometry
    pc.minimise(chain, energy, method, max_evaluations=2)  # contexts and neighbour lists
    own(structure.positions)
    watch = Watch(own, in_torsions, limit)
    solution = pc.minimise(chain, energy, method, smallest, MOST, curvature=False, watch=watch)
    rows = []
    for tolerance in TOLERANCES:
        evaluations, seconds, x = watch.met.get(tolerance, (np.nan, np.nan, None))
        row = {"method": method, "tolerance": tolerance, "evaluations": evaluations, "cpu_seconds": seconds}
        if x is not None:
            row |= {"energy_kj_mol": own(x)[0], "ca_rmsd_angstrom": pc.ca_rmsd(structure, x, structure)}
        rows.append(row | {"status": str(solution.status), "status_evaluations": solution.n_evaluations})
    return rows, {f"{tolerance:g}": x for tolerance, (_, _, x) in watch.met.items()}


def descent(structure: pc.Structure, limit: float, error: float = ERROR) -> tuple[list[Row], Ends]:
    """Steepest descent by an ODE solver: rows as of a method, and where it first met each tolerance."""
    energy = pc.energy(structure, threads=1)
    began, count = process_time(), 0

    def forces(t: float, x: np.ndarray) -> np.ndarray:
        nonlocal count
        count += 1
        return energy(x.reshape(-1, 3))[1].ravel()

    solver = BDF(forces, 0.0, structure.positions.ravel(), np.inf, rtol=error, atol=error)
    met: dict[float, np.ndarray] = {}
    rows = []
    status = "stalled"
    while True:
        residual = rms(forces(solver.t, solver.y))
        for tolerance in TOLERANCES:
            if residual <= tolerance and tolerance not in met:
                x = met[tolerance] = solver.y.reshape(-1, 3).copy()
                rows.append({
                    "method": "descent", "tolerance": tolerance, "evaluations": count,
                    "cpu_seconds": process_time() - began, "energy_kj_mol": energy(x)[0],
                    "ca_rmsd_angstrom": pc.ca_rmsd(structure, x, structure),
                })  # fmt: skip
        if len(met) == len(TOLERANCES):
            status = "converged"
            break
        if process_time() - began > limit or solver.status != "running":
            break
        solver.step()
    rows += [{"method": "descent", "tolerance": t} for t in TOLERANCES if t not in met]
    each = {"status": status, "status_evaluations": count}
    return [row | each for row in rows], {f"{tolerance:g}": x for tolerance, x in met.items()}


def polished(structure: pc.Structure, energy: Energy, x: np.ndarray) -> pc.Solution:
    """Nearest minimum of an end, by small steps near it."""
    return pc.minimise(structure.with_positions(x), energy, "cartesian", POLISHED)


def basins(structure: pc.Structure, kept: "Kept") -> Iterator[Row]:
    """Whether the polished end of each method is that of the descent."""
    last = f"{TOLERANCES[-1]:g}"
    energy = pc.energy(structure, threads=1)
    found = {method: kept.positions(structure.name, method).get(last) for method in (*METHODS, "descent")}
    home = None if found["descent"] is None else polished(structure, energy, found["descent"])
    for method in METHODS:
        row: Row = {"method": method}
        if home is not None and found[method] is not None:
            end = polished(structure, energy, found[method])
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


class Kept:
    """Folder of what is done: a table and positions of each run, and relaxed models."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)

    def table(self, name: str, what: str, make: Callable[[], Iterable[Row]]) -> pd.DataFrame:
        """Table of something done, now or before."""
        return made.kept_rows(self.folder / f"{name}.{what}.csv", make)

    def positions(self, name: str, method: str) -> Ends:
        """Positions at which a method first met each tolerance."""
        return dict(np.load(self.folder / f"{name}.{method}.npz"))

    def run(self, name: str, method: str, make: Callable[[], tuple[list[Row], Ends]]) -> pd.DataFrame:
        """Table of a method, whose positions are kept too."""

        def rows() -> list[Row]:
            found, x = make()
            np.savez(self.folder / f"{name}.{method}.npz", **x)
            return found

        return self.table(name, method, rows)

    def relaxed(self, structure: pc.Structure) -> pc.Structure:
        """A model after `relax`, its positions in full: a file has three digits."""
        path = self.folder / f"{structure.name}.relaxed.npy"
        return structure.with_positions(made.kept(path, lambda: pc.relax(structure, threads=1).x))


def load(path: Path) -> pc.Structure:
    """Protein of a file, nothing beside it."""
    return pc.load(path, keep="none")


def damaged(n: int) -> Iterator[pc.Structure]:
    """Samples, each damaged in the next of the seven ways."""
    for k, name in enumerate(MANY_OF[:n]):
        label, structure = list(models.damaged([load(SAMPLES / f"{name}.pdb")], len(MANY_OF), seed=1))[k]
        yield replace(structure, name=label)


def starts(options: argparse.Namespace, kept: Kept) -> list[tuple[str, pc.Structure]]:
    """Starts and their kinds, small ones first."""
    given = [("deposited", load(path)) for path in options.structures]
    relaxed = [*map(load, options.models), *damaged(options.made)]
    given += [("relaxed", kept.relaxed(model)) for model in sorted(relaxed, key=lambda s: s.n_atoms)]
    return sorted(given, key=lambda each: each[1].n_atoms)


def check(structure: pc.Structure, limit: float) -> None:
    """Print how far runs to 10 and 1 end from where one to the smallest tolerance met these, nm."""
    for method in METHODS:
        _, whole = ends(structure, method, limit)
        for tolerance in (10.0, 1.0):
            _, part = ends(structure, method, limit, tolerance)
            apart = np.abs(part[f"{tolerance:g}"] - whole[f"{tolerance:g}"]).max()
            print(f"{structure.name} {method} {tolerance:g}: {apart:.1e} nm apart", flush=True)
    _, rough = descent(structure, 10.0 * limit)
    _, fine = descent(structure, 10.0 * limit, ERROR / 100.0)
    last = f"{TOLERANCES[-1]:g}"
    print(f"{structure.name} descent: {all_atoms(rough[last], fine[last]):.1e} angstrom apart", flush=True)


def compared(table: pd.DataFrame) -> pd.DataFrame:
    """Rows with what compares methods: energy above the lowest, and whether all methods met the tolerance.

    The lowest end of a structure is that of all methods that move all atoms.
    """
    in_torsions = table["method"].map(lambda name: name != "descent" and RECIPES[name].keeps_geometry)
    lowest = table[~in_torsions].groupby("structure")["energy_kj_mol"].min()
    above = (table["energy_kj_mol"] - table["structure"].map(lowest)) * 100.0 / table["residues"]
    met = table["energy_kj_mol"].notna() | (table["method"] == "descent")
    by_all = met.groupby([table["structure"], table["tolerance"]]).transform("all")
    return table.assign(above_kj_mol_per_100_residues=above, met_by_all=by_all)


def curves(table: pd.DataFrame) -> Figure:
    """Medians of RMSD, energy above the lowest and seconds against tolerance."""
    shown = {
        "ca_rmsd_angstrom": "C-alpha RMSD to the start, angstrom",
        "above_kj_mol_per_100_residues": "energy above the lowest end,\nkJ/mol per 100 residues",
        "cpu_seconds": "CPU seconds",
    }  # fmt: skip
    figure = Figure(figsize=(12, 4), layout="constrained")
    for axes, (column, label) in zip(figure.subplots(1, 3), shown.items(), strict=True):
        for method in METHODS:
            own = table[(table["method"] == method) & table["met_by_all"]]
            medians = own.groupby("tolerance")[column].median()
            axes.plot(medians.index, medians, "o-", label=method)
        axes.set(xscale="log", xlabel="tolerance, kJ/mol/nm (lbfgs: kJ/mol/rad)", ylabel=label)
        axes.set_yscale("linear" if column == "ca_rmsd_angstrom" else "log")
        axes.invert_xaxis()
    axes.legend(frameon=False)
    return figure


def parser() -> argparse.ArgumentParser:
    own = made.parser(__doc__)
    own.add_argument("structures", nargs="*", type=Path, metavar="STRUCTURE")
    own.add_argument("--models", nargs="*", type=Path, default=[], metavar="MODEL", help="to relax first")
    own.add_argument("--made", type=int, default=0, help="damaged copies of samples, to relax first")
    own.add_argument("--kept", type=Path, metavar="FOLDER", help="what is done, not to be done again")
    own.add_argument("--basins", type=int, default=400, metavar="ATOMS", help="of a descent, at most")
    own.add_argument(
        "--limit",
        type=float,
        default=100.0,
        metavar="SECONDS",
        help="of a run, at most; a descent has ten times as many",
    )
    own.add_argument("--check", action="store_true", help="only: that the way is that of each tolerance")
    return own


def main() -> None:
    options = parser().parse_args()
    if options.quick:
        options.structures, options.models, options.made = [SAMPLES / "ala10.pdb"], [], 0
    if options.check:
        for path in options.structures:
            check(load(path), options.limit)
        return
    with tempfile.TemporaryDirectory() as scratch:
        kept = Kept(options.kept or Path(scratch))
        chosen = starts(options, kept)
        tables, minima = [], []
        for kind, structure in chosen:
            name = structure.name
            about = {"structure": name, "start": kind, "residues": structure.n_residues,
                     "atoms": structure.n_atoms}  # fmt: skip
            small = structure.n_atoms <= options.basins
            for method in (*METHODS, "descent") if small else METHODS:
                if method == "descent":
                    run = partial(descent, structure, 10.0 * options.limit)
                else:
                    run = partial(ends, structure, method, options.limit)
                tables.append(kept.run(name, method, run).assign(**about))
            if small:
                minima.append(kept.table(name, "basins", partial(basins, structure, kept)).assign(**about))
    table = compared(pd.concat(tables, ignore_index=True))
    shares = pd.concat(minima or [pd.DataFrame({"method": [], "same": []})])
    print(table.groupby(["method", "tolerance"])[["ca_rmsd_angstrom", "cpu_seconds"]].median().to_string())
    print(shares.groupby("method")["same"].mean().to_string())
    if options.output:
        options.output.mkdir(parents=True, exist_ok=True)
        curves(table).savefig(options.output / "near.png", dpi=150)
        inputs = [*options.structures, *options.models, f"{options.made} damaged copies of samples"]
        made.write(table.round(4), options.output / "near.csv", inputs)
        made.write(shares.round(4), options.output / "near_basins.csv", inputs)


if __name__ == "__main__":
    main()
