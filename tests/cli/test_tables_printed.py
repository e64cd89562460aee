"""What the commands print: every number, every message as it is, and nothing cut off."""

from importlib import import_module
from types import SimpleNamespace

import pandas as pd
import pytest
from fixtures.texts import numbers

from protochain.cli import terminal
from protochain.minimisers.record import SHOWN

KEYS = [column.key for column in SHOWN]
LARGE = ("interrupted", 123456.781, -98765.432, 1234.561, 12345.671, 12.341, 5000, 1234.561)
SMALL = ("clash", 1.0, -1.0, 0.001, 0.004999, 12.341, 5000, 100.0)
BATCH = ("structure", "method", "status", "output", "message", "ca_rmsd_angstrom", "seconds")


def lines_of(capsys):
    return capsys.readouterr().out.splitlines()


def test_a_simulation_is_summed_up_in_a_few_lines(capsys):
    record = {
        "structure": "x", "message": "completed", "ns_per_day": 12.34, "accepted": None, "output": "d",
        "mean_temperature_second_half_k": 301.26, "conserved_drift_kj_mol_ps_per_100_atoms": 0.01234,
        "ca_rmsd_angstrom": 1.234, "ca_rmsd_input_angstrom": 2.345, "ca_rmsd_input_as_filed_angstrom": 30.5,
        "frame": "where it was",
    }  # fmt: skip
    terminal.print_simulation(record)
    first, *_, last = lines = lines_of(capsys)
    assert first.startswith("x: completed") and last.endswith(" d") and "where it was" in lines[-2]
    shown = [12.34, 301.26, 0.01234, 1.234, 2.345, 30.5]
    text = "\n".join(lines).replace("100 atoms", "atoms")
    assert numbers(text) == pytest.approx(shown, rel=0.03)
    terminal.print_simulation(record | {"accepted": 0.456})
    assert 46.0 in numbers(capsys.readouterr().out) and 46.0 not in numbers(text)


@pytest.mark.parametrize("method", ["md", "kcm-stiffness", "module.of.ones.own:Method"])
@pytest.mark.parametrize("columns", [60, 80, 120])
@pytest.mark.parametrize("values", [LARGE, SMALL], ids=["large", "small"])
def test_a_table_has_a_row_for_each_record_and_their_messages_below(
    columns, method, values, capsys, monkeypatch
):
    """Headings wrap at blanks, names anywhere; numbers are whole though the terminal has no room."""
    monkeypatch.setenv("COLUMNS", str(columns))
    first = dict(zip(KEYS, (method, *values), strict=True)) | {"message": "[red]stopped"}
    second = dict.fromkeys(KEYS) | {"method": "own", "status": "converged", "message": "not 12 done"}
    terminal.print_table([first, second])
    *table, message, other = lines_of(capsys)
    assert (message, other) == (f"{method}: [red]stopped", "own: not 12 done")
    assert max(map(len, table)) <= max(terminal._WIDTH, columns)
    at = next(k for k, line in enumerate(table) if values[0] in line)
    for column, value in zip(SHOWN[2:], values[1:], strict=True):
        assert column.short_text(value) in table[at].split(), column.key
    assert table[-1].split() == ["own", "converged", *["-"] * len(values[1:])]
    assert "".join(line.split()[0] for line in table[at:-1] if line.split()) == method
    headings = " ".join(" ".join(table[:at]).replace("/", " ").split())
    for column in SHOWN:
        for word in (column.short or column.heading).split():
            assert word in headings


@pytest.mark.parametrize(("output", "said"), [("d/a.pdb", "d/a.pdb"), ("-", "standard output")])
def test_a_result_is_said_with_both_distances_from_its_start(output, said, capsys):
    record = {"ca_rmsd_angstrom": 1.234, "ca_rmsd_as_filed_angstrom": 20.5, "frame": "where it was"}
    terminal.print_written(record | {"output": output})
    distances, written = lines_of(capsys)
    assert numbers(distances) == [1.23, 20.5] and "where it was" in distances and written.endswith(said)


def test_jobs_are_listed_with_methods_and_path(capsys):
    jobs = [
        SimpleNamespace(name=name, settings=SimpleNamespace(methods=("kcm", "md")), path=f"in/{name}.pdb")
        for name in "ab"
    ]
    terminal.print_jobs(jobs)
    told = capsys.readouterr()
    assert [line.split() for line in told.out.splitlines()] == [[n, "kcm,md", f"in/{n}.pdb"] for n in "ab"]
    assert numbers(told.err) == [2]


