"""Small molecules: their chemistry from each source, their parameters, and what is refused."""

import csv
import re
from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import openmm
import pytest
from fixtures.refusals import expect_refusal
from fixtures.samples import ROOT, STRUCTURES
from fixtures.tolerances import NAGL_COULOMB

import protochain as pc

pytest.importorskip("rdkit")
pytest.importorskip("biotite")
pytest.importorskip("dimorphite_dl")

from rdkit.Chem import AddHs, MolFromSmiles
from rdkit.Chem.rdDistGeom import EmbedMolecule

from protochain.core.graph import neighbours
from protochain.ligands import matching, molecule, protonation, smirnoff, sources
from protochain.ligands.molecule import from_rdkit, to_rdkit
from protochain.ligands.protonation import at_ph
from protochain.structure import ligand_files

COMPLEXES = ROOT.parent / "shared" / "complexes"
KJ_MOL = 1e-6
"""Of the oracle's ten digits."""
TERMS = {
    "1P2Y_NCT": (5.890382313, 25.16669124, 50.37128858, 37.32178428, -17.11451648),
    "1N2J_PAF": (14.29148391, 9.046005779, 18.01814654, 47.68739406, 322.9680027),
    "1MEH_MOA": (45.15037238, 49.81081641, 69.86623456, 33.22971687, -203.473102),
}
"""MMFF94 charges, Sage 2.2.1: of the Open Force Field toolkit 0.18, interchange 0.5, OpenMM's Reference."""
BY_DEFAULT = {
    "1P2Y_NCT": (3.379473350, 40.67481304, 53.53835041, 43.98869036, -100.4495149),
    "1N2J_PAF": (17.84406260, 9.175586721, 6.433687828, 47.27504277, 312.6972054),
    "1MEH_MOA": (57.16190160, 76.21068828, 66.05277898, 35.70683857, -355.6716587),
}
"""The same of Sage 2.3.0 and NAGL's charges, by openff-nagl 0.5.5."""
BOND_NM = 0.16
"""Longer than a bond of carbons, shorter than their distance across a bond."""
RULES_AGREE = 0.97
"""Of the table of net charges, what rules give without it."""
NAMES = ("bonds", "angles", "torsions", "lj", "coulomb")


def file(name):
    return STRUCTURES / f"{name}.sdf"


@pytest.mark.parametrize("name", TERMS)
def test_terms_are_those_of_the_toolkit(name):
    found = pc.ligand(file(name), charges="mmff94").terms()
    assert tuple(found) == NAMES
    assert list(found.values()) == pytest.approx(TERMS[name], abs=KJ_MOL, rel=0)
    found = pc.ligand(file(name)).terms()
    assert list(found.values())[:4] == pytest.approx(BY_DEFAULT[name][:4], abs=KJ_MOL, rel=0)
    assert found["coulomb"] == pytest.approx(BY_DEFAULT[name][4], abs=NAGL_COULOMB)


def test_a_force_field_of_the_package_is_taken_by_its_name():
    named = [
        pc.ligand("CCO", "mmff94", each.name).parameters for each in (smirnoff.SAGE_2_2, smirnoff.SAGE_2_3)
    ]
    default = [pc.ligand("CCO", each).parameters for each in ("mmff94", "nagl")]
    for one, other in zip(named, default, strict=True):
        assert np.array_equal(one.bonds.parameters, other.bonds.parameters)
    assert not np.array_equal(default[0].bonds.parameters, default[1].bonds.parameters)


def test_names_stay_unique_if_the_model_uses_a_name_of_a_hydrogen():
    """The carbon is H1 in the model, and H1X is another hydrogen's name already."""
    methanol = replace(sources.read("CO"), names=("C1", "O1", "H1", "H1X", "H3", "H4"))
    renamed = matching.copy_names(
        methanol, [6, 8], ("H1", "O1"), np.array([[0.0, 0.0, 0.0], [0.143, 0.0, 0.0]])
    )
    assert renamed.names[:2] == ("H1", "O1") and len({*renamed.names}) == 6


@pytest.mark.skipif(not COMPLEXES.exists(), reason="needs ../shared/complexes")
def test_terms_are_those_of_the_toolkit_for_all_74():
    with (COMPLEXES / "terms.csv").open() as lines:
        rows = list(csv.DictReader(lines))
    assert len(rows) == 74
    for row in rows:
        made = pc.ligand(COMPLEXES / "ligands" / f"{row['ligand']}.sdf", charges="mmff94")
        assert (made.molecule.n_atoms, made.molecule.charge) == (int(row["n_atoms"]), int(row["charge"]))
        for name, value in made.terms().items():
            assert value == pytest.approx(float(row[name]), abs=KJ_MOL, rel=0), (row["ligand"], name)


