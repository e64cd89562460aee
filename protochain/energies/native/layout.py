"""Memory layout of atoms: blocks of W atoms, each quantity in one row of W numbers.

Rows are at constant distances from one address. The compiler therefore knows that written rows do not overlap
rows read, and vectorises over four or eight atoms.
"""

import math
from collections.abc import Callable
from typing import Any, TypeVar, cast

import numpy as np

from protochain.core.arrays import Floats
from protochain.core.compilation import njit

W = 32  # Atoms in a block. Wider blocks waste time on padding, narrower blocks on sums along rows.
X, Y, Z, CHARGE, GB_CHARGE, S2, S3, BORN, HALF_INVERSE_BORN, PULL, BOX = range(11)
"""Rows of a block: position (nm), charges times the root of their constant, square and half the cube of the
scaled radius, Born radius B, 1/(2 B), dE/d(Born integral), and lowest and highest x, y, z of its atoms."""
ROWS = 11
FX, FY, FZ, SCALAR = range(4)
"""Rows that the chunks write: force, and one scalar sum of each atom (Born integral or dE/dB)."""
SUMS = 4
CHUNKS = 16
"""Parts of the work, for any number of threads. The order of sums is fixed, so results are bit-identical."""
Share = tuple[int, int]  # Range of chunks for a kernel call, from the first to before the second.
FAR_AWAY = 1e6  # nm. Spacing of the atoms that pad the last block, which have neither charge nor radius.

F = TypeVar("F", bound=Callable[..., Any])


def tile_kernel(function: F) -> F:
    """Compile a kernel of two blocks. Sums along a row may be reordered, to vectorise."""
    fast = {"contract", "reassoc", "nsz"}
    return cast(F, njit(inner=True, cache=True, error_model="numpy", fastmath=fast)(function))


def variant(function: F) -> F:
    """Compile as :func:`tile_kernel`, inlined: branches on constants of the caller have no cost in loops."""
    fast = {"contract", "reassoc", "nsz"}
    return cast(F, njit(inner=True, error_model="numpy", fastmath=fast, forceinline=True)(function))


def ordered_kernel(function: F) -> F:
    """Compile as :func:`variant`, with additions in their order, so that roundings by addition remain."""
    return cast(
        F, njit(inner=True, error_model="numpy", fastmath={"contract", "nsz"}, forceinline=True)(function)
    )


def scalar(function: F) -> F:
    """Compile a kernel for single terms."""
    return cast(F, njit(inner=True, cache=True, error_model="numpy", fastmath={"contract"})(function))


def chunk_kernel(function: F) -> F:
    """Compile a loop over chunks, any of which may run on any thread."""
    return cast(F, njit(inner=True, cache=True, error_model="numpy", nogil=True)(function))


def inline_kernel(function: F) -> F:
    """Compile as :func:`chunk_kernel`, inlined, because a call would count the references of all arrays."""
    return cast(F, njit(inner=True, error_model="numpy", nogil=True, forceinline=True)(function))


def n_blocks(n: int) -> int:
    """Return the number of blocks of n atoms."""
    return -(-n // W)


def in_blocks(values: np.ndarray) -> np.ndarray:
    """(blocks, W): one value per atom, padded with zeros."""
    padded = np.zeros(n_blocks(len(values)) * W, dtype=values.dtype)
    padded[: len(values)] = values
    return padded.reshape(-1, W)


def empty_blocks(n: int) -> Floats:
    """(blocks, ROWS * W) float: blocks of n atoms, far away, uncharged and with unit Born radius."""
    blocks = np.zeros((n_blocks(n), ROWS, W))
    blocks[:, X] = FAR_AWAY * (1 + np.arange(blocks[:, X].size).reshape(-1, W))
    blocks[:, BORN], blocks[:, HALF_INVERSE_BORN] = 1.0, 0.5
    return blocks.reshape(-1, ROWS * W)


def aligned_zeros(shape: tuple[int, ...]) -> Floats:
    """Zeros aligned to a cache line, which vectors of eight doubles would otherwise straddle."""
    size, line = math.prod(shape), 8
    buffer = np.zeros(size + line)
    start = -(buffer.ctypes.data // buffer.itemsize) % line
    return buffer[start : start + size].reshape(shape)


@scalar
def put_positions(x: Floats, atoms: Floats) -> None:
    """Write positions (na, 3) into the blocks, and the blocks' boxes, including padding."""
    for i in range(len(x)):
        block, k = i // W, i % W
        for axis in range(3):
            atoms[block, axis * W + k] = x[i, axis]
    for block in range(len(atoms)):
        for axis in range(3):
            low = high = atoms[block, axis * W]
            for k in range(1, W):
                at = atoms[block, axis * W + k]
                low, high = min(low, at), max(high, at)
            atoms[block, BOX * W + axis], atoms[block, BOX * W + 3 + axis] = low, high


@scalar
def box_distance2(a: Floats, i: int, b: Floats) -> float:
    """Squared distance of a block's atom i from the box around another block."""
    total = 0.0
    for axis in range(3):
        at = a[axis * W + i]
        gap = max(b[BOX * W + axis] - at, at - b[BOX * W + 3 + axis], 0.0)
        total += gap * gap
    return total


@scalar
def far_rows2(is_near: bool, i_near: float, j_near: float, cutoff: float) -> float:
    """Squared distance beyond which a row, an atom with a block, requires neither near series nor masks."""
    # 0 if all rows of a tile are beyond it, infinite if a cutoff masks all rows.
    if cutoff < np.inf:
        return np.inf
    return max(i_near, j_near) ** 2 if is_near else 0.0


@scalar
def part(n: int, chunk: int) -> tuple[int, int]:
    """Begin and end of a chunk's share of n items."""
    return chunk * n // CHUNKS, (chunk + 1) * n // CHUNKS


@scalar
def atoms_of(begin: int, end: int, n: int) -> tuple[int, int]:
    """Range of atoms in the blocks from ``begin`` to before ``end``, of n atoms."""
    return min(n, begin * W), min(n, end * W)


@scalar
def collect_scalars(begin: int, end: int, sums: Floats, is_written: np.ndarray, scalars: Floats) -> None:
    """Sum row SCALAR of some blocks over the chunks, in order, into (blocks * W,), and clear it."""
    for b in range(begin, end):
        row = scalars[b * W : (b + 1) * W]
        row[:] = 0.0
        for c in range(CHUNKS):
            if not is_written[c, b]:
                continue
            chunk_sums = sums[c, b]
            for k in range(W):
                row[k] += chunk_sums[SCALAR * W + k]
                chunk_sums[SCALAR * W + k] = 0.0


@scalar
def add_forces(begin: int, end: int, sums: Floats, is_written: np.ndarray, forces: Floats) -> None:
    """Sum the forces (CHUNKS, blocks, SUMS * W) of some blocks over the chunks, in order."""
    # Only blocks to which a chunk writes, ``is_written`` (CHUNKS, blocks), because a region has few tiles.
    total = np.empty(3 * W)
    for b in range(begin, end):
        total[:] = 0.0
        for c in range(CHUNKS):
            if not is_written[c, b]:
                continue
            chunk_sums = sums[c, b]
            for k in range(3 * W):
                total[k] += chunk_sums[k]
        for i in range(b * W, min(len(forces), (b + 1) * W)):
            for axis in range(3):
                forces[i, axis] = total[axis * W + i - b * W]
