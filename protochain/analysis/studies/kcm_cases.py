"""Cases of the study of KCM against dynamics, its methods, and one run: a row of the study's table.

All methods of a case start from one chain, and none parts overlaps: those that a perturbation makes are
parted before. A run ends at a largest torque of 1 kJ/mol/rad, when it stagnates, or when its evaluations are
used up. Its end is then polished by ``lbfgs`` in the same torsions, to 0.01 kJ/mol/rad, off saddle points.
OpenMM moves all atoms; its end is polished in the torsions of a chain rebuilt there.
"""

import warnings
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import gemmi
import numpy as np

from protochain.articulate import build_chain
from protochain.chain import Chain, pose
from protochain.core import defaults
from protochain.core.arrays import Floats
from protochain.core.errors import ProtochainError, StrayWarning
from protochain.energies import energy
from protochain.minimisers import RECIPES, Recipe, Run, Solution, Status
from protochain.minimisers.annealing import Annealing
from protochain.minimisers.api import Minimisation, minimise_from
from protochain.minimisers.problem import evaluate
from protochain.minimisers.recipes import at_angle
from protochain.minimisers.spaces import Torsions
from protochain.minimisers.stages import last
from protochain.minimisers.start import Start
from protochain.minimisers.starts import perturbed
from protochain.structure import Structure, from_sequence, load
from protochain.structure.superpose import rmsd_angstrom

PEPTIDES = {"met-enkephalin": "YGGFM", "ala10": "AAAAAAAAAA", "chignolin": "GYDPETGTWG"}
MODELS = ("phi psi", "phi psi chi")
"""Backbone alone, with rigid side chains, and with side chains that turn."""
SOLVENTS = ("vacuum", "obc2")
N_STARTS = 20
"""Perturbed starts of each kind, beside the one that is not."""
SPREAD: Mapping[str, float] = {"perturbed": 0.1, "extended": 0.5}
"""rad. Standard deviation of a dihedral: a folded chain soon overlaps."""
EXTENDED_UP_TO = 20
"""Residues up to which a structure given as a file is also started from its extended chain."""

MOST = 20_000
PATIENCE = 1000
"""Evaluations without a new lowest energy after which a run has stagnated: 4 ps of dynamics."""
POLISH, POLISHED = 0.01, 5000
"""kJ/mol/rad, and evaluations at most, of the polish."""
AT = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10_000, 20_000)
"""Evaluations at which the lowest energy so far is noted."""
KEY = ("protein", "model", "solvent", "start", "seed", "method", "max_evaluations")
"""Columns that tell one run from the others."""
_OF_END = (
    "energy_kj_mol", "torque_max_kj_mol_rad", "torque_rms_kj_mol_rad", "rmsd_start_angstrom",
    "rmsd_native_angstrom", "alphas_pm",
)  # fmt: skip
COLUMNS = (
    *KEY, "residues", "atoms", "hinges", "status", "evaluations", "seconds", "energy_start_kj_mol", *_OF_END,
    "polish_status", "polish_evaluations", "lowest_eigenvalue_kj_mol_rad2",
    *(f"polished_{name}" for name in _OF_END), *(f"energy_at_{n}" for n in AT),
)  # fmt: skip
"""Those of the table of runs. ``energy_at_N``: the lowest energy within N evaluations."""
FRICTIONS = (1, 10, 100)
"""1/ps. The limit of large friction is ``kcm-metric``, which moves along M^-1 tau, without inertia."""
COOLED = 10_000
"""Steps of 4 fs from 300 K to 0, after which dynamics goes on at 0 K."""


def _alone(name: str, *runs: Run) -> Recipe:
    return Recipe(name, tuple(replace(run, patience=PATIENCE) for run in runs))


def _dynamics(friction: float) -> Run:
    return Run(Annealing(n_steps=10 * MOST, friction=friction))


def _methods() -> dict[str, Recipe]:
    angles = [at_angle(RECIPES["kcm"], angle) for angle in (0.0005, 0.005, 0.01, 0.05)]
    names = ("proportional", "sign", "adaptive", "metric", "stiffness")
    cooling = replace(_dynamics(10.0), method=Annealing(300.0, COOLED, 10.0), tolerance=0.0, answer=last)
    found = [_alone(each.name, *each.runs) for each in (*angles, *(RECIPES[f"kcm-{n}"] for n in names))]
    found += [_alone(f"md-{friction}", _dynamics(friction)) for friction in FRICTIONS]
    cooled = _alone("md-cooled", cooling, _dynamics(10.0))
    held = replace(cooled.runs[0], patience=COOLED)
    found.append(replace(cooled, runs=(held, *cooled.runs[1:]), draws_random=True))
    return {each.name: each for each in (*found, _alone("lbfgs", *RECIPES["lbfgs"].runs), RECIPES["openmm"])}


METHODS: Mapping[str, Recipe] = _methods()
_POLISH = replace(RECIPES["lbfgs"], name="polish", parts_overlaps=False)


