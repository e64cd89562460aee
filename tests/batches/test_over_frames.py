"""Runs over frames: the same numbers as each frame by itself, in order, whatever ends in between."""

import csv
import os
import signal
import struct
import subprocess
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from fixtures.command_line import COMMAND
from fixtures.frames import models, saved, shaken
from fixtures.refusals import expect_refusal
from fixtures.samples import load
from fixtures.texts import explored
from fixtures.tolerances import RIGID_MOTION
from fixtures.waiting import until

import protochain as pc
from protochain.batches import Processes, cluster
from protochain.batches.frame_files import run_frames
from protochain.batches.frame_report import _MOST_FIGURES, _along, _medians, _worst_first, write_report
from protochain.batches.frame_tasks import EnergyFrames, RelaxFrames, ValidateFrames, prepare_task, row_of
from protochain.batches.frames import ensemble_of, over_frames, relax_frames
from protochain.relaxation import RelaxSettings
from protochain.results.columns import heading
from protochain.structure.formats.frames import Frame, open_frames

SMALL = "ala10.pdb"
SETUP = pc.Setup(threads=1)
RELAX = RelaxFrames(RelaxSettings(), SETUP)


@pytest.fixture
def x():
    """Five frames, of which one has no numbers."""
    made = shaken(load(SMALL), 5, by=0.01)
    made[2, 7] = np.nan
    return made


def opened(x, structure=None):
    return ensemble_of(structure or load(SMALL), x, None, SETUP)


def test_a_frame_is_relaxed_as_it_is_by_itself_whatever_came_before(x):
    results = [*relax_frames(load(SMALL), x, threads=1)]
    assert [each.frame for each in results] == [*range(5)]
    assert [each.record["status"] for each in results] == ["converged"] * 2 + ["refused"] + ["converged"] * 2
    bad = results.pop(2)
    assert bad.structure is None and bad.record["message"].startswith("frame 2: ")
    for each in results:
        alone = pc.relax(load(SMALL).with_positions(x[each.frame]), threads=1)
        assert np.array_equal(each.structure.positions, alone.x)
        assert each.record["energy_end_reference_kj_mol"] == alone.energy_end
        assert each.record["violations_end"] == alone.measures_end["violations"]
        assert each.record["ca_rmsd_angstrom"] == alone.ca_rmsd_angstrom
    (last,) = relax_frames(load(SMALL), x, -1, threads=1)
    assert np.array_equal(last.structure.positions, results[-1].structure.positions)


def test_a_frame_has_lists_of_its_own():
    """Far fields differ in their last bits by where the lists were made."""
    s, setup = load("1ubq.pdb"), pc.Setup(threads=1, accuracy=0.01)
    x = s.positions + np.random.default_rng(0).normal(scale=1e-4, size=(2, *s.positions.shape))
    results = over_frames(*opened(x, s), EnergyFrames(setup, whole=True))
    alone = [pc.energy(s, accuracy=0.01, threads=1)(each)[0] for each in x]
    assert [each.record["energy_kj_mol"] for each in results] == alone


@pytest.mark.slow
@pytest.mark.usefixtures("worker_processes")
def test_processes_change_no_bit_and_no_order(tmp_path, x):
    path = saved(load(SMALL), x, tmp_path / "x.dcd")
    for given in (x, path):
        here = [*relax_frames(load(SMALL), given, threads=1)]
        there = [*relax_frames(load(SMALL), given, workers=2)]
        for own, other in zip(here, there, strict=True):
            assert (own.frame, own.record["message"]) == (other.frame, other.record["message"])
            if own.structure is not None:
                assert np.array_equal(own.structure.positions, other.structure.positions)


def in_this_process(monkeypatch, fate):
    """Do the jobs of processes here; what ``fate`` says of a frame happens to its process."""
    began = []

    def supervise(job, threads, time_limit):
        began.append(job.indices)
        rows = []
        for k, row in zip(job.indices, job.run(threads), strict=True):
            if fate(k):
                return [*rows, *job.lost(rows, "killed", "ended by SIGSEGV", 1.0)]
            rows.append(row)
        return rows

    prepare_task.cache_clear()
    monkeypatch.setattr(cluster, "supervise", supervise)
    return began


