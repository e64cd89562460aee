"""What runs leave out, with proof that the answer is the same, and what that saves.

:mod:`.energies` and :mod:`.runs` have the tables; a new one is a line in them.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from threadpoolctl import threadpool_limits

from bench.cases import Found, table
from bench.page import Section, write_report
from bench.provenance import made
from bench.studies.omissions import energies, runs
from bench.studies.omissions.cells import COLUMNS, Material, run_omission
from protochain.core.figure import INK
from protochain.core.palette import COLOURS
from protochain.results.figures import Figure
from protochain.results.tables import save
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
SHOWN = ("scene", "against", "everything_ms", "left_out_ms", "ratio", "error", "verdict")
READING = (
    "CPU time on one thread, the least of many taken in turn. The answers are the same to the bit, or to the "
    "error given, relative to the sums they come from."
)


def run(output: Path, inputs: Sequence[Path] = (), quick: bool = False) -> Iterator[pd.DataFrame]:
    """Run all of them; write ``omissions.csv``, ``omissions.png`` and ``report.html``."""
    rows: list[Found] = []
    chosen = [each for each in (*energies.OMISSIONS, *runs.OMISSIONS) if each.in_quick or not quick]
    with threadpool_limits(1, "blas"):
        for material in _materials(inputs, quick):
            found = [run_omission(each, material, _SECONDS[quick]) for each in chosen]
            own = [row for row in found if row is not None]
            rows += own
            yield table(own, COLUMNS)[list(SHOWN)]
    every = table(rows, COLUMNS)
    save(output, {"omissions.csv": every, "omissions.png": plot(every)})
    part = Section("Computed with everything, and without", {"runs": every}, (READING,), "omissions.png")
    write_report(output, "What a run does not need", [part], made("1"))


def _materials(inputs: Sequence[Path], quick: bool) -> Iterator[Material]:
    if not inputs:
        yield Material(from_sequence(SHORT if quick else SEQUENCE))
    yield from (Material(load(path), path) for path in inputs)


def plot(rows: pd.DataFrame) -> Figure:
    """Ratio of the times of each, those that are wrong in another colour."""
    rows = rows[np.isfinite(rows["ratio"])]
    several = rows["structure"].nunique() > 1
    names = [
        str(row["scene"]) + (f" ({row['structure']})" if several else "") + f": {row['against']}"
        for row in rows.to_dict("records")
    ]
    figure = Figure(figsize=(7, 1.0 + 0.2 * len(rows)), layout="constrained")
    ax, places = figure.subplots(), np.arange(len(rows))
    colours = [COLOURS[0] if verdict == "right" else COLOURS[1] for verdict in rows["verdict"]]
    ax.barh(places, rows["ratio"], color=colours, height=0.65)
    for place, ratio in enumerate(rows["ratio"]):
        ax.annotate(f"{ratio:.3g}x", (ratio, place), (3, 0), textcoords="offset points", va="center")
    ax.set_yticks(places, names)
    ax.invert_yaxis()
    ax.set_xscale("log")
    ax.axvline(1.0, color=INK, linewidth=0.8)
    ax.grid(False, axis="y")
    ax.set_xlim(0.8, 1.6 * max([1.0, *rows["ratio"]]))
    ax.set_xlabel("slowdown when the part after the colon is also computed")
    largest = rows.iloc[int(np.argmax(rows["ratio"]))]
    answers = "with the same answers" if (rows["verdict"] == "right").all() else "but some answers differ"
    figure.suptitle(f"Runs are up to {largest['ratio']:.1f} times as fast ({largest['scene']}), {answers}")
    return figure
