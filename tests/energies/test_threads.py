"""Threads of one energy: same bits on any number, whoever comes late or not at all; how many there may be."""

import multiprocessing
import threading

import numpy as np
import pytest
from fixtures.samples import energy, load
from fixtures.waiting import until

from protochain.core import processors as door
from protochain.core.compilation import njit
from protochain.energies.native import evaluation
from protochain.energies.native.atomic import add, replace
from protochain.energies.native.atomic import load as look
from protochain.energies.native.evaluate import lists_of
from protochain.energies.native.evaluation import Evaluation, Workspace, tasks_of_a_step
from protochain.energies.native.helpers import Worth
from protochain.energies.native.layout import CHUNKS
from protochain.energies.native.tasks import ALL, LED, TOOK, WAITED

X = load("1l2y.pdb").positions


def on(threads, solvent="obc2"):
    """Trp-cage's energy on any number of threads, more than there are processors too."""
    layout = energy("1l2y.pdb", solvent=solvent, engine="native", threads=1)._layout
    return Evaluation(layout, lists_of(layout, X), np.zeros(len(X)), Workspace(layout), threads)


def same(a, b):
    return a[0] == b[0] and np.array_equal(a[1], b[1])


@pytest.mark.parametrize("solvent", ["vacuum", "obc2"])
@pytest.mark.parametrize("threads", [2, 3, 16, 40])
def test_any_number_of_threads_gives_the_same_bits(threads, solvent):
    alone, together = on(1, solvent), on(threads, solvent)
    for shift in np.linspace(0.0, 1.0, 20):
        assert same(together(X + shift), alone(X + shift))


def test_nobody_waits_for_helpers_that_do_not_come(monkeypatch):
    """As threads that the operating system does not run, for the whole energy."""
    asked = []
    monkeypatch.setattr(evaluation.Helpers, "ask", lambda self, job, n, most: asked.append((n, most)))
    together = on(3)
    assert same(together(X), on(1)(X)) and same(together(X), on(1)(X))
    assert asked == [(2, 2)], "they were asked once, and have not said that they left"


def test_helpers_leave_when_there_is_nothing_to_do():
    together = on(3)
    together(X)
    until(lambda: together._n_helping == 0)
    assert same(together(X), on(1)(X))


