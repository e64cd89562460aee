"""A method as a sequence of runs of the one loop: in which freedoms, by which descent, held by what."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from protochain.arrays import Floats
from protochain.chain import Chain
from protochain.contacts import overlaps
from protochain.energies.protocol import Energy
from protochain.errors import ProtochainError
from protochain.minimisers.annealing import Annealing
from protochain.minimisers.lbfgs import LBFGS
from protochain.minimisers.loop import Ending, Method, Snapshot, Stop, run
from protochain.minimisers.methods import IN_TORSIONS
from protochain.minimisers.metrics import Stiffness
from protochain.minimisers.problem import BudgetSpentError, Evaluation, Force, Problem, Space
from protochain.minimisers.restraints import SOFT_TETHER, Leash, SoftRepulsion, Sum, Tethers
from protochain.minimisers.spaces import Cartesian, Torsions

PATIENCE = 500
"""Evaluations without a new lowest energy after which a run counts as stalled."""

FREE = LBFGS(Stiffness(lasts=40))
"""All atoms: bonds and angles, which are most of the stiffness, change little; to make the matrix anew costs
as much as some evaluations."""

HYBRID_TORQUE = 300.0
"""kJ/mol/rad. Torsions go no further before all atoms move: the rest of the strain is in bonds and angles."""

PARTED = ("lbfgs", "newton", "md", "anneal", "hybrid")
"""Methods that part overlaps before they ask the force field. KCM is left as published; atoms that all may
move find their own way."""

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


def last(problem: Problem, ending: Ending, q: Floats) -> Floats:
    """Where a run came to its end by itself, if that may be an answer; else as :func:`lowest`."""
    end = ending.last.state.at
    sound = (
        ending.stop is Stop.NO_DESCENT
        and end.is_finite
        and (problem.allowed is None or problem.allowed(end.x))
    )
    return end.q if sound else lowest(problem, ending, q)


def lowest(problem: Problem, ending: Ending, q: Floats) -> Floats:
    """Where a run met its tolerance without having climbed; else its lowest energy; else where it began."""
    end = ending.last.state.at
    reached = ending.stop is Stop.TOLERANCE and end.energy <= ending.last.start.energy
    if reached and (problem.allowed is None or problem.allowed(end.x)):
        return end.q
    return q if problem.best is None else problem.best.q


Answer = Callable[[Problem, Ending, Floats], Floats]


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
    patience : int
        Evaluations without a new lowest energy after which it is given up.
    answer : callable
        Where the next stage begins: given the problem, the ending, and q at the start.
    """

    space: Space
    method: Method
    engines: tuple[Force, ...]
    tolerance: float
    restraint: Force | None = None
    soft: bool = False
    patience: int = PATIENCE
    answer: Answer = lowest


@dataclass(frozen=True, eq=False)
class Waypoint:
    """Where a walk was when it stopped.

    Parameters
    ----------
    stage, engine : int
        Which of the plan, and which of its engines.
    before : int
        Iterations of the stages before.
    last : Snapshot
        Of the loop.
    """

    stage: int
    engine: int
    before: int
    last: Snapshot


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
    waypoint : Waypoint or None
        To go on from; none if nothing was computed.
    """

    stop: Stop
    stage: Stage
    q: Floats
    n_iterations: int
    n_evaluations: int
    waypoint: Waypoint | None

    @property
    def x(self) -> Floats:
        """(na, 3) float, nm."""
        return self.stage.space.place(self.q)[0]


def stages(
    method: str, chain: Chain, energy: Energy, moving: Energy, tolerance: float, hold: Hold, seed: int
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
    seed : int
        Of methods that draw random numbers.

    Returns
    -------
    list of Stage
    """
    structure = chain.structure
    torsions, cartesian = Torsions(chain), Cartesian(structure, chain.moving)
    held = [_restraint(chain, strength, hold.max_rmsd) for strength in hold.restraint or (0.0,)]
    apart = [parting(torsions)] if method in PARTED and overlaps(structure, structure.positions) else []
    if method in IN_TORSIONS:
        descent = IN_TORSIONS[method]
        if isinstance(descent, Annealing):
            # Dynamics needs no second engine, and ends where it ends, not at the lowest energy it passed.
            cooling = replace(descent, seed=seed)
            n_steps = descent.n_steps
            apart.append(Stage(torsions, cooling, (moving,), 0.0, held[0], patience=n_steps, answer=last))
            descent = LBFGS()
        return apart + [Stage(torsions, descent, _engines(moving), tolerance, each) for each in held]
    polish = [Stage(cartesian, FREE, _engines(energy), tolerance, each) for each in held]
    if method == "cartesian":
        return polish
    return [*apart, Stage(torsions, LBFGS(), _engines(moving), HYBRID_TORQUE, held[0]), *polish]


def parting(space: Torsions) -> Stage:
    """Part overlapping atoms gently by turning hinges, before any force field is asked."""
    structure = space.chain.structure
    tethers = Tethers(structure.positions, np.full(structure.n_atoms, SOFT_TETHER))
    gentle = Sum([SoftRepulsion(structure), tethers])
    return Stage(space, LBFGS(), (gentle,), 1.0, soft=True)


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
    resume: Waypoint | None = None,
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
    resume : Waypoint, optional
        Go on from there.

    Returns
    -------
    Outcome
        An interrupt or a spent budget ends the stage it meets, and leaves out those after it.

    Notes
    -----
    When a run on a single-precision engine claims its tolerance, finds no lower energy or meets what is not a
    number, it goes on from there on the Reference platform, within the same budget.
    """
    at, n_iterations, waiting = (0, 0), 0, None
    if resume is not None:
        at, n_iterations, waiting = (resume.stage, resume.engine), resume.before, resume.last
    q, waypoint = plan[0].space.start(chain.structure.positions), resume
    stop, n_evaluations = Stop.BUDGET, 0
    steps = [(i, j) for i, stage in enumerate(plan) for j in range(len(stage.engines)) if (i, j) >= at]
    for i, j in steps:
        stage = plan[i]
        if waiting is not None:
            q = waiting.start.q
        elif j and stop not in SINGLE_PRECISION_ENDS:
            continue
        elif i and not j and plan[i - 1].space is not stage.space:
            q = stage.space.start(plan[i - 1].space.place(q)[0])
        problem = Problem(stage.space, stage.engines[j], max_evaluations, stage.restraint, allowed)
        problem.restore(None, n_evaluations, n_evaluations, stage.space.place(q)[0])

        def note(at: Evaluation, stage: Stage = stage, problem: Problem = problem) -> None:
            if not stage.soft:
                record(at, stage.space, problem.n_evaluations)

        try:
            ending = run(problem, stage.method, q, stage.tolerance, stage.patience, note, waiting)
        except (BudgetSpentError, KeyboardInterrupt) as error:
            # Before this engine had evaluated anything: what the one before it found stands.
            stop = Stop.BUDGET if isinstance(error, BudgetSpentError) else Stop.INTERRUPTED
            break
        stop, waiting, n_evaluations = ending.stop, None, problem.n_evaluations
        waypoint = Waypoint(i, j, n_iterations, ending.last)
        n_iterations += ending.last.n_iterations
        q = stage.answer(problem, ending, q)
        if stop in (Stop.BUDGET, Stop.INTERRUPTED) or (
            stop is Stop.NON_FINITE and j + 1 == len(stage.engines)
        ):
            break
    return Outcome(stop, stage, q, n_iterations, n_evaluations, waypoint)
