"""Commands that compute, without the computing: what they hand on, write, print, and how they end."""

import importlib
import json
import math
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace

import mdtraj
import numpy as np
import pandas as pd
import pytest
from fixtures.command_line import is_held, refusal, run
from fixtures.molecules import ring

from protochain.cli.terminal import typical_evaluations
from protochain.minimisers.record import SHOWN
from protochain.structure.write import as_text

pytestmark = pytest.mark.usefixtures("interruptible")
MINIMISE, COMPARE = (importlib.import_module(f"protochain.cli.{name}") for name in ("minimise", "compare"))
S = ring()
KEYS = [column.key for column in SHOWN]


class Solution:
    """Stands for a result, whose file tells its status."""

    structure = S

    def __init__(self, status="converged", is_usable=True):
        self.status, self.is_usable, self.message = status, is_usable, f"ended {status}"
        self.trace = pd.DataFrame({"iteration": [0, 1]})

    def provenance(self):
        return (f"STATUS {self.status}",)

    def record(self):
        beside = {"ca_rmsd_angstrom": 0.125, "ca_rmsd_as_filed_angstrom": 1.5, "frame": "where it was"}
        return dict.fromkeys(KEYS) | beside | {
            "method": "m", "status": self.status, "message": self.message,
        }  # fmt: skip


def text_of(status, suffix=".pdb"):
    """What is written of a result."""
    return as_text(S, suffix, [f"STATUS {status}"])


@pytest.fixture
def asked(monkeypatch):
    """What is prepared and minimised; ``ends`` are the solutions, one after the other."""
    seen = SimpleNamespace(
        prepared=[],
        foretold=[],
        runs=[],
        shown=[],
        ends=iter([Solution()] * 9),
        chain=SimpleNamespace(structure=S),
        troubled=False,
    )

    def prepare(source, setup):
        seen.prepared.append((source, setup))
        return seen.chain, "energy", 1.5

    def foretell(source, chain, energy, *lengths):
        assert chain is seen.chain and energy == "energy"
        assert seen.prepared[-1][0] == source and (seen.runs or not is_held())
        seen.foretold.append(lengths)

    @contextmanager
    def progress(method, n, each=None):
        def watch(row, x):
            seen.shown.append((method, n, row))
            if each:
                each(x)

        yield watch

    def minimise(chain, energy, watch=None, **settings):
        assert chain is seen.chain and energy == "energy" and is_held()
        assert len(seen.foretold) > len(seen.runs)
        seen.runs.append(settings)
        for k in range(2):
            watch({"k": k}, S.positions + k)
        return next(seen.ends)

    def explore(chain, energy, watch=None, **settings):
        best = minimise(chain, energy, watch, **settings)
        overall = {"starts": [1], "starts_summary": {"n": 1}}
        return SimpleNamespace(best=best, overall=lambda: overall)

    def outlook(source, structure, method):
        assert structure is S and seen.prepared[-1][0] == source
        return seen.troubled

    monkeypatch.setattr(MINIMISE, "print_outlook", outlook)
    for module in (MINIMISE, COMPARE):
        monkeypatch.setattr(module, "prepare", prepare)
        monkeypatch.setattr(module, "foretell", foretell)
        monkeypatch.setattr(module, "run_progress", progress)
    monkeypatch.setattr("protochain.minimisers.minimise", minimise)
    monkeypatch.setattr("protochain.minimisers.explore", explore)
    return seen


DEFAULTS = {
    "method": "cartesian", "tolerance": None, "max_evaluations": 5000, "seed": 0, "restraint": "",
    "max_rmsd": math.inf, "curvature": None, "judge": "auto",
}  # fmt: skip


