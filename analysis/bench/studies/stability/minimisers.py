"""Minimisers from starts that are hard: finite, no worse than the start, judged truly, and repeatable."""

from collections.abc import Callable, Iterator
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from warnings import catch_warnings, simplefilter

import numpy as np
from scipy.spatial.transform import Rotation

from bench.cases import Found
from bench.studies.stability.cells import Case, Part, case
from bench.studies.stability.energies import atom, copies, peptide
from protochain.chains.articulate import build_chain
from protochain.chains.chain import Chain, pose, pull_back
from protochain.core.arrays import Floats
from protochain.energies import Energy, energy
from protochain.minimisers import Solution, Status, minimise
from protochain.minimisers.recipes import recipe_of
from protochain.structure import Structure, load, save

METHODS = (
    "kcm", "kcm-proportional", "kcm-adaptive", "kcm-stiffness", "fire", "md", "newton", "lbfgs", "cartesian",
    "hybrid", "openmm",
)  # fmt: skip
_EVALUATIONS, _TOLERANCE = 150, 1.0


def extended() -> Structure:
    """Met-enkephalin, extended."""
    return peptide("YGGFM")


def flat(degrees: float) -> Structure:
    """All dihedrals of an unbranched peptide at 0 or 180 degrees: by symmetry often a saddle point."""
    made = build_chain(peptide("GGGG"))
    q = made.q0.copy()
    q[made.tree.q_start[made.hinge_body]] = np.deg2rad(degrees)
    return made.structure.with_positions(pose(made, q).x)


def shaken(angstrom: float) -> Structure:
    """Every atom moved by normal deviates."""
    s = extended()
    noise = np.random.default_rng(3).normal(scale=angstrom / 10, size=(s.n_atoms, 3))
    return s.with_positions(s.positions + noise)


def turned(degrees: float) -> Structure:
    """Every dihedral turned by normal deviates."""
    made = build_chain(extended())
    q = made.q0.copy()
    turn = np.random.default_rng(4).normal(scale=np.deg2rad(degrees), size=made.n_hinges)
    q[made.tree.q_start[made.hinge_body]] += turn
    return made.structure.with_positions(pose(made, q).x)


def on_one_point() -> Structure:
    """All hydrogens on one point, a nm away."""
    s = extended()
    x = s.positions.copy()
    x[s.atom_element == "H"] = x.mean(axis=0) + np.array([0.0, 0.0, 1.0])
    return s.with_positions(x)


def without_hydrogens() -> Structure:
    """Met-enkephalin from a file without any hydrogen, and then moved by 0.25 angstrom."""
    s = shaken(0.25)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "heavy.pdb"
        save(s, path)
        lines = [line for line in path.read_text().splitlines() if line[76:78].strip() != "H"]
        path.write_text("\n".join([*lines, ""]))
        return load(path)


def hundred() -> Structure:
    """A hundred residues, extended: energies that several threads share."""
    return peptide("ACDEFGHIKLMNPQRSTVWY" * 5)


def threaded() -> Structure:
    """Methionine's end laid through phenylalanine's ring."""
    s = extended()
    x = s.positions.copy()
    ring = [atom(s, 4, name) for name in ("CG", "CD1", "CE1", "CZ", "CE2", "CD2")]
    centre = x[ring].mean(axis=0)
    normal = np.linalg.svd(x[ring] - centre)[2][2]
    first, last = atom(s, 5, "SD"), atom(s, 5, "CE")
    end = np.isin(np.arange(s.n_atoms), [atom(s, 5, name) for name in ("SD", "CE", "HE1", "HE2", "HE3")])
    along = (x[last] - x[first]) / np.linalg.norm(x[last] - x[first])
    turn = Rotation.align_vectors([normal], [along])[0].as_matrix()
    middle = 0.5 * (x[first] + x[last])
    x[end] = (x[end] - middle) @ turn.T + centre
    return s.with_positions(x)


