"""Charges of classes of acids and bases at a pH, against pKa measured in water (Serjeant and Dempsey 1979;
Perrin 1965, 1982; Prankerd 2007)."""

import numpy as np
import pytest

import protochain as pc
from protochain.ligands import protonation, sources
from protochain.ligands.molecule import from_rdkit, to_rdkit
from protochain.ligands.protonation import at_metal, at_ph, unsure

Chem = pytest.importorskip("rdkit.Chem")

NITRO = "[N+](=O)[O-]"


@pytest.mark.parametrize(
    ("smiles", "pka", "acid"),
    [
        ("Oc1ccccc1", 9.99, 0), ("Oc1ccc(C#N)cc1", 7.95, 0), (f"Oc1ccc({NITRO})cc1", 7.15, 0),
        (f"Oc1cccc({NITRO})c1", 8.4, 0), ("Oc1c(Cl)cccc1Cl", 6.79, 0),
        ("Oc1c(Cl)c(Cl)c(Cl)c(Cl)c1Cl", 4.7, 0), (f"Oc1cc({NITRO})cc({NITRO})c1", 6.7, 0),
        ("Oc1c(I)cc(C#N)cc1I", 4.0, 0), ("Oc1ccc(C=O)cc1", 7.6, 0), ("COc1cc(C=O)ccc1O", 7.4, 0),
        (f"Sc1ccc({NITRO})cc1", 4.7, 0), ("CC1(C)CC(=O)CC(=O)C1", 5.2, 0), ("CC1(C)OC(=O)CC(=O)O1", 4.8, 0),
        ("CC(=O)CC(C)=O", 8.9, 0), ("CCC1(CC)C(=O)NC(=O)NC1=O", 7.9, 0), ("ON1C(=O)CCC1=O", 6.0, 0),
        ("O=c1[nH]c(-c2ccccc2)no1", 6.1, 0), ("O=C1NC(=O)C(=Cc2ccccc2)S1", 6.4, 0),
        ("OP(=O)(O)C(F)F", 5.7, -1), ("CNC(=N)NP(=O)(O)O", 4.5, 0), ("COP(O)(O)=S", 5.4, -1),
        (f"CNC(=C{NITRO})NC", 2.7, 1), ("CN1CC(=O)NC1=N", 4.8, 1), ("NN", 8.1, 1),
        ("Nc1nc(N)c(-c2ccc(Cl)cc2)c(CC)n1", 7.3, 1),
    ],
)  # fmt: skip
def test_a_site_loses_the_proton_at_the_pka(smiles, pka, acid):
    """One unit and more below the measured pKa it has the proton, and as far above it lacks it."""
    molecule = sources.read(smiles)
    assert at_ph(molecule, pka - 1.3)[0].charge == acid
    assert at_ph(molecule, pka + 1.3)[0].charge == acid - 1


def test_an_enolate_is_drawn_with_the_charge_at_oxygen():
    enolate = at_ph(sources.read("O=C1CC(=O)NC(=O)N1"), 7.0)[0]
    assert enolate.elements[enolate.formal_charges == -1].tolist() == [8]
    assert len(pc.ligand("O=C1CC(=O)NC(=O)N1", ph=7.0).parameters.charge) == enolate.n_atoms


def test_what_no_rule_covers_is_reported():
    """Fluorouracil has 8.0, of a class with 6.5 +- 0.6; acids of narrow classes are certain."""
    assert unsure(sources.read("Cc1occc(=O)c1O"), 7.0) == ("O3",)
    assert pc.ligand("Cc1occc(=O)c1O", ph=7.0).unsure and not pc.ligand("Cc1occc(=O)c1O").unsure
    for smiles in ("CC(=O)O", "CCN", f"Oc1ccc({NITRO})cc1", "CN1CC(=O)NC1=N"):
        assert unsure(sources.read(smiles), 7.0) == ()


def test_patterns_are_valid_and_have_sources():
    assert all(protonation._query(smarts) for smarts, _ in protonation._SIGMA)
    assert all(protonation._query(rule.smarts) and rule.source[-1] == "]" for rule in protonation.RULES)


@pytest.mark.parametrize("pair", ["COP(=O)([S-])OC COP(=S)([O-])OC", "COP(=S)([S-])OC COP(=S)([S-])OC"])
def test_thiophosphates_are_one_anion_in_both_drawings(pair):
    """Bonds of P and S are as long as in crystals (1.94 to 1.98 angstrom)."""
    first, second = map(pc.ligand, pair.split())
    for made in (first, second):
        at = made.molecule.elements[made.parameters.bonds.atoms]
        lengths = 10.0 * made.parameters.bonds.parameters[(np.sort(at) == [15, 16]).all(axis=1), 0]
        assert len(lengths) and np.allclose(lengths, 1.95, atol=0.05)
    charges = [np.sort(made.parameters.charge) for made in (first, second)]
    assert np.allclose(*charges, atol=1e-9)


@pytest.mark.parametrize("smiles", ["F[P-](F)(F)(F)(F)F", "FP(F)(F)(F)F", "FS(F)(F)(F)(F)c1ccccc1"])
def test_five_and_six_neighbours_are_refused(smiles):
    with pytest.raises(pc.ProtochainError, match="neighbours"):
        pc.ligand(smiles)


@pytest.mark.parametrize("smiles", ["c1n[nH]cn1", "Cc1nn[nH]n1", "c1c[nH]nn1"])
def test_a_metal_moves_the_proton_of_an_azole_to_the_same_nitrogen_in_every_order_of_atoms(smiles):
    bare = Chem.MolFromSmiles(smiles)
    bearing = next(a.GetIdx() for a in bare.GetAtoms() if a.GetSymbol() == "N" and a.GetTotalNumHs())
    states = set()
    for seed in range(6):
        order = np.random.default_rng(seed).permutation(bare.GetNumAtoms()).tolist()
        molecule = from_rdkit(Chem.AddHs(Chem.RenumberAtoms(bare, order)), "test")
        state, _ = at_metal(molecule, [order.index(bearing)])
        drawn = Chem.Mol(to_rdkit(state))
        drawn.GetAtomWithIdx(order.index(bearing)).SetIsotope(15)
        states.add(Chem.MolToSmiles(Chem.RemoveHs(drawn)))
    assert len(states) == 1 and "[15n]" in states.pop()


def test_an_azole_whose_nitrogens_all_hold_metals_loses_its_proton():
    molecule = sources.read("c1c[nH]cn1")
    nitrogens = [k for k, element in enumerate(molecule.elements) if element == 7]
    one, _ = at_metal(molecule, nitrogens[:1])
    both, _ = at_metal(molecule, nitrogens)
    assert (one.formal_charges.sum(), both.formal_charges.sum()) == (0, -1)
