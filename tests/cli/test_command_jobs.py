"""Simulations and batches without the computing: what the commands hand on, print, and how they end."""

import importlib
import io
import json
import math
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import pandas as pd
import pytest
from fixtures.command_line import is_held, refusal, run

import protochain as pc
from protochain.batches import BatchSettings
from protochain.chains.setup import Setup
from protochain.relaxation import RelaxSettings

pytestmark = pytest.mark.usefixtures("interruptible")
SIMULATE, FIRST, BATCH = (
    importlib.import_module(f"protochain.cli.{name}") for name in ("simulate", "first", "batch")
)


@pytest.fixture
def simulated(monkeypatch, tmp_path):
    """What is prepared, minimised and simulated."""
    monkeypatch.chdir(tmp_path)
    done = SimpleNamespace(record=lambda: {"r": 1.0}, is_sound=True, ending="completed", message="why",
                           trajectory=None)  # fmt: skip
    seen = SimpleNamespace(
        prepared=[], foretold=[], runs=[], shown=[], given=[], checked=[], setups=[], done=done,
        chain=SimpleNamespace(q0="q0", structure="s"), relaxed="converged", troubled=False,
    )  # fmt: skip

    def prepare(source, setup):
        seen.prepared.append(source)
        seen.setups.append(setup)
        return seen.chain, "energy", 1.5

    def foretell(*given):
        assert not is_held() and seen.prepared[-1] == given[0]
        seen.foretold.append(given)

    def minimise(*given, watch=None, **more):
        assert is_held() and len(seen.foretold) == len(seen.prepared)
        seen.runs.append((given, more))
        watch({"k": 1}, None)
        start, end = SimpleNamespace(energy=5.5), SimpleNamespace(energy=-3.25)
        return SimpleNamespace(start=start, end=end, ca_rmsd_angstrom=0.125, q="q", status=seen.relaxed)

    def simulate(*given, watch=None, **more):
        assert is_held()
        seen.given.append((given, more))
        watch({}, None)
        return seen.done

    @contextmanager
    def progress(*given, writes=True):
        assert writes == (given[0] != "lbfgs")
        yield lambda row, x: seen.shown.append((*given, row))

    def outlook(*given):
        assert given == (seen.prepared[-1], "s", "lbfgs")
        return seen.troubled

    monkeypatch.setattr(SIMULATE, "prepare", prepare)
    monkeypatch.setattr(SIMULATE, "print_outlook", outlook)
    module = importlib.import_module("protochain.dynamics.simulate_chain")
    monkeypatch.setattr(module, "freed", lambda chain, settings: seen.checked.append(settings))
    monkeypatch.setattr(FIRST, "foretell", foretell)
    monkeypatch.setattr(FIRST, "run_progress", progress)
    monkeypatch.setattr(SIMULATE, "simulation_progress", progress)
    monkeypatch.setattr(SIMULATE, "print_simulation", lambda record: print("summary", record))
    monkeypatch.setattr("protochain.minimisers.minimise", minimise)
    monkeypatch.setattr("protochain.dynamics.simulate", simulate)
    return seen


SIMULATED = {
    "n_steps": 10_000, "output": Path("a-simulation"), "trajectory": "dcd", "checkpoint_every": 10,
    "resume": False, "force": False, "temperature": 300.0, "time_step": 0.005, "thermostat": "langevin",
    "friction": 1.0,
    "superpose": True, "integrator": "leapfrog", "fixman": False, "loops": "open", "hydrogen_mass": None,
    "trajectory_length": 10, "every": 100, "seed": 0, "pull": None, "hinge_springs": (),
    "restraint": (),
}  # fmt: skip


