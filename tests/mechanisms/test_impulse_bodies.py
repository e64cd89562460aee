"""Impacts of bodies that bend, the bound on friction, and the stress of impulses in rigid bodies."""

from dataclasses import replace

import numpy as np
import pytest

from bench.scenes.canonical import chain, started
from bench.scenes.impact.study import random_points, random_pose
from protochain.core.errors import Fault, MechanicsError
from protochain.mechanics.multibody import pose, velocities
from protochain.mechanics.multibody.articulated import articulate
from protochain.mechanics.multibody.random_tree import random_tree
from protochain.mechanisms import Mechanism
from protochain.mechanisms.flexible.dynamics import jacobian, mass_matrix
from protochain.mechanisms.impacts import Bending, ContactPoint, friction_bound, impact, impulse_stress


def bent_chain(links=3):
    flexible = chain(links, shapes=2, flap=1, tip=0.3)
    q, qd = started(flexible)
    q[flexible.tree.n_q :] = 0.02 * np.random.default_rng(3).normal(size=flexible.n_q - flexible.tree.n_q)
    return flexible, q, qd


def rough(seed):
    """Two points of a random tree in the plane, friction up to 2."""
    rng = np.random.default_rng(seed)
    posed = random_pose(True, False, rng)
    qd = rng.normal(size=posed.factors.tree.n_v)
    return posed.factors, qd, list(random_points(posed, qd, 2, 2, rng))


@pytest.mark.parametrize("law", ["newton", "poisson", "stronge"])
def test_an_impact_of_links_that_bend_has_the_momentum_and_work_of_the_whole_matrix(law):
    flexible, q, qd = bent_chain()
    bodies = Bending.at(flexible, q)
    section = len(flexible.shapes[1].place) // 2
    node = flexible.node(1, section)
    at = bodies.origin[node] + (0.0, 0.01, 0.02)
    blocks, j = mass_matrix(flexible, bodies.bent), jacobian(flexible, bodies.bent)
    m = np.block([[blocks.rr, blocks.rf], [blocks.rf.T, blocks.ff]])
    arm = at - bodies.origin[node]
    g = j[node, 3:] - np.cross(arm, j[node, :3], axisb=0, axisc=0)
    # Onto a floor against which it moves.
    normal = -(g @ qd) + (0.1, 0.2, 0.0)
    point = ContactPoint("floor", (-1, node), at, normal, friction=0.3, restitution=0.6)
    found = impact(bodies, qd, [point], law)
    np.testing.assert_allclose(m @ (found.qd - qd), g.T @ found.impulse[0], atol=1e-12)
    np.testing.assert_allclose(found.before[0], g @ qd, atol=1e-13)
    np.testing.assert_allclose(found.after[0], g @ found.qd, atol=1e-12)
    assert found.work == pytest.approx(0.5 * (found.qd @ m @ found.qd - qd @ m @ qd), rel=1e-10)
    assert found.dissipation == -found.work
    with pytest.raises(MechanicsError, match="flexible bodies"):
        impulse_stress(bodies, qd, found, [point])
    across = found.impulse[0] - (found.impulse[0] @ point.normal) * point.normal
    assert np.linalg.norm(across) <= 0.3 * (found.impulse[0] @ point.normal) * (1.0 + 1e-12)
    if law == "newton":
        speed = found.before[0] @ point.normal
        assert speed < 0.0
        assert found.after[0] @ point.normal == pytest.approx(-0.6 * speed, rel=1e-10)
    # The shapes answer, as hinges do: a chain of rigid links would not give way so much.
    assert np.abs(found.qd[flexible.tree.n_v :] - qd[flexible.tree.n_v :]).max() > 0.01


