"""Bonds, angles, torsions and torsion maps. Each chunk of the work adds to separate sums and energies."""

import numpy as np

from protochain.core.arrays import Floats, Integers
from protochain.energies.native.layout import Share, W, chunk_kernel, part, scalar
from protochain.energies.native.pairs import CLOSEST, difference, push

Vector = tuple[float, float, float]


@chunk_kernel
def bond_sums(
    chunks: Share, x: Floats, atoms: Integers, parameters: Floats, sums: Floats, energies: Floats
) -> None:
    """K (r - r0)^2 / 2, parameters (r0, k)."""
    for c in range(*chunks):
        begin, end = part(len(atoms), c)
        energy = 0.0
        for n in range(begin, end):
            i, j = atoms[n, 0], atoms[n, 1]
            dx, dy, dz, r2 = difference(x, i, j)
            r = np.sqrt(max(r2, CLOSEST))
            stretch = r - parameters[n, 0]
            energy += 0.5 * parameters[n, 1] * stretch * stretch
            f = -parameters[n, 1] * stretch / r
            push(sums[c], i, j, f * dx, f * dy, f * dz)
        energies[c] += energy


@chunk_kernel
def angle_sums(
    chunks: Share, x: Floats, atoms: Integers, parameters: Floats, sums: Floats, energies: Floats
) -> None:
    """K (theta - theta0)^2 / 2, parameters (theta0, k)."""
    for c in range(*chunks):
        begin, end = part(len(atoms), c)
        energy = 0.0
        for n in range(begin, end):
            i, j, k = atoms[n, 0], atoms[n, 1], atoms[n, 2]
            ux, uy, uz, u2 = difference(x, i, j)
            vx, vy, vz, v2 = difference(x, k, j)
            nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
            area = np.sqrt(nx * nx + ny * ny + nz * nz)
            inner = ux * vx + uy * vy + uz * vz
            # The arc tangent, unlike the cosine, is accurate for nearly straight angles.
            bend = np.arctan2(area, inner) - parameters[n, 0]
            energy += 0.5 * parameters[n, 1] * bend * bend
            # d(theta)/dx_i = u x (u x v) / (u^2 |u x v|), likewise for k, both by inner products.
            pull = -parameters[n, 1] * bend / max(area, CLOSEST)
            a, b = pull * inner / max(u2, CLOSEST), pull * inner / max(v2, CLOSEST)
            push(sums[c], i, j, a * ux - pull * vx, a * uy - pull * vy, a * uz - pull * vz)
            push(sums[c], k, j, b * vx - pull * ux, b * vy - pull * uy, b * vz - pull * uz)
        energies[c] += energy


@chunk_kernel
def torsion_sums(
    chunks: Share, x: Floats, atoms: Integers, parameters: Floats, sums: Floats, energies: Floats
) -> None:
    """K (1 + cos(n phi - phi0)), parameters (n, phi0, k)."""
    for c in range(*chunks):
        begin, end = part(len(atoms), c)
        energy = 0.0
        torque, phi = 0.0, 0.0
        for n in range(begin, end):
            i, j, k, m = atoms[n, 0], atoms[n, 1], atoms[n, 2], atoms[n, 3]
            # Terms of one torsion, of several periodicities, follow each other.
            if n == begin or not same_four(atoms, n - 1, n):
                torque, phi = 0.0, dihedral(x, i, j, k, m)
            times, height = parameters[n, 0], parameters[n, 2]
            angle = times * phi - parameters[n, 1]
            energy += height * (1.0 + np.cos(angle))
            torque += height * times * np.sin(angle)
            if n == end - 1 or not same_four(atoms, n, n + 1):
                twist(x, i, j, k, m, torque, sums[c])
        energies[c] += energy


@scalar
def same_four(atoms: Integers, a: int, b: int) -> bool:
    """Whether rows a and b have the same four atoms in the same order."""
    return bool(
        atoms[a, 0] == atoms[b, 0] and atoms[a, 1] == atoms[b, 1] and atoms[a, 2] == atoms[b, 2]
        and atoms[a, 3] == atoms[b, 3]
    )  # fmt: skip


