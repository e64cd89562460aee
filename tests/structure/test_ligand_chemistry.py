"""Ligands beside the protein: where their chemistry comes from, their parameters, hydrogens and hands."""

import re
from dataclasses import replace
from pathlib import Path

import gemmi
import numpy as np
import openmm
import pytest
from fixtures.command_line import run
from fixtures.oracles import assert_equals_reference
from fixtures.refusals import expect_refusal
from fixtures.samples import STRUCTURES, shared

import protochain as pc
from protochain.energies.factory import build_system
from protochain.ligands.dictionary import component
from protochain.ligands.sources import of_residue, read
from protochain.structure.ligand_files import poses
from protochain.structure.molecule.chirality import chiral_atoms, volume
from protochain.structure.molecule.repairs import Kind
from protochain.structure.preparation.ligand_chemistry import _rename_hydrogens
from protochain.validation.stereocentres import inverted_stereocentres

Chem, AllChem = (pytest.importorskip(f"rdkit.Chem{name}") for name in ("", ".AllChem"))
pytest.importorskip("biotite")
pytest.importorskip("dimorphite_dl")


PROTEIN = STRUCTURES / "1l2y.pdb"
THREONINE_LIKE = "C[C@H](O)[C@@H](N)C(=O)OC"


def put(made, away=0.9):
    """Positions of a molecule (nm) beside the sample protein, ``away`` beyond its outermost atom."""
    x = 0.1 * made.GetConformer().GetPositions()
    protein = pc.load(PROTEIN).positions
    x += [protein[:, 0].max() + away - x[:, 0].min(), *(protein.mean(0) - x.mean(0))[1:]]
    return x


def embedded(smiles, away=0.3):
    made = Chem.AddHs(Chem.MolFromSmiles(smiles))
    assert AllChem.EmbedMolecule(made, randomSeed=7) == 0
    made.GetConformer().SetPositions(10.0 * put(made, away))
    return made


def posed(tmp_path, smiles, name="pose.sdf", away=0.3):
    """An SDF file of a molecule beside the sample protein."""
    path = tmp_path / name
    Chem.MolToMolFile(embedded(smiles, away), str(path))
    return path


def beside(tmp_path, made, name="XYZ", label="X{}", hydrogens=False, suffix=".pdb"):
    """The sample protein with a molecule as a residue whose atoms have these names."""
    structure = gemmi.read_structure(str(PROTEIN))
    del structure[1:]
    residue = gemmi.Residue()
    residue.name, residue.seqid, residue.het_flag = name, gemmi.SeqId("1"), "H"
    x = made.GetConformer().GetPositions()
    for k, each in enumerate(made.GetAtoms()):
        if each.GetAtomicNum() > 1 or hydrogens:
            atom = gemmi.Atom()
            atom.name, atom.element = label.format(k), gemmi.Element(each.GetSymbol())
            atom.pos = gemmi.Position(*x[k])
            residue.add_atom(atom)
    chain = gemmi.Chain("L")
    chain.add_residue(residue)
    structure[0].add_chain(chain)
    path = tmp_path / f"complex{suffix}"
    structure.write_pdb(str(path))
    return path


def kinds(structure):
    return {each.kind for each in structure.repairs}


def test_a_pose_is_added_and_moves_with_all_its_hydrogens(tmp_path):
    s = pc.load(PROTEIN, ligands=posed(tmp_path, "CC(=O)[O-]"))
    (bound,) = s.ligands
    assert bound.ligand.molecule.charge == -1 and len(bound.atoms) == 7
    assert set(np.flatnonzero(s.mobile)) == set(bound.atoms) and not s.obstacle.any()
    assert s.atom_name[bound.atoms].tolist() == list(bound.ligand.molecule.names)
    assert s.atom_element[bound.atoms].tolist() == ["C", "C", "O", "O", "H", "H", "H"]
    pairs = {frozenset(bound.atoms[pair].tolist()) for pair in bound.ligand.molecule.bonds}
    assert pairs <= {frozenset(pair) for pair in s.bonds.tolist()}
    assert Kind.BOUND in kinds(s)


