"""One step of annealing: the leapfrog, then friction and noise of the falling temperature."""

import numpy as np
import pytest
from fixtures.samples import chain

import protochain as pc
from protochain.chains.chain import pose
from protochain.mechanics import multibody
from protochain.mechanics.motion.leapfrog import Leapfrog
from protochain.mechanics.motion.system import Phase, StepTooLargeError, System
from protochain.mechanics.multibody.articulated import articulate
from protochain.minimisers.annealing import LONGEST_TURN, Annealing, AnnealingState
from protochain.minimisers.problem import Problem
from protochain.minimisers.restraints import Tethers
from protochain.minimisers.spaces import ROOT_LEVER, Torsions

R = 8.31446261815324e-3
"""kJ/mol/K, CODATA."""
SOFT = 1e-3
"""kJ/mol/nm^2 of the springs: so soft that no time step is shortened."""


def problem_of(strength=SOFT):
    c = chain("ala10.pdb", root="free")
    x = c.structure.positions
    home = x + np.random.default_rng(0).normal(scale=0.1, size=x.shape)
    return c, Problem(Torsions(c), Tethers(home, np.full(len(x), strength)), 99)


def draws(seed, step, n):
    return np.random.Generator(np.random.Philox(key=seed, counter=[0, 0, 0, step])).standard_normal(n)


def twice_kinetic(c, q, qd):
    return qd @ pc.mass_matrix(c, pose(c, q)) @ qd


def test_a_run_starts_at_rest_or_with_the_velocities_of_its_temperature():
    c, problem = problem_of()
    at = problem.evaluate(c.q0)
    still = Annealing().init(problem, at)
    assert (still.at, still.n_steps) == (at, 0) and not still.velocity.any()
    warm = Annealing(temperature=500.0, seed=3).init(problem, at)
    drawn = draws(3, 0, c.n_v)
    assert twice_kinetic(c, c.q0, warm.velocity) == pytest.approx(R * 500.0 * (drawn @ drawn), rel=1e-9)
    assert Annealing() == Annealing(0.0, 1000, 10.0, 0.004, 0) and LONGEST_TURN == 0.1


def by_leapfrog(c, problem, q, qd, time_step):
    """The same step by the integrator alone, on unscaled torques."""
    tree = c.tree

    def potential(q, factors):
        at = pose(c, q)
        value, forces = problem.energy(at.x)
        return value, pc.pull_back(c, at, forces)

    factors = articulate(tree, multibody.pose(tree, q))
    p = pc.mass_matrix(c, pose(c, q)) @ qd
    value, torque = potential(q, factors)
    return Leapfrog().step(System(tree, potential), Phase(q, qd, p, value, torque, factors), time_step)


@pytest.mark.parametrize("friction", [0.0, 25.0])
def test_at_zero_temperature_a_step_is_the_leapfrogs_and_friction(friction):
    c, problem = problem_of(10.0)
    at = problem.evaluate(c.q0)
    qd = 0.1 * np.random.default_rng(1).normal(size=c.n_v)
    method = Annealing(n_steps=5, friction=friction, time_step=0.003)
    after = method.step(problem, AnnealingState(at, qd, 2))
    moved = by_leapfrog(c, problem, c.q0, qd, 0.003)
    assert after.at.q == pytest.approx(moved.q, abs=1e-12) and after.n_steps == 3
    assert after.velocity == pytest.approx(np.exp(-friction * 0.003) * moved.qd, rel=1e-9, abs=1e-12)
    assert np.abs(moved.qd - qd).max() > 1e-4
    # One evaluation, kept for the next step.
    assert problem.n_evaluations == 2 and after.at.energy == pytest.approx(moved.potential, rel=1e-12)
    assert problem.evaluate(after.at.q).energy == after.at.energy


