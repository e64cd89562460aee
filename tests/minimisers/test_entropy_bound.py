"""Bounds on a step of KCM: conditions of optimality against dense matrices, descent, limits of the bound."""

import numpy as np
import pytest
from fixtures.samples import chain, energy

import protochain as pc
from protochain.mechanics import multibody
from protochain.minimisers import Descent, Fixed, Torsions
from protochain.minimisers.entropy_bound import (
    METRIC_NAMES,
    EntropyBound,
    MeanTurn,
    TurnBound,
    ellipsoid_at,
    nearest_within,
)
from protochain.minimisers.problem import Problem, evaluate

KKT = 1e-12
"""Residual of the optimality conditions, relative to the largest turn: some hundred roundings."""
SHARES = (0.999, 0.5, 0.1, 1e-3)
"""Bounds as shares of the length of the step."""


def start_of(name, root):
    """Space, start and KCM step of a sample."""
    c = pc.build_chain(chain(name).structure, root=root)
    space = Torsions(c)
    at = evaluate(space, energy(name), c.q0)
    return space, at, at.torque / np.max(np.abs(at.torque))


def dense(ellipsoid, n):
    return np.array([ellipsoid.product(column) for column in np.eye(n)]).T


def positional_metric(space, at, atoms, weights):
    """Mean of w J^T J over atoms by central differences of positions."""
    step, n = 1e-5, space.chain.n_v
    columns = []
    for unit in np.eye(n):
        ahead, behind = (space.place(space.move(at.q, side * step * unit)).x[atoms] for side in (1.0, -1.0))
        columns.append(((ahead - behind) / (2.0 * step)).ravel())
    jacobian = np.array(columns).T
    return jacobian.T @ (np.repeat(weights / np.sum(weights), 3)[:, None] * jacobian)


@pytest.mark.parametrize("root", ["fixed", "free"])
def test_metrics_are_weighted_movements_of_atoms(root):
    space, at, _ = start_of("1l2y.pdb", root)
    n, structure = space.chain.n_v, space.chain.structure
    alphas = structure.alpha_carbons
    measured = dense(ellipsoid_at("positions", space, at), n)
    expected = positional_metric(space, at, alphas, np.ones(len(alphas)))
    np.testing.assert_allclose(measured, expected, atol=1e-8)
    distances = np.linalg.norm(at.x[alphas][:, None] - at.x[alphas], axis=2)
    apart = np.abs(np.subtract.outer(np.arange(len(alphas)), np.arange(len(alphas)))) >= 3
    weights = 1.0 + np.sum((distances <= 0.8) & apart, axis=1)
    assert weights.max() >= 4.0
    expected = positional_metric(space, at, alphas, weights)
    np.testing.assert_allclose(dense(ellipsoid_at("contacts", space, at), n), expected, atol=1e-8)
    mass = multibody.mass_matrix(space.chain.tree, at.pose.frames) / structure.atom_mass.sum()
    expected = np.outer(space.scale, space.scale) * mass
    np.testing.assert_allclose(dense(ellipsoid_at("mass", space, at), n), expected, atol=1e-14)
    np.testing.assert_array_equal(dense(MeanTurn(n), n), np.eye(n) / n)


@pytest.mark.parametrize("name", METRIC_NAMES)
@pytest.mark.parametrize(
    ("sample", "root"), [("1l2y.pdb", "fixed"), ("1l2y.pdb", "free"), ("4pti.pdb", "fixed")]
)
def test_the_nearest_step_meets_the_conditions_of_optimality(sample, root, name):
    space, at, step = start_of(sample, root)
    ellipsoid = ellipsoid_at(name, space, at)
    matrix = dense(ellipsoid, len(step))
    length = np.sqrt(step @ matrix @ step)
    for share in SHARES:
        nearest, multiplier = nearest_within(step, ellipsoid, share * length)
        assert multiplier > 0.0
        assert np.max(np.abs(nearest + multiplier * (matrix @ nearest) - step)) <= KKT
        assert np.sqrt(nearest @ matrix @ nearest) == pytest.approx(share * length, rel=KKT)
        assert at.torque @ nearest > 0.0
    within, multiplier = nearest_within(step, ellipsoid, 1.001 * length)
    assert within is step and multiplier == 0.0


