"""``minimise``: one call for every method."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from protochain.chains.articulate import run_identity, with_energy
from protochain.chains.chain import Pose, pose
from protochain.chains.frame import Frame, depends_on_place, frame_of
from protochain.chains.restraint_list import describe_violations, measure_restraints
from protochain.core import defaults
from protochain.core.arrays import Floats, Watcher, floats, read_only
from protochain.core.checks import WATCHER, check_arguments
from protochain.core.errors import ProtochainError, WriteError, WriteWarning
from protochain.core.interrupts import held_interrupts, open_to_interrupts
from protochain.core.markup import abridge
from protochain.core.processors import one_blas_thread
from protochain.core.settings import document_settings, settings_from
from protochain.core.timings import measure_run, until_now
from protochain.minimisers.checkpoint import load_checkpoint, save_checkpoint
from protochain.minimisers.loop import Stop
from protochain.minimisers.minimise_settings import CheckpointSettings, MinimiseSettings
from protochain.minimisers.openmm_reference import minimise_by_openmm
from protochain.minimisers.problem import Evaluation
from protochain.minimisers.recipes import Recipe, recipe_of
from protochain.minimisers.restraints import Hold, Leash
from protochain.minimisers.saddle import ALL_ATOMS_UP_TO, with_curvature
from protochain.minimisers.solution import Recorder, Solution, frames_of, trace_of
from protochain.minimisers.spaces import Torsions, spaces
from protochain.minimisers.stages import Outcome, Stage, walk
from protochain.minimisers.start import Start
from protochain.minimisers.start_warnings import StrayWatcher
from protochain.minimisers.verdict import Judgement, describe_rejections, judge, rebuilt, verdict
from protochain.validation.omega import twisted_bonds


@document_settings(MinimiseSettings, CheckpointSettings)
@check_arguments(watch=WATCHER)
def minimise(
    chain: Any,
    energy: Any = None,
    method: Any = defaults.METHOD,
    tolerance: float | None = None,
    max_evaluations: int = defaults.MAX_EVALUATIONS,
    seed: int = defaults.SEED,
    *,
    q: Floats | None = None,
    restraints: Any = "",
    max_rmsd: float = np.inf,
    curvature: bool | None = None,
    judge: str = defaults.JUDGE,
    checkpoint: str | Path | None = None,
    resume: str | Path | None = None,
    watch: Watcher | None = None,
) -> Solution:
    """Minimise the energy of a protein.

    Parameters
    ----------
    chain : Chain, Structure, path, or anything that :func:`protochain.as_structure` accepts
        A file is loaded, and a structure is cut into a chain with the default hinges. A result continues from
        its end, with its own hinges. Methods that move masses (``md``, ``anneal``, ``kcm-metric``, ``fire``,
        ``quench``) free a root that ``auto`` has fixed, also in ``chain`` and ``q`` of the result.
    energy : Energy or callable, optional
        Default: for a result its own energy, without the restraints of its run, otherwise
        :func:`protochain.energy`. A callable converts positions (na, 3) in nm to energy in kJ/mol and forces
        (na, 3) in kJ/mol/nm, and also judges the result.
    method : str, Recipe, or object with ``init`` and ``step``
        ``cartesian`` (all atoms), ``hybrid`` (torsions, then all atoms), ``lbfgs`` or ``newton`` (torsions),
        ``kcm`` (kineto-static compliance, turns of a fixed angle, which :func:`protochain.kcm` sets) with
        variants ``kcm-proportional``, ``kcm-sign``, ``kcm-adaptive``, ``kcm-metric`` ...,
        ``fire``, ``quench``, ``md`` (damped constrained dynamics) and ``anneal`` (from 600 K), both ending in
        a minimum by ``lbfgs``, ``openmm`` (LocalEnergyMinimizer), or ``openmm-md`` (OpenMM's dynamics at
        300 K, bonds to hydrogen constrained, between two minimisations). For custom methods see
        :func:`protochain.minimisers.recipe_of`.
    q : (n_q,) float, optional
        Coordinates of the given chain to start from, as in :meth:`Chain.set`. Default: its input pose.
    watch : callable, optional
        Called with every trace row and its positions (in the frame of the start), to show progress or write a
        trajectory. Its optional method ``at_stage`` is called with the stage (``resolving clashes``,
        ``held by springs``, ``interrupted`` ...) and the evaluations so far. Its optional method
        ``at_warning`` is called with a line once a run from a start with overlaps is 2 angstrom (C-alpha
        RMSD) away. Without it, ``errors.StrayWarning`` is issued. The result's message always reports it.

    Returns
    -------
    Solution
        Never worse than the start, restraints included. It is superposed on the start unless an obstacle, a
        selection, a restraint, or the energy fixes the run in space. The judge sets its status.

    Raises
    ------
    ProtochainError
        If the method is unknown, an option makes no sense, or the input cannot be used.

    Notes
    -----
    The native engine skips terms that are constant in the chain. Single-precision forces, as on OpenMM's CPU
    platform, limit how small a torque can become. If a method on such an engine reports convergence, no lower
    energy, or a number that is not finite, it continues on the Reference platform, within the same budget.

    Examples
    --------
    >>> c = pc.build_chain(pc.from_sequence("GAG"))
    >>> r = pc.minimise(c, method="lbfgs")
    >>> str(r.status), r.end.energy < r.start.energy
    ('converged', True)
    """
    run = settings_from(Minimisation, locals(), recipe=recipe_of(method))
    with measure_run():
        cut, energy = with_energy(chain, energy)
        if q is not None:
            cut = rebuilt(cut, pose(cut, floats(q, (cut.n_q,), "q")).x)
        return minimise_from(Start(cut, energy), run, watch)


minimize = minimise


@dataclass(frozen=True)
class Minimisation(CheckpointSettings, MinimiseSettings):
    """A minimisation by a recipe."""

    recipe: Recipe

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.start_hold != Hold() and self.recipe.by_openmm:
            raise ProtochainError(
                f"method {self.recipe.name!r} cannot be restrained to its start; choose cartesian or hybrid"
            )
        if (self.checkpoint or self.resume) and not self.recipe.states:
            raise ProtochainError(
                f"method {self.recipe.name!r} has no state to resume from; choose another, or no checkpoint"
            )

    @property
    def converged_at(self) -> float:
        """Tolerance of the user, or the recipe's default."""
        return self.recipe.tolerance(self.tolerance)

    @property
    def computes_curvature(self) -> bool:
        """Whether the curvature at the end is computed."""
        usual = self.recipe.keeps_geometry or self.converged_at <= ALL_ATOMS_UP_TO
        return not self.recipe.by_openmm and (usual if self.curvature is None else self.curvature)

    @property
    def start_hold(self) -> Hold:
        """Restraints to the start."""
        return Hold.of(self.restraints, self.max_rmsd)

    def settings(self, start: Start) -> dict[str, Any]:
        """Settings that a checkpoint must share with the run it continues."""
        return {
            "method": self.recipe.name,
            "tolerance": self.converged_at,
            "restraint": self.start_hold.record(),
            "max_rmsd": self.max_rmsd,
            "seed": self.seed,
            "curvature": self.computes_curvature,
            **run_identity(start.chain, start.energy),
        }


