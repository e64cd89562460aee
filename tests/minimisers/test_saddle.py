"""Converged means a minimum: eigenvalues against dense Hessians, and the way off saddle points."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from fixtures.quadratics import Along, Flat, Quadratic
from fixtures.samples import SAMPLES, chain, energy

import protochain as pc
from protochain.batches import BatchSettings, task
from protochain.minimisers import Status
from protochain.minimisers.curvature import near_terms
from protochain.minimisers.loop import Stop
from protochain.minimisers.problem import Problem
from protochain.minimisers.saddle import (
    SIGN,
    Curvature,
    CurvatureState,
    _add_vector,
    _is_shoulder,
    _orthonormal,
    step_off,
)
from protochain.minimisers.spaces import Torsions, spaces

EIGENVALUE = 0.01
"""Relative, of the lowest eigenvalue: the search ends when a vector changes it by less than 0.5 per cent."""

STEP = 1e-5
"""rad, of the differences of torques for dense Hessians."""

QUICK = ("ala10.pdb", "1l2y.pdb", "3i40.pdb")


def dense(problem, at):
    """(n_v, n_v) Hessian by central differences of torques."""
    turns = STEP * np.eye(len(at.torque))
    rows = [
        problem.evaluate(problem.move(at.q, -turn)).torque - problem.evaluate(problem.move(at.q, turn)).torque
        for turn in turns
    ]
    hessian = np.array(rows) / (2.0 * STEP)
    return 0.5 * (hessian + hessian.T)


def problem_of(c, e):
    at = pc.pose(c, c.q0).x
    return Problem(Torsions(c), e.without_constants(c.rigid_groups, at), 10**6)


@cache
def flat():
    """Tetraglycine with all hinges at 180 degrees: by symmetry no torque, and two ways down."""
    c = pc.build_chain(pc.from_sequence("GGGG"))
    q = c.q0.copy()
    q[c.tree.q_start[c.hinge_body]] = np.pi
    return pc.build_chain(c.structure.with_positions(pc.pose(c, q).x))


@cache
def flat_energy():
    return pc.energy(flat().structure)


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[] if name in QUICK else pytest.mark.slow) for name in SAMPLES]
)
def test_the_eigenvalue_is_that_of_a_dense_hessian(name):
    c, e = chain(name), energy(name)
    r = pc.minimise(c, e, "lbfgs")
    assert r.status is Status.CONVERGED
    problem = problem_of(c, e)
    at = problem.evaluate(r.q)
    values = np.linalg.eigvalsh(dense(problem, at))
    # Six motions of the whole have no curvature: two chains with free roots.
    whole = 6 if name == "3i40.pdb" else 0
    assert len(problem.space.motions_of_whole(at)) == whole
    values = np.delete(values, np.argsort(np.abs(values))[:whole])
    assert r.lowest_eigenvalue == pytest.approx(values[0], rel=EIGENVALUE)
    assert f"lowest eigenvalue of the Hessian {r.lowest_eigenvalue:.3g} kJ/mol/rad^2" in r.message
    assert r.record()["lowest_eigenvalue_kj_mol_rad2"] == r.lowest_eigenvalue
    plain = pc.minimise(c, e, "lbfgs", curvature=False)
    assert plain.lowest_eigenvalue is None and np.array_equal(plain.q, r.q) and plain.end == r.end
    assert plain.n_iterations == r.n_iterations and len(plain.trace) == len(r.trace)
    assert plain.n_evaluations < r.n_evaluations <= plain.n_evaluations + 40


@pytest.mark.parametrize("sequence", ["WKLFGE", "YGGFM"])
def test_the_second_eigenvalue_is_not_taken_for_the_lowest(sequence):
    c = pc.build_chain(pc.from_sequence(sequence))
    e = pc.energy(c.structure)
    r = pc.minimise(c, e, "lbfgs")
    problem = problem_of(c, e)
    values = np.linalg.eigvalsh(dense(problem, problem.evaluate(r.q)))
    # Far enough apart that a search which ends at the second is seen.
    assert values[1] > 1.2 * values[0] > 0.0
    assert r.lowest_eigenvalue == pytest.approx(values[0], rel=EIGENVALUE)


def test_the_flat_peptide_is_a_saddle_and_is_left():
    c, e = flat(), flat_energy()
    plain = pc.minimise(c, e, "lbfgs", curvature=False)
    assert plain.status is Status.CONVERGED and plain.n_evaluations == 1
    problem = problem_of(c, e)
    values = np.linalg.eigvalsh(dense(problem, problem.evaluate(c.q0)))
    assert values[:3] == pytest.approx([-8.9, -5.6, 8.4], abs=0.1)
    r = pc.minimise(c, e, "lbfgs")
    assert r.status is Status.CONVERGED and r.end.energy < plain.end.energy - 3.0
    problem = problem_of(c, e)
    values = np.linalg.eigvalsh(dense(problem, problem.evaluate(r.q)))
    assert values[0] > 1.0 and r.lowest_eigenvalue == pytest.approx(values[0], rel=EIGENVALUE)


def test_a_saddle_that_is_not_left_is_called_one(monkeypatch):
    monkeypatch.setattr("protochain.minimisers.saddle.ROUNDS", 0)
    r = pc.minimise(flat(), flat_energy(), "lbfgs")
    assert r.status is Status.SADDLE and r.end.energy == r.start.energy and not r.is_usable
    assert r.message.startswith("saddle: the energy falls on both sides of the stationary point: ")
    assert r.lowest_eigenvalue == pytest.approx(-8.94, abs=0.05)


def test_only_a_clear_curvature_is_a_saddle():
    # The tolerance is that of a turn of 1 rad: what is flatter than it counts as flat.
    for tolerance, lowest in ((9.0, -8.94), (8.9, -5.60)):
        r = pc.minimise(flat(), flat_energy(), "lbfgs", tolerance=tolerance)
        assert r.status is Status.CONVERGED and r.lowest_eigenvalue == pytest.approx(lowest, rel=EIGENVALUE)
        assert (r.end.energy < r.start.energy) == (tolerance < 8.94)


@pytest.mark.parametrize("tolerance", [0.01, 0.03, 0.08])
def test_the_sign_of_an_eigenvalue_does_not_depend_on_the_unit_of_energy(tolerance):
    """A hundredth of the energy has a hundredth of the eigenvalue, -0.089, and the same ends."""
    c = flat()
    whole = flat_energy()

    def hundredth(x):
        value, forces = whole(x)
        return 0.01 * value, 0.01 * forces

    scaled = pc.energies.as_energy(hundredth, c.structure)
    r = pc.minimise(c, scaled, "lbfgs", tolerance=tolerance)
    expected = pc.minimise(c, whole, "lbfgs", tolerance=100.0 * tolerance)
    assert r.status is Status.CONVERGED and r.end.energy < r.start.energy - 0.02
    assert 100.0 * r.end.energy == pytest.approx(expected.end.energy, abs=100.0 * tolerance)
    hessian = dense(problem_of(c, scaled), problem_of(c, scaled).evaluate(r.q))
    assert np.linalg.eigvalsh(hessian)[0] > -tolerance


# --- Shoulders: the energy falls all the way, and is nearly level at one place


@cache
def shoulder(method, evaluations):
    """RKDVY on its way along a shoulder 3.73 kJ/mol above its minimum, with a fixed root."""
    c = pc.build_chain(pc.from_sequence("RKDVY"))
    e = pc.energy(c.structure, threads=1)
    on_its_way = pc.minimise(c, e, method, tolerance=1e-3, curvature=False, max_evaluations=evaluations)
    return pc.build_chain(on_its_way.structure, root="fixed"), e


ON_SHOULDER = [("kcm-sign", 1000), ("kcm-sign", 2000), ("kcm-adaptive", 600), ("kcm-adaptive", 2000)]
"""Of lowest eigenvalues 0.19, -0.07, 1.64 and 0.39 kJ/mol/rad^2."""


@pytest.mark.parametrize(("method", "evaluations"), ON_SHOULDER)
@pytest.mark.parametrize("tolerance", [0.01, 0.1])
def test_a_shoulder_is_left_for_the_minimum_below(method, evaluations, tolerance):
    c, e = shoulder(method, evaluations)
    expected = pc.minimise(c, e, "lbfgs", tolerance=1e-4).end.energy
    r = pc.minimise(c, e, "lbfgs", tolerance=tolerance)
    assert r.status is Status.CONVERGED
    assert r.end.energy == pytest.approx(expected, abs=tolerance**2) and r.end.energy < r.start.energy - 3.7
    problem = problem_of(c, e)
    value = np.linalg.eigvalsh(dense(problem, problem.evaluate(r.q)))[0]
    assert value > 1.0 and r.lowest_eigenvalue == pytest.approx(value, rel=EIGENVALUE)


@pytest.mark.parametrize(("method", "evaluations"), ON_SHOULDER)
def test_the_error_of_an_eigenvalue_near_zero_is_stated(method, evaluations):
    c, e = shoulder(method, evaluations)
    reduced = e.without_constants(c.rigid_groups, c.structure.positions)
    problem = Problem(spaces(c, near_terms(e))[0], reduced, 10**6)
    at = problem.evaluate(c.q0)
    search = Curvature(tolerance=1e9, leaves=False)
    state = search.init(problem, at)
    while state.value is None:
        state = search.step(problem, state)
    assert state.value == pytest.approx(np.linalg.eigvalsh(dense(problem, at))[0], abs=SIGN)


def test_a_shoulder_is_a_torque_without_a_zero():
    """Against the roots of the torque g - k s + c s^2 / 2, in turns of unequal hinges."""
    rng = np.random.default_rng(3)
    turn = 1e-3 * rng.normal(size=5)
    length = np.linalg.norm(turn)
    outcomes = []
    for g, k, c in rng.normal(size=(400, 3)):
        roots = np.roots([0.5 * c, -k, g])
        torques = [(g - k * s + 0.5 * c * s**2) * turn / length for s in (-length, 0.0, length)]
        expected = bool(np.abs(roots.imag).min() > 1e-6)
        assert _is_shoulder(turn, *torques) == expected
        outcomes.append(expected)
    assert 50 < sum(outcomes) < 350
    # A stiff direction is a minimum nearby, however far the torque is from 0.
    stiff = [(1.0 - 5.0 * s + 20.0 * s**2) * turn / length for s in (-length, 0.0, length)]
    assert not _is_shoulder(turn, *stiff)


@pytest.mark.parametrize("method", ["lbfgs", "kcm-stiffness"])
def test_a_run_stopped_anywhere_goes_on_as_if_it_had_not(method, tmp_path):
    c, e = flat(), flat_energy()
    whole = pc.minimise(c, e, method)
    file = tmp_path / "run.npz"
    for budget in range(1, whole.n_evaluations, 7):
        part = pc.minimise(c, e, method, max_evaluations=budget, checkpoint=file)
        assert part.n_evaluations <= budget
        rest = pc.minimise(c, e, method, resume=file)
        assert np.array_equal(rest.q, whole.q) and rest.message == whole.message
        assert rest.lowest_eigenvalue == whole.lowest_eigenvalue
        assert (rest.n_evaluations, rest.n_iterations) == (whole.n_evaluations, whole.n_iterations)


def test_a_curvature_that_no_energy_confirms_is_no_saddle():
    """As of forces in single precision: they say that it bends down, and no point is lower."""
    problem = Problem(Flat(), Quadratic(np.diag([5.0, 6.0, 7.0])), 1000)
    at = problem.evaluate(np.zeros(3))
    known = CurvatureState(at, None, direction=np.array([1.0, 0.0, 0.0]), value=-20.0, is_saddle=True)
    done = Curvature(1.0).step(problem, known)
    assert (
        done.stop is Stop.NO_DESCENT and done.confirmed and done.at is at and done.lowest_eigenvalue == -20.0
    )
    assert Curvature(1.0).step(problem, done) is None


@pytest.mark.parametrize("leaves", [True, False])
def test_the_way_off_is_on_the_lower_side_as_far_as_the_energy_falls(leaves):
    # -9 x^2 - x^3 + 5 x^4 falls on both sides of 0, to a lower point on the right.
    energy = Along(lambda t: -9 * t**2 - t**3 + 5 * t**4, lambda t: 18 * t + 3 * t**2 - 20 * t**3)
    problem = Problem(Flat(), energy, 1000)
    at = problem.evaluate(np.zeros(3))
    known = CurvatureState(at, None, direction=np.array([0.6, 0.0, 0.0]), value=-18.0, is_saddle=True)
    done = Curvature(1.0, leaves=leaves).step(problem, known)
    assert energy.asked == [0.0, 0.1, -0.1, 0.2, 0.4, 0.8, 1.6]
    assert done.stop is Stop.SADDLE and done.at.q[0] == (0.8 if leaves else 0.0)
    assert done.lowest_eigenvalue == (None if leaves else -18.0)
    assert Curvature(1.0, leaves=leaves).step(problem, done) is None
    # The lower side is found on the left as well.
    mirrored = Along(lambda t: -9 * t**2 + t**3 + 5 * t**4, lambda t: 18 * t - 3 * t**2 - 20 * t**3)
    left = Problem(Flat(), mirrored, 1000)
    assert step_off(left, left.evaluate(np.zeros(3)), np.array([1.0, 0, 0])).q[0] == -0.8
    # Where the longer turns climb at once, shorter ones are tried; a limit of the run counts as a wall.
    steep = Problem(Flat(), Along(lambda t: -(t**2) + 1e3 * t**4), 1000, allowed=lambda x: x[0, 0] < 0)
    assert step_off(steep, steep.evaluate(np.zeros(3)), np.array([1.0, 0, 0])).q[0] == -0.025


def test_a_budget_that_ends_in_the_search_leaves_it_open():
    c, e = chain("ala10.pdb"), energy("ala10.pdb")
    n = pc.minimise(c, e, "lbfgs", curvature=False).n_evaluations
    r = pc.minimise(c, e, "lbfgs", max_evaluations=n + 4)
    assert r.status is Status.CONVERGED and r.lowest_eigenvalue is None
    assert r.n_evaluations == n + 4
    # Ritz values are never below the eigenvalue, 26.087.
    said, most = r.message.split(
        "curvature not examined to the end: the lowest eigenvalue of the Hessian is at most "
    )
    assert said.endswith("; ") and 26.08 < float(most.removesuffix(" kJ/mol/rad^2")) < 60.0
    r = pc.minimise(c, e, "lbfgs", max_evaluations=n)
    assert r.status is Status.CONVERGED and r.message.endswith("; curvature not examined")


def test_products_that_are_not_symmetric_are_measured_again_and_clear_ones_are_not():
    problem = Problem(Flat(), Quadratic(np.diag([5.0, 6.0, 7.0])), 1000)
    at = problem.evaluate(np.zeros(3))
    known = CurvatureState(at, None, direction=np.array([1.0, 0.0, 0.0]), ritz=5.1)
    method = Curvature(1.0)
    clear = method._measure_eigenvalue(problem, known)
    assert clear.value == 5.1 and problem.n_evaluations == 1
    for doubtful in (replace(known, doubt=0.1), replace(known, ritz=0.01)):
        before = problem.n_evaluations
        assert method._measure_eigenvalue(problem, doubtful).value == pytest.approx(5.0)
        assert problem.n_evaluations == before + 2


def test_of_two_near_eigenvalues_the_lower_is_found():
    """The lowest estimate alone would rest between them: its residual is a tenth of the limit."""
    rng = np.random.default_rng(1)
    turn, _ = np.linalg.qr(rng.normal(size=(40, 40)))
    values = np.r_[3.0, 3.1, np.linspace(20.0, 400.0, 38)]
    matrix = turn @ np.diag(values) @ turn.T
    state = CurvatureState(None, None)
    for _ in range(14):
        new = rng.normal(size=40) if not state.vectors else state.residuals[len(state.vectors) % 3 == 0]
        new = np.linalg.solve(matrix + 5.0 * np.eye(40), new)
        vector = _orthonormal(new, state.vectors)
        state = _add_vector(state, vector, matrix @ vector)
        found = np.linalg.eigvalsh(np.array(state.vectors) @ matrix @ np.array(state.vectors).T)
        assert state.ritz == pytest.approx(found[0]) and state.doubt < 1e-9
        for k, residual in enumerate(state.residuals):
            assert np.abs(np.array(state.vectors) @ residual).max() < 1e-9
            assert k == 0 or np.linalg.norm(residual) > 0
    assert state.ritz == pytest.approx(3.0, rel=1e-3) and abs(state.direction @ turn[:, 0]) > 0.99


def test_rigid_motions_cost_no_energy_and_are_those_of_a_free_chain():
    c, e = chain("1l2y.pdb", root="free"), energy("1l2y.pdb")
    problem = problem_of(c, e)
    at = problem.evaluate(c.q0)
    motions = np.array(problem.space.motions_of_whole(at))
    assert motions @ motions.T == pytest.approx(np.eye(6), abs=1e-12)
    hinges = np.delete(motions, np.arange(6), axis=1) if c.tree.v_start[0] == 0 else motions
    assert np.abs(hinges).max() == 0.0
    for motion in motions:
        assert abs(motion @ at.torque) < 1e-6 * np.linalg.norm(at.torque)
    fixed = chain("1l2y.pdb", root="fixed")
    problem = problem_of(fixed, e)
    assert len(problem.space.motions_of_whole(problem.evaluate(fixed.q0))) == 0


def test_several_free_chains_move_as_one():
    c, e = chain("3i40.pdb"), energy("3i40.pdb")
    problem = problem_of(c, e)
    at = problem.evaluate(c.q0)
    x = c.structure.positions
    apart = np.linalg.norm(x[:, None] - x[None, ::50], axis=2)
    for motion in problem.space.motions_of_whole(at):
        moved = problem.space.place(problem.move(at.q, 1e-4 * motion)).x
        assert np.abs(moved - x).max() > 1e-6
        found = np.linalg.norm(moved[:, None] - moved[None, ::50], axis=2)
        assert np.abs(found - apart).max() < 1e-8


@pytest.mark.parametrize("curvature", [True, False])
def test_settings_of_comparisons_and_batches_reach_their_runs(curvature):
    c, e = chain("ala10.pdb"), energy("ala10.pdb")
    (compared,) = pc.compare(c, "lbfgs", e, curvature=curvature).solutions
    for starts in (1, 2):
        settings = BatchSettings(("lbfgs",), curvature=curvature, n_starts=starts)
        batched, _ = task._run(c, e, "lbfgs", settings)
        assert (batched.lowest_eigenvalue is not None) == curvature
    assert (compared.lowest_eigenvalue is not None) == curvature
