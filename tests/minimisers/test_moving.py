"""A selection of what moves: its words, what is said of it, and the rest fixed to the last bit."""

import numpy as np
import pytest
from fixtures.samples import chain, energy, load, shared, still
from fixtures.tolerances import LEFT_OUT

import protochain as pc
from protochain.chains.articulate import turned_atoms
from protochain.minimisers.stages import Stage, moving_part
from protochain.relaxation.repack import repack_side_chains
from protochain.structure.select import moving_mask, select

BACKBONE = {"N", "H", "H1", "H2", "H3", "CA", "HA", "HA2", "HA3", "C", "O", "OXT"}


def test_side_chains_are_all_beyond_the_c_alphas():
    s = load("3i40.pdb")
    named = np.array([str(name) not in BACKBONE for name in s.atom_name])
    assert np.array_equal(select(s, "sidechain"), named & ~s.kept)
    assert np.array_equal(
        select(s, "chainID B and not sidechain"), (s.residue_chain[s.atom_residue] == "B") & ~named
    )
    assert np.array_equal(select(s, "sidechain and resid 5:8"), select(s, "resid 5:8") & named)
    glycine = s.residue_name[s.atom_residue] == "GLY"
    assert not (select(s, "sidechain") & glycine).any()


@pytest.mark.parametrize("name", ["3i40_insulin.pdb", "2beg_abeta_fibril.pdb"])
def test_an_interface_is_the_residues_that_touch_another_chain(name):
    s = pc.load(shared(name))
    found = select(s, "interface")
    x, of = 10.0 * s.positions, s.atom_residue
    heavy = (s.atom_element != "H") & (s.residue_name[of] != "HOH")
    near = set()
    for r in range(s.n_residues):
        own = x[heavy & (of == r)]
        others = x[heavy & (s.residue_chain[of] != s.residue_chain[r])]
        if len(own) and np.linalg.norm(own[:, None] - others[None], axis=2).min() <= 5.0:
            near.add(r)
    assert near and set(of[found].tolist()) == near and np.array_equal(found, np.isin(of, list(near)))
    assert 0 < select(s, "interface and sidechain").sum() < found.sum()


def test_an_interface_of_two_chains_leaves_the_others_out():
    s = pc.load(shared("2beg_abeta_fibril.pdb"))
    found = select(s, "(interface B A) and protein")
    assert np.array_equal(found, select(s, "interface  A B"))
    # As in a structure that has only the two.
    two = pc.load(shared("2beg_abeta_fibril.pdb"), chains="A,B")
    of = sorted(set(s.atom_residue[found].tolist()))
    there = sorted(set(two.atom_residue[select(two, "interface")].tolist()))
    named = [[(str(x.residue_chain[r]), str(x.residue_number[r])) for r in its]
             for x, its in ((s, of), (two, there))]  # fmt: skip
    assert named[0] == named[1] and 0 < len(of) < len(set(s.atom_residue[select(s, "interface")].tolist()))
    assert np.array_equal(select(s, "interface and chainID A"), select(s, "chainID A and interface"))
    with pytest.raises(pc.ProtochainError, match="side 'X'"):
        select(s, "interface A X")


def test_what_selects_nothing_is_refused_wherever_it_is_given():
    s = load("1ubq.pdb")
    with pytest.raises(pc.ProtochainError, match="selection 'interface' selects no atom"):
        select(s, "interface")
    for call in (
        lambda text: pc.build_chain(s, move=text),
        lambda text: pc.Setup(move=text),
        lambda text: pc.relax(s, move=text),
        lambda text: pc.rmsd(s, s, align=text),
    ):
        for text in ("", "  "):
            with pytest.raises(pc.ProtochainError, match=r"^(move|align) '\s*': selects nothing; give a sel"):
                call(text)
    with pytest.raises(
        pc.ProtochainError, match=r"'within 5 of chain B' cannot be read: .*'around 5 chainID B'"
    ):
        pc.relax(s, move="within 5 of chain B")
    haem = still(pc.load(shared("1hpv_oldformat.pdb")))
    assert haem.obstacle.any()
    kept = haem.residue_name[haem.atom_residue[haem.obstacle]][0]
    with pytest.raises(pc.ProtochainError, match="selects only molecules that stand still"):
        moving_mask(haem, f"resname {kept}")


def test_a_stage_of_moving_atoms_omits_the_terms_of_the_fixed_atoms():
    """Forces on the moving atoms and differences of energies are those of all terms."""
    s, e = load("ala10.pdb"), energy("ala10.pdb")
    moving = select(s, "resid 5")
    stage = moving_part(Stage(None, None, e, 1.0), moving)
    fewer = stage.fit(stage, s.positions).energy
    assert fewer.left_out and not e.left_out
    x = s.positions + 0.001 * moving[:, None]
    (before, _), (after, forces) = fewer(s.positions), fewer(x)
    all_before, (all_after, all_forces) = e(s.positions)[0], e(x)
    assert abs(after - before - (all_after - all_before)) < LEFT_OUT * abs(all_before)
    assert np.linalg.norm((forces - all_forces)[moving]) < LEFT_OUT * np.linalg.norm(all_forces)


