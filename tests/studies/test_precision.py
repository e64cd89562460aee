"""The curves of ``python analysis/bench precision``: oracles of the oracles, and what table and page say."""

import html
from functools import partial

import numpy as np
import openmm
import pandas as pd
import pytest
from fixtures.slow_mechanics import slow_mass_matrix
from fixtures.tolerances import ROUND_OFF
from scipy.special import i0

import protochain as pc
from bench.__main__ import main
from bench.cases import CURVES, Point
from bench.studies import precision
from bench.studies.precision import (
    closures,
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
from protochain.energies import build_system
from protochain.energies.native import neighbours
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


def test_decimal_forces_are_those_of_the_reference():
    structure = pc.from_sequence("GG")
    system = energies.only_pairs(build_system(structure, solvent="vacuum"))
    assert [type(force) for force in system.getForces()] == [openmm.NonbondedForce]
    points = {point.method: point for point in energies._digits("GG")}
    assert (
        max(points["native"].error, points["OpenMM, Reference"].error) < 1e-10 < points["OpenMM, CPU"].error
    )
    assert energies.rms(energies.pair_forces(system, structure.positions)) > 1.0


def test_lists_have_their_margin_back():
    usual = neighbours.SKIN
    with pytest.raises(ZeroDivisionError), energies._margin(0.3):
        assert neighbours.SKIN == 0.3
        raise ZeroDivisionError
    assert usual == neighbours.SKIN
    points = list(energies._margins("GAGAG", (0.02, 0.2)))
    assert {point.setting for point in points} == {"margin 0.02 nm", "margin 0.2 nm"}
    assert max(point.error for point in points) < 1e-9


def test_cutoffs_err_less_the_longer_they_are_and_not_at_all_against_the_same():
    table = curves.points_of("e", energies._cutoffs("GAGAGAG", "vacuum", (0.8, 1.5)))
    own = table[table["method"] == "native"].set_index(["case", "setting"])["error"]
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


def test_the_gradient_of_fixmans_potential_beats_its_differences():
    points = list(fixman._gradients(5, quick=True))
    ours, by_differences = points[0], points[1:]
    assert ours.error < 1e-11 < min(point.error for point in by_differences)
    assert by_differences[0].error / by_differences[1].error == pytest.approx(1e4, rel=0.1)


def test_products_with_the_hessian_have_the_order_of_their_rules():
    stiff = np.array([3.0, 5.0])

    def torque(h):
        return stiff * np.sin(h * np.array([1.0, 0.5]) + 0.3)

    exact = stiff * [1.0, 0.5] * np.cos(0.3)
    for name, order in (("one-sided", 1), ("central", 2), ("order four", 4)):
        rule, _ = hessians.RULES[name]
        errors = [np.abs(rule(torque, torque(0.0), h) - exact).max() for h in (0.04, 0.02)]
        assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.1)


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


def test_a_sentence_and_a_page_say_what_the_numbers_are(tmp_path, monkeypatch):
    evil = "<b>x</b>"
    points = [
        Point("slow", "h", 2.0, 1e-9, evil, "rad", "theory", 40, 5),
        Point("fast", "2 h", 0.5, 3e-4, evil, "rad", "theory", 1, 5),
        Point("none", "", np.nan, np.nan, evil, "rad", "theory", np.nan, 5),
        Point("a", "small", 0.1, 0.1, "sizes", "1", "theory", np.nan, 2),
        Point("a", "large", 0.2, 0.2, "sizes", "1", "theory", np.nan, 9),
    ]
    kind = curves.Kind("A kind", "What is measured.", lambda quick: points if quick else [])
    monkeypatch.setattr(precision, "KINDS", {"own": kind})
    (shown,) = precision.run(tmp_path, quick=True, only=["own"])
    assert len(shown) == 5
    table = pd.read_csv(tmp_path / "curves.csv")
    assert list(table.columns) == ["kind", *CURVES]
    assert table["kind"].unique().tolist() == ["own"]
    assert (tmp_path / "own.png").stat().st_size > 10_000
    said = curves.said(table)
    assert said[0].startswith(evil) and "3 settings of 3 methods" in said[0] and "1 gave no result" in said[0]
    assert "a (large)" in said[1]
    page = (tmp_path / "report.html").read_text()
    assert evil not in page and html.escape(said[0]) in page and page.count("<details") == 1
    for name in ("machine", "threads", "versions", "commit"):
        assert f"<dt>{name}</dt><dd>" in page
    assert f"numba {__import__('numba').__version__}" in page and "data:image/png" in page


def test_kinds_are_named_and_files_are_for_minimisers(tmp_path):
    with pytest.raises(pc.ProtochainError, match="no kind 'fast'; choose from solvers, energies, minimisers"):
        next(precision.run(tmp_path, only=["fast"]))
    with pytest.raises(pc.ProtochainError, match="only minimisers read files"):
        next(precision.run(tmp_path, [tmp_path / "x.pdb"], only=["fixman"]))


@pytest.mark.slow
def test_all_kinds_are_on_the_page_of_a_quick_run(tmp_path):
    assert main(["precision", "--quick", "-o", str(tmp_path)]) == 0
    table = pd.read_csv(tmp_path / "curves.csv")
    assert set(table["kind"]) == set(precision.KINDS)
    assert {f"{name}.csv" for name in precision.KINDS} | {
        "precision.csv", "ends.csv", "traces.csv", "precision.png",
    } <= {path.name for path in tmp_path.iterdir()}  # fmt: skip
    page = (tmp_path / "report.html").read_text()
    assert page.count("data:image/png") == len(precision.KINDS) and "gave no finite error" not in page
    assert table.groupby("kind")["source"].nunique().min() >= 1
