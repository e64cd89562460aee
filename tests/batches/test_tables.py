"""Tables of a batch: which rows are there, in what order, and what is drawn from them."""

import csv
import json
import os
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from fixtures.repairs import noted
from fixtures.samples import load
from matplotlib.image import imread

import protochain as pc
from protochain.batches.frame_files import FramesRun
from protochain.batches.jobs import BatchSettings, Job, Row, failure
from protochain.batches.page import HEIGHT, WIDTH, curves, write_page
from protochain.batches.report import worst_first, write_report
from protochain.batches.table import COLUMNS, TRACE_COLUMNS, Tables, read_table
from protochain.core import storage
from protochain.results.columns import energies_by_term

TWO = BatchSettings(methods=("lbfgs", "kcm"))
JOBS = [Job(name, Path(f"/in/{name}.pdb"), TWO, f"key-{name}") for name in ("one", "two", "three")]


def line(job, method, status="refused", message="why", key=None, seconds="0.0"):
    """A row of summary.csv, as a failure has it."""
    cells = dict.fromkeys(COLUMNS, "") | {
        "structure": job.name, "input": str(job.path), "key": key or job.key, "method": method,
        "status": status, "message": message, "seconds": seconds,
    }  # fmt: skip
    return ",".join(cells.values()) + "\n"


def point(job, method, iteration=0):
    """A row of traces.csv."""
    cells = dict.fromkeys(TRACE_COLUMNS, "0.5") | {
        "structure": job.name, "method": method, "iteration": str(iteration), "key": job.key,
        "evaluations": "1",
    }  # fmt: skip
    return ",".join(cells.values()) + "\n"


def header(columns):
    return ",".join(columns) + "\n"


def rows(job, status="refused", n_points=1):
    trace = [
        {"iteration": k, "evaluations": 1, "seconds": 0.5, "energy_kj_mol": -1.0,
         "rms_torque_kj_mol_rad": 0.5, "max_torque_kj_mol_rad": 2.0, "rms_force_kj_mol_nm": 1.5,
         "max_force_kj_mol_nm": 4.0, "ca_rmsd_angstrom": 0.25, "more": 3} for k in range(n_points)
    ]  # fmt: skip
    return [Row(failure(job, method, status, "why").record, trace) for method in TWO.methods]


@pytest.fixture
def tables(tmp_path):
    made = Tables(tmp_path / "new" / "out", resume=False)
    made.select_finished([])
    yield made
    made.close()


def read(path, columns):
    """Rows of a table as text, whose header is these columns."""
    first, *rows = csv.reader(path.read_text().splitlines())
    assert tuple(first) == columns
    return [dict(zip(columns, row, strict=True)) for row in rows]


def runs(tables):
    """Structure and method of each row of summary.csv."""
    return [(row["structure"], row["method"]) for row in read(tables.summary, COLUMNS)]


def steps(tables):
    """Structure, method and iteration of each row of traces.csv."""
    rows = read(tables.traces, TRACE_COLUMNS)
    return [(row["structure"], row["method"], int(row["iteration"])) for row in rows]


def test_rows_are_appended_after_a_header_and_sorted_by_job_and_method(tables):
    assert runs(tables) == steps(tables) == []
    one, two, three = JOBS
    tables.append(rows(two, n_points=2))
    tables.append(reversed(rows(one)))
    assert runs(tables) == [("two", "lbfgs"), ("two", "kcm"), ("one", "kcm"), ("one", "lbfgs")]
    of_two = [("two", method, k) for method in ("lbfgs", "kcm") for k in (0, 1)]
    assert steps(tables) == [*of_two, ("one", "kcm", 0), ("one", "lbfgs", 0)]
    written = read(tables.summary, COLUMNS)[0]
    given = failure(two, "lbfgs", "refused", "why").record
    assert {name: written[name] for name in given} == {name: str(value) for name, value in given.items()}
    trace = read(tables.traces, TRACE_COLUMNS)[1]
    point_given = rows(two, n_points=2)[0].trace[1]
    assert all(float(trace[name]) == value for name, value in point_given.items() if name in trace)
    # Rows of what is not asked about come last.
    tables.sort([three, one])
    assert runs(tables) == [("one", "lbfgs"), ("one", "kcm"), ("two", "lbfgs"), ("two", "kcm")]
    assert steps(tables) == [("one", "lbfgs", 0), ("one", "kcm", 0), *of_two]


def test_files_are_closed_after_each_append(tables, monkeypatch):
    opened, open_file = [], os.open

    def noted(*given):
        opened.append(open_file(*given))
        return opened[-1]

    with monkeypatch.context() as patch:
        patch.setattr(os, "open", noted)
        tables.append(rows(JOBS[0]))
    assert len(opened) == 2
    for number in opened:
        with pytest.raises(OSError):
            os.fstat(number)