def test_bonds_of_a_ligand_that_turn_are_those_that_rdkit_finds(tmp_path):
    smiles = "COC(=O)CCNC(=O)c1ccc(cc1)C=CCSC"
    s = pc.load(PROTEIN, ligands=posed(tmp_path, smiles))
    here = {int(k): place for place, k in enumerate(s.ligands[0].atoms)}
    axes = [sorted(here[k] for k in hinge.on_axis) for hinge in pc.build_chain(s, "ligand").hinges]
    graph = Chem.MolFromSmiles(smiles)
    single, amides = (
        {tuple(sorted(pair)) for pair in graph.GetSubstructMatches(Chem.MolFromSmarts(pattern))}
        for pattern in ("[!D1]-;!@[!D1]", "[#7]-;!@[$(C=O)]")
    )
    assert sorted(map(tuple, axes)) == sorted(single - amides) and len(axes) == 8 and amides <= single


def test_the_energy_is_that_of_openmms_reference_platform(tmp_path):
    s = pc.load(PROTEIN, ligands=posed(tmp_path, THREONINE_LIKE))
    assert_equals_reference(pc.energy(s, solvent="gbn2", engine="native"), s.positions)


@pytest.mark.parametrize("forcefield", ["amber14", "charmm36"])
def test_the_ligands_own_terms_are_in_the_system_whatever_the_proteins_force_field(tmp_path, forcefield):
    """Without the protein's charges and wells, moving its atoms changes the energy by its own terms."""
    s = pc.load(PROTEIN, ligands=posed(tmp_path, THREONINE_LIKE))
    (bound,) = s.ligands
    system = build_system(s, forcefield, "vacuum")
    mine = {*bound.atoms.tolist()}
    for force in system.getForces():
        if isinstance(force, openmm.NonbondedForce):
            for k in set(range(s.n_atoms)) - mine:
                force.setParticleParameters(k, 0.0, 1.0, 0.0)
        elif isinstance(force, openmm.CustomNonbondedForce):
            force.addInteractionGroup(mine, mine)
    context = openmm.Context(
        system, openmm.VerletIntegrator(0.001), openmm.Platform.getPlatformByName("Reference")
    )

    def total(x):
        context.setPositions(x)
        return context.getState(getEnergy=True).getPotentialEnergy()._value

    moved = s.positions.copy()
    moved[bound.atoms] += 0.01 * np.random.default_rng(3).standard_normal((len(bound.atoms), 3))
    own = [sum(bound.ligand.terms(x[bound.atoms]).values()) for x in (s.positions, moved)]
    assert total(moved) - total(s.positions) == pytest.approx(own[1] - own[0], rel=1e-7)


def test_atoms_are_matched_by_their_bonds_whatever_their_names(tmp_path):
    made = embedded("OC[C@H](O)CN")
    path = beside(tmp_path, made)
    s = pc.load(path, ligands={"XYZ": "NC[C@@H](O)CO"})
    (bound,) = s.ligands
    molecule = bound.ligand.molecule
    assert molecule.charge == 1 and Kind.CHARGED in kinds(s)
    by_name = dict(zip(molecule.names, molecule.elements.tolist(), strict=True))
    for k, each in enumerate(made.GetAtoms()):
        if each.GetAtomicNum() > 1:
            assert by_name[f"X{k}"] == each.GetAtomicNum()
    heavy = np.array([each.GetAtomicNum() > 1 for each in made.GetAtoms()])
    x = {f"X{k}": at for k, at in enumerate(made.GetConformer().GetPositions()) if heavy[k]}
    for name, at in zip(molecule.names, s.positions[bound.atoms], strict=True):
        assert name not in x or np.allclose(10.0 * at, x[name], atol=1e-3)


def test_hydrogens_of_the_file_show_the_charge_and_stay_where_they_are(tmp_path):
    made = embedded("CC(=O)O")
    s = pc.load(beside(tmp_path, made, "ACY", hydrogens=True), ligands={"ACY": "CC(=O)[O-]"})
    (bound,) = s.ligands
    assert bound.ligand.molecule.charge == 0 and len(bound.atoms) == 8
    there = {f"X{k}": x for k, x in enumerate(made.GetConformer().GetPositions())}
    for name, at in zip(s.atom_name[bound.atoms], 10.0 * s.positions[bound.atoms], strict=True):
        assert np.allclose(at, there[name], atol=1e-3)