@dataclass(frozen=True)
class Case:
    """A start: a protein, a model of it, and where its dihedrals begin.

    Parameters
    ----------
    protein : str
        Name.
    source : str
        Sequence, or path of a file.
    is_file : bool
    model : str
        Kinds of hinges.
    solvent : str
    start : str
        ``deposited``, ``perturbed`` or ``extended``.
    seed : int
        Of the perturbation; 0 is none.
    """

    protein: str
    source: str
    is_file: bool
    model: str
    solvent: str
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
    chosen: list[tuple[str, str, bool]], models: tuple[str, ...], solvents: tuple[str, ...], n_starts: int
) -> list[Case]:
    """Starts of the study, the cheapest first.

    A later start of a protein counts as costlier than its first, in proportion, so that the first ones of
    large proteins come before the last ones of small ones.
    """
    found: list[tuple[int, Case]] = []
    for name, source, is_file in chosen:
        structure = _prepared(source, is_file)
        kinds = ["deposited", "perturbed"] if is_file else []
        if not is_file or (structure.n_residues <= EXTENDED_UP_TO and _sequence(structure)):
            kinds.append("extended")
        for kind in kinds:
            seeds = {"deposited": range(1), "perturbed": range(1, n_starts + 1)}.get(
                kind, range(n_starts + 1)
            )
            for seed in seeds:
                weight = structure.n_atoms * (1 + seed)
                found += [
                    (weight, Case(name, source, is_file, model, solvent, kind, seed))
                    for model in models
                    for solvent in solvents
                ]
    return [case for _, case in sorted(found, key=lambda each: each[0])]


def measured(case: Case, method: str, most: int) -> dict[str, Any]:
    """One run and its polish, as a row of the table; a run that is refused says why."""
    row = {**case.key(), "method": method, "max_evaluations": most}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", StrayWarning)
            start = _started(case)
            run = Minimisation(
                METHODS[method],
                tolerance=defaults.TOLERANCE,
                max_evaluations=most,
                seed=case.seed,
                curvature=False,
            )
            raw = minimise_from(start, run)
            again = Minimisation(_POLISH, tolerance=POLISH, max_evaluations=POLISHED)
            polished = minimise_from(Start(_chain_at(raw), start.energy), again)
        if Status.INTERRUPTED in (raw.status, polished.status):
            raise KeyboardInterrupt
    except ProtochainError as error:
        return {**row, "status": f"refused: {error}"}
    structure = start.chain.structure
    return {
        **row, "residues": structure.n_residues, "atoms": structure.n_atoms, "hinges": start.chain.n_hinges,
        "status": str(raw.status), "evaluations": raw.n_evaluations, "seconds": round(raw.seconds, 4),
        "energy_start_kj_mol": raw.start.energy, **_end(raw, case, ""), "polish_status": str(polished.status),
        "polish_evaluations": polished.n_evaluations,
        "lowest_eigenvalue_kj_mol_rad2": polished.lowest_eigenvalue, **_end(polished, case, "polished_"),
        **_lowest_at(raw),
    }  # fmt: skip


def _end(solution: Solution, case: Case, prefix: str) -> dict[str, Any]:
    """Columns of an end, raw or polished; its C-alphas in pm."""
    structure = _started(case).chain.structure
    alpha = structure.alpha_carbons
    here, native = solution.x[alpha], _native(case)
    space = Torsions(_chain_at(solution))
    # The positions of a solution are superposed on the start; torques about a free root belong to its pose.
    torque = evaluate(space, solution.energy_function, space.chain.q0).torque
    values = (
        solution.end.energy,
        solution.end.max_torque,
        float(np.sqrt(np.mean(torque**2))),
        rmsd_angstrom(here, structure.positions[alpha]),
        np.nan if native is None else rmsd_angstrom(here, native),
        " ".join(map(str, np.rint(1000.0 * here).astype(int).ravel())),
    )
    return {prefix + name: value for name, value in zip(_OF_END, values, strict=True)}


def _lowest_at(solution: Solution) -> dict[str, float]:
    """Lowest energy within so many evaluations; a run that has ended keeps its last."""
    trace = solution.trace
    lowest = np.minimum.accumulate(trace["energy_kj_mol"].to_numpy())
    place = np.searchsorted(trace["evaluations"].to_numpy(), AT, side="right") - 1
    return {f"energy_at_{n}": float(lowest[max(k, 0)]) for n, k in zip(AT, place, strict=True)}


def _chain_at(solution: Solution) -> Chain:
    """Chain at an end: the same bodies, or rebuilt where all atoms moved."""
    chain = solution.chain
    if not solution.keeps_geometry:
        return build_chain(solution.structure, chain.opened, chain.root)
    at = pose(chain, solution.q)
    return replace(chain, structure=chain.structure.with_positions(at.x), q0=at.q)


@lru_cache(maxsize=4)
def _started(case: Case) -> Start:
    structure = _prepared(case.source, case.is_file)
    if case.is_file and case.start == "extended":
        structure = _prepared(_sequence(structure), False)
    chain = build_chain(structure, case.model)
    if case.seed:
        chain = perturbed(chain, SPREAD[case.start], np.random.default_rng([case.seed, 22]))
    return Start(chain, energy(structure, solvent=case.solvent, threads=1))


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
