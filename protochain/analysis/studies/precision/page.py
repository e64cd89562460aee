"""Page of the curves: each with its picture, with what it says, and with its points."""

from base64 import b64encode
from collections.abc import Mapping, Sequence
from pathlib import Path

import pandas as pd

from protochain.analysis.studies.made import made
from protochain.analysis.viewer import template
from protochain.processors import processors
from protochain.storage import write_atomically

PICTURES = {"minimisers": "precision"}
"""Names of pictures that are not those of their kinds."""


def write_page(
    folder: Path, parts: Sequence[tuple[str, str, str, list[str]]], tables: Mapping[str, pd.DataFrame]
) -> None:
    """Write ``report.html``.

    Parameters
    ----------
    folder : Path
        Where the pictures are.
    parts : sequence of (str, str, str, list of str)
        Name, title, what is measured, and sentences of each kind.
    tables : mapping of str to pandas.DataFrame
        Points by name of the kind.
    """
    shown = [
        {
            "name": name,
            "title": title,
            "measured": measured,
            "said": sentences,
            "picture": _data_url(folder / f"{PICTURES.get(name, name)}.png"),
            "points": tables[name].to_dict("records"),
        }
        for name, title, measured, sentences in parts
    ]
    text = template("curves.html").render(parts=shown, made=made(f"1, of minimisers {processors()}"))
    write_atomically(folder / "report.html", lambda to: to.write_text(text, encoding="utf-8"))


def _data_url(path: Path) -> str:
    return f"data:image/png;base64,{b64encode(path.read_bytes()).decode()}" if path.exists() else ""