@chunk_kernel
def improper_sums(
    chunks: Share, x: Floats, atoms: Integers, parameters: Floats, sums: Floats, energies: Floats
) -> None:
    """CHARMM's impropers, K (phi - phi0)^2 without periodic wrapping, parameters (phi0, k)."""
    for c in range(*chunks):
        begin, end = part(len(atoms), c)
        energy = 0.0
        for n in range(begin, end):
            off = dihedral(x, atoms[n, 0], atoms[n, 1], atoms[n, 2], atoms[n, 3]) - parameters[n, 0]
            energy += parameters[n, 1] * off * off
            torque = -2.0 * parameters[n, 1] * off
            twist(x, atoms[n, 0], atoms[n, 1], atoms[n, 2], atoms[n, 3], torque, sums[c])
        energies[c] += energy


@chunk_kernel
def map_sums(
    chunks: Share,
    x: Floats,
    atoms: Integers,
    map_index: Integers,
    coefficients: Floats,
    sums: Floats,
    energies: Floats,
) -> None:
    """Torsion maps, bicubic in each cell of a grid over two dihedrals."""
    # ``coefficients`` (maps, size, size, 4, 4) multiply powers of the coordinates in a cell, from 0 to 1.
    size = coefficients.shape[1]
    for c in range(*chunks):
        begin, end = part(len(atoms), c)
        energy = 0.0
        for n in range(begin, end):
            t = atoms[n]
            s1, u = cell(dihedral(x, t[0], t[1], t[2], t[3]), size)
            s2, v = cell(dihedral(x, t[4], t[5], t[6], t[7]), size)
            surface = coefficients[map_index[n], s1, s2]
            value, along_u, along_v = 0.0, 0.0, 0.0
            for i in range(3, -1, -1):
                row = surface[i]
                poly = ((row[3] * v + row[2]) * v + row[1]) * v + row[0]
                slope = (3.0 * row[3] * v + 2.0 * row[2]) * v + row[1]
                along_u = along_u * u + value
                value = value * u + poly
                along_v = along_v * u + slope
            energy += value
            per_radian = size / (2.0 * np.pi)
            twist(x, t[0], t[1], t[2], t[3], -along_u * per_radian, sums[c])
            twist(x, t[4], t[5], t[6], t[7], -along_v * per_radian, sums[c])
        energies[c] += energy


@scalar
def cell(angle: float, size: int) -> tuple[int, float]:
    """Cell of a periodic grid, and the coordinate in it, from 0 to 1."""
    place = angle / (2.0 * np.pi) * size
    if place < 0.0:
        place += size
    index = min(int(place), size - 1)
    return index, place - index


@scalar
def dihedral(x: Floats, i: int, j: int, k: int, m: int) -> float:
    """Dihedral of four atoms in rad, with the sign of the IUPAC convention."""
    f, g, _, a, b = _planes(x, i, j, k, m)
    length = np.sqrt(_dot(g, g))
    return float(np.arctan2(-length * _dot(f, b), _dot(a, b)))


@scalar
def twist(x: Floats, i: int, j: int, k: int, m: int, torque: float, sums: Floats) -> None:
    """Add the forces of a torque -dE/dphi. Blondel, Karplus, J. Comput. Chem. 17:1132 (1996)."""
    f, g, h, a, b = _planes(x, i, j, k, m)
    length = np.sqrt(max(_dot(g, g), CLOSEST))
    a2, b2 = max(_dot(a, a), CLOSEST**2), max(_dot(b, b), CLOSEST**2)
    at_i, at_m = -torque * length / a2, torque * length / b2
    across = torque * _dot(f, g) / (a2 * length)
    over = torque * _dot(h, g) / (b2 * length)
    for axis in range(3):
        fi, fm = at_i * a[axis], at_m * b[axis]
        between = across * a[axis] - over * b[axis]
        sums[i // W, axis * W + i % W] += fi
        sums[j // W, axis * W + j % W] += between - fi
        sums[k // W, axis * W + k % W] -= between + fm
        sums[m // W, axis * W + m % W] += fm


@scalar
def _planes(x: Floats, i: int, j: int, k: int, m: int) -> tuple[Vector, Vector, Vector, Vector, Vector]:
    """Bond vectors F, G, H of Blondel and Karplus, and the normals A = F x G, B = H x G."""
    f = (x[i, 0] - x[j, 0], x[i, 1] - x[j, 1], x[i, 2] - x[j, 2])
    g = (x[j, 0] - x[k, 0], x[j, 1] - x[k, 1], x[j, 2] - x[k, 2])
    h = (x[m, 0] - x[k, 0], x[m, 1] - x[k, 1], x[m, 2] - x[k, 2])
    return f, g, h, _cross(f, g), _cross(h, g)


@scalar
def _dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@scalar
def _cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
