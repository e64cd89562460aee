"""Far fields of groups of atoms by Cartesian Taylor expansions, of any kernel r^-s, truncated by total order.

For two groups with fixed centres R apart, moments M_b = sum w e^b / b! and kernel k,

    sum_ij v_i w_j k(r_ij) ~ sum over |a| + |b| <= p of M'_a (-1)^|b| D_(a+b)(R) M_b,

D_n the derivatives of k: Dehnen, J. Comput. Phys. 179:27 (2002), and Duan, Krasny, J. Comput. Chem. 22:184
(2001). The sum is symmetric in the two groups and a polynomial in the positions, so forces are its exact
gradient. Interactions are computed LANES at a time, each quantity in one row of LANES numbers.
"""

from functools import cache
from typing import Any

import numpy as np

from protochain.core.arrays import Floats, Integers
from protochain.energies.native.lanes import LANES, add_products, put_product
from protochain.energies.native.layout import Share, W, chunk_kernel, part, scalar, tile_kernel
from protochain.energies.native.tree import FIRST, LEFT, PARENT

LARGEST_ORDER = 10
POWER, ORDER, KIND, FIELD = range(4)
"""Columns of an interaction: s of its kernel r^-s, plus a multiple of r^-(s + 2), order p, kind of charge of
the moments, and field to which it adds."""


@cache
def tables(order: int) -> tuple[Integers, Integers, Integers, Integers]:
    """Tables of an order."""
    # (n, 8) int: For each monomial, by degree: exponents of x, y, z, degree, an axis, row of the monomial
    #     divided by that axis once, and twice (-1 for none), exponent along it.
    # (m, 3) int: Rows of a, b and a + b for all |a| + |b| <= order, by the degree of a + b.
    # (l, 3) int: Row of each monomial of a lower order, times x, times y, times z.
    # (n * n,) int: Row of a + b, at n a + b, 0 for higher orders.
    powers = [
        (i, j, n - i - j) for n in range(order + 1) for i in range(n, -1, -1) for j in range(n - i, -1, -1)
    ]
    place = {power: row for row, power in enumerate(powers)}
    monomials = []
    for power in powers:
        axis = int(np.argmax(power))
        lower = [tuple(np.subtract(power, [k * (axis == a) for a in range(3)])) for k in (1, 2)]
        monomials.append((*power, sum(power), axis, *(place.get(key, -1) for key in lower), power[axis]))
    products = [
        (place[a], place[b], place[tuple(np.add(a, b))])
        for degree in range(order + 1) for a in powers for b in powers if sum(a) + sum(b) == degree
    ]  # fmt: skip
    raised = [
        [place[tuple(np.add(a, unit))] for unit in np.eye(3, dtype=int)] for a in powers if sum(a) < order
    ]
    sums = [place.get(tuple(np.add(a, b)), 0) for a in powers for b in powers]
    return np.array(monomials), np.array(products), np.array(raised), np.array(sums)


@scalar
def n_terms(order: int) -> int:
    """Return the number of monomials of three variables up to an order."""
    return (order + 1) * (order + 2) * (order + 3) // 6


@scalar
def n_products(order: int) -> int:
    """Return the number of products of two monomials up to an order: the monomials of six variables."""
    total = 1
    for k in range(1, 7):
        total = total * (order + k) // k
    return total


@chunk_kernel
def put_monomials(dx: float, dy: float, dz: float, monomials: Integers, out: Floats) -> None:
    """Write dx^i dy^j dz^k / (i! j! k!) of a displacement."""
    out[0] = 1.0
    for row in range(1, len(monomials)):
        axis = monomials[row, 4]
        d = dx if axis == 0 else dy if axis == 1 else dz
        out[row] = out[monomials[row, 5]] * d / monomials[row, 7]


