"""Simulations of proteins: energy, temperature, files, going on, and what goes wrong."""

import inspect
import json
import os
import signal
import subprocess
import sys

import mdtraj
import numpy as np
import pandas as pd
import pytest
from fixtures.command_line import COMMAND, run
from fixtures.refusals import expect_refusal
from fixtures.samples import ROOT, STRUCTURES, chain, energy, load
from fixtures.tolerances import ROUND_OFF_NM
from fixtures.waiting import HANG, until
from scipy.stats import kstest

import protochain as pc
from protochain.chains.contacts import overlaps
from protochain.core.errors import Fault
from protochain.core.settings import settings_of
from protochain.core.units import MOLAR_GAS
from protochain.dynamics import Leapfrog, System, closure_of, simulate
from protochain.dynamics.simulate_settings import RunSettings, SimulationSettings
from protochain.mechanics import multibody
from protochain.mechanics.multibody import HingeKind
from protochain.structure.superpose import rmsd

THERMOSTATS = ("none", "langevin", "nose-hoover", "rescale", "hmc")
DRIFT = 0.01
"""kJ/mol/ps for 100 atoms: what a constant-energy run may gain or lose."""


@pytest.fixture(scope="module")
def relaxed():
    """Trp-cage at a minimum of its torsions."""
    c, e = chain("1l2y.pdb"), energy("1l2y.pdb")
    return c, e, pc.minimise(c, e, "lbfgs", 10.0).q


@pytest.fixture(scope="module")
def small():
    s = pc.from_sequence("AGA")
    c, e = pc.build_chain(s), pc.energy(s)
    return c, e, pc.minimise(c, e, "lbfgs", 1.0).q


# --- Energy and temperature


def test_energy_of_trp_cage_does_not_drift_at_2_fs(relaxed):
    m = simulate(*relaxed, time_step=0.002, n_steps=1000, thermostat="none", every=10, seed=1)
    assert m.ending == "completed" and abs(m.drift) < DRIFT
    assert m.trace["kinetic_kj_mol"].std() > 1.0
    assert m.trace["total_kj_mol"].std() < 0.01 * m.trace["kinetic_kj_mol"].std()


@pytest.mark.slow
def test_energy_of_trp_cage_does_not_drift_over_100_ps(relaxed):
    m = simulate(*relaxed, time_step=0.002, n_steps=50_000, thermostat="none", every=100, seed=1)
    assert abs(m.drift) < DRIFT


@pytest.mark.parametrize("thermostat", THERMOSTATS)
def test_every_thermostat_conserves_what_it_counts(thermostat, small):
    m = simulate(*small, n_steps=600, thermostat=thermostat, friction=5.0, every=10, seed=2)
    assert m.ending == "completed"
    conserved = m.trace["conserved_kj_mol"]
    assert conserved.max() - conserved.min() < 0.15 * np.ptp(m.trace["kinetic_kj_mol"])
    assert (m.accepted is None) == (thermostat != "hmc") and (m.accepted or 1.0) > 0.9
    assert m.record()["accepted"] == m.accepted
    if thermostat == "none":
        assert m.freedoms == m.chain.n_v - 6
    else:
        assert np.ptp(m.trace["total_kj_mol"]) > np.ptp(conserved)


@pytest.mark.parametrize("thermostat", ["none", "nose-hoover", "rescale"])
def test_nothing_moves_as_one(thermostat, small):
    m = simulate(*small, n_steps=250, thermostat=thermostat, every=50)
    linear, angular = multibody.momentum(m.chain.tree, m.state.at.factors.frames, m.qd)
    assert np.abs(linear).max() < 1e-8 and np.abs(angular).max() < 1e-8


