"""One job of a batch with methods that are told; children and what is said of their ends."""

import pickle
import queue
import threading
from contextlib import nullcontext
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from fixtures.samples import STRUCTURES, load
from fixtures.waiting import HANG

import protochain as pc
from protochain.batches import batch_structures, cluster, supervise, task
from protochain.batches.jobs import BatchSettings, Job, failure
from protochain.batches.supervise import Child
from protochain.batches.table import Tables
from protochain.batches.task import thin_trace
from protochain.core.errors import WriteError
from protochain.minimisers.minimise_structure import minimise

ALA = STRUCTURES / "ala10.pdb"


def job_of(*methods, path=ALA, **settings):
    return Job("job", path, BatchSettings(methods=methods).changed(**settings), "the key")


@pytest.fixture
def given(monkeypatch):
    """Minimisations of the test's own: what they were given, and the ends they have."""
    calls, shifts = [], {}

    def told(c, e, method, *limits, **more):
        calls.append((e.threads, method, limits, more))
        solution = minimise(c, e, "lbfgs", max_evaluations=2)
        object.__setattr__(solution, "recipe", pc.minimisers.recipe_of(method))
        object.__setattr__(solution, "x", c.structure.positions + shifts.get(method, 0.0))
        return solution

    monkeypatch.setattr("protochain.minimisers.minimise", told)
    return SimpleNamespace(calls=calls, shifts=shifts)


def test_methods_run_with_the_jobs_settings_openmm_first(given, tmp_path):
    s = load("ala10.pdb")
    alpha = s.alpha_carbons
    shift = np.zeros_like(s.positions)
    shift[alpha] = 0.01 * (s.positions[alpha] - s.positions[alpha].mean(axis=0))
    given.shifts["kcm"] = shift
    job = job_of("kcm", "openmm", "lbfgs", tolerance=2.0, max_evaluations=9, seed=4)
    first, *others = list(task.Task(job, tmp_path).run(1))
    assert [call[1] for call in given.calls] == ["openmm", "kcm", "lbfgs"]
    more = {"restraints": "", "max_rmsd": np.inf, "curvature": None, "judge": "auto"}
    more |= {"tolerance": 2.0, "max_evaluations": 9, "seed": 4}
    assert all(call[0] == 1 and call[2:] == ((), more) for call in given.calls)
    assert [row.record["method"] for row in others] == ["kcm", "lbfgs"]
    for row in (first, *others):
        output = f"job.{row.record['method']}.pdb"
        assert row.record["output"] == output and (tmp_path / output).exists()
        assert {key: row.record[key] for key in ("structure", "input", "model", "key")} == {
            "structure": "job", "input": str(ALA), "model": "", "key": "the key",
        }  # fmt: skip
        assert row.record["seconds_preparation"] > 0.0 and isinstance(row.record["constant_terms"], str)
        assert row.record["n_starts"] == 1
    # To openmm's end, not to the start; openmm's own is none.
    size = 0.1 * np.sqrt(np.mean(np.sum((100 * shift[alpha]) ** 2, axis=1)))
    found = [row.record.get("ca_rmsd_to_openmm_angstrom") for row in (first, *others)]
    assert found == [None, pytest.approx(size, rel=1e-6), pytest.approx(0.0, abs=1e-6)]
    assert (tmp_path / "pages" / "job.html").exists()


def test_a_result_without_a_number_has_a_row_but_no_file(given, tmp_path, monkeypatch):
    monkeypatch.setattr(pc.Solution, "is_usable", False)
    (row,) = task.Task(job_of("cartesian", max_rmsd=7.0, restraints="50 0"), tmp_path).run(1)
    assert given.calls[0][3].items() >= {"restraints": "50 0", "max_rmsd": 7.0, "curvature": None}.items()
    assert "output" not in row.record and [path.name for path in tmp_path.iterdir()] == ["pages"]
    assert row.record["message"] and row.trace[0]["iteration"] == 0


@pytest.mark.parametrize(
    ("error", "status", "said"),
    [
        (pc.ProtochainError("why so"), "refused", "why so"), (MemoryError(), "killed", "out of memory"),
        (FileNotFoundError(2, "No such file", "a.xml"), "refused", "a.xml: No such file"),
        (
            WriteError("a.pdb", "full", "", "go on"), "killed",
            "a.pdb: not written (full); free space there, then go on",
        ),
        (OSError("odd\nly"), "refused", "{}: odd ly"), (KeyError("x"), "error", "KeyError: 'x'"),
    ],
)  # fmt: skip
def test_an_error_is_the_row_of_each_method_that_is_left(error, status, said, tmp_path, monkeypatch):
    begun = []

    def fails(c, e, method, *_, **__):
        begun.append(method)
        if method == "lbfgs":
            raise error
        return minimise(c, e, "lbfgs", max_evaluations=2)

    monkeypatch.setattr("protochain.minimisers.minimise", fails)
    clock = iter([10.0, 11.0, 11.5, 14.0, 99.0])
    monkeypatch.setattr(task, "perf_counter", lambda: next(clock))
    job = job_of("kcm", "lbfgs", "fire")
    first, *others = task.Task(job, tmp_path).run(1)
    assert first.record["method"] == "kcm" and first.record["seconds_preparation"] == 0.5
    assert others == [failure(job, method, status, said.format(ALA), 4.0) for method in ("lbfgs", "fire")]
    assert begun == ["kcm", "lbfgs"]


