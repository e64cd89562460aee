"""Energies at equal cost, the cost to approach the lowest end, and the spread of the runs of each method."""

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np
import pandas as pd

from protochain.minimisers import Solution, Status
from protochain.results.columns import Column
from protochain.structure import ca_rmsd


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


def spreads(solutions: Sequence[Solution], repeats: Sequence[Solution]) -> pd.DataFrame:
    """Spread of each method over its solution and its further runs, one row per method."""
    runs = [[s, *(r for r in repeats if r.method == s.method)] for s in solutions]
    return pd.DataFrame([{column.key: column.value(group) for column in SPREAD_COLUMNS} for group in runs])


def _farthest_ends(runs: Sequence[Solution]) -> float:
    pairs = combinations(runs, 2)
    return max((ca_rmsd(runs[0].structure, a.x, b.x) for a, b in pairs), default=0.0)


SPREAD_COLUMNS = (
    Column("method", lambda runs: runs[0].method),
    Column("runs", len, kind=int),
    Column(
        "repeats_exactly", lambda runs: runs[0].recipe.repeats_exactly(runs[0].energy_function), kind=bool
    ),
    Column("converged", lambda runs: sum(s.status is Status.CONVERGED for s in runs), kind=int),
    Column("energy_lowest_kj_mol", lambda runs: min(s.end.energy for s in runs)),
    Column("energy_median_kj_mol", lambda runs: float(np.median([s.end.energy for s in runs]))),
    Column("energy_highest_kj_mol", lambda runs: max(s.end.energy for s in runs)),
    Column("ca_rmsd_between_angstrom", _farthest_ends),
    Column(
        "evaluations_median",
        lambda runs: float(np.median([s.n_evaluations for s in runs])),
        kind=float | None,
    ),
    Column("seconds_median", lambda runs: float(np.median([s.seconds for s in runs]))),
)
"""Columns of the runs of one method from one start."""
