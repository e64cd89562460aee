"""Whole runs: parted overlaps, restraints, limits, selections, many starts, checkpoints."""

import json

import numpy as np
import pytest
from fixtures.molecules import crowded
from fixtures.oracles import angles, bond_lengths
from fixtures.refusals import expect_refusal
from fixtures.samples import chain, energy, load
from fixtures.tolerances import GEOMETRY_NM, GEOMETRY_RAD, ROUND_OFF_NM

import protochain as pc
from protochain.chains.contacts import OVERLAP, overlaps
from protochain.core.errors import Fault
from protochain.minimisers import Status

FREE = ("lbfgs", "cartesian", "hybrid")


@pytest.mark.parametrize(("name", "spread"), [("1l2y.pdb", 0.3), ("3i40.pdb", 0.3)])
def test_hybrid_clears_what_overlaps_and_leaves_bonds_as_the_force_field_has_them(name, spread):
    c = crowded(name, spread)
    worst = overlaps(c.structure, c.structure.positions, c)[0]
    assert worst.share < 0.2
    r = pc.minimise(c, energy(name), "hybrid", tolerance=10.0)
    assert np.isfinite(r.trace["energy_kj_mol"]).all() and r.trace["energy_kj_mol"].iloc[0] > 1e6
    assert r.status == Status.CONVERGED and not overlaps(c.structure, r.x)
    lengths = bond_lengths(c.structure.bonds, r.x)
    usual = bond_lengths(c.structure.bonds, load(name).positions)
    assert np.abs(lengths - usual).max() < 0.015
    assert r.ca_rmsd_angstrom > 0.1


def test_overlaps_say_what_can_part_them():
    s = load("1l2y.pdb")
    c = chain("1l2y.pdb")
    ring = np.flatnonzero((s.atom_residue == 5) & np.isin(s.atom_name, ("CD1", "CZ3")))
    x = s.positions.copy()
    x[ring[1]] = x[ring[0]] + [0.05, 0.0, 0.0]
    (same,) = [o for o in overlaps(s, x, c) if "CD1" in o.first + o.second and "CZ3" in o.first + o.second]
    assert same.distance_angstrom == pytest.approx(0.5) and "one rigid body" in same.remedy
    assert "turning bonds" in overlaps(crowded().structure, crowded().structure.positions, c)[0].remedy
    x[ring[1]] = x[ring[0]]
    assert "no force separates" in overlaps(s, x, c)[0].remedy
    shares = [o.share for o in overlaps(crowded().structure, crowded().structure.positions)]
    assert shares == sorted(shares) and shares[-1] < OVERLAP


@pytest.mark.parametrize("method", FREE)
def test_stronger_restraints_hold_tighter_and_count_for_nothing_in_the_energy(method):
    s, c, e = load("1l2y.pdb"), chain("1l2y.pdb"), energy("1l2y.pdb")
    heavy = s.atom_element != "H"
    moved = []
    for strength in (10.0, 10_000.0):
        r = pc.minimise(c, e, method, restraints=strength)
        assert r.status == Status.CONVERGED and "restraints included" in r.message
        assert r.end.energy == pytest.approx(e(r.x)[0], abs=1e-6)
        assert r.trace["energy_kj_mol"].iloc[-1] == pytest.approx(r.end.energy, abs=1e-6)
        moved.append(np.sqrt(np.mean(np.sum((r.x - s.positions)[heavy] ** 2, axis=1))))
    assert moved[1] < 0.3 * moved[0]


@pytest.mark.parametrize("method", ["lbfgs", "hybrid", "kcm-stiffness"])
def test_an_rmsd_is_not_passed(method):
    c, e = chain("1l2y.pdb"), energy("1l2y.pdb")
    free = pc.minimise(c, e, method, max_evaluations=150)
    assert free.ca_rmsd_angstrom > 0.25
    held = pc.minimise(c, e, method, max_rmsd=0.2, max_evaluations=150)
    assert 0.1 < held.ca_rmsd_angstrom <= 0.2
    assert free.end.energy < held.end.energy < held.start.energy


def test_what_is_not_selected_stays():
    s = load("1l2y.pdb")
    sides = pc.build_chain(s, move="not backbone")
    assert {hinge.kind[:3] for hinge in sides.hinges} == {"chi"}
    r = pc.minimise(sides, energy("1l2y.pdb"), "lbfgs")
    backbone = np.isin(s.atom_name, ("N", "CA", "C", "O"))
    assert r.status == Status.CONVERGED and r.end.energy < r.start.energy - 10
    assert np.abs(r.x - s.positions)[backbone].max() < 1e-12
    region = pc.build_chain(s, move="resid 5:9")
    assert {int(hinge.residue_number) for hinge in region.hinges} == set(range(5, 10))
    r = pc.minimise(region, energy("1l2y.pdb"), "cartesian")
    chosen = np.isin(s.atom_residue, range(4, 9))
    assert r.status == Status.CONVERGED and np.array_equal(region.moving, chosen)
    assert np.abs(r.x - s.positions)[~chosen].max() < ROUND_OFF_NM
    assert np.abs(r.x - s.positions)[chosen].min() > 0


def test_a_chain_that_holds_what_stays_does_not_move_as_a_whole():
    s = load("3i40.pdb")
    c = pc.build_chain(s, move="chainID A and not backbone")
    other = s.residue_chain[s.atom_residue] != "A"
    assert c.n_q == c.n_v == c.n_hinges > 0
    r = pc.minimise(c, energy("3i40.pdb"), "lbfgs", max_evaluations=30)
    assert np.abs(r.x - s.positions)[other].max() < ROUND_OFF_NM and r.end.energy < r.start.energy
    assert pc.build_chain(s, move="chainID A").n_v == pc.build_chain(s, move="chainID A").n_hinges + 6


