"""Cells of the grid: what a case is, how it is run, and its verdict.

A new case is one line in the table of its row. Its check computes an error and says what it was held against
and how large it may be; the line says whether an answer is expected or a refusal, and about what.
:func:`bench.cases.judged` does the rest, with every number of threads that is given.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from enum import IntEnum
from functools import partial
from importlib import import_module
from multiprocessing import get_context
from typing import Any

import numpy as np
import pandas as pd

from bench.cases import Found, Outcome, Refusal, judged, table
from protochain.core.errors import ProtochainError

EPS = float(np.finfo(float).eps)
ROWS = ("mechanics", "springs", "energies", "minimisers", "dynamics")


class Part(IntEnum):
    """Smallest part of the grid that a case belongs to; each is within the next."""

    TESTED = 0
    QUICK = 1
    FULL = 2


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


COLUMNS = (
    "row", "case", "parameters", "verdict", "error", "bound", "source", "message", "threads", "seconds",
)  # fmt: skip
"""Of ``cells.csv``."""


def run_case(row: str, case: Case, threads: Sequence[int] = (1,)) -> Found:
    """Run a case with each number of threads, once if it has none, and judge it.

    A result that depends in any bit on the number of threads is wrong, too.
    """
    used = tuple(threads) if case.threaded else (1,)
    cells = [judged(case.name, partial(case.check, n), case.refusal) for n in used]
    seconds, found = sum(cell.seconds for cell in cells), cells[0]
    # By what they print as, for NaN is not itself.
    if len({repr(replace(cell, seconds=0.0)) for cell in cells}) > 1:
        each = "; ".join(
            f"{n} threads: {cell.verdict}, error {cell.error:.17g}, {cell.message}"
            for n, cell in zip(used, cells, strict=True)
        )
        found = replace(found, outcome=Outcome.WRONG, message=f"not the same by threads: {each}")
    return replace(found, seconds=seconds, more=_place(row, case, used))


def _place(row: str, case: Case, threads: Sequence[int] = (1,)) -> dict[str, str]:
    """Columns of a cell beside what it found."""
    return {
        "row": row, "case": case.name, "parameters": case.parameters, "threads": " ".join(map(str, threads)),
    }  # fmt: skip


def cases_of(row: str, part: Part = Part.FULL) -> list[tuple[int, Case]]:
    """Cases of a row in a part of the grid, with their places in its table."""
    if row not in ROWS:
        raise ProtochainError(f"stability: there is no row {row!r}; choose from {', '.join(ROWS)}")
    table: Sequence[Case] = import_module(f"{__package__}.{row}").CASES
    return [(i, each) for i, each in enumerate(table) if each.part <= part]


def run_cells(
    rows: Iterable[str], part: Part = Part.FULL, threads: Sequence[int] = (1,), workers: int = 1
) -> Iterator[Found]:
    """Run the cases of some rows in processes of their own, by each number of threads; yield as they end."""
    listed = [(row, i, case.part) for row in rows for i, case in cases_of(row, part)]
    # The long ones first, so that none is waited for at the end.
    todo = [(row, i) for row, i, _ in sorted(listed, key=lambda each: -each[2])]
    if workers == 1:
        yield from (_run(row, i, threads) for row, i in todo)
        return
    # Fresh processes: forked ones would share the state of threads that they do not have.
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        futures: Mapping[Future[Found], tuple[str, int]] = {
            pool.submit(_run, row, i, threads): (row, i) for row, i in todo
        }
        for future in as_completed(futures):
            try:
                yield future.result()
            except BrokenProcessPool:
                row, i = futures[future]
                message = f"its process died, or another's; run it again by itself: --rows {row}"
                place = _place(row, import_module(f"{__package__}.{row}").CASES[i])
                yield Found(message=message, more=place)


def _run(row: str, i: int, threads: Sequence[int]) -> Found:
    return run_case(row, import_module(f"{__package__}.{row}").CASES[i], threads)


def ordered(cells: Iterable[Found]) -> pd.DataFrame:
    """Cells as a table, in the order of the tables of cases whatever order they ended in."""
    listed = [(row, each.name, each.parameters) for row in ROWS for _, each in cases_of(row)]
    order = {place: k for k, place in enumerate(listed)}

    def place(cell: Found) -> int:
        return order[cell.more["row"], cell.more["case"], cell.more["parameters"]]

    in_order = sorted(cells, key=place)
    return table(in_order, COLUMNS)
