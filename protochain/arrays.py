"""The two array types everything is made of, and how a value keeps them from changing."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from protochain.errors import ProtochainError

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


def read_only(array: ArrayLike, dtype: type = np.float64) -> NDArray[Any]:
    """Return a contiguous copy that cannot be written to."""
    frozen: NDArray[Any] = np.array(array, dtype=dtype, order="C")
    frozen.flags.writeable = False
    return frozen


def frozen(array: Floats) -> Floats:
    """Return the same array, which nobody else holds, made unwritable."""
    array.flags.writeable = False
    return array


def floats(values: ArrayLike, shape: tuple[int, ...], name: str) -> Floats:
    """Return contiguous float64 values of one shape, as a view that cannot be written to.

    Kernels trust what they are given; and numba, which compiles writable and read-only arrays apart, may take
    either code for either, whichever it met first: rounding would depend on what was computed before.

    Raises
    ------
    ProtochainError
        Naming the array and both shapes.
    """
    array = np.ascontiguousarray(values, dtype=np.float64)
    if array.shape != shape:
        raise ProtochainError(f"{name} has shape {array.shape}, not {shape}")
    return frozen(array.view())
