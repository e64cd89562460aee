"""Counts of the cells of the grid, and its picture."""

import numpy as np
import pandas as pd

from bench.cases import Outcome
from protochain.core.figure import INK
from protochain.core.palette import COLOURS
from protochain.results.figures import Figure


def counts(table: pd.DataFrame) -> pd.DataFrame:
    """Numbers of cells by row and verdict, and the seconds they took."""
    rows = [
        {"row": row, "cells": len(cells)}
        | {str(verdict): int((cells["verdict"] == verdict).sum()) for verdict in Outcome}
        | {"seconds": round(float(cells["seconds"].sum()), 1)}
        for row, cells in table.groupby("row", sort=False)
    ]
    return pd.DataFrame(rows)


_STYLES = {
    Outcome.RIGHT: (COLOURS[0], "o", 9),
    Outcome.REFUSED: (COLOURS[3], "_", 40),
    Outcome.WRONG: (COLOURS[1], "x", 40),
}
_LEAST = 1e-8
"""Of the bound: errors below are drawn there."""


def picture(table: pd.DataFrame) -> Figure:
    """Error of each cell over its bound, a line of dots for each case; refusals beyond the bound."""
    named = table[["row", "case"]].drop_duplicates()
    cases = list(zip(named["row"], named["case"], strict=True))
    figure = Figure(figsize=(7, 0.16 * len(cases) + 1.2), layout="constrained")
    ax = figure.subplots()
    place = {each: i for i, each in enumerate(cases)}
    y = np.array([place[each] for each in zip(table["row"], table["case"], strict=True)])
    # An error of 0 within a bound of 0: none.
    with np.errstate(invalid="ignore", divide="ignore"):
        share = (table["error"] / table["bound"]).where(table["error"] > 0, 0.0).to_numpy()
    x = np.clip(share, _LEAST, 1e2)
    for verdict, (colour, marker, size) in _STYLES.items():
        own = (table["verdict"] == verdict).to_numpy()
        at = x[own] if verdict is Outcome.RIGHT else np.full(own.sum(), 10.0)
        label = f"{verdict}: {own.sum()}"
        ax.scatter(at, y[own], s=size, c=colour, marker=marker, linewidths=1.2, label=label)
    for k, n in enumerate(np.bincount(y[(table["verdict"] == Outcome.REFUSED).to_numpy()])):
        if n:
            ax.text(16.0, k, str(n), fontsize=8, va="center", color=_STYLES[Outcome.REFUSED][0])
    ax.axvline(1.0, color=INK, lw=0.8)
    ax.set_xscale("log")
    ax.set_xlim(0.5 * _LEAST, 50)
    ax.set_yticks(range(len(cases)), [f"{case}  ({row})" for row, case in cases])
    ax.set_ylim(len(cases) - 0.5, -0.5)
    ax.set_xlabel(f"error / largest error that theory allows (line); at {_LEAST:g}: less, or none")
    figure.legend(loc="outside lower center", ncols=3)
    wrong = int((table["verdict"] == Outcome.WRONG).sum())
    are = f"{wrong} are" if wrong > 1 else f"{wrong or 'none'} is"
    figure.suptitle(f"Of {len(table):,} stiff and extreme cells {are} wrong")
    return figure
