"""Is it right where it is hard: a grid of stiff and extreme cases, each right, refused or wrong.

Each row of the grid is a module with a table ``CASES``; :mod:`.cells` runs and judges them. Beside the grid,
error and run time of M^-1 tau (:mod:`.solvers`).
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

import pandas as pd

from bench.page import Section, write_report
from bench.provenance import made
from bench.studies.stability.cells import ROWS, Part, cases_of, ordered, run_cells
from bench.studies.stability.page import counts, picture
from bench.studies.stability.solvers import write_solvers
from protochain.core.errors import ProtochainError
from protochain.core.processors import processors
from protochain.results.tables import save

READING = (
    "Right: the error is within what theory allows. Refused: with one line that says why, where no answer is "
    "expected. Wrong: anything else."
)


def run(
    output: Path,
    inputs: Sequence[Path] = (),
    quick: bool = False,
    rows: Sequence[str] = ROWS,
    threads: int = 2,
    workers: int | None = None,
) -> Iterator[pd.DataFrame]:
    """Run the grid; write ``cells.csv``, ``grid.png`` and ``report.html``, and solvers' errors."""
    if inputs:
        raise ProtochainError("stability: makes its own cases; give no files")
    if threads < 1 or (workers is not None and workers < 1):
        raise ProtochainError("stability: give at least 1 thread and 1 worker")
    counted = tuple(dict.fromkeys((1, threads)))
    part = Part.QUICK if quick else Part.FULL
    for row in rows:
        cases_of(row, part)
    table = ordered(run_cells(rows, part, counted, workers or processors()))
    save(output, {"cells.csv": table, "grid.png": picture(table)})
    parts = [
        Section("Cells by row", {"rows": counts(table)}, (READING,), "grid.png"),
        *(Section(str(row), {"cells": own}) for row, own in table.groupby("row", sort=False)),
    ]
    by_threads = f"{', '.join(map(str, counted))}, which must agree"
    write_report(output, "Stiff and extreme cases", parts, made(by_threads))
    yield counts(table)
    yield table.loc[
        table["verdict"] == "wrong", ["row", "case", "parameters", "verdict", "error", "bound", "message"]
    ]
    if not quick and "mechanics" in rows:
        yield from write_solvers(output)
