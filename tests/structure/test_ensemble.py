"""Frames of one preparation: the same structures, bit for bit, as each frame prepared by itself."""

import copy
from dataclasses import replace

import numpy as np
import pytest
from fixtures.frames import models, shaken, without
from fixtures.repairs import turned_amides
from fixtures.samples import STRUCTURES, load, shared
from fixtures.tolerances import ROUND_OFF_NM

import protochain as pc
from protochain.structure.ensemble import Ensemble
from protochain.structure.formats.frames import Frame, open_frames

BACKBONE = ("N", "CA", "C", "O", "CB")
BOX = np.array([[4.0, 0.0, 0.0], [1.0, 3.5, 0.0], [0.5, -0.7, 3.0]])
"""nm; triclinic."""


@pytest.mark.parametrize(
    ("keep", "chosen", "within"),
    [
        (lambda atom: True, (0, 7, 14), 0.0),
        (lambda atom: not atom.is_hydrogen(), (0, 7, 14), 0.0),
        (lambda atom: atom.name in BACKBONE, (3,), ROUND_OFF_NM),
    ],
    ids=["whole", "without hydrogens", "backbones"],
)
def test_a_frame_is_the_structure_that_its_model_is_prepared_to_be(tmp_path, keep, chosen, within):
    path = without(shared("2k39_ubiquitin_nmr15.pdb"), tmp_path / "x.pdb", keep)
    frames = open_frames(path)
    ensemble = Ensemble.of(pc.load(path), frames)
    for k in chosen:
        (frame,) = frames.select(k)
        own, alone = ensemble.at(frame), pc.load(path, model=k + 1)
        assert own.fingerprint == alone.fingerprint
        # Positions of the others go from nm to angstrom and back where side chains are built.
        np.testing.assert_allclose(own.positions, alone.positions, rtol=0, atol=within)


def test_waters_and_other_atoms_that_are_left_out_stay_out():
    path = STRUCTURES / "3i40.pdb"
    structure = pc.load(path)
    origin = structure.origin
    assert len(origin.atoms) > structure.n_atoms - (origin.place < 0).sum()
    x = np.full((1, len(origin.atoms), 3), 50.0)
    mine = origin.place >= 0
    x[0, origin.place[mine]] = structure.positions[mine] + 1.0
    (frame,) = frames = open_frames(x)
    found = Ensemble.of(structure, frames).at(frame)
    np.testing.assert_allclose(found.positions[mine], structure.positions[mine] + 1.0, rtol=0, atol=1e-15)
    # Hydrogens, which the file lacks, come along; those turned are rounded, to 1e-6 nm.
    assert np.abs(found.positions - structure.positions - 1.0).max() < 2e-6


def not_turned(structure, atom):
    """Whether an atom is no end of an amide that was turned."""
    residue = structure.atom_residue[atom]
    chain, number = structure.residue_chain[residue], structure.residue_number[residue]
    return (str(chain), str(number), str(structure.atom_name[atom])) not in turned_amides(structure)


@pytest.mark.parametrize("name", ["1ubq.pdb", "1ubq.cif"])
def test_places_are_those_of_the_text(name):
    structure = load(name)
    lines = [
        line
        for line in (STRUCTURES / name).read_text().splitlines()
        if line[:6].strip() in ("ATOM", "HETATM")
    ]
    if name.endswith("pdb"):
        text = np.array([[line[30 + 8 * k : 38 + 8 * k] for k in range(3)] for line in lines], dtype=float)
    else:
        text = np.array([line.split()[10:13] for line in lines], dtype=float)
    place = structure.origin.place
    (same,) = np.nonzero(place >= 0)
    same = same[[not_turned(structure, atom) for atom in same]]
    np.testing.assert_allclose(structure.positions[same], 0.1 * text[place[same]], rtol=1e-15)
    assert len(structure.origin.atoms) == len(text)


