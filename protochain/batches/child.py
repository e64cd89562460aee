"""The worker process: a thread of a batch starts ``main`` in a separate Python.

The batch continues if the process hangs, is killed, or runs out of memory. It reads pickled jobs from
standard input and writes pickled rows to standard output.
"""

import os
import pickle
import queue
import sys
import threading
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO

READY, DONE = "ready", "done"


def main() -> None:
    """Run jobs until the pipe closes, at the end of the batch or when it has died."""
    results = os.fdopen(os.dup(1), "wb")
    # Output of libraries must not mix with the rows.
    os.dup2(2, 1)
    with suppress(OSError):
        # When memory runs out, the system is to kill this process, and not the batch.
        Path("/proc/self/oom_score_adj").write_text("500")
    jobs: queue.Queue[Any] = queue.Queue()
    threading.Thread(target=_read, args=(sys.stdin.buffer, jobs), daemon=True).start()
    _warm_up()
    _send(results, READY)

    while True:
        job, threads = jobs.get()
        for row in job.run(threads):
            _send(results, row)
        _send(results, DONE)


def _read(source: BinaryIO, jobs: "queue.Queue[Any]") -> None:
    """Queue jobs as they arrive. Exit when the pipe closes, also within an incomplete job."""
    try:
        while True:
            jobs.put(pickle.load(source))
    finally:
        os._exit(0)


def _send(target: BinaryIO, message: Any) -> None:
    pickle.dump(message, target)
    target.flush()


def _warm_up() -> None:
    """Compile the kernels on a new installation, before the first structure is timed."""
    from protochain.energies import energy
    from protochain.minimisers import minimise
    from protochain.structure import from_sequence

    structure = from_sequence("GAG")
    minimise(structure, energy(structure, threads=1), max_evaluations=3)
