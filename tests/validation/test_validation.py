"""The door of validation: its numbers, its table, its words, and the command."""

import copy
import gzip
import io
import pickle

import numpy as np
import pandas as pd
import pytest
from fixtures.molecules import molecule, shaken, turned
from fixtures.samples import STRUCTURES, load, shared
from openmm import unit

import protochain as pc
from protochain.cli import app
from protochain.validation import LIKENESS, MEASURES, Validation, measures
from protochain.validation.findings import Findings


@pytest.fixture(scope="module")
def spoilt():
    """Trp-cage with a cis peptide bond before residue 6, a C-beta off its place and a hand turned."""
    s = load("1l2y.pdb")
    at = {(int(s.atom_residue[k]), str(s.atom_name[k])): k for k in range(s.n_atoms)}
    x = turned(s, 5, (at[4, "C"], at[5, "N"]), 178.0).copy()
    x[at[13, "CB"]] += [0.0, 0.06, 0.0]
    # C-beta and the hydrogen of C-alpha in each other's place.
    x[[at[7, "CB"], at[7, "HA"]]] = x[[at[7, "HA"], at[7, "CB"]]]
    return s.with_positions(x)


def test_measures_are_numbers_under_their_keys(spoilt):
    found = measures(spoilt)
    assert list(found) == list(MEASURES)
    for key, measure in MEASURES.items():
        assert type(found[key]) is (int if measure.whole else float), key
    clean = measures(load("1l2y.pdb"))
    assert {key for key in MEASURES if clean[key] == 0} >= {
        "violations", "ramachandran_outliers", "cis_peptides", "twisted_peptides", "inverted_stereocentres",
        "threaded_rings",
    }  # fmt: skip
    assert (found["cis_peptides"], found["inverted_stereocentres"], found["cbeta_outliers"]) == (1, 1, 2)
    # At other positions of the same structure, and of a file.
    assert measures(load("1l2y.pdb"), spoilt.positions) == found
    assert measures(load("1l2y.pdb"), spoilt.positions * unit.nanometer) == found
    assert measures(STRUCTURES / "1l2y.pdb") == clean
    assert measures(spoilt, np.full_like(spoilt.positions, np.nan)) == dict.fromkeys(MEASURES)
    with pytest.raises(pc.ProtochainError, match="x has shape"):
        measures(spoilt, spoilt.positions[1:])


def test_what_has_no_residue_to_measure_has_no_percentage():
    found = measures(pc.from_sequence("AG"))
    assert found["ramachandran_favoured_percent"] is None and found["ramachandran_outliers"] == 0
    assert set(measures(pc.load(shared("ala_dipeptide.pdb"))).values()) == {0, None}


def test_the_table_adds_up_to_the_numbers(spoilt):
    v = pc.validate(spoilt)
    t = v.residues
    assert (
        len(t) == 20 and t["residue"].tolist() == [str(k) for k in range(1, 21)] and set(t["chain"]) == {"A"}
    )
    assert {
        "violations": t["violation"].sum(), "ramachandran_outliers": (t["ramachandran"] == "outlier").sum(),
        "rotamer_outliers": t["rotamer_outlier"].sum(),
        "inverted_stereocentres": t["inverted_stereocentres"].sum(),
        "cbeta_outliers": (t["cbeta_deviation_angstrom"] >= 0.25).sum(),
        "cis_peptides": (t["peptide_bond"] == "cis").sum(),
        "twisted_peptides": (t["peptide_bond"] == "twisted").sum(),
        "threaded_rings": t["threaded_rings"].sum(), "cis_prolines": 0,
    }.items() <= dict(v.measures).items()  # fmt: skip
    favoured = (t["ramachandran"] == "favoured").sum() / (t["ramachandran"] != "").sum()
    assert v.measures["ramachandran_favoured_percent"] == pytest.approx(100.0 * favoured)
    found = Findings(spoilt, spoilt.positions)
    assert (t["bond_outliers"] > 0).sum() == len(np.unique(spoilt.atom_residue[found.strain.bonds]))
    pairs = spoilt.atom_residue[found.clashes.pairs]
    assert t["clashes"].sum() == sum(1 + (a != b) for a, b in pairs.tolist()) > 0
    assert t["peptide_bond"].tolist()[5] == "cis" and abs(t["omega_degrees"][5]) < 15.0
    assert np.isnan(t["phi_degrees"][0]) and t["rotamer"][9] == "" and t["name"][9] == "GLY"


def test_what_is_wrong_is_said_of_each_residue(spoilt):
    lines = pc.validate(spoilt).listing()
    of = {line.partition(": ")[0]: line for line in lines}
    assert len(of) == len(lines)
    assert "cis peptide bond before it (omega " in of["A:TRP6"]
    assert "CA inverted" in of["A:LYS8"]
    assert "C-beta 0." in of["A:SER14"]
    numbers = [int(place[5:]) for place in of]
    assert numbers == sorted(numbers)
    outliers = pc.validate(spoilt).residues.query("ramachandran == 'outlier'")["residue"].tolist()
    assert [place[5:] for place, line in of.items() if "Ramachandran outlier (phi " in line] == outliers
    assert pc.validate(pc.from_sequence("GG")).listing() == []


def test_settings_of_a_preparation_reach_it():
    assert pc.validate(STRUCTURES / "3i40.pdb", chains="A").record()["n_residues"] == 21


