"""Cells of the grid: what a case is, how it is run, and its verdict.

A new case is one line in the table of its row. Its check computes an error and says what it was held against
and how large it may be; the runner does the rest.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict, dataclass, field
from enum import IntEnum, StrEnum
from functools import partial
from importlib import import_module
from multiprocessing import get_context
from time import perf_counter
from typing import Any

import numpy as np
import pandas as pd
from threadpoolctl import threadpool_limits

from protochain.errors import ProtochainError

EPS = float(np.finfo(float).eps)
ROWS = ("mechanics", "springs", "energies", "minimisers", "dynamics")


class Part(IntEnum):
    """Smallest part of the grid that a case belongs to; each is within the next."""

    TESTED = 0
    QUICK = 1
    FULL = 2


class Verdict(StrEnum):
    """How a cell ended."""

    RIGHT = "right"
    REFUSED = "refused"
    WRONG = "wrong"


@dataclass(frozen=True)
class Found:
    """What a check found.

    Parameters
    ----------
    error : float
        Size of the error; NaN is wrong.
    bound : float
        Largest error that theory allows.
    oracle : str
        What the result was held against.
    message : str
        Anything else worth a line.
    """

    error: float
    bound: float
    oracle: str
    message: str = ""


@dataclass(frozen=True)
class Case:
    """One cell: a check with its parameters.

    Parameters
    ----------
    name, parameters : str
        Row of the matrix and place in it.
    check : callable
        Number of threads -> what it found; a ProtochainError is a refusal.
    part : Part
        Smallest part of the grid that it belongs to.
    """

    name: str
    parameters: str
    check: Callable[[int], Found]
    part: Part = Part.QUICK


def case(
    name: str, parameters: str, check: Callable[..., Found], *given: Any, part: Part = Part.QUICK
) -> Case:
    """Make a case of a check that computes on one thread, whatever the number given."""
    return Case(name, parameters, lambda threads: check(*given), part)


@dataclass(frozen=True)
class Cell:
    """Result of a case: a line of ``cells.csv``."""

    row: str
    case: str
    parameters: str
    verdict: Verdict
    error: float = np.nan
    bound: float = np.nan
    oracle: str = ""
    message: str = ""
    seconds: float = field(default=np.nan, compare=False)


def run_case(row: str, case: Case, threads: int = 1) -> Cell:
    """Run a case and judge it: wrong are errors above the bound, NaN, and exceptions of any other kind."""
    began, cell = perf_counter(), partial(Cell, row, case.name, case.parameters)
    try:
        # Extreme numbers overflow on the way; what comes of it is judged. BLAS on one thread, as in runs.
        with np.errstate(all="ignore"), threadpool_limits(1, "blas"):
            found = case.check(threads)
    except ProtochainError as error:
        one_line = "\n" not in str(error) and bool(str(error))
        verdict = Verdict.REFUSED if one_line else Verdict.WRONG
        return cell(verdict, message=str(error), seconds=perf_counter() - began)
    except Exception as error:  # whatever it is, the cell is wrong and the grid goes on
        text = f"{type(error).__name__}: {error}"
        return cell(Verdict.WRONG, message=text, seconds=perf_counter() - began)
    # Not "error > bound": NaN is wrong.
    verdict = Verdict.RIGHT if found.error <= found.bound else Verdict.WRONG
    return cell(verdict, **asdict(found), seconds=perf_counter() - began)


def cases_of(row: str, part: Part = Part.FULL) -> list[tuple[int, Case]]:
    """Cases of a row in a part of the grid, with their places in its table.

    Raises
    ------
    ProtochainError
        If there is no such row.
    """
    if row not in ROWS:
        raise ProtochainError(f"stability: there is no row {row!r}; choose from {', '.join(ROWS)}")
    table: Sequence[Case] = import_module(f"{__package__}.{row}").CASES
    return [(i, each) for i, each in enumerate(table) if each.part <= part]


def run_cells(
    rows: Iterable[str], part: Part = Part.FULL, threads: int = 1, workers: int = 1
) -> Iterator[Cell]:
    """Run the cases of some rows in processes of their own, of ``threads`` threads; yield as they end."""
    todo = [(row, i) for row in rows for i, _ in cases_of(row, part)]
    if workers == 1:
        yield from (_run(row, i, threads) for row, i in todo)
        return
    # Fresh processes: forked ones would share the state of threads that they do not have.
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        futures: Mapping[Future[Cell], tuple[str, int]] = {
            pool.submit(_run, row, i, threads): (row, i) for row, i in todo
        }
        for future in as_completed(futures):
            try:
                yield future.result()
            except BrokenProcessPool:
                row, i = futures[future]
                lost = import_module(f"{__package__}.{row}").CASES[i]
                message = "its process died, or another's: run the row again with --workers 1"
                yield Cell(row, lost.name, lost.parameters, Verdict.WRONG, message=message)


def _run(row: str, i: int, threads: int) -> Cell:
    return run_case(row, import_module(f"{__package__}.{row}").CASES[i], threads)


def table_of(cells: Iterable[Cell]) -> pd.DataFrame:
    """Cells as a table, in the order of the tables of cases whatever order they ended in."""
    order = {
        (row, each.name, each.parameters): (k, i) for k, row in enumerate(ROWS) for i, each in cases_of(row)
    }
    rows = sorted(cells, key=lambda cell: order[cell.row, cell.case, cell.parameters])
    return pd.DataFrame([asdict(cell) for cell in rows], columns=list(Cell.__annotations__))
