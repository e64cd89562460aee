"""Cells of the grid: what a case is, how it is run, and its verdict.

A new case is one line in the table of its row. Its check computes an error and says what it was held against
and how large it may be; the line says whether an answer is expected or a refusal, and about what. The
runner does the rest, with every number of threads that it is given.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict, dataclass, field, replace
from enum import IntEnum
from importlib import import_module
from multiprocessing import get_context
from time import perf_counter
from typing import Any

import numpy as np
import pandas as pd

from bench.cases import Outcome, Refusal, judged
from protochain.core.errors import ProtochainError
from protochain.results.tables import table_of

EPS = float(np.finfo(float).eps)
ROWS = ("mechanics", "springs", "energies", "minimisers", "dynamics")


class Part(IntEnum):
    """Smallest part of the grid that a case belongs to; each is within the next."""

    TESTED = 0
    QUICK = 1
    FULL = 2


@dataclass(frozen=True)
class Found:
    """What a check found.

    error: Size of the error; NaN is wrong.
    bound: Largest error that theory allows.
    oracle: What the result was held against.
    message: Anything else worth a line.
    """

    error: float
    bound: float
    oracle: str
    message: str = ""


@dataclass(frozen=True)
class Case:
    """One cell: a check with its parameters.

    name, parameters: Row of the matrix and place in it.
    check: Number of threads -> what it found; a ProtochainError is a refusal.
    part: Smallest part of the grid that it belongs to.
    refusal: What the refusal that is expected is about; None where an answer is.
    threaded: Whether what it computes depends on the number of threads.
    """

    name: str
    parameters: str
    check: Callable[[int], Found]
    part: Part = Part.QUICK
    refusal: Refusal = None
    threaded: bool = True


def case(
    name: str,
    parameters: str,
    check: Callable[..., Found],
    *given: Any,
    part: Part = Part.QUICK,
    refusal: Refusal = None,
) -> Case:
    """Make a case of a check that computes on one thread, whatever the number given."""
    return Case(name, parameters, lambda threads: check(*given), part, refusal, threaded=False)


@dataclass(frozen=True)
class Cell:
    """Result of a case: a line of ``cells.csv``."""

    row: str
    case: str
    parameters: str
    verdict: Outcome
    error: float = np.nan
    bound: float = np.nan
    oracle: str = ""
    message: str = ""
    threads: str = field(default="1", compare=False)
    seconds: float = field(default=np.nan, compare=False)


def run_case(row: str, case: Case, threads: Sequence[int] = (1,)) -> Cell:
    """Run a case with each number of threads, once if it has none, and judge it.

    Wrong are errors above the bound, NaN, a refusal where an answer is expected, an answer or another refusal
    where one is, exceptions of any other kind, and a result that depends in any bit on the number of threads.
    """
    began, used = perf_counter(), tuple(threads) if case.threaded else (1,)
    cells = [_judged(row, case, n) for n in used]
    # By what they print as, for NaN is not itself.
    other = next((cell for cell in cells if repr(_plain(cell)) != repr(_plain(cells[0]))), None)
    found = cells[0]
    if other is not None:
        both = "; ".join(
            f"{n} threads: {cell.verdict}, error {cell.error:.17g}, {cell.message}"
            for n, cell in zip(used, cells, strict=True)
        )
        found = replace(found, verdict=Outcome.WRONG, message=f"not the same by threads: {both}")
    return replace(found, threads=" ".join(map(str, used)), seconds=perf_counter() - began)


def _plain(cell: Cell) -> dict[str, Any]:
    return asdict(replace(cell, seconds=0.0))


def _judged(row: str, case: Case, threads: int) -> Cell:
    verdict, found, said = judged(lambda: case.check(threads), case.refusal)
    told = asdict(found) if found else {}
    message = "; ".join(filter(None, (said, told.pop("message", ""))))
    return Cell(row, case.name, case.parameters, verdict, **told, message=message)


def cases_of(row: str, part: Part = Part.FULL) -> list[tuple[int, Case]]:
    """Cases of a row in a part of the grid, with their places in its table."""
    if row not in ROWS:
        raise ProtochainError(f"stability: there is no row {row!r}; choose from {', '.join(ROWS)}")
    table: Sequence[Case] = import_module(f"{__package__}.{row}").CASES
    return [(i, each) for i, each in enumerate(table) if each.part <= part]


def run_cells(
    rows: Iterable[str], part: Part = Part.FULL, threads: Sequence[int] = (1,), workers: int = 1
) -> Iterator[Cell]:
    """Run the cases of some rows in processes of their own, by each number of threads; yield as they end."""
    listed = [(row, i, case.part) for row in rows for i, case in cases_of(row, part)]
    # The long ones first, so that none is waited for at the end.
    todo = [(row, i) for row, i, _ in sorted(listed, key=lambda each: -each[2])]
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
                message = f"its process died, or another's; run it again by itself: --rows {row}"
                yield Cell(row, lost.name, lost.parameters, Outcome.WRONG, message=message)


def _run(row: str, i: int, threads: Sequence[int]) -> Cell:
    return run_case(row, import_module(f"{__package__}.{row}").CASES[i], threads)


def ordered(cells: Iterable[Cell]) -> pd.DataFrame:
    """Cells as a table, in the order of the tables of cases whatever order they ended in."""
    order = {
        (row, each.name, each.parameters): (k, i) for k, row in enumerate(ROWS) for i, each in cases_of(row)
    }
    return table_of(sorted(cells, key=lambda cell: order[cell.row, cell.case, cell.parameters]), Cell)
