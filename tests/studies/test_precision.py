"""The curves of ``python analysis/bench precision``: oracles of the oracles, and what table and page say."""

from functools import partial

import numpy as np
import pandas as pd
import pytest
from fixtures.slow_mechanics import slow_mass_matrix
from fixtures.tolerances import ROUND_OFF
from scipy.special import i0

from bench.studies.precision import (
    curves,
    differences,
    energies,
    extended,
    fixman,
    hessians,
    integrators,
    minimisers,
    sampling,
    solvers,
)  # fmt: skip
from bench.studies.precision.peptides import KT, peptide
from protochain.mechanics.multibody import HingeKind, integrate, mass_matrix, pose, random_tree


def tree_at(n=7, seed=3):
    tree = random_tree(n, seed, 0.4, HingeKind.FREE)
    return tree, np.random.default_rng(seed).uniform(-3, 3, tree.n_q)


def test_mechanics_in_extended_precision_are_those_of_the_definitions():
    tree, q = tree_at()
    frames, (turn, at) = pose(tree, q), extended.wide_frames(tree, q)
    assert turn.dtype == at.dtype == np.longdouble
    np.testing.assert_allclose(turn.astype(float), frames.rotation, atol=ROUND_OFF)
    np.testing.assert_allclose(at.astype(float), frames.origin, atol=ROUND_OFF)
    mass = slow_mass_matrix(tree, frames)
    for wide in (extended.wide_mass(tree, frames), extended.wide_mass(tree, (turn, at))):
        np.testing.assert_allclose(wide.matrix.astype(float), mass, atol=ROUND_OFF * np.abs(mass).max())
    right = np.random.default_rng(1).normal(size=(tree.n_v, 2))
    x = wide.solve(right)
    np.testing.assert_allclose(wide.times(x).astype(float), right, atol=ROUND_OFF)
    assert np.abs(wide.matrix @ x - right).max() < 1e3 * np.finfo(np.longdouble).eps * np.linalg.cond(mass)
    assert float(wide.log_det) == pytest.approx(np.linalg.slogdet(mass)[1], rel=ROUND_OFF)


def test_extrapolation_finds_the_derivative_and_says_how_well():
    value, left = differences.extrapolated(lambda h: np.array([np.sin(1 + h), np.exp(2 * h)]), 0.1, 6)
    off = np.abs(value - [np.cos(1), 2.0]).max()
    assert off < 1e-12 and left < 1e-11
    assert differences.extrapolated(lambda h: h**3, 0.1, 2)[0] == pytest.approx(0.0, abs=1e-15)


def test_every_solver_solves_and_conjugate_gradients_do_in_as_many_steps_as_there_are_freedoms():
    tree, frames, tau = solvers.posed(6)
    x = np.linalg.solve(mass_matrix(tree, frames), tau)
    size = 1e-9 * np.abs(x).max()
    for name, solver in solvers.SOLVERS.items():
        np.testing.assert_allclose(solver(tree, frames, tau), x, atol=size, err_msg=name)
    few, enough = (solvers.conjugate_gradients(n, tree, frames, tau) for n in (2, 3 * tree.n_v))
    np.testing.assert_allclose(enough, x, atol=size)
    assert np.abs(few - x).max() > 1e3 * size
    # Two steps minimise x M x / 2 - tau x over tau and M tau.
    basis = np.column_stack([tau, mass_matrix(tree, frames) @ tau])
    inner = basis.T @ mass_matrix(tree, frames) @ basis
    np.testing.assert_allclose(few, basis @ np.linalg.solve(inner, basis.T @ tau), rtol=1e-8)


def test_cutoffs_err_less_the_longer_they_are_and_not_at_all_against_the_same():
    table = curves.points_of("e", energies._cutoffs("GAGAGAG", "vacuum", (0.8, 1.5)))
    own = table[table["method"] == "native"].set_index(["case", "parameter"])["error"]
    every, same = own["vacuum, against all pairs"], own["vacuum, against the same cutoff"]
    assert every["0.8 nm"] > every["1.5 nm"] > 1e-3 > 1e-9 > every["all pairs"]
    assert (same < 1e-9).all()


@pytest.fixture(scope="module")
def small():
    return peptide("GAG", "vacuum", "free")


def test_integrators_have_their_order(small):
    exact = integrators._run(small, integrators.DormandPrince(1e-12), 0.032, 1)[0]
    for name, order in (("leapfrog", 2), ("lobatto", 2), ("midpoint", 2), ("rk4", 4)):
        errors = []
        for n in (8, 16):
            step = partial(integrators._points, small, name, "", integrators.FIXED[name], 0.032)
            angle, total = step(n, exact)
            errors.append(angle.error)
            assert angle.evaluations >= n * {"rk4": 4, "midpoint": 3}.get(name, 1)
            assert 0 < total.error < 1.0 and total.unit == "kJ/mol"
        assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.2), name


def test_what_is_sampled_has_the_distribution_of_theory():
    """Two hinges with a cosine of the last for a potential: von Mises, but for det M, which is counted."""
    of = peptide("AAA", "vacuum", "fixed", "resid 2", settle=False)
    assert of.chain.n_hinges == 2

    def pulled(q, factors):
        value = -2.0 * KT * np.cos(q[of.angles[-1]])
        # Half of ln det M, so that the density is that of the cosine alone.
        return value + 0.5 * KT * sampling.log_det(factors), np.zeros(of.chain.n_v)

    of.potential.of = pulled
    shares = sampling.exact_shares(of, 60)
    turns = (np.arange(6000) + 0.5) * 2 * np.pi / 6000
    expected = (np.exp(2 * np.cos(turns)) / (6000 * i0(2))).reshape(sampling.BINS, -1).sum(axis=1)
    np.testing.assert_allclose(shares, expected, atol=2e-3)


def test_the_gradient_of_fixmans_potential_beats_its_differences():
    points = list(fixman._gradients(5, quick=True))
    ours, by_differences = points[0], points[1:]
    assert ours.error < 1e-11 < min(point.error for point in by_differences)
    assert by_differences[0].error / by_differences[1].error == pytest.approx(1e4, rel=0.1)


def test_a_direction_of_the_hessian_is_minus_the_torque(small):
    direction = np.random.default_rng(0).normal(size=small.chain.n_v)
    torque = hessians.along(small, direction)
    energy = [
        small.potential(q, small.system.factors(q))[0]
        for q in (integrate(small.chain.tree, small.q, h * direction) for h in (0.011, 0.009))
    ]
    assert (energy[0] - energy[1]) / 0.002 == pytest.approx(torque(0.01) @ direction, rel=1e-4)


def test_minimisers_are_points_of_the_same_table():
    rows = [
        {"method": method, "cost": cost, "above_kj_mol_per_100_residues": above, "median": median}
        for method, scale in (("lbfgs", 1.0), ("cartesian", 5.0))
        for cost, per in (("evaluations", 10.0), ("seconds", 0.1))
        for above, median in zip(minimisers.ABOVE, (scale * per, 2 * scale * per, np.inf), strict=True)
    ]
    table = curves.points_of("minimisers", minimisers.points(pd.DataFrame(rows), 4))
    assert table["case"].tolist() == 3 * ["torsions only"] + 3 * ["all atoms free"]
    assert table["error"].tolist() == 2 * [100.0, 10.0, np.inf]
    assert table["evaluations"].tolist()[:2] == [10.0, 20.0] and table["seconds"].tolist()[4] == 1.0
    first = curves.said(table)[0]
    assert "lbfgs (within 10) comes closest" in first and "1 gave no result" in first