def system_of(parameters):
    """The same energy as an OpenMM System, a force group for each of its terms."""
    bonds, angles = openmm.HarmonicBondForce(), openmm.HarmonicAngleForce()
    torsions, pairs = openmm.PeriodicTorsionForce(), openmm.NonbondedForce()
    system = openmm.System()
    for charge, sigma, epsilon in zip(parameters.charge, parameters.sigma, parameters.epsilon, strict=True):
        system.addParticle(1.0)
        pairs.addParticle(charge, sigma, epsilon)
    for atoms, row in zip(parameters.bonds.atoms.tolist(), parameters.bonds.parameters, strict=True):
        bonds.addBond(*atoms, *row)
    for atoms, row in zip(parameters.angles.atoms.tolist(), parameters.angles.parameters, strict=True):
        angles.addAngle(*atoms, *row)
    for atoms, (n, *row) in zip(
        parameters.torsions.atoms.tolist(), parameters.torsions.parameters, strict=True
    ):
        torsions.addTorsion(*atoms, int(n), *row)
    pairs.createExceptionsFromBonds(
        parameters.bonds.atoms.tolist(), parameters.scale_coulomb, parameters.scale_lj
    )
    for group, force in enumerate((bonds, angles, torsions, pairs)):
        force.setForceGroup(group)
        system.addForce(force)
    return system


@pytest.mark.parametrize("name", TERMS)
def test_terms_are_those_of_openmm(name):
    made = pc.ligand(file(name))
    context = openmm.Context(
        system_of(made.parameters), openmm.VerletIntegrator(0.001), openmm.Platform.getPlatform("Reference")
    )
    context.setPositions(made.molecule.positions)
    parts = [context.getState(getEnergy=True, groups={g}).getPotentialEnergy()._value for g in range(4)]
    found = made.terms()
    expected = [found["bonds"], found["angles"], found["torsions"], found["lj"] + found["coulomb"]]
    assert parts == pytest.approx(expected, abs=1e-8)


def test_the_last_rule_that_fits_wins(tmp_path):
    """A longer bond for all C-C, told last, is taken; told first, it is not."""
    text = smirnoff.SAGE_2_3.read_text()
    spring = "1 * kilocalories_per_mole/angstrom**2"
    rule = f'<Bond smirks="[#6:1]-[#6:2]" id="x" length="2 * angstroms" k="{spring}"/>'
    start = re.search("<Bonds [^>]*>", text)[0]
    for place, told in (("first", (start, start + rule)), ("last", ("</Bonds>", rule + "</Bonds>"))):
        (tmp_path / f"{place}.offxml").write_text(text.replace(*told))
    ethane = [
        pc.ligand("CC", forcefield=path).parameters.bonds.parameters[0]
        for path in (None, tmp_path / "first.offxml", tmp_path / "last.offxml")
    ]
    assert np.array_equal(ethane[0], ethane[1])
    assert ethane[2] == pytest.approx([0.2, 418.4])


def test_an_improper_is_shared_among_three():
    """Formaldehyde: one centre, Sage's i1 with a third of its barrier each, the oxygen once last."""
    made = pc.ligand("C=O", "mmff94").parameters.torsions
    assert made.atoms[:, 0].tolist() == [0, 0, 0] and sorted(made.atoms[:, 3].tolist()) == [1, 2, 3]
    assert made.parameters == pytest.approx(np.tile([2, np.pi, 5.300125669502 * 4.184 / 3], (3, 1)))


def test_charges_by_rule_and_from_files(tmp_path):
    nicotine = pc.ligand(file("1P2Y_NCT"))
    assert nicotine.parameters.charge.sum() == pytest.approx(0.0, abs=1e-12)
    other = pc.ligand(file("1P2Y_NCT"), charges="gasteiger").parameters.charge
    assert np.abs(other - nicotine.parameters.charge).max() > 0.1
    names, charges = nicotine.molecule.names, nicotine.parameters.charge
    table = tmp_path / "charges.txt"
    lines = [f"{name} {charge!r}\n" for name, charge in zip(names, charges.tolist(), strict=True)]
    table.write_text("".join(reversed(lines)))
    assert pc.ligand(file("1P2Y_NCT"), charges=str(table)).terms() == pytest.approx(nicotine.terms())
    for text, said in (
        ("".join(lines[:-1]), f"has 25 charges for the 26 atoms .* give also {names[-1]}"),
        ("".join(lines[:-1]) + f"{names[-1]} nan", "sum to nan, not to 0"),
        ("".join(lines[:-1]) + f"{names[-1]} 5", "not to 0, the formal charge"),
        ("a b c\n", "give lines of an atom's name and its charge"),
    ):
        table.write_text(text)
        with pytest.raises(pc.ProtochainError, match=said):
            pc.ligand(file("1P2Y_NCT"), charges=str(table))


