"""Relaxation of damaged models: threaded rings, torn bonds, inverted stereocentres; springs."""

import numpy as np
import pytest
from fixtures import models
from fixtures.oracles import bond_lengths
from fixtures.repairs import sentences
from fixtures.samples import load

import protochain as pc
from protochain.chains.contacts import overlaps
from protochain.minimisers.loop import Stop
from protochain.minimisers.restraints import ChiralityRestraint
from protochain.minimisers.stages import Outcome
from protochain.relaxation import rounds
from protochain.relaxation.presets import PRESETS
from protochain.relaxation.problems import Problems
from protochain.relaxation.rounds import Relaxer
from protochain.validation import measures, threaded_rings, violations


@pytest.mark.parametrize("seed", [1])
def test_a_planted_ring_is_freed_and_the_fold_kept(seed):
    (plant,) = models.planted_rings([load("1vii.pdb")], 1, seed)
    s = plant.structure
    assert measures(s)["threaded_rings"] >= 1
    r = pc.relax(s)
    assert r.status == "converged" and r.measures_end["threaded_rings"] == r.measures_end["violations"] == 0
    assert not models.threadings(r.structure) and r.ca_rmsd_angstrom < 0.4
    assert r.rounds[0].released == len({plant.ring_residue, plant.threading_residue})


def test_a_torn_bond_of_a_file_is_closed(tmp_path):
    torn = models.broken(load("1l2y.pdb"), 1.5, seed=3)
    pc.save(torn, tmp_path / "torn.pdb")
    s = pc.load(tmp_path / "torn.pdb")
    assert s.n_chains == 1 and any("kept as a peptide bond" in line for line in sentences(s))
    ends = np.sort(s.atom_name[s.bonds], axis=1)
    peptide = s.bonds[(ends == ["C", "N"]).all(axis=1)]
    assert bond_lengths(peptide, s.positions).max() > 0.2
    r = pc.relax(s)
    assert r.status == "converged" and bond_lengths(peptide, r.x) == pytest.approx(0.1335, abs=0.005)


def test_side_chains_that_springs_hold_against_one_another_give_way_in_a_second_round():
    s = models.with_random_side_chains(load("1ejg.pdb"), seed=3000)
    r = pc.relax(s)
    first, second = r.rounds
    assert first.violations > 0 == second.violations and r.status == "converged"
    assert first.released == 0 < second.released <= 12 and r.ca_rmsd_angstrom < 0.7
    # The trace counts on through the rounds.
    evaluations = r.trace[:, 1]
    assert (np.diff(evaluations) >= 1).all()
    assert first.evaluations < evaluations[-1] <= first.evaluations + second.evaluations


def test_rings_are_freed_where_the_round_begins_not_where_the_input_was(monkeypatch):
    (plant,) = models.planted_rings([load("1vii.pdb")], 1, seed=1)
    seen = []

    def begins(self, x, share, strengths, before, threaded):
        seen.append((share, threaded))
        raise InterruptedError

    monkeypatch.setattr(Relaxer, "_round", begins)
    whole = np.zeros(plant.structure.n_residues, dtype=bool)
    for s, start in ((load("1vii.pdb"), plant.structure), (plant.structure, load("1vii.pdb"))):
        relaxer = Relaxer(s, pc.energy(s), PRESETS["predicted"], 1, lambda *_: None)
        with pytest.raises(InterruptedError):
            relaxer.rounds(start.positions, whole, 1)
        there = [plant.ring_residue, plant.threading_residue] if start is plant.structure else []
        assert np.flatnonzero(seen[-1][0] == 0.0).tolist() == sorted(there) and seen[-1][1] == bool(there)


def stayed(stage, x):
    return Outcome(Stop.TOLERANCE, stage.space, stage.space.start(x), 1, 1, stage.restraint)


def test_what_is_wrong_with_the_input_is_forgotten_where_a_round_ends_without_it(monkeypatch):
    (plant,) = models.planted_rings([load("1l2y.pdb")], 1, seed=3)
    bad, good = models.shaken(plant.structure, 0.25, seed=3), load("1l2y.pdb")
    monkeypatch.setattr(rounds, "walk", lambda plan, x, *_, **__: stayed(plan[0], x))
    relaxer = Relaxer(bad, pc.energy(bad), PRESETS["predicted"], 0, lambda *_: None)
    x = bad.positions
    wrong = (
        relaxer.chirality.inversions(x),
        relaxer.peptides.twisted_bonds(x),
        threaded_rings(bad),
        overlaps(bad, x),
    )
    assert all(len(each) for each in (*wrong, violations(bad).residues))
    for at, concerned in ((x, True), (good.positions, False)):
        ended = relaxer._round(at, np.ones(bad.n_residues), [(1.0, 1.0)], 1, False)
        assert bool(len(ended.concerned)) is concerned
        assert (ended.round.violations > 0, ended.round.overlaps > 0) == (concerned, concerned)


def test_a_wrong_hand_weakens_springs_and_gives_none_to_an_excluded_residue(monkeypatch):
    s, seen = load("1l2y.pdb"), []

    def begins(self, x, share, *_):
        seen.append(share.copy())
        raise InterruptedError

    monkeypatch.setattr(Relaxer, "_round", begins)
    monkeypatch.setattr(ChiralityRestraint, "inversions", lambda self, x: s.alpha_carbons[[4, 7]])
    relaxer = Relaxer(s, pc.energy(s), PRESETS["predicted"], 1, lambda *_: None)
    with pytest.raises(InterruptedError):
        relaxer.rounds(s.positions, np.arange(s.n_residues) == 7, 1)
    assert seen[0].tolist() == [{4: 0.1, 7: 0.0}.get(r, 1.0) for r in range(s.n_residues)]


def test_a_bond_that_a_broken_chain_does_not_have_holds_up_nothing_and_is_reported(tmp_path):
    """Numbers go on across the break: AlphaFold counts a violation there, which no round can mend."""
    s = load("1l2y.pdb")
    beyond = s.atom_residue >= 10
    torn = s.with_positions(s.positions + np.where(beyond, 0.35, 0.0)[:, None] * away_from(s, 9, 10))
    pc.save(torn, tmp_path / "torn.pdb")
    r = pc.relax(tmp_path / "torn.pdb", threads=1)
    assert r.start.n_chains == 2 and len(r.rounds) == 1 and r.rounds[0].violations == 2
    assert r.status == "converged" and r.measures_end["violations"] == 2
    assert "2 residues with violations at breaks of the chain" in r.message
    found = Problems(r.start, r.x)
    assert found.violations.per_residue.sum() == 2 and not found.mendable().any()
    whole = Problems(s, torn.positions)
    per_residue = whole.violations.per_residue
    assert np.array_equal(whole.mendable(), per_residue) and per_residue.sum() >= 2


def away_from(structure, before, after):
    """Unit vector (3,) along the peptide bond between two residues."""
    names, of, x = structure.atom_name, structure.atom_residue, structure.positions
    c, n = x[(names == "C") & (of == before)][0], x[(names == "N") & (of == after)][0]
    return (n - c) / np.linalg.norm(n - c)
