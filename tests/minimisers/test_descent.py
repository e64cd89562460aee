"""Metrics, directions and step rules against dense algebra, differences and their own definitions."""

from itertools import pairwise

import numpy as np
import pytest
from fixtures.molecules import crowded
from fixtures.oracles import bond_lengths
from fixtures.samples import chain, energy, load
from fixtures.tolerances import DIFFERENCE, GEOMETRY_NM
from scipy.optimize import minimize
from scipy.sparse.csgraph import shortest_path

import protochain as pc
from protochain.chains.chain import pose
from protochain.chains.contacts import joined, near_pairs, radii
from protochain.mechanics import multibody
from protochain.minimisers import KCM, LBFGS, RECIPES, Descent, Fire, Newton, StrongWolfe, spring_model
from protochain.minimisers.kcm import by_largest, by_length, by_sign
from protochain.minimisers.loop import Stop, run
from protochain.minimisers.metrics import Euclidean, Mass, Stiffness
from protochain.minimisers.newton import PseudoTransient, conjugate_gradients
from protochain.minimisers.problem import Problem
from protochain.minimisers.restraints import Leash, SoftRepulsion, Sum, Tethers
from protochain.minimisers.spaces import Cartesian, Positions, Torsions
from protochain.minimisers.steps import AcceptReject, Armijo, Decaying, Fixed


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
        assert {tuple(pair) for pair in joined(s, bonds).tolist()} == {
            tuple(pair) for pair in expected.tolist()
        }


def test_near_pairs_are_those_of_all_distances():
    s = load("1l2y.pdb")
    pairs, touch = near_pairs(s, s.positions, 1.2, 2)
    distance = np.linalg.norm(s.positions[:, None] - s.positions, axis=2)
    contact = radii(s)[:, None] + radii(s)
    near = np.triu(distance < 1.2 * contact, 1)
    near[tuple(joined(s, 2).T)] = False
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


@pytest.mark.parametrize("hinges", ["phi psi chi", "phi psi chi angles"])
def test_metrics_solve_with_their_matrices(hinges):
    c = chain("3i40.pdb", hinges)
    space = Torsions(c)
    at = Problem(space, energy("3i40.pdb"), 1).evaluate(c.q0)
    torque = np.random.default_rng(0).normal(size=c.n_v)
    posed = pose(c, c.q0)
    scaled = np.outer(space.scale, space.scale)
    mass = scaled * pc.mass_matrix(c, posed)
    assert mass @ Mass().at(space, at)(torque) == pytest.approx(torque, abs=1e-8)
    stiff = scaled * spring_model.torsion_stiffness(c, posed)
    stiff += spring_model.TORSION_FLOOR * np.eye(c.n_v)
    assert stiff @ Stiffness().at(space, at)(torque) == pytest.approx(torque, abs=1e-8)
    assert np.array_equal(Euclidean().at(space, at)(torque), torque)


def test_stiffness_of_free_atoms_is_that_of_springs_and_leaves_the_others_alone():
    s = load("ala10.pdb")
    moving = np.random.default_rng(0).random(s.n_atoms) < 0.6
    space = Cartesian(s, moving)
    at = Problem(space, energy("ala10.pdb"), 1).evaluate(s.positions.flatten())
    bonded, near = spring_model.covalent(s), spring_model.contacts(s, s.positions, 3)
    dense = spring_matrix(s.n_atoms, bonded.pairs, bonded.stiffness, s.positions)
    contact = spring_matrix(s.n_atoms, near.pairs, near.stiffness, s.positions)
    blocks = np.kron(np.eye(s.n_atoms), np.ones((3, 3)))
    dense += blocks * contact + spring_model.CARTESIAN_FLOOR * np.eye(3 * s.n_atoms)
    free = np.repeat(moving, 3)
    force, step = (space.outward(at.x, each) for each in (at.torque, space.stiffness(at)(at.torque)))
    assert dense[np.ix_(free, free)] @ step[free] == pytest.approx(force[free], rel=1e-9, abs=1e-7)
    assert not step[~free].any() and not force[~free].any()


def test_bonds_are_stiffer_than_angles_and_these_than_dihedrals():
    s = load("ala10.pdb")
    graph = np.full((s.n_atoms, s.n_atoms), np.inf)
    graph[s.bonds[:, 0], s.bonds[:, 1]] = 1.0
    bonds = shortest_path(graph, directed=False)
    found = spring_model.covalent(s)
    expected = np.array([spring_model.BOND, spring_model.ANGLE, spring_model.DIHEDRAL])
    assert (np.diff(expected) < 0).all()
    assert np.array_equal(found.stiffness, expected[bonds[tuple(found.pairs.T)].astype(int) - 1])


