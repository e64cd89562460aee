"""M^-1, ln det M and its gradient, closed loops and round trips on trees that are hard on arithmetic."""

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

from bench.cases import Found, Refusal
from bench.studies.precision.extended import wide_frames
from bench.studies.precision.solvers import backward_error, norm_of_mass
from bench.studies.stability import trees
from bench.studies.stability.cells import EPS, Case, Part, case
from bench.studies.stability.energies import on_a_line, peptide
from bench.studies.stability.solvers import ROUTES
from protochain.chains.articulate import build_chain
from protochain.chains.chain import pose as pose_of_chain
from protochain.core.arrays import Floats, dihedral
from protochain.core.errors import Fault
from protochain.mechanics.multibody import (
    Frames,
    Method,
    Rows,
    Tree,
    forward_dynamics,
    inverse_dynamics,
    log_det_closed,
    log_det_gradient,
    log_det_mass,
    mass_matrix,
    point_rows,
    pose,
    row_matrix,
    solve_closed,
    solve_mass,
)  # fmt: skip

Build = Callable[[], Tree]
BACKWARD = 100.0
"""eps. A sweep does some hundred rounded operations on a body and its parent; errors of bodies do not add up
in the backward error, because each is relative to forces on that body, which the norm of M exceeds."""

LINE, AXIS, TWICE = Fault.NO_INVERSE, Fault.NO_INERTIA, Fault.DEPENDENT
"""Refusals that are expected."""


def _posed(build: Build, angle: float | None = None) -> tuple[Tree, Frames, Floats]:
    """Tree at random coordinates, or with all hinges at one angle, and random torques."""
    tree = build()
    rng = np.random.default_rng(7)
    q = rng.uniform(-3, 3, tree.n_q)
    if angle is not None:
        q[tree.q_start[tree.hinge_bodies]] = angle
    return tree, pose(tree, q), rng.normal(size=tree.n_v)


def solved(build: Build, route: str, angle: float | None = None) -> Found:
    """Backward error of M^-1 tau."""
    tree, frames, tau = _posed(build, angle)
    error = backward_error(tree, frames, ROUTES[route](tree, frames, tau), tau)
    return Found(error, BACKWARD, "M x by Newton-Euler; backward error, eps")


def exact(build: Build, angle: float | None = None) -> Found:
    """Error of M^-1 tau by articulated bodies, against the dense matrix refined in extended precision."""
    tree, frames, tau = _posed(build, angle)
    mass = mass_matrix(tree, frames)
    x = np.linalg.solve(mass, tau).astype(np.longdouble)
    for _ in range(3):
        left = (tau - mass.astype(np.longdouble) @ x).astype(float)
        x += np.linalg.solve(mass, left)
    error = float(np.linalg.norm(solve_mass(tree, frames, tau) - x) / np.linalg.norm(x))
    # Higham (2002), 7.1: a backward error is magnified by the condition number; M itself is rounded alike.
    return Found(error, BACKWARD * EPS * np.linalg.cond(mass), "dense matrix, refined in extended precision")


def log_det(build: Build, method: Method, angle: float | None = None) -> Found:
    """Error of ln det M, against the dense matrix."""
    tree, frames, _ = _posed(build, angle)
    mass = mass_matrix(tree, frames)
    expected = np.linalg.slogdet(mass)[1]
    error = abs(log_det_mass(tree, frames, method) - expected)
    # d ln det M = tr(M^-1 dM): at most n cond times the relative change of M. Fixman's method has the inverse
    # inertias of single bodies instead, whose condition is the length of the links over the width, squared.
    condition = np.linalg.cond(mass)
    if method == "fixman":
        moments = np.linalg.eigvalsh(tree.inertia)
        condition += np.max(tree.mass * np.max(tree.offset**2) * 3 / moments[:, 0])
    return Found(error, BACKWARD * EPS * tree.n_v * condition, "dense matrix, LU")


def log_det_duality(build: Build) -> Found:
    """Difference of ln det M by the two methods, which eliminate different directions."""
    tree, frames, _ = _posed(build)
    ours, other = log_det_mass(tree, frames), log_det_mass(tree, frames, "fixman")
    # A sum of n logarithms, each of a pivot whose relative error is eps times a body's condition (1e3).
    return Found(abs(ours - other), BACKWARD * EPS * 1e3 * tree.n_v, "Fixman's method")


