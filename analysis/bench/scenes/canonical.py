"""Chains of links that bend by assumed modes: Hamilton's equations against accelerations.

After Tong, J. Comput. Nonlinear Dyn. 5:041002 (2010), whose text was not found. What is known of it from
others, and where it is:

=====================================  ============================================================
velocities from momenta, by recursion  ``mechanisms.flexible``: articulated bodies, O(n)
other ways beside it                   amplitudes first, in blocks; the whole matrix
bodies that bend by shapes             ``mechanisms.flexible``, with what stiffens a beam that turns
=====================================  ============================================================

Chosen are links of 1 m and 1 kg in a plane, hinged end to end, EI 3 N m^2, two shapes of bending each; the
first hinge is free: nothing depends on its angle, and its momentum is the whole chain's spin. Left out:
loops, whose rows the recursion does not have, and dampers, which momenta alone do not tell of; ``bending``
refuses both. Its system is stepped by hand: ``Run`` and ``view``, which are of rigid bodies, are left out.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd
from scipy.integrate import solve_ivp

from bench.cases import Found, Point, Scene, check, judged, left_out, tried, vanishes
from bench.cost import timed
from bench.fits import exponent
from protochain.core.arrays import Floats
from protochain.core.errors import Fault, MechanicsError
from protochain.mechanics.motion import DormandPrince
from protochain.mechanics.multibody import HingeKind, Tree
from protochain.mechanisms.assumed import assumed_modes
from protochain.mechanisms.bending import BendingSystem
from protochain.mechanisms.flexible.dynamics import (
    Route,
    canonical_rates,
    forward_dynamics,
    multiply_mass,
    rates_of,
)
from protochain.mechanisms.flexible.flexible import Flexible, bend, elastic
from protochain.mechanisms.segments import Beam

STIFFNESS = 3.0
ROUTES: tuple[Route, ...] = ("articulated", "blocks", "dense")
EPS = float(np.finfo(float).eps)
Rates = Callable[[float, Floats], Floats]
"""Time, state -> its rate: states are (q, qd) or (q, p)."""


def chain(n: int, shapes: int = 2, stiffness: float = STIFFNESS, flap: int = 0, tip: float = 0.0) -> Flexible:
    """Build a chain."""
    link = assumed_modes(Beam(1.0, 1.0, stiffness), flap=flap, lag=shapes)
    ball = 1 if tip else 0
    kinds = [HingeKind.REVOLUTE] * n + [HingeKind.FIXED] * ball
    size = np.append(np.full(n, 1.0 / 12.0), [0.01 * tip] * ball)
    tree = Tree(
        np.arange(-1, n - 1 + ball), np.array(kinds),
        np.tile([1.0, 0.0, 0.0], (n + ball, 1)) * (np.arange(n + ball) > 0)[:, None],
        np.tile(np.eye(3), (n + ball, 1, 1)), np.append(np.ones(n), [tip] * ball),
        np.tile([0.5, 0.0, 0.0], (n + ball, 1)) * (np.arange(n + ball) < n)[:, None],
        size[:, None, None] * np.eye(3),
    )  # fmt: skip
    section = np.append(-1, np.full(n - 1 + ball, len(link.place) - 1))
    return Flexible(tree, (*[link] * n, *[None] * ball), section)


def started(flexible: Flexible, seed: int = 0, quick: float = 1.0) -> tuple[Floats, Floats]:
    """Coordinates and velocities at the start: hinges at up to half a radian, links straight."""
    rng, n = np.random.default_rng(seed), flexible.tree.n_v
    q, qd = np.zeros(flexible.n_q), np.zeros(flexible.n_v)
    q[:n], qd[:n] = rng.uniform(-0.5, 0.5, n), quick * rng.uniform(-1.0, 1.0, n)
    return q, qd


def accelerated(flexible: Flexible) -> Rates:
    """Equations of motion of (q, qd)."""
    n = flexible.n_v

    def rates(t: float, y: Floats) -> Floats:
        tau = elastic(flexible, y[:n])[1]
        return np.concatenate([y[n:], forward_dynamics(flexible, y[:n], y[n:], tau)])

    return rates


def canonical(flexible: Flexible, route: Route = "articulated") -> Rates:
    """Hamilton's equations, of (q, p)."""
    n = flexible.n_v

    def rates(t: float, y: Floats) -> Floats:
        return np.concatenate(canonical_rates(flexible, y[:n], y[n:], elastic(flexible, y[:n])[1], route))

    return rates


