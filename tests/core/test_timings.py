"""Seconds by part: they add up to the whole, whatever is nested in what."""

import json
from itertools import count

import pytest
from fixtures.command_line import refusal, run
from fixtures.samples import STRUCTURES

import protochain as pc
from protochain.core import timings
from protochain.core.timings import PARTS, count_kernel, measure_run, part, until_now


@pytest.fixture
def clock(monkeypatch):
    """A clock that goes on by one each time it is read; how often that was."""
    reads = count()
    monkeypatch.setattr(timings, "perf_counter", lambda: float(next(reads)))
    return lambda: next(reads)


def test_each_moment_belongs_to_the_innermost_part(clock):
    with measure_run():
        with part("loop"), part("evaluations"), part("loop"):
            pass
        with pytest.raises(KeyError), part("judging"):
            raise KeyError
        found = until_now()
    # Turns: into loop, evaluations, loop, and out of them; into and out of judging; told.
    assert found.pop("serial_share_of_loop") is None
    expected = {"loop": 3.0, "evaluations": 2.0, "judging": 1.0, "rest": 3.0}
    assert {name: seconds for name, seconds in found.items() if seconds} == expected
    assert sum(found.values()) == clock() - 1 and [*found] == [*PARTS]


def test_a_run_within_a_run_is_part_of_it_and_without_a_run_nothing_is_timed(clock):
    with measure_run():
        with measure_run(), part("metric"):
            pass
        assert until_now()["metric"] == 1.0
    with part("metric"):
        with count_kernel():
            pass
        assert until_now() == {}


def test_kernels_are_shared_only_where_a_loop_calls_them(clock):
    with measure_run():
        with count_kernel():
            pass
        with part("judging"), count_kernel():
            pass
        with part("loop"), part("evaluations"), count_kernel(), part("kernels"):
            pass
        # From the first to the fourth read but for one in which a kernel is compiled, of six in the loop.
        assert until_now()["serial_share_of_loop"] == 1.0 - 2.0 / 6.0


@pytest.mark.parametrize("call", [pc.minimise, pc.relax])
def test_parts_of_a_call_add_up_to_all_of_it(clock, call):
    found = dict(call(STRUCTURES / "ala10.pdb").record()["timings"])
    assert 0.0 < found.pop("serial_share_of_loop") < 1.0
    assert sum(found.values()) == clock() - 1
    used = {name for name, seconds in found.items() if seconds}
    assert {"reading", "preparing", "energy", "loop", "evaluations", "metric", "judging", "rest"} <= used
    assert not used & {"imports", "writing"}


def test_each_evaluation_of_a_loop_is_counted_once(clock):
    calls = []

    def energy(x):
        calls.append(x)
        return float((x**2).sum()), -2.0 * x

    r = pc.minimise(STRUCTURES / "ala10.pdb", energy, max_evaluations=9)
    assert r.timings["evaluations"] == r.n_evaluations <= len(calls)
    assert r.timings["serial_share_of_loop"] is None, "it has no kernels"


@pytest.mark.parametrize("command", ["minimise", "relax"])
def test_a_command_prints_its_parts_and_their_sum(command, tmp_path, capsys):
    end = tmp_path / "end.pdb"
    words = (command, STRUCTURES / "ala10.pdb", "-o", end)
    run(*words, "--timings")
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    table = {line[0]: float(line[1]) for line in lines if line and line[0] in (*PARTS, "all")}
    assert [*table] == [*PARTS, "all"] and min(table["imports"], table["writing"], table["reading"]) > 0.0
    assert table.pop("all") == pytest.approx(sum(table.values()), abs=0.001 * len(table))
    run(*words, "--json")
    found = json.loads(capsys.readouterr().out)["timings"]
    assert [*found] == [*PARTS, "serial_share_of_loop"] and found["imports"] > 0.0 < found["writing"]


@pytest.mark.parametrize(
    "words",
    [
        "minimise a.pdb --model all",
        "relax a.pdb b.pdb",
        "relax a.pdb --model all",
        "relax a.pdb --frames all",
    ],
)
def test_timings_are_of_one_structure(words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("a.pdb", "b.pdb"):
        (tmp_path / name).write_bytes((STRUCTURES / "ala10.pdb").read_bytes())
    assert "timings" in refusal(*words.split(), "--timings")
