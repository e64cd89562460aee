"""What a file says beside its atoms goes on to the files written of it, where its residues are."""

from dataclasses import replace

import gemmi
import numpy as np
import pytest
from fixtures.molecules import ring
from fixtures.repairs import noted
from fixtures.samples import STRUCTURES, load
from openmm import app

import protochain as pc
from protochain.structure.write import as_text, common_suffix

TERMS = "Non-commercial use only: https://example.org/terms"


def block_of(text):
    return gemmi.cif.read_string(text).sole_block()


def rows(text, category, *items):
    """Values of a category, without quotes."""
    return [tuple(map(gemmi.cif.as_string, row)) for row in block_of(text).find(f"_{category}.", items)]


def predicted(name, tmp_path, change=lambda text: text):
    """A sample as a program that predicts structures writes it: confidence, terms, citation, components."""
    structure = load(name)
    block = block_of(change(as_text(structure, ".cif")))
    labels = dict.fromkeys(
        rows(block.as_string(), "atom_site", "label_asym_id", "label_seq_id", "label_comp_id")
    )
    asyms = list(dict.fromkeys(asym for asym, _, _ in labels))
    for category, columns in {
        "_ma_model_list.": {"ordinal_id": ["1", "2"], "model_id": ["1", None], "data_id": ["1", "1"]},
        "_ma_qa_metric.": {"id": ["1"], "mode": ["local"], "name": ["pLDDT"], "type": ["pLDDT"]},
        "_ma_qa_metric_local.": {
            "ordinal_id": [f"{k}" for k in range(1, len(labels) + 1)], "model_id": ["1"] * len(labels),
            "label_asym_id": [each[0] for each in labels], "label_seq_id": [each[1] for each in labels],
            "label_comp_id": [each[2] for each in labels], "metric_id": ["1"] * len(labels),
            "metric_value": [f"{50 + k}.5" for k in range(len(labels))],
        },
        "_ma_qa_metric_local_pairwise.": {
            "ordinal_id": ["1", "2"], "model_id": ["1", "1"],
            "label_asym_id_1": [asyms[0]] * 2, "label_seq_id_1": ["1", "1"],
            "label_asym_id_2": [asyms[0], asyms[-1]], "label_seq_id_2": ["2", "3"],
            "metric_id": ["1", "1"], "metric_value": ["3", "4"],
        },
        "_ma_target_entity_instance.": {"asym_id": asyms, "entity_id": asyms},
        "_pdbx_data_usage.": {"id": ["1"], "type": ["license"], "details": [TERMS]},
        "_citation.": {
            "id": ["primary"], "title": ["Its structure, predicted"], "journal_abbrev": ["Nature"],
            "year": ["2024"], "pdbx_database_id_DOI": ["10.1000/xyz"],
        },
        "_citation_author.": {"citation_id": ["primary"], "name": ["Doe, J."], "ordinal": ["1"]},
        "_software.": {"name": ["Predictor"], "pdbx_ordinal": ["1"], "version": ["3"]},
        "_chem_comp.": {
            "id": ["ALA", "GLY", "XYZ"], "type": [None, "peptide linking", "non-polymer"],
            "name": ["ALANINE", "GLYCINE", "GONE"],
        },
        "_chem_comp_bond.": {
            "comp_id": ["GLY", "XYZ"], "atom_id_1": ["N", "C1"], "atom_id_2": ["CA", "C2"],
            "value_order": ["sing", "doub"],
        },
    }.items():  # fmt: skip
        block.set_mmcif_category(category, columns)
    path = tmp_path / "predicted.cif"
    path.write_text(block.as_string())
    return path


def test_what_is_said_of_a_model_stays_where_its_residues_are(tmp_path):
    """Of insulin's chain B alone, nothing is said of chain A."""
    path = predicted("3i40.pdb", tmp_path)
    whole, part = (as_text(pc.load(path, chains=chains), ".cif") for chains in ((), "B"))
    local = ("ma_qa_metric_local", "label_asym_id", "label_seq_id", "label_comp_id", "metric_value")
    assert len(rows(whole, *local)) == load("3i40.pdb").n_residues
    kept = rows(part, *local)
    assert kept == [row for row in rows(whole, *local) if row[0] == "B"] and len(kept) == 30
    pairwise = ("ma_qa_metric_local_pairwise", "label_asym_id_1", "label_asym_id_2")
    assert rows(whole, *pairwise) == [("A", "A"), ("A", "B")] and rows(part, *pairwise) == []
    assert rows(part, "ma_target_entity_instance", "asym_id") == [("B",)]
    for text in (whole, part):
        assert rows(text, "pdbx_data_usage", "type", "details") == [("license", TERMS)]
        # What names no model is of all of them.
        assert rows(text, "ma_model_list", "ordinal_id") == [("1",), ("2",)]
        assert rows(text, "citation", "title", "year") == [("Its structure, predicted", "2024")]
        assert rows(text, "software", "name", "version") == [("Predictor", "3")]
        components = rows(text, "chem_comp", "id", "type", "name")
        there = {row[0] for row in rows(text, "atom_site", "label_comp_id")}
        assert [row[0] for row in components] == sorted(there)
        assert ("GLY", "peptide linking", "GLYCINE") in components
        assert all(kind == "L-peptide linking" for name, kind, _ in components if name != "GLY")
        # Those of others are of the structure.
        bonds = rows(text, "chem_comp_bond", "comp_id", "value_order")
        assert bonds[0] == ("GLY", "sing") and all(name != "GLY" for name, _ in bonds[1:])
        assert_no_row_twice(text)


