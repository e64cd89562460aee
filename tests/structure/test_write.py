"""Files of structures, to the letter: a ring of three residues, a disulfide and a water, made by hand."""

from dataclasses import replace

import gemmi
import numpy as np
import pytest
from fixtures.molecules import WHERE, ring
from fixtures.repairs import noted
from fixtures.samples import STRUCTURES

import protochain as pc
from protochain.structure.molecule.header import read_header
from protochain.structure.write import as_text, check_fits, check_format, common_suffix

RING_PDB = """\
SSBOND   1 CYS A    1    CYS A    3B                         1555   1555  2.12  
LINK         N   CYS A   1                 C   CYS A   3B    1555   1555  2.19  
ATOM      1  N   CYS A   1       0.000   0.000  -0.200  1.00  0.50           N  
ATOM      2  CA  CYS A   1       0.000   0.100  -0.200  1.00  1.50           C  
ATOM      3  C   CYS A   1       0.000   0.200  -0.200  1.00  2.50           C  
ATOM      4  SG  CYS A   1       0.000   0.300  -0.200  1.00  3.50           S  
ATOM      5  N   GLY A   2       1.000   0.400  -0.200  1.00  4.50           N  
ATOM      6  CA  GLY A   2       1.000   0.500  -0.200  1.00  5.50           C  
ATOM      7  C   GLY A   2       1.000   0.600  -0.200  1.00  6.50           C  
ATOM      8  N   CYS A   3B      2.000   0.700  -0.200  1.00  7.50           N  
ATOM      9  CA  CYS A   3B      2.000   0.800  -0.200  1.00  8.50           C  
ATOM     10  C   CYS A   3B      2.000   0.900  -0.200  1.00  9.50           C  
ATOM     11  SG  CYS A   3B      2.000   1.000  -0.200  1.00 10.50           S  
TER      12      CYS A   3B                                                     
HETATM   13  O   HOH     4       3.000   1.100  -0.200  1.00 11.50           O  
HETATM   14  H1  HOH     4       3.000   1.200  -0.200  1.00 12.50           H  
HETATM   15  H2  HOH     4       3.000   1.300  -0.200  1.00 13.50           H  
CONECT    1   10                                                                
CONECT    4   11                                                                
CONECT   10    1                                                                
CONECT   11    4                                                                
END                                                                             
"""  # noqa: W291


def test_a_pdb_file_has_its_remarks_links_and_atoms_in_their_columns_and_an_end():
    assert as_text(ring(), ".PDB") == RING_PDB
    remarks = ["one", "", 68 * "x", 68 * "y" + "zz", " ".join(20 * ["word"])]
    expected = ["one", "", 68 * "x", 68 * "y", "  zz", " ".join(13 * ["word"]), "  " + " ".join(7 * ["word"])]
    assert as_text(ring(), ".ent", remarks) == "".join(f"REMARK   3 {line}\n" for line in expected) + RING_PDB
    repaired = replace(ring(), repairs=(noted("two"), noted("three")))
    head = f"REMARK   3 one\nREMARK   3 {noted('two')}\nREMARK   3 {noted('three')}\n"
    assert as_text(repaired, ".pdb", ["one"]) == head + RING_PDB
    half = as_text(replace(ring(), occupancy=np.where(np.arange(14) == 5, 0.5, 1.0)), ".pdb")
    assert half == RING_PDB.replace("  1.00  5.50 ", "  0.50  5.50 ") != RING_PDB
    lighter = as_text(ring(), ".pdb", hydrogens=False)
    assert lighter == RING_PDB.replace(RING_PDB[RING_PDB.index("HETATM   14") : RING_PDB.index("CONECT")], "")


def test_an_mmcif_file_has_its_remarks_entities_links_and_atoms():
    text = as_text(replace(ring(), repairs=(noted("a repair"),)), ".cif", ["one", "it's two", ""])
    # The mark of a whole file of the archive.
    assert text.endswith("\n#\n") and text.count("\n#\n") > 5
    block = gemmi.cif.read_string(text).sole_block()
    assert block.name == "ring"

    def rows(category, *names):
        return [[gemmi.cif.as_string(cell) for cell in row] for row in block.find(f"_{category}.", names)]

    assert rows("protochain_provenance", "ordinal", "text") == [["1", "one"], ["2", "it's two"], ["3", ""]]
    assert rows("protochain_repair", "ordinal", "text") == [["1", str(noted("a repair"))]]
    assert rows("entity", "id", "type") == [["A", "polymer"], ["x1", "water"]]
    assert rows("struct_asym", "id", "entity_id") == [["A", "A"], ["x1", "x1"]]
    sequence = rows("entity_poly_seq", "entity_id", "num", "mon_id")
    assert sequence == [["A", str(k), name] for k, (name, _, _) in enumerate(WHERE, 1)]
    links = rows(
        "struct_conn", "id", "conn_type_id", "ptnr1_auth_asym_id", "ptnr1_auth_seq_id", "ptnr1_label_atom_id",
        "ptnr2_auth_seq_id", "pdbx_ptnr2_PDB_ins_code", "ptnr2_label_atom_id",
    )  # fmt: skip
    assert links == [
        ["covale1", "covale", "A", "1", "N", "3", "B", "C"],
        ["disulf2", "disulf", "A", "1", "SG", "3", "B", "SG"],
    ]
    atoms = rows(
        "atom_site", "group_PDB", "type_symbol", "label_atom_id", "label_comp_id", "label_asym_id",
        "auth_asym_id", "auth_seq_id", "Cartn_x", "Cartn_y", "B_iso_or_equiv",
        "pdbx_PDB_model_num",
    )  # fmt: skip
    assert atoms[3] == ["ATOM", "S", "SG", "CYS", "A", "A", "1", "0", "0.3", "3.5", "1"]
    assert atoms[-1] == ["HETATM", "H", "H2", "HOH", "x1", "", "4", "3", "1.3", "13.5", "1"]
    assert len(atoms) == 14 and "_cell." not in text
    crystal = gemmi.Structure()
    crystal.add_model(gemmi.Model(1))
    crystal.cell.set(20.0, 30.0, 40.0, 90.0, 90.0, 90.0)
    celled = as_text(replace(ring(), header=read_header(crystal)), ".cif")
    assert celled.count("_cell.length_a") == 1 and "_cell.length_b 30\n" in celled


