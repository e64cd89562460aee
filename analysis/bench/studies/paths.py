"""Paths of the methods of the study of KCM: their lengths, largest steps, and the entropy that they lose.

A row of ``paths.csv`` is one path. From the extended peptides it ends at the first point within ``LEFT``
kJ/mol of the minimum to which the finished run leads. From deposited proteins every method gets ``EQUAL``
evaluations. Movements are weighted by mass, after superposition of successive points, so that the motion of
the whole does not count. Rows are added one by one, and those in the table are not repeated.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np
import pandas as pd

from bench.studies import kcm_cases
from bench.studies.kcm_cases import LEFT, MODELS, MOST, TINY, Case
from bench.studies.lowest import append, peptides, stored
from protochain.chains.chain import Chain, pose
from protochain.comparison.hessian import torques_at
from protochain.comparison.unfolding import NativeContacts
from protochain.core.arrays import Floats
from protochain.core.errors import ProtochainError
from protochain.core.units import MOLAR_GAS
from protochain.minimisers import Solution
from protochain.minimisers.loop import Stop
from protochain.minimisers.problem import Evaluation
from protochain.results.tables import save
from protochain.structure.superpose import motion_of, rmsd_angstrom

MINUTES = 30.0
METHODS = (
    "kcm-0.005", "kcm-proportional", "kcm-sign", "kcm-adaptive", "kcm-stiffness", "kcm-metric",
    *(f"entropy-{metric}-{bound:g}" for metric in kcm_cases.METRICS for bound in kcm_cases.BOUNDS),
    "md-0.1", "md-1", "md-10", "md-100", "lbfgs",
)  # fmt: skip
PROTEINS = ("1l2y", "1vii", "1ejg", "4pti", "1orc_icode", "1ubq")
"""Deposited starts, of 20 to 76 residues, if their files are inputs."""
EQUAL = 2000
"""Evaluations of each method from a deposited protein."""
SHOWN = "met-enkephalin"
"""Peptide whose paths are in ``path_points.csv``."""
QUICK = ("ala2", "rgds")
TEMPERATURE = 300.0
"""K."""
KEY = ("protein", "start", "method")
COLUMNS = (
    *KEY, "residues", "hinges", "finished", "evaluations", "energy_kj_mol", "path_rad", "path_nm",
    "largest_step_nm", "entropy_loss_j_mol_k", "ca_rmsd_angstrom", "contacts_share",
)  # fmt: skip
"""``path_rad`` adds up RMS turns of the hinges, ``path_nm`` RMS movements. The energy is that of the polished
end of a peptide, and of the last point of a protein."""


def run(
    output: Path, inputs: Sequence[Path] = (), *, quick: bool = False, minutes: float = MINUTES
) -> Iterator[pd.DataFrame]:
    """Add paths to ``paths.csv``, and write the points of one peptide's paths to ``path_points.csv``."""
    path = output / "paths.csv"
    done = set(stored(path, COLUMNS)[list(KEY)].itertuples(index=False, name=None))
    until = monotonic() + 60.0 * minutes
    cases = [case for case in peptides() if not quick or case.protein in QUICK]
    small = {case.protein for case in cases if kcm_cases.started(case).chain.structure.n_residues <= TINY}
    files = {file.stem: file for file in inputs}
    for name in PROTEINS if files else ():
        if name not in files:
            raise ProtochainError(f"{name}: not among the inputs; give the files of {', '.join(PROTEINS)}")
        cases.append(Case(name, str(files[name]), True, MODELS[0], "obc2", "deposited", 0))
    for case in cases:
        if not (output / "path_points.csv").exists() and case.protein == (QUICK[1] if quick else SHOWN):
            save(output, {"path_points.csv": pd.concat(points(case, method) for method in METHODS)})
        for method in METHODS:
            # Other frictions need hours for larger chains, as in the study itself.
            is_slow = method in ("md-0.1", "md-100") and case.protein not in small
            if is_slow or (case.protein, case.start, method) in done:
                continue
            if monotonic() >= until:
                return
            row = measured_path(case, method)
            append(path, row)
            yield pd.DataFrame([row])


@dataclass
class PathLength:
    """Points of a path, and its length up to each of them."""

    chain: Chain
    evaluations: list[int] = field(default_factory=list)
    energies: list[float] = field(default_factory=list)
    turns: list[float] = field(default_factory=list)
    """RMS turn of each step, rad."""
    movements: list[float] = field(default_factory=list)
    """RMS movement of each step weighted by mass, nm."""
    q: Floats = field(init=False)
    """(n_q,): coordinates of the last point."""
    x: Floats = field(init=False)
    """(na, 3) nm: its positions."""

    def __post_init__(self) -> None:
        self.q, self.x = self.chain.q0, pose(self.chain, self.chain.q0).x

    def note(self, at: Evaluation, n: int) -> None:
        """Add a point after n evaluations."""
        places = self.chain.tree.q_start[self.chain.hinge_body]
        turn = np.mod(at.q[places] - self.q[places] + np.pi, 2.0 * np.pi) - np.pi
        self.turns.append(float(np.sqrt(np.mean(turn**2))))
        self.movements.append(movement(at.x, self.x, self.chain.structure.atom_mass))
        self.q, self.x = at.q, at.x
        self.evaluations.append(n)
        self.energies.append(at.energy)

    def until(self, energy: float) -> int:
        """Index of the first point at or below an energy; of the last point if there is none."""
        below = np.flatnonzero(np.array(self.energies) <= energy)
        return int(below[0]) if len(below) else len(self.energies) - 1


