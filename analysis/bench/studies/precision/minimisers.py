"""Energy error of each method against its cost on many structures, in evaluations and in seconds.

The best known energy of a structure is the lowest end of all methods with the same degrees of freedom, since
torsion methods keep bond lengths and angles. Energies are those of the run's own engine, in double precision
except OpenMM's.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from bench.cases import Point
from protochain.chains.articulate import build_chain
from protochain.core import defaults
from protochain.core.palette import looks
from protochain.energies import energy
from protochain.minimisers import RECIPES, minimise
from protochain.results.figures import Figure, outside, plain
from protochain.results.tables import save
from protochain.structure import Structure, from_sequence, load

METHODS = (
    "kcm", "kcm-adaptive", "kcm-metric", "kcm-stiffness", "newton", "lbfgs", "cartesian", "hybrid", "openmm",
)  # fmt: skip
PEPTIDES = ("YGGFM", "AAAAAAAAAA", "NLYIQWLKDGGPSSGRPPPS")
"""Met-enkephalin, decaalanine and Trp-cage, as extended chains, for use without files."""
ABOVE = (100.0, 10.0, 1.0)
"""kJ/mol per 100 residues above the best known."""
_WORK, _LEAST, _MOST = 2e6, 200, 1000
"""Evaluations times atoms, and limits of the evaluations: fast methods need no more, and slow ones would take
hours on a large protein. OpenMM is allowed twice as many."""
_QUICK = 200
"""Evaluations where it must be quick."""


def run(output: Path, inputs: Sequence[Path] = (), quick: bool = False) -> Iterator[pd.DataFrame]:
    """Measure all methods; write ``traces.csv``, ``ends.csv``, ``precision.csv`` and ``precision.png``."""
    traces, ends = [], []
    peptides = map(from_sequence, PEPTIDES[: 1 if quick else None])
    for structure in (load(path) for path in inputs) if inputs else peptides:
        trace, end = measure(structure, _QUICK if quick else _MOST)
        traces.append(trace)
        ends.append(end)
        save(output, {"traces.csv": pd.concat(traces), "ends.csv": pd.concat(ends)})
        yield end
    all_traces, all_ends = pd.concat(traces), pd.concat(ends)
    needed = work(all_traces, all_ends)
    save(output, {"precision.csv": needed, "precision.png": plot(all_traces, all_ends)})
    yield needed


def measure(structure: Structure, most: int = _MOST) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Run all methods on a structure, with the default hinges and energy; return traces and ends.

    At most this many evaluations are allowed, and OpenMM twice as many.
    """
    chain, own = build_chain(structure), energy(structure)
    traces, ends = [], []
    for method in METHODS:
        budget = int(np.clip(_WORK / structure.n_atoms, _LEAST, most)) * (2 if method == "openmm" else 1)
        solution = minimise(chain, own, method, defaults.TOLERANCE, budget)
        traces.append(solution.trace.assign(structure=structure.name, method=method))
        ends.append(
            {
                "structure": structure.name, "residues": structure.n_residues, "method": method,
                "status": str(solution.status), "energy_end_reference_kj_mol": solution.end.energy,
                "ca_rmsd_angstrom": solution.ca_rmsd_angstrom, "evaluations": solution.n_evaluations,
                "seconds": solution.seconds,
            }
        )  # fmt: skip
    return pd.concat(traces), pd.DataFrame(ends)


def work(traces: pd.DataFrame, ends: pd.DataFrame) -> pd.DataFrame:
    """Evaluations and seconds until each method came near the best known energy."""
    rows = []
    for (method, structure), trace in traces.groupby(["method", "structure"], sort=False):
        best, residues = _best(ends, str(method), str(structure))
        for cost in ("evaluations", "seconds"):
            for above in ABOVE:
                met = trace.loc[trace["energy_kj_mol"] <= best + above * residues / 100.0, cost]
                needed = met.iloc[0] if len(met) else np.inf
                rows.append({"method": method, "cost": cost, "above": above, "needed": needed})
    groups = pd.DataFrame(rows).groupby(["method", "cost", "above"], sort=False)["needed"]
    levels = {"first_quartile": 0.25, "median": 0.5, "third_quartile": 0.75}
    # No interpolation between a number and infinity.
    table = pd.DataFrame({name: groups.quantile(at, interpolation="higher") for name, at in levels.items()})
    return table.reset_index().rename(columns={"above": "above_kj_mol_per_100_residues"})


def points(needed: pd.DataFrame, structures: int) -> Iterator[Point]:
    """Points of the curve: median cost of each method to come within each energy of the best known."""
    costs = needed.set_index(["cost", "method", "above_kj_mol_per_100_residues"])["median"].sort_index()
    unit, against = "kJ/mol per 100 residues", "the lowest end of methods with the same freedoms"
    for method in needed["method"].unique():
        case = "torsions only" if RECIPES[method].keeps_geometry else "all atoms free"
        for above in ABOVE:
            seconds, evaluations = (float(costs[cost, method, above]) for cost in ("seconds", "evaluations"))
            came = np.isfinite(seconds)
            error, parameter = (above, f"within {above:g}") if came else (np.inf, f"not within {above:g}")
            yield Point(method, parameter, seconds, error, case, unit, against, evaluations, structures)


def plot(traces: pd.DataFrame, ends: pd.DataFrame) -> Figure:
    """Median energy above the best known, against evaluations and seconds."""
    figure = Figure(figsize=(7, 5.6), layout="constrained")
    axes = figure.subplots(2, 2, sharey=True)
    for row, (name, in_torsions) in zip(
        axes, (("torsions only", True), ("all atoms free", False)), strict=True
    ):
        methods = [m for m in traces["method"].unique() if RECIPES[m].keeps_geometry == in_torsions]
        for ax, cost in zip(row, ("evaluations", "seconds"), strict=True):
            for method, look in looks(methods).items():
                own = traces[traces["method"] == method]
                grid = np.geomspace(1.0 if cost == "evaluations" else 1e-3, own[cost].max(), 200)
                curve = np.median(
                    [_above(run, ends, cost, grid) for _, run in own.groupby("structure")], axis=0
                )
                ax.plot(grid, np.maximum(curve, 1e-2), **look.line(method))
            ax.set(xscale="log", yscale="log", xlabel=cost, title=name)
            plain(ax)
        row[0].set_ylabel("median energy above the best known,\nkJ/mol per 100 residues")
    outside(axes.ravel())
    return figure


def _above(run: pd.DataFrame, ends: pd.DataFrame, cost: str, grid: np.ndarray) -> np.ndarray:
    """Energy above the best known after each cost of the grid, kJ/mol per 100 residues."""
    best, residues = _best(ends, str(run["method"].iloc[0]), str(run["structure"].iloc[0]))
    place = np.searchsorted(run[cost].to_numpy(), grid, side="right") - 1
    lowest = np.minimum.accumulate(run["energy_kj_mol"].to_numpy())
    return np.asarray((lowest[np.maximum(place, 0)] - best) * 100.0 / residues)


def _best(ends: pd.DataFrame, method: str, structure: str) -> tuple[float, int]:
    """Lowest end (kJ/mol) of methods with the same degrees of freedom, and the number of residues."""
    own = ends[ends["structure"] == structure]
    same = [name for name, r in RECIPES.items() if r.keeps_geometry == RECIPES[method].keeps_geometry]
    alike = own[own["method"].isin(same)]
    return float(alike["energy_end_reference_kj_mol"].min()), int(own["residues"].iloc[0])
