"""Restraint on chiral atoms in a relaxation: wrong ones become right, D-amino acids stay, none is lost."""

import numpy as np
import pytest
from fixtures import models
from fixtures.repairs import sentences
from fixtures.samples import SAMPLES, load, shared

import protochain as pc
from protochain.minimisers.restraints import ChiralityRestraint
from protochain.relaxation.presets import PRESETS
from protochain.relaxation.rounds import Relaxer
from protochain.structure.molecule.chirality import chiral_atoms, mirror_images, wrong_centres
from protochain.structure.molecule.repairs import Kind
from protochain.structure.molecule.residues import Residue

BACKBONE = ("N", "CA", "C", "O", "OXT", "H", "H1", "H2", "H3")


def other_hand(structure, *residues, about="CA", first="N", second="C"):
    """What hangs on an atom, reflected in the plane of it and two neighbours: a well-formed other hand."""
    x = structure.positions.copy()
    for residue in residues:
        own = np.flatnonzero(structure.atom_residue == residue)
        at = {str(structure.atom_name[i]): i for i in own}
        centre = x[at[about]]
        normal = np.cross(x[at[first]] - centre, x[at[second]] - centre)
        normal /= np.linalg.norm(normal)
        beside = BACKBONE if about == "CA" else (*BACKBONE, "HA", "CB", "HB")
        moved = [i for name, i in at.items() if name not in beside]
        x[moved] -= 2.0 * np.outer((x[moved] - centre) @ normal, normal)
    return structure.with_positions(x)


def index(structure, number):
    return int(np.flatnonzero(structure.residue_number == str(number))[0])


def named_d(text, *numbers):
    """Text of a PDB file whose alanines of these numbers are named as D-alanine."""
    lines = text.splitlines(keepends=True)
    chosen = [line[17:20] == "ALA" and int(line[22:26]) in numbers for line in lines if "ATOM" in line[:6]]
    assert any(chosen)
    return "".join(
        "HETATM" + line[6:17] + "DAL" + line[20:]
        if line.startswith("ATOM") and int(line[22:26]) in numbers
        else line
        for line in lines
    )


@pytest.mark.parametrize("name", SAMPLES)
def test_a_structure_of_usual_shape_feels_nothing(name):
    s = load(name)
    energy, forces = ChiralityRestraint.of(s)(s.positions)
    assert energy == 0.0 and not forces.any() and not len(ChiralityRestraint.of(s).inversions(s.positions))


def test_forces_are_the_gradient_of_the_energy():
    s = models.shaken(load("1l2y.pdb"), 0.3, seed=3)
    hands, x, step = ChiralityRestraint.of(s), s.positions, 1e-6
    energy, forces = hands(x)
    assert energy > 1.0
    for atom in np.flatnonzero(np.abs(forces).max(axis=1) > 1.0)[:12]:
        for k in range(3):
            there, back = x.copy(), x.copy()
            there[atom, k] += step
            back[atom, k] -= step
            slope = (hands(there)[0] - hands(back)[0]) / (2.0 * step)
            assert -slope == pytest.approx(forces[atom, k], rel=1e-5, abs=1e-3)


def test_every_triple_of_bonds_of_an_atom_counts():
    """Four triples for a C-alpha with its hydrogen, and they turn the atom in the mirror the other way."""
    s = load("ala10.pdb")
    hands = ChiralityRestraint.of(s)
    assert len(hands.atoms) == 4 * 10 and (hands(s.positions)[0], len(hands.inversions(s.positions))) == (
        0.0,
        0,
    )
    mirror = s.positions * [1.0, 1.0, -1.0]
    assert hands.inversions(mirror).tolist() == np.flatnonzero(s.atom_name == "CA").tolist()
    flipped = s.positions.copy()
    (ha,) = np.flatnonzero((s.atom_residue == 4) & (s.atom_name == "HA"))
    (alpha,) = np.flatnonzero((s.atom_residue == 4) & (s.atom_name == "CA"))
    flipped[ha] = 2.0 * flipped[alpha] - flipped[ha]
    assert hands(flipped)[0] > 1.0 and not len(hands.inversions(flipped))


def test_well_formed_residues_of_the_wrong_hand_become_right():
    s = load("1ubq.pdb")
    wrong = other_hand(other_hand(s, index(s, 7), about="CB", first="CA", second="HB"), index(s, 43))
    threonine, leucine = "A:THR7", "A:LEU43"
    r = pc.relax(wrong, threads=1)
    assert (r.measures_start["inverted_stereocentres"], r.measures_end["inverted_stereocentres"]) == (2, 0)
    assert r.status == "converged" and r.measures_end["violations"] == 0 and r.ca_rmsd_angstrom < 0.2
    said = [
        f"{threonine}: inverted stereocentre CB corrected",
        f"{leucine}: inverted stereocentre CA corrected",
    ]
    assert r.stereocentres_corrected == r.structure.repairs[-2:] and sentences(r.structure)[-2:] == said
    assert r.record()["stereocentres_corrected"] == said
    assert r.rounds[0].released == 2
    assert not ChiralityRestraint.of(s)(r.x)[0]


@pytest.mark.parametrize(("name", "seed"), [("4pti.pdb", 34), ("3i40.pdb", 125)])
def test_noise_neither_leaves_nor_makes_a_wrong_hand(name, seed):
    """Of 4pti a C-alpha of 1.6 cubic angstrom, of 2.5 in ideal residues, once went to the other side."""
    s = models.shaken(load(name), 0.25, seed=seed)
    before = wrong_centres(s, s.positions, s.mirrored)
    assert len(before) == 2
    r = pc.relax(s, threads=1)
    assert r.status == "converged" and not len(wrong_centres(s, r.x, s.mirrored))
    assert len(r.stereocentres_corrected) == 2