def movement(x: Floats, reference: Floats, masses: Floats) -> float:
    """RMS movement in nm, weighted by masses (na,), between positions (na, 3) after superposition."""
    weights = (masses / masses.sum())[:, None]
    centre, own_centre = (weights * reference).sum(axis=0), (weights * x).sum(axis=0)
    turn, shift = motion_of((weights * (reference - centre)).T @ (x - own_centre), own_centre, centre)
    return float(np.sqrt(np.sum(weights * (x @ turn.T + shift - reference) ** 2)))


def entropy_loss(solution: Solution, energy: Any) -> float:
    """Entropy in J/mol/K that free hinges lose when they vibrate about a minimum.

    The entropy of vibration is R/2 ln det(2 pi e kT H^-1) with the Hessian H in the torsions (Karplus,
    Kushick, Macromolecules 14:325, 1981). Free hinges turn by 2 pi. NaN at a saddle.
    """
    hessian = torques_at(solution.chain, energy, solution.q).matrix(np.arange(solution.chain.n_v))
    curvatures = np.linalg.eigvalsh(hessian)
    if curvatures[0] <= 0.0:
        return float("nan")
    kt = MOLAR_GAS * TEMPERATURE
    vibrating = 0.5 * np.sum(np.log(2.0 * np.pi * math.e * kt / curvatures))
    return float(1000.0 * MOLAR_GAS * (len(curvatures) * np.log(2.0 * np.pi) - vibrating))


def measured_path(case: Case, method: str) -> dict[str, Any]:
    """One path as a row of the table."""
    is_file = case.start == "deposited"
    trial = kcm_cases.TRIALS[method]
    start = kcm_cases.started(case, trial.root, trial.body).of(trial.recipe)
    start.warm(trial.recipe)
    chain = start.chain
    path = PathLength(chain)
    polished: Solution | None = None
    finished = False
    for ending, _ in kcm_cases.legs(start, chain.q0, trial, EQUAL if is_file else MOST, path.note):
        before, at = polished, ending.last.state.at
        if is_file:
            finished = ending.stop is not Stop.BUDGET
            continue
        # The study's criterion: little energy is left, and the leg before led to the same minimum.
        polished = kcm_cases.polish(start, at.q)
        left = at.energy + kcm_cases.kinetic_energy(chain, ending.last.state) - polished.end.energy
        stays = ending.stop is not Stop.BUDGET or (before and kcm_cases.one_minimum(before, polished))
        if finished := bool(left <= LEFT and stays):
            break
    last = len(path.energies) - 1 if polished is None else path.until(polished.end.energy + LEFT)
    structure = chain.structure
    x = path.x if polished is None else polished.x
    alphas = structure.alpha_carbons
    values = (
        case.protein, case.start, method, structure.n_residues, chain.n_hinges, finished,
        path.evaluations[last], path.energies[last] if polished is None else polished.end.energy,
        sum(path.turns[: last + 1]), sum(path.movements[: last + 1]), max(path.movements[: last + 1]),
        np.nan if polished is None else entropy_loss(polished, start.energy),
        rmsd_angstrom(x[alphas], structure.positions[alphas]),
        NativeContacts.of_structure(structure).share(x) if is_file else np.nan,
    )  # fmt: skip
    return dict(zip(COLUMNS, values, strict=True))


def points(case: Case, method: str) -> pd.DataFrame:
    """Energy against path length along one path, thinned to steps of 2 % of the evaluations."""
    trial = kcm_cases.TRIALS[method]
    start = kcm_cases.started(case, trial.root, trial.body).of(trial.recipe)
    path = PathLength(start.chain)
    for _ in kcm_cases.legs(start, start.chain.q0, trial, 4 * EQUAL, path.note):
        pass
    table = pd.DataFrame(
        {"protein": case.protein, "method": method, "evaluations": path.evaluations,
         "energy_kj_mol": path.energies, "path_rad": np.cumsum(path.turns),
         "path_nm": np.cumsum(path.movements)}
    )  # fmt: skip
    shown = np.unique(np.geomspace(1, len(table), 200).astype(int)) - 1
    return table.iloc[shown]
