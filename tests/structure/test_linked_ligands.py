"""Ligands of several residues, given by users, or with several bonds to a chain: one molecule."""

from functools import partial

import gemmi
import numpy as np
import openmm
import pytest
from fixtures.modified import component
from fixtures.oracles import assert_equals_reference
from fixtures.refusals import expect_refusal
from fixtures.tolerances import READ_AGAIN
from scipy.spatial.transform import Rotation

import protochain as pc
from protochain.energies.factory import build_system
from protochain.structure.molecule.repairs import Kind

chem = pytest.importorskip("rdkit.Chem")
distances = pytest.importorskip("rdkit.Chem.AllChem")
pytest.importorskip("dimorphite_dl")

PARACETAMOL = "CC(=O)Nc1ccc(O)cc1"
PERFLUOROBENZENE = "Fc1c(F)c(F)c(F)c(F)c1F"


def embedded(smiles):
    """Elements and positions (angstrom) of the heavy atoms of a molecule, in the order of SMILES."""
    made = chem.AddHs(chem.MolFromSmiles(smiles))
    distances.EmbedMolecule(made, randomSeed=7)
    distances.MMFFOptimizeMolecule(made)
    heavy = [a.GetIdx() for a in made.GetAtoms() if a.GetAtomicNum() > 1]
    return [made.GetAtomWithIdx(i).GetSymbol() for i in heavy], made.GetConformer().GetPositions()[heavy]


def written(tmp_path, sequence, ligands, bonds, gone=()):
    """A peptide with residues beside it, as names and rows of atom, element, position; LINK records."""
    pc.save(pc.from_sequence(sequence), tmp_path / "plain.pdb")
    structure = gemmi.read_structure(str(tmp_path / "plain.pdb"))
    structure.remove_hydrogens()
    for place in gone:
        del structure[0]["A"][place]
    chain = gemmi.Chain("L")
    for number, (name, rows) in enumerate(ligands, 1):
        residue = gemmi.Residue()
        residue.name, residue.seqid, residue.het_flag = name, gemmi.SeqId(str(number)), "H"
        for called, element, x in rows:
            atom = gemmi.Atom()
            atom.name, atom.element, atom.occ = called, gemmi.Element(element), 1.0
            atom.pos = gemmi.Position(*x)
            residue.add_atom(atom)
        chain.add_residue(residue)
    structure[0].add_chain(chain)
    for k, ends in enumerate(bonds):
        bond = gemmi.Connection()
        bond.type, bond.name = gemmi.ConnectionType.Covale, f"covale{k}"
        bond.partner1, bond.partner2 = (
            gemmi.AtomAddress(of, gemmi.SeqId(str(number)), name, atom) for of, number, name, atom in ends
        )
        structure.connections.append(bond)
    path = tmp_path / f"{'-'.join(name for name, _ in ligands)}.pdb"
    structure.write_pdb(str(path))
    return path


def sulphurs(sequence, tmp_path):
    """CB and SG of the cysteines of a peptide, angstrom, and all its other heavy atoms."""
    s = pc.from_sequence(sequence)
    x, name = 10.0 * s.positions, s.atom_name
    is_end = np.isin(name, ["CB", "SG"]) & (s.residue_name[s.atom_residue] == "CYS")
    return x[is_end & (name == "CB")], x[is_end & (name == "SG")], x[~is_end & (s.atom_element != "H")]


def turned(x, axis, at, others):
    """Positions turned about an axis through a point to where the others are farthest."""
    ways = (Rotation.from_rotvec(a * axis).apply(x - at) + at for a in np.arange(0.0, 2.0 * np.pi, 0.1))
    return max(ways, key=lambda y: float(np.linalg.norm(y[:, None] - others, axis=2).min()))


def thioether(tmp_path):
    """Cysteine that bears CH2-CO-NH-CH3, drawn without hydrogens."""
    symbols, x = embedded("CSCC(=O)NC")
    (beta,), (sulphur,), others = sulphurs("AACAA", tmp_path)
    axis = (sulphur - beta) / np.linalg.norm(sulphur - beta)
    turn = Rotation.align_vectors([axis], [(x[1] - x[0]) / np.linalg.norm(x[1] - x[0])])[0]
    x = turned(turn.apply(x - x[1]) + sulphur, axis, sulphur, others)[2:]
    rows = list(zip(("CA9", "C8", "O7", "N6", "C5"), symbols[2:], x, strict=True))
    return written(tmp_path, "AACAA", [("Q-Q", rows)], [(("A", 3, "CYS", "SG"), ("L", 1, "Q-Q", "CA9"))])


