"""Threads that help with all energies of a process. They sleep if there is no work."""

import os
import threading
from collections.abc import Callable
from dataclasses import dataclass
from queue import SimpleQueue

Job = Callable[[], None]
"""Job of helpers: part of the work, until none remains."""
_MEMORY = 0.1
"""s over which the time saved by helpers is averaged: many turns of the operating system's scheduler."""
_SHORTEST, _LONGEST = 0.1, 3.2  # s. Shortest and longest pause of helpers.
_PROVEN = 0.3
"""Share of time saved that resets the length of pauses. Two undisturbed threads have a share of 1."""
_CREDIT = 0.01  # s. Initial credit of helpers: a few turns of the scheduler.


@dataclass
class Worth:
    """Whether helpers save time. On a busy machine the leading thread may wait for their last tasks."""

    # After a net loss of time, helpers pause, for twice as long each time. This changes only the run time: an
    # energy has the same bits on any number of threads.

    balance: float = _CREDIT  # s saved recently, as a decaying sum.
    pause: float = 0.0  # s. Length of the last pause.
    pause_end: float = 0.0  # s. End of the last pause.

    def should_ask(self, now: float) -> bool:
        """Whether to ask for helpers at a time in s."""
        return now >= self.pause_end

    def note(self, now: float, took: float, worked: float, share: float) -> None:
        """Record an energy with helpers: now, took, worked in s."""
        # Alone, the leading thread would have done all tasks at the same rate.
        saved = worked / share - took if share else took
        self.balance = (1.0 - min(1.0, took / _MEMORY)) * self.balance + saved
        if self.balance < 0.0:
            self.pause = min(_LONGEST, max(_SHORTEST, 2.0 * self.pause))
            self.pause_end, self.balance = now + self.pause, _CREDIT
        elif self.balance > _PROVEN * _MEMORY:
            self.pause = 0.0


class Helpers:
    """Threads, started at the first request."""

    def __init__(self) -> None:
        self._jobs: SimpleQueue[Job] = SimpleQueue()
        self._threads = 0

    def ask(self, job: Job, n: int, max_threads: int) -> None:
        """Wake n threads for a job, of at most ``max_threads``."""
        while self._threads < max_threads:
            self._threads += 1
            threading.Thread(target=_serve, args=(self._jobs,), daemon=True, name="protochain helper").start()
        for _ in range(n):
            self._jobs.put(job)


def _serve(jobs: "SimpleQueue[Job]") -> None:
    while True:
        jobs.get()()


_pool = [Helpers()]


def helpers() -> Helpers:
    """Return the threads of this process."""
    return _pool[0]


def _reset_after_fork() -> None:
    """Discard the threads, which a forked process does not have."""
    _pool[0] = Helpers()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_reset_after_fork)
