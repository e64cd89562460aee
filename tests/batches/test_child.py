"""The process that minimises, without being one: what it reads, sends and closes, and in which order."""

import pickle
import subprocess
import sys
from types import SimpleNamespace

from fixtures.waiting import HANG

from protochain.batches import child, supervise


def test_a_child_warms_up_on_three_residues_with_one_thread(monkeypatch):
    given = []
    monkeypatch.setattr("protochain.minimisers.minimise", lambda *what, **more: given.append((*what, more)))
    child._warm_up()
    ((structure, energy, options),) = given
    names = structure.residue_name.tolist()
    assert names == ["GLY", "ALA", "GLY"] and energy.threads == 1 and options == {"max_evaluations": 3}


def test_what_libraries_print_does_not_mix_with_rows():
    code = "from protochain.batches import child; child._warm_up = lambda: print(1, flush=True); child.main()"
    pipes = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
    with subprocess.Popen([sys.executable, "-c", code], **pipes) as process:
        assert pickle.load(process.stdout) == "ready"
        assert process.communicate(timeout=HANG) == (b"", b"1\n")


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
        monkeypatch.setattr(supervise, "_thread_state", SimpleNamespace())  # As in a thread that has none.
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
