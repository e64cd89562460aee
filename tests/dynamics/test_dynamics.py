"""Integrators, thermostats and constraints, on trees whose laws of motion are known otherwise."""

from functools import partial
from itertools import pairwise

import numpy as np
import pytest
from fixtures.refusals import expect_refusal
from fixtures.tolerances import REVERSED, ROUND_OFF
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from protochain.core.errors import Fault
from protochain.dynamics import (
    DormandPrince,
    HybridMonteCarlo,
    ImplicitMidpoint,
    Langevin,
    Leapfrog,
    NoseHoover,
    Rescaling,
    RungeKutta4,
    StepTooLargeError,
    System,
    fixman,
)  # fmt: skip
from protochain.dynamics.loop import noise, remove_com_motion
from protochain.mechanics import multibody
from protochain.mechanics.motion import lobatto
from protochain.mechanics.motion.correction import correct
from protochain.mechanics.motion.leapfrog import put_end_momenta
from protochain.mechanics.multibody import HingeKind, Tree, random_tree, rigid_bodies
from protochain.mechanics.multibody.hamilton import momenta, put_momenta
from protochain.mechanics.multibody.rotations import displacement_rates, tangent, tangent_inverse, turn_by

KINDS = (HingeKind.REVOLUTE, HingeKind.PRISMATIC, HingeKind.SCREW)
SYMPLECTIC = [Leapfrog(), Leapfrog(lobatto.drift), ImplicitMidpoint(1e-13)]
INTEGRATORS = [*SYMPLECTIC, RungeKutta4(), DormandPrince()]


def called(integrator):
    by_lobatto = getattr(integrator, "drift", None) is lobatto.drift
    return "Lobatto" if by_lobatto else type(integrator).__name__


def hinged(tree):
    """Coordinates and freedoms of the hinges."""
    alone = np.diff(tree.v_start) == 1
    return tree.q_start[:-1][alone], tree.v_start[:-1][alone]


def springs(tree, strength=20.0):
    """Springs at all hinges, in a potential that is not quite harmonic."""
    at_q, at_v = hinged(tree)

    def potential(q, factors):
        torque = np.zeros(tree.n_v)
        bent = q[at_q] - 0.3
        torque[at_v] = -strength * (bent + bent**3)
        return strength * float(np.sum(bent**2 / 2 + bent**4 / 4)), torque

    return potential


def scene(seed=1, n=6, potential=springs, kinds=KINDS, root=HingeKind.FREE):
    """A tree in motion."""
    rng = np.random.default_rng(seed)
    tree = random_tree(n, seed, branching=0.3, root=root, kinds=kinds)
    rest = np.zeros(tree.n_q)
    rest[:4] = (1.0, 0.2, 0.3, 0.1) if root is HingeKind.FREE else rest[:4]
    q = multibody.integrate(tree, rest, 0.3 * rng.normal(size=tree.n_v))
    return System(tree, potential(tree)), q, rng.normal(size=tree.n_v)


def run(system, integrator, at, time_step, n):
    for _ in range(n):
        at = integrator.step(system, at, time_step)
    return at


def about_origin(tree, at):
    """Linear momentum, and angular momentum about the world's origin."""
    linear, angular = multibody.momentum(tree, at.factors.frames, at.qd)
    centre = multibody.centre_of_mass(tree, at.factors.frames)
    return np.concatenate([linear, angular + np.cross(centre, linear)])


def distance(a, b):
    return max(np.abs(a.q - b.q).max(), np.abs(a.qd - b.qd).max())


# --- Rotations, momenta


@pytest.mark.parametrize("size", [1e-9, 1e-3, 0.0999, 0.1001, 1.0, 3.0, 6.0])
def test_exponential_map_and_its_tangent(size):
    """To rounding: the exponential of [xi]x, and its integral over 0 < s < 1 of s [xi]x."""
    rng = np.random.default_rng(int(1000 * size))
    xi, x = size * Rotation.random(rng=rng).as_matrix()[0], rng.normal(size=3)
    both = expm(np.block([[np.cross(np.eye(3), xi), np.eye(3)], [np.zeros((3, 6))]]))
    expected = both[:3, :3] @ x, both[:3, 3:] @ x, np.linalg.solve(both[:3, 3:], x)
    found = [of(tuple(xi), tuple(x)) for of in (turn_by, tangent, tangent_inverse)]
    assert np.allclose(found, expected, rtol=0, atol=2e-15 * (1.0 + size**4))


