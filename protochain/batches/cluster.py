"""Workers of a batch: threads of this process, or a running Dask cluster."""

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
from protochain.core.settings import document_fields
from protochain.core.storage import temporary_stem, writing

if TYPE_CHECKING:
    from distributed import Client

_LOG = logging.getLogger(__name__)
_PATIENCE = 10.0  # s. Time for the scheduler to answer, and for the first worker before a warning.


@document_fields
@dataclass(frozen=True)
class Processes:
    """Processes that minimise the structures of a batch, and their resources.

    Raises
    ------
    ProtochainError
        If a number is not above 0.
    """

    workers: int | None = None  # Processes on this machine. By default, as many as its cores allow.
    # Address of a Dask cluster to use instead. Its workers must see the same files under the same paths. For
    # ``tls://`` the certificates are read from Dask's settings (``distributed.comm.tls``).
    scheduler: str | None = None
    # Threads for each structure. One is best, as many structures use the cores better than many threads.
    threads: int = defaults.BATCH_THREADS
    # s: Time for each structure. After it, the structure is stopped and reported.
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
        """Start processes for :func:`open_workers` now. They import modules while this process reads."""
        return nullcontext() if self.scheduler else started_early(self.count, self.threads)


@dataclass(frozen=True)
class Workers:
    """Workers that run the jobs."""

    submit: Callable[..., Any]  # As of :class:`concurrent.futures.Executor`, or of Dask.
    count: Callable[[], int]  # Current number of workers.
    dashboard: str = ""  # Address of Dask's dashboard, if any.


@contextmanager
def open_workers(processes: Processes) -> Iterator[Workers]:
    """Start threads of this process, or connect to a cluster. Unfinished jobs are cancelled at the end."""
    if processes.scheduler is None:
        # Without sockets: whoever could reach them would run any code as the user.
        with crew(processes.count) as executor:
            yield Workers(executor.submit, lambda: processes.count)
    else:
        with _connect(processes.scheduler) as client:
            submit = partial(client.submit, pure=False)
            yield Workers(submit, lambda: sum(client.nthreads().values()), client.dashboard_link)


class Submitted:
    """Submitted jobs, in the order in which they end."""

    # A job yields its rows by ``run(threads)``. If its process ended, ``lost(finished_rows, status, message,
    # seconds)`` returns the rows that replace the missing ones.

    def __init__(self, workers: Workers, processes: Processes) -> None:
        self.workers, self.limits = workers, (processes.threads, processes.time_limit)
        self._ended: SimpleQueue[tuple[Any, Any]] = SimpleQueue()
        self._running = set[Any]()  # Dask cancels futures without references.

    def __len__(self) -> int:
        return len(self._running)

    def submit(self, job: Any) -> None:
        """Submit a job."""
        future = self.workers.submit(supervise, job, *self.limits)
        self._running.add(future)
        future.add_done_callback(lambda future: self._ended.put((job, future)))

    def wait_for_next(self, timeout: float | None = None) -> tuple[Any, Any]:
        """Wait for the next job to end. Return the job and its future, or raise :class:`queue.Empty`."""
        job, future = self._ended.get(timeout=timeout)
        self._running.remove(future)
        return job, future


def run_jobs(
    jobs: Sequence[Any], processes: Processes | None, threads: int | None = None
) -> Iterator[tuple[Any, list[Any]]]:
    """Yield jobs with their rows, in order in this process, or as they end in several processes."""
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
    """Status and message of a row that an error ended. ``path`` is its input."""
    match error:
        case WriteError():  # The disk is full. The structure itself is not the cause.
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
    """Temporary file of the values that all processes read."""
    with tempfile.TemporaryDirectory(".part", temporary_stem(), folder) as shared_folder:
        path = Path(shared_folder).absolute() / "task.pickle"
        try:
            with writing(path):
                path.write_bytes(pickle.dumps(values))
        except (pickle.PicklingError, AttributeError, TypeError):
            raise ProtochainError(
                Argument("energy"), ": cannot be sent to processes; define it in a module, or remove ",
                Argument("workers"),
            ) from None  # fmt: skip
        yield path


@lru_cache(maxsize=1)
def load_shared(path: Path) -> Any:
    """Values that :func:`shared_file` wrote. All jobs of a process share them."""
    return pickle.loads(path.read_bytes())


@contextmanager
def _connect(scheduler: str) -> Iterator["Client"]:
    # Imported only here, as it takes half a second.
    dask = library("distributed", "cluster")
    try:
        security = dask.Security() if scheduler.startswith("tls://") else None
        client = dask.Client(scheduler, security=security, timeout=_PATIENCE, set_as_default=False)
    except (OSError, TypeError, ValueError) as error:
        raise ProtochainError(f"scheduler {scheduler}: no cluster responds: {error}") from error
    with client:
        # Warn after a while without a worker, as a queue may start it later, or nobody started one.
        try:
            client.wait_for_workers(1, timeout=_PATIENCE)
        except TimeoutError:
            _LOG.warning(
                "scheduler %s: no workers after %g s; start some with 'dask worker %s', or stop with Ctrl-C",
                scheduler, _PATIENCE, scheduler,
            )  # fmt: skip
            client.wait_for_workers(1)
        local_version = version("protochain")
        for worker, worker_version in client.run(_version).items():
            if worker_version != local_version:
                raise ProtochainError(
                    f"scheduler {scheduler}: worker {worker} has protochain {worker_version}, and here is "
                    f"{local_version}; install one version everywhere"
                )
        yield client


def _version() -> str:
    from importlib.metadata import PackageNotFoundError

    try:
        return version("protochain")
    except PackageNotFoundError:
        return "not installed"