def test_minimise_hands_its_options_on_and_writes_what_is_asked(asked, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert run(
        "minimise", "in/a.pdb", "--method", "lbfgs", "--tolerance", 2, "--max-evaluations", 7, "--seed", 3,
        "--restrain", "5 0", "--max-rmsd", 0.5, "--trace", "t.csv", "--trajectory", "t.dcd", "--checkpoint",
        "c.npz",
        "--json", "--ph", 5, "--model", 2, "-o", "out/b.cif",
    ) == 0  # fmt: skip
    assert asked.runs == [
        {
            "method": "lbfgs", "tolerance": 2.0, "max_evaluations": 7, "seed": 3, "restraint": "5 0",
            "max_rmsd": 0.5, "checkpoint": Path("c.npz"), "resume": None, "curvature": None, "judge": "auto",
        }
    ]  # fmt: skip
    ((source, setup),) = asked.prepared
    assert (source, setup.ph, setup.model) == (Path("in/a.pdb"), 5.0, 2)
    assert asked.foretold == [(7, 7)]
    assert asked.shown == [("lbfgs", 7, {"k": 0}), ("lbfgs", 7, {"k": 1})]
    assert Path("out/b.cif").read_text() == text_of("converged", ".cif")
    assert Path("t.csv").read_text() == "iteration\n0\n1\n"
    frames = mdtraj.load_dcd("t.dcd", top=mdtraj.Topology.from_openmm(S.topology)).xyz
    assert frames == pytest.approx(np.array([S.positions, S.positions + 1]), abs=1e-6)
    assert {path.name for path in tmp_path.iterdir()} == {"out", "t.csv", "t.dcd"}
    printed = json.loads(capsys.readouterr().out)
    assert printed.pop("timings")["imports"] > 0.0
    assert printed == Solution().record() | {
        "input": "in/a.pdb", "output": "out/b.cif", "seconds_preparation": 1.5, "model": 2,
        "confidences": [],
    }  # fmt: skip


@pytest.mark.parametrize(
    ("source", "output"),
    [("x/a.pdb", "a.lbfgs.pdb"), ("a.cif.gz", "a.lbfgs.cif"), ("-", "stdin.lbfgs.pdb")],
)
def test_minimise_names_its_output_after_input_and_method(
    source, output, asked, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    asked.ends = iter([Solution("budget")])
    assert run("minimise", source, "--method", "lbfgs") == 3
    assert Path(output).read_text() == text_of("budget", Path(output).suffix) and asked.runs == [
        DEFAULTS | {"method": "lbfgs", "checkpoint": None, "resume": None}
    ]
    assert asked.foretold == [(typical_evaluations("lbfgs", 5000), 5000)]
    lines = capsys.readouterr().out.splitlines()
    assert lines[-3:] == [
        "m: ended budget", "C-alpha RMSD 0.12 angstrom, as filed 1.50: where it was", f"written: {output}"
    ]  # fmt: skip


def test_a_start_with_overlaps_is_foretold_to_take_longer(asked, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    asked.troubled = True
    assert run("minimise", "a.pdb") == 0
    assert run("minimise", "a.pdb", "--max-evaluations", 200) == 0
    assert asked.foretold == [(3 * typical_evaluations("cartesian", 5000), 5000), (200, 200)]


@pytest.mark.parametrize(("options", "spread"), [((), 0.2), (("--spread", 90), math.pi / 2)])
def test_many_starts_are_explored(options, spread, asked, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(MINIMISE, "print_distribution", lambda summary: print("distribution", summary))
    assert run("minimise", "a.pdb", "--starts", 4, *options) == 0
    assert asked.runs == [DEFAULTS | {"n_starts": 4, "spread": spread}]
    assert asked.shown[0][:2] == ("cartesian", 5000)
    assert asked.foretold == [(4 * typical_evaluations("cartesian", 5000), 20_000)]
    assert capsys.readouterr().out.startswith("distribution {'n': 1}\n")
    assert run("minimise", "a.pdb", "--starts", 2, "--json") == 0
    assert json.loads(capsys.readouterr().out)["starts"] == [1]


def test_minimise_may_be_forced_and_refuses_what_does_not_fit(asked, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("in.pdb").write_text("")
    assert run("minimise", "in.pdb", "-o", "in.pdb", "--force") == 0 and Path(
        "in.pdb"
    ).read_text() == text_of("converged")
    asked.chain.structure = ring(chain_id="AB")
    assert "'AB' does not fit" in refusal("minimise", "in.pdb", "-o", "b.pdb") and len(asked.runs) == 1
    asked.chain.structure, asked.ends = S, iter([Solution(is_usable=False)])
    capsys.readouterr()
    with pytest.raises(SystemExit) as ended:
        run("minimise", "in.pdb", "-o", "b.pdb", "--trace", "t.csv")
    assert ended.value.code == 1 and "in.pdb" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["in.pdb"]


@pytest.mark.parametrize(
    ("ends", "status"),
    [(("converged",) * 2, 0), (("converged", "interrupted"), 130), (("interrupted", "converged"), 130)],
)
def test_all_models_have_outputs_of_their_own(ends, status, asked, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("protochain.structure.read.model_numbers", lambda source: [3, 7])
    asked.ends = map(Solution, ends)
    assert run("minimise", "a.pdb", "--model", "all", "--json", "-o", "d/b.cif") == status
    records = json.loads(capsys.readouterr().out)["models"]
    done = ["3", "7"][: 1 if ends[0] == "interrupted" else 2]
    assert [record["output"] for record in records] == [f"d/b.{number}.cif" for number in done]
    assert {path.name: path.read_text() for path in Path("d").iterdir()} == {
        f"b.{number}.cif": text_of(end, ".cif") for number, end in zip(done, ends, strict=False)
    }
    assert (
        [record["model"] for record in records]
        == [setup.model for _, setup in asked.prepared]
        == [*map(int, done)]
    )
    said = refusal("minimise", "-", "--model", "all")
    assert said.startswith("model all: needs a file") and "one model" in refusal(
        "minimise", "a", "--model", "all", "--resume", "c"
    )


@dataclass
class Comparison:
    """Stands for a comparison of methods that end as they do."""

    ends: tuple
    origin: dict = field(default_factory=dict)

    @property
    def solutions(self):
        return tuple(Solution(end.removesuffix("!"), not end.endswith("!")) for end in self.ends)

    def report(self, output):
        assert (output / ".lock").exists()
        return output / "page"

    def summary(self):
        return {"results": [{"r": len(self.ends)}], "origin": self.origin}


@pytest.fixture
def compared(asked, monkeypatch, tmp_path):
    """What is compared."""
    monkeypatch.chdir(tmp_path)
    seen = SimpleNamespace(given=[], ends=("converged", "converged"))

    def compare(*given, watch=None, **more):
        assert is_held() and len(asked.foretold) > len(seen.given)
        seen.given.append((given, more))
        for method in ("one", "two"):
            watch(method)({}, None)
        return Comparison(seen.ends)

    monkeypatch.setattr("protochain.comparison.compare", compare)
    monkeypatch.setattr("protochain.structure.load", lambda path: f"loaded {path}")
    monkeypatch.setattr(COMPARE, "print_table", lambda rows: print("table", rows))
    return seen


def test_compare_hands_its_options_on(compared, asked, capsys):
    options = ("--tolerance", 2, "--max-evaluations", 7, "--seed", 3, "--repeats", 5, "--reference", "r.pdb")
    options = (*options, "--no-curvature", "--judge", "reference")
    assert run("compare", "in/a.pdb", "--methods", "md,kcm,md", *options, "--json", "-o", "out") == 0
    more = {"reference": "loaded r.pdb", "repeats": 5, "curvature": False, "max_evaluations": 7, "seed": 3}
    more["judge"] = "reference"
    assert compared.given == [((asked.chain, ("md", "kcm"), "energy", 2.0), more)]
    assert asked.foretold == [(14, 14)] and not list(Path().iterdir())
    assert asked.shown == [("one", 7, {}), ("two", 7, {})]
    assert json.loads(capsys.readouterr().out) == {
        "results": [{"r": 2}], "origin": {"input": "in/a.pdb", "seconds_preparation": 1.5}, "output": "out",
    }  # fmt: skip
    assert run("compare", "in/a.pdb.gz", "--methods", "md,kcm") == 0
    assert compared.given[1] == (
        (asked.chain, ("md", "kcm"), "energy", 1.0),
        {
            "reference": None,
            "repeats": 3,
            "curvature": None,
            "max_evaluations": 5000,
            "seed": 0,
            "judge": "auto",
        },
    )
    assert asked.foretold[1] == (sum(typical_evaluations(method, 5000) for method in ("md", "kcm")), 10_000)
    told = capsys.readouterr()
    assert told.err == "" and told.out == (
        "table [{'r': 2}]\nwritten: a-comparison/page with tables, plots and structures in its folder\n"
    )


@pytest.mark.parametrize(
    ("ends", "status"),
    [
        (("converged", "converged"), 0), (("budget", "converged"), 3), (("stalled!", "converged"), 3),
        (("converged",), 130), (("nan!", "nan!"), 1), ((), 1),
    ],
)  # fmt: skip
def test_compare_ends_by_its_methods_and_names_those_left_out(ends, status, compared, capsys):
    compared.ends = ends
    try:
        found = run("compare", "a.pdb", "--methods", "md,kcm")
    except SystemExit as ended:
        found = ended.code
    said = capsys.readouterr().err
    assert found == status and ("a.pdb" in said) == (status == 1)
    assert all((name in said) == (len(ends) < 2) for name in ["md", "kcm"][len(ends) :])


@pytest.mark.parametrize(
    ("ends", "status"),
    [
        (("converged", "converged"), 0), (("converged", "budget"), 3), (("budget", "converged"), 3),
        (("converged", "interrupted"), 130), (("interrupted",), 130), (("converged", "lost"), 3),
    ],
)  # fmt: skip
def test_models_end_with_0_only_if_all_converged_and_are_written(ends, status):
    command = importlib.import_module("protochain.cli.minimise")
    lost = {"status": "converged", "not_written": "no space"}
    assert command._status([lost if end == "lost" else {"status": end} for end in ends]) == status