def test_open_angles_change_and_lower_the_energy_further():
    s, e = load("1l2y.pdb"), energy("1l2y.pdb")
    c = pc.build_chain(s, "phi psi chi angles")
    assert {hinge.kind for hinge in c.hinges if hinge.is_angle} == {"angle N", "angle CA"}
    r, closed = pc.minimise(c, e, "lbfgs"), pc.minimise(chain("1l2y.pdb"), e, "lbfgs")
    assert r.status == Status.CONVERGED and r.end.energy < closed.end.energy - 5
    opened = np.array([hinge.atoms for hinge in c.hinges if hinge.is_angle])
    at = c.tree.q_start[c.hinge_body[[hinge.is_angle for hinge in c.hinges]]]
    assert angles(opened, r.x) == pytest.approx(r.q[at], abs=GEOMETRY_RAD)
    assert np.abs(r.q - c.q0)[at].max() > 0.01
    assert np.abs(bond_lengths(s.bonds, r.x) - bond_lengths(s.bonds, s.positions)).max() < GEOMETRY_NM
    with expect_refusal(fault=Fault.NO_INVERSE):
        pc.solve_mass(c, pc.pose(c, c.q0), np.ones(c.n_v), method="fixman")


def test_starts_are_a_distribution_that_a_seed_repeats():
    c, e = chain("ala10.pdb"), energy("ala10.pdb")
    first, again, other = (pc.explore(c, e, "lbfgs", 5, seed=seed, spread=0.5) for seed in (3, 3, 4))
    assert all(np.array_equal(a.x, b.x) for a, b in zip(first.solutions, again.solutions, strict=True))
    assert not np.array_equal(first.solutions[1].x, other.solutions[1].x)
    assert np.array_equal(first.solutions[0].x, pc.minimise(c, e, "lbfgs", seed=3).x)
    energies = first.table["energy_end_reference_kj_mol"]
    assert first.best.end.energy == energies.min() == first.summary()["energy_lowest_kj_mol"]
    assert len(set(energies.round(1))) > 1 and first.summary()["n_starts"] == 5
    assert len(pc.explore(c, e, "lbfgs", 2, seed=3, spread=0.5).solutions) == 2
    json.dumps(first.overall())


RESUMED = ("kcm-proportional", "kcm-decaying", "kcm-stiffness", "kcm-armijo", "kcm-transient", "fire",
           "newton", "anneal", "cartesian", "hybrid")  # fmt: skip


@pytest.mark.parametrize("method", RESUMED)
def test_a_run_that_goes_on_takes_the_steps_of_one_that_never_stopped(method, tmp_path):
    c, s = chain("1l2y.pdb"), load("1l2y.pdb")
    file = tmp_path / "run.npz"
    whole = pc.minimise(c, pc.energy(s), method, max_evaluations=60)
    pc.minimise(c, pc.energy(s), method, max_evaluations=37, checkpoint=file)
    rest = pc.minimise(c, pc.energy(s), method, max_evaluations=60, resume=file)
    assert np.array_equal(rest.x, whole.x) and rest.end == whole.end
    assert (rest.n_evaluations, rest.n_iterations) == (whole.n_evaluations, whole.n_iterations)
    assert rest.status == whole.status


def test_checkpoints_that_do_not_fit_are_refused(tmp_path):
    c, e = chain("ala10.pdb"), energy("ala10.pdb")
    file = tmp_path / "run.npz"
    pc.minimise(c, e, "lbfgs", max_evaluations=5, checkpoint=file)
    for options, word in (
        ({"method": "newton"}, "method 'lbfgs', not 'newton'"),
        ({"method": "lbfgs", "tolerance": 2.0}, "tolerance 1.0, not 2.0"),
        ({"method": "openmm"}, "has no state"),
    ):
        with pytest.raises(pc.ProtochainError, match=word):
            pc.minimise(c, e, resume=file, **options)
    with pytest.raises(pc.ProtochainError, match="start"):
        pc.minimise(pc.build_chain(pc.from_sequence("AAAAAAAAAA")), e, "lbfgs", resume=file)
    for content, word in ((b"", "not a checkpoint"), (file.read_bytes()[:300], "not a checkpoint")):
        bad = tmp_path / "bad.npz"
        bad.write_bytes(content)
        with pytest.raises(pc.ProtochainError, match=word):
            pc.minimise(c, e, "lbfgs", resume=bad)
    with pytest.raises(pc.ProtochainError, match="not found"):
        pc.minimise(c, e, "lbfgs", resume=tmp_path / "none.npz")


def test_what_an_energy_computed_before_changes_no_bit():
    c = chain("1ejg.pdb")
    used, fresh = pc.energy(c.structure), pc.energy(c.structure)
    x = c.structure.positions
    # Near enough for its neighbour lists to hold at the start too, and to be others.
    used(x + np.random.default_rng(0).uniform(-0.02, 0.02, x.shape))
    first, second = (pc.minimise(c, e, "cartesian", max_evaluations=30) for e in (used, fresh))
    assert np.array_equal(first.x, second.x)


@pytest.mark.parametrize("method", ["hybrid", "newton"])
def test_the_number_of_threads_changes_no_bit_of_a_result(method):
    c = chain("1l2y.pdb")
    one, two = (
        pc.minimise(c, pc.energy(c.structure, threads=threads), method, max_evaluations=120)
        for threads in (1, 2)
    )
    assert np.array_equal(one.x, two.x) and one.end == two.end
