"""Files of a comparison: tables, plots, structures, and one self-contained page."""

import base64
import io
import json
import shlex
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from matplotlib.figure import Figure

from protochain.analysis.folder import clear
from protochain.analysis.viewer import scene, template
from protochain.core.errors import Argument, WriteError
from protochain.core.storage import write_atomically, write_text
from protochain.minimisers.record import SHOWN
from protochain.structure import save
from protochain.structure.losses import told

if TYPE_CHECKING:
    from pandas import DataFrame

    from protochain.analysis.comparison import Comparison


def write_report(comparison: "Comparison", directory: Path) -> Path:
    """Write the files of :meth:`Comparison.report`; return the path of the page."""
    try:
        clear(directory)
        return _write_files(comparison, directory)
    except WriteError as error:
        there = ", ".join(sorted(path.name for path in directory.glob("*") if not path.name.startswith(".")))
        raise error.with_saved(
            f"{directory}: {there}" if there else "nothing",
            "free space there, and run again with ",
            Argument("force", True),
        ) from error


def _write_files(comparison: "Comparison", directory: Path) -> Path:
    name, suffix, summary = comparison.structure.name, comparison.suffix, comparison.summary()
    tables = {
        "summary": comparison.table,
        "equal_cost": _with_unit(comparison.equal_cost, 2, "kj_mol"),
        "work": comparison.work,
        "spread": comparison.spread,
        "displacement": _with_unit(comparison.displacements, 3, "angstrom"),
        "traces": comparison.traces,
    }
    # First, since it names the structures: what an incomplete comparison left can be replaced, too.
    write_text(directory / "summary.json", json.dumps(summary, indent=2, allow_nan=False))
    for stem, table in tables.items():
        write_text(directory / f"{stem}.csv", table.to_csv(index=False))
    write_text(directory / "quality.csv", comparison.quality.to_csv())
    save(comparison.structure, directory / f"{name}.start{suffix}")
    for solution in comparison.solutions:
        file = comparison.file_of(solution)
        if file:
            solution.save(directory / file)
    figures = _figures(comparison)
    for stem, figure in figures.items():
        write_atomically(directory / f"{stem}.png", partial(figure.savefig, dpi=150))
    write_text(directory / "report.html", render(comparison, summary, figures))
    return directory / "report.html"


def write_page(comparison: "Comparison", path: Path) -> None:
    """Write the page alone, for a run by itself.

    Parameters
    ----------
    comparison : Comparison
        Of one method or several.
    path : Path
        HTML file.
    """
    write_text(path, render(comparison, comparison.summary(), _figures(comparison)))


def _figures(comparison: "Comparison") -> dict[str, Figure]:
    return {
        "energy": comparison.plot_energy(),
        "work_precision": comparison.plot_work_precision(),
        "torque": comparison.plot_torque(),
        "rmsd": comparison.plot_rmsd(),
        "displacement": comparison.plot_displacement(),
        "ramachandran": comparison.plot_ramachandran(),
    }


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
    of_one = len(comparison.solutions) == 1
    method = comparison.solutions[0].method if of_one else ""
    return template("report.html").render(
        title=f"{comparison.structure.name}{f' by {method}' if of_one else ': comparison of minimisers'}",
        structure=comparison.structure,
        solutions=comparison.solutions,
        message=comparison.message,
        shown=SHOWN,
        rows=comparison.table.to_dict("records"),
        lost=told(summary["results"]),
        rmsd=comparison.rmsd,
        quality=comparison.quality,
        equal_cost=comparison.equal_cost,
        work=comparison.work,
        spread=comparison.spread,
        figures={name: data_url(figure) for name, figure in figures.items()},
        summary=summary,
        **scene(comparison.ends()),
        command=shlex.join(summary["command"]),
    )


def _with_unit(table: "DataFrame", first: int, unit: str) -> "DataFrame":
    """Table whose columns of methods, from this one on, have the unit in their names."""
    return table.rename(columns={name: f"{name}_{unit}" for name in table.columns[first:]})


def data_url(figure: Figure) -> str:
    """Figure as a data URL for a page."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=150)
    return "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode()
