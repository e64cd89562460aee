"""A method as a sequence of runs of the one loop: in which freedoms, by which descent, held by what."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from protochain.arrays import Floats
from protochain.chain import Chain
from protochain.energies.protocol import Energy
from protochain.errors import ProtochainError
from protochain.minimisers.contacts import overlaps
from protochain.minimisers.lbfgs import LBFGS
from protochain.minimisers.loop import Method, Stop, run
from protochain.minimisers.methods import IN_TORSIONS
from protochain.minimisers.problem import BudgetSpentError, Evaluation, Force, Problem, Space
from protochain.minimisers.restraints import SOFT_TETHER, Leash, SoftRepulsion, Sum, Tethers
from protochain.minimisers.spaces import Cartesian, Torsions

PATIENCE = 500
"""Evaluations without a new lowest energy after which a run counts as stalled."""

HYBRID_TORQUE = 100.0
"""kJ/mol/rad. Torsions go no further before all atoms move: the rest of the strain is in bonds and angles."""

SINGLE_PRECISION_ENDS = (Stop.TOLERANCE, Stop.NO_DESCENT, Stop.NON_FINITE)
"""Endings that may be single precision's fault: its noise, or numbers beyond 1e38 where atoms overlap."""


@dataclass(frozen=True)
class Hold:
    """What keeps a run near its start.

    Parameters
    ----------
    restraint : tuple of float, kJ/mol/nm^2
        Springs from heavy atoms to their start, one strength after the other, each a run of its own.
    max_rmsd : float, angstrom
        C-alpha RMSD to the start that may not be passed.
    """

    restraint: tuple[float, ...] = ()
    max_rmsd: float = np.inf


def read_hold(restraint: str, max_rmsd: float | None) -> Hold:
    """Read strengths with blanks between, and a limit.

    Raises
    ------
    ProtochainError
        If a strength is not a number.
    """
    try:
        strengths = tuple(float(word) for word in restraint.split())
    except ValueError:
        raise ProtochainError(
            f"restrain {restraint!r}: give strengths in kJ/mol/nm^2, as '1000 100 0'"
        ) from None
    return Hold(strengths, np.inf if max_rmsd is None else max_rmsd)


@dataclass(frozen=True, eq=False)
class Stage:
    """One run of the loop.

    Parameters
    ----------
    space : Space
    method : Method
    engines : tuple of callable
        The energy, and what to go on with where single precision ends.
    tolerance : float
    restraint : callable, optional
    soft : bool
        Whether the energy is not the force field's: its rows do not belong into the trace.
    """

    space: Space
    method: Method
    engines: tuple[Force, ...]
    tolerance: float
    restraint: Force | None = None
    soft: bool = False


@dataclass(frozen=True, eq=False)
class Outcome:
    """What a method hands back to be judged.

    Parameters
    ----------
    stop : Stop
    stage : Stage
        The last one run.
    q : (n_q,) float
        In its space.
    n_iterations, n_evaluations : int
    """

    stop: Stop
    stage: Stage
    q: Floats
    n_iterations: int
    n_evaluations: int

    @property
    def x(self) -> Floats:
        """(na, 3) float, nm."""
        return self.stage.space.positions(self.q)


def stages(
    method: str, chain: Chain, energy: Energy, moving: Energy, tolerance: float, hold: Hold
) -> list[Stage]:
    """Return the runs that make up a method.

    Parameters
    ----------
    method : str
    chain : Chain
    energy, moving : Energy
        With all terms, and without those that are constant in the chain.
    tolerance : float
    hold : Hold

    Returns
    -------
    list of Stage
    """
    structure = chain.structure
    torsions, cartesian = Torsions(chain), Cartesian(structure, chain.moving)
    held = [_restraint(chain, strength, hold.max_rmsd) for strength in hold.restraint or (0.0,)]
    if method in IN_TORSIONS:
        return [Stage(torsions, IN_TORSIONS[method], _engines(moving), tolerance, each) for each in held]
    polish = [Stage(cartesian, LBFGS(), _engines(energy), tolerance, each) for each in held]
    if method == "cartesian":
        return polish
    first = Stage(torsions, LBFGS(), _engines(moving), HYBRID_TORQUE, held[0])
    if not overlaps(structure, structure.positions):
        return [first, *polish]
    tethers = Tethers(structure.positions, np.full(structure.n_atoms, SOFT_TETHER))
    gentle = Sum([SoftRepulsion(structure), tethers])
    return [replace(first, engines=(gentle,), tolerance=1.0, soft=True), first, *polish]


def _engines(energy: Energy) -> tuple[Force, ...]:
    return (energy,) if energy.is_exact else (energy, energy.reference)


def _restraint(chain: Chain, strength: float, max_rmsd: float) -> Force | None:
    parts: list[Force] = []
    if strength > 0.0:
        parts.append(Tethers.of_heavy_atoms(chain.structure, strength))
    if max_rmsd < np.inf:
        parts.append(Leash(chain.structure, max_rmsd))
    return Sum(parts) if parts else None


def walk(
    plan: Sequence[Stage],
    chain: Chain,
    max_evaluations: int,
    allowed: Callable[[Floats], bool] | None,
    record: Callable[[Evaluation, Space, int], None],
) -> Outcome:
    """Run one stage after the other, each from where the last one found the lowest energy.

    Parameters
    ----------
    plan : sequence of Stage
    chain : Chain
    max_evaluations : int
        For all of them together.
    allowed : callable, optional
        Whether positions may be an answer.
    record : callable
        Called with each point accepted, its space, and the evaluations so far.

    Returns
    -------
    Outcome
        An interrupt or a spent budget ends the stage it meets, and leaves out those after it.

    Notes
    -----
    When a run on a single-precision engine claims its tolerance, finds no lower energy or meets what is not a
    number, it goes on from there on the Reference platform, within the same budget.
    """
    n_iterations, n_evaluations = 0, 0
    space, q = plan[0].space, plan[0].space.start(chain.structure.positions)
    for stage in plan:
        if stage.space is not space:
            space, q = stage.space, stage.space.start(space.positions(q))
        problem = Problem(space, stage.engines[0], max_evaluations, stage.restraint, allowed, n_evaluations)

        def note(at: Evaluation, stage: Stage = stage, problem: Problem = problem) -> None:
            if not stage.soft:
                record(at, stage.space, problem.n_evaluations)

        for engine in stage.engines:
            problem.energy, problem.best = engine, None
            problem.improved_at = problem.n_evaluations
            try:
                ending = run(problem, stage.method, q, stage.tolerance, PATIENCE, note)
            except (BudgetSpentError, KeyboardInterrupt) as error:
                # Before this engine had evaluated anything: what the one before it found stands.
                stop = Stop.BUDGET if isinstance(error, BudgetSpentError) else Stop.INTERRUPTED
                break
            stop = ending.stop
            n_iterations += ending.n_iterations
            reached = stop is Stop.TOLERANCE and ending.at.energy <= ending.start.energy
            if reached and (allowed is None or allowed(ending.at.x)):
                q = ending.at.q
            elif problem.best is not None:
                q = problem.best.q
            if stop not in SINGLE_PRECISION_ENDS:
                break
        n_evaluations = problem.n_evaluations
        if stop in (Stop.BUDGET, Stop.INTERRUPTED, Stop.NON_FINITE):
            break
    return Outcome(stop, stage, q, n_iterations, n_evaluations)
