"""Starts and methods of the study of KCM against dynamics, and one run: a row of the study's table.

All methods of a case start from the same positions, and none resolves clashes: those that a perturbation
makes are resolved before. A root is free where masses move, since a fixed one is a body of infinite mass;
methods called ``-fixed`` have such a root, and differ in nothing else. Those called ``-first``, ``-middle``
and ``-last`` fix another body, a peptide plane. A run goes on in legs, each to twice the evaluations of the
one before, with the state that it has. After each its end is polished by ``lbfgs`` in the same torsions, off
saddle points and shoulders. A run is finished if no more than ``LEFT`` kJ/mol, kinetic energy included, is
left to the polished end, and if the leg before led there too: so its continuation, by as many
evaluations again, has been looked at.
"""

import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from functools import lru_cache, partial
from itertools import product
from pathlib import Path
from time import perf_counter
from typing import Any

import gemmi
import numpy as np

from protochain.chains.articulate import build_chain
from protochain.chains.chain import Chain, pose
from protochain.core import defaults
from protochain.core.arrays import Floats
from protochain.core.errors import ProtochainError, StrayWarning
from protochain.energies import energy
from protochain.mechanics import multibody
from protochain.minimisers import RECIPES, Recipe, Run, Solution, Status
from protochain.minimisers.annealing import Annealing, AnnealingState
from protochain.minimisers.entropy_bound import EntropyBound, MetricName
from protochain.minimisers.kcm import Proportional
from protochain.minimisers.loop import Ending, Snapshot, Stop, run
from protochain.minimisers.minimise_structure import Minimisation, minimise_from
from protochain.minimisers.problem import Evaluation, Problem, Tally
from protochain.minimisers.recipes import at_angle
from protochain.minimisers.spaces import Torsions
from protochain.minimisers.start import Start
from protochain.minimisers.starts import perturb_dihedrals
from protochain.structure import Structure, from_sequence, load
from protochain.structure.molecule.residues import CHI, SYMMETRIC
from protochain.structure.superpose import rmsd_angstrom

PEPTIDES = {
    "met-enkephalin": "YGGFM", "ala10": "AAAAAAAAAA", "chignolin": "GYDPETGTWG", "ala2": "AA",
    "rgds": "RGDS", "tuftsin": "TKPR", "thymopentin": "RKDVY", "proctolin": "RYLPT", "yigsr": "YIGSR",
    "ikvav": "IKVAV", "neurotensin-8-13": "RRPYIL", "kemptide": "LRRASLG", "abeta-16-22": "KLVFFAE",
    "gnnqqny": "GNNQQNY", "casomorphin": "YPFPGPI", "angiotensin-ii": "DRVYIHPF",
    "bradykinin": "RPPGFSPFR", "dynorphin-1-8": "YGGFLRRI", "dsip": "WAGGDASGE",
}  # fmt: skip
"""Sequences, without disulfides; all but the first three were chosen before anything ran on them."""
MODELS = ("phi psi chi", "phi psi")
"""Side chains that turn, and the backbone alone, with rigid side chains."""
ENERGIES: Mapping[str, Mapping[str, Any]] = {
    "obc2": {"solvent": "obc2"}, "vacuum": {"solvent": "vacuum"},
    "nonbonded": {"solvent": "vacuum", "terms": "nonbonded"},
}  # fmt: skip
"""ff14SB with and without solvent, and its electrostatics and van der Waals alone, as of ProtoFold."""
N_STARTS = 1
"""Perturbed starts of each kind, beside the one that is not."""
SPREAD: Mapping[str, float] = {"perturbed": 0.1, "extended": 0.5}
"""rad. Standard deviation of a dihedral: a folded chain soon overlaps."""
SMALL = 16
"""Residues up to which a structure is also perturbed, and started from its extended chain, and all run."""
TINY = 7
"""Residues up to which frictions of 0.1 and 100 per ps, other energies and other models are run."""