def test_the_residual_of_free_atoms_is_the_mean_over_those_that_move():
    s = load("ala10.pdb")
    moving = np.arange(s.n_atoms) % 4 == 0
    forces = np.random.default_rng(0).normal(size=(s.n_atoms, 3))
    space = Cartesian(s, moving)
    torque = space.torque(Positions(s.positions.flatten()), forces)
    assert space.residual(torque) == pytest.approx(np.sqrt(np.mean(forces[moving] ** 2)), rel=1e-14)


def test_hydrogens_are_not_tethered():
    s = load("ala10.pdb")
    tethers, light = Tethers.of_heavy_atoms(s, 300.0), s.atom_element == "H"
    value, forces = tethers(s.positions + 0.1 * light[:, None])
    assert value == 0.0 and not forces.any()
    value, forces = tethers(s.positions + 0.1 * ~light[:, None])
    assert value == pytest.approx(0.5 * 300.0 * 3 * 0.1**2 * np.sum(~light))
    assert forces[~light] == pytest.approx(-300.0 * 0.1) and not forces[light].any()


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


def test_kcm_norms():
    torque = np.array([3.0, -4.0, 0.0])
    assert np.array_equal(by_largest(torque), torque / 4)
    assert np.array_equal(by_length(torque), torque / 5)
    assert np.array_equal(by_sign(torque), [1.0, -1.0, 0.0])


def test_a_fixed_angle_ends_in_a_cycle_as_large_as_it_and_the_step_rules_cure_it():
    ends = {}
    for angle in (0.04, 0.005):
        c, problem = problem_of("1l2y.pdb", 1500)
        ending, points = walked(problem, Descent(KCM(), Fixed(angle)), c.q0)
        assert ending.stop is Stop.BUDGET
        for before, after in pairwise(points[-50:]):
            assert np.abs(after.q - before.q).max() == pytest.approx(angle, rel=1e-9)
        ends[angle] = np.median([point.residual for point in points[-200:]])
    assert ends[0.04] > 1.5 * ends[0.005] > 200.0
    for rule in (AcceptReject(0.005), Armijo(0.005, window=5), Decaying(0.02, 20.0)):
        c, problem = problem_of("1l2y.pdb", 1500)
        ending, points = walked(problem, Descent(KCM(), rule), c.q0)
        assert np.median([point.residual for point in points[-200:]]) < 0.5 * ends[0.005]


def test_decaying_steps_shorten_as_they_say():
    c, problem = problem_of("ala10.pdb", 40)
    _, points = walked(problem, Descent(KCM(), Decaying(0.01, 10.0)), c.q0)
    turns = [np.abs(b.q - a.q).max() for a, b in pairwise(points)]
    assert turns == pytest.approx(0.01 / (1 + np.arange(len(turns)) / 10.0), rel=1e-9)


def test_accept_reject_never_climbs_and_grows_by_its_factor():
    c, problem = problem_of("1l2y.pdb", 150)
    _, points = walked(problem, Descent(KCM(), AcceptReject(0.0005)), c.q0)
    assert all(b.energy < a.energy for a, b in pairwise(points))
    turns = np.array([np.abs(b.q - a.q).max() for a, b in pairwise(points)])
    exponents = np.log(turns[1:] / turns[:-1] / 1.2) / np.log(0.5)
    assert np.allclose(exponents, np.round(exponents), atol=1e-6) and exponents.min() > -1e-6


def test_armijo_looks_back_over_its_window():
    c, problem = problem_of("1l2y.pdb", 300)
    _, points = walked(problem, Descent(KCM(), Armijo(0.01, window=4)), c.q0)
    values = [point.energy for point in points]
    assert all(value < max(values[max(0, k - 4) : k]) for k, value in enumerate(values) if k)
    assert any(b > a for a, b in pairwise(values))


def hessian_at(problem, at, h=1e-5):
    rows = []
    for unit in np.eye(len(at.torque)):
        ends = [problem.evaluate(problem.move(at.q, sign * h * unit)).torque for sign in (-1, 1)]
        rows.append((ends[0] - ends[1]) / (2 * h))
    return (np.array(rows) + np.array(rows).T) / 2


def test_conjugate_gradients_solve_with_the_hessian():
    c, problem = problem_of("ala10.pdb", 20000)
    low = walked(problem, Descent(LBFGS(), StrongWolfe()), c.q0, 0.1)[0].last.state.at
    at = problem.evaluate(problem.move(low.q, 1e-3 * np.random.default_rng(0).normal(size=c.n_v)))
    hessian = hessian_at(problem, at)
    for shift in (0.0, 500.0):
        solve = problem.space.stiffness(at)
        turn = conjugate_gradients(problem, at, solve, shift, 1e-6, 200)
        expected = np.linalg.solve(hessian + shift * np.eye(c.n_v), at.torque)
        assert turn == pytest.approx(expected, abs=1e-3 * np.abs(expected).max())


