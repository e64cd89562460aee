"""Threaded rings: planted ones, a flat oracle, and none in real structures."""

from itertools import combinations

import numpy as np
import pytest
from fixtures.molecules import atom
from fixtures.samples import load, shared, still

import protochain as pc
from protochain.validation.rings import _least_area, rings, threaded_rings

NAMED = {
    "PHE": ["CG CD1 CE1 CZ CE2 CD2"],
    "TYR": ["CG CD1 CE1 CZ CE2 CD2"],
    "HIS": ["CG ND1 CE1 NE2 CD2"],
    "PRO": ["N CA CB CG CD"],
    "TRP": ["CG CD1 NE1 CE2 CD2", "CD2 CE2 CZ2 CH2 CZ3 CE3"],
}


def normal_of(corners):
    """Unit normal of the plane nearest to some points."""
    return np.linalg.svd(corners - corners.mean(axis=0))[2][2]


def goes_through(corners, start, end, margin=0.0):
    """Whether a line meets the ring's plane within it, by the angle that the ring subtends there.

    None if it does so less than the margin from an edge, where a ring that is not flat decides otherwise.
    """
    centre, normal = corners.mean(axis=0), normal_of(corners)
    here, there = (start - centre) @ normal, (end - centre) @ normal
    if here * there >= 0:
        return False
    at = start + (end - start) * here / (here - there)
    along = np.linalg.svd(corners - centre)[2][:2]
    flat, winding = (corners - at) @ along.T, 0.0
    for p, q in zip(flat, np.roll(flat, -1, axis=0), strict=True):
        winding += np.arctan2(p[0] * q[1] - p[1] * q[0], p @ q)
        nearest = p + np.clip(-p @ (q - p) / ((q - p) @ (q - p)), 0, 1) * (q - p)
        if np.linalg.norm(nearest) < margin:
            return None
    return abs(winding) > np.pi


def through(structure, atoms, bond, shift=0.0, aside=0.0):
    """Positions with a bond through the middle of a ring, or shifted along it, or aside of it (nm)."""
    x = structure.positions.copy()
    corners = x[list(atoms)]
    normal = normal_of(corners)
    across = (corners[0] - corners.mean(axis=0)) / np.linalg.norm(corners[0] - corners.mean(axis=0))
    middle = corners.mean(axis=0) + shift * normal + aside * across
    i, j = bond
    length = np.linalg.norm(x[i] - x[j])
    x[i], x[j] = middle - 0.5 * length * normal, middle + 0.5 * length * normal
    return x


@pytest.mark.parametrize("name", ["1ubq.pdb", "1l2y.pdb"])
def test_rings_are_those_of_the_amino_acids(name):
    s = load(name)
    expected = set()
    for residue, kind in enumerate(s.residue_name):
        for names in NAMED.get(str(kind), ()):
            expected.add(frozenset(atom(s, residue, each) for each in names.split()))
    found = rings(s)
    assert {frozenset(ring) for ring in found} == expected and len(found) == len(expected)
    bonded = set(map(tuple, s.bonds.tolist()))
    for ring in found:
        sides = zip(ring, (*ring[1:], ring[0]), strict=True)
        assert {tuple(sorted(side)) for side in sides} <= bonded


def test_rings_of_molecules_beside_the_protein_are_found():
    """Olanzapine: thiophene, benzene, piperazine and diazepine."""
    s = pc.load(shared("boltz2_5ht2c.cif"))
    assert sorted(len(ring) for ring in rings(s) if s.kept[list(ring)].all()) == [5, 6, 6, 7]


def test_a_disulfide_between_near_residues_closes_a_ring():
    """A6-A11 of insulin: 2 + 3 * 4 + 2 atoms of the main chain and CB, SG, SG, CB."""
    s = load("3i40.pdb")
    (ring,) = [ring for ring in rings(s) if len(ring) > 6]
    assert len(ring) == 20 and {"CB", "SG", "CA", "C", "N"} == set(s.atom_name[list(ring)])
    assert set(s.atom_residue[list(ring)]) == set(range(5, 11))


@pytest.mark.parametrize("name", ["1hel.pdb", "3i40.pdb", "1ejg.pdb"])
def test_no_ring_of_a_sample_is_threaded(name):
    assert threaded_rings(load(name)) == []


@pytest.mark.parametrize(
    "name",
    ["1bx8_hirustasin.pdb", "5vav_cyclic.pdb", "4cup_missing.cif"],
)  # fmt: skip
def test_no_ring_of_a_knotted_or_cyclic_structure_is_threaded(name):
    assert threaded_rings(pc.load(shared(name))) == []


@pytest.mark.parametrize(("name", "bond"), [("1l2y.pdb", ("CE", "NZ")), ("1vii.pdb", ("NZ", "HZ1"))])
def test_every_planted_ring_is_named(name, bond):
    """A lysine's bond, to a hydrogen too, is put through each ring in turn."""
    s = load(name)
    lysine = int(np.flatnonzero(s.residue_name == "LYS")[0])
    planted = tuple(sorted(atom(s, lysine, each) for each in bond))
    for atoms in rings(s):
        found = threaded_rings(s, through(s, atoms, planted))
        (its,) = [each for each in found if each.bond == planted and each.atoms == atoms]
        assert its.residue == s.atom_residue[atoms[0]]
        assert s.describe_residue(its.residue) in its.ring and s.describe_residue(lysine) in its.through
        assert f"bond {s.atom_name[planted[0]]}-{s.atom_name[planted[1]]}" in str(its)
        for shift, aside in ((0.1, 0.0), (-0.1, 0.0), (0.0, 0.2)):
            x = through(s, atoms, planted, shift, aside)
            assert not [each for each in threaded_rings(s, x) if (each.bond, each.atoms) == (planted, atoms)]