@held_interrupts()
@measure_run()
def minimise_from(start: Start, run: Minimisation, watch: Watcher | None = None) -> Solution:
    """Minimise from a start that other runs may share."""
    run.recipe.check(start.energy)
    start = start.of(run.recipe, run.judge)
    with one_blas_thread():
        with open_to_interrupts():
            start.warm(run.recipe)
        record = Recorder(start.chain.structure, _frame(start, run), watch)
        outcome = _by_openmm(start, run, record) if run.recipe.by_openmm else _run_stages(start, run, record)
        seconds = perf_counter() - record.started
        if outcome.stop is Stop.INTERRUPTED:
            record.at_stage(Stop.INTERRUPTED.value, outcome.n_evaluations)
        record.at_stage("evaluating the end", outcome.n_evaluations)
        return _judge(start, run, outcome, record, seconds)


def _frame(start: Start, run: Minimisation) -> Frame:
    """Frame of the result, fixed by a fixed root if the caller requested one and only hinges turn."""
    fixed = start.chain.root == "fixed" and run.recipe.keeps_geometry
    return frame_of(start.chain, start.energy, run.start_hold.place or ("a fixed root" if fixed else ""))


def _floats(start: Start, run: Minimisation, frame: Frame) -> bool:
    """Whether nothing fixes a run in space, except fixed atoms, if there are any."""
    if start.chain.moving.all():
        return not frame.held_by
    return not run.start_hold.place and not depends_on_place(start.energy, start.chain.structure.positions)