def test_hybrid_monte_carlo_samples_the_boltzmann_distribution_of_a_torsion():
    """Two alanines of which phi turns: against the density by quadrature of the energy itself."""
    s = pc.from_sequence("AA")
    c, e = pc.build_chain(s, "phi"), pc.energy(s)
    assert c.n_hinges == 1
    n, temperature, frames = 180, 1000.0, []
    edges = np.linspace(-np.pi, np.pi, n + 1)
    energies = np.array([e(pc.pose(c, np.array([angle])).x)[0] for angle in (edges[1:] + edges[:-1]) / 2])
    m = simulate(
        c, e, c.q0, temperature, 0.02, 250 * 20, "hmc", 5, fixman=True, trajectory_length=20, every=20,
        watch=lambda row, x: frames.append(x),
    )  # fmt: skip
    # A trajectory of 0.4 ps is far from a period of phi, after which it would be back where it began.
    assert 0.7 < m.accepted < 1.0
    top = mdtraj.Topology.from_openmm(s.topology)
    phi = mdtraj.compute_dihedrals(mdtraj.Trajectory(np.array(frames[20:]), top), [c.hinges[0].atoms])[:, 0]

    def density(t):
        weight = np.exp(-(energies - energies.min()) / (MOLAR_GAS * t))
        total = np.concatenate([[0.0], np.cumsum(weight)]) / weight.sum()
        return lambda angle: np.interp(angle, edges, total)

    assert kstest(phi.astype(float), density(temperature)).pvalue > 1e-3
    assert kstest(phi.astype(float), density(0.25 * temperature)).pvalue < 1e-3


def test_hybrid_monte_carlo_undoes_steps_that_fail(small):
    """At 0.1 ps most trajectories climb or break; the samples between them are still sound."""
    m = simulate(*small, time_step=0.1, n_steps=400, thermostat="hmc", every=10, seed=1)
    assert m.ending == "completed" and 0.0 < m.accepted < 0.9
    assert np.isfinite(m.trace.to_numpy()).all()
    frozen = simulate(*small, time_step=0.4, n_steps=100, thermostat="hmc", every=10, seed=1)
    assert frozen.ending == "completed" and frozen.accepted == 0.0
    assert np.ptp(frozen.trace["potential_kj_mol"]) == 0.0
    unsafe = simulate(*small, time_step=0.4, n_steps=100, thermostat="langevin", every=10, seed=1)
    assert unsafe.ending == "unstable"


# --- What begins where


def test_a_root_is_freed_and_the_start_stays_where_it_was(relaxed):
    c, e, q = relaxed
    frames = []
    m = simulate(c, e, q, n_steps=1, every=1, watch=lambda row, x: frames.append(x))
    assert c.n_v + 6 == m.chain.n_v and m.chain.tree.kind[0] == HingeKind.FREE
    assert rmsd(frames[0], pc.pose(c, q).x) < 1e-12
    held = simulate(pc.build_chain(c.structure, root="fixed"), e, q, n_steps=20, every=20)
    assert held.chain.n_v == c.n_v
    on = simulate(m.chain, e, m.q, n_steps=1, every=1, watch=lambda row, x: frames.append(x))
    assert rmsd(frames[2], m.x) < 1e-12 and on.chain.n_v == m.chain.n_v


def test_a_selection_keeps_the_rest_at_rest():
    c = pc.build_chain(load("1l2y.pdb"), move="resid 1:5 and not backbone")
    m = simulate(c, energy("1l2y.pdb"), n_steps=50, every=50)
    moved = np.linalg.norm(m.x - c.structure.positions, axis=1)
    assert moved.max() > 1e-3 and np.all(moved[c.structure.atom_residue > 5] < 1e-12)


def test_heavy_hydrogens_take_their_mass_from_what_they_are_bonded_to():
    s = load("1l2y.pdb")
    light, heavy = (pc.build_chain(s, "phi psi chi rotors", "free", hydrogen_mass=m) for m in (None, 4.0))
    assert heavy.tree.mass.sum() == pytest.approx(light.tree.mass.sum(), rel=1e-14)
    rotor = next(b for b, h in zip(heavy.hinge_body, heavy.hinges, strict=True) if h.kind == "rotor")
    assert heavy.tree.rigid[rotor, 9] == pytest.approx(4.0 / 1.008 * light.tree.rigid[rotor, 9], rel=1e-3)
    for wrong in (0.0, -1.0, 6.0, np.nan):
        with expect_refusal("hydrogen_mass"):
            pc.build_chain(s, hydrogen_mass=wrong)
    m = simulate(light, energy("1l2y.pdb"), n_steps=5, hydrogen_mass=3.0)
    assert m.chain.hydrogen_mass == 3.0


