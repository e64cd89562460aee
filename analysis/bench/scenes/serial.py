"""Serial chains of revolute hinges: M^-1 by three routes, long, light, thin and straight.

After Lee, Wang, Chirikjian, Robotica 25:739 (2007), of which the abstract was read. What it says, and where
it is:

=========================================  ==============================================================
M^-1 of serial arms in O(n), after Fixman  ``multibody.fixman``: by locked directions, on any tree
recursions beside it                       ``multibody.articulated``; dense matrices
polypeptide chains                         not here, but in ``bench stability``, whose extremes these are
=========================================  ==============================================================

Left out: its own arms, which are not known; random and extreme chains take their place.
"""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd
from scipy.linalg import eigh
from scipy.special import jn_zeros

from bench.cases import Found, Point, Scene, check, left_out, vanishes
from bench.cost import timed
from bench.fits import exponent
from bench.studies.precision import solvers as precise
from bench.studies.precision.extended import DIGITS, wide_mass
from bench.studies.stability.cells import Part, cases_of, run_case
from bench.studies.stability.solvers import ROUTES
from protochain.core.arrays import Floats
from protochain.mechanics.motion import DormandPrince, System
from protochain.mechanics.multibody import (
    Frames,
    HingeKind,
    Tree,
    forward_dynamics,
    inverse_dynamics,
    log_det_mass,
    mass_matrix,
    pose,
    pull_back,
    solve_mass,
)  # fmt: skip
from protochain.mechanics.multibody.articulated import Articulated, articulate, solve

GRAVITY = np.array([0.0, -9.81, 0.0])
SERIAL = (
    "chain", "root, positions", "mass ratio, tip", "bodies almost lines", "bodies almost points",
    "body near its axis", "hinges almost parallel", "chain nearly straight", "angles at 0 and pi",
)  # fmt: skip
"""Cases of ``bench stability`` whose trees are serial."""
MOST_BODIES = 100_000
"""Of the chains here; the grid of ``bench stability`` goes to a million."""
BY_HAND = "two uniform rods released from the horizontal, by hand"


def rods(n: int, length: float, mass: float = 1.0) -> Tree:
    """Make a chain of n uniform thin rods of a length and mass together, along x, turning about z."""
    own = length / n
    offset = np.zeros((n, 3))
    offset[1:, 0] = own
    inertia = np.zeros((n, 3, 3))
    inertia[:, 1, 1] = inertia[:, 2, 2] = mass / n * own**2 / 12.0
    return Tree(
        np.arange(-1, n - 1), np.full(n, HingeKind.REVOLUTE), offset, np.tile(np.eye(3), (n, 1, 1)),
        np.full(n, mass / n), np.tile([0.5 * own, 0.0, 0.0], (n, 1)), inertia,
    )  # fmt: skip


def weight(tree: Tree, frames: Frames) -> tuple[float, Floats]:
    """Potential energy of gravity and its torques (n_v,)."""
    arms = np.einsum("bij,bj->bi", frames.rotation, tree.com)
    force = tree.mass[:, None] * GRAVITY
    wrenches = np.concatenate([np.cross(arms, force), force], axis=1)
    return -float(np.sum((frames.origin + arms) * force)), pull_back(tree, frames, wrenches)


def run(quick: bool = False) -> Scene:
    """Run the scene; quick: short chains only: some seconds."""
    points = list(precise.measure(quick))
    sizes = [n for n in (10, 100, 1000, 10_000, MOST_BODIES) if n <= 1000 or not quick]
    lengths, determinants = _lengths(sizes), _determinants((10, 30) if quick else (10, 30, 100, 300))
    return Scene(
        "serial", "serial chains of revolute hinges: x = M^-1 tau",
        tuple(_checks(10 if quick else 20, determinants)), _work(points), tuple(_extremes(quick)),
        tuple(_left_out(100 if quick else 1000)),
        {"lengths": lengths, "exponents": _exponents(lengths), "determinants": determinants},
        "relative error of x",
    )  # fmt: skip


def _checks(n: int, determinants: pd.DataFrame) -> Iterator[Found]:
    two = rods(2, 2.0, 2.0)
    frames = pose(two, np.zeros(2))
    first, second = solve_mass(two, frames, weight(two, frames)[1])
    unit = -GRAVITY[1] / 7.0
    yield check("upper rod of two, rad/s^2", first, -9.0 * unit, 1e-14, BY_HAND)
    yield check("lower rod of two, rad/s^2", first + second, 3.0 * unit, 1e-14, BY_HAND)
    coarse, fine = _frequencies(n), _frequencies(2 * n)
    exact = 0.5 * jn_zeros(0, 3) * np.sqrt(-GRAVITY[1])
    source = "hanging chain: zeros of Bessel's J0"
    order = float(np.log2((coarse[0] - exact[0]) / (fine[0] - exact[0])))
    yield check(f"order of the frequency, {n} to {2 * n} rods", order, 2.0, 2.0 / n**2, source, "absolute")
    # The next term is 1/n^4, and its factor grows with the fourth power of the mode.
    for k, factor in enumerate((0.03, 6.0, 90.0)):
        value = (4.0 * fine[k] - coarse[k]) / 3.0
        yield check(f"frequency {k + 1} for n to infinity, rad/s", value, exact[k], factor / n**4, source)
    yield _energy(n)
    yield _round_trip(10 * n)
    last = determinants.iloc[-1]
    for route in ("articulated", "Fixman"):
        name = f"ln det M of {last['bodies']:.0f} random bodies, {route}: error"
        yield vanishes(name, last[route], 1e-11, f"dense M in extended precision ({DIGITS})")


