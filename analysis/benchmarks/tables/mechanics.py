"""The mass matrix, mechanisms, and searches for contacts."""

import numpy as np
import pandas as pd

from tables import Cell, markdown, table, table_of_rows


def _against(own: str, other: str) -> Cell:
    """Column of times with their ratio to ours."""
    return lambda r: "-" if pd.isna(r[other]) else f"{r[other]:.1f} ({r[other] / r[own]:.2f}x)"


table_of_rows(
    "mechanics-scaling", "mechanics_scaling.csv",
    ("hinges", "{hinges:.0f}"), ("forward dynamics ns per hinge", "{ns_per_hinge:.0f}"),
    ("bytes per hinge", "{bytes_per_hinge:.0f}"),
)  # fmt: skip
table_of_rows(
    "mechanics", "mechanics.csv",
    ("hinges", "{hinges:.0f}"), ("forward dynamics us", "{forward_us:.1f}"),
    ("pin.aba", _against("forward_us", "pinocchio_us")), ("DART", _against("forward_us", "dart_us")),
    ("M^-1 tau us", "{solve_us:.1f}"), ("pin.aba", _against("solve_us", "pinocchio_us")),
)  # fmt: skip

table_of_rows(
    "mechanics-steps", "mechanics_steps.csv",
    ("hinges", "{hinges:,.0f}"), ("damped", lambda r: "yes" if r.damped else "no"),
    ("a step us", "{step_us:.0f}"), ("MuJoCo", _against("step_us", "mujoco_us")),
    ("build s", "{build_s:.2g}"),
)  # fmt: skip


@table("stability", "stability.csv")
def stability(rows: pd.DataFrame) -> str:
    """Time and backward error of M^-1 tau by three algorithms."""
    rows = rows.set_index(["bodies", "route"])
    names = {"dense Cholesky": "dense Cholesky", "articulated": "articulated", "fixman": "Fixman"}

    def shown(n: int, route: str) -> str:
        if (n, route) not in rows.index:
            return "-"
        r = rows.loc[(n, route)]
        ms = f"{r.ms:.2g} ms" if r.ms < 99.5 else f"{r.ms / 1000:.2g} s"
        return f"{ms}, {r.backward_error_eps:.1g}"

    sizes = [n for n in (10, 100, 1000, 10_000, 100_000) if n in rows.index.get_level_values(0)]
    return markdown(
        ("bodies", *names.values()), ((f"{n:,}", *(shown(n, route) for route in names)) for n in sizes)
    )


def _extremes(row: pd.Series) -> str:
    return ", ".join(f"{row[name]} {name}" for name in ("right", "refused", "wrong") if row[name]) or "-"


table_of_rows(
    "mechanisms", "mechanisms.csv",
    ("scene", "`{scene}`: {title}"), ("CPU seconds", "{seconds:.0f}"), ("checks", "{checks}"),
    ("nearest to its bound", "{nearest}"), ("error", "{error:.1e}"), ("bound", "{bound:.0e}"),
    ("extremes", _extremes), ("most saved by leaving out", "{saved:.2g}x"),
)  # fmt: skip


@table("loops", "loops.csv")
def loops(rows: pd.DataFrame) -> str:
    """Seconds of the four-bar by error and method."""
    found = rows[rows["error"] < np.inf].sort_values(["method", "seconds"])
    return markdown(
        ("method", "setting", "error, rad", "CPU seconds", "by MuJoCo's at that error"),
        ((r.method, r.setting, f"{r.error:.1e}", f"{r.seconds:.2g}",
          "-" if pd.isna(r.times_mujoco) else f"{r.times_mujoco:.2g}") for r in found.itertuples()),
    )  # fmt: skip


table_of_rows(
    "loops-costs", "loops_costs.csv",
    ("loops", "{loops:.0f}"), ("bodies", "{bodies:.0f}"),
    ("accelerations us", lambda r: f"{1e6 * r.seconds:.0f}"),
    ("of the open tree us", lambda r: f"{1e6 * r.seconds_open:.0f}"),
)  # fmt: skip


table_of_rows(
    "loads",
    "loads_costs.csv",
    ("load", "{load}"),
    ("us of a step", "{us_per_step:.1f}"),
    ("by the arm without loads", "{ratio:.2f}"),
)


table_of_rows(
    "guide", "guide.csv",
    ("mechanism", "{mechanism}"), ("lines", "{lines}"), ("against", "{against}"), ("error", "{error:.1e}"),
    ("of", "{largest:.2g}"), ("energy that is no work", "{energy:.0e}"),
)  # fmt: skip


@table("search", "search.csv")
def search(rows: pd.DataFrame) -> str:
    """Cost of searches for contacts by size."""
    exponents = rows.groupby("search")["exponent"].first()
    wide = rows.pivot(index="search", columns="bodies", values="ns_each").map("{:.0f}".format)
    heads = ("search", *(f"{n:,}" for n in wide.columns), "exponent")
    return markdown(heads, ((name, *row, f"{exponents[name]:.2f}") for name, row in wide.iterrows()))


table_of_rows(
    "search-lists", "search_lists.csv",
    ("structure", "{structure}"), ("atoms", "{atoms}"), ("distance nm", "{distance_nm:.1f}"),
    ("pairs", "{pairs:,}"), ("cells ms", "{cells_ms:.2f}"), ("lists ms", "{lists_ms:.2f}"),
    ("lists over cells", "{ratio:.1f}"),
)  # fmt: skip
