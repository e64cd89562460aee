"""The figure of the study of KCM against dynamics."""

from collections.abc import Mapping
from itertools import cycle
from typing import Any

import numpy as np
import pandas as pd

from protochain.analysis.studies.kcm_cases import AT
from protochain.results.figures import COLOURS, DASHES, Figure, plain

SHOWN = ("kcm-0.005", "kcm-metric", "md-1", "md-10", "lbfgs")
"""Methods of the panels of energies."""
_LEAST = 1e-2
"""kJ/mol, where curves end on the logarithmic axis."""


def plot(tables: Mapping[str, pd.DataFrame], traces: pd.DataFrame | None) -> Figure:
    """Four panels: energy and C-alpha RMSD along runs, contrasts with their baselines, energy for equal cost.

    Parameters
    ----------
    tables : mapping of str to pandas.DataFrame
        ``contrasts`` and ``cost``.
    traces : pandas.DataFrame, optional
        Runs of one start, point by point.
    """
    figure = Figure(figsize=(11, 8), layout="constrained")
    (energy, rmsd), (shares, cost) = figure.subplots(2, 2)
    style = {
        name: {"color": colour, "linestyle": dash, "label": name}
        for name, colour, dash in zip(SHOWN, cycle(COLOURS), cycle(DASHES), strict=False)
    }
    if traces is not None and len(traces):
        for name, own in traces.groupby("method", sort=False):
            energy.plot(own["evaluations"], own["energy_kj_mol"], **style[str(name)])
            rmsd.plot(own["evaluations"], own["ca_rmsd_angstrom"], **style[str(name)])
        first = traces.iloc[0]
        energy.set_title(f"{first['protein']} from {first['start']}, {first['energy']}")
    energy.set(xscale="log", xlabel="evaluations", ylabel="potential energy, kJ/mol")
    rmsd.set(xscale="log", xlabel="evaluations", ylabel="C-alpha RMSD to the start, angstrom")
    _contrasts(shares, tables["contrasts"])
    for row in tables["cost"].to_dict("records"):
        if row["method"] in style:
            above = [max(row[f"at_{k}"], _LEAST) for k in AT]
            cost.plot(AT, above, **style[row["method"]])
    cost.set(
        xscale="log", yscale="log", xlabel="evaluations",
        ylabel="median above the lowest\nminimum of the start, kJ/mol",
    )  # fmt: skip
    for axis in (energy, rmsd, shares, cost):
        plain(axis)
        if axis.get_legend_handles_labels()[0]:
            axis.legend(frameon=False, fontsize=8)
    return figure


def _contrasts(axis: Any, table: pd.DataFrame) -> None:
    """Shares of one minimum, and of the controls, of all energies together."""
    own = table[(table["energy"] == "all") & (table["start"] == "all") & table["baseline"].notna()][::-1]
    for name, colour, shift in (("same", COLOURS[0], 0.12), ("baseline", "0.6", -0.12)):
        value = 100.0 * own[name]
        off = [value - 100.0 * own[f"{name}_low"], 100.0 * own[f"{name}_high"] - value]
        label = "finished pairs" if name == "same" else "their controls"
        axis.errorbar(value, np.arange(len(own)) + shift, xerr=off, fmt="o", color=colour, label=label, ms=4)
    axis.set_yticks(range(len(own)), own["what"], fontsize=8)
    axis.set(xlim=(0, 100), xlabel="ending in one minimum, per cent")