def staple(tmp_path):
    """Two cysteines that tetrafluorobenzene joins."""
    symbols, x = embedded("Sc1c(F)c(F)c(S)c(F)c1F")
    _, (first, second), others = sulphurs("ACACA", tmp_path)
    axis = (second - first) / np.linalg.norm(second - first)
    ends = [k for k, symbol in enumerate(symbols) if symbol == "S"]
    own = x[ends[1]] - x[ends[0]]
    x = Rotation.align_vectors([axis], [own / np.linalg.norm(own)])[0].apply(x - x[ends].mean(axis=0))
    x = turned(x + (first + second) / 2, axis, (first + second) / 2, others)
    kept = [k for k in range(len(x)) if k not in ends]
    names = {k: f"{symbols[k]}{k}" for k in kept}
    rows = [(names[k], symbols[k], x[k]) for k in kept]
    carbons = [k for k in kept if symbols[k] == "C"]
    bonds = []
    for number, at in ((2, first), (4, second)):
        nearest = min(carbons, key=lambda k: np.linalg.norm(x[k] - at))
        bonds.append((("A", number, "CYS", "SG"), ("L", 1, "Q-Q", names[nearest])))
    return written(tmp_path, "ACACA", [("Q-Q", rows)], bonds)


def chromophore(tmp_path):
    """A chain that goes on through the chromophore of GFP, as which two of its residues are."""
    x = {name: at for name, at in component("CRO").items() if name != "OXT"}
    s = pc.from_sequence("AAAAAA")
    at = {(int(s.atom_residue[k]), str(s.atom_name[k])): 10.0 * s.positions[k] for k in range(s.n_atoms)}
    before, after = at[1, "C"], at[4, "N"]
    axis, own = (after - before) / np.linalg.norm(after - before), x["C3"] - x["N1"]
    turn = Rotation.align_vectors([axis], [own / np.linalg.norm(own)])[0]
    middle = (x["N1"] + x["C3"]) / 2
    moved = turn.apply(np.array([*x.values()]) - middle) + (before + after) / 2
    others = np.array([y for (residue, name), y in at.items() if residue not in (2, 3) and name[0] != "H"])
    rows = [(name, name[0], y) for name, y in zip(x, turned(moved, axis, before, others), strict=True)]
    bonds = [(("A", 2, "ALA", "C"), ("L", 1, "CRO", "N1")), (("L", 1, "CRO", "C3"), ("A", 5, "ALA", "N"))]
    return written(tmp_path, "AAAAAA", [("CRO", rows)], bonds, gone=(3, 2))


def charge(s):
    system = build_system(s, "amber14", "vacuum")
    (force,) = (each for each in system.getForces() if isinstance(each, openmm.NonbondedForce))
    return sum(force.getParticleParameters(k)[0]._value for k in range(s.n_atoms))


def gone(s):
    return {each for repair in s.repairs if repair.kind is Kind.LINKED for each in repair.facts["gone"]}


def test_a_ligand_of_two_residues_is_the_molecule_that_one_residue_is(tmp_path):
    symbols, x = embedded(PARACETAMOL)
    rows = [
        (f"{symbol}{k}", symbol, at + np.array([0.0, 0.0, 12.0]))
        for k, (symbol, at) in enumerate(zip(symbols, x, strict=True))
    ]
    one = pc.load(written(tmp_path, "AAAAAA", [("Q-Q", rows)], []), ligands={"Q-Q": PARACETAMOL})
    bonds = [(("L", 1, "Q-R", "C1"), ("L", 2, "Q-S", "N3"))]
    two = written(tmp_path, "AAAAAA", [("Q-R", rows[:3]), ("Q-S", rows[3:])], bonds)
    # The acid has an oxygen more than the amide that it becomes.
    two = pc.load(two, ligands={"Q-R": "CC(=O)O", "Q-S": "Nc1ccc(O)cc1"})
    assert two.n_atoms == one.n_atoms and len(two.fragments) == 1 and not two.ligands
    assert two.mobile.sum() == one.mobile.sum() == 20 and any("of Q-R" in each for each in gone(two))
    near = np.linalg.norm(one.positions[:, None] - two.positions, axis=2).argmin(axis=0)
    assert len({*near.tolist()}) == one.n_atoms
    expected = pc.energy(one)(one.positions)[0]
    assert pc.energy(two)(one.positions[near])[0] == pytest.approx(expected, abs=1e-4)
    assert_equals_reference(pc.energy(two, engine="native"), two.positions)


def test_what_users_draw_with_or_without_what_leaves_is_one_adduct(tmp_path):
    path = thioether(tmp_path)
    drawn = ("CC(=O)NC", "ClCC(=O)NC", "CNC(=O)COS(=O)(=O)C")
    sdf = tmp_path / "drawn.sdf"
    sdf.write_text(chem.MolToMolBlock(chem.MolFromSmiles(drawn[1])))
    found = [pc.load(path, ligands={"Q-Q": each}) for each in (*drawn, sdf)]
    energies = [pc.energy(s)(s.positions)[0] for s in found]
    assert energies == pytest.approx([energies[0]] * 4, abs=1e-6)
    assert {"Cl" in str(gone(s)) for s in found[1::2]} == {True} and "Cl" not in str(gone(found[0]))
    assert all(not s.ties and not s.obstacle.any() and abs(charge(s)) < 1e-9 for s in found)
    with pytest.raises(pc.ProtochainError, match="missing or unknown"):
        pc.load(path, ligands={"Q-Q": "CNC(=O)CC"})  # A carbon more than the file has.


