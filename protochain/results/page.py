"""Pages: self-contained HTML from the templates of the package, which work offline."""

import math
from collections.abc import Collection, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from jinja2 import ChoiceLoader, Environment, PackageLoader

from protochain.core.lazy_pandas import pd
from protochain.core.palette import looks
from protochain.core.storage import write_text
from protochain.results.columns import flat, heading
from protochain.results.provenance import command_line, of_run


def render(template: str, /, **variables: Any) -> str:
    """Fill a template of the package. Variables are escaped."""
    return templates().get_template(template).render(**variables)


def write_page(path: Path, template: str, /, **variables: Any) -> None:
    """Write a page from a template, which also has the command of this process."""
    write_text(path, render(template, command=command_line(), **variables))


_COUNTED = ("frame", "rank", "time_ps")  # Columns without histograms.


def table_data(
    table: "pd.DataFrame",
    shown: Collection[str] = (),
    links: Sequence[str | None] | None = None,
    by: str | None = None,
) -> dict[str, Any]:
    """Data of a searchable table: columns ``shown`` initially, or all, and ``by`` for lines of histograms."""
    numbers = set(table.select_dtypes("number"))
    columns = [
        {"key": str(name), "title": heading(str(name)), "number": name in numbers,
         "drawn": name in numbers and name not in _COUNTED, "shown": not shown or name in shown}
        for name in table
    ]  # fmt: skip
    cells = [
        [_short(value) for value in table[name].astype(float).tolist()] if name in numbers
        else [flat(value) for value in table[name].astype(object).where(table[name].notna(), None)]
        for name in table
    ]  # fmt: skip
    names = [] if by is None else [str(name) for name in table[by].unique()]
    return {
        "columns": columns,
        "rows": [list(row) for row in zip(*cells, strict=True)],
        "links": links,
        "by": -1 if by is None else table.columns.get_loc(by),
        "looks": {name: look.svg for name, look in looks(["", *names]).items()},
    }


def _short(value: Any) -> int | float | None:
    """Number for JSON, None if it is not finite."""
    if value is None or not math.isfinite(value):
        return None
    return int(value) if value == int(value) else float(f"{value:.6g}")


def write_scan(
    path: Path, title: str, text: str, numbers: Mapping[str, str], figure: Any, table: "pd.DataFrame"
) -> None:
    """Write the page of a scan: numbers of the header by label, description, figure, and all points."""
    from protochain.results.figures import data_url

    run = of_run("openmm", "gemmi", "numpy", "scipy", "numba", "pandas")
    n_converged = (table["status"] == "converged").sum() if "status" in table else None
    write_page(
        path, "scan.html", title=title, text=text, numbers=[*numbers.items()], n_converged=n_converged,
        figure=data_url(figure), table=table, run=run,
    )  # fmt: skip


@cache
def templates(*packages: str) -> Environment:
    """Templates of other packages, followed by templates of this package."""
    loaders = [PackageLoader(name) for name in (*packages, "protochain.results")]
    pages = Environment(loader=ChoiceLoader(loaders), autoescape=True)
    pages.filters["heading"] = heading
    return pages
