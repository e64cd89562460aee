"""Which minima are the same, which are alike, and their harmonic free energies."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment
from scipy.spatial.transform import Rotation

import protochain as pc
from protochain.core.units import MOLAR_GAS
from protochain.searching import conformers
from protochain.searching.minima import SAME_ENERGY, Symmetry, clusters, free_energy, unique

KT = MOLAR_GAS * 300.0


def test_half_turns_of_what_is_symmetrical_change_nothing():
    chain = pc.build_chain(pc.from_sequence("AFYDN"), root="fixed")
    period = dict(
        zip(
            [(h.residue_name, h.kind) for h in chain.hinges],
            Symmetry.of(chain).period[chain.tree.q_start[chain.hinge_body]],
            strict=True,
        )
    )
    half = {key for key, value in period.items() if value == np.pi}
    assert half == {("PHE", "chi2"), ("ASP", "chi2"), ("ASN", "psi")}
    energy = pc.energy(chain.structure)
    for k, hinge in enumerate(chain.hinges):
        q = chain.q0.copy()
        q[chain.tree.q_start[chain.hinge_body[k]]] += np.pi
        rise = abs(energy(pc.pose(chain, q).x)[0] - energy(chain.structure.positions)[0])
        assert (rise < SAME_ENERGY) == ((hinge.residue_name, hinge.kind) in half), hinge


def test_a_carboxyl_group_with_its_hydrogen_is_not_symmetrical(tmp_path):
    without = pc.from_sequence("GDEG")
    pc.save(without, tmp_path / "acids.pdb")
    lines = (tmp_path / "acids.pdb").read_text().splitlines()
    (tmp_path / "acids.pdb").write_text("\n".join(each for each in lines if each[76:78] != " H"))
    for ph, half in ((7.0, {"chi2", "chi3", "psi"}), (2.0, {"psi"})):
        chain = pc.build_chain(pc.load(tmp_path / "acids.pdb", ph=ph), root="fixed")
        own = Symmetry.of(chain).period[chain.tree.q_start[chain.hinge_body]]
        found = {h.kind for h, its in zip(chain.hinges, own, strict=True) if its == np.pi}
        assert found == half


def test_minima_are_told_apart_by_torsions_and_energy():
    symmetry = Symmetry(np.array([2 * np.pi, np.pi]), np.empty((0, 2), dtype=int))
    q = np.array([[0.0, 0.0], [3.1, 0.1], [-3.1, 0.1 + np.pi], [0.0, 1.0], [0.05, 0.0], [0.0, 0.0]])
    energy = np.array([1.0, 0.0, 0.2, 0.1, 1.3, 9.0])
    # 2 is 1 around both circles, 4 is 0; 5 is at the same place with another energy.
    assert unique(q, energy, symmetry).tolist() == [1, 3, 0, 5]
    energy[3] = np.inf
    assert unique(q, energy, symmetry).tolist() == [1, 0, 5]


def exchanged(structure, x, y):
    """Largest distance, nm, of two superposed structures whose equal atoms may be exchanged."""
    backbone = np.isin(structure.atom_name, ("N", "CA", "C", "CB"))
    turn, _ = Rotation.align_vectors(
        y[backbone] - y[backbone].mean(axis=0), x[backbone] - x[backbone].mean(axis=0)
    )
    moved = turn.apply(x - x[backbone].mean(axis=0)) + y[backbone].mean(axis=0)
    apart = np.linalg.norm(moved[:, None] - y[None], axis=2)
    apart[structure.atom_element[:, None] != structure.atom_element[None]] = 9.0
    rows, columns = linear_sum_assignment(apart**2)
    return apart[rows, columns].max()


@pytest.mark.parametrize(
    ("sequence", "hinges", "turns"),
    [
        ("AK", "phi psi chi rotors", {"rotor A:1": 2 / 3, "rotor A:2": 2 / 3}),
        ("VL", "phi psi chi rotors", {"rotor A:1": 2 / 3, "rotor A:2": 4 / 3}),
        ("GY", "phi psi chi polar", {"chi2 A:2": 1, "rotor A:2": 1}),
        ("GF", "phi psi chi polar", {"chi2 A:2": 1}),
    ],
)
def test_turns_that_exchange_equal_atoms_are_one_minimum(sequence, hinges, turns):
    chain = pc.build_chain(pc.from_sequence(sequence), hinges, root="fixed")
    symmetry = Symmetry.of(chain)
    coordinates = chain.tree.q_start[chain.hinge_body]
    chosen = [(k, turns[h.name]) for k, h in zip(coordinates, chain.hinges, strict=True) if h.name in turns]
    q = chain.q0.copy()
    for k, turn in chosen:
        q[k] += np.pi * turn
    assert symmetry.farthest(q, chain.q0) < 1e-9
    # The oracle knows positions and elements alone.
    x, y = (pc.pose(chain, angles).x for angles in (q, chain.q0))
    assert exchanged(chain.structure, x, y) < 0.02
    for k, turn in chosen if len(chosen) == 2 and sequence == "GY" else ():
        alone = chain.q0.copy()
        alone[k] += np.pi * turn
        assert symmetry.farthest(alone, chain.q0) > 1.0
        assert exchanged(chain.structure, pc.pose(chain, alone).x, y) > 0.05


def test_rotors_do_not_multiply_minima():
    """Of AA with rotors an earlier version listed each minimum up to nine times."""
    chain = pc.build_chain(pc.from_sequence("AA"), "phi psi rotors")
    found = pc.search(chain, pc.energy(chain.structure, threads=1), evaluations=2000, n_walkers=1, seed=1)
    x = [found.landscape.positions(q) for q in found.q]
    for k in range(1, len(x)):
        near = np.abs(found.energies[:k] - found.energies[k]) < 0.3
        assert all(exchanged(chain.structure, x[k], x[j]) > 0.02 for j in np.flatnonzero(near))


def test_walks_that_reach_the_lowest_minimum_are_counted():
    chain = pc.build_chain(pc.from_sequence("AAA"))
    found = pc.search(chain, pc.energy(chain.structure, threads=1), evaluations=3000, n_walkers=3, seed=1)
    lowest = [walk.minima[:, 1].min() for walk in found.findings]
    assert found.n_walks_at_lowest == sum(energy < found.energy + SAME_ENERGY for energy in lowest)
    assert found.record()["n_walks_at_lowest"] == found.n_walks_at_lowest
    alone = replace(found, findings=found.findings[:1])
    assert alone.n_walks_at_lowest == 1 and "before you rely on it" in alone.agreement


def test_clusters_are_numbered_by_the_first_in_each():
    random = np.random.default_rng(0)
    shapes = [np.cumsum(random.standard_normal((8, 3)), axis=0) * 0.38 for _ in range(2)]
    turned = np.linalg.qr(random.standard_normal((3, 3)))[0]
    turned *= np.sign(np.linalg.det(turned))
    noise = [0.01 * random.standard_normal((8, 3)) for _ in range(5)]
    given = [shapes[1], shapes[0], shapes[1] @ turned, shapes[0] + 3.0, shapes[1]]
    found = clusters([x + n for x, n in zip(given, noise, strict=True)])
    assert found.tolist() == [1, 2, 1, 2, 1]
    assert clusters([shapes[0]]).tolist() == [1]


def test_free_energies_are_those_of_gaussian_integrals():
    """A quadratic energy in two torsions: -kT ln of the integral of exp(-E/kT), by sums."""
    hessian = np.array([[40.0, 12.0], [12.0, 90.0]])
    at = np.linspace(-3.0, 3.0, 601)
    a, b = np.meshgrid(at, at, indexing="ij")
    energy = 5.0 + 0.5 * (40.0 * a * a + 24.0 * a * b + 90.0 * b * b)
    integral = np.exp(-energy / KT).sum() * (at[1] - at[0]) ** 2
    assert free_energy(5.0, hessian, 300.0) == pytest.approx(-KT * np.log(integral), rel=1e-9)
    heavier = free_energy(5.0, hessian, 300.0, np.log(4.0))
    assert heavier == pytest.approx(-KT * np.log(2.0 * integral), rel=1e-9)
    assert np.isnan(free_energy(5.0, np.diag([1.0, -1.0]), 300.0))
    assert np.isnan(free_energy(5.0, np.diag([-1.0, -1.0]), 300.0))


@pytest.mark.parametrize(("sequence", "regions"), [("AAAA", "BB"), ("AAA", "B"), ("AA", "")])
def test_residues_between_others_have_a_region(sequence, regions):
    """An extended chain is beta all along; a dipeptide has no residue with both phi and psi."""
    chain = pc.build_chain(pc.from_sequence(sequence))
    q = np.array([chain.q0, chain.q0])
    assert conformers.names(*conformers.backbone(chain, q)).tolist() == [regions, regions]
    assert conformers.names(*conformers.backbone(chain, chain.q0)) == regions
    found = pc.search(chain, evaluations=100, method="hopping", n_walkers=1)
    assert {len(each) for each in found.minima["conformer"]} == {len(regions)}
