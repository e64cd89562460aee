"""Impacts against closed forms, dense matrices, brute force and integration over the normal impulse."""

import itertools
from types import SimpleNamespace

import numpy as np
import pytest
from fixtures.refusals import expect_refusal
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from protochain.core.errors import Fault, MechanicsError, ProtochainError
from protochain.mechanics.multibody import (
    HingeKind,
    Rows,
    Tree,
    kinetic_energy,
    mass_matrix,
    operational_inverse,
    point_rows,
    pose,
    random_tree,
    row_matrix,
    solve_closed,
)
from protochain.mechanics.multibody.articulated import articulate
from protochain.mechanisms.impacts import ContactPoint, close_loops, impact
from protochain.mechanisms.impacts.complementarity import _natural_map, restitute
from protochain.mechanisms.impacts.impact import _together
from protochain.mechanisms.impacts.path import DONE, POISSON, follow, follow_in_turn

LAWS = ("newton", "poisson", "stronge")
UP = (0.0, 0.0, 1.0)
EXACT = 1e-13
"""Relative: exact pieces, a few dozen operations."""
PATH = 1e-9
"""Relative: curved pieces, some dozen steps with an error of 1e-10 each."""


def rods():
    """Two uniform rods in a row, 1 m and 1 kg each, that hang from a pin and turn about the world's z."""
    inertia = np.diag([1.0, 0.0, 1.0]) / 12.0
    return Tree(
        np.array([-1, 0]), np.full(2, HingeKind.REVOLUTE), np.array([[0.0, 0.0, 0.0], [0.0, -1.0, 0.0]]),
        np.tile(np.eye(3), (2, 1, 1)), np.ones(2), np.tile([0.0, -0.5, 0.0], (2, 1)),
        np.tile(inertia, (2, 1, 1)),
    )  # fmt: skip


def ball(mass=2.0, radius=0.3, inertia=0.1):
    """Factors of a free ball that touches the floor z = 0."""
    tree = Tree(
        np.array([-1]), np.array([HingeKind.FREE]), np.zeros((1, 3)), np.eye(3)[None], np.array([mass]),
        np.zeros((1, 3)), inertia * np.eye(3)[None],
    )  # fmt: skip
    return articulate(tree, pose(tree, np.array([1.0, 0, 0, 0, 0, 0, radius])))


def sliders(n, mass=None):
    """Factors of balls that slide along the world's z."""
    tree = Tree(
        np.full(n, -1), np.full(n, HingeKind.PRISMATIC), np.zeros((n, 3)), np.tile(np.eye(3), (n, 1, 1)),
        np.ones(n) if mass is None else mass, np.zeros((n, 3)), np.zeros((n, 3, 3)),
    )  # fmt: skip
    return articulate(tree, pose(tree, np.arange(float(n))))


def in_a_row(n, e):
    """Points between neighbours along z."""
    return [ContactPoint(f"{i}-{i + 1}", (i, i + 1), (0, 0, i + 0.5), UP, 0.0, e) for i in range(n - 1)]


def struck(seed, n=6, **options):
    """Random tree in a random pose, in motion: factors, velocities, source of random numbers."""
    rng = np.random.default_rng(seed)
    kinds = (HingeKind.REVOLUTE, HingeKind.PRISMATIC, HingeKind.SCREW)
    tree = random_tree(n, rng, **{"branching": 0.4, "kinds": kinds, **options})
    q = rng.normal(size=tree.n_q)
    return articulate(tree, pose(tree, q)), rng.normal(size=tree.n_v), rng


def touching(factors, rng, k=1, friction=0.5, restitution=0.5):
    """Points of contact at random places of random bodies, with others or the world."""
    points = []
    for i in range(k):
        first, second = rng.permutation(np.arange(-1, factors.tree.n_bodies))[:2]
        place = factors.frames.origin[max(first, second)] + rng.normal(scale=0.1, size=3)
        points.append(
            ContactPoint(f"p{i}", (int(first), int(second)), place, rng.normal(size=3), friction, restitution)
        )
    return points


def approaching(factors, qd, point):
    """The point with its normal turned so that it approaches."""
    u = impact(factors, qd, [point]).before[0] @ point.normal
    return point if u < 0.0 else turned(point)


def turned(point, **new):
    values = {name: getattr(point, name) for name in point.__dataclass_fields__} | new
    return ContactPoint(**(values | ({} if new else {"normal": -point.normal})))


def dense(factors, points):
    """Rows of the points' velocities along world axes, and M."""
    frames = factors.frames
    rows = [point_rows(frames, p.bodies, np.stack([p.point, p.point])) for p in points]
    g = np.concatenate([row_matrix(factors.tree, frames, row) for row in rows])
    return g, mass_matrix(factors.tree, frames)


# --- One point