LEFT = 1.0
"""kJ/mol above its minimum at which a run may stop."""
FIRST, MOST = 1000, 128_000
"""Evaluations of the first leg, and at most."""
SAME_DEGREES, SAME_KJ_MOL = 10.0, 0.1
"""Largest difference of a torsion, and of the energy: two polished ends that differ less are one minimum. A
freedom as soft as 0.5 kJ/mol/rad^2 is left within 1.2 degrees of its minimum by the polish."""
POLISH, POLISHED = 0.01, 5000
"""kJ/mol/rad, and evaluations at most, of the polish."""
NUDGE = 1e-9
"""rad. Standard deviation by which the starts of the ``-nudged`` methods differ: another order of sums."""
AT = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10_000, 20_000, 50_000, 100_000)
"""Evaluations at which the lowest energy so far is noted."""
KEY = ("protein", "model", "energy", "start", "seed", "method", "max_evaluations")
"""Columns that tell one run from the others."""
_OF_END = (
    "energy_kj_mol", "torque_max_kj_mol_rad", "rmsd_start_angstrom", "rmsd_native_angstrom", "torsions_deg",
)  # fmt: skip
COLUMNS = (
    *KEY, "root", "residues", "atoms", "hinges", "status", "finished", "evaluations", "seconds",
    "energy_start_kj_mol", "end_kj_mol", "left_kj_mol", "evaluations_to_left", "polish_status",
    "lowest_eigenvalue_kj_mol_rad2", *_OF_END, *(f"energy_at_{n}" for n in AT),
)  # fmt: skip
"""Those of the table of runs. ``end_kj_mol`` is where the run itself stopped, ``left_kj_mol`` what it
had left, kinetic energy included; ``energy_kj_mol`` and what follows are of the polished end.
``energy_at_N`` is the lowest energy within N evaluations."""
TIME_STEPS: Mapping[float, float] = {0.1: 0.002, 1: 0.0005, 10: 0.016, 100: 0.016}
"""ps, by friction in 1/ps: the more friction, the slower the chain, and the longer the step may be. The limit
of large friction is ``kcm-metric``, which moves along M^-1 tau, without inertia. Without friction the energy
stays, and dynamics leads to no minimum."""


METRICS: tuple[MetricName, ...] = ("positions", "mass")
BOUNDS = (0.1, 0.03, 0.01)
"""nm/rad: bounds of ``kcm-0.005`` in these metrics. In ``positions`` its own steps have 0.03 to 0.4."""

BODIES: Mapping[str, Callable[[int], int]] = {
    "first": lambda n: 1, "middle": lambda n: n // 2, "last": lambda n: n - 1,
}  # fmt: skip
"""Peptide planes that are fixed instead of the middle C-alpha: number of the first of the two residues, of so
many residues. The middle plane is the one before the middle residue."""
OF_BODIES = ("kcm-metric", "md-10")
"""Methods that also run with these bodies fixed, from extended peptides."""


@dataclass(frozen=True)
class Trial:
    """A method as the study runs it.

    recipe: Its run is continued.
    nudged: Whether its start is moved by ``NUDGE``.
    root: As of :func:`protochain.build_chain`.
    body: Of ``BODIES``, the root body; by default that of the middle C-alpha.
    """

    recipe: Recipe
    nudged: bool = False
    root: str = "auto"
    body: str = ""


def _dynamics(friction: float) -> Recipe:
    annealing = Annealing(n_steps=10 * MOST, friction=friction, time_step=TIME_STEPS[friction])
    return Recipe(f"md-{friction:g}", (Run(annealing),))


def _bounded(metric: MetricName, bound: float) -> Recipe:
    (run,) = at_angle(RECIPES["kcm"], 0.005).runs
    method: Any = run.method
    bounded = replace(method, direction=EntropyBound(rate=bound, within=metric))
    return Recipe(f"entropy-{metric}-{bound:g}", (replace(run, method=bounded),))


def halved(recipe: Recipe) -> Recipe:
    """Recipe with half the time step, compliance, or angle, where that adapts the first one."""
    (run,) = recipe.runs
    method: Any = run.method
    if isinstance(method, Annealing):
        method = replace(method, time_step=0.5 * method.time_step)
    elif isinstance(method.direction, Proportional):
        method = replace(method, direction=replace(method.direction, safety=0.5 * method.direction.safety))
    else:
        method = replace(method, rule=replace(method.rule, length=0.5 * method.rule.length))
    return replace(recipe, runs=(replace(run, method=method),))