def assert_no_row_twice(text):
    block = block_of(text)
    names = block.get_mmcif_category_names()
    assert len({*names}) == len(names)
    for name in names:
        found = list(zip(*block.get_mmcif_category(name, raw=True).values(), strict=True))
        assert len({*found}) == len(found), name
    for category, key in (
        ("chem_comp", "id"),
        ("entity", "id"),
        ("struct_asym", "id"),
        ("struct_conn", "id"),
    ):
        keys = rows(text, category, key)
        assert len({*keys}) == len(keys), category


def test_rows_of_a_residue_have_the_name_that_it_has_now(tmp_path):
    path = predicted("1ubq.pdb", tmp_path, lambda text: text.replace(" HIS ", " HIE "))
    text = as_text(pc.load(path), ".cif")
    named = dict(rows(text, "ma_qa_metric_local", "label_seq_id", "label_comp_id"))
    assert named["68"] == "HIS" and len(named) == 76


def test_citation_and_terms_go_to_pdb_files_and_back(tmp_path):
    first = as_text(pc.load(predicted("ala10.pdb", tmp_path)), ".pdb")
    assert "JRNL        AUTH   J.Doe\n" in first and "JRNL        TITL   Its structure, predicted\n" in first
    assert f"REMARK   1 license {TERMS}\n" in first
    (tmp_path / "a.pdb").write_text(first)
    again = pc.load(tmp_path / "a.pdb")
    assert as_text(again, ".pdb").split("\nREMARK   3")[0] == first.split("\nREMARK   3")[0]
    cif = as_text(again, ".cif")
    assert rows(cif, "citation", "title", "pdbx_database_id_DOI") == [
        ("Its structure, predicted", "10.1000/xyz")
    ]
    assert rows(cif, "database_PDB_remark", "id", "text") == [("1", f"license {TERMS}")]


def test_records_of_any_text_are_taken(tmp_path):
    """Quotes, control characters, a text that looks like mmCIF, a remark of another program."""
    odd = [
        "JRNL        TITL   data_x loop_ _a.b 'c \"d\" ; \x1b[31m\x07", "JRNL        AUTH   ,,", "JRNL",
        "REMARK   1", "REMARK   1 ;", "REMARK 980 of another program, some text that goes on to its end",
        "HETNAM", "HETNAM     ALA #$'_",
    ]  # fmt: skip
    (tmp_path / "a.pdb").write_text("\n".join([*odd, (STRUCTURES / "ala10.pdb").read_text()]))
    s = pc.load(tmp_path / "a.pdb")
    for suffix in (".pdb", ".cif"):
        pc.save(s, tmp_path / f"b{suffix}")
        assert pc.load(tmp_path / f"b{suffix}").fingerprint == s.fingerprint
    assert rows((tmp_path / "b.cif").read_text(), "citation", "title")[0][0].startswith(
        "data_x loop_ _a.b 'c"
    )


GLYCAN = """\
HETNAM     NAG 2-ACETAMIDO-2-DEOXY-BETA-D-GLUCOPYRANOSE-
HETNAM   2 NAG  AND MORE THAN GOES INTO TWO LINES OF A FILE OF THE
HETNAM   3 NAG  ARCHIVE
MODRES 1ABC ALA A    3  ALA  GLYCOSYLATION SITE
MODRES 1ABC SER A   99  SER  GONE
LINK         O4  NAG A 101                 C1  NAG A 102     1555   1555  1.44
LINK         O4  NAG A 101                 C1  NAG A 177     1555   1555  1.44
"""
SUGARS = """\
HETATM  901  C1  NAG A 101      30.000  30.000  30.000  1.00  0.00           C
HETATM  902  O4  NAG A 101      31.400  30.000  30.000  1.00  0.00           O1-
HETATM  903  C1  NAG A 102      31.900  31.350  30.000  1.00  0.00           C
HETATM  904  O5  NAG A 102      33.100  31.350  30.000  1.00  0.00           O
HETATM  905 MG    MG A 103      40.000  40.000  40.000  1.00  0.00          MG
CONECT  901  902
CONECT  902  901  903
CONECT  903  902  904  904
CONECT  904  903  903
"""


