"""What is found of ligands in their places: strain, contacts, clashes, stereo, PoseBusters' tests."""

import json
import re

import numpy as np
import pandas as pd
import pytest
from fixtures.command_line import run
from fixtures.samples import STRUCTURES, shared
from fixtures.tolerances import STRAIN

import protochain as pc
from protochain.cli.relaxing import _posebusters
from protochain.ligands.energy import Function, nearest_minimum, strain
from protochain.ligands.molecule import to_rdkit
from protochain.validation.ligands import ligand_motion

Chem = pytest.importorskip("rdkit.Chem")
AllChem = pytest.importorskip("rdkit.Chem.AllChem")

PROTEIN = STRUCTURES / "1l2y.pdb"
SMILES = "C[C@H](O)[C@@H](N)C(=O)OC"
SDF = sorted(STRUCTURES.glob("*.sdf"))
LONG_STEPS = "1L2S_STC.sdf", "1P62_GEO.sdf"
"""Shared ligands that a first step of 1 nm tore apart. Strains were 23 kJ/mol too high, and 0 for 151."""


def posed(tmp_path, smiles=SMILES, away=0.3):
    """A file of a molecule whose nearest atom is beyond the outermost of the sample protein."""
    made = Chem.AddHs(Chem.MolFromSmiles(smiles))
    assert AllChem.EmbedMolecule(made, randomSeed=7) == 0
    x, protein = made.GetConformer().GetPositions(), 10.0 * pc.load(PROTEIN).positions
    x += [protein[:, 0].max() + 10.0 * away - x[:, 0].min(), *(protein.mean(0) - x.mean(0))[1:]]
    made.GetConformer().SetPositions(x)
    Chem.MolToMolFile(made, str(tmp_path / "pose.sdf"))
    return tmp_path / "pose.sdf"


@pytest.mark.parametrize("path", SDF, ids=lambda path: path.stem)
def test_the_energy_of_strain_is_that_of_the_terms_and_its_gradient_the_derivative(path):
    ligand = pc.ligand(path)
    x, rng = ligand.molecule.positions, np.random.default_rng(4)
    x = x + 0.005 * rng.standard_normal(x.shape)
    function = Function(ligand.parameters)
    energies, gradient = function(x)
    terms = ligand.terms(x)
    assert sum(energies.values()) == pytest.approx(sum(terms.values()) - terms["coulomb"], rel=1e-12)
    way, h = rng.standard_normal(x.shape), 1e-6
    up, down = (sum(function(x + sign * h * way)[0].values()) for sign in (1, -1))
    assert np.sum(gradient * way) == pytest.approx((up - down) / (2 * h), rel=1e-6)


@pytest.mark.parametrize("path", SDF, ids=lambda path: path.stem)
def test_strain_is_that_of_heavy_atoms_and_none_at_the_minimum(path):
    ligand = pc.ligand(path)
    parameters, x, z = ligand.parameters, np.array(ligand.molecule.positions), ligand.molecule.elements
    found = strain(parameters, x, z)
    assert found > 1.0
    shaken = x.copy()
    shaken[z == 1] += 0.005 * np.random.default_rng(1).standard_normal((int((z == 1).sum()), 3))
    assert strain(parameters, shaken, z) == pytest.approx(found, abs=0.2)
    least = nearest_minimum(parameters, x, np.ones(len(x), dtype=bool))
    assert strain(parameters, least, z) == pytest.approx(0.0, abs=0.05)
    stretched = x.copy()
    pair = next(pair for pair in ligand.molecule.bonds if (z[pair] > 1).all())
    stretched[pair[0]] += 0.3 * (x[pair[0]] - x[pair[1]])
    assert strain(parameters, stretched, z) > found
    stretched[pair[0]] = x[pair[1]]
    assert not strain(parameters, stretched, z) < found


