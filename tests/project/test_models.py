"""The generator of damaged models: what it damages, what it leaves, and that a seed repeats it."""

import numpy as np
import pytest
from fixtures import models
from fixtures.oracles import bond_lengths
from fixtures.samples import load, shared
from fixtures.tolerances import GEOMETRY_NM

SMALL = ("1vii.pdb", "4pti.pdb", "1ubq.pdb")
MAKERS = {
    "shaken": lambda s, seed: models.shaken(s, 0.3, seed),
    "turned": lambda s, seed: models.turned(s, 3.0, seed),
    "chi1": lambda s, seed: models.with_random_side_chains(s, seed, chis=1),
    "chis": lambda s, seed: models.with_random_side_chains(s, seed),
    "broken": lambda s, seed: models.broken(s, 1.0, seed, n=2),
}


@pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS)
def test_a_seed_repeats_a_model_and_another_does_not(make):
    s = load("1vii.pdb")
    one, same, other = (make(s, seed).positions for seed in (1, 1, 2))
    assert np.array_equal(one, same)
    assert np.abs(one - other).max() > 0.01
    assert np.abs(one - s.positions).max() > 0.01


def test_shaken_atoms_move_by_the_noise_asked_for():
    s = load("1ubq.pdb")
    moved = 10 * (models.shaken(s, 0.2, 0).positions - s.positions)
    assert moved[s.atom_element != "H"].std() == pytest.approx(0.2, rel=0.05)
    assert abs(moved.mean()) < 0.03
    pairs = s.bonds[(s.atom_element[s.bonds] == "H").any(axis=1)]
    assert np.allclose(moved[pairs[:, 0]], moved[pairs[:, 1]], atol=1e-9)


@pytest.mark.parametrize("chis", [1, None])
def test_random_side_chains_keep_bonds_backbone_and_bridges(chis):
    s = load("4pti.pdb")
    x = models.with_random_side_chains(s, 3, chis).positions
    assert np.allclose(bond_lengths(s.bonds, x), bond_lengths(s.bonds, s.positions), atol=GEOMETRY_NM)
    moved = np.linalg.norm(x - s.positions, axis=1) > 0.01
    assert not moved[np.isin(s.atom_name, ["N", "CA", "C", "O", "CB"])].any()
    assert not moved[np.isin(s.residue_name[s.atom_residue], ["CYS", "CYX", "GLY", "ALA", "PRO"])].any()
    assert moved[(s.atom_name == "NZ")].all()
    hydrogens = (s.atom_element == "H") & (s.atom_name != "HA")
    assert moved[hydrogens & (s.residue_name[s.atom_residue] == "LYS")].any()


def test_chi1_alone_leaves_what_lies_beyond_as_it_was():
    s = load("1ubq.pdb")
    x = models.with_random_side_chains(s, 5, chis=1).positions
    at = models._names(s, 0)
    beyond = [at[name] for name in ("CB", "CG", "SD", "CE")]

    def across(y):
        return np.linalg.norm(y[beyond[0]] - y[beyond[3]])

    assert across(x) == pytest.approx(across(s.positions), abs=GEOMETRY_NM)
    assert across(models.with_random_side_chains(s, 5).positions) != pytest.approx(
        across(s.positions), abs=0.001
    )


def test_a_broken_chain_has_two_bonds_off_for_each_segment_and_no_other():
    s = load("1ubq.pdb")
    x = models.broken(s, 1.5, 7).positions
    change = bond_lengths(s.bonds, x) - bond_lengths(s.bonds, s.positions)
    off = s.bonds[np.abs(change) > 1e-6]
    assert 1 <= len(off) <= 2 and change.max() > 0.05
    assert all(set(s.atom_name[pair]) == {"C", "N"} for pair in off)
    moved = np.linalg.norm(x - s.positions, axis=1)
    assert moved[moved > 0] == pytest.approx(0.15)


def test_planted_rings_are_all_threaded_once_and_all_different():
    structures = [load(name) for name in SMALL[:2]]
    before = {s.name: models.threadings(s) for s in structures}
    assert not any(before.values())
    plants = models.planted_rings(structures, 5, seed=1)
    again = models.planted_rings(structures, 5, seed=1)
    for plant, same in zip(plants, again, strict=True):
        s = plant.structure
        assert np.array_equal(s.positions, same.structure.positions) and plant.bond == same.bond
        assert (plant.ring, plant.bond) in models.threadings(s) and len(models.threadings(s)) == 1
        assert set(s.atom_residue[list(plant.bond)]) == {plant.threading_residue}
        original = load(f"{s.name}.pdb")
        lengths = bond_lengths(s.bonds, s.positions), bond_lengths(s.bonds, original.positions)
        assert np.allclose(*lengths, atol=GEOMETRY_NM)
    assert len({(p.structure.name, p.ring, p.bond) for p in plants}) == 5


def test_a_bond_beside_a_ring_does_not_thread_it():
    angle = np.arange(6) * np.pi / 3
    ring = 0.14 * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(6)])
    through = np.array([[0.05, 0.05, 0.1], [0.2, 0.0, 0.1], [0.0, 0.0, 0.3], [0.13, 0.07, 0.1]])
    found = models._passes(ring[None], through, through - [0.0, 0.0, 0.2])
    assert found.tolist() == [True, False, False, False]


@pytest.mark.slow
def test_a_hundred_rings_can_be_planted_in_the_samples():
    structures = [load(name) for name in (*SMALL, "1l2y.pdb", "1ejg.pdb", "3i40.pdb", "1hel.pdb")]
    assert len({p.ring for p in models.planted_rings(structures, 100, seed=0)}) > 25


def test_too_many_rings_say_how_many_there_are():
    with pytest.raises(ValueError, match="0 places"):
        models.planted_rings([load("ala10.pdb")], 1, seed=0)


def test_damaged_models_are_named_and_all_differ():
    made = dict(models.damaged([load("1l2y.pdb"), load("1vii.pdb")], 14, seed=0))
    assert len(made) == 14 and {s.name for s in made.values()} == {"1l2y", "1vii"}
    for s in made.values():
        assert np.isfinite(s.positions).all() and not np.allclose(
            s.positions, load(f"{s.name}.pdb").positions
        )


def test_models_of_an_ensemble_are_those_asked_for():
    made = models.nmr_models(shared("1a1p_compstatin.pdb"), [1, 3])
    assert [s.model_number for s in made] == [1, 3]
    assert not np.array_equal(made[0].positions, made[1].positions)
