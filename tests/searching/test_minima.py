"""Which minima are the same, which are alike, and their harmonic free energies."""

import numpy as np
import pytest

import protochain as pc
from protochain.core.units import MOLAR_GAS
from protochain.searching import conformers
from protochain.searching.minima import SAME_ENERGY, clusters, free_energy, periods, unique

KT = MOLAR_GAS * 300.0


def test_half_turns_of_what_is_symmetrical_change_nothing():
    chain = pc.build_chain(pc.from_sequence("AFYDN"), root="fixed")
    period = dict(
        zip(
            [(h.residue_name, h.kind) for h in chain.hinges],
            periods(chain)[chain.tree.q_start[chain.hinge_body]],
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
        own = periods(chain)[chain.tree.q_start[chain.hinge_body]]
        found = {h.kind for h, its in zip(chain.hinges, own, strict=True) if its == np.pi}
        assert found == half


def test_minima_are_told_apart_by_torsions_and_energy():
    period = np.array([2 * np.pi, np.pi])
    q = np.array([[0.0, 0.0], [3.1, 0.1], [-3.1, 0.1 + np.pi], [0.0, 1.0], [0.05, 0.0], [0.0, 0.0]])
    energy = np.array([1.0, 0.0, 0.2, 0.1, 1.3, 9.0])
    # 2 is 1 around both circles, 4 is 0; 5 is at the same place with another energy.
    assert unique(q, energy, period).tolist() == [1, 3, 0, 5]
    energy[3] = np.inf
    assert unique(q, energy, period).tolist() == [1, 0, 5]


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