@tile_kernel
def block_monomials(a: Floats, cx: float, cy: float, cz: float, monomials: Integers, out: Floats) -> None:
    """Write the monomials of a block's atoms about a centre as rows (n, W)."""
    for k in range(W):
        out[0, k] = 1.0
    for row in range(1, len(monomials)):
        axis = monomials[row, 4]
        c = cx if axis == 0 else cy if axis == 1 else cz
        factor = 1.0 / monomials[row, 7]
        products, lower, at = out[row], out[monomials[row, 5]], a[axis * W : axis * W + W]
        for k in range(W):
            products[k] = lower[k] * (at[k] - c) * factor


@tile_kernel
def dot(a: Floats, b: Floats) -> float:
    """Sum of products of two rows."""
    total = 0.0
    for k in range(W):
        total += a[k] * b[k]
    return total


@chunk_kernel
def shift_moments(moments: Floats, monomials: Floats, products: Integers, n: int, out: Floats) -> None:
    """Add moments about a new centre, by n products. ``monomials`` are of the old centre about the new."""
    for t in range(n):
        out[products[t, 2]] += moments[products[t, 0]] * monomials[products[t, 1]]


@chunk_kernel
def shift_field(field: Floats, monomials: Floats, products: Integers, n: int, out: Floats) -> None:
    """Add a field about a new centre, by n products. ``monomials`` are of the new centre about the old."""
    for t in range(n):
        out[products[t, 0]] += field[products[t, 2]] * monomials[products[t, 1]]


@tile_kernel
def _derivatives(at: Floats, powers: Floats, order: int, monomials: Integers, out: Floats) -> None:
    """Derivatives of a kernel by order, from x, y, z, and rows ((1/r) d/dr)^m k of ``powers``."""
    # McMurchie, Davidson, J. Comput. Phys. 26:218 (1978), equation 4.6, for any kernel, in place, from the
    # highest degree down.
    for k in range(LANES):
        out[0, k] = powers[order, k]
    for m in range(order - 1, -1, -1):
        for row in range(n_terms(order - m) - 1, 0, -1):
            # For an exponent of 1 the factor of the second product is 0.
            once, twice = monomials[row, 5], max(0, monomials[row, 6])
            put_product(out, row, once, at, monomials[row, 4], monomials[row, 7] - 1.0, twice)
        for k in range(LANES):
            out[0, k] = powers[m, k]


