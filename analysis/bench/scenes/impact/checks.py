"""Impacts against numbers known, closed forms and matrices."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pandas as pd

from bench.cases import Found, check, vanishes
from bench.scenes.impact.study import LAWS, random_points, random_pose
from bench.scenes.impact.systems import ball, cradle, rods, struck
from protochain.core.arrays import Floats
from protochain.mechanics.multibody import mass_matrix, point_rows, row_matrix
from protochain.mechanisms.impacts import close_loops, impact
from protochain.mechanisms.impacts.impact import Order
from protochain.mechanisms.impacts.points import Struck

RODS = {
    0.7: {"newton": 1.5875, "poisson": 0.5169, "stronge": 0.5258},
    0.5: {"newton": 0.7372, "poisson": 0.5451, "stronge": 0.5532},
}
"""Kinetic energy after, relative to that before, by friction and law, restitution 0.5."""


def known() -> Iterator[Found]:
    """Rods, cradles, a ball with spin."""
    yield from _rods()
    yield from _cradles()
    yield from _ball()


def _rods() -> Iterator[Found]:
    for friction, kept in RODS.items():
        model, blow = rods(friction)
        for law in LAWS:
            after, before = struck(model, [blow], law)
            ratio = 1.0 + after.work / before
            name = f"T+/T- of two rods, mu {friction}, {law}"
            yield check(name, ratio, kept[law], 5e-5, "after Kane, Levinson (1985), to 4 digits", "absolute")


def _cradles() -> Iterator[Found]:
    source = "each blow passes (1 + e)/2 on"
    for e in (1.0, 0.8):
        model, blows = cradle((1.0,) * 5, (1.0, 0.0, 0.0, 0.0, 0.0), e)
        after, _ = struck(model, blows, "stronge", "in turn")
        name = f"Newton's cradle, fifth ball, e {e:g}, m/s"
        yield check(name, after.qd[4], (0.5 + 0.5 * e) ** 4, 1e-13, source)
    model, blows = cradle((1.0,) * 5, (1.0, 1.0, 0.0, 0.0, 0.0), 1.0)
    after, _ = struck(model, blows, "stronge", "in turn")
    worst = float(np.abs(after.qd - [0.0, 0.0, 0.0, 1.0, 1.0]).max())
    yield vanishes("Newton's cradle, two balls in, two out, m/s", worst, 1e-13, source)
    model, blows = cradle((1.0,) * 3, (1.0, 0.0, 0.0), 1.0)
    after, _ = struck(model, blows)
    worst = float(np.abs(after.qd - np.array([-1.0, 2.0, 2.0]) / 3.0).max())
    yield vanishes("three balls at once, m/s", worst, 1e-13, "twice the compression")


def cradle_table() -> pd.DataFrame:
    """Velocities of five balls after a blow to the first, one after the other and at once."""
    orders: tuple[Order, Order] = ("in turn", "together")
    rows = []
    for e in (1.0, 0.8, 0.5, 0.0):
        model, blows = cradle((1.0,) * 5, (1.0, 0.0, 0.0, 0.0, 0.0), e)
        for order in orders:
            after, _ = struck(model, blows, "poisson", order)
            rows.append({"e": e, "order": order, **{f"ball {i}": v for i, v in enumerate(after.qd)}})
    return pd.DataFrame(rows)


def _ball() -> Iterator[Found]:
    """A ball with spin: it slips through the impact, or grips."""
    spin, velocity, e = np.array([3.0, 20.0, 6.0]), np.array([0.5, 0.3, -2.0]), 0.6
    slip = velocity[:2] + np.cross(spin, [0.0, 0.0, -0.1])[:2]
    for mu, name in ((0.05, "slips"), (0.5, "grips")):
        model, blow = ball(spin, velocity, mu, e)
        after, _ = struck(model, [blow])
        size = np.linalg.norm(slip)
        expected = velocity[:2] - slip / size * min(mu * 1.6 * 2.0, 2.0 / 7.0 * size)
        worst = float(np.abs(after.qd[3:5] - expected).max())
        yield vanishes(f"a ball with spin {name}, m/s", worst, 1e-13, "Coulomb, by hand")


def random_checks(n: int) -> Iterator[Found]:
    """Random trees against their matrices: W with loops, laws without friction, loops that close."""
    rng = np.random.default_rng(2)
    dense, apart, closed = 0.0, 0.0, 0.0
    for k in range(n):
        posed = random_pose(bool(k % 2), True, rng)
        tree, frames, loops = posed.factors.tree, posed.factors.frames, posed.loops
        assert loops is not None
        m, c = mass_matrix(tree, frames), row_matrix(tree, frames, loops)
        # M^-1 where loops hold, and velocities after a plastic impulse that closes them, from one matrix.
        whole = np.linalg.inv(np.block([[m, c.T], [c, np.zeros((len(c), len(c)))]]))[: len(m)]
        open_ = rng.normal(size=tree.n_v)
        qd = close_loops(posed.factors, open_, loops)
        closed = max(closed, _apart(qd, whole[:, : len(m)] @ m @ open_))
        points = list(random_points(posed, qd, 1, 1, rng))
        of = Struck.of(posed.factors, qd, points, loops)
        rows = point_rows(frames, points[0].bodies, np.stack([points[0].point] * 2))
        g = of.axes[0] @ row_matrix(tree, frames, rows)
        dense = max(dense, float(np.abs(of.w - g @ whole[:, : len(m)] @ g.T).max() / np.abs(g @ g.T).max()))
        found = [impact(posed.factors, qd, [replace(points[0], friction=0.0)], law, loops).qd for law in LAWS]
        apart = max(apart, *(_apart(each, found[0]) for each in found))
    yield vanishes(f"W of {n} points of trees with loops", dense, 1e-9, "the mass matrix")
    yield vanishes(f"loops of {n} trees close", closed, 1e-8, "Karush, Kuhn, Tucker")
    yield vanishes(f"laws of {n} impacts without friction", apart, 1e-9, "they are one")


def _apart(x: Floats, y: Floats) -> float:
    return float(np.abs(x - y).max() / np.abs(y).max())


def gain_checks(gains: pd.DataFrame) -> Iterator[Found]:
    """No law but Newton's ever adds energy."""
    own = {law: gains[(gains["law"] == law) & (gains["points"] == 1)] for law in LAWS}
    for law in ("poisson", "stronge"):
        name = f"{own[law]['impacts'].sum()} impacts of one point that add energy, {law}"
        yield vanishes(name, own[law]["gained"].sum(), 0.0, "none may")
    for order in ("together", "in turn"):
        many = gains[(gains["order"] == order) & (gains["points"] > 1)]
        name = f"{many['impacts'].sum()} impacts of 2 to 4 points {order} that add energy"
        yield vanishes(name, many["gained"].sum(), 0.0, "none may")
    found = own["newton"][own["newton"]["in"] == "plane"]
    share = found["gained"].sum() / found["impacts"].sum()
    yield check("share of plane ones that add energy, newton", share, 0.05, 0.04, "some do", "absolute")
