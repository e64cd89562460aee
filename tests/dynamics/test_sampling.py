"""What simulations sample, against densities known otherwise: tests that a wrong or missing term fails."""

from functools import partial

import numpy as np
import pytest
from fixtures.samples import load
from scipy.stats import gamma, kstest

import protochain as pc
from protochain.core.units import MOLAR_GAS
from protochain.dynamics import (
    Closure,
    HybridMonteCarlo,
    ImplicitMidpoint,
    Langevin,
    Leapfrog,
    NoseHoover,
    Propagator,
    Rescaling,
    State,
    System,
    advance,
    closure_of,
    fixman,
    initial,
    simulate,
    total,
)  # fmt: skip
from protochain.mechanics import multibody
from protochain.mechanics.multibody import HingeKind, Tree, random_tree, rigid_bodies

KT = 2.5
KINDS = (HingeKind.REVOLUTE, HingeKind.PRISMATIC, HingeKind.SCREW)
WITHIN, BEYOND = 3.5, 10.0
"""Standard errors: what chance does once in two thousand times, and what it never does."""


def flat(tree):
    """No potential."""
    return lambda q, factors: (0.0, np.zeros(tree.n_v))


def nothing(x):
    """No energy of atoms, either."""
    return 0.0, np.zeros_like(x)


