"""Residues that no template fits: cross-linked, or bonded beside a chain; chains whose id changes."""

import gemmi
import numpy as np
import openmm
import pytest
from fixtures import covalent
from fixtures.modified import modified
from fixtures.samples import STRUCTURES, shared
from fixtures.tolerances import BOND_KEPT

import protochain as pc
from protochain.energies.factory import build_system
from protochain.structure.molecule.chirality import with_mirror_images
from protochain.structure.molecule.repairs import Kind
from protochain.validation.ligands import inverted_double_bonds
from protochain.validation.stereocentres import inverted_stereocentres

pytest.importorskip("rdkit")
pytest.importorskip("dimorphite_dl")

PYRIDOXAL = {
    "C2'": "C2A", "C4'": "C4A", "C5'": "C5A", "OP4": "O4P", "OP1": "O1P", "OP2": "O2P", "OP3": "O3P",
}  # fmt: skip
"""Names in PLP of atoms of LLP that have other ones."""
LINKS = {
    "staple_conn.cif": (("NLE", "CE"), ("MK8", "CE")),
    "isopeptide_KN_link.pdb": (("LYS", "NZ"), ("ASN", "CG")),
    "lasso_link.pdb": (("TYR", "N"), ("GLU", "CD")),
}


def pyridoxal(tmp_path):
    """Lysine with pyridoxal phosphate as one residue of the archive, and as two that a LINK record joins."""
    pc.save(pc.from_sequence("AAKAAA"), tmp_path / "plain.pdb")
    whole = modified(tmp_path / "plain.pdb", {("A", 3): ("LLP", ("CD", "CE", "NZ"))}, tmp_path)
    parted = gemmi.read_structure(str(whole))
    lysine = parted[0]["A"][2]
    lysine.name = "LYS"
    own = {"N", "CA", "C", "O", "CB", "CG", "CD", "CE", "NZ"}
    other = gemmi.Residue()
    other.name, other.seqid, other.het_flag = "PLP", gemmi.SeqId("1"), "H"
    for k in reversed(range(len(lysine))):
        if lysine[k].name not in own:
            moved = lysine[k].clone()
            moved.name = PYRIDOXAL.get(moved.name, moved.name)
            other.add_atom(moved, 0)
            del lysine[k]
    parted[0].add_chain(gemmi.Chain("L"))
    parted[0]["L"].add_residue(other)
    bond = gemmi.Connection()
    bond.type, bond.name = gemmi.ConnectionType.Covale, "covale1"
    bond.partner1 = gemmi.AtomAddress("A", gemmi.SeqId("3"), "LYS", "NZ")
    bond.partner2 = gemmi.AtomAddress("L", gemmi.SeqId("1"), "PLP", "C4A")
    parted.connections.append(bond)
    parted.write_pdb(str(tmp_path / "parted.pdb"))
    return whole, tmp_path / "parted.pdb"


def heavy(s):
    return np.flatnonzero(s.atom_element != "H")


def reference(s):
    context = openmm.Context(
        build_system(s, "amber14", "obc2"),
        openmm.VerletIntegrator(0.001),
        openmm.Platform.getPlatformByName("Reference"),
    )
    context.setPositions(s.positions)
    state = context.getState(getEnergy=True, getForces=True)
    return state.getPotentialEnergy()._value, state.getForces(asNumpy=True)._value


def assert_is_openmms(s):
    energy, forces = pc.energy(s, engine="native")(s.positions)
    expected, expected_forces = reference(s)
    assert energy == pytest.approx(expected, rel=1e-8)
    assert np.abs(forces - expected_forces).max() <= 1e-8 * np.abs(expected_forces).max()


def test_one_residue_or_two_that_a_bond_joins_are_the_same_molecule(tmp_path):
    one, two = (pc.load(path) for path in pyridoxal(tmp_path))
    assert one.n_atoms == two.n_atoms and len(two.fragments) == 1
    x = np.zeros_like(two.positions)
    for k in range(two.n_atoms):
        near = np.linalg.norm(one.positions - two.positions[k], axis=1)
        x[k] = one.positions[np.argmin(near)]
    assert len(np.unique(x, axis=0)) == len(x)
    expected = pc.energy(one)(one.positions)[0]
    assert pc.energy(two)(x)[0] == pytest.approx(expected, abs=1e-4)
    (linked,) = (each for each in two.repairs if each.kind is Kind.LINKED)
    assert "O4A of PLP" in linked.facts["gone"]
    assert_is_openmms(two)