@tile_kernel
def _kernel_rows(at: Floats, power: int, second: float, order: int, out: Floats) -> None:
    """Rows ((1/r) d/dr)^m (r^-s + second r^-(s + 2)), given rows 3 and 4 of ``at``, r^-1 and r^-2."""
    inverse, inverse2, correction = at[3], at[4], at[5]
    for k in range(LANES):
        value = inverse[k] if power % 2 else 1.0
        for _ in range(power // 2):
            value *= inverse2[k]
        out[0, k] = value
        correction[k] = second * inverse2[k]
    for m in range(1, order + 1):
        factor, row, last = -(power + 2.0 * (m - 1.0)), out[m], out[m - 1]
        for k in range(LANES):
            row[k] = factor * last[k] * inverse2[k]
    for m in range(order + 1):
        row, ratio = out[m], (power + 2.0 * m) / power
        for k in range(LANES):
            row[k] *= 1.0 + ratio * correction[k]


@chunk_kernel
def put_moments(
    chunks: Share, atoms: Floats, charges: Floats, kinds: Integers, nodes: Integers, roots: Integers,
    centre: Floats, tabled: Any, moments: Floats,
) -> None:  # fmt: skip
    """Put the moments of the nodes of some chunks, inward. ``kinds`` has rows of kind and order."""
    monomials, products, _, _ = tabled
    rows, shifts = np.empty((len(monomials), W)), np.empty(len(monomials))
    for c in range(*chunks):
        for node in range(roots[c + 1] - 1, roots[c] - 1, -1):
            x, y, z, block = centre[node, 0], centre[node, 1], centre[node, 2], nodes[node, FIRST]
            is_leaf = nodes[node, LEFT] < 0
            if is_leaf:
                block_monomials(atoms[block], x, y, z, monomials, rows)
            for k in range(len(kinds)):
                kind, order = kinds[k, 0], kinds[k, 1]
                for row in range(n_terms(order)):
                    moments[node, kind, row] = dot(charges[block, kind], rows[row]) if is_leaf else 0.0
            for side in range(0 if is_leaf else 2):
                child = nodes[node, LEFT + side]
                put_monomials(
                    centre[child, 0] - x, centre[child, 1] - y, centre[child, 2] - z, monomials, shifts
                )
                for k in range(len(kinds)):
                    kind, order = kinds[k, 0], kinds[k, 1]
                    child_moments, out = moments[child, kind], moments[node, kind]
                    shift_moments(child_moments, shifts, products, n_products(order), out)


@chunk_kernel
def put_fields(
    chunks: Share, uses: Integers, seconds: Floats, nodes: Integers, roots: Integers, centre: Floats,
    start: Integers, source: Integers, tabled: Any, moments: Floats, fields: Floats,
) -> None:  # fmt: skip
    """Put the far fields of the nodes of some chunks, outward."""
    # ``uses`` (n, 4) are the interactions, grouped by kernel, with falling order. The first interaction of a
    # field has its highest order. ``seconds`` (n,) are the factors of r^-(s + 2).
    monomials, products, _, added = tabled
    n = len(monomials)
    derivatives, gathered, sums = np.empty((n, LANES)), np.empty((n, LANES)), np.empty((len(uses) * n, LANES))
    powers, at, shifts = np.empty((LARGEST_ORDER + 1, LANES)), np.empty((6, LANES)), np.empty(n)
    for c in range(*chunks):
        for node in range(roots[c], roots[c + 1]):
            node_fields = fields[node]
            for use in range(len(uses)):
                for row in range(n):
                    node_fields[uses[use, FIELD], row] = 0.0
            if start[node] < start[node + 1]:
                _far_fields(
                    node, uses, seconds, centre, start, source, monomials, added, moments, derivatives,
                    gathered, sums, powers, at, node_fields,
                )  # fmt: skip
            parent = nodes[node, PARENT]
            if parent < 0:
                continue
            put_monomials(
                centre[node, 0] - centre[parent, 0], centre[node, 1] - centre[parent, 1],
                centre[node, 2] - centre[parent, 2], monomials, shifts,
            )  # fmt: skip
            for use in range(len(uses)):
                field, is_first = uses[use, FIELD], True
                for earlier in range(use):
                    is_first &= uses[earlier, FIELD] != field
                if is_first:
                    count = n_products(uses[use, ORDER])
                    shift_field(fields[parent, field], shifts, products, count, node_fields[field])


@chunk_kernel
def _far_fields(
    node: int, uses: Integers, seconds: Floats, centre: Floats, start: Integers, source: Integers,
    monomials: Integers, added: Integers, moments: Floats, derivatives: Floats, gathered: Floats,
    sums: Floats, powers: Floats, at: Floats, fields: Floats,
) -> None:  # fmt: skip
    """Add the fields of a node's far nodes."""
    n = len(monomials)
    for row in range(len(sums)):
        for lane in range(LANES):
            sums[row, lane] = 0.0
    for first in range(start[node], start[node + 1], LANES):
        count = min(LANES, start[node + 1] - first)
        for lane in range(LANES):
            far_node, r2 = source[first + lane if lane < count else first], 0.0
            for axis in range(3):
                # From node to far node: (-1)^|b| D_(a+b)(R) is (-1)^|a| D_(a+b)(-R). The sums have the sign.
                at[axis, lane] = centre[far_node, axis] - centre[node, axis]
                r2 += at[axis, lane] * at[axis, lane]
            at[4, lane] = 1.0 / r2
            at[3, lane] = np.sqrt(at[4, lane])
        for use in range(len(uses)):
            power, order, kind = uses[use, POWER], uses[use, ORDER], uses[use, KIND]
            if use == 0 or power != uses[use - 1, POWER]:
                _kernel_rows(at, power, seconds[use], order, powers)
                _derivatives(at, powers, order, monomials, derivatives)
            # Node by node, because its moments are contiguous in the cache.
            for lane in range(LANES):
                node_moments = moments[source[first + lane if lane < count else first], kind]
                factor = 1.0 if lane < count else 0.0
                for row in range(n_terms(order)):
                    gathered[row, lane] = factor * node_moments[row]
            for row in range(n_terms(order)):
                terms = n_terms(order - monomials[row, 3])
                add_products(sums, use * n + row, gathered, derivatives, added, row * n, terms)
    for use in range(len(uses)):
        for row in range(n_terms(uses[use, ORDER])):
            total = 0.0
            for lane in range(LANES):
                total += sums[use * n + row, lane]
            fields[uses[use, FIELD], row] += -total if monomials[row, 3] % 2 else total


@chunk_kernel
def add_potential(
    chunks: Share, atoms: Floats, field: int, order: int, leaves: Integers, centre: Floats, tabled: Any,
    fields: Floats, values: Floats,
) -> None:  # fmt: skip
    """Add a field to ``values`` (blocks * W,) at the atoms of some chunks."""
    monomials, _, _, _ = tabled
    rows = np.empty((len(monomials), W))
    for c in range(*chunks):
        begin, end = part(len(atoms), c)
        for block in range(begin, end):
            leaf = leaves[block]
            block_monomials(atoms[block], centre[leaf, 0], centre[leaf, 1], centre[leaf, 2], monomials, rows)
            for row in range(n_terms(order)):
                value = fields[leaf, field, row]
                for k in range(W):
                    values[block * W + k] += value * rows[row, k]


@chunk_kernel
def put_far_forces(
    chunks: Share, atoms: Floats, charges: Floats, orders: Integers, acts: Integers, factors: Floats,
    leaves: Integers, centre: Floats, tabled: Any, fields: Floats, forces: Floats, parts: Floats,
) -> None:  # fmt: skip
    """Put the forces (blocks, 3, W) of the fields on the atoms of some chunks, and add energies."""
    # ``acts`` (fields,) is the kind of charge on which a field acts, ``orders`` its order. ``factors``
    # (fields, 1 + components) are factors of its force, and of its energy in each row of ``parts``.
    monomials, _, raised, _ = tabled
    rows, gradient = np.empty((len(monomials), W)), np.empty((4, W))
    for c in range(*chunks):
        begin, end = part(len(atoms), c)
        for block in range(begin, end):
            leaf, force = leaves[block], forces[block]
            block_monomials(atoms[block], centre[leaf, 0], centre[leaf, 1], centre[leaf, 2], monomials, rows)
            for axis in range(3):
                for k in range(W):
                    force[axis, k] = 0.0
            for field in range(len(acts)):
                for axis in range(4):
                    for k in range(W):
                        gradient[axis, k] = 0.0
                n, n_forces = n_terms(orders[field]), n_terms(orders[field] - 1)
                _add_gradient(fields[leaf, field], raised, rows, n, n_forces, gradient)
                charge = charges[block, acts[field]]
                for axis in range(3):
                    for k in range(W):
                        force[axis, k] -= factors[field, 0] * charge[k] * gradient[axis, k]
                energy = dot(charge, gradient[3])
                for component in range(len(parts)):
                    parts[component, c] += factors[field, 1 + component] * energy


@tile_kernel
def _add_gradient(field: Floats, raised: Integers, rows: Floats, n: int, n_forces: int, out: Floats) -> None:
    """Add the gradient of a field at a block's atoms, and its value."""
    for row in range(n):
        monomial, value = rows[row], field[row]
        for k in range(W):
            out[3, k] += value * monomial[k]
    for row in range(n_forces):
        monomial = rows[row]
        for axis in range(3):
            value, total = field[raised[row, axis]], out[axis]
            for k in range(W):
                total[k] += value * monomial[k]
