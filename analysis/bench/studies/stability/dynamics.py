"""Dynamics: long steps, no heat and much, round-off of many steps, restarts at any step, time reversed."""

from collections.abc import Iterator
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from scipy.linalg import eigh
from scipy.stats import gamma, kstest

from bench.cases import Found
from bench.studies.stability.cells import EPS, Case, Part, case
from bench.studies.stability.energies import peptide
from protochain.chains.articulate import build_chain
from protochain.chains.chain import Chain, pose, pull_back
from protochain.core.arrays import Floats
from protochain.core.errors import Argument, Fault, ProtochainError
from protochain.core.units import MOLAR_GAS
from protochain.dynamics import (
    Closure,
    Leapfrog,
    Simulation,
    StepTooLargeError,
    System,
    chain_potential,
    simulate,
)
from protochain.dynamics.integrators import INTEGRATORS
from protochain.energies import Energy, energy
from protochain.mechanics.motion.system import Phase
from protochain.mechanics.multibody import HingeKind, Tree, centre_of_mass, mass_matrix, momentum, random_tree
from protochain.mechanics.multibody import pose as frames_of
from protochain.mechanics.multibody.articulated import Articulated
from protochain.minimisers import minimise


@cache
def _minimum(threads: int, sequence: str = "AAAA") -> tuple[Chain, Energy, Floats]:
    """Peptide with a free root, at a minimum in torsions."""
    s = peptide(sequence)
    chain, ours = build_chain(s, root="free"), energy(s, engine="native", threads=threads)
    return chain, ours, minimise(chain, ours, "newton", 1e-6, 300, curvature=False).q


def _run(threads: int, sequence: str = "AAAA", **settings: Any) -> Simulation:
    """Simulate from the minimum; a run that has become unstable is a refusal, with its message."""
    chain, ours, q = _minimum(threads, sequence)
    done = simulate(chain, ours, q, seed=5, **settings)
    if not done.is_sound:
        raise StepTooLargeError(done.message)
    return done


def _fastest(chain: Chain, ours: Energy, q: Floats) -> float:
    """Largest frequency at q, 1/ps: of the Hessian by differences of torques."""
    hinges, at_v = chain.tree.q_start[chain.hinge_body], chain.tree.v_start[chain.hinge_body]
    h, columns = 1e-5, []
    for k in hinges:
        ends = []
        for sign in (1.0, -1.0):
            moved = q.copy()
            moved[k] += sign * h
            at = pose(chain, moved)
            ends.append(pull_back(chain, at, ours(at.x)[1])[at_v])
        columns.append((ends[1] - ends[0]) / (2 * h))
    hessian = 0.5 * (np.array(columns) + np.array(columns).T)
    # Rates of the hinges under their torques alone, the root free: the block of M^-1 that belongs to them.
    inverse = np.linalg.inv(mass_matrix(chain.tree, frames_of(chain.tree, q)))[np.ix_(at_v, at_v)]
    return float(np.sqrt(max(eigh(hessian, np.linalg.inv(inverse), eigvals_only=True)[-1], 0.0)))


def constant_energy(integrator: str, fs: float, kelvin: float, threads: int) -> Found:
    """Error of the total energy of 50 steps, relative to the thermal and kinetic energy."""
    chain, ours, _ = _minimum(threads)
    points = []
    done = _run(
        threads, temperature=kelvin, time_step=fs / 1000, n_steps=50, thermostat="none", every=1,
        integrator=integrator, watch=lambda row, x: points.append(row["kinetic_kj_mol"]),
    )  # fmt: skip
    total = done.trace["total_kj_mol"].to_numpy()
    size = 0.5 * done.freedoms * MOLAR_GAS * kelvin + max(points)
    h, rate = fs / 1000, float(np.abs(done.qd).max())
    # The same path once more, for the frequencies on it: collisions are faster than the minimum.
    path = _run(threads, temperature=kelvin, time_step=1e-6, n_steps=1, thermostat="none").state.at
    system, step, hw = System(chain.tree, chain_potential(chain, ours)), INTEGRATORS[integrator], 0.0
    for k in range(50 if kelvin > 1e3 else 1):
        hw = max(hw, h * _fastest(chain, ours, path.q)) if k % 2 == 0 else hw
        path = step.step(system, path, h)
    error = float(np.abs(total - total[0]).max())
    # The energy of a spring oscillates by (h w)^2 / (4 - (h w)^2) (Hairer, Lubich, Wanner, 2006, I.5), here
    # for the fastest mode at every other step, and twice that in between, where pairs meet. M changes by the
    # turn of a step. No run may lose half of its heat; 1e-10 of the potential is rounding.
    share = ((2 * hw) ** 2 + (h * rate) ** 2) / 4
    bound = min(share, 0.5) * size + 1e-10 * abs(done.trace["potential_kj_mol"]).max()
    return Found(
        error,
        float(bound),
        "(h w)^2 of the Hessian's fastest mode, kJ/mol",
        f"h w = {hw:.2g}, h qd = {h * rate:.2g}",
    )


