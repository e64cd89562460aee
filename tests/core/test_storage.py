"""What is saved, and said, when the disk is full."""

import json
import os
import resource
import sys
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mdtraj
import numpy as np
import pandas as pd
import pytest
from fixtures.samples import STRUCTURES, chain, energy

import protochain as pc
from protochain.batches import table as tables
from protochain.cli import main
from protochain.cli.minimise import _Frames
from protochain.comparison.folder import clear
from protochain.core import storage
from protochain.core.checkpoints import checkpoint, write_checkpoint
from protochain.core.errors import WriteError
from protochain.core.storage import claim_folder, json_text, temporary_stem, write_atomically
from protochain.structure.formats.trajectory import TrajectoryFile

SAMPLE = STRUCTURES / "ala10.pdb"


@contextmanager
def full_above(n_bytes):
    """Let no file grow above a size: writing more fails as on a full disk, with another number."""
    usual = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (n_bytes, usual[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, usual)


@pytest.mark.parametrize("mask", [0o022, 0o027, 0o077])
def test_files_have_the_permissions_of_new_files(mask, tmp_path):
    usual = os.umask(mask)
    try:
        write_atomically(tmp_path / "a.txt", lambda path: path.write_text("a"))
    finally:
        os.umask(usual)
    assert (tmp_path / "a.txt").stat().st_mode & 0o777 == 0o666 & ~mask


def run(monkeypatch, *arguments):
    """Status of a command in this process, whose kernels are compiled."""
    monkeypatch.setattr(sys, "argv", ["protochain", *map(str, arguments)])
    with pytest.raises(SystemExit) as ended:
        main()
    return ended.value.code


@pytest.fixture(scope="module", autouse=True)
def warm():
    """Compile and cache before files are limited."""
    c, e = chain("ala10.pdb"), energy("ala10.pdb")
    pc.simulate(c, e, n_steps=2)
    return pc.minimise(c, e, "hybrid")


def test_a_file_that_cannot_be_written_is_named_and_leaves_the_old_one(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("old")
    with full_above(1000), pytest.raises(WriteError, match=r"a\.txt: not written \(File too large\)"):
        write_atomically(path, lambda to: to.write_text("x" * 5000))
    assert path.read_text() == "old" and [each.name for each in tmp_path.iterdir()] == ["a.txt"]


@pytest.mark.parametrize("suffix", ["dcd", "xtc"])
def test_a_trajectory_that_fills_the_disk_does_not_cost_the_result(suffix, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    with full_above(20_000):
        status = run(
            monkeypatch,
            "minimise",
            SAMPLE,
            "-o",
            "out.pdb",
            "--trajectory",
            f"t.{suffix}",
            "--json",
            "--tolerance",
            "0.1",
        )
    said = capsys.readouterr()
    assert status == 3 and json.loads(said.out)["status"] == "converged"
    assert f"t.{suffix}: not written (" in said.err and "Saved: out.pdb" in said.err
    assert [path.name for path in tmp_path.iterdir()] == ["out.pdb"]


@pytest.mark.parametrize("suffix", ["dcd", "xtc"])
def test_a_trajectory_that_fills_the_disk_makes_room_at_once(suffix, tmp_path):
    """The space may save the result, so that it is not kept until the run has ended."""
    c, lost = chain("ala10.pdb"), []
    with full_above(20_000), _Frames(tmp_path / f"t.{suffix}", c.structure, lost) as frames:
        while not lost:
            frames(c.structure.positions)
            assert lost or list(tmp_path.iterdir())
        assert not list(tmp_path.iterdir())
        frames(c.structure.positions)
    assert len(lost) == 1 and not list(tmp_path.iterdir())


def test_a_checkpoint_that_fills_the_disk_does_not_cost_the_result(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    with full_above(12_000):
        status = run(monkeypatch, "minimise", SAMPLE, "-o", "out.pdb", "--checkpoint", "c.npz")
    said = capsys.readouterr()
    assert status == 3 and "c.npz: not written (File too large)" in said.err and "converged" in said.out
    assert [path.name for path in tmp_path.iterdir()] == ["out.pdb"]


def test_a_result_that_does_not_fit_is_one_line_and_status_1(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    with full_above(1000):
        assert run(monkeypatch, "minimise", SAMPLE, "-o", "out.pdb") == 1
    line = capsys.readouterr().err.splitlines()[-1]
    assert line.startswith("protochain: out.pdb: not written (File too large); ") and "free space" in line
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("suffix", ["dcd", "xtc"])
def test_a_simulation_that_fills_the_disk_goes_on_when_there_is_space(suffix, tmp_path):
    c, e = chain("ala10.pdb"), energy("ala10.pdb")
    settings = {"n_steps": 300, "every": 2, "checkpoint_every": 10, "trajectory": suffix, "seed": 3}
    whole = pc.simulate(c, e, output=tmp_path / "whole", **settings)
    cut = tmp_path / "cut"
    with full_above(30_000), pytest.raises(WriteError, match=r"saved: .* step .*resume=True"):
        pc.simulate(c, e, output=cut, **settings)
    names = {path.name for path in cut.iterdir()}
    assert names == {"checkpoint.npz", "log.csv", f"trajectory.{suffix}"}
    frames = mdtraj.load(
        str(cut / f"trajectory.{suffix}"), top=mdtraj.Topology.from_openmm(c.structure.topology)
    )
    with checkpoint(cut / "checkpoint.npz", {}, "run") as kept:
        values = kept.values
    assert frames.n_frames == len(pd.read_csv(cut / "log.csv")) == values["frames"] > 10
    on = pc.simulate(c, e, output=cut, resume=True, **settings)
    assert np.array_equal(on.q, whole.q)
    assert (cut / "log.csv").read_bytes() == (tmp_path / "whole" / "log.csv").read_bytes()


def test_a_trajectory_that_cannot_begin_leaves_nothing(tmp_path):
    with full_above(10), pytest.raises(WriteError, match=r"t\.dcd"):
        TrajectoryFile(tmp_path / "t.dcd", chain("ala10.pdb").structure)
    assert not list(tmp_path.iterdir())


def test_a_row_of_a_batch_is_whole_or_not_there(tmp_path):
    path = tmp_path / "summary.csv"
    path.write_text("x" * 900)
    with full_above(1000), pytest.raises(WriteError, match=r"summary\.csv: .*resume=True"):
        tables._append(path, "y" * 200 + "\n")
    assert path.read_text() == "x" * 900


@pytest.mark.parametrize("suffix", ["dcd", "xtc"])
def test_what_a_killed_run_left_is_replaced(suffix, tmp_path):
    """A trajectory begins anew, though a part of another is there."""
    stale = tmp_path / f"t.part.{suffix}"
    stale.write_bytes(b"x" * 100_000)
    c = chain("ala10.pdb")
    with TrajectoryFile(tmp_path / f"t.{suffix}", c.structure) as file:
        file.append(c.structure.positions)
    frames = mdtraj.load(str(tmp_path / f"t.{suffix}"), top=mdtraj.Topology.from_openmm(c.structure.topology))
    assert frames.n_frames == 1 and not stale.exists()


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full")
@pytest.mark.parametrize(
    "words", [("rmsd", SAMPLE, SAMPLE), ("info", SAMPLE, "--json"), ("build", "AAA", "-o", "-"), ("--help",)]
)
@pytest.mark.parametrize("gone", ["room", "reader"])
def test_output_that_nobody_can_take_is_one_line(words, gone, tmp_path, monkeypatch, capsys):
    """A reader that has enough, as ``head``, needs none: the status is of programs that SIGPIPE (13) ends."""
    monkeypatch.chdir(tmp_path)
    reads, writes = os.pipe()
    os.close(reads)
    with Path("/dev/full").open("w") as full, os.fdopen(writes, "w") as pipe:
        monkeypatch.setattr(sys, "stdout", full if gone == "room" else pipe)
        status = run(monkeypatch, *words)
        monkeypatch.undo()
    said = capsys.readouterr().err
    assert status == (1 if gone == "room" else 141)
    assert ("standard output: not written (No space left on device)" in said) == (gone == "room")


def test_a_checkpoint_of_the_disk_is_read_as_it_was(tmp_path):
    write_checkpoint(tmp_path / "c.npz", {"a": np.arange(3)}, {"b": 1}, {"c": 2})
    with checkpoint(tmp_path / "c.npz", {"c": 2}, "run") as kept:
        assert kept.arrays["a"].tolist() == [0, 1, 2] and kept.values == {"b": 1}


# --- Folders of comparisons


def test_a_comparison_is_replaced_only_when_asked_and_whole(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    out = tmp_path / "out"
    out.mkdir()
    old = ("old.lbfgs.pdb", "old.fire.pdb", "old.start.pdb", "summary.csv", "report.html")
    for name in (*old, "notes.txt"):
        (out / name).write_text("old")
    results = [{"output": "old.lbfgs.pdb"}, {"output": "../notes.pdb"}, {"output": "old.fire.pdb"}]
    (out / "summary.json").write_text(json.dumps({"structure": "old", "results": results}))
    (tmp_path / "notes.pdb").write_text("mine")
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    again = ("compare", SAMPLE, "-o", "out", "--methods", "kcm", "--max-evaluations", 5)
    assert run(monkeypatch, *again) == 2
    line = capsys.readouterr().err.splitlines()[-1]
    assert "out: contains a comparison (report.html); give another folder, or --force to replace it" in line
    assert {path.name: path.read_bytes() for path in out.iterdir()} == before
    assert run(monkeypatch, *again, "--force") == 3
    assert {path.stem for path in out.glob("*.pdb")} == {"ala10.kcm", "ala10.start"}
    assert (out / "summary.csv").read_text() != "old" and not (out / ".lock").exists()
    assert (out / "notes.txt").read_text() == "old" and (tmp_path / "notes.pdb").exists()


@dataclass(frozen=True)
class Standing:
    """A method that finds nothing."""

    states = ()

    def init(self, problem, at):
        return self._State(at)

    def step(self, problem, state):
        return None

    @dataclass(frozen=True)
    class _State:
        at: Any


def test_a_comparison_without_any_result_is_cleared_whole(tmp_path):
    k = pc.compare(chain("ala10.pdb"), (Standing(),), energy("ala10.pdb"))
    k.report(tmp_path)
    assert [path.name for path in tmp_path.glob("*.pdb")] == ["ala10.start.pdb"]
    clear(tmp_path)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("evaluations", [1, 30])
def test_a_trajectory_stays_only_beside_a_result(evaluations, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    frames = tmp_path / "t.dcd"
    frames.write_text("old")
    status = run(monkeypatch, "minimise", SAMPLE, "-o", "o.pdb", "--trajectory", "t.dcd", "--force",
                 "--method", "lbfgs", "--max-evaluations", evaluations)  # fmt: skip
    if evaluations == 1:
        assert status == 1 and "No file is written" in capsys.readouterr().err
        assert frames.read_text() == "old"
    else:
        assert status in (0, 3) and frames.stat().st_size > 1000
    assert not list(tmp_path.glob("*.part*")) and (tmp_path / "o.pdb").exists() == (evaluations > 1)


def test_a_comparison_does_not_share_its_folder(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    work = ("compare", SAMPLE, "-o", "out", "--methods", "lbfgs", "--max-evaluations", 5)
    with claim_folder(tmp_path / "out", "comparison"), monkeypatch.context() as another:
        another.setattr(storage, "_LOCKS", set())  # As in another process.
        assert run(monkeypatch, *work) == 2
    assert "another comparison is writing to this folder" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "checkpoint.npz").touch()
    assert run(monkeypatch, *work, "--force") == 2
    assert "contains a batch or simulation (checkpoint.npz)" in capsys.readouterr().err


def test_what_a_killed_run_left_goes_when_it_is_resumed_and_nothing_else(tmp_path):
    left = [f"{temporary_stem()}.part.png", f"pages/{temporary_stem()}.part"]
    own = [".x.settings.json", ".notes.20260101.txt", ".a.ab1cd_fg.png", ".protochain-notes.part", "a.pdb"]
    (tmp_path / "pages").mkdir()
    for name in (*left, *own):
        (tmp_path / name).write_text("x")
    with claim_folder(tmp_path, "batch"):
        assert all((tmp_path / name).exists() for name in (*left, *own))
    with claim_folder(tmp_path, "batch", resume=True):
        assert [name for name in (*left, *own) if (tmp_path / name).exists()] == own


def test_settings_of_a_checkpoint_that_are_no_mapping_are_refused(tmp_path):
    path = tmp_path / "x.npz"
    np.savez(path, text=np.array(json.dumps({"settings": 1.5, "values": {}})))
    with pytest.raises(pc.ProtochainError, match="is not a checkpoint"):
        checkpoint(path, {"task": "x"}, "run").__enter__()


def test_what_is_written_as_json_has_no_infinity():
    values = {"max_rmsd": np.inf, "deep": [{"x": -np.inf}, (np.nan, 1.5)], "path": Path("a"), "n": 3}
    assert json.loads(json_text(values), parse_constant=pytest.fail) == {
        "max_rmsd": None, "deep": [{"x": None}, [None, 1.5]], "path": "a", "n": 3,
    }  # fmt: skip
