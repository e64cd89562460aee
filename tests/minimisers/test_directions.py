"""One step of each minimiser against its textbook's formula, on quadratic energies."""

import numpy as np
import pytest
from fixtures.quadratics import Along, Flat, Quadratic, evaluation, positive

from protochain.minimisers.fire import Fire, FireState
from protochain.minimisers.lbfgs import LBFGS, quasi_newton
from protochain.minimisers.metrics import Mass, Preconditioner, Stiffness
from protochain.minimisers.newton import Newton, PseudoTransient, PseudoTransientState, conjugate_gradients
from protochain.minimisers.problem import Problem

STEP = 1e-6
"""Relative, of a product with H by a difference quotient over 1e-5 on a quadratic: eps / 1e-5, and more
where conjugate gradients enlarge it."""


def inverse(matrix):
    return lambda torque: np.linalg.solve(matrix, torque)


def dense_inverse_bfgs(pairs, metric):
    """Inverse Hessian by its update formula (Nocedal, Wright, 6.17), from the scaled metric."""
    s, y, _ = pairs[-1]
    start = np.linalg.inv(metric)
    h = (s @ y) / (y @ start @ y) * start
    for s, y, _ in pairs:
        left = np.eye(len(s)) - np.outer(s, y) / (s @ y)
        h = left @ h @ left.T + np.outer(s, s) / (s @ y)
    return h


def pairs_of(hessian, n, seed=0):
    steps = np.random.default_rng(seed).normal(size=(n, len(hessian)))
    return tuple((s, hessian @ s, float(s @ hessian @ s)) for s in steps)


def test_the_two_loop_recursion_starts_from_the_scaled_metric():
    hessian, metric = positive(6, 1), positive(6, 2)
    torque = np.arange(1.0, 7.0)
    for n in (1, 3):
        pairs = pairs_of(hessian, n)
        kept = torque.copy(), [tuple(np.copy(part) for part in pair) for pair in pairs]
        found = quasi_newton(torque, pairs, inverse(metric))
        assert found == pytest.approx(dense_inverse_bfgs(pairs, metric) @ torque, rel=1e-10)
        assert np.array_equal(torque, kept[0])
        for pair, before in zip(pairs, kept[1], strict=True):
            assert all(np.array_equal(a, b) for a, b in zip(pair, before, strict=True))
    assert quasi_newton(torque, (), inverse(metric)) == pytest.approx(inverse(metric)(torque), rel=1e-14)


@pytest.mark.parametrize("scale", [1e-4, 1e3])
def test_lbfgs_proposes_its_direction_then_the_preconditioned_torques_neither_too_long(scale):
    hessian, metric = positive(6, 1), positive(6, 2)
    problem = Problem(Flat(longest=0.5, first=0.01), Quadratic(hessian), 9)
    at, pairs = problem.evaluate(scale * np.arange(1.0, 7.0)), pairs_of(hessian, 3)
    (first, kept), (second, none) = LBFGS().propose(problem, at, inverse(metric), pairs)
    assert kept is pairs and none == ()
    for found, limit, whole in (
        (first, 0.5, dense_inverse_bfgs(pairs, metric) @ at.torque),
        (second, 0.01, inverse(metric)(at.torque)),
    ):
        longest = np.abs(whole).max()
        assert (longest > limit) == (scale > 1.0)
        assert found == pytest.approx(whole * (limit / longest if scale > 1.0 else 1.0), rel=1e-9)
    ((alone, memory),) = LBFGS().propose(problem, at, inverse(metric), ())
    assert np.array_equal(alone, second) and memory == ()
    assert problem.n_evaluations == 1


def test_lbfgs_keeps_pairs_of_positive_curvature_the_newest_last():
    def after(torque):
        return evaluation(0.0, torque)

    step, start = np.array([2.0, 0.0, 0.0]), after([3.0, 1.0, 1.0])
    ((s, y, curvature),) = LBFGS().update((), start, step, after([1.0, 0.5, 2.0]))
    assert s is step and y.tolist() == [2.0, 0.5, -1.0] and curvature == 4.0
    # Of the curvature, what counts is its share of both lengths: 1e-10 is the limit.
    for share, n in ((2e-10, 1), (0.5e-10, 0), (0.0, 0), (-1.0, 0)):
        for size in (1e-4, 1e4):
            changed = after(start.torque - size * np.array([share, 1.0, 0.0]))
            assert len(LBFGS().update((), after(start.torque), size * step, changed)) == n
    memory = tuple((step, step, float(k)) for k in range(3))
    kept = LBFGS(memory=3).update(memory, start, step, after([1.0, 0.5, 2.0]))
    assert [pair[2] for pair in kept] == [1.0, 2.0, 4.0]
    assert LBFGS() == LBFGS(Stiffness(20), 100)