def gradient(build: Build, angle: float | None = None) -> Found:
    """Error of the gradient of ln det M along eight hinges, against central differences."""
    tree = build()
    q = np.random.default_rng(7).uniform(-3, 3, tree.n_q)
    hinges = tree.q_start[tree.hinge_bodies]
    if angle is not None:
        q[hinges] = angle
    h, ours = 1e-4, log_det_gradient(tree, pose(tree, q))[tree.v_start[tree.hinge_bodies]]
    value = log_det_mass(tree, pose(tree, q))
    error, third = 0.0, 0.0
    for k in np.linspace(0, len(hinges) - 1, min(8, len(hinges))).astype(int):
        at = [log_det_mass(tree, pose(tree, _moved(q, hinges[k], d * h))) for d in (-2, -1, 1, 2)]
        # Fourth order, so that truncation is far below round-off.
        expected = (at[0] - 8 * at[1] + 8 * at[2] - at[3]) / (12 * h)
        error = max(error, abs(ours[k] - expected))
        third = max(third, abs(at[3] - 2 * at[2] + 2 * at[1] - at[0]) / (2 * h**3))
    # The fifth derivative is taken as the third times 100; each logarithm is rounded n times, 100 eps; and
    # a large angle is rounded itself, so that the step is not h.
    rounded = EPS * np.abs(q).max() / h * np.abs(ours).max()
    bound = 100 * third * h**4 + BACKWARD * EPS * (tree.n_v + abs(value)) / h + rounded
    return Found(error, bound, "differences of order four")


def _moved(q: Floats, k: int, by: float) -> Floats:
    q = q.copy()
    q[k] += by
    return q


def round_trip(build: Build, rate: float) -> Found:
    """Backward error of accelerations at rates: torques -> accelerations -> torques."""
    tree = build()
    rng = np.random.default_rng(7)
    q, qd, tau = rng.uniform(-3, 3, tree.n_q), rate * rng.normal(size=tree.n_v), rng.normal(size=tree.n_v)
    qdd = forward_dynamics(tree, q, qd, tau)
    bias = inverse_dynamics(tree, q, qd, np.zeros(tree.n_v))
    back = inverse_dynamics(tree, q, qd, qdd)
    norm = norm_of_mass(tree, pose(tree, q))
    size = norm * np.linalg.norm(qdd) + np.linalg.norm(tau) + np.linalg.norm(bias)
    return Found(
        float(np.linalg.norm(back - tau) / size / EPS), BACKWARD, "Newton-Euler; backward error, eps"
    )


def grown(build: Build) -> Found:
    """Growth of round-off in positions along a chain, against extended precision."""
    tree = build()
    q = np.random.default_rng(7).uniform(-3, 3, tree.n_q)
    _, at = wide_frames(tree, q)
    error = float(np.abs(pose(tree, q).origin - at).max())
    depth = _depth(tree)
    # Each body on the way rounds a position and turns all beyond it by an eps or so: 10 eps times the sum of
    # the distances to the end, at most.
    reach = float(np.linalg.norm(at, axis=1).max()) + 1.0
    return Found(error, 10 * EPS * depth * reach, "extended precision", f"depth {depth}, nm")


def _depth(tree: Tree) -> int:
    depth = np.zeros(tree.n_bodies, dtype=int)
    for b, p in enumerate(tree.parent):
        depth[b] = depth[p] + 1 if p >= 0 else 1
    return int(depth.max())