@pytest.mark.parametrize(
    ("friction", "law", "kept"),
    [
        (0.7, "newton", 1.5875), (0.7, "poisson", 0.5169), (0.7, "stronge", 0.5258),
        (0.5, "newton", 0.7372), (0.5, "poisson", 0.5451), (0.5, "stronge", 0.5532),
    ],
)  # fmt: skip
def test_two_rods_keep_the_energies_known(friction, law, kept):
    tree = rods()
    frames = pose(tree, np.radians([20.0, 10.0]))
    tip = frames.origin[1] + frames.rotation[1] @ [0.0, -1.0, 0.0]
    qd = np.array([-0.1, -0.1])
    floor = ContactPoint("floor", (-1, 1), tip, (0.0, 1.0, 0.0), friction, 0.5)
    after = impact(articulate(tree, frames), qd, [floor], law)
    ratio = kinetic_energy(tree, frames, after.qd) / kinetic_energy(tree, frames, qd)
    assert ratio == pytest.approx(kept, abs=5e-5)
    sticks = np.abs(after.after[0, 0]) < EXACT
    assert sticks == (friction == 0.7)
    assert after.before[0] @ [1, 0, 0] < 0.0 and (sticks or after.after[0, 0] > 0.0)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("e", [0.0, 0.4, 1.0])
def test_a_ball_with_spin_slips_or_grips_as_known(law, e):
    mass, radius, inertia = 2.0, 0.3, 0.1
    factors, down, spin = ball(mass, radius, inertia), 3.0, np.array([4.0, -7.0, 5.0])
    qd = np.concatenate([spin, [0.5, 0.2, -down]])
    slip = qd[3:5] + np.cross(spin, [0.0, 0.0, -radius])[:2]
    normal = (1.0 + e) * mass * down
    grip = np.linalg.norm(slip) / (1.0 / mass + radius**2 / inertia)
    for mu in (0.1, 0.9 * grip / normal, 1.1 * grip / normal, 10.0):
        found = impact(factors, qd, [ContactPoint("floor", (-1, 0), np.zeros(3), UP, mu, e)], law)
        tangential = -slip / np.linalg.norm(slip) * min(mu * normal, grip)
        assert np.allclose(found.impulse[0], [*tangential, normal], rtol=EXACT, atol=EXACT)
        assert found.compression[0] == pytest.approx(mass * down, rel=EXACT)
        assert np.allclose(found.qd[3:5], qd[3:5] + tangential / mass, rtol=EXACT)
        torque = np.cross([0.0, 0.0, -radius], found.impulse[0])
        assert np.allclose(found.qd[:3], spin + torque / inertia, rtol=EXACT)


@pytest.mark.parametrize("seed", range(8))
def test_without_friction_the_laws_are_one(seed):
    factors, qd, rng = struck(seed)
    loops = random_loops(factors, rng) if seed % 2 else None
    qd = qd if loops is None else close_loops(factors, qd, loops)
    point = approaching(factors, qd, touching(factors, rng, friction=0.0, restitution=0.7)[0])
    found = [impact(factors, qd, [point], law, loops) for law in LAWS]
    u = found[0].before[0] @ point.normal
    assert u < 0.0
    for each in found:
        assert each.after[0] @ point.normal == pytest.approx(-0.7 * u, rel=1e-10)
        assert np.allclose(each.qd, found[0].qd, rtol=1e-11, atol=1e-12)
        assert np.linalg.norm(np.cross(each.impulse[0], point.normal)) < EXACT
        assert each.work == pytest.approx(-0.5 * (1 - 0.7**2) * each.compression[0] * abs(u), rel=1e-10)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("seed", range(6))
def test_velocities_follow_from_impulses_through_the_dense_matrix(seed, law):
    factors, qd, rng = struck(seed)
    point = approaching(factors, qd, touching(factors, rng, friction=0.3)[0])
    found = impact(factors, qd, [point], law)
    g, m = dense(factors, [point])
    assert np.allclose(m @ (found.qd - qd), g.T @ found.impulse[0], rtol=1e-9, atol=1e-11)
    assert np.allclose(found.before[0], g @ qd, rtol=1e-10, atol=EXACT)
    assert np.allclose(found.after[0], g @ found.qd, rtol=1e-10, atol=1e-11)
    change = 0.5 * (found.qd @ m @ found.qd - qd @ m @ qd)
    assert found.work == pytest.approx(change, rel=1e-8, abs=1e-10)
    along = found.impulse[0] @ point.normal
    assert np.linalg.norm(np.cross(found.impulse[0], point.normal)) <= 0.3 * along * (1 + PATH)
    if law == "newton":
        assert found.after[0] @ point.normal == pytest.approx(-0.5 * found.before[0] @ point.normal)
    if law == "poisson":
        assert along == pytest.approx(1.5 * found.compression[0])


