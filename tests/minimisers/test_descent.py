"""Metrics, directions and step rules against dense algebra, differences and their own definitions."""

import numpy as np
import pytest
from fixtures.molecules import crowded
from fixtures.samples import chain, energy, load
from scipy.optimize import minimize
from scipy.sparse.csgraph import shortest_path

from protochain.chains.chain import pose
from protochain.chains.contacts import bonded_pairs, near_pairs, radii
from protochain.mechanics import multibody
from protochain.minimisers import LBFGS, Descent, Newton, StrongWolfe, spring_model
from protochain.minimisers.loop import Stop, run
from protochain.minimisers.problem import Problem
from protochain.minimisers.restraints import Leash, SoftRepulsion, Sum, Tethers
from protochain.minimisers.spaces import Torsions


def problem_of(name, budget=5000, hinges="phi psi chi"):
    c = chain(name, hinges)
    moving = energy(name).without_constants(c.rigid_groups, pose(c, c.q0).x)
    return c, Problem(Torsions(c), moving, budget)


def walked(problem, method, q, tolerance=1.0):
    points = []
    ending = run(problem, method, q, tolerance, 5000, points.append)
    return ending, points


def spring_matrix(n, pairs, stiffness, x):
    """Dense (3 na, 3 na) stiffness of springs, row by row."""
    matrix = np.zeros((3 * n, 3 * n))
    for (i, j), k in zip(pairs, stiffness, strict=True):
        along = (x[i] - x[j]) / np.linalg.norm(x[i] - x[j])
        places = np.r_[3 * i : 3 * i + 3, 3 * j : 3 * j + 3]
        matrix[np.ix_(places, places)] += k * np.outer(np.r_[along, -along], np.r_[along, -along])
    return matrix


def test_atoms_joined_by_few_bonds_are_those_of_the_graph():
    s = load("ala10.pdb")
    graph = np.full((s.n_atoms, s.n_atoms), np.inf)
    graph[s.bonds[:, 0], s.bonds[:, 1]] = 1.0
    steps = shortest_path(graph, directed=False)
    for bonds in (1, 2, 3):
        expected = np.argwhere(np.triu((steps <= bonds) & (steps > 0)))
        assert {tuple(pair) for pair in bonded_pairs(s, bonds).tolist()} == {
            tuple(pair) for pair in expected.tolist()
        }


def test_near_pairs_are_those_of_all_distances():
    s = load("1l2y.pdb")
    pairs, touch = near_pairs(s, s.positions, 1.2, 2)
    distance = np.linalg.norm(s.positions[:, None] - s.positions, axis=2)
    contact = radii(s)[:, None] + radii(s)
    near = np.triu(distance < 1.2 * contact, 1)
    near[tuple(bonded_pairs(s, 2).T)] = False
    assert np.array_equal(pairs, np.argwhere(near))
    assert np.array_equal(touch, contact[tuple(pairs.T)])


@pytest.mark.parametrize(
    ("name", "hinges"), [("ala10.pdb", "phi psi chi"), ("3i40.pdb", "phi psi chi angles")]
)
def test_stiffness_in_torsions_is_that_of_the_springs_between_atoms(name, hinges):
    c = chain(name, hinges)
    at, s = pose(c, c.q0), c.structure
    near = spring_model.contacts(s, at.x, 2)
    dense = spring_matrix(s.n_atoms, near.pairs, near.stiffness, at.x)
    twists = multibody.jacobian(c.tree, at.frames)[c.atom_body]
    arms = at.x - at.frames.origin[c.atom_body]
    moves = twists[:, 3:] + np.cross(twists[:, :3], arms[:, :, None], axis=1)
    jacobian = moves.reshape(3 * s.n_atoms, c.n_v)
    expected = jacobian.T @ dense @ jacobian
    found = spring_model.torsion_stiffness(c, at)
    assert np.abs(found - expected).max() < 1e-10 * np.abs(expected).max()
    assert np.linalg.eigvalsh(found).min() > -1e-9 * np.abs(expected).max()


def test_a_spring_at_contact_is_as_stiff_as_a_lennard_jones_well_and_softens_outward():
    s = load("1l2y.pdb")
    near = spring_model.contacts(s, s.positions, 3)
    distance = np.linalg.norm(np.diff(s.positions[near.pairs], axis=1)[:, 0], axis=1)
    touch = radii(s)[near.pairs].sum(axis=1)
    r, h = touch, 1e-5

    def well(r):
        return spring_model.DEPTH * ((touch / r) ** 12 - 2 * (touch / r) ** 6)

    curvature = (well(r + h) - 2 * well(r) + well(r - h)) / h**2
    softer = np.exp(-spring_model.DECAY * (distance - touch) / touch)
    assert near.stiffness == pytest.approx(curvature * softer, rel=1e-4)
    assert near.stiffness[distance > touch].max() < near.stiffness[distance < 0.9 * touch].max()


@pytest.mark.parametrize("kind", ["soft", "tethers", "leash", "sum"])
def test_restraining_forces_are_minus_the_gradient(kind):
    s = load("1l2y.pdb")
    x = crowded().structure.positions
    tethers, leash, soft = Tethers.of_heavy_atoms(s, 300.0), Leash(s, 0.5), SoftRepulsion(s)
    force = {"soft": soft, "tethers": tethers, "leash": leash, "sum": Sum((tethers, leash))}[kind]
    value, f = force(x)
    assert value > 0
    rng = np.random.default_rng(2)
    for _ in range(4):
        direction, h = rng.normal(size=x.shape), 1e-6
        numeric = (force(x + h * direction)[0] - force(x - h * direction)[0]) / (2 * h)
        assert -numeric == pytest.approx(np.sum(f * direction), rel=1e-5)


def test_newton_converges_faster_and_faster():
    c, problem = problem_of("1l2y.pdb")
    ending, points = walked(problem, Descent(Newton(), StrongWolfe()), c.q0, 1e-3)
    assert ending.stop is Stop.TOLERANCE
    residuals = [point.residual for point in points]
    assert residuals[-1] < 0.05 * residuals[-2] < residuals[-3]


def scipy_evaluations(name):
    """Evaluations that scipy's L-BFGS-B needs to a largest torque of 1 kJ/mol/rad."""
    c, problem = problem_of(name)
    counted = []

    def value_and_gradient(turn):
        at = problem.evaluate(c.q0 + turn)
        counted.append(at.residual)
        return at.energy, -at.torque

    minimize(value_and_gradient, np.zeros(c.n_v), jac=True, method="L-BFGS-B",
             options={"maxcor": 20, "ftol": 0.0, "gtol": 1.0, "maxiter": 5000, "maxfun": 5000})  # fmt: skip
    assert min(counted) <= 1.0
    return next(k for k, size in enumerate(counted, 1) if size <= 1.0)


@pytest.mark.parametrize("name", ["1l2y.pdb", pytest.param("1vii.pdb", marks=pytest.mark.slow)])
def test_the_stiffness_metric_halves_what_a_general_quasi_newton_method_needs(name):
    c, problem = problem_of(name)
    assert walked(problem, Descent(LBFGS(), StrongWolfe()), c.q0)[0].stop is Stop.TOLERANCE
    assert 2 * problem.n_evaluations < scipy_evaluations(name)
