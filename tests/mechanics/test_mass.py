"""The mass matrix by three routes, and what follows from it, on a hundred random trees."""

import numpy as np
import pytest
from fixtures.refusals import expect_refusal
from fixtures.slow_mechanics import (
    N_TREES,
    any_tree,
    body_inertia,
    random_q,
    slow_articulated_inverse,
    slow_fixman,
    slow_inverse_dynamics,
    slow_mass_matrix,
)
from fixtures.tolerances import round_off
from scipy.spatial.transform import Rotation

from protochain.core.errors import Fault, MechanicsError, ProtochainError
from protochain.mechanics.multibody import (
    HingeKind,
    Rows,
    Tree,
    articulated,
    fixman,
    forward_dynamics,
    integrate,
    inverse_dynamics,
    kinetic_energy,
    log_det_closed,
    log_det_gradient,
    log_det_mass,
    mass_matrix,
    multiply_mass,
    operational_inverse,
    point_rows,
    pose,
    rigid_bodies,
    row_matrix,
    solve_closed,
    solve_mass,
    velocities,
)
from protochain.mechanics.multibody.operational import row_loads
from protochain.mechanics.multibody.small import cholesky

METHODS = ("articulated", "fixman")
TREES = [seed for seed in range(N_TREES) if any_tree(seed).n_v]
SMALL = [seed for seed in TREES if any_tree(seed).n_bodies <= 20]
EPS = np.finfo(float).eps


def at(seed):
    tree = any_tree(seed)
    rng = np.random.default_rng(1000 + seed)
    return tree, pose(tree, random_q(tree, rng)), rng


def backward_error(m, x, tau):
    """|M x - tau| / (|M| |x| + |tau|), in the norm that is largest by entries."""
    return np.abs(m @ x - tau).max() / (np.abs(m).sum(axis=1).max() * np.abs(x).max() + np.abs(tau).max())


@pytest.mark.parametrize("seed", TREES)
def test_all_routes_to_the_mass_matrix_agree(seed):
    tree, frames, _ = at(seed)
    composite = mass_matrix(tree, frames)
    scale = np.sqrt(np.outer(np.diag(composite), np.diag(composite)))
    columns = np.stack([multiply_mass(tree, frames, unit) for unit in np.eye(tree.n_v)], axis=1)
    assert np.array_equal(composite, composite.T)
    assert np.abs((columns - composite) / scale).max() < round_off(tree)
    assert np.abs((slow_mass_matrix(tree, frames) - composite) / scale).max() < round_off(tree)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("seed", TREES)
def test_solve_mass_has_a_backward_error_of_round_off(seed, method):
    tree, frames, rng = at(seed)
    m = mass_matrix(tree, frames)
    for tau in (rng.normal(size=tree.n_v), np.eye(tree.n_v)[0], m @ rng.normal(size=tree.n_v)):
        assert backward_error(m, solve_mass(tree, frames, tau, method), tau) < 100 * EPS


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("seed", TREES)
def test_log_det_is_that_of_the_dense_matrix(seed, method):
    tree, frames, _ = at(seed)
    m = mass_matrix(tree, frames)
    scale = np.sqrt(np.diag(m))
    dense = np.linalg.slogdet(m / np.outer(scale, scale))[1] + 2 * np.log(scale).sum()
    # Each pivot is known to eps times the condition of what it was taken from: parts of M, or of H, whose
    # condition is some 1e4 here whatever that of M.
    condition = np.linalg.cond(m / np.outer(scale, scale)) + {"articulated": 100, "fixman": 1e5}[method]
    assert abs(log_det_mass(tree, frames, method) - dense) < 10 * EPS * tree.n_bodies * condition


@pytest.mark.parametrize("seed", SMALL)
def test_the_slow_recursions_say_the_same(seed):
    tree, frames, _ = at(seed)
    for method, slow in (("articulated", slow_articulated_inverse), ("fixman", slow_fixman)):
        inverse, log_det = slow(tree, frames)
        fast = np.stack([solve_mass(tree, frames, unit, method) for unit in np.eye(tree.n_v)], axis=1)
        scale = np.sqrt(np.outer(np.diag(inverse), np.diag(inverse)))
        cond = np.linalg.cond(inverse / scale)
        # Without refinement, A - B H^-1 B^T cancels digits: the slow Fixman is the less exact of the two.
        lost = 100 if method == "articulated" else 1e5
        assert np.abs((fast - inverse) / scale).max() < lost * EPS * cond
        assert abs(log_det_mass(tree, frames, method) - log_det) < lost * EPS * cond * tree.n_v


