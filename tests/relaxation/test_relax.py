"""pc.relax: clean models, the fold kept; springs, rounds, presets, and what a result says."""

import copy
import pickle
import signal
from dataclasses import replace
from pathlib import Path

import numpy as np
import openmm
import pytest
from fixtures import models
from fixtures.refusals import expect_refusal
from fixtures.samples import energy, load, shared
from fixtures.tolerances import NATIVE_ENERGY, NATIVE_FORCE

import protochain as pc
from protochain.chains.contacts import bonded_pairs, overlaps
from protochain.core.interrupts import held_interrupts
from protochain.energies import OpenMMEnergy, build_system
from protochain.minimisers.clash_resolution import unthreading_stages
from protochain.minimisers.loop import Stop
from protochain.relaxation import PRESETS, PROTOCOLS, RelaxSettings, problems, rounds
from protochain.relaxation.names import relaxed_name
from protochain.relaxation.problems import Problems
from protochain.relaxation.relax_structure import _newly_inverted, relax_structure
from protochain.relaxation.restraints import PeptideBonds
from protochain.relaxation.rounds import Relaxer
from protochain.structure.molecule.chirality import wrong_centres
from protochain.structure.molecule.residues import VAN_DER_WAALS
from protochain.validation import violations

STIFF = 4184.0


@pytest.fixture(scope="module")
def damaged():
    """Side chains at random, as a bad model has them: atoms overlap."""
    structure = models.with_random_side_chains(load("1l2y.pdb"), seed=2)
    assert len(overlaps(structure, structure.positions)) >= 3
    return structure


@pytest.fixture(scope="module")
def relaxed(damaged):
    return pc.relax(damaged, threads=1)


def weights(structure, preset):
    """Springs of a preset's first stage, by its table."""
    strength = PRESETS[preset]
    relaxer = Relaxer(structure, energy("1l2y.pdb"), strength, 0, lambda *_: None)
    return relaxer._springs(np.ones(structure.n_residues), strength.backbone[0], strength.side_chains[0])


def test_overlaps_and_violations_go_and_the_fold_stays(damaged, relaxed):
    assert relaxed.status is pc.Status.CONVERGED and relaxed.message.startswith("converged: RMS force")
    assert not overlaps(damaged, relaxed.x) and not violations(damaged, relaxed.x)
    assert relaxed.ca_rmsd_angstrom < 0.5
    assert relaxed.energy_end < relaxed.energy_start - 1e3
    assert relaxed.measures_end["violations"] == 0 and relaxed.measures_start == pc.validate(damaged).measures


def test_the_end_is_a_minimum_of_force_field_and_springs(damaged, relaxed):
    """Judged anew: OpenMM's Reference platform, and springs E = k/2 d^2 by differences of that formula."""
    reference = pc.energy(damaged).reference
    value, forces = reference(relaxed.x)
    heavy = damaged.atom_element != "H"
    if len(relaxed.rounds) == 1:
        forces = forces - np.where(heavy, STIFF, 0.0)[:, None] * (relaxed.x - damaged.positions)
        forces = forces + PeptideBonds.of(damaged)(relaxed.x)[1]
        assert np.sqrt(np.mean(forces**2)) == pytest.approx(relaxed.rms_force, rel=1e-6)
    assert relaxed.rms_force <= 10.0
    assert relaxed.energy_end == pytest.approx(value, rel=NATIVE_FORCE)
    assert relaxed.judge == "the native engine, in double precision"
    assert relaxed.frame.held_by == "springs to the start"


@pytest.mark.parametrize(("stiffness", "held_by"), [(0.5, "springs to the start"), (0.0, "")])
def test_weak_springs_hold_and_none_do_not(stiffness, held_by):
    r = pc.relax(load("ala10.pdb"), solvent="vacuum", stiffness=stiffness, max_iterations=2)
    assert r.frame.held_by == held_by