def test_records_of_ligands_stay_with_them(tmp_path):
    """Names, links, orders of bonds, modified residues and charges; not those of residues that are gone."""
    lines = (STRUCTURES / "ala10.pdb").read_text().splitlines(keepends=True)
    atoms = "".join(line for line in lines if line.startswith(("ATOM", "TER")))
    (tmp_path / "a.pdb").write_text(GLYCAN + atoms + SUGARS + "END\n")
    structure = pc.load(tmp_path / "a.pdb", keep="all")
    text = as_text(structure, ".pdb")
    assert [line.rstrip() for line in text.splitlines() if line.startswith("HETNAM")] == [
        "HETNAM     NAG 2-ACETAMIDO-2-DEOXY-BETA-D-GLUCOPYRANOSE-AND MORE THAN",
        "HETNAM   2 NAG GOES INTO TWO LINES OF A FILE OF THE ARCHIVE",
    ]
    assert [line[12:28] for line in text.splitlines() if line.startswith("MODRES")] == ["ALA A    3  ALA "]
    assert [line[12:57].split() for line in text.splitlines() if line.startswith("LINK")] == [
        ["O4", "NAG", "A", "101", "C1", "NAG", "A", "102"]
    ]
    charges = {line[12:16].strip(): line[78:80] for line in text.splitlines() if line.startswith("HETATM")}
    assert charges["O4"] == "1-" and charges["MG"] == "2+" and charges["C1"] == "  "
    serial = {
        (line[12:16].strip(), line[22:26].strip()): int(line[6:11])
        for line in text.splitlines() if line.startswith("HETATM")
    }  # fmt: skip
    c1, o5 = serial["C1", "102"], serial["O5", "102"]
    (drawn,) = (line for line in text.splitlines() if line.startswith(f"CONECT{c1:5}"))
    assert drawn.split().count(f"{o5}") == 2
    cif = as_text(structure, ".cif")
    names = "auth_seq_id", "auth_comp_id", "label_comp_id", "parent_comp_id", "details"
    assert rows(cif, "pdbx_struct_mod_residue", *names) == [("3", "ALA", "ALA", "ALA", "GLYCOSYLATION SITE")]
    assert rows(cif, "chem_comp", "id", "type")[-1:] == [("NAG", "saccharide")]
    assert ("NAG", "C1", "O5", "doub") in rows(
        cif, "chem_comp_bond", "comp_id", "atom_id_1", "atom_id_2", "value_order"
    )
    assert rows(cif, "struct_conn", "conn_type_id", "ptnr1_auth_seq_id", "ptnr2_auth_seq_id") == [
        ("covale", "101", "102")
    ]
    assert {
        row for row in rows(cif, "atom_site", "label_atom_id", "pdbx_formal_charge") if row[0] == "MG"
    } == {("MG", "2")}
    # The file of the file says the same.
    (tmp_path / "b.cif").write_text(cif)
    assert (
        as_text(pc.load(tmp_path / "b.cif", keep="all"), ".pdb").split("SEQRES")[-1].split("HET ")[-1]
        == (text.split("SEQRES")[-1].split("HET ")[-1])
    )
    assert_no_row_twice(cif)
    # Files say that a ligand has no place in the sequence, or that it is not known.
    asym = dict(rows(cif, "atom_site", "label_comp_id", "label_asym_id"))["NAG"]
    for unknown in (".", "?"):
        block = block_of(cif)
        said = {"label_asym_id": asym, "label_seq_id": unknown, "label_comp_id": "NAG", "metric_value": "5"}
        block.set_mmcif_category("_ma_qa_metric_local.", {k: [v] for k, v in said.items()}, raw=True)
        (tmp_path / "c.cif").write_text(block.as_string())
        again = as_text(pc.load(tmp_path / "c.cif", keep="all"), ".cif")
        assert rows(again, "ma_qa_metric_local", "label_comp_id", "metric_value") == [("NAG", "5")]


