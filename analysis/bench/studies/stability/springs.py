"""Stiff springs: the largest stable step of each integrator, and where an implicit one pays.

A tripeptide's hinges are springs: stiff ones on omega or on bond angles, soft ones on the others. Its normal
modes about the minimum are those of the generalised eigenproblem K v = w^2 M v.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from time import process_time

import numpy as np
from scipy.linalg import eigh

from bench.cases import Found
from bench.studies.stability.cells import Case, Part, case
from protochain.chains.articulate import build_chain
from protochain.core.arrays import Floats
from protochain.dynamics import (
    DormandPrince,
    ImplicitMidpoint,
    Leapfrog,
    RungeKutta4,
    StepTooLargeError,
    System,
)  # fmt: skip
from protochain.mechanics.motion.lobatto import drift as lobatto_drift
from protochain.mechanics.motion.system import Integrator
from protochain.mechanics.multibody import mass_matrix, pose
from protochain.mechanics.multibody.articulated import Articulated
from protochain.structure import from_sequence

SOFT = 10.0
"""kJ/mol/rad^2, springs of the other hinges."""
INTEGRATORS: dict[str, tuple[Integrator, float]] = {
    "leapfrog": (Leapfrog(), 2.0),
    "lobatto": (Leapfrog(lobatto_drift), 2.0),
    "rk4": (RungeKutta4(), 2.0 * np.sqrt(2.0)),
}
"""Integrator, and the largest stable step times w: of the leapfrog 2 (Hairer, Lubich, Wanner, 2006, I.5), of
Kutta's method the end of its stability region on the imaginary axis (Hairer, Wanner, 1996, IV.2)."""
OFF = 0.05
"""The issue of the stable step is settled within this: both sides of it are tried."""


@dataclass(frozen=True, eq=False)
class Springs:
    """A tree of springs with its modes."""

    system: System
    q0: Floats
    stiffness: Floats
    stiff: np.ndarray
    frequencies: Floats
    modes: Floats

    @property
    def slow(self) -> float:
        """Largest frequency without the stiff springs' modes, 1/ps."""
        return float(self.frequencies[-1 - self.stiff.sum()])


@cache
def springs(kind: str, k: float, free: bool) -> Springs:
    """Tripeptide with stiff springs k (kJ/mol/rad^2) on hinges of a kind, and a fixed or free root."""
    opened = "phi psi omega" if kind == "omega" else "phi psi angles"
    chain = build_chain(from_sequence("AAA"), opened, "free" if free else "fixed")
    tree, q0 = chain.tree, chain.q0
    stiff = np.array([hinge.kind == "omega" or hinge.is_angle for hinge in chain.hinges])
    at_v, at_q = tree.v_start[chain.hinge_body], tree.q_start[chain.hinge_body]
    along = np.zeros(tree.n_v)
    along[at_v] = np.where(stiff, k, SOFT)

    def potential(q: Floats, factors: Articulated) -> tuple[float, Floats]:
        torque = np.zeros(tree.n_v)
        torque[at_v] = -along[at_v] * (q[at_q] - q0[at_q])
        return 0.5 * float(torque[at_v] ** 2 @ (1.0 / along[at_v])), torque

    squares, modes = eigh(np.diag(along), mass_matrix(tree, pose(tree, q0)))
    frequencies = np.sqrt(np.maximum(squares, 0.0))
    return Springs(System(tree, potential), q0, along, stiff, frequencies, modes)


def _is_stable(of: Springs, integrator: Integrator, h: float, steps: int = 200) -> bool:
    """Whether a small motion along the stiffest mode stays small."""
    # Small enough that M is constant, and large against rounding.
    qd = 1e-6 * of.modes[:, -1] / np.abs(of.modes[:, -1]).max() * of.frequencies[-1]
    at = integrator.init(of.system, of.q0, qd)
    start = at.total
    try:
        for _ in range(steps):
            at = integrator.step(of.system, at, h)
            if not at.total < 1e3 * start:
                return False
    except StepTooLargeError:
        return False
    # Near the limit the leapfrog's energy oscillates by 1 / (1 - (h w / 2)^2), a hundredfold at 0.995 of it.
    return bool(at.total < 1e3 * start)


def stable_step(name: str, kind: str, k: float, free: bool) -> Found:
    """Largest stable step, found by bisection, against theory on the generalised eigenproblem."""
    of = springs(kind, k, free)
    integrator, limit = INTEGRATORS[name]
    expected = limit / of.frequencies[-1]
    low, high = 0.5, 2.0
    for _ in range(9):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _is_stable(of, integrator, middle * expected) else (low, middle)
    note = f"{1e3 * low * expected:.4g} fs found, {1e3 * expected:.4g} fs expected"
    return Found(abs(low - 1.0), OFF, f"{limit:.3g} / w_max of K v = w^2 M v", note)


