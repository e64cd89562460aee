"""Many structures: what is found, that each is done as if alone, and that nothing stops or loses the rest."""

import io
import json
import os
import queue
from pathlib import Path

import numpy as np
import pandas as pd
import psutil
import pytest
from fixtures.samples import ROOT, STRUCTURES, chain, energy, load
from fixtures.waiting import HANG

import protochain as pc
from protochain.batches import BatchSettings, cluster, find_jobs, supervise
from protochain.batches.batch_settings import keep_settings
from protochain.batches.jobs import Row, failure, origin
from protochain.batches.page import curves, write_page
from protochain.batches.report import statistics, worst_first, write_report
from protochain.batches.supervise import Child
from protochain.batches.table import COLUMNS, TRACE_COLUMNS, Tables
from protochain.batches.task import run
from protochain.core.defaults import METHOD
from protochain.core.errors import WriteError
from protochain.core.storage import json_text
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

    result = pc.batch(
        folder, output, ("lbfgs", "kcm"), workers=1, model="all", max_evaluations=60, watch=watch
    )
    return result, seen, sockets


def _socket(connection):
    return connection.fd, connection.family, connection.laddr, connection.raddr


def test_inputs_are_found_in_order_and_once(folder, monkeypatch):
    names = ["1l2y", "cut", "deep/ala10", "two"]
    assert [job.name for job in find_jobs([folder], BatchSettings())] == names
    assert [job.name for job in find_jobs([folder / "two.pdb", folder], BatchSettings())] == [
        "two",
        *names[:3],
    ]
    assert [job.name for job in find_jobs([f"{folder}/**/*a*.pdb"], BatchSettings())] == ["deep/ala10"]
    for between in ("\n", "\r\n", "\n \n", "\0"):
        names_given = between.join([f"{folder}/cut.pdb", f"{folder}/deep", ""])
        monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(names_given.encode())))
        assert [job.name for job in find_jobs(["-"], BatchSettings())] == ["cut", "deep/ala10"]
    models = find_jobs([folder / "two.pdb", folder / "cut.pdb"], BatchSettings(setup=pc.Setup(model="all")))
    numbers = [(job.name, job.settings.setup.model) for job in models]
    assert numbers == [("two.1", 1), ("two.2", 2), ("cut", None)]
    for nothing in ([], [folder / "deep" / "nothing*.pdb"]):
        with pytest.raises(pc.ProtochainError, match=r"no structures found|matches no file"):
            find_jobs(nothing, BatchSettings())


def test_results_are_never_taken_for_inputs(folder, tmp_path):
    (tmp_path / "out").mkdir()
    for place in ("a.pdb", "out/a.lbfgs.pdb"):
        (tmp_path / place).write_bytes((STRUCTURES / "ala10.pdb").read_bytes())
    assert [job.name for job in find_jobs([tmp_path], BatchSettings(), output=tmp_path / "out")] == ["a"]
    with pytest.raises(pc.ProtochainError, match="folder of their own"):
        find_jobs([tmp_path / "out" / "a.lbfgs.pdb"], BatchSettings(), output=tmp_path / "out")
    with pytest.raises(pc.ProtochainError, match="folder of their own"):
        pc.batch(tmp_path / "a.pdb", tmp_path)
    (tmp_path / "out" / "summary.csv").write_text("method,status\nlbfgs,converged\n")
    with pytest.raises(pc.ProtochainError, match="not a table of a batch"):
        pc.batch(tmp_path / "a.pdb", tmp_path / "out", resume=True)


def test_a_key_is_of_content_and_settings(folder, tmp_path):
    (job,) = find_jobs([folder / "1l2y.pdb"], BatchSettings())
    copy = tmp_path / "1l2y.pdb"
    copy.write_bytes(job.path.read_bytes())
    assert find_jobs([copy], BatchSettings())[0].key == job.key
    assert find_jobs([copy], BatchSettings(seed=1))[0].key != job.key
    copy.write_bytes(job.path.read_bytes() + b"REMARK\n")
    assert find_jobs([copy], BatchSettings())[0].key != job.key
    copy.write_bytes(job.path.read_bytes())
    assert len({job.name for job in find_jobs([job.path, copy], BatchSettings())}) == 2


def test_a_key_is_of_the_force_fields_content_too(tmp_path):
    own = tmp_path / "own.xml"
    settings = BatchSettings(setup=pc.Setup(forcefield=str(own)))
    keys = []
    for text in ("<ForceField/>", "<ForceField></ForceField>", "<ForceField/>"):
        own.write_text(text)
        keys.append(find_jobs([STRUCTURES / "ala10.pdb"], settings)[0].key)
    assert keys[0] == keys[2] != keys[1]