def brute(w, u, mu, e, law):
    """Integrate du/dp = W (1, t) by scipy until the law is met; slip that ends is read as in theory.

    Returns velocities, and whether the slip came to rest on the way.
    """

    def starts():
        """Slip from rest: (b + mu W_tt) s = W_tn of length one, by bisection."""
        low, high = 0.0, np.linalg.norm(w[1:, 0])
        for _ in range(200):
            b = 0.5 * (low + high)
            s = np.linalg.solve(w[1:, 1:] * mu + b * np.eye(2), w[1:, 0])
            low, high = (b, high) if np.linalg.norm(s) > 1.0 else (low, b)
        return -mu * s

    rest = -np.linalg.solve(w[1:, 1:], w[1:, 0])
    rested = False

    def slope(p, y):
        t = now if rested else -mu * y[1:3] / np.linalg.norm(y[1:3])
        return [*(w @ np.array([1.0, *t])), y[0]]

    def met(p, y):
        if goal is None:
            return y[0]
        return {
            "newton": y[0] + e * u[0], "poisson": p - (1 + e) * goal[0],
            "stronge": y[3] - (1 - e * e) * goal[1],
        }[law]  # fmt: skip

    def still(p, y):
        return 1.0 if rested else np.linalg.norm(y[1:3]) - 1e-9 * np.linalg.norm(u)

    def falls(p, y):
        return 1.0 if goal is None else y[0] + 1e-10

    met.terminal = still.terminal = falls.terminal = True
    met.direction, falls.direction = 1, -1
    y, p, goal, now = np.array([*u, 0.0]), 0.0, None, rest
    while True:
        run = solve_ivp(slope, (p, p + 1e3), y, "DOP853", rtol=1e-11, atol=1e-13, events=[met, still, falls])
        y, p = run.y[:, -1], run.t[-1]
        if len(run.t_events[2]):
            goal = None
        elif len(run.t_events[0]):
            if goal is not None:
                return y[:3], rested
            goal = (p, y[3])
        else:
            rested, y[1:3] = True, 0.0
            now = rest if np.linalg.norm(rest) <= mu else starts()


@pytest.mark.parametrize("law", LAWS)
def test_paths_in_space_are_those_of_fine_integration(law):
    """Slip turns as it slows down: it goes on, sticks, or starts anew in another direction."""
    ended, curved = {"slips": 0, "sticks": 0, "turns back": 0}, 0
    for seed in range(30):
        rng = np.random.default_rng(seed)
        g, mu, e = rng.normal(size=(3, 4)), rng.uniform(0.1, 1.0), rng.uniform(0.2, 1.0)
        u = np.array([-1.0, *(0.5 * rng.normal(size=2))])
        if seed % 2:
            # In a plane through the normal, in which slip can reverse at once.
            g[2, :3], g[:2, 3], u[2] = 0.0, 0.0, 0.0
            turn = Rotation.from_euler("x", rng.uniform(0, 6)).as_matrix()
            g, u = turn @ g, turn @ u
        w = g @ g.T
        expected, rested = brute(w, u, mu, e, law)
        out = np.zeros(8)
        assert follow(w, u, mu, e, LAWS.index(law), 0.0, 1e-10, out) == 0
        # The brute force stops slip at 1e-9.
        assert np.allclose(u + w @ out[:3], expected, atol=3e-8)
        slips = np.linalg.norm(expected[1:]) > 1e-8
        ended["sticks" if not slips else "turns back" if rested else "slips"] += 1
        curved += out[7] > 0
    assert curved >= 12
    assert min(ended.values()) >= 1, ended


@pytest.mark.parametrize("law", ["newton", "stronge"])
def test_what_presses_again_is_compressed_anew(law):
    """Slip that turns may pull the point back on its way out; the compression ends the second time."""
    w = np.array([[0.102, 0.896, 2.237], [0.896, 14.45, 38.722], [2.237, 38.722, 106.6]])
    u, mu, e = np.array([-0.5, -8.2, -23.9]), 1.8, 0.9
    out = np.zeros(8)
    assert follow(w, u, mu, e, LAWS.index(law), 0.0, 1e-10, out) == 0
    expected, rested = brute(w, u, mu, e, law)
    # The first time it ends early.
    assert rested and out[3] > 10.0 * 0.5 / (w[0, 0] + mu * np.linalg.norm(w[0, 1:]))
    assert np.allclose(u + w @ out[:3], expected, rtol=1e-6, atol=1e-6)
    if law != "newton":
        assert out[:3] @ u + 0.5 * out[:3] @ w @ out[:3] < 0.0


def test_a_point_that_does_not_approach_does_nothing():
    factors, qd, rng = struck(4)
    point = turned(approaching(factors, qd, touching(factors, rng)[0]))
    found = impact(factors, qd, [point])
    assert np.array_equal(found.qd, qd) and not found.impulse.any() and found.work == 0.0
    assert np.array_equal(found.before, found.after) and found.before[0] @ point.normal > 0.0


# --- Loops