# --- Loops


@pytest.mark.parametrize("name", ["1ejg.pdb"])
def test_closed_loops_stay_closed_and_open_ones_are_left_to_the_force_field(name):
    s = load(name)
    c, e = pc.build_chain(s), energy(name)
    settings = {"temperature": 100.0, "time_step": 0.001, "n_steps": 100, "every": 10, "thermostat": "none"}
    closed = simulate(c, e, loops="closed", **settings)
    free = simulate(c, e, **settings)
    assert closed.trace["closure_error_nm"].max() < 1e-11
    assert "closure_error_nm" not in free.trace
    assert closed.freedoms == free.freedoms - 3 * len(c.loops)
    assert closed.trace["total_kj_mol"].std() < 0.05 * closed.trace["kinetic_kj_mol"].std()
    bonds = c.loops
    length = [
        np.linalg.norm(np.diff(x[bonds], axis=1)[:, 0], axis=1) for x in (s.positions, closed.x, free.x)
    ]
    assert np.abs(length[1] - length[0]).max() < 1e-11 < np.abs(length[2] - length[0]).max()
    # The velocities, too.
    closure = closure_of(closed.chain)
    rates = (
        multibody.row_matrix(
            closed.chain.tree, closed.state.at.factors.frames, closure.rows(closed.state.at.factors.frames)
        )
        @ closed.qd
    )
    assert np.abs(rates).max() < 1e-10


def test_a_loop_too_far_away_to_close_says_so():
    s = chain("3i40.pdb").structure
    c = pc.build_chain(s.with_positions(s.positions + 1e5), root="free")
    with expect_refusal(fault=Fault.FAR):
        simulate(c, lambda x: (0.0, np.zeros_like(x)), n_steps=2, time_step=0.001, loops="closed")


@pytest.mark.parametrize("name", ["1ejg.pdb", "3i40.pdb"])
def test_a_closed_loop_keeps_its_bond_and_both_angles_but_not_its_dihedral(name):
    c = chain(name)
    closure, frames, s = closure_of(c), multibody.pose(c.tree, c.q0), c.structure
    ends, x = closure.ends(frames).reshape(-1, 3, 2, 3), s.positions
    named = {(int(s.atom_residue[i]), str(s.atom_name[i])): x[i] for i in range(s.n_atoms)}
    assert len(ends) == len(c.loops) > 0
    assert np.abs(closure.errors(frames)).max() < ROUND_OFF_NM
    for (a, b), its in zip(c.loops.tolist(), ends, strict=True):
        before_a, before_b = (named[int(s.atom_residue[atom]), "CB"] for atom in (a, b))
        expected = [[x[a], x[b]], [before_a, x[b]], [x[a], before_b]]
        assert np.abs(its - expected).max() < ROUND_OFF_NM


def test_a_constrained_run_returns_when_time_turns():
    s = load("1ejg.pdb")
    c = pc.build_chain(s, root="free")
    closure = closure_of(c)
    system = System(c.tree, lambda q, f: (0.0, np.zeros(c.n_v)), closure)
    rng = np.random.default_rng(0)
    start = system.at(c.q0, np.zeros(c.n_v))
    start = system.with_velocities(start, multibody.sample_velocities(c.tree, start.factors.frames, 2.5, rng))
    at = start
    for _ in range(20):
        at = Leapfrog().step(system, at, 0.002)
    assert np.abs(at.q - start.q).max() > 0.05
    for _ in range(20):
        at = Leapfrog().step(system, at, -0.002)
    assert np.abs(at.q - start.q).max() < 1e-8
    with pytest.raises(pc.ProtochainError, match="no loop"):
        closure_of(chain("1l2y.pdb"))


