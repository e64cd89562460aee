"""Lines of error against cost."""

from itertools import cycle

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from protochain.results.figures import COLOURS, plain

MARKERS = "osD^vPX*<>"


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
    styles = zip(cycle(COLOURS), cycle(MARKERS), strict=False)
    for (method, own), (colour, marker) in zip(points.groupby(by, sort=False), styles, strict=False):
        shown = own[np.isfinite(own[y]) & (own[x] > 0)]
        value = shown[y].clip(lower=least)
        ax.plot(shown[x], value, color=colour, marker=marker, markersize=4, label=str(method))
    ax.set(xscale="log", yscale="log", xlabel=x)
    if len(points):
        ax.legend(frameon=False, fontsize=8)
    plain(ax)