def test_all_crossings_of_two_chains_in_one_place_are_those_of_a_flat_oracle():
    s = load("3i40.pdb")
    rng = np.random.default_rng(5)
    is_a = s.residue_chain[s.atom_residue] == "A"
    n_found = 0
    for _ in range(3):
        x = s.positions.copy()
        x[is_a] += x[~is_a].mean(axis=0) - x[is_a].mean(axis=0) + rng.normal(0.0, 0.3, 3)
        found = {(each.atoms, each.bond) for each in threaded_rings(s, x)}
        for ring in rings(s):
            if len(ring) > 6:
                continue
            # A bond and a ring reach 0.3 nm from their middles at most.
            apart = np.linalg.norm(x[s.bonds].mean(axis=1) - x[list(ring)].mean(axis=0), axis=1)
            for bond in map(tuple, s.bonds[apart < 0.6].tolist()):
                if not set(bond) & set(ring):
                    expected = goes_through(x[list(ring)], *x[list(bond)], margin=0.02)
                    assert expected is None or expected == ((ring, bond) in found)
        n_found += len(found)
    assert n_found > 5


def test_a_disulfide_ring_is_threaded_by_a_bond_that_passes_it():
    s = load("3i40.pdb")
    (ring,) = [ring for ring in rings(s) if len(ring) > 6]
    lysine = int(np.flatnonzero(s.residue_name == "LYS")[0])
    bond = (atom(s, lysine, "CE"), atom(s, lysine, "NZ"))
    x = s.positions.copy()
    centre, normal = x[list(ring)].mean(axis=0), normal_of(x[list(ring)])
    x[bond[0]], x[bond[1]] = centre - 0.8 * normal, centre + 0.8 * normal
    (found,) = [each for each in threaded_rings(s, x) if each.bond == bond and each.atoms == ring]
    assert "ring of 20 atoms that the bond between atom SG of A:CYS6" in str(found)
    x[bond[1]] = centre - 0.7 * normal
    assert not [each for each in threaded_rings(s, x) if each.bond == bond and each.atoms == ring]


@pytest.mark.parametrize(("end", "crosses"), [(0.3, True), (0.8, False)])
def test_a_bond_through_both_sides_of_a_folded_ring_threads_it_not(end, crosses):
    """Bent to a U of 0.6 nm: a bond that ends between the arms is caught, one that passes both is not."""
    s = load("3i40.pdb")
    (ring,) = [ring for ring in rings(s) if len(ring) > 6]
    side = [(x, 0.0) for x in (0.9, 0.7, 0.5, 0.3)] + [(0.1, 0.1), (0.1, 0.5)]
    side += [(x, 0.6) for x in (0.3, 0.5, 0.7, 0.9)]
    x = s.positions + np.array([20.0, 0.0, 0.0])
    x[list(ring)] = [(u, 0.0, w) for u, w in side] + [(u, 0.25, w) for u, w in reversed(side)]
    lysine = int(np.flatnonzero(s.residue_name == "LYS")[0])
    bond = (atom(s, lysine, "CE"), atom(s, lysine, "NZ"))
    x[list(bond)] = [(0.62, 0.13, -0.2), (0.61, 0.12, end)]
    found = [each for each in threaded_rings(s, x) if each.bond == bond and each.atoms == ring]
    assert bool(found) is crosses


def test_molecules_held_fixed_are_not_held_against_the_protein():
    s = still(pc.load(shared("4cup_missing.cif")))
    inside = [ring for ring in rings(s) if s.obstacle[list(ring)].all()]
    bonds = s.bonds[s.obstacle[s.bonds].all(axis=1)]
    ring = inside[0]
    bond = next(tuple(b) for b in bonds.tolist() if not set(b) & set(ring))
    x = through(s, ring, bond)
    assert not [each for each in threaded_rings(s, x) if each.bond == bond and each.atoms == ring]
    of_protein = atom(s, int(s.atom_residue[s.alpha_carbons[3]]), "C"), atom(s, 3, "O")
    x = through(s, ring, of_protein)
    assert [each for each in threaded_rings(s, x) if each.bond == of_protein and each.atoms == ring]


def test_a_large_ring_is_cut_into_the_triangles_of_least_area():
    rng = np.random.default_rng(3)

    def area(corners, cut):
        return sum(
            0.5 * np.linalg.norm(np.cross(corners[b] - corners[a], corners[c] - corners[a]))
            for a, b, c in cut
        )

    def every(i, j):
        """All ways to cut the polygon of corners i to j."""
        if j - i < 2:
            return [[]]
        return [
            [*left, *right, (i, k, j)]
            for k in range(i + 1, j)
            for left in every(i, k)
            for right in every(k, j)
        ]

    assert len(every(0, 7)) == 132
    for _ in range(5):
        corners = rng.normal(size=(8, 3))
        found = _least_area(corners).tolist()
        assert len(found) == 6
        assert area(corners, found) == pytest.approx(min(area(corners, cut) for cut in every(0, 7)))
        used = [frozenset(side) for a, b, c in found for side in combinations((a, b, c), 2)]
        assert {frozenset((k, (k + 1) % 8)) for k in range(8)} <= set(used)
