"""Who does the jobs of a batch: threads of this process, or a Dask cluster that is running already."""

import logging
import pickle
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass
from functools import lru_cache, partial
from importlib.metadata import version
from pathlib import Path
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any

from protochain.batches.supervise import crew, started_early, supervise
from protochain.core import defaults
from protochain.core.checks import at_least, check_fields, in_range, number, optional, text
from protochain.core.errors import Argument, ProtochainError, WriteError
from protochain.core.optional_libraries import library
from protochain.core.processors import processors
from protochain.core.storage import temporary_stem, writing

if TYPE_CHECKING:
    from distributed import Client

_LOG = logging.getLogger(__name__)
_PATIENCE = 10.0
"""s. Time for the scheduler to answer, and for the first worker before its absence is told."""
"""How the name begins of the folder of what all processes need."""


@dataclass(frozen=True)
class Processes:
    """Where the structures of a batch are minimised, and what each may use.

    Parameters
    ----------
    workers : int, optional
        Processes on this machine; by default as many as its cores allow.
    scheduler : str, optional
        Address of a Dask cluster to use instead. Its workers must see the same files under the same paths.
        For ``tls://`` the certificates are those of Dask's own settings (``distributed.comm.tls``).
    threads : int
        Threads for each structure. One is best: many structures use the cores better than many threads.
    time_limit : float, s
        Time for each structure, after which it is given up and reported.

    Raises
    ------
    ProtochainError
        If a number is not above 0.
    """

    workers: int | None = None
    scheduler: str | None = None
    threads: int = defaults.BATCH_THREADS
    time_limit: float = defaults.TIME_LIMIT

    def __post_init__(self) -> None:
        check_fields(
            self, workers=optional(at_least(1)), scheduler=optional(text), threads=at_least(1),
            time_limit=in_range(number, lambda seconds: seconds > 0.0, "give a number above 0"),
        )  # fmt: skip

    @property
    def count(self) -> int:
        """Processes on this machine."""
        return self.workers or max(1, processors() // self.threads)

    def started_early(self) -> AbstractContextManager[None]:
        """Start processes on this machine now, for :func:`at_work`: they import while this one reads."""
        return nullcontext() if self.scheduler else started_early(self.count, self.threads)


@dataclass(frozen=True)
class Workers:
    """Who does the jobs."""

    submit: Callable[..., Any]  # As of :class:`concurrent.futures.Executor`, or of Dask.
    count: Callable[[], int]  # Of jobs that are done at a time, now.
    dashboard: str = ""  # Address of Dask's, if there is one.


@contextmanager
def open_workers(processes: Processes) -> Iterator[Workers]:
    """Start threads of this process, or connect to a cluster; what is not done at the end is given up."""
    if processes.scheduler is None:
        # Without sockets: whoever could reach them would run any code as the user.
        with crew(processes.count) as executor:
            yield Workers(executor.submit, lambda: processes.count)
    else:
        with _connect(processes.scheduler) as client:
            yield Workers(
                partial(client.submit, pure=False),
                lambda: sum(client.nthreads().values()),
                client.dashboard_link,
            )


class Submitted:
    """Jobs that were handed to workers, in the order in which they end."""

    # A job yields the rows of what it does by ``run(threads)``, and says by ``lost(done, status, message,
    # seconds)`` which rows stand for those that are missing where its process ended.

    def __init__(self, workers: Workers, processes: Processes) -> None:
        self.workers, self.limits = workers, (processes.threads, processes.time_limit)
        self._ended: SimpleQueue[tuple[Any, Any]] = SimpleQueue()
        self._running = set[Any]()  # Dask gives up what nobody holds.

    def __len__(self) -> int:
        return len(self._running)

    def submit(self, job: Any) -> None:
        """Hand out a job."""
        future = self.workers.submit(supervise, job, *self.limits)
        self._running.add(future)
        future.add_done_callback(lambda future: self._ended.put((job, future)))

    def wait_for_next(self, timeout: float | None = None) -> tuple[Any, Any]:
        """Wait for the next to end: the job, and its future; :class:`queue.Empty` after a timeout, s."""
        job, future = self._ended.get(timeout=timeout)
        self._running.remove(future)
        return job, future


def run_jobs(
    jobs: Sequence[Any], processes: Processes | None, threads: int | None = None
) -> Iterator[tuple[Any, list[Any]]]:
    """Jobs with their rows: here, one after the other, on so many threads; or by processes, as they end."""
    if processes is None:
        yield from ((job, [*job.run(threads)]) for job in jobs)
        return
    with open_workers(processes) as workers:
        running = Submitted(workers, processes)
        for job in jobs:
            running.submit(job)
        while len(running):
            job, future = running.wait_for_next()
            yield job, future.result()


def reason(error: Exception, path: object = "") -> tuple[str, str]:
    """Status and message of the row of what an error ended; ``path`` is what was worked on."""
    match error:
        case WriteError():  # With space it may be done: not what is wrong with this structure.
            return "killed", str(error)
        case ProtochainError():
            return "refused", str(error)
        case MemoryError():
            return "killed", "out of memory"
        case OSError():
            return "refused", f"{error.filename or path}: {error.strerror or error}"
        case _:  # A bug met by one job must not stop the others.
            return "error", f"{type(error).__name__}: {error}"


@contextmanager
def shared_file(values: tuple[Any, ...], folder: Path | None = None) -> Iterator[Path]:
    """File, for as long as it is needed, of values that all processes read."""
    with tempfile.TemporaryDirectory(".part", temporary_stem(), folder) as shared_folder:
        path = Path(shared_folder).absolute() / "task.pickle"
        try:
            with writing(path):
                path.write_bytes(pickle.dumps(values))
        except (pickle.PicklingError, AttributeError, TypeError):
            raise ProtochainError(
                Argument("energy"), ": cannot be sent to processes; define it in a module, or leave out ",
                Argument("workers"),
            ) from None  # fmt: skip
        yield path


@lru_cache(maxsize=1)
def load_shared(path: Path) -> Any:
    """What :func:`shared` wrote: the jobs of a process have it in common."""
    return pickle.loads(path.read_bytes())


@contextmanager
def _connect(scheduler: str) -> Iterator["Client"]:
    # Half a second that batches on this machine do without.
    dask = library("distributed", "cluster")
    try:
        security = dask.Security() if scheduler.startswith("tls://") else None
        client = dask.Client(scheduler, security=security, timeout=_PATIENCE, set_as_default=False)
    except (OSError, TypeError, ValueError) as error:
        raise ProtochainError(f"scheduler {scheduler}: no cluster answers there: {error}") from error
    with client:
        _await_workers(client, scheduler)
        _check_versions(client, scheduler)
        yield client


def _await_workers(client: "Client", scheduler: str) -> None:
    """Wait for a worker, and say so: a queue may give it later, or nobody has started one."""
    try:
        client.wait_for_workers(1, timeout=_PATIENCE)
    except TimeoutError:
        _LOG.warning(
            "scheduler %s: no workers after %g s; start some with 'dask worker %s', or stop with Ctrl-C",
            scheduler, _PATIENCE, scheduler,
        )  # fmt: skip
        client.wait_for_workers(1)


def _check_versions(client: "Client", scheduler: str) -> None:
    """Refuse workers with another version of protochain."""
    local_version = version("protochain")
    for worker, worker_version in client.run(_version).items():
        if worker_version != local_version:
            raise ProtochainError(
                f"scheduler {scheduler}: worker {worker} has protochain {worker_version}, and here is "
                f"{local_version}; "
                "install one version everywhere"
            )


def _version() -> str:
    from importlib.metadata import PackageNotFoundError

    try:
        return version("protochain")
    except PackageNotFoundError:
        return "not installed"
