"""Hydrogens: their number, their geometry against the force field's, and their energy against Modeller's."""

import numpy as np
import openmm
import pytest
from fixtures.oracles import angle_triples, angles
from fixtures.samples import STRUCTURES, load
from openmm import app, unit
from scipy.spatial.transform import Rotation

import protochain as pc
from protochain.structure.molecule.hydrogens import place_hydrogens

HEAVY_ONLY = ("4pti.pdb", "3i40.pdb")
LENGTH_NM = 1.01e-3
"""Hydrogens of rings are 0.108 nm away, all others of carbons 0.109: one length serves all."""
BEND = np.radians(15.0)
"""Largest difference of an angle at a placed hydrogen from the force field's, where its parent's heavy atoms
are an experiment's: strained rings and bonds take the rest."""


def added(s):
    return np.flatnonzero(s.atom_element == "H")


def by_modeller(name):
    """Positions of all atoms with OpenMM's hydrogens, by residue and name."""
    s = load(name)
    modeller = app.Modeller(s.topology, s.positions * unit.nanometer)
    modeller.delete([atom for atom in modeller.topology.atoms() if atom.element.symbol == "H"])
    modeller.addHydrogens(pH=7.0, platform=openmm.Platform.getPlatform("CPU"))
    names = [
        (atom.residue.index, "H1" if atom.name == "H" and atom.residue.index in starts(s) else atom.name)
        for atom in modeller.topology.atoms()
    ]
    return dict(zip(names, modeller.positions.value_in_unit(unit.nanometer), strict=True))


@pytest.mark.parametrize("name", HEAVY_ONLY)
def test_as_many_as_modeller_adds_at_the_same_atoms_and_of_no_higher_energy(name):
    s, theirs = load(name), by_modeller(name)
    ours = list(zip(s.atom_residue.tolist(), s.atom_name.tolist(), strict=True))
    assert sorted(theirs) == sorted(ours)
    x = np.array([theirs[key] for key in ours])
    energy = pc.energy(s)
    assert energy(s.positions)[0] < energy(x)[0]


def starts(s):
    return {int(np.flatnonzero(s.residue_chain_index == k)[0]) for k in range(s.n_chains)}


@pytest.mark.parametrize("name", HEAVY_ONLY)
def test_bonds_and_angles_are_the_force_fields(name):
    s = load(name)
    system = pc.energy(s, solvent="vacuum").system
    hydrogen = s.atom_element == "H"
    for force in system.getForces():
        if isinstance(force, openmm.HarmonicBondForce):
            for k in range(force.getNumBonds()):
                i, j, length, _ = force.getBondParameters(k)
                if hydrogen[i] or hydrogen[j]:
                    assert np.linalg.norm(s.positions[i] - s.positions[j]) == pytest.approx(
                        length._value, abs=LENGTH_NM
                    )
        if isinstance(force, openmm.HarmonicAngleForce):
            usual = {}
            for k in range(force.getNumAngles()):
                i, j, m, angle, _ = force.getAngleParameters(k)
                usual[min(i, m), j, max(i, m)] = angle._value
    triples = angle_triples(s.bonds)
    touched = triples[hydrogen[triples].any(axis=1)]
    expected = [usual[min(i, k), j, max(i, k)] for i, j, k in touched.tolist()]
    assert np.abs(angles(touched, s.positions) - expected).max() < BEND


def test_placement_turns_with_the_molecule():
    s = load("1ubq.pdb")
    turn = Rotation.from_euler("xyz", [0.3, -1.1, 2.0]).as_matrix()
    charge = np.zeros(s.n_atoms)
    x = s.positions.copy()
    x[added(s)] = np.nan
    element = s.atom_element.tolist()
    straight = place_hydrogens(x, element, charge, s.bonds)
    turned = place_hydrogens(x @ turn.T, element, charge, s.bonds)
    assert np.abs(turned - straight @ turn.T).max() < 3e-6
    assert np.array_equal(straight[s.atom_element != "H"], s.positions[s.atom_element != "H"])


