"""``protochain relax``: one file to one file, several to a folder, and what it says."""

import gzip
import json
import os
import shutil
import subprocess
import sys

import gemmi
import models
import numpy as np
import pandas as pd
import pytest
from conftest import STRUCTURES, load, shared
from test_commands import refusal, run

import protochain as pc
from protochain.analysis.relaxed import write_relaxed
from protochain.batches.relaxed import SHOWN_RELAXED
from protochain.cli.relaxing import print_relaxed, tell_plan
from protochain.relaxation.record import before_and_after
from protochain.structure.write import as_text

pytestmark = pytest.mark.usefixtures("interruptible")


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def command(*arguments):
    """Run in a process of its own, as batches have to."""
    return subprocess.run(
        [sys.executable, "-c", "from protochain.cli import main; main()", *map(str, arguments)],
        capture_output=True, text=True, env=os.environ, check=False,
    )  # fmt: skip


def test_a_ranked_model_is_named_as_colabfold_names_it_and_said_before_and_after(here, capsys):
    damaged = models.with_random_side_chains(load("1l2y.pdb"), seed=2)
    name = "x_unrelaxed_rank_001_alphafold2_ptm_model_1_seed_000.pdb"
    (here / name).write_text(as_text(damaged, ".pdb", hydrogens=False))
    assert run("relax", name, "--threads", 1) == 0
    said = capsys.readouterr()
    first = said.err.splitlines()[-1]
    assert first.startswith(f"{name}: 20 residues, 304 atoms; ") and "overlap" in first and "about" in first
    written = name.replace("unrelaxed", "relaxed")
    assert said.out.splitlines()[-1] == f"written: {written}" and (here / written).exists()
    assert "before" in said.out and "after" in said.out and "converged: RMS force" in said.out
    assert max(map(len, said.out.splitlines())) <= 80
    again = pc.load(here / written)
    assert pc.validate(again).measures["violations"] == 0


def test_json_is_one_object_of_the_record(here, capsys):
    assert run("relax", STRUCTURES / "1l2y.pdb", "-o", "out.pdb", "--json", "--threads", 1) == 0
    record = json.loads(capsys.readouterr().out)
    assert record["output"] == "out.pdb" and record["input"] == str(STRUCTURES / "1l2y.pdb")
    assert (
        record["status"] == "converged" and record["violations_end"] == 0 and record["preset"] == "predicted"
    )
    assert len(record["rounds"]) == record["n_rounds"] and record["evaluations"] > 5


def test_unconverged_is_status_3_and_the_file_is_written_all_the_same(here, capsys):
    given = ("relax", STRUCTURES / "1l2y.pdb", "-o", "out.cif", "--max-iterations", 2, "--strip-hydrogens")
    assert run(*given, "--threads", 1) == 3
    assert "budget" in capsys.readouterr().out
    made = gemmi.read_structure("out.cif")
    assert not any(atom.is_hydrogen() for chain in made[0] for res in chain for atom in res)


def test_a_page_shows_both_structures(here, capsys):
    given = (STRUCTURES / "1l2y.pdb", "--max-iterations", 3, "--report", "page.html", "--threads", 1)
    assert run("relax", *given) == 3
    page = (here / "page.html").read_text()
    assert "written: page.html" in capsys.readouterr().out
    assert '"name": "input"' in page and '"farthest_angstrom"' in page and "<td>energy, kJ/mol</td>" in page
    assert "ff14SB" in page or "amber14" in page


def test_standard_output_holds_the_structure_alone(here, capsys):
    assert run("relax", STRUCTURES / "1l2y.pdb", "-o", "-", "--max-iterations", 1, "--threads", 1) == 3
    out, err = capsys.readouterr()
    assert out.count("ATOM ") == 304 and out.rstrip().endswith("END") and "written: standard output" in err


def test_what_makes_no_sense_is_refused_before_the_work(here):
    (here / "in").mkdir()
    shutil.copy(STRUCTURES / "1l2y.pdb", here / "in" / "a.pdb")
    for arguments, said in (
        (("in/a.pdb", "--resume"), "resume: in/a.pdb is one file"),
        (("in/a.pdb", "-o", "in/a.pdb"), "is the input"),
        (("in/a.pdb", "-o", "-", "--json"), "both go to standard output"),
        (("in/a.pdb", "--report", "page.txt"), "ends in .html"),
        (("in/a.pdb", "--preset", "weak"), "choose from predicted, crystal, design"),
        (("in/a.pdb", "--protocol", "alphafold", "--solvent", "gbn2"), "protocol alphafold is vacuum"),
        (("in", "--report", "page.html"), "have report.html in their folder"),
        (("in", "-o", "out.pdb"), "give the name of a folder"),
        (("none.pdb",), "none.pdb: cannot be read"),
        (("in/*.cif",), "matches no file"),
    ):
        assert said in refusal("relax", *arguments), arguments
    assert sorted(path.name for path in here.rglob("*")) == ["a.pdb", "in"]


