"""Atomic operations of compiled code on elements of an array of int64, for several threads without locks.

Numba has no atomic operations for processors, so they are written in LLVM's intermediate language, all with
sequential consistency: after such an operation other threads see all earlier writes of a thread.
"""

import platform
import sys
from time import get_clock_info
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic as _intrinsic

from protochain.energies.native.layout import scalar

# Numba does not declare the types of its tools.
intrinsic: Any = _intrinsic
_ORDER = "seq_cst"
_PAUSES = {
    "x86_64": ("llvm.x86.sse2.pause", ()),
    "amd64": ("llvm.x86.sse2.pause", ()),
    "aarch64": ("llvm.aarch64.hint", (1,)),
    "arm64": ("llvm.aarch64.hint", (1,)),
}
yield_processor: Any = types.ExternalFunction(
    "SwitchToThread" if sys.platform == "win32" else "sched_yield", types.int32()
)
"""Let the operating system run another thread on this processor."""
_IS_WINDOWS = sys.platform == "win32"
_counter: Any = types.ExternalFunction("QueryPerformanceCounter", types.int32(types.voidptr))
_clock: Any = types.ExternalFunction("clock_gettime", types.int32(types.int32, types.voidptr))
TICK = get_clock_info("perf_counter").resolution if _IS_WINDOWS else 1e-9  # s. Unit of :func:`ticks`.
_MONOTONIC = 6 if sys.platform == "darwin" else 1


@scalar
def ticks(buffer: Any) -> int:
    """Read a monotonic clock in ticks, through a buffer of two int64."""
    if _IS_WINDOWS:
        _counter(buffer.ctypes)
        return buffer[0]
    _clock(_MONOTONIC, buffer.ctypes)
    return 1_000_000_000 * buffer[0] + buffer[1]


def _place(context: Any, builder: Any, kind: Any, array: Any, index: Any) -> Any:
    pointer = context.make_array(kind)(context, builder, array).data
    return builder.gep(pointer, [index])


@intrinsic
def load(typing: Any, array: Any, index: Any) -> Any:
    """Read array[index]."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.load_atomic(_place(context, builder, signature.args[0], *args), _ORDER, 8)

    return types.int64(array, types.int64), code


@intrinsic
def add(typing: Any, array: Any, index: Any, value: Any) -> Any:
    """Add to array[index] and return its previous value."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.atomic_rmw(
            "add", _place(context, builder, signature.args[0], *args[:2]), args[2], _ORDER
        )

    return types.int64(array, types.int64, types.int64), code


@intrinsic
def replace(typing: Any, array: Any, index: Any, old: Any, new: Any) -> Any:
    """Set array[index] to ``new`` if it is ``old``, and return whether it was."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        place = _place(context, builder, signature.args[0], *args[:2])
        return builder.extract_value(builder.cmpxchg(place, args[2], args[3], _ORDER, _ORDER), 1)

    return types.boolean(array, types.int64, types.int64, types.int64), code


@intrinsic
def pause(typing: Any) -> Any:
    """Signal to the processor that this thread waits in a loop."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        if platform.machine().lower() in _PAUSES:
            name, arguments = _PAUSES[platform.machine().lower()]
            kind = ir.FunctionType(ir.VoidType(), [ir.IntType(32)] * len(arguments))
            function = cgutils.get_or_insert_function(builder.module, kind, name)
            builder.call(function, [ir.Constant(ir.IntType(32), argument) for argument in arguments])
        return context.get_dummy_value()

    return types.none(), code
