"""Page of a batch: counts of statuses, distributions, and rows, the worst first."""

import re
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
from matplotlib.figure import Figure

from protochain.core.lazy_pandas import pd
from protochain.core.palette import looks
from protochain.core.storage import write_atomically
from protochain.results.figures import outside, panels, plain
from protochain.results.page import table_data, write_page
from protochain.structure.molecule.repairs import loss_lines

_SHOWN = {
    "structure", "method", "status", "ca_rmsd_angstrom", "energy_end_reference_kj_mol", "violations_end",
    "clashscore_end", "ramachandran_outliers_end", "seconds",
}  # fmt: skip
"""Columns of the page that are shown at first."""
_NOT_ON_PAGE = (
    "energy_.*_kj_mol|.*_eigenvalue_.*|.*_beside_.*|n_(bodies|hinges|chains|lost_atoms)|seed|threads"
)
"""Numeric columns in the table only, except energies at start and end."""

USABLE = "energy_end_reference_kj_mol"


def write_report(folder: Path, table: "pd.DataFrame", summary: dict[str, Any]) -> None:
    """Write ``report.html``, ``energy.png``, ``rmsd.png`` and ``seconds.png``."""
    usable = table[table[USABLE].notna()]
    for stem, (values, label) in _measures(usable).items():
        figure = plot_distribution(values, usable["method"], label)
        outside(figure.axes)
        write_atomically(folder / f"{stem}.png", partial(figure.savefig, dpi=150))
    pages = {str(path.relative_to(folder / "pages")) for path in (folder / "pages").rglob("*.html")}
    write_page(
        folder / "report.html",
        "batch.html",
        summary=summary,
        lost=loss_lines(table.to_dict("records")),
        counts=table.groupby("method", sort=False)["status"].value_counts().unstack(fill_value=0),
        data=_data(worst_first(table), pages),
        judges=[judge for judge in table["judge"].dropna().unique() if judge] if "judge" in table else [],
    )


def _data(rows: "pd.DataFrame", pages: set[str]) -> dict[str, Any]:
    """Rows of the page, the worst first, with links to the pages of structures."""
    columns = [
        str(name) for name in rows.select_dtypes("number")
        if name in (USABLE, "energy_start_kj_mol") or not re.fullmatch(_NOT_ON_PAGE, str(name))
    ]  # fmt: skip
    links = [f"pages/{quote(name)}.html" if f"{name}.html" in pages else None for name in rows["structure"]]
    first = ["structure", "method", "status"]
    columns.sort(key=lambda name: name not in _SHOWN)
    varying = [name for name in columns if name in _SHOWN or rows[name].nunique() > 1]
    drop = rows[[*first, *varying]].assign(energy_drop_kj_mol_per_residue=_drop(rows))
    return table_data(drop.assign(message=rows["message"]), _SHOWN, links, "method")


def worst_first(table: "pd.DataFrame") -> "pd.DataFrame":
    """Sort rows: without a result, not converged, converged, and in each the largest RMSD first."""
    rank = np.where(table[USABLE].isna(), 0, np.where(table["status"] != "converged", 1, 2))
    ranked = table.assign(rank=rank, far=-table["ca_rmsd_angstrom"].astype(float))
    return ranked.sort_values(["rank", "far"], kind="stable").drop(columns=["rank", "far"])


def plot_distributions(table: "pd.DataFrame") -> Figure:
    """Plot the distributions of energy drop, RMSD and seconds side by side, a line for each method."""
    figure, axes = panels(None, 3, (7.2, 2.6), sharey=True)
    table = table[table[USABLE].notna()]
    for ax, (values, label) in zip(axes, _measures(table).values(), strict=True):
        plot_distribution(values, table["method"], label.replace(", kJ", ",\nkJ").replace(" to", "\nto"), ax)
    for ax in axes[1:]:
        ax.set_ylabel("")
    outside(axes)
    return figure


def _measures(table: "pd.DataFrame") -> dict[str, tuple["pd.Series", str]]:
    """Quantities that are drawn, with their labels, by the stem of the file."""
    return {
        "energy": (_drop(table), "energy drop, kJ/mol per residue"),
        "rmsd": (table["ca_rmsd_angstrom"], "C-alpha RMSD to the start, angstrom"),
        "seconds": (table["seconds"], "seconds"),
    }


def plot_distribution(values: "pd.Series", methods: "pd.Series", label: str, ax: Any = None) -> Figure:
    """Plot the cumulative distribution of a quantity, a line for each method."""
    figure, (ax,) = panels(ax, 1, (4.6, 3.2))
    styles = looks(methods.astype(str).unique())
    for method, method_values in values.astype(float).groupby(methods, sort=False):
        sorted_values = np.sort(method_values.dropna().to_numpy())
        if len(sorted_values):
            share = 100.0 * np.arange(1, len(sorted_values) + 1) / len(sorted_values)
            ax.step(sorted_values, share, where="post", **styles[str(method)].line(str(method)))
    medians = values.astype(float).groupby(methods).median().dropna().sort_values()
    ends = [f"{medians.iloc[k]:.3g} ({medians.index[k]})" for k in (0, -1) if len(medians)]
    if len(medians) > 1:
        ax.set_title("medians from " + "\nto ".join(ends))
    elif len(medians):
        ax.set_title(f"median {ends[0]}")
    ax.set(xlabel=label, ylabel="structures up to this value, %", ylim=(0, 101))
    plain(ax)
    return figure


def _drop(table: "pd.DataFrame") -> "pd.Series":
    drop = table["energy_start_kj_mol"].astype(float) - table[USABLE].astype(float)
    n = table["n_residues"].astype(float)
    return drop / n.where(n > 0.0)  # of amino acids: DNA has none
