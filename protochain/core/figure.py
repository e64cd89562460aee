"""One style of all figures: 8 points, the palette's colours, open axes, text that follows a dark page."""

import io
from pathlib import Path
from typing import Any

import matplotlib
from cycler import cycler
from matplotlib.figure import Figure as PlainFigure

from protochain.core.palette import COLOURS

if Path("matplotlibrc").exists():
    # What matplotlib has read of the folder of somebody's structures, as to run LaTeX, is not wanted.
    matplotlib.rcdefaults()

INK, LIGHT_INK = "#262626", "#d6d6d6"
"""Colours of text and axes on a light and on a dark page."""
STYLE: Any = {
    "font.family": "sans-serif", "font.size": 8.0, "axes.titlesize": 8.0, "figure.titlesize": 8.0,
    "axes.labelsize": 8.0, "xtick.labelsize": 8.0, "ytick.labelsize": 8.0, "legend.fontsize": 8.0,
    "legend.title_fontsize": 8.0, "legend.frameon": False, "lines.linewidth": 1.5, "lines.markersize": 4.0,
    "axes.prop_cycle": cycler(color=COLOURS), "axes.spines.top": False, "axes.spines.right": False,
    "axes.grid": True, "axes.axisbelow": True, "grid.color": INK, "grid.alpha": 0.15, "axes.linewidth": 0.6,
    "grid.linewidth": 0.6, "xtick.major.width": 0.6, "ytick.major.width": 0.6, "axes.facecolor": "none",
    "figure.facecolor": "white", "savefig.dpi": 300, "pdf.fonttype": 42, "svg.fonttype": "none",
    "svg.hashsalt": "protochain",
    **dict.fromkeys(("text.color", "axes.edgecolor", "axes.labelcolor", "xtick.color", "ytick.color"), INK),
}  # fmt: skip
_DARK = "".join(f'[style*="{of}: {INK}"] {{ {of}: {LIGHT_INK} !important }} ' for of in ("fill", "stroke"))
_DATES = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}


def style() -> Any:
    """Context in which text and lines are drawn in the style. It is also a decorator."""
    return matplotlib.rc_context(STYLE)


class Figure(PlainFigure):
    """Figure in the style, which notebooks show without pyplot, which would store every figure in memory."""

    @style()
    def draw(self, renderer: Any) -> None:
        """Draw with titles and ticks of the style, which matplotlib sets and makes late."""
        for ax in self.axes:
            for place in ("left", "center"):
                ax.set_title(ax.get_title(place), loc=place)
        super().draw(renderer)

    def _repr_png_(self) -> bytes:
        return image(self, "png", dpi=100)


for _name in ("__init__", "add_subplot", "subplots", "subplot_mosaic", "suptitle", "colorbar"):
    setattr(Figure, _name, style()(getattr(PlainFigure, _name)))


def image(figure: PlainFigure, kind: str, **options: Any) -> bytes:
    """Bytes of a figure as SVG, PDF or PNG. An SVG has no ground, and its text is light on a dark page."""
    buffer = io.BytesIO()
    with style():
        figure.savefig(
            buffer, format=kind, metadata=_DATES.get(kind), **{"transparent": kind == "svg"} | options
        )
    content = buffer.getvalue()
    if kind == "svg":
        rule = f"<style>@media (prefers-color-scheme: dark) {{ {_DARK}}}</style>"
        content = content.replace(b"<defs>", f"{rule}\n <defs>".encode(), 1)
    return content