def test_a_page_that_cannot_be_written_is_told_and_made_again(tmp_path):
    """What was computed stays; a full disk is a circumstance."""
    page, job = tmp_path / "pages" / "job.html", job_of("lbfgs", "cartesian", max_evaluations=2)
    page.mkdir(parents=True)
    first, last = task.Task(job, tmp_path).run(1)
    assert first.record["status"] == "budget" and last.record["status"] == "killed"
    assert str(page) in last.record["message"] and last.record["output"] == "job.cartesian.pdb"
    assert str(page) in batch_structures._line([last])
    tables = Tables(tmp_path, resume=False)
    tables.select_finished([job])
    tables.append([first, last])
    assert not tables.select_finished([job])
    tables.close()


def test_a_trace_is_thinned_to_fifty_points_with_both_ends():
    for n in (1, 2, 49, 50):
        rows = thin_trace(pd.DataFrame({"iteration": range(n)}))
        assert [row["iteration"] for row in rows] == list(range(n))
    for n in (51, 400, 5000):
        places = [row["iteration"] for row in thin_trace(pd.DataFrame({"iteration": range(n), "e": 1.0}))]
        assert places[0] == 0 and places[-1] == n - 1 and 30 <= len(places) <= 50
        assert places == sorted(set(places)) and places[:4] == [0, 1, 2, 3]
        # Evenly in the logarithm: no gap is much wider than another.
        ratios = np.diff(np.log(np.add(places, 1)))[8:]
        assert ratios.max() < np.log(n) / 49 + 0.12


class Scripted(Child):
    """A child without a process, which says what it is told."""

    threads, is_ready = 1, True

    def __init__(self, *said, sent=None):
        self.messages, self.sent, self.killed = queue.Queue(), [], False
        for each in said:
            self.messages.put(each)

    def _send(self, message):
        self.sent.append(message)

    def _death(self):
        return "it died"

    def kill(self):
        self.killed = True


def test_a_childs_rows_are_those_it_sends_until_it_is_done(tmp_path):
    job = job_of("kcm", "lbfgs")
    rows = [failure(job, method, "budget", "") for method in job.settings.methods]
    child = Scripted(*rows, "done", "more")
    assert child.do(job, 60.0) == rows and not child.killed
    assert child.sent == [(job, 1)] and child.messages.qsize() == 1


def test_a_child_that_dies_or_is_late_leaves_rows_for_the_methods_left(tmp_path, monkeypatch):
    clock = iter([100.0, 100.5, 101.0, 103.0, 104.0])
    monkeypatch.setattr(supervise, "perf_counter", lambda: next(clock))
    job = job_of("kcm", "lbfgs", "fire")
    first = failure(job, "kcm", "budget", "")
    child = Scripted(first, None)
    # Begun at 100; the last look at the clock is at 103.
    assert child.do(task.Task(job, tmp_path), 60.0) == [
        first, *(failure(job, method, "killed", "it died", 3.0) for method in ("lbfgs", "fire"))
    ]  # fmt: skip
    assert child.killed
    clock = iter([100.0, 100.5, 107.0, 107.5])
    child = Scripted(first)
    late = "time limit of 6.5 s reached"
    assert child.do(task.Task(job, tmp_path), 6.5) == [
        first, *(failure(job, method, "time-limit", late, 7.5) for method in ("lbfgs", "fire"))
    ]  # fmt: skip
    assert child.killed


class Ended(Child):
    """A child whose process has ended, with what it said."""

    def __init__(self, status, said, tmp_path):
        self.process = SimpleNamespace(wait=lambda: status)
        self.stderr = (tmp_path / "said").open("w+b")
        self.stderr.write(said)


@pytest.mark.parametrize(
    ("status", "said", "death"),
    [
        (3, b"one\ntwo \n\n", "the minimisation process ended with status 3: two"),
        (0, b"", "the minimisation process ended with status 0: "),
        (0, b"x" * 5000, "the minimisation process ended with status 0: " + 2000 * "x"),
        # Cut within a letter.
        (
            2,
            "é".encode() * 1000 + b"x",
            f"the minimisation process ended with status 2: \ufffd{999 * 'é'}x",
        ),
        (-9, b"one", "the minimisation process was ended by SIGKILL, as when memory runs out"),
        (-15, b"one", "the minimisation process was ended by SIGTERM"),
    ],
)
def test_the_end_of_a_child_is_told(status, said, death, tmp_path):
    child = Ended(status, said, tmp_path)
    assert child._death() == death
    child.stderr.close()


