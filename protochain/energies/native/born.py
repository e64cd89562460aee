"""Born radii by pairwise descreening, polar energies of pairs, and forces due to changes of the radii.

Hawkins, Cramer, Truhlar, J. Phys. Chem. 100:19824 (1996), equations 9-11, with the radii of Onufriev,
Bashford, Case, Proteins 55:383 (2004). If atom j is wholly outside atom i, its integral
(s/(r^2 - s^2) - atanh(s/r)/r) / 2 is s^3 / (2 r^4) times a series in (s/r)^2, independent of atom i and
without logarithm or root. The few nearer pairs come from a list.
"""

from typing import Any

import numpy as np

from protochain.core.arrays import Floats, Integers
from protochain.energies.native.layout import (
    BORN,
    FX,
    FY,
    FZ,
    GB_CHARGE,
    HALF_INVERSE_BORN,
    PULL,
    S2,
    S3,
    SCALAR,
    Share,
    W,
    X,
    Y,
    Z,
    box_distance2,
    chunk_kernel,
    far_rows2,
    part,
    scalar,
    tile_kernel,
    variant,
)  # fmt: skip
from protochain.energies.native.pairs import CLOSEST, difference, push
from protochain.energies.native.series import integral_series, inverse_root, logarithm, power_of_two

_LN2 = float(np.log(2.0))
_LOG2E = 1.0 / _LN2
BATCH = 64  # Near pairs computed at a time.


@chunk_kernel
def integral_sums(
    chunks: Share, atoms: Floats, tiles: Integers, is_near: np.ndarray, near: float, block_near: Floats,
    cutoff: float, sums: Floats,
) -> None:  # fmt: skip
    """Add the descreening integrals of all pairs at ``near`` or further to row SCALAR of the sums."""
    for c in range(*chunks):
        begin, end = part(len(tiles), c)
        for k in range(begin, end):
            i, j = tiles[k, 0], tiles[k, 1]
            far2 = far_rows2(is_near[k], block_near[i], block_near[j], cutoff)
            _integral_tile(
                atoms[i], atoms[j], i == j, near * near, far2, cutoff * cutoff, sums[c, i], sums[c, j]
            )


@tile_kernel
def _integral_tile(
    a: Floats, b: Floats, same: bool, near2: float, far2: float, cutoff2: float, a_sums: Floats,
    b_sums: Floats,
) -> None:  # fmt: skip
    for i in range(W):
        if box_distance2(a, i, b) < far2:
            add_integrals(a, i, b, same, True, near2, cutoff2, a_sums, b_sums)
        else:
            add_integrals(a, i, b, same, False, near2, cutoff2, a_sums, b_sums)


@variant
def add_integrals(
    a: Floats, i: int, b: Floats, same: bool, masked: bool, near2: float, cutoff2: float, a_sums: Floats,
    b_sums: Floats,
) -> None:  # fmt: skip
    """Add the integrals of one row of a tile: an atom with a block."""
    xi, yi, zi, first = a[X * W + i], a[Y * W + i], a[Z * W + i], i if same else -1
    s2, s3 = a[S2 * W + i], a[S3 * W + i]
    total = 0.0
    for j in range(W):
        dx, dy, dz = xi - b[X * W + j], yi - b[Y * W + j], zi - b[Z * W + j]
        r2 = dx * dx + dy * dy + dz * dz
        # One division per pair costs less than a root by polynomials, because the divider is otherwise idle.
        inverse2 = 1.0 / r2
        if masked:
            inverse2 = inverse2 if (r2 >= near2) & (r2 < cutoff2) & (j > first) else 0.0
        g = integral_series(b[S2 * W + j] * inverse2, masked)
        h = integral_series(s2 * inverse2, masked)
        inverse4 = inverse2 * inverse2
        total += b[S3 * W + j] * inverse4 * g
        b_sums[SCALAR * W + j] += s3 * inverse4 * h
    a_sums[SCALAR * W + i] += total


@chunk_kernel
def polar_sums(
    chunks: Share, atoms: Floats, tiles: Integers, cutoff: float, salt: Any, sums: Floats, energies: Floats
) -> None:
    """Add the generalised-Born energy of all pairs, its forces, and 2 dE/dB to row SCALAR of the sums."""
    # -q q / f with f^2 = r^2 + P exp(-r^2 / 4P), P = B B: Still, Tempczyk, Hawley, Hendrickson, JACS 112:6127
    # (1990), equation 3. Salt multiplies it by 1 + w (1 - exp(-kappa f)): Srinivasan, Trevathan, Beroza,
    # Case, Theor. Chem. Acc. 101:426 (1999).
    for c in range(*chunks):
        begin, end = part(len(tiles), c)
        energy, rows = 0.0, np.empty(3 * W)
        for k in range(begin, end):
            i, j = tiles[k, 0], tiles[k, 1]
            masked = i == j or cutoff < np.inf
            if salt is None:
                energy -= _polar_tile(
                    atoms[i], atoms[j], i == j, masked, cutoff * cutoff, 1.0 / cutoff, rows, sums[c, i],
                    sums[c, j],
                )  # fmt: skip
            else:
                energy -= _salted_tile(
                    atoms[i], atoms[j], i == j, cutoff * cutoff, 1.0 / cutoff, salt[0], salt[1], rows,
                    sums[c, i], sums[c, j],
                )  # fmt: skip
        energies[c] += energy


