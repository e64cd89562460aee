"""Exit statuses: 1 without a result, 2 for bad input, 3 not converged, 4 some refused, 130 stopped."""

import importlib
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import pandas as pd
import pytest
import typer
from fixtures.command_line import refusal, run
from fixtures.samples import STRUCTURES

import protochain as pc
from protochain.batches import mutation_scan
from protochain.batches.cluster import Processes
from protochain.cli import mutate, score
from protochain.cli.options import exit_status
from protochain.cli.rows import conclude, table_of
from protochain.comparison.docking import DOCKING
from protochain.relaxation.mutations import COLUMNS
from protochain.validation.interface import CONFIDENCES, MAKEUP, SCORES

SAMPLE = STRUCTURES / "ala10.pdb"
OK, BUDGET, REFUSED, ERROR = "converged", "budget", "refused", "error"


@pytest.mark.parametrize(
    ("statuses", "usable", "interrupted", "status"),
    [
        ([OK], True, False, 0), ([OK, "measured"], True, False, 0), (["measured"], True, False, 0),
        ([OK], True, True, 130), ([OK, "interrupted"], True, False, 130), ([REFUSED], False, True, 130),
        ([REFUSED, REFUSED], False, False, 2), ([REFUSED], True, False, 2), ([], False, False, 1),
        ([], True, False, 1), ([ERROR], False, False, 1), ([REFUSED, "killed"], False, False, 1),
        ([OK, REFUSED], True, False, 4), ([BUDGET, REFUSED], True, False, 4), ([OK, ERROR], True, False, 3),
        *(([OK, other], True, False, 3) for other in (BUDGET, "violations", "stalled", "nan", "overlaps")),
    ],
)  # fmt: skip
def test_the_status_of_several_results(statuses, usable, interrupted, status):
    for order in (statuses, statuses[::-1]):
        assert exit_status(order, usable=usable, interrupted=interrupted) == status


def row(mutant, wild=OK, energy=-1.0):
    return dict.fromkeys((column.key for column in COLUMNS), None) | {
        "record": "design-7", "chain": "A", "residue": "2", "wild": "A", "mutant": "G", "mutations": "A:A2G",
        "status": mutant, "status_wild": wild, "energy_mutant_kj_mol": energy, "message": "",
    }  # fmt: skip


MUTANTS = [
    ([row(OK)], 0), ([row(OK), row(BUDGET)], 3), ([row(OK, BUDGET)], 3), ([row(REFUSED, None, None)], 2),
    ([row(OK), row(REFUSED, None, None)], 4), ([row(ERROR, None, None)], 1),
    ([row("killed", None, None), row(REFUSED, None, None)], 1), ([row(OK), row(ERROR, None, None)], 3),
    ([row("interrupted")], 130),
]  # fmt: skip


