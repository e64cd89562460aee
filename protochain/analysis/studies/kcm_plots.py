"""Figures of the study of KCM against dynamics."""

from itertools import cycle

import numpy as np
import pandas as pd

from protochain.analysis.studies.kcm_cases import AT, METHODS
from protochain.results.figures import COLOURS, DASHES, Figure, plain

_LEAST = 1e-3
"""kJ/mol, where curves end on the logarithmic axis."""


def plot_traces(found: pd.DataFrame) -> Figure:
    """Median energy above the lowest polished end of each start, against evaluations: a panel a family.

    Parameters
    ----------
    found : pandas.DataFrame
        Runs with ``lowest_kj_mol``, from starts that all methods have run from.
    """
    figure = Figure(figsize=(11, 4.4), layout="constrained")
    axes = figure.subplots(1, 3, sharey=True)
    families = {
        "KCM, its angle and rule": [name for name in METHODS if name.startswith("kcm-0")]
        + ["kcm-proportional", "kcm-sign", "kcm-adaptive"],
        "metrics, and L-BFGS": ["kcm-adaptive", "kcm-metric", "kcm-stiffness", "lbfgs"],
        "dynamics, friction per ps": [name for name in METHODS if name.startswith("md-")],
    }
    for axis, (title, methods) in zip(axes, families.items(), strict=True):
        for name, colour, dash in zip(methods, cycle(COLOURS), cycle(DASHES), strict=False):
            own = found[found["method"] == name]
            if len(own):
                above = [(own[f"energy_at_{n}"] - own["lowest_kj_mol"]).median() for n in AT]
                axis.plot(AT, np.maximum(above, _LEAST), color=colour, linestyle=dash, label=name)
        axis.set(xscale="log", yscale="log", xlabel="evaluations", title=title)
        if axis.lines:
            axis.legend(frameon=False, fontsize=8)
        plain(axis)
    axes[0].set_ylabel("median energy above the lowest\npolished end of the start, kJ/mol")
    return figure


def plot_shares(table: pd.DataFrame) -> Figure:
    """Share of starts in which two methods reach one minimum, of all together, as a matrix."""
    own = table[table["start"] == "all"]
    names = [name for name in METHODS if name in set(own["a"]) | set(own["b"])]
    grid = pd.DataFrame(np.nan, index=names, columns=names)
    for row in own.to_dict("records"):
        grid.loc[row["a"], row["b"]] = grid.loc[row["b"], row["a"]] = 100.0 * row["polished_share"]
    figure = Figure(figsize=(8, 7), layout="constrained")
    axis = figure.subplots()
    shown = axis.imshow(grid.to_numpy(), vmin=0.0, vmax=100.0, cmap="cividis")
    axis.set_xticks(range(len(names)), names, rotation=60, ha="right")
    axis.set_yticks(range(len(names)), names)
    for i, line in enumerate(grid.to_numpy()):
        for j, value in enumerate(line):
            if np.isfinite(value):
                axis.text(
                    j, i, f"{value:.0f}", ha="center", va="center", color="black" if value > 50 else "white"
                )
    figure.colorbar(shown, label="starts in which both reach one minimum, per cent")
    return figure