def test_resuming_keeps_whole_rows_of_the_same_input_with_their_traces(tables):
    one, two, three = JOBS
    stranger = Job("four", Path("/in/four.pdb"), TWO, "key-four")
    summary = [
        line(one, "kcm"), line(one, "lbfgs"),  # finished
        line(two, "lbfgs"),  # a method is missing
        line(three, "lbfgs", key="old"), line(three, "kcm", key="old"),  # of another content
        line(stranger, "lbfgs", "killed"),  # not asked about
    ]  # fmt: skip
    tables.summary.write_text(header(COLUMNS) + "".join(summary) + line(three, "lbfgs")[:-5])
    traces = [point(job, "lbfgs") for job in (two, one, stranger, three)]
    tables.traces.write_text(header(TRACE_COLUMNS) + "".join(traces) + "one,lbfgs\n" + point(one, "kcm")[:-1])
    assert tables.select_finished(JOBS) == {("one", "key-one")}
    assert tables.summary.read_text() == header(COLUMNS) + "".join(summary[:2]) + summary[5]
    assert tables.traces.read_text() == header(TRACE_COLUMNS) + "".join(traces[1:3])


@pytest.mark.parametrize("status", ["killed", "time-limit", "interrupted", "refused", "error", "budget"])
def test_what_circumstances_ended_is_done_again(status, tables):
    one = JOBS[0]
    tables.append([rows(one)[0], failure(one, "kcm", status, "why")])
    again = status in ("killed", "time-limit", "interrupted")
    assert tables.select_finished([one]) == (set() if again else {one.identity})
    assert len(runs(tables)) == (0 if again else 2) and len(steps(tables)) == (0 if again else 1)


def test_bytes_that_are_no_text_spoil_their_own_row_only(tables):
    one, two, _ = JOBS
    tables.append(rows(one))
    with tables.summary.open("ab") as file:
        file.write(b"\xff\xfe,\n" + line(two, "kcm", message="caf\u00e9").encode("latin-1"))
    assert tables.select_finished([one]) == {one.identity}
    assert tables.read()["structure"].tolist() == ["one", "one", "two"]


def test_a_folder_is_of_one_batch_at_a_time(tables, monkeypatch):
    folder = tables.folder
    # The name is one for all versions of the program, which must see each other.
    assert (folder / ".lock").exists()
    monkeypatch.setattr(storage, "_LOCKS", set())  # As in another process.
    for resume in (True, False):
        with pytest.raises(pc.ProtochainError) as refusal:
            Tables(folder, resume)
        assert str(refusal.value).startswith(f"{folder}: ")
    tables.close()
    with pytest.raises(pc.ProtochainError) as refusal:
        Tables(folder, resume=False)
    assert str(refusal.value).startswith(f"{folder / 'summary.csv'}: ") and "resume" in str(refusal.value)
    # The refusal leaves no lock behind.
    Tables(folder, resume=True).close()


def test_a_folder_or_table_of_something_else_is_refused(tmp_path):
    file = tmp_path / "file"
    file.write_text("")
    with pytest.raises(pc.ProtochainError, match=str(file)):
        Tables(file / "out", resume=False)
    (tmp_path / "summary.csv").write_text("structure,method\na,b\n")
    other = Tables(tmp_path, resume=True)
    with pytest.raises(pc.ProtochainError) as refusal:
        other.select_finished([])
    assert str(refusal.value).startswith(f"{other.summary}: ")
    other.close()


def test_a_new_batch_without_a_row_leaves_nothing_whatever_is_missing_already(tmp_path):
    for gone in ("traces", "summary"):
        made = Tables(tmp_path / "new" / "out", resume=False)
        made.select_finished([])
        getattr(made, gone).unlink()
        made.abandon()
        made.close()
        assert not (tmp_path / "new").exists()


@pytest.mark.parametrize("name", ["summary", "relaxed"])
@pytest.mark.parametrize("resume", [False, True])
def test_a_refusal_leaves_a_table_of_another_kind_as_it_is(name, resume, tmp_path):
    """Which is replaced if that is asked for; and so does one that fails the traces of something else."""
    first = Tables(tmp_path, resume=False, name=name)
    first.select_finished([])
    first.append(rows(JOBS[0]))
    first.close()
    (tmp_path / "settings.json").write_text("{}")
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    other = {"summary": "relaxed", "relaxed": "summary"}[name]
    with pytest.raises(pc.ProtochainError, match=rf"{name}\.csv: contains a batch; give another folder"):
        Tables(tmp_path, resume, other)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before
    Tables(tmp_path, resume=False, name=other, force=True).close()
    assert not list(tmp_path.iterdir())
    (tmp_path / "traces.csv").write_text("of something else\n")
    made = Tables(tmp_path, resume, other)
    made.abandon()
    made.close()
    assert [path.name for path in tmp_path.iterdir()] == ["traces.csv"]


