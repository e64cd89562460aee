"""Unfolding along soft modes: Chetaev's function rises at every step, contacts are lost, the way back."""

import itertools

import numpy as np
import pytest
from fixtures.samples import STRUCTURES

import protochain as pc
from protochain.chains.chain import pose, pull_back
from protochain.comparison.unfolding import SCALE, NativeContacts, control
from protochain.core.errors import Fault

LOST = 0.2


@pytest.fixture(scope="module")
def folded():
    return pc.minimise(STRUCTURES / "1l2y.pdb", method="lbfgs")


@pytest.fixture(scope="module")
def path(folded):
    return pc.unfold(folded, until=LOST, max_steps=1500)


def test_trp_cage_loses_its_contacts_and_its_energy_rises(folded, path):
    assert path.is_unfolded
    assert path.shares[0] == 1.0 and path.shares[-1] <= LOST < path.shares[-2]
    assert path.energies[0] == pytest.approx(folded.end.energy, abs=1e-6)
    assert path.energies[-1] > path.energies[0]
    assert len(path.energies) == len(path.shares) == len(path.rates) + 1
    table = path.table()
    assert table["contacts_share"].iloc[-1] == path.contacts.share(path.structure.positions)
    # Only hinges turn: bonds have their lengths.
    bonds = path.chain.structure.bonds
    assert np.linalg.norm(np.diff(path.structure.positions[bonds], axis=1)[:, 0], axis=1) == pytest.approx(
        np.linalg.norm(np.diff(folded.x[bonds], axis=1)[:, 0], axis=1), abs=1e-9
    )


def test_the_sum_of_native_distances_rises_by_the_predicted_rates(folded):
    short = pc.unfold(folded, angle=1e-5, max_steps=25)
    assert (short.rates > 0.0).all()
    before, after = (short.contacts.distances(x).sum() for x in (folded.x, short.structure.positions))
    # Second order in steps of 1e-5 rad.
    assert after - before == pytest.approx(short.rates.sum(), rel=1e-3)


def test_the_way_back_under_kcm_reports_whether_the_fold_returns(folded, path):
    back = pc.minimise(path.structure, method="kcm-adaptive", max_evaluations=600)
    assert back.end.energy < path.energies[-1]
    share = path.contacts.share(back.x)
    assert path.contacts.share(folded.x) == 1.0
    # Another basin: KCM goes down the nearest slope.
    assert share < 0.6 and pc.ca_rmsd(path.chain.structure, back.x, folded.x) > 2.0


def test_the_gradient_of_the_distances_is_that_of_differences(folded):
    contacts = NativeContacts.of_structure(folded.structure)
    chain = folded.chain
    at = pose(chain, folded.q)
    gradient = pull_back(chain, at, contacts.gradient(at.x))
    for v in (0, 7, chain.n_v - 1):
        turn = np.zeros(chain.n_v)
        turn[v] = 1e-6
        ends = (
            contacts.distances(pose(chain, folded.q + side * turn).x).sum() for side in (-1.0, 1.0)
        )  # hinges only: a fixed root
        low, high = ends
        assert (high - low) / 2e-6 == pytest.approx(gradient[v], abs=1e-6)


def test_pairs_are_near_and_apart_in_the_sequence(folded):
    contacts = NativeContacts.of_structure(folded.structure)
    x, residue = folded.x, folded.structure.atom_residue
    alphas = folded.structure.alpha_carbons
    expected = {
        (a, b)
        for k, a in enumerate(alphas)
        for b in alphas[k + 1 :]
        if np.linalg.norm(x[a] - x[b]) < 0.8 and residue[b] - residue[a] >= 3
    }
    assert {tuple(sorted(pair)) for pair in contacts.atoms.tolist()} == expected


def test_contacts_between_chains_count_at_every_separation():
    insulin = pc.load(STRUCTURES / "3i40.pdb")
    x, residue, chain = insulin.positions, insulin.atom_residue, insulin.residue_chain_index
    expected = {
        (a, b)
        for a, b in itertools.combinations(insulin.alpha_carbons.tolist(), 2)
        if np.linalg.norm(x[a] - x[b]) < 0.8
        and (chain[residue[a]] != chain[residue[b]] or residue[b] - residue[a] >= 3)
    }
    assert {tuple(sorted(pair)) for pair in NativeContacts.of_structure(insulin).atoms.tolist()} == expected
    assert any(chain[residue[a]] != chain[residue[b]] for a, b in expected)


def test_control_against_dense_projections():
    draw = np.random.default_rng(3)
    soft = np.linalg.qr(draw.normal(size=(12, 4)))[0]
    climb, torque = draw.normal(size=12), 300.0 * draw.normal(size=12)
    step = control(soft, climb, torque)
    inside = soft @ soft.T
    outside = np.eye(12) - inside
    rest = outside @ climb
    relaxing = outside @ torque
    relaxing = relaxing - rest * (rest @ relaxing) / (rest @ rest)
    expected = inside @ climb / np.abs(inside @ climb).max() + relaxing / max(np.abs(relaxing).max(), SCALE)
    assert step == pytest.approx(expected, abs=1e-12)
    assert climb @ step == pytest.approx(np.sum((soft.T @ climb) ** 2) / np.abs(inside @ climb).max())
    assert not control(soft, rest, torque).any()


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"angle": 0.0}, "angle"), ({"angle": float("nan")}, "angle"), ({"until": 1.0}, "until"),
        ({"modes": 0}, "modes"), ({"max_steps": 2.5}, "max_steps"),
    ],
)  # fmt: skip
def test_bad_settings_are_refused(folded, settings, words):
    with pytest.raises(pc.ProtochainError, match=f"^{words}"):
        pc.unfold(folded, **settings)


def test_a_chain_without_contacts_is_refused():
    with pytest.raises(pc.ProtochainError, match="no contacts"):
        pc.unfold(pc.from_sequence("AAAA"))


@pytest.mark.parametrize("late", [50, 131])
def test_a_step_with_infinite_forces_is_refused(folded, late):
    """Within the second derivatives, and at a step."""
    calls = iter(range(100_000))

    def energy(x):
        return 0.0, np.full_like(x, np.inf if next(calls) > late else 0.0)

    with pytest.raises(pc.ProtochainError) as error:
        pc.unfold(folded.chain, energy, max_steps=1500)
    assert error.value.fault is Fault.NOT_FINITE