def test_a_manifest_has_settings_of_its_own(folder, tmp_path):
    manifest = tmp_path / "work.csv"
    path = os.path.relpath(folder / "1l2y.pdb", tmp_path)
    manifest.write_text(f'path,methods,solvent,strict\n{path},"kcm, lbfgs",vacuum,yes\n{path},,,\n')
    first, second = find_jobs([], BatchSettings(seed=7), manifest)
    setup = pc.Setup(solvent="vacuum", strict=True)
    assert first.settings == BatchSettings(methods=("kcm", "lbfgs"), setup=setup, seed=7)
    assert second.settings == BatchSettings(seed=7) and first.key != second.key
    assert first.path.samefile(folder / "1l2y.pdb")
    for text, said in (
        ("file\nx\n", "no column 'path'"),
        ("path,colour\nx,red\n", r"work.csv: line 2: no setting is called 'colour'"),
        ("path,trust_forcefield\nx,yes\n", "no setting is called 'trust_forcefield'"),
        ("path,seed\nx,1\ny,many\n", "line 3: invalid literal"),
        ("path,strict\nx,maybe\n", "neither true nor false"),
        ("path\nx,1\n", "more cells than columns"),
        ("path,methods\nx,argparse:ArgumentParser\n", "line 2: methods: an import path runs code"),
        ('path,methods\nx,"kcm, argparse:ArgumentParser"\n', "an import path runs code"),
    ):
        manifest.write_text(text)
        with pytest.raises(pc.ProtochainError, match=said):
            find_jobs([], BatchSettings(), manifest)


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"methods": ()}, "at least one"), ({"methods": ("nope",)}, "'nope' is not known"),
        ({"tolerance": -1.0}, "tolerance"), ({"model": "first"}, "model"), ({"max_rmsd": -1.0}, "rmsd"),
    ],
)  # fmt: skip
def test_settings_that_make_no_sense_are_refused(settings, said):
    with pytest.raises(pc.ProtochainError, match=said):
        BatchSettings().changed(**settings)


def test_each_structure_ends_as_it_does_alone(done):
    table = done[0].table.set_index(["structure", "method"])
    for method in ("lbfgs", "kcm"):
        alone = pc.minimise(chain("1l2y.pdb"), energy("1l2y.pdb"), method, max_evaluations=60)
        row = table.loc[("1l2y", method)]
        assert row["energy_end_reference_kj_mol"] == alone.end.energy
        assert row["ca_rmsd_angstrom"] == alone.ca_rmsd_angstrom and row["status"] == str(alone.status)
        assert set(alone.record()) <= set(COLUMNS)
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
    for row in result.table.to_dict("records"):
        if row["status"] == "refused":
            continue
        assert f"{row['energy_end_reference_kj_mol']:.3f}" in page
        own = (result.folder / "pages" / f"{row['structure']}.html").read_text()
        assert f"{row['energy_end_reference_kj_mol']:.3f}" in own and row["message"] in own
        up = "../" * (1 + row["structure"].count("/"))
        assert f'href="{up}{row["output"]}"' in own and f'href="{up}report.html"' in own
    for row in pd.read_csv(result.folder / "statistics.csv").to_dict("records"):
        assert f"{row['median']:.3f}" in page or f"{row['median']:.0f}" in page
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
    with pytest.raises(pc.ProtochainError, match="holds a batch"):
        pc.batch(folder, tmp_path, "lbfgs")


def test_tables_are_of_one_writer_and_drop_what_is_stale(folder, tmp_path):
    one, two = find_jobs([folder / "1l2y.pdb", folder / "cut.pdb"], BatchSettings(methods=("lbfgs", "kcm")))
    tables = Tables(tmp_path, resume=False)
    with pytest.raises(pc.ProtochainError, match="another batch"):
        Tables(tmp_path, resume=True)
    tables.finished([])
    point = {"iteration": 0, "evaluations": 1, "seconds": 0.1, "energy_kj_mol": -1.0}
    for job in (two, one):
        rows = [failure(job, method, "refused", 'why,\n"so"') for method in job.settings.methods]
        tables.append([Row(row.record, [point]) for row in rows])
    tables.sort([one, two])
    assert tables.read()["structure"].tolist() == ["1l2y", "1l2y", "cut", "cut"]
    assert tables.read()["message"].tolist() == ['why, "so"'] * 4
    tables.close()
    resumed = Tables(tmp_path, resume=True)
    assert resumed.finished([one, two]) == {one.identity, two.identity}
    (changed,) = find_jobs([folder / "1l2y.pdb"], BatchSettings(methods=("lbfgs", "kcm"), seed=2))
    assert resumed.finished([changed]) == set()
    # Of a structure that is not asked about nothing is lost.
    assert resumed.read()["structure"].tolist() == ["cut", "cut"]
    rows = [failure(one, method, "time-limit", "late") for method in one.settings.methods]
    resumed.append(rows)
    assert resumed.finished([one, two]) == {two.identity}
    assert (tmp_path / "traces.csv").read_text().count("\n") == 3
    resumed.close()