def test_energies_that_several_threads_of_a_program_share_do_not_mix():
    e, places = energy("1l2y.pdb", engine="native", threads=2), [X, X + 0.01, 1.001 * X]
    expected = [e(x) for x in places]
    found = {}

    def call(k):
        found[k] = [e(places[k]) for _ in range(20)]

    threads = [threading.Thread(target=call, args=(k,)) for k in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for k, energies in found.items():
        for value, forces in energies:
            assert value == pytest.approx(expected[k][0], rel=1e-10)
            np.testing.assert_allclose(forces, expected[k][1], rtol=1e-8, atol=1e-6)


@pytest.mark.skipif("fork" not in multiprocessing.get_all_start_methods(), reason="no fork here")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_process_split_off_has_helpers_of_its_own():
    together = on(2)
    before = together(X)
    context = multiprocessing.get_context("fork")
    here, there = context.Pipe()

    def child():
        together.workspace.worth = Worth()  # on a busy machine the parent's may not ask again yet
        after = together(X)
        there.send(
            (same(after, before), together._helpers is evaluation.helpers(), evaluation.helpers()._threads)
        )

    process = context.Process(target=child)
    process.start()
    assert here.poll(60.0) and here.recv() == (True, True, 1)
    process.join()


def test_the_tasks_of_a_step_share_its_chunks():
    for threads in range(1, 40):
        for blocks in (1, 10, 32, 33, 1000):
            assert CHUNKS % tasks_of_a_step(threads, blocks) == 0
    assert tasks_of_a_step(1, 1000) == 1 and tasks_of_a_step(2, 1000) == tasks_of_a_step(16, 2) == CHUNKS


@njit(nogil=True)
def count(numbers, times):
    """Add one to the first, and to the second by setting it to one more than it was."""
    for _ in range(times):
        add(numbers, 0, 1)
        while True:
            old = look(numbers, 1)
            if replace(numbers, 1, old, old + 1):
                break


def test_threads_that_change_a_number_together_lose_nothing():
    numbers = np.zeros(2, np.int64)
    count(numbers, 1)
    threads = [threading.Thread(target=count, args=(numbers, 100_000)) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert numbers.tolist() == [400_001, 400_001]


def test_a_number_is_replaced_only_if_it_is_as_expected():
    @njit
    def swap(numbers, old, new):
        return replace(numbers, 1, old, new)

    numbers = np.array([7, 8, 9])
    assert not swap(numbers, 7, 1) and numbers.tolist() == [7, 8, 9]
    assert swap(numbers, 8, 1) and numbers.tolist() == [7, 1, 9]


GROUPS = {
    "none": ("", {}, 1e6),
    "no limit": ("0::/a/b\n", {"a/b/cpu.max": "max 100000\n"}, 1e6),
    "own": ("0::/a/b\n", {"a/b/cpu.max": "150000 100000\n"}, 1.5),
    "above": ("0::/a/b\n", {"a/b/cpu.max": "max 100000\n", "a/cpu.max": "300000 100000\n"}, 3.0),
    "smallest": ("0::/a/b\n", {"a/b/cpu.max": "50000 100000\n", "a/cpu.max": "300000 100000\n"}, 0.5),
    "container": ("0::/\n", {"cpu.max": "200000 50000\n"}, 4.0),
    "version 1": (
        "5:memory:/x\n2:cpu,cpuacct:/y\n",
        {"cpu/y/cpu.cfs_quota_us": "250000\n", "cpu/y/cpu.cfs_period_us": "100000\n"},
        2.5,
    ),
    "version 1, no limit": (
        "2:cpu:/y\n", {"cpu/y/cpu.cfs_quota_us": "-1\n", "cpu/y/cpu.cfs_period_us": "100000\n"}, 1e6
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", GROUPS)
def test_processors_that_control_groups_allow(case, tmp_path):
    own, files, expected = GROUPS[case]
    (tmp_path / "own").write_text(own)
    for name, text in files.items():
        (tmp_path / "groups" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "groups" / name).write_text(text)
    assert door.n_allowed(tmp_path / "groups", tmp_path / "own") == expected


@pytest.mark.parametrize(
    ("bound", "quota", "expected"), [(8, 1e6, 8), (8, 2.4, 2), (8, 2.6, 3), (2, 3.0, 2), (4, 0.2, 1)]
)
def test_processors_are_those_this_process_may_use(bound, quota, expected, monkeypatch):
    monkeypatch.setattr(door.os, "sched_getaffinity", lambda _: set(range(bound)), raising=False)
    monkeypatch.setattr(door, "n_allowed", lambda *_: quota)
    assert door.processors() == expected


def noted(worth, now, energies, took, worked, share):
    """Time after some energies, all alike, in a row."""
    for _ in range(energies):
        assert worth.should_ask(now)
        now += took
        worth.note(now, took, worked, share)
    return now


def test_helpers_that_save_time_are_asked_again_and_again():
    # Half of the tasks done by them, and once in a while a turn of the scheduler lost.
    worth, now = Worth(), 0.0
    for _ in range(20):
        now = noted(worth, now, 40, 0.0005, 0.0005, 0.5)
        worth.note(now, 0.0045, 0.0005, 0.5)
    assert worth.should_ask(now)


def test_helpers_that_cost_time_rest_twice_as_long_each_time():
    worth, now, rests = Worth(), 0.0, []
    while len(rests) < 7:
        now += 0.005
        worth.note(now, 0.005, 0.0005, 0.5)
        if not worth.should_ask(now):
            rests.append(round(worth.pause_end - now, 6))
            now = worth.pause_end
            assert worth.should_ask(now)
    assert rests == [0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 3.2]
    now = noted(worth, now, 1000, 0.0005, 0.0005, 0.5)
    while worth.should_ask(now):
        worth.note(now, 0.005, 0.0005, 0.5)
    assert worth.pause_end - now == pytest.approx(0.1), "long proof of use, and earlier rests are forgotten"


def test_a_thread_that_leads_alone_waits_for_nobody():
    alone = on(1)
    alone(X)
    tasks, led, waited, took = alone._counters[[ALL, LED, WAITED, TOOK]]
    assert tasks == led == 6 and waited == 0 < took