@pytest.mark.parametrize("name", [*(path.name for path in SDF), *LONG_STEPS])
def test_strain_does_not_depend_on_the_round_off_of_the_start(name):
    """With the best hydrogens, the derivative of the strain is the gradient of the heavy atoms."""
    sample = STRUCTURES / name
    ligand = pc.ligand(
        sample if sample.exists() else shared(f"../complexes/ligands/{name}"), charges="gasteiger"
    )
    parameters, x, z = ligand.parameters, np.array(ligand.molecule.positions), ligand.molecule.elements
    placed = nearest_minimum(parameters, x, z == 1)
    _, gradient = Function(parameters)(placed)
    assert np.abs(gradient[z == 1]).max() <= 1e-3
    found, rng = strain(parameters, x, z), np.random.default_rng(5)
    for _ in range(2):
        shift = 1e-10 * rng.standard_normal(x.shape)
        expected = np.sum(gradient[z > 1] * shift[z > 1])
        assert strain(parameters, x + shift, z) - found == pytest.approx(expected, abs=STRAIN)


def test_contacts_and_clashes_are_those_of_the_distances(tmp_path):
    s = pc.load(PROTEIN, ligands=posed(tmp_path))
    atoms = s.ligands[0].atoms
    heavy = s.atom_element != "H"
    for closer in (0.0, 0.2, 0.45, 3.0):
        x = s.positions.copy()
        x[atoms] -= [closer, 0.0, 0.0]
        moved = s.with_positions(x)
        (found,) = pc.validate(moved).ligands
        apart = np.linalg.norm(
            x[atoms][heavy[atoms]][:, None] - x[(~s.kept & heavy).nonzero()[0]], axis=2
        ).min(1)
        assert found.contacts == (apart <= 0.4).sum()
        assert (found.clashes > 0) == (closer == 3.0) or closer == 0.45
        assert found.inverted == () and found.failed is None


def test_a_mirrored_centre_is_named(tmp_path):
    s = pc.load(PROTEIN, ligands=posed(tmp_path))
    atoms = s.ligands[0].atoms
    x = s.positions.copy()
    x[atoms] *= [1.0, -1.0, 1.0]
    (found,) = pc.validate(s.with_positions(x)).ligands
    centres = {name for name, _ in s.ligands[0].ligand.molecule.stereo}
    assert set(found.inverted) == centres and len(centres) == 2


def test_posebusters_tests_are_those_of_its_own_reader(tmp_path):
    busters = pytest.importorskip("posebusters")
    for closer in (0.0, 1.0):
        s = pc.load(PROTEIN, ligands=posed(tmp_path, away=0.3 - closer))
        (found,) = pc.validate(s, posebusters=True).ligands
        pc.save_ligands(s, tmp_path / "pose_of.sdf")
        pc.save(pc.load(PROTEIN), tmp_path / "protein.pdb")
        bust = busters.PoseBusters(config="dock").bust(
            tmp_path / "pose_of.sdf", None, tmp_path / "protein.pdb"
        )
        row = bust.iloc[0]
        assert dict(found.posebusters) == {name: bool(value) for name, value in row.items()}
        assert ("minimum_distance_to_protein" in found.failed) == bool(closer)


def test_a_relaxation_runs_posebusters_at_the_start_as_at_the_end(tmp_path):
    pytest.importorskip("posebusters")
    s = pc.load(PROTEIN, ligands=posed(tmp_path))
    for asked in (False, True):
        relaxed = pc.relax(s, posebusters=asked, max_iterations=3, solvent="vacuum", move="ligand")
        for found in (*relaxed.ligands_start, *relaxed.ligands_end):
            assert (found.posebusters is not None) is asked


