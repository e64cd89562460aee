"""Armature: M with a diagonal, against dense algebra, in both methods and in all integrators."""

from dataclasses import replace

import numpy as np
import pytest
from fixtures.bending_trees import KINDS, some
from fixtures.refusals import expect_refusal
from fixtures.slow_mechanics import random_q
from fixtures.tolerances import round_off

from protochain.core.errors import BodyError, Fault
from protochain.mechanics.motion import DormandPrince, ImplicitMidpoint, Leapfrog, RungeKutta4, System
from protochain.mechanics.multibody import (
    HingeKind,
    Tree,
    forward_dynamics,
    inverse_dynamics,
    kinetic_energy,
    log_det_gradient,
    log_det_mass,
    mass_matrix,
    multiply_mass,
    pose,
    random_tree,
    solve_mass,
)
from protochain.mechanics.multibody.articulated import articulate, sample
from protochain.mechanics.multibody.hamilton import momenta
from protochain.mechanics.multibody.kinematics import integrate
from protochain.mechanisms.flexible import dynamics
from protochain.mechanisms.flexible.dynamics import rates_of
from protochain.mechanisms.flexible.flexible import bend

SLOPE = 1e-6
"""Relative, of central differences with steps of 1e-5."""


def with_rotors(seed, root=HingeKind.FREE, n=12):
    """A branched tree of which two hinges in three have rotors, one far heavier than the rest."""
    rng = np.random.default_rng(seed)
    tree = random_tree(n, seed, 0.4, root, KINDS)
    size = 10.0 * rng.random(n) * (rng.random(n) < 0.7)
    size[rng.integers(n)] = 1e4
    tree = replace(tree, armature=size)
    q = random_q(tree, rng)
    return tree, q, pose(tree, q), rng


def nothing(q, factors):
    return 0.0, np.zeros(factors.tree.n_v)


@pytest.mark.parametrize("root", [HingeKind.FREE, HingeKind.REVOLUTE])
@pytest.mark.parametrize("seed", range(6))
def test_the_mass_matrix_has_the_rotors_on_its_diagonal_in_every_method(seed, root):
    tree, q, frames, rng = with_rotors(seed, root)
    rotors = np.repeat(tree.armature, np.diff(tree.v_start))
    m = mass_matrix(replace(tree, armature=None), frames) + np.diag(rotors)
    same = round_off(tree)
    assert mass_matrix(tree, frames) == pytest.approx(m, rel=same, abs=same)
    tau, qd = rng.normal(size=tree.n_v), rng.normal(size=tree.n_v)
    x = np.linalg.solve(m, tau)
    condition = np.linalg.cond(m) * np.finfo(float).eps
    for method in ("articulated", "fixman"):
        assert np.allclose(solve_mass(tree, frames, tau, method), x, atol=10 * condition * np.max(np.abs(x)))
        assert log_det_mass(tree, frames, method) == pytest.approx(np.linalg.slogdet(m)[1], rel=1e-10)
    assert multiply_mass(tree, frames, qd) == pytest.approx(m @ qd, rel=same, abs=same * np.max(np.abs(m)))
    assert momenta(tree, frames, qd)[0] == pytest.approx(m @ qd, rel=same, abs=same * np.max(np.abs(m)))
    assert kinetic_energy(tree, frames, qd) == pytest.approx(0.5 * qd @ m @ qd, rel=same)
    bias = inverse_dynamics(replace(tree, armature=None), q, qd, np.zeros(tree.n_v))
    qdd = forward_dynamics(tree, q, qd, tau)
    size = np.max(np.abs(m)) * np.max(np.abs(qdd))
    assert m @ qdd + bias == pytest.approx(tau, abs=same * size)
    assert inverse_dynamics(tree, q, qd, qdd) == pytest.approx(tau, abs=same * size)


@pytest.mark.parametrize("seed", range(3))
def test_driven_hinges_and_thermal_velocities_have_rotors(seed):
    tree, q, _, rng = with_rotors(seed, HingeKind.REVOLUTE)
    driven = (np.diff(tree.v_start) == 1) & (rng.random(tree.n_bodies) < 0.3)
    tree = replace(tree, driven=driven)
    frames, free, held = pose(tree, q), tree.undriven_v, tree.driven_v
    m = mass_matrix(tree, frames)
    tau, qd = rng.normal(size=tree.n_v), rng.normal(size=tree.n_v)
    qdd = forward_dynamics(tree, q, qd, tau)
    bias = inverse_dynamics(tree, q, qd, np.zeros(tree.n_v))
    assert np.array_equal(qdd[held], tau[held])
    assert (m @ qdd + bias)[free] == pytest.approx(tau[free], abs=1e-9 * np.max(np.abs(m)))
    inverse = np.linalg.inv(m[np.ix_(free, free)])
    for method in ("articulated", "fixman"):
        assert solve_mass(tree, frames, tau, method)[free] == pytest.approx(inverse @ tau[free], rel=1e-8)
        assert log_det_mass(tree, frames, method) == pytest.approx(-np.linalg.slogdet(inverse)[1], rel=1e-9)
    factors = articulate(tree, frames)
    drawn = np.array([sample(factors, unit) for unit in np.eye(tree.n_v)])[:, free]
    assert drawn.T @ drawn == pytest.approx(inverse, rel=1e-8, abs=1e-10 * np.max(inverse))


