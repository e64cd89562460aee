"""Fixman's potential, ln det M, and its gradient."""

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

from bench.cases import Point
from bench.cost import least_seconds
from bench.studies.precision.differences import extrapolated
from bench.studies.precision.extended import DIGITS, WIDE, wide_frames, wide_mass
from protochain.core.arrays import Floats
from protochain.mechanics.multibody import (
    HingeKind,
    Tree,
    log_det_gradient,
    log_det_mass,
    mass_matrix,
    pose,
    random_tree,
)  # fmt: skip

HINGES = 6
"""Hinges along which the gradient is compared."""
Value = Callable[[Tree, Floats], float]


def dense(tree: Tree, q: Floats) -> float:
    """Value of ln det M by the dense matrix: O(n^3)."""
    return float(np.linalg.slogdet(mass_matrix(tree, pose(tree, q)))[1])


def articulated(tree: Tree, q: Floats) -> float:
    """Value of ln det M by the pivots of articulated bodies."""
    return log_det_mass(tree, pose(tree, q))


def by_fixman(tree: Tree, q: Floats) -> float:
    """Value of ln det M by the determinant of the locked directions."""
    return log_det_mass(tree, pose(tree, q), "fixman")


VALUES: dict[str, Value] = {"dense": dense, "articulated": articulated, "Fixman": by_fixman}


def measure(quick: bool) -> Iterator[Point]:
    """Error of the value by size, and of the gradient by rule and step."""
    for n in (10, 30) if quick else (10, 30, 100, 300):
        tree, q = _chain(n)
        exact = wide_mass(tree, wide_frames(tree, q)).log_det
        for name, value in VALUES.items():
            seconds = least_seconds(partial(value, tree, q), 0.05)
            against = f"dense matrix in extended precision ({DIGITS})"
            error = abs(float(value(tree, q) - exact))
            yield Point(name, f"{n} bodies", seconds, error, "ln det M", "1", against, np.nan, tree.n_v)
    for n in (10,) if quick else (10, 100):
        yield from _gradients(n, quick)


def _gradients(n: int, quick: bool) -> Iterator[Point]:
    tree, q = _chain(n)
    hinges = tree.hinge_bodies[np.linspace(0, len(tree.hinge_bodies) - 1, HINGES).astype(int)]
    places = tree.q_start[hinges]
    found = [extrapolated(partial(_wide_along, tree, q, k), WIDE(0.02)) for k in places]
    exact, left = np.array([float(value) for value, _ in found]), max(error for _, error in found)
    size = float(np.abs(exact).max())
    against = f"extrapolated differences in extended precision, which agree to {left / size:.0e}"
    case, evaluations = f"gradient of ln det M, {n} bodies", 2.0 * len(tree.hinge_bodies)

    def off(gradient: Floats) -> float:
        return float(np.abs(gradient - exact).max()) / size

    seconds = least_seconds(lambda: log_det_gradient(tree, pose(tree, q)), 0.05)
    ours = log_det_gradient(tree, pose(tree, q))[tree.v_start[hinges]]
    yield Point("O(n) gradient", "", seconds, off(ours), case, "1", against, 1, tree.n_v)
    each = least_seconds(partial(articulated, tree, q), 0.05)
    for h in 10.0 ** -np.arange(1, 8, 2 if quick else 1, dtype=float):
        by_differences = np.array([_difference(tree, q, k, h) for k in places])
        error = off(by_differences)
        # Of all hinges, though only some are compared.
        cost = each * evaluations
        yield Point(
            "central differences", f"{h:g} rad", cost, error, case, "1", against, evaluations, tree.n_v
        )


def _chain(n: int) -> tuple[Tree, Floats]:
    tree = random_tree(n, n, 0.0, HingeKind.FREE)
    return tree, np.random.default_rng(n).uniform(-3, 3, tree.n_q)


def _wide_along(tree: Tree, q: Floats, k: int, h: np.longdouble) -> np.longdouble:
    moved = q.astype(WIDE)
    moved[k] += h
    return wide_mass(tree, wide_frames(tree, moved)).log_det


def _difference(tree: Tree, q: Floats, k: int, h: float) -> float:
    up, down = q.copy(), q.copy()
    up[k] += h
    down[k] -= h
    return (articulated(tree, up) - articulated(tree, down)) / (2 * h)
