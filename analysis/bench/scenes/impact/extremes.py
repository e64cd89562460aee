"""Extreme impacts: restitution 0 and 1, friction 0 and 10, masses of 1e-9, points without number or end."""

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

from bench.cases import Found, check, judged, vanishes
from bench.scenes.impact import bounces
from bench.scenes.impact.paths import point_of
from bench.scenes.impact.study import LAWS, Kind, random_points, random_pose
from bench.scenes.impact.systems import UP, ball, box, chain, cradle, rods, struck
from protochain.core.errors import Fault
from protochain.mechanics.multibody import (
    HingeKind,
    Tree,
    kinetic_energy,
    mass_matrix,
    point_rows,
    pose,
    row_matrix,
)
from protochain.mechanics.multibody.articulated import articulate
from protochain.mechanisms.impacts import ContactPoint, impact
from protochain.mechanisms.impacts.impact import Law

LIGHT = 1e-9
"""kg, against 1 kg."""


def extremes(quick: bool) -> Iterator[Found]:
    """All of them."""
    cases: list[tuple[str, Callable[[], Found], Fault | None]] = []
    for law in LAWS:
        cases += [
            (f"e = 0, rods, {law}", partial(_leaves, law, 0.0, 0.7), None),
            (f"e = 1 without friction, rods, {law}", partial(_keeps, law), None),
            (f"mu = 10, rods, {law}", partial(_grips, law), None),
            (f"a lower rod of 1e-9 kg, {law}", partial(_light_rod, law), None),
            (f"a ball of 1e-9 kg strikes one of 1 kg, {law}", partial(_two_balls, law, LIGHT, 1.0), None),
            (f"a ball of 1 kg strikes one of 1e-9 kg, {law}", partial(_two_balls, law, 1.0, LIGHT), None),
            (f"approach at 1e-9 m/s, slip at 1 m/s, {law}", partial(_grazing, law), None),
        ]
    cases += [
        ("mu = 0, a ball with spin", partial(_spin, 0.0), None),
        ("mu = 10, a ball with spin", partial(_spin, 10.0), None),
        ("four corners at once", partial(_flat, 2, 0.5), None),
        ("100 points at once, without friction", partial(_flat, 10, 0.0), None),
        ("balls of 1e-9 and 1 kg in turn, e = 0", _in_turn_without_end, None),
        ("a chain of 1000 bodies" if not quick else "a chain of 100 bodies", partial(_long, quick), None),
        ("bounces without end, ended by the jump", _ended, None),
        ("bounces without end", _endless, Fault.ENDLESS),
        ("a slide at 45 degrees, mu = 2, poisson", partial(_jammed, "poisson"), None),
        ("a slide at 45 degrees, mu = 2, newton", partial(_jammed, "newton"), Fault.JAMMED),
        ("a piston that drives into the floor", _piston, Fault.IMMOVABLE),
        ("three points that friction jams", _too_rough, Fault.FRICTION),
    ]
    for name, call, refusal in cases:
        yield judged(name, call, refusal)


def _leaves(law: Law, e: float, mu: float) -> Found:
    model, blow = rods(mu, e)
    after, _ = struck(model, [blow], law)
    return vanishes("normal velocity after", after.after[0, 2], 1e-15, "it stays")


def _keeps(law: Law) -> Found:
    model, blow = rods(0.0, 1.0)
    after, before = struck(model, [blow], law)
    return vanishes("change of energy", after.work / before, 1e-14, "none is lost")


def _grips(law: Law) -> Found:
    model, blow = rods(10.0)
    after, _ = struck(model, [blow], law)
    return vanishes("slip after", after.after[0, 0], 1e-14, "it sticks")


def _light_rod(law: Law) -> Found:
    """Change of the energy, from velocities after, against what impulses do."""
    model, blow = rods(0.7, 0.5, LIGHT)
    after, before = struck(model, [blow], law)
    w = point_of(model, blow)[0]
    # W of a double pendulum by hand.
    a, b = np.radians(20.0), np.radians(30.0)
    coupled = 0.5 * LIGHT * np.cos(a - b)
    m = np.array([[1.0 / 3.0 + LIGHT, coupled], [coupled, LIGHT / 3.0]])
    g = np.array([[np.sin(a), np.sin(b)], [-np.cos(a), -np.cos(b)]])
    det = m[0, 0] * m[1, 1] - m[0, 1] * m[1, 0]
    inverse = np.array([[m[1, 1], -m[0, 1]], [-m[1, 0], m[0, 0]]]) / det
    exact = g @ inverse @ g.T
    apart = np.abs(w[:2, :2] - exact).max() / np.abs(exact).max()
    energy = kinetic_energy(model.tree, model.state().frames, after.qd) / before - 1.0 - after.work / before
    return vanishes("W and energy", max(apart, abs(energy)), 1e-12, "double pendulum by hand")


