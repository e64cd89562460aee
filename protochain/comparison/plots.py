"""Figures of a comparison, with colours for colour-blind readers, and line styles for grey prints."""

from collections.abc import Iterable, Mapping, Sequence
from textwrap import fill
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure as PlainFigure
from matplotlib.ticker import MaxNLocator

from protochain.core.arrays import Floats
from protochain.core.palette import COLOURS, looks
from protochain.results.figures import outside, panels, plain
from protochain.structure import Structure
from protochain.validation.ramachandran import ALLOWED, CLASSES, FAVOURED, ramachandran, tables

_LOG_FROM = 1e4  # kJ/mol. A larger drop, as from a relieved clash, needs a logarithmic axis.
_SMALL = 7.0  # Points of the numbers in cells.
_SAME = 0.1  # kJ/mol above the lowest, lower limit of a logarithmic axis: less is the same minimum.


def plot_energy(
    traces: pd.DataFrame, groups: Mapping[str, Sequence[str]], title: str, ax: Any = None
) -> PlainFigure:
    """Energy against evaluations and against seconds. Runs in torsions and of all atoms have their panels."""
    traces = traces[np.isfinite(traces["energy_kj_mol"])]
    groups = _drawn_groups(traces, groups) if ax is None else {"all runs": [*traces["method"].unique()]}
    _, grid = panels(ax, (max(1, len(groups)), 2), (7, 0.7 + 2.4 * max(1, len(groups))), sharey="row")
    if traces.empty:
        return _set_title(grid, ax, f"{title}: no finite energy")
    styles = _styles(traces["method"].unique())
    for axes, (name, methods) in zip(grid.reshape(len(groups), -1), groups.items(), strict=True):
        runs = traces[traces["method"].isin(methods)]
        best = runs.groupby("method", sort=False)["energy_kj_mol"].cummin()
        finding = _end_lowest(best.groupby(runs["method"], sort=False).min())
        axes[0].set_title(_plain_text(f"{title}, {name}: {finding}"), loc="left")
        logarithmic = best.iloc[0] - best.min() > _LOG_FROM
        if logarithmic:
            best = (best - best.min()).clip(lower=_SAME)
        _draw_runs(axes, runs.assign(shown=best), "shown", styles)
        axes[0].set_ylabel(f"{'energy above the lowest' if logarithmic else 'lowest energy so far'}, kJ/mol")
        axes[0].set_yscale("log" if logarithmic else "linear")
    outside(grid)
    figure: PlainFigure = grid[0].figure
    return figure


def _drawn_groups(traces: pd.DataFrame, groups: Mapping[str, Sequence[str]]) -> dict[str, Sequence[str]]:
    """Groups of methods that have run."""
    return {name: methods for name, methods in groups.items() if traces["method"].isin(methods).any()}


def _end_lowest(energies: pd.Series) -> str:
    """Methods that end lowest, of the lowest energy of each."""
    lowest = [str(name) for name in energies.index[energies <= energies.min() + _SAME]]
    ends = f"{' and '.join(filter(None, (', '.join(lowest[:-1]), lowest[-1])))} end{'s'[len(lowest) > 1 :]}"
    return f"{ends} {'lowest, ' if len(energies) > 1 else ''}at {energies.min():.1f} kJ/mol"


def plot_work_precision(
    traces: pd.DataFrame, work: pd.DataFrame, groups: Mapping[str, Sequence[str]], title: str, ax: Any = None
) -> PlainFigure:
    """Energy above the lowest end against evaluations and against seconds (work-precision diagram)."""
    groups = _drawn_groups(traces, groups)
    n = len(groups)
    _, axes_grid = panels(ax, (n, 2), (7, 0.7 + 2.4 * n), least=2 * n, sharex="col", sharey=True)
    lowest = traces["method"].map(work.set_index("method")["lowest_kj_mol"])
    best = traces.groupby("method", sort=False)["energy_kj_mol"].cummin()
    styles = _styles(traces["method"].unique())
    # Single-precision energies may be below the lowest judged energy.
    traces = traces.assign(above=(best - lowest).clip(lower=_SAME))
    for axes, (name, methods) in zip(axes_grid.reshape(n, 2), groups.items(), strict=True):
        _draw_runs(axes, traces[traces["method"].isin(methods)], "above", styles)
        axes[0].set(ylabel=f"{name}:\nenergy above the lowest end, kJ/mol", yscale="log")
    outside(axes_grid)
    near = work.set_index("method")["evaluations_within_10_kj_mol"].dropna()
    first = f"{near.idxmin()} is the first, after {near.min():.0f} evaluations" if len(near) else "none comes"
    return _set_title(axes_grid, ax, f"{title}: {first}, within 10 kJ/mol of the lowest end")


