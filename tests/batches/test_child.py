"""The process that minimises, without being one: what it reads, sends and closes, and in which order."""

import io
import pickle
import queue
from functools import partial
from types import SimpleNamespace

import pytest

from protochain.batches import child, supervise
from protochain.batches.supervise import Child


class Over(Exception):
    """The test has seen enough."""


class Jobs(queue.Queue):
    """Jobs that end the test when there are none left."""

    def get(self):
        if self.empty():
            raise Over
        return super().get()


def test_a_child_says_that_it_is_ready_and_sends_the_rows_of_each_job(monkeypatch):
    log, sent = [], io.BytesIO()

    class Reader:
        def __init__(self, target, args, daemon):
            assert target is child._read and args[0] == "standard input" and daemon is True
            self.jobs = args[1]

        def start(self):
            self.jobs.put((SimpleNamespace(run=partial(run, "job 1")), 2))
            self.jobs.put((SimpleNamespace(run=partial(run, "job 2")), 3))

    class Adjusted:
        def __init__(self, path):
            self.path = path

        def write_text(self, text):
            log.append((self.path, text))
            raise PermissionError

    def run(job, threads):
        yield f"{job} by {threads}"
        yield "second row"

    files = SimpleNamespace(
        dup=lambda number: ("copy", number), dup2=lambda *numbers: log.append(numbers),
        fdopen=lambda number, mode: sent if (number, mode) == (("copy", 1), "wb") else None,
    )  # fmt: skip
    monkeypatch.setattr(child, "os", files)
    monkeypatch.setattr(child, "Path", Adjusted)
    monkeypatch.setattr(child, "queue", SimpleNamespace(Queue=Jobs))
    monkeypatch.setattr(child, "threading", SimpleNamespace(Thread=Reader))
    monkeypatch.setattr(child, "sys", SimpleNamespace(stdin=SimpleNamespace(buffer="standard input")))
    monkeypatch.setattr(child, "_warm_up", lambda: log.append(("warm", len(sent.getvalue()))))
    with pytest.raises(Over):
        child.main()
    # What libraries print goes to standard error.
    assert log == [(2, 1), ("/proc/self/oom_score_adj", "500"), ("warm", 0)]
    sent.seek(0)
    said = [pickle.load(sent) for _ in range(7)]
    assert said == [
        "ready", "job 1 by 2", "second row", "done", "job 2 by 3", "second row", "done",
    ]  # fmt: skip
    assert sent.read() == b""


def test_a_child_warms_up_on_three_residues_with_one_thread(monkeypatch):
    given = []
    monkeypatch.setattr("protochain.minimisers.minimise", lambda *what, **more: given.append((*what, more)))
    child._warm_up()
    ((structure, energy, options),) = given
    names = structure.residue_name.tolist()
    assert names == ["GLY", "ALA", "GLY"] and energy.threads == 1 and options == {"max_evaluations": 3}


class Pipe:
    """A pipe that notes its end."""

    def __init__(self, name, log, error=None):
        self.name, self.log, self.error = name, log, error

    def close(self):
        self.log.append(self.name)
        if self.error:
            raise self.error


@pytest.mark.parametrize("error", [None, BrokenPipeError()])
def test_a_child_that_is_killed_is_waited_for_and_its_pipes_are_closed(error):
    log = []

    class Fake(Child):
        def __init__(self):
            self.process = SimpleNamespace(
                kill=lambda: log.append("kill"), wait=lambda: log.append("wait"),
                stdin=Pipe("in", log, error), stdout=Pipe("out", log), poll=lambda: status[0],
            )  # fmt: skip
            self.listener = SimpleNamespace(join=lambda: log.append("join"))
            self.said = Pipe("said", log)

    status = [None]
    made = Fake()
    assert made.is_alive
    made.kill()
    assert log == ["kill", "wait", "join", "in", "out", "said"]
    for status[0] in (0, -9):
        assert not made.is_alive


class Started:
    """A child as who supervises sees it."""

    def __init__(self, threads):
        self.threads, self.is_alive, self.killed = threads, True, 0
        everyone.append(self)

    def kill(self):
        self.is_alive, self.killed = False, self.killed + 1

    def do(self, job, time_limit):
        return [job, self]


everyone = []


def test_children_started_early_are_taken_up_or_ended(monkeypatch):
    monkeypatch.setattr(supervise, "Child", Started)
    everyone.clear()

    def do(threads):
        monkeypatch.setattr(supervise, "_here", SimpleNamespace())  # As in a thread that has none.
        return supervise.supervise("job", threads, 1.0)[1]

    with supervise.started_early(100, 2):
        early = tuple(everyone)
        assert len(early) == supervise._MOST_AHEAD
        assert {do(2), do(2)} <= {*early}
        assert sum(each.killed for each in early) == 0
        other = do(3)
        assert other.threads == 3 and other not in early
        # It had been started for another number of threads.
        assert sum(each.killed for each in early) == 1
    assert [each.killed for each in early].count(1) == len(early) - 2 and not supervise._ahead
    assert do(2) not in early
