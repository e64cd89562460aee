"""How ``minimise`` and ``batch`` put their parts together, with parts that note what they get."""

import pickle
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from fixtures.samples import STRUCTURES, chain
from fixtures.told_energy import told
from threadpoolctl import threadpool_info

import protochain as pc
from protochain.batches import Batch, BatchSettings, child
from protochain.batches import batch_structures as batches
from protochain.batches.cluster import Processes
from protochain.batches.jobs import failure, find_jobs
from protochain.minimisers import RECIPES, minimise_structure
from protochain.minimisers.loop import Stop
from protochain.minimisers.minimise_structure import Minimisation
from protochain.minimisers.saddle import ROUNDS, SHARE_OF_RUN, Curvature
from protochain.minimisers.spaces import spaces
from protochain.minimisers.start import Start


@pytest.fixture
def noted(monkeypatch):
    """Parts of a minimisation that note what they are given."""
    seen = SimpleNamespace(saved=[], loaded=[], rows=[], stages=[])

    def walk(plan, x, max_evaluations, allowed, note, waypoint):
        seen.walk = SimpleNamespace(plan=plan, x=x, most=max_evaluations, allowed=allowed, waypoint=waypoint)
        for k, space in enumerate(spaces(chain("ala10.pdb")), 1):
            n = space.chain.n_v if k == 1 else 3 * len(space.moving)
            at = SimpleNamespace(x=f"x{k}", energy=10.0, restraint=float(k), torque=np.full(n, 5.0))
            note(at, SimpleNamespace(space=space, name=f"stage {k}", recorded=True), k)
            note(at, SimpleNamespace(space=space, name="apart", recorded=False), k)
        return seen.done

    def load(*given):
        seen.loaded.append(given)
        return "the waypoint"

    seen.done = SimpleNamespace(waypoint=None)
    monkeypatch.setattr(minimise_structure, "walk", walk)
    monkeypatch.setattr(minimise_structure, "load_checkpoint", load)
    monkeypatch.setattr(minimise_structure, "save_checkpoint", lambda *given: seen.saved.append(given))
    return seen


class Noting:
    """A recorder that notes what it is told."""

    def __init__(self, rows, stages):
        self.rows, self.stages = rows, stages
        self.frame = SimpleNamespace(held_by="")

    def __call__(self, *row):
        self.rows.append(row)

    def at_stage(self, name, n_evaluations):
        self.stages.append((name, n_evaluations))


def walked(noted, method="lbfgs", **settings):
    start = Start(chain("ala10.pdb"), told())
    run = Minimisation(RECIPES[method], **settings)
    assert minimise_structure._walked(start, run, Noting(noted.rows, noted.stages)) is noted.done
    return start, run


def test_a_walk_is_of_the_plan_within_the_budget_and_recorded_without_restraints(noted):
    start, _ = walked(noted, max_evaluations=7, tolerance=3.0, restraint=(5.0, 0.0), curvature=False)
    assert [stage.tolerance for stage in noted.walk.plan] == [3.0, 3.0]
    assert [stage.restraint is None for stage in noted.walk.plan] == [False, True]
    assert (noted.walk.x is start.chain.structure.positions, noted.walk.most) == (True, 7)
    assert noted.walk.allowed is None and noted.walk.waypoint is None
    torques = {"rms_torque_kj_mol_rad": 5.0, "max_torque_kj_mol_rad": 5.0}
    forces = {"rms_force_kj_mol_nm": 5.0, "max_force_kj_mol_nm": 5.0 * np.sqrt(3.0)}
    assert noted.rows == [("x1", 9.0, pytest.approx(torques), 1), ("x2", 8.0, pytest.approx(forces), 2)]
    assert noted.stages == [("stage 1", 1), ("apart", 1), ("stage 2", 2), ("apart", 2)]
    assert noted.saved == noted.loaded == []


def test_a_walk_in_torsions_looks_at_its_end(noted):
    walked(noted)
    first, look, again, *_, final = noted.walk.plan
    assert (look.looks, look.recorded, look.restraint, look.tolerance) == (True, False, None, -np.inf)
    assert look.method == Curvature(1.0, floats=True) and final.method == replace(look.method, leaves=False)
    assert (again.method, again.after, first.after) == (first.method, (Stop.SADDLE,), ())
    assert len(noted.walk.plan) == 1 + 2 * ROUNDS + 1


