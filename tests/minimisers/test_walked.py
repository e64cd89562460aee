"""Where a minimisation looks at its end, and the pipes of a batch's child."""

import pickle
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from fixtures.samples import chain
from fixtures.told_energy import told

from protochain.batches import child
from protochain.minimisers import RECIPES, minimise_structure
from protochain.minimisers.loop import Stop
from protochain.minimisers.minimise_structure import Minimisation
from protochain.minimisers.saddle import ROUNDS, Curvature
from protochain.minimisers.start import Start


@pytest.fixture
def noted(monkeypatch):
    """The plan of a minimisation, which is not walked."""
    seen = SimpleNamespace()

    def walk(plan, *_):
        seen.plan = plan
        return SimpleNamespace(waypoint=None)

    monkeypatch.setattr(minimise_structure, "walk", walk)
    return seen


def walked(noted, method="lbfgs", **settings):
    run = Minimisation(RECIPES[method], **settings)
    record = SimpleNamespace(frame=SimpleNamespace(held_by=""))
    minimise_structure._run_stages(Start(chain("ala10.pdb"), told()), run, record)
    return run


def test_a_walk_in_torsions_looks_at_its_end(noted):
    walked(noted)
    first, look, again, *_, final = noted.plan
    assert (look.looks, look.recorded, look.restraint, look.tolerance) == (True, False, None, -np.inf)
    assert look.method == Curvature(1.0, floats=True) and final.method == replace(look.method, leaves=False)
    assert (again.method, again.after, first.after) == (first.method, (Stop.SADDLE,), ())
    assert len(noted.plan) == 1 + 2 * ROUNDS + 1


@pytest.mark.parametrize("method", ["hybrid", "cartesian"])
def test_a_walk_in_all_atoms_looks_at_its_end_at_tight_tolerances_or_if_asked(noted, method):
    asked = (
        (None, None, False), (1.01, None, False), (1.0, None, True), (9.0, True, True), (0.1, False, False),
    )  # fmt: skip
    for tolerance, curvature, looks in asked:
        run = walked(noted, method, tolerance=tolerance, curvature=curvature)
        found = [stage for stage in noted.plan if stage.looks]
        assert bool(found) is looks is run.computes_curvature
        for stage in found:
            assert stage.method.floats and stage.method.tolerance == tolerance
            assert stage.space is noted.plan[-2].space
    assert not Minimisation(RECIPES["openmm"], tolerance=0.1, curvature=True).computes_curvature


@pytest.mark.parametrize("cut", [b"", pickle.dumps(("three", 3))[:-3], b"\x00"])
def test_a_child_reads_jobs_until_the_pipe_closes_in_the_middle_of_one_or_not(cut, tmp_path, monkeypatch):
    jobs, file = child.queue.Queue(), tmp_path / "in"
    file.write_bytes(pickle.dumps("one") + pickle.dumps(("two", 2)) + cut)

    class Gone(Exception):
        pass

    def leave(status):
        raise Gone(status)

    monkeypatch.setattr(child.os, "_exit", leave)
    with file.open("rb") as source, pytest.raises(Gone, match="0"):
        child._read(source, jobs)
    assert [jobs.get(block=False) for _ in range(jobs.qsize())] == ["one", ("two", 2)]


def test_a_child_sends_each_message_at_once(tmp_path):
    with (tmp_path / "out").open("wb") as target:
        child._send(target, ("a row", 1))
        assert pickle.loads((tmp_path / "out").read_bytes()) == ("a row", 1)
    assert (child.READY, child.DONE) == ("ready", "done")
