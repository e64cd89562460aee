"""Figures that notebooks show."""

import io

from matplotlib.figure import Figure as PlainFigure


class Figure(PlainFigure):
    """Figure that notebooks show without pyplot, which would keep every figure in memory."""

    def _repr_png_(self) -> bytes:
        buffer = io.BytesIO()
        self.savefig(buffer, format="png", dpi=100)
        return buffer.getvalue()