@pytest.mark.parametrize(
    ("statuses", "is_finished"),
    [
        (("converged", "converged"), True), (("refused", "budget"), True), (("error", "clash"), True),
        (("converged", "interrupted"), False), (("killed", "converged"), False),
        (("converged", "time-limit"), False), (("converged",), False), ((), False),
    ],
)  # fmt: skip
def test_a_structure_is_finished_when_each_method_ended_by_itself(statuses, is_finished, tmp_path):
    (job,) = find_jobs([STRUCTURES / "ala10.pdb"], BatchSettings(methods=("lbfgs", "kcm")))
    tables = Tables(tmp_path, resume=False)
    tables.finished([])
    rows = [failure(job, *each, "why") for each in zip(job.settings.methods, statuses, strict=False)]
    if rows:
        tables.append([Row(row.record, [{"iteration": 0}]) for row in rows])
    assert tables.finished([job]) == ({job.identity} if is_finished else set())
    left = 2 if is_finished else 0
    assert len(tables.read()) == left and len(pd.read_csv(tables.traces)) == left
    tables.close()


@pytest.mark.parametrize(("lost", "ending"), [(1, ""), (30, ""), (30, "\n"), (300, ""), (300, "\n")])
def test_a_row_cut_short_is_discarded_with_its_structure(lost, ending, tmp_path):
    one, two = find_jobs([STRUCTURES / f"{name}.pdb" for name in ("ala10", "1l2y")], BatchSettings())
    tables = Tables(tmp_path, resume=False)
    tables.finished([])
    for job in (one, two):
        tables.append([failure(job, METHOD, "refused", 300 * "x")])
    text = tables.summary.read_text()
    tables.summary.write_text(text[:-lost] + ending)
    assert tables.finished([one, two]) == {one.identity}
    assert tables.read()["structure"].tolist() == ["ala10"]
    tables.close()


def test_a_time_limit_is_of_a_structure_not_of_a_method(tmp_path, monkeypatch):
    now = 0.0

    class Slow(queue.Queue):
        """Each message takes six seconds of a clock of its own."""

        def get(self, timeout):
            nonlocal now
            now += min(timeout, 6.0)
            if timeout < 6.0:
                raise queue.Empty
            return super().get(block=False)

    class Without(Child):
        """A child without a process."""

        threads, is_ready = 1, True

        def __init__(self):
            self.messages = Slow()

        def _send(self, message):
            for method in message[0].settings.methods:
                self.messages.put(failure(message[0], method, "converged", ""))

        def kill(self):
            pass

    monkeypatch.setattr("protochain.batches.supervise.perf_counter", lambda: now)
    (job,) = find_jobs([STRUCTURES / "ala10.pdb"], BatchSettings(methods=("lbfgs", "kcm", "hybrid")))
    rows = Without().do(job, tmp_path, time_limit=16.0)
    ends = [(row.record["method"], row.record["status"], row.record["seconds"]) for row in rows]
    assert ends == [("lbfgs", "converged", 0.0), ("kcm", "converged", 0.0), ("hybrid", "time-limit", 16.0)]


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
    rows = late.do(long, tmp_path, time_limit=HANG)
    assert [row.record["status"] for row in rows] == ["converged", "time-limit"]
    assert f"{HANG:g} s" in rows[1].record["message"] and not late.is_alive
    monkeypatch.undo()
    dying = After(lambda child: child.process.kill())
    rows = dying.do(long, tmp_path, time_limit=HANG)
    assert [row.record["status"] for row in rows] == ["converged", "killed"]
    assert "SIGKILL" in rows[-1].record["message"]
    child = Child(threads=1)
    assert [row.record["status"] for row in child.do(short, tmp_path, HANG)] == ["converged"]
    child.kill()


