"""Second derivatives of pairs of atoms, and of Born radii, along the freedoms of a tree.

With u = r^2 a pair adds D = 4 E_uu d d^T + 2 E_u 1 between its atoms. Generalised Born radii B_i(I_i) depend
on all other atoms by I_i = sum h(r_ij), so that K has also terms with the rows P = dB/dq, which is made here
for one atom after the other: forces on all bodies, added up from the leaves inward. Twists and wrenches are
about one point, as in :mod:`protochain.minimisers.torsion_kernels`.
"""

import numpy as np

from protochain.core.arrays import Floats, Integers
from protochain.energies.native.born import descreening
from protochain.energies.native.layout import scalar, shared

_FAR = 0.16
"""Square of s/r up to which the integral of a sphere is a series that ends at once."""
_STEP = 1e-5
"""Of the distance, for the second derivative of an integral that is no series."""


@scalar
def screening(r: float, radius: float, s: float, engulfs: bool) -> tuple[float, float, float]:
    """Descreening integral h of a sphere of radius s at distance r from an atom, h'/r, and h''."""
    t = s * s / (r * r)
    if t < _FAR and r - s > radius:
        # s^3/2r^4 times the sum of 2k/(2k+1) t^(k-1).
        value, slope, second, power, k = 0.0, 0.0, 0.0, 1.0, 1.0
        while power > 1e-18:
            c = 2.0 * k / (2.0 * k + 1.0) * power
            value += c
            slope -= c * (2.0 * k + 2.0)
            second += c * (2.0 * k + 2.0) * (2.0 * k + 3.0)
            power *= t
            k += 1.0
        scale = 0.5 * s * s * s / (r * r * r * r)
        return scale * value, scale * slope / (r * r), scale * second / (r * r)
    value, slope = descreening(r, radius, s, engulfs)
    after = descreening(r * (1.0 + _STEP), radius, s, engulfs)[1]
    before = descreening(r * (1.0 - _STEP), radius, s, engulfs)[1]
    return value, slope, slope + (after - before) / (2.0 * _STEP)


@scalar
def still(r2: float, born_i: float, born_j: float) -> tuple[float, float, float]:
    """Factors of a pair's generalised Born energy -qq/f: f^2, exp(-x) and x, with x = r^2/4 B B."""
    x = 0.25 * r2 / (born_i * born_j)
    decay = np.exp(-x)
    return r2 + born_i * born_j * decay, decay, x


@shared
def integrals(
    begin: int, end: int, x: Floats, body: Integers, radius: Floats, scaled: Floats, engulfs: bool,
    parent: Integers, v_start: Integers, motions: Floats, sums: Floats, along: Floats,
) -> None:  # fmt: skip
    """Write the integrals of some atoms, and their derivatives along all freedoms."""
    wrench = np.empty((len(parent), 6))
    for i in range(begin, end):
        wrench[:] = 0.0
        total = 0.0
        for j in range(len(x)):
            if j == i:
                continue
            dx, dy, dz = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], x[j, 2] - x[i, 2]
            r = np.sqrt(dx * dx + dy * dy + dz * dz)
            value, slope, _ = screening(r, radius[i], scaled[j], engulfs)
            total += value
            if body[j] != body[i]:
                _push(wrench, body[i], body[j], x, i, j, slope * dx, slope * dy, slope * dz)
        sums[i] = total
        _project(wrench, parent, v_start, motions, along[i])


@shared
def born_rows(
    first: int, begin: int, end: int, x: Floats, body: Integers, charge: Floats, surface: Floats,
    born: Floats, parent: Integers, v_start: Integers, motions: Floats, of_born: Floats, couplings: Floats,
    along: Floats,
) -> None:  # fmt: skip
    """Write dE/dB of some atoms, d2E/dB dB with all, d2E/dB dq at constant radii, from row ``first`` on."""
    wrench = np.empty((len(parent), 6))
    for i in range(begin, end):
        wrench[:] = 0.0
        row, inverse = couplings[i - first], 1.0 / born[i]
        sixth = surface[i] * inverse**6
        q2 = 0.5 * charge[i] * charge[i]
        slope, own = (
            (q2 - 6.0 * sixth * born[i]) * inverse**2,
            (42.0 * sixth - 2.0 * q2 * inverse) * inverse**2,
        )
        for j in range(len(x)):
            if j == i:
                continue
            dx, dy, dz = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], x[j, 2] - x[i, 2]
            f2, decay, s = still(dx * dx + dy * dy + dz * dz, born[i], born[j])
            by_f = 0.5 * charge[i] * charge[j] / (f2 * np.sqrt(f2))
            twice = -1.5 * by_f / f2
            of_i, of_j = born[j] * decay * (1.0 + s), born[i] * decay * (1.0 + s)
            slope += by_f * of_i
            own += twice * of_i * of_i + by_f * born[j] * decay * s * s * inverse
            row[j] = twice * of_i * of_j + by_f * decay * (1.0 + s + s * s)
            if body[j] != body[i]:
                mixed = twice * (1.0 - 0.25 * decay) * of_i - 0.25 * by_f * decay * s * inverse
                force = 2.0 * mixed
                _push(wrench, body[i], body[j], x, i, j, force * dx, force * dy, force * dz)
        of_born[i], row[i] = slope, own
        _project(wrench, parent, v_start, motions, along[i - first])