def _run_stages(start: Start, run: Minimisation, record: Recorder) -> Outcome:
    chain, hold = start.chain, run.start_hold
    reduced = start.energy_of(run.recipe)
    torque = start.judgement.max_torque if run.recipe.in_torsions else 0.0
    plan = run.recipe.plan(chain, start.cached_energy, reduced, run.converged_at, hold, run.seed, torque)
    if run.computes_curvature:
        plan = with_curvature(plan, _floats(start, run, record.frame))
    x = chain.structure.positions
    waypoint = load_checkpoint(Path(run.resume), plan, run.settings(start), x) if run.resume else None
    allowed = Leash(chain.structure, hold.max_rmsd).allows if hold.max_rmsd < np.inf else None
    if not plan[0].recorded:
        record(start.pose.x, start.judgement.energy, start.judgement.sizes, 0)

    look = _watch_over(start, record)

    def note(at: Evaluation, stage: Stage, n_evaluations: int) -> None:
        record.at_stage(stage.name, n_evaluations)
        look(at.x)
        if stage.recorded:
            record(at.x, at.energy - at.restraint, stage.space.sizes(at.torque), n_evaluations)

    outcome = walk(plan, x, run.max_evaluations, allowed, note, waypoint)
    if run.checkpoint and outcome.waypoint:
        try:
            save_checkpoint(Path(run.checkpoint), outcome.waypoint, run.settings(start))
        except WriteError as error:
            # The result is worth more: it must not be lost with the checkpoint.
            warnings.warn(str(error), WriteWarning, stacklevel=2)
    return outcome


def _watch_over(start: Start, record: Recorder) -> Callable[[Floats], None]:
    """Watcher that warns if a run from a crowded start moves far away. Other runs have none."""
    return StrayWatcher(start.chain.structure, record.warn) if start.is_crowded else lambda x: None


def _by_openmm(start: Start, run: Minimisation, record: Recorder) -> Outcome:
    look, atoms = _watch_over(start, record), spaces(start.chain)[1]

    def note(x: Floats, energy: float, n_evaluations: int, forces: Floats) -> None:
        record.at_stage("all atoms", n_evaluations)
        look(x)
        sizes = atoms.sizes(atoms.torque(atoms.place(x.ravel()), forces))
        record(x, energy, sizes, n_evaluations)

    return minimise_by_openmm(
        run.recipe, start.chain, start.energy, run.converged_at, run.max_evaluations, run.seed, note
    )


