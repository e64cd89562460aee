"""Page of the grid: a matrix of cells coloured by verdict, with what each was held against."""

from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pandas as pd

from protochain.analysis.studies.stability.cells import Verdict
from protochain.analysis.viewer import template
from protochain.processors import processors
from protochain.storage import write_atomically


def counts(table: pd.DataFrame) -> pd.DataFrame:
    """Numbers of cells by row and verdict, and the seconds they took."""
    rows = [
        {"row": row, "cells": len(cells)}
        | {str(verdict): int((cells["verdict"] == verdict).sum()) for verdict in Verdict}
        | {"seconds": round(float(cells["seconds"].sum()), 1)}
        for row, cells in table.groupby("row", sort=False)
    ]
    return pd.DataFrame(rows)


def write_page(table: pd.DataFrame, path: Path, threads: Sequence[int]) -> None:
    """Write the page: one square for each cell, in the rows of the grid, and all cells as a table."""
    grid = [
        {
            "row": row,
            "cases": [(name, cells.to_dict("records")) for name, cells in own.groupby("case", sort=False)],
        }
        for row, own in table.groupby("row", sort=False)
    ]
    text = template("grid.html").render(
        grid=grid, counts=counts(table), cells=table.to_dict("records"), total=len(table), made=_made(threads)
    )
    write_atomically(path, lambda to: to.write_text(text, encoding="utf-8"))


def _made(threads: Sequence[int]) -> dict[str, Any]:
    return {
        "protochain": version("protochain"),
        "numpy": np.__version__,
        "numba": numba.__version__,
        "processors": processors(),
        "threads that must agree": ", ".join(map(str, threads)),
    }