def test_simulate_minimises_first_and_hands_its_options_on(simulated, capsys):
    assert run("simulate", "in/a.pdb") == 0
    assert simulated.given == [((simulated.chain, "energy", "q"), SIMULATED)]
    assert simulated.runs == [((simulated.chain, "energy", "lbfgs", 10.0), {"seed": 0})]
    assert simulated.foretold == [(Path("in/a.pdb"), simulated.chain, "energy", 10_050, 15_000)]
    assert simulated.checked == []
    assert simulated.shown == [("lbfgs", 5000, {"k": 1}), ("a", 10_000, 0.005, {})]
    told = capsys.readouterr()
    beside = {"input": "in/a.pdb", "output": "a-simulation", "seconds_preparation": 1.5}
    assert told.out == f"summary { ({'r': 1.0} | beside) }\n"
    assert told.err == "in/a.pdb: minimised first: 5.5 -> -3.2 kJ/mol, C-alpha RMSD 0.12 angstrom\n"
    options = (
        "--steps", 40, "--time-step", 2, "--temperature", 10, "--thermostat", "hmc", "--friction", 3,
        "--fixman", "--integrator", "leapfrog", "--hydrogen-mass", 3, "--trajectory-length", 4, "--every", 4,
        "--trajectory", "xtc", "--checkpoint-every", 5, "--seed", 6, "--json", "-o", "out", "--force",
        "--ph", 5, "--pull", "A:1:N-B:2:C", "--pull-stiffness", 20, "--pull-speed", 0,
        "--hinge-spring", "omega 40", "--hinge-spring", "phi 3 0",
    )  # fmt: skip
    simulated.troubled = True
    assert run("simulate", "in/a.pdb", *options) == 0
    assert simulated.given[1][1] == SIMULATED | {
        "pull": pc.Pull(("A:1:N", "B:2:C"), 20.0, 0.0),
        "hinge_springs": (pc.HingeSpring("omega", 40.0), pc.HingeSpring("phi", 3.0)),
        "n_steps": 40, "output": Path("out"), "trajectory": "xtc", "checkpoint_every": 5, "force": True,
        "temperature": 10.0, "time_step": 0.002, "thermostat": "hmc", "friction": 3.0, "fixman": True,
        "hydrogen_mass": 3.0, "trajectory_length": 4, "every": 4, "seed": 6,
    }  # fmt: skip
    assert [settings.pull.speed for settings in simulated.checked] == [0.0]
    # From a start with overlaps, three times as many evaluations as usual.
    assert simulated.foretold[1][3:] == (190, 5040) and simulated.shown[3] == ("a", 40, 0.002, {})
    assert simulated.runs[1][1] == {"seed": 6} and [each.ph for each in simulated.setups] == [7.0, 5.0]
    assert json.loads(capsys.readouterr().out) == {"r": 1.0} | beside | {"output": "out"}


def test_simulate_relaxes_what_begins(simulated, capsys):
    Path("out").mkdir()
    for name in ("log.csv", "checkpoint.npz"):
        (Path("out") / name).write_text("")
    assert "out" in refusal("simulate", "a.pdb", "-o", "out") and simulated.given == simulated.prepared == []
    for options in (("--no-relax",), ("-o", "out", "--resume")):
        assert run("simulate", "a.pdb", *options) == 0
        given, more = simulated.given[-1]
        assert simulated.foretold[-1][3:] == (10_000, 10_000)
        assert given[2] == "q0" and simulated.runs == [] and more["resume"] is ("--resume" in options)
    capsys.readouterr()
    assert run("simulate", "a.pdb", "--loops", "closed") == 0
    given, more = simulated.given[-1]
    assert given[2] == "q" and len(simulated.runs) == 1 and more["loops"] == "closed"
    assert capsys.readouterr().err == (
        "a.pdb: minimised first: 5.5 -> -3.2 kJ/mol, C-alpha RMSD 0.12 angstrom; "
        "loops are kept closed as they are after it\n"
    )


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
    assert told.err == "protochain: a.pdb: why; the frames until then are in a-simulation/*.part.*\n"


