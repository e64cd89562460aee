"""Tables of rows, and tables, figures and text in a folder."""

from collections.abc import Iterable, Mapping
from dataclasses import asdict, fields
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd
from matplotlib.figure import Figure

from protochain.core.storage import write_atomically
from protochain.results.columns import heading


def table_of(rows: Iterable[Any], kind: type) -> pd.DataFrame:
    """Rows, values of a dataclass, as a table: with its columns even of none."""
    return pd.DataFrame([asdict(row) for row in rows], columns=[field.name for field in fields(kind)])


def energies_by_term(records: Mapping[str, Mapping[str, Any]]) -> pd.DataFrame:
    """Energy of each term at the start and at each end, from records by the names of the ends.

    Returns
    -------
    pandas.DataFrame
        Columns ``term``, ``start_kj_mol``, and of each end ``NAME_kj_mol``. Terms that are 0 everywhere, and
        those of energies that are not known by term, are left out; restraints are no part of the energy.
    """
    rows = []
    for key in dict.fromkeys(key for each in records.values() for key in each):
        name = key.removeprefix("energy_").removesuffix("_start_kj_mol")
        if key != f"energy_{name}_start_kj_mol":
            continue
        # A run that failed has no numbers.
        start = next((each[key] for each in records.values() if each.get(key) is not None), None)
        ends = {f"{of}_kj_mol": each.get(f"energy_{name}_end_kj_mol") for of, each in records.items()}
        if start or any(ends.values()):
            rows.append({"term": heading(name), "start_kj_mol": start, **ends})
    columns = ["term", "start_kj_mol", *(f"{of}_kj_mol" for of in records)]
    return pd.DataFrame(rows, columns=columns)


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