@pytest.mark.parametrize("method", ["hybrid", "cartesian"])
def test_a_walk_in_all_atoms_looks_at_its_end_at_tight_tolerances_or_if_asked(noted, method):
    asked = (
        (None, None, False),
        (1.01, None, False),
        (1.0, None, True),
        (9.0, True, True),
        (0.1, False, False),
    )
    for tolerance, curvature, looks in asked:
        _, run = walked(noted, method, tolerance=tolerance, curvature=curvature)
        found = [stage for stage in noted.walk.plan if stage.looks]
        assert bool(found) is looks is run.examines
        for stage in found:
            assert (stage.method.floats, stage.method.share) == (True, SHARE_OF_RUN)
            assert stage.method.tolerance == tolerance and stage.space is noted.walk.plan[-2].space
    assert not Minimisation(RECIPES["openmm"], tolerance=0.1, curvature=True).examines


def test_a_walk_that_parts_overlaps_records_its_start_first(noted, monkeypatch):
    monkeypatch.setattr("protochain.minimisers.recipes.overlaps", lambda *_: ["one"])
    start, _ = walked(noted)
    assert noted.rows[0][1:] == (start.judgement.energy, start.judgement.sizes, 0)
    assert np.array_equal(noted.rows[0][0], start.pose.x) and len(noted.rows) == 3


def test_a_limit_of_the_rmsd_is_one_of_the_result(noted):
    start, _ = walked(noted, max_rmsd=0.5)
    leash = noted.walk.allowed.__self__
    assert (leash.structure, leash.limit) == (start.chain.structure, 0.5)


def test_checkpoints_are_read_before_and_written_after(noted):
    start, run = walked(noted, resume="in.npz")
    ((*asked, x),) = noted.loaded
    assert asked == [Path("in.npz"), noted.walk.plan, run.settings(start)]
    assert np.array_equal(x, start.chain.structure.positions)
    assert noted.walk.waypoint == "the waypoint" and noted.saved == []
    noted.done.waypoint = "the end"
    start, run = walked(noted, checkpoint="out.npz")
    assert noted.saved == [(Path("out.npz"), "the end", run.settings(start))] and len(noted.loaded) == 1
    noted.done.waypoint = None
    walked(noted, checkpoint="out.npz")
    walked(noted)
    assert len(noted.saved) == 1


def test_openmms_minimiser_gets_the_settings_and_records_forces(monkeypatch):
    given, rows, stages = [], [], []
    x = chain("ala10.pdb").structure.positions

    def by_openmm(*parts):
        given.append(parts[:-1])
        parts[-1](x, -5.0, 3, np.full(x.shape, 2.0))
        return "the outcome"

    monkeypatch.setattr(minimise_structure, "minimise_by_openmm", by_openmm)
    start = Start(chain("ala10.pdb"), told())
    run = Minimisation(RECIPES["openmm"], tolerance=2.0, max_evaluations=7, seed=3)
    assert minimise_structure._by_openmm(start, run, Noting(rows, stages)) == "the outcome"
    assert given == [(RECIPES["openmm"], start.chain, start.energy, 2.0, 7, 3)]
    (row,) = rows
    sizes = {"rms_force_kj_mol_nm": 2.0, "max_force_kj_mol_nm": 2.0 * np.sqrt(3.0)}
    assert row[0] is x and row[1:] == (-5.0, pytest.approx(sizes), 3) and stages == [("all atoms", 3)]