def test_each_preset_holds_what_its_table_says():
    s = load("1l2y.pdb")
    backbone = np.isin(s.atom_name, ("N", "CA", "C", "O", "OXT"))
    hydrogen = s.atom_element == "H"
    for name, side_chains in (("predicted", 4184.0), ("crystal", 1000.0), ("design", 0.0)):
        weight = weights(s, name).weight
        assert (weight[hydrogen] == 0.0).all(), name
        assert (weight[~hydrogen & ~backbone] == side_chains).all(), name
        assert weight[backbone] == pytest.approx(1255.2 if name == "design" else 4184.0), name
    assert PRESETS["design"].backbone == pytest.approx((1255.2, 502.08, 0.0))
    assert PRESETS["design"].softened and not PRESETS["predicted"].softened
    assert all(each.source and each.tolerance == 10.0 for each in (*PRESETS.values(), *PROTOCOLS.values()))


def test_stiffness_and_tolerance_replace_those_of_the_preset():
    own = RelaxSettings("crystal", stiffness=2092.0, tolerance=3.0).strength
    assert own.backbone == pytest.approx((2092.0,)) and own.side_chains == pytest.approx((500.0,))
    assert own.tolerance == 3.0


def touching(structure, residue, x):
    """(nr,) bool: residues with an unbonded atom within the van der Waals radii of one of a residue's."""
    radius = np.array([VAN_DER_WAALS[str(each)] for each in structure.atom_element])
    near = np.linalg.norm(x[:, None] - x, axis=2) < radius[:, None] + radius
    near[tuple(bonded_pairs(structure, 3).T)] = near[tuple(bonded_pairs(structure, 3).T[::-1])] = False
    found = np.zeros(structure.n_residues, dtype=bool)
    found[structure.atom_residue[near[structure.atom_residue == residue].any(axis=0)]] = True
    return found


def test_residues_in_trouble_and_their_neighbours_are_released_in_turn(monkeypatch):
    """The disulfide 16-26 of crambin joins what is far in sequence; springs lead to the input always."""
    s = load("1ejg.pdb")
    found = replace(violations(s), per_residue=np.arange(s.n_residues) == 15)
    monkeypatch.setattr(problems, "violations", lambda *_: found)
    relaxer = Relaxer(s, pc.energy(s, solvent="vacuum", threads=1), PRESETS["predicted"], 2, lambda *_: None)
    excluded = np.arange(s.n_residues) == 40
    done = relaxer.rounds(s.positions, excluded, 5)
    bonded = [15, 14, 16, 25]
    assert s.residue_name[25] == s.residue_name[15] == "CYS"
    alpha = s.alpha_carbons
    for k, (each, share) in enumerate(zip(done, (1.0, 0.1, 0.0), strict=True), 1):
        assert each.springs.home is s.positions
        expected = np.full(s.n_residues, STIFF / k)
        expected[bonded], expected[40] = share * STIFF / k, 0.0
        if k == 3:  # Released before, in vain: what touches residue 15 gives way too.
            expected[touching(s, 15, done[1].x) & (expected == STIFF / k)] *= 0.1
            assert (expected == 0.1 * STIFF / k).sum() >= 2
        assert each.springs.weight[alpha] == pytest.approx(expected)
    assert [each.round.released for each in done][:2] == [1, 5] and done[2].round.released > 6
    assert [each.round.violations for each in done] == [1, 1, 1]
    assert len(relaxer.rounds(s.positions, excluded, 2)) == 2
    moved = s.positions + np.where(s.atom_residue == 15, 1.0, 0.0)[:, None]
    assert np.array_equal(relaxer._touching(np.array([15]), moved), touching(s, 15, moved))


def test_the_round_with_the_fewest_left_is_the_result(monkeypatch):
    s = load("1l2y.pdb")
    left = iter((3, 1, 2))

    def found(*_):
        return replace(violations(s), per_residue=np.arange(s.n_residues) < next(left))

    monkeypatch.setattr(problems, "violations", found)
    result = relax_structure(s, energy("1l2y.pdb"), RelaxSettings(max_iterations=1))
    assert len(result.rounds) == 3 and result.best == 1
    assert [each.violations for each in result.rounds] == [3, 1, 2]