@pytest.mark.parametrize(
    ("made", "ligands", "bonds", "length"),
    [
        (thioether, {"Q-Q": "ClCC(=O)NC"}, 1, 0.181),
        (staple, {"Q-Q": PERFLUOROBENZENE}, 2, 0.177),
        (chromophore, {}, 2, 0.135),
    ],
)
def test_bonds_of_a_ligand_are_kept_and_read_again(tmp_path, made, ligands, bonds, length):
    load = partial(pc.load, ligands=ligands)
    s = load(made(tmp_path))
    assert not s.ties and not s.obstacle.any() and len(s.links) == bonds and len(s.fragments) == 1
    assert abs(charge(s)) < 1e-9
    assert_equals_reference(pc.energy(s, engine="native"), s.positions)
    relaxed = pc.relax(s)
    for i, j in s.links.tolist():
        assert np.linalg.norm(relaxed.x[i] - relaxed.x[j]) == pytest.approx(length, abs=0.01)
    assert Kind.GAP not in {each.kind for each in s.repairs}
    for suffix in (".pdb", ".cif"):
        relaxed.save(tmp_path / f"out{suffix}")
        again = load(tmp_path / f"out{suffix}")
        # A ring with two equal sides may be matched either way round: another order of the same parameters.
        assert made is staple or again.fingerprint == relaxed.structure.fingerprint
        assert again.bonds.tolist() == relaxed.structure.bonds.tolist()
        energies = [pc.energy(each)(relaxed.x)[0] for each in (again, relaxed.structure)]
        assert energies[0] == pytest.approx(energies[1], rel=READ_AGAIN)


def at_amine(tmp_path, number, ends, name, rows):
    """AAKAA with a component where its amine has a hydrogen; atoms along and behind that bond, angstrom."""
    s = pc.from_sequence("AAKAA")
    its = s.atom_residue == number - 1
    before, n, hydrogen = (10.0 * s.positions[its & (s.atom_name == end)][0] for end in ends)
    along, back = (x / np.linalg.norm(x) for x in (hydrogen - n, n - before))
    placed = [(each, each[0], n + a * along + b * back) for each, a, b in rows]
    residue = s.residue_name[number - 1]
    bond = ("A", number, residue, ends[1]), ("L", 1, name, rows[0][0])
    return written(tmp_path, "AAKAA", [(name, placed)], [bond])


def test_an_alkyl_at_the_first_nitrogen_leaves_an_ammonium_with_all_its_terms(tmp_path):
    rows = [("C1", 1.47, 0.0), ("C2", 1.47, 1.52), ("O2", 2.9, 1.52)]
    s = pc.load(at_amine(tmp_path, 1, ("CA", "N", "H1"), "EDO", rows))
    (told,) = (each for each in s.repairs if each.kind is Kind.LINKED)
    assert told.facts["gone"] == ("O1 of EDO",) and charge(s) == pytest.approx(1.0)
    energy, n = pc.energy(s), int(np.flatnonzero(s.atom_name == "N")[0])
    angles = (f for f in energy.system.getForces() if isinstance(f, openmm.HarmonicAngleForce))
    assert sum(f.getAngleParameters(k)[1] == n for f in angles for k in range(f.getNumAngles())) == 6
    pc.save(s, tmp_path / "again.cif")
    assert pc.load(tmp_path / "again.cif").fingerprint == s.fingerprint


def test_a_term_of_an_atom_that_the_structure_lacks_is_refused(tmp_path):
    s = pc.load(at_amine(tmp_path, 1, ("CA", "N", "H1"), "FMT", [("C", 1.35, 0.0), ("O1", 1.35, 1.23)]))
    (made,) = s.fragments
    lacking = np.where(np.array(made.ligand.molecule.names) == "ALA:H", -1, made.atoms)
    object.__setattr__(made, "atoms", lacking)
    with expect_refusal("standard_residues", match="between residues"):
        build_system(s, "amber14", "vacuum")


def test_an_acetyl_is_a_cap_only_where_a_chain_ends(tmp_path):
    rows = [("C", 1.35, 0.0), ("O", 1.35, 1.23), ("CH3", 2.5, -1.0)]
    s = pc.load(at_amine(tmp_path, 3, ("CE", "NZ", "HZ1"), "ACE", rows))
    assert not {Kind.CAP, Kind.BONDS_LEFT_OUT} & {each.kind for each in s.repairs}
    assert s.residue_name[-1] == "ACE" and s.mobile[-1] and len(s.links) == 1
    assert charge(s) == pytest.approx(0.0, abs=1e-6)
