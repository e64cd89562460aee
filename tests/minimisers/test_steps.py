"""Step rules along a line whose heights are told."""

from itertools import pairwise

import numpy as np
import pytest
from fixtures.quadratics import along, evaluation
from scipy.optimize import line_search

from protochain.minimisers.steps import AcceptReject, Armijo, Decaying, Fixed, StrongWolfe, _search_length


def heights(told, elsewhere=100.0):
    return lambda t: told.get(t, elsewhere)


def test_a_fixed_step_is_taken_whether_the_energy_falls_or_rises():
    problem, at, direction = along(heights({0.0: 1.0, 0.25: 9.0}))
    assert Fixed(0.25).init(at) is None
    length, found, state = Fixed(0.25).step(problem, at, direction, None)
    assert (length, found.energy, state) == (0.25, 9.0, None) and found.q.tolist() == [0.25, 0.0, 0.0]


def test_decaying_steps_halve_after_their_half():
    rule = Decaying(0.5, 4.0)
    problem, at, direction = along(lambda t: 7.0)
    assert rule.init(at) == 0
    for taken, expected in ((0, 0.5), (4, 0.25), (12, 0.125)):
        length, found, state = rule.step(problem, at, 2.0 * direction, taken)
        assert (length, found.q[0], found.energy, state) == (expected, 2.0 * expected, 7.0, taken + 1)


def test_accept_reject_takes_a_step_back_until_the_energy_falls():
    # Equal is no fall, and minus infinity no energy.
    told = {0.0: 1.0, 0.8: 3.0, 0.4: 1.0, 0.2: -np.inf, 0.1: 0.9}
    problem, at, direction = along(heights(told))
    rule = AcceptReject(0.8)
    assert rule.init(at) == 0.8
    length, found, state = rule.step(problem, at, direction, rule.init(at))
    assert problem.energy.asked == [0.8, 0.4, 0.2, 0.1]
    assert (length, found.energy, state) == (0.1, 0.9, pytest.approx(0.12, rel=1e-14))
    problem, at, direction = along(heights(told))
    length, _, state = AcceptReject(9.0, grow=3.0, shrink=0.25).step(problem, at, direction, 0.4)
    assert problem.energy.asked == [0.4, 0.1] and (length, state) == (0.1, pytest.approx(0.3))


@pytest.mark.parametrize("rule", [AcceptReject(1.0), Armijo(1.0)])
def test_steps_lost_in_rounding_are_not_tried(rule):
    problem, at, direction = along(heights({0.0: 1.0}))
    # The largest entry counts: 2 here. Tried are lengths above 0.5e-8.
    state = {AcceptReject: 2e-8, Armijo: (2e-8, (1.0,))}[type(rule)]
    assert rule.step(problem, at, np.array([1.0, -2.0, 0.5]), state) is None
    assert problem.energy.asked == [2e-8, 1e-8]
    state = {AcceptReject: 1e-8, Armijo: (1e-8, (1.0,))}[type(rule)]
    assert rule.step(problem, at, direction, state) is None and len(problem.energy.asked) == 2


def test_armijos_first_state_is_its_length_and_the_energy():
    assert Armijo(0.3).init(evaluation(5.0, [1.0, 0.0, 0.0])) == (0.3, (5.0,))
    assert Armijo(0.3) == Armijo(0.3, window=1, decrease=1e-4)


def test_armijo_asks_for_its_share_of_the_slope_below_the_highest_of_its_window():
    # The slope is 3 (torque) x 2 (direction): at a length of 1 at least 0.25 x 6 below 5, the highest seen.
    rule, seen = Armijo(1.0, window=2, decrease=0.25), (5.0, 3.0)
    for told, length in (
        ({2.0: 3.5}, 1.0),
        ({2.0: 3.51, 1.0: 4.25}, 0.5),
        ({2.0: 3.51, 1.0: 4.26, 0.5: 4.625}, 0.25),
        ({2.0: -np.inf, 1.0: 4.0}, 0.5),
    ):
        problem, at, direction = along(heights({0.0: 3.0} | told), torque=lambda t: 3.0)
        taken, found, state = rule.step(problem, at, 2.0 * direction, (1.0, seen))
        assert taken == length and found.energy == list(told.values())[-1] and found.q[0] == 2.0 * length
        assert state == (2.0 * length, (3.0, found.energy))


def test_the_line_search_takes_a_full_step_where_it_meets_the_conditions():
    problem, at, direction = along(lambda t: 0.5 * (t - 1.25) ** 2, lambda t: 1.25 - t)
    length, found, state = StrongWolfe().step(problem, at, direction, None)
    assert (length, found.q[0], state) == (1.0, 1.0, None)
    # No point is evaluated twice, and that at 0 is known.
    assert problem.energy.asked == [1.0]