def textbook_pcg(hessian, torque, metric, shift, rtol, most):
    """Preconditioned conjugate gradients with the matrix itself: the solution and the number of products."""
    a, d = hessian + shift * np.eye(len(torque)), np.zeros_like(torque)
    r = torque - a @ d
    z = np.linalg.solve(metric, r)
    p, first = z, r @ z
    n = 0
    while n < most:
        n += 1
        alpha = (r @ z) / (p @ a @ p)
        d, new = d + alpha * p, r - alpha * a @ p
        fresh = np.linalg.solve(metric, new)
        beta = (new @ fresh) / (r @ z)
        r, z, p = new, fresh, fresh + beta * p
        if np.sqrt(r @ z) <= rtol * np.sqrt(first):
            break
    return d, n


@pytest.mark.parametrize("shift", [0.0, 30.0])
@pytest.mark.parametrize("rtol", [0.7, 0.3, 0.1, 0.03, 1e-3, 1e-6])
def test_conjugate_gradients_are_the_textbooks_and_stop_at_their_tolerance(shift, rtol):
    hessian, metric = positive(6, 1), positive(6, 2, 5.0)
    problem = Problem(Flat(), Quadratic(hessian), 99)
    at = problem.evaluate(np.linspace(-1.0, 2.0, 6))
    for most in (2, 20):
        before = problem.n_evaluations
        found = conjugate_gradients(problem, at, inverse(metric), shift, rtol, most)
        expected, n = textbook_pcg(hessian, at.torque, metric, shift, rtol, most)
        assert found == pytest.approx(expected, rel=STEP, abs=STEP * np.abs(expected).max())
        assert problem.n_evaluations - before == n


def test_a_product_with_the_hessian_steps_a_hundred_thousandth_of_the_largest_freedom():
    problem = Problem(Flat(), Quadratic(np.eye(3)), 99)
    at = problem.evaluate(np.array([1.0, -4.0, 2.0]))
    conjugate_gradients(problem, at, np.copy, 0.0, 0.1, 1)
    assert problem.energy.asked[1] - at.q == pytest.approx(1e-5 * np.array([-0.25, 1.0, -0.5]), rel=1e-9)


def test_conjugate_gradients_end_at_a_direction_without_positive_curvature():
    # Flat: the torque itself; a saddle: what was found before its curvature was met.
    for hessian in (np.zeros((3, 3)), -np.eye(3)):
        problem = Problem(Flat(), Quadratic(hessian), 99)
        at = evaluation(0.0, [2.0, 1.0, 0.0])
        slope = Problem(Flat(), lambda x, h=hessian: (0.0, np.array([[2.0, 1.0, 0.0]]) - x @ h), 99)
        found = conjugate_gradients(slope, at, np.copy, 0.0, 0.1, 9)
        assert np.array_equal(found, at.torque) and found is not at.torque and slope.n_evaluations == 1
    problem = Problem(Flat(), Quadratic(np.diag([1.0, -1.0, 1.0])), 99)
    at = problem.evaluate(np.array([-2.0, 1.0, 0.0]))
    # Curvature along (2, 1, 0): 3 for a length of 5.
    assert at.torque.tolist() == [2.0, 1.0, 0.0]
    found = conjugate_gradients(problem, at, np.copy, 0.0, 1e-3, 9)
    assert found == pytest.approx(5.0 / 3.0 * at.torque, rel=STEP) and problem.n_evaluations == 3


def test_conjugate_gradients_stop_when_nothing_is_left():
    # With a torque that does not change the product is the shift, exactly.
    problem = Problem(Flat(), lambda x: (0.0, np.array([[3.0, 0.0, 0.0]])), 99)
    found = conjugate_gradients(problem, evaluation(0.0, [3.0, 0.0, 0.0]), np.copy, 2.0, 0.0, 9)
    assert found.tolist() == [1.5, 0.0, 0.0] and problem.n_evaluations == 1