def as_mol2(molecule, charges, order):
    """A MOL2 file of a molecule's atoms in an order, named A1 on in that order."""
    chem = pytest.importorskip("rdkit.Chem")
    place, table = {k: n + 1 for n, k in enumerate(order)}, chem.GetPeriodicTable()
    symbols = [table.GetElementSymbol(int(z)) for z in molecule.elements]
    places = [" ".join(f"{10 * each:.4f}" for each in x) for x in molecule.positions]
    atoms = [f"{n} A{n} {places[k]} {symbols[k]} 1 X {charges[k]:.6f}" for k, n in place.items()]
    bonds = [
        f"{k} {place[i]} {place[j]} {order}"
        for k, ((i, j), order) in enumerate(zip(molecule.bonds.tolist(), molecule.orders, strict=True), 1)
    ]
    head = ["@<TRIPOS>MOLECULE", "x", f"{len(atoms)} {len(bonds)} 1 0 0", "SMALL", "USER_CHARGES"]
    return "\n".join([*head, "@<TRIPOS>ATOM", *atoms, "@<TRIPOS>BOND", *bonds, ""])


def test_charges_of_a_mol2_file_are_in_the_order_of_its_atoms(tmp_path):
    of, table = pc.ligand(file("1P2Y_NCT")).molecule, tmp_path / "charges.mol2"
    charges = np.random.default_rng(0).normal(size=of.n_atoms)
    charges = np.round(charges - charges.mean(), 6)
    charges[0] -= charges.sum()
    table.write_text(as_mol2(of, charges, range(of.n_atoms)))
    found = pc.ligand(file("1P2Y_NCT"), charges=str(table)).parameters.charge
    assert found == pytest.approx(charges, abs=2e-6)
    table.write_text(as_mol2(of, charges, [*range(1, of.n_atoms), 0]))
    with pytest.raises(pc.ProtochainError, match=r"has 26 charges for the 26 atoms of .*; give also"):
        pc.ligand(file("1P2Y_NCT"), charges=str(table))


WATER = """@<TRIPOS>MOLECULE
water
3 2 1 0 0
SMALL
USER_CHARGES
@<TRIPOS>ATOM
1 OW 0.0000 0.0000 0.0000 O.3 1 HOH -0.8340
2 HW 0.9572 0.0000 0.0000 H 1 HOH 0.4170
3 HX -0.2400 0.9266 0.0000 H 1 HOH 0.4170
@<TRIPOS>BOND
1 1 2 1
2 1 3 1
"""


def test_a_mol2_file_has_names_and_charges(tmp_path):
    path = tmp_path / "water.mol2"
    path.write_text(WATER)
    made = sources.read(path)
    assert made.names == ("OW", "HW", "HX") and made.orders.tolist() == [1, 1]
    assert made.positions[1] == pytest.approx([0.09572, 0.0, 0.0])
    with expect_refusal("forcefield", match="fits H"):
        pc.ligand(path)


def test_stereo_is_kept_as_data():
    for smiles, stereo in (
        ("C[C@H](N)C(=O)O", (("C2", "S"),)),
        ("C[C@@H](N)C(=O)O", (("C2", "R"),)),
        ("C/C=C/C", (("C2=C3", "E"),)),
        ("C/C=C\\C", (("C2=C3", "Z"),)),
        ("COP(=O)(O)OC", ()),
    ):
        made = sources.read(smiles)
        assert made.stereo == stereo and from_rdkit(to_rdkit(made), "again").stereo == stereo
    assert sources.from_dictionary("ATP").stereo == (("C4'", "R"), ("C3'", "S"), ("C2'", "R"), ("C1'", "R"))


def embedded(smiles):
    made = AddHs(MolFromSmiles(smiles))
    assert EmbedMolecule(made, randomSeed=1) == 0
    return from_rdkit(made, "model")