def knotted() -> Structure:
    """A chain led through a loop of its own: dihedrals of a circle, and its end drawn through it."""
    s = peptide("AAAAAAAAAAAA")
    made = build_chain(s)
    q = made.q0.copy()
    kinds = np.array([hinge.kind for hinge in made.hinges])
    at = made.tree.q_start[made.hinge_body]
    q[at[kinds == "phi"]], q[at[kinds == "psi"]] = np.deg2rad(-70.0), np.deg2rad(100.0)
    x = pose(made, q).x.copy()
    tail = s.atom_residue >= 9
    x[tail] += x[s.atom_residue < 6].mean(axis=0) - x[tail].mean(axis=0)
    return s.with_positions(x)


STARTS: dict[str, Callable[[], Structure]] = {
    "extended": extended, **{f"flat, {d:g} degrees": partial(flat, d) for d in (0.0, 180.0)},
    **{f"moved by {a:g} angstrom": partial(shaken, a) for a in (0.05, 0.25, 1.0, 2.0)},
    **{f"turned by {d:g} degrees": partial(turned, d) for d in (5.0, 45.0, 180.0)},
    "hydrogens on one point": on_one_point, "hydrogens missing": without_hydrogens,
    "a ring threaded": threaded, "through its own loop": knotted,
    "two chains through one another": lambda: copies(peptide("AAAA"), 2, (0.02, 0.0, 0.0)),
    "a hundred residues": hundred,
}  # fmt: skip


@cache
def _start(name: str, threads: int) -> tuple[Chain, Energy]:
    structure = STARTS[name]()
    return build_chain(structure), energy(structure, engine="native", threads=threads)


def minimised(start: str, method: str, threads: int) -> Found:
    """Run a method twice, and hold what it says against the Reference platform."""
    chain, ours = _start(start, threads)
    with catch_warnings():
        simplefilter("ignore")
        runs = [
            minimise(chain, ours, method, _TOLERANCE, _EVALUATIONS, curvature=False, seed=1) for _ in range(2)
        ]
    first, second = runs
    problems = list(_problems(first, second, chain, ours))
    message = "; ".join(problems) or f"{first.status}, {first.n_evaluations} evaluations"
    before = ours.reference(chain.structure.positions)[0]
    after = ours.reference(first.x)[0]
    # What is not worse than the start by the judge is so by the Reference platform, to the rounding of a
    # superposed copy: a spring of 5e5 kJ/mol/nm^2 feels its atoms' rounding.
    worse = (after - before) / max(1.0, abs(before)) if np.isfinite(before) else 0.0
    error = np.nan if problems else max(worse, 0.0)
    return Found(error, 1e-9, "the Reference platform, and a second run", message)


def _problems(first: Solution, second: Solution, chain: Chain, ours: Energy) -> Iterator[str]:
    """What a run says that is not so."""
    if not np.isfinite(first.x).all():
        yield "positions are not finite"
        return
    value, forces = ours.reference(first.x)
    if abs(value - first.end.energy) > 1e-9 * max(1.0, abs(value)):
        yield f"its energy is {value:.10g}, not {first.end.energy:.10g} kJ/mol"
    if first.status is Status.CONVERGED and not _left(first, forces) <= _TOLERANCE * (1 + 1e-6):
        yield f"converged with {_left(first, forces):.3g} left"
    if first.n_evaluations > 2 * _EVALUATIONS:
        yield f"{first.n_evaluations} evaluations of {_EVALUATIONS}"
    if not np.array_equal(first.x, second.x) or first.status != second.status:
        yield f"not repeated: {np.abs(first.x - second.x).max():.3g} nm apart"


