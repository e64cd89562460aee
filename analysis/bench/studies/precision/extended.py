"""Mechanics in extended precision: dense, slow, written from the definitions, for studies to be held against.

Its precision is numpy's ``longdouble``: 64 bits of mantissa on x86, on some machines no more than a double.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from protochain.mechanics.multibody import Frames, HingeKind, Tree

WIDE = np.longdouble
_REFINEMENTS = 3
DIGITS = f"{np.finfo(WIDE).nmant + 1} bits"


def wide_frames(tree: Tree, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotations (nb, 3, 3) and origins (nb, 3) of the bodies' frames at coordinates q (n_q,).

    Hinges turn (REVOLUTE) or are free; other kinds are not needed here.
    """
    turn, at = np.zeros((tree.n_bodies, 3, 3), WIDE), np.zeros((tree.n_bodies, 3), WIDE)
    for b, p in enumerate(tree.parent):
        above, origin = (turn[p], at[p]) if p >= 0 else (np.eye(3, dtype=WIDE), np.zeros(3, WIDE))
        at[b] = origin + above @ tree.offset[b].astype(WIDE)
        k, own = tree.q_start[b], np.eye(3, dtype=WIDE)
        if tree.kind[b] == HingeKind.FREE:
            w, x, y, z = np.asarray(q[k : k + 4], WIDE) / np.sqrt(np.sum(np.asarray(q[k : k + 4], WIDE) ** 2))
            cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]], WIDE)
            own = own + 2 * w * cross + 2 * cross @ cross
            at[b] += above @ tree.placement[b].astype(WIDE) @ np.asarray(q[k + 4 : k + 7], WIDE)
        elif tree.kind[b] == HingeKind.REVOLUTE:
            c, s = np.cos(WIDE(q[k])), np.sin(WIDE(q[k]))
            own = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]], WIDE)
        turn[b] = above @ tree.placement[b].astype(WIDE) @ own
    return turn, at


@dataclass(frozen=True, eq=False)
class WideMass:
    """Mass matrix, the sum over bodies of J^T I J.

    spin, flow (nb, 3, n_v): Angular velocities of the bodies, and velocities of their centres of mass, for
        unit rates.
    mass, inertia (nb,): Masses, and inertia tensors along the world's axes.
    """

    spin: np.ndarray
    flow: np.ndarray
    mass: np.ndarray
    inertia: np.ndarray

    @cached_property
    def matrix(self) -> np.ndarray:
        """(n_v, n_v)."""
        of_bodies = zip(self.spin, self.flow, self.mass, self.inertia, strict=True)
        return np.sum([m * f.T @ f + s.T @ i @ s for s, f, m, i in of_bodies], axis=0)

    @cached_property
    def lower(self) -> np.ndarray:
        """Cholesky's factor."""
        return wide_cholesky(self.matrix)

    @property
    def log_det(self) -> np.longdouble:
        """Logarithm of the determinant."""
        return WIDE(2 * np.sum(np.log(np.diagonal(self.lower))))

    def times(self, x: np.ndarray) -> np.ndarray:
        """Product with x (n_v, k), body by body: more exact than by the matrix, whose entries are rounded."""
        turning = np.einsum("bij,bjk->bik", self.inertia, self.spin @ x)
        return np.asarray(
            np.einsum("bin,bik->nk", self.spin, turning)
            + np.einsum("b,bin,bik->nk", self.mass, self.flow, self.flow @ x)
        )

    def solve(self, right: np.ndarray) -> np.ndarray:
        """Solution for right sides (n_v,) or (n_v, k), refined with products body by body."""
        b = np.asarray(right, WIDE).reshape(len(right), -1)
        x = wide_solve(self.lower, b)
        for _ in range(_REFINEMENTS):
            x = x + wide_solve(self.lower, b - self.times(x))
        return x.reshape(np.shape(right))


def wide_mass(tree: Tree, frames: Frames | tuple[np.ndarray, np.ndarray]) -> WideMass:
    """Mass matrix at frames as they are given."""
    pair = (frames.rotation, frames.origin) if isinstance(frames, Frames) else frames
    turn, at = (np.asarray(each, WIDE) for each in pair)
    n = tree.n_bodies
    # Columns of J are the velocities that a unit rate of each freedom gives the bodies beyond its hinge.
    spin, flow = np.zeros((n, 3, tree.n_v), WIDE), np.zeros((n, 3, tree.n_v), WIDE)
    for b, p in enumerate(tree.parent):
        k, size = tree.v_start[b], tree.v_start[b + 1] - tree.v_start[b]
        if p >= 0:
            spin[b] = spin[p]
            flow[b] = flow[p] + np.cross(spin[p], at[b] - at[p], axis=0)
        if size == 6:
            spin[b, :, k : k + 3] += np.eye(3)
            flow[b, :, k + 3 : k + 6] += np.eye(3)
        elif size == 1:
            spin[b, :, k] += turn[b, :, 2]
    inertia = turn @ tree.inertia.astype(WIDE) @ turn.swapaxes(1, 2)
    arm = np.einsum("bij,bj->bi", turn, tree.com.astype(WIDE))
    centre = flow + np.cross(spin, arm[:, :, None], axis=1)
    return WideMass(spin, centre, tree.mass.astype(WIDE), inertia)


def wide_cholesky(matrix: np.ndarray) -> np.ndarray:
    """Lower Cholesky factor of a positive definite matrix."""
    lower = np.zeros_like(matrix)
    for j in range(len(matrix)):
        lower[j, j] = np.sqrt(matrix[j, j] - lower[j, :j] @ lower[j, :j])
        lower[j + 1 :, j] = (matrix[j + 1 :, j] - lower[j + 1 :, :j] @ lower[j, :j]) / lower[j, j]
    return lower


def wide_solve(lower: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solution by Cholesky's factor, for a right side (n,) or several (n, k)."""
    x = np.array(right, WIDE)
    for j in range(len(x)):
        x[j] = (x[j] - lower[j, :j] @ x[:j]) / lower[j, j]
    for j in range(len(x) - 1, -1, -1):
        x[j] = (x[j] - lower[j + 1 :, j] @ x[j + 1 :]) / lower[j, j]
    return x
