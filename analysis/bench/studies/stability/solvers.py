"""Error and run time of M^-1 tau by three algorithms.

The error is the backward error, in units of machine precision.
"""

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from time import perf_counter

import numpy as np
import pandas as pd

from bench.cost import in_turn
from bench.lines import draw_lines
from bench.studies.precision.solvers import SOLVERS, Solver, backward_error, dense, posed
from protochain.mechanics.multibody import HingeKind, multiply_mass, solve_mass
from protochain.results.figures import Figure, outside
from protochain.results.tables import save

DENSE_UP_TO = 3000
REPEATS = 200
SIZES = (10, 30, 100, 300, 1000, 3000, 10_000, 100_000)


ROUTES: dict[str, Solver] = {"dense Cholesky": dense, "articulated": solve_mass, "fixman": SOLVERS["Fixman"]}


def error_against_time() -> pd.DataFrame:
    """Errors and times of all routes on random serial chains with a free root, by size."""
    rows = []
    for n in SIZES:
        tree, frames, tau = posed(n)
        for name, route in ROUTES.items():
            if name == "dense Cholesky" and n > DENSE_UP_TO:
                continue
            x = route(tree, frames, tau)
            (taken,) = in_turn([partial(route, tree, frames, tau)], 0.5, 3, clock=perf_counter)
            residual = np.linalg.norm(multiply_mass(tree, frames, x) - tau) / np.linalg.norm(tau)
            rows.append((n, name, 1e3 * taken.median, backward_error(tree, frames, x, tau), residual))
    columns = ["bodies", "route", "ms", "backward_error_eps", "relative_residual"]
    return pd.DataFrame(rows, columns=columns)


def crossover() -> int:
    """Number of bodies from which the articulated-body algorithm is always faster than the dense matrix."""
    slower = 0
    for n in range(2, 61, 2):
        tree, frames, tau = posed(n, HingeKind.REVOLUTE)
        calls = [partial(route, tree, frames, tau) for route in (solve_mass, dense)]
        ours, other = in_turn(calls, turns=REPEATS, clock=perf_counter)
        if other.median <= ours.median:
            slower = n
    return slower + 2


def plot(table: pd.DataFrame) -> Figure:
    """Run time and error against the number of bodies."""
    figure = Figure(figsize=(7, 3.2), layout="constrained")
    axes = figure.subplots(1, 2)
    for ax, column, label in zip(
        axes, ("ms", "backward_error_eps"), ("ms", "backward error, eps"), strict=True
    ):
        draw_lines(ax, table, "bodies", column, "route")
        ax.set_ylabel(label)
    outside(axes)
    figure.suptitle("M^-1 tau of random serial chains")
    return figure


def write_solvers(output: Path) -> Iterator[pd.DataFrame]:
    """Measure the solvers; write ``error_against_time.csv`` with its plot, and yield the tables."""
    table = error_against_time()
    save(output, {"error_against_time.csv": table, "error_against_time.png": plot(table)})
    yield table
    yield pd.DataFrame({"hinges_from_which_articulated_is_quicker_than_dense": [crossover()]})
