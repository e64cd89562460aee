"""Further outputs: a trajectory, a trace, a topology ... never replace a file without ``--force``."""

from pathlib import Path

import pytest
from fixtures.command_line import refusal_as_said, run
from fixtures.samples import STRUCTURES

import protochain as pc

ALA = str(STRUCTURES / "ala10.pdb")
MINIMISE = ["minimise", ALA, "-o", "end.pdb", "--max-evaluations", 2, "--solvent", "vacuum"]
OPTIONS = {"trajectory": "t.dcd", "trace": "t.csv", "checkpoint": "t.npz", "ligand-out": "t.sdf"}


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    ("command", "file"),
    [
        *((f"minimise {ALA} -o end.pdb --{option} {file}", file) for option, file in OPTIONS.items()),
        (f"relax {ALA} -o end.pdb --ligand-out t.sdf", "t.sdf"),
        (f"relax {ALA} --trajectory {ALA} -o t.dcd", "t.pdb"),
        (f"relax {ALA} --trajectory {ALA} -o t.xtc --resume", "t.pdb"),
        (f"relax {ALA} --trajectory {ALA} -o end.pdb", "end.csv"),
        (f"simulate {ALA} -o run", "run/trajectory.dcd"),
        (f"compare {ALA} --methods kcm -o run", "run/ala10.kcm.pdb"),
    ],
)
def test_an_existing_file_is_refused_before_the_run(command, file, here):
    Path(file).parent.mkdir(exist_ok=True)
    Path(file).write_text("mine")
    line = refusal_as_said(*command.split())
    assert line.startswith(f"{file}: exists") and "--force" in line and "\n" not in line
    assert [path for path in here.rglob("*") if path.is_file()] == [here / file]
    assert Path(file).read_text() == "mine"


def test_force_replaces_further_outputs_and_all_are_listed(capsys):
    further = [part for option in ("trajectory", "trace") for part in (f"--{option}", OPTIONS[option])]
    Path("end.pdb").write_text("")
    assert run(*MINIMISE, *further, "--checkpoint", "t.npz") == 3
    lines = capsys.readouterr().out.splitlines()
    written = [line.removeprefix("written: ") for line in lines if line.startswith("written: ")]
    assert sorted(written) == ["end.pdb", "t.csv", "t.dcd", "t.npz"]
    Path("t.dcd").write_text("")
    assert run(*MINIMISE, *further, "--force") == 3 and Path("t.dcd").stat().st_size
    relax = ["relax", ALA, "--trajectory", ALA, "-o", "t.dcd", "--workers", 1, "--solvent", "vacuum"]
    Path("t.pdb").write_text("")
    assert run(*relax, "--max-iterations", 1, "--force") == 3 and pc.load("t.pdb").n_residues
