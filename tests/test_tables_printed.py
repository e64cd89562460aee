"""What the commands print, to the letter."""

from types import SimpleNamespace

import pandas as pd
import pytest

from protochain.cli import terminal
from protochain.minimisers.record import SHOWN


def test_a_simulation_is_summed_up_in_a_few_lines(capsys):
    record = {
        "structure": "x", "message": "completed", "ns_per_day": 12.34, "accepted": None, "output": "d",
        "mean_temperature_second_half_k": 301.26, "conserved_drift_kj_mol_ps_per_100_atoms": 0.01234,
        "ca_rmsd_angstrom": 1.234, "ca_rmsd_input_angstrom": 2.345, "ca_rmsd_input_as_filed_angstrom": 30.5,
        "frame": "where it was",
    }  # fmt: skip
    terminal.print_simulation(record)
    terminal.print_simulation(record | {"accepted": 0.456})
    lines = [
        "x: completed, 12.3 ns/day",
        "temperature 301.3 K over the second half, conserved energy drifts 0.012 kJ/mol/ps for 100 atoms{}",
        "C-alpha RMSD to the start 1.23 angstrom",
        "to the input 2.35, as filed 30.50: where it was",
        "written: d",
    ]
    text = "\n".join(lines) + "\n"
    assert capsys.readouterr().out == text.format("") + text.format(", 46 % of trajectories kept")


KEYS = [column.key for column in SHOWN]
TABLE = """\
                                            torque  force                      
                             start      end kJ/mol kJ/mol     RMSD             
       method      status   kJ/mol   kJ/mol   /rad    /nm angstrom evals time s
kcm-stiffness interrupted 123456.8 -98765.4 1234.6  12346    12.34  5000 1234.6
          own   converged        -        -      -      -        -     -      -
kcm-stiffness: [red]stopped
own: not 12 done
"""  # noqa: W291
WIDE = """\
method    status start kJ/mol end kJ/mol torque kJ/mol/rad force kJ/mol/nm RMSD angstrom evals time s
    md     clash         1.00      -1.00             1e-03           5e-03         12.34  5000 100.00
   own converged            -          -                 -               -             -     -      -
md: [red]stopped
own: not 12 done
"""
LONG = """\
                                             torque  force                      
                              start      end kJ/mol kJ/mol     RMSD             
        method      status   kJ/mol   kJ/mol   /rad    /nm angstrom evals time s
module.of.ones interrupted 123456.8 -98765.4 1234.6  12346    12.34  5000 1234.6
   .own:Method                                                                  
           own   converged        -        -      -      -        -     -      -
module.of.ones.own:Method: [red]stopped
own: not 12 done
"""  # noqa: W291
LARGE = ("interrupted", 123456.781, -98765.432, 1234.561, 12345.671, 12.341, 5000, 1234.561)
SMALL = ("clash", 1.0, -1.0, 0.001, 0.004999, 12.341, 5000, 100.0)


@pytest.mark.parametrize(
    ("columns", "method", "values", "table"),
    [
        (80, "kcm-stiffness", LARGE, TABLE), (60, "kcm-stiffness", LARGE, TABLE),
        (120, "md", SMALL, WIDE), (80, "module.of.ones.own:Method", LARGE, LONG),
    ],
)  # fmt: skip
def test_a_table_has_a_row_for_each_record_and_their_messages_below(
    columns, method, values, table, capsys, monkeypatch
):
    """Headings wrap at blanks, names anywhere; numbers are whole though the terminal has no room."""
    monkeypatch.setenv("COLUMNS", str(columns))
    first = dict(zip(KEYS, (method, *values), strict=True)) | {"message": "[red]stopped"}
    second = dict.fromkeys(KEYS) | {"method": "own", "status": "converged", "message": "not 12 done"}
    terminal.print_table([first, second])
    assert capsys.readouterr().out == table


@pytest.mark.parametrize(("output", "said"), [("d/a.pdb", "d/a.pdb"), ("-", "standard output")])
def test_a_result_is_said_with_both_distances_from_its_start(output, said, capsys):
    record = {"ca_rmsd_angstrom": 1.234, "ca_rmsd_as_filed_angstrom": 20.5, "frame": "where it was"}
    terminal.print_written(record | {"output": output})
    assert capsys.readouterr().out == (
        f"C-alpha RMSD 1.23 angstrom, as filed 20.50: where it was\nwritten: {said}\n"
    )


def test_jobs_are_listed_with_methods_and_path(capsys):
    jobs = [
        SimpleNamespace(name=name, settings=SimpleNamespace(methods=("kcm", "md")), path=f"in/{name}.pdb")
        for name in "ab"
    ]
    terminal.print_jobs(jobs)
    told = capsys.readouterr()
    assert told.out == "a  kcm,md  in/a.pdb\nb  kcm,md  in/b.pdb\n" and told.err == "2 structures\n"


