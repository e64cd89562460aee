"""Arrays of compiled code without counts of references.

Numba counts the references of each array that a kernel takes from a tuple, by atomic operations of some
nanoseconds. In a step of a mechanism with loads they took more time than the arithmetic.
"""

from typing import Any

from numba import types
from numba.extending import intrinsic as _intrinsic

intrinsic: Any = _intrinsic  # Numba does not declare the types of its tools.


@intrinsic
def borrow(typing: Any, values: Any) -> Any:
    """Arrays in nested tuples without counts. The caller must hold the arrays while they are used."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return _without_counts(context, builder, signature.args[0], args[0])

    return values(values), code


def _without_counts(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    if isinstance(kind, types.Array):
        array = context.make_array(kind)(context, builder, value)
        array.meminfo = array.meminfo.type(None)
        return array._getvalue()
    if isinstance(kind, types.BaseTuple):
        for i, element in enumerate(kind):
            part = _without_counts(context, builder, element, builder.extract_value(value, i))
            value = builder.insert_value(value, part, i)
    return value
