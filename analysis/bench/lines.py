"""Lines of error against cost."""

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from protochain.core.palette import looks
from protochain.results.figures import plain

__all__ = ["draw_lines"]


def draw_lines(
    ax: Axes, points: pd.DataFrame, x: str, y: str = "error", by: str = "method", least: float = 0.0
) -> None:
    """Draw a line with marks for each method, both axes logarithmic, without a legend.

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
    styles = looks(points[by].astype(str).unique())
    for method, own in points.groupby(by, sort=False):
        shown = own[np.isfinite(own[y]) & (own[x] > 0)]
        look = styles[str(method)].line(str(method)) | {"markevery": None}
        ax.plot(shown[x], shown[y].clip(lower=least), **look)
    ax.set(xscale="log", yscale="log", xlabel=x)
    plain(ax)
