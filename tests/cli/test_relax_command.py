"""``protochain relax``: one file to one file, several to a folder, and what it says."""

import gzip
import json
import os
import re
import shutil
from dataclasses import replace
from pathlib import Path

import gemmi
import numpy as np
import pandas as pd
import pytest
from distributed import LocalCluster
from fixtures import models
from fixtures.command_line import refusal, refusal_as_said, run
from fixtures.samples import STRUCTURES, load
from fixtures.texts import explored
from scipy.spatial.transform import Rotation

import protochain as pc
from protochain.batches import BatchSettings, find_jobs
from protochain.batches.jobs import Job
from protochain.batches.page import SHOWN_RELAXED
from protochain.batches.table import COLUMNS as OF_MINIMISED
from protochain.batches.table import RELAXED_COLUMNS as OF_RELAXED
from protochain.batches.task import Task
from protochain.cli.relaxing import print_relaxed
from protochain.comparison.relaxed import viewer_scene, write_relaxed
from protochain.structure.write import as_text

pytestmark = pytest.mark.usefixtures("interruptible")


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("command", ["minimise", "relax"])
def test_single_terms_are_computed_only_if_they_are_shown(command, here, monkeypatch, capsys):
    def refuse(*arguments):
        raise AssertionError

    monkeypatch.setattr("protochain.minimisers.solution.terms_at", refuse)
    words = command, STRUCTURES / "ala10.pdb", "-o", here / "end.pdb", "--force"
    assert run(*words) == 0
    for shown in (["--json"], ["--report", here / "end.html"]):
        with pytest.raises(AssertionError):
            run(*words, *shown)


def test_a_ranked_model_is_named_as_colabfold_names_it_and_said_before_and_after(here, capsys):
    damaged = models.with_random_side_chains(load("1l2y.pdb"), seed=2)
    name = "x_unrelaxed_rank_001_alphafold2_ptm_model_1_seed_000.pdb"
    (here / name).write_text(as_text(damaged, ".pdb", hydrogens=False))
    assert run("relax", name, "--threads", 1) == 0
    said = capsys.readouterr()
    first, *warnings = said.err.splitlines()
    assert first.startswith(f"{name}: 20 residues, 304 atoms; about") and len(warnings) <= 6
    written = name.replace("unrelaxed", "relaxed")
    assert said.out.splitlines()[-1] == f"written: {written}" and (here / written).exists()
    assert "before" in said.out and "after" in said.out and "converged: RMS force" in said.out
    assert max(map(len, said.out.splitlines())) <= 80
    again = pc.load(here / written)
    assert pc.validate(again).measures["violations"] == 0


def test_what_makes_no_sense_is_refused_before_the_work(here):
    (here / "in").mkdir()
    shutil.copy(STRUCTURES / "1l2y.pdb", here / "in" / "a.pdb")
    for arguments, said in (
        (("in/a.pdb", "--resume"), "requires several inputs, not in/a.pdb"),
        (("in/a.pdb", "-o", "in/a.pdb"), "is the input"),
        (("in/a.pdb", "-o", "-", "--json"), "both go to standard output"),
        (("in/a.pdb", "--report", "page.txt"), "ends in .html"),
        (("in/a.pdb", "--preset", "weak"), "choose from predicted, crystal, design"),
        (("in/a.pdb", "--protocol", "alphafold", "--solvent", "gbn2"), "protocol alphafold is vacuum"),
        (("in", "--report", "page.html"), "have report.html in their folder"),
        (("in", "-o", "out.pdb"), "require an output folder"),
        (("none.pdb",), "none.pdb: not found"),
        (("in/*.cif",), "matches no file"),
    ):
        assert said in refusal("relax", *arguments), arguments
    assert sorted(path.name for path in here.rglob("*")) == ["a.pdb", "in"]


