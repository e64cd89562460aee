"""Output folder of a search: tables, the lowest minima, and a page."""

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from protochain.core.arrays import Floats
from protochain.core.palette import COLOURS, START, looks
from protochain.core.storage import json_text, write_text
from protochain.results.figures import data_url, outside, panels, plain
from protochain.results.page import write_page
from protochain.results.run_folder import remove_files
from protochain.results.tables import save
from protochain.results.viewer import scene
from protochain.structure import Structure
from protochain.structure import save as save_structure

N_WRITTEN = 20
"""Number of lowest minima that are written as files."""
_N_SHOWN = 25  # Number of minima in the table of the page.
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
    """Write tables, structures, ``summary.json``, and last the page ``report.html`` with links to them."""
    # ``structure`` returns a minimum by number. ``populations`` is None without temperatures.
    files: dict[str, pd.DataFrame | Figure | str] = {"minima.csv": minima, "energy-rmsd.png": figure}
    if populations is not None:
        files |= {"populations.csv": populations, "conformers.csv": conformers}
    folder.mkdir(parents=True, exist_ok=True)
    remove_files((*folder.glob("minima/minimum-*.pdb"), *(folder / name for name in TABLES)))
    save(folder, files)
    (folder / "minima").mkdir(exist_ok=True)
    for number, row in enumerate(minima.head(N_WRITTEN).to_dict("records"), 1):
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
        minima=minima.head(_N_SHOWN),
        n_files=min(N_WRITTEN, len(minima)),
        populations=populations,
        conformers=at_lowest,
        figure=data_url(figure),
        **scene(ends),
    )


def draw_minima(table: pd.DataFrame, walks: Iterable[Floats], lowest: float) -> Figure:
    """Plot energies of minima against C-alpha RMSD to the lowest, and the lowest energy of each walk."""
    # walks: for each walk (n, 2), evaluations and energies of its minima.
    figure, (left, right) = panels(None, 2, (7, 3.2))
    clusters = table["cluster"].to_numpy()
    for k, (colour, marker) in enumerate(zip((*COLOURS, START), "osD^vPX.", strict=True), 1):
        rows = table[clusters == k if k <= len(COLOURS) else clusters > len(COLOURS)]
        if len(rows):
            left.scatter(
                rows["ca_rmsd_to_lowest_angstrom"], rows["above_lowest_kj_mol"], s=14, color=colour,
                marker=marker, label=f"{k}" if k <= len(COLOURS) else "others",
            )  # fmt: skip
    left.set(xlabel="C-alpha RMSD to the lowest, angstrom", ylabel="energy above the lowest, kJ/mol")
    left.set_xlim(*_limits(table["ca_rmsd_to_lowest_angstrom"], 0.5))
    left.set_ylim(*_limits(table["above_lowest_kj_mol"], 5.0))
    outside([left], title="cluster")
    left.set_title(f"{len(table)} minima, {(table['above_lowest_kj_mol'] < 10.0).sum()} within 10 kJ/mol")
    runs = {f"walker {number}": walk for number, walk in enumerate(walks)}
    for (name, walk), look in zip(runs.items(), looks(runs).values(), strict=True):
        lowest_so_far = np.minimum.accumulate(walk[:, 1]) - lowest
        right.step(walk[:, 0], lowest_so_far, where="post", **look.line(name))
    right.set(xlabel="energy evaluations of a walk", ylabel="lowest so far, above\nthe lowest of all, kJ/mol")
    right.set_xscale("log")
    near = sum(np.min(walk[:, 1], initial=np.inf) < lowest + 1.0 for walk in runs.values())
    right.set_title(f"walks that come within 1 kJ/mol of it: {near} of {len(runs)}")
    plain(left)
    plain(right)
    return figure


def _limits(values: "pd.Series", least: float) -> tuple[float, float]:
    """Limits of an axis from 0 to the largest value, with a margin."""
    most = max(values.max(), least)
    return -0.05 * most, 1.05 * most