@tile_kernel
def _polar_tile(
    a: Floats, b: Floats, same: bool, masked: bool, cutoff2: float, shift: float, rows: Floats,
    a_sums: Floats, b_sums: Floats,
) -> float:  # fmt: skip
    if masked:
        return add_polar(a, b, same, True, False, cutoff2, shift, 0.0, 0.0, rows, a_sums, b_sums)
    return add_polar(a, b, same, False, False, cutoff2, shift, 0.0, 0.0, rows, a_sums, b_sums)


@tile_kernel
def _salted_tile(
    a: Floats, b: Floats, same: bool, cutoff2: float, shift: float, share: float, kappa: float, rows: Floats,
    a_sums: Floats, b_sums: Floats,
) -> float:  # fmt: skip
    return add_polar(a, b, same, True, True, cutoff2, shift, share, kappa, rows, a_sums, b_sums)


@variant
def _decays(a: Floats, i: int, b: Floats, rows: Floats) -> None:
    """Write rows of an atom with a block: f^2, its exponential e, and e (1 + r^2 / 4P), the slope by P."""
    xi, yi, zi = a[X * W + i], a[Y * W + i], a[Z * W + i]
    born, half = a[BORN * W + i], -_LOG2E * a[HALF_INVERSE_BORN * W + i]
    for j in range(W):
        dx, dy, dz = xi - b[X * W + j], yi - b[Y * W + j], zi - b[Z * W + j]
        r2 = dx * dx + dy * dy + dz * dz
        exponent = r2 * (half * b[HALF_INVERSE_BORN * W + j])
        decay = power_of_two(exponent)
        rows[j] = r2 + born * b[BORN * W + j] * decay
        rows[W + j] = decay
        rows[2 * W + j] = decay - decay * exponent * _LN2


@variant
def add_polar(
    a: Floats, b: Floats, same: bool, masked: bool, salted: bool, cutoff2: float, shift: float, share: float,
    kappa: float, rows: Floats, a_sums: Floats, b_sums: Floats,
) -> float:  # fmt: skip
    """Add forces and 2 dE/dB, and return minus the energy."""
    # Two loops, with ``rows`` between them: the processor executes shorter chains of dependences in parallel.
    energy = 0.0
    for i in range(W):
        _decays(a, i, b, rows)
        xi, yi, zi, first = a[X * W + i], a[Y * W + i], a[Z * W + i], i if same else -1
        qi, born = a[GB_CHARGE * W + i], a[BORN * W + i]
        fx, fy, fz, slope = 0.0, 0.0, 0.0, 0.0
        for j in range(W):
            dx, dy, dz = xi - b[X * W + j], yi - b[Y * W + j], zi - b[Z * W + j]
            inverse_f, qq = inverse_root(rows[j]), qi * b[GB_CHARGE * W + j]
            if masked:
                qq = qq if (dx * dx + dy * dy + dz * dz < cutoff2) & (j > first) else 0.0
                if not salted:
                    energy -= qq * shift
            pair = qq * inverse_f
            if salted:
                decay = share * power_of_two(kappa * -_LOG2E * rows[j] * inverse_f)
                screen = 1.0 + share - decay
                energy += qq * screen * (inverse_f - shift)
                cube = pair * (screen * inverse_f * inverse_f - kappa * decay * (inverse_f - shift))
            else:
                energy += pair
                cube = pair * (inverse_f * inverse_f)
            f = cube - 0.25 * cube * rows[W + j]
            with_born = cube * rows[2 * W + j]
            slope += with_born * b[BORN * W + j]
            fx += f * dx
            fy += f * dy
            fz += f * dz
            b_sums[FX * W + j] += f * dx
            b_sums[FY * W + j] += f * dy
            b_sums[FZ * W + j] += f * dz
            b_sums[SCALAR * W + j] += with_born * born
        a_sums[FX * W + i] -= fx
        a_sums[FY * W + i] -= fy
        a_sums[FZ * W + i] -= fz
        a_sums[SCALAR * W + i] += slope
    return energy


