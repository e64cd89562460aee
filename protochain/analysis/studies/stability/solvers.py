"""Error and run time of M^-1 tau by three algorithms.

The error is the backward error |M x - tau| / (|M| |x| + |tau|) in units of machine precision, with M x by
Newton-Euler and |M| by ten steps of the power method: O(n), so that long chains need no dense matrix.
"""

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from statistics import median
from time import perf_counter

import numpy as np
import pandas as pd
from scipy.linalg import cho_factor, cho_solve

from protochain.analysis.plots import Figure
from protochain.multibody import (
    Frames,
    HingeKind,
    Tree,
    mass_matrix,
    multiply_mass,
    pose,
    random_tree,
    solve_mass,
)
from protochain.storage import write_atomically

EPS = np.finfo(float).eps
DENSE_UP_TO = 3000
REPEATS = 200
SIZES = (10, 30, 100, 300, 1000, 3000, 10_000, 100_000)


def dense(tree: Tree, frames: Frames, tau: np.ndarray) -> np.ndarray:
    """Composite-rigid-body algorithm, then Cholesky: O(n^3)."""
    return cho_solve(cho_factor(mass_matrix(tree, frames)), tau)


def articulated(tree: Tree, frames: Frames, tau: np.ndarray) -> np.ndarray:
    """Articulated-body algorithm: O(n)."""
    return solve_mass(tree, frames, tau)


def fixman(tree: Tree, frames: Frames, tau: np.ndarray) -> np.ndarray:
    """Fixman's method with iterative refinement: O(n)."""
    return solve_mass(tree, frames, tau, "fixman")


ROUTES: dict[str, Callable[[Tree, Frames, np.ndarray], np.ndarray]] = {
    "dense Cholesky": dense,
    "articulated": articulated,
    "fixman": fixman,
}
STYLES = {"dense Cholesky": ("#D55E00", "o"), "articulated": ("#0072B2", "s"), "fixman": ("#009E73", "^")}


def norm_of_mass(tree: Tree, frames: Frames) -> float:
    """Largest eigenvalue of M, approached from below by the power method."""
    x = np.random.default_rng(1).normal(size=tree.n_v)
    for _ in range(10):
        x = multiply_mass(tree, frames, x / np.linalg.norm(x))
    return float(np.linalg.norm(x))


def backward_error(tree: Tree, frames: Frames, x: np.ndarray, tau: np.ndarray) -> float:
    """Backward error of x as M^-1 tau, in units of machine precision."""
    residual = np.linalg.norm(multiply_mass(tree, frames, x) - tau)
    return float(residual / (norm_of_mass(tree, frames) * np.linalg.norm(x) + np.linalg.norm(tau)) / EPS)


def error_against_time() -> pd.DataFrame:
    """Errors and times of all routes on random serial chains with a free root, by size."""
    rows = []
    for n in SIZES:
        tree = random_tree(n, n, 0.0, HingeKind.FREE)
        rng = np.random.default_rng(n)
        frames = pose(tree, rng.uniform(-3, 3, tree.n_q))
        tau = rng.normal(size=tree.n_v)
        for name, route in ROUTES.items():
            if name == "dense Cholesky" and n > DENSE_UP_TO:
                continue
            x = route(tree, frames, tau)
            times: list[float] = []
            while len(times) < 3 or (sum(times) < 0.5 and len(times) < 1000):
                began = perf_counter()
                route(tree, frames, tau)
                times.append(perf_counter() - began)
            residual = np.linalg.norm(multiply_mass(tree, frames, x) - tau) / np.linalg.norm(tau)
            rows.append(
                {
                    "bodies": n,
                    "route": name,
                    "ms": 1e3 * median(times),
                    "backward_error_eps": backward_error(tree, frames, x, tau),
                    "relative_residual": residual,
                }
            )
    return pd.DataFrame(rows)


def crossover() -> int:
    """Number of bodies from which the articulated-body algorithm is always faster than the dense matrix."""
    slower = 0
    for n in range(2, 61, 2):
        tree = random_tree(n, n, 0.0, HingeKind.REVOLUTE)
        rng = np.random.default_rng(n)
        frames, tau = pose(tree, rng.uniform(-3, 3, tree.n_q)), rng.normal(size=tree.n_v)
        taken: dict[str, list[float]] = {"articulated": [], "dense": []}
        for _ in range(REPEATS):
            for name, route in (("articulated", articulated), ("dense", dense)):
                began = perf_counter()
                route(tree, frames, tau)
                taken[name].append(perf_counter() - began)
        if median(taken["dense"]) <= median(taken["articulated"]):
            slower = n
    return slower + 2


def plot(table: pd.DataFrame) -> Figure:
    """Run time and error against the number of bodies."""
    figure = Figure(figsize=(10, 4), layout="constrained")
    for ax, column, label in zip(
        figure.subplots(1, 2), ("ms", "backward_error_eps"), ("ms", "backward error, eps"), strict=True
    ):
        for route, rows in table.groupby("route", sort=False):
            colour, marker = STYLES[str(route)]
            ax.loglog(rows["bodies"], rows[column], color=colour, marker=marker, label=str(route))
        ax.set_xlabel("bodies")
        ax.set_ylabel(label)
        ax.grid(True, alpha=0.25)
    figure.axes[0].legend(frameon=False)
    figure.suptitle("M^-1 tau of random serial chains")
    return figure


def write_solvers(output: Path) -> Iterator[pd.DataFrame]:
    """Measure the solvers; write ``error_against_time.csv`` with its plot, and yield the tables."""
    table = error_against_time()
    write_atomically(output / "error_against_time.csv", lambda to: table.to_csv(to, index=False))
    write_atomically(output / "error_against_time.png", partial(plot(table).savefig, dpi=150))
    yield table
    yield pd.DataFrame({"hinges_from_which_articulated_is_quicker_than_dense": [crossover()]})
