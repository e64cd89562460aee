"""Array types shared by all modules, and read-only copies and views of arrays."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from protochain.errors import ProtochainError

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

Watcher = Callable[[Mapping[str, float], Floats], None]
"""Callback of a run: receives each row of its log, and the positions (na, 3) the row belongs to."""


def read_only(array: ArrayLike, dtype: type = np.float64) -> NDArray[Any]:
    """Return a contiguous read-only copy."""
    frozen: NDArray[Any] = np.array(array, dtype=dtype, order="C")
    frozen.flags.writeable = False
    return frozen


def frozen(array: Floats) -> Floats:
    """Make an array without other owners read-only, and return it."""
    array.flags.writeable = False
    return array


def floats(values: ArrayLike, shape: tuple[int, ...], name: str) -> Floats:
    """Return a contiguous read-only float64 view of values that have the given shape.

    Kernels do not check shapes. And numba compiles writable and read-only arrays separately, but may call
    either code for either, whichever was compiled first: rounding would depend on earlier calls.

    Raises
    ------
    ProtochainError
        If the shape is another; the message names the array and both shapes.
    """
    array = np.ascontiguousarray(values, dtype=np.float64)
    if array.shape != shape:
        raise ProtochainError(f"{name} has shape {array.shape}, not {shape}")
    return frozen(array.view())
