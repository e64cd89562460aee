"""Figures of the pages, each from its tables in analysis/results, with a title that states what it shows.

    python analysis/benchmarks/figures.py [NAME ...] [-o DIR]

NAME is any of FIGURES (all by default). Each is written as NAME.svg, with its row in made.csv. Tables are
those of DIR, or of analysis/results if DIR has none. Nothing is measured.
"""

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

import made
import numpy as np
import pandas as pd
from made import RESULTS
from tables import SOLVENTS

from bench.lines import draw_lines
from bench.studies import kcm_plots
from bench.studies.omissions import plot as plot_omissions
from bench.studies.precision.curves import plot as plot_curves
from bench.studies.stability.page import picture
from protochain.comparison.plots import plot_energy
from protochain.core.figure import INK, Figure, style
from protochain.core.palette import COLOURS, DASHES, MARKERS, looks
from protochain.minimisers import RECIPES
from protochain.results.figures import outside

WAYS = {"tree": "tree", "cutoff": "cutoff", "OpenMM CPU, all": "OpenMM, all pairs"}
"""Ways of engines_accuracy.csv, by the beginnings of their names."""


def near(table: pd.DataFrame) -> Figure:
    """Medians of RMSD, energy above the minimum, evaluations against tolerance, and energy against RMSD."""
    rmsd, above = "C-alpha RMSD, angstrom", "above the minimum,\nkJ/mol per residue"
    shown = (
        ("tolerance", "ca_rmsd_angstrom", rmsd), ("tolerance", "above", above),
        ("tolerance", "evaluations", "evaluations"), ("ca_rmsd_angstrom", "above", above),
    )  # fmt: skip
    table = table.assign(above=table["above_kj_mol"] / table["residues"])
    medians = table.groupby(["method", "tolerance"])[["ca_rmsd_angstrom", "above", "evaluations"]].median()
    figure = Figure(figsize=(7, 5.2), layout="constrained")
    panels = figure.subplots(2, 2).ravel()
    for ax, (along, column, label) in zip(panels, shown, strict=True):
        for method, look in looks(table["method"].unique()).items():
            points = medians.loc[method].reset_index().sort_values("tolerance", ascending=False)
            ax.plot(points[along], points[column], **look.line(method) | {"markevery": None})
        ax.set(ylabel=label, xlabel=rmsd if along != "tolerance" else "tolerance, kJ/mol/nm (lbfgs: /rad)")
        if along == "tolerance":
            ax.set_xscale("log")
            ax.invert_xaxis()
        if column == "above":
            ax.set_yscale("symlog", linthresh=0.01)
        ax.set_ylim(bottom=0.0)
    outside(panels)
    ours, theirs = (medians.loc[(method, 1.0), "evaluations"] for method in ("cartesian", "openmm"))
    figure.suptitle(
        f"To 1 kJ/mol/nm cartesian needs {ours:.0f} evaluations and OpenMM {theirs:.0f} "
        f"(medians of {table['structure'].nunique()} structures)"
    )
    return figure


def limit_cycle(table: pd.DataFrame) -> Figure:
    """Largest torque that KCM with a fixed step leaves, and that other rules leave."""
    figure = Figure(figsize=(5.6, 3.4), layout="constrained")
    ax = figure.subplots()
    torques = table.groupby("setting")["torque_end_kj_mol_rad"]
    of_steps = torques.quantile([0.25, 0.5, 0.75]).unstack().filter(like="kcm, ", axis=0)
    steps = of_steps.index.str.extract(r"([\d.]+) rad", expand=False).astype(float)
    low, middle, high = (of_steps[share].to_numpy() for share in (0.25, 0.5, 0.75))
    ax.errorbar(steps, middle, yerr=(middle - low, high - middle), fmt="o-", color=COLOURS[1])
    ax.annotate("fixed step", (steps[2], middle[2]), (6, -10), textcoords="offset points", color=COLOURS[1])
    ends = {name: torques.median()[name] for name in ("kcm-decaying", "kcm-adaptive", "kcm-stiffness")}
    for name, end in ends.items():
        ax.axhline(end, linestyle=DASHES[1], color=INK, linewidth=0.8)
        above = name != "kcm-stiffness"
        ax.annotate(
            name, (steps.min(), end), (0, 3 if above else -3), textcoords="offset points",
            va="bottom" if above else "top",
        )  # fmt: skip
    ax.set(
        xscale="log", yscale="log", ylim=(2e-4, 2e2), xlabel="step, rad",
        ylabel="largest torque at the end, kJ/mol/rad",
        title=f"The smallest fixed step leaves {middle[steps.argmin()]:.1f} kJ/mol/rad, kcm-stiffness "
        f"{ends['kcm-stiffness']:.4f}",
    )  # fmt: skip
    return figure