def sampled(propagator, q, length, n, measure):
    """(n,) measure at the ends of trajectories from q, the first tenth left out."""
    state, out = initial(propagator, q), []
    for step in range(1, length * n + 1):
        state = advance(propagator, state)
        if step % length == 0:
            out.append(measure(state))
    return np.array(out[n // 10 :]), state


def mean_and_error(series, blocks=20):
    """Mean, and its standard error by blocks far longer than the memory of the series."""
    each = series[: len(series) // blocks * blocks].reshape(blocks, -1).mean(axis=1)
    return series.mean(), each.std(ddof=1) / np.sqrt(blocks)


def joined(*trees):
    """One forest of several trees."""
    parts = {
        name: np.concatenate([getattr(tree, name) for tree in trees])
        for name in ("kind", "offset", "placement", "mass", "com", "inertia", "pitch")
    }
    first = np.cumsum([0, *[tree.n_bodies for tree in trees]])
    parent = [np.where(t.parent < 0, -1, t.parent + n) for t, n in zip(trees, first, strict=False)]
    return Tree(parent=np.concatenate(parent), **parts)


def rest(tree):
    q = np.zeros(tree.n_q)
    q[tree.q_start[:-1][tree.kind == HingeKind.FREE]] = 1.0
    return q


# --- Fixman's potential: the scene of the largest effect


LIGHT = 0.2


def pendulums(k):
    """Double pendulums, k of them in a plane: beads of 0.2 and 1 amu on arms of 0.1 nm.

    det M of each is 1e-4 (0.2 + sin^2 a), with a the angle between its arms.
    """
    n = 2 * k + 1
    parent = [-1] + [b for i in range(k) for b in (0, 2 * i + 1)]
    com, offset, mass = np.zeros((n, 3)), np.zeros((n, 3)), np.ones(n)
    com[1:, 0], offset[2::2, 0], mass[1::2] = 0.1, 0.1, LIGHT
    kind = [HingeKind.FIXED] + [HingeKind.REVOLUTE] * (n - 1)
    placement = np.tile(np.eye(3), (n, 1, 1))
    return Tree(parent, kind, offset, placement, mass, com, np.zeros((n, 3, 3)))


ANGLES = np.linspace(0.0, 2.0 * np.pi, 1001)[:-1]


def doubled(power):
    """Mean of cos 2a for a density (det M)^power: 0 with Fixman's term, 1/2 without, 1 with a wrong sign."""
    weight = (LIGHT + np.sin(ANGLES) ** 2) ** power
    return float(weight @ np.cos(2 * ANGLES) / weight.sum())


@pytest.mark.parametrize(("on", "power"), [(True, 0.0), (False, 0.5)])
def test_fixmans_term_is_there_and_has_its_sign(on, power):
    """By theory the angle is uniform with it; without it, or with the other sign, ten errors away."""
    k = 16
    tree = pendulums(k)
    for angle in (0.3, 1.4):
        m = multibody.mass_matrix(tree, multibody.pose(tree, np.full(tree.n_q, angle)))
        assert np.linalg.det(m[:2, :2]) == pytest.approx(1e-4 * (LIGHT + np.sin(angle) ** 2), rel=1e-12)
    system = System(tree, fixman(KT) if on else flat(tree))
    propagator = Propagator(system, Leapfrog(), HybridMonteCarlo(KT, 12), 0.003, KT, 1, False)
    start = np.random.default_rng(0).uniform(-np.pi, np.pi, tree.n_q)
    seen, end = sampled(propagator, start, 12, 500, lambda s: np.mean(np.cos(2 * s.at.q[1::2])))
    assert end.bath.memory[1] > 0.6 * end.bath.memory[2]
    mean, error = mean_and_error(seen)
    for density in (0.0, 0.5, 1.0):
        away = abs(mean - doubled(density)) / error
        # Wrong sign and none are nearer to one another than either to the flexible density.
        assert away < WITHIN if density == power else away > (BEYOND if on else 0.5 * BEYOND)


@pytest.mark.parametrize(("loops", "time_step"), [("open", 0.01), ("closed", 0.002)])
def test_simulate_moves_in_fixmans_potential(loops, time_step):
    """Without energy of the atoms and thermostat: what the motion gains, Fixman's potential loses."""
    c = pc.build_chain(load("3i40.pdb") if loops == "closed" else pc.from_sequence("G" * 8), root="free")
    m = simulate(c, nothing, c.q0, 300.0, time_step, 60, "none", 2, fixman=True, loops=loops, every=1)
    kinetic, bias = m.trace["kinetic_kj_mol"], m.trace["fixman_kj_mol"]
    assert np.ptp(bias) > 0.3
    assert np.ptp(kinetic + bias) < 0.05 * np.ptp(bias)
    assert np.ptp(m.trace["potential_kj_mol"]) < 1e-9
    half = bias.iloc[-1] / (MOLAR_GAS * 300.0)
    alone = 0.5 * pc.log_det_mass(m.chain, pc.pose(m.chain, m.q))
    assert (half == pytest.approx(alone, rel=1e-12)) == (loops == "open")


# --- Closed loops


def looped(seed):
    """Two trees with loops within and between them, away from rest."""
    second = (HingeKind.FREE, HingeKind.FIXED, HingeKind.REVOLUTE)[seed % 3]
    tree = joined(
        random_tree(6, seed, 0.3, HingeKind.FREE, KINDS), random_tree(5, seed + 50, 0.3, second, KINDS)
    )
    rng = np.random.default_rng(seed)
    q = multibody.integrate(tree, rest(tree), rng.normal(size=tree.n_v))
    body = np.array([[0, 5], [2, 9], [1, 8], [10, 4]])
    open_ = Closure(tree, body, rng.normal(scale=0.1, size=(4, 2, 3)), np.zeros(4))
    return Closure(tree, body, open_.local, open_.errors(multibody.pose(tree, q))), q


@pytest.mark.parametrize("seed", range(2))
def test_fixmans_potential_of_closed_loops(seed):
    """Against dense matrices: det of M on the loops' tangent, times the Jacobian of the distances there."""
    closure, q = looped(seed)
    tree, h = closure.tree, 1e-4
    system = System(tree, fixman(KT, closure), closure)

    def moved(step):
        return multibody.integrate(tree, q, step)

    def difference(function):
        """Fourth order."""
        return np.array(
            [
                (
                    8 * (function(moved(h * e)) - function(moved(-h * e)))
                    - function(moved(2 * h * e))
                    + function(moved(-2 * h * e))
                )
                / (12 * h)
                for e in np.eye(tree.n_v)
            ]
        ).T

    g = difference(lambda at: closure.errors(multibody.pose(tree, at)))
    m = multibody.mass_matrix(tree, multibody.pose(tree, q))
    tangent = np.linalg.svd(g)[2][len(g) :].T
    dense = np.linalg.slogdet(tangent.T @ m @ tangent)[1] + np.linalg.slogdet(g @ g.T)[1]
    value, torque = system.potential(q, system.factors(q))
    assert value == pytest.approx(0.5 * KT * dense, abs=1e-8)
    numeric = -difference(lambda at: system.potential(at, system.factors(at))[0])
    assert np.abs(torque - numeric).max() < 1e-9 * np.abs(torque).max()
    # The loops contribute, also along a free root where they join two trees.
    alone = fixman(KT)(q, system.factors(q))[1]
    assert np.abs(torque - alone).max() > 0.1
    assert (np.abs(torque[:6]).max() > 1e-3) and np.all(alone[:6] == 0.0)


CRANK, COUPLER, ROCKER, GROUND = 0.1, 0.453, 0.46, 0.138


def four_bar():
    """Planar linkage: a crank that turns all the way, a coupler, and a rocker that is a constant distance."""
    point = np.array(
        [
            [0.0, 0, 0], [0.1, 0, 0], [0, 0.1, 0],
            [CRANK / 2, 0.05, 0], [CRANK, 0, 0.05],
            [COUPLER / 2, 0.05, 0], [COUPLER, 0, 0.05],
        ]
    )  # fmt: skip
    mass, com, inertia = rigid_bodies(
        np.array([0, 0, 0, 1, 1, 2, 2]), point, np.array([1, 1, 1, 0.86, 0.86, 7.94, 7.94]), 3
    )
    tree = Tree(
        [-1, 0, 1], [HingeKind.FIXED, HingeKind.REVOLUTE, HingeKind.REVOLUTE],
        [[0, 0, 0], [0, 0, 0], [CRANK, 0, 0]], np.tile(np.eye(3), (3, 1, 1)), mass, com, inertia,
    )  # fmt: skip
    closure = Closure(
        tree, np.array([[0, 2]]), np.array([[[GROUND, 0, 0], [COUPLER, 0, 0]]]), np.array([ROCKER])
    )
    return tree, closure


def follows(crank):
    """Angle of the coupler against the crank, by the law of cosines."""
    across = np.array([GROUND - CRANK * np.cos(crank), -CRANK * np.sin(crank)])
    r = np.linalg.norm(across)
    elbow = np.arccos((r**2 + COUPLER**2 - ROCKER**2) / (2 * r * COUPLER))
    return np.arctan2(across[1], across[0]) + elbow - crank


# --- Kinetic energy with closed loops and free roots


def springs(tree, strength=20.0):
    at_q, at_v = (start[:-1][np.diff(tree.v_start) == 1] for start in (tree.q_start, tree.v_start))

    def potential(q, factors):
        torque = np.zeros(tree.n_v)
        torque[at_v] = -strength * (q[at_q] + q[at_q] ** 3)
        return strength * float(np.sum(q[at_q] ** 2 / 2 + q[at_q] ** 4 / 4)), torque

    return potential


def two_trees():
    return joined(random_tree(3, 1, root=HingeKind.FREE), random_tree(2, 2, root=HingeKind.FREE))


def closed_trees():
    """Two free trees of 15 freedoms in all, joined by two distances, and their start."""
    tree = two_trees()
    q = rest(tree)
    q[-5:-1] = 0.05
    body, local = np.array([[0, 4], [2, 3]]), 0.1 * np.random.default_rng(3).normal(size=(2, 2, 3))
    length = Closure(tree, body, local, np.zeros(2)).errors(multibody.pose(tree, q))
    return Closure(tree, body, local, length), q


@pytest.mark.parametrize(
    ("name", "closed", "freedoms"),
    [
        ("langevin", False, 15), ("nose-hoover", False, 9), ("rescale", True, 7), ("hmc", True, 13),
    ],
)  # fmt: skip
def test_kinetic_energy_of_free_roots_and_closed_loops_follows_the_gamma_law(name, closed, freedoms):
    """6 freedoms fewer where the motion as one is taken away, and one fewer for each distance."""
    closure, q = closed_trees()
    tree = closure.tree
    thermostat = {
        "langevin": Langevin(KT, 80.0 if closed else 40.0),
        "rescale": Rescaling(KT, freedoms, 80.0 if closed else 40.0),
        "nose-hoover": NoseHoover(KT, freedoms, 5.0),
        "hmc": HybridMonteCarlo(KT, 2),
    }[name]
    system = System(tree, springs(tree), closure if closed else None)
    removes = thermostat.conserves_momentum
    # Constraints bear shorter steps only.
    propagator = Propagator(system, Leapfrog(), thermostat, 0.01 if closed else 0.02, KT, 3, removes)
    every, n = (15, 1000) if name == "nose-hoover" else (2, 1000)
    energies, end = sampled(propagator, q, every, n, lambda s: s.at.kinetic)
    if removes:
        momenta = np.concatenate(multibody.momentum(tree, end.at.factors.frames, end.at.qd))
        assert np.abs(momenta).max() < 1e-6
    assert kstest(energies, gamma(freedoms / 2, scale=KT).cdf).pvalue > 1e-3
    assert np.var(energies) == pytest.approx(0.5 * freedoms * KT**2, rel=0.25)
    wrong = {freedoms - 1, freedoms + 1} | ({freedoms + 2, freedoms - 2} if closed else set())
    for other in wrong:
        assert kstest(energies, gamma(other / 2, scale=KT).cdf).pvalue < 1e-3


@pytest.mark.parametrize("thermostat", ["rescale"])
def test_simulate_counts_the_freedoms_of_insulin(thermostat):
    """Two free chains and three disulfides: rank of the rows by dense algebra, and the mean temperature."""
    c = pc.build_chain(load("3i40.pdb"))
    m = simulate(
        c, nothing, c.q0, 300.0, 0.0005, 150, thermostat, 4, friction=5000.0, loops="closed",
        trajectory_length=1, every=1,
    )  # fmt: skip
    closure, tree = closure_of(m.chain), m.chain.tree
    frames = multibody.pose(tree, m.q)
    rank = np.linalg.matrix_rank(multibody.row_matrix(tree, frames, closure.rows(frames)))
    assert (tree.kind == HingeKind.FREE).sum() == 2 and rank == 9
    assert m.freedoms == tree.n_v - rank - (6 if thermostat == "rescale" else 0)
    seen = m.trace["temperature_k"].to_numpy()[1:] / 300.0
    assert kstest(seen * m.freedoms / 2, gamma(m.freedoms / 2).cdf).pvalue > 1e-3
    # Nine distances are 4 % of the freedoms.
    assert abs(seen.mean() - 1.0) < 4 * np.sqrt(2.0 / m.freedoms / len(seen)) < 9 / m.freedoms


# --- Detailed balance


def stiff(h_omega):
    """Springs so stiff that a step of this much of their period's 1/(2 pi) errs by some kT."""
    kt, stiffness = 25.0, 2500.0
    tree = random_tree(3, 4, root=HingeKind.FIXED)
    least = np.diag(multibody.mass_matrix(tree, multibody.pose(tree, np.zeros(2)))).min()

    def potential(q, factors):
        return 0.5 * stiffness * float(q @ q), -stiffness * q

    def draw(rng):
        return np.sqrt(kt / stiffness) * rng.normal(size=2)

    system = System(tree, total([potential, fixman(kt)]))
    return system, Leapfrog(), h_omega * np.sqrt(least / stiffness), kt, draw


def free_fall(time_step):
    """No potential, and steps so long that their equations have no solution, or more than one."""
    tree = random_tree(5, 1, root=HingeKind.FREE)

    def draw(rng):
        return multibody.integrate(tree, rest(tree), rng.uniform(-3.0, 3.0, tree.n_v))

    return System(tree, flat(tree)), Leapfrog(), time_step, KT, draw


def ring(time_step):
    tree, closure = four_bar()

    def draw(rng):
        crank = rng.uniform(-np.pi, np.pi)
        return np.array([crank, follows(crank)])

    return System(tree, flat(tree), closure), Leapfrog(), time_step, KT, draw


def by_midpoint(h_omega):
    system, _, h, kt, draw = stiff(h_omega)
    return system, ImplicitMidpoint(1e-12), h, kt, draw


def started(scene, seed, length):
    """Propagator of trajectories of this length, and a thermal phase, drawn."""
    system, integrator, h, kt, draw = scene
    rng = np.random.default_rng(seed)
    at = system.at(draw(rng), np.zeros(system.tree.n_v))
    qd = multibody.sample_velocities(system.tree, at.factors.frames, kt, rng)
    at = system.with_velocities(at, qd)
    return Propagator(system, integrator, HybridMonteCarlo(kt, length), h, kt, seed, False), at


@pytest.mark.parametrize(
    ("make", "n"),
    [
        (partial(stiff, 1.7), 150), (partial(free_fall, 0.25), 100), (partial(ring, 0.3), 60),
        (partial(by_midpoint, 1.7), 10),
    ],
    ids=["stiff", "free fall", "ring", "midpoint"],
)  # fmt: skip
def test_a_step_of_monte_carlo_is_refused_together_with_its_reverse(make, n):
    """Else Metropolis' criterion, which compares energies only, would not balance."""
    scene, taken, refused = make(), 0, 0
    for seed in range(n):
        propagator, at = started(scene, seed, 1_000_000)
        system, bath = propagator.system, propagator.thermostat.init(at)
        there = advance(propagator, State(0, at, bath)).at
        if not np.isfinite(there.potential):
            refused += 1
            continue
        taken += 1
        back = advance(propagator, State(0, system.with_velocities(there, -there.qd), bath)).at
        assert np.isfinite(back.potential)
        assert np.abs(back.q - at.q).max() < 1e-5
    if n > 10:
        assert taken > 0.1 * n and refused > 0.03 * n


def test_monte_carlo_keeps_the_exact_distribution_where_its_guard_acts():
    """Two freedoms whose law is normal: trajectories that begin as it says end as it says."""
    scene, n, length = stiff(1.5), 800, 3
    ends, broken, kept = [], 0, 0
    for seed in range(n):
        propagator, at = started(scene, seed, length)
        state = State(length * seed, at, propagator.thermostat.init(at))
        for _ in range(length):
            state = advance(propagator, state)
            broken += not np.isfinite(state.at.potential)
        ends.append(state.at.q / np.sqrt(25.0 / 2500.0))
        kept += state.bath.memory[1]
    square = np.sum(np.square(ends), axis=1)
    assert broken > 0.05 * n and 0.2 * n < kept < 0.8 * n
    assert abs(square.mean() - 2.0) < WITHIN * 2.0 / np.sqrt(n)
    assert kstest(square, gamma(1.0, scale=2.0).cdf).pvalue > 1e-3


# --- The benchmark's errors
