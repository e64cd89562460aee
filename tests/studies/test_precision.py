"""The curves of ``python analysis/bench precision``: oracles of the oracles, and what table and page say."""

from functools import partial

import numpy as np
import pandas as pd
import pytest
from fixtures.slow_mechanics import slow_mass_matrix
from fixtures.tolerances import ROUND_OFF

from bench.__main__ import main
from bench.studies import precision
from bench.studies.precision import (
    closures,
    differences,
    extended,
    integrators,
    solvers,
)  # fmt: skip
from bench.studies.precision.peptides import peptide
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


def test_closures_are_kept_in_a_few_corrections_and_the_dense_matrix_agrees():
    points = list(closures._accelerations(6))
    assert {point.method for point in points} == set(closures.ROUTES)
    assert max(point.error for point in points) < 1e-11
    chain, q = closures.bent(6)
    frames, tau = pose(chain.tree, q), np.random.default_rng(0).normal(size=chain.n_v)
    loop = closures.loop(chain, q, 1, 4)
    assert np.abs(loop.errors(frames)).max() < 1e-14 and len(loop.length) == 3
    x = closures.wide_closed(chain.tree, frames, tau, loop.rows(frames)).astype(float)
    # Along a motion without constraint forces the distances change at no rate.
    along = x / np.abs(x).max()
    rates = [loop.errors(pose(chain.tree, integrate(chain.tree, q, h * along))) for h in (1e-5, -1e-5)]
    assert np.abs(rates[0] - rates[1]).max() < 1e-13


@pytest.mark.slow
def test_all_kinds_are_on_the_page_of_a_quick_run(tmp_path):
    assert main(["precision", "--quick", "-o", str(tmp_path)]) == 0
    table = pd.read_csv(tmp_path / "curves.csv")
    assert set(table["kind"]) == set(precision.KINDS)
    assert {f"{name}.csv" for name in precision.KINDS} | {
        "precision.csv", "ends.csv", "traces.csv", "precision.png",
    } <= {path.name for path in tmp_path.iterdir()}  # fmt: skip
    page = (tmp_path / "report.html").read_text()
    assert page.count('src="data:image/') == len(precision.KINDS) and "gave no finite error" not in page
    assert table.groupby("kind")["source"].nunique().min() >= 1
