"""Hydrogens: their number, their geometry against the force field's, and their energy against Modeller's."""

import numpy as np
import openmm
import pytest
from conftest import load
from openmm import app, unit
from oracles import angle_triples, angles
from scipy.spatial.transform import Rotation

import protochain as pc
from protochain.structure.hydrogens import place_hydrogens

HEAVY_ONLY = ("4pti.pdb", "1ubq.pdb", "1hel.pdb", "3i40.pdb")
LENGTH_NM = 1.01e-3
"""Hydrogens of rings are 0.108 nm away, all others of carbons 0.109: one length serves all."""
BEND = np.radians(15.0)
"""Largest difference of an angle at a placed hydrogen from the force field's, where its parent's heavy atoms
are an experiment's: strained rings and bonds take the rest."""


def added(s):
    return np.flatnonzero(s.atom_element == "H")


@pytest.mark.parametrize("name", HEAVY_ONLY)
def test_as_many_as_modeller_adds_at_the_same_atoms(name):
    s = load(name)
    modeller = app.Modeller(s.topology, s.positions * unit.nanometer)
    modeller.delete([atom for atom in modeller.topology.atoms() if atom.element.symbol == "H"])
    modeller.addHydrogens(pH=7.0)
    theirs = [
        (atom.residue.index, "H1" if atom.name == "H" and atom.residue.index in starts(s) else atom.name)
        for atom in modeller.topology.atoms()
    ]
    ours = list(zip(s.atom_residue.tolist(), s.atom_name.tolist(), strict=True))
    assert sorted(theirs) == sorted(ours)


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


@pytest.mark.parametrize("name", HEAVY_ONLY)
def test_their_energy_is_no_higher_than_after_modellers_minimisation(name):
    s = load(name)
    energy = pc.energy(s)
    x = {}
    modeller = app.Modeller(s.topology, s.positions * unit.nanometer)
    modeller.delete([atom for atom in modeller.topology.atoms() if atom.element.symbol == "H"])
    modeller.addHydrogens(pH=7.0)
    for atom, at in zip(
        modeller.topology.atoms(), modeller.positions.value_in_unit(unit.nanometer), strict=True
    ):
        name = "H1" if atom.name == "H" and atom.residue.index in starts(s) else atom.name
        x[atom.residue.index, name] = at
    theirs = np.array([x[key] for key in zip(s.atom_residue.tolist(), s.atom_name.tolist(), strict=True)])
    assert energy(s.positions)[0] < energy(theirs)[0]


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
