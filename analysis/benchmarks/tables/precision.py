"""Tables of the curves of error against run time; errors only, which no other work on the machine changes."""

import pandas as pd

from tables import markdown, table

USED = (
    ("solvers", "M x = tau, {n} freedoms", "300 bodies", "articulated", ""),
    ("energies", "forces, all pairs, {n} atoms", "obc2, against all pairs", "native", "all pairs"),
    ("energies", "the same with a cutoff of 2 nm", "obc2, against all pairs", "native", "2 nm"),
    ("integrators", "angles after 128 fs, leapfrog of 4 fs", "angles", "leapfrog", "4 fs"),
    ("integrators", "the same, Kutta's method", "angles", "rk4", "4 fs"),
    ("integrators", "total energy, leapfrog of 4 fs", "total energy", "leapfrog", "4 fs"),
    ("sampling", "temperature, {evaluations:,.0f} steps of 5 fs", "temperature", "langevin, 5 fs", None),
    ("sampling", "distribution of a dihedral, the same run", "distribution", "langevin, 5 fs", None),
    ("closures", "closed loop after a step of 4 fs", "distances after one step", "4 fs", None),
    ("closures", "accelerations under a closed loop", "accelerations", "articulated", None),
    ("fixman", "ln det M, {n} freedoms", "ln det M", "articulated", None),
    ("fixman", "its gradient, {n} freedoms", "gradient of ln det M, 100", "O(n) gradient", ""),
    ("hessians", "product with the Hessian, as `newton` takes it", "YGGFM, obc2", "one-sided", "1e-05 rad"),
)
"""Kind, how it is named, how its case begins, method, and setting: the last of several by default."""


def _shown(error: float, unit: str) -> str:
    return f"{error:.1e}" + {"1": ", relative"}.get(unit, f" {unit}")


@table("curves-short", "precision_curves.csv")
def curves_short(points: pd.DataFrame) -> str:
    """Errors of what is used by default."""
    points, rows = points.fillna({"setting": ""}), []
    for kind, named, case, method, setting in USED:
        of = points[(points["kind"] == kind) & points["case"].str.startswith(case)]
        of = of[of["method"] == method]
        point = of[of["setting"] == setting].iloc[-1] if setting is not None else of.iloc[-1]
        shown = _shown(point["error"], point["unit"])
        rows.append([named.format(**point), f"`{kind}`", shown, point["source"]])
    return markdown(("what", "kind", "error", "compared with"), rows)


@table("curves", "precision_curves.csv")
def curves(points: pd.DataFrame) -> str:
    """Least error of each method, by case."""
    points, rows = points.fillna({"setting": ""}), []
    for (kind, case), of in points.groupby(["kind", "case"], sort=False):
        largest = of[of["n"] == of["n"].max()]
        least = largest.loc[largest.groupby("method", sort=False)["error"].idxmin()]
        cell = "; ".join(
            f"{r['method']} {r['error']:.1e}" + (f" ({r['setting']})" if r["setting"] else "")
            for _, r in least.iterrows()
        )
        unit = "relative" if of["unit"].iloc[0] == "1" else of["unit"].iloc[0]
        rows.append([f"`{kind}`", case, of["n"].max(), unit, cell])
    return markdown(("kind", "case", "size", "error", "least of each method, and its setting"), rows)
