"""Results of commands with a row for each structure: tables, printed rows and exit status."""

import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import typer

from protochain.cli.options import exit_status, print_files, print_json
from protochain.cli.printable import printer
from protochain.core.lazy_pandas import pd

Rows = list[dict[str, Any]]


def refusal_row(error: object, **row: Any) -> dict[str, Any]:
    """Report the reason for a missing result on standard error. Return the row."""
    print(" ".join(str(error).split()), file=sys.stderr)
    return {**row, "message": str(error)}


def conclude(
    rows: Rows,
    tables: Mapping[Path | None, "Callable[[], pd.DataFrame]"],
    show: Callable[[Rows], None],
    as_json: bool,
    files: Sequence[Path] = (),
    is_sound: bool = True,
    **entries: Any,
) -> None:
    """Write the requested tables, print the rows or one object, and exit, with 3 if not ``is_sound``."""
    from protochain.core.storage import write_atomically

    for path, table in tables.items():
        if path:
            write_atomically(path, partial(table().to_csv, index=False))
    written = [*filter(None, tables), *files]
    usable = [row for row in rows if not row["message"]]
    if as_json:
        print_json({**entries, "results": rows, "files": [*map(str, written)]})
    else:
        if usable:
            show(usable)
        print_files(*written)
    status = "measured" if is_sound else "overlaps"
    raise typer.Exit(exit_status("refused" if row["message"] else status for row in rows))


def table_of(rows: Rows, without: Iterable[str] = ()) -> "pd.DataFrame":
    """Rows as a table, without the columns ``without``."""
    return pd.DataFrame(rows).drop(columns=[*without], errors="ignore").convert_dtypes()


def concatenate(tables: "Sequence[pd.DataFrame]") -> "pd.DataFrame":
    """Concatenate tables. Without tables, return an empty one."""
    return pd.concat(tables) if tables else pd.DataFrame()


def print_rows(headings: Iterable[str], rows: Iterable[Sequence[Any]], texts: int = 1) -> None:
    """Print rows below headings. The first ``texts`` columns are text, all others numbers."""
    from rich.markup import escape
    from rich.table import Table

    names, cells = [*headings], [[_text(value) for value in row] for row in rows]
    table = Table(box=None, pad_edge=False, padding=(0, 1, 0, 0))
    least = 0
    for k, (name, *column) in enumerate(zip(names, *cells, strict=True)):
        longest = max(map(len, (name, *column)))
        width = min(longest, _FOLDED) if k < texts else longest
        least += width + 1
        if k < texts:
            table.add_column(name, overflow="fold", min_width=width)
        else:
            table.add_column(name, justify="right", no_wrap=True)
    for row in cells:
        table.add_row(*map(escape, row))
    # On narrow terminals, rich would cut off numbers and their headings.
    console = printer()
    console.width = max(console.width, least)
    console.print(table, crop=False)


_FOLDED = 30  # Width to which texts of a table are folded on narrow terminals.


def _text(value: Any) -> str:
    if not isinstance(value, float):
        return "-" if value is None else str(value)
    return f"{value:.2f}" if abs(value) < 10 else f"{value:.0f}"
