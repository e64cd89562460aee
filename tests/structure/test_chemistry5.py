"""Chemistry of small molecules that public structures have: each line of a manifest of such cases."""

import csv

import numpy as np
import pytest
from fixtures.refusals import expect_refusal
from fixtures.samples import ROOT

import protochain as pc
from protochain.core.errors import ForceFieldError
from protochain.ligands import sources
from protochain.ligands.protonation import at_ph

FOLDER = ROOT.parent / "shared" / "cases" / "chemistry5"


def rows(name):
    path = FOLDER / name
    if not path.exists():
        return []
    with path.open() as lines:
        return list(csv.DictReader(lines, delimiter="\t"))


pytestmark = pytest.mark.skipif(not FOLDER.exists(), reason="needs ../shared/cases/chemistry5")


@pytest.mark.parametrize("row", rows("charges.tsv"), ids=lambda row: row["name"])
def test_charges_at_ph_7(row):
    assert at_ph(sources.read(row["smiles"]), 7.0)[0].charge == int(row["must"])


def distances(s, x, first, second):
    """Distances of all pairs of atoms with these names, angstrom."""
    one, other = (10.0 * x[np.isin(s.atom_name, names)] for names in (first, second))
    return np.linalg.norm(one[:, None] - other, axis=-1)


def test_phosphorothioates_of_a_strand():
    result = pc.relax(FOLDER / "dna_phosphorothioate.cif", keep="all")
    apart = distances(result.start, result.x, ["P"], ["S2P"])
    assert np.allclose(apart[apart < 2.5], 1.95, atol=0.05) and (apart < 2.5).sum() == 2


def test_six_neighbours_are_refused():
    with expect_refusal("forcefield", kind=ForceFieldError, match="6 neighbours"):
        pc.ligand(FOLDER / "pf6.sdf")


def test_molybdate_has_the_charges_of_the_dictionary():
    s = pc.load(FOLDER / "molybdate.cif", keep="all")
    assert s.formal_charge.sum() == -2 and any("Dictionary, -2" in str(each) for each in s.repairs)


def test_hydrogens_of_a_water_point_away_from_zinc():
    result = pc.relax(FOLDER / "zn_his3_water.pdb", keep="all")
    s, x = result.start, 10.0 * result.x
    water = [np.flatnonzero((s.residue_name[s.atom_residue] == "HOH") & (s.atom_element == e)) for e in "OH"]
    (oxygen,), hydrogens = water
    zinc = x[s.atom_name == "ZN"][0]
    for h in hydrogens:
        u, v = zinc - x[oxygen], x[h] - x[oxygen]
        angle = np.degrees(np.arccos(u @ v / np.linalg.norm(u) / np.linalg.norm(v)))
        assert 110.0 < angle < 135.0


def test_sdf_in_sdf_out_has_the_order_of_hydrogens(tmp_path):
    from rdkit import Chem

    source = FOLDER / "order_of_hydrogens.sdf"
    s = pc.load(ROOT / "structures" / "1l2y.pdb", ligands=str(source))
    pc.save_ligands(s, tmp_path / "out.sdf")
    given, made = (Chem.MolFromMolFile(str(path), removeHs=False) for path in (source, tmp_path / "out.sdf"))
    x, y = (each.GetConformer().GetPositions() for each in (given, made))
    assert np.allclose(x, y, atol=2e-4)
