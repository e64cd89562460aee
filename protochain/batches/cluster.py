"""A Dask client: of a cluster of our own on this machine, or of one that is there."""

import logging
import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib.metadata import version

from distributed import Client, LocalCluster, Worker, WorkerPlugin
from distributed.security import Security

from protochain.errors import ProtochainError


@contextmanager
def connected(workers: int | None, scheduler: str | None, threads: int) -> Iterator[Client]:
    """Give a client, and close what was started for it.

    Parameters
    ----------
    workers : int, optional
        Processes on this machine; by default as many as its cores allow.
    scheduler : str, optional
        Address of a cluster that is there. For ``tls://`` certificates are those of Dask's own settings
        (``distributed.comm.tls``).
    threads : int
        That each worker may use.

    Raises
    ------
    ProtochainError
        If the cluster does not answer, or runs another version of protochain.
    """
    if scheduler is None:
        count = workers or max(1, (os.cpu_count() or 1) // threads)
        with (
            LocalCluster(
                n_workers=count,
                threads_per_worker=1,
                host="127.0.0.1",
                dashboard_address="127.0.0.1:0",  # Another batch may have the usual port.
                memory_limit=0,  # The worker only passes on; its child is watched by the system.
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
        _check_versions(client, scheduler)
        yield client


class _CalmWorker(WorkerPlugin):
    """Leaves Ctrl-C, which all processes of a terminal get, to the client, who ends the workers."""

    def setup(self, worker: Worker) -> None:
        with suppress(ValueError):  # Not in a main thread, where no signal arrives.
            signal.signal(signal.SIGINT, signal.SIG_IGN)


def _check_versions(client: Client, scheduler: str) -> None:
    """Refuse workers that would compute something else."""
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