def test_a_frame_at_which_the_process_ends_is_named_and_all_others_are_done_in_order(monkeypatch, x):
    """Those after it in the same job, too; a slow frame keeps none of the others from being done."""
    slow = []

    def fate(k):
        if k == 0:
            until(lambda: len(slow) >= 2)
        slow.append(k)
        return k in (1, 9)

    many = np.concatenate([x[:2]] * 10)
    began = in_this_process(monkeypatch, fate)
    ensemble, chosen = opened(many)
    results = [*over_frames(ensemble, chosen, ValidateFrames(SETUP), Processes(3))]
    assert [each.frame for each in results] == [*range(20)]
    lost = [each.frame for each in results if each.structure is None]
    assert lost == [1, 9] and results[9].record["status"] == "killed"
    assert "frame 9" in results[9].record["message"] and "SIGSEGV" in results[9].record["message"]
    assert (2, 3, 4, 5, 6, 7) in began and max(map(len, began)) == 8


def test_frames_of_a_file_are_read_where_they_are_done(monkeypatch, tmp_path, x):
    ensemble, chosen = opened(saved(load(SMALL), x, tmp_path / "x.xtc"))
    given = []

    def supervise(job, *_):
        given.append(job.frames)
        return job.lost([], "killed", "", 0.0)

    monkeypatch.setattr(cluster, "supervise", supervise)
    assert len([*over_frames(ensemble, chosen, RELAX, Processes(1))]) == 5
    # Each once more, in another process, before it is given up.
    assert sorted(given) == sorted([(0,), (1,), (2,), (3,), (4,)] * 2)


def test_a_frame_at_which_the_process_ended_is_tried_again(monkeypatch, x):
    """What was read before it may have been the fault."""
    ends = [3, 4, 4]

    def fate(k):
        return k in ends and not ends.remove(k)

    began = in_this_process(monkeypatch, fate)
    ensemble, chosen = opened(np.concatenate([x[:2]] * 3))
    results = [*over_frames(ensemble, chosen, ValidateFrames(SETUP), Processes(1))]
    assert [each.record["status"] for each in results] == ["measured"] * 4 + ["killed", "measured"]
    assert began == [(0, 1, 2, 3, 4, 5), (3, 4, 5), (4, 5), (5,)]


@pytest.mark.usefixtures("worker_processes")
def test_a_damaged_frame_of_a_file_takes_no_other_with_it(tmp_path):
    """mdtraj writes beyond its memory where the bits of a frame of XTC are wrong, and ends later."""
    structure = load(SMALL)
    path = saved(structure, shaken(structure, 5, by=0.01), tmp_path / "x.xtc")
    content, start = bytearray(path.read_bytes()), struct.pack(">ii", 1995, structure.n_atoms)
    # Behind the start of the third frame: header, box, limits and the length of its bits.
    place = content.find(start, content.find(start, 4) + 4) + 92 + 60
    content[place : place + 60] = b"\xff" * 60
    path.write_bytes(content)
    ensemble, chosen = ensemble_of(structure, path, None, SETUP)
    results = [*over_frames(ensemble, chosen, ValidateFrames(SETUP), Processes(1))]
    assert [each.frame for each in results if each.structure is None] == [2]
    assert "frame 2: " in results[2].record["message"]


def test_a_bug_met_by_one_frame_is_in_its_row(x):
    ensemble, _ = opened(x)

    def act(structure):
        raise {0: ZeroDivisionError("oops"), 1: MemoryError()}[frame.index]

    for frame, status in ((Frame(0, x[0]), "error"), (Frame(1, x[1]), "killed")):
        row = row_of(ensemble, act, frame)
        assert (
            row.x is None
            and row.record["status"] == status
            and f"frame {frame.index}" in row.record["message"]
        )


