import json
import signal

import numpy as np
import pytest
from fixtures.oracles import angle_triples, angles, bond_lengths
from fixtures.samples import STRUCTURES, chain, energy, load
from fixtures.tolerances import GEOMETRY_NM, GEOMETRY_RAD, TRACED_FORCE

import protochain as pc
from protochain.chains.contacts import overlaps
from protochain.cli import main
from protochain.minimisers import METHODS, Status
from protochain.minimisers.solution import SIZES, TRACE_COLUMNS
from protochain.minimisers.verdict import verdict
from protochain.structure.molecule.chirality import changed_stereocentres
from protochain.structure.superpose import superpose

MAIN, OTHERS = ("kcm", "hybrid"), ("1ejg.pdb", "1ubq.cif", "3i40.pdb")
"""Hinges alone, and then all atoms: on these structures too; the others on one."""
KINDS = ("kcm", "kcm-transient", "fire", "anneal", "lbfgs", "cartesian", "hybrid", "openmm", "openmm-md")
"""Methods of every direction, step rule and space, and those of OpenMM."""


class Wrapped:
    """An energy with something wrong with it; its judge is the honest one."""

    def __init__(self, inner, spoil):
        self.inner, self.spoil, self.calls = inner, spoil, 0

    def __getattr__(self, name):
        return getattr(self.inner, name)

    def without_constants(self, groups, x):
        return self

    def __call__(self, x):
        self.calls += 1
        return self.spoil(self.calls, *self.inner(x))


@pytest.mark.parametrize(
    ("name", "method"),
    [*(("1l2y.pdb", method) for method in METHODS), *((name, method) for name in OTHERS for method in MAIN)],
)
def test_every_method_lowers_the_energy(name, method):
    # Annealing climbs before it descends.
    r = pc.minimise(chain(name), energy(name), method, max_evaluations=2100 if method == "anneal" else 60)
    assert r.end.energy < r.start.energy
    assert np.isfinite(r.x).all() and np.isfinite(r.energy)
    assert r.end.energy == pytest.approx(energy(name).reference(r.x)[0], abs=1e-6)
    assert list(r.trace.columns) == list(TRACE_COLUMNS)
    assert r.trace["energy_kj_mol"].iloc[0] == pytest.approx(r.start.energy, rel=1e-5)
    assert r.trace["evaluations"].is_monotonic_increasing and r.trace["seconds"].is_monotonic_increasing
    assert r.trace["ca_rmsd_angstrom"].iloc[0] < 1e-6
    assert np.allclose(pc.pose(pc.build_chain(r.structure), pc.build_chain(r.structure).q0).x, r.x, atol=1e-9)


FORCES, TORQUES = SIZES[2:], SIZES[:2]


@pytest.mark.parametrize(("method", "moved"), [("cartesian", 1), ("hybrid", 2), ("openmm", 1), ("lbfgs", 0)])
def test_a_trace_has_the_rms_and_the_largest_force_or_torque_of_every_point(method, moved):
    """By the energy's own forces there, which do not depend on how the positions are superposed."""
    c, e, rows = chain("1l2y.pdb"), energy("1l2y.pdb"), []
    r = pc.minimise(c, e, method, 30.0, watch=lambda row, x: rows.append((row, x)), curvature=False)
    in_all_atoms = r.trace["rms_force_kj_mol_nm"].notna()
    assert {0: not in_all_atoms.any(), 1: in_all_atoms.all(), 2: in_all_atoms.nunique() == 2}[moved]
    for names, there in ((FORCES, in_all_atoms), (TORQUES, ~in_all_atoms)):
        assert all((r.trace[name].notna() == there).all() for name in names)
    for row, x in rows:
        assert all(row[name] == pytest.approx(value, nan_ok=True) for name, value in
                   r.trace.loc[row["iteration"], list(SIZES)].items())  # fmt: skip
        if np.isfinite(row["rms_force_kj_mol_nm"]):
            size = np.linalg.norm(e(x)[1], axis=1)
            found = [row[name] for name in FORCES]
            assert found == pytest.approx([np.sqrt(np.mean(size**2) / 3.0), size.max()], rel=TRACED_FORCE)
    if moved == 0:
        last, tau = r.trace.iloc[-1], pc.pull_back(c, at := pc.pose(c, r.q), e(at.x)[1])
        assert last["max_torque_kj_mol_rad"] == pytest.approx(np.abs(tau).max(), rel=TRACED_FORCE)
        assert last["rms_torque_kj_mol_rad"] == pytest.approx(np.sqrt(np.mean(tau**2)), rel=TRACED_FORCE)
    else:
        met = r.trace["rms_force_kj_mol_nm"] <= 30.0
        assert met.idxmax() == len(met) - 1 or method == "openmm"


