"""Charges by NAGL's model: those of OpenFF NAGL, whatever the order of atoms and the drawing of bonds."""

import csv
from collections import defaultdict
from dataclasses import replace

import numpy as np
import pytest
from fixtures.samples import ROOT
from fixtures.tolerances import NAGL_CHARGE, TABULATED_CHARGE

import protochain as pc

pytest.importorskip("rdkit")
pytest.importorskip("biotite")
pytest.importorskip("dimorphite_dl")

from rdkit import Chem
from rdkit.Chem.MolStandardize import rdMolStandardize

from protochain.ligands import nagl, sources
from protochain.ligands.molecule import to_rdkit

COMPLEXES = ROOT.parent / "shared" / "complexes"
CHARGES = {
    "CO": (
        0.116673, -0.5988, 0.02855, 0.02855, 0.02855, 0.396477,
    ),
    "O=CO": (
        -0.54613, 0.632395, -0.61543, 0.086415, 0.44275,
    ),
    "C[NH+]=C(N)N": (
        0.002268, -0.389102, 0.527144, -0.507603, -0.507603, 0.078908, 0.078908, 0.078908, 0.321809,
        0.329091, 0.329091, 0.329091, 0.329091,
    ),
    "COP(=O)([O-])OP(=O)([O-])[O-]": (
        0.212274, -0.618638, 1.580185, -0.926353, -0.926353, -0.797022, 1.423316, -0.961168, -0.961168,
        -0.961168, -0.021301, -0.021301, -0.021301,
    ),
    "O=[N+]([O-])c1ccc([O-])cc1": (
        -0.27802, 0.311295, -0.27802, -0.369808, -0.019891, -0.332875, 0.575684, -0.729424, -0.332875,
        -0.019891, 0.122851, 0.114061, 0.114061, 0.122851,
    ),
    "CN(C)C=CC=[N+](C)C": (
        0.12925, -0.53388, 0.12925, 0.268315, -0.371188, 0.268315, -0.53388, 0.12925, 0.12925, 0.079629,
        0.079629, 0.079629, 0.079629, 0.079629, 0.079629, 0.121367, 0.187032, 0.121367, 0.079629, 0.079629,
        0.079629, 0.079629, 0.079629, 0.079629,
    ),
    "NS(=O)(=O)c1ccc(Br)s1": (
        -1.030833, 1.556516, -0.653207, -0.653207, -0.47842, -0.025919, -0.14875, -0.108082, -0.004305,
        0.308359, 0.448295, 0.448295, 0.171668, 0.169589,
    ),
    "CS(C)=O": (
        -0.124549, 0.276542, -0.124549, -0.499865, 0.078737, 0.078737, 0.078737, 0.078737, 0.078737,
        0.078737,
    ),
    "CN=[N+]=[N-]": (
        0.10597, -0.389171, 0.199357, -0.057733, 0.047192, 0.047192, 0.047192,
    ),
    "Clc1ccc[n+]([O-])c1": (
        -0.07758, 0.069523, -0.173208, -0.079876, -0.205405, 0.548625, -0.522461, -0.209138, 0.150528,
        0.161177, 0.169983, 0.167832,
    ),
    "FC1CC1I": (
        -0.202296, 0.158273, -0.148989, -0.04598, -0.139114, 0.088195, 0.089347, 0.089347, 0.111217,
    ),
    "CC(=O)[S-]": (
        -0.143636, 0.691332, -0.737371, -0.855673, 0.015116, 0.015116, 0.015116,
    ),
}  # fmt: skip
"""e. Of openff-nagl 0.5.5 with torch and openff-nagl-models 2025.9.0; the first two are in its table."""
STRANGE = "OP(=O)(O)I"
"""A bond of phosphorus and iodine is outside the domain of the model, and in MMFF94 and Sage."""


def shuffled(molecule, seed):
    """The molecule with its atoms and bonds in another order, and where they are now."""
    random = np.random.default_rng(seed)
    order = random.permutation(molecule.n_atoms)
    now, bonds = np.argsort(order), random.permutation(len(molecule.bonds))
    double = molecule.double_bonds.copy()
    double[:, :4] = now[double[:, :4]]
    return replace(
        molecule,
        names=tuple(molecule.names[i] for i in order),
        elements=molecule.elements[order],
        formal_charges=molecule.formal_charges[order],
        bonds=now[molecule.bonds][bonds],
        orders=molecule.orders[bonds],
        handedness=0 * molecule.handedness,
        double_bonds=double,
        positions=None,
    ), now