def test_frames_in_the_order_of_the_file_are_told_from_those_of_the_structure(tmp_path):
    """A complete file, hydrogens last in each residue: both orders have as many atoms."""
    own = load("1l2y.pdb")
    order = np.lexsort((np.arange(own.n_atoms), own.atom_element == "H", own.atom_residue))
    pc.save(own, tmp_path / "x.pdb")
    lines = (tmp_path / "x.pdb").read_text().splitlines(keepends=True)
    atoms = [i for i, line in enumerate(lines) if line.startswith("ATOM")]
    sorted_lines = [lines[atoms[k]] for k in order]
    for i, line in zip(atoms, sorted_lines, strict=True):
        lines[i] = line
    (tmp_path / "y.pdb").write_text("".join(lines))
    structure = pc.load(tmp_path / "y.pdb")
    assert not np.array_equal(structure.origin.place, np.arange(own.n_atoms))
    x = shaken(own, 1)
    filed = np.empty_like(x)
    filed[:, structure.origin.place] = x
    for given in (x, filed):
        (frame,) = frames = open_frames(given)
        assert np.array_equal(Ensemble.of(structure, frames).at(frame).positions, x[0])


def test_molecules_broken_across_the_box_are_made_whole():
    structure = load("1l2y.pdb")
    for k, x in enumerate(shaken(structure, 5)):
        inside = (x @ np.linalg.inv(BOX)) % 1.0 @ BOX
        broken = np.abs(inside - x - (inside - x)[0]).max() > 1.0
        frames = open_frames(inside[None])
        ensemble = Ensemble.of(structure, frames)
        found = ensemble.at(Frame(k, inside, BOX)).positions
        assert broken, "the test needs a molecule that is broken"
        off = (found - x - (found - x)[0]) @ np.linalg.inv(BOX)
        np.testing.assert_allclose(off, 0.0, atol=ROUND_OFF_NM)
        with pytest.raises(pc.ProtochainError, match=r"atom \w+ of A:\w+ .* angstrom apart: .*box"):
            ensemble.at(Frame(k, inside))


def test_a_molecule_that_is_whole_stays_where_it_is_bit_for_bit():
    structure = load("1l2y.pdb")
    (x,) = shaken(structure, 1)
    ensemble = Ensemble.of(structure, open_frames(x[None]))
    assert np.array_equal(ensemble.at(Frame(0, x, 3.0 * BOX)).positions, x)


def test_a_chain_in_another_image_comes_back_to_what_it_touches_and_a_far_one_stays():
    structure = pc.load(STRUCTURES / "3i40.pdb", keep="none")
    box, x = np.diag([6.0, 6.0, 6.0]), np.array(structure.positions)
    ensemble = Ensemble.of(structure, open_frames(x[None]))
    # Disulfides join its chains; apart, they are molecules of their own.
    apart = replace(ensemble, structure=pc.load(STRUCTURES / "3i40.pdb", keep="none", disulfide="none"))
    if apart.structure.n_atoms != len(x):
        x = np.array(apart.structure.positions)
        apart = Ensemble.of(apart.structure, open_frames(x[None]))
    b = apart.structure.residue_chain[apart.structure.atom_residue] == "B"
    shifted = np.array(x)
    shifted[b] += box[0] - box[2]
    np.testing.assert_allclose(apart.at(Frame(0, shifted, box)).positions, x, rtol=0, atol=ROUND_OFF_NM)
    far = np.array(x)
    far[b] += [0.0, 3.0, 0.0]
    assert np.array_equal(apart.at(Frame(0, far, np.diag([20.0] * 3))).positions, far)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda x: x.__setitem__((40, 1), np.nan), "not a number"),
        (lambda x: x.__setitem__((40, 1), np.inf), "not a number"),
        (lambda x: x.__setitem__((40, 1), 1e9), "far away"),
        (lambda x: x.__setitem__(slice(None), 0.0), "0.00 angstrom"),
        (lambda x: x.__setitem__(slice(None), x[::-1].copy()), "other atoms"),
    ],
    ids=["NaN", "infinite", "far", "one place", "other atoms"],
)
def test_a_frame_that_makes_no_sense_is_refused_naming_an_atom(change, said):
    structure = load("1l2y.pdb")
    x = 5.0 * np.array(structure.positions) if said == "other atoms" else np.array(structure.positions)
    ensemble = Ensemble.of(structure, open_frames(x[None]))
    change(x)
    with pytest.raises(pc.ProtochainError, match=r"atom \w+ of A:[A-Z]{3}\d") as refused:
        ensemble.at(Frame(3, x))
    assert said in str(refused.value) and "\n" not in str(refused.value)