@pytest.mark.parametrize(("residual", "rtol"), [(1e-3, 0.001), (10.0, 0.09950372), (1e4, 0.5)])
@pytest.mark.parametrize("scale", [1e-3, 10.0])
def test_newtons_direction_is_that_of_the_model_to_a_tolerance_that_falls_with_the_torque(
    residual, rtol, scale
):
    hessian, metric = positive(6, 1), positive(6, 2, 5.0)
    problem = Problem(Flat(longest=0.5, first=0.01), Quadratic(hessian), 99)
    at = problem.evaluate(scale * np.linspace(-1.0, 2.0, 6))
    at = evaluation(at.energy, at.torque, at.q, residual)
    (newton, kept), (plain, same) = Newton().propose(problem, at, inverse(metric), "kept")
    assert kept == same == "kept"
    for found, limit, whole in (
        (newton, 0.5, textbook_pcg(hessian, at.torque, metric, 0.0, rtol, 30)[0]),
        (plain, 0.01, inverse(metric)(at.torque)),
    ):
        expected = whole * min(1.0, limit / np.abs(whole).max())
        assert found == pytest.approx(expected, rel=1e-6, abs=1e-6 * np.abs(expected).max())
    for most in (1, 2):
        (cut, _), _ = Newton(max_products=most).propose(problem, at, inverse(metric), None)
        whole, _ = textbook_pcg(hessian, at.torque, metric, 0.0, rtol, most)
        whole *= min(1.0, 0.5 / np.abs(whole).max())
        assert cut == pytest.approx(whole, rel=1e-6, abs=1e-6 * np.abs(whole).max())
    assert Newton() == Newton(Stiffness(20), 30)


def test_newton_proposes_nothing_that_does_not_descend():
    # A metric that is not positive turns the torques round; at right angles there is no descent either.
    problem = Problem(Flat(), lambda x: (0.0, np.array([[3.0, 0.0, 0.0]])), 99)
    at = evaluation(0.0, [3.0, 0.0, 0.0])
    turned = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    for solve in (np.negative, lambda torque: turned @ torque):
        assert list(Newton().propose(problem, at, solve, None)) == []
    assert len(list(Newton().propose(problem, at, np.copy, None))) == 2


def test_pseudo_transient_steps_solve_the_implicit_equation_and_grow_as_torques_fall():
    hessian = positive(6, 1)
    problem = Problem(Flat(longest=0.5), Quadratic(hessian), 99)
    at = problem.evaluate(0.1 * np.linspace(-1.0, 2.0, 6))
    for delta in (1e-3, 0.1, 10.0):
        after = PseudoTransient().step(problem, PseudoTransientState(at, delta))
        turn, _ = textbook_pcg(hessian, at.torque, np.eye(6), 1.0 / delta, 0.1, 30)
        turn *= min(1.0, 0.5 / np.abs(turn).max())
        assert after.at.q - at.q == pytest.approx(turn, rel=1e-7, abs=1e-9)
        grown = delta * np.linalg.norm(at.torque) / np.linalg.norm(-hessian @ (at.q + turn))
        assert after.time_step == pytest.approx(grown, rel=1e-6)
        assert PseudoTransient(max_products=1).step(problem, PseudoTransientState(at, delta)).at.q == (
            pytest.approx(
                at.q + textbook_pcg(hessian, at.torque, np.eye(6), 1.0 / delta, 0.1, 1)[0], abs=1e-9
            )
        )
    for residual, expected in ((0.5, 0.01), (1.0, 0.01), (20.0, 0.0005)):
        first = PseudoTransient().init(problem, evaluation(0.0, at.torque, at.q, residual))
        assert first.time_step == pytest.approx(expected)
    assert PseudoTransient() == PseudoTransient(0.01, 30)


def test_pseudo_transient_steps_are_no_longer_than_their_space_allows():
    problem = Problem(Flat(longest=0.5), Along(lambda t: -t, lambda t: 4.0), 99)
    after = PseudoTransient().step(problem, PseudoTransientState(evaluation(0.0, [4.0, 0.0, 0.0]), 1.0))
    assert after.at.q.tolist() == [0.5, 0.0, 0.0] and after.time_step == 1.0