def test_measures_and_energies_are_those_of_each_model(tmp_path, x):
    path = models(load("1l2y.pdb"), shaken(load("1l2y.pdb"), 2, by=0.01), tmp_path / "x.pdb")
    ensemble, chosen = ensemble_of(path, None, None, SETUP)
    reference = load("1l2y.pdb")
    measured = [*over_frames(ensemble, chosen, ValidateFrames(SETUP, reference))]
    energies = [*over_frames(ensemble, chosen, EnergyFrames(SETUP))]
    for k, (found, energy) in enumerate(zip(measured, energies, strict=True)):
        model = pc.load(path, model=k + 1)
        alone = pc.validate(model, reference, posebusters=False).measures
        assert {key: found.record[key] for key in alone} == dict(alone)
        (terms,) = pc.energy_terms(model).to_dict("records")
        assert {f"{key}_kj_mol" for key in terms} <= energy.record.keys()
        # Lists of neighbours are made anew, sums are in another order.
        assert energy.record["total_kj_mol"] == pytest.approx(terms["total"], rel=1e-12)


@pytest.mark.parametrize("workers", [None, 1])
def test_energies_of_frames_are_those_by_openmm(x, workers):
    table = pc.frame_energies(load(SMALL), x, slice(1, None), solvent="vacuum", workers=workers)
    assert table["frame"].tolist() == [1, 2, 3, 4] and table["status"].tolist()[1:2] == ["refused"]
    assert table["message"][1].startswith("frame 2: ")
    reference = pc.energy(load(SMALL), solvent="vacuum", engine="openmm").reference
    for row in table.drop(index=1).to_dict("records"):
        value, forces = reference(x[row["frame"]])
        assert row["energy_kj_mol"] == pytest.approx(value, rel=RIGID_MOTION)
        assert row["rms_force_kj_mol_nm"] == pytest.approx(np.sqrt(np.mean(forces**2)), rel=RIGID_MOTION)
    parts = "A:1-4,A:5-10"
    (shared,) = pc.frame_energies(load(SMALL), x, 3, between=parts, solvent="vacuum").to_dict("records")
    terms = pc.energy_terms(load(SMALL).with_positions(x[3]), between=parts, solvent="vacuum")
    for key, value in terms.stack().items():
        assert shared["_".join(key) + "_kj_mol"] == pytest.approx(value, rel=1e-9), key


def rows_of(path):
    """Rows without the seconds, which differ."""
    with path.open(newline="") as file:
        return [
            {key: value for key, value in row.items() if key != "seconds"} for row in csv.DictReader(file)
        ]


def content(path):
    """Bytes of a trajectory; the head of DCD has the time at which it was made."""
    return path.read_bytes()[276 if path.suffix == ".dcd" else 0 :]


def stop_after(n):
    def watch(done, failed, last):
        if done == n:
            raise KeyboardInterrupt

    return watch


