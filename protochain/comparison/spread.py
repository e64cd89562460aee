"""Spread of the runs of each method."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np
import pandas as pd

from protochain.minimisers import Solution, Status
from protochain.results.columns import Column
from protochain.structure import ca_rmsd


def spreads(solutions: Sequence[Solution], repeats: Sequence[Solution]) -> pd.DataFrame:
    """Spread of each method over its solution and its further runs, one row per method."""
    runs = [[s, *(r for r in repeats if r.method == s.method)] for s in solutions]
    return pd.DataFrame([{column.key: column.value(solution) for column in COLUMNS} for solution in runs])


def _repeats_exactly(runs: Sequence[Solution]) -> bool:
    return runs[0].recipe.repeats_exactly(runs[0].energy_function)


def _distance(runs: Sequence[Solution]) -> float:
    """Largest C-alpha RMSD between two ends, angstrom."""
    pairs = combinations(runs, 2)
    return max((ca_rmsd(runs[0].structure, a.x, b.x) for a, b in pairs), default=0.0)


COLUMNS = (
    Column("method", lambda runs: runs[0].method),
    Column("runs", len, kind=int),
    Column("repeats_exactly", _repeats_exactly, kind=bool),
    Column("converged", lambda runs: sum(s.status is Status.CONVERGED for s in runs), kind=int),
    Column("energy_lowest_kj_mol", lambda runs: min(s.end.energy for s in runs)),
    Column("energy_median_kj_mol", lambda runs: float(np.median([s.end.energy for s in runs]))),
    Column("energy_highest_kj_mol", lambda runs: max(s.end.energy for s in runs)),
    Column("ca_rmsd_between_angstrom", _distance),
    Column(
        "evaluations_median",
        lambda runs: float(np.median([s.n_evaluations for s in runs])),
        kind=float | None,
    ),
    Column("seconds_median", lambda runs: float(np.median([s.seconds for s in runs]))),
)
"""Columns of the runs of one method from one start."""