def test_a_mirrored_stereocentre_is_told_and_relax_turns_it_right(tmp_path):
    other = THREONINE_LIKE.replace("C[C@H]", "C[C@@H]")
    path = beside(tmp_path, embedded(other), "LIG")
    s = pc.load(path, ligands={"LIG": THREONINE_LIKE})
    (bound,) = s.ligands
    assert len(bound.inverted) == 1 and Kind.INVERTED in kinds(s)
    centres = chiral_atoms(s)
    mine = centres[np.isin(centres[:, 0], bound.atoms)]
    assert len(mine) == 2 and sorted(np.sign(volume(s.positions[mine]))) == [-1.0, 1.0]
    (wrong,) = mine[volume(s.positions[mine]) < 0.0, 0]
    assert (str(s.atom_name[wrong]),) == bound.inverted
    relaxed = pc.relax(s)
    assert (volume(relaxed.x[mine]) > 0.0).all()
    # ChiralityRestraint of the end, by RDKit from its positions.
    pc.save_ligands(relaxed, tmp_path / "end.sdf")
    end = Chem.MolFromMolFile(str(tmp_path / "end.sdf"), removeHs=True)
    Chem.AssignStereochemistryFrom3D(end)
    neutral = Chem.AddHs(Chem.MolFromSmiles(THREONINE_LIKE.replace("(N)", "([NH3+])")))
    assert end.HasSubstructMatch(Chem.RemoveHs(neutral), useChirality=True)
    right = pc.load(path, ligands={"LIG": other})
    assert right.ligands[0].inverted == () and Kind.INVERTED not in kinds(right)


@pytest.mark.parametrize(
    ("drawn", "name", "wrong"),
    [("DAL", "DAL", []), ("ALA", "DAL", ["CA"]), ("DSN", "DSN", []), ("DAL", "ALA", ["CA"])],
)
def test_a_free_amino_acid_is_of_the_hand_that_its_name_says(drawn, name, wrong, tmp_path):
    found = component(drawn)
    found, made = found[found.element != "H"], Chem.RWMol()
    for symbol in found.element:
        made.AddAtom(Chem.Atom(str(symbol)))
    made.AddConformer(Chem.Conformer(made.GetNumAtoms()))
    made.GetConformer().SetPositions(found.coord.astype(float))
    made.GetConformer().SetPositions(10.0 * put(made))
    path = beside(tmp_path, made, name)
    text = path.read_text()
    path.write_text(re.sub(r"X(\d)  ", lambda at: f"{found.atom_name[int(at[1])]:4}", text))
    s = pc.load(path, keep="ligands")
    assert [s.atom_name[k] for k in inverted_stereocentres(s, s.positions)] == wrong
    done = pc.relax(s)
    assert done.status == "converged" and s.ligands[0].inverted == tuple(wrong)
    assert not len(inverted_stereocentres(s, done.x))
    centre = next(row for row in chiral_atoms(s) if row[0] in s.ligands[0].atoms)
    assert (volume(done.x[centre]) * volume(s.positions[centre]) < 0.0) == bool(wrong)


@pytest.mark.parametrize(
    ("smiles", "name", "atoms", "charge"),
    [("C#N", "CYN", "CN", 0), ("[NH4+]", "NH4", "N", 1), ("N=O", "NO", "NO", None),
     ("Oc1ccccc1", "HOH", "OABDEFG", None)],
)  # fmt: skip
def test_the_smallest_molecules_are_what_their_atoms_are(smiles, name, atoms, charge, tmp_path):
    path = beside(tmp_path, embedded(smiles, away=0.9), name)
    text = path.read_text()
    path.write_text(re.sub(r"X(\d)  ", lambda at: f"{atoms[int(at[1])]}   ", text))
    s = pc.load(path, keep="all")
    if charge is None:  # It stays, with a reason, and without hydrogens.
        (line,) = (each for each in s.repairs if each.kind is Kind.STAYS_UNKNOWN)
        assert not s.ligands and s.kept.sum() == len(atoms) and line.facts["residue"].name != "HOH"
    else:
        (bound,) = s.ligands
        assert bound.ligand.molecule.charge == charge and s.formal_charge[bound.atoms].sum() == charge


def test_methods_move_it_torsions_as_a_rigid_body(tmp_path):
    s = pc.load(PROTEIN, ligands=posed(tmp_path, THREONINE_LIKE))
    atoms = s.ligands[0].atoms
    apart = np.linalg.norm(s.positions[atoms][:, None] - s.positions[atoms], axis=2)
    for method, rigid in (("lbfgs", True), ("cartesian", False)):
        x = pc.minimise(s, method=method, max_evaluations=60).x[atoms]
        assert np.abs(x - s.positions[atoms]).max() > 1e-3
        same = np.abs(np.linalg.norm(x[:, None] - x, axis=2) - apart).max() < 1e-9
        assert same == rigid


