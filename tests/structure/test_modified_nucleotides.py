"""Modified nucleotides within strands and at their ends: their own chemistry, the rest Amber's."""

import gemmi
import numpy as np
import openmm
import pytest
from fixtures.modified import modified
from fixtures.oracles import assert_equals_reference
from fixtures.samples import STRUCTURES
from scipy.spatial.transform import Rotation

import protochain as pc
from protochain.energies.factory import build_system
from protochain.ligands.sources import from_dictionary
from protochain.structure.molecule.repairs import Kind

pytest.importorskip("rdkit")
pytest.importorskip("dimorphite_dl")

PYRIMIDINE, PURINE = ("C1'", "N1", "C6"), ("C1'", "N9", "C8")
MADE = {
    "inner": {("A", 3): ("5CM", PYRIMIDINE), ("A", 5): ("6MA", PURINE), ("B", 19): ("BRU", PYRIMIDINE)},
    "first": {("A", 1): ("5CM", PYRIMIDINE)},
    "neighbours": {("A", 4): ("8OG", PURINE), ("A", 5): ("6MA", PURINE), ("A", 6): ("6MA", PURINE)},
    "locked sugar": {("B", 16): ("LCG", ("C1'", "C3'", "C4'"))},
    "phosphorothioate": {("A", 3): ("SC", ("P", "O5'", "OP1")), ("A", 4): ("GS", ("P", "O5'", "OP1"))},
}


def made(name, tmp_path):
    """The duplex with modified nucleotides; that at the 5' end without a phosphate."""
    path = modified(STRUCTURES / "1bna.pdb", MADE[name], tmp_path)
    structure = gemmi.read_structure(str(path))
    for atom in ("P", "OP1", "OP2"):
        if structure[0]["A"][0].name != "DC":
            structure[0]["A"][0].remove_atom(atom, "\0")
    structure.write_pdb(str(path))
    return path


def charges(s, forcefield="amber14"):
    system = build_system(s, forcefield, "vacuum")
    (force,) = (each for each in system.getForces() if isinstance(each, openmm.NonbondedForce))
    return np.array([force.getParticleParameters(k)[0]._value for k in range(s.n_atoms)])


def by_place(s):
    """Charges by chain, number and name."""
    r = s.atom_residue
    places = zip(
        s.residue_chain[r].tolist(), map(int, s.residue_number[r]), s.atom_name.tolist(), strict=True
    )
    return dict(zip(places, charges(s), strict=True))


@pytest.mark.parametrize("name", ["first", "neighbours", "locked sugar", "phosphorothioate"])
def test_a_strand_with_modified_nucleotides_moves_as_one(name, tmp_path):
    s = pc.load(made(name, tmp_path))
    assert s.mobile.all() and not s.ties
    assert [each.kind for each in s.repairs].count(Kind.MODIFIED) == len(MADE[name])
    # 22 phosphates; nothing else here is charged at pH 7.
    assert charges(s).sum() == pytest.approx(-22.0, abs=1e-9)
    assert_equals_reference(pc.energy(s, engine="native"), s.positions)
    done = pc.minimise(s, method="hybrid", max_evaluations=30).structure
    for suffix in (".pdb", ".cif"):
        pc.save(done, tmp_path / f"out{suffix}")
        assert pc.load(tmp_path / f"out{suffix}").fingerprint == done.fingerprint


def test_what_is_not_changed_keeps_ambers_charges(tmp_path):
    plain, s = pc.load(STRUCTURES / "1bna.pdb"), pc.load(made("inner", tmp_path))
    changed = {(chain, number) for chain, number in MADE["inner"]}
    before, after = by_place(plain), by_place(s)
    kept = [
        at for at in after
        if at[:2] not in changed or ((at[2][-1] == "'" or "P" in at[2]) and at[2] not in ("C1'", "H1'"))
    ]  # fmt: skip
    assert len(kept) > 690
    assert [after[at] for at in kept] == [before[at] for at in kept]
    # Of modified bases the charges are those of a graph network, not those of the standard ones.
    assert abs(after["A", 5, "N6"] - before["A", 5, "N6"]) > 0.05


def test_a_modified_nucleotide_that_lacks_an_atom_stays_in_place_and_says_why(tmp_path):
    path = made("inner", tmp_path)
    path.write_text("".join(line for line in path.read_text().splitlines(True) if line[12:16] != " C5A"))
    s = pc.load(path)
    (stays,) = (each for each in s.repairs if each.kind is Kind.STAYS_UNKNOWN)
    assert "C5A" in str(stays) and s.obstacle.any() and s.ties
    assert {str(s.residue_name[r]) for r in s.atom_residue[s.obstacle]} == {"5CM"}
    assert_equals_reference(pc.energy(s, engine="native"), s.positions)


