"""What calls cost: seconds, taken in turn."""

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import median
from time import perf_counter, process_time
from typing import Any, TypeVar

from threadpoolctl import threadpool_limits

_Result = TypeVar("_Result")
_SHORT, _MOST = 0.1, 1000
"""s, below which calls are made in a row; turns."""


@dataclass(frozen=True)
class Timed:
    """Last result of a call, and the seconds of each.

    result: What the last call returned.
    seconds: One for each call that counts.
    """

    result: Any
    seconds: tuple[float, ...]

    @property
    def least(self) -> float:
        """Seconds of the shortest: other work on the machine only adds."""
        return min(self.seconds)

    @property
    def median(self) -> float:
        """Seconds that half of the calls take."""
        return median(self.seconds)


def in_turn(
    calls: Sequence[Callable[[], object]],
    seconds: float = 0.0,
    turns: int = 1,
    row: int = 1,
    clock: Callable[[], float] = process_time,
) -> list[Timed]:
    """Time calls in turn, so that a slow moment of the machine strikes all.

    Dense algebra has one thread: several that wait for each other take a hundred times as long.
    """
    results: list[object] = [None] * len(calls)
    taken: list[list[float]] = [[] for _ in calls]
    done, began = 0, perf_counter()
    with threadpool_limits(1, "blas"):
        while done < turns or (done < _MOST and perf_counter() - began < seconds):
            for k, call in enumerate(calls):
                times = row if taken[k] and taken[k][-1] < _SHORT else 1
                for i in range(times):
                    start = clock()
                    results[k] = call()
                    spent = clock() - start
                    if i or times == 1:
                        taken[k].append(spent)
            done += 1
    return [Timed(result, tuple(own)) for result, own in zip(results, taken, strict=True)]


def timed(call: Callable[[], _Result], repeats: int = 1) -> tuple[_Result, float]:
    """Result of a call, and its processor seconds: the least of some repeats.

    What is compiled by the first call belongs in no timing: call it before, or give two repeats or more.
    """
    (found,) = in_turn([call], turns=repeats)
    return found.result, found.least


def least_seconds(call: Callable[[], object], seconds: float = 0.2) -> float:
    """Least processor seconds of a call, of at least three and for as long as this; the first not counted."""
    call()
    return in_turn([call], seconds, 3)[0].least


def cpu_seconds() -> float:
    """CPU time of this process and of those that it has waited for."""
    spent = os.times()
    return process_time() + spent.children_user + spent.children_system
