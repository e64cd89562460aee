"""Minimisation of one protein from many starts of perturbed dihedrals."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from protochain.chains.articulate import with_energy
from protochain.chains.chain import Chain, pose
from protochain.core import defaults
from protochain.core.arrays import Floats, read_only
from protochain.core.checks import WATCHER, check_arguments, function, integer, number, quantity
from protochain.core.errors import Argument, ProtochainError
from protochain.core.interrupts import held_interrupts
from protochain.core.lazy_pandas import pd
from protochain.core.settings import document_fields
from protochain.energies import Energy
from protochain.minimisers.minimise_settings import MinimiseSettings, StartSettings
from protochain.minimisers.minimise_structure import minimise
from protochain.minimisers.restraints import Hold
from protochain.minimisers.solution import Solution
from protochain.minimisers.spaces import Torsions
from protochain.minimisers.stages import overlap_stage, walk
from protochain.minimisers.verdict import OTHER_ISOMER, Status
from protochain.structure import Structure

_BUDGET = 500  # Largest number of evaluations of soft repulsion before a start.


def lowest_solution(solutions: Iterable[Solution]) -> Solution:
    """Solution of lowest energy, the first of equal ones. Solutions with changed isomers come last."""
    return min(solutions, key=lambda s: (s.status in OTHER_ISOMER, s.end.energy))


@document_fields
@dataclass(frozen=True, eq=False)
class Starts:
    """Minima of one method from many starts.

    Examples
    --------
    >>> len(pc.explore("structures/ala10.pdb", method="lbfgs", n_starts=2).solutions)
    2
    """

    chain: Chain  # Unperturbed.
    solutions: tuple[Solution, ...]  # One for each start, the first from the unperturbed chain.

    @cached_property
    def best(self) -> Solution:
        """Solution of lowest energy, as :func:`lowest_solution`."""
        return lowest_solution(self.solutions)

    @property
    def frames(self) -> Floats:
        """(n, na, 3) float, nm: positions at the end of each solution."""
        return np.array([solution.x for solution in self.solutions])

    @property
    def structure(self) -> Structure:
        """Structure at the end of the best solution."""
        return self.best.structure

    @property
    def energy_function(self) -> Energy:
        """Energy function of all solutions."""
        return self.best.energy_function

    def records(self) -> list[dict[str, Any]]:
        """Record of each start, as written to JSON."""
        return [
            {
                "start": k,
                "energy_start_kj_mol": s.start.energy,
                "energy_end_reference_kj_mol": s.end.energy,
                "ca_rmsd_angstrom": s.frame.ca_rmsds(s.x)[0],
                "evaluations": s.n_evaluations,
                "seconds": s.seconds,
                "status": str(s.status),
            }
            for k, s in enumerate(self.solutions)
        ]

    @cached_property
    def table(self) -> "pd.DataFrame":
        """One row per start."""
        return pd.DataFrame(self.records())

    def summary(self) -> dict[str, float]:
        """Quantiles of the final energies, and the number within 1 kJ/mol of the lowest."""
        energies = np.array([s.end.energy for s in self.solutions])
        names = ("lowest", "first_quartile", "median", "third_quartile", "highest")
        quantiles = np.quantile(energies, [0.0, 0.25, 0.5, 0.75, 1.0]).tolist()
        return {
            "n_starts": len(energies),
            **{f"energy_{name}_kj_mol": value for name, value in zip(names, quantiles, strict=True)},
            "n_within_1_kj_mol_of_lowest": int(np.sum(energies < quantiles[0] + 1.0)),
        }

    def overall(self) -> dict[str, Any]:
        """Entries over all starts, which replace entries of the best solution's record."""
        rows = self.records()
        best = self.solutions.index(self.best)
        return {
            "energy_start_kj_mol": self.solutions[0].start.energy,
            "ca_rmsd_angstrom": rows[best]["ca_rmsd_angstrom"],
            "ca_rmsd_as_filed_angstrom": self.best.ca_rmsd_as_filed_angstrom,
            "evaluations": sum(s.n_evaluations for s in self.solutions),
            "seconds": sum(s.seconds for s in self.solutions),
            "starts_summary": self.summary(),
            "starts": rows,
        }

    def __repr__(self) -> str:
        s = self.summary()
        low, middle, high = (s[f"energy_{name}_kj_mol"] for name in ("lowest", "median", "highest"))
        return f"<{s['n_starts']} starts: {low:.2f}, median {middle:.2f}, highest {high:.2f} kJ/mol>"


