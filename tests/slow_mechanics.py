"""Mechanics of trees in dense algebra, slow and readable: the reference for the fast sweeps."""

from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

from protochain.mechanics.multibody import Frames, HingeKind, Tree, random_tree

KINDS = (HingeKind.REVOLUTE, HingeKind.PRISMATIC, HingeKind.SCREW, HingeKind.FIXED)
N_TREES = 100


def any_tree(seed: int) -> Tree:
    """Return one of a hundred trees: serial and branched, up to 200 hinges of every kind, some forests."""
    rng = np.random.default_rng(seed)
    n = int(rng.choice([2, 3, 10, 30, 60, 120, 201]))
    root = rng.choice([HingeKind.FIXED, HingeKind.FREE, HingeKind.REVOLUTE, HingeKind.PRISMATIC])
    kinds = KINDS if seed % 2 else (HingeKind.REVOLUTE,)
    tree = random_tree(n, rng, branching=(0.0, 0.2, 0.7)[seed % 3], root=HingeKind(root), kinds=kinds)
    return forest(tree) if seed % 4 == 3 else tree


def forest(tree: Tree) -> Tree:
    """Return the tree with its middle body turned into a free root."""
    middle = tree.n_bodies // 2
    parent, kind, placement = tree.parent.copy(), tree.kind.copy(), tree.placement.copy()
    parent[middle], kind[middle], placement[middle] = -1, HingeKind.FREE, np.eye(3)
    return replace(tree, parent=parent, kind=kind, placement=placement)


def random_q(tree: Tree, rng: np.random.Generator) -> np.ndarray:
    return rng.uniform(-3, 3, size=tree.n_q)


def skew(a: np.ndarray) -> np.ndarray:
    x, y, z = a
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])


def slow_frames(tree: Tree, q: np.ndarray) -> Frames:
    """World frames, one body at a time, by scipy's rotations."""
    rotations, origins = [], []
    for b in range(tree.n_bodies):
        p = tree.parent[b]
        above = rotations[p] if p >= 0 else Rotation.identity()
        origin = above.apply(np.array(tree.offset[b])) + (origins[p] if p >= 0 else 0.0)
        rotation = above * Rotation.from_matrix(np.array(tree.placement[b]))
        k = tree.q_start[b]
        if tree.kind[b] == HingeKind.FREE:
            w, x, y, z = q[k : k + 4]
            rotation, origin = rotation * Rotation.from_quat([x, y, z, w]), origin + q[k + 4 : k + 7]
        elif tree.kind[b] != HingeKind.FIXED:
            turn, slide = tree.twist[b]
            origin = origin + rotation.apply([0.0, 0.0, slide * q[k]])
            rotation = rotation * Rotation.from_rotvec([0.0, 0.0, turn * q[k]])
        rotations.append(rotation)
        origins.append(origin)
    return Frames(np.array([r.as_matrix() for r in rotations]), np.array(origins))


def outboard(tree: Tree, body: int) -> list[int]:
    """The body and all bodies outward of it."""
    found = [body]
    for b in range(body + 1, tree.n_bodies):
        if tree.parent[b] in found:
            found.append(b)
    return found


def shift(lever: np.ndarray) -> np.ndarray:
    """Twist about a point -> the same twist about another, ``lever`` away."""
    x = np.eye(6)
    x[3:, :3] = -skew(lever)
    return x


def freedoms(tree: Tree, frames: Frames, b: int) -> np.ndarray:
    """(6, n_v of the body): twist of the body about its origin for each unit of its freedoms."""
    if tree.kind[b] == HingeKind.FREE:
        return np.eye(6)
    if tree.kind[b] == HingeKind.FIXED:
        return np.zeros((6, 0))
    axis = frames.rotation[b, :, 2]
    turn, slide = tree.twist[b]
    return np.concatenate([turn * axis, slide * axis])[:, None]


def slow_jacobian(tree: Tree, frames: Frames) -> np.ndarray:
    """(nb, 6, n_v)."""
    jacobian = np.zeros((tree.n_bodies, 6, tree.n_v))
    for k in range(tree.n_bodies):
        columns = slice(tree.v_start[k], tree.v_start[k + 1])
        for b in outboard(tree, k):
            jacobian[b, :, columns] = shift(frames.origin[b] - frames.origin[k]) @ freedoms(tree, frames, k)
    return jacobian


def body_inertia(tree: Tree, frames: Frames, b: int) -> np.ndarray:
    """6x6 spatial inertia of a body about its origin, world axes."""
    r = frames.rotation[b]
    c = shift(r @ tree.com[b])
    about_com = block_diag(r @ tree.inertia[b] @ r.T, tree.mass[b] * np.eye(3))
    return c.T @ about_com @ c


def slow_mass_matrix(tree: Tree, frames: Frames) -> np.ndarray:
    """J^T M0 J."""
    j = slow_jacobian(tree, frames)
    return sum(j[b].T @ body_inertia(tree, frames, b) @ j[b] for b in range(tree.n_bodies))


