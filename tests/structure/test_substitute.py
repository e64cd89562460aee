"""Side chains built anew from the backbone, and sequences put on it."""

import numpy as np
import pytest
from fixtures.command_line import refusal_as_said
from fixtures.samples import STRUCTURES, load, shared

import protochain as pc
from protochain.chains.hinges import find_hinges
from protochain.core.arrays import dihedral
from protochain.structure.molecule.chirality import with_mirror_images, wrong_centres
from protochain.structure.molecule.repairs import Kind
from protochain.structure.molecule.residues import STANDARD
from protochain.structure.substitute import substitute

LYSOZYME = STRUCTURES / "1hel.pdb"


def inverted(structure):
    return wrong_centres(structure, structure.positions, structure.mirrored).tolist()


def chi1(structure):
    atoms = [hinge.atoms for hinge in find_hinges(structure, ("chi",)) if hinge.kind == "chi1"]
    return np.degrees(dihedral(*structure.positions[np.transpose(atoms)]))


def residue(structure, place):
    chain, number = place.split(":")
    return int(np.flatnonzero((structure.residue_chain == chain) & (structure.residue_number == number))[0])


@pytest.mark.parametrize("name", ["3i40.pdb", "1ysa.pdb"])
def test_a_structure_in_which_nothing_is_replaced_is_the_same(name):
    s = load(name)
    same = substitute(s, {})
    assert same.fingerprint == s.fingerprint and np.array_equal(same.positions, s.positions)
    assert same.repairs == s.repairs and same.residue_label == s.residue_label
    assert np.array_equal(same.origin.place, s.origin.place)


@pytest.mark.parametrize("name", ["GLY", "PRO", "CYS", "HIS", "LEU", "TRP"])
def test_a_mutant_has_the_atoms_of_its_residue_and_all_others_where_they_were(name):
    s = load("1hel.pdb")
    r = residue(s, "A:56")
    m = substitute(s, {r: name})
    assert m.residue_name[r] == name and m.n_residues == s.n_residues
    before, after = (each.atom_residue != r for each in (s, m))
    assert np.array_equal(s.positions[before], m.positions[after])
    there = set(m.atom_name[(m.atom_residue == r) & (m.atom_element != "H")].tolist())
    built = set(pc.from_sequence(f"A{STANDARD[name]}A").atom_name.tolist())
    assert {"N", "CA", "C", "O"} <= there <= built
    assert not inverted(m) and m.origin.atoms == s.origin.atoms
    last = m.repairs[-1]
    assert last.kind is (Kind.SIDE_CHAIN_BUILT if name == "LEU" else Kind.MUTATED)


def test_a_disulfide_bond_that_loses_a_cysteine_leaves_the_other_reduced():
    s = load("1hel.pdb")
    m = substitute(s, {residue(s, "A:6"): "ALA"})
    assert "HG" in m.atom_name[m.atom_residue == residue(m, "A:127")].tolist()
    sulphur = [(m.atom_name[b] == "SG").all() for b in m.bonds]
    assert sum(sulphur) == 3


def test_d_amino_acids_become_others_of_their_hand():
    s = pc.Setup(sequence="AAA").load(pc.from_sequence("GGG"))
    mirror = s.with_positions(s.positions * [1, 1, -1])
    d = with_mirror_images(mirror)
    m = substitute(d, {1: "LEU"})
    assert m.residue_name_in_file.tolist() == ["DAL", "DLE", "DAL"] and not inverted(m)


def test_rebuilt_side_chains_are_mostly_those_of_the_crystal():
    s = pc.load(shared("5pti_bpti.cif"))
    m = pc.Setup(rebuild_side_chains="all").load(shared("5pti_bpti.cif"))
    off = np.abs((chi1(m) - chi1(s) + 180.0) % 360.0 - 180.0)
    assert len(off) > 40 and (off < 40.0).mean() > 0.7
    assert (m.repairs[-1].kind, m.built[m.alpha_carbons].any()) == (Kind.SIDE_CHAIN_BUILT, False)


def test_a_selection_is_rebuilt_and_the_rest_stays():
    s, m = load("1hel.pdb"), pc.Setup(rebuild_side_chains="resid 10:20").load(LYSOZYME)
    numbers = s.residue_number[s.atom_residue].astype(int)
    rest = (numbers < 10) | (numbers > 20)
    assert np.array_equal(s.positions[rest], m.positions[rest])
    assert not np.allclose(s.positions[~rest], m.positions[~rest])


def test_sequences_are_read_from_files_and_letters(tmp_path):
    fasta = tmp_path / "design.fasta"
    fasta.write_text(">B chain\nFVNQ\nHLC\n>A\nGI--\n")
    assert pc.Setup(sequence=fasta).sequence == "B=FVNQHLC/A=GI--"
    fasta.write_text(">design, score=0.7\nGIV/FVN*\n")
    assert pc.Setup(sequence=fasta).sequence == "GIV/FVN" == pc.Setup(sequence="giv/fvn").sequence
    s = load("3i40.pdb")
    letters = {c: "".join(STANDARD[n] for n in s.residue_name[s.residue_chain == c]) for c in "AB"}
    same = pc.Setup(sequence=f"{letters['A']}/{letters['B']}").load(STRUCTURES / "3i40.pdb")
    assert np.array_equal(same.positions, s.positions)
    other = pc.Setup(sequence=f"B={letters['B'][:-1]}W").load(STRUCTURES / "3i40.pdb")
    assert other.residue_name.tolist() == [*s.residue_name[:-1].tolist(), "TRP"]
    pc.save(other, tmp_path / "other.cif")
    assert pc.load(tmp_path / "other.cif").fingerprint == other.fingerprint


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--sequence", "AAA"), "1 given, of -; its chains are A, B"),
        (("--sequence", "A=AAA"), "3 letters for chain A, which has 21 residues"),
        (("--sequence", "A=" + "B" * 21), "'B' at A:GLY1"),
        (("--sequence", "no.fasta"), "--sequence 'no.fasta': give a FASTA file"),
        (("--rebuild-side-chains", "resname ZZZ"), "selects no atom"),
        (("--rebuild-side-chains", "resname HOH", "--keep", "all"), "has no side chain"),
    ],
)
def test_what_cannot_be_put_on_a_backbone_is_refused(options, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert said in refusal_as_said("relax", STRUCTURES / "3i40.pdb", "-o", "out.pdb", *options)


def test_frames_get_their_side_chains_anew():
    """The trajectory has those of the file, which are taken off and built for each frame's backbone."""
    (done,) = pc.relax_frames(STRUCTURES / "5awl.pdb", sequence="AAAAAAAAAA", max_iterations=1)
    assert done.structure is not None and {*done.structure.residue_name.tolist()} == {"ALA"}