BATCH = ("structure", "method", "status", "output", "message", "ca_rmsd_angstrom", "seconds")


def summary(n_failed):
    """Two methods; a structure without a result has a row for each."""
    rows = [
        dict(zip(BATCH, (s, m, status, output, "", r, t), strict=True))
        for s, m, status, output, r, t in (
            ("a", "md", "converged", "a.pdb", 1.0, 2.0), ("b", "md", "converged", "b.pdb", 2.0, 3.0),
            ("c", "md", "budget", "c.pdb", 6.0, 7.0), ("a", "kcm", "stalled", "a.pdb", 0.125, 9.0),
        )
    ]  # fmt: skip
    for k in range(n_failed):
        for m in ("md", "kcm", "none"):
            row = (f"f{k}", m, "refused", None, f"[b]{k}: why", None, None)
            rows.append(dict(zip(BATCH, row, strict=True)))
    return pd.DataFrame(rows)


def test_a_batch_is_summed_up_by_method_and_lists_ten_failures(capsys):
    terminal.print_batch(summary(10), "out/report.html")
    lines = capsys.readouterr().out.splitlines()
    assert lines == [
        "md: 10 refused, 2 converged, 1 budget; medians: RMSD 2.00 angstrom, 3.00 s",
        "kcm: 10 refused, 1 stalled; medians: RMSD 0.12 angstrom, 9.00 s",
        "none: 10 refused",
        *(f"f{k}: refused: [b]{k}: why" for k in range(10)),
        "written: out/report.html and the tables, structures and pages beside it",
    ]
    terminal.print_batch(summary(12), "r" * 100)
    lines = capsys.readouterr().out.splitlines()
    assert lines[-2:] == [
        "and 2 more, in the table", f"written: {'r' * 100} and the tables, structures and pages beside it",
    ]  # fmt: skip
    assert sum(": refused: " in line for line in lines) == 10
    long = summary(1).tail(1).assign(message="w " * 90)
    terminal.print_batch(long, "r")
    assert f"f0: refused: {'w ' * 90}".rstrip() in [
        line.rstrip() for line in capsys.readouterr().out.splitlines()
    ]


def test_many_starts_are_summed_up_in_a_line(capsys):
    terminal.print_distribution(
        {
            "n_starts": 5, "energy_lowest_kj_mol": -3.0, "energy_median_kj_mol": 0.125,
            "energy_highest_kj_mol": 9.0, "n_within_1_kj_mol_of_lowest": 2,
        }
    )  # fmt: skip
    assert capsys.readouterr().out == (
        "5 starts: lowest -3.00, median 0.12, highest 9.00 kJ/mol; 2 within 1 kJ/mol of the lowest\n"
    )


def test_deviations_are_a_table_with_failures_below(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "100")
    good = {
        "file": "[b]a.pdb", "model": 3.0, "rmsd_angstrom": 1.23456, "tm_score": 0.56789,
        "matched_residues": 12.0, "coverage": 0.756, "matched_by": "numbers", "chain_mapping": "A:B",
        "message": "",
    }  # fmt: skip
    bad = {"file": "b", "message": f"[b] 12 {'w ' * 90}end"}
    terminal.print_deviations([good, bad, good | {"tm_score": None, "file": "c"}])
    lines = capsys.readouterr().out.splitlines()
    cells = [line.split() for line in lines]
    assert cells[0] == ["file", "model", "RMSD", "angstrom", "TM-score", "matched", "residues", "chains"]
    assert cells[1] == ["[b]a.pdb", "3", "1.235", "0.5679", "12", "(76", "%)", "by", "numbers", "A:B"]
    assert cells[2] == ["c", "3", "1.235", "-", "12", "(76", "%)", "by", "numbers", "A:B"]
    assert lines[3] == bad["message"] and len(lines) == 4
    # Files to the left in 24 columns, numbers to the right, nothing at the edges.
    assert lines[1].index("3 ") == 24 + 1 + 4 and len(lines[1]) == len(lines[2])
    assert all(line == line.strip() for line in lines[1:3])
    terminal.print_deviations([bad])
    assert capsys.readouterr().out == f"{bad['message']}\n"


def test_messages_are_printed_as_they_are_in_colour_too(capsys, monkeypatch):
    """rich would paint numbers and take square brackets for styles."""
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.setenv("COLUMNS", "200")
    message = "[b]line 12 is 'odd'"
    terminal.print_table([dict.fromkeys(KEYS) | {"method": "x", "message": message}])
    terminal.print_batch(summary(3), "r")
    terminal.print_deviations([{"message": message}])
    lines = capsys.readouterr().out.splitlines()
    assert {f"x: {message}", message, "f0: refused: [b]0: why", "none: 3 refused"} <= set(lines)
    assert "md: 3 refused, 2 converged, 1 budget; medians: RMSD 2.00 angstrom, 3.00 s" in lines