def by_hand(flexible: Flexible) -> Rates:
    """Equations of (q, qd) of two links in a plane with one shape each, from sections in the complex plane.

    A section of a link is at z = z0 + w exp(i angle), with w = x - S eta^2 / 2 + i phi eta.
    """
    links = [
        (s.mass, s.place[:, 0], s.moves[:, 1, 0], s.shortening[:, 0, 0, 0]) for s in flexible.shapes if s
    ]
    slope = flexible.sections.turns[flexible.links[1, 0], 2, 0]
    springs = np.array([0.0, 0.0, *(s.stiffness[0, 0] for s in flexible.shapes if s)])

    def rates(t: float, y: Floats) -> Floats:
        (a, b, *eta), (da, db, *deta) = y[:4], y[4:]
        m, load = np.zeros((4, 4)), -springs * y[:4]
        columns, quick = np.zeros(4, complex), 0.0j
        angle, spin, turning = a, da, np.array([1.0, 0.0, 0.0, 0.0])
        for k, (mass, x, phi, short) in enumerate(links):
            e, rate = eta[k], deta[k]
            along = 1j * phi - short * e
            w, turn = x - 0.5 * short * e**2 + 1j * phi * e, np.exp(1j * angle)
            j = columns + (1j * w * turn)[:, None] * turning
            j[:, 2 + k] += along * turn
            acceleration = quick + turn * (-short * rate**2 + 2j * spin * along * rate - spin**2 * w)
            m += np.einsum("n,nk,nl->kl", mass, j.conj(), j).real
            load -= np.einsum("n,nk,n->k", mass, j.conj(), acceleration).real
            columns, quick = j[-1], acceleration[-1]
            # The second link rides on the slope of the first one's tip.
            turning = turning + np.array([0.0, 1.0, slope, 0.0])
            angle, spin = a + b + slope * eta[0], da + db + slope * deta[0]
        return np.concatenate([y[4:], np.linalg.solve(m, load)])

    return rates


def end_of(rates: Rates, start: Floats, until: float, tolerance: float) -> Floats:
    """State at a time, by DOP853 (scipy)."""

    def tried(t: float, y: Floats) -> Floats:
        try:
            return rates(t, y)
        except MechanicsError:
            # A step that is too long may lead anywhere; a shorter one is tried then.
            return np.full_like(y, np.nan)

    found = solve_ivp(tried, (0.0, until), start, "DOP853", rtol=tolerance, atol=0.1 * tolerance)
    return np.asarray(found.y[:, -1])


def run(quick: bool = False) -> Scene:
    """Run the scene; quick: chains of up to 30 links for a moment: some seconds."""
    sizes = (3, 30) if quick else (3, 10, 30, 100, 300)
    costs = _costs(sizes)
    return Scene(
        "canonical", "links that bend: momenta against accelerations, and three ways from momenta to rates",
        (*_motion(0.2 if quick else 0.5), *_agreement(costs, sizes)), _work(0.1 if quick else 0.5),
        tuple(_extremes(quick)), tuple(_left_out(3 if quick else 30)), {"costs": costs},
        "error of the coordinates",
    )  # fmt: skip


def _motion(until: float) -> Iterator[Found]:
    two = chain(2, 1)
    q, qd = started(two, 1, 3.0)
    start = np.concatenate([q, qd])
    exact = end_of(by_hand(two), start, until, 1e-12)
    p = multiply_mass(two, bend(two, q), qd)
    found = end_of(canonical(two), np.concatenate([q, p]), until, 1e-12)
    rates = rates_of(two, bend(two, found[:4]), found[4:])
    other = end_of(accelerated(two), start, until, 1e-12)
    source = "equations by hand, DOP853 at 1e-12"
    for label, state in (("momenta", np.append(found[:4], rates)), ("accelerations", other)):
        off = float(np.abs(state - exact).max())
        yield vanishes(f"two links by {label}: q and qd", off, 1e-8, source)
    ten = chain(10)
    q, qd = started(ten)
    p = multiply_mass(ten, bend(ten, q), qd)
    found = end_of(canonical(ten), np.concatenate([q, p]), 0.5 * until, 1e-9)
    n = ten.n_v
    spun = float(np.abs(found[n] - p[0]) / np.abs(p).max())
    yield vanishes("momentum of the free hinge, ten links", spun, 1e-13, "it is cyclic")
    bent = bend(ten, found[:n])
    kinetic = 0.5 * float(found[n:] @ rates_of(ten, bent, found[n:]))
    total = kinetic + elastic(ten, found[:n])[0]
    yield check("energy by momenta, ten links", total, 0.5 * float(p @ qd), 1e-8, "the start")
    system = BendingSystem(ten.tree, lambda q, bent: (0.0, np.zeros(n)), flexible=ten)
    at = first = system.at(q, qd)
    for _ in range(5):
        at = DormandPrince(1e-10).step(system, at, 0.1 * until)
    yield check("energy by motion's integrators, ten links", at.total, first.total, 1e-8, "the start")


