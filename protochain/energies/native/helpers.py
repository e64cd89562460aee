"""Threads that help with all energies of a process. They sleep where there is nothing to do."""

import os
import threading
from queue import SimpleQueue
from typing import Protocol


class Job(Protocol):
    """What helpers are asked for."""

    def help_out(self) -> None:
        """Do some of the work, as long as there is any."""


class Helpers:
    """Threads, started when first asked for."""

    def __init__(self) -> None:
        self._jobs: SimpleQueue[Job] = SimpleQueue()
        self._threads = 0

    def ask(self, job: Job, n: int, most: int) -> None:
        """Wake n threads for a job, of ``most`` in all."""
        while self._threads < most:
            self._threads += 1
            threading.Thread(target=_serve, args=(self._jobs,), daemon=True, name="protochain helper").start()
        for _ in range(n):
            self._jobs.put(job)


def _serve(jobs: "SimpleQueue[Job]") -> None:
    while True:
        jobs.get().help_out()


_all = [Helpers()]


def helpers() -> Helpers:
    """Return the threads of this process."""
    return _all[0]


def _forget() -> None:
    """A process split off another has none of its threads."""
    _all[0] = Helpers()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget)
