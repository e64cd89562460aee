"""Missing atoms of the backbone, and atoms without a place, against those of a crystal."""

import gemmi
import numpy as np
import pytest
from fixtures.samples import STRUCTURES, load

import protochain as pc
from protochain.structure.formats.chain_splitting import separate_caps
from protochain.structure.molecule.repairs import Kind

LINES = [line for line in (STRUCTURES / "1ubq.pdb").read_text().splitlines() if line[:4] == "ATOM"]


def loaded(tmp_path, change, strict=False):
    path = tmp_path / "made.pdb"
    path.write_text("\n".join([*filter(None, map(change, LINES)), "END"]))
    return pc.load(path, strict=strict)


def is_atom(line, number, *names):
    return int(line[22:26]) == number and line[12:16].strip() in names


@pytest.mark.parametrize(("name", "number"), [("N", 19), ("CA", 45), ("C", 19)])
def test_one_atom_of_a_backbone_is_built_where_it_was(tmp_path, name, number):
    s = loaded(tmp_path, lambda line: None if is_atom(line, number, name) else line)
    whole = load("1ubq.pdb")
    assert s.n_chains == whole.n_chains == 1 and s.n_residues == 76
    (told,) = (r for r in s.repairs if r.kind is Kind.ATOMS_ADDED)
    assert told.facts["residue"].number == str(number) and told.facts["atoms"] == (name,)

    def place(structure):
        of = (structure.residue_number == str(number))[structure.atom_residue]
        (k,) = np.flatnonzero(of & (structure.atom_name == name))
        return k, structure.positions[k]

    (k, x), (_, expected) = place(s), place(whole)
    assert 10.0 * np.linalg.norm(x - expected) < 0.2 and s.built[k]
    with pytest.raises(pc.ProtochainError, match=f"atom {name} missing"):
        loaded(tmp_path, lambda line: None if is_atom(line, number, name) else line, strict=True)


@pytest.mark.parametrize("names", [("N", "CA"), ("CA", "C"), ("N", "C"), ("N", "CA", "C")])
def test_atoms_of_a_backbone_are_built_where_they_were(tmp_path, names):
    """Of each residue of 1ubq, 1hel and 4pti in turn all three are off by 0.06 angstrom, 0.38 at most."""
    whole = load("1ubq.pdb")
    for number in (10, 64):
        s = loaded(tmp_path, lambda line, n=number: None if is_atom(line, n, *names) else line)
        (told,) = (r for r in s.repairs if r.kind is Kind.ATOMS_ADDED)
        assert told.facts["atoms"] == names and s.n_chains == 1
        assert np.array_equal(s.atom_name, whole.atom_name)
        off = np.linalg.norm(s.positions - whole.positions, axis=1)[s.built]
        assert len(off) == len(names) and 10.0 * off.max() < 0.4


def test_a_residue_without_a_neighbour_to_build_from_is_left_out(tmp_path):
    for number, names in ((1, ("N",)), (76, ("C",)), (76, ("N", "CA", "C"))):
        s = loaded(tmp_path, lambda line, n=number, its=names: None if is_atom(line, n, *its) else line)
        assert [r.facts["residue"].number for r in s.repairs if r.kind is Kind.NO_BACKBONE] == [str(number)]
    # The residue after it is missing, so that no bonds of usual length close the gap.
    gap = loaded(
        tmp_path, lambda line: None if is_atom(line, 10, "N", "CA", "C") or line[22:26] == "  11" else line
    )
    assert [r.facts["residue"].number for r in gap.repairs if r.kind is Kind.NO_BACKBONE] == ["10"]


@pytest.mark.parametrize("place", ["origin", "CA", "far"])
def test_side_chains_at_the_origin_upon_ca_or_far_away_are_missing(tmp_path, place):
    side = ("CD1", "CD2", "CE1", "CE2", "CZ")
    (alpha,) = (line[30:54] for line in LINES if is_atom(line, 45, "CA"))
    at = {"origin": "   0.000   0.000   0.000", "CA": alpha, "far": "  70.000-510.000  90.000"}[place]
    s = loaded(tmp_path, lambda line: line[:30] + at + line[54:] if is_atom(line, 45, *side) else line)
    bare = loaded(tmp_path, lambda line: None if is_atom(line, 45, *side) else line)
    assert np.array_equal(s.positions, bare.positions) and np.array_equal(s.atom_name, bare.atom_name)
    (told,) = (r for r in s.repairs if r.kind is Kind.NO_PLACE)
    assert {*told.facts["atoms"]} == {*side} and told.facts["residue"].number == "45"


def test_an_atom_that_happens_to_be_at_the_origin_stays(tmp_path):
    (x,) = (
        np.array([float(line[i : i + 8]) for i in (30, 38, 46)]) for line in LINES if is_atom(line, 45, "CZ")
    )

    def moved(line):
        at = np.array([float(line[i : i + 8]) for i in (30, 38, 46)]) - x
        return line[:30] + "{:8.3f}{:8.3f}{:8.3f}".format(*at) + line[54:]

    assert not [r for r in loaded(tmp_path, moved).repairs if r.kind is Kind.NO_PLACE]


def test_caps_of_charmm_within_residues_are_residues_of_their_own():
    names = ("CAY", "CY", "OY", "HY1", "N", "HN", "CA", "C", "O", "NT", "HNT", "CAT", "HT1")
    lines = (
        f"ATOM  {k:5d}  {name:<3s} ALA A   5    {0.4 * k:8.3f}   0.000   0.000"
        for k, name in enumerate(names)
    )
    structure = gemmi.read_pdb_string("\n".join([*lines, "END\n"]))
    separate_caps(structure)
    found = [
        (residue.name, residue.seqid.num, [atom.name for atom in residue]) for residue in structure[0][0]
    ]
    assert found == [
        ("ACE", 4, ["CH3", "C", "O", "HY1"]),
        ("ALA", 5, ["N", "HN", "CA", "C", "O"]),
        ("NME", 6, ["N", "HNT", "CH3", "HT1"]),
    ]
