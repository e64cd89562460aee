"""Simulations and batches without the computing: what the commands hand on, print, and how they end."""

import importlib
import io
from contextlib import contextmanager, nullcontext
from pathlib import Path
from types import SimpleNamespace

import pandas as pd
import pytest
from fixtures.command_line import is_held, run

from protochain.batches import BatchSettings
from protochain.cli import options

pytestmark = pytest.mark.usefixtures("interruptible")
SIMULATE, FIRST, BATCH = (
    importlib.import_module(f"protochain.cli.{name}") for name in ("simulate", "first", "batch")
)


@pytest.fixture
def simulated(monkeypatch, tmp_path):
    """What is minimised and simulated."""
    monkeypatch.chdir(tmp_path)
    done = SimpleNamespace(record=lambda: {"r": 1.0}, is_sound=True, ending="completed", message="why",
                           trajectory=None)  # fmt: skip
    seen = SimpleNamespace(runs=[], given=[], done=done, relaxed="converged")
    chain = SimpleNamespace(q0="q0", structure="s")

    def minimise(*given, **more):
        assert is_held()
        seen.runs.append(given)
        start, end = SimpleNamespace(energy=5.5), SimpleNamespace(energy=-3.25)
        return SimpleNamespace(
            start=start, end=end, ca_rmsd_angstrom=0.125, q="q", status=seen.relaxed, restraints=None
        )

    def simulate(*given, **more):
        assert is_held()
        seen.given.append(given)
        return seen.done

    monkeypatch.setattr(options, "prepare", lambda source, setup: (chain, "energy", 1.5))
    monkeypatch.setattr(SIMULATE, "print_outlook", lambda *given: 1)
    monkeypatch.setattr(FIRST, "foretell", lambda *given: None)
    for module, name in ((FIRST, "run_progress"), (SIMULATE, "simulation_progress")):
        monkeypatch.setattr(module, name, lambda *given, **more: nullcontext())
    monkeypatch.setattr(SIMULATE, "print_simulation", lambda record: None)
    monkeypatch.setattr("protochain.minimisers.minimise", minimise)
    monkeypatch.setattr("protochain.dynamics.simulate", simulate)
    return seen


def test_simulate_does_not_begin_if_interrupted_while_it_relaxes(simulated, capsys):
    simulated.relaxed = "interrupted"
    # Typer's status of a KeyboardInterrupt, which the command line puts into words.
    assert run("simulate", "a.pdb") == 130
    assert len(simulated.runs) == 1 and simulated.given == [] and "minimised" not in capsys.readouterr().err


def test_simulate_ends_by_how_the_run_ended(simulated, capsys):
    simulated.done.ending = "interrupted"
    assert run("simulate", "a.pdb") == 130
    simulated.done.is_sound = False
    capsys.readouterr()
    with pytest.raises(SystemExit) as ended:
        run("simulate", "a.pdb", "--no-relax")
    told = capsys.readouterr()
    assert ended.value.code == 1 and told.out == ""
    assert told.err == "protochain: a.pdb: why. Earlier frames are in a-simulation/*.part.*\n"


class Batch(SimpleNamespace):
    """Stands for the results of a batch."""

    def counts(self):
        return self.table["status"].value_counts().to_dict()


@pytest.fixture
def batched(monkeypatch, tmp_path):
    """What a batch is asked for."""
    monkeypatch.chdir(tmp_path)
    table = pd.DataFrame({"status": ["converged"], "output": ["a.pdb"]})
    seen = SimpleNamespace(
        given=[], found=[], done=Batch(table=table, report=Path("page"), interrupted=False)
    )

    def batch(*given, **more):
        assert more.pop("watch") == "watch"
        seen.given.append((given, more))
        given[1].mkdir(exist_ok=True)
        (given[1] / "summary.json").write_text('{"a": 1}')
        return seen.done

    @contextmanager
    def progress():
        yield "watch"

    monkeypatch.setattr("protochain.batches.batch", batch)
    monkeypatch.setattr("protochain.batches.find_jobs", lambda *given: seen.found.append(given) or "jobs")
    monkeypatch.setattr(BATCH, "batch_progress", progress)
    monkeypatch.setattr(BATCH, "print_jobs", lambda jobs: print("found", jobs))
    monkeypatch.setattr(BATCH, "print_batch", lambda table, report: print("done", len(table), repr(report)))
    return seen


def test_a_dry_batch_lists_its_jobs(batched, capsys, monkeypatch):
    monkeypatch.setattr("sys.stdin", io.StringIO(" x.pdb \n\ny\n"))
    assert (
        run("batch", "a", "-", "b", "--dry-run", "--manifest", "m.csv", "-o", "out", "--methods", "md") == 0
    )
    ((inputs, settings, manifest, output),) = batched.found
    assert inputs == ["a", "x.pdb", "y", "b"] and (manifest, output) == (Path("m.csv"), Path("out"))
    assert settings == BatchSettings(("md",)) and batched.given == []
    assert capsys.readouterr().out == "found jobs\n"
    for text, more, expected in (
        ("x\ny\0 z\0", (), ["x\ny", " z"]), ("x\ny", ("-0",), ["x\ny"]), ("", ("--null",), [])
    ):  # fmt: skip
        monkeypatch.setattr("sys.stdin", io.StringIO(text))
        assert run("batch", "-", "--dry-run", *more) == 0 and batched.found[-1][0] == expected


@pytest.mark.parametrize(
    ("rows", "interrupted", "status"),
    [
        ({"converged": "a"}, True, 130), ({"converged": "a", "refused": None}, False, 4), ({"budget": "a"},
        False, 3),
        ({"refused": None}, False, 2), ({"refused": None}, True, 130), ({"converged": "a"}, False, 0),
        ({"refused": None, "killed": None}, False, 1), ({}, False, 1),
    ],
)  # fmt: skip
def test_a_batch_ends_by_its_results_and_says_if_it_was_interrupted(
    rows, interrupted, status, batched, capsys
):
    table = pd.DataFrame({"status": list(rows), "output": list(rows.values())})
    batched.done = Batch(table=table, report="page", interrupted=interrupted)
    assert run("batch", "a") == status
    assert capsys.readouterr().err == "protochain: interrupted. Continue with --resume\n" * interrupted
