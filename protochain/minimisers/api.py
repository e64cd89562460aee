"""``minimise``: one call for every method."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from time import perf_counter

import numpy as np

from protochain.arrays import Floats, read_only
from protochain.articulate import build_chain
from protochain.chain import Chain, Pose, pose, rigid_groups
from protochain.energies.factory import energy as build_energy
from protochain.energies.protocol import Energy
from protochain.errors import ProtochainError
from protochain.minimisers.kcm import KCM
from protochain.minimisers.lbfgs import LBFGS
from protochain.minimisers.loop import Method, Stop, run
from protochain.minimisers.openmm_reference import local_energy_minimizer
from protochain.minimisers.problem import BudgetSpentError, Evaluation, Problem
from protochain.minimisers.solution import Recorder, Solution, Watcher
from protochain.minimisers.verdict import judge, rebuilt, verdict
from protochain.multibody import integrate
from protochain.structure import Structure, ca_rmsd, load

TORSION_METHODS: dict[str, Callable[[], Method]] = {"kcm": KCM, "lbfgs": LBFGS}
"""Methods that turn hinges, run by the one loop."""

METHODS = (*TORSION_METHODS, "openmm")
DEFAULT_METHOD = "lbfgs"
PATIENCE = 500
"""Evaluations without a new lowest energy after which a run counts as stalled."""

_SINGLE_PRECISION_ENDS = (Stop.TOLERANCE, Stop.NO_DESCENT, Stop.NON_FINITE)
"""Endings that may be single precision's fault: its noise, or numbers beyond 1e38 where atoms overlap."""


@dataclass(frozen=True)
class _Run:
    """What any method hands back to be judged: the chain as it ended, and where."""

    stop: Stop
    chain: Chain
    at: Pose
    n_iterations: int
    n_evaluations: int


def minimise(
    chain: Chain | Structure | str | Path,
    energy: Energy | None = None,
    method: str = DEFAULT_METHOD,
    tolerance: float = 1.0,
    max_evaluations: int = 5000,
    seed: int = 0,
    *,
    watch: Watcher | None = None,
) -> Solution:
    """Minimise the energy of a protein.

    Parameters
    ----------
    chain : Chain, Structure or path
        A file is loaded, a structure cut into a chain with the default hinges.
    energy : Energy, optional
        ff14SB with OBC2 by default.
    method : str
        ``kcm`` (kineto-static compliance, as published), ``lbfgs`` (quasi-Newton in torsions) or
        ``openmm`` (LocalEnergyMinimizer, all atoms free).
    tolerance : float
        Converged when the largest torque (kJ/mol/rad) or, for ``openmm``, the RMS force (kJ/mol/nm), as
        recomputed in double precision, is no larger.
    max_evaluations : int
        Energy evaluations allowed.
    seed : int
        Recorded; the methods here draw no random numbers.
    watch : callable, optional
        Called with every trace row and its positions, to show progress or write a trajectory.

    Returns
    -------
    Solution
        Never worse than the start, and its status is the judge's, not the method's own.

    Raises
    ------
    ProtochainError
        If the method is unknown, an option makes no sense, or the input cannot be used.

    Notes
    -----
    The native engine leaves out terms that are constant in the chain. Single-precision forces, as of
    OpenMM's CPU platform, limit how small a torque can become: when a method on such an engine claims its
    tolerance, finds no lower energy or meets what is not a number, it goes on from there on the Reference
    platform, within the same budget.
    """
    check_settings(method, tolerance, max_evaluations)
    if isinstance(chain, str | Path):
        chain = load(chain)
    if isinstance(chain, Structure):
        chain = build_chain(chain)
    if energy is None:
        energy = build_energy(chain.structure)
    structure = chain.structure
    first = pose(chain, chain.q0)
    moving = energy
    if method in TORSION_METHODS:
        moving = energy.without_constants(rigid_groups(chain), first.x)
    # Judging first, and a step of no length, also make both contexts and compile the kernels, off the clock.
    start = judge(chain, energy, first)
    moving(first.x)
    integrate(chain.tree, chain.q0, np.zeros(chain.n_v))

    record = Recorder(structure, watch)
    if method in TORSION_METHODS:
        done = _in_torsions(chain, moving, TORSION_METHODS[method](), tolerance, max_evaluations, record)
    else:
        done = _by_openmm(chain, energy, tolerance, max_evaluations, record)
    seconds = perf_counter() - record.started

    end = judge(done.chain, energy, done.at)
    if not end.energy <= start.energy:
        done, end = _Run(done.stop, chain, first, done.n_iterations, done.n_evaluations), start
    x = done.at.x
    if method in TORSION_METHODS:
        met, size, unit = end.max_torque <= tolerance, end.max_torque, "largest torque {:.4g} kJ/mol/rad"
    else:
        met, size, unit = end.rms_force <= tolerance, end.rms_force, "RMS force {:.4g} kJ/mol/nm"
    measured = f"{unit.format(size)} for a tolerance of {tolerance:g}, in double precision"
    status, message = verdict(done.stop, met, measured, structure, x, done.n_evaluations)
    return Solution(
        method=method,
        chain=chain,
        energy_function=energy,
        constant_terms=moving.left_out,
        q=done.at.q,
        x=x,
        energy=moving(x)[0],
        status=status,
        message=message,
        n_iterations=done.n_iterations,
        n_evaluations=done.n_evaluations,
        seconds=seconds,
        trace=record.trace(),
        start=start,
        end=end,
        ca_rmsd_angstrom=ca_rmsd(structure, x, structure.positions),
        tolerance=tolerance,
        seed=seed,
    )


