"""Processors that this process may use, and command of further processes."""

import os
import sys
from contextlib import AbstractContextManager
from functools import cache
from pathlib import Path
from typing import Any

from threadpoolctl import ThreadpoolController

_CGROUPS = Path("/sys/fs/cgroup")
_OWN = Path("/proc/self/cgroup")


def processors() -> int:
    """Return the number of processors that this process may use: the machine's, bound ones, or a share."""
    bound = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, min(bound, round(n_allowed(_CGROUPS, _OWN))))


def n_allowed(root: Path, group_of_process: Path) -> float:
    """Return the processors' worth of time that control groups allow, at most 1e6."""
    n_processors = 1e6
    for line in _text(group_of_process).splitlines():
        _, controllers, path = line.split(":", 2)
        group = Path(path.strip("/"))
        # In a container, its own group is mounted as the root, whatever its path outside.
        for place in (group, *group.parents):
            if not controllers:
                quota, _, period = _text(root / place / "cpu.max").partition(" ")
            elif "cpu" in controllers.split(","):
                folder = root / "cpu" / place
                quota, period = _text(folder / "cpu.cfs_quota_us"), _text(folder / "cpu.cfs_period_us")
            else:
                continue
            if quota.strip().isdigit() and period.strip().isdigit():
                n_processors = min(n_processors, int(quota) / int(period))
    return n_processors


def _text(path: Path) -> str:
    """Return the text of a file, empty if there is none."""
    try:
        return path.read_text()
    except OSError:
        return ""


def one_blas_thread() -> AbstractContextManager[Any]:
    """Limit BLAS to one thread: sums must not depend on the machine, nor threads compete with the energy."""
    return _libraries(frozenset(_WITH_BLAS & sys.modules.keys())).limit(limits=1, user_api="blas")


@cache
def _libraries(modules: frozenset[str]) -> ThreadpoolController:
    """Return the loaded libraries with threads. A search for them takes as long as some evaluations."""
    return ThreadpoolController()


_WITH_BLAS = {"numpy", "scipy.linalg", "torch", "sklearn"}


def own_python(statement: str) -> list[str]:
    """Command that runs a statement. ``-P`` ignores a ``gemmi.py`` in the current folder."""
    first = "import sys; sys.path.append(sys.argv.pop(1)); "
    return [sys.executable, "-P", "-c", first + statement, str(Path(__file__).parents[2])]