@pytest.mark.parametrize("method", ["kcm", "lbfgs"])
@pytest.mark.parametrize("name", ["1l2y.pdb", "3i40.pdb"])
def test_a_torsion_space_result_keeps_bond_lengths_and_angles(name, method):
    r = pc.minimise(chain(name), energy(name), method, max_evaluations=150)
    s = r.chain.structure
    cut = {tuple(pair) for pair in r.chain.loops.tolist()}
    bonds = np.array([pair for pair in s.bonds.tolist() if tuple(pair) not in cut])
    triples = angle_triples(bonds)
    assert r.ca_rmsd_angstrom > 0.01
    assert np.abs(bond_lengths(bonds, r.x) - bond_lengths(bonds, s.positions)).max() < GEOMETRY_NM
    assert np.abs(angles(triples, r.x) - angles(triples, s.positions)).max() < GEOMETRY_RAD
    assert np.allclose(superpose(pc.pose(r.chain, r.q).x, r.x), r.x, atol=1e-12)


@pytest.mark.parametrize("method", ["lbfgs", "openmm"])
def test_converged_means_converged_in_double_precision(method):
    name = "1l2y.pdb" if method == "lbfgs" else "ala10.pdb"
    r = pc.minimise(chain(name), energy(name), method, tolerance=1.0)
    assert r.status == Status.CONVERGED and r.message.startswith("converged: ")
    value, forces = energy(name).reference(r.x)
    if method == "lbfgs":
        c = pc.build_chain(r.structure)
        size = np.abs(pc.pull_back(c, pc.pose(c, c.q0), forces)).max()
        assert size == pytest.approx(r.end.max_torque, rel=1e-4)
    else:
        size = np.sqrt(np.mean(forces**2))
        assert size == pytest.approx(r.end.rms_force, rel=1e-9)
    assert size <= 1.0
    assert value == pytest.approx(r.end.energy, abs=1e-6)


def test_a_tolerance_below_single_precision_is_still_met():
    single = energy("1l2y.pdb", engine="openmm")
    r = pc.minimise(chain("1l2y.pdb"), single, "lbfgs", tolerance=0.01)
    assert r.status == Status.CONVERGED and r.end.max_torque <= 0.01


def test_an_engine_that_lies_about_its_forces_is_not_believed():
    liar = Wrapped(energy("1l2y.pdb", engine="openmm"), lambda calls, value, f: (value, 1e-9 * f))
    for budget in (1, 5):
        r = pc.minimise(chain("1l2y.pdb"), liar, "lbfgs", max_evaluations=budget)
        assert r.status == Status.BUDGET and r.message.startswith(f"budget: {budget} evaluations")
        assert r.end.max_torque > 100


def test_an_engine_that_climbs_is_caught_and_the_start_returned():
    climber = Wrapped(energy("1l2y.pdb"), lambda calls, value, f: (-value, -f))
    r = pc.minimise(chain("1l2y.pdb"), climber, "kcm", max_evaluations=20)
    assert r.trace["energy_kj_mol"].iloc[-1] < r.trace["energy_kj_mol"].iloc[0]
    assert r.end == r.start and np.array_equal(r.x, chain("1l2y.pdb").structure.positions)


@pytest.mark.parametrize("method", KINDS)
@pytest.mark.parametrize("budget", [1, 3])
def test_a_tiny_budget_gives_a_result_no_worse_than_the_start(method, budget):
    r = pc.minimise(chain("1vii.pdb"), energy("1vii.pdb"), method, max_evaluations=budget)
    assert r.end.energy <= r.start.energy
    assert r.status in (Status.BUDGET, Status.CLASH)
    assert r.n_evaluations == r.trace["evaluations"].iloc[-1] == budget or method != "kcm"
    assert r.n_evaluations <= budget and len(r.trace) >= 1


def test_the_budget_is_kept_to_the_last_evaluation():
    counted = Wrapped(energy("1l2y.pdb"), lambda calls, value, f: (value, f))
    r = pc.minimise(chain("1l2y.pdb"), counted, "lbfgs", max_evaluations=19)
    assert r.n_evaluations == 19 and r.status == Status.BUDGET and "19 evaluations" in r.message
    # Two before the clock starts, one for the energy reported.
    assert counted.calls == 19 + 3


@pytest.mark.parametrize(("method", "most"), [("kcm", 40), ("lbfgs", 300)])
def test_a_run_that_meets_no_number_goes_on_in_double_precision(method, most):
    single = energy("1l2y.pdb", engine="openmm")
    spoilt = Wrapped(single, lambda calls, value, f: (value, f if calls < 12 else f * np.nan))
    r = pc.minimise(chain("1l2y.pdb"), spoilt, method, max_evaluations=most)
    assert np.isfinite(r.x).all() and r.end.energy < r.start.energy
    assert r.status == (Status.BUDGET if method == "kcm" else Status.CONVERGED)


@pytest.mark.parametrize("method", ["kcm", "lbfgs"])
def test_a_run_without_numbers_keeps_the_best_before(method):
    def spoil(calls, value, f):
        return value, f if calls < 12 else f * np.nan

    spoilt = Wrapped(energy("1l2y.pdb", engine="openmm"), spoil)
    spoilt.exact = spoilt.reference = Wrapped(energy("1l2y.pdb").reference, spoil)
    r = pc.minimise(chain("1l2y.pdb"), spoilt, method, max_evaluations=300)
    assert np.isfinite(r.x).all() and r.end.energy < r.start.energy
    assert r.status == (Status.NON_FINITE if method == "kcm" else Status.STALLED)
    assert r.n_evaluations < 300


