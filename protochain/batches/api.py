"""``batch``: many structures by Dask, results to disk as they arrive."""

import json
import platform
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from importlib.metadata import version
from importlib.util import find_spec
from itertools import islice
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

from distributed import LocalCluster, as_completed
from distributed.client import Client, Future

from protochain.batches.cluster import connected
from protochain.batches.jobs import Job, Row, Settings, failure, find_jobs
from protochain.batches.supervise import supervise
from protochain.batches.table import Tables, read_table
from protochain.errors import ProtochainError
from protochain.interrupts import held_interrupts
from protochain.storage import write_atomically

if TYPE_CHECKING:
    import pandas as pd

_AHEAD = 4
"""Jobs that wait at the scheduler for each thread of the cluster: enough that none is idle, and no more."""

_RECOUNT = 5.0
"""s between counts of the cluster's threads: it may grow."""


@dataclass(frozen=True)
class Progress:
    """How far a batch is.

    Parameters
    ----------
    total, done, failed, skipped : int
        Structures: of the whole batch, done now, of these without any usable result, done before.
    seconds : float
        Since the first was submitted.
    dashboard : str
        Address of Dask's dashboard, if there is one.
    """

    total: int
    done: int
    failed: int
    skipped: int
    seconds: float
    dashboard: str


Watcher = Callable[[Progress], None]


@dataclass(frozen=True)
class Batch:
    """What a batch left in its folder.

    Parameters
    ----------
    folder : Path
    interrupted : bool
        Whether it ended before all was done.
    """

    folder: Path
    interrupted: bool = False

    @cached_property
    def table(self) -> "pd.DataFrame":
        """``summary.csv``: a row a structure and method, failures among them."""
        return read_table(self.folder / "summary.csv")

    @cached_property
    def traces(self) -> "pd.DataFrame":
        """``traces.csv``: some fifty points of every run."""
        return read_table(self.folder / "traces.csv")

    @property
    def report(self) -> Path:
        """The page of the whole set."""
        return self.folder / "report.html"

    def counts(self) -> dict[str, int]:
        """Return how many rows ended how."""
        return {str(status): int(n) for status, n in self.table["status"].value_counts().items()}

    def __repr__(self) -> str:
        said = ", ".join(f"{n} {status}" for status, n in self.counts().items())
        return f"<Batch in {self.folder}: {said}>"

    def _repr_html_(self) -> str:
        return self.table.iloc[:, :12].to_html(index=False, max_rows=20)


def batch(
    inputs: str | Path | Iterable[str | Path],
    output: str | Path,
    methods: str | Sequence[str] = ("hybrid",),
    *,
    manifest: str | Path | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    threads: int = 1,
    time_limit: float = 3600.0,
    resume: bool = False,
    watch: Watcher | None = None,
    **settings: Any,
) -> Batch:
    """Minimise many structures in worker processes; write tables, structures and pages.

    Parameters
    ----------
    inputs : path-like or iterable of path-like
        Files, folders, patterns, or ``-`` for a list on standard input.
    output : path-like
        Folder for ``summary.csv``, ``traces.csv``, structures and pages, to which rows are appended as they
        arrive; at the end also ``summary.parquet``, ``summary.json``, plots and ``report.html``.
    methods : str or sequence of str
        As of :func:`protochain.minimise`. With ``openmm`` among them, C-alpha RMSDs to its end are reported.
    manifest : path-like, optional
        CSV with a column ``path`` and any of the settings.
    workers : int, optional
        Processes on this machine; all cores by default.
    scheduler : str, optional
        Address of a Dask cluster to use instead. Its workers must see the same files under the same paths.
    threads : int
        Threads for each structure. One is best: many structures use the cores better than many threads.
    time_limit : float, s
        For each structure; what takes longer is killed and reported.
    resume : bool
        Go on in a folder: structures whose content and settings are those of finished rows are skipped.
    watch : callable, optional
        Called with a :class:`Progress` after each structure.
    **settings
        Any others of :class:`protochain.batches.Settings`: ``solvent="gbn2"``, ``model="all"`` ...

    Returns
    -------
    Batch
        What fails is a row with a status and a message; nothing of it stops the others.

    Raises
    ------
    ProtochainError
        If there is nothing to do, a setting makes no sense, or the folder or cluster cannot be used.

    Notes
    -----
    A script that calls this must do so under ``if __name__ == "__main__":``, as all that start processes.
    """
    given = [inputs] if isinstance(inputs, str | Path) else list(inputs)
    chosen = (methods,) if isinstance(methods, str) else tuple(methods)
    if not time_limit > 0 or threads < 1 or (workers is not None and workers < 1):
        raise ProtochainError("time-limit, threads and workers: give numbers above 0")
    try:
        common = Settings(methods=chosen, **settings)
    except TypeError as error:
        raise ProtochainError(f"settings: {error}") from error
    folder = Path(output)
    jobs = find_jobs(given, common, Path(manifest) if manifest else None, folder)
    tables = Tables(folder, resume)
    try:
        done = tables.finished(jobs)
        todo = [job for job in jobs if job.identity not in done]
        interrupted = False
        if todo:
            with connected(workers, scheduler, threads) as client:
                interrupted = _work(client, todo, tables, threads, time_limit, len(done), watch)
        with held_interrupts():
            tables.sort(jobs)
            _finish(folder, jobs)
    finally:
        tables.close()
    return Batch(folder, interrupted)