def random_loops(factors, rng, m=2):
    """Rows of distances between points of random bodies."""
    n = factors.tree.n_bodies
    return Rows(np.array([rng.permutation(n)[:2] for _ in range(m)]), rng.normal(size=(m, 2, 6)))


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("k", [1, 3])
def test_loops_hold_through_an_impact(seed, k):
    factors, qd, rng = struck(seed, n=8)
    loops = random_loops(factors, rng)
    c = row_matrix(factors.tree, factors.frames, loops)
    apart, qd = qd, close_loops(factors, qd, loops)
    points = [approaching(factors, qd, p) for p in touching(factors, rng, k, friction=0.2)]
    found = impact(factors, qd, points, loops=loops)
    # Loops that are not closed before close at once, and are struck as they close.
    assert np.abs(c @ apart).max() > 0.01
    assert np.allclose(impact(factors, apart, points, loops=loops).qd, found.qd, rtol=1e-9, atol=1e-10)
    g, m = dense(factors, points)
    assert np.abs(c @ found.qd).max() < 1e-11
    impulses = g.T @ found.impulse.ravel() + c.T @ found.loops
    assert np.allclose(m @ (found.qd - qd), impulses, rtol=1e-9, atol=1e-10)
    if k == 1:
        # The inverse of M where loops hold, column by column.
        closed = np.array([solve_closed(factors.tree, factors.frames, row, loops) for row in g])
        after = g @ qd + g @ closed.T @ found.impulse[0]
        assert np.allclose(found.after[0], after, rtol=1e-9, atol=1e-10)


def test_loops_close_by_the_impulse_that_costs_least():
    factors, qd, rng = struck(2, n=8)
    loops = random_loops(factors, rng)
    found = close_loops(factors, qd, loops)
    c, m = row_matrix(factors.tree, factors.frames, loops), mass_matrix(factors.tree, factors.frames)
    kkt = np.block([[m, c.T], [c, np.zeros((len(c), len(c)))]])
    expected = np.linalg.solve(kkt, np.concatenate([m @ qd, np.zeros(len(c))]))[: len(qd)]
    assert np.allclose(found, expected, rtol=1e-9, atol=1e-10)
    with expect_refusal(fault=Fault.DEPENDENT, kind=MechanicsError):
        close_loops(factors, qd, Rows(np.tile(loops.body, (2, 1)), np.tile(loops.wrench, (2, 1, 1))))


def test_known_factors_give_the_same_bits():
    factors, qd, rng = struck(5)
    tree, frames, rows = factors.tree, factors.frames, random_loops(factors, rng, 3)
    again = operational_inverse(tree, frames, rows, factors)
    assert np.array_equal(again, operational_inverse(tree, frames, rows))
    assert np.array_equal(
        solve_closed(tree, frames, qd, rows, factors=factors), solve_closed(tree, frames, qd, rows)
    )


# --- Impulses that are given


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("closed", [False, True])
def test_the_work_of_a_blow_is_impulse_times_mean_velocity(seed, closed):
    """Kelvin's theorem; and velocities through the dense matrix, of two bodies struck at once."""
    factors, qd, rng = struck(seed, n=8)
    loops = random_loops(factors, rng) if closed else None
    qd = qd if loops is None else close_loops(factors, qd, loops)
    external = {b: tuple(rng.normal(size=(2, 3))) for b in (1, 6)}
    found = impact(factors, qd, [], loops=loops, external=external)
    tree, frames = factors.tree, factors.frames
    m, pushed, mean = mass_matrix(tree, frames), np.zeros(tree.n_v), 0.0
    for body, (point, blow) in external.items():
        rows = row_matrix(tree, frames, point_rows(frames, (-1, body), np.stack([point, point])))
        pushed += rows.T @ blow
        mean += blow @ rows @ (qd + found.qd) / 2.0
    if closed:
        pushed += row_matrix(tree, frames, loops).T @ found.loops
    np.testing.assert_allclose(m @ (found.qd - qd), pushed, rtol=1e-9, atol=1e-10)
    assert found.work == pytest.approx(mean, rel=1e-9)
    gained = 0.5 * (found.qd @ m @ found.qd - qd @ m @ qd)
    assert found.work == pytest.approx(gained, rel=1e-8, abs=1e-10)


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("law", ["poisson", "stronge"])
def test_no_impact_gives_energy_and_what_it_takes_is_all_that_the_blow_does_not_give(seed, law):
    """The dissipation inequality; the blow's own work by its mean velocity while it alone acts, first."""
    factors, qd, rng = struck(seed)
    loops = random_loops(factors, rng) if seed % 2 else None
    points = touching(factors, rng, 1 + seed % 3, rng.uniform(0.0, 1.5), rng.uniform())
    external = {2: tuple(rng.normal(size=(2, 3)))}
    found = impact(factors, qd, points, law, loops, "in turn", external)
    blown, m = impact(factors, qd, [], external=external), mass_matrix(factors.tree, factors.frames)
    lost = 0.5 * (blown.qd @ m @ blown.qd - found.qd @ m @ found.qd)
    assert found.dissipation == pytest.approx(lost, rel=1e-8, abs=1e-9) and found.dissipation > -1e-9
    assert found.work == pytest.approx(blown.work - lost, rel=1e-8, abs=1e-9)


