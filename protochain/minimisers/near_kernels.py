"""Kernels of the near terms' curvature: stiffness of pairs, gradients of angles, blocks, and free pairs.

``atom_blocks`` (na, 9) are diagonal blocks of the Hessian, row by row, ``pair_blocks`` (n, 9) pair blocks.
"""

import numpy as np
from numpy.typing import NDArray

from protochain.core.arrays import Floats, Integers
from protochain.energies.native.neighbours import grow_rows
from protochain.mechanics.multibody.algebra import Vector, add, cross, dot, kernel, scale, subtract, vector

STIFFEST = 1e6
"""kJ/mol/nm^2, limit for a pair: twice the stiffest bond. Overlapping atoms would hide others by rounding."""
_TINY = 1e-6  # nm^2, smallest square of a length, or area, in a denominator.
_THIN = 1e-5
"""nm^4, smallest square of an area that turns a dihedral, 1/50 of the value for two bonds. Three atoms in
line turn by any angle without moving."""


@kernel
def bond_stiffness(x: Floats, pairs: Integers, length: Floats, k: Floats) -> tuple[Floats, Floats]:
    """Curvatures (n,) of harmonic bonds along their lines and across them, at least 0."""
    across = np.empty(len(pairs))
    for n in range(len(pairs)):
        d = subtract(vector(x, pairs[n, 0]), vector(x, pairs[n, 1]))
        across[n] = max(0.0, k[n] * (1.0 - length[n] / np.sqrt(max(dot(d, d), _TINY))))
    return k.copy(), across


@kernel
def well_stiffness(x: Floats, pairs: Integers, a12: Floats, b6: Floats) -> tuple[Floats, Floats]:
    """Curvatures (n,) of A/r^12 - B/r^6 along the lines and across them, at least 0."""
    along, across = np.empty(len(pairs)), np.empty(len(pairs))
    for n in range(len(pairs)):
        d = subtract(vector(x, pairs[n, 0]), vector(x, pairs[n, 1]))
        inverse = 1.0 / max(dot(d, d), _TINY)
        sixth = inverse**3
        steep = (156.0 * a12[n] * sixth - 42.0 * b6[n]) * sixth * inverse
        along[n] = min(max(steep, 0.0), STIFFEST)
        across[n] = max((6.0 * b6[n] - 12.0 * a12[n] * sixth) * sixth * inverse, 0.0)
    return along, across


@kernel
def bends(x: Floats, atoms: Integers) -> Floats:
    """Gradients (n, 3, 3) of the angles of three atoms each, zero if these are in line."""
    gradients = np.empty((len(atoms), 3, 3))
    for n in range(len(atoms)):
        middle = vector(x, atoms[n, 1])
        u, v = subtract(vector(x, atoms[n, 0]), middle), subtract(vector(x, atoms[n, 2]), middle)
        normal = cross(u, v)
        area = np.sqrt(max(dot(normal, normal), _TINY**2))
        first = scale(1.0 / (max(dot(u, u), _TINY) * area), cross(u, normal))
        last = scale(-1.0 / (max(dot(v, v), _TINY) * area), cross(v, normal))
        _put(first, gradients, n, 0)
        _put(scale(-1.0, add(first, last)), gradients, n, 1)
        _put(last, gradients, n, 2)
    return gradients


@kernel
def turns(x: Floats, atoms: Integers, waves: Floats, first: Integers) -> tuple[Floats, Floats]:
    """Gradients (n, 4, 3) of dihedrals, as in :func:`energies.native.bonded.twist`, and stiffness (n,)."""
    gradients, stiffness = np.empty((len(atoms), 4, 3)), np.zeros(len(atoms))
    for n in range(len(atoms)):
        xj, xk = vector(x, atoms[n, 1]), vector(x, atoms[n, 2])
        f, g, h = subtract(vector(x, atoms[n, 0]), xj), subtract(xj, xk), subtract(vector(x, atoms[n, 3]), xk)
        a, b = cross(f, g), cross(h, g)
        length = np.sqrt(max(dot(g, g), _TINY))
        a2, b2 = max(dot(a, a), _THIN), max(dot(b, b), _THIN)
        start, end = scale(-length / a2, a), scale(length / b2, b)
        between = subtract(scale(dot(f, g) / (a2 * length), a), scale(dot(h, g) / (b2 * length), b))
        _put(start, gradients, n, 0)
        _put(subtract(between, start), gradients, n, 1)
        _put(scale(-1.0, add(between, end)), gradients, n, 2)
        _put(end, gradients, n, 3)
        angle = np.arctan2(-length * dot(f, b), dot(a, b))
        for w in range(first[n], first[n + 1]):
            times, phase, k = waves[w, 0], waves[w, 1], waves[w, 2]
            stiffness[n] += abs(k * times * times * np.cos(times * angle - phase)) if times else k
    return gradients, stiffness


@kernel
def _put(v: Vector, gradients: Floats, n: int, k: int) -> None:
    gradients[n, k, 0], gradients[n, k, 1], gradients[n, k, 2] = v