def test_a_child_does_not_outlive_its_worker(folder, tmp_path):
    (long,) = find_jobs([STRUCTURES / "1hel.pdb"], BatchSettings(methods=("kcm",), max_evaluations=10**9))
    child = Child(threads=1)
    child._send((long, tmp_path, 1))
    child.process.stdin.close()
    assert child.process.wait(timeout=HANG) == 0
    child.kill()
    said = [child.messages.get(block=False) for _ in range(child.messages.qsize())]
    assert not [each for each in said if isinstance(each, Row)], "it went on to the end of its job"


def test_a_bug_or_full_memory_is_a_row(folder, tmp_path, monkeypatch):
    (job,) = find_jobs([folder / "deep"], BatchSettings(methods=("lbfgs", "kcm")))
    for error, status, said in (
        (MemoryError(), "killed", "out of memory"),
        (ZeroDivisionError("oh\nno"), "error", "ZeroDivisionError: oh no"),
        (WriteError("a.pdb", "full", "", "free some"), "killed", "a.pdb: not written (full); free some"),
    ):

        def fail(*args, error=error, **kwargs):
            raise error

        monkeypatch.setattr("protochain.minimisers.minimise", fail)
        rows = list(run(job, tmp_path, 1))
        assert [row.record["method"] for row in rows] == ["lbfgs", "kcm"]
        assert {(row.record["status"], row.record["message"]) for row in rows} == {(status, said)}


def test_ends_are_compared_with_openmms(folder, tmp_path):
    (job,) = find_jobs([folder / "deep"], BatchSettings(methods=("lbfgs", "openmm"), max_evaluations=300))
    rows = {row.record["method"]: row.record for row in run(job, tmp_path, 1)}
    ends = {name: pc.load(tmp_path / f"ala10.{name}.pdb") for name in rows}
    apart = pc.ca_rmsd(ends["lbfgs"], ends["lbfgs"].positions, ends["openmm"].positions)
    assert rows["lbfgs"]["ca_rmsd_to_openmm_angstrom"] == pytest.approx(apart, abs=2e-3)
    assert "ca_rmsd_to_openmm_angstrom" not in rows["openmm"]


def test_names_are_escaped_on_pages(tmp_path):
    path = tmp_path / f"{EVIL.replace('/', '|')}.pdb"
    path.write_bytes((STRUCTURES / "ala10.pdb").read_bytes())
    (job,) = find_jobs([path], BatchSettings(methods=("lbfgs",), max_evaluations=3))
    list(run(job, tmp_path, 1))
    (page,) = (tmp_path / "pages").iterdir()
    assert "<script>" not in page.read_text() and "&lt;script&gt;" in page.read_text()


def test_messages_are_escaped_on_pages(tmp_path):
    (job,) = find_jobs([STRUCTURES / "ala10.pdb"], BatchSettings(methods=("lbfgs",)))
    row = failure(job, "lbfgs", "refused", EVIL)
    tables = Tables(tmp_path, resume=False)
    tables.finished([])
    tables.append([row])
    summary = {"n_structures": 1, "command": [EVIL], "python": "3", "versions": {}}
    write_page(tmp_path, job, [row], [EVIL])
    write_report(tmp_path, tables.read(), summary)
    tables.close()
    for page in (tmp_path / "pages" / "ala10.html", tmp_path / "report.html"):
        text = page.read_text()
        assert EVIL not in text and text.count("&lt;script&gt;alert(1)&lt;/script&gt;") == 2


def test_a_structures_page_shows_all_columns_with_a_heading(tmp_path):
    (job,) = find_jobs([STRUCTURES / "ala10.pdb"], BatchSettings(methods=("lbfgs",)))
    headed = [column for column in record.COLUMNS if column.heading]
    values = {column.key: k + 0.25 for k, column in enumerate(headed)}
    write_page(tmp_path, job, [Row(values | {"message": ""}, [])], [])
    page = (tmp_path / "pages" / "ala10.html").read_text()
    for k, column in enumerate(headed):
        assert column.key in COLUMNS and f">{column.title}</th>" in page and f">{k}.250</td>" in page