def test_the_bound_of_one_point_in_closed_form():
    """A rod on the floor, leaning: W of its tip by hand."""
    m = Mechanism()
    lean, mass, length = 0.6, 2.0, 1.5
    m.body("rod", mass, inertia=mass * length**2 / 12, position=(0, 0, 0))
    state = m.build().state()
    tip = 0.5 * length * np.array([np.sin(lean), 0.0, -np.cos(lean)])
    point = ContactPoint("floor", (-1, 0), tip, (0, 0, 1))
    per = 12.0 / (mass * length**2)
    x, z = tip[0], tip[2]
    # About y it turns in the plane; about x and z too, with the same inertia.
    nn, nt, tt = 1 / mass + per * x * x, per * (-x * z), 1 / mass + per * z * z
    side = 1 / mass + per * (x * x + z * z)
    wanted = np.sqrt((nn - nt**2 / tt) / max(tt, side))
    assert friction_bound(state.factors, [point]) == pytest.approx(wanted, rel=1e-12)
    assert friction_bound(state.factors, []) == np.inf
    # Four corners bear on each other.
    four = [replace(point, point=(a, b, -1.0)) for a in (-1, 1) for b in (-1, 1)]
    assert friction_bound(state.factors, four) == 0.0


def test_what_friction_jams_is_above_the_bound_and_below_it_there_is_one_solution():
    refused = independent = 0
    for seed in range(300):
        factors, qd, points = rough(seed)
        sure = friction_bound(factors, points)
        independent += sure > 0.0
        try:
            impact(factors, qd, points)
        except MechanicsError as error:
            assert error.fault is Fault.FRICTION
            assert max(point.friction for point in points) > sure
            assert (f"below {sure:.2g} there is one" in str(error)) == (sure > 0.0)
            refused += sure > 0.0
        impact(factors, qd, [replace(point, friction=0.99 * sure) for point in points])
    assert independent > 100
    assert refused >= 1


def test_stresses_of_a_tree_are_symmetric_and_add_up_to_those_of_its_points_of_mass():
    rng = np.random.default_rng(8)
    tree = random_tree(9, rng)
    q, qd = rng.normal(size=tree.n_q), rng.normal(size=tree.n_v)
    factors = articulate(tree, pose(tree, q))
    frames = factors.frames
    at = frames.origin[5] + rng.normal(size=3)
    twist = velocities(tree, frames, qd)[5]
    normal = -(twist[3:] + np.cross(twist[:3], at - frames.origin[5]))
    point, blow = ContactPoint("wall", (2, 5), at, normal, 0.3, 0.4), {0: (at, rng.normal(size=3))}
    found = impact(factors, qd, [point], external=blow)
    stress = impulse_stress(factors, qd, found, [point], blow)
    assert np.abs(found.impulse).max() > 0.0
    np.testing.assert_allclose(stress, stress.swapaxes(1, 2), atol=1e-12 * np.abs(stress).max())
    # Six points on the axes of inertia have a body's mass, centre and inertia.
    total = np.outer(blow[0][1], at)
    change = velocities(tree, frames, found.qd) - velocities(tree, frames, qd)
    for b in range(tree.n_bodies):
        moments, axes = np.linalg.eigh(tree.inertia[b])
        spread = np.sqrt(np.maximum(0.5 * moments.sum() - moments, 0.0) * 3.0 / tree.mass[b])
        for axis, far in zip(axes.T, spread, strict=True):
            for sign in (-1.0, 1.0):
                r = frames.rotation[b] @ (tree.com[b] + sign * far * axis)
                total -= tree.mass[b] / 6.0 * np.outer(
                    change[b, 3:] + np.cross(change[b, :3], r), r + frames.origin[b]
                )  # fmt: skip
    # Couples of hinges are antisymmetric, and cancel.
    np.testing.assert_allclose(stress.sum(axis=0), 0.5 * (total + total.T), atol=1e-10 * np.abs(stress).max())


def test_loops_have_no_stress():
    m = Mechanism()
    for name in "ab":
        m.body(name, 1.0, com=(0.5, 0, 0), inertia=0.1)
    m.hinge("A", "world", "a", axis=(0, 0, 1))
    m.hinge("B", "a", "b", at=(1, 0, 0), axis=(0, 0, 1), q=1.0)
    m.close("C", a=("b", (1, 0, 0)), b=("world", (1.5, 0.5, 0)), kind="spherical")
    state = m.build().state()
    blow = {0: ((0.5, 0, 0), (0, 1.0, 0))}
    found = impact(state.factors, state.qd, [], loops=state.loops, external=blow)
    with pytest.raises(MechanicsError, match="rows of loops do not locate"):
        impulse_stress(state.factors, state.qd, found, [], blow)
