"""Bodies that bend: rigid limits, finite differences, dense algebra, and beams against closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from fixtures.bending_trees import BEAM, KINDS, on_a_hub, some
from fixtures.slow_mechanics import random_q

from protochain.core.errors import MechanicsError
from protochain.mechanics import multibody
from protochain.mechanics.multibody import HingeKind, random_tree
from protochain.mechanics.multibody.rotations import tangent
from protochain.mechanisms.assumed import assumed_modes, clamp_shapes, clamped_roots
from protochain.mechanisms.flexible.algebra import tangent_rate
from protochain.mechanisms.flexible.dynamics import (
    forward_dynamics,
    inverse_dynamics,
    jacobian,
    mass_matrix,
    momenta,
    pull_back,
    solve,
)
from protochain.mechanisms.flexible.flexible import Flexible, bend, elastic, integrate
from protochain.mechanisms.segments import Beam


def dense(flexible, q):
    m = mass_matrix(flexible, bend(flexible, q))
    assert m.rr.shape[0] == flexible.tree.n_v
    return np.block([[m.rr, m.rf], [m.rf.T, m.ff]])


def kinetic(flexible, q, qd):
    return 0.5 * qd @ dense(flexible, q) @ qd


@pytest.mark.parametrize("seed", range(3))
def test_bodies_without_shapes_are_a_tree(seed):
    tree = random_tree(8, seed, 0.4, HingeKind.FREE, KINDS)
    rng = np.random.default_rng(seed)
    flexible = Flexible(tree, (None,) * 8, np.full(8, -1))
    q, qd, tau = random_q(tree, rng), rng.normal(size=tree.n_v), rng.normal(size=tree.n_v)
    m = mass_matrix(flexible, bend(flexible, q))
    assert np.allclose(m.rr, multibody.mass_matrix(tree, multibody.pose(tree, q)), rtol=1e-12, atol=1e-13)
    assert m.rf.shape == (tree.n_v, 0)
    ours, theirs = (f(x, q, qd, tau) for f, x in (
        (forward_dynamics, flexible), (multibody.forward_dynamics, tree)))  # fmt: skip
    assert np.abs(ours - theirs).max() < 1e-10 * np.abs(theirs).max()


@pytest.mark.parametrize("seed", range(4))
def test_columns_are_the_differences_of_frames(seed):
    flexible, q, qd, _, _ = some(seed)
    h = 1e-6
    ahead, behind = (bend(flexible, integrate(flexible, q, sign * h * qd)) for sign in (1, -1))
    bent = bend(flexible, q)
    twists = jacobian(flexible, bent) @ qd
    spin = (ahead.rotation - behind.rotation) / (2 * h) @ bent.rotation.swapaxes(1, 2)
    omega = np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], axis=1)
    assert np.allclose(twists[:, :3], omega, atol=1e-7)
    assert np.allclose(twists[:, 3:], (ahead.origin - behind.origin) / (2 * h), atol=1e-8)


@pytest.mark.parametrize("seed", range(4))
def test_solutions_and_products_agree_with_the_dense_matrix(seed):
    flexible, q, qd, tau, rng = some(seed, (HingeKind.FREE, HingeKind.REVOLUTE)[seed % 2])
    bent, m = bend(flexible, q), dense(flexible, q)
    x = np.linalg.solve(m, tau)
    assert np.abs(solve(flexible, bent, tau) - x).max() < 1e-9 * np.abs(x).max()
    wrench = rng.normal(size=(len(bent.origin), 6))
    tau_of_wrench = np.einsum("nik,ni->k", jacobian(flexible, bent), wrench)
    assert np.allclose(pull_back(flexible, bent, wrench), tau_of_wrench, atol=1e-12)
    still = inverse_dynamics(flexible, q, qd, 0.0 * qd)
    assert np.allclose(inverse_dynamics(flexible, q, qd, x), still + m @ x, atol=1e-10 * np.abs(still).max())
    qdd = forward_dynamics(flexible, q, qd, tau, wrench)
    back = inverse_dynamics(flexible, q, qd, qdd, wrench)
    assert np.abs(back - tau).max() < 1e-9 * np.abs(m).max() * np.abs(qdd).max()


@pytest.mark.parametrize("seed", range(4))
def test_lagranges_equations_hold(seed):
    """dp/dt = tau + gradient along a motion, and the gradient is that of the kinetic energy."""
    flexible, q, qd, qdd, _ = some(seed, (HingeKind.FREE, HingeKind.REVOLUTE)[seed % 2])
    p, gradient = momenta(flexible, q, qd)
    assert np.allclose(p, dense(flexible, q) @ qd, atol=1e-11)
    h = 1e-5
    ends = [
        momenta(flexible, integrate(flexible, q, sign * h * qd + 0.5 * h**2 * qdd), qd + sign * h * qdd)[0]
        for sign in (1, -1)
    ]
    tau = inverse_dynamics(flexible, q, qd, qdd)
    assert np.allclose((ends[0] - ends[1]) / (2 * h), tau + gradient, atol=1e-6 * np.abs(tau).max())
    first = 6 if flexible.tree.kind[0] == HingeKind.FREE else 0
    for k in range(first, flexible.n_v):
        step = h * np.eye(flexible.n_v)[k]
        energies = [kinetic(flexible, integrate(flexible, q, sign * step), qd) for sign in (1, -1)]
        slope = (energies[0] - energies[1]) / (2 * h)
        assert gradient[k] == pytest.approx(slope, abs=1e-6 * np.abs(gradient).max())


def test_a_driven_hinge_is_partitioned_off():
    flexible, q, qd, tau, _ = some(1, HingeKind.REVOLUTE)
    tree = flexible.tree
    driven = replace(flexible, tree=replace(tree, driven=np.arange(6) == 0))
    found, m = forward_dynamics(driven, q, qd, tau), dense(flexible, q)
    bias = inverse_dynamics(flexible, q, qd, 0.0 * qd)
    rest = tau[1:] - bias[1:] - m[1:, 0] * tau[0]
    assert found[0] == tau[0]
    assert np.allclose(
        found[1:], np.linalg.solve(m[1:, 1:], rest), rtol=1e-9, atol=1e-9 * np.abs(found).max()
    )


@pytest.mark.parametrize("size", [0.0, 1e-5, 9.9e-3, 1.01e-2, 0.7, 3.0])
def test_rates_of_the_tangent_of_rotations(size):
    rng = np.random.default_rng(1)
    theta, (rate, x) = size * np.array([0.6, 0.0, 0.8]), rng.normal(size=(2, 3))
    h = 1e-5
    ends = [np.array(tangent(tuple(theta + sign * h * rate), tuple(x))) for sign in (1, -1)]
    assert np.allclose((ends[0] - ends[1]) / (2 * h), tangent_rate(*map(tuple, (theta, rate, x))), atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_elastic_torques_are_those_of_each_body(seed):
    flexible, q, *_ = some(seed)
    energy, torque = elastic(flexible, q)
    assert np.array_equal(torque[: flexible.tree.n_v], np.zeros(flexible.tree.n_v))
    rest, expected, total = q[flexible.tree.n_q :], [], 0.0
    for shapes in flexible.shapes:
        if shapes is not None:
            eta, rest = rest[: shapes.n_shapes], rest[shapes.n_shapes :]
            expected.append(-shapes.stiffness @ eta)
            total += 0.5 * eta @ shapes.stiffness @ eta
    assert np.allclose(torque[flexible.tree.n_v :], np.concatenate(expected), rtol=1e-14)
    assert energy == pytest.approx(total, rel=1e-14)


# --- Beams


def frequencies(flexible, rate):
    """Of small vibrations about steady turning, from differences of the torques that keep it up."""
    n = flexible.n_v - 1

    def torque(eta, eta_rate):
        q = np.concatenate([[0.3], eta])
        return (
            inverse_dynamics(flexible, q, np.concatenate([[rate], eta_rate]), np.zeros(n + 1))[1:]
            - elastic(flexible, q)[1][1:]
        )

    h, unit = 1e-4, np.eye(n)
    stiffness, gyration = (
        np.array([(torque(*(h * e * d for d in pair)) - torque(*(-h * e * d for d in pair))) / (2 * h)
                  for e in unit]).T
        for pair in ((1, 0), (0, 1))
    )  # fmt: skip
    mass = mass_matrix(flexible, bend(flexible, np.zeros(n + 1))).ff
    zero = np.zeros((n, n))
    first = np.block(
        [[zero, np.eye(n)], [-np.linalg.solve(mass, stiffness), -np.linalg.solve(mass, gyration)]]
    )
    found = np.linalg.eigvals(first)
    return np.sort(np.abs(found[found.imag > 0.0]))


def test_clamped_shapes():
    """Orthonormal, clamped and free at their ends; wave numbers as in the tables, however many."""
    assert clamped_roots(3) == pytest.approx([1.875104, 4.694091, 7.854757], abs=1e-6)
    points, weights = np.polynomial.legendre.leggauss(60)
    shape, _, curvature = clamp_shapes(0.5 * (1 + points), 20)
    product = np.einsum("n,nk,nl->kl", 0.5 * weights, shape, shape)
    assert np.allclose(product, np.eye(20), atol=1e-9)
    bending = np.einsum("n,nk,nl->kl", 0.5 * weights, curvature, curvature)
    assert np.allclose(bending / np.outer(*[clamped_roots(20) ** 2] * 2), np.eye(20), atol=1e-9)
    ends = clamp_shapes(np.array([0.0, 1.0]), 20)
    assert np.allclose(ends[0][0], 0.0, atol=1e-13) and np.allclose(ends[1][0], 0.0, atol=1e-11)
    assert np.allclose(ends[2][1] / clamped_roots(20) ** 2, 0.0, atol=1e-12)
    h = 1e-6
    near = [clamp_shapes(np.array([0.4 + sign * h]), 5) for sign in (1, -1)]
    for k in (0, 1):
        exact = clamp_shapes(np.array([0.4]), 5)[k + 1]
        assert np.allclose((near[0][k] - near[1][k]) / (2 * h), exact, rtol=1e-7, atol=1e-6)


def test_a_cantilever_has_the_frequencies_of_euler_and_bernoulli():
    of = Beam(2.0, 3.0, (5.0, 20.0), twist=4.0, polar=0.3)
    flexible = on_a_hub(of, flap=3, lag=2, twist=2)
    flap, lag = (clamped_roots(3) ** 2 * np.sqrt(stiffness / (3.0 * 2.0**4)) for stiffness in (5.0, 20.0))
    twist = np.pi * np.array([0.5, 1.5]) / 2.0 * np.sqrt(4.0 / 0.3)
    expected = np.sort([*flap, *lag[:2], *twist])
    assert frequencies(flexible, 0.0) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize(
    ("rate", "flap"), [(0, 3.5160), (1, 3.6816), (2, 4.1373), (4, 5.5850), (6, 7.3604), (12, 13.170)]
)
def test_a_rotating_beam_has_the_frequencies_of_wright_and_others(rate, flap):
    """J. Appl. Mech. 49:197 (1982), hub radius 0; in the plane w^2 - W^2."""
    # A beam held by its shapes is too stiff, at 12 by 7e-5 with eight of them; the table has four digits.
    assert frequencies(on_a_hub(flap=8), float(rate))[0] == pytest.approx(flap, rel=1e-4)
    lag = frequencies(on_a_hub(lag=8), float(rate))[0]
    assert lag**2 == pytest.approx(flap**2 - rate**2, abs=2e-4 * flap**2)


# --- Spin-up: a beam of 10 m on a hub that comes to 6 rad/s in 15 s; Kane, Ryan, Banerjee (1987)


def test_what_makes_no_sense_is_refused():
    with pytest.raises(MechanicsError, match="shapes of lag needs a stiffness lag above zero"):
        assumed_modes(Beam(1.0, 1.0, (1.0, 0.0)), flap=1, lag=1)
    with pytest.raises(MechanicsError, match="moment of inertia polar above zero"):
        assumed_modes(Beam(1.0, 1.0, (0.0, 0.0), twist=1.0), twist=1)
    with pytest.raises(MechanicsError, match="rigid zones"):
        assumed_modes(Beam(1.0, 1.0, 1.0, rigid=0.1), flap=1)
    own = assumed_modes(BEAM, flap=2, sections=3)
    with pytest.raises(MechanicsError, match="moves of a body of 4 sections and 2 shapes"):
        replace(own, moves=own.moves[..., :1])
    tree = random_tree(2, 0)
    with pytest.raises(MechanicsError, match="body 1: its parent has no section 4"):
        Flexible(tree, (own, None), np.array([-1, 4]))
    with pytest.raises(MechanicsError, match="needs 2 shapes"):
        Flexible(tree, (own,), np.array([-1, 0]))
    light = replace(own, mass=0.0 * own.mass)
    flexible = Flexible(random_tree(1, 0), (light,), np.array([-1]))
    q = np.array([1.0, 0, 0, 0, 0, 0, 0, 0, 0])
    with pytest.raises(MechanicsError, match="body 0: its hinge or one of its shapes has no inertia"):
        forward_dynamics(flexible, q, np.zeros(8), np.zeros(8))
