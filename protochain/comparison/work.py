"""Energies at equal cost, and the cost to approach the lowest end, in evaluations and in seconds."""

from collections.abc import Mapping

import numpy as np
import pandas as pd


def at_equal_cost(traces: pd.DataFrame) -> pd.DataFrame:
    """Lowest energy so far of each method at equal evaluations and at equal seconds."""
    parts = []
    for cost in ("evaluations", "seconds"):
        grid = _grid(traces[cost])
        part = pd.DataFrame({"cost": cost, "at": grid})
        for method, run in traces.groupby("method", sort=False):
            best = run["energy_kj_mol"].cummin().to_numpy()
            last = np.searchsorted(run[cost].to_numpy(), grid, side="right") - 1
            part[str(method)] = np.where(last >= 0, best[np.maximum(last, 0)], np.nan)
        parts.append(part)
    return pd.concat(parts, ignore_index=True)


WITHIN = (100.0, 10.0, 1.0)
"""kJ/mol above the lowest end. 1 counts as the same minimum."""


def work_to_reach(traces: pd.DataFrame, lowest: Mapping[str, float]) -> pd.DataFrame:
    """Evaluations and seconds until each method first reached ``WITHIN`` above the lowest end."""
    # lowest kJ/mol.
    rows = []
    for method, run in traces.groupby("method", sort=False):
        row: dict[str, object] = {"method": method, "lowest_kj_mol": lowest[str(method)]}
        for cost in ("evaluations", "seconds"):
            for near in WITHIN:
                met = run.loc[run["energy_kj_mol"] <= lowest[str(method)] + near, cost]
                row[f"{cost}_within_{near:g}_kj_mol"] = np.nan if met.empty else met.iloc[0]
        rows.append(row)
    return pd.DataFrame(rows)


def _grid(costs: pd.Series) -> np.ndarray:
    """Values 1, 3, 10, 30 ... that span the costs."""
    positive = costs[costs > 0]
    if positive.empty:
        return np.zeros(0)
    low, high = (np.floor(np.log10(value)) for value in (positive.min(), positive.max()))
    grid = np.array([f * 10.0**k for k in np.arange(low, high + 1) for f in (1.0, 3.0)])
    inside = grid[(grid >= positive.min()) & (grid < positive.max())]
    return np.append(inside, positive.max())
