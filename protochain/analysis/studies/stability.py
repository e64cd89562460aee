"""Error and run time of M^-1 tau by three algorithms, and their accuracy in stiff and extreme cases.

The error is the backward error |M x - tau| / (|M| |x| + |tau|) in units of machine precision, with M x by
Newton-Euler and |M| by ten steps of the power method: O(n), so that long chains need no dense matrix.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from statistics import median
from time import perf_counter

import numpy as np
import pandas as pd
from scipy.linalg import cho_factor, cho_solve

from protochain.analysis.plots import Figure
from protochain.errors import MechanicsError, ProtochainError
from protochain.multibody import (
    Frames,
    HingeKind,
    Tree,
    mass_matrix,
    multiply_mass,
    pose,
    random_tree,
    rigid_bodies,
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
    """Fixman's method with one step of refinement: O(n)."""
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


def beads(n: int, shared: bool, angle: float = 70.0) -> Tree:
    """Chain of equal beads with free torsions: each bead beyond the third is a body of its own.

    With ``shared``, a bead on the axes of neighbouring hinges gives a third of its mass to each of the three
    bodies in which it is at rest, so that every rotational inertia has full rank.
    """
    turn = np.deg2rad(180.0 - angle)
    parent, kind = np.arange(-1, n - 3), np.full(n - 2, HingeKind.REVOLUTE)
    kind[0] = HingeKind.FREE
    # Body b holds bead b + 2 at the end of a bond; its hinge is the bond before, along z.
    bend = np.array([[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]])
    placement = np.tile(bend, (n - 2, 1, 1))
    placement[0] = np.eye(3)
    bond = 0.15
    tip = bond * bend[:, 2]
    offset = np.tile(tip, (n - 2, 1))
    offset[0] = 0.0
    body = np.repeat(np.arange(n - 2), 3)
    local = np.tile([[0.0, 0.0, -bond], [0.0, 0.0, 0.0], tip], (n - 2, 1))
    bead = (np.arange(n - 2)[:, None] + np.arange(3)).ravel()
    if shared:
        mass = 12.0 / np.bincount(bead)[bead]
    else:
        first = (body == 0) | (np.tile([0, 0, 1], n - 2) == 1)
        body, local, mass = body[first], local[first], np.full(first.sum(), 12.0)
    return Tree(parent, kind, offset, placement, *rigid_bodies(body, local, mass, n - 2))


def nearly_collinear(degrees: float) -> Tree:
    """Chain of thirty bodies, the last at this angle from its hinge's axis."""
    tree = random_tree(30, 4, 0.0, HingeKind.FREE)
    away = np.deg2rad(degrees)
    points = np.array([[0.0, 0.0, 0.05], [0.1 * np.sin(away), 0.0, 0.1 * np.cos(away)]])
    mass, com, inertia = rigid_bodies(np.zeros(2, dtype=np.int64), points, np.array([12.0, 1.0]), 1)
    all_mass, all_com, all_inertia = tree.mass.copy(), tree.com.copy(), tree.inertia.copy()
    all_mass[-1], all_com[-1], all_inertia[-1] = mass[0], com[0], inertia[0]
    return replace(tree, mass=all_mass, com=all_com, inertia=all_inertia)


def mass_ratio(ratio: float) -> Tree:
    """Branched tree of a hundred bodies, every other one heavier or lighter by a factor."""
    tree = random_tree(100, 6, 0.3, HingeKind.FREE)
    factor = np.where(np.arange(100) % 2, ratio, 1.0)
    return replace(tree, mass=tree.mass * factor, inertia=tree.inertia * factor[:, None, None])


CASES: dict[str, Callable[[], Tree]] = {
    **{f"mass ratio {r:g}": partial(mass_ratio, r) for r in (1e-6, 1e-3, 1e3, 1e6)},
    **{
        f"last body {d:g} degrees off its axis": partial(nearly_collinear, d)
        for d in (5.0, 0.1, 1e-3, 1e-5, 1e-7, 0.0)
    },
    "100 beads, each a body of one atom": lambda: beads(100, shared=False),
    "100 beads, masses shared": lambda: beads(100, shared=True),
    "100 beads nearly straight (179.9 degrees), shared": lambda: beads(100, shared=True, angle=179.9),
    "10,000 beads, masses shared": lambda: beads(10_000, shared=True),
    "100,000 beads, masses shared": lambda: beads(100_000, shared=True),
    "serial chain of 1,000,000": lambda: random_tree(1_000_000, 1, 0.0, HingeKind.FREE),
}


def extremes() -> pd.DataFrame:
    """Backward error of each route in each case, or its error message."""
    rows: list[dict[str, object]] = []
    for case, build in CASES.items():
        row: dict[str, object] = {"case": case}
        try:
            tree = build()
        except MechanicsError as error:
            rows.append({"case": case, **dict.fromkeys(ROUTES, f"refused: {error}")})
            continue
        rng = np.random.default_rng(7)
        q = rng.uniform(-3, 3, tree.n_q)
        frames, tau = pose(tree, q), rng.normal(size=tree.n_v)
        for name, route in ROUTES.items():
            if name == "dense Cholesky" and tree.n_v > DENSE_UP_TO:
                row[name] = "-"
                continue
            try:
                row[name] = f"{backward_error(tree, frames, route(tree, frames, tau), tau):.2g} eps"
            except (MechanicsError, np.linalg.LinAlgError) as error:
                row[name] = f"refused: {error}"
        rows.append(row)
    return pd.DataFrame(rows)


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


def run(output: Path, inputs: Sequence[Path] = ()) -> Iterator[pd.DataFrame]:
    """Run both parts; write ``error_against_time.csv`` with its plot, and ``extremes.csv``.

    Parameters
    ----------
    output : Path
        Folder.
    inputs : sequence of Path
        Must be empty: the chains are random.

    Yields
    ------
    pandas.DataFrame
        Each table, when it is written.
    """
    if inputs:
        raise ProtochainError("stability: builds its own chains; give no files")
    table = error_against_time()
    write_atomically(output / "error_against_time.csv", lambda to: table.to_csv(to, index=False))
    write_atomically(output / "error_against_time.png", partial(plot(table).savefig, dpi=150))
    yield table
    yield pd.DataFrame({"hinges_from_which_articulated_is_quicker_than_dense": [crossover()]})
    cases = extremes()
    write_atomically(output / "extremes.csv", lambda to: cases.to_csv(to, index=False))
    yield cases