def test_charges_of_another_model_are_named(tmp_path):
    s = pc.load(PROTEIN, ligands=posed(tmp_path, "OP(=O)(O)I"))
    (noted,) = [each for each in s.repairs if each.kind is Kind.CHARGES_OF_MMFF94]
    assert noted.facts["atoms"] == ("P1", "I1") and "P1" in str(noted)
    s = pc.load(PROTEIN, ligands=posed(tmp_path, "OP(=O)(O)I"), ligand_charges="mmff94")
    assert s.ligands and Kind.CHARGES_OF_MMFF94 not in kinds(s)


def test_what_no_source_knows_stays_in_place_and_says_what_to_give(tmp_path):
    s = pc.load(beside(tmp_path, embedded("CC(=O)OC"), "ZZ9"), keep="all")
    (told,) = [each for each in s.repairs if each.kind is Kind.STAYS_UNKNOWN]
    assert "ZZ9" in str(told) and not s.ligands and s.obstacle.sum() == 5


def test_what_the_force_field_cannot_type_stays_in_place(tmp_path):
    s = pc.load(beside(tmp_path, embedded("CCB(O)O"), "XBO"), ligands=None, keep="all")
    assert not s.ligands and Kind.STAYS_UNKNOWN in kinds(s)


@pytest.mark.parametrize(
    ("ligands", "said"),
    [
        ({"XYZ": "notsmiles("}, "is neither SMILES nor"),
        ({"XYZ": "CCO"}, "another molecule"),
        ({"XYZ": "missing.sdf"}, "missing.sdf"),
        ({"ABC": "CCO"}, "ABC"),
        (["XYZ=CCO", "XYZ=CCC"], "twice"),
        ("CCO", "NAME=SMILES"),
        ("poses/x.pdbqt", "obabel poses/x.pdbqt -O poses/x.sdf"),
        ("LIG=x.pdbqt", "mk_export.py x.pdbqt -s x.sdf"),
        (3, "give names and molecules"),
        ({"XYZ": "CC[BH2]"}, "another molecule"),
    ],
)
def test_what_makes_no_sense_is_refused_in_one_line(tmp_path, ligands, said):
    path = beside(tmp_path, embedded("CC(=O)OC"))
    with pytest.raises(pc.ProtochainError, match=said) as refused:
        pc.load(path, ligands=ligands)
    assert "\n" not in str(refused.value)


def test_donors_of_a_ligand_that_hold_a_metal_are_tied_to_it():
    """APC of 1HQ2 holds two magnesium ions by its phosphates."""
    s = pc.load(shared("../complexes/astex/1HQ2_PH2_protein.pdb"))
    (bound,) = [each for each in s.ligands if s.residue_name[s.atom_residue[each.atoms[0]]] == "APC"]
    ends = [tie for tie in s.ties if len(tie.atoms) == 2 and tie.atoms[0] in bound.atoms]
    assert len({tie.atoms[1] for tie in ends}) == 2
    for tie in ends:
        i, j = tie.atoms
        assert s.atom_element[i] == "O" and s.atom_element[j] == "Mg"
        assert np.linalg.norm(s.positions[i] - s.positions[j]) == pytest.approx(tie.rest, abs=1e-6)


def with_metal(path, name, element, away):
    """The same file with an ion at a distance in angstrom from an atom of residue L, on its far side."""
    structure = gemmi.read_structure(str(path))
    (residue,) = structure[0]["L"]
    at = residue[name][0].pos
    out = at - gemmi.Position(*np.mean([a.pos.tolist() for a in residue], axis=0))
    chain, ion, site = gemmi.Chain("M"), gemmi.Residue(), gemmi.Atom()
    ion.name, ion.seqid, ion.het_flag = element.upper(), gemmi.SeqId("1"), "H"
    site.name, site.element = element.upper(), gemmi.Element(element)
    site.pos = at + out * (away / out.length())
    ion.add_atom(site)
    chain.add_residue(ion)
    structure[0].add_chain(chain)
    structure.write_pdb(str(path))
    return path


@pytest.mark.parametrize(
    ("smiles", "name", "near", "far"),
    [("NS(=O)(=O)c1ccccc1", "X0", -1, 0), ("NCCc1ccccc1", "X0", 0, 1), ("OC1CCCCC1", "X0", 0, 0)],
)
def test_a_donor_that_holds_a_metal_has_no_proton_to_lose(tmp_path, smiles, name, near, far):
    """Sulphonamide and ammonium on zinc; an alcohol keeps its own."""
    for away, charge in ((2.0, near), (4.0, far)):
        path = with_metal(beside(tmp_path, embedded(smiles, away=0.8)), name, "Zn", away)
        (bound,) = pc.load(path, ligands={"XYZ": smiles}, keep="all").ligands
        assert bound.ligand.molecule.charge == charge
        assert sum(each.after - each.before for each in bound.ligand.charged) == charge


