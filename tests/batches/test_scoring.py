"""Interfaces of many complexes: the same numbers and the same order, whoever scores them."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from fixtures.command_line import refusal, run
from fixtures.samples import STRUCTURES

import protochain as pc
from protochain.batches.cluster import Processes
from protochain.batches.scoring import ScoreJob, score_files

SETUP = pc.Setup(threads=1, solvent="vacuum")


@pytest.mark.slow
@pytest.mark.usefixtures("worker_processes")
def test_processes_score_as_this_one_does_in_the_order_of_the_files(tmp_path):
    bad = tmp_path / "bad.pdb"
    bad.write_text("no structure")
    paths = (STRUCTURES / "3i40.pdb", bad, STRUCTURES / "ala10.pdb", STRUCTURES / "1ysa.pdb")
    jobs = [ScoreJob(path.name, path, SETUP) for path in paths]
    here, there = [*score_files(jobs, None)], [*score_files(jobs, Processes(2))]
    assert [name for name, _ in here] == [name for name, _ in there]
    assert [*dict.fromkeys(name for name, _ in here)] == [path.name for path in paths]
    for (name, own), (_, other) in zip(here, there, strict=True):
        if isinstance(own, str):
            assert own == other and Path(name).name in own
        else:
            assert own.record() == other.record()
            assert own.residues.equals(other.residues)
    refused = {name for name, its in here if isinstance(its, str)}
    assert refused == {"bad.pdb", "ala10.pdb"}


def test_a_process_that_ends_costs_its_complex_alone():
    job = ScoreJob("a.pdb", Path("a.pdb"), SETUP)
    assert job.lost([], "killed", "ended by SIGKILL", 1.0) == [("a.pdb", "a.pdb: ended by SIGKILL")]


PREDICTED = {
    "boltz/one/one_model_0.cif": ("confidence_one_model_0.json", {"iptm": 0.9, "pair_chains_iptm": {
        "0": {"0": 1.0, "1": 0.5}, "1": {"0": 0.5, "1": 1.0}}}),
    "chai/one/pred.model_idx_0.cif": ("scores.model_idx_0.npz", {"iptm": np.array([0.3])}),
    "af3/one/one_model.cif": ("one_summary_confidences.json", {"iptm": 0.7}),
    "af3/two/one_model.cif": ("one_summary_confidences.json", {"iptm": 0.6}),
    "colabfold/one_unrelaxed_rank_001_alphafold2_multimer_v3_model_1_seed_000.pdb": (
        "one_scores_rank_001_alphafold2_multimer_v3_model_1_seed_000.json", {"iptm": 0.2}),
}  # fmt: skip
"""Models as their programs call them, and their confidences."""


def test_a_folder_of_predictions_is_ranked_by_confidence(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    s = pc.load(STRUCTURES / "3i40.pdb")
    for model, (name, values) in PREDICTED.items():
        path = Path("out", model)
        path.parent.mkdir(parents=True, exist_ok=True)
        pc.save(s, path)
        if name.endswith("npz"):
            np.savez(path.with_name(name), **values)
        else:
            path.with_name(name).write_text(json.dumps(values))
    options = ("--interface", "A:B", "--solvent", "vacuum", "--workers", "1", "--csv", "s.csv")
    assert run("score", "out", *options, "--rank", "ipTM") == 0
    table = pd.read_csv("s.csv")
    assert table["iptm"].tolist() == [0.7, 0.6, 0.5, 0.3, 0.2]
    assert [file.split("/")[1] for file in table["file"]] == ["af3", "af3", "boltz", "chai", "colabfold"]
    # Equal names are printed with their folders.
    assert "out/af3/two/one_model.cif" in capsys.readouterr().out
    message = refusal("score", "out", "--rank", "iptn")
    assert "is not known" in message
    assert "iptm" in message