def test_without_posebusters_one_line_says_so_and_the_rest_is_found(tmp_path, monkeypatch, capsys):
    pose = posed(tmp_path)
    monkeypatch.setitem(__import__("sys").modules, "posebusters", None)
    v = pc.validate(pc.load(PROTEIN, ligands=pose), posebusters=True)
    assert v.ligands[0].posebusters is None and v.ligands[0].strain_kj_mol > 0
    assert "posebusters" in v.posebusters_missing and "pip install" in v.posebusters_missing
    assert run("validate", PROTEIN, "--ligands", pose, "--posebusters") == 0
    assert capsys.readouterr().out.count("pip install") == 1
    few = ["--max-iterations", "2", "-o", tmp_path / "out.pdb"]
    run("relax", PROTEIN, "--ligands", pose, "--posebusters", *few)
    assert "PoseBusters' tests: not run" in capsys.readouterr().out
    # With results, ligands before and after are counted, and the failed tests named.
    both = {"posebusters_passed_start": False, "chain": "B", "residue": "1", "name": "LIG"}
    ligands = [
        both | {"posebusters_passed_end": True, "posebusters_failed_end": []},
        both | {"posebusters_passed_end": False, "posebusters_failed_end": ["bond_lengths"]},
    ]
    (line,) = _posebusters(ligands)
    assert "0 of 2 ligands passed before, 1 after; B:LIG1 fails bond_lengths" in line


def test_relax_records_each_ligand_before_and_after(tmp_path, capsys):
    pose, out = posed(tmp_path), tmp_path / "out.cif"
    result = pc.relax(pc.load(PROTEIN, ligands=pose))
    record = result.record()
    (row,) = record["ligands"]
    (start,), (end,) = (pc.validate(each).ligands for each in (result.start, result.structure))
    for when, found in (("start", start), ("end", end)):
        assert row[f"strain_{when}_kj_mol"] == record[f"ligand_strain_{when}_kj_mol"] == found.strain_kj_mol
        assert row[f"clashes_{when}"] == record[f"ligand_clashes_{when}"] == found.clashes
        assert row[f"contacts_{when}"] == found.contacts and row[f"posebusters_passed_{when}"] is None
    assert row["strain_end_kj_mol"] < row["strain_start_kj_mol"]
    run("relax", PROTEIN, "--ligands", pose, "-o", out, "--json", "--posebusters")
    (said,) = json.loads(capsys.readouterr().out)["ligands"]
    assert type(said["posebusters_passed_end"]) is bool
    assert said["strain_end_kj_mol"] == pytest.approx(row["strain_end_kj_mol"], rel=1e-6)


def test_posebusters_pass_after_the_stream_of_another_call_was_closed(tmp_path):
    """As notebooks and test runners replace the standard error."""
    pytest.importorskip("posebusters")
    import rdkit

    s = pc.load(PROTEIN, ligands=posed(tmp_path))
    (before,) = pc.validate(s, posebusters=True).ligands
    with (tmp_path / "log").open("w") as stream:
        rdkit.log_handler.stream = stream
    (after,) = pc.validate(pc.load(PROTEIN, ligands=tmp_path / "pose.sdf"), posebusters=True).ligands
    assert dict(after.posebusters) == dict(before.posebusters)


BENZOATE = "O=C([O-])c1ccccc1"
"""Its oxygens, and either side of its ring, are equal."""


def test_the_motion_of_a_ligand_is_its_shift_and_equal_atoms_may_change_places(tmp_path):
    s = pc.load(PROTEIN, ligands=posed(tmp_path, BENZOATE))
    (bound,) = s.ligands
    by, x = np.array([0.03, -0.04, 0.12]), s.positions.copy()
    x[bound.atoms] += by
    assert ligand_motion(s, x) == pytest.approx(np.full((1, 2), 1.3), abs=1e-6)
    # The oxygens change places, and the ring turns over: another numbering of the same place.
    molecule = bound.ligand.molecule
    skeleton = Chem.RemoveHs(to_rdkit(molecule))
    order = skeleton.GetSubstructMatch(Chem.MolFromSmarts("[#8]~[#6](~[#8])-c1ccccc1"))
    heavy = bound.atoms[molecule.heavy][list(order)]
    x = s.positions.copy()
    x[heavy] = x[heavy[[2, 1, 0, 3, 8, 7, 6, 5, 4]]]
    rmsd, farthest = ligand_motion(s, x)[0]
    assert rmsd == pytest.approx(0.0, abs=1e-6) and farthest > 2.0
    x[bound.atoms] += by
    assert ligand_motion(s, x)[0, 0] == pytest.approx(1.3, abs=1e-6)
    assert ligand_motion(pc.load(PROTEIN), np.zeros((304, 3))).shape == (0, 2)
    assert np.isnan(ligand_motion(s, np.full_like(x, np.nan))).all()


