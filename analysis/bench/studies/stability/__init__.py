"""Is it right where it is hard: a grid of stiff and extreme cases, each right, refused or wrong.

Each row of the grid is a module with a table ``CASES``; :mod:`.cells` runs and judges them. Beside the grid,
error and run time of M^-1 tau (:mod:`.solvers`).
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

import pandas as pd

from bench.studies.stability.cells import ROWS, Part, cases_of, ordered, run_cells
from bench.studies.stability.page import counts, picture, rendered
from bench.studies.stability.solvers import write_solvers
from protochain.core.errors import ProtochainError
from protochain.core.processors import processors
from protochain.results.tables import save


def run(
    output: Path,
    inputs: Sequence[Path] = (),
    quick: bool = False,
    rows: Sequence[str] = ROWS,
    threads: int = 2,
    workers: int | None = None,
) -> Iterator[pd.DataFrame]:
    """Run the grid; write ``cells.csv``, ``grid.png`` and ``report.html``, and of all of it solvers' errors.

    Parameters
    ----------
    output : Path
        Folder.
    inputs : sequence of Path
        Must be empty: the cases are made here.
    quick : bool
        Only cases of some seconds: two minutes on 2 cores.
    rows : sequence of str
        Rows of the grid.
    threads : int
        What has threads is computed on one and on so many, and must be the same.
    workers : int, optional
        Processes; as many as there are processors for, by default.

    Yields
    ------
    pandas.DataFrame
        Counts of verdicts by row; the cells that are wrong, or ``wrong`` in the column ``verdict`` of none;
        and the times and errors of the solvers.

    Raises
    ------
    ProtochainError
        If files are given or a row is not known.
    """
    if inputs:
        raise ProtochainError("stability: makes its own cases; give no files")
    if threads < 1 or (workers is not None and workers < 1):
        raise ProtochainError("stability: give at least 1 thread and 1 worker")
    counted = tuple(dict.fromkeys((1, threads)))
    part = Part.QUICK if quick else Part.FULL
    for row in rows:
        cases_of(row, part)
    table = ordered(run_cells(rows, part, counted, workers or processors()))
    save(output, {"cells.csv": table, "grid.png": picture(table), "report.html": rendered(table, counted)})
    yield counts(table)
    yield table.loc[
        table["verdict"] == "wrong", ["row", "case", "parameters", "verdict", "error", "bound", "message"]
    ]
    if not quick and "mechanics" in rows:
        yield from write_solvers(output)