def test_the_line_search_shortens_a_step_that_is_too_long():
    problem, at, direction = along(lambda t: 0.5 * (t - 0.125) ** 2, lambda t: 0.125 - t)
    length, found, _ = StrongWolfe().step(problem, at, direction, None)
    # The parabola through the start, its slope and the first point has its vertex at the minimum.
    assert length == pytest.approx(0.125, rel=1e-9) and found.energy < 1e-15
    assert found.q[0] == length and len(problem.energy.asked) == len(set(problem.energy.asked))


@pytest.mark.parametrize("size", [1.0, 0.5])
@pytest.mark.parametrize(("beyond", "torque"), [(1.0, 1.0), (np.inf, np.nan)])
def test_a_line_search_that_fails_steps_back_by_tens_and_then_gives_up(size, beyond, torque):
    # The torque says that the energy falls; it never does.
    problem, at, direction = along(lambda t: beyond if t else 1.0, lambda t: torque if t else 1.0)
    assert StrongWolfe().step(problem, at, size * direction, None) is None
    asked = problem.energy.asked
    assert asked[-1] <= 1e-8 < asked[-2] and asked[-1] == pytest.approx(0.1 * asked[-2])
    # The search itself ends above 1e-4 / 4.
    shorter = [t for t in asked if t < 2e-5]
    assert len(shorter) > 3 and all(b == pytest.approx(0.1 * a) for a, b in pairwise(shorter))


def test_a_line_search_that_fails_takes_the_lowest_point_it_met():
    # A wall at 1e-5: below it the energy falls, beyond it there is none.
    def energy(t):
        return -t if t < 1e-5 else np.inf

    problem, at, direction = along(energy)
    length, found, state = StrongWolfe().step(problem, at, direction, None)
    inside = [t for t in problem.energy.asked if t < 1e-5]
    assert state is None and length == max(inside) and found.q[0] == length and found.energy == -length
    assert inside == [problem.energy.asked[-1]]


@pytest.mark.parametrize("wall", [0.3, 1e-3, 1e-6])
@pytest.mark.parametrize("torque", [np.nan, 1.0, -1.0, 0.0])
def test_the_line_search_ends_at_no_point_without_an_energy(wall, torque):
    """NaN is neither higher nor lower than the start: the search must not take it for a fall."""
    problem, at, direction = along(
        lambda t: -t if t < wall else np.nan, lambda t: 1.0 if t < wall else torque
    )
    length, found, _ = StrongWolfe().step(problem, at, direction, None)
    assert 0.0 < length < wall and found.energy == -length and found.is_finite
    problem, at, direction = along(lambda t: np.nan if t else 0.0, lambda t: torque if t else 1.0)
    assert StrongWolfe().step(problem, at, direction, None) is None


def test_a_fall_without_an_end_is_followed_for_ten_doublings():
    problem, at, direction = along(lambda t: -t, lambda t: 1.0)
    length, found, _ = StrongWolfe().step(problem, at, direction, None)
    assert problem.energy.asked == [2.0**k for k in range(11)] and (length, found.energy) == (1024.0, -1024.0)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_the_line_search_asks_for_the_same_points_as_scipys():
    """Waves on a parabola, some with a wall beyond which there is no energy."""
    n = failed = 0
    for seed in range(600):
        r = np.random.default_rng(seed)
        size, fast, phase = np.exp(r.normal(size=6)), np.exp(1.5 * r.normal(size=6)), r.uniform(0, 6, 6)
        wall = np.exp(2 * r.normal()) if seed % 3 == 0 else np.inf
        asked = []

        def height(t, size=size, fast=fast, phase=phase, wall=wall, asked=asked):
            asked.append(t := float(np.squeeze(t)))
            return float(size @ np.sin(fast * t + phase)) + 0.1 * t * t if t < wall else np.inf

        def slope(t, size=size, fast=fast, phase=phase, wall=wall):
            t = float(np.squeeze(t))
            return float(size * fast @ np.cos(fast * t + phase)) + 0.2 * t if t < wall else np.nan

        if slope(0.0) < 0.0:
            one, start = np.ones(1), height(0.0)
            theirs = line_search(
                height, lambda t, slope=slope: slope(t) * np.ones(1), 0 * one, one, slope(0.0) * one, start
            )[0]
            before = asked[1:]
            asked.clear()
            assert _search_length(height, slope, start, -slope(0.0)) == theirs and asked == before
            n, failed = n + 1, failed + (theirs is None)
    assert n > 200 and 0 < failed < n


def test_a_line_search_that_fails_beside_a_lower_point_takes_that_point():
    # Falls steeply at all lengths, against a slope that claims to rise beyond 0.5: no Wolfe point.
    def energy(t):
        return -1.0 if t == 1.0 else np.nan if t else 0.0

    problem, at, direction = along(energy, lambda t: -1e9 if t else 1.0)
    length, found, _ = StrongWolfe().step(problem, at, direction, None)
    assert (length, found.energy) == (1.0, -1.0)
