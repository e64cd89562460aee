"""Solutions of M x = tau: dense, by articulated bodies, by Fixman's method, by conjugate gradients."""

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from bench.cases import Point
from bench.cost import least_seconds
from bench.studies.precision.extended import DIGITS, wide_mass
from protochain.core.arrays import Floats
from protochain.mechanics.multibody import (
    Frames,
    HingeKind,
    Tree,
    mass_matrix,
    multiply_mass,
    pose,
    random_tree,
    solve_mass,
)  # fmt: skip
from protochain.mechanics.multibody.fixman import eliminate, respond, soft_rates

Solver = Callable[[Tree, Frames, Floats], Floats]


def dense(tree: Tree, frames: Frames, tau: Floats) -> Floats:
    """M by composite bodies, then Cholesky: O(n^3)."""
    return np.asarray(cho_solve(cho_factor(mass_matrix(tree, frames)), tau))


def refined(solver: Solver, tree: Tree, frames: Frames, tau: Floats) -> Floats:
    """Solve, then once more for what is left, with M x by Newton-Euler."""
    x = solver(tree, frames, tau)
    return x + solver(tree, frames, tau - multiply_mass(tree, frames, x))


def fixman_once(tree: Tree, frames: Frames, tau: Floats) -> Floats:
    """Fixman's method without the refinement that is part of it: x = (A - B H^-1 B^T) tau."""
    loads = np.zeros((tree.n_bodies, 6))
    for b, p in enumerate(tree.parent):
        k, size = tree.v_start[b], tree.v_start[b + 1] - tree.v_start[b]
        own = tau[k : k + 6].copy() if size == 6 else np.zeros(6)
        if size == 1:
            own[:3] = tau[k] * frames.rotation[b, :, 2]
        loads[b] += own
        if p >= 0:
            loads[p] -= own
    return soft_rates(tree, frames, respond(eliminate(tree, frames), loads))


def conjugate_gradients(steps: int, tree: Tree, frames: Frames, tau: Floats) -> Floats:
    """Some steps of conjugate gradients (Hestenes, Stiefel, 1952), with M x by Newton-Euler."""
    x, left = np.zeros_like(tau), tau.copy()
    along, size = left.copy(), left @ left
    for _ in range(steps):
        if size == 0.0:
            break
        product = multiply_mass(tree, frames, along)
        length = size / (along @ product)
        x, left = x + length * along, left - length * product
        before, size = size, left @ left
        along = left + (size / before) * along
    return x


SOLVERS: dict[str, Solver] = {
    "dense Cholesky": dense, "dense, refined": partial(refined, dense), "articulated": solve_mass,
    "articulated, refined": partial(refined, solve_mass), "Fixman, unrefined": fixman_once,
    "Fixman": partial(solve_mass, method="fixman"),
}  # fmt: skip


def posed(n: int, root: HingeKind = HingeKind.FREE) -> tuple[Tree, Frames, Floats]:
    """A random serial chain, in a random pose, with torques."""
    tree = random_tree(n, n, 0.0, root)
    rng = np.random.default_rng(n)
    return tree, pose(tree, rng.uniform(-3, 3, tree.n_q)), rng.normal(size=tree.n_v)


def norm_of_mass(tree: Tree, frames: Frames) -> float:
    """Largest eigenvalue of M, approached from below by the power method."""
    x = np.random.default_rng(1).normal(size=tree.n_v)
    for _ in range(10):
        x = multiply_mass(tree, frames, x / np.linalg.norm(x))
    return float(np.linalg.norm(x))


def backward_error(tree: Tree, frames: Frames, x: Floats, tau: Floats) -> float:
    """Backward error |M x - tau| / (|M| |x| + |tau|) of x as M^-1 tau, in units of machine precision.

    With M x by Newton-Euler and |M| by the power method: O(n), so that long chains need no dense matrix.
    """
    residual = np.linalg.norm(multiply_mass(tree, frames, x) - tau)
    return float(
        residual
        / (norm_of_mass(tree, frames) * np.linalg.norm(x) + np.linalg.norm(tau))
        / np.finfo(float).eps
    )


def measure(quick: bool) -> Iterator[Point]:
    """Error of the solution for short chains, backward error for long ones."""
    for n in (10, 30) if quick else (10, 30, 100, 300):
        tree, frames, tau = posed(n)
        exact = wide_mass(tree, frames).solve(tau)
        against = f"dense M, refined, in extended precision ({DIGITS})"
        steps = [n // 2, n, 2 * n, 4 * n, 8 * n, 16 * n]
        runs: list[tuple[str, str, Solver, float]] = [(k, "", f, np.nan) for k, f in SOLVERS.items()]
        runs += [
            ("conjugate gradients", f"{k} steps", partial(conjugate_gradients, k), float(k)) for k in steps
        ]
        for name, parameter, solver, products in runs:
            off = np.asarray(solver(tree, frames, tau) - exact, float)
            error = float(np.linalg.norm(off) / np.linalg.norm(exact.astype(float)))
            seconds = least_seconds(partial(solver, tree, frames, tau), 0.05)
            yield Point(name, parameter, seconds, error, f"{n} bodies", "1", against, products, tree.n_v)
    for n in (1000,) if quick else (1000, 10_000, 100_000):
        tree, frames, tau = posed(n)
        for name in ("articulated", "Fixman"):
            solver = SOLVERS[name]
            error = backward_error(tree, frames, solver(tree, frames, tau), tau)
            seconds = least_seconds(partial(solver, tree, frames, tau), 0.05)
            against = "M x by Newton-Euler"
            yield Point(
                name, f"{n} bodies", seconds, error, "long chains", "eps, backward", against, np.nan, tree.n_v
            )