def test_simulate_refuses_before_it_reads(simulated):
    for options in (("--steps", -1), ("--checkpoint-every", 0), ("--time-step", 0), ("--trajectory", "avi")):
        assert refusal("simulate", "a.pdb", *options)
    assert simulated.prepared == [] and simulated.given == []


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


def test_batch_hands_its_options_on(batched, capsys):
    assert run("batch", "a", "b") == 0
    given, more = batched.given[0]
    assert given == (["a", "b"], Path("batch"))
    assert more == {
        "manifest": None, "resume": False, "force": False, "workers": None, "scheduler": None, "threads": 1,
        "time_limit": 3600.0,
        "methods": ("cartesian",), "tolerance": None, "max_rmsd": math.inf, "max_evaluations": 5000,
        "seed": 0, "restraint": "", "n_starts": 1, "spread": 0.2, "curvature": None, "judge": "auto",
        "setup": Setup(), "relaxing": RelaxSettings(),
    }  # fmt: skip
    assert capsys.readouterr().out == "done 1 'page'\n"
    options = (
        "-o", "out", "--methods", "md, kcm", "--manifest", "m.csv", "--workers", 2, "--scheduler", "s",
        "--threads", 3,
        "--time-limit", 4, "--resume", "--force", "--tolerance", 5, "--max-evaluations", 6, "--max-rmsd", 7,
        "--seed", 8, "--restrain", "5 0", "--no-curvature", "--judge", "reference",
        "--json", "--ph", 5, "--preset", "crystal", "--stiffness", 9, "--max-iterations", 8,
        "--max-outer-iterations", 7, "--exclude", "resid 3", "--strip-hydrogens", "--repack",
    )  # fmt: skip
    assert run("batch", *options) == 0
    given, more = batched.given[1]
    assert given == ([], Path("out")) and more == {
        "manifest": Path("m.csv"), "resume": True, "force": True, "workers": 2, "scheduler": "s",
        "threads": 3, "time_limit": 4.0,
        "methods": ("md", "kcm"), "tolerance": 5.0, "max_rmsd": 7.0, "max_evaluations": 6, "seed": 8,
        "restraint": "5 0", "n_starts": 1, "spread": 0.2, "curvature": False, "judge": "reference",
        "setup": Setup(ph=5.0),
        "relaxing": RelaxSettings("crystal", "", 5.0, 9.0, 8, 7, "resid 3", False, True),
    }  # fmt: skip
    assert capsys.readouterr().out == '{"a": 1}\n'
    assert run("batch", "a", "--starts", 9, "--spread", 90) == 0
    assert batched.given[2] == (
        (["a"], Path("batch")),
        batched.given[0][1] | {"n_starts": 9, "spread": math.pi / 2},
    )


def test_a_dry_batch_lists_its_jobs(batched, capsys, monkeypatch):
    monkeypatch.setattr("sys.stdin", io.StringIO(" x.pdb \n\ny\n"))
    assert (
        run("batch", "a", "-", "b", "--dry-run", "--manifest", "m.csv", "-o", "out", "--methods", "md") == 0
    )
    ((inputs, settings, manifest, output),) = batched.found
    assert inputs == ["a", "x.pdb", "y", "b"] and (manifest, output) == (Path("m.csv"), Path("out"))
    assert settings == BatchSettings(("md",)) and batched.given == []
    assert capsys.readouterr().out == "found jobs\n"
    for text, options, expected in (
        ("x\ny\0 z\0", (), ["x\ny", " z"]), ("x\ny", ("-0",), ["x\ny"]), ("", ("--null",), [])
    ):  # fmt: skip
        monkeypatch.setattr("sys.stdin", io.StringIO(text))
        assert run("batch", "-", "--dry-run", *options) == 0 and batched.found[-1][0] == expected


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
    assert capsys.readouterr().err == "protochain: interrupted; --resume does the rest\n" * interrupted