def _left(solution: Solution, forces: Floats) -> float:
    """Largest torque, or RMS force where all atoms move: computed here, not by the judge's code."""
    if not solution.recipe.keeps_geometry:
        return float(np.sqrt(np.mean(forces**2)))
    chain, x = solution.chain, solution.x
    arms = []
    for hinge, body in zip(chain.hinges, chain.hinge_body.tolist(), strict=True):
        beyond = {body}
        for b in range(body + 1, chain.n_bodies):
            if int(chain.tree.parent[b]) in beyond:
                beyond.add(b)
        out = np.isin(chain.atom_body, list(beyond))
        axis = x[hinge.atoms[2]] - x[hinge.atoms[1]]
        axis /= np.linalg.norm(axis)
        moments = np.cross(x[out] - x[hinge.atoms[1]], forces[out]).sum(axis=0)
        arms.append(abs(float(moments @ axis)))
    return max(arms)


SADDLES: dict[str, Callable[[], Structure]] = {
    **{f"GGGG, all dihedrals {d:g} degrees": partial(flat, d) for d in (0.0, 180.0)},
    **{name: partial(peptide, name) for name in ("YGGFM", "WKLFGE", "DRVYIHPF")},
}
"""The last three have a second eigenvalue that is found sooner than the lowest."""


def curved(start: str, method: str, threads: int) -> Found:
    """Eigenvalue that a run in torsions ends with, against the Hessian of the Reference platform's torques.

    An end that has converged must have no eigenvalue below minus the tolerance: from a flat start, at which
    torques vanish by symmetry, the run must go on.
    """
    structure = SADDLES[start]()
    chain, ours = build_chain(structure), energy(structure, engine="native", threads=threads)
    with catch_warnings():
        simplefilter("ignore")
        done = minimise(chain, ours, method, 0.1, 3000, seed=1)
    if done.status is not Status.CONVERGED:
        left = _left(done, ours.reference(done.x)[1])
        return Found(
            0.0 if left > 0.1 else np.nan, 0.0, "Reference torques", f"{done.status}, {left:.3g} left"
        )
    if done.lowest_eigenvalue is None:
        return Found(np.nan, 0.0, "an eigenvalue", "converged without an eigenvalue")
    lowest = float(np.linalg.eigvalsh(_hessian(done, ours))[0])
    note = f"{done.status}, {done.lowest_eigenvalue:.4g} found, {lowest:.4g} kJ/mol/rad^2"
    if lowest < -0.1 * (1 + 1e-3):
        return Found(np.nan, 0.0, "converged at a saddle point", note)
    # Davidson's search ends when a vector lowers the estimate by less than half a per cent, as would the
    # next; the second eigenvalue, which it might take for the lowest, is farther.
    error = abs(done.lowest_eigenvalue - lowest) / max(1.0, abs(lowest))
    return Found(error, 0.05, "Hessian by differences of Reference torques", note)


def _hessian(solution: Solution, ours: Energy) -> Floats:
    chain, h, columns = solution.chain, 1e-4, []
    for k in chain.tree.q_start[chain.hinge_body]:
        ends = []
        for sign in (1.0, -1.0):
            q = solution.q.copy()
            q[k] += sign * h
            at = pose(chain, q)
            ends.append(pull_back(chain, at, ours.reference(at.x)[1]))
        columns.append((ends[1] - ends[0]) / (2 * h))
    hessian = np.array(columns)
    return 0.5 * (hessian + hessian.T)


def _cases() -> Iterator[Case]:
    for start in STARTS:
        for method in METHODS:
            check = partial(minimised, start, method)
            tested = start in ("extended", "moved by 2 angstrom") and method in ("lbfgs", "hybrid", "kcm")
            slow = start.startswith(("through", "two", "a hundred")) or method in ("openmm", "md")
            part = Part.TESTED if tested else Part.FULL if slow else Part.QUICK
            # OpenMM's CPU platform adds its forces in any order on several threads, and does not repeat.
            if method == "openmm":
                yield case(start, method, check, 1, part=part)
            else:
                yield Case(start, method, check, part)
    for start in SADDLES:
        for method in METHODS:
            part = Part.QUICK if method in ("newton", "lbfgs") else Part.FULL
            if recipe_of(method).keeps_geometry and method not in ("md", "fire"):
                yield Case("end of a run", f"{start}, {method}", partial(curved, start, method), part)


CASES = tuple(_cases())