def _trials() -> dict[str, Trial]:
    found = {"kcm-0.005": Trial(at_angle(RECIPES["kcm"], 0.005))}
    found |= {
        f"kcm-{name}": Trial(RECIPES[f"kcm-{name}"])
        for name in ("proportional", "sign", "adaptive", "stiffness", "metric")
    }
    bounded = [_bounded(metric, bound) for metric, bound in product(METRICS, BOUNDS)]
    found |= {recipe.name: Trial(recipe) for recipe in bounded}
    found |= {f"md-{friction:g}": Trial(_dynamics(friction)) for friction in TIME_STEPS}
    found |= {f"{name}-fixed": replace(found[name], root="fixed") for name in OF_BODIES}
    found |= {
        f"{name}-{body}": replace(found[name], root="fixed", body=body)
        for name in OF_BODIES
        for body in BODIES
    }
    controls = {}
    for name, trial in found.items():
        controls[f"{name}-half"] = replace(trial, recipe=halved(trial.recipe))
        controls[f"{name}-nudged"] = replace(trial, nudged=True)
    return found | controls | {"lbfgs": Trial(replace(RECIPES["lbfgs"], parts_overlaps=False))}


TRIALS: Mapping[str, Trial] = _trials()
METHODS = (*TRIALS, "openmm")
"""All in torsions but the last, OpenMM's minimiser, which moves all atoms and is no part of any contrast."""
CONTROLS = {"half the step": "half", "another order of sums": "nudged"}
"""Ends of the names of controls: what should not matter."""


def runs_of(n_residues: int, energy: str, is_first: bool = False) -> tuple[str, ...]:
    """Methods that run for a structure. Methods that would need hours, or would not end, are skipped.

    Other fixed bodies and bounds run only from the first extended start of a peptide.
    """
    wanted = {_base(name) for name in METHODS}
    if n_residues > SMALL or energy != "obc2":
        wanted = {"kcm-stiffness", "kcm-metric", "md-10", "lbfgs"}
    if energy != "obc2":
        wanted |= {"kcm-0.005", "kcm-adaptive", "md-1"}
    elif n_residues > TINY:
        wanted -= {"md-0.1", "md-100"}
    few = n_residues > SMALL
    return tuple(
        name
        for name in METHODS
        if _base(name) in wanted
        and not (few and name.endswith(("-nudged", "-fixed-half")))
        and (is_first or not (fixes_plane(name) or name.startswith("entropy-")))
    )


def fixes_plane(method: str) -> bool:
    """Whether a method fixes a body of ``BODIES``."""
    return method in TRIALS and bool(TRIALS[method].body)


def _base(name: str) -> str:
    """Method that another one is a control of, or has a fixed root of."""
    stem, _, end = name.rpartition("-")
    return _base(stem) if end in {*CONTROLS.values(), "fixed", *BODIES} else name


_POLISHER = replace(RECIPES["lbfgs"], name="polish", parts_overlaps=False)


@dataclass(frozen=True)
class Case:
    """A start: a protein, a model of it, and where its dihedrals begin.

    protein: Name.
    source: Sequence, or path of a file.
    model: Kinds of hinges.
    energy: Of ``ENERGIES``.
    start: ``deposited``, ``perturbed`` or ``extended``.
    seed: Of the perturbation; 0 is none.
    """

    protein: str
    source: str
    is_file: bool
    model: str
    energy: str
    start: str
    seed: int

    def key(self) -> dict[str, Any]:
        """What tells this start from others, as columns of the table."""
        return {k: v for k, v in asdict(self).items() if k not in ("source", "is_file")}


def proteins(inputs: tuple[Path, ...]) -> list[tuple[str, str, bool]]:
    """Name, source, and whether it is a file: the peptides, then the files given."""
    return [(name, sequence, False) for name, sequence in PEPTIDES.items()] + [
        (path.stem, str(path), True) for path in inputs
    ]