@check_arguments(
    n_starts=integer, seed=integer, spread=quantity("radian"), each=function("k", "solution"),
    watch=WATCHER, max_rmsd=number,
)  # fmt: skip
@held_interrupts()
def explore(
    chain: Any,
    energy: Any = None,
    method: Any = defaults.METHOD,
    n_starts: int = defaults.N_STARTS,
    *,
    seed: int = defaults.SEED,
    spread: float = defaults.SPREAD,
    tolerance: float | None = None,
    each: Callable[[int, Solution], None] | None = None,
    **settings: Any,
) -> Starts:
    """Minimise from many starts.

    Parameters
    ----------
    chain : Chain, Structure, path, or anything that :func:`protochain.as_structure` accepts
        The first start. The others are perturbed.
    energy : Energy or callable, optional
        As in :func:`protochain.minimise`. All starts share one energy function.
    method : str, Recipe, or object with ``init`` and ``step``
        As in :func:`protochain.minimise`.
    n_starts : int
        Number of starts.
    seed : int
        Start k draws from its own random stream, (seed, k).
    spread : float, rad
        Standard deviation of the perturbation of every hinge.
    tolerance : float, optional
        As in :func:`protochain.minimise`, but by default 1 also in kJ/mol/nm, to compare minima.
    each : callable, optional
        Called with the number and solution of each start.
    **settings
        As in :func:`protochain.minimise`, except ``restraints`` and ``max_rmsd``, which would refer to each
        perturbed start.

    Returns
    -------
    Starts
        An interrupt ends the current start and skips the rest.

    Raises
    ------
    ProtochainError
        If a setting is invalid.

    Examples
    --------
    >>> c = pc.build_chain(pc.from_sequence("GAG"))
    >>> found = pc.explore(c, n_starts=3, method="lbfgs")
    >>> found.best.end.energy <= found.solutions[0].end.energy
    True
    """
    MinimiseSettings(seed=seed)
    StartSettings(n_starts=n_starts, spread=spread)
    refuse_restraints(settings.get("restraints", ()), settings.get("max_rmsd", np.inf))
    settings["tolerance"] = defaults.TOLERANCE if tolerance is None else tolerance
    chain, energy = with_energy(chain, energy)
    solutions: list[Solution] = []
    for k in range(n_starts):
        random = np.random.default_rng([seed, k])
        try:
            start = perturb_dihedrals(chain, spread, random) if k else chain
            solution = _superpose_on_start(minimise(start, energy, method, seed=seed, **settings), chain)
        except KeyboardInterrupt:
            if not solutions:
                raise
            break
        solutions.append(solution)
        if each:
            each(k, solution)
        if solution.status is Status.INTERRUPTED:
            break
    return Starts(chain, tuple(solutions))


def refuse_restraints(restraints: Any, max_rmsd: float) -> None:
    """Raise an error for restraints to the start, if there are many starts."""
    if Hold.of(restraints, max_rmsd) != Hold():
        remedy = " refer to each start's own structure; use one start"
        raise ProtochainError(Argument("restraints"), " and ", Argument("max_rmsd"), remedy)


def perturb_dihedrals(chain: Chain, spread: float, random: np.random.Generator) -> Chain:
    """Turn every hinge by a normal deviate (standard deviation in rad), then separate overlapping atoms."""
    q = chain.q0.copy()
    turns = np.array([not hinge.is_angle for hinge in chain.hinges])
    turning = chain.tree.q_start[chain.hinge_body[turns]]
    q[turning] += random.normal(scale=spread, size=len(turning))
    return separate_overlaps(_move_chain(chain, q))


def separate_overlaps(chain: Chain) -> Chain:
    """Separate overlapping atoms by soft repulsion in torsions.

    Parameters
    ----------
    chain : Chain
        With any dihedrals, random ones for example.

    Returns
    -------
    Chain
        The same bodies, moved.
    """
    x = chain.structure.positions
    return _move_chain(chain, walk([overlap_stage(Torsions(chain))], x, _BUDGET, None, lambda *_: None).q)


def _move_chain(chain: Chain, q: np.ndarray) -> Chain:
    at = pose(chain, q)
    return replace(chain, structure=chain.structure.with_positions(at.x), q0=at.q)


def _superpose_on_start(solution: Solution, chain: Chain) -> Solution:
    if solution.frame.start is chain.structure:
        return solution
    frame = replace(solution.frame, start=chain.structure)
    x = frame(solution.x)
    frames = read_only([frame(positions) for positions in solution.frames], np.float32)
    return replace(solution, x=x, frame=frame, ca_rmsd_angstrom=frame.ca_rmsds(x)[0], frames=frames)