def summary(n_failed):
    """Two methods; a structure without a result has a row for each."""
    rows = [
        dict(zip(BATCH, (s, m, status, output, "", r, t), strict=True))
        for s, m, status, output, r, t in (
            ("a", "md", "converged", "a.pdb", 1.0, 2.0), ("b", "md", "converged", "b.pdb", 2.0, 3.0),
            ("c", "md", "budget", "c.pdb", 6.0, 7.0), ("a", "kcm", "stalled", "a.pdb", 0.25, 9.0),
        )
    ]  # fmt: skip
    for k in range(n_failed):
        for m in ("md", "kcm", "none"):
            row = (f"f{k}", m, "refused", None, f"[b]{k}: why", None, None)
            rows.append(dict(zip(BATCH, row, strict=True)))
    return pd.DataFrame(rows)


@pytest.mark.parametrize("failed", [0, 1, terminal._SHOWN_FAILURES, terminal._SHOWN_FAILURES + 2])
def test_a_batch_is_summed_up_by_method_and_lists_some_failures(failed, capsys):
    terminal.print_batch(summary(failed), "r" * 100)
    lines = lines_of(capsys)
    md, kcm, *others = (line for line in lines if line.startswith(("md: ", "kcm: ", "none: ")))
    # How many of each status, the most frequent first, then the medians.
    counts = sorted([failed, 2, 1] if failed else [2, 1], reverse=True)
    assert numbers(md) == [*counts, 2.0, 3.0]
    assert numbers(kcm) == [*([failed] if failed else []), 1, 0.25, 9.0]
    assert [numbers(line) for line in others] == ([[failed]] if failed else [])
    listed = [line for line in lines if "[b]" in line]
    assert listed == [line for k in range(failed) for line in lines if line.startswith(f"f{k}: ")]
    assert len(listed) == min(failed, terminal._SHOWN_FAILURES) and "r" * 100 in lines[-1]
    if failed > len(listed):
        assert numbers(lines[-2]) == [failed - len(listed)]


def test_a_long_message_of_a_batch_is_not_wrapped(capsys):
    terminal.print_batch(summary(1).tail(1).assign(message="w " * 90), "r")
    assert any(line.count("w ") >= 89 for line in lines_of(capsys))


def test_many_starts_are_summed_up_in_a_line(capsys):
    told = {
        "n_starts": 5, "energy_lowest_kj_mol": -3.0, "energy_median_kj_mol": 0.25,
        "energy_highest_kj_mol": 9.0, "n_within_1_kj_mol_of_lowest": 2,
    }  # fmt: skip
    terminal.print_distribution(told)
    (line,) = lines_of(capsys)
    assert numbers(line.replace("within 1", "within")) == list(told.values())


def test_deviations_are_a_table(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "100")
    good = {
        "file": "[b]a.pdb", "model": 3.0, "rmsd_angstrom": 1.23456, "tm_score": 0.56789,
        "matched_residues": 12.0, "coverage": 0.756, "matched_by": "numbers", "chain_mapping": "A:B",
        "message": "",
    }  # fmt: skip
    import_module("protochain.cli.rmsd").print_deviations([good, good | {"tm_score": None, "file": "c"}])
    heading, *rows = lines_of(capsys)
    assert len(rows) == 2
    for row, file, score in zip(rows, ("[b]a.pdb", "c"), ([0.56789], []), strict=True):
        assert row.split()[0] == file and row.split()[-1] == "A:B" and "numbers" in row
        shown = [3, 1.23456, *score, 12, 75.6]
        assert numbers(row.removeprefix(file)) == pytest.approx(shown, rel=0.01)
    assert " - " in rows[1] and len(rows[0]) == len(rows[1]) == len(heading)


def test_messages_are_printed_as_they_are_in_colour_too(capsys, monkeypatch):
    """rich would paint numbers and take square brackets for styles."""
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.setenv("COLUMNS", "200")
    message = "[b]line 12 is 'odd'"
    terminal.print_table([dict.fromkeys(KEYS) | {"method": "x", "message": message}])
    terminal.print_batch(summary(3), "r")
    lines = lines_of(capsys)
    assert f"x: {message}" in lines and any(line.endswith("[b]0: why") for line in lines)
    assert not any("\x1b" in line for line in lines if line.startswith(("md: ", "f0: ", "x: ")))