def unconditionally(kind: str, k: float, free: bool, times: float) -> Found:
    """Energy of the implicit midpoint rule at a step far above the explicit limit."""
    of = springs(kind, k, free)
    qd = 1e-6 * of.modes[:, -1] / np.abs(of.modes[:, -1]).max() * of.frequencies[-1]
    integrator = ImplicitMidpoint()
    at = integrator.init(of.system, of.q0, qd)
    start = at.total
    for _ in range(50):
        at = integrator.step(of.system, at, times * 2.0 / of.frequencies[-1])
    # Quadratic invariants are kept (Hairer, Lubich, Wanner, 2006, IV.2), but for the change of M by motion of
    # each hinge, 1e-6 rad, and for steps solved to 1e-10 of a velocity, at least of 1e-10 rad/ps: an
    # error of position is h times that, and w h is 2 times.
    fastest = float(np.abs(qd).max())
    left = 1e-10 * max(1.0, fastest) / fastest
    bound = sum(_changed(of, k, 1e-6) for k in of.system.tree.hinge_bodies) + 50 * 2 * left * (1 + 2 * times)
    return Found(abs(at.total / start - 1.0), bound, "its own start: a quadratic energy is kept")


def _changed(of: Springs, body: int, turn: float) -> float:
    """Largest relative change of a kinetic energy by a turn of one hinge."""
    tree, q = of.system.tree, of.q0.copy()
    q[tree.q_start[body]] += turn
    masses = [mass_matrix(tree, pose(tree, each)) for each in (q, of.q0)]
    return float(np.abs(eigh(*masses, eigvals_only=True) - 1.0).max())


def order(name: str, kind: str, k: float) -> Found:
    """Order of an integrator: error of the end for a step and for half of it, against Dormand-Prince."""
    of = springs(kind, k, False)
    integrator = ImplicitMidpoint() if name == "midpoint" else INTEGRATORS[name][0]
    qd = 0.1 * of.modes[:, -1] / np.abs(of.modes[:, -1]).max() * of.frequencies[-1]
    h = 0.1 / of.frequencies[-1]
    reference = DormandPrince(1e-12)
    expected = reference.step(of.system, reference.init(of.system, of.q0, qd), 20 * h).q
    errors = []
    for parts in (1, 2):
        at = integrator.init(of.system, of.q0, qd)
        for _ in range(20 * parts):
            at = integrator.step(of.system, at, h / parts)
        errors.append(float(np.abs(at.q - expected).max()))
    p = 4 if name == "rk4" else 2
    # The next term of the error is h w = 0.1 smaller, or its square for symmetric methods.
    return Found(abs(np.log2(errors[0] / errors[1]) - p), 0.2, f"order {p}; Dormand-Prince at 1e-12")


AMPLITUDE, SHARE = 0.05, 0.05
"""rad of the soft hinges at the start, and the error of their motion that is allowed, relative to it."""
PHASE = 4.5 * np.pi
"""rad of the motion: it ends in the middle of a swing, where an error of phase is one of place."""
ACCURATE = float(np.sqrt(12.0 * SHARE / PHASE))
"""Step times frequency of the midpoint rule for this error: its frequency is off by (w h)^2 / 12."""


def _pull(of: Springs) -> tuple[Floats, float]:
    """Coordinates off the minimum along the fastest slow mode, and the time until its phase is ``PHASE``."""
    mode = of.modes[:, -1 - of.stiff.sum()]
    return of.q0 + AMPLITUDE * mode / np.abs(mode).max(), PHASE / of.slow


def _error(of: Springs, integrator: Integrator, h: float, expected: Floats) -> tuple[float, float]:
    """Relative error of the soft hinges at the end, and the CPU seconds a step took at least."""
    q, time = _pull(of)
    n = max(1, round(time / h))
    at = integrator.init(of.system, q, np.zeros_like(q))
    least = np.inf
    try:
        for _ in range(n):
            began = process_time()
            at = integrator.step(of.system, at, time / n)
            least = min(least, process_time() - began)
    except StepTooLargeError:
        return np.inf, least
    error = np.abs(at.q - expected)[~of.stiff].max() / AMPLITUDE
    return float(error if np.isfinite(error) else np.inf), least


@cache
def _measured(kind: str, k: float) -> tuple[float, float, float, float]:
    """Seconds that the explicit and the implicit method need, and a step of each, for the error allowed."""
    of = springs(kind, k, False)
    q, time = _pull(of)
    reference = DormandPrince(1e-9)
    expected = reference.step(of.system, reference.init(of.system, q, np.zeros_like(q)), time).q
    found = []
    for integrator, start in ((Leapfrog(), 1.8 / of.frequencies[-1]), (ImplicitMidpoint(), 1.0 / of.slow)):
        h = min(start, 1.0 / of.slow)
        error, step = _error(of, integrator, h, expected)
        while error > SHARE:
            h /= 1.1
            error, again = _error(of, integrator, h, expected)
            step = min(step, again)
        found.append((step * time / h, step))
    return found[0][0], found[1][0], found[0][1], found[1][1]


RISING = (1e3, 1e4, 1e5, 1e6, 1e7)
STIFFEST = 1e8
"""kJ/mol/rad^2."""


