"""``relax_files``: many structures relaxed by a batch, with the table of ``protochain relax``."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from protochain.batches.batch_structures import Batch, BatchProgress, run_batch
from protochain.batches.cluster import Processes
from protochain.batches.jobs import BatchSettings
from protochain.chains.setup import Setup
from protochain.relaxation.record import METHOD as RELAX
from protochain.relaxation.relax_settings import RelaxSettings

NAME = "relaxed"


def relax_files(
    inputs: Iterable[str | Path],
    output: str | Path,
    relaxing: RelaxSettings | None = None,
    setup: Setup | None = None,
    *,
    manifest: str | Path | None = None,
    resume: bool = False,
    watch: Callable[[BatchProgress], None] | None = None,
    **processes: Any,
) -> Batch:
    """Relax many structures: :func:`protochain.batch` with the method ``relax``, its table ``relaxed.csv``.

    Parameters
    ----------
    inputs : iterable of path-like
        Files, folders, patterns.
    output : path-like
        Folder for the structures, ``relaxed.csv`` with a row for each, and pages.
    relaxing : RelaxSettings, optional
        How firmly, and how far.
    setup : Setup, optional
        How structures are read, and their energy. Its threads are those of each structure; one by default.
    manifest : path-like, optional
        CSV with a column ``path`` and columns named after fields of ``relaxing`` and ``setup``.
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
    """
    setup = setup or Setup()
    if setup.threads is not None:
        processes = {"threads": setup.threads} | processes
    settings = BatchSettings((RELAX,), setup=setup, relaxing=relaxing or RelaxSettings())
    return run_batch(
        list(inputs), settings, Path(output), Path(manifest) if manifest else None, resume,
        Processes(**processes), watch, NAME,
    )  # fmt: skip