@pytest.mark.parametrize("seed", range(5))
def test_momenta_and_gradient_of_the_kinetic_energy(seed):
    system, q, qd = scene(seed)
    tree, frames = system.tree, multibody.pose(system.tree, q)
    p, gradient = momenta(tree, frames, qd)
    assert np.allclose(p, multibody.mass_matrix(tree, frames) @ qd, rtol=ROUND_OFF, atol=1e-12)
    h = 1e-5

    def kinetic(step):
        return multibody.kinetic_energy(tree, multibody.pose(tree, multibody.integrate(tree, q, step)), qd)

    difference = [(kinetic(h * one) - kinetic(-h * one)) / (2 * h) for one in np.eye(tree.n_v)]
    assert np.allclose(gradient, difference, atol=1e-8 * np.abs(gradient).max())


def test_lagranges_equations_are_those_of_newton_and_euler():
    """The rate dp/dt = tau + gradient, with the turn of a free root's axes, is what M qdd + c says."""
    system, q, qd = scene(3)
    tree, h = system.tree, 1e-5
    tau = np.random.default_rng(0).normal(size=tree.n_v)
    qdd = multibody.forward_dynamics(tree, q, qd, tau)

    def p(t):
        frames = multibody.pose(tree, multibody.integrate(tree, q, t * qd))
        return momenta(tree, frames, qd + t * qdd)[0]

    p0, gradient = momenta(tree, multibody.pose(tree, q), qd)
    expected = tau + gradient
    expected[:3] += np.cross(qd[:3], p0[:3])
    assert np.allclose((p(h) - p(-h)) / (2 * h), expected, atol=1e-7 * np.abs(expected).max())


# --- Integrators


@pytest.mark.parametrize("integrator", [*SYMPLECTIC, RungeKutta4()], ids=called)
def test_observed_order(integrator):
    system, q, qd = scene()
    span, order = 0.1, 4 if isinstance(integrator, RungeKutta4) else 2
    exact = run(system, DormandPrince(1e-13), system.at(q, qd), span, 1)
    steps = np.array([40, 80, 160, 320])
    errors = [
        distance(run(system, integrator, integrator.init(system, q, qd), span / n, n), exact) for n in steps
    ]
    slope = np.polyfit(np.log(span / steps), np.log(errors), 1)[0]
    assert slope == pytest.approx(order, abs=0.3 if order == 4 else 0.1)


def test_dormand_prince_keeps_its_tolerance_and_takes_as_few_steps_as_it_may():
    system, q, qd = scene()
    exact = run(system, RungeKutta4(), system.at(q, qd), 0.1 / 800, 800)
    errors, costs = [], []
    for tolerance in (1e-4, 1e-6, 1e-8, 1e-10):
        calls = []

        def counted(q, factors, calls=calls):
            calls.append(q)
            return system.potential(q, factors)

        counting = System(system.tree, counted)
        end = run(counting, DormandPrince(tolerance), counting.at(q, qd), 0.1, 1)
        errors.append(distance(end, exact))
        costs.append(len(calls))
    # Of order five: a tolerance a hundred times smaller costs some 2.5 times the evaluations.
    assert errors[0] < 1e-2 and errors[1] < 1e-4 and errors[2] < 1e-6
    assert all(1.5 < b / a < 3.5 for a, b in pairwise(costs[1:]))


@pytest.mark.parametrize("integrator", SYMPLECTIC, ids=called)
def test_time_reversal_returns_to_the_start(integrator):
    system, q, qd = scene()
    start = integrator.init(system, q, qd)
    there = run(system, integrator, start, 0.01, 30)
    assert distance(there, start) > 0.5
    assert distance(run(system, integrator, there, -0.01, 30), start) < REVERSED
    mirrored = run(system, integrator, system.with_velocities(there, -there.qd), 0.01, 30)
    assert distance(system.with_velocities(mirrored, -mirrored.qd), start) < REVERSED


