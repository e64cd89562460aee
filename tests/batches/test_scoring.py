"""Interfaces of many complexes: the same numbers and the same order, whoever scores them."""

from pathlib import Path

import pytest
from fixtures.samples import STRUCTURES

import protochain as pc
from protochain.batches.cluster import Processes
from protochain.batches.scoring import ScoreJob, score_files

SETUP = pc.Setup(threads=1, solvent="vacuum")


@pytest.mark.slow
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