@pytest.mark.parametrize("law", LAWS)
def test_a_ball_at_rest_is_driven_into_the_floor_and_comes_back(law):
    mass, radius, inertia, e = 2.0, 0.3, 0.1, 0.6
    factors = ball(mass, radius, inertia)
    middle, down, along = (0.0, 0.0, radius), 3.0, 0.8
    for mu in (0.05, 5.0):
        floor = ContactPoint("floor", (-1, 0), np.zeros(3), UP, mu, e)
        found = impact(factors, np.zeros(6), [floor], law, external={0: (middle, (along, 0.0, -down))})
        grip = along / mass / (1.0 / mass + radius**2 / inertia)
        rub = min(mu * (1.0 + e) * down, grip)
        np.testing.assert_allclose(found.impulse[0], [-rub, 0.0, (1.0 + e) * down], rtol=EXACT, atol=EXACT)
        np.testing.assert_allclose(found.before[0], [along / mass, 0.0, -down / mass], rtol=EXACT, atol=EXACT)
        np.testing.assert_allclose(found.qd[3:], [(along - rub) / mass, 0.0, e * down / mass], atol=EXACT)
        change = kinetic_energy(factors.tree, factors.frames, found.qd)
        assert found.work == pytest.approx(change, rel=1e-12)
        # Struck upwards it leaves the floor alone, which would have met it.
        sinking = np.array([0.0, 0.0, 0.0, 0.0, 0.0, -1.0])
        lifted = impact(factors, sinking, [floor], law, external={0: (middle, (0.0, 0.0, 4.0))})
        assert not lifted.impulse.any() and lifted.qd[5] == pytest.approx(1.0, rel=EXACT)


def test_no_blow_changes_no_bit_and_wrong_ones_are_refused():
    factors, qd, rng = struck(5)
    point = approaching(factors, qd, touching(factors, rng)[0])
    plain, empty = impact(factors, qd, [point]), impact(factors, qd, [point], external={})
    assert np.array_equal(plain.qd, empty.qd) and plain.work == empty.work
    zero, n = np.zeros(3), factors.tree.n_bodies
    for external, words in (
        ([zero, zero], "give {body: "), ({n: (zero, zero)}, f"no body {n}; give a number from 0 to {n - 1}"),
        ({-1: (zero, zero)}, "no body -1"), ({"arm": (zero, zero)}, "no body 'arm'"),
        ({True: (zero, zero)}, "no body True"), ({0: zero}, "body 0: give a pair"),
        ({0: 1.0}, "body 0: give a pair"), ({2: (zero, [0, np.nan, 0])}, "body 2: its impulse is not finite"),
        ({2: ([np.inf, 0, 0], zero)}, "body 2: its point is not finite"),
        ({2: (zero, [1.0])}, r"body 2: impulse has shape \(1,\)"),
        ({0: ("a", zero)}, "body 0: point: give an array"),
    ):  # fmt: skip
        with pytest.raises(ProtochainError, match=words) as refused:
            impact(factors, qd, [], external=external)
        assert len(str(refused.value).splitlines()) == 1


# --- Several points


@pytest.mark.parametrize("e", [1.0, 0.8])
def test_newtons_cradle_passes_the_blow_on(e):
    factors = sliders(5)
    one = impact(factors, np.array([1.0, 0, 0, 0, 0]), in_a_row(5, e), order="in turn")
    assert one.qd[-1] == pytest.approx(((1 + e) / 2) ** 4, rel=EXACT)
    assert np.sum(one.qd) == pytest.approx(1.0, rel=EXACT)
    if e == 1.0:
        two = impact(factors, np.array([1.0, 1, 0, 0, 0]), in_a_row(5, e), "stronge", order="in turn")
        assert np.allclose(two.qd, [0, 0, 0, 1, 1], atol=EXACT)
        assert np.allclose(one.qd, [0, 0, 0, 0, 1], atol=EXACT)


def test_at_once_the_cradle_shares_the_blow():
    """Compressed, three balls move at 1/3; what is given back doubles the change."""
    found = impact(sliders(3), np.array([1.0, 0, 0]), in_a_row(3, 1.0))
    assert np.allclose(found.qd, [-1 / 3, 2 / 3, 2 / 3], atol=EXACT)
    assert np.allclose(found.compression, [2 / 3, 1 / 3], atol=EXACT)
    assert found.work == pytest.approx(0.0, abs=EXACT)


def enumerated(w, u, mu, floor):
    """All solutions in the plane, two rows a point: each is free or holds, and sticks or slips either way."""
    k, found = len(mu), []
    for hold, slide in itertools.product(
        itertools.product((0, 1), repeat=k), itertools.product((0, 1, -1), repeat=k)
    ):
        a, b = np.zeros((2 * k, 2 * k)), np.zeros(2 * k)
        for i in range(k):
            n, t = 2 * i, 2 * i + 1
            if hold[i]:
                a[n], b[n] = w[n], -u[n]
            else:
                a[n, n], b[n] = 1.0, floor[i]
            if slide[i]:
                a[t, t], a[t, n] = 1.0, slide[i] * mu[i]
            else:
                a[t], b[t] = w[t], -u[t]
        x = np.linalg.solve(a, b)
        v = u + w @ x
        n, t, slide = np.arange(0, 2 * k, 2), np.arange(1, 2 * k, 2), np.array(slide)
        fits = np.all(x[n] > floor - 1e-9) and np.all(v[n] > -1e-9)
        fits &= np.all(np.where(slide == 0, np.abs(x[t]) < mu * x[n] + 1e-9, v[t] * slide > -1e-9))
        if fits and not any(np.allclose(w @ (x - y), 0.0, atol=1e-7) for y in found):
            found.append(x)
    return found