@scalar
def _push(wrench: Floats, a: int, b: int, x: Floats, i: int, j: int, fx: float, fy: float, fz: float) -> None:
    """Add a force on atom j to body b, and its opposite on atom i to body a."""
    for to, at, sign in ((b, j, 1.0), (a, i, -1.0)):
        gx, gy, gz = sign * fx, sign * fy, sign * fz
        wrench[to, 0] += x[at, 1] * gz - x[at, 2] * gy
        wrench[to, 1] += x[at, 2] * gx - x[at, 0] * gz
        wrench[to, 2] += x[at, 0] * gy - x[at, 1] * gx
        wrench[to, 3] += gx
        wrench[to, 4] += gy
        wrench[to, 5] += gz


@scalar
def _project(wrench: Floats, parent: Integers, v_start: Integers, motions: Floats, along: Floats) -> None:
    """Add wrenches up from the leaves inward, and write their components along the freedoms."""
    for b in range(len(parent) - 1, -1, -1):
        for v in range(v_start[b], v_start[b + 1]):
            value = 0.0
            for p in range(6):
                value += motions[v, p] * wrench[b, p]
            along[v] = value
        if parent[b] >= 0:
            for p in range(6):
                wrench[parent[b], p] += wrench[b, p]


@shared
def pair_sweep(
    begin: int, end: int, parent: Integers, order: Integers, depth: Integers, v_start: Integers,
    motions: Floats, x: Floats, body: Integers, first: Integers, charge: Floats, lj_type: Integers,
    a12: Floats, b6: Floats, partner_start: Integers, partner: Integers, own: Floats, solvated: bool,
    gb_charge: Floats, born: Floats, radius: Floats, scaled: Floats, engulfs: bool, pull: Floats,
    forces: Floats, matrix: Floats,
) -> None:  # fmt: skip
    """Write the stiffness in torsions of the pairs with bodies from ``begin`` to ``end``, and their forces.

    Atoms lie in the order of their bodies. A row of blocks, (6, 6 nb), is summed from the leaves inward.
    """
    n, deepest = len(parent), 0
    for b in range(n):
        deepest = max(deepest, depth[b])
    rows, along = np.zeros((deepest + 1, 6, 6 * n)), np.empty(6 * n)
    mark = np.full(len(x), -1, np.int64)
    g = np.empty((3, 6))
    for b in order:
        row = rows[depth[b]]
        for i in range(first[b], first[b + 1]):
            for m in range(partner_start[i], partner_start[i + 1]):
                mark[partner[m]] = m
            xi, yi, zi = x[i, 0], x[i, 1], x[i, 2]
            fx, fy, fz = 0.0, 0.0, 0.0
            sxx, sxy, sxz, syy, syz, szz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for c in range(begin, end):
                if c == b:
                    continue
                g[:] = 0.0
                for j in range(first[c], first[c + 1]):
                    xj, yj, zj = x[j, 0], x[j, 1], x[j, 2]
                    dx, dy, dz = xi - xj, yi - yj, zi - zj
                    r2 = dx * dx + dy * dy + dz * dz
                    u = 1.0 / r2
                    m = mark[j]
                    if m < 0:
                        a, b_, qq = (
                            a12[lj_type[i], lj_type[j]],
                            b6[lj_type[i], lj_type[j]],
                            charge[i] * charge[j],
                        )
                    else:
                        a, b_, qq = own[m, 0], own[m, 1], own[m, 2]
                    u3 = u * u * u
                    r = np.sqrt(r2)
                    twelve, six, coulomb = a * u3 * u3, b_ * u3, qq / r
                    e1 = (-6.0 * twelve + 3.0 * six - 0.5 * coulomb) * u
                    e2 = (42.0 * twelve - 12.0 * six + 0.75 * coulomb) * u * u
                    if solvated:
                        f2, decay, _ = still(r2, born[i], born[j])
                        by_f = 0.5 * gb_charge[i] * gb_charge[j] / (f2 * np.sqrt(f2))
                        by_u = 1.0 - 0.25 * decay
                        e1 += by_f * by_u
                        e2 += by_f * (decay / (16.0 * born[i] * born[j]) - 1.5 * by_u * by_u / f2)
                        _, slope, second = screening(r, radius[i], scaled[j], engulfs)
                        e1 += 0.5 * pull[i] * slope
                        e2 += 0.25 * pull[i] * (second - slope) * u
                        _, slope, second = screening(r, radius[j], scaled[i], engulfs)
                        e1 += 0.5 * pull[j] * slope
                        e2 += 0.25 * pull[j] * (second - slope) * u
                    along_, across = 4.0 * e2, 2.0 * e1
                    fx -= across * dx
                    fy -= across * dy
                    fz -= across * dz
                    xx, yy, zz = (
                        along_ * dx * dx + across,
                        along_ * dy * dy + across,
                        along_ * dz * dz + across,
                    )
                    xy, xz, yz = along_ * dx * dy, along_ * dx * dz, along_ * dy * dz
                    sxx += xx
                    sxy += xy
                    sxz += xz
                    syy += yy
                    syz += yz
                    szz += zz
                    # -D (omega cross x_j + u): columns of a turn are x_j cross the rows of D.
                    g[0, 0] -= yj * xz - zj * xy
                    g[0, 1] -= zj * xx - xj * xz
                    g[0, 2] -= xj * xy - yj * xx
                    g[1, 0] -= yj * yz - zj * yy
                    g[1, 1] -= zj * xy - xj * yz
                    g[1, 2] -= xj * yy - yj * xy
                    g[2, 0] -= yj * zz - zj * yz
                    g[2, 1] -= zj * xz - xj * zz
                    g[2, 2] -= xj * yz - yj * xz
                    g[0, 3] -= xx
                    g[0, 4] -= xy
                    g[0, 5] -= xz
                    g[1, 3] -= xy
                    g[1, 4] -= yy
                    g[1, 5] -= yz
                    g[2, 3] -= xz
                    g[2, 4] -= yz
                    g[2, 5] -= zz
                _add_moments(row, 6 * c, g, xi, yi, zi)
            _of_itself(g, sxx, sxy, sxz, syy, syz, szz, xi, yi, zi)
            _add_moments(row, 6 * b, g, xi, yi, zi)
            forces[i, 0] += fx
            forces[i, 1] += fy
            forces[i, 2] += fz
            for m in range(partner_start[i], partner_start[i + 1]):
                mark[partner[m]] = -1
        for k in range(v_start[b], v_start[b + 1]):
            for c in range(6 * n):
                value = 0.0
                for p in range(6):
                    value += motions[k, p] * row[p, c]
                along[c] = value
            for c in range(n - 1, -1, -1):
                for j in range(v_start[c], v_start[c + 1]):
                    value = 0.0
                    for p in range(6):
                        value += motions[j, p] * along[6 * c + p]
                    matrix[k, j] = value
                if parent[c] >= 0:
                    for p in range(6):
                        along[6 * parent[c] + p] += along[6 * c + p]
        inner = parent[b]
        if inner < 0 or depth[inner] != depth[b]:
            for p in range(6):
                for c in range(6 * n):
                    if inner >= 0:
                        rows[depth[inner], p, c] += row[p, c]
                    row[p, c] = 0.0


@scalar
def _add_moments(row: Floats, at: int, g: Floats, x: float, y: float, z: float) -> None:
    """Add forces g (3, 6) on a point, with their moments, to a block (6, 6) of a row."""
    for q in range(6):
        gx, gy, gz = g[0, q], g[1, q], g[2, q]
        row[0, at + q] += y * gz - z * gy
        row[1, at + q] += z * gx - x * gz
        row[2, at + q] += x * gy - y * gx
        row[3, at + q] += gx
        row[4, at + q] += gy
        row[5, at + q] += gz


@scalar
def _of_itself(
    g: Floats, xx: float, xy: float, xz: float, yy: float, yz: float, zz: float, x: float, y: float, z: float
) -> None:  # fmt: skip
    """Forces g (3, 6) = D (omega cross x + u) of an atom's own block D."""
    rows = ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))
    for k in range(3):
        d = rows[k]
        g[k, 0] = y * d[2] - z * d[1]
        g[k, 1] = z * d[0] - x * d[2]
        g[k, 2] = x * d[1] - y * d[0]
        g[k, 3], g[k, 4], g[k, 5] = d