def _loops(n: int, loops: int, redundant: bool) -> tuple[Tree, Frames, Floats, Rows]:
    tree, frames, tau = _posed(partial(trees.chain, n))
    pairs = [(k * n // loops, (k + 1) * n // loops - 1) for k in range(loops)]
    if redundant:
        pairs.append(pairs[0])
    made = [
        point_rows(frames, pair, np.tile(frames.origin[list(pair)].mean(axis=0), (2, 1))) for pair in pairs
    ]
    both = (np.concatenate([getattr(rows, name) for rows in made]) for name in ("body", "wrench"))
    return tree, frames, tau, Rows(*both)


def closed(n: int, loops: int, method: Method, redundant: bool = False) -> Found:
    """Error of accelerations under closed loops, against the dense saddle-point matrix."""
    tree, frames, tau, rows = _loops(n, loops, redundant)
    mass, g = mass_matrix(tree, frames), row_matrix(tree, frames, rows)
    x = solve_closed(tree, frames, tau, rows, method)
    whole = np.block([[mass, g.T], [g, np.zeros((len(g), len(g)))]])
    expected = np.linalg.lstsq(whole, np.concatenate([tau, np.zeros(len(g))]))[0][: tree.n_v]
    inverse = g @ np.linalg.solve(mass, g.T)
    error = float(np.linalg.norm(x - expected) / np.linalg.norm(expected))
    # Two solutions one within the other: the condition numbers multiply.
    bound = BACKWARD * EPS * (np.linalg.cond(mass) + np.linalg.cond(whole) + np.linalg.cond(inverse))
    return Found(error, bound, "dense saddle-point matrix")


def closed_log_det(n: int, loops: int, method: Method) -> Found:
    """Error of ln det (G M^-1 G^T), against dense matrices."""
    tree, frames, _, rows = _loops(n, loops, redundant=False)
    mass, g = mass_matrix(tree, frames), row_matrix(tree, frames, rows)
    inverse = g @ np.linalg.solve(mass, g.T)
    error = abs(log_det_closed(tree, frames, rows, method) - np.linalg.slogdet(inverse)[1])
    bound = BACKWARD * EPS * len(g) * np.linalg.cond(inverse) * np.linalg.cond(mass)
    return Found(error, bound, "dense matrices")


def angle_of(off_line: float) -> Found:
    """Dihedral of four points, three of them this far (relative) from a line, against its definition.

    The last three points turn by 50 degrees about the middle bond; on a line it is undefined and any will do.
    """
    turn = np.deg2rad(50.0)
    x = np.array([[off_line, 0.0, -1.0], [0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [np.cos(turn), np.sin(turn), 1.5]])
    found = float(dihedral(*x))
    expected = turn if off_line else found
    # Differences of points of order one are rounded by eps: relative to the distance from the line.
    bound = 10 * EPS / off_line if off_line else np.pi
    return Found(abs(found - expected), bound, "the angle it was made with")


def straightened(off_line: float) -> Found:
    """Error of the atoms of a chain with N, CA and C of one residue almost on a line."""
    s = peptide("GAG")
    x = on_a_line(s, off_line)[0]
    made = build_chain(s.with_positions(x))
    error = float(np.abs(pose_of_chain(made, made.q0).x - x).max())
    # Positions are those given whatever the dihedral, since the frames are made of it: some eps of a few nm
    # for each of a dozen bodies, and more the nearer the axis the atom that a dihedral is measured by.
    return Found(error, 1e3 * EPS, "the positions given, nm")


def _cases() -> Iterator[Case]:
    yield from _by_size()
    for ratio in (1e-9, 1e-6, 1e-3, 1e3, 1e6, 1e9):
        for kind, of in (("every other body", trees.mass_ratio), ("tip", trees.tip_heavier)):
            yield from _by_routes(f"mass ratio, {kind}", f"{ratio:g}", partial(of, ratio))
    for width in (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 0.0):
        less = LINE if width < 1e-4 else None
        yield from _by_routes("bodies almost lines", f"width {width:g}", partial(trees.thin, width), less)
    for size in (1e-1, 1e-2, 1e-4, 1e-6, 1e-8, 0.0):
        less = LINE if size < 1e-4 else None
        yield from _by_routes("bodies almost points", f"size {size:g}", partial(trees.small, size), less)
    for d in (5.0, 0.1, 1e-3, 1e-5, 1e-7, 0.0):
        # Two atoms: a line at any angle.
        none = AXIS if d < 1e-4 else None
        build = partial(trees.nearly_collinear, d)
        yield from _by_routes("body near its axis", f"{d:g} degrees", build, none or LINE, none)
    for d in (30.0, 1.0, 1e-3, 1e-6, 0.0):
        yield from _by_routes("hinges almost parallel", f"{d:g} degrees", partial(trees.nearly_parallel, d))
    for d in (70.0, 170.0, 179.9, 179.99999, 180.0):
        none, build = AXIS if d > 179.999 else None, partial(trees.beads, 40, True, d)
        yield from _by_routes("chain nearly straight", f"{d} degrees", build, none, none)
    for name, shared in (("shared", True), ("not shared", False)):
        less = None if shared else LINE
        yield from _by_routes("bodies of one atom", f"masses {name}", partial(trees.beads, 100, shared), less)
    for name, angle in (("0", 0.0), ("pi", np.pi), ("pi/2", np.pi / 2), ("1e9", 1e9)):
        both: tuple[tuple[str, Callable[..., Tree]], ...] = (
            ("chain", partial(trees.chain, 30)),
            ("beads", partial(trees.beads, 30, True)),
        )
        for kind, of in both:
            where = f"{kind}, all angles {name}"
            yield case("angles at 0 and pi", f"{where}, M^-1", exact, of, angle, part=Part.TESTED)
            yield case("angles at 0 and pi", f"{where}, ln det", log_det, of, "articulated", angle)
            yield case("angles at 0 and pi", f"{where}, gradient", gradient, of, angle)
    for rate in (0.0, 1.0, 1e3, 1e6):
        yield case(
            "accelerations at rates", f"{rate:g} rad/ps", round_trip, partial(trees.branched, 100), rate
        )
    for n, loops in ((10, 1), (30, 3), (100, 10), (1000, 10)):
        for method in ("articulated", "fixman"):
            where = f"{loops} in {n} bodies, {method}"
            yield case("closed loops", f"{where}, M^-1", closed, n, loops, method)
            yield case("closed loops", f"{where}, ln det", closed_log_det, n, loops, method)
    for method in ("articulated", "fixman"):
        where = f"the same loop twice, {method}"
        yield case("closed loops", where, closed, 30, 3, method, True, part=Part.TESTED, refusal=TWICE)
    for off in (1.0, 1e-3, 1e-6, 1e-9, 1e-12, 0.0):
        yield case("dihedral on a line", f"off it by {off:g}", angle_of, off, part=Part.TESTED)
        yield case("chain with N, CA, C on a line", f"off it by {off:g}", straightened, off)


def _by_size() -> Iterator[Case]:
    for n in (1, 2, 10, 100, 1000, 10_000, 100_000, 1_000_000):
        part = Part.TESTED if n <= 100 else Part.QUICK if n <= 10_000 else Part.FULL
        build = partial(trees.chain, n)
        for route in ("articulated", "fixman"):
            yield case("chain", f"{n} bodies, {route}", solved, build, route, part=part)
        if n <= 1000:
            yield case("chain", f"{n} bodies, against dense", exact, build, part=part)
            yield case("chain", f"{n} bodies, ln det", log_det, build, "articulated", part=part)
        yield case("chain", f"{n} bodies, ln det by two methods", log_det_duality, build, part=part)
        if n <= 10_000:
            for end, of in (("end", trees.chain), ("middle", trees.from_the_middle)):
                yield case("root, positions", f"{end}, {n} bodies", grown, partial(of, n), part=part)
    for name, of in (
        ("tree", trees.branched), ("star", trees.star), ("forest", trees.forest),
        ("root in the middle", trees.from_the_middle),
    ):  # fmt: skip
        for n in (10, 1000, 100_000):
            part = Part.QUICK if n <= 1000 else Part.FULL
            for route in ("articulated", "fixman"):
                yield case(name, f"{n} bodies, {route}", solved, partial(of, n), route, part=part)
            if n <= 1000:
                yield case(name, f"{n} bodies, ln det", log_det, partial(of, n), "articulated", part=part)
            yield case(name, f"{n} bodies, gradient", gradient, partial(of, n), part=part)


def _by_routes(
    name: str, parameters: str, build: Build, by_fixman: Refusal = None, by_all: Refusal = None
) -> Iterator[Case]:
    """Cases of all ways of solution, with the refusals expected of Fixman's method and of the others."""
    for route in ROUTES:
        expected = by_fixman if route == "fixman" else by_all
        yield case(name, f"{parameters}, {route}", solved, build, route, refusal=expected)
    yield case(name, f"{parameters}, ln det", log_det, build, "articulated", refusal=by_all)
    where = f"{parameters}, ln det by Fixman's method"
    yield case(name, where, log_det, build, "fixman", refusal=by_fixman)


CASES = tuple(_cases())