@pytest.mark.parametrize(
    "record", ["MODRES XXXX ALA A    \t    \t  \t", "SEQRES   1 A12,34  ALA GLY 12,34 XXX"]
)
def test_a_header_without_a_number_or_a_name_is_read_and_written(record, tmp_path):
    path = tmp_path / "in.pdb"
    path.write_text(f"{record}\n{(STRUCTURES / 'ala10.pdb').read_text()}", encoding="utf-8")
    structure = pc.load(path)
    for suffix in (".cif", ".pdb"):
        (tmp_path / f"out{suffix}").write_text(as_text(structure, suffix))
        assert pc.load(tmp_path / f"out{suffix}").fingerprint == structure.fingerprint


def test_only_known_suffixes_of_any_case_are_written(tmp_path):
    for name in ("a.pdb", "a.ENT", "a.cif", "a.mmCIF", "a.PdbX"):
        check_format(tmp_path / name)
        pc.save(ring(), tmp_path / name, ["a remark"])
        assert (tmp_path / name).read_text() == as_text(ring(), (tmp_path / name).suffix, ["a remark"])
    with pytest.raises(pc.ProtochainError) as refused:
        pc.save(ring(), tmp_path / "a.xyz")
    assert str(refused.value) == (
        f"{tmp_path}/a.xyz: unknown suffix '.xyz'; use .pdb or .ent or .cif or .mmcif or .pdbx"
    )
    with pytest.raises(pc.ProtochainError, match=r"a\.pdb: no models"):
        pc.save([], tmp_path / "a.pdb")
    with pytest.raises(pc.ProtochainError, match=r"a\.pdb\.zip: unknown suffix '\.zip'"):
        pc.save(ring(), tmp_path / "a.pdb.zip")
    assert not list(tmp_path.glob("a.xyz*")) + list(tmp_path.glob("*.zip*"))


def moved(angstrom, axis=0, atom=1):
    """The ring with one coordinate elsewhere."""
    x = ring().positions.copy()
    x[atom, axis] = angstrom / 10.0
    assert 10.0 * x[atom, axis] == angstrom
    return ring(x)


@pytest.mark.parametrize("angstrom", [-999.999, 9999.999])
def test_the_outermost_coordinates_that_fit_the_columns_are_written(angstrom, tmp_path):
    check_fits(moved(angstrom), tmp_path / "x.PDB")
    assert f"{angstrom:8.3f}" in as_text(moved(angstrom), ".pdb")


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("angstrom", [-1000.0, 10000.0])
def test_coordinates_further_out_are_refused_with_the_atom(angstrom, axis, tmp_path):
    with pytest.raises(pc.ProtochainError) as refused:
        pc.save(moved(angstrom, axis, 10), tmp_path / "x.pdb")
    assert str(refused.value) == (
        f"{tmp_path}/x.pdb: the coordinates of atom SG of A:CYS3B do not fit a PDB file; write .cif"
    )
    assert list(tmp_path.iterdir()) == []
    pc.save(moved(angstrom, axis, 10), tmp_path / "x.mmcif")


@pytest.mark.parametrize("name", [";", "#", "'", "_", "$"])
@pytest.mark.parametrize("suffix", [".pdb", ".cif"])
def test_chains_and_residues_may_be_called_by_any_letter(name, suffix, tmp_path):
    """Also by those that begin a text, a comment, a quotation or a name in mmCIF."""
    made = tmp_path / "given.pdb"
    text = (STRUCTURES / "ala10.pdb").read_text().splitlines(keepends=True)
    lines = [f"{line[:21]}{name}{line[22:]}" for line in text if line[:4] == "ATOM"]
    polymer = [f"SEQRES   1 {name}   11  ALA ALA ALA ALA ALA ALA ALA ALA ALA ALA   {name}\n"]
    made.write_text("".join([*polymer, *lines, "END\n"]))
    pc.save(pc.load(made), tmp_path / f"written{suffix}")
    again = pc.load(tmp_path / f"written{suffix}")
    assert {*again.residue_chain.tolist()} == {name} and again.n_residues == 10


def test_structures_share_the_suffix_that_fits_all():
    assert common_suffix([]) == common_suffix([ring(), ring(chain_id="B")]) == ".pdb"
    assert common_suffix([ring(), ring(chain_id="AB")]) == common_suffix([moved(10000.0)]) == ".cif"


def test_label_ids_of_absent_residues_are_refused():
    """As of a structure made in Python: rows of the header would get the ids of other residues."""
    with pytest.raises(ValueError, match="shorter"):
        as_text(replace(ring(), residue_label=(("A", 1),) * 5), ".cif")