def test_what_is_left_is_said():
    """Springs so stiff that a peptide bond stays broken."""
    broken = models.broken(load("1l2y.pdb"), 1.0, seed=3)
    assert violations(broken)
    r = pc.relax(broken, threads=1, stiffness=1e6, max_outer_iterations=1, solvent="vacuum")
    assert r.status is pc.Status.VIOLATIONS or r.status is pc.Status.CLASH
    first = broken.describe_residue(int(violations(broken, r.x).residues[0]))
    assert "left with violations" in r.message and first in r.message
    assert r.record()["status"] != "converged" and r.is_usable
    free = pc.relax(broken, threads=1, solvent="vacuum")
    assert free.status is pc.Status.CONVERGED and free.measures_end["violations"] == 0


def test_excluded_residues_have_no_springs():
    s = load("1l2y.pdb")
    r = pc.relax(s, threads=1, exclude="resid 5:8 and name CA", solvent="vacuum")
    assert r.rounds[0].released == 4
    with pytest.raises(pc.ProtochainError, match="selects no atom"):
        pc.relax(s, exclude="resid 999")


def test_iterations_are_counted_and_limited():
    s = load("1l2y.pdb")
    r = pc.relax(s, threads=1, max_iterations=3)
    assert r.status is pc.Status.BUDGET and r.rounds[0].iterations <= 3
    assert len(r.trace) == 4 and r.energy_end < r.energy_start
    staged = pc.relax(s, "design", threads=1, max_iterations=3)
    assert [each.iterations for each in staged.rounds] == [3] * len(staged.rounds)
    whole = pc.relax(s, threads=1, max_iterations=0)
    assert whole.status is pc.Status.CONVERGED
    assert (np.diff(whole.trace[:, 1]) >= 1).all() and whole.trace[-1, 4] <= 10.0


def test_design_goes_through_three_stages_and_ends_free(damaged):
    stages = []

    class Watch:
        def __call__(self, row, x):
            assert np.isfinite(row["energy_kj_mol"]) and x.shape == damaged.positions.shape

        def at_stage(self, name, evaluations):
            stages.append(name)

    r = pc.relax(damaged, "design", threads=1, watch=Watch())
    assert stages[0] == "resolving clashes" and stages[-1] == "all atoms"
    assert len(r.rounds) == 1 and r.frame.held_by == "" and "springs included" not in r.message
    assert not overlaps(damaged, r.x) and r.ca_rmsd_angstrom < 2.0
    superposed, as_filed = r.frame.ca_rmsds(r.x)
    assert superposed == pytest.approx(as_filed, abs=1e-6)


def test_the_protocol_has_its_own_force_field():
    s = load("1l2y.pdb")
    with expect_refusal("solvent", "protocol", match="gbn2"):
        pc.relax(s, protocol="alphafold", solvent="gbn2")
    with expect_refusal("preset", "protocol"):
        pc.relax(s, "design", protocol="alphafold")


def test_another_engine_is_judged_by_the_reference_platform():
    r = pc.relax(load("1l2y.pdb"), engine="openmm", solvent="vacuum", threads=1)
    assert r.judge == "OpenMM's Reference platform, in double precision" and r.judge in r.message
    assert r.status is pc.Status.CONVERGED
    native = pc.relax(load("1l2y.pdb"), engine="native", solvent="vacuum", threads=1)
    assert r.energy_end == pytest.approx(native.energy_end, abs=5.0)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"preset": "weak"}, "preset 'weak' is not known; choose from predicted, crystal, design"),
        ({"protocol": "rosetta"}, "protocol 'rosetta' is not known; choose from alphafold"),
        ({"tolerance": 1e7}, "give a number above 0, at most 1e6"),
        ({"tolerance": 0.0}, "tolerance 0: give a number above 0, at most 1e6"),
        ({"stiffness": -1.0}, "stiffness -1: give kJ/mol/nm^2, none below 0"),
        ({"max_iterations": -1}, "max_iterations -1: give 0 or more"),
        ({"max_outer_iterations": 0}, "max_outer_iterations 0: give at least 1"),
        ({"hinges": "phi"}, "relax has no option 'hinges'"),
        ({"method": "lbfgs"}, "relax has no option 'method'"),
        ({"pH": 4.0}, "did you mean ph?"),
    ],
)
def test_settings_that_make_no_sense_are_refused(options, said):
    with pytest.raises(pc.ProtochainError, match=said.replace("^", r"\^")):
        pc.relax(load("1l2y.pdb"), **options)


