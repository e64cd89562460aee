"""Ligands in the files written, read again: tables of atoms and bonds, CONECT records, SDF."""

import json
from itertools import cycle

import gemmi
import numpy as np
import pandas as pd
import pytest
from fixtures import covalent
from fixtures.command_line import refusal, run
from fixtures.refusals import expect_refusal
from fixtures.samples import STRUCTURES

import protochain as pc
from protochain.ligands.molecule import to_rdkit
from protochain.ligands.sources import of_residue
from protochain.ligands.tables import stereo
from protochain.structure.molecule.repairs import Kind

Chem = pytest.importorskip("rdkit.Chem")
AllChem = pytest.importorskip("rdkit.Chem.AllChem")
pytest.importorskip("biotite")

PROTEIN = STRUCTURES / "1l2y.pdb"
SMILES = {
    "nitro": "C[C@H](O)[C@@H](C)c1ccc(cc1)[N+](=O)[O-]",
    "trans double bond": "C/C=C/C(=O)[O-]",
    "cis double bond": "C/C=C\\C(=O)[O-]",
    "single bonds": "OC[C@@H](O)C",
    "no stereo, single bonds": "CCOCC",
    "phosphate": "C[C@@H]([NH3+])COP(=O)([O-])[O-]",
    "sulphone and alkyne": "C#CCS(=O)(=O)c1cc[nH]c1",
}


def posed(tmp_path, smiles, name="pose.sdf", away=0.3):
    """A file of a molecule beside the sample protein."""
    made = Chem.AddHs(Chem.MolFromSmiles(smiles))
    assert AllChem.EmbedMolecule(made, randomSeed=7) == 0
    x, protein = made.GetConformer().GetPositions(), 10.0 * pc.load(PROTEIN).positions
    x += [protein[:, 0].max() + 10.0 * away - x[:, 0].min(), *(protein.mean(0) - x.mean(0))[1:]]
    made.GetConformer().SetPositions(x)
    path = tmp_path / name
    Chem.MolToMolFile(made, str(path))
    return path


def of(molecule):
    """Its chemistry by the names of atoms: independent of their order."""
    names = np.array(molecule.names)
    atoms = {
        name: (z, charge)
        for name, z, charge in zip(names, molecule.elements, molecule.formal_charges, strict=True)
    }
    bonds = {
        frozenset(pair): order
        for pair, order in zip(names[molecule.bonds].tolist(), molecule.orders, strict=True)
    }
    return atoms, bonds, {(frozenset(atom.split("=")), letter) for atom, letter in molecule.stereo}


