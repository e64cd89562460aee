"""Page and picture of the scenes: what each leaves out, what that saves, and the proof."""

from pathlib import Path

import numpy as np
import pandas as pd

from protochain.analysis.plots import COLOURS, Figure
from protochain.analysis.studies.made import made
from protochain.analysis.studies.scenes.cells import COUNTS
from protochain.analysis.studies.scenes.features import ALLOWED
from protochain.analysis.viewer import template
from protochain.storage import write_atomically

WRONG = "#cc0000"


def plot(table: pd.DataFrame) -> Figure:
    """Ratio of each scene's times, those that are wrong in red."""
    table = table[np.isfinite(table["ratio"])]
    several = table["structure"].nunique() > 1
    names = [
        str(row["scene"]) + (f" ({row['structure']})" if several else "") + f": {row['against']}"
        for row in table.to_dict("records")
    ]
    figure = Figure(figsize=(8, 0.9 + 0.27 * len(table)), layout="constrained")
    ax, places = figure.subplots(), np.arange(len(table))
    colours = [COLOURS[0] if verdict == "right" else WRONG for verdict in table["verdict"]]
    ax.barh(places, table["ratio"], color=colours, height=0.65)
    for place, ratio in enumerate(table["ratio"]):
        ax.text(ratio, place, f" {ratio:.3g}x", va="center", fontsize=8)
    ax.set_yticks(places, names, fontsize=8)
    ax.invert_yaxis()
    ax.set_xscale("log")
    ax.axvline(1.0, color="grey", linewidth=0.8)
    ax.set_xlim(0.8, 1.6 * max([1.0, *table["ratio"]]))
    ax.set_xlabel("times as long with what stands behind the colon; the answers are the same")
    return figure


def write_page(scenes: pd.DataFrame, features: pd.DataFrame, path: Path) -> None:
    """Write the page, with all text escaped."""
    text = template("scenes.html").render(
        scenes=scenes.to_dict("records"), features=features.to_dict("records"), counts=COUNTS,
        allowed=ALLOWED, made=made("1"),
    )  # fmt: skip
    write_atomically(path, lambda to: to.write_text(text, encoding="utf-8"))