SURE = 1e-5
"""Share of right runs that a bound on the temperature would call wrong."""
NARROW = 0.04
"""Relative: a run whose bound is wider says nothing of its temperature, and is wrong."""


def thermostatted(thermostat: str, kelvin: float, threads: int) -> Found:
    """Kinetic energies with a thermostat, against their law: Gamma of half the freedoms, times kT.

    It holds at any q, whatever the potential. Bounds are its quantiles for as many independent samples as the
    measured autocorrelation leaves: a few per cent of the temperature.
    """
    slow, hot = thermostat == "nose-hoover", kelvin > 1e4
    n, length = 20_000 if slow else 4000, 1
    if thermostat == "hmc":  # velocities are drawn anew every other step
        n, length = 12_000, 2
    step = 0.0002 if hot else 0.002
    done = _run(
        threads, "A" * 12, temperature=kelvin, time_step=step, n_steps=n if kelvin else 400,
        thermostat=thermostat, friction=(0.1 if slow else 1.0) / step, every=length, trajectory_length=length,
    )  # fmt: skip
    if not kelvin:
        warm = done.trace["temperature_k"].to_numpy()[100:]
        return Found(float(warm.max()), 1e-6, "0 K", "K, of a start at rest in a minimum")
    shares = done.trace["kinetic_kj_mol"].to_numpy()[n // length // 8 :] / (MOLAR_GAS * kelvin)
    return _canonical(shares, done.freedoms)


def stiff_bath(threads: int) -> Found:
    """A bath faster than the steps can follow: refused, for its own equations blow up."""
    _run(threads, temperature=300, time_step=0.002, n_steps=1000, thermostat="nose-hoover", friction=200.0)
    return Found(np.nan, 0.0, "a refusal")


def _canonical(shares: Floats, freedoms: int) -> Found:
    """Kinetic energies over kT, against Gamma(f / 2): their mean, and by Kolmogorov and Smirnov the rest."""
    half, n = 0.5 * freedoms, len(shares) / _inefficiency(shares)
    # The mean of n of Gamma(a) is Gamma(n a) / n.
    ends = gamma.ppf([0.5 * SURE, 1 - 0.5 * SURE], n * half) / (n * half)
    off, widest = abs(float(shares.mean()) / half - 1.0), float(np.abs(ends - 1.0).max())
    apart = float(kstest(shares, gamma(half).cdf).statistic)
    # Kolmogorov's distribution for many samples: 2 exp(-2 n d^2) is the chance of a distance d.
    largest = float(np.sqrt(0.5 * np.log(2.0 / SURE) / n))
    note = f"mean off by {off:.2g} of {widest:.2g}, distribution by {apart:.2g} of {largest:.2g}"
    note += f", {n:.0f} independent samples"
    if widest > NARROW:
        return Found(np.nan, NARROW, "Gamma law", f"too few samples: {note}")
    if apart / largest > off / widest:
        return Found(apart, largest, f"Gamma law of {freedoms} freedoms, Kolmogorov-Smirnov", note)
    return Found(off, widest, f"Gamma law of {freedoms} freedoms, mean", note)


def _inefficiency(x: Floats) -> float:
    """Samples for one independent one: 1 + 2 sums of autocorrelations, as long as their pairs are positive.

    Geyer, Statistical Science 7:473 (1992).
    """
    x, n = x - x.mean(), len(x)
    wave = np.fft.rfft(x, 2 * n)
    correlation = np.fft.irfft(wave * wave.conj())[:n]
    correlation /= correlation[0]
    pairs = correlation[: n // 2 * 2].reshape(-1, 2).sum(axis=1)
    last = int(np.argmax(pairs < 0)) if (pairs < 0).any() else len(pairs)
    return max(1.0, 2.0 * float(pairs[:last].sum()) - 1.0)


def restarted(thermostat: str, step: int, threads: int) -> Found:
    """Stop at a step and resume, against the run that was not stopped: bit for bit."""
    given: dict[str, Any] = {"thermostat": thermostat, "every": 1, "time_step": 0.002, "trajectory_length": 1}
    with TemporaryDirectory() as folder:
        whole = _run(threads, n_steps=12, output=Path(folder) / "whole", **given)
        _run(threads, n_steps=step, output=Path(folder) / "parts", **given)
        resumed = _run(threads, n_steps=12, output=Path(folder) / "parts", resume=True, **given)
    same = np.array_equal(whole.q, resumed.q) and np.array_equal(whole.qd, resumed.qd)
    error = 0.0 if same else float(np.abs(whole.q - resumed.q).max()) or np.nan
    return Found(error, 0.0, "the run that was not stopped, bit for bit")


def reversed_in_time(integrator: str, fs: float, kelvin: float, threads: int) -> Found:
    """Steps forward and as many back, against the start."""
    n = 20
    chain, ours, _ = _minimum(threads)
    start = _run(threads, temperature=kelvin, n_steps=1, time_step=1e-4, thermostat="none").state.at
    system, step, h = System(chain.tree, chain_potential(chain, ours)), INTEGRATORS[integrator], fs / 1000
    at = first = system.at(start.q, start.qd)
    neighbour = system.at(start.q, start.qd * (1 + 1e-9))
    for _ in range(n):
        at, neighbour = step.step(system, at, h), step.step(system, neighbour, h)
    grown = float(np.abs(neighbour.q - at.q).max() / (1e-9 * h * np.abs(start.qd).max()))
    for _ in range(n):
        at = step.step(system, at, -h)
    error = float(np.abs(at.q - first.q).max())
    # A step is solved to 1e-12 of a velocity (midpoint: 1e-10; leapfrog, whose momenta are advanced with the
    # velocities before Newton's last correction, the same) and its torques are rounded; of 2 n steps each
    # error grows on the way back as that of a neighbour grew.
    solved = 1e-12 if integrator == "lobatto" else 1e-10
    rounded = 100 * EPS * 0.1 * np.abs(ours(pose(chain, start.q).x)[1]).max()  # torque of a force at 0.1 nm
    light = np.diagonal(np.linalg.inv(mass_matrix(chain.tree, first.factors.frames))).max()
    step_error = solved * h * max(1.0, float(np.abs(start.qd).max())) + 10 * EPS + h**2 * light * rounded
    bound = 2 * n * float(step_error) * max(grown, 1.0)
    return Found(error, bound, "its own start")


def far_away(nm: float, threads: int) -> Found:
    """Total energies of a run this far from the origin, against the same at the origin."""
    chain, ours, q = _minimum(threads)
    away = q.copy()
    root = chain.tree.q_start[0]
    away[root + 4 : root + 7] += nm
    given: dict[str, Any] = {"n_steps": 50, "time_step": 0.001, "thermostat": "none", "every": 1, "seed": 5}
    home, there = (simulate(chain, ours, each, **given) for each in (q, away))
    if not there.is_sound:
        raise ProtochainError(there.message)
    error = np.abs(home.trace["total_kj_mol"].to_numpy() - there.trace["total_kj_mol"].to_numpy()).max()
    # Each atom's energy by the rounding of its place; a thermal run's forces, some ten times the start's.
    size = 1e3 + 10 * np.abs(ours(pose(chain, q).x)[1]).sum()
    return Found(float(error), 1e-9 + 10 * EPS * nm * float(size), "the run at the origin, kJ/mol")


def rounded(n_steps: int, closed: bool, away: float = 0.0) -> Found:
    """Drift of momentum and of quaternions' lengths, or of closures, of free bodies by rounding alone."""
    tree = random_tree(6, 2, 0.0, HingeKind.FREE)
    rng = np.random.default_rng(4)
    q = rng.uniform(-1, 1, tree.n_q)
    q[tree.q_start[0] + 4 : tree.q_start[0] + 7] += away
    frames, closure = frames_of(tree, q), None
    if closed:
        ends = frames.origin[[0, 5]]
        length = np.array([np.linalg.norm(ends[1] - ends[0])])
        closure = Closure(tree, np.array([[0, 5]]), np.zeros((1, 2, 3)), length)

    def nothing(q: Floats, factors: Articulated) -> tuple[float, Floats]:
        return 0.0, np.zeros(tree.n_v)

    system, leapfrog = System(tree, nothing, closure), Leapfrog()
    # They turn, and their common centre rests: nanometres away coordinates would be rounded the more.
    qd = rng.normal(size=tree.n_v)
    qd[tree.v_start[0] + 3 : tree.v_start[0] + 6] -= momentum(tree, frames, qd)[0] / tree.mass.sum()
    at = system.with_velocities(system.at(q, np.zeros(tree.n_v)), qd)
    before = _about_the_origin(tree, at)
    for _ in range(n_steps):
        at = leapfrog.step(system, at, 0.002)
    after = _about_the_origin(tree, at)
    turn = at.q[tree.q_start[0] : tree.q_start[0] + 4]
    # About the world's origin, which the bodies leave: what is rounded is the moment of momentum there.
    away = 1.0 + float(np.abs(at.q[4:7]).max())
    drift = float(np.abs(after - before).max() / (np.abs(before).max() * away))
    parts = {"momentum": drift, "quaternion": abs(float(np.linalg.norm(turn)) - 1.0)}
    # Every step rounds by some eps, to either side; quaternions are made anew.
    bounds = {"momentum": 10 * EPS * (n_steps**0.5 + 100), "quaternion": 10 * EPS}
    if closure is not None:
        parts["closure"] = float(np.abs(closure.errors(at.factors.frames)).max())
        bounds["closure"] = 1e-12  # nm: what each step is solved to
        # Impulses that are solved no further pull each to the same side as long as the loop keeps its shape.
        bounds["momentum"] = 10 * EPS * (n_steps + 100)
    worst = max(parts, key=lambda name: parts[name] / bounds[name])
    note = ", ".join(f"{name} {value:.2g}" for name, value in parts.items())
    return Found(parts[worst], bounds[worst], f"the {worst} at the start", note)


def _about_the_origin(tree: Tree, at: Phase) -> Floats:
    """(6,): linear momentum, and angular momentum about the world's origin, both of which steps keep.

    About the common centre of mass it changes with the path of that, which is right to the order of the step.
    """
    frames = at.factors.frames
    linear, angular = momentum(tree, frames, at.qd)
    return np.concatenate([linear, angular + np.cross(centre_of_mass(tree, frames), linear)])


NO_STEP = {"0": 0.0, "negative": -0.001, "NaN": np.nan, "of a ps": 1.0}
LONGEST = {"leapfrog": 4.0, "lobatto": 4.0, "midpoint": 8.0, "rk4": 8.0}
"""fs at 1e5 K: a thermal hydrogen crosses an atom in some fs, in which the wall is met and left again."""


def _cases() -> Iterator[Case]:
    for integrator in ("leapfrog", "lobatto", "midpoint", "rk4"):
        for kelvin in (0.0, 300.0, 1e5):
            for fs in (1.0, 2.0, 4.0, 8.0, 16.0, 40.0):
                part = Part.TESTED if integrator == "leapfrog" and fs in (2.0, 40.0) else Part.QUICK
                part = Part.FULL if integrator == "midpoint" else part
                where = f"{integrator}, {fs:g} fs, {kelvin:g} K"
                refusal = Fault.STEP if kelvin == 1e5 and fs > LONGEST[integrator] else None
                yield Case(
                    "constant energy", where, partial(constant_energy, integrator, fs, kelvin), part, refusal
                )
    for thermostat in ("langevin", "nose-hoover", "rescale", "hmc"):
        for kelvin in (0.0, 300.0, 1e5):
            long = thermostat in ("nose-hoover", "hmc") or kelvin > 300
            part = Part.FULL if kelvin and long else Part.QUICK
            cold = Argument("temperature") if thermostat == "nose-hoover" and not kelvin else None
            check = partial(thermostatted, thermostat, kelvin)
            yield Case("thermostats", f"{thermostat}, {kelvin:g} K", check, part, cold)
    where = "nose-hoover, friction times step 0.4"
    yield Case("thermostats", where, stiff_bath, Part.QUICK, Fault.STEP)
    for thermostat in ("none", "langevin", "nose-hoover", "rescale", "hmc"):
        for step in range(1, 12):
            check = partial(restarted, thermostat, step)
            part = Part.QUICK if step in (1, 5, 11) else Part.FULL
            yield Case("restart", f"{thermostat}, after step {step}", check, part)
    for integrator in ("leapfrog", "lobatto", "midpoint"):
        for kelvin in (10.0, 300.0, 3000.0):
            for fs in (1.0, 4.0):
                part = Part.FULL if integrator == "midpoint" else Part.QUICK
                check = partial(reversed_in_time, integrator, fs, kelvin)
                yield Case("time reversed", f"{integrator}, {fs:g} fs, {kelvin:g} K", check, part)
    for n, part in ((1000, Part.TESTED), (30_000, Part.QUICK), (2_000_000, Part.FULL)):
        yield case("round-off", f"{n} steps, free bodies", rounded, n, False, part=part)
    for n, part in ((1000, Part.TESTED), (10_000, Part.QUICK), (200_000, Part.FULL)):
        yield case("round-off", f"{n} steps, a closed loop", rounded, n, True, part=part)
    for nm in (1.0, 1e3, 1e6):
        yield Case("far from the origin", f"{nm:g} nm", partial(far_away, nm))
        far = Fault.FAR if nm > 1e3 else None
        where = f"{nm:g} nm, a closed loop"
        yield case("far from the origin", where, rounded, 100, True, nm, part=Part.TESTED, refusal=far)
    for name, h in NO_STEP.items():
        yield Case("no step", name, partial(_refused, h), Part.TESTED, Argument("time_step"))


def _refused(step: float, threads: int) -> Found:
    _run(threads, time_step=step, n_steps=1)
    return Found(np.nan, 0.0, "a refusal")


CASES = tuple(_cases())
