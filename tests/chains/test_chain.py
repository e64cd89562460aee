from types import SimpleNamespace

import numpy as np
import pytest
from fixtures.oracles import angle_triples, angles, bond_lengths
from fixtures.refusals import expect_refusal
from fixtures.samples import SAMPLES, chain, energy, load
from fixtures.tolerances import DIFFERENCE, GEOMETRY_NM, GEOMETRY_RAD, RIGID_MOTION, ROUND_OFF_NM
from scipy.spatial.transform import Rotation

import protochain as pc
from protochain.chains.articulate import transfer_coordinates, with_free_root
from protochain.chains.hinges import _in_rings
from protochain.core.arrays import dihedral
from protochain.mechanics.multibody import HingeKind, integrate
from protochain.minimisers.problem import evaluate
from protochain.minimisers.spaces import ROOT_LEVER, Torsions

ALL_HINGES = "phi psi omega chi rotors"


def turned(c, seed=0, size=1.0):
    """The chain's q after a random turn of every freedom."""
    step = np.random.default_rng(seed).uniform(-size, size, c.n_v)
    return integrate(c.tree, c.q0, step)


@pytest.mark.parametrize("name", SAMPLES)
@pytest.mark.parametrize("hinges", ["phi psi chi", ALL_HINGES])
def test_q0_is_the_input_pose(name, hinges):
    c = chain(name, hinges)
    assert np.allclose(pc.pose(c, c.q0).x, load(name).positions, rtol=0, atol=ROUND_OFF_NM)


def test_coordinates_of_a_chain_with_a_free_root_are_of_the_same_positions():
    """Of two chains, so that the coordinates of hinges have other indices."""
    c = pc.build_chain(load("3i40.pdb"), root="fixed", hydrogen_mass=2.0)
    free = pc.build_chain(c, root="free")
    assert free.n_q == c.n_q + 14 and free.hydrogen_mass == with_free_root(c).hydrogen_mass == 2.0
    q = turned(c, size=0.2)
    x = pc.pose(free, transfer_coordinates(c, free, q)).x
    assert np.allclose(x, pc.pose(c, q).x, rtol=0, atol=ROUND_OFF_NM)


@pytest.mark.parametrize("name", ["1l2y.pdb", "3i40.pdb"])
@pytest.mark.parametrize("root", ["fixed", "free"])
def test_a_hinge_coordinate_is_the_dihedral_measured_from_the_atoms(name, root):
    c = chain(name, ALL_HINGES, root)
    q = turned(c, size=3.0)
    x = pc.pose(c, q).x
    coordinates = q[c.tree.q_start[c.hinge_body]]
    measured = np.array([dihedral(*x[list(hinge.atoms)]) for hinge in c.hinges])
    off = (measured - coordinates + np.pi) % (2 * np.pi) - np.pi
    assert np.abs(off).max() < 1e-9


@pytest.mark.parametrize("name", ["1l2y.pdb", "1ejg.pdb", "3i40.pdb"])
def test_bond_lengths_and_angles_do_not_change(name):
    c = chain(name, ALL_HINGES)
    s = c.structure
    loops = {tuple(pair) for pair in c.loops.tolist()}
    bonds = np.array([pair for pair in s.bonds.tolist() if tuple(pair) not in loops])
    triples = angle_triples(bonds)
    x = pc.pose(c, turned(c, size=3.0)).x
    assert np.abs(bond_lengths(bonds, x) - bond_lengths(bonds, s.positions)).max() < GEOMETRY_NM
    assert np.abs(angles(triples, x) - angles(triples, s.positions)).max() < GEOMETRY_RAD
    assert np.abs(x - s.positions).max() > 0.1


@pytest.mark.parametrize(("name", "every"), [("1l2y.pdb", 1), ("1ejg.pdb", 5), ("3i40.pdb", 9)])
def test_torques_are_minus_the_gradient_of_the_energy(name, every):
    c, e = chain(name), energy(name).reference
    scale = Torsions(c).scale
    at = evaluate(Torsions(c), e, c.q0)
    h = 1e-5
    numeric = at.torque.copy()
    for k in range(0, c.n_v, every):
        step = np.zeros(c.n_v)
        step[k] = h * scale[k]
        ahead, behind = (e(pc.pose(c, integrate(c.tree, c.q0, s)).x)[0] for s in (step, -step))
        numeric[k] = -(ahead - behind) / (2 * h)
    assert np.linalg.norm(at.torque - numeric) < DIFFERENCE * np.linalg.norm(at.torque)


