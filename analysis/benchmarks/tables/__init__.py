"""Tables and paragraphs of the pages, made from the CSV files of results: what all of them share.

A module a topic, as analysis/docs/measured has a page a topic; pages.py imports them and fills the pages.
"""

import textwrap
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from made import RECORD, RESULTS

TABLES: dict[str, Callable[[Path], str]] = {}
"""What makes each table of a page from the folder of results."""
Cell = str | Callable[[pd.Series], str]
"""Of a column: a format of the fields of a row, or a function of the row."""
SOLVENTS = {"obc2": "OBC2", "gbn2": "GBn2", "vacuum": "vacuum"}


def _read(results: Path, file: str, **reading: Any) -> pd.DataFrame:
    paths = sorted(results.glob(file))
    if not paths:
        raise FileNotFoundError(file)
    return pd.concat(pd.read_csv(path, **reading) for path in paths)


def table(name: str, *files: str, **reading: Any) -> Callable[[Callable[..., str]], Callable[..., str]]:
    """Register a function of the tables in these files (``*``: of all that match) as a table of the pages."""

    def register(make: Callable[..., str]) -> Callable[..., str]:
        TABLES[name] = lambda results: make(*(_read(results, file, **reading) for file in files))
        return make

    return register


def table_of_rows(name: str, file: str, *columns: tuple[str, Cell]) -> None:
    """Register a table that shows each row of a file."""
    TABLES[name] = lambda results: of_rows(_read(results, file), *columns)


def markdown(headings: Iterable[str], rows: Iterable[Iterable[object]]) -> str:
    """A table of Markdown, its first column text and the others numbers, aligned right."""
    head = list(headings)
    lines = [f"| {' | '.join(head)} |", "|---|" + "--:|" * (len(head) - 1)]
    lines += [f"| {' | '.join(map(str, row))} |" for row in rows]
    return "\n".join(lines) + "\n"


def of_rows(rows: pd.DataFrame, *columns: tuple[str, Cell]) -> str:
    """A table of Markdown: each column a heading and its cell. No number is "-", an infinite one "never"."""

    def cell(row: pd.Series, made_by: Cell) -> str:
        text = made_by.format(**row) if isinstance(made_by, str) else made_by(row)
        return {"nan": "-", "inf": "never"}.get(text, text)

    body = ([cell(row, made_by) for _, made_by in columns] for _, row in rows.iterrows())
    return markdown([heading for heading, _ in columns], body)


def paragraph(*sentences: str) -> str:
    """Sentences as a paragraph of a page."""
    return textwrap.fill(" ".join(sentences), 140, break_long_words=False, break_on_hyphens=False) + "\n"


def ratio(value: float) -> str:
    """A ratio with two digits, never for zero."""
    if not value > 0:
        return "never"
    return f"{value:.2g}x" if value < 0.995 else f"{value:.1f}x" if value < 9.95 else f"{value:.0f}x"


def ratio_of(name: str) -> Cell:
    """Column of ratios."""
    return lambda row: "-" if pd.isna(row[name]) else ratio(row[name])


def digits(value: float) -> str:
    """A time or rate with three digits."""
    if not np.isfinite(value):
        return "-" if np.isnan(value) else "never"
    return f"{value:.0f}" if value >= 99.95 else f"{value:.1f}" if value >= 9.995 else f"{value:.2f}"


def digits_of(name: str) -> Cell:
    """Column of times or rates."""
    return lambda row: digits(row[name])


def between(values: pd.Series) -> str:
    """A range of counts or ratios, in whole numbers from ten on."""
    low, high = (f"{v:.0f}" if v >= 9.95 else f"{v:.1f}" for v in (values.min(), values.max()))
    return f"{low} to {high}"


def percent(row: pd.Series) -> str:
    """A share with its interval."""
    return f"{100 * row['value']:.0f} % ({100 * row['low']:.0f} to {100 * row['high']:.0f})"


def made_by(record: pd.DataFrame, *files: str) -> str:
    """Commands and commits of tables, each once."""
    rows = record[record["table"].isin(files)][["command", "commit"]].drop_duplicates()
    return paragraph(*(f"`{r.command}`, at commit {r.commit}." for r in rows.itertuples()))


@table("made", RECORD, dtype=str, keep_default_na=False)
def made(record: pd.DataFrame) -> str:
    """How every table, picture and notebook was made."""
    folders = ("results", "docs", "notebooks", "scenes")
    lines = ["| table | command | commit | machine | threads | load |", "|---|---|---|---|--:|--:|"]
    for r in record.itertuples():
        folder = next((name for name in folders if (RESULTS.parent / name / r.table).exists()), folders[0])
        name = f"[{r.table}](../../{folder}/{r.table})"
        cells = (name, f"`{r.command}`", r.commit, r.machine, r.threads, r.load)
        lines.append(f"| {' | '.join(cells)} |")
    versions = ", ".join(dict.fromkeys(v for row in record["versions"] for v in row.split(", ") if v))
    return "\n".join([*lines, "", paragraph(f"Versions: {versions}.")])
