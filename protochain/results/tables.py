"""Tables, figures and text in a folder."""

from collections.abc import Mapping
from functools import partial
from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure

from protochain.core.figure import image
from protochain.core.storage import write_atomically


def save(folder: Path, files: Mapping[str, pd.DataFrame | Figure | str]) -> None:
    """Write tables as CSV, figures, and text to a folder, by the names of their files."""
    for name, content in files.items():
        write_atomically(folder / name, partial(_write, content))


def _write(content: pd.DataFrame | Figure | str, to: Path) -> None:
    if isinstance(content, pd.DataFrame):
        content.to_csv(to, index=False)
    elif isinstance(content, Figure):
        to.write_bytes(image(content, to.suffix.removeprefix("."), dpi=150))
    else:
        to.write_text(content, encoding="utf-8")
