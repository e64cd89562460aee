"""Tables of a batch, their text to the letter; the pages drawn from them."""

import os
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from conftest import noted
from matplotlib.image import imread

import protochain as pc
from protochain.batches.jobs import BatchSettings, Job, Row, failure
from protochain.batches.page import HEIGHT, WIDTH, curves, write_page
from protochain.batches.report import plot_distribution, statistics, worst_first, write_report
from protochain.batches.table import CIRCUMSTANCES, COLUMNS, TRACE_COLUMNS, Tables, read_table
from protochain.lab.report import COLOURS
from protochain.minimisers import record

TWO = BatchSettings(methods=("lbfgs", "kcm"))
JOBS = [Job(name, Path(f"/in/{name}.pdb"), TWO, f"key-{name}") for name in ("one", "two", "three")]
HEADER = ",".join(COLUMNS) + "\n"
TRACE_HEADER = (
    "structure,method,iteration,evaluations,seconds,energy_kj_mol,"
    "max_torque_kj_mol_rad,ca_rmsd_angstrom,key\n"
)


def line(job, method, status="refused", message="why", key=None, seconds="0.0"):
    """A row of summary.csv, as a failure has it."""
    cells = dict.fromkeys(COLUMNS, "") | {
        "structure": job.name, "input": str(job.path), "key": key or job.key, "method": method,
        "status": status, "message": message, "seconds": seconds,
    }  # fmt: skip
    return ",".join(cells.values()) + "\n"


def point(job, method, iteration=0):
    return f"{job.name},{method},{iteration},1,0.5,-1.0,2.0,0.25,{job.key}\n"


def rows(job, status="refused", n_points=1):
    trace = [
        {"iteration": k, "evaluations": 1, "seconds": 0.5, "energy_kj_mol": -1.0,
         "max_torque_kj_mol_rad": 2.0, "ca_rmsd_angstrom": 0.25, "more": 3} for k in range(n_points)
    ]  # fmt: skip
    return [Row(failure(job, method, status, "why").record, trace) for method in TWO.methods]


@pytest.fixture
def tables(tmp_path):
    made = Tables(tmp_path / "new" / "out", resume=False)
    made.finished([])
    yield made
    made.close()


def texts(tables):
    return tables.summary.read_text(), tables.traces.read_text()


def test_columns_are_those_of_a_record_and_of_a_batch():
    more = (
        "ca_rmsd_to_openmm_angstrom", "n_starts", "energy_median_kj_mol", "energy_highest_kj_mol",
        "n_within_1_kj_mol_of_lowest", "seconds_preparation", "input", "model", "output", "key",
    )  # fmt: skip
    assert (*(column.key for column in record.COLUMNS), *more) == COLUMNS
    assert ",".join(TRACE_COLUMNS) + "\n" == TRACE_HEADER
    assert CIRCUMSTANCES == ("killed", "time-limit", "interrupted")


def test_rows_are_appended_after_a_header_and_sorted_by_job_and_method(tables):
    assert texts(tables) == (HEADER, TRACE_HEADER)
    one, two, three = JOBS
    tables.append(rows(two, n_points=2))
    tables.append(reversed(rows(one)))
    summary, traces = texts(tables)
    assert summary == HEADER + "".join(
        line(*each) for each in ((two, "lbfgs"), (two, "kcm"), (one, "kcm"), (one, "lbfgs"))
    )
    points = [(two, "lbfgs"), (two, "lbfgs", 1), (two, "kcm"), (two, "kcm", 1), (one, "kcm"), (one, "lbfgs")]
    assert traces == TRACE_HEADER + "".join(point(*each) for each in points)
    # Rows of what is not asked about come last.
    tables.sort([three, one])
    summary, traces = texts(tables)
    order = ((one, "lbfgs"), (one, "kcm"), (two, "lbfgs"), (two, "kcm"))
    assert summary == HEADER + "".join(line(*each) for each in order)
    assert traces == TRACE_HEADER + "".join(point(*points[k]) for k in (5, 4, 0, 1, 2, 3))


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
    tables.summary.write_text(HEADER + "".join(summary) + line(three, "lbfgs")[:-5])
    traces = [point(job, "lbfgs") for job in (two, one, stranger, three)]
    tables.traces.write_text(TRACE_HEADER + "".join(traces) + "one,lbfgs\n" + point(one, "kcm")[:-1])
    assert tables.finished(JOBS) == {("one", "key-one")}
    assert texts(tables) == (HEADER + "".join(summary[:2]) + summary[5], TRACE_HEADER + "".join(traces[1:3]))


@pytest.mark.parametrize("status", ["killed", "time-limit", "interrupted", "refused", "error", "budget"])
def test_what_circumstances_ended_is_done_again(status, tables):
    one = JOBS[0]
    tables.append([rows(one)[0], failure(one, "kcm", status, "why")])
    again = status in ("killed", "time-limit", "interrupted")
    assert tables.finished([one]) == (set() if again else {one.identity})
    assert texts(tables)[0].count("\n") == (1 if again else 3)
    assert texts(tables)[1].count("\n") == (1 if again else 2)