def test_a_folder_is_relaxed_with_a_row_for_each_and_resumed(here, capsys):
    """Packed, mmCIF, several models, and one broken file, which stops nothing."""
    (here / "in").mkdir()
    with gzip.open(here / "in" / "x_unrelaxed_rank_002_y.pdb.gz", "wt") as file:
        file.write((STRUCTURES / "1l2y.pdb").read_text())
    (here / "in" / "ala.cif").write_text(as_text(load("ala10.pdb"), ".cif"))
    (here / "in" / "broken.pdb").write_text("ATOM      1  N   ALA A   1\n")
    given = ("relax", "in", "-o", "out", "--workers", 1, "--solvent", "vacuum")
    assert run(*given) == 4
    said = capsys.readouterr().out
    assert "3 structures: 2 converged, 1 refused" in said and "broken: " in said
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
    capsys.readouterr()
    assert "--resume continues it" in refusal_as_said(*given)
    assert "replaced" not in capsys.readouterr().err
    assert "without stiffness, which is 100.0 now" in refusal(*given, "--resume", "--stiffness", 100)
    shutil.copy(STRUCTURES / "ala10.pdb", here / "in" / "new.pdb")
    assert run(*given, "--resume") == 4
    said = capsys.readouterr()
    assert "4 structures: 3 converged, 1 refused" in said.out and "replaced" not in said.err
    assert (here / "out" / "x_relaxed_rank_002_y.pdb").stat().st_mtime_ns == kept
    assert run("relax", "in/ala.cif", "in/new.pdb", *given[2:], "--force", "--verbose") == 0
    assert "relaxed.csv and " in capsys.readouterr().err
    assert len(pd.read_csv(here / "out" / "relaxed.csv")) == 2


@pytest.fixture(scope="module")
def predictions(tmp_path_factory):
    """As AlphaFold 3 leaves them, and files of one stem beside one another."""
    folder = tmp_path_factory.mktemp("predictions")
    for place in ("job/seed-1_sample-0/model.cif", "job/seed-1_sample-1/model.cif", "model.pdb"):
        (folder / place).parent.mkdir(parents=True, exist_ok=True)
        (folder / place).write_text(as_text(load("ala10.pdb"), Path(place).suffix))
    with gzip.open(folder / "model.pdb.gz", "wt") as file:
        file.write((folder / "model.pdb").read_text())
    return folder


@pytest.fixture(scope="module")
def cluster():
    """Dask's scheduler and a worker in threads of this process: address."""
    with LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, protocol="tcp", host="127.0.0.1",
        dashboard_address=None, memory_limit=0,
    ) as made:  # fmt: skip
        yield made.scheduler_address


@pytest.mark.usefixtures("worker_processes")
def test_a_batch_relaxes_beside_other_methods_as_relax_alone(predictions, cluster, here):
    given = {"solvent": "vacuum", "max_evaluations": 40, "stiffness": 2000}
    b = pc.batch(predictions, "out", "lbfgs,relax", scheduler=cluster, **given)
    table = b.table.set_index(["structure", "method"])
    names = ["job/seed-1_sample-0/model", "job/seed-1_sample-1/model", "model.pdb", "model.pdb.gz"]
    assert [*table.index] == [(name, method) for name in names for method in ("lbfgs", "relax")]
    assert {*b.table.columns} == {*OF_MINIMISED, *OF_RELAXED}
    of_relax = table.xs("relax", level="method")
    assert of_relax["output"].tolist() == [
        f"{name}.relaxed.{ending}" for name, ending in zip(names, ("cif", "cif", "pdb", "pdb"), strict=True)
    ]
    alone = pc.relax(predictions / "model.pdb", solvent="vacuum", stiffness=2000, threads=1)
    row = of_relax.loc["model.pdb"]
    assert row["status"] == "converged" and row["preset"] == "predicted"
    assert row["energy_end_reference_kj_mol"] == pytest.approx(alone.energy_end, rel=1e-9)
    assert float(row["springs_backbone_kj_mol_nm2"]) == 2000.0
    assert of_relax["n_rounds"].notna().all() and of_relax["n_hinges"].isna().all()
    for name, output in zip(names, table["output"].xs("lbfgs", level="method"), strict=True):
        page = (here / "out" / "pages" / f"{name}.html").read_text()
        # From where the page lies.
        links = re.findall('href="([^"]+)"', page)
        ends = {
            os.path.relpath((here / "out" / "pages" / f"{name}.html").parent / link, "out") for link in links
        }
        assert ends == {"report.html", output, of_relax.loc[name, "output"]}
        assert all((here / "out" / end).exists() for end in ends)
        assert f"pages/{name}.html" in explored(b.report.read_text())[1]
    points = b.traces.query("structure == 'model.pdb' and method == 'relax'")
    assert points["evaluations"].iloc[-1] <= row["evaluations"] and len(points) > 2
    assert json.loads((here / "out" / "summary.json").read_text())["settings"]["stiffness"] == 2000


