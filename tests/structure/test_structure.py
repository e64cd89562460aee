import gemmi
import numpy as np
import pytest
from fixtures.repairs import sentences, turned_amides
from fixtures.samples import STRUCTURES, load, shared

import protochain as pc
from protochain.core.arrays import dihedral
from protochain.core.units import ANGSTROM_PER_NM
from protochain.structure.preparation.prepare import read
from protochain.structure.write import as_text

OXYGEN_NM = 0.02
"""Of a carboxylate of ideal geometry, built on an experiment's three other atoms."""


def identities(path):
    """(chain, number, insertion code, residue name) in the order of the file's first model, by gemmi."""
    structure = gemmi.read_structure(str(path))
    return [
        (chain.name, str(residue.seqid.num), residue.seqid.icode.strip(), residue.name)
        for chain in structure[0]
        for residue in chain
        if gemmi.find_tabulated_residue(residue.name).is_amino_acid()
    ]


def own_identities(s):
    columns = (s.residue_chain, s.residue_number, s.residue_insertion_code, s.residue_name)
    return [tuple(map(str, row)) for row in zip(*columns, strict=True)]


def written(tmp_path, text, name="x.pdb"):
    path = tmp_path / name
    path.write_text(text)
    return path


def lines_of(name):
    return (STRUCTURES / name).read_text().splitlines(keepends=True)


def test_a_complete_file_is_taken_as_it_is():
    s = load("1l2y.pdb")
    assert s.repairs == () and dict(s.left_out) == {}
    original = gemmi.read_structure(str(STRUCTURES / "1l2y.pdb"))
    # Each hydrogen is put after its parent: compare by name, not by order.
    theirs = {
        (str(residue.seqid), atom.name): atom.pos.tolist() for residue in original[0][0] for atom in residue
    }
    for atom in range(s.n_atoms):
        key = (str(s.residue_number[s.atom_residue[atom]]), str(s.atom_name[atom]))
        assert np.allclose(ANGSTROM_PER_NM * s.positions[atom], theirs[key], atol=1e-9)


@pytest.mark.parametrize("name", ["1ubq.cif", "3i40.pdb"])
def test_heavy_atoms_stay_where_they_were(name):
    s = load(name)
    theirs = {}
    original = gemmi.read_structure(str(STRUCTURES / name))
    for chain in original[0]:
        for residue in chain:
            for atom in residue:
                theirs[chain.name, str(residue.seqid), atom.name] = atom.pos.tolist()
    turned = turned_amides(s)
    assert len(turned) == 2
    heavy = np.flatnonzero(s.atom_element != "H")
    for atom in heavy:
        r = s.atom_residue[atom]
        key = (s.residue_chain[r], f"{s.residue_number[r]}{s.residue_insertion_code[r]}", s.atom_name[atom])
        if tuple(map(str, key)) in turned:
            continue
        if tuple(map(str, key)) in theirs:
            there = theirs[tuple(map(str, key))]
            assert np.allclose(ANGSTROM_PER_NM * s.positions[atom], there, atol=1e-6)
        else:
            assert s.atom_name[atom] == "OXT"


def test_both_formats_of_one_entry_give_one_structure():
    pdb, cif = load("1ubq.pdb"), load("1ubq.cif")
    assert own_identities(pdb) == own_identities(cif)
    assert np.array_equal(pdb.atom_name, cif.atom_name)
    assert np.allclose(pdb.positions, cif.positions, atol=1e-7)


def test_insertion_codes_and_alternates_of_a_real_entry():
    path = shared("4zhl_icodes.cif")
    s = pc.load(path)
    assert own_identities(s) == identities(path)
    assert np.count_nonzero(s.residue_insertion_code != "") == 19


def test_a_terminal_oxygen_is_where_the_files_own_was(tmp_path):
    gone = [line for line in lines_of("1ubq.pdb") if line[12:16] != " OXT"]
    s, file = pc.load(written(tmp_path, "".join(gone))), load("1ubq.pdb")
    assert any(line.endswith("missing OXT added") for line in sentences(s))
    (ours,), (theirs,) = (np.flatnonzero(each.atom_name == "OXT") for each in (s, file))
    assert np.linalg.norm(s.positions[ours] - file.positions[theirs]) < OXYGEN_NM