def cases(
    chosen: list[tuple[str, str, bool]], models: tuple[str, ...], energies: tuple[str, ...], n_starts: int
) -> list[tuple[Case, tuple[str, ...]]]:
    """Starts of the study and their methods: first starts of the first model first, small ones before large.

    Up to ``TINY`` residues there are other energies and models, of the first start.
    """
    found: list[tuple[tuple[int, ...], Case, tuple[str, ...]]] = []
    for name, source, is_file in chosen:
        structure = _prepared(source, is_file)
        is_small = structure.n_residues <= SMALL
        kinds = {"deposited": range(1)} if is_file else {}
        if is_file and is_small:
            kinds["perturbed"] = range(1, n_starts + 1)
        if not is_file or (is_small and _sequence(structure)):
            kinds["extended"] = range(n_starts + 1)
        for kind, seeds in kinds.items():
            for seed, (m, model), (k, each) in product(seeds, enumerate(models), enumerate(energies)):
                if m + k and (seed or (m and k) or structure.n_residues > TINY):
                    continue
                order = (m + (kind == "extended" and seed > 0), structure.n_atoms * (1 + seed))
                case = Case(name, source, is_file, model, each, kind, seed)
                is_first = is_small and kind == "extended" and not (seed or m or k)
                found.append((order, case, runs_of(structure.n_residues, each, is_first)))
    return [(case, methods) for _, case, methods in sorted(found, key=lambda each: each[0])]


def measured(case: Case, method: str, most: int = MOST) -> dict[str, Any]:
    """One run, its continuation and its polish, as a row of the table; a run that is refused says why."""
    row = {**case.key(), "method": method, "max_evaluations": most}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", StrayWarning)
            trial = TRIALS.get(method)
            start = started(case, trial.root, trial.body).of(trial.recipe) if trial else started(case)
            found = _by_openmm(start, most) if method == "openmm" else _continued(start, case, method, most)
    except ProtochainError as error:
        return {**row, "status": f"refused: {error}"}
    chain = start.chain
    return {
        **row, "root": chain.root, "residues": chain.structure.n_residues,
        "atoms": chain.structure.n_atoms, "hinges": chain.n_hinges,
        "energy_start_kj_mol": start.judgement.energy, **found.columns(), **_end(found.polished, case),
    }  # fmt: skip


@dataclass(frozen=True, eq=False)
class Found:
    """How a run went: its polished end, and what it did until it stopped."""

    polished: Solution
    status: str
    finished: bool
    evaluations: int
    seconds: float
    end: float
    left: float
    trace: tuple[tuple[int, float], ...]
    """Evaluations, lowest energy so far."""

    def columns(self) -> dict[str, Any]:
        """Columns of the run itself."""
        n, lowest = (np.array(each) for each in zip(*self.trace, strict=True))
        place = np.maximum(np.searchsorted(n, AT, side="right") - 1, 0)
        near = lowest <= self.polished.end.energy + LEFT
        return {
            "status": self.status, "finished": self.finished, "evaluations": self.evaluations,
            "seconds": round(self.seconds, 4), "end_kj_mol": self.end, "left_kj_mol": self.left,
            "evaluations_to_left": int(n[near][0]) if near.any() else np.nan,
            "polish_status": str(self.polished.status),
            "lowest_eigenvalue_kj_mol_rad2": self.polished.lowest_eigenvalue,
            **{f"energy_at_{k}": float(e) for k, e in zip(AT, lowest[place], strict=True)},
        }  # fmt: skip


Note = Callable[[Evaluation, int], None]
"""Told of each point, and of the evaluations so far."""


def legs(start: Start, q: Floats, trial: Trial, most: int, note: Note) -> Iterator[tuple[Ending, int]]:
    """Continue a method in legs, each to twice the evaluations; yield their endings, and the evaluations."""
    space = Torsions(start.chain)
    resume: Snapshot | None = None
    n = 0
    (own,) = trial.recipe.runs
    limit = FIRST
    while True:
        problem = Problem(space, start.reduced_energy, min(limit, most))
        problem.restore(Tally(n), start.pose.x)
        ending = run(problem, own.method, q, 0.1 * POLISH, most, partial(_noted, problem, note), resume)
        if ending.stop is Stop.INTERRUPTED:
            raise KeyboardInterrupt
        n, resume = problem.n_evaluations, ending.last
        yield ending, n
        if ending.stop is not Stop.BUDGET or n >= most:
            return
        limit = 2 * limit