def test_closed_loops_are_those_of_the_start_and_go_on_as_they_were(tmp_path):
    """A minimum by turning hinges has other lengths and angles at its loops than the file."""
    c, e = chain("3i40.pdb"), energy("3i40.pdb")
    relaxed = pc.minimise(c, e, "lbfgs", max_evaluations=20)
    before, after = (
        np.linalg.norm(np.diff(x[c.loops], axis=1)[:, 0], axis=1) for x in (c.structure.positions, relaxed.x)
    )
    assert np.abs(after - before).max() > 1e-4
    settings = {"loops": "closed", "time_step": 0.001, "every": 5, "checkpoint_every": 1}
    whole = simulate(c, e, relaxed.q, n_steps=20, **settings)
    assert whole.trace["closure_error_nm"].max() < 1e-11
    end = np.linalg.norm(np.diff(whole.x[c.loops], axis=1)[:, 0], axis=1)
    assert np.abs(end - after).max() < 1e-11
    simulate(c, e, relaxed.q, n_steps=10, output=tmp_path, **settings)
    # Resumed without q, as the command does.
    part = simulate(c, e, n_steps=20, output=tmp_path, resume=True, **settings)
    assert np.array_equal(part.q, whole.q) and np.array_equal(part.qd, whole.qd)


# --- Files


@pytest.mark.parametrize(("suffix", "precision"), [("dcd", 1e-6), ("xtc", 6e-4)])
def test_files_hold_what_the_run_was(suffix, precision, small, tmp_path):
    frames = []
    m = simulate(
        *small, n_steps=60, every=20, output=tmp_path / "run", trajectory=suffix,
        watch=lambda row, x: frames.append(x),
    )  # fmt: skip
    folder = tmp_path / "run"
    names = {"checkpoint.npz", "last.pdb", "log.csv", "summary.json", f"trajectory.{suffix}"}
    assert {path.name for path in folder.iterdir()} == names
    top = mdtraj.Topology.from_openmm(m.chain.structure.topology)
    read = mdtraj.load(str(folder / f"trajectory.{suffix}"), top=top)
    assert read.n_frames == 4 and np.abs(read.xyz - frames).max() < precision
    assert m.frames.dtype == np.float32 and np.abs(m.frames - frames).max() < precision
    if suffix == "xtc":
        assert np.allclose(read.time, m.trace["time_ps"])
    pd.testing.assert_frame_equal(pd.read_csv(folder / "log.csv"), m.trace, check_dtype=False)
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["status"] == "completed" and summary["steps"] == 60 and summary["ns_per_day"] > 0
    assert summary["ca_rmsd_angstrom"] == pytest.approx(m.trace["ca_rmsd_angstrom"].iloc[-1])
    assert np.abs(pc.load(folder / "last.pdb").positions - m.x).max() < 1e-4
    assert "CONSTRAINED DYNAMICS, COMPLETED" in (folder / "last.pdb").read_text()


def test_the_record_is_of_the_end_and_of_the_run_that_made_the_steps(small, tmp_path):
    """Also where the log has the start alone, and where nothing was left to resume."""
    first, again = (
        simulate(*small, n_steps=30, every=1000, output=tmp_path, resume=resume) for resume in (False, True)
    )
    assert len(first.rows) == 1 and again.n_steps == 0
    alpha = first.chain.structure.alpha_carbons
    moved = 10 * np.sqrt(np.mean(np.sum((first.x - first.frames[0])[alpha] ** 2, axis=1)))
    written = json.loads((tmp_path / "summary.json").read_text())
    for record in (first.record(), again.record(), written):
        assert 0.0 < record["ca_rmsd_angstrom"] <= moved + 1e-4
        assert record["mean_temperature_second_half_k"] != first.rows[0]["temperature_k"]
    assert written["ns_per_day"] == first.ns_per_day and again.record()["ns_per_day"] is None


@pytest.mark.parametrize("thermostat", THERMOSTATS)
def test_a_run_in_parts_is_the_run_in_one(thermostat, small, tmp_path):
    settings = {"thermostat": thermostat, "every": 20, "seed": 3, "fixman": thermostat == "hmc"}
    whole = simulate(*small, n_steps=200, **settings)
    for n_steps in (60, 140, 200):
        part = simulate(
            *small, n_steps=n_steps, output=tmp_path, resume=n_steps > 60, checkpoint_every=1, **settings
        )
    assert np.array_equal(part.q, whole.q) and np.array_equal(part.qd, whole.qd)
    pd.testing.assert_frame_equal(part.trace, whole.trace, check_exact=True, check_dtype=False)
    other = simulate(*small, n_steps=200, **{**settings, "seed": 4})
    assert not np.array_equal(other.q, whole.q)


