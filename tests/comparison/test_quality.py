"""Measures of quality on small structures, whose values follow on paper."""

import mdtraj
import numpy as np
import pytest
from fixtures.molecules import molecule, ring
from fixtures.samples import load

import protochain as pc
from protochain.comparison import quality as module
from protochain.comparison.quality import quality, radius_of_gyration
from protochain.structure.superpose import displacements
from protochain.validation import MEASURES, measures
from protochain.validation.bonding import hydrogen_bonds, secondary_structure


def test_the_radius_of_gyration_weighs_masses():
    pair = molecule("HO", [[1.0, 2.0, 3.0], [1.0, 2.0, 3.5]])
    hydrogen, oxygen = pair.atom_mass
    # Two masses at a distance d: sqrt(m M) / (m + M) d.
    assert radius_of_gyration(pair) == pytest.approx(5.0 * np.sqrt(hydrogen * oxygen) / (hydrogen + oxygen))


L_SHAPE = [(0, 1), (1, 2), (3, 1), (3, 4)]
CORNER = [[0.1, 0, 0], [0, 0, 0], [0, 0.1, 0], [0, 0, 0.2], [0, 0.1, 0.1]]


def test_bonds_and_angles_are_those_of_the_topology():
    bent = molecule("CCCCC", CORNER, L_SHAPE)
    assert module._bond_lengths(bent) == pytest.approx([0.1, 0.1, 0.2, 0.1 * np.sqrt(2.0)])
    assert np.degrees(module._bond_angles(bent)) == pytest.approx([90, 90, 90, 45])
    assert not len(module._bond_angles(molecule("CC", [[0, 0, 0], [1, 0, 0]], [(0, 1)])))
    assert module._root_mean_square(np.array([3.0, -4.0])) == pytest.approx(np.sqrt(12.5))


def test_displacements_are_of_the_c_alphas_after_superposition():
    s = ring()
    x = s.positions.copy()
    x[s.alpha_carbons] = [[0.0, 0, 0], [1, 0, 0], [2, 0, 0]]
    start = s.with_positions(x)
    x = x + 5.0
    x[s.alpha_carbons[1]] += [0, 0.3, 0]
    # The middle one of three in a row leaves by 0.3 nm: one third of it shifts the centre.
    assert displacements(s, x, start.positions) == pytest.approx([1.0, 2.0, 1.0])


@pytest.fixture(scope="module")
def chain():
    return pc.from_sequence("AGPSA")


def test_helices_and_hydrogen_bonds_are_those_of_mdtraj():
    s = load("1l2y.pdb")
    frames = pc.to_mdtraj(s)
    kinds = {"helix": "H", "strand": "E", "loop": "C"}
    letters = [kinds[kind] for kind in secondary_structure(s).tolist()]
    assert letters == mdtraj.compute_dssp(frames, simplified=True)[0].tolist() and {*letters} == {"H", "C"}
    found = mdtraj.baker_hubbard(frames, freq=0.0, periodic=False)
    assert quality(s)["hydrogen_bonds"] == len(hydrogen_bonds(s)) == len(found) > 5


def test_a_row_of_quality_has_every_measure(chain):
    x = chain.positions.copy()
    x[0] += [0.0, 0.0, 0.05]
    end = chain.with_positions(1.25 * x)
    row = quality(end, chain)
    assert list(row) == [
        "radius_of_gyration_angstrom", "ca_rmsd_to_start_angstrom", "tm_score_to_start",
        "secondary_structure_kept", "overlaps", "hydrogen_bonds", *MEASURES,
        "bond_length_change_rms_angstrom", "bond_angle_change_rms_degrees",
    ]  # fmt: skip
    first, second = chain.bonds.T
    change = [
        np.linalg.norm(end.positions[i] - end.positions[j])
        - np.linalg.norm(chain.positions[i] - chain.positions[j])
        for i, j in zip(first, second, strict=True)
    ]
    assert row["bond_length_change_rms_angstrom"] == pytest.approx(10.0 * np.sqrt(np.mean(np.square(change))))
    assert row["bond_angle_change_rms_degrees"] > 0.1
    assert row["ca_rmsd_to_start_angstrom"] == pc.ca_rmsd(chain, end.positions, chain.positions)
    assert row["radius_of_gyration_angstrom"] == radius_of_gyration(end)
    assert 0.0 < row["tm_score_to_start"] < 1.0 and row["secondary_structure_kept"] == 1.0
    unchanged = quality(chain, chain)
    names = ("hydrogen_bonds", "bond_length_change_rms_angstrom", "bond_angle_change_rms_degrees")
    assert [unchanged[name] for name in names] == [len(hydrogen_bonds(chain)), 0.0, 0.0]
    assert {key: row[key] for key in MEASURES} == measures(end) != measures(chain)
    assert unchanged["ca_rmsd_to_start_angstrom"] < 1e-6 and unchanged["overlaps"] == 0
    short = pc.from_sequence("AA")
    assert quality(short, short)["tm_score_to_start"] is None
    near = chain.positions.copy()
    near[-1] = near[0] + 0.03
    assert quality(chain.with_positions(near), chain)["overlaps"] > 0


def test_what_is_kept_of_the_structure_is_a_fraction(chain, monkeypatch):
    kinds = iter([np.array(list("HHECC")), np.array(list("HHHHC"))])
    monkeypatch.setattr(module, "secondary_structure", lambda s: next(kinds))
    assert quality(chain, chain)["secondary_structure_kept"] == 0.6
