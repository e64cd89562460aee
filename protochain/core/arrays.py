"""Array types shared by all modules, read-only arrays, immutable values with arrays, vectors and angles."""

from collections.abc import Callable, Mapping
from dataclasses import fields
from math import isfinite
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from protochain.core.checks import plain
from protochain.core.errors import Fault, ProtochainError

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
GOLDEN = np.pi * (3.0 - np.sqrt(5.0))
"""The golden angle, rad."""

Watcher = Callable[[Mapping[str, float], Floats], None]
"""Callback of a run: receives each row of its log, and the positions (na, 3) the row belongs to."""


class Value:
    """Base of frozen dataclasses: copied and pickled by fields, with read-only arrays, without caches."""

    def __reduce__(self) -> tuple[Any, ...]:
        """Fields by which to make it anew."""
        values = [getattr(self, column.name) for column in fields(self)]  # type: ignore[arg-type]  # its subclasses are dataclasses
        arguments = [dict(value) if isinstance(value, MappingProxyType) else value for value in values]
        return _rebuild, (type(self), *arguments)


def _rebuild(kind: type, *values: Any) -> Any:
    for value in values:
        if isinstance(value, np.ndarray):
            value.flags.writeable = False
    return kind(*values)


def read_only(array: ArrayLike, dtype: type = np.float64) -> NDArray[Any]:
    """Return a contiguous read-only copy."""
    return freeze(np.array(array, dtype=dtype, order="C"))


def freeze(array: Floats) -> Floats:
    """Make an array without other owners read-only, and return it."""
    # By position: a third of the time of the flag's attribute, and of the keyword.
    array.setflags(False)  # type: ignore[call-arg]  # numpy's stub has it by keyword only
    return array


def floats(values: ArrayLike, shape: tuple[int, ...], name: str, unit: str = "") -> Floats:
    """Return a contiguous read-only float64 view of values, of a shape, and in a unit if given."""
    # Kernels do not check shapes. And numba compiles writable and read-only arrays separately, but may call
    # either code for either, whichever was compiled first: rounding would depend on earlier calls.
    if hasattr(values, "value_in_unit"):
        if not unit:
            raise ProtochainError(f"{name} has a unit; give numbers, without a unit")
        values = plain(values, unit, name)
    if isinstance(values, np.ndarray) and values.dtype.kind == "c":
        raise ProtochainError(f"{name}: give real numbers, not complex ones")
    try:
        array = np.ascontiguousarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise ProtochainError(f"{name}: give an array of numbers of shape {shape}") from None
    if array.shape != shape:
        raise ProtochainError(f"{name} has shape {array.shape}, not {shape}")
    return freeze(array.view())


def finite(values: ArrayLike, shape: tuple[int, ...], name: str) -> Floats:
    """As :func:`floats`, and raise if a number is not finite."""
    array = floats(values, shape, name)
    flat = array.reshape(-1)
    # The square is much quicker to ask, and finite only if all are; the squares of large numbers are not.
    if not (isfinite(flat.dot(flat)) or np.isfinite(array).all()):
        at = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise ProtochainError(
            f"{name} has {array[at]} at {at[0] if len(at) == 1 else at}; give finite numbers",
            fault=Fault.NOT_FINITE,
        )
    return array


def cross(a: Floats, b: Floats) -> Floats:
    """Vector products (..., 3) of vectors (..., 3), bit for bit numpy's, which mostly looks at shapes."""
    (ax, ay, az), (bx, by, bz) = ((vectors[..., 0], vectors[..., 1], vectors[..., 2]) for vectors in (a, b))
    product = np.empty(np.broadcast(a, b).shape)
    product[..., 0] = ay * bz - az * by
    product[..., 1] = az * bx - ax * bz
    product[..., 2] = ax * by - ay * bx
    return product


def sphere(n: int) -> Floats:
    """Directions (n, 3) spread evenly over the sphere, on a golden-angle spiral."""
    z = 1.0 - (2.0 * np.arange(n) + 1.0) / n
    turn, across = GOLDEN * np.arange(n), np.sqrt(1.0 - z * z)
    return np.column_stack([across * np.cos(turn), across * np.sin(turn), z])


def dots(a: Floats, b: Floats) -> Floats:
    """Scalar products (...) of vectors (..., 3), bit for bit equal to ``a[k] @ b[k]``."""
    return np.asarray((a[..., None, :] @ b[..., :, None])[..., 0, 0])


def means_by(of: Integers, values: Floats, n: int) -> Floats:
    """Means (n,) of the values (m,) of n groups, NaN of empty ones. ``of`` (m,) are the values' groups."""
    counts = np.bincount(of, minlength=n)
    return np.asarray(np.bincount(of, values, n) / np.where(counts, counts, np.nan))


def distance(a: Floats, b: Floats) -> Floats:
    """Distances of points (..., 3)."""
    return np.asarray(np.linalg.norm(a - b, axis=-1))


def angle(a: Floats, b: Floats, c: Floats) -> Floats:
    """Angles at the middle ones b of points (..., 3), rad."""
    u, v = a - b, c - b
    return np.asarray(np.arctan2(np.linalg.norm(cross(u, v), axis=-1), (u * v).sum(axis=-1)))


def dihedral(a: Floats, b: Floats, c: Floats, d: Floats) -> Floats:
    """Dihedrals of points (..., 3), rad, -pi to pi, with the sign of IUPAC. Accurate at every angle."""
    first, axis, last = b - a, c - b, d - c
    m, n = cross(first, axis), cross(axis, last)
    return np.asarray(np.arctan2(np.sqrt(dots(axis, axis)) * dots(first, n), dots(m, n)))


def dihedral_slopes(x: Floats, shortest: float = 1e-4) -> Floats:
    """Gradients (n, 4, 3) of dihedrals of points x (n, 4, 3): Blondel, Karplus, JCC 17:1132 (1996)."""
    # Bonds shorter than the shortest, and points as near to a line, turn no faster.
    f, g, h = x[:, 0] - x[:, 1], x[:, 1] - x[:, 2], x[:, 3] - x[:, 2]
    length = np.maximum(np.sqrt(dots(g, g)), shortest)[:, None]
    a, b = cross(f, g), cross(h, g)
    a /= np.maximum(dots(a, a), shortest**4)[:, None]
    b /= np.maximum(dots(b, b), shortest**4)[:, None]
    between = (dots(f, g)[:, None] * a - dots(h, g)[:, None] * b) / length
    first, last = -length * a, length * b
    return np.stack([first, between - first, -between - last, last], axis=1)