@pytest.mark.parametrize(
    ("smiles", "holds", "charge", "left"),
    [
        ("[nH]1cc(CC)nc1", "X0", 0, "X5"),  # An imidazole's other nitrogen has its proton.
        ("[nH]1ccc2ccccc12", "X0", -1, None),  # Of indole there is none.
        ("ONC(=O)c1ccccc1", "X0", -1, "X1"),  # hydroxamate
        ("SCc1ccccc1", "X0", -1, None),
    ],
)
def test_no_proton_is_left_between_a_ligand_and_zinc(tmp_path, smiles, holds, charge, left):
    path = with_metal(beside(tmp_path, embedded(smiles, away=0.8)), holds, "Zn", 2.1)
    s = pc.load(path, ligands={"XYZ": smiles}, keep="all")
    (bound,) = s.ligands
    molecule = bound.ligand.molecule
    bearing = {molecule.names[i] for pair in molecule.bonds.tolist() for i in pair
               if molecule.elements[[*pair]].min() == 1 and molecule.elements[i] != 1}  # fmt: skip
    hetero = {name for name, z in zip(molecule.names, molecule.elements, strict=True) if z in (7, 8, 16)}
    assert molecule.charge == charge and bearing & hetero == ({left} if left else set())


@pytest.mark.parametrize("smiles", ["CC(=O)O", "CN1CCN(C)CC1"])
def test_a_pose_is_charged_as_the_same_molecule_under_a_name(tmp_path, smiles):
    pose, made = posed(tmp_path, smiles), embedded(smiles)
    added = pc.load(PROTEIN, ligands=pose)
    named = pc.load(beside(tmp_path, made), ligands={"XYZ": str(pose)})
    found = [each.ligands[0].ligand for each in (added, named)]
    assert found[0].molecule.charge == found[1].molecule.charge == (-1 if smiles == "CC(=O)O" else 1)
    assert [len(each.charged) for each in found] == [1, 1] and Kind.CHARGED in kinds(added)
    assert added.atom_element.tolist() == named.atom_element.tolist()
    pc.save_ligands(added, tmp_path / "out.sdf")
    (written,) = Chem.SDMolSupplier(str(tmp_path / "out.sdf"), removeHs=False)
    assert Chem.GetFormalCharge(written) == found[0].molecule.charge


def placed_atoms(path):
    """Text of the coordinates of the heavy atoms of the protein in a PDB file's first model, by name."""
    lines = path.read_text().partition("ENDMDL")[0].splitlines()
    atoms = [x for x in lines if x.startswith("ATOM") and x[12:16].strip()[0] != "H" and "D" not in x[76:78]]
    return {x[12:27].replace(" ", ""): x[30:54] for x in atoms}


def test_a_rigid_protein_stays_as_its_file_has_it_and_the_pose_moves(tmp_path):
    pose, other = posed(tmp_path, "CC(=O)NCCS", away=0.08), embedded("OCCO", away=0.9)
    path, out, sdf = beside(tmp_path, other, "EDO", label="A{}"), tmp_path / "out.pdb", tmp_path / "out.sdf"
    run("relax", path, "--ligands", "EDO=OCCO", "--ligands", pose, "--keep", "all", "--rigid-protein",
        "--ligand-out", sdf, "-o", out)  # fmt: skip
    assert placed_atoms(out) == placed_atoms(path) and len(placed_atoms(out)) > 100
    moved, stayed = (each.GetConformer().GetPositions() for each in Chem.SDMolSupplier(str(sdf)))
    given = Chem.MolFromMolFile(str(pose)).GetConformer().GetPositions()
    assert np.linalg.norm(moved - given, axis=1).min() > 0.01
    x = other.GetConformer().GetPositions()[[each.GetAtomicNum() > 1 for each in other.GetAtoms()]]
    assert np.abs(stayed - x).max() < 2e-3


