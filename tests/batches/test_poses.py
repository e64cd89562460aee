"""Screening: poses of one SDF, of which some cannot be used, scored as they are and relaxed."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from fixtures.command_line import run
from fixtures.refusals import expect_refusal
from fixtures.samples import STRUCTURES

import protochain as pc
from protochain.ligands.sources import title_of
from protochain.relaxation.poses import COLUMNS
from protochain.validation.ligands import POSEBUSTERS

Chem = pytest.importorskip("rdkit.Chem")
AllChem = pytest.importorskip("rdkit.Chem.AllChem")

PROTEIN = STRUCTURES / "1l2y.pdb"
ESTER = "C[C@H](O)[C@@H](N)C(=O)OC"
BAD = {"broken": "no SDF file that can be read", "flat": "no coordinates in space", "boronic": "B1"}
"""Titles of records that cannot be used, and the reasons."""


def posed(smiles, title, away):
    """A record of a molecule whose nearest atom is beyond the outermost of the sample protein."""
    molecule = Chem.AddHs(Chem.MolFromSmiles(smiles))
    assert AllChem.EmbedMolecule(molecule, randomSeed=7) == 0
    x, protein = molecule.GetConformer().GetPositions(), 10.0 * pc.load(PROTEIN).positions
    x += [protein[:, 0].max() + 10.0 * away - x[:, 0].min(), *(protein.mean(0) - x.mean(0))[1:]]
    molecule.GetConformer().SetPositions(x)
    molecule.SetProp("_Name", title)
    return f"{Chem.MolToMolBlock(molecule)}>  <score>\n{-away}\n\n$$$$\n"


@pytest.fixture(scope="module")
def poses(tmp_path_factory):
    flat = Chem.MolFromSmiles("CCO")
    AllChem.Compute2DCoords(flat)
    flat.SetProp("_Name", "flat")
    path = tmp_path_factory.mktemp("poses") / "poses.sdf"
    broken = "broken\n  x\n\n none\nM  END\n$$$$\n"
    records = [
        posed(ESTER, "first of two", 0.2),
        broken,
        posed("CCO", "alcohol", 0.25),
        f"{Chem.MolToMolBlock(flat)}$$$$\n",
        posed("OB(O)c1ccccc1", "boronic", 0.2),
        posed(ESTER, "clashing", -0.15),
    ]
    path.write_text("".join(records))
    return path


GOOD = {"first of two": 1, "alcohol": 3, "clashing": 6}
"""Records by title."""


@pytest.fixture(scope="module")
def scored(poses, tmp_path_factory):
    """Outputs of a run that moves no atom, and its exit status."""
    folder = tmp_path_factory.mktemp("scored")
    given = ("relax", PROTEIN, "--ligand-poses", poses, "--score-only", "--workers", 1)
    outputs = ("-o", folder / "out", "--ligand-out", folder / "l.sdf", "--protein-out", folder / "p.pdb")
    return folder, run(*given, *outputs)


def test_a_bad_record_is_a_row_with_its_title_and_stops_no_other(scored):
    folder, status = scored
    table = pd.read_csv(folder / "out" / "poses.csv")
    assert status == 4
    assert table["structure"].tolist() == [f"1l2y.poses_{k}" for k in range(1, 7)]
    assert table["title"].tolist() == ["first of two", "broken", "alcohol", "flat", "boronic", "clashing"]
    for row in table.itertuples():
        reason = BAD.get(row.title)
        assert row.status == ("refused" if reason else "measured")
        if reason:
            number = row.structure.rpartition("_")[2]
            assert row.message.startswith(f"{row.title}: ") and f"poses.sdf#{number}: " in row.message
            assert reason in row.message and "; " in row.message and "\n" not in row.message


def test_scores_are_of_the_poses_as_they_are(scored, poses):
    table = pd.read_csv(scored[0] / "out" / "poses.csv").set_index("title")
    for title, number in GOOD.items():
        s = pc.load(PROTEIN, ligands=f"{poses}#{number}")
        (ligand,), row = pc.validate(s).ligands, table.loc[title]
        apart = pc.score_interface(s, "A", "B").scores["energy_kj_mol"]
        for when in ("start", "end"):
            assert row[f"interaction_energy_{when}_kj_mol"] == pytest.approx(apart, rel=1e-9)
            assert row[f"strain_{when}_kj_mol"] == pytest.approx(ligand.strain_kj_mol, rel=1e-6)
            assert row[f"clashes_{when}"] == ligand.clashes
        assert row["rmsd_angstrom"] == 0.0
        assert row["valid"] == (title != "clashing") and (ligand.clashes > 0) == (title == "clashing")


def test_records_keep_title_fields_order_atoms_and_bonds(scored, poses):
    before = {m.GetProp("_Name"): m for m in Chem.SDMolSupplier(str(poses), removeHs=False) if m}
    after = list(Chem.SDMolSupplier(str(scored[0] / "l.sdf"), removeHs=False))
    assert [molecule.GetProp("_Name") for molecule in after] == list(GOOD)
    for molecule in after:
        source = before[molecule.GetProp("_Name")]
        n = source.GetNumAtoms()  # A proton that is added for the pH comes last.
        assert molecule.GetProp("score") == source.GetProp("score")
        elements = [[atom.GetSymbol() for atom in m.GetAtoms()][:n] for m in (molecule, source)]
        assert elements[0] == elements[1]
        x = [m.GetConformer().GetPositions()[:n] for m in (molecule, source)]
        np.testing.assert_allclose(*x, atol=2e-4)
        bonds = [
            {(b.GetBeginAtomIdx(), b.GetEndAtomIdx(), str(b.GetBondType())) for b in m.GetBonds()}
            for m in (molecule, source)
        ]
        assert bonds[1] <= bonds[0]


def test_the_protein_alone_is_one_model_if_it_does_not_move(scored):
    alone, whole = pc.load(scored[0] / "p.pdb"), pc.load(PROTEIN)
    assert not alone.ligands and "LIG" not in (scored[0] / "p.pdb").read_text()
    np.testing.assert_allclose(alone.positions, whole.positions, atol=1e-4)
    assert "MODEL" not in (scored[0] / "p.pdb").read_text()


def test_relaxed_poses_and_their_proteins_are_written(poses, tmp_path, capsys):
    folder, proteins = tmp_path / "out", tmp_path / "p.cif"
    given = ("relax", PROTEIN, "--ligands", poses, "-o", folder, "--max-iterations", 8, "--workers", 1)
    assert run(*given, "--posebusters", "--protein-out", proteins) == 4
    said = capsys.readouterr().out
    table = pd.read_csv(folder / "poses.csv")
    relaxed = pd.read_csv(folder / "relaxed.csv")
    assert [*table] == ["structure", "status", "message", *(name.removeprefix("pose_") for name in COLUMNS)]
    assert table["rmsd_angstrom"].to_numpy() == pytest.approx(relaxed["ligand_rmsd_angstrom"], nan_ok=True)
    assert {*table["status"]} - {"refused"}
    n = int(table["valid"].eq(other=True).sum())
    assert f"{n} of 6 poses {'is' if n == 1 else 'are'} valid: PoseBusters" in said
    for row in table.itertuples():
        if row.status == "refused":
            continue
        end = pc.load(folder / relaxed.loc[row.Index, "output"])
        expected = pc.validate(end, posebusters=True).ligands[0].posebusters
        # The file has three decimals.
        differing = [test for test in POSEBUSTERS if table.loc[row.Index, test] != expected[test]]
        assert tuple(expected) == POSEBUSTERS and len(differing) <= 1
        assert row.valid == table.loc[row.Index, list(POSEBUSTERS)].all()
        if row.title == "clashing":
            assert row.interaction_energy_end_kj_mol < row.interaction_energy_start_kj_mol
    for model, number in enumerate(GOOD.values(), 1):
        alone = pc.load(proteins, model=model)
        complex_ = pc.load(folder / f"1l2y.poses_{number}.relaxed.pdb")
        np.testing.assert_allclose(alone.positions, complex_.positions[: alone.n_atoms], atol=1e-4)


def test_one_pose_is_scored_without_moving_an_atom(poses, tmp_path):
    s = pc.load(PROTEIN, ligands=f"{poses}#6")
    r = pc.relax(s, score_only=True)
    np.testing.assert_array_equal(r.x, s.positions)
    assert str(r.status) == "measured" and r.is_usable
    assert r.energy_end == r.energy_start == pytest.approx(pc.energy(s)(s.positions)[0], rel=1e-12)
    out, alone = tmp_path / "o.pdb", tmp_path / "p.pdb"
    # The name of the file may be written in several ways.
    pose = f"{poses.parent}/./{poses.name}#1"
    given = ("relax", PROTEIN, "--ligands", pose, "--score-only", "-o", out, "--protein-out", alone)
    assert run(*given) == 0
    atoms = [
        [line[:54] for line in path.read_text().splitlines() if line.startswith("ATOM")]
        for path in (out, alone)
    ]
    assert atoms[0] == atoms[1] and "LIG" in out.read_text() and "LIG" not in alone.read_text()
    with expect_refusal("force", match=r"p\.pdb.*exists"):
        run(*given)


@pytest.mark.parametrize(
    "given, said",
    [
        (("--protein-out", "p.pdb"), "protein_out requires"),
        (("--score-only", "--repack"), "score_only.*remove"),
    ],
)
def test_options_without_effect_are_refused(tmp_path, monkeypatch, given, said):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(pc.ProtochainError, match=said):
        run("relax", PROTEIN, *given)
    assert not list(Path().iterdir())


@pytest.mark.parametrize("is_first", [True, False])
def test_a_row_is_of_the_pose_not_of_a_ligand_added_to_all(poses, tmp_path, is_first):
    both, same = tmp_path / "both.sdf", tmp_path / "same.sdf"
    both.write_text("$$$$\n".join(poses.read_text().split("$$$$\n")[:2]) + "$$$$\n")
    same.write_text(posed("CCN", "in all", 1.2))
    files = (same, both) if is_first else (both, same)
    given = ("relax", PROTEIN, "--ligands", files[0], "--ligands", files[1], "--score-only", "--workers", 1)
    assert run(*given, "-o", tmp_path / "out") == 4
    table = pd.read_csv(tmp_path / "out" / "poses.csv")
    assert table["title"].tolist() == ["first of two", "broken"]
    assert table["message"][1].startswith("broken: ")
    s = pc.load(PROTEIN, ligands=[same, f"{both}#1"])
    pose = [ligand for ligand in s.ligands if ligand.ligand.molecule.source == f"{both}#1"]
    residue = s.residue(int(s.atom_residue[pose[0].atoms[0]]))
    expected = pc.validate(s).ligands[[*s.ligands].index(pose[0])].strain_kj_mol
    assert (table["chain"][0], str(int(table["residue"][0]))) == (residue.chain, residue.number)
    assert table["strain_start_kj_mol"][0] == pytest.approx(expected, rel=1e-6)


def test_a_folder_without_a_usable_pose_has_no_proteins(poses, tmp_path, capsys):
    bad = tmp_path / "bad.sdf"
    bad.write_text("".join(f"{block}$$$$\n" for block in poses.read_text().split("$$$$\n")[1:5:2]))
    given = ("relax", PROTEIN, "--ligands", bad, "--score-only", "--workers", 1, "-o", tmp_path / "out")
    assert run(*given, "--protein-out", tmp_path / "p.pdb") == 2
    assert not (tmp_path / "p.pdb").exists() and "p.pdb" not in capsys.readouterr().out


def test_records_end_at_lines_that_begin_with_the_signs(poses, tmp_path):
    path = tmp_path / "trailing.sdf"
    path.write_text(poses.read_text().replace("$$$$", "$$$$  "))
    for title, number in GOOD.items():
        x = [pc.load(PROTEIN, ligands=f"{file}#{number}").positions for file in (path, poses)]
        np.testing.assert_array_equal(*x)
        assert title_of(f"{path}#{number}") == title


@pytest.mark.parametrize("name", ["missing", "large", "second"])
def test_files_of_poses_that_cannot_be_used_are_named(poses, tmp_path, name):
    path = tmp_path / f"{name}.sdf"
    if name == "large":
        with path.open("wb") as file:
            file.truncate(10_000_001)
    elif name == "second":
        path.write_text(poses.read_text())
    further = ("--ligands", poses) if name == "second" else ()
    said = {"missing": "cannot be read", "large": "too large", "second": "has several poses"}[name]
    with pytest.raises(pc.ProtochainError, match=rf"{name}\.sdf: .*{said}.*; "):
        run("relax", PROTEIN, *further, "--ligands", path, "--workers", 1, "-o", tmp_path / "out")
    assert not (tmp_path / "out" / "relaxed.csv").exists()
