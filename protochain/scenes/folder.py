"""Folder of a scene: its tables as CSV, its picture, and where they come from."""

from collections.abc import Mapping
from functools import partial
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from protochain.scenes.scene import Scene
from protochain.storage import json_text, write_atomically

if TYPE_CHECKING:
    from protochain.analysis.plots import Figure

_MARKERS = "osD^vPX*<>"
_LEAST = 1e-17
"""Where an error of nothing is drawn, on a logarithmic axis."""


def plot_work(scene: Scene) -> "Figure":
    """Draw error against seconds, a line for each method.

    Parameters
    ----------
    scene : Scene
        With its table ``work``.

    Returns
    -------
    matplotlib.figure.Figure
        Both axes are logarithmic; settings without a finite error are left out, and errors of nothing are
        drawn at 1e-17.
    """
    # Here, since it brings what proteins need.
    from protochain.analysis.plots import COLOURS, Figure, plain

    figure = Figure(figsize=(7, 4.5), layout="constrained")
    ax = figure.subplots()
    styles = zip(cycle(COLOURS), cycle(_MARKERS), strict=False)
    for (method, points), (colour, marker) in zip(
        scene.work.groupby("method", sort=False), styles, strict=False
    ):
        shown = points[np.isfinite(points["error"]) & (points["seconds"] > 0)]
        error = shown["error"].clip(lower=_LEAST)
        ax.plot(shown["seconds"], error, color=colour, marker=marker, markersize=4, label=str(method))
    ax.set(xscale="log", yscale="log", xlabel="processor seconds", ylabel=scene.error_of, title=scene.title)
    if len(scene.work):
        ax.legend(frameon=False, fontsize=8)
    plain(ax)
    return figure


def write(scene: Scene, folder: Path) -> dict[str, str]:
    """Write the tables of a scene, ``work.png`` and ``made.json`` to a folder.

    Parameters
    ----------
    scene : Scene
    folder : Path
        Made if it is not there.

    Returns
    -------
    dict of str to str
        Machine, threads, versions and commit.
    """
    from protochain.analysis.studies.made import made

    for name, table in scene.frames().items():
        write_atomically(folder / f"{name}.csv", partial(table.to_csv, index=False))
    write_atomically(folder / "work.png", partial(plot_work(scene).savefig, dpi=110))
    record = made("1", ("numpy", "scipy", "numba"))
    text = json_text(record)
    write_atomically(folder / "made.json", lambda to: to.write_text(text, encoding="utf-8"))
    return record


def summary(scene: Scene, made: Mapping[str, str]) -> dict[str, Any]:
    """What a scene has found as plain values for JSON, without its own tables."""
    frames = scene.frames()
    found = {name: frames[name].to_dict("records") for name in ("checks", "work", "extremes", "left_out")}
    head = {"scene": scene.name, "title": scene.title, "wrong": list(scene.wrong)}
    return {**head, **found, "error_of": scene.error_of, "made": dict(made)}