@chunk_kernel
def screened_sums(
    chunks: Share, atoms: Floats, tiles: Integers, rows: np.ndarray, sums: Floats, energies: Floats
) -> None:  # fmt: skip
    """Add the difference of 1/f and 1/r to energy, forces and 2 dE/dB, for selected rows of far tiles."""
    for c in range(*chunks):
        begin, end = part(len(tiles), c)
        energy, buffer = 0.0, np.empty(3 * W)
        for k in range(begin, end):
            i, j = tiles[k, 0], tiles[k, 1]
            energy -= _screened_tile(atoms[i], atoms[j], rows[k], buffer, sums[c, i], sums[c, j])
        energies[c] += energy


@tile_kernel
def _screened_tile(
    a: Floats, b: Floats, counts: np.ndarray, rows: Floats, a_sums: Floats, b_sums: Floats
) -> float:
    """As :func:`add_polar`, minus the energy and force of 1/r."""
    energy = 0.0
    for i in range(W):
        if not counts[i]:
            continue
        _decays(a, i, b, rows)
        xi, yi, zi, qi = a[X * W + i], a[Y * W + i], a[Z * W + i], a[GB_CHARGE * W + i]
        born, fx, fy, fz, slope = a[BORN * W + i], 0.0, 0.0, 0.0, 0.0
        for j in range(W):
            dx, dy, dz = xi - b[X * W + j], yi - b[Y * W + j], zi - b[Z * W + j]
            inverse_f, qq = inverse_root(rows[j]), qi * b[GB_CHARGE * W + j]
            inverse = inverse_root(dx * dx + dy * dy + dz * dz)
            energy += qq * (inverse_f - inverse)
            cube = qq * (inverse_f * inverse_f * inverse_f)
            f = cube - 0.25 * cube * rows[W + j] - qq * (inverse * inverse * inverse)
            with_born = cube * rows[2 * W + j]
            slope += with_born * b[BORN * W + j]
            fx += f * dx
            fy += f * dy
            fz += f * dz
            b_sums[FX * W + j] += f * dx
            b_sums[FY * W + j] += f * dy
            b_sums[FZ * W + j] += f * dz
            b_sums[SCALAR * W + j] += with_born * born
        a_sums[FX * W + i] -= fx
        a_sums[FY * W + i] -= fy
        a_sums[FZ * W + i] -= fz
        a_sums[SCALAR * W + i] += slope
    return energy