@pytest.mark.parametrize(("rows", "status"), MUTANTS)
def test_mutants_end_by_both_sides_and_fail_without_any(rows, status, tmp_path, monkeypatch, capsys):
    """A single mutant, designs, and a scan."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(Processes, "started_early", lambda *_: nullcontext())
    monkeypatch.setattr(mutation_scan, "mutate_designs", lambda *_: rows)
    monkeypatch.setattr(mutation_scan, "run_scan", lambda *_: (pd.DataFrame(rows), False))
    (tmp_path / "d.fa").write_text(">a\nAAAAAAAAAG\n>b\nAAAAAAAAGA\n")
    assert run("mutate", SAMPLE, "--scan", "A:2") == status
    capsys.readouterr()
    assert run("mutate", SAMPLE, "--sequence", "d.fa#designs", "-o", "d") == status
    assert capsys.readouterr().out.count("design-7") == len(rows)
    monkeypatch.setattr(mutation_scan, "run_scan", lambda *_: (pd.DataFrame(rows), True))
    assert run("mutate", SAMPLE, "--scan", "A:2") == 130
    if len(rows) == 1 and rows[0]["energy_mutant_kj_mol"]:
        made = SimpleNamespace(record=lambda: rows[0], structure=None)
        made.mutant = SimpleNamespace(is_usable=True, provenance=lambda: None)
        monkeypatch.setattr("protochain.relaxation.mutations.mutate_at", lambda *_: made)
        monkeypatch.setattr(mutate.options, "write_models", lambda *_: None)
        assert run("mutate", SAMPLE, "A2G", "--json") == status


BEST = {
    1: "buried_area_angstrom2 buried_heavy_area_angstrom2 shape_complementarity packing hydrogen_bonds "
    "salt_bridges contacts contacts_per_residue hydrogen_bonds_percent_1 hydrogen_bonds_percent_2 "
    "hydrophobic_percent_1 hydrophobic_percent_2 interface_plddt iptm ipsae pdockq pdockq2 dockq fnat lddt "
    "lddt_pli",
    -1: "energy_kj_mol energy_1_kj_mol energy_2_kj_mol energy_per_area_kj_mol_nm2 energy_per_residue_kj_mol "
    "interaction_kj_mol coulomb_kj_mol lennard_jones_kj_mol generalised_born_kj_mol desolvation_kj_mol "
    "unsatisfied_polar_atoms clashes unsatisfied_percent_1 unsatisfied_percent_2 pae_angstrom irms_angstrom "
    "lrms_angstrom ligand_rmsd_angstrom ca_rmsd_1_angstrom ca_rmsd_2_angstrom hotspot_rmsd_angstrom",
}  # fmt: skip
"""Scores of which the highest, and the lowest, is the best. All others have no direction."""


def test_every_score_ranks_the_best_first_and_missing_values_last():
    scores = {**SCORES, **MAKEUP, **CONFIDENCES, **DOCKING}
    directions = {name: way for way, names in BEST.items() for name in names.split()}
    assert {name: of.better for name, of in scores.items() if of.better} == directions
    values = [None, 2.0, -3.0, 5.0, None, 0.0]
    for better in (1, -1, 0):
        ranked = sorted(values, key=lambda value: score._place(value, better))
        assert ranked == [*sorted([2.0, -3.0, 5.0, 0.0], reverse=better >= 0), None, None]


@pytest.mark.parametrize(("files", "alone"), [(["a", "b"], False), (["a"], True), (["a", "-"], True)])
def test_standard_input_is_scored_by_this_process(files, alone, monkeypatch):
    seen = []
    monkeypatch.setattr(Processes, "started_early", lambda *_: nullcontext())
    monkeypatch.setattr(
        score.options, "files_of", lambda inputs, _: [(f, Path(f), pc.Setup()) for f in inputs]
    )
    monkeypatch.setattr(
        "protochain.batches.scoring.score_files",
        lambda jobs, processes: seen.append(processes) or [("a", "no")],
    )
    assert run("score", *files) == 2
    assert (seen[0] is None) is alone
    if alone:
        assert "workers" in refusal("score", *files, "--workers", "2")


@pytest.mark.parametrize(("interrupted", "status"), [(False, 0), (True, 130)])
def test_a_search_that_is_interrupted_says_so(interrupted, status, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(
        "protochain.searching.search", lambda *_, **more: SimpleNamespace(interrupted=interrupted)
    )
    monkeypatch.setattr(importlib.import_module("protochain.cli.search"), "print_search", lambda *_: None)
    assert run("search", "GAG") == status
    assert ("--resume" in capsys.readouterr().err) is interrupted


@pytest.mark.parametrize(
    ("messages", "is_sound", "status"),
    [([""], True, 0), ([""], False, 3), (["", "no"], True, 4), (["", "no"], False, 4), (["no"], True, 2)],
)
def test_rows_of_a_command_end_by_those_without_a_result(messages, is_sound, status, tmp_path, capsys):
    rows = [{"file": f"{k}.pdb", "message": message} for k, message in enumerate(messages)]
    shown, table = [], tmp_path / "t.csv"
    with pytest.raises(typer.Exit) as ended:
        conclude(rows, {table: lambda: table_of(rows), None: None}, shown.extend, False, is_sound=is_sound)
    assert ended.value.exit_code == status
    # The table has all rows, and the terminal those with a result.
    assert len(pd.read_csv(table)) == len(rows)
    assert [row["message"] for row in shown] == [""] * messages.count("") and str(
        table
    ) in capsys.readouterr().out


@pytest.mark.parametrize(
    ("is_minimum", "is_stable", "status"), [(True, True, 0), (False, True, 3), (False, False, 3)]
)
def test_modes_of_a_point_with_torques_are_not_those_of_a_minimum(
    is_minimum, is_stable, status, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    modes = SimpleNamespace(is_minimum=is_minimum, is_stable=is_stable)
    monkeypatch.setattr("protochain.comparison.normal_modes.normal_modes", lambda *_, **more: modes)
    monkeypatch.setattr("protochain.comparison.modes_folder.write_modes", lambda *_, **more: {})
    assert run("modes", SAMPLE, "--no-relax", "--json") == status
