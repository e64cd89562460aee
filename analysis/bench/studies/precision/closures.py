"""Closed loops: distances kept over a step, by iterations, and accelerations under constraints."""

from collections.abc import Callable, Iterator
from functools import partial
from time import process_time

import numpy as np

from bench.cases import Point
from bench.cost import least_seconds
from bench.studies.precision.extended import DIGITS, WIDE, wide_cholesky, wide_mass, wide_solve
from bench.studies.precision.peptides import KT
from protochain.chains.articulate import build_chain
from protochain.chains.chain import Chain, pose
from protochain.core.arrays import Floats
from protochain.dynamics import Closure, Leapfrog, Phase, StepTooLargeError, System
from protochain.mechanics.motion.system import Drifted
from protochain.mechanics.multibody import (
    Frames,
    Rows,
    Tree,
    mass_matrix,
    row_matrix,
    sample_velocities,
    solve_closed,
)  # fmt: skip
from protochain.structure import from_sequence


def loop(chain: Chain, q: Floats, first: int, last: int) -> Closure:
    """Keep three distances between the backbone atoms N and CA of two residues, by their places."""
    s = chain.structure

    def atom(residue: int, name: str) -> int:
        return int(np.flatnonzero((s.atom_residue == residue) & (s.atom_name == name))[0])

    pairs = np.array([(atom(first, a), atom(last, b)) for a, b in (("CA", "CA"), ("N", "CA"), ("CA", "N"))])
    x = pose(chain, q).x
    length = np.linalg.norm(x[pairs[:, 1]] - x[pairs[:, 0]], axis=1)
    return Closure(chain.tree, chain.atom_body[pairs], chain.atom_local[pairs], length)


def bent(residues: int) -> tuple[Chain, Floats]:
    """Polyglycine with a free root and random angles, so that no loop is straight."""
    chain = build_chain(from_sequence("G" * residues), "phi psi", "free")
    q = chain.q0.copy()
    q[chain.tree.q_start[chain.hinge_body]] += np.random.default_rng(4).normal(scale=0.5, size=chain.n_hinges)
    return chain, q


def dense_closed(tree: Tree, frames: Frames, tau: Floats, rows: Rows) -> Floats:
    """Accelerations by the dense matrix of M and the constraints together."""
    mass, g = mass_matrix(tree, frames), row_matrix(tree, frames, rows)
    whole = np.block([[mass, g.T], [g, np.zeros((len(g), len(g)))]])
    return np.asarray(np.linalg.solve(whole, np.concatenate([tau, np.zeros(len(g))]))[: len(tau)])


def wide_closed(tree: Tree, frames: Frames, tau: Floats, rows: Rows) -> np.ndarray:
    """Accelerations in extended precision, with the rows as they are given."""
    g = row_matrix(tree, frames, rows).astype(WIDE)
    moved = wide_mass(tree, frames).solve(np.column_stack([tau.astype(WIDE), g.T]))
    free, inverse = moved[:, 0], moved[:, 1:]
    return np.asarray(free - inverse @ wide_solve(wide_cholesky(g @ inverse), g @ free))


ROUTES: dict[str, Callable[[Tree, Frames, Floats, Rows], Floats]] = {
    "dense": dense_closed,
    "articulated": solve_closed,
    "Fixman": partial(solve_closed, method="fixman"),
}


def measure(quick: bool) -> Iterator[Point]:
    """Distances by iterations, accelerations by length, and distances in the course of a run."""
    chain, q = bent(8 if quick else 20)
    closure = loop(chain, q, 1, chain.structure.n_residues - 2)
    system = System(chain.tree, lambda q, factors: (0.0, np.zeros(chain.n_v)), closure)
    qd = sample_velocities(chain.tree, pose(chain, q).frames, KT, np.random.default_rng(5))
    at = system.with_velocities(system.at(q, qd), qd)
    for fs in (2.0, 8.0) if quick else (1.0, 2.0, 4.0, 8.0, 16.0):
        yield from _iterations(closure, at, fs)
    for n in (8,) if quick else (8, 20, 40, 60):
        yield from _accelerations(n)
    for fs in (2.0,) if quick else (1.0, 2.0, 4.0, 8.0):
        yield from _run(system, closure, at, 100 if quick else 2000, fs)


def _iterations(closure: Closure, at: Phase, fs: float) -> Iterator[Point]:
    """Error of the distances after each iteration for the impulses of one step."""
    errors: list[float] = []
    seconds: list[float] = []
    spent, began = 0.0, process_time()

    def watched(start: Phase, p: Floats, h: float) -> Drifted:
        nonlocal spent
        end = Leapfrog().drift(start, p, h)
        noted = process_time()
        errors.append(float(np.abs(closure.errors(end[2].frames)).max()))
        seconds.append(noted - began - spent)
        spent += process_time() - noted
        return end

    # Compiled or loaded before the clock starts.
    closure.drift(Leapfrog().drift, at, at.p, 1e-4)
    began = process_time()
    try:
        closure.drift(watched, at, at.p, 1e-3 * fs)
    except StepTooLargeError:
        errors.append(np.inf)
        seconds.append(process_time() - began)
    where = f"distances after one step, {len(closure.length)} of {len(at.qd)} freedoms"
    for k, (error, cost) in enumerate(zip(errors, seconds, strict=True)):
        against = "the distances at the start"
        yield Point(f"{fs:g} fs", f"{k} corrections", cost, error, where, "nm", against, k + 1, len(at.qd))


def _accelerations(n: int) -> Iterator[Point]:
    """Error of accelerations under three distances."""
    chain, q = bent(n)
    frames = pose(chain, q).frames
    rows = loop(chain, q, 1, n - 2).rows(frames)
    tau = np.random.default_rng(6).normal(size=chain.n_v)
    exact = wide_closed(chain.tree, frames, tau, rows).astype(float)
    for name, route in ROUTES.items():
        given = (chain.tree, frames, tau, rows)
        error = float(np.linalg.norm(route(*given) - exact) / np.linalg.norm(exact))
        seconds = least_seconds(partial(route, *given), 0.05)
        against = f"dense matrices in extended precision ({DIGITS})"
        yield Point(name, f"{n} residues", seconds, error, "accelerations", "1", against, np.nan, chain.n_v)


def _run(system: System, closure: Closure, at: Phase, steps: int, fs: float) -> Iterator[Point]:
    """Largest error of the distances so far, in the course of a run without potential."""
    largest, began = 0.0, process_time()
    for k in range(1, steps + 1):
        at = Leapfrog().step(system, at, 1e-3 * fs)
        largest = max(largest, float(np.abs(closure.errors(at.factors.frames)).max()))
        if k in (steps // 100, steps // 10, steps):
            case, against = "distances in the course of a run", "the distances at the start"
            cost = process_time() - began
            yield Point(f"{fs:g} fs", f"{k} steps", cost, largest, case, "nm", against, np.nan, len(at.qd))