@pytest.mark.parametrize("integrator", SYMPLECTIC, ids=called)
def test_phase_space_area_is_kept(integrator):
    """The Jacobian S of a step, in canonical charts at both ends, satisfies S^T W S = W."""
    system, q, qd = scene(2, n=4, kinds=(HingeKind.REVOLUTE,))
    tree, n = system.tree, system.tree.n_v
    start = system.at(q, 2.0 * qd)
    end = integrator.step(system, start, 0.03)

    def step(z):
        p = start.p + z[n:]
        p[:3] = tangent_inverse(tuple(-z[:3]), tuple(p[:3]))
        moved = multibody.integrate(tree, start.q, z[:n])
        velocity = multibody.solve_mass(tree, multibody.pose(tree, moved), p)
        at = integrator.step(system, system.at(moved, velocity), 0.03)
        turn = Rotation.from_quat(np.roll(at.q[:4], -1)) * Rotation.from_quat(np.roll(end.q[:4], -1)).inv()
        xi, p = turn.as_rotvec(), at.p.copy()
        p[:3] = tangent(tuple(-xi), tuple(at.p[:3]))
        return np.concatenate([xi, at.q[4:] - end.q[4:], p])

    h = 1e-4
    jacobian = np.array(
        [
            (8 * (step(h * z) - step(-h * z)) - step(2 * h * z) + step(-2 * h * z)) / (12 * h)
            for z in np.eye(2 * n)
        ]
    ).T
    area = np.block([[np.zeros((n, n)), np.eye(n)], [-np.eye(n), np.zeros((n, n))]])
    assert np.abs(jacobian - np.eye(2 * n)).max() > 0.1
    assert np.abs(jacobian.T @ area @ jacobian - area).max() < 1e-7


@pytest.mark.parametrize("integrator", INTEGRATORS, ids=called)
def test_momenta_of_an_isolated_chain_are_conserved_and_quaternions_stay_unit(integrator):
    system, q, qd = scene()
    start = integrator.init(system, q, qd)
    end = run(system, integrator, start, 0.005, 40)

    tolerance = 1e-9 if integrator in SYMPLECTIC else 1e-4
    assert distance(start, end) > 0.1
    before, after = (about_origin(system.tree, at) for at in (start, end))
    assert np.abs(after - before).max() < tolerance * np.abs(before).max()
    assert np.linalg.norm(end.q[:4]) == pytest.approx(1.0, abs=1e-14)


def test_a_step_without_solution_is_named():
    system, q, qd = scene()
    for integrator in SYMPLECTIC:
        with expect_refusal(fault=Fault.STEP, kind=StepTooLargeError):
            run(system, integrator, system.at(q, 100.0 * qd), 1.0, 5)
    with expect_refusal(fault=Fault.STEP, kind=StepTooLargeError):
        torn = System(system.tree, lambda q, factors: (np.nan, np.full(system.tree.n_v, np.nan)))
        DormandPrince().step(torn, system.at(q, qd), 0.1)


@pytest.mark.parametrize("root", [HingeKind.FIXED, HingeKind.FREE])
def test_newtons_matrix_is_the_derivative_to_first_order_in_the_step(root):
    """Against dense differences of what a drift's velocities must satisfy: off by the square of its time."""
    system, q, qd = scene(3, n=7, root=root)
    tree = system.tree
    p = momenta(tree, multibody.pose(tree, q), qd)[0]
    wanted = np.random.default_rng(1).normal(size=tree.n_v)
    errors = []
    for h in (0.02, 0.01, 0.005):

        def lack(rates, h=h):
            frames = multibody.pose(tree, multibody.integrate(tree, q, 0.5 * h * rates))
            mu, gradient = momenta(tree, frames, rates)
            out = np.empty(tree.n_v)
            put_end_momenta(tree.links, h, rates, mu, gradient, out)
            return p - out

        dense = np.array([(lack(qd + 1e-6 * e) - lack(qd - 1e-6 * e)) / -2e-6 for e in np.eye(tree.n_v)]).T
        frames = multibody.pose(tree, multibody.integrate(tree, q, 0.5 * h * qd))
        n, n_v = tree.n_bodies, tree.n_v
        twists, carried, mu, gradient = (np.empty(shape) for shape in ((n, 6), (n, 6), n_v, n_v))
        put_momenta(
            tree.links, tree.bodies, frames.rotation, frames.origin, qd, twists, carried, mu, gradient
        )
        x, there = wanted.copy(), (frames.rotation.copy(), frames.origin.copy())
        correct(tree.links, tree.bodies, *there, twists, carried, 0.5 * h, x)
        errors.append(np.abs(dense @ x - wanted).max())
    by_mass_alone = np.abs(dense @ multibody.solve_mass(tree, frames, wanted) - wanted).max()
    assert errors[2] < 0.1 * by_mass_alone
    assert 3.0 < errors[0] / errors[1] < 5.5 and 3.0 < errors[1] / errors[2] < 5.5