@pytest.mark.parametrize("name", ["1l2y.pdb", "3i40.pdb"])
def test_energy_and_torques_do_not_change_with_the_place_of_the_input(name):
    c, e = chain(name), energy(name).reference
    rotation = Rotation.random(rng=np.random.default_rng(3))
    x = rotation.apply(c.structure.positions.copy()) + np.array([1.0, -2.0, 3.0])
    other = pc.build_chain(c.structure.with_positions(x))
    here, there = (evaluate(Torsions(k), e, k.q0) for k in (c, other))
    assert here.energy == pytest.approx(there.energy, rel=RIGID_MOTION)
    size = np.linalg.norm(here.torque)
    hinges = c.tree.v_start[c.hinge_body]
    assert np.linalg.norm(here.torque[hinges] - there.torque[hinges]) < RIGID_MOTION * size
    for root in np.flatnonzero(c.tree.kind == HingeKind.FREE):
        for part in (0, 3):
            k = slice(c.tree.v_start[root] + part, c.tree.v_start[root] + part + 3)
            assert np.linalg.norm(rotation.apply(here.torque[k]) - there.torque[k]) < RIGID_MOTION * size


def atoms_named(s, residue, *names):
    here = np.flatnonzero(s.atom_residue == residue)
    return [int(a) for a in here if s.atom_name[a] in names]


def test_a_peptide_plane_is_one_body_and_a_c_alpha_unit_another():
    c = chain("1l2y.pdb")
    s = c.structure
    plane = atoms_named(s, 3, "C", "O") + atoms_named(s, 4, "N", "H")
    unit = atoms_named(s, 4, "CA", "HA", "HA2")
    assert len(plane) == 4 and len(set(c.atom_body[plane])) == 1
    assert len(set(c.atom_body[unit])) == 1 and c.atom_body[unit[0]] != c.atom_body[plane[0]]
    # With omega open the plane falls in two.
    opened = chain("1l2y.pdb", "phi psi omega chi")
    assert len(set(opened.atom_body[plane])) == 2


def test_rings_are_rigid():
    c = chain("1l2y.pdb", ALL_HINGES)
    s = c.structure
    for r, name in enumerate(s.residue_name):
        if name == "PRO":
            ring = atoms_named(s, r, "N", "CA", "CB", "CG", "CD")
        elif name in ("TRP", "TYR"):
            ring = atoms_named(s, r, "CG", "CD1", "CD2", "CE2", "CZ", "CZ2", "CZ3", "CH2")
        else:
            continue
        assert len(set(c.atom_body[ring])) == 1
    assert not [h for h in c.hinges if h.kind == "phi" and h.residue_name == "PRO"]


def test_the_hinges_of_trp_cage_are_those_of_its_sequence():
    kinds = [hinge.kind for hinge in chain("1l2y.pdb").hinges]
    # 20 residues, 4 prolines: no phi for those or the first; psi for all, the last turning its carboxylate.
    assert kinds.count("phi") == 20 - 4 - 1
    assert kinds.count("psi") == 20
    assert [kinds.count(f"chi{i}") for i in range(1, 6)] == [13, 10, 3, 2, 1]
    c = chain("1l2y.pdb")
    assert c.n_hinges == 64 == c.n_q == c.n_v and c.n_bodies == 65


def test_disulfides_cut_loops_and_two_chains_are_two_free_trees():
    assert len(chain("1ejg.pdb").loops) == 3
    c = chain("3i40.pdb")
    assert len(c.loops) == 3
    assert (c.tree.kind == HingeKind.FREE).sum() == 2
    assert (c.n_q, c.n_v) == (c.n_hinges + 14, c.n_hinges + 12)
    assert c.tree.n_bodies == c.n_hinges + 2


def test_the_root_is_in_the_middle_of_the_chain():
    c = chain("1ubq.pdb")
    s = c.structure
    middle = atoms_named(s, 38, "CA")[0]
    assert c.atom_body[middle] == 0


def test_what_cannot_turn_or_is_unknown_is_refused():
    with pytest.raises(pc.ProtochainError, match="'psy' is not a kind of hinge"):
        pc.build_chain(load("ala10.pdb"), "phi psy")
    with pytest.raises(pc.ProtochainError, match="no bond turns"):
        pc.build_chain(load("ala10.pdb"), "chi")
    with expect_refusal("root", match="root 'middle'"):
        pc.build_chain(load("ala10.pdb"), root="middle")


def test_the_scale_of_a_free_root_makes_forces_torques():
    c = chain("3i40.pdb")
    scale = Torsions(c).scale
    assert np.count_nonzero(scale == ROOT_LEVER) == 6 and np.count_nonzero(scale == 1) == c.n_v - 6


def test_dihedral_has_the_iupac_sign():
    x = np.array([[1.0, 0, 0], [0, 0, 0], [0, 0, 1], [0, 0, 1]])
    for angle in (0.5, -0.5, 3.1, -3.1):
        # Looking along +z, clockwise is from x towards y.
        x[3] = [np.cos(angle), np.sin(angle), 1.0]
        assert dihedral(*x) == pytest.approx(angle, abs=1e-14)


