"""What a curve is: points of error against cost, their table, their picture and what they say."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from matplotlib.ticker import NullFormatter

from bench.cases import CURVES, Point, table
from bench.lines import draw_lines
from protochain.results.figures import Figure, outside

_LEAST = 1e-21
"""Where an error of nothing is drawn, on a logarithmic axis."""


@dataclass(frozen=True)
class Kind:
    """Something that approximates or iterates.

    title: Heading of its part of the page.
    measured: One sentence: what is measured, and on what.
    measure: Whether it must be quick -> points.
    """

    title: str
    measured: str
    measure: Callable[[bool], Iterable[Point]]


def points_of(name: str, points: Iterable[Point]) -> pd.DataFrame:
    """Points of a kind as a table."""
    own = table(points, CURVES)
    own.insert(0, "kind", name)
    return own


def said(points: pd.DataFrame) -> list[str]:
    """What each case of a kind says: which setting comes closest, which is quickest, and how errors fall."""
    return [_said(str(case), own) for case, own in points.groupby("case", sort=False)]


def _said(case: str, points: pd.DataFrame) -> str:
    if points["n"].nunique() > 1:
        points = points[points["n"] == points["n"].max()]
        case = f"{case}, the largest"
    sound = points[np.isfinite(points["error"])]
    if sound.empty:
        return f"{case}: no setting gave a finite error."
    # Of equal errors the cheaper.
    closest = sound.sort_values(["error", "seconds"], kind="stable").iloc[0]
    quickest = sound.sort_values(["seconds", "error"], kind="stable").iloc[0]
    against = ", ".join(dict.fromkeys(sound["source"]))
    text = (
        f"{case}: of {_number(len(points), 'setting')} of {_number(points['method'].nunique(), 'method')}, "
    )
    text += f"{_setting(closest)} comes closest, with an error of {_error(closest)} for {_cost(closest)}"
    if quickest.name != closest.name:
        text += f"; {_setting(quickest)} is the quickest, with {_error(quickest)} for {_cost(quickest)}"
    lost = len(points) - len(sound)
    text += f"; {lost} gave no result" if lost else ""
    return f"{text}. Held against {against}."


def _number(n: int, what: str) -> str:
    return f"{n} {what}" if n == 1 else f"{n} {what}s"


def _setting(point: pd.Series) -> str:
    return f"{point['method']} ({point['setting']})" if point["setting"] else str(point["method"])


def _error(point: pd.Series) -> str:
    return f"{point['error']:.1e}" + ("" if point["unit"] == "1" else f" {point['unit']}")


def _cost(point: pd.Series) -> str:
    counted = np.isfinite(point["evaluations"])
    return f"{point['seconds']:.1e} s" + (
        f" and {_number(int(point['evaluations']), 'evaluation')}" if counted else ""
    )


def plot(points: pd.DataFrame, title: str) -> Figure:
    """Error against seconds, and against evaluations where they differ: a row of panels for each case."""
    cases: Sequence[tuple[object, pd.DataFrame]] = list(points.groupby("case", sort=False))
    counted = [case for case, own in cases if _counts(own)]
    costs = ["seconds"] + (["evaluations"] if counted else [])
    figure = Figure(figsize=(3.6 * len(costs), 0.6 + 2.5 * len(cases)), layout="constrained")
    grid = figure.subplots(len(cases), len(costs), squeeze=False)
    for row, (case, own) in zip(grid, cases, strict=True):
        for ax, cost in zip(row, costs, strict=True):
            if cost == "evaluations" and case not in counted:
                ax.set_visible(False)
                continue
            draw_lines(ax, own, cost, least=_LEAST)
            unit = own["unit"].iloc[0]
            ax.set(title=str(case), ylabel="relative error" if unit == "1" else f"error, {unit}")
            ax.xaxis.set_minor_formatter(NullFormatter())
    outside(grid.ravel())
    figure.suptitle(title)
    return figure


def _counts(points: pd.DataFrame) -> bool:
    """Whether evaluations are a cost to compare by: all methods have them, and not the same."""
    return bool(points["evaluations"].notna().all() and points["evaluations"].nunique() > 1)