def plot_torque(traces: pd.DataFrame, title: str, ax: Any = None) -> PlainFigure:
    """Largest torque against evaluations and against seconds."""
    _, axes = panels(ax, 2, (7, 3.1), sharey=True)
    styles = _styles(traces["method"].unique())
    drawn = traces["max_torque_kj_mol_rad"] > 0.0
    free = traces.loc[~drawn, "method"].unique()
    note = f"\nnot recorded while all atoms move: {', '.join(free)}" if len(free) else ""
    traces = traces[drawn]
    if traces.empty:
        return _set_title(axes, ax, f"{title}: no run in torsions")
    _draw_runs(axes, traces, "max_torque_kj_mol_rad", styles)
    axes[0].set(ylabel="largest torque, kJ/mol/rad", yscale="log")
    outside(axes)
    last = traces.groupby("method", sort=False)["max_torque_kj_mol_rad"].last()
    text = f"the largest torque on a hinge falls to {last.min():.3g} kJ/mol/rad ({last.idxmin()})"
    return _set_title(axes, ax, f"{title}: {text}{note}")


def _set_title(axes: Any, ax: Any, title: str) -> PlainFigure:
    """Figure of the Axes, with a title above all panels, or above the first of the user's Axes."""
    figure: PlainFigure = axes[0].figure
    title = _plain_text(title)
    if ax is None:
        wide = int(13 * figure.get_figwidth())
        figure.suptitle("\n".join(fill(line, wide) for line in title.split("\n")))
    else:
        axes[0].set_title(title)
    return figure


Styles = dict[str, dict[str, Any]]


def _styles(methods: Iterable[str]) -> Styles:
    """Colour and line style of each method, the same in every figure of a comparison."""
    return {method: look.line(method) for method, look in looks(methods).items()}


def _draw_runs(axes: Sequence[Axes], traces: pd.DataFrame, value: str, styles: Styles) -> None:
    """Draw a column of the traces against evaluations and against seconds, one line per method."""
    for method, run in traces.groupby("method", sort=False):
        for ax, cost in zip(axes, ("evaluations", "seconds"), strict=False):
            ax.plot(run[cost], run[value], **styles[str(method)])
    for ax, label in zip(axes, ("energy evaluations", "seconds"), strict=False):
        ax.set_xlabel(label)
    for ax in axes:
        ax.set_xscale("log")
        plain(ax)


def plot_rmsd(traces: pd.DataFrame, rmsd: pd.DataFrame, title: str, ax: Any = None) -> PlainFigure:
    """C-alpha RMSD to the start along each run, and between all ends."""
    alone = traces["method"].nunique() == 1
    if alone and ax is None:
        _, axes = panels(None, 1, (5, 2.8))
    else:
        _, axes = panels(ax, 2, (7, 3.1), width_ratios=(1.1, 1))
    left = axes[0]
    styles = _styles(traces["method"].unique())
    for method, run in traces.groupby("method", sort=False):
        left.plot(run["evaluations"], run["ca_rmsd_angstrom"], **styles[str(method)])
    left.set(xscale="log", xlabel="energy evaluations", ylabel="C-alpha RMSD to the start, angstrom")
    outside(axes)
    plain(left)
    if len(axes) > 1:
        _draw_between(axes[1], rmsd)
    ends = traces.groupby("method", sort=False)["ca_rmsd_angstrom"].last()
    far = f"{ends.min():.2f} to {ends.max():.2f}" if len(ends) > 1 else f"{ends.max():.2f}"
    return _set_title(axes, ax, f"{title}: C-alphas move by {far} angstrom (RMSD to the start)")