def _judge(start: Start, run: Minimisation, outcome: Outcome, record: Recorder, seconds: float) -> Solution:
    """Judge an outcome. The start itself is the result if the end is not better."""
    chain, energy, restraint, structure = start.chain, start.energy, outcome.restraint, start.chain.structure
    at, end = _select_end(start, outcome)
    lowest = outcome.lowest_eigenvalue if at is not start.pose else None
    residual = end.max_torque if isinstance(outcome.space, Torsions) else end.rms_force
    met = outcome.complete and residual <= run.converged_at
    residuals = _describe_residuals(outcome, residual, run.converged_at, energy.engine, met, lowest)
    stop = outcome.stop
    if not np.isfinite(end.energy) and stop is not Stop.INTERRUPTED:
        # A callable may return forces that vanish, or are small, and no energy with them.
        stop, met = Stop.NON_FINITE, False
    # Status and message.
    restraint_values = measure_restraints(structure, run.start_hold.listed, at.x)
    problems = [*describe_rejections(structure, at.x), *describe_violations(restraint_values)]
    status, ended = verdict(stop, met, residuals, structure, at.x, outcome.n_evaluations, problems=problems)
    if twisted := twisted_bonds(structure, at.x, structure.positions):
        ended = f"{ended}; peptide bonds that became twisted: {abridge(twisted)}"
    x = at.x if at is start.pose else record.frame(at.x)
    # Built on first access, without a reference to the watcher.
    trace: Any = partial(trace_of, record.structure, record.rows, record.alphas)
    frames: Any = partial(frames_of, record.frame, [*record.recorded_frames().values()])
    return Solution(
        recipe=run.recipe,
        chain=chain,
        energy_function=energy,
        constant_terms=start.energy_of(run.recipe).left_out,
        q=at.q,
        x=x,
        energy=start.cached_energy(at.x)[0],
        status=status,
        ended=ended,
        n_iterations=outcome.n_iterations,
        n_evaluations=outcome.n_evaluations,
        seconds=seconds,
        trace=trace,
        start=start.judgement,
        end=end,
        judge=start.cached_energy.judge,
        frame=record.frame,
        ca_rmsd_angstrom=record.frame.ca_rmsds(x)[0],
        tolerance=run.converged_at,
        hold=run.start_hold,
        seed=run.seed,
        restraints=restraint and (restraint(start.pose.x)[0], restraint(at.x)[0]),
        restraint_values=restraint_values,
        timings=until_now(),
        lowest_eigenvalue=lowest,
        frame_rows=read_only(list(record.recorded_frames()), np.int64),
        frames=frames,
    )


def _select_end(start: Start, outcome: Outcome) -> tuple[Pose, Judgement]:
    """Pose and judgement of the end, or of the start if the end is not better, restraints included."""
    if isinstance(outcome.space, Torsions):
        chain = outcome.space.chain
        at = pose(chain, outcome.q)
    else:
        chain = rebuilt(start.chain, read_only(outcome.x))
        at = pose(chain, chain.q0)
    if np.array_equal(at.q, chain.q0):
        # No digit is rounded anew: the energies are those of the run, or of the start.
        at = replace(at, x=chain.structure.positions)
    end = judge(chain, at, start.cached_energy.judge_at(at.x), outcome.restraint)
    restraint = outcome.restraint or (lambda x: (0.0, x))
    if end.energy + restraint(at.x)[0] <= start.judgement.energy + restraint(start.pose.x)[0]:
        return at, end
    return start.pose, judge(start.chain, start.pose, start.start_values, outcome.restraint)


def _describe_residuals(
    outcome: Outcome, residual: float, tolerance: float, engine: str, met: bool, lowest: float | None
) -> str:
    """Residual, judge and curvature of an end, in words."""
    restrained = ", restraints included" if outcome.restraint else ""
    judgement = "evaluated by the callable itself" if engine == "custom" else "in double precision"
    text = f"{outcome.space.unit.format(residual)} for a tolerance of {tolerance:g}{restrained}, {judgement}"
    eigenvalue_bound, unit = outcome.eigenvalue_at_most, outcome.space.eigenvalue_unit
    if lowest is not None:
        flat = ", negative: a smaller tolerance leads lower" if lowest < 0.0 else ""
        return f"{text}; lowest eigenvalue of the Hessian {lowest:.3g} {unit}{flat}"
    if not met:
        return text
    text += "; curvature not examined"
    if eigenvalue_bound is None:
        return text
    return f"{text} to the end: the lowest eigenvalue of the Hessian is at most {eigenvalue_bound:.3g} {unit}"
