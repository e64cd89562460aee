"""Figures that notebooks show."""

import io
from pathlib import Path

import matplotlib
from matplotlib.figure import Figure as PlainFigure

if Path("matplotlibrc").exists():
    # What matplotlib has read of the folder of somebody's structures, as to run LaTeX, is not wanted.
    matplotlib.rcdefaults()


class Figure(PlainFigure):
    """Figure that notebooks show without pyplot, which would store every figure in memory."""

    def _repr_png_(self) -> bytes:
        buffer = io.BytesIO()
        self.savefig(buffer, format="png", dpi=100)
        return buffer.getvalue()