def crossover(kind: str) -> Found:
    """Ratio of frequencies from which the implicit rule is the cheaper for the same error, against theory.

    The explicit method must take w_max h < 2, the implicit one is limited by its error: w h < ``ACCURATE``.
    """
    ratios, gains, costs = [], [], []
    # Beyond the crossover by a factor of three at the least, however quick a step is.
    for k in (*RISING, STIFFEST):
        of = springs(kind, k, False)
        explicit, implicit, step, dear = _measured(kind, k)
        ratios.append(of.frequencies[-1] / of.slow)
        gains.append(np.log(explicit / implicit))
        costs.append(dear / step)
    found = float(np.exp(np.interp(0.0, gains, np.log(ratios), left=np.nan, right=np.nan)))
    # The implicit step's cost rises with stiffness: that at the crossover.
    cost = float(np.exp(np.interp(np.log(found), np.log(ratios), np.log(costs))))
    expected = 1.8 * cost / ACCURATE
    note = f"w_max / w of {found:.3g} found, {expected:.3g} expected; a step costs {cost:.3g} times as much"
    # Errors of neighbouring modes, and steps tried by factors of 1.1: within a factor of two.
    return Found(abs(np.log2(found / expected)), 1.0, "theory of both errors and measured costs", note)


def winner(kind: str, k: float) -> Found:
    """Whether the cheaper method for the same error is the one that theory says, away from the crossover."""
    of = springs(kind, k, False)
    explicit, implicit, step, dear = _measured(kind, k)
    limit = ACCURATE / of.slow
    expected = (dear / limit) / (step / min(1.8 / of.frequencies[-1], np.sqrt(2.0) * limit))
    found = implicit / explicit
    note = f"implicit costs {found:.3g} times as much, {expected:.3g} expected"
    # Each is within a factor of two of its theory.
    return Found(abs(np.log2(found / expected)), 2.0, "theory of both errors and measured costs", note)


def equal_cost(kind: str, k: float) -> Found:
    """Which method has the smaller error when both may cost the same, against theory.

    The implicit one has the step that its error allows; the explicit one, in as many evaluations, a step
    shorter by what a step of the other costs. Where that is not stable, the implicit one must win.
    """
    of = springs(kind, k, False)
    q, time = _pull(of)
    reference = DormandPrince(1e-9)
    expected = reference.step(of.system, reference.init(of.system, q, np.zeros_like(q)), time).q
    h = ACCURATE / of.slow
    implicit, counted = _error_and_evaluations(of, ImplicitMidpoint(), h, expected)
    shorter = time / counted
    explicit, _ = _error_and_evaluations(of, Leapfrog(), shorter, expected)
    beyond = 0.5 * shorter * of.frequencies[-1]
    note = (
        f"errors {implicit:.2g} implicit, {explicit:.2g} explicit, in {counted} evaluations; the explicit "
        f"step is {beyond:.2g} of the largest stable one"
    )
    # Within a factor of two of the limit, either may be.
    wins = implicit < explicit
    off = 0.0 if wins == (beyond > 1.0) else abs(float(np.log2(beyond)))
    right = implicit < 4 * SHARE
    return Found(off if right else np.nan, 1.0, "theory: implicit where 2 / w_max is too short a step", note)


def _error_and_evaluations(
    of: Springs, integrator: Integrator, h: float, expected: Floats
) -> tuple[float, int]:
    """Relative error of the soft hinges at the end, and how often the torques were evaluated."""
    counted = 0

    def potential(q: Floats, factors: Articulated) -> tuple[float, Floats]:
        nonlocal counted
        counted += 1
        return of.system.potential(q, factors)

    error, _ = _error(replace(of, system=replace(of.system, potential=potential)), integrator, h, expected)
    return error, counted


def _cases() -> Iterator[Case]:
    for kind in ("omega", "bond angles"):
        for k in (1.0, 1e3, 1e6, 1e9):
            for name in INTEGRATORS:
                part = Part.TESTED if k == 1e6 and name == "leapfrog" else Part.QUICK
                where = f"{name}, {kind}, {k:g} kJ/mol/rad^2"
                yield case("largest stable step", where, stable_step, name, kind, k, False, part=part)
            where = f"leapfrog, {kind}, {k:g} kJ/mol/rad^2, free root"
            yield case("largest stable step", where, stable_step, "leapfrog", kind, k, True)
            for times in (2.0, 10.0, 100.0):
                where = f"{times:g} times the explicit limit, {kind}, {k:g} kJ/mol/rad^2"
                yield case("implicit midpoint is stable", where, unconditionally, kind, k, False, times)
        for name in (*INTEGRATORS, "midpoint"):
            yield case("order", f"{name}, {kind}", order, name, kind, 1e3)
        for k in RISING:
            where = f"{kind}, {k:g} kJ/mol/rad^2"
            yield case("implicit against explicit", where, winner, kind, k, part=Part.FULL)
            yield case("equal numbers of evaluations", where, equal_cost, kind, k, part=Part.FULL)
        yield case("crossover", kind, crossover, kind, part=Part.FULL)


CASES = tuple(_cases())