@pytest.mark.parametrize("seed", TREES)
def test_forward_and_inverse_dynamics_undo_each_other(seed):
    tree, _, rng = at(seed)
    q, qd, tau = random_q(tree, rng), rng.normal(size=tree.n_v), rng.normal(size=tree.n_v)
    wrench = rng.normal(size=(tree.n_bodies, 6))
    m = mass_matrix(tree, pose(tree, q))
    qdd = forward_dynamics(tree, q, qd, tau, wrench)
    loads = np.abs(inverse_dynamics(tree, q, qd, np.zeros(tree.n_v), wrench)).max()
    size = np.abs(m).sum(axis=1).max() * np.abs(qdd).max() + np.abs(tau).max() + loads
    assert np.abs(inverse_dynamics(tree, q, qd, qdd, wrench) - tau).max() < 100 * EPS * size


@pytest.mark.parametrize("seed", SMALL)
def test_inverse_dynamics_is_newtons_law_for_each_body(seed):
    tree, _, rng = at(seed)
    q, qd, qdd = random_q(tree, rng), rng.normal(size=tree.n_v), rng.normal(size=tree.n_v)
    slow = slow_inverse_dynamics(tree, lambda time: pose(tree, integrate(tree, q, time * qd)), qd, qdd, 1e-5)
    # dJ/dt is a central difference: truncation step^2 times third derivatives, cancellation eps / step.
    fast = inverse_dynamics(tree, q, qd, qdd)
    assert np.abs(fast - slow).max() < 1e-7 * (1 + np.abs(slow).max()) * tree.n_bodies


@pytest.mark.parametrize("seed", TREES)
def test_kinetic_energy_is_half_qd_m_qd(seed):
    tree, frames, rng = at(seed)
    qd = rng.normal(size=tree.n_v)
    energy = kinetic_energy(tree, frames, qd)
    assert energy == pytest.approx(0.5 * qd @ mass_matrix(tree, frames) @ qd, rel=round_off(tree))
    twists = velocities(tree, frames, qd)
    each = [v @ body_inertia(tree, frames, b) @ v for b, v in enumerate(twists)]
    assert energy == pytest.approx(0.5 * sum(each), rel=round_off(tree))


@pytest.mark.parametrize("seed", TREES[::3])
def test_the_fixman_torque_is_the_gradient_of_log_det(seed):
    tree, _, rng = at(seed)
    q, h = random_q(tree, rng), 1e-4
    gradient = log_det_gradient(tree, pose(tree, q))

    def value(step):
        return log_det_mass(tree, pose(tree, integrate(tree, q, step)))

    # Fourth order, so that truncation stays below rounding in ln det (eps times its size) over h.
    numeric = np.array(
        [
            (8 * (value(h * u) - value(-h * u)) - (value(2 * h * u) - value(-2 * h * u))) / (12 * h)
            for u in np.eye(tree.n_v)
        ]
    )
    assert np.abs(gradient - numeric).max() < 1e-8 * (1 + np.abs(numeric).max())


@pytest.mark.parametrize("seed", TREES[::5])
def test_velocity_samples_have_the_covariance_of_the_inverse(seed):
    tree, frames, _ = at(seed)
    factors = articulated.articulate(tree, frames)
    root = np.stack([articulated.sample(factors, unit) for unit in np.eye(tree.n_v)], axis=1)
    inverse = np.linalg.inv(mass_matrix(tree, frames))
    scale = np.sqrt(np.outer(np.diag(inverse), np.diag(inverse)))
    cond = np.linalg.cond(inverse / scale)
    assert np.abs((root @ root.T - inverse) / scale).max() < 100 * EPS * cond


def some_rows(tree, frames, rng, m):
    """Rows between random pairs of bodies, some with the world, and the closure of one pair of points."""
    random = Rows(rng.integers(-1, tree.n_bodies, size=(m, 2)), rng.normal(size=(m, 2, 6)))
    points = point_rows(frames, (0, tree.n_bodies - 1), rng.normal(size=(2, 3)))
    return Rows(np.concatenate([random.body, points.body]), np.concatenate([random.wrench, points.wrench]))


