"""Tables, figures and text in a folder."""

from collections.abc import Mapping
from functools import partial
from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure

from protochain.core.storage import write_atomically


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