@chunk_kernel
def near_integral_sums(
    chunks: Share, x: Floats, offset_radius: Floats, scaled_radius: Floats, engulfs: bool, pairs: Integers,
    near: float, slopes: Floats, sums: Floats,
) -> None:  # fmt: skip
    """Add the integrals of listed pairs nearer than ``near``, and store their slopes over distance."""
    # Near pairs are computed in batches, as vectors.
    for c in range(*chunks):
        begin, end = part(len(pairs), c)
        batch, pair_index, count = np.ones(9 * BATCH), np.empty(BATCH, np.int64), 0
        for k in range(begin, end):
            i, j = pairs[k, 0], pairs[k, 1]
            r2 = max(difference(x, i, j)[3], CLOSEST)
            slopes[k, 0], slopes[k, 1] = 0.0, 0.0
            if r2 < near * near:
                pair_index[count], batch[count] = k, r2
                batch[BATCH + count], batch[2 * BATCH + count] = offset_radius[i], scaled_radius[i]
                batch[3 * BATCH + count], batch[4 * BATCH + count] = offset_radius[j], scaled_radius[j]
                count += 1
            if count == BATCH or k == end - 1:
                _descreenings(batch, engulfs)
                for slot in range(count):
                    pair, i, j = pair_index[slot], pairs[pair_index[slot], 0], pairs[pair_index[slot], 1]
                    sums[c, i // W, SCALAR * W + i % W] += batch[5 * BATCH + slot]
                    sums[c, j // W, SCALAR * W + j % W] += batch[6 * BATCH + slot]
                    slopes[pair, 0], slopes[pair, 1] = batch[7 * BATCH + slot], batch[8 * BATCH + slot]
                count = 0


@tile_kernel
def _descreenings(batch: Floats, engulfs: bool) -> None:
    """Compute rows of integrals and slopes of atoms i and j from rows of r^2, offset and scaled radii."""
    for k in range(BATCH):
        r = np.sqrt(batch[k])
        of_i, slope_i = descreening(r, batch[BATCH + k], batch[4 * BATCH + k], engulfs)
        of_j, slope_j = descreening(r, batch[3 * BATCH + k], batch[2 * BATCH + k], engulfs)
        batch[5 * BATCH + k], batch[6 * BATCH + k] = of_i, of_j
        batch[7 * BATCH + k], batch[8 * BATCH + k] = slope_i, slope_j


@variant
def descreening(r: float, radius: float, s: float, engulfs: bool) -> tuple[float, float]:
    """Descreening integral of a sphere of radius s at distance r from an atom, and its slope divided by r."""
    # ``engulfs`` adds 1/radius - 1/L if the sphere contains the whole atom, as in GBSAOBCForce. The code has
    # no branches, to vectorise.
    reach, furthest = abs(r - s), r + s
    outside = reach > radius
    nearest = reach if outside else radius
    product = 1.0 / (nearest * furthest * r)
    lower, upper, inverse = furthest * r * product, nearest * r * product, nearest * furthest * product
    # L changes with r if the nearest point of the sphere is outside the atom.
    moves = (-lower if r > s else lower) if outside else 0.0
    squares, log = upper * upper - lower * lower, logarithm(nearest * upper)
    ratio = s * s * inverse
    arm = r - ratio
    value = lower - upper + 0.25 * arm * squares + 0.5 * log * inverse
    slope = (
        moves * lower + upper * upper + 0.25 * (1.0 + ratio * inverse) * squares
        - 0.5 * arm * (upper * upper * upper + moves * lower * lower)
        - 0.5 * log * inverse * inverse - 0.5 * (upper + moves) * inverse
    )  # fmt: skip
    if engulfs:
        within = radius < s - r
        value += 2.0 * (1.0 / radius - lower) if within else 0.0
        slope -= 2.0 * moves * lower if within else 0.0
    touches = furthest > radius
    return 0.5 * value if touches else 0.0, 0.5 * slope * inverse if touches else 0.0


@chunk_kernel
def near_descreening_sums(
    chunks: Share, x: Floats, pull: Floats, pairs: Integers, slopes: Floats, sums: Floats
) -> None:
    """Add the forces of the listed pairs from the slopes of :func:`near_integral_sums`."""
    for c in range(*chunks):
        begin, end = part(len(pairs), c)
        for k in range(begin, end):
            i, j = pairs[k, 0], pairs[k, 1]
            dx, dy, dz, _ = difference(x, i, j)
            f = -(pull[i] * slopes[k, 0] + pull[j] * slopes[k, 1])
            push(sums[c], i, j, f * dx, f * dy, f * dz)


@scalar
def put_born_radii(
    begin: int, end: int, integral: Floats, offset_radius: Floats, radius: Floats, bend: Floats,
    atoms: Floats, slope: Floats,
) -> None:  # fmt: skip
    """Write Born radii of a range of atoms into the blocks, and dB/d(integral) into ``slope``."""
    # ``bend`` has alpha, beta, gamma of tanh(alpha psi - beta psi^2 + gamma psi^3), psi = integral times
    # offset radius. All are zero for HCT, 1/B = 1/radius - integral.
    for i in range(begin, end):
        alpha, beta, gamma = bend[i, 0], bend[i, 1], bend[i, 2]
        psi = integral[i] * offset_radius[i]
        if alpha == 0.0:
            born = 1.0 / (1.0 / offset_radius[i] - integral[i])
            slope[i] = born * born
        else:
            t = np.tanh(psi * (alpha - psi * (beta - psi * gamma)))
            born = 1.0 / (1.0 / offset_radius[i] - t / radius[i])
            inner = alpha - psi * (2.0 * beta - 3.0 * psi * gamma)
            slope[i] = born * born * (1.0 - t * t) * inner * offset_radius[i] / radius[i]
        block, k = i // W, i % W
        atoms[block, BORN * W + k], atoms[block, HALF_INVERSE_BORN * W + k] = born, 0.5 / born


@scalar
def add_self_energy(
    begin: int, end: int, gb_charge: Floats, surface: Floats, slope: Floats, atoms: Floats, salt: Any,
    with_born: Floats,
) -> tuple[float, float]:  # fmt: skip
    """Self energy -q^2 / (2 B) and surface energy c / B^6 of some atoms. 2 dE/dB becomes dE/d(integral)."""
    # Surface: Schaefer, Bartels, Karplus, J. Mol. Biol. 284:835 (1998).
    polar, area = 0.0, 0.0
    for i in range(begin, end):
        block, k = i // W, i % W
        inverse = 2.0 * atoms[block, HALF_INVERSE_BORN * W + k]
        q2 = gb_charge[i] * gb_charge[i]
        sixth = surface[i] * inverse**6
        if salt is None:
            polar -= 0.5 * q2 * inverse
        else:
            share, kappa = salt
            decay = share * np.exp(-kappa / inverse)
            polar -= 0.5 * q2 * inverse * (1.0 + share - decay)
            q2 *= 1.0 + share - decay * (1.0 + kappa / inverse)
        area += sixth
        of_born = 0.5 * (with_born[i] + q2 * inverse * inverse) - 6.0 * sixth * inverse
        with_born[i] = of_born * slope[i]
        atoms[block, PULL * W + k] = with_born[i]
    return polar, area