def _noted(problem: Problem, note: Note, at: Evaluation) -> None:
    note(at, problem.n_evaluations)


def _continued(start: Start, case: Case, method: str, most: int) -> Found:
    """Run a method until it is finished, stops by itself, or has used up its evaluations."""
    trial, chain = TRIALS[method], start.chain
    start.warm(trial.recipe)
    q = chain.q0
    if trial.nudged:
        random = np.random.default_rng([case.seed, 37])
        q = Torsions(chain).move(q, NUDGE * random.standard_normal(chain.n_v))
    trace: list[tuple[int, float]] = []

    def note(at: Evaluation, n: int) -> None:
        # Parts of the energy that are constant in the chain are in it, as in every energy of the table.
        trace.append((n, min(at.energy, trace[-1][1] if trace else np.inf)))

    seconds, before, since = 0.0, None, perf_counter()
    for ending, n in legs(start, q, trial, most, note):
        seconds += perf_counter() - since
        at = ending.last.state.at
        polished = polish(start, at.q)
        left = at.energy + kinetic_energy(chain, ending.last.state) - polished.end.energy
        stays = ending.stop is not Stop.BUDGET or (before is not None and one_minimum(before, polished))
        finished = left <= LEFT and stays
        circles = not isinstance(ending.last.state, AnnealingState) and _circles(trace, n)
        status = "finished" if finished else "circling" if circles else ending.stop.name.lower()
        before = polished
        if finished or status == "circling":
            break
        since = perf_counter()
    return Found(polished, status, finished, n, seconds, at.energy, left, tuple(trace))


