"""``relax_files``: many structures relaxed by the processes of a batch."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from protochain.batches.api import Batch, BatchProgress, run_jobs
from protochain.batches.cluster import Processes
from protochain.batches.jobs import find_jobs
from protochain.batches.relaxed import COLUMNS, RelaxSettings
from protochain.batches.table import Tables
from protochain.relaxation.settings import Relaxing
from protochain.setup import Setup

NAME = "relaxed"


def relax_files(
    inputs: Iterable[str | Path],
    output: str | Path,
    relaxing: Relaxing | None = None,
    setup: Setup | None = None,
    *,
    resume: bool = False,
    watch: Callable[[BatchProgress], None] | None = None,
    **processes: Any,
) -> Batch:
    """Relax many structures in worker processes; a failure is a row and stops no other.

    Parameters
    ----------
    inputs : iterable of path-like
        Files, folders, patterns.
    output : path-like
        Folder for the structures, ``relaxed.csv`` with a row for each, and pages.
    relaxing : Relaxing, optional
        How firmly, and how far.
    setup : Setup, optional
        How structures are read, and their energy. Its threads are those of each structure; one by default.
    resume : bool
        Continue in a folder with the same settings: structures are skipped that are finished and unchanged.
    watch : callable, optional
        Called with a :class:`protochain.batches.BatchProgress` after each structure.
    **processes
        Fields of :class:`protochain.batches.Processes`: ``workers``, ``scheduler``, ``time_limit``.

    Returns
    -------
    Batch
        Its table is ``relaxed.csv``.

    Raises
    ------
    ProtochainError
        If there is nothing to do, settings differ from those of the folder to be resumed, or it cannot be
        used.

    Notes
    -----
    A script must call it under ``if __name__ == "__main__":``, as any function that starts processes.
    """
    relaxing, setup = relaxing or Relaxing(), setup or Setup()
    if setup.threads is not None:
        processes = {"threads": setup.threads} | processes
    settings, folder = RelaxSettings(relaxing, relaxing.setup(setup)), Path(output)
    jobs = find_jobs(list(inputs), settings, None, folder)
    return run_jobs(jobs, settings, Tables(folder, resume, NAME, COLUMNS), Processes(**processes), watch)
