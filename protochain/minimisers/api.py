"""``minimise``: one call for every method."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from protochain.arrays import Floats, read_only
from protochain.articulate import as_chain
from protochain.chain import Chain, Pose, pose
from protochain.energies.factory import energy as build_energy
from protochain.energies.protocol import Energy, check_is_of
from protochain.errors import ProtochainError
from protochain.interrupts import held_interrupts
from protochain.minimisers.annealing import Annealing
from protochain.minimisers.checkpoint import load_checkpoint, save_checkpoint
from protochain.minimisers.lbfgs import LBFGS
from protochain.minimisers.loop import Stop
from protochain.minimisers.methods import BY_OPENMM, DEFAULT_METHOD, IN_TORSIONS, METHODS
from protochain.minimisers.openmm_reference import langevin_dynamics, local_energy_minimizer
from protochain.minimisers.problem import Evaluation, Problem, Space, evaluate
from protochain.minimisers.restraints import Leash
from protochain.minimisers.solution import Recorder, Solution, Watcher
from protochain.minimisers.spaces import Cartesian, Torsions
from protochain.minimisers.stages import SINGLE_PRECISION_ENDS, Hold, Outcome, Stage, stages, walk
from protochain.minimisers.verdict import judge, rebuilt, verdict
from protochain.structure import ca_rmsd

_SETTLED = 100.0
"""kJ/mol/nm. RMS force at which OpenMM's dynamics can begin: a strained start would be hot."""