def test_conjugate_gradients_stop_at_negative_curvature_and_still_descend():
    c, problem = problem_of("1l2y.pdb", 1000)
    at = problem.evaluate(c.q0)
    turn = conjugate_gradients(problem, at, np.copy, 0.0, 1e-8, 60)
    assert turn @ at.torque > 0
    # On a hill top every direction is of negative curvature: along the torque then.
    hill = Problem(Torsions(c), lambda x: tuple(-part for part in energy("1l2y.pdb")(x)), 1000)
    top = walked(problem, Descent(Newton(), StrongWolfe()), c.q0, 0.01)[0].last.state.at
    shifted = hill.evaluate(hill.move(top.q, 1e-4 * np.ones(c.n_v)))
    assert np.array_equal(conjugate_gradients(hill, shifted, np.copy, 0.0, 0.1, 10), shifted.torque)


def test_newton_converges_faster_and_faster():
    c, problem = problem_of("1l2y.pdb")
    ending, points = walked(problem, Descent(Newton(), StrongWolfe()), c.q0, 1e-3)
    assert ending.stop is Stop.TOLERANCE
    residuals = [point.residual for point in points]
    assert residuals[-1] < 0.05 * residuals[-2] < residuals[-3]


def test_pseudo_transient_steps_begin_along_the_torques_and_grow_as_these_fall():
    c, problem = problem_of("1l2y.pdb")
    method = PseudoTransient(time_step=1e-4)
    first = method.init(problem, problem.evaluate(c.q0))
    second = method.step(problem, first)
    turn = second.at.q - c.q0
    assert turn == pytest.approx(first.time_step * first.at.torque, abs=0.1 * np.abs(turn).max())
    third = method.step(problem, second)
    grown = np.linalg.norm(second.at.torque) / np.linalg.norm(third.at.torque)
    assert third.time_step == pytest.approx(second.time_step * grown)
    assert walked(problem, PseudoTransient(), c.q0)[0].stop is Stop.TOLERANCE


def test_fire_moves_by_newtons_second_law_and_stops_when_it_climbs():
    c, problem = problem_of("1l2y.pdb")
    method = Fire(time_step=1e-5)
    first = method.init(problem, problem.evaluate(c.q0))
    second = method.step(problem, first)
    push = pc.solve_mass(c, pose(c, c.q0), first.at.torque)
    assert second.at.q - c.q0 == pytest.approx(1e-10 * push, rel=1e-6, abs=1e-15)
    against = type(second)(**{**vars(second), "velocity": -push})
    assert method.step(problem, against).time_step == 0.5 * second.time_step
    assert walked(problem, Fire(), c.q0)[0].stop is Stop.TOLERANCE


def test_every_setting_descends_from_the_same_start():
    c, _ = problem_of("ala10.pdb")
    for name, recipe in RECIPES.items():
        if not recipe.keeps_geometry:
            continue
        _, problem = problem_of("ala10.pdb", 300)
        _, points = walked(problem, recipe.runs[0].method, c.q0)
        assert problem.best.energy < points[0].energy - 2.0, name


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


def test_torques_of_open_angles_are_minus_the_gradient():
    c = chain("1l2y.pdb", "phi psi chi angles")
    e = energy("1l2y.pdb")
    at = pose(c, c.q0)
    tau = pc.pull_back(c, at, e(at.x)[1])
    h = 1e-5
    ends = [
        [e(pose(c, multibody.integrate(c.tree, c.q0, s * h * u)).x)[0] for s in (1, -1)]
        for u in np.eye(c.n_v)
    ]
    numeric = -np.diff(np.array(ends)[:, ::-1], axis=1).ravel() / (2 * h)
    assert np.linalg.norm(tau - numeric) < DIFFERENCE * np.linalg.norm(tau)


def test_damped_dynamics_ends_in_a_minimum_and_keeps_the_geometry():
    c, e = chain("ala10.pdb"), energy("ala10.pdb")
    r = pc.minimise(c, e, "md")
    assert r.status == "converged" and r.end.energy < r.start.energy - 20.0
    before, after = (bond_lengths(c.structure.bonds, x) for x in (c.structure.positions, r.x))
    assert np.abs(after - before).max() < GEOMETRY_NM
    # At 0 K only friction changes the total energy: the potential falls with hardly a step back.
    energies = r.trace["energy_kj_mol"].to_numpy()[:1000]
    assert np.sum(np.maximum(np.diff(energies), 0.0)) < 0.2 * (energies[0] - energies[-1])


def test_annealing_climbs_first_depends_on_its_seed_and_repeats():
    c, e = chain("ala10.pdb"), energy("ala10.pdb")
    first, again, other = (pc.minimise(c, e, "anneal", seed=seed) for seed in (1, 1, 2))
    assert np.array_equal(first.q, again.q) and not np.array_equal(first.q, other.q)
    energies = first.trace["energy_kj_mol"]
    assert energies.iloc[:500].max() > first.start.energy
    assert first.status == other.status == "converged" and first.end.energy < first.start.energy
