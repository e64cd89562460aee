"""What runs leave out, with proof that the answer is the same, and what that saves.

:mod:`.energies` and :mod:`.runs` have the tables; a new one is a line in them.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from threadpoolctl import threadpool_limits

from bench.page import render
from bench.studies.omissions import energies, runs
from bench.studies.omissions.cells import COUNTS, Material, Row, run_omission
from protochain.results.figures import COLOURS, Figure
from protochain.results.provenance import made
from protochain.results.tables import save, table_of
from protochain.structure import from_sequence, load

SEQUENCE = (
    "KVFGRCELAAAMKRHGLDNYRGYSLGNWVCAAKFESNFNTQATNRNTDGSTDYGILQINSRWWCNDGRTPGSRNLCNIPCSALLSSDITASVNCAKKIVSDGNGMNAWV"
    "AWRNRCKGTDVQAWIRGCRL"
)  # fmt: skip
"""Hen egg-white lysozyme, as an extended chain of some 2000 atoms, for use without files."""
SHORT = "NLYIQWLKDGGPSSGRPPPS"
"""Trp-cage, for --quick."""
_SECONDS = 3.0, 0.2
"""Of each timing, in full and with --quick."""


def run(output: Path, inputs: Sequence[Path] = (), quick: bool = False) -> Iterator[pd.DataFrame]:
    """Run all of them; write ``omissions.csv``, ``omissions.png`` and ``report.html``."""
    rows: list[Row] = []
    chosen = [each for each in (*energies.OMISSIONS, *runs.OMISSIONS) if each.in_quick or not quick]
    with threadpool_limits(1, "blas"):
        for material in _materials(inputs, quick):
            found = [run_omission(each, material, _SECONDS[quick]) for each in chosen]
            own = [row for row in found if row is not None]
            rows += own
            columns = ["scene", "against", "everything_ms", "left_out_ms", "ratio", "error", "verdict"]
            yield table_of(own, Row)[columns]
    table = table_of(rows, Row)
    page = render("omissions.html", rows=table.to_dict("records"), counts=COUNTS, made=made("1"))
    save(output, {"omissions.csv": table, "omissions.png": _plot(table), "report.html": page})


def _materials(inputs: Sequence[Path], quick: bool) -> Iterator[Material]:
    if not inputs:
        yield Material(from_sequence(SHORT if quick else SEQUENCE))
    yield from (Material(load(path), path) for path in inputs)


def _plot(table: pd.DataFrame) -> Figure:
    """Ratio of the times of each, those that are wrong in another colour."""
    table = table[np.isfinite(table["ratio"])]
    several = table["structure"].nunique() > 1
    names = [
        str(row["scene"]) + (f" ({row['structure']})" if several else "") + f": {row['against']}"
        for row in table.to_dict("records")
    ]
    figure = Figure(figsize=(8, 0.9 + 0.27 * len(table)), layout="constrained")
    ax, places = figure.subplots(), np.arange(len(table))
    colours = [COLOURS[0] if verdict == "right" else COLOURS[1] for verdict in table["verdict"]]
    ax.barh(places, table["ratio"], color=colours, height=0.65)
    for place, ratio in enumerate(table["ratio"]):
        ax.text(ratio, place, f" {ratio:.3g}x", va="center", fontsize=8)
    ax.set_yticks(places, names, fontsize=8)
    ax.invert_yaxis()
    ax.set_xscale("log")
    ax.axvline(1.0, color="grey", linewidth=0.8)
    ax.set_xlim(0.8, 1.6 * max([1.0, *table["ratio"]]))
    ax.set_xlabel("times as long with what stands behind the colon; the answers are the same")
    return figure
