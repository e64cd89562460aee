"""Spread of the runs of each method."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np
import pandas as pd

from protochain.minimisers import Solution, Status
from protochain.structure import ca_rmsd


def spread(runs: Sequence[Solution]) -> dict[str, object]:
    """Measure the spread of the runs of one method from one start."""
    first = runs[0]
    energies = [s.end.energy for s in runs]
    apart = [ca_rmsd(first.structure, a.x, b.x) for a, b in combinations(runs, 2)]
    return {
        "method": first.method,
        "runs": len(runs),
        "repeats_exactly": first.recipe.repeats_exactly(first.energy_function),
        "converged": sum(s.status is Status.CONVERGED for s in runs),
        "energy_lowest_kj_mol": min(energies),
        "energy_median_kj_mol": float(np.median(energies)),
        "energy_highest_kj_mol": max(energies),
        "ca_rmsd_between_angstrom": max(apart, default=0.0),
        "evaluations_median": float(np.median([s.n_evaluations for s in runs])),
        "seconds_median": float(np.median([s.seconds for s in runs])),
    }


def spreads(solutions: Sequence[Solution], repeats: Sequence[Solution]) -> pd.DataFrame:
    """Spread of each method, from its solution and its further runs: one row per method."""
    return pd.DataFrame([spread([s, *(r for r in repeats if r.method == s.method)]) for s in solutions])