def in_space(w, u):
    """Plane rows (normal, tangential) as rows in space, whose second tangential velocity does nothing."""
    k = len(u) // 2
    place = np.ravel([[3 * i, 3 * i + 1] for i in range(k)])
    whole, before = np.zeros((3 * k, 3 * k)), np.zeros(3 * k)
    whole[np.ix_(place, place)], before[place] = w, u
    return whole, before, place


def test_several_points_in_the_plane_against_all_that_could_be():
    """Both phases of Poisson's law are the one solution, or there are several and they are refused."""
    rng, told, seen = np.random.default_rng(0), 0, 0
    for _ in range(60):
        k = int(rng.integers(2, 4))
        g = rng.normal(size=(2 * k, 2 * k + 1))
        w, u, mu = g @ g.T, rng.normal(size=2 * k), rng.uniform(0.0, 1.5, size=k)
        whole, before, place = in_space(w, u)
        out, e = np.zeros((2, 3 * k)), 0.6
        refused = restitute(whole, before, mu, np.full(k, e), out) != 0
        first = enumerated(w, u, mu, np.zeros(k))
        second = []
        if len(first) == 1:
            second = enumerated(w, u + w @ first[0], mu, e * first[0][::2])
        seen += refused
        told += refused == (len(first) != 1 or len(second) != 1)
        if len(first) == len(second) == 1 and not refused:
            assert np.allclose(out[1, place], first[0], atol=1e-9)
            assert np.allclose(out[0, place], first[0] + second[0], atol=1e-9)
    assert told >= 59 and seen < 20


def test_points_in_space_keep_to_their_cones():
    """Of both phases: complementary along the normal, in the cone, and on its edge against the slip."""
    for seed in range(12):
        factors, qd, rng = struck(seed, n=9)
        points = touching(factors, rng, 3, 0.3, 0.5)
        found = impact(factors, qd, points)
        normals = np.array([p.normal for p in points])
        along = np.sum(found.impulse * normals, axis=1)
        leaving = np.sum(found.after * normals, axis=1)
        assert leaving.min() > -1e-10 and along.min() > -1e-12
        # What is given back is at least e times what was taken, and more only where nothing moves.
        more = along - 1.5 * found.compression
        assert more.min() >= -1e-10 * along.max() and np.abs(more * leaving).max() < 1e-9
        _, m = dense(factors, points)
        across = found.impulse - along[:, None] * normals
        assert np.all(np.linalg.norm(across, axis=1) <= 0.3 * along + 1e-12 * along.max())
        assert found.work <= 1e-12 * abs(qd @ m @ qd)


def box(com=(0.0, 0.0, 0.0)):
    """Factors of a box of 2 x 2 x 1 that stands on the floor, and its four corners."""
    tree = Tree(
        np.array([-1]), np.array([HingeKind.FREE]), np.zeros((1, 3)), np.eye(3)[None], np.array([3.0]),
        np.array([com]), np.diag([1.25, 1.25, 2.0])[None],
    )  # fmt: skip
    corners = np.array([[x, y, -0.5] for x in (-1.0, 1.0) for y in (-1.0, 1.0)])
    return articulate(tree, pose(tree, np.array([1.0, 0, 0, 0, 0, 0, 0]))), corners


@pytest.mark.parametrize("friction", [0.0, 0.4])
@pytest.mark.parametrize("com", [(0.0, 0.0, 0.0), (0.2, -0.1, 0.0)])
def test_redundant_points_share_the_blow_by_least_norm(com, friction):
    factors, corners = box(com)
    floor = [ContactPoint(f"corner {i}", (-1, 0), x, UP, friction, 0.3) for i, x in enumerate(corners)]
    qd = np.array([0, 0, 0, 0, 0, -2.0])
    found = impact(factors, qd, floor)
    g, m = dense(factors, floor)
    assert np.linalg.matrix_rank(g) == 6
    assert np.allclose(found.qd, -0.3 * qd, atol=1e-11)
    # All corners stop: the least norm of impulses that do it; those across only where friction lets them.
    rows = g if friction else g[2::3]
    expected = np.linalg.pinv(rows.T) @ m @ (found.qd - qd)
    given = found.impulse.ravel() if friction else found.impulse[:, 2]
    assert np.allclose(given, expected, rtol=1e-6, atol=1e-7)


