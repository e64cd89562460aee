"""The figure of the study of KCM against dynamics."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from bench.studies.kcm_cases import AT
from protochain.core.figure import style
from protochain.core.palette import COLOURS, START, looks
from protochain.results.figures import Figure, outside, plain

SHOWN = ("kcm-0.005", "kcm-metric", "md-1", "md-10", "lbfgs")
"""Methods of the panels of energies."""
_LEAST = 1e-2
"""kJ/mol, where curves end on the logarithmic axis."""


@style()
def plot(tables: Mapping[str, pd.DataFrame], traces: pd.DataFrame | None) -> Figure:
    """Panels: energy along runs of one start, how often pairs of methods agree, energy for equal cost."""
    figure = Figure(figsize=(7, 6.6), layout="constrained")
    above, below = figure.subfigures(2, 1, squeeze=False)[:, 0]
    shares, (energy, cost) = above.subplots(), below.subplots(1, 2)
    lines = {name: look.line(name) for name, look in looks(SHOWN).items()}
    if traces is not None and len(traces):
        for name, own in traces.groupby("method", sort=False):
            energy.plot(own["evaluations"], own["energy_kj_mol"], **lines[str(name)])
        first, last = traces.iloc[0], traces.groupby("method")["energy_kj_mol"].last()
        energy.set_title(f"{first['protein']}, {first['start']}: {last.idxmin()} ends lowest")
    energy.set(xscale="log", xlabel="evaluations", ylabel="potential energy, kJ/mol")
    if len(tables["contrasts"]):
        _contrasts(shares, tables["contrasts"])
    rows = tables["cost"].set_index("method")
    methods = [name for name in SHOWN if name in rows.index]
    rows = rows.loc[methods, [f"at_{k}" for k in AT]].clip(lower=_LEAST)
    for method in methods:
        cost.plot(AT, rows.loc[method], **lines[method])
    lowest = rows[f"at_{AT[-1]}"].idxmin() if len(rows) else "none"
    cost.set(
        xscale="log", yscale="log", xlabel="evaluations", title=f"All starts: {lowest} ends lowest",
        ylabel="median above the lowest\nminimum of the start, kJ/mol",
    )  # fmt: skip
    for axis in (energy, shares, cost):
        plain(axis)
    outside([energy, cost])
    return figure


PATHS = (
    "kcm-0.005", "entropy-positions-0.03", "entropy-mass-0.01", "md-0.1", "md-1", "md-10", "lbfgs",
)  # fmt: skip
"""Methods of the figure of paths, as many as there are colours."""


@style()
def plot_paths(points: pd.DataFrame, rows: pd.DataFrame) -> Figure:
    """Energy along the paths of one peptide, and path lengths from deposited proteins at equal cost."""
    figure = Figure(figsize=(7, 3.6), layout="constrained")
    energy, lengths = figure.subplots(1, 2)
    methods = looks(PATHS)
    for name in PATHS:
        path = points[points["method"] == name]
        energy.plot(path["path_nm"], path["energy_kj_mol"], **methods[name].line(name))
    energy.set(
        xscale="log", xlim=(1e-3, None), ylabel="potential energy, kJ/mol",
        xlabel="path length, nm (RMS movement by mass)",
        title=f"Bounded KCM falls along a path as\nshort as that of dynamics: {points['protein'].iloc[0]}",
    )  # fmt: skip
    deposited = rows[rows["start"] == "deposited"].sort_values("residues", kind="stable")
    for name in PATHS:
        path = deposited[deposited["method"] == name]
        if len(path):
            lengths.plot(path["residues"], path["path_nm"], **methods[name].line(name) | {"markevery": 1})
    lengths.set(
        xscale="log", yscale="log", xlabel="residues", ylabel="path length, nm",
        title="Without a bound KCM moves\na protein to and fro",
    )  # fmt: skip
    for axis in (energy, lengths):
        plain(axis)
    outside([energy, lengths])
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
    for name, colour, shift in (("same", COLOURS[0], 0.12), ("baseline", START, -0.12)):
        value = 100.0 * own[name]
        off = [value - 100.0 * own[f"{name}_low"], 100.0 * own[f"{name}_high"] - value]
        label = "with the change" if name == "same" else "with half the step"
        axis.errorbar(value, np.arange(len(own)) + shift, xerr=off, fmt="o", color=colour, label=label, ms=4)
    axis.set_yticks(range(len(own)), [_NAMED[what] for what in own.index])
    axis.set(xlim=(0, 100), xlabel="runs from one start that end in the same minimum, per cent")
    outside([axis])
    first, inertia = (100.0 * own["same"].get(name, np.nan) for name in [*_NAMED][:3:2])
    axis.set_title(
        f"{table['scope'].iloc[0]}: KCM and dynamics share {first:.0f} % of minima. "
        f"Inertia with friction 10 / ps leaves {inertia:.0f} %"
    )