def _circles(trace: list[tuple[int, float]], n: int) -> bool:
    """Whether the last half of the evaluations, 1000 at least, found next to nothing lower."""
    half = next(energy for k, energy in reversed(trace) if k <= n // 2)
    return n > 2 * FIRST and half - trace[-1][1] < 0.01 * LEFT


def kinetic_energy(chain: Chain, state: Any) -> float:
    """Kinetic energy of a state, kJ/mol."""
    if not isinstance(state, AnnealingState):
        return 0.0
    frames = multibody.pose(chain.tree, state.at.q)
    return 0.5 * float(state.velocity @ multibody.multiply_mass(chain.tree, frames, state.velocity))


def polish(start: Start, q: Floats) -> Solution:
    """Minimum below an end, with a fixed root, whatever the method has."""
    structure = start.chain.structure.with_positions(pose(start.chain, q).x)
    chain = build_chain(structure, start.chain.opened, "fixed")
    polish = Minimisation(_POLISHER, tolerance=POLISH, max_evaluations=POLISHED)
    found = minimise_from(Start(chain, start.energy), polish)
    if found.status is Status.INTERRUPTED:
        raise KeyboardInterrupt
    return found


def one_minimum(a: Solution, b: Solution) -> bool:
    """Whether two polished ends are one minimum."""
    return same_minimum(torsions(a), torsions(b), a.end.energy - b.end.energy)


def same_minimum(a: Floats, b: Floats, rise: float) -> bool:
    """Whether two ends are one minimum, by their torsions in degrees and how far one is above the other."""
    apart = np.abs((a - b + 180.0) % 360.0 - 180.0)
    return bool(np.max(apart, initial=0.0) < SAME_DEGREES and abs(rise) < SAME_KJ_MOL)


def torsions(solution: Solution) -> Floats:
    """Torsions (n_hinges,) of an end, degrees; doubled where half a turn exchanges two equal groups."""
    chain, q = solution.chain, solution.q[solution.chain.tree.q_start[solution.chain.hinge_body]]
    last = [h.residue_name in SYMMETRIC and h.kind == f"chi{len(CHI[h.residue_name])}" for h in chain.hinges]
    ends = chain.structure.residue_chain_index[1:] != chain.structure.residue_chain_index[:-1]
    terminal = set(np.flatnonzero([*ends, True]).tolist())
    of = chain.structure.atom_residue
    carboxylate = [h.kind == "psi" and int(of[h.atoms[1]]) in terminal for h in chain.hinges]
    return np.rad2deg(q) * np.where(np.logical_or(last, carboxylate), 2.0, 1.0)


def _by_openmm(start: Start, most: int) -> Found:
    """OpenMM's minimiser; its end is polished in the torsions of a chain rebuilt there."""
    if "nonbonded" in start.energy.forcefield:
        raise ProtochainError("OpenMM moves all atoms, which bonded terms hold")
    raw = minimise_from(start, Minimisation(RECIPES["openmm"], tolerance=10.0, max_evaluations=most))
    if raw.status is Status.INTERRUPTED:
        raise KeyboardInterrupt
    made = build_chain(raw)
    polished = polish(Start(made, start.energy), made.q0)
    rows = raw.trace[["evaluations", "energy_kj_mol"]].to_numpy()
    lowest = np.minimum.accumulate(rows[:, 1])
    return Found(
        polished, str(raw.status), raw.status is Status.CONVERGED, raw.n_evaluations, raw.seconds,
        raw.end.energy, raw.end.energy - polished.end.energy,
        tuple((int(n), float(e)) for n, e in zip(rows[:, 0], lowest, strict=True)),
    )  # fmt: skip


def _end(solution: Solution, case: Case) -> dict[str, Any]:
    """Columns of a polished end."""
    structure = started(case).chain.structure
    alpha = structure.alpha_carbons
    here, native = solution.x[alpha], _native(case)
    values = (
        solution.end.energy,
        solution.end.max_torque,
        rmsd_angstrom(here, structure.positions[alpha]),
        np.nan if native is None else rmsd_angstrom(here, native),
        " ".join(f"{each:.1f}" for each in torsions(solution)),
    )
    return dict(zip(_OF_END, values, strict=True))


def traced(case: Case, method: str, most: int) -> list[dict[str, Any]]:
    """Energy and C-alpha RMSD to the start along a run of so many evaluations, as the papers draw them."""
    trial = TRIALS[method]
    start = started(case, trial.root, trial.body).of(trial.recipe)
    start.warm(trial.recipe)
    alpha, x = start.chain.structure.alpha_carbons, start.chain.structure.positions
    rows: list[dict[str, Any]] = []

    def note(at: Evaluation, n: int) -> None:
        if not rows or n >= 1.05 * rows[-1]["evaluations"]:
            apart = rmsd_angstrom(at.x[alpha], x[alpha])
            rows.append(
                {**case.key(), "method": method, "evaluations": n, "energy_kj_mol": at.energy,
                 "ca_rmsd_angstrom": apart}
            )  # fmt: skip

    for _, n in legs(start, start.chain.q0, trial, most, note):
        if n >= most:
            break
    return rows


@lru_cache(maxsize=4)
def started(case: Case, root: str = "auto", body: str = "") -> Start:
    structure = _prepared(case.source, case.is_file)
    if case.is_file and case.start == "extended":
        structure = _prepared(_sequence(structure), False)
    chain = build_chain(structure, case.model)
    if case.seed:
        chain = perturb_dihedrals(chain, SPREAD[case.start], np.random.default_rng([case.seed, 22]))
    if root != "auto":
        # The oxygen is the third atom of no hinge: all hinges turn, and its body is the root.
        number = BODIES[body](structure.n_residues) if body else 0
        move = f"not (resid {number} and name O)" if body else defaults.MOVE
        chain = build_chain(chain.structure, case.model, root, move=move)
    return Start(chain, energy(structure, threads=1, **ENERGIES[case.energy]))


@lru_cache(maxsize=16)
def _prepared(source: str, is_file: bool) -> Structure:
    return load(source) if is_file else from_sequence(source)


def _native(case: Case) -> Floats | None:
    """C-alphas of the file."""
    if not case.is_file:
        return None
    structure = _prepared(case.source, True)
    return structure.positions[structure.alpha_carbons]


def _sequence(structure: Structure) -> str:
    """One-letter codes; empty where a residue is none of the standard twenty, or with several chains."""
    if structure.n_chains > 1:
        return ""
    known = [gemmi.find_tabulated_residue(str(name)) for name in structure.residue_name]
    letters = "".join(each.one_letter_code for each in known)
    return letters if letters.isupper() and letters.isalpha() else ""
