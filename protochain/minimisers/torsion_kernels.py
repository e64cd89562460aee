"""Stiffness in torsions, K = J^T C J, by one sweep over the tree for all columns.

All twists and wrenches are about one point, so that they add up in a subtree. A term k g g^T between atoms
has a wrench W on each body b, and C = sum k W_b W_c^T, 6x6 for bodies b and c. With S the motion of a
freedom, and sums over the bodies that it moves, K_kl = S_k^T (sum_b sum_c C_bc) S_l. A row of blocks,
(6, 6 nb), is summed from the leaves inward for every body. The total cost is O(nb^2) for any terms.
"""

import numpy as np

from protochain.chains.chain import Chain, Pose
from protochain.core.arrays import Floats, Integers, cross
from protochain.mechanics.multibody import velocities
from protochain.mechanics.multibody.algebra import kernel

Term = tuple[Integers, Floats, Floats]
"""Atoms (n, k), gradients (n, k, 3) and stiffness (n,) of some lengths or angles."""


def stiffness_in_torsions(chain: Chain, at: Pose, terms: list[Term], tether: Floats) -> Floats:
    """Stiffness (n_v, n_v) of terms k g g^T, and of springs (na,) from the atoms to fixed points."""
    tree, middle = chain.tree, at.x.mean(axis=0)
    x = at.x - middle
    bodies, wrenches, start, stiffness = _wrenches(chain.atom_body, x, terms)
    body_blocks = np.zeros((tree.n_bodies, 36))
    _add_tethers(chain.atom_body, x, tether, body_blocks)
    order, depth = _inward_order(np.array(tree.parent))
    # Entries body by body, in their order, and the first of each.
    first = np.r_[0, np.cumsum(np.bincount(bodies, minlength=tree.n_bodies))].astype(np.int64)
    entry = np.argsort(bodies, kind="stable").astype(np.int64)
    matrix = np.empty((chain.n_v, chain.n_v))
    motions, starts = _motions(chain, at, middle), np.array(tree.v_start)
    _sweep(
        np.array(tree.parent), order, depth, starts, motions, body_blocks, bodies, wrenches, start, stiffness,
        first, entry, matrix,
    )  # fmt: skip
    return np.asarray(0.5 * (matrix + matrix.T))


def _motions(chain: Chain, at: Pose, middle: Floats) -> Floats:
    """(n_v, 6) float: twist of each freedom's body about the middle, at unit rate."""
    tree = chain.tree
    counts, motions = np.diff(tree.v_start), np.empty((chain.n_v, 6))
    lever = middle - at.frames.origin
    for j in range(int(counts.max(initial=0))):
        has = counts > j
        places = tree.v_start[:-1][has] + j
        rates = np.zeros(chain.n_v)
        rates[places] = 1.0
        twists = velocities(tree, at.frames, rates)
        twists[:, 3:] += cross(twists[:, :3], lever)
        # A body moves with its parent, and by its own freedom.
        inner = np.where((tree.parent >= 0)[:, None], twists[tree.parent], 0.0)
        motions[places] = (twists - inner)[has]
    return motions


def _wrenches(atom_body: Integers, x: Floats, terms: list[Term]) -> tuple[Integers, Floats, Integers, Floats]:
    """Bodies and wrenches of terms between bodies, the first wrench of each term, and its stiffness."""
    bodies, wrenches, sizes, stiffness = [], [], [], []
    for atoms, gradients, k in terms:
        where = atom_body[atoms]
        between = (where != where[:, :1]).any(axis=1)
        atoms, gradients = atoms[between], gradients[between]
        bodies.append(where[between].ravel())
        wrenches.append(np.concatenate([cross(x[atoms], gradients), gradients], axis=2).reshape(-1, 6))
        sizes.append(np.full(len(atoms), atoms.shape[1]))
        stiffness.append(k[between])
    start = np.r_[0, np.cumsum(np.concatenate(sizes))].astype(np.int64)
    return np.concatenate(bodies), np.concatenate(wrenches), start, np.concatenate(stiffness)


