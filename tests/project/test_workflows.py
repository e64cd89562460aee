"""The step that others' pipelines take: that its options exist, and that it runs where they can run here."""

import json
import re
import shutil
import subprocess
import sys
import tomllib

import pytest
from fixtures.command_line import COMMANDS, run
from fixtures.samples import ROOT

import protochain as pc

WORKFLOWS = ROOT / "analysis" / "workflows"
VERSION = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
NF_CORE = WORKFLOWS / "nf-core" / "modules" / "nf-core" / "protochain" / "relax"
GALAXY = WORKFLOWS / "galaxy" / "protochain_relax.xml"
CALLS = (WORKFLOWS / "snakemake" / "wrapper.py", NF_CORE / "main.nf", GALAXY)

pytestmark = pytest.mark.usefixtures("interruptible")


@pytest.mark.parametrize("path", CALLS, ids=lambda path: path.name)
def test_options_of_a_step_exist(path):
    known = {name for each in COMMANDS["relax"].params for name in (*each.opts, *each.secondary_opts)}
    program = path.read_text(encoding="utf-8").split("<command")[-1]
    called = program.split("protochain relax", 1)[1].split("eq 3")[0]
    asked = set(re.findall(r"(?<![\w-])--?[a-z][\w-]*", called)) - {"-"}
    assert "--json" in asked and asked <= known


@pytest.mark.parametrize(
    "path", [NF_CORE / "main.nf", NF_CORE / "environment.yml", GALAXY], ids=lambda path: path.name
)
def test_a_step_is_of_this_version(path):
    assert {*re.findall(r"\b\d+\.\d+\.\d+\b", path.read_text(encoding="utf-8"))} == {VERSION}


@pytest.mark.parametrize(
    "name",
    ["predictions/x_unrelaxed_rank_001_m.pdb", "predictions/boltz_results_y/predictions/x/x_model_0.cif"],
)
def test_folders_of_predictors_are_taken_as_the_page_says(name, tmp_path, monkeypatch):
    page = (WORKFLOWS / "README.md").read_text(encoding="utf-8")
    patterns = re.findall(r'^protochain relax "(.*)" -o relaxed(?:-boltz)?$', page, re.MULTILINE)
    monkeypatch.chdir(tmp_path)
    (tmp_path / name).parent.mkdir(parents=True)
    pc.save(pc.from_sequence("GAVS"), tmp_path / name)
    (its,) = [pattern for pattern in patterns if next(tmp_path.glob(pattern), None)]
    run("relax", its, "-o", "relaxed", "--workers", "1")
    written = [path for path in (tmp_path / "relaxed").rglob("*") if path.suffix in (".pdb", ".cif")]
    assert [path.suffix for path in written] == [name[-4:]]


@pytest.mark.skipif(shutil.which("snakemake") is None, reason="Snakemake is not installed")
def test_the_snakemake_wrapper_runs(tmp_path):
    shutil.copytree(WORKFLOWS / "snakemake", tmp_path / "relax")
    there = tmp_path / "relax" / "test"
    (there / "models").mkdir()
    for name, sequence in {"a": "GAVS", "b": "GGG"}.items():
        pc.save(pc.from_sequence(sequence), there / "models" / f"{name}.pdb")
    done = subprocess.run(["snakemake", "--cores", "1"], cwd=there, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    for name in "ab":
        assert json.loads((there / "relaxed" / f"{name}.json").read_text())["method"] == "relax"
        assert pc.load(there / "relaxed" / f"{name}.pdb").n_residues in (3, 4)


def test_the_galaxy_tool_does_what_its_test_says(tmp_path):
    """Its command, with what Galaxy puts in; planemo is not asked."""
    command = re.search(r"CDATA\[\s*(.*?)\]\]></command>", GALAXY.read_text(encoding="utf-8"), re.DOTALL)[1]
    model = WORKFLOWS / "galaxy" / "test-data" / "model.pdb"
    for name, value in {
        "$model.ext": "pdb",
        "$model": str(model),
        "$preset": "predicted",
        "$repack": "",
    }.items():
        command = command.replace(name, value)
    command = " ".join(command.replace("\\$", "$").split())
    program = f'{sys.executable} -c "from protochain.cli import main; main()"'
    done = subprocess.run(
        ["sh", "-c", command.replace("protochain relax", f"{program} relax")],
        cwd=tmp_path, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "METHOD RELAX" in (tmp_path / "relaxed").read_text()
    assert json.loads((tmp_path / "record.json").read_text())["method"] == "relax"