def test_frames_of_another_topology_are_refused_with_the_numbers_of_atoms(tmp_path):
    structure = load("1ubq.pdb")
    with pytest.raises(pc.ProtochainError, match=r"7 atoms a frame, but 1ubq 660, and 1231"):
        Ensemble.of(structure, open_frames(np.zeros((2, 7, 3))))
    other = models(load("1l2y.pdb"), shaken(load("1l2y.pdb"), 2), tmp_path / "other.pdb")
    with pytest.raises(pc.ProtochainError, match=r"other\.pdb: has no atom A/1/MET"):
        Ensemble.of(structure, open_frames(other))


def test_backbones_of_another_sequence_are_refused(tmp_path):
    structure = load("1l2y.pdb")
    turn = np.broadcast_to(np.eye(3), (1, 20, 3, 3))
    alpha = structure.positions[structure.alpha_carbons][None]
    np.savez(tmp_path / "x.npz", pos=alpha, node_orientations=turn, sequence="A" * 20)
    with pytest.raises(pc.ProtochainError, match="NLYIQWLKDGGPSSGRPPPS"):
        Ensemble.of(structure, open_frames(tmp_path / "x.npz"))


def test_a_hydrogen_far_from_its_atom_is_placed_anew_as_in_a_file(tmp_path):
    structure = load("1l2y.pdb")
    (x,) = shaken(structure, 1, by=0.0)
    hydrogen = int(np.flatnonzero(structure.atom_name == "HB2")[3])
    heavy = structure.neighbours[hydrogen][0]
    x[hydrogen] += 0.06 * (x[hydrogen] - x[heavy]) / np.linalg.norm(x[hydrogen] - x[heavy])
    frames = open_frames(models(structure, x[None], tmp_path / "x.pdb"))
    alone = pc.load(tmp_path / "x.pdb")
    (found,) = (Ensemble.of(structure, frames).at(frame) for frame in frames)
    assert np.array_equal(found.positions, alone.positions)
    length = np.linalg.norm(found.positions[hydrogen] - found.positions[heavy])
    assert length == pytest.approx(0.109, abs=1e-5)


def test_the_gap_is_how_far_chains_lie_apart_that_touch_in_the_structure():
    s = load("3i40.pdb")
    ensemble = Ensemble(s, np.arange(s.n_atoms), {})
    b = s.residue_chain[s.atom_residue] == "B"
    near = np.linalg.norm(s.positions[b][:, None] - s.positions[~b][None], axis=2).min()
    # Disulfides join insulin's chains to one molecule.
    assert ensemble.gap(s.positions) is None
    cut = replace(s, topology=without_disulfides(s.topology))
    ensemble = Ensemble(cut, np.arange(s.n_atoms), {})
    assert ensemble.gap(cut.positions) == pytest.approx(near)
    moved = cut.positions + np.outer(b, [5.0, 0.0, 0.0])
    far = np.linalg.norm(moved[b][:, None] - moved[~b][None], axis=2).min()
    assert far > 1.0 and ensemble.gap(moved) == pytest.approx(far)


def without_disulfides(topology):
    made = copy.deepcopy(topology)
    made._bonds = [bond for bond in made._bonds if {bond[0].name, bond[1].name} != {"SG"}]
    return made


@pytest.mark.parametrize(("side", "is_box"), [(0.1, False), (0.25, False), (0.4, True)])
def test_cells_too_thin_for_any_molecule_are_none(side, is_box):
    t = pc.to_mdtraj(load("1l2y.pdb"))
    t.unitcell_vectors = side * np.eye(3)[None]
    (frame,) = open_frames(t)
    assert (frame.box is not None) == is_box


def test_the_gap_is_the_largest_of_several_molecules():
    s = load("1ysa.pdb")
    ensemble = Ensemble(s, np.arange(s.n_atoms), {})
    first = s.residue_chain[s.atom_residue] == "A"
    near, far = (ensemble.gap(s.positions + np.outer(first, [0.0, 0.0, z])) for z in (0.0, 20.0))
    assert near < 0.6 < 5.0 < far