def test_rates_of_a_displacement_integrate_to_it():
    system, q, qd = scene()
    tree, h = system.tree, 1e-6
    step = 0.4 * np.random.default_rng(0).normal(size=tree.n_v)
    rates = displacement_rates(tree, step, qd)
    a = multibody.integrate(tree, q, step + h * rates)
    b = multibody.integrate(tree, multibody.integrate(tree, q, step), h * qd)
    assert np.abs(a - b).max() < 1e-10


# --- Thermostats

KT = 2.5


def thermostats(freedoms):
    return {
        "langevin": Langevin(KT, 5.0),
        "nose-hoover": NoseHoover(KT, freedoms, 5.0),
        "rescale": Rescaling(KT, freedoms, 5.0),
        "hmc": HybridMonteCarlo(KT, 5),
    }


@pytest.mark.parametrize("name", ["langevin", "nose-hoover", "rescale", "hmc"])
def test_what_a_thermostat_takes_is_counted(name):
    system, q, qd = scene(7, n=5, kinds=(HingeKind.REVOLUTE,))
    thermostat = thermostats(system.tree.n_v)[name]
    drift = []
    for h in (0.01, 0.005):
        at = system.at(q, qd)
        bath = thermostat.init(at)
        start, exchanged = at.total + bath.energy, 0.0
        for step in range(1, round(4.0 / h) + 1):
            at = Leapfrog().step(system, at, h)
            at, bath = thermostat.apply(system, at, bath, h, partial(noise, 3, step))
            exchanged = max(exchanged, abs(bath.energy))
        drift.append(abs(at.total + bath.energy - start))
        assert exchanged > 5.0 and drift[-1] < 0.05 * exchanged
    assert drift[1] < drift[0] or drift[1] < 1e-2


def test_nose_hoover_runs_back():
    system, q, qd = scene(7, n=5)
    thermostat = NoseHoover(KT, system.tree.n_v, 5.0)
    at = start = system.at(q, qd)
    bath = thermostat.init(at)
    for _ in range(50):
        at = Leapfrog().step(system, at, 0.01)
        at, bath = thermostat.apply(system, at, bath, 0.01, partial(noise, 0, 0))
    assert distance(at, start) > 0.5 and np.abs(bath.memory).max() > 0.1
    for _ in range(50):
        at, bath = thermostat.apply(system, at, bath, -0.01, partial(noise, 0, 0))
        at = Leapfrog().step(system, at, -0.01)
    assert distance(at, start) < 1e-9 and np.abs(bath.memory).max() < 1e-9


def test_at_zero_kelvin_langevin_only_damps():
    system, q, qd = scene()
    at = system.at(q, qd)
    after, bath = Langevin(0.0, 2.0).apply(system, at, Langevin(0.0).init(at), 0.1, partial(noise, 0, 1))
    assert np.allclose(after.qd, np.exp(-0.2) * qd, rtol=1e-14)
    assert bath.energy == pytest.approx(at.kinetic - after.kinetic)


def test_rescaling_approaches_the_mean_kinetic_energy_at_twice_the_rate_of_velocities():
    system, q, qd = scene(root=HingeKind.FIXED)
    n = system.tree.n_v
    thermostat = Rescaling(KT, n, 2.0)
    for size in (0.5, 4.0):
        at = system.at(q, qd)
        at = system.with_velocities(at, np.sqrt(size * n * KT / at.kinetic) * qd)
        ends = [
            thermostat.apply(system, at, thermostat.init(at), 0.1, partial(noise, 1, step))[0].kinetic
            for step in range(2000)
        ]
        mean = 0.5 * n * KT
        expected = mean + np.exp(-0.4) * (at.kinetic - mean)
        assert abs(np.mean(ends) - expected) < 4 * np.std(ends) / np.sqrt(2000)