@pytest.mark.parametrize("smiles", CHARGES)
def test_charges_are_those_of_openff(smiles):
    molecule = sources.read(smiles)
    tolerance = TABULATED_CHARGE if len(molecule.heavy) <= 3 else NAGL_CHARGE
    assert nagl.charges(molecule) == pytest.approx(CHARGES[smiles], abs=tolerance)
    assert nagl.outside(molecule) == ()


@pytest.mark.skipif(not COMPLEXES.exists(), reason="needs ../shared/complexes")
def test_charges_are_those_of_openff_for_all_74():
    expected = defaultdict(list)
    with (COMPLEXES / "nagl_charges.csv").open() as lines:
        for row in csv.DictReader(lines):
            expected[row["ligand"]].append(float(row["charge"]))
    assert len(expected) == 74
    for name, values in expected.items():
        molecule = sources.read(COMPLEXES / "ligands" / f"{name}.sdf")
        assert nagl.charges(molecule) == pytest.approx(values, abs=NAGL_CHARGE), name


@pytest.mark.parametrize("smiles", CHARGES)
def test_charges_do_not_depend_on_the_order_of_atoms(smiles):
    molecule = sources.read(smiles)
    for seed in range(3):
        other, now = shuffled(molecule, seed)
        assert np.array_equal(nagl.charges(other)[now], nagl.charges(molecule))


@pytest.mark.parametrize("smiles", CHARGES)
def test_atoms_alike_have_one_charge(smiles):
    molecule = sources.read(smiles)
    charges = nagl.charges(molecule)
    ranks = np.array(Chem.CanonicalRankAtoms(to_rdkit(molecule), breakTies=False))
    assert all(np.ptp(charges[ranks == rank]) == 0.0 for rank in ranks)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("CN(C)C=CC=[N+](C)C", "C[N+](C)=CC=CN(C)C"),
        ("CC(N)=[N+](C)C", "CC(=[NH2+])N(C)C"),
        ("CC1=C([O-])C(=C[NH+]=CC(=O)O)C=CN1", "CC1=[NH+]C=CC(=CNC=C(O)[O-])C1=O"),  # two moves at once
        ("C[n+]1ccc(N)cc1", "CN1C=CC(=[NH2+])C=C1"),
        ("[O-]c1ccncc1", "O=c1cc[n-]cc1"),
        ("CC(=O)C=C([O-])CC", "CC([O-])=CC(=O)CC"),
        ("CC(=S)C=C([S-])CC", "CC([S-])=CC(=S)CC"),
    ],
)
def test_drawings_of_one_molecule_have_one_set_of_charges(one, other):
    charges = [np.sort(nagl.charges(sources.read(each))) for each in (one, other)]
    assert np.array_equal(*charges)


@pytest.mark.parametrize(
    "drawn",
    [
        "CN(=O)=O", "C[S+2](C)([O-])[O-]", "C=N#N", "CS(C)=O", "CO[P+](C)([O-])[O-]", "C[C+](N)N(C)C",
        "CN(C)[P+](C)(C)N", "CNNC[N+]#N", "CC([O-])=[N+](C)C", "C[O+]=c1cccc[n-]1", "C[n+]1ccccc1[O-]",
        "C[N+](C)=CC=C[O-]", "[NH2+]=c1cc[n-]cc1", "C[n+]1ccc([O-])cc1", "CC(N)=[N+](C)C",
        "C[N+](C)=c1cccc[nH]1", "C[N+](C)=CC=CN", "C[N+](C)=c1cc[nH]cc1", "O=[Cl-]", "C[C+]=[N-]",
    ],
)  # fmt: skip
def test_each_rule_redraws_what_rdkits_own_normaliser_redraws(drawn):
    """A molecule for each, in their order, which no other rule redraws; azides and n-oxides have two."""
    made = Chem.MolFromSmiles(drawn, sanitize=False)
    Chem.SanitizeMol(made, Chem.SANITIZE_SETAROMATICITY | Chem.SANITIZE_SYMMRINGS)
    normalised = nagl._normalise(made), rdMolStandardize.Normalizer().normalize(made)
    for each in normalised:
        Chem.SanitizeMol(each, Chem.SANITIZE_SETAROMATICITY | Chem.SANITIZE_SYMMRINGS)
    ours, theirs, before = map(Chem.MolToSmiles, (*normalised, made))
    assert ours == theirs != before


def test_outside_the_domain_charges_are_those_of_mmff94():
    made, known = pc.ligand(STRANGE), pc.ligand(STRANGE, charges="mmff94")
    assert made.outside == ("P1", "I1") and known.outside == ()
    assert np.array_equal(made.parameters.charge, known.parameters.charge)
    assert pc.ligand(STRANGE, charges="gasteiger").outside == ()