def test_relax_takes_manifests_and_clusters_as_batch_does(predictions, cluster, here, capsys):
    sheet = predictions / "work.csv"
    sheet.write_text(
        "path,preset,stiffness,chain\njob/seed-1_sample-0/model.cif,crystal,,\n"
        "job/seed-1_sample-1/model.cif,,300,\nmodel.pdb,,,B\n"
    )
    given = ("relax", "--manifest", sheet, "--scheduler", cluster, "--solvent", "vacuum", "-o", "out")
    assert run(*given) == 4
    said = capsys.readouterr()
    assert "3 structures: 2 converged, 1 refused" in said.out and "model: " in said.out
    assert "[1 of 3] " in said.err and "violations 0 to 0" in said.err
    whole = pd.read_csv("out/relaxed.csv")
    table = whole.set_index("structure")
    one, two = (f"job/seed-1_sample-{k}/model" for k in range(2))
    assert [*table.index] == [one, two, "model"] and tuple(whole.columns) == OF_RELAXED
    assert table.loc[one, ["preset", "output"]].tolist() == ["crystal", f"{one}.relaxed.cif"]
    assert table.loc[two, "springs_backbone_kj_mol_nm2"] == 300.0
    assert table.loc["model", "status"] == "refused" and "B" in table.loc["model", "message"]
    # What is done is not done again, and one file is a folder's run where a cluster is named.
    before = (here / "out" / "relaxed.csv").read_bytes()
    assert run(*given, "--resume") == 4 and (here / "out" / "relaxed.csv").read_bytes() == before
    single = ("relax", predictions / "model.pdb", "--scheduler", cluster, "--solvent", "vacuum")
    assert run(*single) == 0 and (here / "relaxed" / "model.relaxed.pdb").exists()
    assert run("batch", predictions / "model.pdb", "--methods", "relax", "--preset", "crystal",
               "--solvent", "vacuum", "--scheduler", cluster, "-o", "batch") == 0  # fmt: skip
    said = capsys.readouterr().out
    assert "relax: 1 converged; residues with violations 0 before, 0 after; medians: RMSD" in " ".join(
        said.split()
    )
    assert tuple(pd.read_csv("batch/summary.csv").columns) == OF_RELAXED
    sheet.write_text("path,methods\nmodel.pdb,relax\nmodel.pdb,kcm\n")
    assert "methods kcm: relaxed.csv is for relax only" in refusal("relax", "--manifest", sheet)
    sheet.write_text("path,seed\nmodel.pdb,3\n")
    assert "line 2: seed: does not apply to relax" in refusal("relax", "--manifest", sheet)


def test_what_does_not_fit_a_pdb_file_is_written_as_mmcif(tmp_path):
    """Content decides what a file is, and here what it is written as, too."""
    long = gemmi.read_structure(str(STRUCTURES / "ala10.pdb"))
    long.rename_chain("A", "AB")
    long.make_mmcif_document().write_file(str(tmp_path / "long.pdb"))
    (job,) = find_jobs([tmp_path / "long.pdb"], BatchSettings(("relax",)).changed(solvent="vacuum"))
    (row,) = Task(job, tmp_path / "out").run(1)
    assert row.record["output"] == "long.relaxed.cif"
    assert {*pc.load(tmp_path / "out" / "long.relaxed.cif").residue_chain} == {"AB"}