@pytest.mark.parametrize(
    ("name", "hinges", "root"),
    [
        ("1l2y.pdb", "phi psi omega chi rotors", "free"),
        ("1hel.pdb", "phi psi chi rotors", "fixed"),
        ("3i40.pdb", "phi psi chi", "auto"),
    ],
)
def test_the_mass_matrix_is_that_of_the_atoms(name, hinges, root):
    c = chain(name, hinges, root)
    rng = np.random.default_rng(2)
    q, h = integrate(c.tree, c.q0, rng.normal(scale=0.3, size=c.n_v)), 1e-5
    at = pc.pose(c, q)
    moved = [
        (pc.pose(c, integrate(c.tree, q, h * u)).x - pc.pose(c, integrate(c.tree, q, -h * u)).x) / (2 * h)
        for u in np.eye(c.n_v)
    ]
    weighted = np.array(moved).reshape(c.n_v, -1) * np.sqrt(np.repeat(c.structure.atom_mass, 3))
    by_atoms = weighted @ weighted.T
    m = pc.mass_matrix(c, at)
    scale = np.sqrt(np.outer(np.diag(m), np.diag(m)))
    # Central differences: truncation h^2 / 6, cancellation eps |x| / h over the shortest lever.
    assert np.abs((m - by_atoms) / scale).max() < 1e-8
    tau = rng.normal(size=c.n_v)
    for method in ("articulated", "fixman"):
        x = pc.solve_mass(c, at, tau, method)
        size = np.abs(m).sum(axis=1).max() * np.abs(x).max() + np.abs(tau).max()
        assert np.abs(m @ x - tau).max() < 100 * np.finfo(float).eps * size
        dense = np.linalg.slogdet(m / scale)[1] + np.log(np.diag(m)).sum()
        assert pc.log_det_mass(c, at, method) == pytest.approx(dense, abs=1e-8)


def test_every_body_can_be_inverted_even_with_every_hinge_open():
    """Sharing the atoms on the axes leaves no body a point or a line; the total mass stays."""
    c = chain("1hel.pdb", "phi psi omega chi rotors", "free")
    moments = np.linalg.eigvalsh(c.tree.inertia)
    assert (moments[:, 0] / moments[:, 2]).min() > 1e-3
    assert c.tree.mass.sum() == pytest.approx(c.structure.atom_mass.sum(), rel=1e-13)


def test_polar_hinges_are_the_rotors_whose_hydrogens_can_be_donated():
    s = load("1ubq.pdb")
    polar, rotors = (pc.build_chain(s, f"phi {kind}").hinges for kind in ("polar", "rotors"))
    donated = [hinge for hinge in rotors if hinge.kind == "rotor" and s.atom_element[hinge.atoms[2]] != "C"]
    assert [hinge for hinge in polar if hinge.kind == "rotor"] == donated
    # 3 serines, 7 threonines, one tyrosine, 7 lysines, and the amine of the first residue.
    assert len(donated) == 19
    assert len(pc.build_chain(s, "phi polar rotors").hinges) == len(rotors)


def test_a_hinge_that_turns_nothing_is_closed():
    """An amine whose one hydrogen lies on the line of CA and N: no torque is needed to turn it."""
    from openmm import app

    topology = app.Topology()
    residue = topology.addResidue("GLY", topology.addChain("A"))
    names = ["N", "CA", "C", "O", "OXT", "H1", "HA2"]
    symbols = ["N", "C", "C", "O", "O", "H", "H"]
    atoms = [
        topology.addAtom(name, app.Element.getBySymbol(symbol), residue)
        for name, symbol in zip(names, symbols, strict=True)
    ]
    for i, j in [(0, 1), (1, 2), (2, 3), (2, 4), (0, 5), (1, 6)]:
        topology.addBond(atoms[i], atoms[j])
    straight = np.array([[0, 0, 0], [0.15, 0, 0], [0.2, 0.14, 0], [0.14, 0.24, 0], [0.32, 0.14, 0.01]])
    rest = np.array([[-0.1, 0.0, 0.0], [0.18, -0.05, 0.08]])
    s = pc.Structure("line", topology, np.concatenate([straight, rest]))
    assert [hinge.kind for hinge in pc.build_chain(s, "psi rotors").hinges] == ["psi"]
    bent = s.with_positions(s.positions + np.array([[0, 0, 0]] * 5 + [[0, 0.05, 0]] + [[0, 0, 0]]))
    assert [hinge.kind for hinge in pc.build_chain(bent, "psi rotors").hinges] == ["psi", "rotor"]


@pytest.mark.parametrize("turn", range(3))
def test_hinges_in_a_ring_of_groups_are_all_of_the_ring_and_no_others(turn):
    """A ring of four groups, a tail at one, and a second tree. The first hinge is anywhere in the ring."""
    pairs = [(0, 1), (1, 2), (2, 3), (3, 0), (2, 4), (4, 5), (6, 7)]
    pairs = [*pairs[turn:], *pairs[:turn]]
    hinges = [SimpleNamespace(atoms=(-1, *pair, -1)) for pair in pairs]
    ring = {k for k, pair in enumerate(pairs) if max(pair) < 4}
    assert _in_rings(np.arange(8), hinges) == ring