def test_a_hydroxyl_turns_to_its_acceptor():
    # C-O-H with an acceptor 2.8 angstrom from the oxygen, on one side.
    x = np.array([[-0.14, 0, 0], [0, 0, 0], [0.09, 0.265, 0], [np.nan] * 3, [-0.19, -0.1, 0.1]])
    placed = place_hydrogens(
        x,
        ["C", "O", "O", "H", "H"],
        np.array([0.1, -0.6, -0.6, 0.4, 0.1]),
        np.array([[0, 1], [1, 3], [0, 4]]),
    )
    assert np.linalg.norm(placed[3] - placed[1]) == pytest.approx(0.096, abs=1e-5)
    assert np.linalg.norm(placed[3] - placed[2]) < 0.2


def test_a_water_is_put_together():
    x = np.array([[0.0, 0, 0], [np.nan] * 3, [np.nan] * 3])
    placed = place_hydrogens(x, ["O", "H", "H"], np.array([-0.8, 0.4, 0.4]), np.array([[0, 1], [0, 2]]))
    u, v = placed[1], placed[2]
    assert np.degrees(np.arccos(u @ v / np.linalg.norm(u) / np.linalg.norm(v))) == pytest.approx(
        104.52, abs=0.01
    )


def sides(s, parents):
    """By residue and parent: whether hydrogen 2 is above the plane of the two other bonds, and 3 below."""
    at = {
        (int(r), str(n)): s.positions[i]
        for i, (r, n) in enumerate(zip(s.atom_residue, s.atom_name, strict=True))
    }
    found = {}
    for r, residue in enumerate(s.residue_name.tolist()):
        for parent, (before, after, pair) in parents.get(residue, {}).items():
            up = np.cross(at[r, before] - at[r, parent], at[r, after] - at[r, parent])
            found[r, parent] = bool(up @ (at[r, f"{pair}2"] - at[r, f"{pair}3"]) > 0)
    return found


METHYLENES = {
    "PRO": {"CB": ("CA", "CG", "HB"), "CG": ("CB", "CD", "HG"), "CD": ("CG", "N", "HD")},
    "GLY": {"CA": ("N", "C", "HA")},
    "SER": {"CB": ("CA", "OG", "HB")},
    "LEU": {"CB": ("CA", "CG", "HB")},
    "ILE": {"CG1": ("CB", "CD1", "HG1")},
    "ARG": {"CG": ("CB", "CD", "HG"), "CD": ("CG", "NE", "HD")},
    "LYS": {"CB": ("CA", "CG", "HB"), "CE": ("CD", "NZ", "HE")},
}


@pytest.mark.parametrize("name", ["1l2y.pdb", "1vii.pdb"])
def test_hydrogens_2_and_3_are_on_the_sides_where_entries_have_them(name, tmp_path):
    lines = (STRUCTURES / name).read_text().splitlines(keepends=True)
    path = tmp_path / name
    path.write_text("".join(line for line in lines if line[76:78].strip() != "H"))
    expected = sides(load(name), METHYLENES)
    assert expected and sides(pc.load(path), METHYLENES) == expected


def test_hydrogens_beyond_a_parents_room_are_placed_too():
    """A carbon with five, of which one is there: as files with stray hydrogens have them."""
    x = np.full((6, 3), np.nan)
    x[:3] = [[0.0, 0.0, 0.0], [0.15, 0.0, 0.0], [-0.04, 0.1, 0.0]]
    bonds = np.array([[0, 1], [0, 2], [0, 3], [0, 4], [0, 5]])
    placed = place_hydrogens(x, ["C", "C", "H", "H", "H", "H"], np.zeros(6), bonds)
    assert np.allclose(np.linalg.norm(placed[3:], axis=1), 0.109, atol=1e-6)
    assert np.array_equal(placed[:3], x[:3])