def test_names_that_look_like_numbers_stay_text_and_counts_stay_whole(tmp_path):
    path = tmp_path / "summary.csv"
    counts = [name for name in COLUMNS if name.startswith("n_")]
    whole = [*counts, "iterations", "evaluations", "seed", "threads", "model"]
    text = [
        "structure", "message", "key", "repairs", "left_out", "constant_terms", "restraint_kj_mol_nm2",
        "output",
    ]  # fmt: skip
    names = (*text, *whole)
    path.write_text(f"{','.join(names)},seconds\n" + "007," * len(names) + "1.50\n" + "," * len(names) + "\n")
    table = read_table(path)
    assert table.loc[0, text].tolist() == ["007"] * len(text) and table.loc[0, "seconds"] == 1.5
    # Whole numbers remain whole beside a failure, which has none; also in Parquet.
    assert table.loc[0, whole].tolist() == [7] * len(whole) and table.loc[1].isna().all()
    table.to_parquet(tmp_path / "table.parquet", index=False)
    for each in (table, pd.read_parquet(tmp_path / "table.parquet")):
        assert {str(each[name].dtype) for name in whole} == {"Int64"}


@pytest.mark.parametrize("name", ["NA", "nan", "null", "None", "007"])
def test_names_that_look_like_nothing_stay_and_numbers_that_are_none_are_missing(name, tables):
    job = Job(name, Path(f"/in/{name}.pdb"), TWO, "key")
    tables.append(rows(job))
    tables.summary.write_text(tables.summary.read_text() + line(job, "kcm", seconds="nan"))
    read, frames = tables.read(), FramesRun(tables.summary).table
    assert read["structure"].tolist() == frames["structure"].tolist() == [name] * 3
    for each in (read, frames, read_table(tables.traces)):
        assert all(each[name].isna().all() for name in ("output", "n_atoms") if name in each)
        assert str(each["seconds"].dtype) == "float64"
    assert read["energy_end_kj_mol"].isna().all() and read["seconds"].isna().tolist() == [False, False, True]
    assert read_table(tables.traces)["structure"].tolist() == [name] * 2


def points(*values):
    return [{"evaluations": e, "energy_kj_mol": v} for e, v in values]


def test_curves_are_scaled_to_all_runs_together():
    energies = {
        "kcm": ((0, 8.0), (10, 6.0), (100, 7.0)),
        "lbfgs": ((1, 4.0), (20, np.nan), (1000, 0.0), (9999, np.inf)),
    }
    drawn = curves(
        [
            *(Row({"method": method}, points(*given)) for method, given in energies.items()),
            Row({"method": "none"}, points((1, np.nan))),
            Row({"method": "nothing"}, []),
        ]
    )
    assert (drawn["low"], drawn["high"], drawn["most"]) == (0.0, 8.0, 1000)
    assert set(drawn["lines"]) == set(energies)
    for method, line in drawn["lines"].items():
        at = np.array([[float(value) for value in pair.split(",")] for pair in line.split()])
        finite = [(n, e) for n, e in energies[method] if np.isfinite(e)]
        # Thousand evaluations are the width, by their logarithm; the lowest energy so far, downward.
        across = [np.log10(max(n, 1)) / 3 * WIDTH for n, _ in finite]
        down = [(8.0 - min(e for _, e in finite[: k + 1])) / 8.0 * HEIGHT for k in range(len(finite))]
        assert at == pytest.approx(np.column_stack([across, down]), abs=0.06)
    assert not curves([Row({"method": "none"}, points((1, np.nan)))])["lines"]
    # One point is neither wide nor high.
    assert curves([Row({"method": "kcm"}, points((1, 5.0)))])["lines"]["kcm"].split(",") == ["0.0", "0.0"]


def test_a_structures_page_is_written_with_its_curves_and_repairs(tmp_path):
    (tmp_path / "pages").mkdir()
    row = Row(failure(JOBS[0], "kcm", "budget", "used up").record, points((1, 4.0), (100, 0.0)))
    write_page(tmp_path, JOBS[0], [row], [noted("<CB>")])
    page = (tmp_path / "pages" / "one.html").read_text()
    drawn = curves([row])["lines"]["kcm"]
    assert all(text in page for text in ("&lt;CB&gt;", "used up", drawn, f"{WIDTH}", f"{HEIGHT}", "one"))
    assert [path.name for path in (tmp_path / "pages").iterdir()] == ["one.html"]


