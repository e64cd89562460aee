"""``--trajectory`` and ``--frames`` of relax, validate, energy and rmsd: files, exit statuses, refusals."""

import json
import re
from contextlib import nullcontext

import numpy as np
import pandas as pd
import pytest
from fixtures.command_line import refusal, refusal_as_said, run
from fixtures.frames import models, saved, shaken
from fixtures.samples import load

import protochain as pc
from protochain.batches.cluster import Processes
from protochain.batches.frame_files import FramesRun
from protochain.cli import frames as of_frames
from protochain.cli import terminal
from protochain.structure.formats.frames import open_frames

SMALL = "ala10.pdb"


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A folder with a topology, its frames, of which one is damaged, and the same as models."""
    monkeypatch.chdir(tmp_path)
    structure = load(SMALL)
    x = shaken(structure, 4, by=0.01)
    pc.save(structure, "top.pdb")
    models(structure, x, tmp_path / "models.pdb")
    x[1, 5] = np.nan
    saved(structure, x, tmp_path / "x.dcd")
    return tmp_path


@pytest.fixture(autouse=True)
def here_alone(monkeypatch):
    """No processes: those are tested by themselves."""
    from protochain.batches import frame_files

    over = frame_files.over_frames
    monkeypatch.setattr(frame_files, "over_frames", lambda e, f, task, processes: over(e, f, task))
    monkeypatch.setattr(Processes, "started_early", lambda *_: nullcontext())


def test_relax_writes_frames_rows_topology_and_page(here, capsys):
    given = ["relax", "top.pdb", "--trajectory", "x.dcd", "-o", "o.xtc", "--report", "o.html"]
    assert run(*given, "--threads", 1) == 4
    said = capsys.readouterr()
    assert "3 converged" in said.out and "1 refused" in said.out and "o.xtc" in said.out
    assert "frame 1: " in said.err
    table = pd.read_csv("o.csv")
    assert table["frame"].tolist() == [0, 1, 2, 3] and table["status"].tolist().count("converged") == 3
    assert len(open_frames(here / "o.xtc")) == 3 and pc.load("o.pdb").n_atoms == load(SMALL).n_atoms
    assert "frame 1: " in (here / "o.html").read_text()
    assert sorted(path.name for path in here.iterdir()) == [
        "models.pdb", "o.csv", "o.html", "o.pdb", "o.xtc", "top.pdb", "x.dcd",
    ]  # fmt: skip


def test_models_are_relaxed_into_models_and_named_after_the_file(here, capsys):
    assert run("relax", "models.pdb", "--frames", "::2", "--threads", 1, "--json") == 0
    said = capsys.readouterr()
    record = json.loads(said.out)
    assert record["counts"] == {"converged": 2} and record["output"] == "models.relaxed.pdb"
    assert len(open_frames(here / "models.relaxed.pdb")) == 2 and "left out" not in said.err
    rows = pd.read_csv("models.relaxed.csv")
    assert rows["frame"].tolist() == [0, 2]
    alone = pc.relax("models.pdb", model=3, threads=1)
    assert rows["energy_end_reference_kj_mol"][1] == alone.energy_end


def test_other_commands_write_a_row_a_frame(here, capsys):
    common = ["--trajectory", "x.dcd"]
    assert run("validate", "top.pdb", *common, "--csv", "v.csv", "--reference", "top.pdb") == 4
    assert run("energy", "top.pdb", *common, "-o", "e.csv", "--threads", 1) == 4
    assert run("rmsd", "top.pdb", "top.pdb", *common, "-o", "r.csv") == 4
    assert run("rmsd", "top.pdb", "top.pdb", *common, "--frames", "2:", "-o", "r2.csv") == 0
    for name, key in (("v", "violations"), ("v", "lddt"), ("e", "total_kj_mol"), ("r", "rmsd_angstrom")):
        table = pd.read_csv(f"{name}.csv")
        assert table["frame"].tolist() == [0, 1, 2, 3] and table[key].isna().tolist() == [
            False,
            True,
            False,
            False,
        ]
    capsys.readouterr()
    # The frames are farther and farther from the structure, and the farthest is neither first nor last.
    x = load(SMALL).positions * np.array([1.01, 1.03, 1.02, 1.05, 1.04])[:, None, None]
    saved(load(SMALL), x, here / "y.dcd")
    assert run("energy", "top.pdb", "--trajectory", "y.dcd", "-o", "y.csv", "--threads", 1) == 0
    assert pd.read_csv("y.csv")["total_kj_mol"].argsort().tolist() == [0, 2, 1, 4, 3]
    (named,) = re.findall(r"highest total kJ/mol: frames (.*)", capsys.readouterr().out)
    assert re.findall(r"(\d+) \(", named) == ["3", "4", "1"]
    structure = load(SMALL)
    x = next(iter(open_frames(here / "x.dcd", 3))).x
    assert pd.read_csv("r2.csv")["rmsd_angstrom"][1] == pytest.approx(
        pc.ca_rmsd(structure, x, structure), rel=1e-4
    )


def test_frames_of_which_none_can_be_used_are_a_failure(here):
    assert run("relax", "top.pdb", "--trajectory", "x.dcd", "--frames", "1", "-o", "o.dcd") == 2
    assert not (here / "o.dcd").exists() and len(pd.read_csv("o.csv")) == 1


def test_frames_that_are_written_though_none_converged_are_no_failure(here):
    given = ("relax", "top.pdb", "--trajectory", "x.dcd", "--frames", "0", "-o", "o.dcd")
    assert run(*given, "--max-iterations", "1") == 3
    assert (here / "o.dcd").exists() and pd.read_csv("o.csv")["status"].tolist() == ["budget"]


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("relax top.pdb models.pdb --trajectory x.dcd", "one structure"),
        ("relax top.pdb --trajectory x.dcd -o o.foo", ".foo"),
        ("relax top.pdb --trajectory x.dcd -o x.dcd", "is the input"),
        ("relax top.pdb --trajectory x.dcd --report page.txt -o o.dcd", ".html"),
        ("relax - --frames all", "standard input"),
        ("rmsd top.pdb top.pdb models.pdb --trajectory x.dcd", "one structure"),
    ],
)
def test_what_makes_no_sense_is_refused_in_a_line(here, given, said):
    before = {path.name for path in here.iterdir()}
    line = refusal(*given.split())
    assert said in line and "\n" not in line
    assert {path.name for path in here.iterdir()} == before


EXCLUDED = {
    "relax top.pdb --trajectory x.dcd -o o.dcd": "scheduler=tcp://x ligand-out=l.sdf protein-out=p.pdb "
    "restraint-csv=r.csv posebusters timings",
    "validate top.pdb --trajectory x.dcd": "residues=r.csv changes=c.csv posebusters",
    "energy top.pdb --trajectory x.dcd": "by=residue report=r.html",
    "score top.pdb --trajectory x.dcd": "rank=clashes residues=r.csv report=r.html",
    "validate top.pdb": "workers=2 resume", "validate top.pdb models.pdb": "report=r.html",
    "energy top.pdb": "workers=2 resume",
    "rmsd top.pdb top.pdb": "workers=2 resume", "score top.pdb": "workers=2 resume",
    "relax top.pdb": "workers=2 time-limit=9 resume",
    "relax top.pdb models.pdb": "report=r.html timings restraint-csv=r.csv",
    "minimise models.pdb --model all": "timings trace=t.csv trajectory=y.dcd checkpoint=c.npz resume=c.npz "
    "report=r.html ligand-out=l.sdf restraint-csv=r.csv",
    "simulate top.pdb": "trajectory-length=5", "simulate top.pdb --thermostat none": "friction=2",
    "search top.pdb --method csa": "temperatures=300-400 replicas=3 pilot=9", "batch top.pdb": "null",
    "mutate top.pdb A2G": "into=V workers=2 scheduler=tcp://x time-limit=9 resume report=r.html",
}  # fmt: skip
"""Commands, and options that would have no effect there."""


@pytest.mark.parametrize("command", EXCLUDED)
def test_an_option_without_an_effect_is_refused_by_name(here, command):
    before = {path.name for path in here.iterdir()}
    for option in EXCLUDED[command].split():
        assert f"--{option.split('=')[0]} " in refusal_as_said(*command.split(), *f"--{option}".split("=")), (
            option
        )
        assert {path.name for path in here.iterdir()} == before


def test_a_stopped_run_is_not_replaced_by_chance(here, capsys, monkeypatch):
    begun = ["relax", "top.pdb", "--trajectory", "x.dcd", "-o", "o.dcd", "--threads", 1]

    def stop(done, failed, last):
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        from contextlib import contextmanager

        patched.setattr(terminal, "frames_progress", contextmanager(lambda name, total: (yield stop)))
        assert run(*begun) == 130
    assert "--resume" in capsys.readouterr().err
    assert "resume" in refusal(*begun)
    assert run(*begun, "--resume") == 4 and len(pd.read_csv("o.csv")) == 4
    rows = (here / "o.csv").read_bytes()
    assert run(*begun, "--resume") == 4 and (here / "o.csv").read_bytes() == rows
    said = capsys.readouterr().err
    assert "o.csv: is complete, nothing to do (settings are not compared" in said and "replaced" not in said
    assert "o.csv: exists" in refusal(*begun) and run(*begun, "--force") == 4


def test_sums_medians_and_worst_frames_are_of_their_columns(tmp_path, capsys):
    """Sums of violations before and after, medians of each column, and the worst frames by the end."""
    table = pd.DataFrame({
        "frame": [0, 1, 2, 3], "status": "converged", "largest_gap_angstrom": [0.1, 12.0, 0.2, 15.0],
        "violations_start": [9, 1, 7, 3], "violations_end": [0, 5, 1, 3],
        "energy_start_kj_mol": [-10.0, -20.0, -30.0, -50.0],
        "energy_end_reference_kj_mol": [-100.0, -200.0, -300.0, -700.0],
    })  # fmt: skip
    table.to_csv(tmp_path / "t.csv", index=False)
    of_frames._print(FramesRun(tmp_path / "t.csv", counts={"converged": 4}, written=4), None)
    said = capsys.readouterr().out
    assert re.findall(r"(\d+) before, (\d+) after", said) == [("20", "9")]
    assert re.findall(r"(start|end)\D* kJ/mol (-\d+)", said) == [("start", "-25"), ("end", "-250")]
    (named,) = re.findall("highest violations end: frames (.*)", said)
    assert re.findall(r"(\d+) \((\d+)\)", named) == [("1", "5"), ("3", "3"), ("2", "1")]
    assert re.findall(r"(\d+) frames with molecules up to (\d+) ", said) == [("2", "15")]


@pytest.mark.parametrize("measures", [
    "energy_start_kj_mol energy_end_reference_kj_mol ca_rmsd_angstrom seconds",
    "violations clashscore_per_1000_atoms ramachandran_outliers rotamer_outliers lddt",
    "total_kj_mol", "sum_total_kj_mol", "lddt rmsd_angstrom tm_score",
    "energy_kj_mol buried_area_angstrom2 packing",
])  # fmt: skip
def test_the_median_of_every_measure_of_a_command_is_printed(tmp_path, capsys, measures):
    names = measures.split()
    values = {name: [0.0, 2.0 * k + 11.0, 99.0] for k, name in enumerate(names)}
    table = pd.DataFrame({"frame": [0, 1, 2], "status": "converged", "largest_gap_angstrom": 0.0, **values})
    table.to_csv(tmp_path / "t.csv", index=False)
    of_frames._print(FramesRun(tmp_path / "t.csv", counts={"converged": 3}, written=3), None)
    (medians,) = re.findall("medians: ([^;\n]*)", capsys.readouterr().out)
    assert [int(text.split()[-1]) for text in medians.split(", ")] == [11 + 2 * k for k in range(len(names))]