def test_a_base_that_bears_a_ligand_keeps_the_rest_of_ambers(tmp_path):
    """N4 of a cytosine with an acetyl of its own residue, as protecting groups and adducts are."""
    structure = gemmi.read_structure(str(STRUCTURES / "1bna.pdb"))
    structure.remove_waters()
    structure.remove_hydrogens()
    base = structure[0]["A"]["9"][0]
    at = {name: np.array(base[name][0].pos.tolist()) for name in ("N4", "C4", "C5")}
    out = (at["N4"] - at["C4"]) / np.linalg.norm(at["N4"] - at["C4"])
    aside = at["C5"] - at["C4"] - ((at["C5"] - at["C4"]) @ out) * out
    aside /= np.linalg.norm(aside)
    carbon = at["N4"] + 1.36 * (0.5 * out + 0.87 * aside)
    residue = gemmi.Residue()
    residue.name, residue.seqid, residue.het_flag = "Q-Q", gemmi.SeqId("1"), "H"
    for name, x in (
        ("C1", carbon),
        ("O1", carbon + 1.22 * (-0.5 * out + 0.87 * aside)),
        ("C2", carbon + 1.5 * out),
    ):
        atom = gemmi.Atom()
        atom.name, atom.element, atom.occ, atom.pos = name, gemmi.Element(name[0]), 1.0, gemmi.Position(*x)
        residue.add_atom(atom)
    chain = gemmi.Chain("L")
    chain.add_residue(residue)
    structure[0].add_chain(chain)
    bond = gemmi.Connection()
    bond.type, bond.name = gemmi.ConnectionType.Covale, "covale1"
    bond.partner1 = gemmi.AtomAddress("A", gemmi.SeqId("9"), "DC", "N4")
    bond.partner2 = gemmi.AtomAddress("L", gemmi.SeqId("1"), "Q-Q", "C1")
    structure.connections.append(bond)
    structure.write_pdb(str(tmp_path / "acetyl.pdb"))
    s = pc.load(tmp_path / "acetyl.pdb", ligands={"Q-Q": "CC(=O)O"})
    assert s.mobile.all() and len(s.fragments) == 1
    assert charges(s).sum() == pytest.approx(-22.0, abs=1e-9)
    assert_equals_reference(pc.energy(s, engine="native"), s.positions)
    before, after = by_place(pc.load(STRUCTURES / "1bna.pdb")), by_place(s)
    changed = {at for at in before if at not in after or before[at] != after[at]}
    assert changed == {("A", 9, name) for name in ("N4", "H41", "H42")}


def test_a_strand_that_a_tyrosine_holds_moves_with_it(tmp_path):
    """As topoisomerases hold DNA: the tyrosine's oxygen is where O3' of the nucleotide before was."""
    structure = gemmi.read_structure(str(STRUCTURES / "1bna.pdb"))
    structure.remove_waters()
    structure.remove_hydrogens()
    first = structure[0]["A"][0]
    oxygen, carbon = (np.array(first[name][0].pos.tolist()) for name in ("O3'", "C3'"))
    del structure[0]["A"][0]
    pc.save(pc.from_sequence("AAYAA"), tmp_path / "peptide.pdb")
    peptide = gemmi.read_structure(str(tmp_path / "peptide.pdb"))
    peptide.remove_hydrogens()
    chain = peptide[0]["A"]
    chain.name = "P"
    atoms = [atom for residue in chain for atom in residue]
    x = np.array([atom.pos.tolist() for atom in atoms])
    own, its = (np.array(chain["3"][0][name][0].pos.tolist()) for name in ("OH", "CZ"))
    axis = (carbon - oxygen) / np.linalg.norm(carbon - oxygen)
    x = Rotation.align_vectors([axis], [(its - own) / np.linalg.norm(its - own)])[0].apply(x - own)
    others = np.array([a.pos.tolist() for a in structure[0]["A"][0]])
    ways = [Rotation.from_rotvec(turn * axis).apply(x) + oxygen for turn in np.arange(0.0, 2.0 * np.pi, 0.1)]
    best = max(ways, key=lambda y: np.sort(np.linalg.norm(y[:, None] - others, axis=2).min(axis=1))[2])
    for atom, at in zip(atoms, best, strict=True):
        atom.pos = gemmi.Position(*at)
    structure[0].add_chain(chain)
    bond = gemmi.Connection()
    bond.type, bond.name = gemmi.ConnectionType.Covale, "covale1"
    bond.partner1 = gemmi.AtomAddress("P", gemmi.SeqId("3"), "TYR", "OH")
    bond.partner2 = gemmi.AtomAddress("A", gemmi.SeqId("2"), "DG", "P")
    structure.connections.append(bond)
    structure.write_pdb(str(tmp_path / "held.pdb"))
    s = pc.load(tmp_path / "held.pdb", keep="all")
    assert not s.ties and not s.obstacle.any() and len(s.links) == 1 and len(s.fragments) == 1
    # Eleven phosphates in each strand.
    assert charges(s).sum() == pytest.approx(-22.0, abs=1e-9)
    assert_equals_reference(pc.energy(s, engine="native"), s.positions)


@pytest.mark.parametrize("name", ["7MG", "G7M"])
def test_a_7_methylguanine_is_a_cation(name):
    """The dictionary draws one with a hydrogen in the place of its charge."""
    molecule = from_dictionary(name)
    charge = dict(zip(molecule.names, molecule.formal_charges.tolist(), strict=True))
    assert charge["N7"] == 1
    assert molecule.charge == 1
    (carbon,) = (k for k, each in enumerate(molecule.names) if each == "C8")
    assert sum(molecule.elements[molecule.bonds[(molecule.bonds == carbon).any(axis=1)]].ravel() == 1) == 1
