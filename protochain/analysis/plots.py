"""Figures of a comparison: safe for colour-blind readers, and readable in grey by line style."""

import io
from collections.abc import Iterable, Mapping, Sequence
from itertools import cycle
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure as PlainFigure
from matplotlib.ticker import MaxNLocator

from protochain.analysis.quality import ramachandran_reference
from protochain.arrays import Floats

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""Okabe and Ito's palette, dark colours first."""
_DASHES = ("-", "--", "-.", ":")
_LOG_FROM = 1e4
"""kJ/mol. A larger drop, as from a relieved clash, would hide all else on a linear axis."""
_SAME = 0.1
"""kJ/mol above the lowest, where curves end on a logarithmic axis: less is the same minimum."""


class Figure(PlainFigure):
    """Figure that notebooks show without pyplot, which would keep every figure in memory."""

    def _repr_png_(self) -> bytes:
        buffer = io.BytesIO()
        self.savefig(buffer, format="png", dpi=100)
        return buffer.getvalue()


def plot_energy(traces: pd.DataFrame, title: str) -> Figure:
    """Energy against evaluations and against seconds.

    Parameters
    ----------
    traces : pandas.DataFrame
        As ``Comparison.traces``.
    title : str

    Returns
    -------
    matplotlib.figure.Figure
        Lowest energy so far of each run. Evaluations and seconds are logarithmic; if clashes make energies
        span decades, so is the energy above the lowest of all.
    """
    figure = Figure(figsize=(10, 4.2), layout="constrained")
    axes = figure.subplots(1, 2, sharey=True)
    styles = _styles(traces["method"].unique())
    traces = traces[np.isfinite(traces["energy_kj_mol"])]
    if traces.empty:
        figure.suptitle(f"{_plain_text(title)}: no finite energy")
        return figure
    best = traces.groupby("method", sort=False)["energy_kj_mol"].cummin()
    logarithmic = best.iloc[0] - best.min() > _LOG_FROM
    if logarithmic:
        best = (best - best.min()).clip(lower=_SAME)
    _draw_runs(axes, traces.assign(shown=best), "shown", styles)
    axes[0].set_ylabel("energy above the lowest, kJ/mol" if logarithmic else "energy, kJ/mol")
    axes[0].set_yscale("log" if logarithmic else "linear")
    figure.suptitle(f"{_plain_text(title)}: lowest energy so far")
    return figure


def plot_work_precision(
    traces: pd.DataFrame, work: pd.DataFrame, groups: Mapping[str, Sequence[str]], title: str
) -> Figure:
    """Energy above the lowest end against evaluations and against seconds (work-precision diagram).

    Parameters
    ----------
    traces, work : pandas.DataFrame
        As ``Comparison.traces`` and ``Comparison.work``.
    groups : mapping of str to sequence of str
        Methods with the same degrees of freedom, and so the same lowest end: one row of panels each.
    title : str

    Returns
    -------
    matplotlib.figure.Figure
    """
    groups = {name: methods for name, methods in groups.items() if methods}
    figure = Figure(figsize=(10, 0.6 + 3.6 * len(groups)), layout="constrained")
    grid = figure.subplots(len(groups), 2, sharex="col", sharey=True, squeeze=False)
    lowest = traces["method"].map(work.set_index("method")["lowest_kj_mol"])
    best = traces.groupby("method", sort=False)["energy_kj_mol"].cummin()
    styles = _styles(traces["method"].unique())
    # Single-precision energies may lie below the lowest judged one.
    traces = traces.assign(above=(best - lowest).clip(lower=_SAME))
    for axes, (name, methods) in zip(grid, groups.items(), strict=True):
        _draw_runs(axes, traces[traces["method"].isin(methods)], "above", styles)
        axes[0].set_ylabel(f"{name}:\nenergy above the lowest end, kJ/mol")
        axes[0].set_yscale("log")
    figure.suptitle(f"{_plain_text(title)}: energy above the lowest end against cost")
    return figure


def plot_torque(traces: pd.DataFrame, title: str) -> Figure:
    """Largest torque against evaluations and against seconds.

    Parameters
    ----------
    traces : pandas.DataFrame
        As ``Comparison.traces``.
    title : str

    Returns
    -------
    matplotlib.figure.Figure
        Logarithmic in both. Torques are not recorded while all atoms move; the title names those methods.
    """
    figure = Figure(figsize=(10, 4.2), layout="constrained")
    styles = _styles(traces["method"].unique())
    drawn = traces["max_torque_kj_mol_rad"] > 0.0
    free = traces.loc[~drawn, "method"].unique()
    note = f"\nnot recorded while all atoms move: {', '.join(free)}" if len(free) else ""
    traces = traces[drawn]
    if traces.empty:
        figure.suptitle(f"{_plain_text(title)}: no run in torsions")
        return figure
    axes = figure.subplots(1, 2, sharey=True)
    _draw_runs(axes, traces, "max_torque_kj_mol_rad", styles)
    axes[0].set_ylabel("largest torque, kJ/mol/rad")
    axes[0].set_yscale("log")
    figure.suptitle(f"{_plain_text(title)}: largest torque on a hinge{note}")
    return figure


Styles = dict[str, dict[str, Any]]


def _styles(methods: Iterable[str]) -> Styles:
    """Colour and line style of each method, the same in every figure of a comparison."""
    return {
        method: {"color": colour, "linestyle": dash, "label": method}
        for method, colour, dash in zip(methods, cycle(COLOURS), cycle(_DASHES))
    }


