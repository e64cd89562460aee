"""What a search writes to its folder: tables, the lowest minima, and a page."""

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from protochain.core.arrays import Floats
from protochain.core.storage import json_text, write_text
from protochain.results.figures import COLOURS, data_url, panels
from protochain.results.page import write_page
from protochain.results.tables import save
from protochain.results.viewer import scene
from protochain.structure import Structure
from protochain.structure import save as save_structure

WRITTEN = 20
"""Minima, the lowest, that are written as files."""
_SHOWN = 25
"""Minima in the table of the page."""
TABLES = ("minima.csv", "populations.csv", "conformers.csv", "energy-rmsd.png")


def write_search(
    folder: Path,
    record: Mapping[str, Any],
    minima: pd.DataFrame,
    structure: Callable[[int], Structure],
    ends: dict[str, Structure],
    figure: Figure,
    populations: pd.DataFrame | None,
    conformers: pd.DataFrame,
) -> None:
    """Write the tables, structures, ``summary.json`` and ``report.html``; the page last, which links them.

    Structures are by the number of their minimum; there are no populations without temperatures.
    """
    files: dict[str, pd.DataFrame | Figure | str] = {"minima.csv": minima, "energy-rmsd.png": figure}
    if populations is not None:
        files |= {"populations.csv": populations, "conformers.csv": conformers}
    folder.mkdir(parents=True, exist_ok=True)
    for old in (*folder.glob("minima/minimum-*.pdb"), *(folder / name for name in TABLES)):
        old.unlink(missing_ok=True)
    save(folder, files)
    (folder / "minima").mkdir(exist_ok=True)
    for number, row in enumerate(minima.head(WRITTEN).to_dict("records"), 1):
        remarks = [
            f"MINIMUM {number} OF A SEARCH BY {record['method'].upper()}",
            f"ENERGY {row['energy_kj_mol']:.4f} KJ/MOL, {row['above_lowest_kj_mol']:.4f} ABOVE THE LOWEST",
        ]
        save_structure(structure(number), folder / "minima" / f"minimum-{number:03d}.pdb", remarks)
    write_text(folder / "summary.json", json_text(record))
    at_lowest = conformers
    if len(at_lowest):
        at_lowest = at_lowest[at_lowest["temperature_k"] == at_lowest["temperature_k"].min()]
    write_page(
        folder / "report.html",
        "search.html",
        record=record,
        minima=minima.head(_SHOWN),
        n_files=min(WRITTEN, len(minima)),
        populations=populations,
        conformers=at_lowest,
        figure=data_url(figure),
        **scene(ends),
    )


def drawn(table: pd.DataFrame, walks: Iterable[Floats], lowest: float) -> Figure:
    """Energy of the minima against their C-alpha RMSD to the lowest, and the lowest energy as it fell.

    walks: of each (n, 2), evaluations and energy of what it found.
    """
    figure, (left, right) = panels(None, 2, (10, 3.6))
    left.scatter(
        table["ca_rmsd_to_lowest_angstrom"], table["above_lowest_kj_mol"], s=12,
        c=[COLOURS[(each - 1) % len(COLOURS)] for each in table["cluster"]],
    )  # fmt: skip
    left.set_xlabel("C-alpha RMSD to the lowest, angstrom; a colour each cluster")
    left.set_ylabel("energy above the lowest, kJ/mol")
    for walker, found in enumerate(walks):
        right.step(
            found[:, 0], np.minimum.accumulate(found[:, 1]) - lowest, where="post",
            color=COLOURS[walker % len(COLOURS)],
        )  # fmt: skip
    right.set_xlabel("energy evaluations of a walk; a line each")
    right.set_ylabel("lowest so far, above the lowest of all, kJ/mol")
    right.set_xscale("log")
    return figure
