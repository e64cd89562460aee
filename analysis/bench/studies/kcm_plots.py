"""The figure of the study of KCM against dynamics."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from bench.studies.kcm_cases import AT
from protochain.core.palette import COLOURS, looks
from protochain.results.figures import Figure, plain

SHOWN = ("kcm-0.005", "kcm-metric", "md-1", "md-10", "lbfgs")
"""Methods of the panels of energies."""
_LEAST = 1e-2
"""kJ/mol, where curves end on the logarithmic axis."""


def plot(tables: Mapping[str, pd.DataFrame], traces: pd.DataFrame | None) -> Figure:
    """Panels: energy along runs of one start, how often pairs of methods agree, energy for equal cost."""
    figure = Figure(figsize=(11, 8), layout="constrained")
    axes = figure.subplot_mosaic([["shares", "shares"], ["energy", "cost"]])
    shares, energy, cost = axes["shares"], axes["energy"], axes["cost"]
    style = {name: look.line(name) for name, look in looks(SHOWN).items()}
    if traces is not None and len(traces):
        for name, own in traces.groupby("method", sort=False):
            energy.plot(own["evaluations"], own["energy_kj_mol"], **style[str(name)])
        first = traces.iloc[0]
        energy.set_title(f"One start: {first['protein']}, {first['start']}")
    energy.set(xscale="log", xlabel="evaluations", ylabel="potential energy, kJ/mol")
    if len(tables["contrasts"]):
        _contrasts(shares, tables["contrasts"])
    for row in tables["cost"].to_dict("records"):
        if row["method"] in style:
            above = [max(row[f"at_{k}"], _LEAST) for k in AT]
            cost.plot(AT, above, **style[row["method"]])
    cost.set(
        xscale="log", yscale="log", xlabel="evaluations", title="All starts of which every method has run",
        ylabel="median above the lowest\nminimum of the start, kJ/mol",
    )  # fmt: skip
    for axis in (energy, shares, cost):
        plain(axis)
        if axis.get_legend_handles_labels()[0]:
            axis.legend(frameon=False, fontsize=8, loc="lower left" if axis is shares else "best")
    return figure


PATHS = (
    "kcm-0.005", "entropy-positions-0.03", "entropy-mass-0.01", "md-0.1", "md-1", "md-10", "md-100", "lbfgs",
)  # fmt: skip
"""Methods of the figure of paths."""


def plot_paths(points: pd.DataFrame, rows: pd.DataFrame) -> Figure:
    """Energy along the paths of one peptide, and path lengths from deposited proteins at equal cost."""
    figure = Figure(figsize=(11, 4.4), layout="constrained")
    energy, lengths = figure.subplots(1, 2)
    style = looks(PATHS)
    for name in PATHS:
        path = points[points["method"] == name]
        energy.plot(path["path_nm"], path["energy_kj_mol"], **style[name].line(name))
    energy.set(
        xscale="log", xlim=(1e-3, None), ylabel="potential energy, kJ/mol",
        xlabel="path length, nm (RMS movement by mass)",
        title=f"Bounded KCM falls along a path as short as that of dynamics: {points['protein'].iloc[0]}",
    )  # fmt: skip
    deposited = rows[rows["start"] == "deposited"].sort_values("residues", kind="stable")
    for name in PATHS:
        path = deposited[deposited["method"] == name]
        if len(path):
            lengths.plot(path["residues"], path["path_nm"], **style[name].line(name) | {"markevery": 1})
    lengths.set(
        xscale="log", yscale="log", xlabel="residues", ylabel="path length, nm",
        title="Without a bound KCM moves a protein to and fro",
    )  # fmt: skip
    for axis in (energy, lengths):
        plain(axis)
        axis.title.set_fontsize(10)
    figure.legend(
        *energy.get_legend_handles_labels(), frameon=False, fontsize=8, loc="outside lower center", ncols=8
    )
    return figure


_NAMED = {
    "KCM and dynamics, friction 10": "KCM by torques and dynamics, friction 10 / ps",
    "metric of masses": "add masses (KCM along $M^{-1}$torque)",
    "inertia, friction 10": "then add inertia, friction 10 / ps",
    "inertia, friction 1": "then add inertia, friction 1 / ps",
    "root, without inertia": "fix one residue (KCM along $M^{-1}$torque)",
    "root, friction 10": "fix one residue (dynamics)",
    "rule: adaptive angle": "another rule for the length of steps",
}
"""Contrasts of the figure, in words."""


def _contrasts(axis: Any, table: pd.DataFrame) -> None:
    """Shares of one minimum, and of the worst controls, in solvent with all hinges."""
    rows = table[table["scope"] == table["scope"].iloc[0]].set_index("what")
    own = rows.loc[[name for name in reversed(_NAMED) if name in rows.index]]
    own = own[own["baseline"].notna()]
    for name, colour, shift in (("same", COLOURS[0], 0.12), ("baseline", "0.6", -0.12)):
        value = 100.0 * own[name]
        off = [value - 100.0 * own[f"{name}_low"], 100.0 * own[f"{name}_high"] - value]
        label = (
            "with the change" if name == "same" else "with a change that should not matter (half the step)"
        )
        axis.errorbar(value, np.arange(len(own)) + shift, xerr=off, fmt="o", color=colour, label=label, ms=4)
    axis.set_yticks(range(len(own)), [_NAMED[what] for what in own.index], fontsize=9)
    axis.set(xlim=(0, 100), xlabel="runs from one start that end in the same minimum, per cent")
    axis.set_title(
        f"How often does a change of the method leave the minimum as it is? {table['scope'].iloc[0]}"
    )