def named(**changes):
    """The ring with another name of a residue or an atom, or another number."""
    s, made, atoms = ring(), app.Topology(), []
    for chain in s.topology.chains():
        new = made.addChain(chain.id)
        for residue in chain.residues():
            first = residue.index == 0
            of = made.addResidue(
                changes.get("residue", residue.name) if first else residue.name, new,
                changes.get("number", residue.id) if first else residue.id, residue.insertionCode,
            )  # fmt: skip
            for atom in residue.atoms():
                name = changes.get("atom", atom.name) if atom.index == 0 else atom.name
                atoms.append(made.addAtom(name, atom.element, of, formalCharge=changes.get("charge")))
    for bond in s.topology.bonds():
        made.addBond(atoms[bond.atom1.index], atoms[bond.atom2.index])
    return replace(s, topology=made)


@pytest.mark.parametrize(
    ("changes", "what"),
    [
        ({"atom": "C10_1"}, "atom name 'C10_1'"),
        ({"number": "10000"}, "residue number '10000'"),
        ({"number": "-1000"}, "residue number '-1000'"),
        ({"number": "2147483641"}, "residue number '2147483641'"),
        ({"charge": 12}, "formal charge '12'"),
    ],
)
def test_what_a_pdb_file_would_cut_needs_mmcif(changes, what, tmp_path):
    structure = named(**changes)
    with pytest.raises(pc.ProtochainError) as refused:
        pc.save(structure, tmp_path / "x.pdb")
    assert str(refused.value) == f"{tmp_path}/x.pdb: {what} does not fit a PDB file; write .cif instead"
    assert not list(tmp_path.iterdir()) and common_suffix([structure]) == ".cif"
    pc.save(structure, tmp_path / "x.cif")
    value = next(iter(changes.values()))
    assert f"{value}" in (tmp_path / "x.cif").read_text()


@pytest.mark.parametrize(
    "places", [range(-3, 7), range(-50, -40), range(5, 25, 2), range(0, 10), [1, 2, 3, 4, 5, 6, 7, 8, 9, 900]]
)
def test_any_label_seq_id_is_read_and_the_sequence_is_that_of_the_residues(places, tmp_path):
    """Below 1 it would count from the sequence's end."""
    sequence = "MGKACDEFHI"
    block = block_of(as_text(pc.from_sequence(sequence), ".cif"))
    places = list(places)
    for category, item in (("_atom_site.", "label_seq_id"), ("_entity_poly_seq.", "num")):
        column = block.find_values(f"{category}{item}")
        for k in range(len(column)):
            if category == "_atom_site.":
                column[k] = f"{places[int(column[k]) - 1]}"
    (tmp_path / "a.cif").write_text(block.as_string())
    text = as_text(pc.load(tmp_path / "a.cif"), ".cif")
    listed = [
        gemmi.find_tabulated_residue(row[0]).one_letter_code
        for row in rows(text, "entity_poly_seq", "mon_id")
    ]
    assert "".join(listed) == sequence
    assert len(dict.fromkeys(rows(text, "atom_site", "label_seq_id"))) == 10


def test_every_model_has_its_own_coordinates_repairs_and_cis_peptides(tmp_path):
    first = replace(load("ala10.pdb"), repairs=(noted("of the first"),))
    second = replace(
        first.with_positions(first.positions + 0.1), repairs=(noted("of the second"),), model_number=2
    )
    # The amide plane turned over: omega from 180 to 0 is the next residue mirrored in that plane.
    x = second.positions.copy()
    at = {str(n): k for k, n in enumerate(first.atom_name) if first.atom_residue[k] == 4}
    after = np.flatnonzero(first.atom_residue > 4)
    axis = x[next(k for k in after if first.atom_name[k] == "N")] - x[at["C"]]
    axis /= np.linalg.norm(axis)
    arm = x[after] - x[at["C"]]
    along = (arm @ axis)[:, None] * axis
    x[after] = x[at["C"]] + 2 * along - arm
    second = second.with_positions(x)
    pdb, cif = (as_text([first, second], suffix) for suffix in (".pdb", ".cif"))
    for text in (pdb, cif):
        assert "of the first" in text and "of the second" in text
    read = gemmi.read_pdb_string(pdb)
    for k, each in enumerate((first, second)):
        found = np.array([place.atom.pos.tolist() for place in read[k].all()])
        assert np.abs(found - 10.0 * each.positions).max() < 0.001
    assert [each.model_num for each in read.cispeps] == [2]
    assert len(set(rows(cif, "atom_site", "pdbx_PDB_model_num"))) == 2
    assert rows(cif, "struct_mon_prot_cis", "pdbx_PDB_model_num") == [("2",)]
    # Models of one number are numbered, and all are without hydrogens.
    alike = as_text([first, replace(second, model_number=first.model_number)], ".cif", hydrogens=False)
    written = rows(alike, "atom_site", "pdbx_PDB_model_num", "type_symbol")
    assert {number for number, _ in written} == {"1", "2"} and "H" not in {element for _, element in written}
