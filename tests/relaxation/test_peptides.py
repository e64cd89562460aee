"""Peptide bonds in relaxations and minimisations: twisted ones become planar, none is lost unsaid."""

from dataclasses import replace

import numpy as np
import pytest
from fixtures import models
from fixtures.repairs import sentences
from fixtures.samples import SAMPLES, energy, load

import protochain as pc
from protochain.core.arrays import dihedral_slopes
from protochain.minimisers.loop import Stop
from protochain.minimisers.restraints import Tethers
from protochain.minimisers.verdict import verdict
from protochain.relaxation.presets import PRESETS, PROTOCOLS
from protochain.relaxation.problems import Problems
from protochain.relaxation.relax_structure import _newly_reversed, describe_problems
from protochain.relaxation.restraints import PeptideBonds
from protochain.relaxation.rounds import Relaxer
from protochain.validation.layout import dihedrals
from protochain.validation.omega import isomerised_bonds, omegas, twisted_bonds


def bond_before(structure, residue):
    """Atoms (4,) of the peptide bond before a residue."""
    bonds = PeptideBonds.of(structure)
    return bonds.atoms[structure.atom_residue[bonds.atoms[:, 2]] == residue][0]


def pulled(structure, residue, degrees):
    """Minimisation under a strong pull of one omega: the end is well-formed but for it, as a bad model."""
    atoms, home = bond_before(structure, residue), Tethers.of_heavy_atoms(structure, 100.0)

    def pull(x):
        off = np.radians((dihedrals(x, atoms[None])[0] - degrees + 180.0) % 360.0 - 180.0)
        value, forces = home(x)
        forces[atoms] -= 3e3 * off * dihedral_slopes(x[atoms][None])[0]
        return value + 1.5e3 * off**2, forces

    chain = pc.build_chain(structure)
    return pc.minimise(chain, pc.energy(structure), "cartesian", restraints=pull)


def with_omega(structure, residue, degrees):
    """The structure with another omega."""
    return pulled(structure, residue, degrees).structure


@pytest.fixture(scope="module")
def bent():
    """Trp-cage with the bond before Ser 13 beyond the barrier, as that of Phe 120 in 1a0i."""
    made = with_omega(load("1l2y.pdb"), 12, -75.0)
    assert omegas(made).omega[11] == pytest.approx(-75.0, abs=12.0)
    return made


@pytest.mark.parametrize("name", SAMPLES)
def test_bonds_of_usual_shape_feel_nothing(name):
    s = load(name)
    value, forces = PeptideBonds.of(s)(s.positions)
    assert value == 0.0 and not forces.any()
    assert PeptideBonds.of(s).cis.sum() == omegas(s).cis.sum()


def test_forces_are_the_gradient_of_the_energy():
    s = models.shaken(load("1ubq.pdb"), 0.3, seed=3)
    bonds, x = PeptideBonds.of(s), s.positions
    value, forces = bonds(x)
    assert value > 100.0 and np.abs(forces.sum(axis=0)).max() < 1e-9 * np.abs(forces).max()
    for seed in range(3):
        way = np.random.default_rng(seed).normal(size=x.shape)
        slope = (bonds(x + 1e-6 * way)[0] - bonds(x - 1e-6 * way)[0]) / 2e-6
        assert slope == pytest.approx(-np.vdot(way, forces), rel=1e-5)


def test_a_bond_beyond_the_barrier_is_turned_to_trans_in_the_first_round(bent):
    """Force field and springs leave it where it is."""
    r = pc.relax(bent, threads=1)
    assert r.status == "converged" and len(r.rounds) == 1
    assert (r.measures_end["cis_peptides"], r.measures_end["twisted_peptides"]) == (0, 0)
    told = "A:SER13: twisted peptide bond before it turned to trans"
    assert [str(each) for each in r.peptides_turned] == [told] == sentences(r.structure)[-1:]
    assert r.record()["peptides_turned"] == [told] and r.ca_rmsd_angstrom < 0.4
    alone = pc.minimise(bent, pc.energy(bent), "cartesian", restraints=4184.0)
    assert np.sum(omegas(bent, alone.x).cis | omegas(bent, alone.x).twisted) == 1


@pytest.mark.parametrize(("omega", "cis"), [(60.0, True), (130.0, False)])
def test_before_proline_a_bond_turns_to_the_nearer_form(omega, cis):
    made = with_omega(load("1l2y.pdb"), 11, omega)
    r = pc.relax(made, threads=1)
    found = omegas(made, r.x)
    assert r.status == "converged" and found.cis[found.residue == 11] == cis and not found.twisted.any()
    assert str(r.peptides_turned[0]).endswith(f"to {'cis' if cis else 'trans'}")


