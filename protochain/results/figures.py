"""Figures: their colours and axes, and their embedding in pages."""

import base64
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as PlainFigure
from matplotlib.ticker import LogLocator, NullFormatter

from protochain.core.errors import Argument, ProtochainError
from protochain.core.figure import Figure as Figure
from protochain.core.figure import image, style
from protochain.core.storage import write_atomically

FORMATS = (".svg", ".pdf", ".png")
"""Formats of figures for papers."""
_LARGE = 150_000  # Bytes of an SVG beyond which a page has a PNG.


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


def outside(axes: Iterable[Axes], title: str = "") -> None:
    """Put one legend off the data: of one panel to its right, of several below them."""
    axes = list(axes)
    keys = {label: line for ax in axes for line, label in zip(*ax.get_legend_handles_labels(), strict=True)}
    figure: Any = axes[0].figure
    root: Any = axes[0].get_figure(root=True)
    if not isinstance(root, Figure) or not keys:
        options: dict[str, Any] = {}
    elif len(axes) == 1:
        options = {"loc": "center left", "bbox_to_anchor": (1.0, 0.5)}
    else:
        fit = int(root.get_figwidth() / (0.6 + 0.065 * max(map(len, keys))))
        options = {"loc": "outside lower center", "ncols": max(1, min(fit, len(keys)))}
    if keys:
        with style():
            (figure if "ncols" in options else axes[0]).legend(keys.values(), keys, title=title, **options)


def data_url(figure: PlainFigure) -> str:
    """Figure as a data URL for a page: an SVG, or a PNG if the SVG would be large."""
    content, kind = image(figure, "svg"), "svg+xml"
    if len(content) > _LARGE:
        content, kind = image(figure, "png", dpi=120, transparent=True), "png"
    return f"data:image/{kind};base64," + base64.b64encode(content).decode()


def check_figure(path: Path | None) -> None:
    """Raise an error for a file name without a format of figures, before any work is done."""
    if path is not None and path.suffix.lower() not in FORMATS:
        raise ProtochainError(Argument("figure"), f" {path}: give a name that ends in {', '.join(FORMATS)}")


def write_figure(path: Path, draw: Callable[[], PlainFigure]) -> None:
    """Write a figure for a paper, in the format of its file name."""
    content = image(draw(), path.suffix.lower().removeprefix("."))
    write_atomically(path, lambda to: to.write_bytes(content))
