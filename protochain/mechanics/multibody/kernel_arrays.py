"""Arrays in compiled code: borrowed, so that references are not counted, and copied.

Numba counts the references of each array that a kernel takes from a tuple, by atomic operations of some
nanoseconds. In a step of a mechanism with loads they took more time than the arithmetic. For an assignment to
a slice Numba also compiles a message of differing shapes, for seconds. Copies by loops have none.
"""

from typing import Any

from numba import types
from numba.extending import intrinsic as _intrinsic

from protochain.core.arrays import Floats, Integers
from protochain.mechanics.multibody.algebra import inner_kernel

# Numba does not declare the types of its tools.
intrinsic: Any = _intrinsic
_ARRAY: Any = types.Array
_TUPLE: Any = types.BaseTuple


@intrinsic
def borrow(typing: Any, values: Any) -> Any:
    """Arrays in nested tuples without counts. The caller must hold the arrays while they are used."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return _without_counts(context, builder, signature.args[0], args[0])

    return values(values), code


def _without_counts(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    if isinstance(kind, _ARRAY):
        array = context.make_array(kind)(context, builder, value)
        array.meminfo = array.meminfo.type(None)
        return array._getvalue()
    if isinstance(kind, _TUPLE):
        for i, element in enumerate(kind):
            part = _without_counts(context, builder, element, builder.extract_value(value, i))
            value = builder.insert_value(value, part, i)
    return value


@inner_kernel
def copy(source: Floats, target: Floats) -> None:
    """Write (n,) numbers into another array."""
    for k in range(len(source)):
        target[k] = source[k]


@inner_kernel
def copy_row(source: Floats, target: Floats, i: int) -> None:
    """Write (n,) numbers into a row of a table."""
    for k in range(len(source)):
        target[i, k] = source[k]


@inner_kernel
def scatter(source: Floats, places: Integers, target: Floats) -> None:
    """Write (n,) numbers to places (n,) of another array."""
    for k in range(len(places)):
        target[places[k]] = source[k]