def test_bytes_that_are_no_text_spoil_their_own_row_only(tables):
    one, two, _ = JOBS
    tables.append(rows(one))
    with tables.summary.open("ab") as file:
        file.write(b"\xff\xfe,\n" + line(two, "kcm", message="caf\u00e9").encode("latin-1"))
    assert tables.finished([one]) == {one.identity}
    assert tables.read()["structure"].tolist() == ["one", "one", "two"]


def test_a_folder_is_of_one_batch_at_a_time(tables):
    folder = tables.folder
    # The name is one for all versions of the program, which must see each other.
    assert (folder / ".lock").exists()
    for resume in (True, False):
        with pytest.raises(pc.ProtochainError) as refusal:
            Tables(folder, resume)
        assert str(refusal.value) == f"{folder}: another batch is writing to this folder; give another"
    tables.close()
    with pytest.raises(pc.ProtochainError) as refusal:
        Tables(folder, resume=False)
    said = f"{folder / 'summary.csv'}: holds a batch; resume=True continues it, or give another folder"
    assert str(refusal.value) == said
    # The refusal leaves no lock behind.
    Tables(folder, resume=True).close()


def test_a_folder_or_table_of_something_else_is_refused(tmp_path):
    file = tmp_path / "file"
    file.write_text("")
    with pytest.raises(pc.ProtochainError, match="is not a folder"):
        Tables(file / "out", resume=False)
    (tmp_path / "summary.csv").write_text("structure,method\na,b\n")
    other = Tables(tmp_path, resume=True)
    with pytest.raises(pc.ProtochainError) as refusal:
        other.finished([])
    assert str(refusal.value) == f"{other.summary}: is not a table of a batch; give another folder"
    other.close()


def test_a_new_batch_without_a_row_leaves_nothing_whatever_is_missing_already(tmp_path):
    for gone in ("traces", "summary"):
        made = Tables(tmp_path / "new" / "out", resume=False)
        made.finished([])
        getattr(made, gone).unlink()
        made.abandon()
        made.close()
        assert not (tmp_path / "new").exists()


def test_names_that_look_like_numbers_stay_text_and_counts_stay_whole(tmp_path):
    path = tmp_path / "summary.csv"
    text = ("structure", "message", "key", "repairs", "left_out", "constant_terms", "restraint_kj_mol_nm2",
            "output")  # fmt: skip
    integers = (
        "iteration", "iterations", "evaluations", "n_chains", "n_residues", "n_atoms", "n_bodies", "n_hinges",
        "seed", "threads", "n_starts", "n_within_1_kj_mol_of_lowest", "model",
    )  # fmt: skip
    names = (*text, *integers)
    path.write_text(
        ",".join([*names, "seconds"]) + "\n" + "007," * len(names) + "1.50\n" + "," * len(names) + "\n"
    )
    table = read_table(path)
    assert table.loc[0, list(text)].tolist() == ["007"] * len(text) and table.loc[0, "seconds"] == 1.5
    # Whole numbers remain whole beside a failure, which has none; also in Parquet.
    assert table.loc[0, list(integers)].tolist() == [7] * len(integers) and table.loc[1].isna().all()
    table.to_parquet(tmp_path / "table.parquet", index=False)
    for each in (table, pd.read_parquet(tmp_path / "table.parquet")):
        assert {str(each[name].dtype) for name in integers} == {"Int64"}
    assert set(integers) - {"iteration"} < set(COLUMNS)


def points(*values):
    return [{"evaluations": e, "energy_kj_mol": v} for e, v in values]


def test_curves_are_scaled_to_all_runs_together():
    assert (WIDTH, HEIGHT) == (640, 240)
    drawn = curves(
        [
            Row({"method": "kcm"}, points((0, 8.0), (10, 6.0), (100, 7.0))),
            Row({"method": "lbfgs"}, points((1, 4.0), (20, np.nan), (1000, 0.0), (9999, np.inf))),
            Row({"method": "none"}, points((1, np.nan))),
            Row({"method": "nothing"}, []),
        ]
    )
    assert drawn == {
        "low": 0.0, "high": 8.0, "most": 1000,
        "lines": {"kcm": "0.0,0.0 213.3,60.0 426.7,60.0", "lbfgs": "0.0,120.0 640.0,240.0"},
    }  # fmt: skip
    assert curves([Row({"method": "none"}, points((1, np.nan)))]) == {"lines": {}}
    # One point is neither wide nor high.
    assert curves([Row({"method": "kcm"}, points((1, 5.0)))])["lines"] == {"kcm": "0.0,0.0"}


def test_a_structures_page_is_written_with_its_curves_and_repairs(tmp_path):
    (tmp_path / "pages").mkdir()
    row = Row(failure(JOBS[0], "kcm", "budget", "used up").record, points((1, 4.0), (100, 0.0)))
    write_page(tmp_path, JOBS[0], [row], [noted("<CB>")])
    page = (tmp_path / "pages" / "one.html").read_text()
    for text in ("&lt;CB&gt;", "used up", 'points="0.0,0.0 640.0,240.0"', "640", "240", "one"):
        assert text in page
    assert [path.name for path in (tmp_path / "pages").iterdir()] == ["one.html"]


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