@pytest.mark.parametrize(
    ("kind", "suffix"), [*zip(SMILES, cycle((".cif", ".pdb")), strict=False), ("nitro", ".pdb")]
)
def test_the_chemistry_written_is_read_again(tmp_path, kind, suffix):
    s = pc.load(PROTEIN, ligands=posed(tmp_path, SMILES[kind]))
    (bound,) = s.ligands
    pc.save(s, tmp_path / f"saved{suffix}")
    again = pc.load(tmp_path / f"saved{suffix}")
    (read,) = again.ligands
    assert "file's bonds" in read.ligand.molecule.source
    assert of(read.ligand.molecule) == of(bound.ligand.molecule)
    assert again.atom_name.tolist() == s.atom_name.tolist()
    assert np.allclose(again.positions, s.positions, atol=1e-4)
    assert read.inverted == bound.inverted == ()
    terms, before = read.ligand.terms(s.positions[read.atoms]), bound.ligand.terms(s.positions[bound.atoms])
    assert terms == pytest.approx(before, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize(("charge", "total"), [("-1", -1), ("?", 0)])
def test_a_table_with_charges_goes_before_the_dictionary_and_one_without_after(charge, total):
    """A file has acetate under the dictionary's name of acetic acid. Its atoms have no charges elsewhere."""
    orders = {"CH3 C": "sing", "C O": "doub", "C OXT": "sing"}
    atoms = {"C": "C", "O": "O", "OXT": "O", "CH3": "C"}
    rows = [f"ACY {name} {symbol} {charge if name == 'OXT' else '?'}" for name, symbol in atoms.items()]
    tables = {
        "atom": ("comp_id atom_id type_symbol charge", rows),
        "bond": ("comp_id atom_id_1 atom_id_2 value_order", [f"ACY {b} {o}" for b, o in orders.items()]),
    }
    header = "data_x\n" + "".join(
        "loop_\n" + "".join(f"_chem_comp_{table}.{name}\n" for name in names.split()) + "\n".join(rows) + "\n"
        for table, (names, rows) in tables.items()
    )
    molecule = of_residue("ACY", header, {name: (symbol, 0) for name, symbol in atoms.items()})
    assert molecule.formal_charges.sum() == total


@pytest.mark.parametrize("kind", SMILES)
def test_the_tables_written_say_what_rdkit_finds_in_the_smiles(tmp_path, kind):
    pc.save(pc.load(PROTEIN, ligands=posed(tmp_path, SMILES[kind])), tmp_path / "saved.cif")
    block, made = gemmi.cif.read(f"{tmp_path}/saved.cif")[0], Chem.MolFromSmiles(SMILES[kind])
    tables = (block.get_mmcif_category(f"_{name}.") for name in ("chem_comp_atom", "chem_comp_bond"))
    atoms, bonds = (its.loc[its.comp_id == "LIG"] for its in map(pd.DataFrame, tables))
    rows = atoms.drop(columns=["comp_id", "atom_id"]).to_numpy().tolist()
    for k, atom in enumerate(made.GetAtoms()):
        letter = atom.GetProp("_CIPCode") if atom.HasProp("_CIPCode") else "N"
        facts = atom.GetSymbol(), atom.GetFormalCharge(), "NY"[atom.GetIsAromatic()], letter, k + 1
        assert rows[k] == [str(fact) for fact in facts]
    number = {name: k for k, name in enumerate(atoms.atom_id)}
    assert bonds.pdbx_ordinal.tolist() == [str(k + 1) for k in range(len(bonds))]
    of_bond = {frozenset((number[row[2]], number[row[3]])): row[5:7] for row in bonds.itertuples()}
    for bond in made.GetBonds():
        stereo = {"STEREOE": "E", "STEREOZ": "Z"}.get(str(bond.GetStereo()), "N")
        ends = frozenset((bond.GetBeginAtomIdx(), bond.GetEndAtomIdx()))
        assert of_bond[ends] == ("NY"[bond.GetIsAromatic()], stereo)
    none, *others = block.get_mmcif_category("_protochain_ligand.")["atoms"]
    assert none is False and {*" ".join(others).split()} <= number.keys()


@pytest.mark.parametrize(("suffix", "hydrogens"), [(".cif", False), (".pdb", True)])
def test_a_centre_that_is_inverted_stays_told(tmp_path, suffix, hydrogens):
    """What the output states is the source's stereo, not that of the positions."""
    pose = posed(tmp_path, "C[C@H](O)[C@@H](N)C(=O)OC")
    s = pc.load(PROTEIN, ligands=pose)
    pc.save(s, tmp_path / "first.cif")
    wrong = pc.load(tmp_path / "first.cif", ligands={"LIG": "C[C@@H](O)[C@@H](N)C(=O)OC"})
    assert len(wrong.ligands[0].inverted) == 1
    pc.save(wrong, tmp_path / f"second{suffix}", hydrogens=hydrogens)
    again = pc.load(tmp_path / f"second{suffix}")
    assert again.ligands[0].inverted == wrong.ligands[0].inverted
    assert Kind.INVERTED in {each.kind for each in again.repairs}


def test_conect_records_repeat_bonds_by_their_order(tmp_path):
    s = pc.load(PROTEIN, ligands=posed(tmp_path, SMILES["sulphone and alkyne"]))
    pc.save(s, tmp_path / "saved.pdb")
    made = Chem.MolFromPDBBlock(
        "".join(
            line for line in (tmp_path / "saved.pdb").read_text().splitlines(True)
            if line.startswith(("HETATM", "CONECT"))
        ),
        removeHs=False, proximityBonding=False,
    )  # fmt: skip
    molecule = s.ligands[0].ligand.molecule
    assert made.GetNumAtoms() == molecule.n_atoms and made.GetNumBonds() == len(molecule.bonds)
    assert Chem.MolToSmiles(Chem.RemoveHs(made)) == Chem.MolToSmiles(Chem.RemoveHs(to_rdkit(molecule)))


@pytest.mark.parametrize("kind", ["nitro", "trans double bond", "cis double bond", "phosphate"])
def test_the_sdf_has_orders_charges_stereo_and_the_order_given(tmp_path, kind):
    pose = posed(tmp_path, SMILES[kind])
    s = pc.load(PROTEIN, ligands=pose)
    moved = s.with_positions(s.positions + 0.1)
    pc.save_ligands(moved, tmp_path / "out.sdf")
    (made,) = Chem.SDMolSupplier(str(tmp_path / "out.sdf"), removeHs=False)
    given = Chem.MolFromMolFile(str(pose), removeHs=False)
    elements = [
        [each.GetSymbol() for each in mol.GetAtoms() if each.GetAtomicNum() > 1] for mol in (made, given)
    ]
    assert elements[0] == elements[1]
    assert Chem.MolToSmiles(Chem.RemoveHs(made)) == Chem.MolToSmiles(Chem.RemoveHs(given))
    # Hydrogens too are in the order of the file, moved by 1 angstrom.
    assert np.allclose(
        made.GetConformer().GetPositions(), given.GetConformer().GetPositions() + 1.0, atol=2e-4
    )
    assert made.GetProp("_Name").split()[0] == "LIG"


def shuffled(path, name, title="CMPD-0042", seed=3):
    """The same molecule with atoms in another order, hydrogens among them, a title and fields."""
    made = Chem.MolFromMolFile(str(path), removeHs=False)
    order = np.random.default_rng(seed).permutation(made.GetNumAtoms()).tolist()
    made = Chem.RenumberAtoms(made, order)
    made.SetProp("_Name", title)
    block = Chem.MolToMolBlock(made)
    out = path.with_name(name)
    out.write_text(f"{block}>  <IC50_nM>  (42)\n3.5\n\n> <note>\ntwo\nlines\n\n$$$$\n")
    return out


def as_read(path):
    (made,) = Chem.SDMolSupplier(str(path), removeHs=False)
    return made, made.GetConformer().GetPositions()


@pytest.mark.parametrize("kind", ["nitro", "cis double bond", "sulphone and alkyne"])
def test_the_sdf_has_title_fields_and_order_of_the_file(tmp_path, kind):
    pose = shuffled(posed(tmp_path, SMILES[kind]), "given.sdf")
    pc.save_ligands(pc.load(PROTEIN, ligands=pose), tmp_path / "out.sdf")
    (given, x), (made, y) = as_read(pose), as_read(tmp_path / "out.sdf")
    assert [a.GetSymbol() for a in made.GetAtoms()] == [a.GetSymbol() for a in given.GetAtoms()]
    assert np.allclose(x, y, atol=2e-4)
    assert made.GetProp("_Name") == "CMPD-0042"
    assert made.GetProp("IC50_nM") == "3.5" and made.GetProp("note") == "two\nlines"
    # Under the names of a model coordinates show which atom is which.
    pc.save(pc.load(PROTEIN, ligands=posed(tmp_path, SMILES[kind])), tmp_path / "model.cif")
    named = pc.load(tmp_path / "model.cif", ligands=[("LIG", str(pose))])
    pc.save_ligands(named, tmp_path / "named.sdf")
    made, y = as_read(tmp_path / "named.sdf")
    heavy = [a.GetIdx() for a in given.GetAtoms() if a.GetAtomicNum() > 1]
    assert np.allclose(np.sort(x[heavy], axis=0), np.sort(y[heavy], axis=0), atol=2e-4)
    # Equivalent atoms may change places: all bonds of the file are bonds here.
    assert [a.GetSymbol() for a in made.GetAtoms()] == [a.GetSymbol() for a in given.GetAtoms()]
    pairs = ({bond.GetBeginAtomIdx(), bond.GetEndAtomIdx()} for bond in given.GetBonds())
    assert all(made.GetBondBetweenAtoms(*pair) for pair in pairs)
    assert made.GetProp("_Name") == "CMPD-0042" and made.GetProp("IC50_nM") == "3.5"


def test_protons_that_the_ph_adds_come_last_and_those_it_removes_are_absent(tmp_path):
    pose = shuffled(posed(tmp_path, "OC(=O)[C@@H](C)CCN"), "given.sdf")
    pc.save_ligands(pc.load(PROTEIN, ligands=pose), tmp_path / "out.sdf")
    (given, x), (made, y) = as_read(pose), as_read(tmp_path / "out.sdf")
    acid = next(
        a for a in given.GetAtoms() if a.GetAtomicNum() == 1 and a.GetNeighbors()[0].GetAtomicNum() == 8
    )
    rest = np.delete(x, acid.GetIdx(), axis=0)
    assert len(y) == len(x) and np.allclose(rest, y[:-1], atol=2e-4)
    assert made.GetAtomWithIdx(len(y) - 1).GetNeighbors()[0].GetFormalCharge() == 1


def test_a_result_adds_fields_once(tmp_path):
    pose = shuffled(posed(tmp_path, SMILES["nitro"]), "given.sdf")
    first, again = tmp_path / "first.sdf", tmp_path / "again.sdf"
    for given, out in ((pose, first), (first, again)):
        result = pc.relax(PROTEIN, ligands=str(given), rigid_protein=True)
        pc.save_ligands(result, out)
    made, y = as_read(again)
    (end,), record = result.ligands_end, result.record()
    number = {
        key: float(made.GetProp(f"protochain_{key}"))
        for key in ("energy_kj_mol", "strain_kj_mol", "rmsd_angstrom")
    }
    assert number["energy_kj_mol"] == pytest.approx(result.energy_end, abs=1e-3)
    assert number["strain_kj_mol"] == pytest.approx(end.strain_kj_mol, abs=1e-3)
    before = as_read(first)[1]
    heavy = [a.GetIdx() for a in made.GetAtoms() if a.GetAtomicNum() > 1]
    moved = np.sqrt(((y - before)[heavy] ** 2).sum(axis=1).mean())
    assert number["rmsd_angstrom"] == pytest.approx(moved, abs=2e-3)
    assert made.GetProp("protochain_status") == record["status"] and made.GetProp("IC50_nM") == "3.5"
    assert again.read_text().count("protochain_energy_kj_mol") == 1 and made.GetProp("_Name") == "CMPD-0042"


def test_ligands_that_are_not_there_are_no_file(tmp_path):
    with expect_refusal("ligands", match="no ligand"):
        pc.save_ligands(pc.load(PROTEIN), tmp_path / "out.sdf")
    with pytest.raises(pc.ProtochainError, match="sdf"):
        pc.save_ligands(pc.load(PROTEIN), tmp_path / "out.mol2")
    assert not list(tmp_path.iterdir())


def test_commands_write_the_ligands(tmp_path, capsys):
    pose = posed(tmp_path, SMILES["phosphate"])
    saved, sdf = tmp_path / "saved.cif", tmp_path / "out.sdf"
    run(
        "minimise",
        "--max-evaluations",
        "30",
        PROTEIN,
        "--ligands",
        pose,
        "-o",
        saved,
        "--ligand-out",
        sdf,
        "--json",
    )
    record = json.loads(capsys.readouterr().out)
    assert record["ligands_written"] == str(sdf)
    (made,) = Chem.SDMolSupplier(str(sdf), removeHs=False)
    end = pc.load(saved)
    x = 10.0 * end.positions[end.ligands[0].atoms]
    assert np.abs(np.sort(x, axis=0) - np.sort(made.GetConformer().GetPositions(), axis=0)).max() < 2e-4


def test_a_protein_alone_has_no_sdf(tmp_path):
    said = refusal("relax", PROTEIN, "-o", tmp_path / "out.pdb", "--ligand-out", tmp_path / "out.sdf")
    assert "no ligand" in said
    said = refusal("relax", PROTEIN, "-o", tmp_path / "out.pdb", "--ligand-out", tmp_path / "out.mol2")
    assert ".sdf" in said
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "table",
    [
        {"kind": ["clockwise"], "atoms": ["C1 C2"]},
        {"comp_id": ["LIG"]},
        {"comp_id": ["LIG"], "kind": ["clockwise"], "atoms": ["C1"]},
        {"comp_id": ["LIG"] * 3, "kind": ["clockwise", "cis", ""], "atoms": ["", "C1 C1 C1 C1", "C1 " * 999]},
        {"comp_id": ["LIG"], "kind": ["clockwise"], "atoms": ["C1 C1 C1 C1 C1"]},
        {"comp_id": ["LIG"], "kind": ["trans"], "atoms": ["X Y Z W"]},
    ],
)
def test_a_table_of_stereo_that_makes_no_sense_is_nothing(tmp_path, table):
    s = pc.load(PROTEIN, ligands=posed(tmp_path, SMILES["single bonds"]))
    pc.save(s, tmp_path / "saved.cif")
    document = gemmi.cif.read(str(tmp_path / "saved.cif"))
    document.sole_block().find_mmcif_category("_protochain_ligand.").erase()
    document.sole_block().set_mmcif_category("_protochain_ligand.", table)
    document.write_file(str(tmp_path / "spoilt.cif"))
    again = pc.load(tmp_path / "spoilt.cif")
    assert of(again.ligands[0].ligand.molecule)[:2] == of(s.ligands[0].ligand.molecule)[:2]
    for suffix in (".cif", ".pdb"):
        pc.save(again, tmp_path / f"again{suffix}")
        assert len(pc.load(tmp_path / f"again{suffix}").ligands) == 1