def test_pseudo_transient_steps_that_climb_are_taken_back_and_shortened():
    # The torque is 4 everywhere, so that a step is 4 delta: 1 climbs, 1/4 is level, 1/16 is no number.
    told = {1.0: 3.0, 0.25: 1.0, 1 / 16: -np.inf, 1 / 64: 0.5}
    problem = Problem(Flat(longest=9.0), Along(lambda t: told.get(t, 7.0), lambda t: 4.0), 99)
    at = evaluation(1.0, [4.0, 0.0, 0.0])
    after = PseudoTransient().step(problem, PseudoTransientState(at, 0.25))
    assert after.at.q.tolist() == [1 / 64, 0.0, 0.0] and after.time_step == 1 / 256
    assert [t for t in problem.energy.asked if t != 1e-5] == list(told)


def fire(v, torque, downhill=0, dt=0.01, mixing=0.25, mass=(1.0, 2.0, 4.0), longest=1e9, **settings):
    """A step of FIRE from the origin, its mass matrix diagonal; the torques elsewhere are others."""
    space = Flat(mass=np.diag(mass), longest=longest)
    problem = Problem(space, Quadratic(np.eye(3)), 9)
    at = evaluation(0.0, torque)
    made = Preconditioner(Mass(), at, inverse(space.mass))
    method = Fire(mixing=0.5, time_step=0.03, **settings)
    return method.step(problem, FireState(at, made, np.array(v), dt, mixing, downhill))


def test_fire_quickens_after_five_steps_downhill():
    v, torque = np.array([3.0, 0.0, 4.0]), np.array([1.0, 4.0, 8.0])
    slow, quick = fire(v, torque, downhill=4), fire(v, torque, downhill=5)
    assert (slow.time_step, slow.mixing, slow.downhill) == (0.01, 0.25, 5)
    assert (quick.time_step, quick.downhill) == (pytest.approx(0.011, rel=1e-14), 6)
    assert quick.mixing == pytest.approx(0.2475, rel=1e-14)
    # The velocity is turned by the mixing before, and moves for the longer step.
    push = np.array([1.0, 2.0, 2.0])
    turned = 0.75 * v + 0.25 * 5.0 / 3.0 * push + 0.011 * push
    assert quick.at.q == pytest.approx(0.011 * turned, rel=1e-14)
    assert fire(v, torque, downhill=5, longest_time_step=0.0105, fade=0.5).time_step == 0.0105
    assert fire(v, torque, downhill=5, fade=0.5).mixing == 0.125


@pytest.mark.parametrize("v", [(-3.0, 0.0, 0.0), (4.0, -1.0, 0.0)])
def test_fire_stops_and_halves_its_step_where_it_does_not_descend(v):
    torque, push = np.array([1.0, 4.0, 8.0]), np.array([1.0, 2.0, 2.0])
    assert v @ torque <= 0.0
    after = fire(v, torque, downhill=9)
    assert after.velocity == pytest.approx(0.005 * push, rel=1e-14)
    assert after.at.q == pytest.approx(0.005**2 * push, rel=1e-14)
    assert (after.time_step, after.mixing, after.downhill) == (0.005, 0.5, 0)


def test_fire_shortens_a_step_to_a_tenth_of_the_longest_and_its_velocity_alike():
    torque, push = np.array([1.0, 4.0, 8.0]), np.array([1.0, 2.0, 2.0])
    # From rest the largest turn is 2e-4.
    assert fire(np.zeros(3), torque, longest=2.1e-3).at.q == pytest.approx(1e-4 * push, rel=1e-14)
    after = fire(np.zeros(3), torque, longest=1e-3)
    assert after.at.q == pytest.approx(0.5e-4 * push, rel=1e-14)
    assert after.velocity == pytest.approx(0.005 * push, rel=1e-14) and after.time_step == 0.01


def test_fire_ends_where_there_is_no_number():
    problem = Problem(Flat(mass=np.eye(3)), Along(lambda t: np.nan), 9)
    first = Fire().init(problem, evaluation(0.0, [1.0, 0.0, 0.0]))
    assert Fire().step(problem, first) is None and problem.n_evaluations == 1
