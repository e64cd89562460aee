"""Phosphorylated residues keep their phosphates, with Amber's parameters for these."""

import numpy as np
import openmm
import pytest
from fixtures.modified import modified
from fixtures.refusals import expect_refusal
from fixtures.samples import STRUCTURES

import protochain as pc
from protochain.energies.factory import build_system
from protochain.structure.molecule.repairs import Reason
from protochain.structure.molecule.templates import PHOSPHATES
from protochain.validation.strain import strain

SITES = {("A", 20): "SEP", ("A", 22): "TPO", ("A", 59): "PTR"}
CHARGE = {"SEP": -2, "TPO": -2, "PTR": -2}


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return modified(STRUCTURES / "1ubq.pdb", SITES, tmp_path_factory.mktemp("phosphates"))


def atoms_of(s, name):
    return np.flatnonzero(s.residue_name[s.atom_residue] == name)


def phosphorus_bonds(s, x, name):
    """Lengths (angstrom) of the bonds of P in the first residue of a name, ascending."""
    p = atoms_of(s, name)[(s.atom_name == "P")[atoms_of(s, name)]][0]
    ends = s.bonds[(s.bonds == p).any(axis=1)]
    return np.sort(10.0 * np.linalg.norm(x[ends[:, 0]] - x[ends[:, 1]], axis=1))


def reference(s, forcefield, solvent):
    system = build_system(s, forcefield, solvent)
    integrator = openmm.VerletIntegrator(0.001)
    context = openmm.Context(system, integrator, openmm.Platform.getPlatformByName("Reference"))
    context.setPositions(s.positions)
    state = context.getState(getEnergy=True, getForces=True)
    return state.getPotentialEnergy()._value, state.getForces(asNumpy=True)._value, system


@pytest.mark.parametrize(("forcefield", "solvent"), [("amber14", "obc2"), ("amber19", "gbn2")])
def test_the_native_energy_is_that_of_openmm_and_charges_are_whole(path, forcefield, solvent):
    s = pc.load(path)
    assert s.losses == () and {*SITES.values()} <= {*s.residue_name.tolist()}
    energy, forces = pc.energy(s, forcefield, solvent, engine="native")(s.positions)
    expected, expected_forces, system = reference(s, forcefield, solvent)
    assert energy == pytest.approx(expected, rel=1e-8)
    assert np.abs(forces - expected_forces).max() <= 1e-8 * np.abs(expected_forces).max()
    (nonbonded,) = (each for each in system.getForces() if isinstance(each, openmm.NonbondedForce))
    charge = np.array([nonbonded.getParticleParameters(i)[0]._value for i in range(s.n_atoms)])
    for name, expected in CHARGE.items():
        assert charge[atoms_of(s, name)].sum() == pytest.approx(expected, abs=1e-4)


def test_relaxed_phosphates_are_tetrahedra_that_survive_writing(path, tmp_path):
    s = pc.relax(path).structure
    for name in SITES.values():
        *terminal, ester = phosphorus_bonds(s, s.positions, name)
        assert terminal == pytest.approx([1.50] * 3, abs=0.05) and ester == pytest.approx(1.61, abs=0.05)
    for suffix in (".pdb", ".cif"):
        pc.save(s, tmp_path / f"out{suffix}")
        again = pc.load(tmp_path / f"out{suffix}")
        assert again.repairs == () and again.fingerprint == s.fingerprint
    p = atoms_of(s, "SEP")[(s.atom_name[atoms_of(s, "SEP")] == "P")][0]
    assert not (strain(s).bonds == p).any()
    x = s.positions.copy()
    x[p] += 0.03  # nm along each axis
    assert (strain(s, x).bonds == p).any()


def test_side_chains_turn_to_the_phosphate(path):
    hinges = pc.build_chain(path, "chi rotors").hinges
    kinds = {name: [h.kind for h in hinges if h.residue_name == name] for name in SITES.values()}
    assert kinds == {
        "SEP": ["chi1", "chi2", "chi3"],
        "TPO": ["chi1", "chi2", "rotor", "chi3"],
        "PTR": ["chi1", "chi2", "chi3", "chi4"],
    }


def test_acid_has_one_hydrogen_and_the_file_says_on_which_oxygen(path, tmp_path):
    s = pc.load(path, ph=5.0)
    for name in SITES.values():
        assert (s.atom_name[atoms_of(s, name)] == "H1P").sum() == 1
    pc.energy(s, "amber19")
    s = pc.load(modified(STRUCTURES / "1ubq.pdb", {("A", 65): "SEP"}, tmp_path, acid=True))
    own = atoms_of(s, "SEP")
    name = s.atom_name[own].tolist()
    assert name[name.index("H1P") - 1] == "O2P" and s.losses == ()
    pc.energy(s)


@pytest.mark.parametrize(
    ("site", "gone", "why"),
    [
        (20, "", Reason.ASKED),
        (20, "O2P", Reason.INCOMPLETE),
        (1, "", Reason.END),
    ],
)
def test_else_it_becomes_its_parent_and_the_loss_says_why(site, gone, why, tmp_path):
    changed = "SEP" if site == 20 else ("SEP", ("N", "CA", "CB"))
    path = modified(STRUCTURES / "1ubq.pdb", {("A", site): changed}, tmp_path)
    if gone:
        lines = path.read_text().splitlines(keepends=True)
        path.write_text("".join(line for line in lines if line[12:16].strip() != gone))
    s = pc.load(path, standard_residues=why is Reason.ASKED)
    assert s.residue_name[site - 1] == "SER" and "SEP" not in s.residue_name
    (loss,) = s.losses
    assert loss.why is why and {"P", "O1P", "O3P"} <= {*loss.atoms}


def test_a_force_field_without_parameters_is_refused_with_the_remedy(path):
    with expect_refusal("standard_residues", match="standard_residues=True"):
        pc.energy(pc.load(path), "amber99sb")
    pc.energy(pc.load(path, standard_residues=True), "amber99sb")


def test_the_users_file_of_the_same_parameters_is_not_read_twice(path, tmp_path):
    own = tmp_path / "phosphates.xml"
    own.write_bytes(PHOSPHATES["amber19"].read_bytes())
    s = pc.load(path, forcefield=own)
    energy = pc.energy(s, f"amber19,{own}")(s.positions)[0]
    assert energy == pytest.approx(pc.energy(pc.load(path), "amber19")(s.positions)[0], rel=1e-12)
