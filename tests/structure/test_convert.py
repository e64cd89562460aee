"""What other libraries hold becomes the same structure as the file they read, and goes back to them."""

import gemmi
import MDAnalysis
import mdtraj
import numpy as np
import pytest
from fixtures.samples import STRUCTURES, load, shared
from fixtures.tolerances import PDB_ROUNDING_NM
from openmm import app

import protochain as pc

SINGLE_NM = 2e-6
"""Positions of some nm or some ten angstrom in single precision."""


def held(kind, path):
    if kind == "gemmi":
        return gemmi.read_structure(str(path))
    if kind == "mdtraj":
        return mdtraj.load_pdb(str(path), no_boxchk=True)
    if kind == "universe":
        return MDAnalysis.Universe(str(path))
    if kind == "atoms":
        return MDAnalysis.Universe(str(path)).select_atoms("protein")
    read = app.PDBFile(str(path))
    return read.topology, read.positions


def heavy_atoms(s):
    """Position of each atom that is no hydrogen, by residue and name."""
    keys = zip(s.atom_residue.tolist(), s.atom_name.tolist(), strict=True)
    return {key: x for key, x, e in zip(keys, s.positions, s.atom_element, strict=True) if e != "H"}


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("kind", ["gemmi", "mdtraj", "universe", "atoms", "openmm"])
@pytest.mark.parametrize("name", ["3i40.pdb"])
def test_it_becomes_the_same_structure(name, kind):
    s, file = pc.as_structure(held(kind, STRUCTURES / name), "held"), load(name)
    assert (s.name, s.n_chains, s.n_residues, s.n_atoms) == (
        "held",
        file.n_chains,
        file.n_residues,
        file.n_atoms,
    )
    assert np.array_equal(s.residue_name, file.residue_name)
    ours = heavy_atoms(s)
    for key, x in heavy_atoms(file).items():
        assert np.allclose(ours[key], x, atol=SINGLE_NM)
    assert len(s.bonds) == len(file.bonds)
    if kind != "mdtraj":
        assert list(s.residue_number) == list(file.residue_number)


def test_a_structure_goes_there_and_back():
    s = load("1ubq.pdb")
    assert pc.as_structure(s) is s
    for other in (pc.to_mdtraj(s), pc.to_mdanalysis(s), (s.topology, s.positions)):
        again = pc.as_structure(other)
        assert np.array_equal(again.atom_name, s.atom_name) and again.repairs == ()
        assert np.allclose(again.positions, s.positions, atol=SINGLE_NM)
    frames = pc.to_mdtraj(s, np.array([s.positions, s.positions + 0.1]))
    assert frames.n_frames == 2 and np.allclose(frames.xyz[1], s.positions + 0.1, atol=SINGLE_NM)
    universe = pc.to_mdanalysis(s)
    assert universe.select_atoms("resid 5:6 and name CA").n_atoms == 2
    assert np.allclose(universe.atoms.positions, 10 * s.positions, atol=10 * PDB_ROUNDING_NM)


def test_settings_of_loading_hold_for_them_too():
    made = gemmi.read_structure(str(STRUCTURES / "4pti.pdb"))
    assert not len(pc.build_chain(pc.as_structure(made, disulfide="none")).loops)
    assert pc.as_structure(made, keep=("water",)).obstacle.sum() == 180
    many = gemmi.read_structure(str(shared("2sdf_sdf1_nmr30.pdb")))
    assert np.allclose(
        pc.as_structure(many, model=7).positions, pc.load(shared("2sdf_sdf1_nmr30.pdb"), model=7).positions
    )


def test_they_can_be_minimised_and_compared():
    held_by_mdtraj = pc.to_mdtraj(load("ala10.pdb"))
    r = pc.minimise(held_by_mdtraj, method="lbfgs", max_evaluations=5)
    assert r.end.energy < r.start.energy
    k = pc.compare(
        pc.to_mdanalysis(load("ala10.pdb")), ("lbfgs",), max_evaluations=5, reference=held_by_mdtraj
    )
    assert k.quality.loc["start", "reference_rmsd_angstrom"] < 1e-4
