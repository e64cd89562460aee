"""Second derivatives of pairs of atoms, and of Born radii, along the freedoms of a tree.

With u = r^2 a pair adds D = 4 E_uu d d^T + 2 E_u 1 between its atoms. Generalised Born radii B_i(I_i) depend
on all other atoms by I_i = sum h(r_ij), so that K also has terms with the rows P = dB/dq. These are computed
here atom by atom, from forces on all bodies, which are summed from the leaves inward. Twists and wrenches are
about one point, as in :mod:`protochain.minimisers.torsion_kernels`.
"""

import numpy as np

from protochain.core.arrays import Floats, Integers
from protochain.energies.native.born import descreening
from protochain.energies.native.layout import chunk_kernel, scalar

_FAR = 0.16
"""Square of s/r up to which the integral of a sphere is a series of :data:`_TERMS` terms."""
_TERMS = 18
_STEP = 1e-5
"""Relative step of the distance for the second derivative of an integral without a series."""
_K = np.arange(1.0, _TERMS + 1.0)
_VALUE = 2.0 * _K / (2.0 * _K + 1.0)
_SLOPE = -_VALUE * (2.0 * _K + 2.0)
_SECOND = -_SLOPE * (2.0 * _K + 3.0)
"""Coefficients of t^(k-1), t = (s/r)^2, of h = s^3/2r^4 sum 2k/(2k+1) t^(k-1) and its derivatives."""
_NEGLIGIBLE = 36.0
"""x of exp(-x) above which the Born radii of a pair are negligible: 2e-16 remains."""


Tree = tuple[Integers, Integers, Integers, Floats]
"""Parent, depth and first freedom of each body, and motions of the freedoms."""
Pairs = tuple[Floats, Integers, Floats, Floats, Integers, Integers, Floats]
"""Charges, Lennard-Jones types, their A and B, and starts, partners and parameters of exceptions."""
Salt = tuple[float, float]
"""Share of the solvent and kappa, both 0 without salt, as of ``energies.native.implicit.Solvent``."""
Solvent = tuple[bool, Floats, Floats, Floats, Floats, bool, Floats, Salt]
"""Whether it exists, charges, Born and offset radii, scaled radii, whether spheres engulf, pulls, salt."""


@scalar
def screening(r: float, u: float, radius: float, s: float, engulfs: bool) -> tuple[float, float, float]:
    """Descreening integral h of a sphere of radius s at distance r from an atom, h'/r and h'', u = 1/r^2."""
    t = s * s * u
    if t < _FAR and r - s > radius:
        terms = 5 if t < 0.001 else 9 if t < 0.02 else _TERMS
        value, slope, second = 0.0, 0.0, 0.0
        for k in range(terms - 1, -1, -1):
            value = value * t + _VALUE[k]
            slope = slope * t + _SLOPE[k]
            second = second * t + _SECOND[k]
        scale = 0.5 * s * t * u
        return scale * value, scale * slope * u, scale * second * u
    value, slope = descreening(r, radius, s, engulfs)
    after = descreening(r * (1.0 + _STEP), radius, s, engulfs)[1]
    before = descreening(r * (1.0 - _STEP), radius, s, engulfs)[1]
    return value, slope, slope + (after - before) / (2.0 * _STEP)


@scalar
def born_distance(r2: float, radii: float, inverse: float) -> tuple[float, float, float, float]:
    """Terms of a pair's energy -qq/f: f^2, 1/f, exp(-x) and x = r^2/4BB, given BB and its inverse."""
    x = 0.25 * r2 * inverse
    decay = np.exp(-x) if x < _NEGLIGIBLE else 0.0
    f2 = r2 + radii * decay
    return f2, 1.0 / np.sqrt(f2), decay, x


@scalar
def screen_slopes(f2: float, by_f: float, salt: Salt) -> tuple[float, float]:
    """Factors by which salt changes dE/df^2 and d2E/df^2 df^2 of an energy -qq/f, from f^2 and 1/f."""
    share, kappa = salt
    if kappa == 0.0:
        return 1.0, 1.0
    x = kappa * f2 * by_f
    decay = share * np.exp(-x)
    once = 1.0 + share - decay * (1.0 + x)
    return once, once - decay * x * x / 3.0