def test_the_parts_of_a_broken_chain_are_different_molecules_in_mmcif(tmp_path):
    gone = [
        line for line in lines_of("1ubq.pdb") if not (line[:4] == "ATOM" and 30 <= int(line[22:26]) <= 33)
    ]
    text = as_text(pc.load(written(tmp_path, "".join(gone))), ".cif")
    columns = ["label_asym_id", "auth_asym_id", "auth_seq_id"]
    table = gemmi.cif.read_string(text).sole_block().find("_atom_site.", columns)
    residues = {
        (asym, chain): {int(row[2]) for row in table if (row[0], row[1]) == (asym, chain)}
        for asym, chain in {(row[0], row[1]) for row in table}
    }
    assert {chain for _, chain in residues} == {"A"} and len({asym for asym, _ in residues}) == 2
    assert sorted(residues.values(), key=min) == [set(range(1, 30)), set(range(34, 77))]


def test_deuterium_is_hydrogen_in_its_place():
    path = shared("5pti_bpti.cif")
    s = pc.load(path, keep=())
    assert set(s.atom_element) <= set("HCNOS")
    numbers = s.residue_number[s.atom_residue].tolist()
    there = dict(zip(zip(map(str, numbers), s.atom_name, strict=True), s.positions, strict=True))
    chain = gemmi.read_structure(str(path))[0][0]
    exchanged = [(str(r.seqid), atom) for r in chain for atom in r if r.name != "DOD" and atom.name == "D"]
    assert len(exchanged) > 20
    for number, atom in exchanged:
        assert there[number, "H"] == pytest.approx(np.array(atom.pos.tolist()) / 10.0, abs=1e-6)


@pytest.mark.parametrize("name", ["1ubq.pdb", "1ubq.cif"])
def test_a_cut_file_is_refused_wherever_it_was_cut(name, tmp_path):
    text = (STRUCTURES / name).read_text()
    atoms = text.index("\nATOM") if name.endswith("pdb") else text.index("\nATOM   1 ")
    end = text.rindex("\nATOM")
    rng = np.random.default_rng(0)
    for place in rng.integers(atoms + 1, end, size=20):
        with pytest.raises(pc.ProtochainError, match=r"cut short|cannot be read|missing") as refused:
            read(written(tmp_path, text[:place], name))
        assert "\n" not in str(refused.value)


def test_every_amino_acid_is_built_with_standard_geometry():
    sequence = "ACDEFGHIKLMNPQRSTVWY"
    s = pc.from_sequence(sequence.lower())
    from protochain.structure.molecule.residues import STANDARD

    assert "".join(STANDARD[name] for name in s.residue_name) == sequence
    assert set(s.residue_chain) == {"A"} and list(s.residue_number) == [str(i) for i in range(1, 21)]
    first, second = s.bonds.T
    lengths = np.linalg.norm(s.positions[first] - s.positions[second], axis=1)
    assert lengths.min() > 0.09 and lengths.max() < 0.19
    at = {
        (int(r), str(n)): s.positions[i]
        for i, (r, n) in enumerate(zip(s.atom_residue, s.atom_name, strict=True))
    }
    for r, name in enumerate(s.residue_name):
        if r:
            omega = [at[r - 1, "CA"], at[r - 1, "C"], at[r, "N"], at[r, "CA"]]
            assert abs(dihedral(*np.array(omega))) > np.radians(179)
        if name != "GLY":
            # L amino acids: N, C, CB run clockwise seen from the hydrogen on CA.
            n, c, cb, ha = (at[r, k] - at[r, "CA"] for k in ("N", "C", "CB", "HA"))
            assert np.dot(np.cross(n, c), cb) > 0 > np.dot(np.cross(n, c), ha)