def heavy_motion(start, end):
    """RMSD and largest displacement of the heavy atoms of the one ligand, atom by atom, angstrom."""
    (bound,) = start.ligands
    its = bound.atoms[bound.ligand.molecule.heavy]
    away = 10.0 * np.linalg.norm(end[its] - start.positions[its], axis=1)
    return np.sqrt(np.mean(away**2)), away.max()


COLUMNS = ["ligand_rmsd_angstrom", "ligand_displacement_max_angstrom"]


@pytest.mark.parametrize("how", ["relax", "cartesian", "lbfgs"])
def test_a_pose_that_moved_is_reported_where_the_protein_stands_still(tmp_path, how):
    """The RMSD of C-alphas was the only one: 0.00 of a pose that moved by angstroms."""
    s = pc.load(PROTEIN, ligands=posed(tmp_path, away=0.2))
    chain = pc.build_chain(s, move="ligand")
    found = pc.relax(s, move="ligand") if how == "relax" else pc.minimise(chain, method=how)
    record = found.record()
    assert record["ca_rmsd_angstrom"] == pytest.approx(0.0, abs=1e-6)
    rmsd, farthest = heavy_motion(s, found.x)
    assert [record[name] for name in COLUMNS] == pytest.approx([rmsd, farthest], abs=1e-6)
    assert rmsd > 0.05 and f"ligand RMSD {rmsd:.2f}" in repr(found)
    assert any(f"LIGAND RMSD {rmsd:.3f}, LARGEST DISPLACEMENT" in line for line in found.provenance())
    if how == "relax":
        (row,) = record["ligands"]
        assert [row["rmsd_angstrom"], row["displacement_max_angstrom"]] == [record[name] for name in COLUMNS]


def test_the_motion_of_one_pose_and_of_several_is_printed_and_in_the_tables(tmp_path, capsys):
    poses = tmp_path / "poses.sdf"
    poses.write_text("".join(posed(tmp_path, away=a).read_text() + "$$$$\n" for a in (0.15, 0.25)))
    folder, page = tmp_path / "out", tmp_path / "page.html"
    assert run("relax", PROTEIN, "--ligands", poses, "--rigid-protein", "-o", folder, "--workers", 1) == 0
    said, table = capsys.readouterr().out, pd.read_csv(folder / "relaxed.csv")
    starts = [pc.load(PROTEIN, ligands=f"{poses}#{k}") for k in (1, 2)]
    ends = [pc.relax(s, move="ligand").x for s in starts]
    expected = np.array([heavy_motion(s, x) for s, x in zip(starts, ends, strict=True)])
    assert table[COLUMNS].to_numpy() == pytest.approx(expected, abs=1e-3)
    assert (
        f"ligands: median RMSD {np.median(expected[:, 0]):.2f}, largest {expected[:, 0].max():.2f}, "
        f"largest displacement {expected[:, 1].max():.2f} angstrom" in said
    )
    one = ("--ligands", f"{poses}#1", "--rigid-protein", "-o", tmp_path / "one.pdb")
    assert run("relax", PROTEIN, *one, "--report", page) == 0
    said = " ".join(capsys.readouterr().out.split())
    rmsd, farthest = expected[0]
    assert f"B:1 RMSD {rmsd:.2f}, largest displacement {farthest:.2f} angstrom" in said
    assert f"Ligand RMSD {rmsd:.2f}, largest displacement {farthest:.2f} angstrom" in page.read_text()
    assert run("minimise", PROTEIN, *one, "--method", "cartesian", "--force") == 0
    said = capsys.readouterr().out
    # In a narrow terminal the words of a heading are above one another.
    assert re.search(r"ligand +ligand\n.* RMSD +shift|ligand RMSD.* ligand shift", said)