def _costs(sizes: tuple[int, ...]) -> pd.DataFrame:
    """Seconds of each way to rates, and its error, M x - p over the size of M and x, in eps."""
    rows: list[tuple[int, str, float, float]] = []
    for n in sizes:
        flexible = chain(n)
        q, qd = started(flexible)
        bent = bend(flexible, q)
        p = multiply_mass(flexible, bent, qd)
        for route in ROUTES:
            found, seconds = timed(
                partial(rates_of, flexible, bent, p, route), 1 if n > 100 and route != "articulated" else 5
            )
            lack = np.abs(multiply_mass(flexible, bent, found) - p).max()
            # The size of M is that of its largest entry: the chain's inertia about the first hinge.
            unit = np.eye(1, flexible.n_v)[0]
            size = np.abs(multiply_mass(flexible, bent, unit)).max() * np.abs(found).max()
            rows.append((n, route, seconds, lack / size / EPS))
        for label, rates, other in (
            ("accelerations, all", accelerated(flexible), qd), ("momenta, all", canonical(flexible), p)
        ):  # fmt: skip
            _, seconds = timed(partial(rates, 0.0, np.concatenate([q, other])), 3)
            rows.append((n, label, seconds, np.nan))
    return pd.DataFrame(rows, columns=["links", "route", "seconds", "error_eps"])


def _agreement(costs: pd.DataFrame, sizes: tuple[int, ...]) -> Iterator[Found]:
    for route in ROUTES:
        worst = float(costs.loc[costs["route"] == route, "error_eps"].max())
        name = f"rates of momenta, {route}: backward error in eps, up to {sizes[-1]} links"
        yield vanishes(name, worst, 100.0, "M x by Newton and Euler")
    if len(sizes) > 2:
        own = costs[(costs["route"] == "articulated") & (costs["links"] >= 30)]
        grown = exponent(own["links"], own["seconds"])
        yield check("seconds, leaf to root, as a power of the links", grown, 1.0, 0.25, "O(n)", "absolute")


def _work(until: float) -> list[Point]:
    flexible = chain(3)
    q, qd = started(flexible)
    n = flexible.n_v
    p = multiply_mass(flexible, bend(flexible, q), qd)
    exact = end_of(accelerated(flexible), np.concatenate([q, qd]), until, 1e-13)[:n]
    forms = {"accelerations": (accelerated(flexible), qd)}
    forms |= {f"momenta, {route}": (canonical(flexible, route), p) for route in ROUTES}
    rows = []
    for label, (rates, other) in forms.items():
        for tolerance in (1e-4, 1e-6, 1e-8, 1e-10):
            end = partial(end_of, rates, np.concatenate([q, other]), until, tolerance)
            rows.append(tried(label, f"{tolerance:g}", end, lambda at: np.abs(at[:n] - exact).max()))
    return rows


def _both(flexible: Flexible, until: float, bound: float, quick: float = 1.0) -> Found:
    """Both forms against each other."""
    q, qd = started(flexible, quick=quick)
    n = flexible.n_v
    p = multiply_mass(flexible, bend(flexible, q), qd)
    ends = [
        end_of(rates, np.concatenate([q, other]), until, 1e-10)[:n]
        for rates, other in ((accelerated(flexible), qd), (canonical(flexible), p))
    ]
    off = float(np.abs(ends[0] - ends[1]).max())
    return vanishes("q", off, bound, "accelerations against momenta")


def _rigid(factor: float) -> Found:
    """Links so stiff that they are rigid, for a moment, against hinges alone."""
    off = []
    for flexible in (chain(2, 1, factor * STIFFNESS), chain(2, 0)):
        q, qd = started(flexible)
        off.append(end_of(accelerated(flexible), np.concatenate([q, qd]), 0.02, 1e-10)[:2])
    error = float(np.abs(off[0] - off[1]).max())
    return vanishes("angles", error, 10.0 / factor, "rigid links")


def _driven() -> Found:
    flexible = chain(2, 1)
    held = replace(flexible, tree=replace(flexible.tree, driven=np.array([True, False])))
    rates_of(held, bend(flexible, np.zeros(4)), np.zeros(4))
    return check("rates", 1.0, 0.0, 0.0, "a refusal")


def _extremes(quick: bool) -> Iterator[Found]:
    yield judged("EI a thousandth", partial(_both, chain(3, 2, 1e-3 * STIFFNESS), 0.1, 1e-7))
    for factor in (1e3,) if quick else (1e3, 1e6):
        yield judged(f"EI times {factor:g}", partial(_rigid, factor))
    yield judged(
        "a million times the links' mass at the end", partial(_both, chain(2, 1, tip=1e6), 0.1, 1e-6)
    )
    yield judged("a rate of 50 rad/s", partial(_both, chain(2, 1), 0.02, 1e-7, 50.0))
    yield judged("at rest", partial(_both, chain(3), 0.1, 1e-14, 0.0))
    if not quick:
        yield judged("300 links", partial(_both, chain(300, 1), 0.005, 1e-7))
    yield judged("a driven hinge", _driven, Fault.DRIVEN)


def _left_out(n: int) -> Iterator[Found]:
    """Shapes out of the plane, which nothing excites."""

    def angles(flap: int) -> Floats:
        flexible = chain(n, 2, flap=flap)
        q, qd = started(flexible)
        p = multiply_mass(flexible, bend(flexible, q), qd)
        return end_of(canonical(flexible), np.concatenate([q, p]), 0.05, 1e-9)[:n]

    yield left_out("shapes out of the plane", partial(angles, 2), partial(angles, 0), 1e-9, 2)
