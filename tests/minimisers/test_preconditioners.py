"""Metrics and how long each is used; a descent's bookkeeping."""

from dataclasses import dataclass, field

import numpy as np
import pytest
from fixtures.quadratics import Flat, Quadratic, evaluation, positive

from protochain.minimisers.descent import Descent, DescentState, Direction
from protochain.minimisers.kcm import KCM, by_largest, by_length
from protochain.minimisers.metrics import Euclidean, Mass, Preconditioner, Stiffness
from protochain.minimisers.problem import Problem
from protochain.minimisers.steps import Fixed

TORQUE = np.array([1.0, -2.0, 3.0])


def test_metrics_solve_with_the_matrices_of_their_space_at_the_point():
    space = Flat(matrix=positive(3, 1), mass=positive(3, 2))
    at = evaluation(0.0, TORQUE)
    for metric, matrix, name in ((Mass(), space.mass, "inertia"), (Stiffness(), space.matrix, "stiffness")):
        assert metric.at(space, at)(TORQUE) == pytest.approx(np.linalg.solve(matrix, TORQUE), rel=1e-14)
        assert space.made.pop() == (name, at)
    same = Euclidean().at(space, at)(TORQUE)
    assert np.array_equal(same, TORQUE) and same is not TORQUE
    # The mass matrix changes with the pose, contacts slowly, the identity never.
    assert (Mass().refresh_every, Stiffness().refresh_every) == (1, 20)
    assert Euclidean().refresh_every > 1e6


@pytest.mark.parametrize("every", [1, 2, 3])
def test_a_matrix_is_computed_again_after_its_iterations(every):
    space, points = Flat(matrix=np.eye(3)), [evaluation(float(k), TORQUE) for k in range(8)]
    used = [Preconditioner.first(Stiffness(every), space, points[0])]
    for at in points[1:]:
        used.append(used[-1].next(space, at))
    assert [each.age for each in used] == [k % every for k in range(8)]
    assert [each.made_at for each in used] == [points[k - k % every] for k in range(8)]
    assert len(space.made) == len(range(0, 8, every)) and {each.metric for each in used} == {Stiffness(every)}


@dataclass(frozen=True)
class TwoWays(Direction):
    """Proposes two directions, each with a memory, and notes what it is told."""

    metric: object = field(default_factory=lambda: Stiffness(2))
    told: list = field(default_factory=list)

    def propose(self, problem, at, solve, memory):
        self.told.append((at, memory))
        yield solve(at.torque), "first"
        yield -at.torque, "second"

    def update(self, memory, before, step, after):
        self.told.append((memory, before, step, after))
        return f"{memory} updated"


@dataclass(frozen=True)
class Refuses:
    """Step rule that steps by a quarter, but not along the first directions."""

    refused: int
    tried: list = field(default_factory=list)

    def init(self, at):
        return "begun"

    def step(self, problem, at, direction, state):
        self.tried.append((direction, state))
        if len(self.tried) <= self.refused:
            return None
        return 0.25, problem.evaluate(problem.move(at.q, 0.25 * direction)), "gone on"


@pytest.mark.parametrize("refused", [0, 1])
def test_a_descent_steps_along_the_first_direction_its_rule_accepts(refused):
    matrix = positive(3, 3)
    problem = Problem(Flat(matrix=matrix), Quadratic(np.eye(3)), 10)
    direction, rule = TwoWays(), Refuses(refused)
    method = Descent(direction, rule)
    at = problem.evaluate(TORQUE)
    state = method.init(problem, at)
    assert method.metric == Stiffness(2)
    assert (state.at, state.memory, state.rule, state.preconditioner.made_at) == (at, (), "begun", at)
    after = method.step(problem, state)
    ways = [np.linalg.solve(matrix, at.torque), -at.torque]
    assert len(rule.tried) == refused + 1 and rule.tried[0][1] == "begun"
    assert np.allclose(rule.tried[0][0], ways[0], rtol=1e-14)
    assert after.at.q == pytest.approx(at.q + 0.25 * ways[refused], rel=1e-14)
    name = ("first", "second")[refused]
    assert (after.memory, after.rule) == (f"{name} updated", "gone on")
    assert direction.told[0] == (at, ())
    memory, before, step, found = direction.told[1]
    assert (memory, before, found) == (name, at, after.at)
    assert step == pytest.approx(0.25 * ways[refused], rel=1e-14)
    assert after.preconditioner.age == 1 and after.preconditioner.made_at is at
    third = method.step(problem, after)
    assert third.preconditioner.age == 0 and third.preconditioner.made_at is third.at


def test_a_descent_ends_when_no_direction_is_accepted():
    problem = Problem(Flat(matrix=np.eye(3)), Quadratic(np.eye(3)), 10)
    method = Descent(TwoWays(), Refuses(2))
    state = method.init(problem, problem.evaluate(TORQUE))
    assert isinstance(state, DescentState) and method.step(problem, state) is None
    assert problem.n_evaluations == 1


def test_kcm_turns_along_its_torques_in_its_metric_and_norm():
    mass = positive(3, 4)
    problem = Problem(Flat(mass=mass), Quadratic(np.eye(3)), 10)
    at = problem.evaluate(TORQUE)
    push = np.linalg.solve(mass, at.torque)
    for direction, expected in (
        (KCM(), at.torque / 3.0),
        (KCM(Mass()), push / np.abs(push).max()),
        (KCM(Mass(), by_length), push / np.sqrt(push @ push)),
    ):
        state = Descent(direction, Fixed(0.125)).init(problem, at)
        ((found, memory),) = direction.propose(problem, at, state.preconditioner.solve, "kept")
        assert found == pytest.approx(expected, rel=1e-14) and memory == "kept"
        after = Descent(direction, Fixed(0.125)).step(problem, state)
        assert after.at.q == pytest.approx(at.q + 0.125 * expected, rel=1e-14) and after.memory == ()
    assert KCM() == KCM(Euclidean(), by_largest)