@pytest.mark.parametrize("seed", TREES[::3])
def test_operational_inverse_is_g_minv_gt(seed):
    tree, frames, rng = at(seed)
    rows = some_rows(tree, frames, rng, 12)
    g, m = row_matrix(tree, frames, rows), mass_matrix(tree, frames)
    slow = g @ np.linalg.solve(m, g.T)
    scale = np.sqrt(np.diag(m))
    cond = np.linalg.cond(m / np.outer(scale, scale))
    fast = operational_inverse(tree, frames, rows)
    assert np.abs(fast - slow).max() < 100 * EPS * cond * np.abs(slow).max()
    assert np.abs(fast - fast.T).max() < round_off(tree) * np.abs(slow).max()


def test_rows_are_functions_of_the_twists():
    tree, frames, rng = at(5)
    rows, qd = some_rows(tree, frames, rng, 6), rng.normal(size=tree.n_v)
    by_twists = np.einsum("mbk,bk->m", row_loads(tree, rows), velocities(tree, frames, qd))
    assert np.allclose(row_matrix(tree, frames, rows) @ qd, by_twists, rtol=1e-10)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("seed", [seed for seed in TREES if any_tree(seed).n_v > 15][::6])
def test_closed_loops_hold_and_cost_least(seed, method):
    tree, frames, rng = at(seed)
    rows = some_rows(tree, frames, rng, 1)
    g, m = row_matrix(tree, frames, rows), mass_matrix(tree, frames)
    tau = rng.normal(size=tree.n_v)
    x = solve_closed(tree, frames, tau, rows, method)
    # Karush-Kuhn-Tucker: M x + G^T lambda = tau, G x = 0.
    zero = np.zeros((len(g), len(g)))
    dense = np.linalg.solve(np.block([[m, g.T], [g, zero]]), np.concatenate([tau, np.zeros(len(g))]))
    assert np.abs(g @ x).max() < 1e-9 * np.abs(g).max() * np.abs(x).max()
    assert np.abs(x - dense[: tree.n_v]).max() < 1e-8 * np.abs(x).max()
    log_det = np.linalg.slogdet(g @ np.linalg.solve(m, g.T))[1]
    assert log_det_closed(tree, frames, rows, method) == pytest.approx(log_det, abs=1e-8)


@pytest.mark.parametrize("method", METHODS)
def test_rows_that_depend_on_one_another_are_refused(method):
    tree, frames, rng = at(34)
    rows = some_rows(tree, frames, rng, 1)
    twice = Rows(np.concatenate([rows.body] * 2), np.concatenate([rows.wrench] * 2))
    with expect_refusal(fault=Fault.DEPENDENT, kind=MechanicsError):
        solve_closed(tree, frames, np.ones(tree.n_v), twice, method)


def beads(share: float) -> Tree:
    """Four equal beads with right angles between bonds of length one, free in space, one dihedral.

    The beads of the middle bond lie on the hinge's axis; ``share`` of their mass counts in the outer body.
    """
    x = np.array([[0.0, 1, 0], [0, 0, 0], [0, 0, 1], [0, 1, 1]])
    body = np.array([0, 0, 0, 1, 1, 1])
    local = np.concatenate([x[:3], x[1:] - x[2]])
    mass = np.array([1.0, 1 - share, 1 - share, share, share, 1.0])
    real = mass > 0
    placement, offset = np.tile(np.eye(3), (2, 1, 1)), np.array([[0.0, 0, 0], [0, 0, 1]])
    kind = np.array([HingeKind.FREE, HingeKind.REVOLUTE])
    return Tree(
        np.array([-1, 0]), kind, offset, placement, *rigid_bodies(body[real], local[real], mass[real], 2)
    )


@pytest.mark.parametrize("method", METHODS)
def test_four_beads_have_the_exact_determinant(method):
    tree = beads(0.5)
    dihedral = np.linspace(-3.1, 3.1, 41)
    q = np.column_stack([np.ones(41), np.zeros((41, 6)), dihedral])
    found = np.exp([log_det_mass(tree, pose(tree, each), method) for each in q])
    c = np.cos(np.pi - dihedral)
    exact = 35 + 4 * c - 16 * c**2 + c**4
    assert np.ptp(found / exact) < 1e-12 * (found / exact).mean()