def _draw_between(right: Axes, rmsd: pd.DataFrame) -> None:
    """Draw a table of RMSDs between ends."""
    values = rmsd.to_numpy()
    image = right.imshow(values, cmap="cividis_r", vmin=0.0)
    ticks = np.arange(len(rmsd))
    right.set_xticks(ticks, list(rmsd.columns), rotation=35.0, ha="right", rotation_mode="anchor")
    right.set_yticks(ticks, list(rmsd.index))
    for (i, j), value in np.ndenumerate(values):
        shade = "white" if value > 0.6 * values.max() else "black"
        text = f"{value:.{2 if len(ticks) < 7 else 1}f}"
        right.text(j, i, text, ha="center", va="center", color=shade, fontsize=_SMALL)
    right.grid(False)
    right.set_title("between ends")
    right.figure.colorbar(image, ax=right, label="C-alpha RMSD, angstrom")


def plot_displacement(displacements: pd.DataFrame, title: str, ax: Any = None) -> PlainFigure:
    """Displacement of each C-alpha from the start."""
    _, axes = panels(ax, 1, (7, 2.8))
    (panel,) = axes
    place = np.arange(1, len(displacements) + 1)
    for method, style in _styles(displacements.columns[3:]).items():
        panel.plot(place, displacements[method], **style)
    chains = displacements["chain"].to_numpy()
    for k in np.flatnonzero(chains[1:] != chains[:-1]):
        panel.axvline(k + 1.5, color="black", linewidth=0.8)
    panel.set_xlabel("residue, in the order of the file")
    panel.set_ylabel("displacement of C-alpha, angstrom")
    panel.set_ylim(bottom=0.0)
    panel.xaxis.set_major_locator(MaxNLocator(integer=True))
    outside(axes)
    plain(panel)
    moved = displacements.iloc[:, 3:].max(axis=1)
    text = f"no C-alpha moves by more than {moved.max():.1f} angstrom from the start (all superposed)"
    return _set_title(axes, ax, f"{title}: {text}")


def plot_differences(changes: Mapping[str, pd.DataFrame], title: str = "", ax: Any = None) -> PlainFigure:
    """Change of torsions and displacement of C-alphas along the sequence."""
    _, axes = panels(ax, (2, 1), (7, 4.2), least=1)
    top, bottom = axes[0], axes[-1]
    styles = _styles(changes)
    for name, table in changes.items():
        place = np.arange(1, len(table) + 1)
        if len(changes) == 1:
            for names, colour, label in ((("phi", "psi"), 0, "phi, psi"), (_CHIS, 1, "side chain")):
                largest = table[list(names)].abs().max(axis=1)
                top.plot(place, largest, ".", ms=4, color=COLOURS[colour], label=f"{label}, largest")
        else:
            top.plot(place, table["torsions_degrees"], **styles[name] | {"linewidth": 1.2})
        if len(axes) > 1:
            bottom.plot(place, table["ca_moved_angstrom"], **styles[name] | {"linewidth": 1.2})
    top.set(ylabel="change of torsions, degrees", ylim=(0, None))
    outside([top])
    if len(axes) > 1:
        bottom.set(ylabel="C-alpha moved, angstrom", ylim=(0, None))
    bottom.set_xlabel("residue")
    first = [change[["chain", "residue"]].to_numpy().T for change in changes.values()][:1]
    places = residue_places(*first[0]) if first else {}
    for panel in axes:
        panel.set_xticks([*places], [*places.values()])
        plain(panel)
    far = max((table["ca_moved_angstrom"].max() for table in changes.values()), default=0.0)
    text = f"{title}: no C-alpha moves by more than {far:.1f} angstrom"
    return _set_title(axes, ax, text if title else "")


_CHIS = ("chi1", "chi2", "chi3", "chi4")
_PLACES = 12  # Number of residues that an axis names, more if there are more chains.


def residue_places(chain: Any, number: Any) -> dict[int, str]:
    """Labels of residues along an axis, by place from 1: the first of each chain, and some between."""
    starts = np.flatnonzero(np.append(True, chain[1:] != chain[:-1])[: len(chain)]).tolist()
    step = 5 * max(1, round(len(chain) / _PLACES / 5))
    between = [k for k in range(step, len(chain), step) if min(abs(k - start) for start in starts) > step / 2]
    labels = {k + 1: f"{chain[k]}:{number[k]}" for k in starts}
    return labels | {k + 1: number[k] for k in between if len(starts) < _PLACES}