@pytest.mark.parametrize(
    "smiles", ["C[C@H](N)C(=O)O", "C[C@@H](N)C(=O)O", "CC[C@](F)(Cl)Br", "CC[C@@](F)(Cl)Br"]
)
def test_a_flat_stereocentre_is_inverted_on_whichever_side_it_lies(smiles):
    source = embedded(smiles)
    (centre,) = np.flatnonzero(source.handedness)
    near = [i for i in neighbours(source.bonds, source.n_atoms)[centre] if source.elements[i] != 1][:3]
    normal = np.cross(*(source.positions[i] - source.positions[near[0]] for i in near[1:]))
    for side in (-1e-4, 1e-4):
        x = source.positions.copy()
        x[centre] = x[near].mean(0) + side * normal / np.linalg.norm(normal)
        assert matching.inverted_atoms(source, x[source.heavy]) == [(centre,)]
    assert matching.inverted_atoms(source, source.positions[source.heavy]) == []
    upon = np.repeat(source.positions[source.heavy][:1], len(source.heavy), axis=0)
    with np.errstate(all="raise"):
        assert matching.inverted_atoms(source, upon) == [
            (each,) for each in np.flatnonzero(source.handedness)
        ]


def test_hydrogens_that_a_carbon_lacks_make_another_molecule_and_no_charge():
    ethanol = embedded("CCO")
    first, _, oxygen = ethanol.heavy.tolist()
    assert protonation.with_hydrogens(ethanol, {first: 2}) is None
    assert protonation.with_hydrogens(ethanol, {first: 4}) is None
    assert protonation.with_hydrogens(ethanol, {first: 3, oxygen: 0}).charge == -1


@pytest.mark.parametrize("name", TERMS)
def test_a_model_is_matched_by_its_graph_and_its_stereo_compared(name):
    """Atoms in another order and by other names; of a mirror image all centres are inverted, but no bond."""
    source = sources.read(file(name))
    order = np.random.default_rng(1).permutation(source.heavy)
    names = tuple(f"X{i}" for i in range(len(order)))
    x = source.positions[order]
    found = matching.place_on_model(source, source.elements[order], names, x)
    assert found.inverted == () and sorted(found.atoms[source.heavy]) == list(range(len(order)))
    inside = np.isin(source.bonds, source.heavy).all(1)
    now = order[found.atoms[source.bonds[inside]]]
    assert {*map(frozenset, now.tolist())} == {*map(frozenset, source.bonds[inside].tolist())}
    # Ends of a carboxylate may change places.
    lengths = [
        np.linalg.norm(np.subtract(*source.positions[ends.T]), axis=1) for ends in (now, source.bonds[inside])
    ]
    weighted = [float(source.orders[inside] @ each) for each in lengths]
    assert weighted[0] <= weighted[1] + 1e-12
    mirrored = matching.place_on_model(source, source.elements[order], names, x * [1, 1, -1])
    centres = [each for each, _ in source.stereo if "=" not in each]
    at = dict(zip(mirrored.molecule.names, source.names, strict=True))
    assert [at[each] for each in mirrored.inverted] == centres


def test_double_bonds_of_a_model_are_where_they_are_short():
    """SMILES have no coordinates: ends of phosphates would fit in several ways."""
    model = sources.from_dictionary("ATP")
    heavy = model.heavy
    smiles = "Nc1ncnc2c1ncn2[C@@H]1O[C@H](COP(=O)(O)OP(=O)(O)OP(=O)(O)O)[C@@H](O)[C@H]1O"
    given = sources.read(smiles)
    found = matching.place_on_model(
        given, model.elements[heavy], tuple(np.array(model.names)[heavy]), model.positions[heavy]
    )
    assert found.inverted == () and "C1'" in found.molecule.names
    other = sources.read(smiles.replace("[C@@H]1O[C", "[C@H]1O[C"))
    found = matching.place_on_model(
        other, model.elements[heavy], tuple(np.array(model.names)[heavy]), model.positions[heavy]
    )
    assert found.inverted == ("C1'",)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("CC(=O)Oc1ccc(N)cc1", r"both are C8NO2, but bonded otherwise \(it lacks bonds: 1 of CO\)"),
        ("CC(=O)NC1CCC(O)CC1", "fits the model badly: bonds of the ring"),
        ("CC(=O)Nc1ccccc1", "C8NO2, not C8NO"),
        ("CC(=O)Nc1ccc(OC)cc1", "the model has C8NO2 of C9NO2; add what is missing"),
    ],
)
def test_what_differs_between_model_and_molecule_is_named(given, said):
    model = embedded("CC(=O)Nc1ccc(O)cc1")
    with pytest.raises(pc.ProtochainError, match=said) as refused:
        matching.place_on_model(sources.read(given), model.elements, model.names, model.positions)
    assert "\n" not in str(refused.value)


