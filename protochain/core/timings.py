"""Run time by part: each moment belongs to the innermost active part, so the parts add up."""

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from time import perf_counter, process_time

PARTS = (
    "imports", "kernels", "reading", "preparing", "chain", "energy", "loop", "evaluations", "metric",
    "judging", "measuring", "writing", "rest",
)  # fmt: skip
"""Modules and the start of Python, compiled code (loaded or made), the file, its missing atoms, rigid
bodies, the System and native terms, the loop but for its evaluations and metrics, these, start and end by the
judge, their violations, files, the remainder."""
LOOP = ("loop", "evaluations", "metric")
"""Parts that make up the loop."""


class Clock:
    """Seconds by part, and seconds of the loop in kernels that all threads share."""

    def __init__(self) -> None:
        self.seconds = dict.fromkeys(PARTS, 0.0)
        self.shared, self.within, self._since = 0.0, ["rest"], perf_counter()

    def turn(self) -> None:
        """Count the time since the last turn for the active part."""
        now = perf_counter()
        self.seconds[self.within[-1]] += now - self._since
        self._since = now


_CLOCK: ContextVar[Clock | None] = ContextVar("clock", default=None)


@contextmanager
def measure_run(from_start: bool = False) -> Iterator[None]:
    """Time a run, unless it is part of a timed run. ``from_start`` counts from the start of the process."""
    if _CLOCK.get() is not None:
        yield
        return
    clock = Clock()
    clock.seconds["imports"] = process_time() if from_start else 0.0
    token = _CLOCK.set(clock)
    try:
        yield
    finally:
        _CLOCK.reset(token)


@contextmanager
def part(name: str) -> Iterator[None]:
    """Count what follows as a part of the run that is timed, if one is."""
    if (clock := _CLOCK.get()) is None:
        yield
        return
    clock.turn()
    clock.within.append(name)
    try:
        yield
    finally:
        clock.turn()
        clock.within.pop()


def until_now() -> dict[str, float | None]:
    """Seconds of each part until now, and what share of the loop one thread does alone (Amdahl)."""
    if (clock := _CLOCK.get()) is None:
        return {}
    clock.turn()
    loop = sum(clock.seconds[name] for name in LOOP)
    return {**clock.seconds, "serial_share_of_loop": 1.0 - clock.shared / loop if clock.shared else None}


@contextmanager
def count_kernel() -> Iterator[None]:
    """Count the next calls as a kernel that threads share, if a loop called it, once it is compiled."""
    if (clock := _CLOCK.get()) is None or clock.within[-1] not in LOOP:
        yield
        return
    began = perf_counter() - clock.seconds["kernels"]
    try:
        yield
    finally:
        clock.shared += perf_counter() - clock.seconds["kernels"] - began