def test_quartiles_are_of_each_method_over_the_rows_with_a_result():
    found = statistics(results())
    assert found.columns.tolist() == [
        "method",
        "quantity",
        "first_quartile",
        "median",
        "third_quartile",
        "highest",
    ]
    assert found.values.tolist() == [
        ["lbfgs", "energy_drop_kj_mol_per_residue", 6.25, 7.5, 8.75, 10.0],
        ["lbfgs", "ca_rmsd_angstrom", 0.25, 0.375, 0.5, 0.625],
        ["lbfgs", "evaluations", 1.75, 2.5, 3.25, 4.0],
        ["lbfgs", "seconds", 2.0, 3.0, 4.0, 5.0],
        ["kcm", "energy_drop_kj_mol_per_residue", *[8.0] * 4],
        ["kcm", "ca_rmsd_angstrom", *[0.25] * 4],
        ["kcm", "ca_rmsd_to_openmm_angstrom", *[0.5] * 4],
        ["kcm", "evaluations", *[2.0] * 4],
        ["kcm", "seconds", *[2.0] * 4],
    ]


def test_the_worst_come_first_and_nothing_is_added():
    sorted_rows = worst_first(results())
    assert sorted_rows["structure"].tolist() == ["s0", "s1", "s3", "s2"]
    assert sorted_rows.columns.tolist() == results().columns.tolist()
    refused = results().assign(status="converged")
    assert worst_first(refused)["structure"].tolist() == ["s0", "s3", "s2", "s1"]


def test_a_distribution_rises_to_all_structures():
    values = pd.Series([3.0, 1.0, np.nan, 2.0, 7.0, np.nan])
    methods = pd.Series(["kcm", "kcm", "kcm", "lbfgs", "kcm", "none"])
    figure = plot_distribution(values, methods, "seconds")
    (ax,) = figure.axes
    first, second = ax.lines
    assert first.get_xdata().tolist() == [1.0, 3.0, 7.0] and second.get_xdata().tolist() == [2.0]
    assert (
        first.get_ydata().tolist() == pytest.approx([100 / 3, 200 / 3, 100.0]) and second.get_ydata() == 100.0
    )
    assert first.get_drawstyle() == "steps-post" and (first.get_label(), second.get_label()) == (
        "kcm",
        "lbfgs",
    )
    assert (first.get_linestyle(), second.get_linestyle()) == ("-", "--")
    assert (first.get_color(), second.get_color()) == COLOURS[:2]
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("seconds", "structures up to this value, %")
    assert ax.get_ylim() == (0, 101) and ax.get_legend() is not None and not ax.get_legend().get_frame_on()
    many = plot_distribution(pd.Series(np.arange(9.0)), pd.Series(list("abcdefghi")), "").axes[0].lines
    assert [each.get_color() for each in many] == [*COLOURS, *COLOURS[:2]]
    assert [each.get_linestyle() for each in many] == ["-", "--", "-.", ":", "-", "--", "-.", ":", "-"]
    assert figure.get_size_inches().tolist() == [5.2, 3.6] and figure.get_layout_engine() is not None
    nothing = plot_distribution(values[2:3], methods[2:3], "").axes[0]
    assert not nothing.lines and nothing.get_legend() is None


def test_the_report_shows_each_row_and_links_the_pages_there_are(tmp_path):
    (tmp_path / "pages").mkdir()
    (tmp_path / "pages" / "s1.html").write_text("")
    summary = {
        "n_structures": 4,
        "table": "summary.csv",
        "command": ["protochain", "batch"],
        "python": "3.x",
        "versions": {"numpy": "n"},
    }
    write_report(tmp_path, results(), summary)
    assert {path.name for path in tmp_path.iterdir()} == {
        "pages", "report.html", "statistics.csv", "energy.png", "rmsd.png", "seconds.png",
    }  # fmt: skip
    page = (tmp_path / "report.html").read_text()
    assert '<a href="pages/s1.html">s1</a>' in page and "pages/s2.html" not in page
    assert "<td>0.625</td><td>-30.000</td><td>5.000</td>" in "".join(
        part.strip() for part in page.split("\n")
    )
    assert page.count("data:image/png;base64,") == 3 and "rows; all are in summary.csv" not in page
    pd.testing.assert_frame_equal(pd.read_csv(tmp_path / "statistics.csv"), statistics(results()))
    assert len({(tmp_path / f"{stem}.png").read_bytes() for stem in ("energy", "rmsd", "seconds")}) == 3
    assert imread(tmp_path / "energy.png").shape[:2] == (540, 780)
    large = pd.concat([results()] * 51, ignore_index=True)
    write_report(tmp_path, large, summary)
    page = (tmp_path / "report.html").read_text()
    assert "200 of 204 rows; all are in summary.csv" in page and page.count('class="text">said</td>') == 200