def dynamics_energy(table: pd.DataFrame) -> Figure:
    """Energy error against time step and against cost."""
    figure = Figure(figsize=(7, 3.2), layout="constrained")
    axes = figure.subplots(1, 2, sharey=True)
    sound = table[(table["status"] == "completed") & (table["time_ps"] < 100)]
    sound = sound.assign(seconds_per_ps=sound["ms_per_step"] / sound["step_fs"])
    for ax, column in zip(axes, ("step_fs", "seconds_per_ps"), strict=True):
        draw_lines(ax, sound, column, "error_kj_mol", "integrator")
    axes[0].set(xlabel="time step, fs", ylabel="standard deviation of the energy, kJ/mol")
    axes[1].set(xlabel="run time, s per ps")
    outside(axes)
    leapfrog = np.log(sound.loc[sound["integrator"] == "leapfrog", ["step_fs", "error_kj_mol"]])
    order = np.polyfit(leapfrog["step_fs"], leapfrog["error_kj_mol"], 1)[0]
    figure.suptitle(f"Trp-cage, 300 K: leapfrog's energy error grows as the step to the power of {order:.1f}")
    return figure


def engines_accuracy(table: pd.DataFrame) -> Figure:
    """Error of the forces against ms of a processor: a panel for each solvent, a colour for each size."""
    sizes, solvents = sorted(table["atoms"].unique()), list(dict.fromkeys(table["solvent"]))
    figure = Figure(figsize=(7, 3.2), layout="constrained")
    axes = figure.subplots(1, len(solvents), sharey=True)
    colours = dict(zip(sizes, COLOURS, strict=False))
    styles = dict(zip(WAYS, zip(("-", ":", ""), MARKERS[:1] + MARKERS[1] + "x", strict=True), strict=True))
    for ax, solvent in zip(axes, solvents, strict=True):
        for atoms, colour in colours.items():
            of_size = table[(table["solvent"] == solvent) & (table["atoms"] == atoms)]
            for way, (dash, marker) in styles.items():
                points = of_size[of_size["by"].str.startswith(way)]
                values = points["processor_ms"], points["rms_force_off_kj_mol_nm"]
                ax.loglog(*values, linestyle=dash, marker=marker, color=colour)
            for ms in of_size.loc[of_size["by"] == "all pairs", "processor_ms"]:
                ax.axvline(ms, color=colour, linewidth=0.8, alpha=0.6)
        ax.set(title=SOLVENTS[solvent], xlabel="ms of a processor (line: all pairs)")
    axes[0].set_ylabel("RMS error of the forces, kJ/mol/nm")
    for atoms, colour in colours.items():
        axes[0].plot([], [], color=colour, linewidth=3.0, label=f"{atoms:,} atoms")
    for way, (dash, marker) in styles.items():
        axes[0].plot([], [], linestyle=dash, marker=marker, color=INK, label=WAYS[way])
    outside(axes)
    of_trees = table[(table["atoms"] == sizes[-1]) & table["by"].str.startswith("tree")]
    row = of_trees[of_trees["solvent"] == "obc2"].sort_values("processor_ms").iloc[0]
    figure.suptitle(
        f"Trees: {sizes[-1]:,} atoms in OBC2 for {100 * row['of_all_pairs']:.0f} % of the time of all pairs, "
        f"with an error of {row['rms_force_off_kj_mol_nm']:.1g} kJ/mol/nm"
    )
    return figure


def kcm(*tables: pd.DataFrame) -> Figure:
    """The study of KCM against dynamics."""
    contrasts, cost, traces = tables
    return kcm_plots.plot({"contrasts": contrasts, "cost": cost}, traces)


def integrators(curves: pd.DataFrame) -> Figure:
    """Error of the integrators against seconds and evaluations."""
    rows = curves[curves["kind"] == "integrators"]
    sound = rows[np.isfinite(rows["error"])]
    best = sound.loc[sound["error"].idxmin()]
    return plot_curves(rows, f"Of the integrators {best['method']} comes closest, to {best['error']:.0e} rad")


def comparison(traces: pd.DataFrame) -> Figure:
    """Energy along runs of ubiquitin."""
    methods = traces["method"].unique()
    groups = {
        name: [method for method in methods if RECIPES[method].keeps_geometry == in_torsions]
        for name, in_torsions in (("torsions only", True), ("all atoms free", False))
    }
    return plot_energy(traces, groups, "ubiquitin")


FIGURES: dict[str, tuple[Callable[..., Any], str]] = {
    "comparison": (comparison, "comparison"),
    "dynamics-energy": (dynamics_energy, "dynamics_energy"),
    "engines-accuracy": (engines_accuracy, "engines_accuracy"),
    "integrators": (integrators, "precision_curves"),
    "kcm": (kcm, "kcm_contrasts kcm_cost kcm_traces"),
    "kcm-paths": (kcm_plots.plot_paths, "kcm_path_points kcm_paths"),
    "limit-cycle": (limit_cycle, "compliance_starts"),
    "near": (near, "near"),
    "omissions": (plot_omissions, "scenes"),
    "stability": (picture, "stability_cells"),
}
"""Functions of figures, with the names of their tables."""


def draw(name: str, output: Path) -> None:
    """Write a figure and its row."""
    function, tables = FIGURES[name]
    paths = [
        next(folder / f"{table}.csv" for folder in (output, RESULTS) if (folder / f"{table}.csv").exists())
        for table in tables.split()
    ]
    with style():
        figure = function(*map(pd.read_csv, paths))
    made.draw(figure, output / f"{name}.svg", paths)
    print(f"{name}.svg")


def parser() -> argparse.ArgumentParser:
    return made.parser(__doc__ or "", FIGURES)


def main() -> None:
    options = parser().parse_args()
    for name in options.studies or FIGURES:
        draw(name, options.output or RESULTS)


if __name__ == "__main__":
    main()