def test_a_damaged_checkpoint_is_refused_part_by_part(tmp_path):
    s = pc.from_sequence("AGC")
    c, e = pc.build_chain(s), pc.energy(s, solvent="vacuum", threads=1)
    settings = {
        "n_steps": 4, "every": 2, "thermostat": "nose-hoover", "pull": "A:1:CA-A:3:CA",
        "hinge_springs": (pc.HingeSpring("phi", 10.0),), "checkpoint_every": 1,
    }  # fmt: skip
    simulate(c, e, output=tmp_path, **settings)
    path = tmp_path / "checkpoint.npz"
    content = path.read_bytes()
    with np.load(path) as file:
        arrays = dict(file)
    text = json.loads(str(arrays.pop("text")))
    parts = [
        *((name, change, arrays) for name, array in arrays.items() if array.size
          for change in (lambda a: a[..., :-1], lambda a: a * np.nan, lambda a: a.astype("U"))),
        *((name, lambda _, to=to: to, text["values"]) for name in text["values"] for to in ("x", None, [1])),
    ]  # fmt: skip
    assert len(parts) > 60
    for name, change, where in parts:
        before = where[name]
        where[name] = change(before)
        np.savez(path, text=np.array(json.dumps(text)), **arrays)
        where[name] = before
        with pytest.raises(
            pc.ProtochainError, match=rf"damaged checkpoint \(\w+: .*{name}.*force=True$"
        ) as refusal:
            simulate(c, e, output=tmp_path, resume=True, **{**settings, "n_steps": 8})
        assert str(refusal.value).startswith(str(path))
    path.write_bytes(content)
    assert simulate(c, e, output=tmp_path, resume=True, **{**settings, "n_steps": 8}).n_steps == 4


def test_a_checkpoint_fits_one_simulation_only(small, tmp_path):
    simulate(*small, n_steps=20, every=10, output=tmp_path)
    with expect_refusal("resume", "force", match="contains a simulation"):
        simulate(*small, n_steps=40, every=10, output=tmp_path)
    with expect_refusal("temperature", match=r"300\.0, not 310\.0"):
        simulate(*small, temperature=310.0, n_steps=40, every=10, output=tmp_path, resume=True)
    c, e, q = small
    moved = pc.build_chain(c.structure.with_positions(pc.pose(c, q + 0.1).x))
    with pytest.raises(pc.ProtochainError, match="start"):
        simulate(moved, e, n_steps=40, every=10, output=tmp_path, resume=True)
    for name, text, said in (
        ("trajectory.dcd", b"cut", "trajectory.dcd: has lost frames"),
        ("trajectory.dcd", None, "trajectory.dcd: has lost frames"),
        ("log.csv", b"step\n0\n", "log.csv: rows before the checkpoint are missing"),
        ("log.csv", b"\xff", "log.csv: damaged log"),
        ("log.csv", b"other", "log.csv: damaged log"),
    ):
        path = tmp_path / name
        whole = path.read_bytes()
        if text is None:
            path.unlink()
        else:
            path.write_bytes(text + whole[len(text) :] if "damaged" in said else text)
        before = {each.name: each.read_bytes() for each in tmp_path.iterdir()}
        with pytest.raises(pc.ProtochainError, match=said):
            simulate(*small, n_steps=40, every=10, output=tmp_path, resume=True)
        # A run that is refused leaves its folder as it was.
        assert {each.name: each.read_bytes() for each in tmp_path.iterdir()} == before
        path.write_bytes(whole)
    again = simulate(*small, n_steps=40, every=10, output=tmp_path, force=True)
    assert len(again.trace) == 5
    with expect_refusal("resume", match="no checkpoint"):
        simulate(*small, n_steps=40, output=tmp_path / "none", resume=True)
    with expect_refusal("resume", match="output"):
        simulate(*small, n_steps=40, resume=True)


