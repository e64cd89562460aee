"""Threads that help with all energies of a process. They sleep where there is nothing to do."""

import os
import threading
from collections.abc import Callable
from dataclasses import dataclass
from queue import SimpleQueue

Job = Callable[[], None]
"""What helpers are asked for: some of the work, as long as there is any."""
_MEMORY = 0.1
"""s for which what helpers saved counts: many turns of the operating system's scheduler."""
_SHORTEST, _LONGEST = 0.1, 3.2
"""s. Rests of helpers."""
_PROVEN = 0.3
"""Share of the time saved with which earlier rests are forgotten; that of two undisturbed threads is 1."""
_CREDIT = 0.01
"""s that helpers may cost at first: a few of the scheduler's turns."""


@dataclass
class Worth:
    """Whether helpers save time. Beside other work they may cost more: who leads waits for their last tasks.

    Where they have cost time on balance, they are not asked for a while, twice as long each time. This
    changes nothing but time: an energy has the same bits on any number of threads.
    """

    balance: float = _CREDIT
    """s saved of late; what is past counts ever less."""
    pause: float = 0.0
    pause_end: float = 0.0
    """Length of the last rest, and its end, s."""

    def should_ask(self, now: float) -> bool:
        """Whether to ask for helpers at a time in s."""
        return now >= self.pause_end

    def note(self, now: float, took: float, worked: float, share: float) -> None:
        """Take account of an energy with helpers: now, took, worked s."""
        # Alone it would have done the others at the same rate.
        saved = worked / share - took if share else took
        self.balance = (1.0 - min(1.0, took / _MEMORY)) * self.balance + saved
        if self.balance < 0.0:
            self.pause = min(_LONGEST, max(_SHORTEST, 2.0 * self.pause))
            self.pause_end, self.balance = now + self.pause, _CREDIT
        elif self.balance > _PROVEN * _MEMORY:
            self.pause = 0.0


class Helpers:
    """Threads, started when first asked for."""

    def __init__(self) -> None:
        self._jobs: SimpleQueue[Job] = SimpleQueue()
        self._threads = 0

    def ask(self, job: Job, n: int, max_threads: int) -> None:
        """Wake n threads for a job, of ``most`` in all."""
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
    """A process split off another has none of its threads."""
    _pool[0] = Helpers()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_reset_after_fork)
