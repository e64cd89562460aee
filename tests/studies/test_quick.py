"""The claims of README that a reviewer measures again by one command."""

import sys

import pandas as pd
import pytest
from fixtures.samples import ROOT

sys.path.insert(0, str(ROOT / "analysis" / "benchmarks"))
import quick

RESULTS = ROOT / "analysis" / "results"


def test_energies_and_compliance_are_measured(tmp_path, monkeypatch):
    monkeypatch.setattr(quick, "RACED", ("ala10",))
    rows = [*quick.energies(tmp_path), *quick.compliance(tmp_path)]
    assert [row["met"] for row in rows] == [True, True, True]


@pytest.mark.parametrize(
    ("claim", "table", "column"),
    [(quick.race, "race_gbsa.csv", "energy_whole_s"), (quick.relaxation, "relax.csv", "times_sooner")],
)
@pytest.mark.parametrize("slower", [False, True])
def test_a_slower_run_misses_the_claim(tmp_path, monkeypatch, claim, table, column, slower):
    """A stand-in for the benchmark writes the published table, or a slower one."""
    measured = pd.read_csv(RESULTS / table)
    if slower:
        measured[column] *= 100.0 if column == "energy_whole_s" else 0.01
    monkeypatch.setattr(quick, "benchmark", lambda *_: measured.to_csv(tmp_path / table, index=False))
    assert claim(tmp_path)[0]["met"] is not slower


def test_a_missed_claim_is_in_the_table_and_the_exit_status(tmp_path, monkeypatch, capsys):
    row = {"claim": "energies repeat", "published": "equal", "here": "different", "met": False}
    monkeypatch.setattr(quick, "CLAIMS", (lambda folder: [row],))
    assert quick.main(["-o", str(tmp_path)]) == 1
    assert "| energies repeat | equal | different | False |" in capsys.readouterr().out
    assert not pd.read_csv(tmp_path / "quick.csv")["met"].any()