def minimise(
    chain: Any,
    energy: Energy | None = None,
    method: str = DEFAULT_METHOD,
    tolerance: float = 1.0,
    max_evaluations: int = 5000,
    seed: int = 0,
    *,
    restraint: float | Sequence[float] = (),
    max_rmsd: float = np.inf,
    checkpoint: str | Path | None = None,
    resume: str | Path | None = None,
    watch: Watcher | None = None,
) -> Solution:
    """Minimise the energy of a protein.

    Parameters
    ----------
    chain : Chain, Structure, path, or anything that :func:`protochain.as_structure` takes
        A file is loaded, a structure cut into a chain with the default hinges.
    energy : Energy, optional
        ff14SB with OBC2 by default.
    method : str
        ``hybrid`` (torsions, then all atoms), ``cartesian`` (all atoms), ``lbfgs`` or ``newton`` (torsions),
        ``kcm`` (kineto-static compliance, as published) and its kin ``kcm-adaptive``, ``kcm-metric`` ...,
        ``fire``, ``quench``, ``md`` (damped constrained dynamics) and ``anneal`` (from 600 K), both ending in
        a minimum by ``lbfgs``, ``openmm`` (LocalEnergyMinimizer), or ``openmm-md`` (OpenMM's dynamics at
        300 K with hydrogens' bonds constrained, between two minimisations).
    tolerance : float
        Converged when the largest torque (kJ/mol/rad) or, where all atoms move, the RMS force (kJ/mol/nm), as
        recomputed in double precision, is no larger.
    max_evaluations : int
        Energy evaluations allowed.
    seed : int
        Of ``anneal`` and ``openmm-md``; the other methods draw no random numbers.
    restraint : float or sequence of float, kJ/mol/nm^2
        Springs from the heavy atoms to their start: one strength after the other, each until it converges. 0
        as the last lets go.
    max_rmsd : float, angstrom
        C-alpha RMSD to the start, superposed, that the result does not pass.
    checkpoint : path-like, optional
        File (.npz) to write when the run ends: what it takes to go on.
    resume : path-like, optional
        Go on from a checkpoint of a run with the same settings; evaluations count on. The steps are those of
        a run that was never stopped, bit for bit.
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
    hold = Hold(tuple(float(k) for k in np.atleast_1d(restraint)), max_rmsd)
    check_settings(method, tolerance, max_evaluations, hold, bool(checkpoint or resume))
    chain = as_chain(chain)
    if energy is None:
        energy = build_energy(chain.structure)
    check_is_of(energy, chain.structure)
    # One thread of linear algebra: its sums must not depend on the machine, nor its threads spin beside the
    # energy's.
    with threadpool_limits(1, "blas"):
        run = _Run(chain, energy, method, tolerance, max_evaluations, seed, hold)
        return _minimise(run, _path(checkpoint), _path(resume), watch)


@dataclass(frozen=True, eq=False)
class _Run:
    """What is to be done."""

    chain: Chain
    energy: Energy
    method: str
    tolerance: float
    max_evaluations: int
    seed: int
    hold: Hold

    @property
    def settings(self) -> dict[str, Any]:
        """What a checkpoint belongs to."""
        return {
            "method": self.method,
            "tolerance": self.tolerance,
            "restraint": list(self.hold.restraint),
            "max_rmsd": self.hold.max_rmsd,
            "hinges": self.chain.opened,
            "root": self.chain.root,
            "move": self.chain.move,
            "seed": self.seed,
            "engine": self.energy.engine,
            "system": self.energy.fingerprint,
            "start": hashlib.sha256(self.chain.structure.positions.tobytes()).hexdigest(),
        }


def _path(name: str | Path | None) -> Path | None:
    return None if name is None else Path(name)


@held_interrupts()
def _minimise(run: _Run, checkpoint: Path | None, resume: Path | None, watch: Watcher | None) -> Solution:
    chain, energy, method, tolerance = run.chain, run.energy, run.method, run.tolerance
    structure = chain.structure
    first = pose(chain, chain.q0)
    in_torsions = method in IN_TORSIONS
    moving = energy
    if in_torsions or method == "hybrid":
        moving = energy.without_constants(chain.rigid_groups, first.x)
    # Neighbour lists of the start, whatever was computed before: they set the order of sums.
    energy.list_at(first.x)
    # Judging first, and solving with each metric once, also make contexts and compile kernels, off the clock.
    start = judge(chain, energy, first)
    _warm(chain, moving, energy, method)

    record = Recorder(structure, watch)
    if method in BY_OPENMM:
        plan = [Stage(Cartesian(structure, chain.moving), LBFGS(), (energy,), tolerance)]
        done = _by_openmm(run, plan[0], record)
    else:
        plan = stages(method, chain, energy, moving, tolerance, run.hold, run.seed)
        waypoint = load_checkpoint(resume, plan, run.settings) if resume else None
        limit = run.hold.max_rmsd
        allowed = Leash(structure, limit).allows if limit < np.inf else None
        if plan[0].soft:
            record(first.x, start.energy, start.max_torque, 0)
        done = walk(plan, chain, run.max_evaluations, allowed, partial(_note, record), waypoint)
        if checkpoint and done.waypoint:
            save_checkpoint(checkpoint, done.waypoint, run.settings)
    seconds = perf_counter() - record.started

    space, restraint = done.stage.space, done.stage.restraint
    turned = isinstance(space, Torsions)
    end_chain, at = (chain, pose(chain, done.q)) if turned else _posed(chain, done.x)
    end = judge(end_chain, energy, at, restraint)
    if not end.energy <= start.energy:
        at, end = first, judge(chain, energy, first, restraint)
    residual = end.max_torque if turned else end.rms_force
    held = ", restraints included" if restraint else ""
    measured = f"{space.unit.format(residual)} for a tolerance of {tolerance:g}{held}, in double precision"
    met = done.stage is plan[-1] and residual <= tolerance
    status, message = verdict(done.stop, met, measured, structure, at.x, done.n_evaluations)
    return Solution(
        method=method,
        chain=chain,
        energy_function=energy,
        constant_terms=moving.left_out,
        q=at.q,
        x=at.x,
        energy=energy(at.x)[0],
        status=status,
        message=message,
        n_iterations=done.n_iterations,
        n_evaluations=done.n_evaluations,
        seconds=seconds,
        trace=record.trace(),
        start=start,
        end=end,
        ca_rmsd_angstrom=ca_rmsd(structure, at.x, structure.positions),
        tolerance=tolerance,
        hold=run.hold,
        seed=run.seed,
    )


def check_settings(
    method: str, tolerance: float, max_evaluations: int, hold: Hold | None = None, stoppable: bool = False
) -> None:
    """Refuse settings that make no sense, before any work is done.

    Raises
    ------
    ProtochainError
        Naming the setting and the mend.
    """
    hold = hold or Hold()
    if method not in METHODS:
        raise ProtochainError(f"method {method!r} is not known; choose from {', '.join(METHODS)}")
    if not 0 < tolerance < np.inf:
        raise ProtochainError(f"tolerance {tolerance:g}: give a number above 0")
    if max_evaluations < 1:
        raise ProtochainError(f"max-evaluations {max_evaluations}: give at least 1")
    if not all(0 <= strength < np.inf for strength in hold.restraint):
        raise ProtochainError(f"restraint {hold.restraint}: give strengths in kJ/mol/nm^2, none below 0")
    if not hold.max_rmsd > 0:
        raise ProtochainError(f"max-rmsd {hold.max_rmsd:g}: give a number of angstrom above 0")
    if method in BY_OPENMM and hold != Hold():
        raise ProtochainError(f"method {method!r} cannot be held near its start; choose cartesian or hybrid")
    if method in BY_OPENMM and stoppable:
        raise ProtochainError(
            f"method {method!r} keeps no state to go on from; choose another, or no checkpoint"
        )


def _posed(chain: Chain, x: Floats) -> tuple[Chain, Pose]:
    moved = rebuilt(chain, read_only(x))
    return moved, pose(moved, moved.q0)


def _warm(chain: Chain, moving: Energy, energy: Energy, method: str) -> None:
    """Compute everything a run computes once.

    Energies twice: the second call looks whether the first's neighbour lists still hold.
    """
    x = chain.structure.positions
    in_torsions, descent = method in IN_TORSIONS, IN_TORSIONS.get(method)
    if in_torsions or moving is not energy:
        space = Torsions(chain)
        at = evaluate(space, moving, space.move(chain.q0, np.zeros(chain.n_v)))
        space.stiffness(at)(at.torque)
        space.inertia(at)(at.torque)
        moving(x)
        if isinstance(descent, Annealing):
            problem = Problem(space, moving, 1)
            descent.step(problem, descent.init(problem, at))
    if not in_torsions:
        energy(x), energy(x)


def _note(record: Recorder, at: Evaluation, space: Space, n_evaluations: int) -> None:
    torque = at.residual if isinstance(space, Torsions) else np.nan
    record(at.x, at.energy - at.restraint, torque, n_evaluations)


def _by_openmm(run: _Run, stage: Stage, record: Recorder) -> Outcome:
    energy, x = run.energy, run.chain.structure.positions
    n_iterations, n_evaluations = 0, 1
    record(x, energy(x)[0], np.nan, 1)
    stop, settled = Stop.BUDGET, x
    if run.method == "openmm-md":
        settle = partial(local_energy_minimizer, tolerance=_SETTLED)
        for part in (settle, partial(langevin_dynamics, seed=run.seed)):
            left = run.max_evaluations - n_evaluations
            if left < 1:
                break
            note = partial(_note_cartesian, record, n_evaluations)
            stop, x, iterations, evaluations = part(energy, "CPU", x, max_evaluations=left, record=note)
            n_iterations += iterations
            n_evaluations += evaluations
            settled = x if part is settle else settled
            if stop is Stop.INTERRUPTED:
                return Outcome(stop, stage, stage.space.start(settled), n_iterations, n_evaluations, None)
    for platform in ("CPU", "Reference"):
        if n_evaluations >= run.max_evaluations:
            stop = Stop.BUDGET
            break
        note = partial(_note_cartesian, record, n_evaluations)
        stop, x, iterations, evaluations = local_energy_minimizer(
            energy, platform, x, stage.tolerance, run.max_evaluations - n_evaluations, note
        )
        n_iterations += iterations
        n_evaluations += evaluations
        _, forces = energy.reference(x)
        rms_force = np.sqrt(np.mean(forces[run.chain.moving] ** 2))
        if stop not in SINGLE_PRECISION_ENDS or rms_force <= stage.tolerance:
            break
    # Dynamics that no minimisation could follow to its end leaves a hot structure.
    x = min(x, settled, key=lambda y: energy(y)[0])
    return Outcome(stop, stage, stage.space.start(x), n_iterations, n_evaluations, None)


def _note_cartesian(record: Recorder, before: int, x: Floats, energy: float, evaluations: int) -> None:
    record(x, energy, np.nan, before + evaluations)