def check_settings(method: str, tolerance: float, max_evaluations: int) -> None:
    """Refuse settings that make no sense, before any work is done.

    Raises
    ------
    ProtochainError
        Naming the setting and the mend.
    """
    if method not in METHODS:
        raise ProtochainError(f"method {method!r} is not known; choose from {', '.join(METHODS)}")
    if not 0 < tolerance < np.inf:
        raise ProtochainError(f"tolerance {tolerance:g}: give a number above 0")
    if max_evaluations < 1:
        raise ProtochainError(f"max-evaluations {max_evaluations}: give at least 1")


def _in_torsions(
    chain: Chain, energy: Energy, method: Method, tolerance: float, max_evaluations: int, record: Recorder
) -> _Run:
    problem = Problem(chain, energy, max_evaluations)

    def note(at: Evaluation) -> None:
        record(at.x, at.energy, at.max_torque, problem.n_evaluations)

    q, n_iterations = chain.q0, 0
    for engine in (energy,) if energy.is_exact else (energy, energy.reference):
        problem.energy, problem.best = engine, None
        try:
            ending = run(problem, method, q, tolerance, PATIENCE, note)
        except (BudgetSpentError, KeyboardInterrupt) as error:
            # Before this engine had evaluated anything: what the one before it found stands.
            stop = Stop.BUDGET if isinstance(error, BudgetSpentError) else Stop.INTERRUPTED
            break
        stop = ending.stop
        n_iterations += ending.n_iterations
        reached = stop is Stop.TOLERANCE and ending.at.energy <= record.rows[0]["energy_kj_mol"]
        if reached:
            q = ending.at.q
        elif problem.best is not None:
            q = problem.best.q
        if stop not in _SINGLE_PRECISION_ENDS or engine is energy.reference:
            break
    return _Run(stop, chain, pose(chain, q), n_iterations, problem.n_evaluations)


def _by_openmm(
    chain: Chain, energy: Energy, tolerance: float, max_evaluations: int, record: Recorder
) -> _Run:
    x, n_iterations, n_evaluations = chain.structure.positions, 0, 1
    record(x, energy(x)[0], np.nan, 1)
    stop = Stop.BUDGET
    for platform in ("CPU", "Reference"):
        if n_evaluations >= max_evaluations:
            stop = Stop.BUDGET
            break
        note = partial(_note_cartesian, record, n_evaluations)
        stop, x, iterations, evaluations = local_energy_minimizer(
            energy, platform, x, tolerance, max_evaluations - n_evaluations, note
        )
        n_iterations += iterations
        n_evaluations += evaluations
        _, forces = energy.reference(x)
        if stop not in _SINGLE_PRECISION_ENDS or np.sqrt(np.mean(forces**2)) <= tolerance:
            break
    moved = rebuilt(chain, read_only(x))
    return _Run(stop, moved, pose(moved, moved.q0), n_iterations, n_evaluations)


def _note_cartesian(record: Recorder, before: int, x: Floats, energy: float, evaluations: int) -> None:
    record(x, energy, np.nan, before + evaluations)