@scalar
def born_coupling(
    r2: float, radii: float, inverse: float, charges: float, salt: Salt
) -> tuple[float, float, float, float, float]:
    """Terms of a pair's energy E: dE/df^2 and d2E/df^2 df^2, exp(-x) and x, and d2E/dB_i dB_j."""
    f2, by_f, decay, x = born_distance(r2, radii, inverse)
    once, again = screen_slopes(f2, by_f, salt)
    twice = by_f * by_f
    by_f *= 0.5 * charges * twice
    twice *= -1.5 * by_f * again
    by_f *= once
    grown = decay * (1.0 + x)
    return by_f, twice, decay, x, twice * radii * grown * grown + by_f * decay * (1.0 + x + x * x)


@chunk_kernel
def couplings(
    begin: int, end: int, left: int, right: int, x: Floats, charge: Floats, born: Floats, salt: Salt,
    block: Floats,
) -> None:  # fmt: skip
    """Write d2E/dB dB of the atoms from ``begin`` to ``end`` with those from ``left`` to ``right``."""
    for i in range(begin, end):
        for j in range(left, right):
            dx, dy, dz = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], x[j, 2] - x[i, 2]
            r2, radii = dx * dx + dy * dy + dz * dz, born[i] * born[j]
            far = r2 > 4.0 * _NEGLIGIBLE * radii
            block[i - begin, j - left] = (
                0.0 if far else born_coupling(r2, radii, 1.0 / radii, charge[i] * charge[j], salt)[4]
            )


@chunk_kernel
def integrals(
    above: int, begin: int, end: int, x: Floats, body: Integers, first: Integers, radius: Floats,
    scaled: Floats, engulfs: bool, parent: Integers, v_start: Integers, motions: Floats, sums: Floats,
    along: Floats,
) -> None:  # fmt: skip
    """Write the integrals of some atoms, and their derivatives along all freedoms from row ``above`` on."""
    wrench = np.empty((len(parent), 6))
    for i in range(begin, end):
        wrench[:] = 0.0
        total = 0.0
        for c in range(len(parent)):
            gx, gy, gz, mx, my, mz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for j in range(first[c], first[c + 1]):
                if j == i:
                    continue
                dx, dy, dz = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], x[j, 2] - x[i, 2]
                r2 = dx * dx + dy * dy + dz * dz
                value, slope, _ = screening(np.sqrt(r2), 1.0 / r2, radius[i], scaled[j], engulfs)
                total += value
                fx, fy, fz = slope * dx, slope * dy, slope * dz
                gx, gy, gz = gx + fx, gy + fy, gz + fz
                mx += x[j, 1] * fz - x[j, 2] * fy
                my += x[j, 2] * fx - x[j, 0] * fz
                mz += x[j, 0] * fy - x[j, 1] * fx
            if c != body[i]:
                _push(wrench, body[i], c, x, i, gx, gy, gz, mx, my, mz)
        sums[i] = total
        _project(wrench, parent, v_start, motions, along[i - above])


@chunk_kernel
def born_rows(
    above: int, begin: int, end: int, x: Floats, body: Integers, first: Integers, charge: Floats,
    surface: Floats, born: Floats, salt: Salt, parent: Integers, v_start: Integers, motions: Floats,
    of_born: Floats, stiffness: Floats, along: Floats,
) -> None:  # fmt: skip
    """Write dE/dB and d2E/dB2 of some atoms, and d2E/dB dq at constant radii, from row ``above`` on."""
    wrench = np.empty((len(parent), 6))
    for i in range(begin, end):
        wrench[:] = 0.0
        inverse = 1.0 / born[i]
        sixth = surface[i] * inverse**6
        q2 = 0.5 * charge[i] * charge[i]
        once, again = screen_slopes(born[i] * born[i], inverse, salt)
        slope, second = (
            (once * q2 - 6.0 * sixth * born[i]) * inverse**2,
            (42.0 * sixth - (3.0 * again - once) * q2 * inverse) * inverse**2,
        )
        for c in range(len(parent)):
            gx, gy, gz, mx, my, mz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for j in range(first[c], first[c + 1]):
                dx, dy, dz = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], x[j, 2] - x[i, 2]
                r2 = dx * dx + dy * dy + dz * dz
                if j == i or r2 > 4.0 * _NEGLIGIBLE * born[i] * born[j]:
                    continue
                radii = born[i] * born[j]
                by_f, twice, decay, s, _ = born_coupling(r2, radii, 1.0 / radii, charge[i] * charge[j], salt)
                of_i = born[j] * decay * (1.0 + s)
                slope += by_f * of_i
                second += twice * of_i * of_i + by_f * born[j] * decay * s * s * inverse
                mixed = twice * (1.0 - 0.25 * decay) * of_i - 0.25 * by_f * decay * s * inverse
                fx, fy, fz = 2.0 * mixed * dx, 2.0 * mixed * dy, 2.0 * mixed * dz
                gx, gy, gz = gx + fx, gy + fy, gz + fz
                mx += x[j, 1] * fz - x[j, 2] * fy
                my += x[j, 2] * fx - x[j, 0] * fz
                mz += x[j, 0] * fy - x[j, 1] * fx
            if c != body[i]:
                _push(wrench, body[i], c, x, i, gx, gy, gz, mx, my, mz)
        of_born[i], stiffness[i] = slope, second
        _project(wrench, parent, v_start, motions, along[i - above])