@pytest.mark.parametrize("seed", range(3))
def test_fixmans_torque_is_the_gradient_of_ln_det_with_rotors(seed):
    tree, q, frames, _ = with_rotors(seed)
    found, h = log_det_gradient(tree, frames), 1e-5
    for k in range(tree.n_v):
        way = h * np.eye(tree.n_v)[k]
        up, down = (log_det_mass(tree, pose(tree, integrate(tree, q, sign * way))) for sign in (1, -1))
        assert found[k] == pytest.approx((up - down) / (2 * h), abs=SLOPE * max(1.0, np.max(np.abs(found))))


@pytest.mark.parametrize(
    ("integrator", "order"),
    [(Leapfrog(), 2), (ImplicitMidpoint(1e-13), 2), (RungeKutta4(), 4)],
    ids=["leapfrog", "midpoint", "rk4"],
)
def test_integrators_keep_their_order_and_energy_with_rotors(integrator, order):
    tree, _, _, rng = with_rotors(1, n=5)
    tree = replace(tree, armature=rng.uniform(0.1, 0.5, 5))
    system = System(tree, nothing)
    q = np.append([1.0, 0, 0, 0, 0, 0, 0], np.zeros(tree.n_q - 7))
    qd = rng.normal(size=tree.n_v)
    until, ends = 0.4, []
    for n in (20, 40):
        at = system.at(q, qd)
        for _ in range(n):
            at = integrator.step(system, at, until / n)
        ends.append(at)
    exact = DormandPrince(1e-13).step(system, system.at(q, qd), until)
    assert exact.total == pytest.approx(system.at(q, qd).total, rel=1e-11)
    wrong = [np.max(np.abs(each.q - exact.q)) for each in ends]
    assert wrong[0] / wrong[1] == pytest.approx(2**order, rel=0.25)
    assert ends[1].total == pytest.approx(exact.total, rel=1e-2)


@pytest.mark.parametrize("seed", range(4))
def test_bodies_that_bend_have_rotors_at_their_hinges(seed):
    flexible, q, qd, tau, rng = some(seed)
    bare, own = flexible, rng.uniform(0.5, 3.0, flexible.tree.n_bodies)
    flexible = replace(flexible, tree=replace(flexible.tree, armature=own))
    rotors = np.zeros(flexible.n_v)
    rotors[: flexible.tree.n_v] = np.repeat(own, np.diff(flexible.tree.v_start))
    bent = bend(flexible, q)
    blocks = dynamics.mass_matrix(bare, bent)
    m = np.block([[blocks.rr, blocks.rf], [blocks.rf.T, blocks.ff]]) + np.diag(rotors)
    same = 1e-9
    assert dynamics.multiply_mass(flexible, bent, qd) == pytest.approx(m @ qd, rel=same)
    assert dynamics.momenta(flexible, q, qd)[0] == pytest.approx(m @ qd, rel=same)
    assert dynamics.solve(flexible, bent, tau) == pytest.approx(np.linalg.solve(m, tau), rel=1e-6)
    for route in ("articulated", "blocks", "dense"):
        assert rates_of(flexible, bent, m @ qd, route) == pytest.approx(qd, rel=1e-6)
    qdd = dynamics.forward_dynamics(flexible, q, qd, tau)
    bias = dynamics.inverse_dynamics(bare, q, qd, 0.0 * qd)
    assert m @ qdd + bias == pytest.approx(tau, abs=1e-8 * np.max(np.abs(bias)))
    assert dynamics.inverse_dynamics(flexible, q, qd, qdd) == pytest.approx(
        tau, abs=1e-8 * np.max(np.abs(bias))
    )


def test_a_rotor_resists_where_nothing_else_does():
    """A hinge about the axis of a needle has no inertia but the rotor's."""
    needle = (
        np.array([-1]), np.array([HingeKind.REVOLUTE]), np.zeros((1, 3)), np.eye(3)[None], np.ones(1),
        np.array([[0, 0, 0.5]]), np.diag([1.0, 1.0, 0.0])[None],
    )  # fmt: skip
    with expect_refusal(fault=Fault.NO_INERTIA, kind=BodyError):
        Tree(*needle)
    tree = Tree(*needle, armature=np.array([0.25]))
    assert forward_dynamics(tree, np.zeros(1), np.ones(1), np.ones(1)) == pytest.approx([4.0])
    with pytest.raises(BodyError, match="armature -1 must not be negative"):
        Tree(*needle, armature=np.array([-1.0]))
