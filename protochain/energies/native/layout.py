"""How atoms lie in memory: in blocks of W, one number of all W atoms after another.

A block's numbers lie at known distances from one address, so the compiler sees that what it writes does not
touch what it reads, and works on four atoms at a time.
"""

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numpy as np
from numba import njit, prange

from protochain.arrays import Floats

W = 32
"""Atoms in a block. Wider ones waste more on padding, narrower ones more on sums along rows."""
X, Y, Z, CHARGE, GB_CHARGE, S2, S3, BORN, HALF_INVERSE_BORN, PULL = range(10)
"""Rows of a block: position (nm); charges times the root of their constant; square and half the cube of the
scaled radius; Born radius B; 1/(2 B); dE/d(Born integral)."""
ROWS = 10
FX, FY, FZ, OWN = range(4)
"""Rows of what the chunks write: force, and a sum of the atom's own."""
SUMS = 4
CHUNKS = 16
"""Parts of the work, whatever the number of threads: sums have one order, so results have one value."""
FAR_AWAY = 1e6
"""nm. Where the atoms that fill the last block lie, apart from each other, without charge or radius."""

F = TypeVar("F", bound=Callable[..., Any])


def tiled(function: F) -> F:
    """Compile what is done for two blocks: sums along a row may be taken in any order, four at a time."""
    fast = {"contract", "reassoc", "nsz"}
    return cast(F, njit(cache=True, error_model="numpy", fastmath=fast)(function))


def variant(function: F) -> F:
    """Compile as :func:`tiled`, into its caller: a choice made there by a constant costs nothing in loops."""
    fast = {"contract", "reassoc", "nsz"}
    return cast(F, njit(error_model="numpy", fastmath=fast, forceinline=True)(function))


def scalar(function: F) -> F:
    """Compile what is done for one term after another."""
    return cast(F, njit(cache=True, error_model="numpy", fastmath={"contract"})(function))


def shared(function: F) -> F:
    """Compile a loop over chunks, which threads share."""
    return cast(F, njit(cache=True, error_model="numpy", parallel=True)(function))


def n_blocks(n: int) -> int:
    """Blocks that n atoms fill."""
    return -(-n // W)


def in_blocks(values: np.ndarray) -> np.ndarray:
    """(blocks, W): a number of each atom, and zeros for those that fill the last block."""
    padded = np.zeros(n_blocks(len(values)) * W, dtype=values.dtype)
    padded[: len(values)] = values
    return padded.reshape(-1, W)


def empty_blocks(n: int) -> Floats:
    """(blocks, ROWS * W) float: blocks for n atoms, all far away, uncharged and of unit Born radius."""
    blocks = np.zeros((n_blocks(n), ROWS, W))
    blocks[:, X] = FAR_AWAY * (1 + np.arange(blocks[:, X].size).reshape(-1, W))
    blocks[:, BORN], blocks[:, HALF_INVERSE_BORN] = 1.0, 0.5
    return blocks.reshape(-1, ROWS * W)


@scalar
def put_positions(x: Floats, atoms: Floats) -> None:
    """Write positions (na, 3) into the blocks."""
    for i in range(len(x)):
        block, k = i // W, i % W
        for axis in range(3):
            atoms[block, axis * W + k] = x[i, axis]


@scalar
def part(n: int, chunk: int) -> tuple[int, int]:
    """Begin and end of a chunk's share of n things."""
    return chunk * n // CHUNKS, (chunk + 1) * n // CHUNKS


@shared
def take_own(sums: Floats, own: Floats) -> None:
    """Add up the atoms' own sums that the chunks wrote, in the order of the chunks, and clear them."""
    for chunk in prange(CHUNKS):
        begin, end = part(sums.shape[1], chunk)
        for b in range(begin, end):
            for k in range(W):
                value = 0.0
                for c in range(CHUNKS):
                    value += sums[c, b, OWN * W + k]
                    sums[c, b, OWN * W + k] = 0.0
                if b * W + k < len(own):
                    own[b * W + k] = value


@shared
def add_forces(sums: Floats, forces: Floats) -> None:
    """Add up the forces that the chunks wrote, (CHUNKS, blocks, SUMS * W), in the order of the chunks."""
    for chunk in prange(CHUNKS):
        begin, end = part(len(forces), chunk)
        for i in range(begin, end):
            for axis in range(3):
                value = 0.0
                for c in range(CHUNKS):
                    value += sums[c, i // W, axis * W + i % W]
                forces[i, axis] = value