def test_sharing_the_mass_of_atoms_on_the_axis_changes_nothing_but_the_bodies():
    q = np.array([1.0, 0.2, -0.3, 0.4, 0, 0, 0, 0.7])
    matrices = [mass_matrix(tree, pose(tree, q)) for tree in (beads(0.0), beads(0.3), beads(0.5))]
    assert np.allclose(matrices[0], matrices[1], atol=1e-14) and np.allclose(
        matrices[0], matrices[2], atol=1e-14
    )
    # Unshared, the second body is a single bead: fine for articulated bodies, undefined for Fixman's.
    single, frames = beads(0.0), pose(beads(0.0), q)
    tau = np.arange(7.0)
    assert np.allclose(solve_mass(single, frames, tau), np.linalg.solve(matrices[0], tau), atol=1e-13)
    with expect_refusal(fault=Fault.NO_INVERSE, kind=MechanicsError, match="body 1"):
        solve_mass(single, frames, tau, "fixman")
    assert np.allclose(
        solve_mass(beads(0.5), frames, tau, "fixman"), np.linalg.solve(matrices[0], tau), atol=1e-13
    )


def test_a_pose_without_inertia_against_a_hinge_is_refused():
    """A bead on a slide along the x axis of a turning body: on the axis itself nothing resists turning."""
    mass, com, inertia = rigid_bodies(np.array([0, 1]), np.zeros((2, 3)), np.ones(2), 2)
    sideways = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    tree = Tree(
        np.array([-1, 0]), np.array([HingeKind.REVOLUTE, HingeKind.PRISMATIC]), np.zeros((2, 3)),
        np.stack([np.eye(3), sideways]), mass, com, inertia,
    )  # fmt: skip
    assert np.isfinite(solve_mass(tree, pose(tree, np.array([0.3, 0.5])), np.ones(2))).all()
    with pytest.raises(MechanicsError, match="body 0: its hinge has no inertia at this pose"):
        solve_mass(tree, pose(tree, np.array([0.3, 0.0])), np.ones(2))


def test_little_inertia_against_a_hinge_is_solved_with_and_none_but_rounding_refused():
    """A rod turns about itself: only the bead that slides out sideways resists."""
    ends = np.array([[0.0, 0, 1], [0, 0, -1], [0, 0, 0]])
    sideways = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    tree = Tree(
        np.array([-1, 0]), np.array([HingeKind.REVOLUTE, HingeKind.PRISMATIC]), np.zeros((2, 3)),
        np.stack([np.eye(3), sideways]), *rigid_bodies(np.array([0, 0, 1]), ends, np.ones(3), 2),
    )  # fmt: skip
    for out in (1e-3, 1e-5, 1e-6):
        found = solve_mass(tree, pose(tree, np.array([0.0, out])), np.ones(2))
        assert found == pytest.approx([1 / out**2, 1.0], rel=1e-12)
    for out in (1e-8, 1e-10):
        with pytest.raises(MechanicsError, match="body 0: its hinge has no inertia at this pose"):
            solve_mass(tree, pose(tree, np.array([0.0, out])), np.ones(2))


def test_a_pivot_of_rounding_errors_is_none():
    for left, fine in ((1e-3, True), (1e-13, True), (2 * EPS, False), (0.0, False), (-1e-3, False)):
        for size in (4.0**-10, 1.0, 4.0**10):
            a = size * np.array([[1.0, 0.0], [1.0, 1.0 + left]])
            assert cholesky(a, 2) is fine
            if fine:
                # One of 1 + left is rounded to eps.
                assert a[1, 1] == pytest.approx(np.sqrt(size * left), rel=2 * EPS / left)