def test_the_result_of_a_run_is_validated_at_its_end(spoilt):
    v = pc.validate(spoilt, reference=load("1l2y.pdb"))
    assert list(v.measures) == [*MEASURES, *LIKENESS] and v.measures["lddt"] < 1.0
    assert v.residues["lddt"].between(0.0, 1.0).all()
    assert v.record()["n_residues"] == 20 and v.record()["heavy_atoms_added"] == 0 and v.added == ""
    r = pc.minimise(pc.build_chain(load("ala10.pdb")), method="lbfgs", max_evaluations=3)
    end = pc.validate(r, reference=r.chain)
    assert end.structure is not r.chain.structure and dict(end.measures).items() >= r.measures_end.items()
    assert end.measures["ca_rmsd_to_reference_angstrom"] == pytest.approx(r.ca_rmsd_angstrom, abs=1e-6)
    with pytest.raises(pc.ProtochainError, match="no residue matches"):
        pc.validate(molecule("CO", [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]]), reference=spoilt)


def test_a_validation_shows_itself_and_is_a_value(spoilt):
    v = pc.validate(spoilt)
    assert repr(v).startswith("<Validation of 1l2y: ") and "1 inverted stereocentres" in repr(v)
    assert repr(pc.validate(pc.from_sequence("GG"))).endswith(": nothing wrong>")
    html = v._repr_html_()
    assert html.startswith("<table><caption>Validation of 1l2y</caption>")
    assert all(f"<th>{measure.what}</th>".replace("'", "&#x27;") in html for measure in MEASURES.values())
    for again in (pickle.loads(pickle.dumps(v)), copy.deepcopy(v)):
        assert isinstance(again, Validation) and again.record() == v.record()
        assert again.residues.equals(v.residues) and again.listing() == v.listing()
    with pytest.raises(TypeError):
        v.measures["lddt"] = 1.0


def test_heavy_atoms_are_where_the_file_has_them_and_what_is_added_is_said():
    v = pc.validate(shared("trpcage_d9e_missing.pdb"))
    heavy = "5 heavy atoms added that the file lacks, in 1 residue"
    assert v.added == f"{heavy}; 6 hydrogens added at pH 7 (146 were in the file)"
    assert v.record()["heavy_atoms_added"] == 5
    assert v.residues.query("atoms_added > 0")["residue"].tolist() == ["9"]
    codes = pc.validate(shared("1orc_icode.pdb"), keep="none")
    assert {"56A", "56E"} <= set(codes.residues["residue"]) and len(codes.residues) == 64
    assert any(line.startswith("A:GLU56C: ") for line in codes.listing())


def test_ligands_are_no_residues_of_the_table():
    s = pc.load(shared("1ake_full.cif"), chains="A")
    assert s.kept.any()
    v = pc.validate(s)
    assert len(v.residues) == 214 and "AP5" not in set(v.residues["name"])


def run(*arguments):
    return app([str(each) for each in arguments], standalone_mode=False)


def test_the_command_measures_files_folders_and_patterns(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "models"
    folder.mkdir()
    text = (STRUCTURES / "1l2y.pdb").read_text()
    (folder / "a.pdb.gz").write_bytes(gzip.compress(text.encode()))
    pc.save(shaken(load("1l2y.pdb"), 0.02), tmp_path / "b.cif")
    (tmp_path / "bad.pdb").write_text("nothing\n")
    native = STRUCTURES / "1l2y.pdb"
    asked = ("validate", "models", "b*.cif", "bad.pdb", "--reference", native)
    assert run(*asked, "--csv", "t.csv", "--residues", "r.csv") == 4
    told = capsys.readouterr()
    assert len(told.err.splitlines()) == 1 and "bad.pdb: " in told.err
    assert max(map(len, told.out.splitlines()[:6])) <= 80
    table = pd.read_csv(tmp_path / "t.csv")
    assert table["file"].tolist() == ["models/a.pdb.gz", "b.cif", "bad.pdb"]
    assert {key: table[key][0] for key in MEASURES} == pytest.approx(measures(load("1l2y.pdb")))
    assert table["lddt"][0] == 1.0 and 0.8 < table["lddt"][1] < 1.0 and "bad.pdb: " in table["message"][2]
    # Lists are for the terminal and JSON, and counts stay whole beside a file without any.
    assert "findings" not in table
    texts = pd.read_csv(tmp_path / "t.csv", dtype=str)
    assert (
        texts["violations"][0] == str(measures(load("1l2y.pdb"))["violations"]) and texts["model"][0] == "1"
    )
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO((folder / "a.pdb.gz").read_bytes())))
    assert run("validate", "-", "b.cif", "--csv", "s.csv") == 0
    given = pd.read_csv(tmp_path / "s.csv").set_index("file")
    assert [*given.index] == ["b.cif", "standard input"]
    assert given.loc["standard input", [*MEASURES]].to_dict() == table.loc[0, [*MEASURES]].to_dict()
    (tmp_path / "s.csv").unlink()
    assert run("validate", "bad.pdb", "--csv", "bad.csv") == 2
    assert pd.read_csv(tmp_path / "bad.csv").columns.tolist() == ["file", "message"]
    (tmp_path / "bad.csv").unlink()
    rows = pd.read_csv(tmp_path / "r.csv")
    assert rows["file"].tolist() == ["models/a.pdb.gz"] * 20 + ["b.cif"] * 20
    assert rows["lddt"].notna().all() and rows["model"].tolist() == [1] * 40
    words = pc.validate(folder / "a.pdb.gz").listing()
    assert words and all(f"  {line}\n" in told.out for line in words)
    assert "more residues; --residues FILE lists all" in told.out
    assert {each.name for each in tmp_path.iterdir()} == {"b.cif", "bad.pdb", "models", "r.csv", "t.csv"}
    with pytest.raises(pc.ProtochainError, match="is the input"):
        run("validate", "models/a.pdb.gz", "b.cif", "--csv", "b.cif")
    with pytest.raises(pc.ProtochainError, match=r"none\.pdb: not found"):
        run("validate", "none.pdb")
