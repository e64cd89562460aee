"""Figures: their colours and axes, and how a page holds them."""

import base64
import io
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as PlainFigure

from protochain.core.errors import ProtochainError
from protochain.core.figure import Figure as Figure

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""Okabe and Ito's palette, dark colours first."""
DASHES = ("-", "--", "-.", ":")


def plain(ax: Axes) -> None:
    """Keep the left and bottom axes only, with a faint grid."""
    ax.spines[["top", "right"]].set_visible(False)
    ax.grid(True, which="major", alpha=0.25)


def panels(
    ax: Any, shape: int | tuple[int, int], size: tuple[float, float], least: int = 1, **options: Any
) -> tuple[PlainFigure, Any]:
    """Figure and Axes (n,) to draw in: new ones, or those given, which may be fewer if the plot allows it."""
    rows, columns = (1, shape) if isinstance(shape, int) else shape
    if ax is None:
        figure = Figure(figsize=size, layout="constrained")
        return figure, figure.subplots(rows, columns, squeeze=False, **options).ravel()
    axes = np.array([ax] if isinstance(ax, Axes) else ax, dtype=object).ravel()
    n = rows * columns
    if len(axes) not in {min(least, n), n} or not all(isinstance(each, Axes) for each in axes):
        number = f"{n}" if least >= n else f"{least} or {n}"
        raise ProtochainError(f"ax: give {number} Axes of matplotlib, as plt.subplots makes them")
    return axes[0].figure, axes


def data_url(figure: PlainFigure) -> str:
    """Figure as a data URL for a page."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=150)
    return "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode()
