"""Many structures: what is found, that each is done as if alone, and that nothing stops or loses the rest."""

import csv
import json
import os
import re
from pathlib import Path

import numpy as np
import pandas as pd
import psutil
import pytest
from fixtures.jobs import jobs_in_processes
from fixtures.refusals import expect_refusal
from fixtures.samples import ROOT, STRUCTURES, chain, energy, load
from fixtures.texts import explored
from fixtures.waiting import HANG

import protochain as pc
from protochain.batches import BatchSettings, cluster, find_jobs, supervise
from protochain.batches.batch_settings import store_settings
from protochain.batches.jobs import Row, failure, origin
from protochain.batches.page import write_page
from protochain.batches.report import write_report
from protochain.batches.supervise import Child
from protochain.batches.table import COLUMNS, TRACE_COLUMNS, Tables
from protochain.batches.task import Task
from protochain.core.defaults import METHOD
from protochain.minimisers import record

CUT = "ATOM      1  N   ALA A   1      11.104   6.134  -6.504  1.00  0.00           N\n"
EVIL = "<script>alert(1)</script>"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Inputs: two structures, one with two models, one that is cut short, one with an evil name."""
    folder = tmp_path_factory.mktemp("inputs")
    (folder / "deep").mkdir()
    (folder / "deep" / "ala10.pdb").write_bytes((STRUCTURES / "ala10.pdb").read_bytes())
    (folder / "1l2y.pdb").write_bytes((STRUCTURES / "1l2y.pdb").read_bytes())
    (folder / "cut.pdb").write_text(CUT)
    (folder / "notes.txt").write_text("not a structure")
    shaken = [load("ala10.pdb"), load("ala10.pdb").with_positions(load("ala10.pdb").positions * 1.001)]
    text = ""
    for k, s in enumerate(shaken, 1):
        pc.save(s, folder / "one.pdb")
        lines = (folder / "one.pdb").read_text().splitlines()
        atoms = "\n".join(line for line in lines if line.startswith(("ATOM", "TER")))
        text += f"MODEL     {k:4}\n{atoms}\nENDMDL\n"
    (folder / "one.pdb").unlink()
    (folder / "two.pdb").write_text(text + "END\n")
    return folder


@pytest.fixture(scope="module")
def done(folder, tmp_path_factory):
    """All of it by two methods, in one worker; and what sockets the processes had meanwhile, by process."""
    output = tmp_path_factory.mktemp("batch")
    seen, sockets = [], {}
    own = psutil.Process()
    before = set(map(_socket, own.net_connections("all")))

    def watch(progress):
        seen.append(progress)
        for process in (own, *own.children(recursive=True)):
            opened = {*map(_socket, process.net_connections("all"))} - before
            sockets.setdefault(process.pid, set()).update(opened)

    with jobs_in_processes():
        result = pc.batch(
            folder, output, ("lbfgs", "kcm"), workers=1, model="all", max_evaluations=60, watch=watch
        )
    return result, seen, sockets


def _socket(connection):
    return connection.fd, connection.family, connection.laddr, connection.raddr


def test_each_structure_ends_as_it_does_alone(done):
    table = done[0].table.set_index(["structure", "method"])
    for method in ("lbfgs", "kcm"):
        alone = pc.minimise(chain("1l2y.pdb"), energy("1l2y.pdb"), method, max_evaluations=60)
        row = table.loc[("1l2y", method)]
        assert row["energy_end_reference_kj_mol"] == alone.end.energy
        assert row["ca_rmsd_angstrom"] == alone.ca_rmsd_angstrom and row["status"] == str(alone.status)
        assert set(alone.record()) - {"timings", "restraint_violations"} <= set(COLUMNS)
        written = pc.load(done[0].folder / row["output"])
        assert np.abs(written.positions - alone.x).max() < 1e-4
        points = done[0].traces.query(f"structure == '1l2y' and method == '{method}'")
        assert points["energy_kj_mol"].iloc[0] == alone.trace["energy_kj_mol"].iloc[0]
        assert points["evaluations"].iloc[-1] == alone.trace["evaluations"].iloc[-1]
        assert len(points) <= 50


def test_what_fails_is_a_row_and_all_else_is_done(done):
    result, seen, _ = done
    table = result.table
    names = ["1l2y", "cut", "deep/ala10", "two.1", "two.2"]
    assert table["structure"].tolist() == [name for name in names for _ in range(2)]
    assert table["method"].tolist() == ["lbfgs", "kcm"] * 5
    bad = table[table["structure"] == "cut"]
    assert (bad["status"] == "refused").all() and bad["output"].isna().all()
    assert bad["message"].str.contains("cut.pdb").all()
    assert table[table["structure"] != "cut"]["output"].notna().all()
    assert [(p.done, p.total, p.skipped) for p in seen] == [(k, 5, 0) for k in range(1, 6)]
    assert seen[-1].failed == 1


def test_nobody_can_reach_the_processes_of_a_batch_on_this_machine(done):
    """Whoever may talk to a worker runs any code as its user: they have pipes, and no sockets."""
    assert len(done[2]) > 1 and not set().union(*done[2].values())


def test_the_summary_is_json(done):
    text = (done[0].folder / "summary.json").read_text()
    assert json.loads(text, parse_constant=pytest.fail)["settings"]["max_rmsd"] is None


def test_the_folder_holds_one_truth(done):
    result = done[0]
    parquet = pd.read_parquet(result.folder / "summary.parquet")
    pd.testing.assert_frame_equal(parquet, result.table, check_dtype=False)
    assert tuple(result.table.columns) == COLUMNS and tuple(result.traces.columns) == TRACE_COLUMNS
    page = result.report.read_text()
    shown, _ = explored(page)
    for row in result.table.to_dict("records"):
        if row["status"] == "refused":
            continue
        assert pytest.approx(row["energy_end_reference_kj_mol"], rel=1e-5) in shown
        own = (result.folder / "pages" / f"{row['structure']}.html").read_text()
        assert f"{row['energy_end_reference_kj_mol']:.3f}" in own and row["message"] in own
        up = "../" * (1 + row["structure"].count("/"))
        assert f'href="{up}{row["output"]}"' in own and f'href="{up}report.html"' in own
    assert "http://" not in page.replace("http://127.0.0.1", "")


def test_resuming_skips_what_is_finished_and_redoes_what_is_not(folder, done, tmp_path):
    first = pc.batch(
        [folder / "1l2y.pdb", folder / "cut.pdb"], tmp_path, "lbfgs", workers=1, max_evaluations=60
    )
    before = (tmp_path / "summary.csv").read_text()
    seen = []
    again = {"workers": 1, "max_evaluations": 60, "resume": True, "watch": seen.append}
    pc.batch([folder / "1l2y.pdb", folder / "cut.pdb"], tmp_path, "lbfgs", **again)
    assert not seen and (tmp_path / "summary.csv").read_text() == before
    # A row cut off in the middle, and a structure added: both are done, and nothing else.
    summary = tmp_path / "summary.csv"
    summary.write_text(before[:-30])
    result = pc.batch([folder / "1l2y.pdb", folder / "cut.pdb", folder / "deep"], tmp_path, "lbfgs", **again)
    assert [p.skipped for p in seen] == [1, 1]
    assert result.table["structure"].tolist() == ["1l2y", "cut", "deep/ala10"]
    assert result.table["energy_end_kj_mol"].iloc[0] == first.table["energy_end_kj_mol"].iloc[0]
    with expect_refusal("resume", "force", match="contains a batch"):
        pc.batch(folder, tmp_path, "lbfgs")


def test_a_batch_replaces_another_with_other_settings_if_it_is_asked_to(tmp_path):
    """Not one that is resumed; where nothing can be done, what is there stays."""
    files = [str(STRUCTURES / name) for name in ("ala10.pdb", "1l2y.pdb")]
    few = {"workers": 1, "max_evaluations": 3, "solvent": "vacuum"}
    pc.batch(files, tmp_path, "lbfgs", **few)
    with pytest.raises(pc.ProtochainError, match="max_evaluations"):
        pc.batch(files, tmp_path, "lbfgs", resume=True, force=True, **few | {"max_evaluations": 4})
    with pytest.raises(pc.ProtochainError):
        pc.batch(tmp_path / "none.pdb", tmp_path, "lbfgs", force=True, **few)
    assert len(pd.read_csv(tmp_path / "summary.csv")) == 2
    done = pc.batch(files[:1], tmp_path, "lbfgs", force=True, **few | {"max_evaluations": 4})
    assert done.table["structure"].tolist() == ["ala10"]
    assert json.loads((tmp_path / "settings.json").read_text())["settings"]["max_evaluations"] == 4


class After(Child):
    """A child to which something happens once its first row has come."""

    def __init__(self, happens):
        super().__init__(threads=1)
        self.happens = happens

    def _next(self, deadline, late):
        message = super()._next(deadline, late)
        if isinstance(message, Row):
            self.happens(self)
        return message


def test_a_hang_a_death_and_an_odd_file_end_one_job_each(folder, tmp_path, monkeypatch):
    (long,) = find_jobs(
        [STRUCTURES / "1l2y.pdb"], BatchSettings(methods=("lbfgs", "kcm"), max_evaluations=10**9)
    )
    (short,) = find_jobs([folder / "deep"], BatchSettings(methods=("lbfgs",), max_evaluations=20))
    late = After(lambda child: monkeypatch.setattr(supervise, "perf_counter", lambda: 1e9))
    rows = late.do(Task(long.anywhere(), tmp_path), time_limit=HANG)
    assert [row.record["status"] for row in rows] == ["converged", "time-limit"]
    assert f"{HANG:g} s" in rows[1].record["message"] and not late.is_alive
    monkeypatch.undo()
    dying = After(lambda child: child.process.kill())
    rows = dying.do(Task(long.anywhere(), tmp_path), time_limit=HANG)
    assert [row.record["status"] for row in rows] == ["converged", "killed"]
    assert "SIGKILL" in rows[-1].record["message"]
    child = Child(threads=1)
    assert [row.record["status"] for row in child.do(Task(short.anywhere(), tmp_path), HANG)] == ["converged"]
    child.kill()


def test_a_child_does_not_outlive_its_worker(folder, tmp_path):
    (long,) = find_jobs([STRUCTURES / "1hel.pdb"], BatchSettings(methods=("kcm",), max_evaluations=10**9))
    child = Child(threads=1)
    child._send((Task(long.anywhere(), tmp_path), 1))
    child.process.stdin.close()
    assert child.process.wait(timeout=HANG) == 0
    child.kill()
    said = [child.messages.get(block=False) for _ in range(child.messages.qsize())]
    assert not [each for each in said if isinstance(each, Row)], "it went on to the end of its job"


def test_messages_are_escaped_on_pages(tmp_path):
    (job,) = find_jobs([STRUCTURES / "ala10.pdb"], BatchSettings(methods=("lbfgs",)))
    row = failure(job, "lbfgs", "refused", EVIL)
    tables = Tables(tmp_path, resume=False)
    tables.select_finished([])
    tables.append([row])
    summary = {"n_structures": 1, "command": [EVIL], "python": "3", "versions": {}}
    write_page(tmp_path, job, [row], [EVIL])
    write_report(tmp_path, tables.read(), summary)
    tables.close()
    for page in (tmp_path / "pages" / "ala10.html", tmp_path / "report.html"):
        text = page.read_text()
        # As HTML has it, and as JSON in it has it.
        shown = re.findall(r"(?:&lt;|\\u003c)script(?:&gt;|\\u003e)alert\(1\)(?:&lt;|\\u003c)/script", text)
        assert EVIL not in text and len(shown) == 2


def test_a_structures_page_shows_all_columns_with_a_heading(tmp_path):
    (job,) = find_jobs([STRUCTURES / "ala10.pdb"], BatchSettings(methods=("lbfgs",)))
    headed = [column for column in record.COLUMNS if column.heading]
    values = {column.key: k + 0.25 for k, column in enumerate(headed)}
    write_page(tmp_path, job, [Row(values | {"message": ""}, [])], [])
    page = (tmp_path / "pages" / "ala10.html").read_text()
    for k, column in enumerate(headed):
        assert column.key in COLUMNS and f">{column.title}</th>" in page and f">{k}.250</td>" in page


def test_a_cluster_that_is_not_there_is_named_and_keeps_no_folder(folder, tmp_path, monkeypatch):
    (tmp_path / "there").mkdir()
    monkeypatch.setattr(cluster, "_PATIENCE", 0.5)
    for output in (tmp_path / "there", tmp_path / "new" / "deep"):
        with pytest.raises(pc.ProtochainError, match="no cluster responds"):
            pc.batch(folder, output, scheduler="tcp://127.0.0.1:9")
    assert list(tmp_path.rglob("*")) == [tmp_path / "there"]


def test_a_failed_start_leaves_an_earlier_batch_as_it_is(folder, tmp_path, monkeypatch):
    tables = Tables(tmp_path, resume=False)
    (job,) = find_jobs([folder / "1l2y.pdb"], BatchSettings())
    tables.select_finished([job])
    tables.append([Row(origin(job) | {"method": METHOD, "status": "converged"}, [])])
    tables.close()
    # As the batch itself does, before any result.
    rows = (tmp_path / "summary.csv").read_bytes()
    (tmp_path / "summary.csv").unlink()
    store_settings(tmp_path, BatchSettings(), [job])
    (tmp_path / "summary.csv").write_bytes(rows)
    monkeypatch.setattr(cluster, "_PATIENCE", 0.5)
    with pytest.raises(pc.ProtochainError, match="no cluster responds"):
        pc.batch(folder, tmp_path, resume=True, scheduler="tcp://127.0.0.1:9")
    assert "converged" in (tmp_path / "summary.csv").read_text()


def test_a_batch_over_nothing_writes_nothing(tmp_path):
    (tmp_path / "empty").mkdir()
    (tmp_path / "list.csv").write_text("path\nnone.pdb\n")
    for given, options in (
        (tmp_path / "empty", {}),
        ([tmp_path / "none.pdb", tmp_path / "nor.cif"], {}),
        ((), {"manifest": tmp_path / "list.csv"}),
        ((), {"manifest": tmp_path / "none.csv"}),
    ):
        with pytest.raises(pc.ProtochainError, match=r"no structures found|none\.\w+: not found"):
            pc.batch(given, tmp_path / "out", workers=1, **options)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("options", [{"workers": 0}, {"threads": 0}, {"time_limit": 0.0}, {"colour": "red"}])
def test_options_that_make_no_sense_are_refused_before_any_work(options, folder, tmp_path):
    with pytest.raises(pc.ProtochainError, match=r"at least 1|above 0|no setting is called 'colour'"):
        pc.batch(folder, tmp_path / "new", **options)
    assert not (tmp_path / "new").exists() and ROOT.exists()


def test_a_name_that_is_no_utf_8_is_refused_and_stops_no_other(tmp_path, monkeypatch):
    """Names of files are bytes of any kind; tables and pages are UTF-8."""
    monkeypatch.chdir(tmp_path)
    text = (STRUCTURES / "ala10.pdb").read_bytes()
    for name in (b"b.pdb", b"a\xff.pdb"):
        Path(os.fsdecode(name)).write_bytes(text)
    with pytest.raises(pc.ProtochainError, match="its name is not UTF-8"):
        pc.load(os.fsdecode(b"a\xff.pdb"))
    with pytest.raises(pc.ProtochainError, match="its name is not UTF-8; give another"):
        pc.batch("b.pdb", os.fsdecode(b"\xff"), "lbfgs", workers=1, max_evaluations=5)
    done = pc.batch([os.fsdecode(b"a\xff.pdb"), "b.pdb"], "out", "lbfgs", workers=1, max_evaluations=5)
    assert dict(zip(done.table["structure"], done.table["status"], strict=True)) == {
        r"a\udcff": "refused", "b": "budget",
    }  # fmt: skip
    assert done.report.exists()


def test_a_damaged_table_is_refused_before_anything_is_written(tmp_path):
    for name in ("one", "two"):
        pc.save(load("ala10.pdb"), tmp_path / f"{name}.pdb")
    out = tmp_path / "out"
    pc.batch(tmp_path / "one.pdb", output=out, methods=("lbfgs",), max_evaluations=2, workers=1)
    for damaged in (out / "summary.csv", out / "traces.csv"):
        whole = damaged.read_bytes()
        damaged.write_bytes(whole.replace(b"structure", b"s\xe0ructure", 1))
        before = {path.name: path.read_bytes() for path in out.iterdir() if path.is_file()}
        with pytest.raises(pc.ProtochainError, match="is not a table of a batch"):
            pc.batch(tmp_path, output=out, methods=("lbfgs",), max_evaluations=2, workers=1, resume=True)
        assert {path.name: path.read_bytes() for path in out.iterdir() if path.is_file()} == before
        damaged.write_bytes(whole)


@pytest.mark.parametrize(
    ("table", "column"),
    [
        ("summary", "energy_end_kj_mol"),
        ("summary", "iterations"),
        ("summary", "n_atoms"),
        ("traces", "seconds"),
    ],
)
def test_rows_whose_numbers_are_damaged_are_made_again_or_left_out(table, column, tmp_path):
    pc.save(load("ala10.pdb"), tmp_path / "one.pdb")

    def run(**more):
        return pc.batch(tmp_path / "one.pdb", tmp_path / "out", "lbfgs", max_evaluations=2, workers=1, **more)

    run()
    path = tmp_path / "out" / f"{table}.csv"
    rows = list(csv.reader(path.read_text().splitlines()))
    at = rows[0].index(column)
    rows[1][at] = f"x{float(rows[1][at])}"
    with path.open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(rows)
    done = run(resume=True)
    assert list(done.table["status"]) == ["budget"] and np.isfinite(done.table["energy_end_kj_mol"]).all()
    assert np.isfinite(done.traces["seconds"].astype(float)).all()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('path\n"a.pdb\nb.pdb\n', "line 3: its path has control characters"),
        ("path\na.pdb\n\x00.pdb\n", "line 3: its path has control characters"),
        ("path\na.pdb\n", "a.pdb: not found"),
    ],
)
def test_names_of_a_manifest_that_can_be_of_no_file_are_refused_with_its_name(text, said, tmp_path):
    path = tmp_path / "list.csv"
    path.write_text(text)
    with pytest.raises(pc.ProtochainError, match=f"list.csv: .*{said}"):
        pc.batch((), manifest=path, output=tmp_path / "out")
