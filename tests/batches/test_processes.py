"""Where a batch runs, and how its jobs are handed out."""

import errno
import os
import sys
import threading
from collections import deque
from concurrent.futures import Future
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import pytest
from fixtures.waiting import HANG

import protochain as pc
from protochain.batches import batch_structures, cluster
from protochain.batches.cluster import Processes, Workers, open_workers
from protochain.batches.jobs import BatchSettings, Job, Row
from protochain.batches.supervise import supervise
from protochain.batches.table import Tables
from protochain.batches.task import Task
from protochain.core.errors import WriteError

OWN = version("protochain")
pytestmark = pytest.mark.usefixtures("worker_processes")


@pytest.mark.parametrize(
    "wrong", [{"time_limit": 0.0}, {"time_limit": float("nan")}, {"threads": 0}, {"workers": 0}]
)
def test_numbers_of_processes_are_above_zero(wrong):
    with pytest.raises(pc.ProtochainError) as refusal:
        Processes(**wrong)
    ((name, value),) = wrong.items()
    assert str(refusal.value).startswith(f"{name} {value:g}: give ")
    assert Processes(1, None, 1, 1e-3).workers == 1
    assert Processes() == Processes(None, None, 1, 3600.0)


def test_what_all_processes_read_is_named_if_it_cannot_be_written(tmp_path, monkeypatch):
    def full(path, data):
        raise OSError(errno.EFBIG, os.strerror(errno.EFBIG))

    monkeypatch.setattr(Path, "write_bytes", full)
    wrong = pytest.raises(WriteError, match=rf"{tmp_path}.*pickle: not written \(File too large\)")
    with wrong, cluster.shared_file((1,), tmp_path):
        pass


class Client:
    """Dask's client as a batch sees it."""

    made = ()
    answers = ()
    error = None
    dashboard_link = "http://there"

    def __init__(self, *given, **options):
        if self.error:
            raise self.error
        type(self).made = (*self.made, (given, options))
        self.awaited = False

    def __enter__(self):
        return self

    def __exit__(self, *_):
        type(self).made = (*self.made, "closed")

    def wait_for_workers(self, count, timeout):
        assert (count, timeout) == (1, 10.0)
        self.awaited = True

    def run(self, function):
        assert self.awaited
        assert function is cluster._version
        return dict(self.answers)

    def nthreads(self):
        return {"one": 2, "two": 3}

    def submit(self, *given, pure):
        return given, pure


@pytest.fixture
def dask(monkeypatch):
    """A client that only notes what it is given."""

    class Own(Client):
        pass

    monkeypatch.setattr("distributed.Client", Own)
    return Own


@pytest.mark.parametrize(
    ("processes", "cores", "count"),
    [
        (Processes(workers=3), 8, 3), (Processes(threads=3), 8, 2), (Processes(threads=9), 8, 1),
    ],
)  # fmt: skip
def test_on_this_machine_a_thread_is_busy_on_each_core(processes, cores, count, dask, monkeypatch):
    monkeypatch.setattr(cluster, "processors", lambda: cores)
    barrier = threading.Barrier(count, timeout=HANG)
    with open_workers(processes) as workers:
        assert (workers.count(), workers.dashboard) == (count, "")
        # It breaks, unless all are busy at a time.
        assert sorted(each.result() for each in [workers.submit(barrier.wait) for _ in range(count)]) == [
            *range(count)
        ]
    assert dask.made == ()


def test_without_dask_a_batch_here_runs_and_a_cluster_names_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with open_workers(Processes(workers=1)) as workers:
        assert workers.submit(len, "job").result() == 3
    remedy = r'^distributed .* pip install "protochain\[cluster\]"$'
    with pytest.raises(pc.ProtochainError, match=remedy), open_workers(Processes(scheduler="tcp://there:1")):
        pass


@pytest.mark.parametrize("address", ["tcp://there:1", "tls://there:1"])
def test_a_cluster_that_runs_is_used_where_its_version_is_ours(address, dask):
    dask.answers = [("one", OWN), ("two", OWN)]
    with open_workers(Processes(scheduler=address)) as workers:
        assert (workers.count(), workers.dashboard) == (5, "http://there")
        assert workers.submit(len, "job") == ((len, "job"), False)
    (((given,), options), closed) = dask.made
    assert given == address and closed == "closed"
    assert (options["timeout"], options["set_as_default"]) == (10.0, False)
    assert (options["security"] is None) == address.startswith("tcp")
    dask.answers = [("one", OWN), ("two", "0.0.1")]
    with pytest.raises(pc.ProtochainError) as refusal, open_workers(Processes(scheduler=address)):
        pass
    assert str(refusal.value) == (
        f"scheduler {address}: worker two has protochain 0.0.1, and here is {OWN}; "
        "install one version everywhere"
    )