def test_a_structures_page_has_terms_and_changes_also_beside_a_run_that_failed(tmp_path):
    (tmp_path / "pages").mkdir()
    failed = failure(JOBS[0], "kcm", "killed", "out of memory").record
    done = failure(JOBS[0], "lbfgs", "converged", "done").record
    done |= {"energy_bonds_start_kj_mol": 8.5, "energy_bonds_end_kj_mol": 4.25, "energy_kj_mol": 3.0}
    done |= {"energy_cmap_start_kj_mol": 0.0, "energy_cmap_end_kj_mol": 0.0}
    table = energies_by_term({"kcm": failed, "lbfgs": done})
    assert table.columns.tolist() == ["term", "start_kj_mol", "kcm_kj_mol", "lbfgs_kj_mol"]
    assert table["term"].tolist() == ["bonds"] and table["start_kj_mol"].tolist() == [8.5]
    s = load("ala10.pdb")
    write_page(
        tmp_path, JOBS[0], [Row(failed, []), Row(done, [])], [],
        {"kcm": (s, None), "lbfgs": (s, s.with_positions(s.positions * 1.01))},
    )  # fmt: skip
    page = (tmp_path / "pages" / "one.html").read_text()
    assert "<td>4.250</td>" in page and "What changed" in page and "C-alpha RMSD of chain A" in page
    assert energies_by_term({"kcm": failed}).empty


def results(n=4):
    """A table of a batch: one failure, then results that rise."""
    return pd.DataFrame(
        {
            "structure": [f"s{k}" for k in range(n)], "method": ["kcm", "lbfgs"] * (n // 2),
            "status": ["refused", "budget", "converged", "converged"][:n], "message": "said",
            "energy_start_kj_mol": [np.nan, 10.0, 20.0, 30.0][:n],
            "energy_end_reference_kj_mol": [np.nan, -10.0, -20.0, -30.0][:n],
            "n_residues": [np.nan, 4.0, 5.0, 6.0][:n], "ca_rmsd_angstrom": [np.nan, 0.125, 0.25, 0.625][:n],
            "ca_rmsd_to_openmm_angstrom": [np.nan, np.nan, 0.5, np.nan][:n],
            "evaluations": [np.nan, 1, 2, 4][:n], "seconds": [99.0, 1.0, 2.0, 5.0][:n],
        }
    )  # fmt: skip


def test_the_worst_come_first_and_nothing_is_added():
    sorted_rows = worst_first(results())
    assert sorted_rows["structure"].tolist() == ["s0", "s1", "s3", "s2"]
    assert sorted_rows.columns.tolist() == results().columns.tolist()
    refused = results().assign(status="converged")
    assert worst_first(refused)["structure"].tolist() == ["s0", "s3", "s2", "s1"]


def test_the_report_shows_each_row_and_links_the_pages_there_are(tmp_path):
    (tmp_path / "pages").mkdir()
    (tmp_path / "pages" / "s1.html").write_text("")
    summary = {
        "n_structures": 4, "table": "summary.csv", "command": ["protochain", "batch"], "python": "3.x",
        "versions": {"numpy": "n"},
    }  # fmt: skip
    write_report(tmp_path, results(), summary)
    assert {path.name for path in tmp_path.iterdir()} == {
        "pages", "report.html", "energy.png", "rmsd.png", "seconds.png",
    }  # fmt: skip
    page = (tmp_path / "report.html").read_text()
    data = json.loads(re.search(r'<script type="application/json">(.*?)</script>', page, re.DOTALL)[1])
    keys = [column["key"] for column in data["columns"]]
    rows = [dict(zip(keys, row, strict=True)) for row in data["rows"]]
    assert [row["structure"] for row in rows] == worst_first(results())["structure"].tolist()
    linked = {row["structure"]: link for row, link in zip(rows, data["links"], strict=True)}
    assert linked["s1"] == "pages/s1.html" and linked["s2"] is None
    assert [0.625, -30.0, 5.0] in [
        [row[key] for key in ("ca_rmsd_angstrom", "energy_end_reference_kj_mol", "seconds")] for row in rows
    ]
    assert [row["message"] for row in rows] == ["said"] * len(results())
    assert len({(tmp_path / f"{stem}.png").read_bytes() for stem in ("energy", "rmsd", "seconds")}) == 3
    assert imread(tmp_path / "energy.png").std() > 0
