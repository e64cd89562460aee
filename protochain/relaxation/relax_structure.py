"""``relax``: relaxation of predicted and experimental structures that preserves the fold."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from protochain.chains.frame import Frame
from protochain.chains.restraint_list import Restraints, RestraintValue, describe_violations
from protochain.core import defaults
from protochain.core.arrays import Integers, Watcher, read_only
from protochain.core.checks import WATCHER, check_arguments
from protochain.core.interrupts import held_interrupts
from protochain.core.markup import abridge, plural
from protochain.core.processors import one_blas_thread
from protochain.core.timings import measure_run, until_now
from protochain.energies import Energy
from protochain.energies.on_device import prepare_energy
from protochain.minimisers.judging import CachedEnergy
from protochain.minimisers.problem import Evaluation
from protochain.minimisers.recipes import check_dihedrals
from protochain.minimisers.restraints import ChiralityRestraint
from protochain.minimisers.spaces import Cartesian
from protochain.minimisers.stages import Stage
from protochain.minimisers.verdict import Status, describe_rejections, verdict
from protochain.relaxation.presets import IN_RIGID_PROTEIN
from protochain.relaxation.problems import Problems
from protochain.relaxation.relax_settings import RelaxSettings, fixed_options, split
from protochain.relaxation.restraints import PeptideBonds
from protochain.relaxation.result import Relaxation
from protochain.relaxation.rounds import Relaxer, RoundEnd, best_round
from protochain.structure import Structure
from protochain.structure.molecule.chirality import atom_names, with_mirror_images
from protochain.structure.select import move_argument, moving_mask, select, split_sides
from protochain.validation.fixed import fixed_counts
from protochain.validation.interface import as_native
from protochain.validation.omega import describe_bonds

_NAMED = 3  # Residues and bonds that a message names.


@check_arguments(watch=WATCHER)
def relax(
    source: Any, preset: str = defaults.PRESET, *, watch: Watcher | None = None, **options: Any
) -> Relaxation:
    """Relax a structure: remove overlaps, broken bonds and strain, and preserve the fold.

    All atoms move, with springs from the heavy atoms to the input. If violations (as AlphaFold counts them)
    or overlaps remain, the springs of these residues and their neighbours are weakened, then removed, and the
    structure is minimised again. All other springs always pull to the original input, to prevent drift.

    Parameters
    ----------
    source : Structure, path, or anything that :func:`protochain.as_structure` accepts
        Structure to relax. If it is a result, its energy and selection are the defaults of the relaxation.
    preset : str
        ``predicted``, ``crystal`` or ``design`` (see :class:`protochain.relaxation.RelaxSettings`).
    watch : callable, optional
        Called with a row of the trace and the positions of each point, to show progress. Its optional method
        ``at_stage`` is called with the name of the stage and the evaluations so far.
    **options
        Further fields of ``RelaxSettings`` (``protocol``, ``tolerance``, ``stiffness``,
        ``max_iterations``, ``max_outer_iterations``, ``exclude``, ``keep_hydrogens``, ``repack``,
        ``repack_region``, ``mirror``, ``interface``, two sides to score before and after) and of
        :class:`protochain.Setup` (``forcefield``, ``solvent``, ``threads``, ``keep`` ...). With ``move``, a
        selection as of :func:`protochain.build_chain` (``sidechain``, ``interface``), all other atoms stay
        where they are, bit for bit.

    Returns
    -------
    Relaxation
        Its energy, restraints included, is never above the start's. Its status reports remaining problems.

    Raises
    ------
    ProtochainError
        If an option is invalid, or the input cannot be used.

    Examples
    --------
    >>> r = pc.relax("structures/ala10.pdb")
    >>> str(r.status)
    'converged'
    """
    relaxing, setup = split({"preset": preset, **move_argument(source), **options})
    with measure_run():
        structure = setup.load(source)
        energy = setup.energy_of(source, structure, fixed_options(relaxing, options))
        return relax_structure(structure, energy, relaxing, watch, setup.move)


@held_interrupts()
@measure_run()
def relax_structure(
    structure: Structure,
    energy: Energy,
    settings: RelaxSettings,
    watch: Watcher | None = None,
    move: str = defaults.MOVE,
) -> Relaxation:
    """Relax a structure with a prepared energy, whose force field is the one that the settings require."""
    if settings.mirror:
        structure = with_mirror_images(structure)
    if settings.interface:
        as_native(energy)
        split_sides(structure, settings.interface)
    mobile = read_only(moving_mask(structure, move), np.bool_)
    held_by = _held_by(mobile, settings)
    excluded, strength = _unrestrained_residues(structure, settings), settings.strength
    of_ligands = np.zeros(structure.n_atoms, dtype=bool)
    of_ligands[[k for ligand in structure.ligands for k in ligand.atoms]] = True
    if not mobile[~of_ligands].any():
        # In a rigid protein only the pose can change: springs to it would preserve its overlaps.
        excluded, strength = np.ones_like(excluded), replace(strength, softened=IN_RIGID_PROTEIN)
    # Each round minimises from the end of the previous one. Springs pull to ``first``.
    check_dihedrals(energy, "relax")
    energy = prepare_energy(energy, structure.positions)
    first = _repack(structure, energy, mobile, settings)
    trace = _Trace(watch)
    judged: Any = CachedEnergy(energy)
    restraint_list = settings.restraints
    user_restraints = (Restraints.of(first, restraint_list),) if restraint_list else ()
    moving = None if mobile[~structure.obstacle].all() else mobile
    relaxer = Relaxer(first, judged, strength, settings.max_iterations, trace, moving, user_restraints)
    with one_blas_thread():
        rounds = partial(relaxer.rounds, first.positions, excluded, settings.max_outer_iterations)
        ends = [relaxer.unmoved()] if settings.score_only else rounds()
    seconds = perf_counter() - trace.began
    # The best round is judged in double precision, with the residual of its last stage.
    end = best_round(ends)
    frame = Frame(structure, held_by)
    restraint, has_restraint = relaxer.restraint(end.springs), end.springs.weight.any() or user_restraints
    value, forces = judged.judge_at(end.x)
    space, total = Cartesian(structure, mobile), forces + restraint(end.x)[1]
    force = space.residual(space.torque(space.place(space.start(end.x)), total))
    restraint_values = user_restraints[0].measure(end.x) if user_restraints else ()
    status, message = _verdict(structure, judged, settings, end, force, restraint_values)
    return Relaxation(
        start=structure,
        turned=first.repairs[len(structure.repairs) :],
        x=frame(end.x),
        settings=settings,
        energy_function=energy,
        rounds=tuple(round_end.round for round_end in ends),
        best=ends.index(end),
        status=status,
        message=message,
        energy_start=judged.judge_at(structure.positions, first=True)[0],
        energy_end=value,
        rms_force=force,
        judge=judged.judge,
        frame=frame,
        seconds=seconds,
        trace=read_only(np.array(trace.rows).reshape(-1, 5)),
        restraints=(restraint(structure.positions)[0], restraint(end.x)[0]) if has_restraint else None,
        restraint_values=restraint_values,
        timings=until_now(),
        move=move,
        moving=mobile,
    )


class _Trace:
    """Collects a row for each accepted point, and passes it to the callback."""

    def __init__(self, watch: Watcher | None) -> None:
        self.watch, self.began = watch, perf_counter()
        self.report_stage = getattr(watch, "at_stage", None)
        self.rows: list[tuple[float, ...]] = []

    def __call__(self, stage: Stage, at: Evaluation, evaluations: int) -> None:
        if self.report_stage:
            self.report_stage(stage.name, evaluations)
        if not stage.recorded:
            return
        energy = at.energy - at.restraint
        self.rows.append((len(self.rows), evaluations, perf_counter() - self.began, energy, at.residual))
        if self.watch:
            row = {"evaluations": evaluations, "energy_kj_mol": energy, "max_torque_kj_mol_rad": np.nan}
            self.watch(row, at.x)


def _unrestrained_residues(structure: Structure, settings: RelaxSettings) -> NDArray[np.bool_]:
    """(nr,) bool: residues without springs, which have selected atoms or are free ligands."""
    free = np.zeros(structure.n_residues, dtype=bool)
    if settings.exclude:
        free[structure.atom_residue[select(structure, settings.exclude)]] = True
    if settings.free_ligands:
        for ligand in structure.ligands:
            free[structure.atom_residue[ligand.atoms]] = True
    return free


def _held_by(mobile: NDArray[np.bool_], settings: RelaxSettings) -> str:
    if settings.score_only or not mobile.all():
        return "atoms that stand still"
    return "springs to the start" if settings.strength.backbone[-1] > 0.0 else ""


def _repack(
    structure: Structure, energy: Energy, mobile: NDArray[np.bool_], settings: RelaxSettings
) -> Structure:
    """The structure with new rotamers of the side chains in a region, or of conflicting side chains."""
    if not (settings.repack or settings.repack_region):
        return structure
    from protochain.relaxation.repack import repack_side_chains

    region = None
    if settings.repack_region:
        region = np.unique(structure.atom_residue[select(structure, settings.repack_region)]).tolist()
    return repack_side_chains(structure, region, energy=energy, moving=mobile)


def _verdict(
    structure: Structure, energy: CachedEnergy, settings: RelaxSettings, end: RoundEnd, force: float,
    restraint_values: tuple[RestraintValue, ...],
) -> tuple[Status, str]:  # fmt: skip
    tolerance = settings.strength.tolerance
    springs = ", springs included" if end.springs.weight.any() else ""
    measured = f"RMS force {force:.4g} kJ/mol/nm for a tolerance of {tolerance:g}{springs}, by {energy.judge}"
    fixed = [f"{n} {name}" for name, n in fixed_counts(structure).items()]
    measured += f"; fixed, not relaxed: {abridge(fixed)}" if fixed else ""
    if settings.score_only:
        return Status.MEASURED, f"measured without a step: {measured}"
    problems = end.problems
    all_problems = problems if problems.moving is None else replace(problems, moving=None)
    broken = int((all_problems.violations.per_residue & ~all_problems.mendable()).sum())
    breaks = f"; {plural(broken, 'residue')} with violations at breaks of the chain: model what is missing"
    measured += breaks if broken else ""
    lines = describe_problems(problems)
    # The moving atoms cannot mend problems of fixed atoms, which do not decide the status.
    of_fixed = describe_problems(replace(problems, fixed=True)) if problems.moving is not None else []
    earlier = [line for line in of_fixed if line not in lines]
    measured += f"; was in the input, at fixed atoms: {'; '.join(earlier)}" if earlier else ""
    violated = describe_violations(restraint_values)
    if violated and springs:
        springs_to_input = f"springs to the input of up to {max(settings.strength.backbone):g} kJ/mol/nm^2"
        violated[-1] += f"; {springs_to_input} may oppose it: lower their stiffness, or exclude the residues"
    return verdict(
        end.stop, force <= tolerance, measured, structure, end.x, end.round.evaluations,
        inverted=_newly_inverted(problems), isomerised=_bonds_before(problems, _newly_reversed(problems)),
        problems=[*lines, *violated], concerns=problems.concerns,
    )  # fmt: skip


def _newly_inverted(problems: Problems) -> list[str]:
    """Stereocentres that were correct at the start and are inverted now. Corrected centres are ignored."""
    s = problems.structure
    return atom_names(s, np.setdiff1d(problems.inversions, ChiralityRestraint.of(s).inversions(s.positions)))


def _newly_reversed(problems: Problems) -> Integers:
    """Nitrogens of peptide bonds that had the target form at the start and have the other form now."""
    s = problems.structure
    return np.setdiff1d(problems.reversed_peptides, PeptideBonds.of(s).twisted_bonds(s.positions))


def _bonds_before(problems: Problems, nitrogens: Integers) -> list[str]:
    s = problems.structure
    return describe_bonds(s, problems.x, s.positions, s.atom_residue[nitrogens])


def describe_problems(problems: Problems) -> list[str]:
    """Names of the remaining problems."""
    lines = describe_rejections(problems.structure, problems.x, problems.concerns)
    rings = problems.counted_rings
    lines += [abridge([*map(str, rings)], 2)] if rings else []
    if problems.fixed:  # Other overlaps are a clash.
        pairs = problems.overlaps[problems.concerns(problems.overlaps)].tolist()
        touching = [f"{problems.structure.atom(i)} with {problems.structure.atom(j)}" for i, j in pairs]
        lines += [f"overlaps: {abridge(touching, 2)}"] if pairs else []
    twisted = _bonds_before(problems, np.setdiff1d(problems.peptides, _newly_reversed(problems)))
    lines += [f"twisted peptide bonds: {abridge(twisted, _NAMED)}"] if twisted else []
    # Breaks of the chain are not errors of the model, which may be cropped, with continuous numbers.
    residues = np.flatnonzero(problems.mendable()).tolist()
    if not residues:
        return lines
    names = abridge([problems.structure.describe_residue(residue) for residue in residues], _NAMED)
    left = f"{plural(len(residues), 'residue is', 'residues are')} left with violations"
    return [*lines, f"{left}: {names}"]