def test_metropolis_undoes_what_climbs_and_keeps_what_falls():
    system, q, qd = scene()
    thermostat = HybridMonteCarlo(1e-6, 1)
    start = system.at(q, qd)
    bath = thermostat.init(start)
    for height, kept in ((1.0, 0.0), (-1.0, 1.0)):
        moved = multibody.integrate(system.tree, q, np.full(system.tree.n_v, 0.1))
        lifted = System(system.tree, lambda q, f: (height + start.total, np.zeros(system.tree.n_v)))  # noqa: B023
        end = lifted.at(moved, np.zeros(system.tree.n_v))
        after, memory = thermostat.apply(system, end, bath, 0.1, partial(noise, 0, 1))
        assert np.array_equal(after.q, moved if kept else q)
        assert memory.memory[1] == kept and memory.memory[2] == 1.0


# --- The Fixman potential


def bead_chain():
    """Four equal beads at right angles: one torsion, a free root; the third bead's mass is shared."""
    point = np.array(
        [[0.0, 0.15, -0.15], [0.0, 0.0, -0.15], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.15, 0.0, 0.0]]
    )
    body = np.array([0, 0, 0, 1, 1])
    mass, com, inertia = rigid_bodies(body, point, np.array([12.0, 12.0, 6.0, 6.0, 12.0]), 2)
    return Tree(
        parent=[-1, 0], kind=[HingeKind.FREE, HingeKind.REVOLUTE], offset=np.zeros((2, 3)),
        placement=np.tile(np.eye(3), (2, 1, 1)), mass=mass, com=com, inertia=inertia,
    )  # fmt: skip


def test_the_determinant_of_a_bead_chain_is_that_of_theory():
    """Exact: det M = c (35 + 4 cos a - 16 cos^2 a + cos^4 a), a the supplement of the dihedral."""
    tree = bead_chain()
    grid = np.linspace(-np.pi, np.pi, 21)
    at = np.zeros(tree.n_q)
    at[0] = 1.0
    values = []
    for angle in grid:
        at[-1] = angle
        values.append(System(tree, fixman(2.0)).at(at, np.zeros(tree.n_v)).potential)
    # The second body's arm starts a quarter turn from the first's.
    c = np.cos(grid - np.pi / 2 + np.pi)
    ratio = np.exp(values) / (35 + 4 * c - 16 * c**2 + c**4)
    assert np.allclose(ratio, ratio[0], rtol=1e-10)


@pytest.mark.parametrize("seed", range(3))
def test_fixmans_torque_is_minus_the_gradient_of_fixmans_potential(seed):
    system, q, qd = scene(seed)
    biased = System(system.tree, fixman(KT))
    at, h = biased.at(q, qd), 1e-5
    for k, one in enumerate(np.eye(system.tree.n_v)):
        up = biased.at(multibody.integrate(system.tree, q, h * one), qd).potential
        down = biased.at(multibody.integrate(system.tree, q, -h * one), qd).potential
        assert at.torque[k] == pytest.approx(-(up - down) / (2 * h), abs=1e-7 * np.abs(at.torque).max())


# --- Motion as one


def test_overall_motion_is_taken_away_and_nothing_else():
    """Two free chains: what is left has no momenta, and differs from the whole by a rigid motion."""
    one, other = random_tree(4, 1), random_tree(3, 2)
    parts = {
        name: np.concatenate([getattr(one, name), getattr(other, name)])
        for name in ("kind", "offset", "placement", "mass", "com", "inertia", "pitch")
    }
    tree = Tree(
        parent=np.concatenate([one.parent, np.where(other.parent < 0, -1, other.parent + 4)]), **parts
    )
    rng = np.random.default_rng(0)
    rest = np.zeros(tree.n_q)
    rest[[0, 10]] = 1.0
    q = multibody.integrate(tree, rest, rng.normal(size=tree.n_v))
    frames, qd = multibody.pose(tree, q), rng.normal(size=tree.n_v)
    still = remove_com_motion(tree, frames, qd)
    linear, angular = multibody.momentum(tree, frames, still)
    assert np.abs(linear).max() < 1e-12 and np.abs(angular).max() < 1e-12
    _, at_v = hinged(tree)
    assert np.array_equal(still[at_v], qd[at_v])
    taken = multibody.velocities(tree, frames, qd) - multibody.velocities(tree, frames, still)
    assert np.allclose(taken[:, :3], taken[0, :3], atol=1e-12)
    assert np.allclose(
        np.cross(taken[0, :3], frames.origin - frames.origin[0]), taken[:, 3:] - taken[0, 3:], atol=1e-12
    )
    assert multibody.kinetic_energy(tree, frames, still) < multibody.kinetic_energy(tree, frames, qd)
