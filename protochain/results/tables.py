"""Tables of rows, and tables, figures and text in a folder."""

from collections.abc import Iterable, Mapping
from dataclasses import asdict, fields
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd
from matplotlib.figure import Figure

from protochain.core.storage import write_atomically


def table_of(rows: Iterable[Any], kind: type) -> pd.DataFrame:
    """Rows, values of a dataclass, as a table: with its columns even of none."""
    return pd.DataFrame([asdict(row) for row in rows], columns=[field.name for field in fields(kind)])


def save(folder: Path, files: Mapping[str, pd.DataFrame | Figure | str]) -> None:
    """Write tables as CSV, figures, and text to a folder, each by the name of its file."""
    for name, what in files.items():
        write_atomically(folder / name, partial(_write, what))


def _write(what: pd.DataFrame | Figure | str, to: Path) -> None:
    if isinstance(what, pd.DataFrame):
        what.to_csv(to, index=False)
    elif isinstance(what, Figure):
        what.savefig(to, dpi=120)
    else:
        to.write_text(what, encoding="utf-8")