def test_a_molecule_bonded_to_a_chain_moves_with_it_and_is_read_again(tmp_path):
    s = pc.minimise(pc.load(pyridoxal(tmp_path)[1]), max_evaluations=100).structure
    assert s.mobile.any() and not s.ties and not s.obstacle.any()
    for suffix in (".pdb", ".cif"):
        pc.save(s, tmp_path / f"out{suffix}")
        assert pc.load(tmp_path / f"out{suffix}").fingerprint == s.fingerprint
    # It hangs on its residue, and is no molecule of its own.
    assert len(pc.build_chain(s).tree.parent[pc.build_chain(s).tree.parent < 0]) == 1


def renamed(tmp_path, from_residue, backwards):
    """The sample in which a chain has another id from a residue on, its later part first if asked."""
    structure = gemmi.read_structure(str(STRUCTURES / "1l2y.pdb"))
    del structure[1:]
    first, second = gemmi.Chain("A"), gemmi.Chain("B")
    for residue in structure[0]["A"]:
        (first if residue.seqid.num < from_residue else second).add_residue(residue)
    del structure[0]["A"]
    for chain in (second, first) if backwards else (first, second):
        structure[0].add_chain(chain)
    path = tmp_path / "renamed.pdb"
    structure.write_pdb(str(path))
    return path


@pytest.mark.parametrize("backwards", [False, True])
def test_a_chain_that_goes_on_under_another_id_is_one(backwards, tmp_path):
    plain, s = pc.load(STRUCTURES / "1l2y.pdb"), pc.load(renamed(tmp_path, 9, backwards))
    assert s.n_chains == 1 and Kind.CHAIN_GOES_ON in {each.kind for each in s.repairs}
    assert {*s.residue_chain.tolist()} == {"A", "B"}
    assert np.array_equal(s.positions, plain.positions) and np.array_equal(s.bonds, plain.bonds)
    assert len(pc.build_chain(s).hinges) == len(pc.build_chain(plain).hinges)
    pc.save(s, tmp_path / "out.cif")
    again = pc.load(tmp_path / "out.cif")
    assert again.fingerprint == s.fingerprint and again.residue_chain.tolist() == s.residue_chain.tolist()


# Pieces of five residues move far.
@pytest.mark.filterwarnings("ignore::protochain.core.errors.StrayWarning")
@pytest.mark.parametrize("name", LINKS)
def test_a_bond_that_the_file_states_is_kept(name, tmp_path):
    s = pc.load(shared(f"../cases/links/{name}"))
    called = [(str(s.residue_name[s.atom_residue[k]]), str(s.atom_name[k])) for k in range(s.n_atoms)]
    ends = [pair for pair in s.bonds.tolist() if {called[k] for k in pair} == {*LINKS[name]}]
    assert len(ends) == 1 and Kind.LINKED in {each.kind for each in s.repairs}
    assert_is_openmms(s)
    (i, j) = ends[0]
    done = pc.minimise(s, method="hybrid", max_evaluations=150).structure
    before, after = (np.linalg.norm(each.positions[i] - each.positions[j]) for each in (s, done))
    assert abs(after - before) < 0.01
    pc.save(done, tmp_path / "out.cif")
    assert pc.load(tmp_path / "out.cif").fingerprint == done.fingerprint


QUICK = (
    "lanthionine", "hemithioacetal-of-bisulfite", "adenylyl-tyrosine", "boronate", "isopeptide-aspartate",
    "staple", "cycle",
)  # fmt: skip
ALL = [
    pytest.param(name, marks=() if name in QUICK else pytest.mark.slow, id=name) for name in covalent.KINDS
]
TIED = {"boronate"}


@pytest.mark.parametrize(
    "name",
    [
        "acrylamide", "o-glycan", "phosphohistidine", "chloromethyl-ketone-ND1", "glycosyl-enzyme-aspartate",
        "c-mannose",
    ],
)  # fmt: skip
def test_a_bond_of_a_known_kind_need_not_be_stated(name, tmp_path):
    case = covalent.KINDS[name]
    s = pc.load(covalent.written(tmp_path, case, stated=False)[0])
    at, ((i, a, j, b, _),) = covalent.places(s, case), case.bonds
    assert sorted((at[i, a], at[j, b])) in s.bonds.tolist()


