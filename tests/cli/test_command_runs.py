"""Commands that compute, without the computing: what they hand on, write, print, and how they end."""

import importlib
import json
from contextlib import nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace

import pandas as pd
import pytest
from fixtures.command_line import is_held, refusal, run
from fixtures.molecules import ring

from protochain.cli import options, terminal
from protochain.minimisers.record import SHORT_COLUMNS
from protochain.structure.write import as_text

pytestmark = pytest.mark.usefixtures("interruptible")
COMPARE = importlib.import_module("protochain.cli.compare")
S = ring()
KEYS = [column.key for column in SHORT_COLUMNS]


class Solution:
    """Stands for a result, whose file tells its status."""

    structure = S

    def __init__(self, status="converged", is_usable=True):
        self.status, self.is_usable, self.message = status, is_usable, f"ended {status}"
        self.trace = pd.DataFrame({"iteration": [0, 1]})

    def provenance(self):
        return (f"STATUS {self.status}",)

    def record(self, terms=True):
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
        prepared=[], runs=0, ends=iter([Solution()] * 9), chain=SimpleNamespace(structure=S)
    )

    def prepare(source, setup):
        seen.prepared.append(setup)
        return seen.chain, "energy", 1.5

    def minimise(chain, energy, **settings):
        assert chain is seen.chain and energy == "energy" and is_held()
        seen.runs += 1
        return next(seen.ends)

    monkeypatch.setattr(terminal, "print_outlook", lambda *given: 1)
    monkeypatch.setattr(options, "prepare", prepare)
    for module in (terminal, COMPARE):
        monkeypatch.setattr(module, "foretell", lambda *given: None)
        monkeypatch.setattr(module, "run_progress", lambda *given: nullcontext(lambda row, x: None))
    monkeypatch.setattr("protochain.minimisers.minimise", minimise)
    return seen


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
    assert Path(output).read_text() == text_of("budget", Path(output).suffix)
    lines = capsys.readouterr().out.splitlines()
    assert lines[-3:] == [
        "m: ended budget", "C-alpha RMSD to the start 0.12 angstrom", f"written: {output}"
    ]  # fmt: skip


def test_minimise_may_be_forced_and_refuses_what_does_not_fit(asked, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("in.pdb").write_text("")
    assert run("minimise", "in.pdb", "-o", "in.pdb", "--force") == 0 and Path(
        "in.pdb"
    ).read_text() == text_of("converged")
    asked.chain.structure = ring(chain_id="AB")
    assert "'AB' does not fit" in refusal("minimise", "in.pdb", "-o", "b.pdb") and asked.runs == 1
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
    monkeypatch.setattr("protochain.structure.preparation.read.model_numbers", lambda source: [3, 7])
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
        == [setup.model for setup in asked.prepared]
        == [*map(int, done)]
    )
    said = refusal("minimise", "-", "--model", "all")
    assert said.startswith("model all requires a file") and "single model" in refusal(
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
    seen = SimpleNamespace(ends=())

    def compare(*given, watch=None, **more):
        assert is_held()
        watch("one")({}, None)
        return Comparison(seen.ends)

    monkeypatch.setattr("protochain.comparison.compare", compare)
    monkeypatch.setattr(COMPARE, "print_table", lambda rows: None)
    return seen


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