def plot_ramachandran(angles: dict[str, Floats], title: str, ax: Any = None) -> PlainFigure:
    """Ramachandran plots of the start and of every end."""
    axes = _panels_of_angles(len(angles), (3.4, 3.3), ax)
    for panel, (name, values) in zip(axes, angles.items(), strict=False):
        ramachandran_ground(panel)
        panel.scatter(values[:, 0], values[:, 1], s=9, color=COLOURS[0])
        panel.set_title(name)
    if ax is None:
        return _set_title(axes, ax, f"{title}: phi and psi")
    figure: PlainFigure = axes[0].figure
    return figure


def _panels_of_angles(n: int, size: tuple[float, float], ax: Any = None) -> Any:
    """Axes of phi and psi for n panels of a size, in rows of three with labels on the outer ones."""
    columns = min(3, n) or 1
    rows = -(-n // columns) or 1
    shape = (rows, columns) if ax is None else n
    _, axes = panels(ax, shape, (size[0] * columns, size[1] * rows), least=n, sharex=True, sharey=True)
    for k, panel in enumerate(axes):
        panel.set_visible(k < n)
        if ax is not None or k + columns >= n:
            panel.set_xlabel("phi, degrees")
            panel.tick_params(labelbottom=True)
        if ax is not None or k % columns == 0:
            panel.set_ylabel("psi, degrees")
    return axes


def plot_ramachandran_classes(ends: Mapping[str, Structure]) -> PlainFigure:
    """Ramachandran plot of each class with residues: the last end in colour, the first as rings."""
    results = {name: ramachandran(end) for name, end in ends.items()}
    last_name, last = list(results.items())[-1]
    kinds = np.unique(np.concatenate([result.kind for result in results.values()])).tolist()
    axes = _panels_of_angles(len(kinds), (3.1, 3.2))
    for panel, kind in zip(axes, kinds, strict=False):
        ramachandran_ground(panel, kind)
        for name, result in results.items():
            of_kind = result.kind == kind
            phi, psi, is_outlier = (v[of_kind] for v in (result.phi, result.psi, result.region == 0))
            if result is not last:
                panel.scatter(phi, psi, s=16, facecolors="none", edgecolors="#666666", lw=0.6, label=name)
                continue
            panel.scatter(phi[~is_outlier], psi[~is_outlier], s=9, color=COLOURS[0], label=name)
            panel.scatter(phi[is_outlier], psi[is_outlier], s=24, marker="D", color=COLOURS[1])
            for r, x, y in zip(result.residue[of_kind][is_outlier].tolist(), phi[is_outlier], psi[is_outlier],
                               strict=True):  # fmt: skip
                side = "right" if x > 0.0 else "left"
                text = f" {ends[name].residue(r)} "
                panel.text(x, y, text, fontsize=8, ha=side, va="bottom" if y < 0.0 else "top")
        panel.set_title(f"{CLASSES[kind].replace('_', ' ')}: {int((last.kind == kind).sum())}")
    counts = " to ".join(str(len(result.outliers)) for result in results.values())
    favoured = f"{last.favoured_percent:.1f} % favoured, " if len(last.kind) else ""
    rings = f"; rings: {next(iter(results))}" if len(results) > 1 else ""
    return _set_title(axes, None, f"{last_name}: {favoured}outliers {counts}{rings}")


def ramachandran_ground(panel: Axes, kind: int = 0) -> None:
    """Draw the favoured (dark grey) and allowed (light grey) regions of a class, axes in degrees."""
    favoured = tables()[kind].T
    grid = np.linspace(-179.0, 179.0, len(favoured))
    panel.contourf(grid, grid, favoured, levels=[ALLOWED[kind], FAVOURED, 1.0], colors=["#dddddd", "#aaaaaa"])
    ticks = range(-180, 181, 90)
    panel.set(xlim=(-180, 180), ylim=(-180, 180), xticks=ticks, yticks=ticks)
    panel.set_box_aspect(1.0)


def _plain_text(text: str) -> str:
    """Escape dollar signs, which matplotlib reads as mathematics."""
    return text.replace("$", r"\$")