def test_molecules_beside_the_protein_stand_still():
    s = pc.load(shared("3i40_insulin.pdb"), keep="water")
    assert s.obstacle.sum() > 20
    r = pc.relax(s, threads=1, max_iterations=5)
    assert np.array_equal(r.x[s.obstacle], s.positions[s.obstacle])
    assert (np.linalg.norm(r.x - s.positions, axis=1)[~s.obstacle] > 0).all()
    assert r.frame.held_by == "atoms that stand still"


@pytest.mark.parametrize(
    ("given", "named"),
    [
        ("x_unrelaxed_rank_001_alphafold2_model_3.pdb", "x_relaxed_rank_001_alphafold2_model_3.pdb"),
        ("unrelaxed_model_1.pdb.gz", "relaxed_model_1.pdb"),
        ("unrelaxed_unrelaxed_rank_2.pdb", "unrelaxed_relaxed_rank_2.pdb"),
        ("boltz.cif", "boltz.relaxed.cif"),
        ("1abc.ent", "1abc.relaxed.pdb"),
    ],
)
def test_names_of_results(given, named, tmp_path):
    assert relaxed_name(tmp_path / given) == named


def test_a_result_of_standard_input_has_a_name(monkeypatch):
    monkeypatch.setattr("protochain.relaxation.names.suffix_of", lambda source: ".pdb")
    assert relaxed_name(Path("-")) == "stdin.relaxed.pdb"


def test_a_result_is_a_value(relaxed, damaged):
    for other in (copy.deepcopy(relaxed), pickle.loads(pickle.dumps(relaxed))):
        assert np.array_equal(other.x, relaxed.x) and other.message == relaxed.message
    assert not relaxed.x.flags.writeable
    assert "Relaxation of" in repr(relaxed) and "converged" in repr(relaxed)
    assert "<table>" in relaxed._repr_html_()
    assert pc.as_structure(relaxed).n_atoms == damaged.n_atoms
    assert list(relaxed.displacements.columns) == ["chain", "residue", "name", "displacement_angstrom"]


def test_an_interrupt_keeps_the_best_so_far(monkeypatch):
    s = load("1l2y.pdb")
    taken = []

    def interrupted(self, stage, at, evaluations):
        taken.append(at.energy)
        if len(taken) == 4:
            raise KeyboardInterrupt

    monkeypatch.setattr("protochain.relaxation.relax_structure._Trace.__call__", interrupted)
    r = relax_structure(s, energy("1l2y.pdb"), RelaxSettings())
    assert r.status is pc.Status.INTERRUPTED and len(r.rounds) == 1
    assert r.energy_end <= r.energy_start
    assert Stop.INTERRUPTED in rounds._FINAL


@pytest.mark.usefixtures("interruptible")
def test_a_signal_between_two_rounds_keeps_the_first(monkeypatch):
    s = load("1l2y.pdb")
    found = replace(violations(s), per_residue=np.arange(s.n_residues) < 3)

    def interrupted(*_):
        signal.raise_signal(signal.SIGINT)
        return found

    monkeypatch.setattr(problems, "violations", interrupted)
    r = relax_structure(s, energy("1l2y.pdb"), RelaxSettings())
    first, second = r.rounds
    assert first.evaluations > 1 and second.evaluations == r.best == 0 and r.energy_end < r.energy_start


