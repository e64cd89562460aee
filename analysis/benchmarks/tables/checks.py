"""What the tests would notice, and the grid of stiff and extreme cases."""

import pandas as pd

from tables import markdown, table, table_of_rows


@table("stability-grid", "stability_cells.csv")
def stability_grid(cells: pd.DataFrame) -> str:
    """Verdicts of the grid by row, with the largest error of its bound."""
    share = (cells["error"] / cells["bound"]).where(cells["error"] > 0, 0.0)

    def line(name: str, own: pd.DataFrame) -> tuple[str, ...]:
        worst = cells.loc[share[own.index].idxmax()]
        counted = (f"{(own['verdict'] == v).sum()}" for v in ("right", "refused", "wrong"))
        what = f"{share[own.index].max():.2g} of its bound ({worst['case']}, {worst['parameters']})"
        return name, f"{len(own)}", *counted, what

    rows = [line(str(name), own) for name, own in cells.groupby("row", sort=False)]
    heads = ("row", "cells", "right", "refused, as expected", "wrong", "largest error")
    return markdown(heads, [*rows, line("all", cells)])


table_of_rows(
    "mutants", "mutants_score.csv",
    ("folder", "`{folder}`"), ("noticed", "{noticed}"), ("excused", "{excused}"),
    ("not noticed", "{survived}"), ("share", "{share:.2f}"), ("interval", "{low:.2f} to {high:.2f}"),
    ("commit", "{commit}"),
)  # fmt: skip
table_of_rows(
    "mutants-semantic", "mutants_semantic_score.csv",
    ("kind of fault", "{kind}"), ("noticed", "{noticed}"), ("excused", "{excused}"),
    ("not noticed", "{survived}"), ("share", "{share:.2f}"), ("interval", "{low:.2f} to {high:.2f}"),
    ("commit", "{commit}"),
)  # fmt: skip
