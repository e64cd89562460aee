"""Page of a run over frames: their statuses, and the quantities that differ between frames."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from protochain.batches.frame_files import FramesRun
from protochain.core.palette import looks
from protochain.results.columns import heading
from protochain.results.figures import data_url, outside, panels, plain
from protochain.results.page import table_data, write_page
from protochain.results.provenance import of_run

_FIRST = ("energy", "violations", "ca_rmsd", "rmsd", "clashscore", "total")
"""Beginnings of the names of the quantities that are drawn first."""
_NO_QUANTITIES = ("frame", "time_ps", "output_frame")
_MOST_FIGURES = 12
_MAIN = "violations", "clashscore_per_1000_atoms", "ca_rmsd_angstrom", "energy_kj_mol"
"""Measures in the header."""
_WORST = ("violations_end", "violations", "ca_rmsd_angstrom")  # Measures of damage, the best first.


def write_report(run: FramesRun, name: str, source: str, path: Path) -> None:
    """Write the page of a run, one file that works offline."""
    table = run.table
    usable = table[_usable(table)]
    numbers = usable.drop(columns=[*_NO_QUANTITIES], errors="ignore").select_dtypes("number")
    varying = numbers.loc[:, numbers.nunique() > 1]
    figure = _along(usable["frame"], varying)
    rows, by = _worst_first(table)
    columns = ["frame", "status", *varying, "message"]
    first = ["frame", "status", *sorted(map(str, varying), key=lambda name: not name.startswith(_FIRST))[:7]]
    write_page(
        path,
        "frames.html",
        name=name,
        source=source,
        total=len(table),
        table=run.csv.name,
        counts=pd.DataFrame([{"frames": len(table), **run.counts}]),
        figure=figure and data_url(figure),
        medians=_medians(usable),
        data=table_data(rows[columns], [*first, "message"] if rows["message"].notna().any() else first),
        worst_by=heading(by),
        run=of_run("openmm", "gemmi", "numpy", "scipy", "numba", "MDAnalysis", "pandas"),
    )


def _medians(table: pd.DataFrame) -> list[tuple[str, str]]:
    """Labels and medians of the main measures of a table, of the start and of the end."""
    numbers = table.select_dtypes("number")
    columns_of = _by_quantity(numbers.loc[:, numbers.notna().any()])
    return [
        (f"median {heading(name)}", _arrow(table, columns_of[name])) for name in _MAIN if name in columns_of
    ]


def _arrow(table: pd.DataFrame, columns: Mapping[str, str]) -> str:
    """Medians of the columns of a quantity, from its start to its end."""
    return " → ".join(f"{table[column].median():.4g}" for column in columns.values())


def _by_quantity(names: Iterable[Any]) -> dict[str, dict[str, str]]:
    """Columns by quantity and stage, start or end."""
    columns_of: dict[str, dict[str, str]] = {}
    for name in map(str, names):
        stage = next((stage for stage in ("start", "end_reference", "end") if f"_{stage}" in name), "")
        quantity = name.replace(f"_{stage}", "") if stage else name
        columns_of.setdefault(quantity, {})[stage.split("_")[0]] = name
    return columns_of


def _worst_first(table: pd.DataFrame) -> tuple[pd.DataFrame, str]:
    """Sort rows: without a result, not converged, converged, and in each the most damaged first."""
    by = next((name for name in _WORST if name in table and table[name].notna().any()), "frame")
    severity = np.select([~_usable(table), table["status"] != "converged"], [0, 1], 2)
    order = -table[by].astype(float) if by != "frame" else table[by]
    return table.assign(_bad=severity, _far=order).sort_values(["_bad", "_far"], kind="stable")[[*table]], by


def _usable(table: pd.DataFrame) -> pd.Series:
    return ~table["status"].isin(["refused", "killed", "error", "time-limit"])


def _along(frame: pd.Series, numbers: pd.DataFrame) -> Figure | None:
    """Curves against the frame. Start and end of a quantity share a panel."""
    pairs = _by_quantity(numbers)
    quantities = sorted(pairs, key=lambda name: not name.startswith(_FIRST))[:_MOST_FIGURES]
    if not quantities or len(frame) < 2:
        return None
    rows = -(-len(quantities) // 2)
    figure, axes = panels(None, (rows, 2), (7, 1.7 * rows), sharex=True)
    for ax, name in zip(axes, quantities, strict=False):
        for (stage, column), look in zip(pairs[name].items(), looks(pairs[name]).values(), strict=True):
            ax.plot(frame, numbers[column], **look.line(stage) | {"linewidth": 1.2})
        ax.set_title(heading(name))
        plain(ax)
    for k, ax in enumerate(axes):
        ax.set_visible(k < len(quantities))
        if k + 2 >= len(quantities):
            ax.set_xlabel("frame")
            ax.tick_params(labelbottom=True)
    medians = _arrow(numbers, pairs[quantities[0]])
    figure.suptitle(f"{len(frame)} frames, median {heading(quantities[0])}: {medians}")
    if any(len(stages) > 1 for stages in pairs.values()):
        outside(axes[: len(quantities)])
    return figure
