"""Results stay in the frame of their input, unless something holds the run in place."""

import gemmi
import numpy as np
import pytest
from fixtures.samples import STRUCTURES, chain, energy, load
from fixtures.tolerances import ROUND_OFF_NM
from MDAnalysis.analysis.rms import rmsd as mda_rmsd

import protochain as pc
from protochain.dynamics import simulate
from protochain.structure.formats.trajectory import TrajectoryFile

AGREES = 0.002
"""Angstrom, both RMSDs of a written file: what rounding to the third decimal adds to each."""


def both(x, start, alpha):
    """RMSD in angstrom of positions in nm, as filed and superposed."""
    return [10.0 * mda_rmsd(x[alpha], start[alpha], superposition=fitted) for fitted in (False, True)]


def written(path):
    """Positions in nm of all atoms of a file, in its order."""
    model = gemmi.read_structure(str(path))[0]
    return np.array([cra.atom.pos.tolist() for cra in model.all()]) / 10.0


@pytest.mark.parametrize(
    ("name", "method"),
    [
        ("1l2y.pdb", "lbfgs"), ("1l2y.pdb", "hybrid"), ("1l2y.pdb", "openmm"), ("1l2y.pdb", "md"),
        ("3i40.pdb", "lbfgs"), ("ala10.pdb", "cartesian"),
    ],
)  # fmt: skip
def test_a_written_structure_lies_on_its_start(name, method, tmp_path):
    s = load(name)
    r = pc.minimise(chain(name), energy(name), method, max_evaluations=150)
    record = r.record()
    for suffix in (".pdb", ".cif"):
        r.save(tmp_path / f"out{suffix}")
        x = written(tmp_path / f"out{suffix}")
        filed, fitted = both(x, s.positions, s.alpha_carbons)
        assert fitted > 0.1 and filed == pytest.approx(fitted, abs=AGREES)
        assert np.abs(x - r.x).max() < 1e-4 and np.array_equal(r.structure.positions, r.x)
    assert record["ca_rmsd_as_filed_angstrom"] == pytest.approx(filed, abs=AGREES)
    assert record["ca_rmsd_angstrom"] == pytest.approx(fitted, abs=AGREES)
    assert record["frame"] == "superposed on the start"
    # One rigid motion of the whole: nothing inside has changed.
    assert r.end.energy == pytest.approx(energy(name).reference(r.x)[0], abs=1e-6)


def test_chains_of_several_move_as_one():
    s = load("3i40.pdb")
    r = pc.minimise(chain("3i40.pdb"), energy("3i40.pdb"), "lbfgs", max_evaluations=60)
    apart = [np.linalg.norm(x[:, None] - x[None], axis=2) for x in (pc.pose(r.chain, r.q).x, r.x)]
    assert s.n_chains > 1 and np.abs(apart[0] - apart[1]).max() < ROUND_OFF_NM


def test_two_alpha_carbons_fix_no_frame_and_all_atoms_do():
    s = pc.from_sequence("GY")
    r = pc.minimise(s, method="lbfgs", max_evaluations=100)
    fitted = mda_rmsd(r.x, s.positions, superposition=True)
    assert len(s.alpha_carbons) == 2 and fitted > 0.01
    assert mda_rmsd(r.x, s.positions, superposition=False) == pytest.approx(fitted, rel=1e-6)


def test_what_holds_a_run_leaves_it_where_it_ran():
    s, e = load("1l2y.pdb"), energy("1l2y.pdb")
    held = {
        "springs to the start": (chain("1l2y.pdb"), {"restraints": (100.0,)}),
        "a restraint": (chain("1l2y.pdb"), {"restraints": lambda x: (0.0, np.zeros_like(x))}),
        "atoms that stand still": (pc.build_chain(s, move="resid 5:9"), {}),
        "a fixed root": (pc.build_chain(s, root="fixed"), {}),
    }
    for why, (c, options) in held.items():
        r = pc.minimise(c, e, "lbfgs", max_evaluations=20, **options)
        assert r.record()["frame"] == f"held by {why}"
        assert np.array_equal(r.x, pc.pose(c, r.q).x), why
        assert r.record()["ca_rmsd_as_filed_angstrom"] > r.ca_rmsd_angstrom + 1e-4
    for options in ({"restraints": (100.0, 0.0)}, {"max_rmsd": 0.2}):
        r = pc.minimise(chain("1l2y.pdb"), e, "lbfgs", max_evaluations=40, **options)
        assert r.record()["frame"] == "superposed on the start"


def test_obstacles_stay_where_they_are():
    s = pc.load(STRUCTURES / "4pti.pdb", keep=["water"])
    assert s.obstacle.any()
    r = pc.minimise(s, method="lbfgs", max_evaluations=15)
    assert np.abs(r.x - s.positions)[s.obstacle].max() < ROUND_OFF_NM
    assert r.record()["frame"] == "held by atoms that stand still"


