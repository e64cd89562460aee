"""A Dask client: of a cluster started on this machine, or of one that is running already."""

import logging
import signal
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib.metadata import version

from distributed import Client, LocalCluster, Worker, WorkerPlugin
from distributed.security import Security

from protochain import defaults
from protochain.checks import check_fields, integer, number, optional, text
from protochain.errors import Argument, ProtochainError
from protochain.processors import processors

_LOG = logging.getLogger(__name__)
_PATIENCE = 10.0
"""s. Time for the first worker before its absence is told."""


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
            self, workers=optional(integer), scheduler=optional(text), threads=integer, time_limit=number
        )
        if not self.time_limit > 0 or self.threads < 1 or (self.workers is not None and self.workers < 1):
            raise ProtochainError(
                Argument("time_limit"),
                ", ",
                Argument("threads"),
                " and ",
                Argument("workers"),
                ": give numbers above 0",
            )


@contextmanager
def connected(processes: Processes) -> Iterator[Client]:
    """Connect to a cluster, or start one on this machine; close afterwards what was started.

    Raises
    ------
    ProtochainError
        If the cluster does not answer, or runs another version of protochain.
    """
    scheduler = processes.scheduler
    if scheduler is None:
        count = processes.workers or max(1, processors() // processes.threads)
        with (
            LocalCluster(
                n_workers=count,
                threads_per_worker=1,
                host="127.0.0.1",
                dashboard_address="127.0.0.1:0",  # The usual port may be another batch's.
                memory_limit=0,  # Memory is used by the worker's child, which the system limits.
                silence_logs=logging.CRITICAL,
            ) as cluster,
            Client(cluster) as client,
        ):
            client.register_plugin(_CalmWorker())
            yield client
        return
    try:
        security = Security() if scheduler.startswith("tls://") else None
        client = Client(scheduler, security=security, timeout="10s", set_as_default=False)
    except (OSError, TypeError, ValueError) as error:
        raise ProtochainError(f"scheduler {scheduler}: no cluster answers there: {error}") from error
    with client:
        _await_workers(client, scheduler)
        _check_versions(client, scheduler)
        yield client


def _await_workers(client: Client, scheduler: str) -> None:
    """Wait for a worker, and say so: a queue may give it later, or nobody has started one."""
    try:
        client.wait_for_workers(1, timeout=_PATIENCE)
    except TimeoutError:
        _LOG.warning(
            "scheduler %s: no workers after %g s; start some with 'dask worker %s', or stop with Ctrl-C",
            scheduler, _PATIENCE, scheduler,
        )  # fmt: skip
        client.wait_for_workers(1)


class _CalmWorker(WorkerPlugin):
    """Ignore Ctrl-C, which all processes of a terminal receive: the client ends the workers."""

    def setup(self, worker: Worker) -> None:
        with suppress(ValueError):  # Only a main thread receives signals.
            signal.signal(signal.SIGINT, signal.SIG_IGN)


def _check_versions(client: Client, scheduler: str) -> None:
    """Refuse workers with another version of protochain."""
    own = version("protochain")
    for worker, theirs in client.run(_version).items():
        if theirs != own:
            raise ProtochainError(
                f"scheduler {scheduler}: worker {worker} has protochain {theirs}, and here is {own}; "
                "install one version everywhere"
            )


def _version() -> str:
    from importlib.metadata import PackageNotFoundError

    try:
        return version("protochain")
    except PackageNotFoundError:
        return "not installed"
