"""Slow, clear statements of geometry."""

import numpy as np


def bond_lengths(bonds: np.ndarray, x: np.ndarray) -> np.ndarray:
    return np.linalg.norm(x[bonds[:, 0]] - x[bonds[:, 1]], axis=1)


def angle_triples(bonds: np.ndarray) -> np.ndarray:
    neighbours: dict[int, list[int]] = {}
    for i, j in bonds.tolist():
        neighbours.setdefault(i, []).append(j)
        neighbours.setdefault(j, []).append(i)
    return np.array(
        [(a, b, c) for b, around in neighbours.items() for a in around for c in around if a < c], dtype=int
    )


def angles(triples: np.ndarray, x: np.ndarray) -> np.ndarray:
    u, v = x[triples[:, 0]] - x[triples[:, 1]], x[triples[:, 2]] - x[triples[:, 1]]
    return np.arctan2(np.linalg.norm(np.cross(u, v), axis=1), np.sum(u * v, axis=1))