def _draw_runs(axes: Sequence[Axes], traces: pd.DataFrame, value: str, styles: Styles) -> None:
    """Draw a column of the traces against evaluations and against seconds, one line per method."""
    for method, run in traces.groupby("method", sort=False):
        for ax, cost in zip(axes, ("evaluations", "seconds"), strict=True):
            # A line through one point would be invisible.
            ax.plot(run[cost], run[value], marker="o" if len(run) == 1 else "", **styles[str(method)])
    axes[0].set_xlabel("energy evaluations")
    axes[1].set_xlabel("seconds")
    axes[0].legend(frameon=False)
    for ax in axes:
        ax.set_xscale("log")
        plain(ax)


def plot_rmsd(traces: pd.DataFrame, rmsd: pd.DataFrame, title: str) -> Figure:
    """C-alpha RMSD to the start along each run, and between all ends.

    Parameters
    ----------
    traces : pandas.DataFrame
        As ``Comparison.traces``.
    rmsd : pandas.DataFrame
        As ``Comparison.rmsd``, angstrom.
    title : str

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure = Figure(figsize=(10, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.3, 1))
    styles = _styles(traces["method"].unique())
    for method, run in traces.groupby("method", sort=False):
        left.plot(run["evaluations"], run["ca_rmsd_angstrom"], **styles[str(method)])
    left.set_xscale("log")
    left.set_xlabel("energy evaluations")
    left.set_ylabel("C-alpha RMSD to the start, angstrom")
    left.legend(frameon=False)
    plain(left)

    values = rmsd.to_numpy()
    image = right.imshow(values, cmap="cividis_r", vmin=0.0)
    ticks = np.arange(len(rmsd))
    right.set_xticks(ticks, list(rmsd.columns))
    right.set_yticks(ticks, list(rmsd.index))
    for i in ticks:
        for j in ticks:
            shade = "white" if values[i, j] > 0.6 * values.max() else "black"
            right.text(j, i, f"{values[i, j]:.2f}", ha="center", va="center", color=shade)
    right.set_title("between ends", fontsize="medium")
    figure.colorbar(image, ax=right, label="C-alpha RMSD, angstrom")
    figure.suptitle(f"{_plain_text(title)}: C-alpha RMSD after superposition")
    return figure


def plot_displacement(displacements: pd.DataFrame, title: str) -> Figure:
    """Displacement of each C-alpha from the start.

    Parameters
    ----------
    displacements : pandas.DataFrame
        As ``Comparison.displacements``, angstrom.
    title : str

    Returns
    -------
    matplotlib.figure.Figure
        One line per method; vertical lines separate the chains.
    """
    figure = Figure(figsize=(10, 3.8), layout="constrained")
    ax = figure.subplots()
    place = np.arange(1, len(displacements) + 1)
    for method, style in _styles(displacements.columns[3:]).items():
        ax.plot(place, displacements[method], **style)
    chains = displacements["chain"].to_numpy()
    for k in np.flatnonzero(chains[1:] != chains[:-1]):
        ax.axvline(k + 1.5, color="black", linewidth=0.8)
    ax.set_xlabel("residue, in the order of the file")
    ax.set_ylabel("displacement of C-alpha, angstrom")
    ax.set_ylim(bottom=0.0)
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.legend(frameon=False, ncols=3)
    plain(ax)
    figure.suptitle(f"{_plain_text(title)}: displacement from the start, superposed on all C-alphas")
    return figure


def plot_ramachandran(angles: dict[str, Floats], title: str) -> Figure:
    """Ramachandran plots of the start and of every end.

    Parameters
    ----------
    angles : dict of str to (n, 2) float
        Phi and psi in degrees, by ``start`` and method; the start first.
    title : str

    Returns
    -------
    matplotlib.figure.Figure
        One panel each, over the allowed and marginally allowed regions of MDAnalysis' reference.
    """
    columns = min(3, len(angles))
    rows = -(-len(angles) // columns)
    figure = Figure(figsize=(3.4 * columns, 3.3 * rows), layout="constrained")
    axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    reference = ramachandran_reference()
    grid = np.linspace(-180.0, 180.0, len(reference) + 1)[:-1]
    for ax, (name, values) in zip(axes.flat, angles.items(), strict=False):
        ax.contourf(grid, grid, reference, levels=[1, 17, 15000], colors=["#dddddd", "#aaaaaa"])
        ax.scatter(values[:, 0], values[:, 1], s=9, color=COLOURS[0])
        ax.set(xlim=(-180, 180), ylim=(-180, 180), xticks=range(-180, 181, 90), yticks=range(-180, 181, 90))
        ax.set_aspect("equal")
        ax.set_title(name, fontsize="medium")
    for k, ax in enumerate(axes.flat):
        ax.set_visible(k < len(angles))
        if k + columns >= len(angles):
            ax.set_xlabel("phi, degrees")
            ax.tick_params(labelbottom=True)
    for ax in axes[:, 0]:
        ax.set_ylabel("psi, degrees")
    figure.suptitle(f"{_plain_text(title)}: phi and psi; dark grey allowed, light grey marginally allowed")
    return figure


def plain(ax: Axes) -> None:
    """Keep the left and bottom axes only, with a faint grid."""
    ax.spines[["top", "right"]].set_visible(False)
    ax.grid(True, which="major", alpha=0.25)


def _plain_text(text: str) -> str:
    """Escape dollar signs, which matplotlib reads as mathematics."""
    return text.replace("$", r"\$")