@pytest.mark.parametrize("method", KINDS)
def test_an_interrupt_returns_the_best_so_far(method):
    def watch(row, x):
        if row["iteration"] == 8:
            raise KeyboardInterrupt

    r = pc.minimise(chain("1l2y.pdb"), energy("1l2y.pdb"), method, watch=watch)
    assert r.status == Status.INTERRUPTED and r.message.startswith("interrupted after")
    # Annealing climbs before it descends: so far the start is best.
    assert r.end.energy < r.start.energy or (method == "anneal" and r.end.energy == r.start.energy)
    assert len(r.trace) == 9


@pytest.mark.parametrize("method", ("kcm", "cartesian", "openmm", "openmm-md"))
def test_a_signal_ends_a_run(method, signals):
    def watch(row, x):
        if row["iteration"] == 8:
            signal.raise_signal(signal.SIGTERM)

    r = pc.minimise(chain("1l2y.pdb"), energy("1l2y.pdb"), method, watch=watch)
    assert r.status == Status.INTERRUPTED and len(r.trace) <= 10


def test_a_signal_after_the_last_step_changes_nothing(signals, monkeypatch, tmp_path):
    def interrupted(what):
        def call(*given, **named):
            signal.raise_signal(signal.SIGINT)
            return what(*given, **named)

        return call

    monkeypatch.setattr("protochain.minimisers.minimise_structure.verdict", interrupted(verdict))
    monkeypatch.setattr(pc.Solution, "save", interrupted(pc.Solution.save))
    source, output = str(STRUCTURES / "ala10.pdb"), tmp_path / "out.pdb"
    monkeypatch.setattr("sys.argv", ["protochain", "minimise", source, "-o", str(output)])
    with pytest.raises(SystemExit, match="0"):
        main()
    assert output.exists()


@pytest.mark.filterwarnings("ignore::protochain.core.errors.StrayWarning")
@pytest.mark.parametrize("method", KINDS)
def test_atoms_on_top_of_one_another_give_no_nan_and_a_verdict_that_names_them(method):
    c = chain("1l2y.pdb")
    s = c.structure
    q = c.q0.copy()
    # Turn one side chain and one phi until atoms overlap badly.
    rng = np.random.default_rng(4)
    for _ in range(200):
        q = c.q0 + rng.uniform(-1.5, 1.5, c.n_q)
        crowded = s.with_positions(pc.pose(c, q).x)
        if overlaps(crowded, crowded.positions):
            break
    else:
        pytest.fail("nothing overlaps")
    e = energy("1l2y.pdb")
    start = pc.build_chain(crowded)
    r = pc.minimise(start, e, method, max_evaluations=6)
    assert np.isfinite(r.x).all() and r.end.energy <= r.start.energy
    # All atoms may move through one another: then the hand that changed is named first.
    assert (r.status in (Status.CLASH, Status.INVERTED)) == bool(overlaps(crowded, r.x))
    assert (r.status == Status.INVERTED) == bool(changed_stereocentres(crowded, r.x, crowded.positions))
    at_once = pc.minimise(start, e, method, max_evaluations=1)
    assert at_once.status == Status.CLASH
    assert "angstrom apart" in at_once.message and " of A:" in at_once.message
    longer = pc.minimise(start, e, method, max_evaluations=50)
    assert longer.end.energy < r.start.energy and np.isfinite(longer.trace["energy_kj_mol"]).all()


@pytest.mark.filterwarnings("ignore::protochain.core.errors.StrayWarning")
@pytest.mark.parametrize("method", KINDS)
def test_atoms_at_one_point_end_in_a_verdict(method):
    s = load("ala10.pdb")
    x = s.positions.copy()
    x[s.n_atoms - 3] = x[0]
    c = pc.build_chain(s.with_positions(x))
    r = pc.minimise(c, energy("ala10.pdb"), method, max_evaluations=50)
    assert r.status in (Status.CLASH, Status.NON_FINITE) or r.end.energy < r.start.energy
    assert np.isfinite(r.x).all()
    json.dumps(r.record(), allow_nan=False)


def test_a_start_at_the_minimum_is_recognised_at_once():
    once = pc.minimise(chain("ala10.pdb"), energy("ala10.pdb"), "lbfgs", tolerance=0.1)
    assert once.status == Status.CONVERGED
    again = pc.minimise(pc.build_chain(once.structure), energy("ala10.pdb"), "lbfgs", tolerance=0.2)
    assert again.status == Status.CONVERGED and again.n_iterations == 0 and again.ca_rmsd_angstrom < 1e-6


def test_a_file_a_structure_or_a_chain_may_be_given():
    by_file = pc.minimise(STRUCTURES / "ala10.pdb", max_evaluations=5)
    by_structure = pc.minimize(load("ala10.pdb"), max_evaluations=5)
    assert by_file.method == by_structure.method == "cartesian"
    assert by_file.end.energy == pytest.approx(by_structure.end.energy, abs=1e-2)