def pair_of_rows(tree, rng, share, size=1.0):
    """A row between the first body and the last, and the same with a share of another added."""
    one, other = rng.normal(size=(2, 2, 6))
    ends = np.tile((0, tree.n_bodies - 1), (2, 1))
    return Rows(ends, size * np.array([one, one + share * other])), Rows(ends, np.array([one, other]))


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("seed", [seed for seed in TREES if 15 < any_tree(seed).n_v < 60][:6])
def test_rows_nearly_alike_hold_and_the_same_row_twice_is_refused(seed, method):
    tree, frames, rng = at(seed)
    tau, stream = rng.normal(size=tree.n_v), rng.bit_generator.state
    for share, size in ((1e-4, 1.0), (1.0, 1e-9), (1.0, 1e9), (0.0, 1.0), (0.0, 1e9)):
        rng.bit_generator.state = stream
        near, apart = pair_of_rows(tree, rng, share, size)
        if share == 0.0:
            with expect_refusal(fault=Fault.DEPENDENT, kind=MechanicsError):
                solve_closed(tree, frames, tau, near, method)
        else:
            expected = solve_closed(tree, frames, tau, apart, method)
            found = solve_closed(tree, frames, tau, near, method)
            assert np.abs(found - expected).max() < 1e-4 * np.abs(expected).max()


@pytest.mark.parametrize("solver", [solve_mass, log_det_mass])
def test_the_method_asked_for_is_the_one_used(monkeypatch, solver):
    tree, frames, _ = at(2)
    given = (tree, frames, np.ones(tree.n_v)) if solver is solve_mass else (tree, frames)
    monkeypatch.setattr(fixman, "eliminate", lambda tree, frames: pytest.fail("by Fixman's method"))
    solver(*given, "articulated")
    with pytest.raises(pytest.fail.Exception):
        solver(*given, "fixman")


@pytest.mark.parametrize("method", METHODS)
def test_torques_of_a_wrong_shape_are_named(method):
    tree, frames, _ = at(2)
    with pytest.raises(ProtochainError, match=rf"^tau has shape \({tree.n_v + 1},\)"):
        solve_mass(tree, frames, np.ones(tree.n_v + 1), method)


def test_an_unknown_method_is_refused():
    tree, frames, _ = at(2)
    with pytest.raises(MechanicsError, match="method 'magic' is not known; choose articulated or fixman"):
        solve_mass(tree, frames, np.zeros(tree.n_v), "magic")


def ramp(e):
    """A chain whose masses rise from 10^-e to 10^e, posed, with torques."""
    rng, n = np.random.default_rng(0), 12
    mass = np.logspace(-e, e, n)
    tree = Tree(
        np.arange(-1, n - 1), np.full(n, HingeKind.REVOLUTE), np.tile([1.0, 0, 0], (n, 1)),
        Rotation.random(n, rng=rng).as_matrix(), mass, np.tile([0.5, 0, 0], (n, 1)),
        np.diag([0.01, 0.1, 0.1]) * mass[:, None, None], np.zeros(n),
    )  # fmt: skip
    return tree, pose(tree, rng.normal(size=n)), rng.normal(size=n)


@pytest.mark.parametrize("e", [4, 6, 7, 8, 10, 12])
def test_fixman_s_method_is_right_or_refused_whatever_the_masses(e):
    given = ramp(e)
    wanted = solve_mass(*given)
    if e < 7:
        assert np.allclose(solve_mass(*given, "fixman"), wanted, rtol=1e-8)
        assert log_det_mass(*given[:2], "fixman") == pytest.approx(log_det_mass(*given[:2]), rel=1e-10)
    else:
        refused = pytest.raises(
            MechanicsError, match=r"Fixman's method has a relative error of .* use method articulated"
        )
        with refused:
            solve_mass(*given, "fixman")
        with refused:
            log_det_mass(*given[:2], "fixman")


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_what_is_not_finite_is_refused_by_name(bad):
    tree, frames, tau = ramp(1)
    q, wrong = np.zeros(12), np.where(np.arange(12) == 3, bad, tau)
    calls = {
        "tau": lambda: solve_mass(tree, frames, wrong),
        "qd": lambda: forward_dynamics(tree, q, wrong, tau),
        "tau ": lambda: forward_dynamics(tree, q, q, wrong),
        "wrench": lambda: forward_dynamics(tree, q, q, tau, np.full((12, 6), bad)),
    }  # fmt: skip
    for name, call in calls.items():
        with pytest.raises(ProtochainError, match=f"^{name.strip()} has {bad:g} at .*; give finite numbers"):
            call()