def _frequencies(n: int) -> Floats:
    """Three lowest frequencies of a hanging chain of 1 m, in n rods."""
    tree, q, h = rods(n, 1.0), np.zeros(n), 1e-5
    q[0] = -0.5 * np.pi
    ends = [[weight(tree, pose(tree, q + sign * h * one))[1] for one in np.eye(n)] for sign in (-1.0, 1.0)]
    stiffness = np.subtract(ends[0], ends[1]) / (2.0 * h)
    mass = mass_matrix(tree, pose(tree, q))
    return np.sqrt(eigh(0.5 * (stiffness + stiffness.T), mass, eigvals_only=True)[:3])


def _energy(n: int) -> Found:
    """Largest change of the energy of a chain that falls from the horizontal for half a second."""
    tree = rods(n, 1.0)

    def potential(q: Floats, factors: Articulated) -> tuple[float, Floats]:
        return weight(tree, factors.frames)

    system, integrator = System(tree, potential), DormandPrince(1e-10)
    at = integrator.init(system, np.zeros(n), np.zeros(n))
    start, drift, size = at.total, 0.0, 0.0
    for _ in range(10):
        at = integrator.step(system, at, 0.05)
        drift, size = max(drift, abs(at.total - start)), max(size, at.kinetic)
    name = f"change of energy, {n} rods fall, of the kinetic energy"
    return vanishes(name, drift / size, 1e-8, "the start")


def _round_trip(n: int) -> Found:
    tree, _, tau = precise.posed(n, HingeKind.REVOLUTE)
    rng = np.random.default_rng(n)
    q, qd = rng.uniform(-3, 3, tree.n_q), rng.normal(size=tree.n_v)
    back = inverse_dynamics(tree, q, qd, forward_dynamics(tree, q, qd, tau))
    # Relative to the torques of the motion, against which those given are small.
    bias = float(np.linalg.norm(inverse_dynamics(tree, q, qd, np.zeros(tree.n_v))))
    error = float(np.linalg.norm(back - tau)) / (bias + float(np.linalg.norm(tau)))
    name = f"torques to accelerations and back, {n} random bodies"
    return vanishes(name, error, 1e-12, "Newton-Euler")


def _determinants(sizes: tuple[int, ...]) -> pd.DataFrame:
    """Logarithm of det M by dense M in extended precision; errors of three routes in double."""
    rows = []
    for n in sizes:
        tree, frames, _ = precise.posed(n, HingeKind.REVOLUTE)
        exact = wide_mass(tree, frames).log_det
        found = {
            "articulated": log_det_mass(tree, frames), "Fixman": log_det_mass(tree, frames, "fixman"),
            "dense Cholesky": np.linalg.slogdet(mass_matrix(tree, frames))[1],
        }  # fmt: skip
        errors = {route: float(value - exact) for route, value in found.items()}
        rows.append({"bodies": n, "ln_det": float(exact), **errors})
    return pd.DataFrame(rows)


def _work(points: list[Point]) -> list[Point]:
    """Points of the longest chain that is compared in extended precision."""
    case = [point.case for point in points if point.case != "long chains"][-1]
    return [replace(each, setting=each.setting or case) for each in points if each.case == case]


def _lengths(sizes: list[int]) -> pd.DataFrame:
    """Seconds and backward error of every route by the number of bodies."""
    rows = []
    for n in sizes:
        tree, frames, tau = precise.posed(n, HingeKind.REVOLUTE)
        for name, route in ROUTES.items():
            if name == "dense Cholesky" and n > 1000:
                continue
            call = partial(route, tree, frames, tau)
            x, seconds = timed(call, 20 if n < 10_000 else 3)
            row = {"bodies": n, "route": name, "seconds": seconds}
            rows.append({**row, "backward_error_eps": precise.backward_error(tree, frames, x, tau)})
    return pd.DataFrame(rows)


def _exponents(lengths: pd.DataFrame) -> pd.DataFrame:
    """Exponents of the cost, from 100 bodies on: what a call costs by itself hides that of a few."""
    long = lengths[lengths["bodies"] >= 100]
    rows = [
        (name, exponent(own["bodies"], own["seconds"])) for name, own in long.groupby("route", sort=False)
    ]
    return pd.DataFrame(rows, columns=["route", "exponent"])


def _extremes(quick: bool) -> Iterator[Found]:
    """Cases of ``bench stability`` with serial trees."""
    for _, case in cases_of("mechanics", Part.QUICK if quick else Part.FULL):
        dear = case.name in ("chain", "root, positions") and case.part > Part.TESTED
        if case.name not in SERIAL or case.parameters.startswith("1000000 ") or (quick and dear):
            continue
        yield replace(run_case("mechanics", case), name=f"{case.name}: {case.parameters}")


def _left_out(n: int) -> Iterator[Found]:
    """What M^-1 tau does without, with the bounds of ``bench stability``: errors by eps and the condition."""
    tree, frames, tau = precise.posed(n, HingeKind.REVOLUTE)
    mass = mass_matrix(tree, frames)
    bound = 100.0 * float(np.finfo(float).eps * np.linalg.cond(mass))
    less = partial(solve_mass, tree, frames, tau)
    name = f"the mass matrix of {n} bodies, as a matrix"
    yield left_out(name, partial(precise.dense, tree, frames, tau), less, bound)
    factors = articulate(tree, frames)
    name = f"factors of {n} bodies, for a second right side"
    yield left_out(name, lambda: solve(articulate(tree, frames), tau), lambda: solve(factors, tau), 0.0, 20)