def test_a_folder_is_relaxed_with_a_row_for_each_and_resumed(here):
    """Packed, mmCIF, several models, and one broken file, which stops nothing."""
    (here / "in").mkdir()
    with gzip.open(here / "in" / "x_unrelaxed_rank_002_y.pdb.gz", "wt") as file:
        file.write((STRUCTURES / "1l2y.pdb").read_text())
    (here / "in" / "ala.cif").write_text(as_text(load("ala10.pdb"), ".cif"))
    (here / "in" / "broken.pdb").write_text("ATOM      1  N   ALA A   1\n")
    given = ("relax", "in", "-o", "out", "--workers", 1, "--solvent", "vacuum")
    done = command(*given)
    assert done.returncode == 3, done.stderr
    assert "3 structures: 2 converged, 1 refused" in done.stdout and "broken: " in done.stdout
    table = pd.read_csv(here / "out" / "relaxed.csv").set_index("structure")
    assert list(table.index) == ["ala", "broken", "x_unrelaxed_rank_002_y"]
    assert table.loc["x_unrelaxed_rank_002_y", "output"] == "x_relaxed_rank_002_y.pdb"
    assert table.loc["ala", "output"] == "ala.relaxed.cif"
    assert (table["violations_end"].dropna() == 0).all() and table["status"]["broken"] == "refused"
    for name in ("x_relaxed_rank_002_y.pdb", "ala.relaxed.cif", "report.html", "pages/ala.html"):
        assert (here / "out" / name).exists(), name
    assert "relaxed.csv" in (here / "out" / "report.html").read_text()
    assert {column.key for column in SHOWN_RELAXED} <= set(table.columns)
    page = (here / "out" / "pages" / "ala.html").read_text()
    assert all(f">{column.title}<" in page for column in SHOWN_RELAXED)
    kept = (here / "out" / "x_relaxed_rank_002_y.pdb").stat().st_mtime_ns
    assert "--resume continues it" in command(*given).stderr
    other = command(*given, "--resume", "--stiffness", 100)
    assert other.returncode == 2 and "without stiffness, which is 100.0 now" in other.stderr
    shutil.copy(STRUCTURES / "ala10.pdb", here / "in" / "new.pdb")
    again = command(*given, "--resume")
    assert "4 structures: 3 converged, 1 refused" in again.stdout
    assert (here / "out" / "x_relaxed_rank_002_y.pdb").stat().st_mtime_ns == kept


def test_models_of_a_file_are_several():
    """Each model is a structure of the folder."""
    from protochain.batches import find_jobs
    from protochain.batches.relaxed import RelaxSettings
    from protochain.setup import Setup

    jobs = find_jobs([shared("1vii_villin_nmr3.pdb")], RelaxSettings(setup=Setup(model="all")))
    assert [job.settings.setup.model for job in jobs] == [0, 1, 2]
    assert len({job.key for job in jobs}) == 3 and jobs[0].settings.methods == ("relax",)


def test_measures_that_are_nothing_before_and_after_are_left_out():
    from protochain.validation import MEASURES

    record = {f"{key}_{when}": 0 for key in MEASURES for when in ("start", "end")}
    record |= {"violations_start": 3, "ramachandran_favoured_percent_start": None}
    record |= {"ramachandran_favoured_percent_end": None, "overlaps_start": 2, "overlaps_end": 0}
    record |= {"energy_start_kj_mol": 2.5e9, "energy_end_reference_kj_mol": -12.34}
    assert before_and_after(record) == [
        ("residues with violations, as AlphaFold counts them", "3", "0"),
        ("overlapping pairs of atoms", "2", "0"),
        ("energy, kJ/mol", "2.5e+09", "-12.3"),
    ]


def test_the_plot_of_displacements_names_its_line_in_words(monkeypatch, tmp_path):
    figures = []
    monkeypatch.setattr(
        "protochain.analysis.relaxed.data_url", lambda figure: figures.append(figure) or "data:,"
    )
    r = pc.relax(load("ala10.pdb"), threads=1, solvent="vacuum")
    write_relaxed(r, r.record(), tmp_path / "page.html")
    ((panel,),) = (figure.axes for figure in figures)
    assert [text.get_text() for text in panel.get_legend().get_texts()] == ["relaxed"]
    assert panel.lines[0].get_ydata() == pytest.approx(r.displacements["displacement_angstrom"])


def test_hands_are_announced_and_told(monkeypatch, tmp_path, capsys):
    s = load("ala10.pdb")
    x = s.positions.copy()
    own = s.atom_residue == 3
    n, alpha, c = (x[own & (s.atom_name == name)][0] for name in ("N", "CA", "C"))
    normal = np.cross(n - alpha, c - alpha)
    normal /= np.linalg.norm(normal)
    moved = own & ~np.isin(s.atom_name, ["N", "H", "CA", "C", "O"])
    x[moved] -= 2.0 * np.outer((x[moved] - alpha) @ normal, normal)
    wrong = s.with_positions(x)
    tell_plan(tmp_path / "x.pdb", wrong, pc.energy(wrong, solvent="vacuum"))
    said = capsys.readouterr().err
    assert "; 1 chiral atom of the wrong hand, to be turned right (name D-amino acids as DAL ...); " in said
    tell_plan(tmp_path / "x.pdb", s, pc.energy(s, solvent="vacuum"))
    assert "of the wrong hand" not in capsys.readouterr().err
    r = pc.relax(wrong, threads=1, solvent="vacuum")
    print_relaxed(r.record() | {"output": "x.pdb"})
    assert "residue 4 ALA of chain A: CA of the wrong hand turned right\n" in capsys.readouterr().out