def slow_articulated_inverse(tree: Tree, frames: Frames) -> tuple[np.ndarray, float]:
    """M^-1 = [1 - H psi K]^T D^-1 [1 - H psi K] column by column, and ln det M, with 6x6 matrices."""
    n = tree.n_bodies
    h = [freedoms(tree, frames, b) for b in range(n)]
    p = [body_inertia(tree, frames, b) for b in range(n)]
    d, gain, log_det = [None] * n, [None] * n, 0.0
    for b in range(n - 1, -1, -1):
        d[b] = h[b].T @ p[b] @ h[b]
        gain[b] = p[b] @ h[b] @ np.linalg.inv(d[b])
        log_det += np.linalg.slogdet(d[b])[1] if h[b].size else 0.0
        if tree.parent[b] >= 0:
            x = shift(frames.origin[b] - frames.origin[tree.parent[b]])
            p[tree.parent[b]] += x.T @ (p[b] - gain[b] @ d[b] @ gain[b].T) @ x
    inverse = np.zeros((tree.n_v, tree.n_v))
    for column in range(tree.n_v):
        tau = np.eye(tree.n_v)[column]
        z, rate, twist = np.zeros((n, 6)), [None] * n, np.zeros((n, 6))
        for b in range(n - 1, -1, -1):
            own = slice(tree.v_start[b], tree.v_start[b + 1])
            rate[b] = tau[own] - h[b].T @ z[b]
            if tree.parent[b] >= 0:
                x = shift(frames.origin[b] - frames.origin[tree.parent[b]])
                z[tree.parent[b]] += x.T @ (z[b] + gain[b] @ rate[b])
        for b in range(n):
            own = slice(tree.v_start[b], tree.v_start[b + 1])
            if tree.parent[b] >= 0:
                twist[b] = shift(frames.origin[b] - frames.origin[tree.parent[b]]) @ twist[tree.parent[b]]
            inverse[own, column] = np.linalg.solve(d[b], rate[b]) - gain[b].T @ twist[b] if h[b].size else []
            twist[b] += h[b] @ inverse[own, column]
    return inverse, log_det


def slow_fixman(tree: Tree, frames: Frames) -> tuple[np.ndarray, float]:
    """M^-1 = A - B H^-1 B^T and ln det M = sum ln det M_b + ln det H, from dense soft and hard rows."""
    n = tree.n_bodies
    relative = np.eye(6 * n)
    for b in range(n):
        p = tree.parent[b]
        if p >= 0:
            relative[6 * b : 6 * b + 6, 6 * p : 6 * p + 6] = -shift(frames.origin[b] - frames.origin[p])
    soft, hard = [], []
    for b in range(n):
        rows = relative[6 * b : 6 * b + 6]
        h = freedoms(tree, frames, b)
        if h.shape[1] == 1:
            # Coordinates of the relative twist in a basis whose first vector is the hinge's twist.
            basis = np.column_stack([h, np.linalg.svd(h)[0][:, 1:]])
            coordinates = np.linalg.inv(basis) / np.abs(np.linalg.det(np.linalg.inv(basis))) ** (1 / 6)
            scale = (np.linalg.inv(basis) @ h)[0, 0] / (coordinates @ h)[0, 0]
            soft.append(scale * coordinates[:1] @ rows)
            # All six rows together keep determinant one.
            hard.append(scale ** (-1 / 5) * coordinates[1:] @ rows)
        else:
            (soft if h.shape[1] == 6 else hard).append(rows)
    e_s = np.concatenate(soft) if soft else np.zeros((0, 6 * n))
    e_h = np.concatenate(hard) if hard else np.zeros((0, 6 * n))
    bodies = [body_inertia(tree, frames, b) for b in range(n)]
    w = np.linalg.inv(block_diag(*bodies))
    a, b_, h_ = e_s @ w @ e_s.T, e_s @ w @ e_h.T, e_h @ w @ e_h.T
    log_det = sum(np.linalg.slogdet(m)[1] for m in bodies) + np.linalg.slogdet(h_)[1]
    return a - b_ @ np.linalg.solve(h_, b_.T), log_det


def slow_inverse_dynamics(tree: Tree, frames_at, qd: np.ndarray, qdd: np.ndarray, step: float) -> np.ndarray:
    """J^T (M0 (J qdd + dJ/dt qd) + gyroscopic loads), dJ/dt by central differences of frames_at(time)."""
    frames = frames_at(0.0)
    j = slow_jacobian(tree, frames)
    rate = (slow_jacobian(tree, frames_at(step)) - slow_jacobian(tree, frames_at(-step))) / (2 * step)
    tau = np.zeros(tree.n_v)
    for b in range(tree.n_bodies):
        m = body_inertia(tree, frames, b)
        omega = (j[b] @ qd)[:3]
        arm = frames.rotation[b] @ tree.com[b]
        about_origin = m[:3, :3]
        gyroscopic = np.concatenate(
            [np.cross(omega, about_origin @ omega), tree.mass[b] * np.cross(omega, np.cross(omega, arm))]
        )
        tau += j[b].T @ (m @ (j[b] @ qdd + rate[b] @ qd) + gyroscopic)
    return tau
