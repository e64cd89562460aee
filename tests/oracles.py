"""Slow, clear statements of what the fast code computes."""

import numpy as np
from scipy.spatial.transform import Rotation

from protochain.multibody import HingeKind, Tree


def random_tree(n: int, rng: np.random.Generator, free: bool) -> Tree:
    """A branched forest of two trees with hinges in any direction."""
    parent = np.array([-1] + [int(rng.integers(0, i)) for i in range(1, n)])
    parent[n // 2] = -1
    root = parent < 0
    kind = np.where(root, HingeKind.FREE if free else HingeKind.FIXED, HingeKind.REVOLUTE)
    axis = rng.normal(size=(n, 3))
    axis /= np.linalg.norm(axis, axis=1)[:, None]
    placement = Rotation.random(n, rng=rng).as_matrix()
    placement[root] = np.eye(3)
    return Tree(parent, kind, axis, rng.normal(size=(n, 3)), placement)


def random_q(tree: Tree, rng: np.random.Generator) -> np.ndarray:
    return rng.uniform(-3, 3, size=tree.n_q)


def frames(tree: Tree, q: np.ndarray) -> tuple[list[Rotation], list[np.ndarray]]:
    """World frames, one body at a time, by scipy's rotations."""
    rotations, origins = [], []
    for b in range(tree.n_bodies):
        p = tree.parent[b]
        above = rotations[p] if p >= 0 else Rotation.identity()
        origin = above.apply(np.array(tree.offset[b])) + (origins[p] if p >= 0 else 0.0)
        rotation = above * Rotation.from_matrix(np.array(tree.placement[b]))
        k = tree.q_start[b]
        if tree.kind[b] == HingeKind.REVOLUTE:
            rotation = rotation * Rotation.from_rotvec(q[k] * tree.axis[b])
        elif tree.kind[b] == HingeKind.FREE:
            w, x, y, z = q[k : k + 4]
            rotation, origin = rotation * Rotation.from_quat([x, y, z, w]), origin + q[k + 4 : k + 7]
        rotations.append(rotation)
        origins.append(origin)
    return rotations, origins


def outboard(tree: Tree, body: int) -> list[int]:
    """The body and everything that hangs on it."""
    found = [body]
    for b in range(body + 1, tree.n_bodies):
        if tree.parent[b] in found:
            found.append(b)
    return found


def torques(tree: Tree, q: np.ndarray, points: np.ndarray, body: np.ndarray, f: np.ndarray) -> np.ndarray:
    """tau_k = a_k . sum over outboard points of (r - P_k) x f; for a free root the whole load."""
    rotations, origins = frames(tree, q)
    tau = []
    for b in range(tree.n_bodies):
        mine = np.isin(body, outboard(tree, b))
        moment = np.cross(points[mine] - origins[b], f[mine]).sum(axis=0)
        if tree.kind[b] == HingeKind.REVOLUTE:
            tau.append(rotations[b].apply(np.array(tree.axis[b])) @ moment)
        elif tree.kind[b] == HingeKind.FREE:
            tau += [*moment, *f[mine].sum(axis=0)]
    return np.array(tau)


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