def test_a_residue_named_as_d_keeps_its_hand_and_gets_it_where_it_has_the_other(tmp_path):
    s = load("ala10.pdb")
    pc.save(other_hand(s, 3), tmp_path / "one.pdb")
    text = named_d((tmp_path / "one.pdb").read_text(), 4, 7)
    (tmp_path / "two.pdb").write_text(text)
    two = pc.load(tmp_path / "two.pdb")
    assert np.flatnonzero(two.mirrored).tolist() == [3, 6]
    assert two.describe(int(ChiralityRestraint.of(two).inversions(two.positions)[0])) == "atom CA of A:DAL7"
    r = pc.relax(two, threads=1)
    (turned,) = r.stereocentres_corrected
    assert (turned.kind, turned.facts["atoms"]) == (Kind.HAND_TURNED, ("CA",))
    assert turned.facts["residue"] == Residue("A", "7", "DAL")
    alpha = np.flatnonzero(two.atom_name == "CA")
    assert np.intersect1d(alpha, ChiralityRestraint.of(s).inversions(r.x)).tolist() == alpha[[3, 6]].tolist()
    assert r.status == "converged" and r.measures_end["inverted_stereocentres"] == 0


MIRROR = [1.0, 1.0, -1.0]


def test_a_chain_in_the_mirror_stays_so_and_is_a_violation_unless_it_is_meant(tmp_path):
    s = load("1l2y.pdb")
    mirror = s.with_positions(s.positions * MIRROR)
    r, meant, usual = (
        pc.relax(mirror, threads=1),
        pc.relax(mirror, threads=1, mirror=True),
        pc.relax(s, threads=1),
    )
    assert r.stereocentres_corrected == meant.stereocentres_corrected == () and np.array_equal(r.x, meant.x)
    assert r.energy_end == pytest.approx(usual.energy_end, abs=0.5)
    assert r.status == "violations" and "chain A is a mirror image" in r.message
    # 17 C-alphas, three glycines having none, and the C-beta of an isoleucine.
    assert r.measures_end["inverted_stereocentres"] == r.measures_start["inverted_stereocentres"] == 18
    # As D-amino acids they are measured as the usual ones are.
    assert meant.status == usual.status == "converged"
    its = (
        "inverted_stereocentres",
        "ramachandran_outliers",
        "ramachandran_favoured_percent",
        "cbeta_outliers",
    )
    assert [meant.measures_end[name] for name in its] == [usual.measures_end[name] for name in its]
    pc.save(meant.structure, tmp_path / "d.pdb")
    again = pc.load(tmp_path / "d.pdb")
    assert again.mirrored.sum() == 17 and pc.relax(again, threads=1).status == "converged"


def test_most_stereocentres_make_a_mirror_image_chain_by_chain(tmp_path):
    s = load("1l2y.pdb")
    of = s.alpha_carbons[s.residue_name != "GLY"]
    assert mirror_images(s) == mirror_images(other_hand(s, *s.atom_residue[of[:8]])) == {}
    (its,) = mirror_images(other_hand(s, *s.atom_residue[of[:10]])).values()
    assert len(its) == len(of)
    for name, given in (("a", s), ("b", s.with_positions(s.positions * MIRROR + [0.0, 0.0, 5.0]))):
        pc.save(given, tmp_path / f"{name}.pdb")
    lines = [(tmp_path / f"{name}.pdb").read_text().splitlines(keepends=True) for name in "ab"]
    text = [line for line in lines[0] if line[:4] in ("ATOM", "TER ")]
    text += [f"{line[:21]}B{line[22:]}" for line in lines[1] if line[:4] in ("ATOM", "TER ")]
    (tmp_path / "both.pdb").write_text("".join([*text, "END\n"]))
    assert [*mirror_images(pc.load(tmp_path / "both.pdb"))] == ["B"]


def test_a_hand_lost_in_a_round_is_turned_back_before_the_next():
    s, began = load("1l2y.pdb"), {}
    lost = other_hand(s, 5).positions
    note = lambda stage, at, n: began.setdefault(stage.recorded, at.x)  # noqa: E731
    relaxer = Relaxer(s, pc.energy(s), PRESETS["predicted"], 500, note)
    relaxer._round(lost, np.ones(s.n_residues), [(400.0, 400.0)], 1, False)
    hands = relaxer.chirality
    assert len(hands.inversions(lost)) == 1 and len(began) == 2 and not len(hands.inversions(began[True]))


def test_d_amino_acids_under_names_of_l_stay_where_their_phi_is_theirs():
    """Gramicidin A alternates; its file of 1996 names D-leucine as leucine, and D-valine as valine."""
    s = pc.load(shared("1grm_gramicidin.pdb"))
    wrong = wrong_centres(s, s.positions, s.mirrored)
    assert len(wrong) == 12 and not s.mirrored.any()
    assert not len(ChiralityRestraint.of(s).inversions(s.positions))
    r = pc.relax(s, threads=1, solvent="vacuum")
    assert r.stereocentres_corrected == () and np.array_equal(wrong_centres(s, r.x, s.mirrored), wrong)
    flat = s.positions.copy()
    (around,) = (row[1:] for row in chiral_atoms(s) if row[0] == wrong[3])
    flat[wrong[3]] = s.positions[around].mean(axis=0)
    assert ChiralityRestraint.of(s.with_positions(flat)).inversions(s.positions).tolist() == [wrong[3]]
