"""What the commands print: every number, every message as it is, and nothing cut off."""

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


@pytest.mark.parametrize(
    ("method", "columns", "values"),
    [("md", 80, SMALL), ("kcm-stiffness", 120, LARGE), ("module.of.ones.own:Method", 60, LARGE)],
)
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
