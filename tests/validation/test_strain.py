"""Strain: against the energy of OpenMM's force field, and planted faults."""

import numpy as np
import pytest
from fixtures.molecules import atom
from fixtures.oracles import angle_triples
from fixtures.oracles import angles as slow_angles
from fixtures.samples import load, shared

import protochain as pc
from protochain.core.arrays import angle, distance
from protochain.validation.rings import threaded_rings
from protochain.validation.strain import _terms, strain
from protochain.validation.violations import violations

RT = 8.314462618e-3 * 300.0


@pytest.mark.parametrize("name", ["1l2y.pdb", "3i40.pdb"])
def test_terms_are_those_of_the_force_field(name):
    """Half a square of each deviation, times RT, is the term's energy: the sums are OpenMM's."""
    s = load(name)
    (bonds, lengths), (triples, angles) = _terms(s, hydrogens=True)
    parts = pc.energy(s, engine="openmm", solvent="vacuum").parts(s.positions)[0]
    z = (distance(*s.positions[bonds.T]) - lengths[:, 0]) / lengths[:, 1]
    assert 0.5 * RT * (z**2).sum() == pytest.approx(parts["HarmonicBondForce"], rel=1e-6)
    z = (angle(*s.positions[triples.T]) - angles[:, 0]) / angles[:, 1]
    assert 0.5 * RT * (z**2).sum() == pytest.approx(parts["HarmonicAngleForce"], rel=1e-6)


@pytest.mark.parametrize("name", ["3i40.pdb", "ala10.pdb"])
def test_every_bond_and_angle_of_heavy_atoms_is_compared(name):
    s = load(name)
    heavy = s.bonds[(s.atom_element[s.bonds] != "H").all(axis=1)]
    found, triples = strain(s), angle_triples(heavy)
    assert found.n_bonds == len(heavy) and found.n_angles == len(triples)
    ours = {(min(i, k), j, max(i, k)) for i, j, k in _terms(s)[1][0].tolist()}
    assert ours == {(min(i, k), j, max(i, k)) for i, j, k in triples.tolist()}
    theirs = np.sort(slow_angles(triples, s.positions))
    assert np.sort(angle(*s.positions[_terms(s)[1][0].T])) == pytest.approx(theirs)


def test_molecules_beside_the_protein_are_left_out():
    s = pc.load(shared("4cup_missing.cif"))
    heavy = (s.atom_element[s.bonds] != "H").all(axis=1)
    beside = s.kept[s.bonds].any(axis=1)
    assert strain(s).n_bonds == (heavy & ~beside).sum() < heavy.sum()


def test_short_bonds_to_hydrogen_are_a_convention_of_crystals():
    """0.86 to 0.97 angstrom in this file."""
    s = pc.load(shared("3enl_enolase_H.pdb"))
    assert strain(s).n_bonds > 3000 and not len(strain(s).bonds)


@pytest.mark.parametrize(("by", "wrong"), [(0.0122, 0), (0.0126, 1), (-0.0126, 1), (-0.0122, 0)])
def test_a_bond_is_an_outlier_beyond_four_deviations(by, wrong):
    """C-N of ff14SB: 0.1335 nm, 410031 kJ/mol/nm^2, so sqrt(RT/k) = 0.00247 nm; four make 0.00987."""
    s = load("ala10.pdb")
    c, n = atom(s, 3, "C"), atom(s, 4, "N")
    scale = 0.009865 / 0.0124
    x = s.positions.copy()
    along = (x[n] - x[c]) / np.linalg.norm(x[n] - x[c])
    x[s.atom_residue >= 4] += (0.1335 + by * scale - np.linalg.norm(x[n] - x[c])) * along
    found = strain(s, x)
    assert found.bonds.tolist() == [[c, n]] * wrong
    if wrong:
        assert found.bond_deviations[0] == pytest.approx(by * scale / np.sqrt(RT / 410031.0), rel=1e-3)
        line = found.lines(s, x)[0]
        assert s.describe(c) in line and s.describe(n) in line
        assert (
            f"{10 * (0.1335 + by * scale):.2f} angstrom" in line
            and f"{found.bond_deviations[0]:+.1f}" in line
        )


@pytest.mark.parametrize("sign", [1, -1])
def test_a_bent_angle_is_named_with_its_sign(sign):
    """A serine's oxygen turned in the plane of its angle (109.5 degrees in ff14SB), bond kept."""
    s = load("1ubq.pdb")
    residue = int(np.flatnonzero(s.residue_name == "SER")[0])
    ca, cb, og = (atom(s, residue, name) for name in ("CA", "CB", "OG"))
    x = s.positions.copy()
    u, v = x[ca] - x[cb], x[og] - x[cb]
    aside = v - (v @ u) / (u @ u) * u
    degrees = 109.5 + sign * 22.0
    u, aside = u / np.linalg.norm(u), aside / np.linalg.norm(aside)
    x[og] = x[cb] + 0.141 * (np.cos(np.radians(degrees)) * u + np.sin(np.radians(degrees)) * aside)
    found, before = strain(s, x), strain(s)
    (new,) = {tuple(each) for each in found.angles.tolist()} - {
        tuple(each) for each in before.angles.tolist()
    }
    assert new == (ca, cb, og) and not len(found.bonds)
    row = found.angles.tolist().index([ca, cb, og])
    # 418.4 kJ/mol/rad^2
    expected = sign * np.radians(22.0) / np.sqrt(RT / 418.4)
    assert found.angle_deviations[row] == pytest.approx(expected, rel=1e-3)
    assert (
        f"angle CA-CB-OG of {s.describe_residue(residue)} is {degrees:.0f} degrees" in found.lines(s, x)[row]
    )


def test_one_atom_moved_strains_its_bonds_the_worst_first():
    s = load("4pti.pdb")
    assert not len(strain(s).bonds)
    moved = atom(s, 20, "CB")
    x = s.positions.copy()
    x[moved] += [0.05, 0.03, 0.0]
    found = strain(s, x)
    assert len(found.bonds) > 1 and (found.bonds == moved).any(axis=1).all()
    assert (np.diff(np.abs(found.bond_deviations)) <= 0).all()
    assert (np.diff(np.abs(found.angle_deviations)) <= 0).all()
    assert (np.abs(found.bond_deviations) > 4).all() and len(found.lines(s, x)) == len(found.bonds) + len(
        found.angles
    )


@pytest.mark.parametrize(
    ("name", "bonds", "angles"), [("1hel_lysozyme.pdb", 0, 0), ("src_1yi6_minimized.pdb", 0, 0)]
)
def test_a_refined_crystal_and_a_minimised_structure_have_none(name, bonds, angles):
    found = strain(pc.load(shared(name)))
    assert (len(found.bonds), len(found.angles)) == (bonds, angles)


def test_models_with_violations_have_some():
    found = strain(pc.load(shared("af_multiple_disulfides.pdb")))
    assert len(found.bonds) > 20 and len(found.angles) > 20
    # SG-SG bonds of 1.3 to 1.8 angstrom.
    s = pc.load(shared("af_multiple_disulfides.pdb"))
    assert sum(set(s.atom_name[pair]) == {"SG"} for pair in found.bonds) >= 8


@pytest.mark.parametrize("measure", [strain, violations, threaded_rings])
def test_positions_of_another_shape_are_refused(measure):
    with pytest.raises(pc.ProtochainError, match="x has shape"):
        measure(load("1l2y.pdb"), np.zeros((3, 3)))
