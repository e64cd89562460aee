"""One self-contained page from a comparison."""

import base64
import io
import shlex
from typing import TYPE_CHECKING, Any

from matplotlib.figure import Figure

from protochain.analysis.viewer import scene, template

if TYPE_CHECKING:
    from protochain.analysis.comparison import Comparison


def render(comparison: "Comparison", summary: dict[str, Any], figures: dict[str, Figure]) -> str:
    """Render ``report.html``: verdicts, tables, plots, repairs and provenance in one offline file.

    Parameters
    ----------
    comparison : Comparison
    summary : dict
        ``Comparison.summary()``; every number on the page is also in it or in the CSV files.
    figures : dict of str to matplotlib.figure.Figure

    Returns
    -------
    str
        HTML. Names from files are escaped.
    """
    from protochain.analysis.comparison import SHOWN

    return template("report.html").render(
        structure=comparison.structure,
        solutions=comparison.solutions,
        shown=SHOWN,
        rows=comparison.table.to_dict("records"),
        rmsd=comparison.rmsd,
        quality=comparison.quality,
        progress=comparison.progress,
        figures={name: _data_url(figure) for name, figure in figures.items()},
        summary=summary,
        **scene(comparison),
        command=shlex.join(summary["command"]),
    )


def _data_url(figure: Figure) -> str:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=150)
    return "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode()