def test_each_point_has_its_own_coefficients():
    factors, qd = sliders(3), np.array([-1.0, -2.0, -3.0])
    floor = [
        ContactPoint(f"floor {i}", (-1, i), (0, 0, i), UP, 0.0, e) for i, e in enumerate((0.2, 0.9, 0.0))
    ]
    for order in ("together", "in turn"):
        assert np.allclose(impact(factors, qd, floor, order=order).qd, [0.2, 1.8, 0.0], atol=1e-11)


def test_points_of_different_restitution_add_no_energy_either():
    """One point stores what the other gives back: less of it, so that none is gained."""
    rng = np.random.default_rng(607)
    g = rng.normal(size=(6, 4))
    w, u, mu = g @ g.T, g @ rng.normal(size=4), np.array([0.5, 0.1])
    out = np.zeros((2, 6))
    assert restitute(w, u, mu, np.array([0.0, 1.0]), out) == 0
    back = (out[0, 3] - out[1, 3]) / out[1, 3]
    work = out[0] @ u + 0.5 * out[0] @ w @ out[0]
    assert 0.85 < back < 0.95 and -1e-5 < work <= 0.0
    # Given back in full, from what the compression has left, it would be a gain.
    same = np.zeros((2, 6))
    assert restitute(w, u, mu, np.array([0.0, 0.5]), same) == 0
    assert np.allclose(same[1], out[1]) and same[0, 3] == pytest.approx(1.5 * same[1, 3])


# --- What is refused


def test_of_several_solutions_the_point_is_named_where_they_differ_most():
    """The second of two, though the first has the higher friction: so say all pairs found by trying all."""
    rng, mu = np.random.default_rng(1), np.array([2.0, 1.8])
    points = [ContactPoint(f"p{i}", (-1, i), np.zeros(3), UP, mu[i]) for i in (0, 1)]
    while True:
        g = rng.normal(size=(4, 5))
        w, u = g @ g.T, rng.normal(size=4)
        found = enumerated(w, u, mu, np.zeros(2))
        apart = [np.linalg.norm((a - b).reshape(2, 2), axis=1) for a, b in itertools.combinations(found, 2)]
        if apart and all(2.0 * first < second for first, second in apart):
            break
    whole, before, _ = in_space(w, u)
    with expect_refusal(fault=Fault.FRICTION, kind=MechanicsError, match="'p1'"):
        _together(SimpleNamespace(w=whole, u=before), points)


def test_what_is_left_of_endless_blows_gives_nothing_back():
    """A light ball between a wall and one that is far heavier: ten thousand blows would turn it back."""
    factors = sliders(2, np.array([1e-8, 1.0]))
    wall = ContactPoint("wall", (-1, 0), np.zeros(3), UP, 0.0, 1.0)
    found = impact(factors, np.array([0.0, -1.0]), [wall, *in_a_row(2, 1.0)], order="in turn")
    assert np.abs(found.qd).max() < 1e-6


def test_what_cannot_be_met_is_refused_by_name():
    factors = sliders(2)
    driven = Tree(
        **{name: getattr(factors.tree, name) for name in ("parent", "kind", "offset", "placement", "mass")},
        com=np.zeros((2, 3)), inertia=np.zeros((2, 3, 3)), driven=np.array([True, False]),
    )  # fmt: skip
    piston = ContactPoint("piston", (-1, 0), np.zeros(3), UP)
    for points in ([piston], [piston, *in_a_row(2, 0.5)]):
        with expect_refusal(fault=Fault.IMMOVABLE, kind=MechanicsError, match="'piston'"):
            impact(articulate(driven, factors.frames), np.array([-1.0, 0.0]), points)
    # Driven, it throws the other as a wall that moves would, and keeps its own velocity.
    thrown = impact(articulate(driven, factors.frames), np.array([1.0, 0.0]), in_a_row(2, 0.5))
    assert np.allclose(thrown.qd, [1.0, 1.5], rtol=EXACT)
    # A slide at 45 degrees, gripped: it can only leave along the slide, which friction holds.
    slope = ContactPoint("slope", (-1, 0), np.zeros(3), (1.0, 0.0, 1.0), 2.0, 0.5)
    with expect_refusal(fault=Fault.JAMMED, kind=MechanicsError, match="'slope'"):
        impact(factors, np.array([-1.0, 0.0]), [slope], "newton")
    for law in ("poisson", "stronge"):
        assert np.allclose(impact(factors, np.array([-1.0, 0.0]), [slope], law).qd, 0.0, atol=EXACT)


