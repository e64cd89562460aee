"""What is written and drawn: tables, pictures and pages in a folder; error against cost."""

import io
from collections.abc import Iterable, Mapping
from dataclasses import asdict, fields
from functools import partial
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure as PlainFigure

from protochain.core.storage import write_atomically

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""Okabe and Ito's palette, dark colours first."""
DASHES = ("-", "--", "-.", ":")
_MARKERS = "osD^vPX*<>"


class Figure(PlainFigure):
    """Figure that notebooks show without pyplot, which would keep every figure in memory."""

    def _repr_png_(self) -> bytes:
        buffer = io.BytesIO()
        self.savefig(buffer, format="png", dpi=100)
        return buffer.getvalue()


def plain(ax: Axes) -> None:
    """Keep the left and bottom axes only, with a faint grid."""
    ax.spines[["top", "right"]].set_visible(False)
    ax.grid(True, which="major", alpha=0.25)


Work = tuple[str, str, float, float]
"""Point of error against run time: method (a line of the picture), setting, processor seconds, error."""


def work_table(rows: Iterable[Work]) -> pd.DataFrame:
    """Points of error against run time as the table of a scene."""
    return pd.DataFrame(list(rows), columns=["method", "setting", "seconds", "error"])


def draw_lines(
    ax: Axes, points: pd.DataFrame, x: str, y: str = "error", by: str = "method", least: float = 0.0
) -> None:
    """Draw a line with marks for each method, both axes logarithmic.

    Parameters
    ----------
    ax : matplotlib Axes
        Where to draw.
    points : pandas.DataFrame
        Points of all methods.
    x, y, by : str
        Columns: cost, value, and method.
    least : float
        Where smaller values are drawn. Those that are not finite are left out, and so is what costs nothing.
    """
    styles = zip(cycle(COLOURS), cycle(_MARKERS), strict=False)
    for (method, own), (colour, marker) in zip(points.groupby(by, sort=False), styles, strict=False):
        shown = own[np.isfinite(own[y]) & (own[x] > 0)]
        value = shown[y].clip(lower=least)
        ax.plot(shown[x], value, color=colour, marker=marker, markersize=4, label=str(method))
    ax.set(xscale="log", yscale="log", xlabel=x)
    if len(points):
        ax.legend(frameon=False, fontsize=8)
    plain(ax)


def table_of(rows: Iterable[Any], kind: type) -> pd.DataFrame:
    """Rows, values of a dataclass, as a table: with its columns even of none."""
    return pd.DataFrame([asdict(row) for row in rows], columns=[field.name for field in fields(kind)])


def save(folder: Path, files: Mapping[str, pd.DataFrame | PlainFigure | str]) -> None:
    """Write tables as CSV, figures, and text to a folder, each by the name of its file."""
    for name, what in files.items():
        write_atomically(folder / name, partial(_write, what))


def _write(what: pd.DataFrame | PlainFigure | str, to: Path) -> None:
    if isinstance(what, pd.DataFrame):
        what.to_csv(to, index=False)
    elif isinstance(what, PlainFigure):
        what.savefig(to, dpi=120)
    else:
        to.write_text(what, encoding="utf-8")