@pytest.mark.parametrize(("method", "by"), [("lbfgs", "_walked"), ("openmm", "_by_openmm")])
def test_a_run_is_warmed_up_before_its_clock_starts_and_judged_after_it_stops(method, by, monkeypatch):
    log, outcome = [], SimpleNamespace(stop=Stop.BUDGET, n_evaluations=3)

    def solved(start, run, record):
        assert {each["num_threads"] for each in threadpool_info() if each["user_api"] == "blas"} <= {1}
        log.append("run")
        return outcome

    def judged(start, run, done, record, seconds):
        log.append((done, seconds + record.started, record.structure is start.chain.structure, record.watch))
        return "the solution"

    monkeypatch.setattr(Start, "warm", lambda self, recipe: log.append(("warm", recipe.name)))
    monkeypatch.setattr(minimise_structure, by, solved)
    monkeypatch.setattr(minimise_structure, "_judged", judged)
    monkeypatch.setattr(minimise_structure, "perf_counter", lambda: 12.5)
    start = Start(chain("ala10.pdb"), SimpleNamespace(system="some", atoms="amber14"))
    assert minimise_structure.minimise_from(start, Minimisation(RECIPES[method]), len) == "the solution"
    # The clock began when the record was made, by the true clock.
    assert log == [("warm", method), "run", (outcome, pytest.approx(12.5), True, len)]
    with pytest.raises(pc.ProtochainError, match="needs an OpenMM System"):
        minimise_structure.minimise_from(
            Start(chain("ala10.pdb"), SimpleNamespace(system=None, atoms="")), Minimisation(RECIPES["openmm"])
        )


@pytest.fixture
def handed(monkeypatch):
    """A batch whose jobs are not done, and what its parts are given."""
    seen = SimpleNamespace(interrupted=False, done=0, works=[], finished=[])

    @contextmanager
    def at_work(processes):
        seen.processes = processes
        yield "the workers"

    def work(workers, todo, tables, processes, skipped, watch):
        seen.works.append((workers, [job.name for job in todo], processes, skipped, watch))
        for job in todo[: seen.done]:
            tables.append([failure(job, method, "budget", "") for method in job.settings.methods])
        return seen.interrupted

    monkeypatch.setattr(batches, "at_work", at_work)
    monkeypatch.setattr(batches, "_work", work)
    monkeypatch.setattr(
        batches, "_finish", lambda tables, jobs: seen.finished.append((tables.folder, len(jobs)))
    )
    return seen


def test_a_batch_hands_its_settings_to_their_parts(handed, tmp_path):
    inputs, out = [STRUCTURES / "ala10.pdb", STRUCTURES / "1l2y.pdb"], tmp_path / "out"
    handed.done = 1
    options = {"workers": 2, "threads": 3, "time_limit": 9.0, "seed": 4, "ph": 5.0, "watch": len}
    assert batches.batch(inputs, out, ("kcm", "lbfgs"), **options) == Batch(out, False)
    processes = Processes(2, None, 3, 9.0)
    assert handed.processes == processes and handed.finished == [(out, 2)]
    assert handed.works == [("the workers", ["ala10", "1l2y"], processes, 0, len)]
    settings = BatchSettings(("kcm", "lbfgs"), seed=4, setup=pc.Setup(ph=5.0))
    keys = {job.key for job in find_jobs(inputs, settings)}
    assert set(batches.Batch(out).table["key"]) <= keys
    # What is finished is not done again; when all is, no cluster is needed.
    handed.interrupted, handed.done = True, 9
    assert batches.batch(inputs, str(out), ["kcm", "lbfgs"], resume=True, **options) == Batch(out, True)
    assert handed.works[1][1] == ["1l2y"] and handed.works[1][3] == 1
    assert batches.batch(inputs, out, ("kcm", "lbfgs"), resume=True, **options) == Batch(out, False)
    assert len(handed.works) == 2 and len(handed.finished) == 3
    assert Batch(out).table["structure"].tolist() == ["ala10", "ala10", "1l2y", "1l2y"]


def test_a_batch_of_one_file_by_one_method_or_of_a_manifest(handed, tmp_path):
    (tmp_path / "list.csv").write_text(f"path,seed\n{STRUCTURES / '1l2y.pdb'},3\n")
    batches.batch(str(STRUCTURES / "ala10.pdb"), tmp_path / "a", "kcm", manifest=tmp_path / "list.csv")
    assert handed.works[0][1] == ["ala10", "1l2y"] and handed.processes == Processes()
    batches.batch([], tmp_path / "b", manifest=str(tmp_path / "list.csv"))
    assert handed.works[1][1] == ["1l2y"]
    for name in ("a", "b"):
        # The lock is released.
        batches.Tables(tmp_path / name, resume=True).close()
    with pytest.raises(
        pc.ProtochainError, match="no setting is called 'colour'; choose from workers, scheduler, "
    ):
        batches.batch([], tmp_path / "c", colour="red")


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