def test_hydrogens_of_the_model_tell_tautomers_apart():
    """The heavy atoms of a carboxylic acid, of equal lengths: the oxygen with hydrogen is the hydroxyl."""
    acid = sources.read("CC(=O)O")
    x = np.array([[-0.15, 0.0, 0.0], [0.0, 0.0, 0.0], [0.06, 0.11, 0.0], [0.06, -0.11, 0.0]])
    for count in ([3, 0, 0, 1], [3, 0, 1, 0]):
        found = matching.place_on_model(acid, [6, 6, 8, 8], ("A", "B", "C", "D"), x, count)
        hydroxyl = found.molecule.names[acid.names.index("O2")]
        assert hydroxyl == "ABCD"[count.index(1)]


def test_another_molecule_is_refused():
    source, other = sources.read(file("1P2Y_NCT")), sources.read(file("1N2J_PAF"))
    with pytest.raises(pc.ProtochainError, match="another molecule than the model has: C6O4, not C10N2"):
        matching.place_on_model(source, other.elements, other.names, other.positions)
    oxygens = np.where(source.elements == 7, 8, source.elements)
    with pytest.raises(pc.ProtochainError, match="another molecule than the model has: C10O2, not C10N2"):
        matching.place_on_model(source, oxygens, source.names, source.positions, by_name=True)


@pytest.mark.parametrize(
    ("smiles", "ph", "charges"),
    [
        ("CC(=O)O", 7.4, {"O2": -1}),
        ("CC(=O)O", 2.0, {}),
        ("CC(=O)[O-]", 2.0, {"O2": 0}),
        ("CCCN", 7.4, {"N1": 1}),
        ("CCCN", 12.0, {}),
        ("OC(=O)CCN", 7.4, {"O1": -1, "N1": 1}),
        ("Oc1ccc(F)cc1", 7.4, {}),
        ("O=c1cccc[nH]1", 7.4, {}),
        ("COP(=O)(O)O", 7.4, {"O3": -1, "O4": -1}),
        ("CC(=O)NC", 7.4, {}),
        ("C[N+](=O)[O-]", 7.4, {}),
        ("O=c1[nH]c(=O)c2[nH]c(=O)[nH]c2[nH]1", 7.4, {"N4": -1}),
    ],
)
def test_acids_and_bases_are_charged_at_a_ph(smiles, ph, charges):
    before = sources.read(smiles)
    after, changed = at_ph(before, ph)
    assert {each.atom: each.after for each in changed} == charges
    gained = sum(each.after - each.before for each in changed)
    assert after.charge == before.charge + gained and after.n_atoms == before.n_atoms + gained


@pytest.mark.parametrize(
    ("smiles", "charge"),
    [
        ("SC#N", -1), ("CN1CCN(C)CC1", 1), ("OC(=O)CN(CC(=O)O)CCN(CC(=O)O)CC(=O)O", -3), ("NCCNCCN", 2),
        ("NCCCN", 2), ("CP(=O)(O)OP(=O)(O)O", -3), ("COP(=O)(O)NP(=O)(O)O", -3), ("COP(=O)(O)OP(=S)(O)O", -3),
        ("OP(=O)(O)OP(=O)(O)O", -3), ("CN1C=CCC(C(N)=O)=C1", 0), ("CN(C)C(=N)NC(=N)N", 1),
        ("Nc1c2ccccc2nc2ccccc12", 1), ("Cc1cc(NS(=O)(=O)c2ccccc2)no1", -1), ("CC(=O)NN", 0), ("CC(=O)NO", 0),
        ("CNO", 0), ("COP(=O)(O)NC", -1), ("OC(=O)O", -1),
    ],
)  # fmt: skip
def test_rules_mend_what_the_table_of_sites_has_not(smiles, charge):
    assert at_ph(sources.read(smiles), 7.0)[0].charge == charge


def test_the_table_of_net_charges_decides_and_rules_alone_give_almost_all(monkeypatch):
    rows = protonation._rows("net_charges.csv")[::4]
    with_table = [at_ph(sources.read(row["smiles"]), 7.0)[0].charge for row in rows]
    assert with_table == [int(row["charge"]) for row in rows]
    monkeypatch.setattr(protonation, "net_charges", dict)
    alone = [at_ph(sources.read(row["smiles"]), 7.0)[0].charge for row in rows]
    assert np.mean(np.equal(alone, with_table)) >= RULES_AGREE