@pytest.mark.parametrize("name", ["checkpoint.npz", "log.csv", "log.part.csv"])
def test_what_a_simulation_left_is_not_written_over(name, small, tmp_path):
    (tmp_path / name).write_text("of a week")
    with pytest.raises(pc.ProtochainError, match=rf"contains a simulation \({name}\)"):
        simulate(*small, n_steps=2, output=tmp_path)
    assert [(each.name, each.read_text()) for each in tmp_path.iterdir()] == [(name, "of a week")]


KILLED = """
import os, signal, sys
moved = []
def kill(event, arguments):
    if event == "os.rename" and str(arguments[1]).endswith("checkpoint.npz"):
        moved.append(arguments)
        if len(moved) == 3:
            os.kill(os.getpid(), signal.SIGKILL)
sys.addaudithook(kill)
from protochain.cli import main
main()
"""
"""The command, killed when its third checkpoint is written and not yet in its place."""


@pytest.mark.parametrize("suffix", ["xtc"])
def test_after_kill_9_a_run_goes_on_as_if_nothing_had_been(suffix, tmp_path, capsys):
    arguments = [
        "simulate", STRUCTURES / "ala10.pdb", "--steps", 300, "--every", 20, "--checkpoint-every", 2,
        "--trajectory", suffix, "--seed", 9,
    ]  # fmt: skip
    run(*arguments, "-o", tmp_path / "whole")
    cut = subprocess.run(
        [sys.executable, "-c", KILLED, *map(str, arguments), "-o", "cut"], cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert cut.returncode == -signal.SIGKILL and (tmp_path / "cut" / "checkpoint.npz").exists()
    assert not (tmp_path / "cut" / f"trajectory.{suffix}").exists()
    capsys.readouterr()
    run(*arguments, "-o", tmp_path / "cut", "--resume", "--json")
    assert json.loads(capsys.readouterr().out)["steps"] == 300
    whole, cut = (tmp_path / name for name in ("whole", "cut"))
    assert (whole / "log.csv").read_bytes() == (cut / "log.csv").read_bytes()
    top = mdtraj.Topology.from_openmm(pc.load(whole / "last.pdb").topology)
    frames = [mdtraj.load(str(path / f"trajectory.{suffix}"), top=top).xyz for path in (whole, cut)]
    assert len(frames[0]) == 16 and np.array_equal(*frames)
    assert (whole / "last.pdb").read_bytes() == (cut / "last.pdb").read_bytes()


def test_ctrl_c_leaves_a_run_to_go_on_with(protochain, tmp_path):
    arguments = ["simulate", STRUCTURES / "ala10.pdb", "--steps", 1_000_000, "--every", 20, "-o", "run"]
    process = subprocess.Popen(
        [*COMMAND, *map(str, arguments)], cwd=tmp_path, text=True, stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )  # fmt: skip
    until((tmp_path / "run" / "checkpoint.npz").exists, process)
    process.send_signal(signal.SIGINT)
    out, _ = process.communicate(timeout=HANG)
    assert process.returncode == 130 and "interrupted" in out
    rows = pd.read_csv(tmp_path / "run" / "log.csv")
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert summary["status"] == "interrupted" and summary["steps"] // 20 == len(rows) - 1
    more = (len(rows) + 1) * 20
    assert protochain(*arguments[:3], more, *arguments[4:], "--resume").returncode == 0
    assert len(pd.read_csv(tmp_path / "run" / "log.csv")) == len(rows) + 2


# --- What goes wrong


def test_a_step_too_large_is_named_and_nothing_is_written_as_if_good(protochain, tmp_path):
    done = protochain("simulate", STRUCTURES / "ala10.pdb", "--steps", 2000, "--time-step", 60, "-o", "run")
    assert done.returncode == 1
    assert "unstable after" in done.stderr and "time step" in done.stderr and "Traceback" not in done.stderr
    assert done.stdout == ""
    names = {path.name for path in (tmp_path / "run").iterdir()}
    assert names == {"checkpoint.npz", "log.part.csv", "summary.json", "trajectory.part.dcd"}
    assert json.loads((tmp_path / "run" / "summary.json").read_text())["status"] == "unstable"


def test_overlaps_at_the_start_are_named_as_the_reason():
    c, e = chain("ala10.pdb"), energy("ala10.pdb", solvent="vacuum")
    for seed in range(20):
        q = c.q0 + np.random.default_rng(seed).normal(scale=1.5, size=c.n_q)
        crowd = len(overlaps(c.structure, pc.pose(c, q).x))
        if crowd > 1:
            break
    m = simulate(c, e, q, n_steps=50, every=10)
    assert m.ending == "unstable"
    assert m.message.endswith(f"{crowd} pairs of atoms overlap at the start: minimise first")
    assert m.record()["conserved_drift_kj_mol_ps_per_100_atoms"] is None and np.isnan(m.drift)


@pytest.mark.parametrize(
    ("settings", "word"),
    [
        ({"thermostat": "oven"}, "oven"),
        ({"integrator": "euler"}, "euler"),
        ({"loops": "knotted"}, "knotted"),
        ({"time_step": 0.0}, "time_step"),
        ({"temperature": -1.0}, "temperature"),
        ({"friction": -1.0}, "friction"),
        ({"q": np.zeros(3)}, "q has shape"),
        ({"n_steps": 0}, "steps"),
        ({"every": 0}, "every"),
        ({"seed": -1}, "seed"),
        ({"thermostat": "hmc", "every": 15}, "multiple"),
        ({"thermostat": "hmc", "integrator": "rk4"}, "reversible"),
        ({"thermostat": "nose-hoover", "temperature": 0.0}, "nose-hoover"),
        ({"loops": "closed", "integrator": "lobatto"}, "leapfrog"),
        ({"loops": "closed"}, "no loop"),
        ({"hydrogen_mass": 9.0}, "hydrogen_mass"),
        ({"trajectory": "avi", "output": "nowhere"}, "avi"),
    ],
)
def test_settings_that_make_no_sense_are_refused_by_name(settings, word, small, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    c, e, q = small
    with pytest.raises(pc.ProtochainError, match=word):
        simulate(c, e, **{"q": q, **settings})
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("kind", [SimulationSettings, RunSettings])
def test_every_setting_is_a_keyword_of_the_call_with_its_default(kind):
    keywords = inspect.signature(simulate).parameters
    assert {name: keywords[name].default for name, _ in settings_of(kind)} == vars(kind())


# --- Extremes


@pytest.mark.parametrize("temperature", [0.0, 10_000.0])
def test_zero_and_ten_thousand_kelvin(temperature, small):
    c, e, q = small
    start = q + 0.2
    hot = temperature > 0
    m = simulate(c, e, start, temperature, 0.001 if hot else 0.004, 500, friction=20.0, every=10)
    assert m.ending == "completed" and np.isfinite(m.trace.to_numpy()).all()
    if hot:
        assert m.trace["temperature_k"].iloc[20:].mean() == pytest.approx(temperature, rel=0.3)
    else:
        total = m.trace["total_kj_mol"].to_numpy()
        assert np.all(np.diff(total) < 1e-6) and total[-1] < total[0] - 1.0
        assert m.trace["kinetic_kj_mol"].iloc[0] == 0.0


@pytest.mark.parametrize("time_step", [0.004])
def test_a_long_open_chain_needs_no_shorter_step(time_step):
    """Its ends carry momenta that no hinge feels: fixed points do not attract, and Newton's method does."""
    c = pc.build_chain(pc.from_sequence("GAS" * 30), root="free")
    system = System(c.tree, lambda q, f: (0.0, np.zeros(c.n_v)))
    rng = np.random.default_rng(0)
    frames = multibody.pose(c.tree, c.q0)
    at = start = system.at(c.q0, multibody.sample_velocities(c.tree, frames, 2.5, rng))
    for _ in range(30):
        at = Leapfrog().step(system, at, time_step)
    assert np.abs(at.q - start.q).max() > 0.1
    assert at.total == pytest.approx(start.total, rel=1e-4)
    assert np.linalg.norm(at.q[:4]) == pytest.approx(1.0, abs=1e-14)
