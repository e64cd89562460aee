"""Page of a run over frames: how they ended, and the distribution of all that differs between them."""

from pathlib import Path

import pandas as pd

from protochain.batches.frame_files import FramesRun
from protochain.batches.report import WORST, plot_distribution
from protochain.results.columns import heading
from protochain.results.figures import data_url
from protochain.results.page import write_page
from protochain.results.provenance import of_run

_FIRST = ("energy", "violations", "ca_rmsd", "rmsd", "clashscore", "total")
"""What is drawn first, by how its name begins."""
_NO_QUANTITIES = ("frame", "time_ps", "output_frame")
_MOST_FIGURES = 16


def write_report(run: FramesRun, name: str, source: str, path: Path) -> None:
    """Write the page of a run, one file that works offline."""
    table = run.table
    usable = table[~table["status"].isin(["refused", "killed", "error", "time-limit"])]
    numbers = usable.drop(columns=[*_NO_QUANTITIES], errors="ignore").select_dtypes("number")
    varying = numbers.loc[:, numbers.nunique() > 1]
    others = table[~table["status"].isin(["converged", "measured"])]
    write_page(
        path,
        "frames.html",
        name=name,
        source=source,
        total=len(table),
        table=run.csv.name,
        counts=pd.DataFrame([{"frames": len(table), **run.counts}]),
        statistics=quartiles(varying),
        figures=_figures(varying),
        others=others.head(WORST)[["frame", "status", "message"]].to_dict("records"),
        n_others=len(others),
        run=of_run("openmm", "gemmi", "numpy", "scipy", "numba", "MDAnalysis", "pandas"),
    )


def quartiles(numbers: pd.DataFrame) -> pd.DataFrame:
    """Quartiles of each column, a row each."""
    at = {"lowest": 0.0, "first quartile": 0.25, "median": 0.5, "third quartile": 0.75, "highest": 1.0}
    rows = [
        {"quantity": heading(name), **{stated: values.quantile(q) for stated, q in at.items()}}
        for name, values in ((str(name), numbers[name]) for name in numbers)
    ]
    return pd.DataFrame(rows, columns=["quantity", *at])


def _figures(numbers: pd.DataFrame) -> dict[str, str]:
    """Distributions; those of start and end of a quantity are drawn together."""
    pairs: dict[str, dict[str, str]] = {}
    for name in numbers:
        when = next((when for when in ("start", "end_reference", "end") if f"_{when}" in str(name)), "")
        pairs.setdefault(str(name).replace(f"_{when}", "") if when else str(name), {})[when.split("_")[0]] = (
            str(name)
        )
    ranked = sorted(pairs, key=lambda name: not name.startswith(_FIRST))
    drawn: dict[str, str] = {}
    for name in ranked[:_MOST_FIGURES]:
        its = pairs[name]
        long = pd.concat([numbers[column].rename("value") for column in its.values()], keys=its.keys())
        ends = pd.Series(long.index.get_level_values(0), index=long.index).replace("", "frames")
        figure = plot_distribution(long, ends, heading(name), of="frames")
        drawn[heading(name)] = data_url(figure)
    return drawn