def test_five_iterations_suffice_for_any_spectrum():
    class Diagonal:
        def __init__(self, values):
            self.values, self.solutions = values, 0

        def product(self, step):
            return self.values * step

        def shifted_solver(self, multiplier):
            self.solutions += 1
            return lambda step: step / (1.0 + multiplier * self.values)

    random = np.random.default_rng(0)
    for decades in (1, 4, 8):
        for share in SHARES:
            values = 10.0 ** -random.uniform(0.0, decades, 200)
            step = random.normal(size=200)
            ellipsoid = Diagonal(values)
            bound = share * np.sqrt(step @ (values * step))
            nearest, multiplier = nearest_within(step, ellipsoid, bound)
            assert ellipsoid.solutions <= 5
            residual = nearest * (1.0 + multiplier * values) - step
            assert np.max(np.abs(residual)) <= KKT * np.max(np.abs(step))


def test_without_an_active_bound_every_step_is_that_of_kcm():
    c, e = chain("1l2y.pdb"), energy("1l2y.pdb")
    plain = pc.minimise(c, e, "kcm", max_evaluations=15)
    for method in (
        pc.kcm(entropy_bound=1e6),
        pc.kcm(turn_bound=1e6),
        Descent(EntropyBound(), Fixed(0.0005)),
    ):
        bounded = pc.minimise(c, e, method, max_evaluations=15)
        assert np.array_equal(bounded.x, plain.x)


def steps_of(method, n=10):
    """Space, points and steps of a run of a method on Trp-cage."""
    c, e = chain("1l2y.pdb"), energy("1l2y.pdb")
    space = Torsions(c)
    problem = Problem(space, e, 1000)
    descent = method.runs[0].method
    state = descent.init(problem, problem.evaluate(c.q0))
    points = [state.at]
    for _ in range(n):
        state = descent.step(problem, state)
        points.append(state.at)
    return space, points, np.diff([point.q for point in points], axis=0)


@pytest.mark.parametrize("metric", METRIC_NAMES)
def test_the_bound_holds_at_every_step(metric):
    bound = 2e-5 if metric == "turns" else 2e-4
    space, points, steps = steps_of(pc.kcm(entropy_bound=bound, metric=metric))
    for at, step in zip(points, steps, strict=False):
        length = np.sqrt(step @ ellipsoid_at(metric, space, at).product(step))
        assert length == pytest.approx(bound, rel=1e-9)
        assert at.torque @ step > 0.0


def test_the_bound_of_turns_holds_at_every_hinge():
    _, points, steps = steps_of(pc.kcm(angle=0.002, turn_bound=0.0005))
    for at, step in zip(points, steps, strict=False):
        expected = np.clip(0.002 * at.torque / np.max(np.abs(at.torque)), -0.0005, 0.0005)
        np.testing.assert_allclose(step, expected, atol=1e-14)
    assert np.max(np.abs(steps)) == pytest.approx(0.0005, rel=1e-9)


def test_bounded_methods_have_names_of_their_settings():
    assert pc.kcm(entropy_bound=1e-4, metric="mass").name == "kcm-0.0005-entropy-mass-0.0001"
    assert pc.kcm(turn_bound=1e-4).name == "kcm-0.0005-turns-0.0001"
    assert pc.kcm(turn_bound=1e-4).runs[0].method.direction == TurnBound(limit=0.2)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"entropy_bound": 0.0}, "entropy_bound 0: give a number above 0"),
        ({"entropy_bound": np.nan}, "entropy_bound nan: give a number above 0"),
        ({"turn_bound": -1.0}, "turn_bound -1: give a number above 0"),
        ({"entropy_bound": 1.0, "turn_bound": 1.0}, "entropy_bound and turn_bound cannot be combined"),
        ({"entropy_bound": 1.0, "metric": "volume"}, "metric 'volume'"),
    ],
)
def test_settings_without_a_meaning_are_refused(settings, message):
    with pytest.raises(pc.ProtochainError) as refusal:
        pc.kcm(**settings)
    assert str(refusal.value).startswith(message)


def test_a_chain_without_c_alphas_needs_another_metric():
    c = pc.build_chain(pc.load("structures/1bna.pdb"), hinges="nucleic")
    with pytest.raises(
        pc.ProtochainError, match="no C-alpha atoms for this metric; choose 'mass' or 'turns'"
    ):
        pc.minimise(c, method="kcm-entropy", max_evaluations=3)
    assert pc.minimise(c, method=pc.kcm(entropy_bound=1e-4, metric="mass"), max_evaluations=3).end


def test_the_method_limits_the_rate_of_entropy_loss():
    """Its result is that of the direction with this bound, and not that of plain KCM."""
    c, e = chain("1l2y.pdb"), energy("1l2y.pdb")
    bounded = Descent(EntropyBound(rate=0.5), Fixed(0.0005))
    ends = [
        pc.minimise(c, e, method, max_evaluations=5).end.energy for method in ("kcm-entropy", bounded, "kcm")
    ]
    assert ends[0] == ends[1] != ends[2]