@pytest.mark.slow
def test_all_of_the_table_of_net_charges_can_be_reached(monkeypatch):
    rows = protonation._rows("net_charges.csv")
    molecules = [sources.read(row["smiles"]) for row in rows]
    assert [protonation.skeleton(each) for each in molecules] == [row["skeleton"] for row in rows]
    assert len({row["skeleton"] for row in rows}) == len(rows)
    wanted = [int(row["charge"]) for row in rows]
    assert [at_ph(each, 7.0)[0].charge for each in molecules] == wanted
    monkeypatch.setattr(protonation, "net_charges", dict)
    assert (
        np.mean([at_ph(m, 7.0)[0].charge == q for m, q in zip(molecules, wanted, strict=True)]) >= RULES_AGREE
    )


def test_a_charge_that_is_known_moves_the_weakest_site():
    """MES: dimorphite-dl has one pKa for all tertiary amines, and would charge its morpholine."""
    acid = sources.read("O=S(=O)(O)CCN1CCOCC1")
    assert at_ph(acid, 7.0)[0].charge == -1 and at_ph(acid, 4.0)[0].charge == 0


def test_hydrogens_that_stay_are_where_they_were():
    before = sources.read(file("1MEH_MOA"))
    after, changed = at_ph(before, 7.4)
    assert [each.after for each in changed] == [-1] and after.stereo == before.stereo
    kept = [before.names.index(name) for name in after.names]
    assert np.array_equal(after.positions, before.positions[kept])


HEADER = """data_x
loop_
_chem_comp_bond.comp_id
_chem_comp_bond.atom_id_1
_chem_comp_bond.atom_id_2
_chem_comp_bond.value_order
01 CA CB sing
01 CB OX {order}
01 CB OY sing
01 OY HY sing
"""
ATOMS = {"CA": ("C", 0), "CB": ("C", 0), "OX": ("O", 0), "OY": ("O", -1)}


def test_chemistry_comes_from_the_first_source_that_has_it():
    header = HEADER.format(order="doub")
    acetate = sources.of_residue("01", header, ATOMS)
    assert acetate.names[:4] == ("CA", "CB", "OX", "OY") and acetate.n_atoms == 7 and acetate.charge == -1
    assert sources.of_residue("01", header, ATOMS, "CC").n_atoms == 8
    assert sources.of_residue("GOL", header).n_atoms == 14
    with pytest.raises(pc.ProtochainError, match="01 of the file's bonds: has bonds of an unknown order"):
        sources.of_residue("01", HEADER.format(order="odd"), ATOMS)
    with expect_refusal("ligands", match="'01'"):
        sources.of_residue("01")


def test_names_of_a_component_on_other_atoms_do_not_bond_these():
    """Programs number atoms anew; of a distorted molecule its own names decide."""
    its = sources.from_dictionary("BEN")
    heavy, x = its.heavy, its.positions[its.heavy].copy()
    own = [its.names[i] for i in heavy]
    carbons = [k for k, name in enumerate(own) if name[0] == "C"]
    names = list(own)
    for k, other in zip(carbons, np.roll(carbons, 2), strict=True):
        names[k] = own[other]
    made = matching.place_on_model(its, its.elements[heavy], tuple(names), x, by_name=True).molecule
    ends = made.positions[made.bonds[(made.elements[made.bonds] != 1).all(1)]]
    assert np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1).max() < BOND_NM
    x[carbons[0]] += 0.1
    found = matching.place_on_model(its, its.elements[heavy], tuple(own), x, by_name=True)
    assert found.atoms[heavy].tolist() == [*range(len(heavy))]


NITROGEN = """data_x
loop_
_chem_comp_bond.comp_id
_chem_comp_bond.atom_id_1
_chem_comp_bond.atom_id_2
_chem_comp_bond.value_order
01 C N sing
{bonds}
"""


@pytest.mark.parametrize(
    ("bonds", "charges"),
    [
        ("01 N H1 sing\n01 N H2 sing\n01 N H3 sing", {"N": 1}),
        ("01 N C2 sing\n01 N C3 sing\n01 N C4 sing", {"N": 1}),
        ("01 N O1 doub\n01 N O2 sing", {"N": 1, "O2": -1}),
        ("01 N H1 sing\n01 N H2 sing", {}),
    ],
)
def test_a_nitrogen_of_four_bonds_is_charged_where_a_table_has_no_charges(bonds, charges):
    names = {"C", "N", *(name for row in bonds.split("\n") for name in row.split()[1:3])}
    made = sources.of_residue(
        "01", NITROGEN.format(bonds=bonds), {name: (name[0], 0) for name in sorted(names)}
    )
    there = dict(zip(made.names, made.formal_charges.tolist(), strict=True))
    assert {name: charge for name, charge in there.items() if charge} == charges