def test_wrong_arguments_are_refused_in_one_line():
    for options, words in (
        ({"normal": np.zeros(3)}, "its normal has no direction"),
        ({"friction": -0.1}, "friction -0.1 must be 0"),
        ({"friction": np.inf}, "friction inf"), ({"restitution": 1.1}, "restitution 1.1 is not 0 to 1"),
        ({"friction": "high"}, "friction 'high': give a number"),
        ({"restitution": np.nan}, "restitution nan"), ({"bodies": (0, 0)}, "cannot touch itself"),
        ({"point": [0.0, np.nan, 0.0]}, "its point is not finite"),
        ({"point": [0.0]}, r"shape \(1,\), not \(3,\)"),
    ):  # fmt: skip
        with pytest.raises(Exception, match=words) as refused:
            ContactPoint(**({"name": "tip", "bodies": (-1, 0), "point": np.zeros(3), "normal": UP} | options))
        assert "tip" in str(refused.value) and "\n" not in str(refused.value)
    factors, qd = sliders(3), np.array([1.0, 0.0, 0.0])
    with expect_refusal(fault=Fault.NOT_FINITE, kind=MechanicsError):
        impact(factors, np.array([1.0, np.nan, 0.0]), in_a_row(2, 1.0))
    with pytest.raises(MechanicsError, match="law 'hooke' is not known; choose newton, poisson or stronge"):
        impact(factors, qd, in_a_row(2, 1.0), "hooke")
    with pytest.raises(MechanicsError, match="order 'later' is not known; choose together or in turn"):
        impact(factors, qd, in_a_row(2, 1.0), order="later")
    with pytest.raises(MechanicsError, match="several points together follow Poisson's law, not newton"):
        impact(factors, qd, in_a_row(3, 1.0), "newton")
    with pytest.raises(MechanicsError, match="contact '2-3': there is no body 3"):
        impact(factors, qd, in_a_row(4, 1.0))


# --- Endless bounces


@pytest.mark.parametrize("seed", range(6))
def test_newtons_method_has_the_derivative_of_what_vanishes_at_a_solution(seed):
    """By differences, of contacts that stick, slide, part, and have no friction, away from their bounds."""
    random = np.random.default_rng(seed)
    n = 12
    half = random.normal(size=(n, n))
    w, u, x = half @ half.T + 3.0 * np.eye(n), random.normal(size=n), random.normal(size=n)
    mu, floor = np.array([0.0, 0.05, 0.6, 9.0]), np.zeros(4)
    x[::3] = np.abs(x[::3]) + 0.5

    def at(x):
        residual, slope = np.empty(n), np.empty((n, n))
        size = _natural_map(w, u, mu, floor, x, residual, slope)
        return residual, slope, size

    found, step = at(x)[1], 1e-6
    ahead, behind = (np.array([at(x + sign * step * e)[0] for e in np.eye(n)]) for sign in (1, -1))
    assert np.abs((ahead - behind).T / (2.0 * step) - found).max() < 1e-7 * np.abs(found).max()
    assert at(x)[2] >= np.abs(x).max()


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("fastest", [0, 1, 2])
def test_in_turn_the_fastest_point_is_always_the_next(law, fastest):
    """As a loop over one point after the other has it, of which each feels the impulses before."""
    random = np.random.default_rng(fastest)
    half = random.normal(size=(9, 9))
    w, mu, e = half @ half.T + 9.0 * np.eye(9), np.array([0.1, 0.3, 0.0]), np.array([0.2, 0.0, 0.5])
    u = 0.1 * random.normal(size=9)
    u[::3] = -1.0
    u[3 * fastest] = -2.0
    out, slow, number = np.zeros((2, 9)), np.full(3, 1e-6), LAWS.index(law)
    assert follow_in_turn(w, u, mu, e, number, slow, 1e-10, 10_000, out) == (0, 0)
    expected, v, order = np.zeros((2, 9)), u.copy(), []
    while (approach := v[::3].min()) < -1e-6:
        i = 3 * int(np.argmin(v[::3]))
        order.append(i // 3)
        alone = np.zeros(8)
        follow(w[i : i + 3, i : i + 3], v[i : i + 3], mu[i // 3], e[i // 3], number, 1e-6, 1e-10, alone)
        expected[0, i : i + 3] += alone[:3]
        expected[1, i] += alone[3]
        v += w[:, i : i + 3] @ alone[:3]
        assert approach < 0.0 and len(order) < 10_000
    assert order[0] == fastest
    assert np.allclose(out, expected, rtol=1e-9, atol=1e-12)


def test_a_slip_that_ends_with_the_compression_is_followed_to_the_end():
    """A point of one freedom: its velocity and inverse inertia are along one vector, and both end at once."""
    rng = np.random.default_rng(2)
    for _ in range(300):
        v = rng.uniform(0.1, 1.0, 3) * [1.0, 0.0, rng.choice([-1.0, 1.0])]
        friction, restitution, speed = rng.uniform([0.05, 0.05, 0.1], [2.0, 1.0, 2.0])
        out = np.empty(8)
        w, u = np.outer(v, v), -speed * v
        assert follow(w, u, friction, restitution, POISSON, 1e-12 * speed, 1e-10, out) == DONE
        normal, tangential = v[0], abs(v[2])
        compression = speed / (normal + friction * tangential)
        # In the restitution the slip is the other way round, or friction holds the point.
        back = min(friction, normal / tangential)
        expected = [1.0 + restitution, 0.0, np.sign(v[2]) * (friction - restitution * back)]
        assert out[:3] == pytest.approx(compression * np.array(expected), rel=1e-9, abs=1e-12)