def test_what_a_child_says_is_listened_to_until_it_ends(tmp_path):
    for tail in (b"", b"\x00 broken"):
        child = Scripted()
        file = tmp_path / "out"
        file.write_bytes(pickle.dumps("ready") + pickle.dumps([1, 2]) + tail)
        with file.open("rb") as stdout:
            child.process = SimpleNamespace(stdout=stdout)
            child._listen()
        assert [child.messages.get(block=False) for _ in range(3)] == ["ready", [1, 2], None]


def test_a_child_is_ready_before_the_time_of_its_first_structure_begins(monkeypatch, tmp_path):
    clock = iter([100.0, 100.0, 500.0, 500.0, 500.5])
    monkeypatch.setattr(supervise, "perf_counter", lambda: next(clock))
    job = job_of("kcm")
    child = Scripted("ready", failure(job, "kcm", "budget", ""), "done")
    child.is_ready = False
    (row,) = child.do(job, 60.0)
    assert row.record["status"] == "budget" and child.is_ready and not child.killed


@pytest.fixture
def counted(monkeypatch):
    """Children without processes, as they are made."""
    made = []

    class Counted(Scripted):
        is_alive = True

        def __init__(self, threads):
            super().__init__()
            self.threads, self.process = threads, SimpleNamespace(kill=self.end)
            made.append(self)

        def end(self):
            self.is_alive = False

        def do(self, job, time_limit):
            return [len(made), time_limit]

    monkeypatch.setattr(supervise, "Child", Counted)
    monkeypatch.setattr(supervise, "_thread_state", threading.local())
    return made


def test_a_thread_keeps_its_child_while_that_fits(counted, tmp_path):
    job = job_of("kcm")
    assert supervise.supervise(job, 1, 5.0) == [1, 5.0]
    assert supervise.supervise(job, 1, 6.0) == [1, 6.0] and not counted[0].killed
    # Another number of threads, or a child that has died, needs a new one.
    assert supervise.supervise(job, 2, 5.0)[0] == 2 and counted[0].killed
    counted[1].is_alive = False
    assert supervise.supervise(job, 2, 5.0)[0] == 3 and counted[1].killed and not counted[2].killed


@pytest.mark.parametrize("error", [None, KeyboardInterrupt, ZeroDivisionError])
def test_children_end_with_the_crew_however_it_ends(error, counted, tmp_path):
    job, both = job_of("kcm"), threading.Barrier(2, timeout=HANG)
    with pytest.raises(error) if error else nullcontext(), supervise.crew(2) as executor:
        # Each waits for the other, so that both threads have one.
        given = [executor.submit(lambda: (both.wait(), supervise.supervise(job, 1, 5.0))) for _ in "ab"]
        for future in given:
            future.result()
        assert len(counted) == 2 and all(child.is_alive for child in counted)
        if error:
            raise error
    assert not any(child.is_alive for child in counted) and all(child.killed for child in counted)


def test_a_window_is_of_four_jobs_a_worker_counted_again_after_a_while(monkeypatch):
    now, counted = [0.0], []
    workers = cluster.Workers(None, lambda: counted.append(now[0]) or 5)
    monkeypatch.setattr(batch_structures, "perf_counter", lambda: now[0])
    window = batch_structures._Window(workers)
    sizes = []
    for now[0] in (0.1, 5.1, 5.2, 9.0, 10.3):
        sizes.append(window.size())
    assert sizes == [20] * 5 and counted == [0.1, 5.2, 10.3]
    assert batch_structures._Window(cluster.Workers(None, lambda: 0)).size() == 4


def test_a_batch_shows_itself(tmp_path):
    lines = ["structure,method,status,key", "a,kcm,budget,1", "a,lbfgs,converged,1", "007,kcm,budget,2"]
    (tmp_path / "summary.csv").write_text("\n".join(lines) + "\n")
    (tmp_path / "traces.csv").write_text("structure,energy_kj_mol\n007,1.5\n")
    made = batch_structures.Batch(tmp_path)
    assert made.counts() == {"budget": 2, "converged": 1} and not made.interrupted
    assert repr(made) == f"<Batch in {tmp_path}: 2 budget, 1 converged>"
    assert made.table["structure"].tolist() == ["a", "a", "007"]
    assert made.traces["structure"].tolist() == ["007"] and made.traces["energy_kj_mol"].tolist() == [1.5]
    assert made.report == tmp_path / "report.html" and made._repr_html_().count("<tr") == 4
    assert "007" in made._repr_html_() and "<th>0</th>" not in made._repr_html_()