def _two_balls(law: Law, first: float, second: float) -> Found:
    model, blows = cradle((first, second), (1.0, 0.0), 0.5)
    after, _ = struck(model, blows, law)
    return check("second after, m/s", after.qd[1], 1.5 * first / (first + second), 1e-14, "momentum")


def _grazing(law: Law) -> Found:
    model, blow = ball((0.0, 0.0, 0.0), (1.0, 0.0, -1e-9), 0.3, 0.5)
    after, _ = struck(model, [blow], law)
    # A ball slips on; friction takes mu (1 + e) times the speed of approach.
    return check("loss of speed, m/s", 1.0 - after.qd[3], 0.3 * 1.5e-9, 1e-6, "Coulomb")


def _spin(mu: float) -> Found:
    model, blow = ball((0.0, 50.0, 0.0), (0.0, 0.0, -2.0), mu, 0.8)
    after, _ = struck(model, [blow])
    # The lowest point moves towards -x at 5 m/s; gripped, 2/7 of it goes into the motion.
    return check("sideways after, m/s", after.qd[3], 0.0 if mu == 0.0 else 2.0 / 7.0 * 5.0, 1e-14, "by hand")


def _flat(side: int, mu: float) -> Found:
    model, blows = box((0.2, -0.1, 0.0), side, mu)
    after, _ = struck(model, blows)
    expected = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.6])
    worst = float(np.abs(after.qd - expected).max())
    return vanishes("velocities after", worst, 1e-9, "a flat fall goes straight up")


def _in_turn_without_end() -> Found:
    masses = (1.0, LIGHT, LIGHT, 1.0)
    model, blows = cradle(masses, (1.0, 0.0, 0.0, 0.0), 0.0)
    after, _ = struck(model, blows, "stronge", "in turn")
    # Each blow is plastic; without end all would move as one.
    oracle = 1.0 / sum(masses)
    return check("last ball after, m/s", after.qd[-1], oracle, 1e-6, "momentum of all")


def _long(quick: bool) -> Found:
    factors, qd, wall = chain(100 if quick else 1000)
    found = impact(factors, qd, [wall], "poisson")
    rows = point_rows(factors.frames, wall.bodies, np.stack([wall.point, wall.point]))
    g = row_matrix(factors.tree, factors.frames, rows)
    dense = np.linalg.solve(mass_matrix(factors.tree, factors.frames), g.T @ found.impulse[0])
    worst = float(np.abs(found.qd - qd - dense).max() / np.abs(dense).max())
    return vanishes("velocities after", worst, 1e-7, "the mass matrix, as a matrix")


def _ended() -> Found:
    return next(bounces.bounce_checks(*bounces.bounce(bounces.ball(), ends=True)))


def _endless() -> Found:
    bounces.bounce(bounces.ball(), ends=False)
    return check("never", np.nan, 0.0, 0.0, "")


def _slider(driven: bool) -> Tree:
    return Tree(
        np.array([-1]), np.array([HingeKind.PRISMATIC]), np.zeros((1, 3)), np.eye(3)[None], np.ones(1),
        np.zeros((1, 3)), np.zeros((1, 3, 3)), driven=np.array([True]) if driven else None,
    )  # fmt: skip


def _jammed(law: Law) -> Found:
    tree = _slider(driven=False)
    point = ContactPoint("slope", (-1, 0), np.zeros(3), np.array([1.0, 0.0, 1.0]), 2.0, 0.5)
    after = impact(articulate(tree, pose(tree, np.zeros(1))), np.array([-1.0]), [point], law)
    return vanishes("velocity after", after.qd[0], 1e-14, "it sticks and can go nowhere")


def _piston() -> Found:
    tree = _slider(driven=True)
    point = ContactPoint("floor", (-1, 0), np.zeros(3), np.array(UP))
    impact(articulate(tree, pose(tree, np.zeros(1))), np.array([-1.0]), [point])
    return check("never", np.nan, 0.0, 0.0, "")


def _too_rough() -> Found:
    """The first of random plane trees that three points with friction up to 2 jam."""
    rng, kind = np.random.default_rng(0), Kind(True, 3, "poisson", "together", 1.0)
    for _ in range(1000):
        posed = random_pose(True, False, rng)
        qd = rng.normal(size=posed.factors.tree.n_v)
        points = list(random_points(posed, qd, kind.points, kind.points, rng))
        impact(posed.factors, qd, points)
    return check("never", np.nan, 0.0, 0.0, "")