def test_worst_cases_come_first_and_quartiles_are_of_results():
    table = pd.DataFrame(
        {
            "structure": list("abcde"),
            "method": "lbfgs",
            "status": ["converged", "converged", "budget", "refused", "converged"],
            "energy_start_kj_mol": [0.0, 0.0, 0.0, np.nan, 0.0],
            "energy_end_reference_kj_mol": [-10.0, -20.0, -30.0, np.nan, -40.0],
            "n_residues": [10.0, 10.0, 10.0, np.nan, 10.0],
            "ca_rmsd_angstrom": [0.1, 0.5, 0.2, np.nan, 0.3],
            "ca_rmsd_to_openmm_angstrom": np.nan,
            "evaluations": [1.0, 2.0, 3.0, np.nan, 4.0],
            "seconds": [1.0, 1.0, 1.0, 99.0, 1.0],
        }
    )
    assert worst_first(table)["structure"].tolist() == ["d", "c", "b", "e", "a"]
    rows = statistics(table).set_index("quantity")
    assert rows.loc["energy_drop_kj_mol_per_residue", "median"] == 2.5
    assert rows.loc["seconds", "highest"] == 1.0 and "ca_rmsd_to_openmm_angstrom" not in rows.index


def test_a_curve_falls_from_corner_to_corner():
    trace = [{"evaluations": e, "energy_kj_mol": v} for e, v in ((0, 5.0), (1, 3.0), (10, 4.0), (100, 1.0))]
    drawn = curves([Row({"method": "kcm"}, trace), Row({"method": "none"}, [])])
    assert (drawn["low"], drawn["high"], drawn["most"]) == (1.0, 5.0, 100)
    assert drawn["lines"] == {"kcm": "0.0,0.0 0.0,120.0 320.0,120.0 640.0,240.0"}
    assert curves([])["lines"] == {}


def test_a_cluster_that_is_not_there_is_named_and_keeps_no_folder(folder, tmp_path, monkeypatch):
    (tmp_path / "there").mkdir()
    monkeypatch.setattr(cluster, "_PATIENCE", 0.5)
    for output in (tmp_path / "there", tmp_path / "new" / "deep"):
        with pytest.raises(pc.ProtochainError, match="no cluster answers"):
            pc.batch(folder, output, scheduler="tcp://127.0.0.1:9")
    assert list(tmp_path.rglob("*")) == [tmp_path / "there"]


def test_a_failed_start_leaves_an_earlier_batch_as_it_is(folder, tmp_path, monkeypatch):
    tables = Tables(tmp_path, resume=False)
    (job,) = find_jobs([folder / "1l2y.pdb"], BatchSettings())
    tables.finished([job])
    tables.append([Row(origin(job) | {"method": METHOD, "status": "converged"}, [])])
    tables.close()
    # As the batch itself does, before any result.
    rows = (tmp_path / "summary.csv").read_bytes()
    (tmp_path / "summary.csv").unlink()
    keep_settings(tmp_path, BatchSettings(), [job])
    (tmp_path / "summary.csv").write_bytes(rows)
    monkeypatch.setattr(cluster, "_PATIENCE", 0.5)
    with pytest.raises(pc.ProtochainError, match="no cluster answers"):
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


def test_what_is_written_as_json_has_no_infinity():
    values = {"max_rmsd": np.inf, "deep": [{"x": -np.inf}, (np.nan, 1.5)], "path": Path("a"), "n": 3}
    assert json.loads(json_text(values), parse_constant=pytest.fail) == {
        "max_rmsd": None, "deep": [{"x": None}, [None, 1.5]], "path": "a", "n": 3,
    }  # fmt: skip


@pytest.mark.parametrize("options", [{"workers": 0}, {"threads": 0}, {"time_limit": 0.0}, {"colour": "red"}])
def test_options_that_make_no_sense_are_refused_before_any_work(options, folder, tmp_path):
    with pytest.raises(pc.ProtochainError, match=r"numbers above 0|no setting is called 'colour'"):
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
        damaged.write_text("a,b\n1,2\n")
        before = {path.name: path.read_bytes() for path in out.iterdir() if path.is_file()}
        with pytest.raises(pc.ProtochainError, match="is not a table of a batch"):
            pc.batch(tmp_path, output=out, methods=("lbfgs",), max_evaluations=2, workers=1, resume=True)
        assert {path.name: path.read_bytes() for path in out.iterdir() if path.is_file()} == before
        damaged.write_bytes(whole)


def test_records_count_residues_of_the_protein_alone():
    """As the terminal does: waters and ligands beside it are no residues of it."""
    structure = load("1ejg.pdb")
    assert structure.n_protein_residues == 46
    kept = pc.load(STRUCTURES / "1hel.pdb", keep="all")
    assert kept.n_residues > kept.n_protein_residues == 129
    solution = pc.minimise(kept, method="lbfgs", max_evaluations=1)
    assert solution.record()["n_residues"] == 129