def test_noise_is_no_cis_bond():
    """Of lysozyme with noise one omega is -26, with C-alphas 4 angstrom apart."""
    s = models.shaken(load("1hel.pdb"), 0.25, seed=11)
    assert omegas(s).cis.sum() == 1 and not PeptideBonds.of(s).cis.any()


def test_springs_to_a_bad_model_twist_no_bond():
    """Dihedrals off by 4 degrees add up; the springs alone twisted four bonds of this model by their pull."""
    s = models.turned(load("1ubq.pdb"), 4.0, seed=26)
    r = pc.relax(s, threads=1)
    assert r.status == "converged" and r.measures_end["twisted_peptides"] == 0
    bonds = PeptideBonds.of(s)
    assert (r.measures_start["twisted_peptides"], len(bonds.twisted_bonds(r.x))) == (0, 0)
    assert bonds(r.x)[0] > 0.0


def test_what_springs_do_not_hold_is_not_pushed():
    """The last stage of ``design`` is free, and AlphaFold's protocol has no such push."""
    s = load("1l2y.pdb")
    for preset, pushed in (
        (PRESETS["predicted"], True),
        (PRESETS["design"], False),
        (PROTOCOLS["alphafold"], False),
    ):
        relaxer = Relaxer(s, energy("1l2y.pdb"), preset, 0, lambda *_: None)
        springs = relaxer._springs(np.ones(s.n_residues), preset.backbone[-1], preset.side_chains[-1])
        assert (relaxer.restraint(springs) is not springs) == pushed


def test_what_is_left_or_lost_is_named_in_message_and_status(bent):
    name = "before A:SER13 (omega "
    r = pc.relax(bent, threads=1, protocol="alphafold", max_iterations=1)
    assert r.status == "budget" and "twisted peptide bonds: " + name in r.message
    s = load("1l2y.pdb")
    other = Problems(s, bent.positions)
    assert describe_problems(other) == []  # -75: it went to the other side, and is lost.
    half = Problems(s, with_omega(s, 12, 120.0).positions)
    assert describe_problems(half)[0].startswith("twisted peptide bonds: " + name)
    assert _newly_reversed(half).tolist() == [] and _newly_reversed(other).tolist() == [bond_before(s, 12)[2]]


def test_a_bond_of_fixed_atoms_does_not_decide_the_status():
    """A mutation fixes the backbone. If the bond moves, the same twist is a violation."""
    twisted = with_omega(load("1l2y.pdb"), 12, 120.0)
    r = pc.mutate(twisted, "A:L2A", solvent="vacuum", threads=1).mutant
    old = "was in the input, at fixed atoms: twisted peptide bonds: before A:SER13"
    assert r.status == "converged" and old in r.message
    problems = Problems(twisted, twisted.positions, twisted.atom_residue == 11)
    assert describe_problems(problems)[0].startswith("twisted peptide bonds: before A:SER13")
    assert describe_problems(replace(problems, fixed=True)) == []
    # Overlaps and violations count by their atoms.
    x = twisted.positions.copy()
    x[twisted.atom_residue == 0] = x[twisted.atom_residue == 19][0] + 0.01
    crowded = Problems(twisted, x, twisted.atom_residue == 11)
    assert not crowded.mendable()[[0, 19]].any() and replace(crowded, moving=None).mendable()[0]


def test_minimise_names_a_bond_that_turned(bent):
    s = load("1l2y.pdb")
    assert isomerised_bonds(s, bent.positions, s.positions)[0].startswith("before A:SER13 (omega ")
    assert not isomerised_bonds(bent, s.positions, bent.positions)  # It had no form that it could lose.
    status, message = verdict(Stop.TOLERANCE, True, "as measured", s, bent.positions, 5)
    assert status is pc.Status.ISOMERISED and message.startswith(
        "isomerised: the peptide bond before A:SER13"
    )
    assert verdict(Stop.INTERRUPTED, True, "", s, bent.positions, 5)[0] is pc.Status.INTERRUPTED


def test_minimise_names_a_bond_that_became_twisted():
    """Not as a status: the minimum of a force field may have one."""
    s = load("1l2y.pdb")
    r = pulled(s, 12, 130.0)
    (said,) = twisted_bonds(s, r.x, s.positions)
    assert said.startswith("before A:SER13 (omega ") and r.status == "converged"
    assert r.message.endswith(f"; peptide bonds that became twisted: {said}")