@pytest.mark.parametrize(("n_steps", "done", "share"), [(4, 0, 0.75), (4, 2, 0.25), (4, 3, 0.0)])
def test_the_noise_is_of_a_temperature_that_falls_to_zero_and_of_the_step(n_steps, done, share):
    c, problem = problem_of()
    at = problem.evaluate(c.q0)
    # With so much friction only noise is left.
    method = Annealing(400.0, n_steps, friction=1e9, seed=5)
    after = method.step(problem, AnnealingState(at, np.zeros(c.n_v), done))
    drawn = draws(5, done + 1, c.n_v)
    warmth = twice_kinetic(c, after.at.q, after.velocity)
    assert warmth == pytest.approx(R * 400.0 * share * (drawn @ drawn), rel=1e-9, abs=1e-12)


def test_all_steps_are_taken_and_no_more():
    c, problem = problem_of()
    method = Annealing(n_steps=3)
    state = method.init(problem, problem.evaluate(c.q0))
    for k in (1, 2, 3):
        state = method.step(problem, state)
        assert state.n_steps == k
    assert method.step(problem, state) is None and problem.n_evaluations == 4


def test_warming_takes_a_step():
    c, problem = problem_of()
    Annealing().warm(problem, problem.evaluate(c.q0))
    assert problem.n_evaluations == 2


def test_a_time_step_is_shortened_where_a_freedom_would_turn_too_far():
    c, problem = problem_of()
    space, method = problem.space, Annealing(time_step=0.004)
    factors = articulate(c.tree, multibody.pose(c.tree, c.q0))
    # A free root moves by 0.1 nm for each unit.
    assert space.scale[:8].tolist() == [1.0] * 3 + [ROOT_LEVER] * 3 + [1.0] * 2 and ROOT_LEVER == 0.1
    hinge, slide = np.zeros(c.n_v), np.zeros(c.n_v)
    hinge[9], slide[4] = -1.0, 1.0
    still, mass = np.zeros(c.n_v), pc.mass_matrix(c, pose(c, c.q0))

    def chosen(qd, acceleration=still):
        return method._time_step(space, Phase(c.q0, qd, mass @ qd, 0.0, mass @ acceleration, factors))

    assert chosen(still) == 0.004 == chosen(24.0 * hinge) == chosen(2.4 * slide)
    assert chosen(50.0 * hinge) == pytest.approx(0.002, rel=1e-9)
    assert chosen(5.0 * slide) == pytest.approx(0.002, rel=1e-9)
    # A turn of 0.1 from rest: a t^2 / 2.
    assert chosen(still, 12000.0 * hinge) == 0.004
    assert chosen(still, 50000.0 * hinge) == pytest.approx(0.002, rel=1e-6)
    assert chosen(still, 5000.0 * slide) == pytest.approx(0.002, rel=1e-6)
    assert chosen(100.0 * hinge, 50000.0 * hinge) == pytest.approx(0.001, rel=1e-6)


def test_a_step_that_is_too_large_is_halved_up_to_thirty_times(monkeypatch):
    c, problem = problem_of()
    tried = []

    class Fussy(Leapfrog):
        def step(self, system, at, time_step):
            tried.append(time_step)
            if time_step > limit:
                raise StepTooLargeError("too large")
            return super().step(system, at, time_step)

    monkeypatch.setattr("protochain.mechanics.motion.leapfrog.Leapfrog", Fussy)
    limit, method = 0.0011, Annealing(friction=3.0)
    at, qd = problem.evaluate(c.q0), 0.1 * np.ones(c.n_v)
    after = method.step(problem, AnnealingState(at, qd, 0))
    assert tried == [0.004, 0.002, 0.001] and after.n_steps == 1
    # Friction is of the time that passed.
    moved = by_leapfrog(c, problem, c.q0, qd, 0.001)
    assert after.velocity == pytest.approx(np.exp(-0.003) * moved.qd, rel=1e-9, abs=1e-12)
    limit = 0.0
    tried.clear()
    assert method.step(problem, AnnealingState(at, qd, 0)) is None
    assert len(tried) == 30 and tried[-1] == 0.004 * 0.5**29