@pytest.mark.parametrize(("suffix", "n"), [(".dcd", 1), (".xtc", 3), (".pdb", 5)])
def test_an_interrupted_run_goes_on_without_lost_or_doubled_frames(tmp_path, x, suffix, n):
    whole, stopped = tmp_path / f"whole{suffix}", tmp_path / f"stopped{suffix}"
    ensemble, chosen = opened(x)
    done = run_frames(ensemble, chosen, RELAX, whole.with_suffix(".csv"), whole)
    assert dict(done.counts) == {"converged": 4, "refused": 1} and done.written == 4
    first = run_frames(ensemble, chosen, RELAX, stopped.with_suffix(".csv"), stopped, watch=stop_after(n))
    assert first.interrupted and not stopped.exists()
    # What a process wrote after its last checkpoint, when it was killed.
    with stopped.with_suffix(".csv").open("ab") as file:
        file.write(b"9,,conver")
    part = next(tmp_path.glob("stopped.part.*"))
    part.write_bytes(part.read_bytes() + b"part of a frame")
    with expect_refusal("resume", "force"):
        run_frames(ensemble, chosen, RELAX, stopped.with_suffix(".csv"), stopped)
    with expect_refusal("solvent"):
        other = RelaxFrames(RelaxSettings(), pc.Setup(threads=1, solvent="vacuum"))
        run_frames(ensemble, chosen, other, stopped.with_suffix(".csv"), stopped, resume=True)
    again = run_frames(ensemble, chosen, RELAX, stopped.with_suffix(".csv"), stopped, resume=True)
    assert not again.interrupted and (again.counts, again.written) == (done.counts, done.written)
    assert rows_of(stopped.with_suffix(".csv")) == rows_of(whole.with_suffix(".csv"))
    assert content(stopped) == content(whole) != b""
    assert {path.stem for path in tmp_path.iterdir()} == {"whole", "stopped"}
    # What is complete is read, unless it is of other frames or columns, or is gone.
    read = run_frames(ensemble, chosen, RELAX, stopped.with_suffix(".csv"), stopped, resume=True)
    assert read.was_complete and replace(read, was_complete=False) == again
    table = stopped.with_suffix(".csv")
    with expect_refusal("force", match="another run"):
        run_frames(ensemble, chosen.without_first(1), RELAX, table, stopped, resume=True)
    with expect_refusal("force", match="another run"):
        run_frames(ensemble, chosen, RELAX, table, resume=True)
    stopped.unlink()
    with expect_refusal("force", match="is incomplete"):
        run_frames(ensemble, chosen, RELAX, table, stopped, resume=True)


def test_rows_say_where_the_frame_is_in_the_trajectory_and_the_topology_reads_it(tmp_path, x):
    ensemble, chosen = opened(x)
    output = tmp_path / "out.dcd"
    done = run_frames(ensemble, chosen, RELAX, tmp_path / "out.csv", output)
    table = pd.read_csv(done.csv)
    assert table["output_frame"].tolist()[:2] == [0, 1] and np.isnan(table["output_frame"][2])
    assert table["output_frame"].tolist()[3:] == [2, 3]
    ends = [each.structure for each in over_frames(ensemble, chosen, RELAX)]
    top, written = pc.load(done.topology), open_frames(output)
    assert top.fingerprint == load(SMALL).fingerprint and len(written) == 4
    for k, end in enumerate(each for each in ends if each is not None):
        (frame,) = written.select(k)
        assert np.abs(frame.x - end.positions).max() < 1e-6


def test_without_hydrogens_the_trajectory_and_its_topology_have_none(tmp_path, x):
    ensemble, chosen = opened(x[:2])
    done = run_frames(ensemble, chosen, RELAX, tmp_path / "o.csv", tmp_path / "o.xtc", hydrogens=False)
    n = int((load(SMALL).atom_element != "H").sum())
    assert open_frames(done.trajectory).n_atoms == n
    assert done.topology.read_text().count("\nATOM") == n


def test_a_run_in_which_no_frame_can_be_used_writes_rows_and_no_trajectory(tmp_path, x):
    ensemble, chosen = opened(x[2:3])
    done = run_frames(ensemble, chosen, RELAX, tmp_path / "o.csv", tmp_path / "o.dcd")
    assert dict(done.counts) == {"refused": 1} and not (tmp_path / "o.dcd").exists() and len(done.table) == 1


def test_the_worst_frames_come_first_by_what_tells_most_of_damage():
    """After those without a result, and those that did not converge."""
    status, rmsd = (
        ["converged", "converged", "refused", "violations", "converged"],
        [3.0, 9.0, np.nan, 1.0, 5.0],
    )
    table = pd.DataFrame({"frame": range(5), "status": status, "ca_rmsd_angstrom": rmsd})
    for name, order in (("ca_rmsd_angstrom", [2, 3, 1, 4, 0]), ("rmsd", [2, 3, 0, 1, 4])):
        rows, by = _worst_first(table.rename(columns={"ca_rmsd_angstrom": name}))
        assert rows["frame"].tolist() == order and by == (name if "ca" in name else "frame")


