"""Tables and words of the curve of nearness: how far ends lie from their starts, by method and tolerance."""

from pathlib import Path

import pandas as pd
from tables import digits, markdown, of_rows, paragraph, table

METHODS = ("cartesian", "hybrid", "lbfgs", "openmm")
DEFAULT, REFERENCE, TOLERANCE = "cartesian", "openmm", 10.0
"""The default method and its tolerance, kJ/mol/nm, and what it is held against."""
ALLOWED = 0.2
"""angstrom. Median RMSD above the reference's."""


def _pairs(rows: pd.DataFrame, tolerance: float) -> pd.DataFrame:
    """Default and reference, by structure, where both met a tolerance."""
    of = rows[rows["tolerance"] == tolerance].pivot(index="structure", columns="method")
    both = of["energy_kj_mol"][[DEFAULT, REFERENCE]].notna().all(axis=1)
    return of[both]


@table("near")
def near(results: Path) -> str:
    """Medians of RMSD, energy and seconds against tolerance, of structures in which all methods met it."""
    rows = pd.read_csv(results / "near.csv")
    kinds = {
        "RMSD, angstrom": ("ca_rmsd_angstrom", "{:.2f}".format),
        "energy, kJ/mol per 100 residues": ("above_kj_mol_per_100_residues", "{:.0f}".format),
        "CPU seconds": ("cpu_seconds", digits),
        "met, of all": ("energy_kj_mol", str),
    }
    cells = []
    tolerances = sorted(rows["tolerance"].unique(), reverse=True)
    for kind, (column, shown) in kinds.items():
        for method in METHODS:
            own = rows[rows["method"] == method]
            of = (own if kind == "met, of all" else own[own["met_by_all"]]).groupby("tolerance")[column]
            values = of.count() if kind == "met, of all" else of.median()
            cells.append([kind, f"`{method}`", *(shown(values[t]) for t in tolerances)])
    return markdown(("median", "method", *(f"{t:g}" for t in tolerances)), cells)


@table("near-words")
def near_words(results: Path) -> str:
    """Whether the default is as near as the reference and as low, at each tolerance."""
    rows = pd.read_csv(results / "near.csv")
    parts = []
    for tolerance in (TOLERANCE, 1.0):
        both = _pairs(rows, tolerance)
        away, energy = both["ca_rmsd_angstrom"].median(), both["energy_kj_mol"]
        low = (energy[DEFAULT] <= energy[REFERENCE]).mean()
        meets = away[DEFAULT] <= away[REFERENCE] + ALLOWED
        parts.append(
            f"at {tolerance:g} kJ/mol/nm `{DEFAULT}` ends {away[DEFAULT]:.2f} angstrom away and OpenMM "
            f"{away[REFERENCE]:.2f} (medians of {len(both)}; {'within' if meets else 'not within'} "
            f"{ALLOWED:g} of it), and is as low in {low:.0%}"
        )
    n = rows.groupby("start")["structure"].nunique()
    far = rows[(rows["tolerance"] == TOLERANCE) & (rows["ca_rmsd_angstrom"] > 2.0)]
    counted = far.groupby("method").size()
    counts = ", ".join(f"{counted.get(method, 0)} by `{method}`" for method in METHODS)
    return paragraph(
        f"Of {n['deposited']} structures as deposited and {n['relaxed']} relaxed models: {'; '.join(parts)}.",
        f"Ends beyond 2 angstrom at {TOLERANCE:g}: {counts}.",
    )


@table("near-basins")
def near_basins(results: Path) -> str:
    """Share of ends in the minimum to which steepest descent leads."""
    rows = pd.read_csv(results / "near_basins.csv")
    met = rows[rows["apart_angstrom"].notna()].astype({"same": bool})
    of = met.groupby("method", sort=False)
    shares = pd.DataFrame({"same": of["same"].sum(), "n": of.size(), "apart": of["apart_angstrom"].median(),
                           "above": of["above_kj_mol"].median()}).reset_index()  # fmt: skip
    return of_rows(
        shares, ("method", "`{method}`"), ("in the minimum of steepest descent", "{same} of {n}"),
        ("median distance from it, angstrom (all atoms)", "{apart:.2f}"),
        ("median energy above it, kJ/mol", "{above:+.1f}"),
    )  # fmt: skip