@kernel
def _add_tethers(atom_body: Integers, x: Floats, tether: Floats, body_blocks: Floats) -> None:
    """Add the stiffness P k P^T of springs to fixed points, P = (x cross, 1)."""
    for i in range(len(tether)):
        k, b = tether[i], atom_body[i]
        if k == 0.0:
            continue
        u, v, w = x[i, 0], x[i, 1], x[i, 2]
        columns = ((0.0, w, -v), (-w, 0.0, u), (v, -u, 0.0))
        for axis in range(3):
            m = columns[axis]
            for p in range(3):
                for q in range(3):
                    body_blocks[b, 6 * p + q] += k * m[p] * m[q]
                body_blocks[b, 6 * p + 3 + axis] += k * m[p]
                body_blocks[b, 6 * (3 + axis) + p] += k * m[p]
            body_blocks[b, 7 * (3 + axis)] += k


@kernel
def _inward_order(parent: Integers) -> tuple[Integers, Integers]:
    """Bodies, children before parents, the largest branch first, and the depth of each in other branches."""
    # At any time, only a logarithmic number of rows of bodies is then unfinished.
    n = len(parent)
    size, heavy = np.ones(n, np.int64), np.full(n, -1, np.int64)
    for b in range(n - 1, -1, -1):
        if parent[b] >= 0:
            size[parent[b]] += size[b]
    for b in range(n):
        p = parent[b]
        if p >= 0 and (heavy[p] < 0 or size[b] > size[heavy[p]]):
            heavy[p] = b
    # Places of a parent before its children, the largest branch last. The order is reversed at the end.
    depth, place, following = np.zeros(n, np.int64), np.zeros(n, np.int64), np.ones(n, np.int64)
    order, roots = np.empty(n, np.int64), 0
    for b in range(n):
        p = parent[b]
        if p < 0:
            place[b] = roots
            roots += size[b]
        elif b == heavy[p]:
            place[b], depth[b] = place[p] + size[p] - size[b], depth[p]
        else:
            place[b], depth[b] = place[p] + following[p], depth[p] + 1
            following[p] += size[b]
        order[n - 1 - place[b]] = b
    return order, depth


@kernel
def _sweep(
    parent: Integers, order: Integers, depth: Integers, v_start: Integers, motions: Floats,
    body_blocks: Floats, bodies: Integers, wrenches: Floats, start: Integers, stiffness: Floats,
    first: Integers, entry: Integers, matrix: Floats,
) -> None:  # fmt: skip
    """Sum rows of blocks inward, and project them on the motions."""
    n, deepest = len(parent), 0
    for b in range(n):
        deepest = max(deepest, depth[b])
    rows = np.zeros((deepest + 1, 6, 6 * n))
    term_of = np.empty(len(bodies), np.int64)
    for t in range(len(stiffness)):
        for e in range(start[t], start[t + 1]):
            term_of[e] = t
    pull = np.empty(6 * n)
    for b in order:
        # This row contains the largest branch, which was summed just before.
        row = rows[depth[b]]
        for m in range(first[b], first[b + 1]):
            e = entry[m]
            t = term_of[e]
            for partner in range(start[t], start[t + 1]):
                c = 6 * bodies[partner]
                for p in range(6):
                    share = stiffness[t] * wrenches[e, p]
                    for q in range(6):
                        row[p, c + q] += share * wrenches[partner, q]
        for p in range(6):
            for q in range(6):
                row[p, 6 * b + q] += body_blocks[b, 6 * p + q]
        for k in range(v_start[b], v_start[b + 1]):
            for c in range(6 * n):
                pull[c] = 0.0
            for p in range(6):
                s = motions[k, p]
                if s != 0.0:
                    for c in range(6 * n):
                        pull[c] += s * row[p, c]
            for c in range(n - 1, -1, -1):
                for j in range(v_start[c], v_start[c + 1]):
                    value = 0.0
                    for p in range(6):
                        value += motions[j, p] * pull[6 * c + p]
                    matrix[k, j] = value
                if parent[c] >= 0:
                    for p in range(6):
                        pull[6 * parent[c] + p] += pull[6 * c + p]
        inner = parent[b]
        if inner < 0 or depth[inner] != depth[b]:
            # The end of a light branch, or of a tree.
            for p in range(6):
                for c in range(6 * n):
                    if inner >= 0:
                        rows[depth[inner], p, c] += row[p, c]
                    row[p, c] = 0.0
