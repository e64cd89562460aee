"""Figures: their colours and axes, and their embedding in pages."""

import base64
import io
from collections.abc import Callable
from functools import partial
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as PlainFigure
from matplotlib.ticker import LogLocator, NullFormatter

from protochain.core.errors import Argument, ProtochainError
from protochain.core.figure import Figure as Figure
from protochain.core.storage import write_atomically

FORMATS = (".svg", ".pdf", ".png")
"""Formats of figures for papers."""


def plain(ax: Axes) -> None:
    """Show only the left and bottom axes, with a faint grid."""
    ax.spines[["top", "right"]].set_visible(False)
    if ax.get_xscale() == "log":
        low, high = sorted(ax.get_xlim())
        few = high < 100.0 * low  # Powers of ten alone would be one tick, or none.
        subs = (1.0, 2.0, 5.0) if few else (1.0,)
        ax.xaxis.set(major_locator=LogLocator(subs=subs), minor_formatter=NullFormatter())
        if few:
            ax.xaxis.set_major_formatter("{x:g}")
    ax.grid(True, which="major", alpha=0.25)


def panels(
    ax: Any, shape: int | tuple[int, int], size: tuple[float, float], least: int = 1, **options: Any
) -> tuple[PlainFigure, Any]:
    """Figure and Axes (n,) to draw in: new Axes, or the user's, at least ``least`` of them."""
    rows, columns = (1, shape) if isinstance(shape, int) else shape
    if ax is None:
        figure = Figure(figsize=size, layout="constrained")
        return figure, figure.subplots(rows, columns, squeeze=False, **options).ravel()
    axes = np.array([ax] if isinstance(ax, Axes) else ax, dtype=object).ravel()
    n = rows * columns
    if len(axes) not in {min(least, n), n} or not all(isinstance(axis, Axes) for axis in axes):
        number = f"{n}" if least >= n else f"{least} or {n}"
        raise ProtochainError(f"ax: give {number} Axes of matplotlib, as plt.subplots makes them")
    return axes[0].figure, axes


def data_url(figure: PlainFigure) -> str:
    """Figure as a data URL for a page."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=150, transparent=True)
    return "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode()


def check_figure(path: Path | None) -> None:
    """Raise an error for a file name without a format of figures, before any work is done."""
    if path is not None and path.suffix.lower() not in FORMATS:
        raise ProtochainError(Argument("figure"), f" {path}: give a name that ends in {', '.join(FORMATS)}")


def write_figure(path: Path, draw: Callable[[], PlainFigure]) -> None:
    """Write a figure for a paper in the package's style, in the format of its file name."""
    import matplotlib.style

    kind = path.suffix.lower().removeprefix(".")
    metadata = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}.get(kind)
    with (
        as_file(files("protochain.results") / "static" / "paper.mplstyle") as style,
        matplotlib.style.context(str(style)),
    ):
        write_atomically(path, partial(draw().savefig, format=kind, metadata=metadata))