def test_a_protocols_force_field_is_that_of_relax_alone(tmp_path):
    settings = BatchSettings(("relax", "lbfgs"), max_evaluations=5).changed(protocol="alphafold")
    (job,) = find_jobs([STRUCTURES / "ala10.pdb"], settings)
    rows = {row.record["method"]: row.record for row in Task(job, tmp_path).run(1)}
    assert (rows["relax"]["forcefield"], rows["relax"]["solvent"]) == ("amber99sb", "vacuum")
    assert (rows["lbfgs"]["forcefield"], rows["lbfgs"]["solvent"]) == ("amber14", "obc2")


def test_a_worker_elsewhere_finds_the_force_field(tmp_path, here):
    (here / "own.xml").write_text("<ForceField/>")
    settings = BatchSettings(("relax",)).changed(forcefield="amber14,own.xml")
    job = Job("x", tmp_path / "x.pdb", settings, "key")
    assert job.anywhere().settings.setup.forcefield == f"amber14,{here / 'own.xml'}"
    usual = replace(job, settings=BatchSettings(("relax",)))
    assert usual.anywhere() == usual


def test_the_page_tells_what_changed_in_a_table_and_a_figure(monkeypatch, tmp_path):
    figures = []
    monkeypatch.setattr(
        "protochain.comparison.relaxed.data_url", lambda figure: figures.append(figure) or "data:,"
    )
    r = pc.relax(load("ala10.pdb"), threads=1, solvent="vacuum")
    write_relaxed(r, r.record(), tmp_path / "page.html")
    (top, bottom), _ = (figure.axes for figure in figures)  # The second has classes of residues.
    told = [text.get_text() for text in top.get_legend().get_texts()]
    assert told == ["phi, psi, largest", "side chain, largest"]
    assert bottom.lines[0].get_ydata() == pytest.approx(r.displacements["displacement_angstrom"])
    page = (tmp_path / "page.html").read_text()
    found = pc.differences(r.start, r)
    assert f"<td>{found.totals['ca_rmsd_angstrom']:.3f}</td>" in page and np.isnan(
        found.totals["contacts_kept"]
    )
    assert "C-alpha RMSD of chain A, angstrom" in page and "rigid domains" in page


def test_a_motion_of_the_whole_changes_nothing_on_the_page():
    """The end is coloured by how far its atoms are from the start once both are superposed."""
    r = pc.relax(load("ala10.pdb"), threads=1, solvent="vacuum")
    turned = replace(r, x=r.x @ Rotation.from_rotvec([0.3, 1.0, -0.7]).as_matrix().T + [0.5, -1.0, 2.0])
    made = [viewer_scene(each) for each in (r, turned)]
    shown, high = [each["models"] for each in made], [each["colourings"][0]["high"] for each in made]
    atoms = [
        [(at.atom.pos.tolist(), at.atom.b_iso) for at in gemmi.read_pdb_string(models[1]["text"])[0].all()]
        for models in shown
    ]
    assert [away for _, away in atoms[0]] == pytest.approx([away for _, away in atoms[1]], abs=0.011)
    assert np.array([x for x, _ in atoms[0]]) == pytest.approx(np.array([x for x, _ in atoms[1]]), abs=0.0011)
    assert max(away for _, away in atoms[0]) > 0.1
    assert high[0] == pytest.approx(high[1])


def test_ligands_that_moved_farthest_are_printed_first(capsys):
    done = pc.relax(STRUCTURES / "ala10.pdb", max_iterations=1, threads=1, solvent="vacuum")
    ligands = [
        {
            "name": "LIG", "chain": "B", "residue": str(k), "rmsd_angstrom": 1.0,
            "displacement_max_angstrom": far,
        }
        for k, far in enumerate((0.5, 2.5, 0.25, 9.0, 1.5))
    ]  # fmt: skip
    print_relaxed(done, done.record() | {"output": "-", "ligands": ligands})
    shown = capsys.readouterr()
    assert re.findall(r"LIG B:(\d) ", shown.out + shown.err) == ["3", "1", "4"]