@kernel
def add_springs(
    x: Floats, pairs: Integers, along: Floats, across: Floats, slots: Integers, atom_blocks: Floats,
    pair_blocks: Floats,
) -> None:  # fmt: skip
    """Add along u u^T + across (1 - u u^T) of each pair, off the diagonal to its slot unless that is -1."""
    for n in range(len(pairs)):
        i, j, slot = pairs[n, 0], pairs[n, 1], slots[n]
        d = subtract(vector(x, i), vector(x, j))
        difference = (along[n] - across[n]) / max(dot(d, d), _TINY)
        for a in range(3):
            for b in range(3):
                value = difference * d[a] * d[b] + (across[n] if a == b else 0.0)
                atom_blocks[i, 3 * a + b] += value
                atom_blocks[j, 3 * a + b] += value
                if slot >= 0:
                    pair_blocks[slot, 3 * a + b] -= value


@kernel
def add_gradients(
    atoms: Integers, gradients: Floats, stiffness: Floats, slots: Integers, atom_blocks: Floats,
    pair_blocks: Floats,
) -> None:  # fmt: skip
    """Add k g g^T of each term. The rows of a pair block belong to the atom with the lower index."""
    for n in range(len(atoms)):
        pair = 0
        for p in range(atoms.shape[1]):
            i = atoms[n, p]
            for a in range(3):
                for b in range(3):
                    atom_blocks[i, 3 * a + b] += stiffness[n] * gradients[n, p, a] * gradients[n, p, b]
            for q in range(p + 1, atoms.shape[1]):
                row, column = (p, q) if i < atoms[n, q] else (q, p)
                slot = slots[n, pair]
                pair += 1
                for a in range(3):
                    for b in range(3):
                        product = gradients[n, row, a] * gradients[n, column, b]
                        pair_blocks[slot, 3 * a + b] += stiffness[n] * product


@kernel
def _grid(x: Floats, reach: float) -> tuple[Floats, float, Integers]:
    """Lowest corner, side, and numbers of cells of a grid with a limited number of cells per atom."""
    low, high = x[0].copy(), x[0].copy()
    for i in range(len(x)):
        for a in range(3):
            low[a], high[a] = min(low[a], x[i, a]), max(high[a], x[i, a])
    side, shape, many = reach, np.ones(3, np.int64), True
    while many:
        cells = 1.0
        for a in range(3):
            along = min((high[a] - low[a]) / side, 1e6)
            shape[a] = int(along) + 1
            cells *= shape[a]
        many = cells > 8.0 * len(x) + 64.0
        side = 1.25 * side if many else side
    return low, side, shape


@kernel
def _cell(x: Floats, i: int, a: int, low: Floats, side: float, shape: Integers) -> int:
    """Index of an atom's cell along an axis of the grid."""
    return min(int(min((x[i, a] - low[a]) / side, 1e6)), shape[a] - 1)


@kernel
def _cells(x: Floats, low: Floats, side: float, shape: Integers) -> tuple[Integers, Integers]:
    """Start of each cell, and the atoms sorted by cell."""
    place = np.empty(len(x), np.int64)
    start = np.zeros(shape[0] * shape[1] * shape[2] + 1, np.int64)
    for i in range(len(x)):
        c = _cell(x, i, 0, low, side, shape) * shape[1] + _cell(x, i, 1, low, side, shape)
        place[i] = c * shape[2] + _cell(x, i, 2, low, side, shape)
        start[place[i] + 1] += 1
    for c in range(1, len(start)):
        start[c] += start[c - 1]
    filled, order = start[:-1].copy(), np.empty(len(x), np.int64)
    for i in range(len(x)):
        order[filled[place[i]]] = i
        filled[place[i]] += 1
    return start, order


@kernel
def free_pairs(
    x: Floats, first_partner: Integers, partner: Integers, moving: NDArray[np.bool_], reach: float
) -> Integers:
    """Pairs (n, 2) within reach with a moving atom, without excluded partners, sorted by first atom."""
    low, side, shape = _grid(x, reach)
    start, order = _cells(x, low, side, shape)
    pairs, n_pairs = np.empty((8 * len(x) + 8, 2), np.int64), 0
    for i in range(len(x)):
        ci, cj = _cell(x, i, 0, low, side, shape), _cell(x, i, 1, low, side, shape)
        ck = _cell(x, i, 2, low, side, shape)
        for a in range(max(ci - 1, 0), min(ci + 2, shape[0])):
            for b in range(max(cj - 1, 0), min(cj + 2, shape[1])):
                # Three cells in a row are one range of atoms.
                row = (a * shape[1] + b) * shape[2]
                for at in range(start[row + max(ck - 1, 0)], start[row + min(ck + 2, shape[2])]):
                    j = order[at]
                    if j <= i or not (moving[i] or moving[j]):
                        continue
                    d = subtract(vector(x, i), vector(x, j))
                    if dot(d, d) > reach * reach:
                        continue
                    is_free = True
                    for p in range(first_partner[i], first_partner[i + 1]):
                        is_free &= partner[p] != j
                    if is_free:
                        if n_pairs == len(pairs):
                            pairs = grow_rows(pairs, 2 * n_pairs)
                        pairs[n_pairs, 0], pairs[n_pairs, 1] = i, j
                        n_pairs += 1
    return pairs[:n_pairs].copy()