def test_a_rigid_protein_without_a_pose_is_one_around_its_ligands(tmp_path):
    s = pc.load(beside(tmp_path, embedded("OCCO"), "EDO", label="A{}"), ligands="EDO=OCCO")
    r = pc.relax(s, rigid_protein=True)
    away = np.linalg.norm(r.x - s.positions, axis=1) > 0.0
    assert np.array_equal(np.flatnonzero(away), np.sort(s.ligands[0].atoms))
    with expect_refusal("rigid_protein", "move"):
        pc.Setup(rigid_protein=True, move="sidechain")
    with expect_refusal("ligands", match="no ligand"):
        pc.relax(PROTEIN, rigid_protein=True)


def test_a_pose_within_a_rigid_protein_comes_out_whole(tmp_path):
    """Its bonds, by RDKit from the file written, are not stretched around atoms of the protein."""
    s = pc.load(PROTEIN, ligands=posed(tmp_path, "c1ccccc1-c1ccccc1", away=-0.7))
    r = pc.relax(s, rigid_protein=True)
    pc.save_ligands(r, tmp_path / "out.sdf")
    (end,) = Chem.SDMolSupplier(str(tmp_path / "out.sdf"))
    x, protein = end.GetConformer().GetPositions(), 10.0 * s.positions[~s.kept & (s.atom_element != "H")]
    longest = max(np.linalg.norm(x[b.GetBeginAtomIdx()] - x[b.GetEndAtomIdx()]) for b in end.GetBonds())
    nearest, before = (
        np.linalg.norm(at[:, None] - protein, axis=2).min()
        for at in (x, 10.0 * s.positions[s.ligands[0].atoms])
    )
    assert longest < 1.62 and nearest > 2.4 > before


def test_poses_of_a_file_are_joined_each_under_a_name_before_other_ligands(tmp_path):
    smiles, out = ["CC(=O)NCCS", "OCC(O)CO"], tmp_path / "joined.sdf"
    with Chem.SDWriter(str(tmp_path / "poses.sdf")) as poses:
        for each in smiles:
            poses.write(embedded(each))
    path = beside(tmp_path, embedded("OCCO", away=0.9), "EDO", label="A{}")
    run("relax", path, "--ligands", "EDO=OCCO", "--ligands", tmp_path / "poses.sdf", "--keep", "all",
        "--rigid-protein", "--ligand-out", out, "-o", tmp_path / "relaxed", "--workers", 1)  # fmt: skip
    made = [*Chem.SDMolSupplier(str(out))]
    assert [Chem.MolToSmiles(each) for each in made] == [smiles[0], "OCCO", smiles[1], "OCCO"]
    titles = [each.GetProp("_Name") for each in made]
    assert titles[0] != titles[2] and all(title.startswith("LIG ") for title in titles[::2])
    assert all(title.startswith("EDO ") for title in titles[1::2])
    for name, record in zip(("poses_1", "poses_2"), made[::2], strict=True):
        (saved,) = (tmp_path / "relaxed").glob(f"*{name}.relaxed.pdb")
        end = pc.load(saved)
        (bound,) = (b for b in end.ligands if end.residue_name[end.atom_residue[b.atoms[0]]] == "LIG")
        x = 10.0 * end.positions[bound.atoms][bound.ligand.molecule.heavy]
        assert np.abs(x - record.GetConformer().GetPositions()).max() < 2e-3


@pytest.mark.parametrize("name", ["", "pose"])
def test_twenty_records_are_as_many_poses(tmp_path, name):
    """Of two molecules, all of one name or of none, as docking programs write them."""
    smiles, path = ["CC(=O)NCCS", "OCC(O)CO"], tmp_path / "x.sdf"
    made = [embedded(each) for each in smiles]
    with Chem.SDWriter(str(path)) as file:
        for k in range(20):
            made[k % 2].SetProp("_Name", name)
            made[k % 2].SetProp("minimizedAffinity", f"{-k}")
            file.write(made[k % 2])
    found = poses(path)
    assert found == [f"{path}#{k}" for k in range(1, 21)]
    for k in (0, 9, 19):
        molecule = of_residue("", source=Path(found[k]))
        assert molecule.n_atoms == made[k % 2].GetNumAtoms()


def test_hydrogens_of_one_name_get_names_that_no_atom_has():
    ethanol = read("CCO")
    names = [("H2", "H1", "O")[k] if k < 3 else "H" for k in range(ethanol.n_atoms)]
    given = replace(ethanol, names=tuple(names))
    assert _rename_hydrogens(given).names == ("H2", "H1", "O", "H", "H3", "H4", "H5", "H6", "H7")