def test_an_energy_that_knows_places_holds_the_run():
    s, c = load("ala10.pdb"), chain("ala10.pdb")
    home = s.positions + 0.02 * np.random.default_rng(0).normal(size=s.positions.shape)

    def map_of_density(x):
        return 500.0 * np.sum((x - home) ** 2), 1000.0 * (home - x)

    r = pc.minimise(c, map_of_density, "lbfgs", max_evaluations=20)
    assert r.record()["frame"] == "held by its energy" and np.array_equal(r.x, pc.pose(c, r.q).x)
    first, last = 0, s.n_atoms - 1

    def spring(x):
        across, forces = x[last] - x[first], np.zeros_like(x)
        forces[first], forces[last] = 100.0 * across, -100.0 * across
        return 50.0 * across @ across, forces

    r = pc.minimise(c, spring, "lbfgs", max_evaluations=20)
    assert r.record()["frame"] == "superposed on the start"
    assert r.record()["ca_rmsd_as_filed_angstrom"] == pytest.approx(r.ca_rmsd_angstrom, abs=1e-9)


def test_frames_lie_on_the_start_too(tmp_path):
    import mdtraj

    s = load("1l2y.pdb")
    path = tmp_path / "run.dcd"
    with TrajectoryFile(path, s) as file:
        r = pc.minimise(
            chain("1l2y.pdb"), energy("1l2y.pdb"), "lbfgs", max_evaluations=60,
            watch=lambda row, x: file.append(x),
        )  # fmt: skip
    frames = mdtraj.load(str(path), top=mdtraj.Topology.from_openmm(s.topology)).xyz.astype(float)
    assert np.abs(frames[-1] - r.x).max() < 1e-5
    for x in frames[1:]:
        filed, fitted = both(x, s.positions, s.alpha_carbons)
        assert filed == pytest.approx(fitted, abs=AGREES)
    assert fitted > 0.3


def test_a_simulation_stays_on_its_start_and_a_resumed_one_too(tmp_path):
    """The start lies on the input: it is the end of the minimisation, as its result has it."""
    import mdtraj

    s, c, e = load("1l2y.pdb"), chain("1l2y.pdb"), energy("1l2y.pdb")
    r = pc.minimise(c, e, "lbfgs", max_evaluations=60)
    settings = {"every": 10, "seed": 2, "friction": 10.0, "temperature": 400.0}
    simulate(c, e, r.q, n_steps=60, output=tmp_path, **settings)
    # A resumed run has the start of its folder, not of this q.
    m = simulate(c, e, c.q0, n_steps=120, output=tmp_path, resume=True, **settings)
    top = mdtraj.Topology.from_openmm(s.topology)
    frames = mdtraj.load(str(tmp_path / "trajectory.dcd"), top=top).xyz.astype(float)
    assert len(frames) == 13 and np.abs(frames[0] - r.x).max() < 1e-6
    for x in (*frames[1:], written(tmp_path / "last.pdb"), m.x):
        filed, fitted = both(x, r.x, s.alpha_carbons)
        assert fitted > 0.05 and filed == pytest.approx(fitted, abs=AGREES)
    record = m.record()
    assert record["frame"] == "superposed on the start"
    assert record["ca_rmsd_angstrom"] == pytest.approx(fitted, abs=1e-3)
    filed, fitted = both(m.x, s.positions, s.alpha_carbons)
    assert record["ca_rmsd_input_angstrom"] == pytest.approx(fitted, abs=1e-3)
    assert record["ca_rmsd_input_as_filed_angstrom"] == pytest.approx(filed, abs=1e-3)
    region = pc.build_chain(s, move="resid 5:9")
    still = simulate(region, e, n_steps=20, every=10)
    assert still.record()["frame"] == "held by atoms that stand still"
    assert np.abs(still.x - s.positions)[np.isin(s.atom_residue, range(14, 20))].max() < ROUND_OFF_NM


def test_frames_are_as_the_run_went_where_that_is_asked_for():
    c, e = chain("1l2y.pdb"), energy("1l2y.pdb")
    settings = {"n_steps": 40, "every": 20, "seed": 2, "friction": 10.0, "temperature": 400.0}
    usual, as_run = simulate(c, e, **settings), simulate(c, e, superpose=False, **settings)
    assert usual.trace.equals(as_run.trace) and str(as_run.frame) == "as the run went"
    assert np.abs(as_run.x - pc.pose(as_run.chain, as_run.q).x).max() < ROUND_OFF_NM
    assert np.allclose(as_run.frames[-1], as_run.x, atol=1e-6)
    filed, fitted = both(as_run.x, usual.x, c.structure.alpha_carbons)
    assert fitted < 1e-5 < 1e-2 < filed


def test_the_best_of_many_starts_lies_on_the_input():
    s = load("ala10.pdb")
    found = pc.explore(chain("ala10.pdb"), energy("ala10.pdb"), "lbfgs", 3, seed=1, max_evaluations=100)
    for solution, row in zip(found.solutions, found.records(), strict=True):
        filed, fitted = both(solution.structure.positions, s.positions, s.alpha_carbons)
        assert fitted > 0.1 and filed == pytest.approx(fitted, abs=AGREES)
        assert row["ca_rmsd_angstrom"] == pytest.approx(fitted, abs=1e-6)
        assert solution.ca_rmsd_angstrom == pytest.approx(fitted, abs=1e-6)
        assert np.abs(solution.frames[-1] - solution.x).max() < 1e-6
    assert found.overall()["ca_rmsd_as_filed_angstrom"] == pytest.approx(
        found.overall()["ca_rmsd_angstrom"], abs=1e-6
    )