@pytest.mark.parametrize("error", [OSError("no"), TypeError("no")])
def test_a_cluster_that_does_not_answer_is_named(error, dask):
    dask.error = error
    with pytest.raises(pc.ProtochainError) as refusal, open_workers(Processes(scheduler="tcp://there:1")):
        pass
    assert str(refusal.value) == "scheduler tcp://there:1: no cluster responds: no"


def test_a_worker_tells_its_version(monkeypatch):
    assert cluster._version() == OWN

    def none(name):
        raise PackageNotFoundError(name)

    monkeypatch.setattr(cluster, "version", none)
    assert cluster._version() == "not installed"


def jobs_of(n, folder):
    settings = BatchSettings(methods=("kcm", "lbfgs"))
    return [Job(f"s{k}", Path(folder) / f"s{k}.pdb", settings, f"key-{k}") for k in range(n)]


RESULT = {"output": "file", "energy_end_reference_kj_mol": -12.25, "ca_rmsd_angstrom": 0.5, "seconds": 2.0}


class Ending:
    """Workers of which one ends, the earliest, whenever the batch looks whether any has."""

    def __init__(self, monkeypatch, lost_at=None, failed_at=(), usable=()):
        self.submitted, self.lost_at, self.failed_at, self.usable = [], lost_at, failed_at, usable
        self.running, self.most = [], 0
        self.workers = Workers(self.submit, lambda: 1, "http://there")

        class Ended(deque):
            def put(_, item):
                _.append(item)

            def get(_, timeout):
                self.most = max(self.most, len(self.running))
                self.end(*self.running.pop(0))
                return _.popleft()

        monkeypatch.setattr(cluster, "SimpleQueue", Ended)

    def submit(self, function, job, threads, time_limit):
        assert function is supervise
        self.submitted.append((job, threads, time_limit))
        self.running.append((len(self.submitted) - 1, job, Future()))
        return self.running[-1][-1]

    def end(self, number, job, future):
        record = RESULT if number in self.usable else {}
        rows = job.lost([], "budget", "", 0.0)
        if number == self.lost_at:
            assert future.cancel()
        elif number in self.failed_at:
            future.set_exception(RuntimeError("why"))
        else:
            future.set_result([Row(row.record | record, []) for row in rows])


@pytest.fixture
def tables(tmp_path):
    made = Tables(tmp_path, resume=False)
    made.select_finished([])
    yield made
    made.close()


def test_jobs_are_handed_out_a_few_ahead_and_counted_as_they_end(tables, tmp_path, monkeypatch):
    ending, seen = Ending(monkeypatch, failed_at=(1,), usable=(0, 2, 3, 4, 5)), []
    clock = iter(range(1000))
    monkeypatch.setattr(batch_structures, "perf_counter", lambda: float(next(clock)))
    todo = jobs_of(6, tmp_path)
    processes = Processes(threads=2, time_limit=9.0)
    assert batch_structures._work(ending.workers, todo, tables, processes, 3, seen.append) is False
    assert ending.submitted == [(Task(job.anywhere(), tmp_path), 2, 9.0) for job in todo] and ending.most == 4
    assert [(p.total, p.done, p.failed, p.skipped) for p in seen] == [
        (9, 1, 0, 3), (9, 2, 1, 3), (9, 3, 1, 3), (9, 4, 1, 3), (9, 5, 1, 3), (9, 6, 1, 3),
    ]  # fmt: skip
    assert {p.dashboard for p in seen} == {"http://there"}
    of = {method: f"{method} budget, -12.25 kJ/mol, RMSD 0.50 angstrom, 2.0 s" for method in ("kcm", "lbfgs")}
    done = [f"s{k}: {of['kcm']}; {of['lbfgs']}" for k in range(6)]
    lost = "s1: killed: no worker finished this structure: why"
    assert [p.line for p in seen] == [done[0], lost, *done[2:]]
    seconds = [p.seconds for p in seen]
    assert seconds == sorted(seconds) and 0.0 < seconds[0] < 10.0
    table = tables.read()
    assert table["structure"].tolist() == [job.name for job in todo for _ in range(2)]
    assert table["status"].tolist() == ["budget"] * 2 + ["killed"] * 2 + ["budget"] * 8
    assert table["message"][2] == "no worker finished this structure: why"


def test_a_scheduler_that_is_lost_ends_the_batch(tables, tmp_path, monkeypatch):
    workers = Ending(monkeypatch, lost_at=1).workers
    assert batch_structures._work(workers, jobs_of(3, tmp_path), tables, Processes(), 0, None) is True
    assert tables.read()["structure"].tolist() == ["s0", "s0"]


def test_an_interrupt_keeps_what_is_done_and_hands_out_no_more(tables, tmp_path, monkeypatch):
    ending = Ending(monkeypatch)

    def watch(progress):
        if progress.done == 2:
            raise KeyboardInterrupt

    assert batch_structures._work(ending.workers, jobs_of(9, tmp_path), tables, Processes(), 0, watch) is True
    assert tables.read()["structure"].nunique() == 2 and len(ending.submitted) == 5
