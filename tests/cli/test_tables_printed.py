"""What the commands print: every number, every message as it is, and nothing cut off."""

from types import SimpleNamespace

import pandas as pd
import pytest
from fixtures.samples import load
from fixtures.texts import numbers

from protochain.cli import terminal
from protochain.cli.rows import print_rows
from protochain.minimisers.record import SHORT_COLUMNS

KEYS = [column.key for column in SHORT_COLUMNS]
LARGE = {
    "interrupted": "interrupted", 123456.781: "123456.8", -98765.432: "-98765.4", 1234.561: "1234.6",
    12345.671: "12346", 12.341: "12.34", 5000: "5000", 234.567: "234.57",
}  # fmt: skip
SMALL = {
    "clash": "clash", 1.0: "1.00", -1.0: "-1.00", 0.001: "1e-03", 0.004999: "5e-03", 12.341: "12.34",
    5000: "5000", 100.0: "100.00",
}  # fmt: skip
"""Values of the columns, and how they are printed: with two decimals, or as many as there is room for."""
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
    at = next(k for k, line in enumerate(table) if line.split()[1:2] == [next(iter(values))])
    assert table[at].split()[-len(values) :] == [*values.values()]
    assert table[-1].split() == ["own", "converged", *["-"] * (len(values) - 1)]
    assert "".join(line.split()[0] for line in table[at:-1] if line.split()) == method
    headings = " ".join(" ".join(table[:at]).replace("/", " ").split())
    for column in SHORT_COLUMNS:
        for word in (column.short or column.heading).split():
            assert word in headings


@pytest.mark.parametrize(("output", "said"), [("d/a.pdb", "d/a.pdb"), ("-", "standard output")])
def test_a_result_is_said_with_both_distances_from_its_start(output, said, capsys):
    record = {"ca_rmsd_angstrom": 1.234, "ca_rmsd_as_filed_angstrom": 20.5, "frame": "where it was"}
    terminal.print_written(record | {"output": output})
    distance, filed, written = lines_of(capsys)
    assert numbers(distance) == [1.23] and numbers(filed) == [20.5] and "where it was" in filed
    assert written.endswith(said)


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


def test_rows_have_names_on_the_left_and_numbers_on_the_right_below_their_headings(capsys):
    print_rows(["file", "clashes", "score"], [["a.pdb", 3, 12.345], ["a-longer-name.pdb", None, 0.5]])
    heading, *rows = lines_of(capsys)
    ends = [heading.index(name) + len(name) for name in ("clashes", "score")]
    for row, texts in zip(rows, (["a.pdb", "3", "12"], ["a-longer-name.pdb", "-", "0.50"]), strict=True):
        assert row.split() == texts and row.startswith(texts[0])
        assert [row[:end].split()[-1] for end in ends] == texts[1:] and " " not in {
            row[end - 1] for end in ends
        }


def test_minima_and_populations_of_a_search_are_said_in_their_units(capsys):
    nan, names = (
        float("nan"),
        "minimum above_lowest_kj_mol free_energy_kj_mol conformer ca_rmsd_to_lowest_angstrom",
    )
    minima = pd.DataFrame([[1, 0.0, nan, "", 0.0], [2, 3.25, 1.5, "C7eq", 1.75]], columns=names.split())
    names = "temperature_k energy_kj_mol energy_error_kj_mol helix_share helix_share_error"
    rows = [[300.0, -10.25, 0.5, 0.125, 0.025], [600.0, 20.5, 1.5, nan, nan]]
    done = {"minima": minima, "populations": pd.DataFrame(rows, columns=names.split())}
    chain = SimpleNamespace(structure=load("ala10.pdb"))
    done |= {"energy": -12.341, "q": [0] * 7, "agreement": "2 of 3 walks"}
    terminal.print_search(SimpleNamespace(chain=chain, **done), "out")
    first, agreement, *rows, last = lines_of(capsys)
    assert (
        numbers(first)[-2:] == [-12.34, 7]
        and agreement.strip() == "2 of 3 walks"
        and last == "written: out"
        and "C7eq" in rows[1]
    )
    assert [numbers(row.replace("C7eq", "").replace("+-", " ")) for row in rows] == [
        [1, 0.0, 0.0], [2, 3.25, 1.5, 1.75], [300, -10.2, 0.5, 12.5, 2.5], [600, 20.5, 1.5],
    ]  # fmt: skip
