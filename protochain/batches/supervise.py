"""Threads of this process or of Dask, which run jobs in child processes and report if a child ends."""

import os
import pickle
import queue
import signal
import subprocess
import tempfile
import threading
from collections.abc import Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from time import perf_counter
from typing import IO, Any

from protochain.batches.child import DONE
from protochain.core.interrupts import held_interrupts
from protochain.core.processors import own_python

_START = 600.0
"""s. Time for a child to import and, on a new installation, to compile. Several may compile at once."""

_PINNED = (
    "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS", "OPENMM_CPU_THREADS",
)  # fmt: skip


class ChildError(Exception):
    """Raised when a child ended or exceeded its time limit. ``status`` is the cause."""

    def __init__(self, status: str, message: str) -> None:
        super().__init__(message)
        self.status = status


class Child:
    """Process that runs one job at a time, with a number of threads for its libraries."""

    def __init__(self, threads: int) -> None:
        self.threads = threads
        # A file, as a pipe might fill: it is read only after the child has ended.
        self.stderr: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115 (closed with the child)
        self.process = subprocess.Popen(
            own_python("from protochain.batches.child import main; main()"),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self.stderr,
            start_new_session=True,  # Only the batch handles Ctrl-C.
            env=os.environ | dict.fromkeys(_PINNED, str(threads)),
        )
        self.messages: queue.Queue[Any] = queue.Queue()
        self.listener = threading.Thread(target=self._listen, daemon=True)
        self.listener.start()
        self.is_ready = False

    def do(self, job: Any, time_limit: float) -> list[Any]:
        """Run a job in the child. Return all its rows, also if the child ends early."""
        rows: list[Any] = []
        began = perf_counter()
        try:
            if not self.is_ready:
                self._next(began + _START, "the minimisation process did not start in time")
                self.is_ready, began = True, perf_counter()
            self._send((job, self.threads))
            while True:
                message = self._next(began + time_limit, f"time limit of {time_limit:g} s reached")
                if isinstance(message, str) and message == DONE:
                    return rows
                rows.append(message)
        except ChildError as error:
            self.kill()
            return [*rows, *job.lost(rows, error.status, str(error), perf_counter() - began)]

    @property
    def is_alive(self) -> bool:
        """Whether the process is running."""
        return self.process.poll() is None

    def kill(self) -> None:
        """End the process, if it is running, and close its pipes."""
        self.process.kill()
        self.process.wait()
        self.listener.join()
        for pipe in (self.process.stdin, self.process.stdout, self.stderr):
            assert pipe
            with suppress(OSError):  # Data that was not sent remains in the buffer.
                pipe.close()

    def _send(self, message: Any) -> None:
        assert self.process.stdin
        try:
            pickle.dump(message, self.process.stdin)
            self.process.stdin.flush()
        except OSError as error:
            raise ChildError("killed", self._death()) from error

    def _listen(self) -> None:
        assert self.process.stdout
        while True:
            try:
                self.messages.put(pickle.load(self.process.stdout))
            except (EOFError, pickle.UnpicklingError, OSError):
                self.messages.put(None)
                return

    def _next(self, deadline: float, late: str) -> Any:
        try:
            message = self.messages.get(timeout=max(0.0, deadline - perf_counter()))
        except queue.Empty:
            raise ChildError("time-limit", late) from None
        if message is None:
            raise ChildError("killed", self._death())
        return message

    def _death(self) -> str:
        status = self.process.wait()
        self.stderr.seek(0, os.SEEK_SET)
        lines = self.stderr.read()[-2000:].decode(errors="replace").strip().splitlines()
        if status >= 0:
            return f"the minimisation process ended with status {status}: {lines[-1] if lines else ''}"
        name = signal.Signals(-status).name
        cause = ", as when memory runs out" if name == "SIGKILL" else ""
        return f"the minimisation process was ended by {name}{cause}"


_thread_state = threading.local()  # Child of each thread, and the children of its crew, if any.


class _Children(list[Child]):
    """All children of a crew. The crew may end while a thread starts another child."""

    are_wanted = True

    def add(self, child: Child) -> None:
        """Add a child, or end it if the crew has ended."""
        self.append(child)
        if not self.are_wanted:
            child.process.kill()

    def end(self) -> None:
        """End all children. Their threads report it."""
        self.are_wanted = False
        for child in self:
            child.process.kill()


_ahead: list[Child] = []  # Children without a thread.
_MOST_AHEAD = 8  # Most children without a thread, as there may be fewer jobs than processors.


@contextmanager
def started_early(count: int, threads: int) -> Iterator[None]:
    """Start children while this process imports and reads. :func:`supervise` uses them."""
    _ahead.extend(Child(threads) for _ in range(min(count, _MOST_AHEAD)))
    try:
        yield
    finally:
        while _ahead:
            _ahead.pop().kill()


def _take_child(threads: int) -> Child:
    """Child that was started early, or a new one."""
    try:
        child = _ahead.pop()
    except IndexError:
        return Child(threads)
    if child.threads == threads:
        return child
    child.kill()
    return Child(threads)


@contextmanager
def crew(count: int) -> Iterator[Executor]:
    """Threads for :func:`supervise`, each with a child. Children end with the context, also within a job."""
    children = _Children()
    executor = ThreadPoolExecutor(count, "crew", lambda: setattr(_thread_state, "children", children))
    try:
        yield executor
    finally:
        with held_interrupts():
            executor.shutdown(wait=False, cancel_futures=True)
            children.end()
            executor.shutdown()
            for child in children:
                child.kill()


def supervise(job: Any, threads: int, time_limit: float) -> list[Any]:
    """Run a job in the child of this thread, for up to time_limit, s. Start a child if there is none."""
    child: Child | None = getattr(_thread_state, "child", None)
    if child is None or not child.is_alive or child.threads != threads:
        if child is not None:
            child.kill()
        child = _thread_state.child = _take_child(threads)
        children: _Children | None = getattr(_thread_state, "children", None)
        if children is not None:
            children.add(child)
    return child.do(job, time_limit)