def test_one_hydrogen_of_another_name_is_the_one_that_the_table_has():
    """Of two it cannot be said which; so the centre is of neither hand."""
    bonds = [(0, 1), (0, 2), (0, 3), (0, 4)]
    kinds = {
        kind: stereo([{"kind": kind, "atoms": "C F CL BR H"}], ["C", "F", "CL", "BR", "H"], bonds)
        for kind in ("clockwise", "counterclockwise")
    }
    assert kinds["clockwise"][0] == [1, 0, 0, 0, 0] and kinds["counterclockwise"][0] == [2, 0, 0, 0, 0]
    for kind, known in kinds.items():
        rows = [{"kind": kind, "atoms": "C F CL BR H"}]
        assert stereo(rows, ["C", "F", "CL", "BR", "HX"], bonds) == known
        assert stereo(rows, ["C", "F", "CL", "BRX", "HX"], bonds)[0] == [0] * 5
    swapped = [{"kind": "clockwise", "atoms": "C CL F BR H"}]
    assert stereo(swapped, ["C", "F", "CL", "BR", "HX"], bonds) == kinds["counterclockwise"]


@pytest.mark.parametrize("kind", ["disulfide-glutathione", "pyridoxal", "adenylyl-tyrosine", "nitrile"])
def test_the_sdf_has_a_ligand_that_is_bonded_to_the_protein(tmp_path, kind):
    """Its atoms, orders and charges in the bonded state, and the bond in a field."""
    case = covalent.KINDS[kind]
    path, product = covalent.written(tmp_path, case)
    result = pc.relax(path, keep="all")
    pc.save_ligands(result, tmp_path / "out.sdf")
    (made,) = Chem.SDMolSupplier(str(tmp_path / "out.sdf"), removeHs=False)
    ((i, a, j, b, _),) = case.bonds
    name = case.molecules[-1].removeprefix("=")
    mine = [each.GetIdx() for each in product.GetAtoms() if each.HasProp("of") and each.GetIntProp("of") == j]
    # The oracle: heavy atoms of the product that RDKit joined, and orders of the bonds between them.
    for each in (product, made):
        Chem.Kekulize(each, clearAromaticFlags=True)
    inside = [
        bond for bond in product.GetBonds() if {bond.GetBeginAtomIdx(), bond.GetEndAtomIdx()} <= {*mine}
    ]
    heavy = [each for each in made.GetAtoms() if each.GetAtomicNum() > 1]
    there = [each for each in made.GetBonds() if {each.GetBeginAtomIdx(), each.GetEndAtomIdx()} <= {
        each.GetIdx() for each in heavy
    }]  # fmt: skip
    assert sorted(each.GetSymbol() for each in heavy) == sorted(
        product.GetAtomWithIdx(k).GetSymbol() for k in mine
    )
    assert len(there) == len(inside)
    assert sum(each.GetBondTypeAsDouble() for each in there) == sum(
        each.GetBondTypeAsDouble() for each in inside
    )
    s = result.structure
    its = s.residue_name[s.atom_residue] == name
    assert made.GetNumAtoms() == its.sum() and made.GetNumAtoms() > len(mine)
    x = 10.0 * s.positions[its]
    y = made.GetConformer().GetPositions()
    assert np.abs(np.sort(x, axis=0) - np.sort(y, axis=0)).max() < 2e-4
    residue = case.molecules[0].split()[i]
    assert made.GetProp("protochain_bonds") == f"{a} of A:{residue}{i + 1} and {b}"
    assert float(made.GetProp("protochain_energy_kj_mol")) == pytest.approx(result.energy_end, abs=1e-3)
    assert float(made.GetProp("protochain_rmsd_angstrom")) > 0.0


def test_commands_write_a_ligand_that_is_bonded(tmp_path, capsys):
    path, _ = covalent.written(tmp_path, covalent.KINDS["disulfide-mercaptoethanol"])
    sdf = tmp_path / "out.sdf"
    for command, options in (("minimise", ("--max-evaluations", "5")), ("relax", ("--max-iterations", "3"))):
        run(command, path, *options, "-o", tmp_path / "out.pdb", "--ligand-out", sdf, "--json", "--force")
        record = json.loads(capsys.readouterr().out)
        (made,) = Chem.SDMolSupplier(str(sdf))
        assert made.GetProp("protochain_status") == record["status"]
        assert made.GetProp("protochain_residue") == "BME B 1"
        assert sorted(each.GetSymbol() for each in made.GetAtoms()) == ["C", "C", "O", "S"]
