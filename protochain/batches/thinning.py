"""Traces thinned: a batch keeps some points of each run."""

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import pandas as pd

TRACE_POINTS = 50
"""Rows kept of a trace: the first, the last, and others spaced evenly in the logarithm of their index."""


def thinned(trace: "pd.DataFrame") -> list[dict[str, float]]:
    """Return some rows of a trace, each without what it does not have."""
    n = len(trace)
    if n > TRACE_POINTS:
        places = np.unique(np.geomspace(1, n, TRACE_POINTS).astype(int)) - 1
        trace = trace.iloc[places]
    return [
        {str(key): value for key, value in row.items() if not np.isnan(value)}
        for row in trace.to_dict("records")
    ]
