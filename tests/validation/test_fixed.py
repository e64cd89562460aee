"""What stands still beside the protein: broken bonds and overlaps of nucleic acids and ligands are said."""

from dataclasses import replace

import gemmi
import numpy as np
import pytest
from fixtures.repairs import sentences
from fixtures.samples import STRUCTURES, load, shared, still

import protochain as pc
from protochain.validation.fixed import fixed_counts, fixed_faults


@pytest.fixture(scope="module")
def dodecamer():
    """B-DNA and, 12 angstrom from it, Trp-cage, as gemmi reads them; chains A, B and P."""
    made = gemmi.read_structure(str(shared("../complexes/models/1bna.pdb")))
    made.remove_waters()
    chain = gemmi.read_structure(str(STRUCTURES / "1l2y.pdb"))[0][0].clone()
    chain.name = "P"
    beside = max(each.atom.pos.x for each in made[0].all()) + 20.0
    moved(chain, (beside, 20.0, 20.0))
    made[0].add_chain(chain)
    made.setup_entities()
    return made


def moved(residues, by, atoms=()):
    """Move atoms of residues by angstrom, all or those named."""
    for residue in residues:
        for atom in residue:
            if not atoms or atom.name in atoms:
                atom.pos += gemmi.Position(*by)


def loaded(structure, folder, numbers=(), by=(0.0, 0.0, 0.0), atoms=(), chain="A"):
    """The prepared structure of a file, after some of its residues were moved."""
    made = structure.clone()
    moved([residue for residue in made[0][chain] if residue.seqid.num in numbers], by, atoms)
    made.make_mmcif_document().write_file(str(folder / "made.cif"))
    return still(pc.load(folder / "made.cif", keep="all"))


@pytest.mark.parametrize("name", ["1ysa.pdb", "5ugo.cif", "3ave.pdb"])
def test_crystal_structures_have_no_faults(name):
    """DNA, nucleotides with calcium, glycans, cofactors; hydrogens of these as they are placed."""
    s = pc.load(shared(f"../complexes/models/{name}"))
    faults = fixed_faults(s)
    assert s.kept.sum() > 50 and (len(faults.bonds), len(faults.clashes)) == (0, 0)
    assert faults.summary(s, s.positions) == ""


def test_nothing_fixed_has_no_faults(dodecamer, tmp_path):
    s = load("1l2y.pdb")
    assert fixed_faults(s).lines(s, s.positions) == [] and fixed_counts(s) == {}
    good = loaded(dodecamer, tmp_path)
    assert fixed_faults(good).summary(good, good.positions) == ""
    assert fixed_counts(good) == {"DC": 8, "DG": 8, "DA": 4, "DT": 4}


def test_a_bond_within_a_nucleotide_is_known_by_its_name(dodecamer, tmp_path):
    """By distance it would only not be there."""
    s = loaded(dodecamer, tmp_path, [5], (0.0, 0.0, 1.5), ["C5'", "O5'", "P", "OP1", "OP2"])
    (pair,) = fixed_faults(s).bonds
    assert {*s.atom_name[pair].tolist()} == {"C4'", "C5'"}
    found = pc.validate(s)
    assert found.measures["fixed_broken_bonds"] == 1 and "1 broken bonds outside the protein" in repr(found)
    assert any(line.startswith("A:DA5: C5' to C4' broken (2.39") for line in found.listing())


def test_a_torn_strand_keeps_its_phosphate_and_is_said(dodecamer, tmp_path):
    """Numbers go on: it was taken for two strands, and lost the second one's phosphate."""
    s = loaded(dodecamer, tmp_path, range(7, 13), (0.0, 0.0, -5.0))
    assert not any("phosphate" in line and "residue 7 " in line for line in sentences(s))
    ((i, j),) = [
        pair for pair in fixed_faults(s).bonds.tolist() if {*s.atom_name[pair].tolist()} == {"O3'", "P"}
    ]
    assert np.linalg.norm(s.positions[i] - s.positions[j]) > 0.25
    assert sorted(s.residue_number[s.atom_residue[[i, j]]].tolist()) == ["6", "7"]


def test_molecules_in_one_place_are_counted(dodecamer, tmp_path):
    """Nothing that stands still feels another such molecule."""
    s = loaded(dodecamer, tmp_path, range(13, 25), (3.0, 0.0, 0.0), chain="B")
    clashes = fixed_faults(s).clashes
    assert len(clashes) > 3 and s.obstacle[clashes].all()
    x = s.positions
    assert (np.linalg.norm(x[clashes[:, 0]] - x[clashes[:, 1]], axis=1) < 0.22).all()
    taking_turns = s.occupancy.copy()
    taking_turns[s.obstacle] = 0.5
    assert not len(fixed_faults(replace(s, occupancy=taking_turns)).clashes)


def test_a_ligand_in_pieces_is_said():
    """Its bonds are known by distance: what is torn off is not bonded, and shows by that."""
    s = still(pc.load(shared("../complexes/models/1a0i.cif")))
    x, torn = s.positions.copy(), ["PG", "O1G", "O2G", "O3G"]
    assert not len(fixed_faults(s).bonds)
    x[s.obstacle & np.isin(s.atom_name, torn)] += 0.15
    stretched = fixed_faults(s, x).bonds
    assert [{*s.atom_name[pair].tolist()} for pair in stretched] == [{"PG", "O3B"}]


def test_a_ligand_whose_file_has_it_in_pieces_is_torn_where_they_are_nearest(tmp_path):
    """No bond is read between the pieces; ATP's phosphate is nearer to no other atom than to the last."""
    made = gemmi.read_structure(str(shared("../complexes/models/1a0i.cif")))
    (atp,) = (residue for chain in made[0] for residue in chain if residue.name == "ATP")
    at = {atom.name: np.array(atom.pos.tolist()) for atom in atp}
    away = (at["PG"] - at["O3B"]) / np.linalg.norm(at["PG"] - at["O3B"])
    moved([atp], 2.0 * away, ["PG", "O1G", "O2G", "O3G"])
    made.make_mmcif_document().write_file(str(tmp_path / "torn.cif"))
    s = still(pc.load(tmp_path / "torn.cif"))
    bonds = fixed_faults(s).bonds
    assert [{*s.atom_name[pair].tolist()} for pair in bonds] == [{"PG", "O3B"}] and s.obstacle[bonds].all()


def test_the_end_of_a_relaxation_says_what_is_fixed_and_broken(dodecamer, tmp_path):
    s = loaded(dodecamer, tmp_path, [5], (0.0, 0.0, 1.5), ["C5'", "O5'", "P", "OP1", "OP2"])
    r = pc.relax(s, threads=1)
    assert r.status == "violations" and r.measures_end["violations"] == 0
    at = "A:DA5"
    said = f"1 broken bond outside the protein: C5' of {at} and C4' of {at}, 2.39"
    assert r.message.startswith(f"violations: {said} angstrom apart; RMS force")
    assert r.message.endswith("; fixed, not relaxed: 8 DC, 8 DG, 4 DA, 4 DT")
    record = r.record()
    assert (record["fixed_broken_bonds_start"], record["fixed_broken_bonds_end"]) == (1, 1)
    assert record["fixed"] == {"DC": 8, "DG": 8, "DA": 4, "DT": 4}
    found = pc.minimise(s, pc.energy(s), "cartesian", max_evaluations=3)
    assert f"; {said}" in found.message