def _work(
    client: Client,
    todo: Sequence[Job],
    tables: Tables,
    threads: int,
    time_limit: float,
    skipped: int,
    watch: Watcher | None,
) -> bool:
    """Have the jobs done; append their rows as they arrive. Return whether it ended before all were."""
    began = perf_counter()
    folder = tables.folder.absolute()
    waiting = iter(todo)
    of: dict[Any, Job] = {}
    done = failed = 0

    def submit(count: int) -> Iterator[Future]:
        for job in islice(waiting, count):
            future = client.submit(supervise, job, folder, threads, time_limit, pure=False)
            of[future.key] = job
            yield future

    # A scheduler elsewhere may have Bokeh, which draws it; ours has what is installed here.
    there = find_spec("bokeh") or not isinstance(client.cluster, LocalCluster)
    dashboard = client.dashboard_link if there else ""
    window = _Window(client)
    running = as_completed(submit(window.size()), loop=client.loop)
    try:
        for future in running:
            if future.status not in ("finished", "error"):
                return True  # The scheduler is gone.
            with held_interrupts() as interrupts:
                rows = _rows(future, of.pop(future.key))
                tables.append(rows)
            done += 1
            failed += all("output" not in row.record for row in rows)
            if watch:
                total = skipped + len(todo)
                seconds = perf_counter() - began
                watch(Progress(total, done, failed, skipped, seconds, dashboard))
            if interrupts:
                raise KeyboardInterrupt
            for further in submit(max(0, window.size() - len(of))):
                running.add(further)
    except KeyboardInterrupt:
        client.cancel(list(running.futures))
        return True
    return False


class _Window:
    """How many jobs to have at the scheduler: the client's memory does not grow with the batch."""

    def __init__(self, client: Client) -> None:
        self.client, self.counted, self.threads = client, -_RECOUNT, 0

    def size(self) -> int:
        if perf_counter() - self.counted > _RECOUNT:
            self.threads, self.counted = sum(self.client.nthreads().values()), perf_counter()
        return _AHEAD * max(self.threads, 1)


def _rows(future: Future, job: Job) -> list[Row]:
    """Return the rows of a job, or what Dask says of it."""
    if future.status == "finished":
        rows: list[Row] = future.result()
        return rows
    message = f"no worker finished it: {future.exception()}"
    return [failure(job, method, "killed", message) for method in job.settings.methods]


def _finish(folder: Path, jobs: Sequence[Job]) -> None:
    """Write what is made from the whole table."""
    from protochain.batches.report import write_report

    table = read_table(folder / "summary.csv")
    write_atomically(folder / "summary.parquet", lambda to: table.to_parquet(to, index=False))
    packages = (
        "protochain",
        "openmm",
        "pdbfixer",
        "gemmi",
        "numpy",
        "scipy",
        "numba",
        "distributed",
        "pandas",
    )
    summary = {
        "n_structures": len(jobs),
        "n_rows": len(table),
        "status": {str(name): int(n) for name, n in Counter(table["status"]).items()},
        "command": sys.argv,
        "python": platform.python_version(),
        "versions": {name: version(name) for name in packages},
        "settings": asdict(jobs[0].settings),
    }
    text = json.dumps(summary, indent=2, default=str)
    write_atomically(folder / "summary.json", lambda to: to.write_text(text, encoding="utf-8"))
    write_report(folder, table, summary)