@pytest.mark.parametrize(
    ("bonds", "atoms"),
    [
        (("C1 C2", "C1 O1"), "C1 C2 O1"),
        (("C1 C2",), "C1 C2 C3 O1 O2 O3"),
        (("C1 C3", "C3 C2", "C1 O1"), "C1 C2 C3 O1"),
    ],
    ids=["atoms missing", "bonds missing", "another molecule"],
)
def test_a_table_of_a_part_is_not_the_chemistry_of_a_component(bonds, atoms):
    header = NITROGEN.format(bonds="\n".join(f"GOL {pair} sing" for pair in bonds))
    found = sources.of_residue("GOL", header, {name: (name[0], 0) for name in atoms.split()})
    assert ("dictionary" in found.source.lower()) == ("C1 C3" not in bonds)


def test_a_molecule_of_a_file_with_several_is_given_by_its_number(tmp_path):
    text, path = "".join(file(name).read_text() for name in ("1P2Y_NCT", "1MEH_MOA")), tmp_path / "poses.sdf"
    path.write_text(text)
    assert ligand_files.poses(path) == [f"{path}#1", f"{path}#2"] and ligand_files.has_poses(str(path))
    for number, name in enumerate(("1P2Y_NCT", "1MEH_MOA"), 1):
        made, alone = sources.read(f"{path}#{number}"), sources.read(file(name))
        assert made.source == f"{path}#{number}" and np.array_equal(made.positions, alone.positions)
        assert ligand_files.poses(file(name)) == [str(file(name))]
    with pytest.raises(pc.ProtochainError, match=r"has 2 molecules; give .* as .*poses.sdf#1"):
        sources.read(path)
    with pytest.raises(pc.ProtochainError, match=r"poses.sdf: has 2 molecules"):
        sources.read(f"{path}#3")


def test_a_mol2_file_with_several_molecules_has_each_by_its_number(tmp_path):
    of = pc.ligand(file("1P2Y_NCT")).molecule
    charges, path = np.zeros(of.n_atoms), tmp_path / "poses.mol2"
    text = as_mol2(of, charges, range(of.n_atoms))
    moved = as_mol2(replace(of, positions=of.positions + 1.0), charges, range(of.n_atoms))
    path.write_text(text + moved)
    assert ligand_files.poses(path) == [f"{path}#1", f"{path}#2"] and ligand_files.has_poses(str(path))
    first, second = (sources.read(f"{path}#{number}").positions for number in (1, 2))
    assert np.allclose(second - first, 1.0) and np.allclose(first, of.positions, atol=1e-5)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("notsmiles(", "is neither SMILES nor the name of a file"),
        ("missing.sdf", "missing.sdf: cannot be read"),
        ("C.C", "has 2 molecules; give one"),
        ("[CH2]C", "atom C1 lacks a bond or a charge"),
        ("CCB(O)O", "has no vdW for B1"),
        ("[Zn+2]", "has no vdW for Zn1"),
        ("C[Hg]C", "has no vdW for Hg1"),
        ("[Na+]", "LibraryCharges .* fits Na1"),
    ],
)
def test_what_has_no_sense_or_no_parameters_is_refused_by_name(given, said):
    with pytest.raises(pc.ProtochainError, match=said) as refused:
        pc.ligand(given)
    assert "\n" not in str(refused.value)


def test_bad_files_are_refused_in_one_line(tmp_path):
    text, path = file("1P2Y_NCT").read_text(), tmp_path / "bad.sdf"
    for bad, said in (
        (text + text, "has 2 molecules"),
        ("", "has 0 molecules"),
        (text.replace("   14.5300", "       nan"), "not finite|can be read"),
        (text.replace("   14.5300", "200000.000"), "beyond 100000 angstrom"),
        ("some text\n", "can be read"),
        (text.replace(" N   0", " Xq  0"), "can be read|no molecule"),
    ):
        path.write_text(bad)
        with pytest.raises(pc.ProtochainError, match=said) as refused:
            pc.ligand(path)
        assert "bad.sdf" in str(refused.value) and "\n" not in str(refused.value)
    with expect_refusal("x", match="in space"):
        pc.ligand("CCO").terms()