def test_the_rough_energy_is_that_of_a_cutoff_with_a_reaction_field():
    """OpenMM's Reference platform, with the same cutoff and dielectric, in vacuum."""
    s = load("1l2y.pdb")
    system = build_system(s, solvent="vacuum")
    (nonbonded,) = (force for force in system.getForces() if isinstance(force, openmm.NonbondedForce))
    nonbonded.setNonbondedMethod(nonbonded.CutoffNonPeriodic)
    nonbonded.setCutoffDistance(0.9)
    nonbonded.setReactionFieldDielectric(78.5)
    reference, forces = OpenMMEnergy(system, "Reference")(s.positions)
    value, own = energy("1l2y.pdb").coarse(s.positions)
    assert value == pytest.approx(reference, rel=NATIVE_ENERGY * 100)
    assert np.linalg.norm(own - forces) < NATIVE_FORCE * 100 * np.linalg.norm(forces)
    assert abs(value - energy("1l2y.pdb")(s.positions)[0]) > 100.0


def test_only_hands_that_became_wrong_are_inverted():
    """A model with noise, in which hands were wrong, ends with right ones: that is no fault."""
    shaken = models.shaken(load("1l2y.pdb"), 0.6, seed=2)
    x, mirrored = shaken.positions, shaken.mirrored
    wrong = wrong_centres(shaken, x, mirrored)
    assert len(wrong) >= 1
    r = pc.relax(shaken, threads=1, solvent="vacuum")
    left = wrong_centres(shaken, r.x, mirrored)
    assert len(left) < len(wrong) and (r.status is pc.Status.INVERTED) == bool(set(left) - set(wrong))
    right = load("1l2y.pdb")
    mirror = right.positions * [1.0, 1.0, -1.0]
    spoiled = _newly_inverted(Problems(right, mirror))
    assert len(spoiled) >= 16 and spoiled[0] == "CA of A:ASN1"


def test_the_budget_of_iterations_holds_while_rings_are_freed():
    """Of many rings none may come free, however long one tries."""
    (planted,) = models.planted_rings([load("1l2y.pdb")], 1, seed=1)
    points = []
    note = lambda stage, at, evaluations: points.append(at)  # noqa: E731
    relaxer = Relaxer(planted.structure, energy("1l2y.pdb"), PRESETS["predicted"], 3, note)
    relaxer._walk_stages(unthreading_stages(relaxer._space, relaxer.energy), planted.structure.positions, 0)
    assert len(points) == 4


@pytest.mark.usefixtures("interruptible")
@pytest.mark.parametrize("is_raised", [True, False])
def test_an_interrupt_while_rings_are_freed_ends_the_run(is_raised):
    """Not that stage alone, and what it has come to is kept."""
    (planted,) = models.planted_rings([load("1l2y.pdb")], 1, seed=1)
    points = []

    def note(name, at, evaluations):
        points.append(at)
        if len(points) == 4 and is_raised:
            raise KeyboardInterrupt
        if len(points) == 4:
            signal.raise_signal(signal.SIGINT)

    s = planted.structure
    relaxer = Relaxer(s, energy("1l2y.pdb"), PRESETS["predicted"], 2000, note)
    with held_interrupts():
        (done,) = relaxer.rounds(s.positions, np.zeros(s.n_residues, bool), 3)
    assert done.stop is Stop.INTERRUPTED and len(points) <= 5
    assert not np.array_equal(done.x, s.positions)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["af_with_violations.pdb", "af_multiple_disulfides.pdb"])
def test_published_models_with_violations_end_with_none(name):
    r = pc.relax(shared(name))
    assert r.status is pc.Status.CONVERGED and r.measures_end["violations"] == 0
    assert r.measures_start["violations"] > 5 and r.ca_rmsd_angstrom < 0.3