def test_the_page_shows_distributions_and_names_the_frames_without_a_result(tmp_path, x):
    ensemble, chosen = opened(x)
    done = run_frames(ensemble, chosen, RELAX, tmp_path / "o.csv", tmp_path / "o.dcd")
    write_report(done, "relax", "x.xtc <b>", tmp_path / "o.html")
    page = (tmp_path / "o.html").read_text()
    assert "x.xtc &lt;b&gt;" in page and page.count('src="data:image/') == 1
    table, (cells, _) = pd.read_csv(done.csv), explored(page)
    assert str(table["message"][2]) in cells
    assert pytest.approx(table["ca_rmsd_angstrom"].max(), rel=1e-5) in cells
    # Frames that are measured have their result.
    measured = run_frames(*opened(np.delete(x, 2, axis=0)), EnergyFrames(SETUP), tmp_path / "e.csv", None)
    write_report(measured, "energy", "x.xtc", tmp_path / "e.html")
    assert dict(measured.counts) == {"measured": 4} and {"measured"} == {
        cell for cell in explored((tmp_path / "e.html").read_text())[0] if isinstance(cell, str)
    }


def test_of_many_quantities_energy_and_violations_are_drawn_first():
    names = [*(f"other_{k}" for k in range(_MOST_FIGURES)), "violations_end", "energy_end_kj_mol"]
    figure = _along(pd.Series([1, 2]), pd.DataFrame({name: [0.0, 1.0] for name in names}))
    titles = [ax.get_title() for ax in figure.axes if ax.get_visible()]
    assert titles[:3] == [heading(name) for name in ("violations", "energy_kj_mol", "other_0")]
    assert len(titles) == _MOST_FIGURES


def test_the_header_of_frames_has_medians_of_the_start_and_the_end():
    table = pd.DataFrame({
        "violations_start": [9, 3, 4], "violations_end": [0, 0, 1], "ca_rmsd_angstrom": [0.5, 0.1, 0.2],
        "energy_start_kj_mol": [7.0, 8.0, 9.0], "energy_end_reference_kj_mol": [-1.0, -2.0, -4.0],
        "clashscore_per_1000_atoms_end": np.nan, "seconds": 1.0,
    })  # fmt: skip
    assert _medians(table) == [
        ("median violations", "4 → 0"),
        ("median C-alpha RMSD, angstrom", "0.2"),
        ("median energy, kJ/mol", "8 → -2"),
    ]


@pytest.mark.slow
def test_a_killed_command_is_resumed_to_the_same_files(tmp_path):
    """SIGKILL in the middle: whatever was written, the end is that of a run that was left alone."""
    structure = load("1l2y.pdb")
    pc.save(structure, tmp_path / "top.pdb")
    saved(structure, shaken(structure, 40, by=0.01), tmp_path / "x.xtc")
    common = ["relax", "top.pdb", "--trajectory", "x.xtc", "--workers", "2"]
    subprocess.run([*COMMAND, *common, "-o", "whole.dcd"], cwd=tmp_path, check=True, capture_output=True)
    running = subprocess.Popen(
        [*COMMAND, *common, "-o", "killed.dcd"], cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    table = tmp_path / "killed.csv"
    until(lambda: table.exists() and len(rows_of(table)) >= 5, running)
    os.kill(running.pid, signal.SIGKILL)
    running.communicate()
    assert (tmp_path / "killed.checkpoint.npz").exists()
    subprocess.run(
        [*COMMAND, *common, "-o", "killed.dcd", "--resume"], cwd=tmp_path, check=True, capture_output=True
    )
    assert rows_of(tmp_path / "killed.csv") == rows_of(tmp_path / "whole.csv")
    assert content(tmp_path / "killed.dcd") == content(tmp_path / "whole.dcd") != b""


def test_frames_of_a_chain_move_the_atoms_that_the_chain_moves():
    s = load("ala10.pdb")
    c = pc.build_chain(s, move="resid 1 to 3")
    frame = next(relax_frames(c, s.positions[None], max_iterations=3, solvent="vacuum"))
    away = np.linalg.norm(frame.structure.positions - s.positions, axis=1)
    assert frame.move == c.move and away[s.atom_residue < 3].max() > 1e-3
    assert away[s.atom_residue > 3].max() < 1e-9