@scalar
def _push(
    wrench: Floats, a: int, b: int, x: Floats, i: int, fx: float, fy: float, fz: float, mx: float, my: float,
    mz: float,
) -> None:  # fmt: skip
    """Add a force with its moment to body b, and the opposite force on atom i to body a."""
    wrench[b, 0] += mx
    wrench[b, 1] += my
    wrench[b, 2] += mz
    wrench[b, 3] += fx
    wrench[b, 4] += fy
    wrench[b, 5] += fz
    wrench[a, 0] -= x[i, 1] * fz - x[i, 2] * fy
    wrench[a, 1] -= x[i, 2] * fx - x[i, 0] * fz
    wrench[a, 2] -= x[i, 0] * fy - x[i, 1] * fx
    wrench[a, 3] -= fx
    wrench[a, 4] -= fy
    wrench[a, 5] -= fz


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


@chunk_kernel
def pair_sweep(
    bodies: Integers, begin: int, end: int, tree: Tree, atoms: tuple[Floats, Integers], pairs: Pairs,
    solvent: Solvent, sums: tuple[Floats, Floats, Floats, Floats],
) -> None:  # fmt: skip
    """Wrenches on some bodies, at unit rates of earlier bodies from ``begin`` to ``end``."""
    # Atoms are in the order of their bodies. In ``sums``, ``rows`` has blocks (6, 6 nb), summed from the
    # leaves inward, and ``along`` has their components along the freedoms of the bodies. The stiffness of
    # each single atom, (xx, xy, xz, yy, yz, zz), and the force on it are written to ``sources`` for atoms of
    # the bodies, and are added to ``targets`` for the other atoms.
    parent, depth, v_start, motions = tree
    (x, first), (rows, along, sources, targets) = atoms, sums
    charge, lj_type, a12, b6, partner_start, partner, stiffness = pairs
    solvated, gb_charge, born, radius, scaled, engulfs, pull, salt = solvent
    over = 1.0 / born
    mark = np.full(len(x), -1, np.int64)
    g, block = np.empty((3, 6)), np.empty(9)
    atom, freedom = 0, 0
    for b in bodies:
        row = rows[depth[b]]
        for i in range(first[b], first[b + 1]):
            for m in range(partner_start[i], partner_start[i + 1]):
                mark[partner[m]] = m
            xi, yi, zi = x[i, 0], x[i, 1], x[i, 2]
            block[:] = 0.0
            for c in range(begin, min(b, end)):
                fx, fy, fz = 0.0, 0.0, 0.0
                pxx, pxy, pxz, pyy, pyz, pzz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
                txx, txy, txz, tyx, tyy, tyz, tzx, tzy, tzz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
                for j in range(first[c], first[c + 1]):
                    xj, yj, zj = x[j, 0], x[j, 1], x[j, 2]
                    dx, dy, dz = xi - xj, yi - yj, zi - zj
                    r2 = dx * dx + dy * dy + dz * dz
                    u = 1.0 / r2
                    m = mark[j]
                    if m < 0:
                        one, type_j = lj_type[i], lj_type[j]
                        a, b_, qq = a12[one, type_j], b6[one, type_j], charge[i] * charge[j]
                    else:
                        a, b_, qq = stiffness[m, 0], stiffness[m, 1], stiffness[m, 2]
                    u3 = u * u * u
                    r = np.sqrt(r2)
                    twelve, six, coulomb = a * u3 * u3, b_ * u3, qq * r * u
                    e1 = (-6.0 * twelve + 3.0 * six - 0.5 * coulomb) * u
                    e2 = (42.0 * twelve - 12.0 * six + 0.75 * coulomb) * u * u
                    if solvated:
                        inverse = over[i] * over[j]
                        f2, by_f, decay, _ = born_distance(r2, born[i] * born[j], inverse)
                        once, again = screen_slopes(f2, by_f, salt)
                        over_f2, by_u = by_f * by_f, 1.0 - 0.25 * decay
                        by_f *= 0.5 * gb_charge[i] * gb_charge[j] * over_f2
                        e1 += by_f * once * by_u
                        e2 += by_f * (once * 0.0625 * decay * inverse - again * 1.5 * by_u * by_u * over_f2)
                        _, slope, second = screening(r, u, radius[i], scaled[j], engulfs)
                        e1 += 0.5 * pull[i] * slope
                        e2 += 0.25 * pull[i] * (second - slope) * u
                        _, slope, second = screening(r, u, radius[j], scaled[i], engulfs)
                        e1 += 0.5 * pull[j] * slope
                        e2 += 0.25 * pull[j] * (second - slope) * u
                    along_, across = 4.0 * e2, 2.0 * e1
                    px, py, pz = across * dx, across * dy, across * dz
                    fx, fy, fz = fx - px, fy - py, fz - pz
                    xx, yy, zz = (
                        along_ * dx * dx + across,
                        along_ * dy * dy + across,
                        along_ * dz * dz + across,
                    )
                    xy, xz, yz = along_ * dx * dy, along_ * dx * dz, along_ * dy * dz
                    targets[j, 0] += xx
                    targets[j, 1] += xy
                    targets[j, 2] += xz
                    targets[j, 3] += yy
                    targets[j, 4] += yz
                    targets[j, 5] += zz
                    targets[j, 6] += px
                    targets[j, 7] += py
                    targets[j, 8] += pz
                    pxx, pxy, pxz = pxx + xx, pxy + xy, pxz + xz
                    pyy, pyz, pzz = pyy + yy, pyz + yz, pzz + zz
                    # D (omega cross x_j), for each axis of omega.
                    txx += yj * xz - zj * xy
                    txy += zj * xx - xj * xz
                    txz += xj * xy - yj * xx
                    tyx += yj * yz - zj * yy
                    tyy += zj * xy - xj * yz
                    tyz += xj * yy - yj * xy
                    tzx += yj * zz - zj * yz
                    tzy += zj * xz - xj * zz
                    tzz += xj * yz - yj * xz
                g[0, 0], g[0, 1], g[0, 2], g[0, 3], g[0, 4], g[0, 5] = -txx, -txy, -txz, -pxx, -pxy, -pxz
                g[1, 0], g[1, 1], g[1, 2], g[1, 3], g[1, 4], g[1, 5] = -tyx, -tyy, -tyz, -pxy, -pyy, -pyz
                g[2, 0], g[2, 1], g[2, 2], g[2, 3], g[2, 4], g[2, 5] = -tzx, -tzy, -tzz, -pxz, -pyz, -pzz
                _add_moments(row, 6 * c, g, xi, yi, zi)
                for p, value in enumerate((pxx, pxy, pxz, pyy, pyz, pzz, fx, fy, fz)):
                    block[p] += value
            # Stiffness and force of the atom are complete.
            sources[atom] = block
            atom += 1
            for m in range(partner_start[i], partner_start[i + 1]):
                mark[partner[m]] = -1
        for k in range(v_start[b], v_start[b + 1]):
            for c in range(6 * begin, 6 * end):
                value = 0.0
                for p in range(6):
                    value += motions[k, p] * row[p, c]
                along[freedom, c] = value
            freedom += 1
        inner = parent[b]
        if inner < 0 or depth[inner] != depth[b]:
            for p in range(6):
                for c in range(6 * begin, 6 * end):
                    if inner >= 0:
                        rows[depth[inner], p, c] += row[p, c]
                    row[p, c] = 0.0


@chunk_kernel
def add_rows(
    begin: int, end: int, freedoms: Integers, parent: Integers, v_start: Integers, motions: Floats,
    along: Floats, matrix: Floats,
) -> None:  # fmt: skip
    """Add twice the wrenches along some freedoms, summed from the leaves inward, to rows of the stiffness."""
    for m in range(begin, end):
        row, to = along[m], matrix[freedoms[m]]
        for c in range(len(parent) - 1, -1, -1):
            for j in range(v_start[c], v_start[c + 1]):
                value = 0.0
                for p in range(6):
                    value += motions[j, p] * row[6 * c + p]
                to[j] += 2.0 * value
            if parent[c] >= 0:
                for p in range(6):
                    row[6 * parent[c] + p] += row[6 * c + p]


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
