"""The page of a study or scene: its sections, each with sentences, a picture and tables."""

from base64 import b64encode
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import pandas as pd

from protochain.results.tables import save


@dataclass(frozen=True, eq=False)
class Section:
    """A part of a page.

    tables: By what their rows are.
    lines: Sentences.
    picture: File in the folder of the page, if there is one.
    """

    heading: str
    tables: Mapping[str, pd.DataFrame] = field(default_factory=dict)
    lines: Sequence[str] = ()
    picture: str = ""


def write_report(folder: Path, title: str, sections: Sequence[Section], made: Mapping[str, str]) -> None:
    """Write ``report.html`` beside its pictures, which it holds; what comes from files is escaped."""
    # On use: it loads the viewer of structures, which scenes know nothing of.
    from protochain.results.page import templates

    page = templates("bench").get_template("report.html")
    pictures = {each.picture: _data_url(folder / each.picture) for each in sections if each.picture}
    save(folder, {"report.html": page.render(title=title, sections=sections, pictures=pictures, made=made)})


def _data_url(path: Path) -> str:
    return f"data:image/png;base64,{b64encode(path.read_bytes()).decode()}" if path.exists() else ""
