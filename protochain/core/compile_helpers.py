"""Helpers that compile kernels ahead, in processes parallel to the first run on a machine.

Numba compiles on one core. The run compiles kernels in the order in which it needs them, helpers begin at
the other end, and each skips kernels in the hands of another. ``kernels.txt`` lists the kernels of a run by
default, with their types. If one is missing there, or has other types now, the run itself compiles it.
"""

import atexit
import importlib
import os
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

from protochain.core.processors import own_python, processors

MOST = 3
"""Helpers. More would wait for one another's kernels."""
_LIST = Path(__file__).with_name("kernels.txt")
_HELPER = "PROTOCHAIN_HELPER"  # Environment variable with the number of the helper.

_HELD: list[Any] = []  # Lock of the process that has helpers, until it ends.


def is_helper() -> bool:
    """Whether this process is one."""
    return _HELPER in os.environ


def call_helpers(missing: str, folder: Path) -> None:
    """Start helpers when a kernel of the list must first be compiled, in one process of a folder only."""
    if not (is_helper() or _HELD) and any(entry.startswith(f"{missing} ") for entry in entries()):
        _start(folder / "helpers.lock")


def _start(place: Path) -> None:
    """Start helpers, one on each other core, which end with this process at the latest."""
    from filelock import FileLock, Timeout

    lock = FileLock(place)
    try:
        lock.acquire(0)
    except (Timeout, OSError, RuntimeError):
        return
    _HELD.append(lock)
    python = Path(sys.executable or "")
    # Not a program that has Python inside.
    if getattr(sys, "frozen", False) or not python.name.startswith("python"):
        return
    for number in range(1, min(processors() - 1, MOST) + 1):
        try:
            helper = subprocess.Popen(
                own_python("from protochain.core.compile_helpers import help_out; help_out()"),
                stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                env=os.environ | {_HELPER: str(number)}, start_new_session=True,
            )  # fmt: skip
        except OSError:
            return
        atexit.register(_end, helper)


def _end(helper: "subprocess.Popen[bytes]") -> None:
    helper.kill()
    helper.wait()


@cache
def entries() -> tuple[str, ...]:
    """Lines of the list: module, name and types of a kernel, in the order in which helpers compile them."""
    return tuple(line for line in _LIST.read_text().splitlines() if line and not line.startswith("#"))


def help_out() -> None:
    """Compile the kernels of the list that no other process has compiled or begun."""
    caller = os.getppid()
    for kernel, types in _kernels():
        if os.getppid() != caller:
            return
        store = kernel._cache
        if not store.has_folder or store.has(types, kernel.targetctx) or not store.try_alone():
            continue
        try:
            kernel.compile(types)
        except Exception:  # Another kernel now than the list says: the run will compile it.
            continue
        finally:
            store.release()


def _kernels() -> Iterator[tuple[Any, tuple[Any, ...]]]:
    for entry in entries():
        module, name, *types = entry.split()
        try:
            yield getattr(importlib.import_module(module), name), tuple(map(type_of, types))
        except (ImportError, AttributeError, KeyError, ValueError):  # The list is of other kernels.
            continue


def type_of(text: str) -> Any:
    """Type of numba from its text."""
    # A letter, f float64, i int64, b bool or n None; for an array the number of its axes behind it, then r if
    # it is read-only and s if it has gaps; for a tuple its types in brackets, with commas.
    from numba import types

    if text.startswith("("):
        return types.Tuple([type_of(part) for part in _parts(text[1:-1])])
    scalar = {"f": types.float64, "i": types.int64, "b": types.boolean, "n": types.none}[text[0]]
    if len(text) == 1:
        return scalar
    return types.Array(scalar, int(text[1]), "A" if "s" in text else "C", readonly="r" in text)


def _parts(text: str) -> Iterator[str]:
    """Parts between commas that are in no further brackets."""
    depth, begin = 0, 0
    for place, letter in enumerate(text):
        depth += (letter == "(") - (letter == ")")
        if letter == "," and depth == 0:
            yield text[begin:place]
            begin = place + 1
    if text:
        yield text[begin:]