@pytest.mark.parametrize("name", ALL)
def test_a_stated_bond_of_any_kind_has_its_chemistry_and_length(name, tmp_path):
    case = covalent.KINDS[name]
    path, product = covalent.written(tmp_path, case)
    s = pc.load(path)
    at = covalent.places(s, case)
    ends = [(at[i, a], at[j, b]) for i, a, j, b, _ in case.bonds]
    assert {frozenset(pair) for pair in ends} <= {frozenset(pair) for pair in s.bonds.tolist()}
    if name in TIED:
        assert s.ties and Kind.NO_PARAMETERS in {each.kind for each in s.repairs}
    else:
        assert not s.ties and not s.obstacle.any()
        covalent.assert_is(s, case, product)
    done = pc.minimise(s, method="cartesian", max_evaluations=60).structure
    for i, j in ends:
        before, after = (np.linalg.norm(each.positions[i] - each.positions[j]) for each in (s, done))
        assert abs(after - before) < BOND_KEPT
    for suffix in (".pdb", ".cif"):
        pc.save(done, tmp_path / f"out{suffix}")
        assert pc.load(tmp_path / f"out{suffix}").fingerprint == done.fingerprint


def test_an_acrylamide_drawn_as_it_was_before_it_reacted_is_saturated(tmp_path):
    added = covalent.KINDS["acrylate-at-histidine"]
    path, _ = covalent.written(tmp_path, added._replace(changed=()))
    covalent.assert_is(pc.load(path), added, covalent.product(added))


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_flat_alpha_carbon_is_of_neither_hand(sign, tmp_path):
    path, _ = covalent.written(tmp_path, covalent.Bonded(("GLY DHA GLY",), ()))
    structure = gemmi.read_structure(str(path))
    for atom in (atom for residue in structure[0]["A"] for atom in residue):
        atom.pos.x *= sign
    structure.make_mmcif_document().write_file(str(path))
    s = pc.load(path)
    assert s.residue_name_in_file[1] == "DHA" and not s.mirrored.any() and len(s.fragments) == 1


def told(s):
    """What is inverted by the lines of loading, and by the measures."""
    lines = [each for each in s.repairs if each.kind in (Kind.INVERTED, Kind.INVERTED_IN_FILE)]
    names = [getattr(a, "name", a) for each in lines for a in each.facts["atoms"]]
    return names, [s.atom_name[k] for k in inverted_stereocentres(s, s.positions)]


@pytest.mark.parametrize("drawn, name, wrong", [("HYP", "HYP", []), ("HZP", "HYP", ["CG"]),
                                                ("HZP", "HZP", []), ("HYP", "HZP", ["CG"])])  # fmt: skip
def test_a_stereocentre_of_a_modified_residue_is_that_of_its_source(drawn, name, wrong, tmp_path):
    path = modified(STRUCTURES / "1l2y.pdb", {("A", 12): (drawn, ("CB", "CG", "CD"))}, tmp_path)
    path.write_text(path.read_text().replace(drawn, name))
    s = pc.load(path)
    assert told(s) == (wrong, wrong)
    if wrong:
        assert pc.minimise(s, method="cartesian", max_evaluations=40).status != "converged"
        done = pc.relax(s).structure
        assert not len(inverted_stereocentres(s, done.positions))


def test_a_mirror_image_of_a_modified_residue_is_one_in_a_chain_that_is(tmp_path):
    path = modified(STRUCTURES / "1l2y.pdb", {("A", 12): ("HZP", ("CB", "CG", "CD"))}, tmp_path)
    s = pc.load(path)
    d = with_mirror_images(s.with_positions(s.positions * [1.0, 1.0, -1.0]))
    assert d.mirrored.sum() == 17 and not len(inverted_stereocentres(d, d.positions))


def test_a_sugar_beside_a_chain_and_retinal_are_as_their_sources(tmp_path):
    path, _ = covalent.written(tmp_path, covalent.KINDS["c-mannose"])
    assert told(pc.load(path)) == ([], [])
    path.write_text(path.read_text().replace("MAN", "GLC"))
    assert told(pc.load(path)) == (["C2"], ["C2"])
    s = pc.load(covalent.written(tmp_path, covalent.KINDS["methyllanthionine"])[0])
    assert told(s) == ([], [])  # DBB is a D-amino acid.
    s = pc.load(covalent.written(tmp_path, covalent.KINDS["retinal"])[0])
    assert told(s) == ([], []) and not len(inverted_double_bonds(s, s.positions))
    at = {str(name): k for k, name in enumerate(s.atom_name) if s.residue_name[s.atom_residue[k]] == "RET"}
    a, b = s.positions[[at["C11"], at["C12"]]]
    axis = (b - a) / np.linalg.norm(b - a)
    ring = [at[name] for name in at if name in ("C10", "C9", "C8", "C19", "H11", "H10")]
    x = s.positions.copy()
    x[ring] = 2.0 * np.outer((x[ring] - a) @ axis, axis) + 2.0 * a - x[ring]
    assert (s.atom_name[inverted_double_bonds(s, x)] == ["C11", "C12"]).all()