@pytest.mark.parametrize("move", ["sidechain", "around 4 chainID A"])
def test_relax_moves_what_is_selected_and_no_bit_of_the_rest(move):
    s, e = load("3i40.pdb"), energy("3i40.pdb")
    r = pc.relax(s, move=move, max_iterations=25, tolerance=30.0, threads=1)
    chosen = moving_mask(s, move)
    assert 0 < chosen.sum() < s.n_atoms
    assert np.array_equal(r.x[~chosen], s.positions[~chosen])
    assert (np.abs(r.x - s.positions)[chosen] > 0.0).any(axis=1).mean() > 0.9
    assert r.energy_end < r.energy_start and e.reference(r.x)[0] == pytest.approx(r.energy_end, abs=1e-3)
    record = r.record()
    assert (record["n_atoms_moving"], record["move"]) == (chosen.sum(), move)
    assert str(r.frame) == "held by atoms that stand still"
    assert any(f"MOVED {chosen.sum()} OF {s.n_atoms} ATOMS" in line for line in r.provenance())
    # Its force is that of the atoms that move.
    assert np.array_equal(r.structure.positions, r.x)


def test_no_round_unthreading_hand_or_rotamer_moves_what_is_fixed():
    """Parting of overlaps, turning of hands and repacking each have steps of their own."""
    s = load("1l2y.pdb")
    x = s.positions.copy()
    rng = np.random.default_rng(0)
    x += 0.05 * rng.normal(size=x.shape)
    alpha = s.alpha_carbons[[5, 12]]
    hydrogens = [
        int(np.flatnonzero((s.atom_residue == s.atom_residue[k]) & (s.atom_name == "HA"))[0]) for k in alpha
    ]
    betas = [
        int(np.flatnonzero((s.atom_residue == s.atom_residue[k]) & (s.atom_name == "CB"))[0]) for k in alpha
    ]
    x[hydrogens], x[betas] = x[betas], x[hydrogens]
    spoilt = s.with_positions(x)
    for move in ("resid 10:20", "sidechain"):
        r = pc.relax(spoilt, "design", move=move, max_iterations=15, repack=True, threads=1)
        fixed = ~moving_mask(spoilt, move)
        assert len(r.rounds) >= 1 and np.array_equal(r.x[fixed], x[fixed])
    chosen = select(s, "resid 1:10")
    turned = repack_side_chains(spoilt, range(20), moving=chosen)
    assert np.array_equal(turned.positions[~chosen], x[~chosen])
    assert not np.array_equal(repack_side_chains(spoilt, range(20)).positions[~chosen], x[~chosen])


def test_atoms_that_move_by_hinges_are_counted_with_those_beyond():
    c = pc.build_chain(load("ala10.pdb"), move="resid 5")
    e = energy("ala10.pdb")
    r = pc.minimise(c, e, "lbfgs", max_evaluations=30)
    moved = (np.abs(r.x - c.structure.positions) > 1e-9).any(axis=1)
    turned = turned_atoms(c)
    # Atoms on the axis of the first hinge are beyond it, too.
    assert moved.sum() <= turned.sum() <= moved.sum() + 2 and turned[moved].all()
    assert r.record()["n_atoms_moving"] == turned.sum() > c.moving.sum()
    atoms = pc.minimise(c, e, "cartesian", max_evaluations=10)
    assert atoms.record()["n_atoms_moving"] == c.moving.sum()
    assert (
        pc.minimise(chain("ala10.pdb"), e, "lbfgs", max_evaluations=2).record()["n_atoms_moving"] == c.n_atoms
    )


@pytest.mark.parametrize(
    ("call", "place"),
    [
        (lambda s: pc.minimise(s, move="sidechain"), r"pc\.build_chain\(structure, move=\.\.\.\) takes it"),
        (lambda s: pc.compare(s, hinges="phi"), r"pc\.build_chain\(structure, hinges=\.\.\.\) takes it"),
        (lambda s: pc.simulate(s, move="sidechain"), r"pc\.build_chain\(structure, move=\.\.\.\) takes it"),
        (lambda s: pc.minimise(s, solvent="gbn2"), r"pc\.energy\(structure, solvent=\.\.\.\) takes it"),
        (lambda s: pc.build_chain(s, keep="all"), r"pc\.load\(file, keep=\.\.\.\) takes it"),
        (lambda s: pc.load("in.pdb", chain="A"), r"pc\.load\(file, chains='A'\) reads chains of a file"),
        (lambda s: pc.as_structure("in.pdb", chain="A"), r"pc\.load\(file, chains='A'\) reads"),
        (lambda s: pc.minimise(s, chain="A"), r"pc\.load\(file, chains='A'\) reads"),
    ],
)  # fmt: skip
def test_an_option_of_another_call_is_refused_with_its_place(call, place):
    with pytest.raises(pc.ProtochainError, match=rf"^\w+ has no option '\w+'; {place}"):
        call(load("ala10.pdb"))
    with pytest.raises(TypeError, match="'colour'"):
        pc.load("in.pdb", colour="red")