@pytest.mark.parametrize(("other", "is_the_same"), [("0.00", True), ("0.5", False), ("none", False)])
def test_a_scale_is_compared_as_a_number(other, is_the_same, tmp_path):
    path = tmp_path / "scaled.offxml"
    path.write_text(smirnoff.SAGE_2_2.read_text().replace('scale13="0.0"', f'scale13="{other}"'))
    with nullcontext() if is_the_same else pytest.raises(pc.ProtochainError, match=f"scale13 .* '{other}'"):
        pc.ligand("CC", forcefield=path)


def test_force_fields_and_molecules_beyond_measure_are_refused(tmp_path, monkeypatch):
    for of, name, least, said in (
        (smirnoff, "_LARGEST", 10, "is too large for a force field; give an .offxml file"),
        (smirnoff, "_MOST_MATCHES", 2, "fits 'CCO' too often; make it more specific"),
        (molecule, "_MOST_ATOMS", 2, "'CCO': has 3 atoms; give a small molecule"),
        (sources, "_LARGEST", 10, "is too large for molecules; split it"),
    ):
        with monkeypatch.context() as patch, pytest.raises(pc.ProtochainError, match=said):
            patch.setattr(of, name, least)
            pc.ligand(file("1P2Y_NCT") if of is sources else "CCO", forcefield=smirnoff.SAGE_2_2)
    with pytest.raises(pc.ProtochainError, match=r"cannot be read .*give an .offxml file"):
        pc.ligand("CCO", forcefield=tmp_path / "nowhere.offxml")


def test_bad_force_fields_are_refused_in_one_line(tmp_path):
    text, path = smirnoff.SAGE_2_2.read_text(), tmp_path / "bad.offxml"
    entity = '<!DOCTYPE x [<!ENTITY a "a">]>'
    for bad, said in (
        ("no xml", "is no XML"),
        (entity + "<SMIRNOFF/>", "has a DOCTYPE"),
        ("<ForceField/>", "is no SMIRNOFF force field"),
        ('<SMIRNOFF version="0.3"/>', "has no vdW parameters"),
        (text.replace("1.533682189836 * angstrom ** 1", "__import__('os')"), "length of <Bond> b1"),
        (text.replace("1.533682189836 * angstrom", "1.5 * furlong"), "unit 'furlong' is unknown"),
        (text.replace("1.533682189836 * angstrom ** 1", "1.5 * angstrom ** 2"), "another dimension"),
        (text.replace("1.533682189836 * angstrom ** 1", "1e999 * angstrom"), "another dimension or no size"),
        (text.replace('"[#6X4:1]-[#6X4:2]"', '"[#6X4:1"', 1), "is no SMIRKS pattern"),
        (text.replace('"[#6X4:1]-[#6X4:2]"', '"[#6X4:1]-[#6X4]"', 1), "is no SMIRKS pattern of 2 atoms"),
        (text.replace('idivf1="1.0"', 'idivf1="0.0"', 1), "has a strange idivf"),
        (text.replace('periodicity1="3"', 'periodicity1="2.5"', 1), "has a strange idivf or periodicity"),
        (text.replace("OEAroModel_MDL", "Daylight"), "aromaticity_model"),
        (text.replace("Lorentz-Berthelot", "geometric"), "combining_rules"),
        (text.replace('rmin_half="', 'rmin_half="-'), "<Atom> n1 has a negative radius or well"),
        (text.replace('epsilon="', 'epsilon="-'), "<Atom> n1 has a negative radius or well"),
    ):
        path.write_text(bad)
        with pytest.raises(pc.ProtochainError, match=said) as refused:
            pc.ligand("CC", forcefield=path)
        assert "bad.offxml" in str(refused.value) and "\n" not in str(refused.value)


def test_without_the_extra_one_line_says_how_to_get_it(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "rdkit.Chem", None)
    with pytest.raises(pc.ProtochainError, match=re.escape('pip install "protochain[ligands]"')):
        pc.ligand("CCO")


def test_an_atom_that_is_not_there_inverts_nothing():
    """Nor does it warn: an amino acid of which an atom, as that of a cap, is at NaN."""
    made = sources.from_dictionary("ALA")
    x = np.random.default_rng(1).normal(size=(len(made.heavy), 3))
    x[made.names.index("CB")] = np.nan
    assert np.flatnonzero(made.handedness).size == 1 and matching.inverted_atoms(made, x) == []


def test_an_amide_that_ends_a_chain_is_no_radical():
    assert sources.from_dictionary("NH2").names[0] == "N"
    with pytest.raises(pc.ProtochainError, match="NO of the Chemical Component Dictionary: is a radical"):
        sources.from_dictionary("NO")
