"""Rounds of a relaxation: minimisations with springs to the input, which are weakened if problems remain."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from protochain.chains.contacts import near_pairs, overlapping
from protochain.core.arrays import Floats, Integers, read_only
from protochain.core.graph import both_ways
from protochain.core.settings import document_fields
from protochain.energies import Energy
from protochain.energies.factory import bonded_part
from protochain.minimisers.clash_resolution import TetheredModel, unthreading_stages
from protochain.minimisers.curvature import near_terms
from protochain.minimisers.descent import Descent
from protochain.minimisers.lbfgs import LBFGS, NEAR_MEMORY
from protochain.minimisers.loop import Stop
from protochain.minimisers.metrics import NEAR_REFRESH
from protochain.minimisers.problem import BudgetSpentError, Evaluation, Force, Placement, evaluate
from protochain.minimisers.restraints import ChiralityRestraint, SoftRepulsion, Sum, Tethers
from protochain.minimisers.spaces import Cartesian
from protochain.minimisers.stages import PATIENCE, Outcome, Stage, walk, with_reference
from protochain.minimisers.steps import StrongWolfe
from protochain.relaxation.presets import Preset
from protochain.relaxation.problems import Problems
from protochain.relaxation.restraints import PeptideBonds, Planes
from protochain.structure import Structure

_BACKBONE = ("N", "CA", "C", "O", "OXT")
_MEMORY = 8
"""Pairs of L-BFGS. While overlaps separate, the curvature changes so much that older pairs mislead."""
_REFRESH = 20  # Iterations between two models of the Hessian.
_STIFFER = 60e3
"""kJ/mol/nm^2, added to the model of the Hessian for every atom, because springs make steps short. With 60
times 1000 instead of 8 the number of evaluations is halved."""
_STIFFER_NEAR = 10e3
"""kJ/mol/nm^2, the same for the model from the near terms. It saves a fifth of the evaluations."""
_HIGH = 1000.0  # kJ/mol/nm, RMS force above which a coarse energy is minimised first, several times as fast.

_WEAKER = 0.1
"""Factor of the springs of residues with violations after their first round, 0 after the next. Removing all
springs at once would change more of the fold than necessary."""


Note = Callable[[Stage, Evaluation, int], None]
"""Called with each accepted point: its stage, the point, evaluations so far."""


@document_fields
@dataclass(frozen=True)
class Round:
    """One minimisation."""

    released: int  # Residues whose springs were weakened or removed.
    violations: int  # Residues with violations at its end.
    overlaps: int  # Pairs of atoms that overlap at its end.
    iterations: int  # Steps.
    evaluations: int  # Energies computed.
    seconds: float  # Wall time.


@dataclass(frozen=True, eq=False)
class RoundEnd:
    """End of a round."""

    problems: Problems  # At the final positions.
    stop: Stop
    springs: Tethers  # Springs of its last stage.
    # (n,) int: Residues with violations, overlaps, threaded rings, inverted centres, twisted peptide bonds.
    concerned: Integers
    round: Round

    @property
    def x(self) -> Floats:
        """(na, 3) float, nm: positions."""
        return self.problems.x


@dataclass(frozen=True, eq=False)
class Relaxer:
    """Data that all rounds share."""

    structure: Structure  # The input, with turned side chains: all springs pull to it.
    energy: Energy
    strength: Preset
    max_iterations: int  # Limit of each minimisation, 0 for none.
    note: Note
    moving: NDArray[np.bool_] | None = None  # (na,) bool: Moving atoms, by default all except obstacles.
    user_restraints: tuple[Force, ...] = ()  # Restraints of the user.

    def rounds(self, x: Floats, excluded: NDArray[np.bool_], max_rounds: int) -> list[RoundEnd]:
        """Minimise from x (na, 3) nm, with fewer springs each round while violations or overlaps remain."""
        share, ends = np.where(excluded, 0.0, 1.0), list[RoundEnd]()
        # Weaken springs to wrong positions: they would prevent the turn of a C-beta, or of a peptide bond.
        problems = Problems(self.structure, x, self.moving)
        turning = self.structure.atom_residue[[*problems.inversions, *problems.reversed_peptides]]
        share[turning] = np.minimum(share[turning], _WEAKER)
        strengths = list(zip(self.strength.backbone, self.strength.side_chains, strict=True))
        strongest = strengths[-1:]
        while True:
            share = share.copy()
            # Springs would pull the bonds back through the rings.
            share[problems.of_rings()] = 0.0
            before = sum(end.round.evaluations for end in ends)
            ends.append(self._round(problems.x, share, strengths, before, bool(problems.counted_rings)))
            last = ends[-1]
            problems = last.problems
            if not len(last.concerned) or len(ends) == max_rounds:
                return ends
            # As weak as springs in series: in other programs, springs pull to the end of the previous round.
            strengths = [(main / (len(ends) + 1), side / (len(ends) + 1)) for main, side in strongest]
            weaker = np.where(self._near(last.concerned), np.where(share == 1.0, _WEAKER, 0.0), share)
            # If that did not help, residues in contact are in the way.
            persistent = last.concerned[share[last.concerned] < 1.0]
            weaker[self._touching(persistent, problems.x) & (weaker == 1.0)] = _WEAKER
            is_final = last.stop in _FINAL or not any(strengths[0])
            if is_final or (weaker == share).all():
                return ends
            share = weaker

    def unmoved(self) -> RoundEnd:
        """The input as the end of a round without steps or springs."""
        structure = self.structure
        problems = Problems(structure, structure.positions, self.moving)
        entry = Round(0, len(problems.violations.residues), len(problems.overlaps), 0, 0, 0.0)
        springs = self._springs(np.zeros(structure.n_residues), 0.0, 0.0)
        return RoundEnd(problems, Stop.TOLERANCE, springs, np.empty(0, dtype=np.int64), entry)

    def _round(
        self, x: Floats, share: Floats, strengths: Sequence[tuple[float, float]], before: int, threaded: bool
    ) -> RoundEnd:
        """Unthread rings if necessary, run the stages, and find the remaining problems."""
        began, structure, n_unthreading = perf_counter(), self.structure, 0
        springs = [self._springs(share, *strength) for strength in strengths]
        plan = [*(self._first_stages(springs[0]) if not before else []), *self._correction_stages(springs[0])]
        plan += [stage for tethers in springs for stage in self._force_field_stages(tethers)]
        if threaded and (unthread_stages := unthreading_stages(self._space, self.energy)):
            freed = self._walk_stages(unthread_stages, x, before)
            x, n_unthreading = freed.x, freed.n_evaluations
            if freed.stop is Stop.INTERRUPTED:
                plan = []
        if plan:
            outcome = self._walk_stages(plan, x, before + n_unthreading)
        else:
            outcome = replace(freed, restraint=self.restraint(springs[-1]), n_iterations=0, n_evaluations=0)
        problems = Problems(structure, read_only(outcome.x), self.moving)
        concerned = problems.residues(self.strength.planar)
        concerned &= np.bincount(structure.atom_residue, self._mobile, structure.n_residues) > 0.0
        entry = Round(
            int((share < 1.0).sum()), len(problems.violations.residues), len(problems.overlaps),
            outcome.n_iterations, n_unthreading + outcome.n_evaluations, perf_counter() - began,
        )  # fmt: skip
        return RoundEnd(problems, outcome.stop, _tethers(outcome.restraint), np.flatnonzero(concerned), entry)

    def _walk_stages(self, plan: Sequence[Stage], x: Floats, before: int) -> Outcome:
        """Run stages from x, within the allowed iterations."""
        n_points, begun = 0, set[Stage | None]()

        def record(at: Evaluation, stage: Stage, n_evaluations: int) -> None:
            nonlocal n_points
            n_points += 1
            # First points of stages are free, except in unthreading: hundreds of rings may all stay threaded.
            begun.add(None if stage.restraint is None else stage)
            self.note(stage, at, before + n_evaluations)
            if 0 < self.max_iterations <= n_points - len(begun):
                raise BudgetSpentError

        outcome = walk(plan, x, _ENDLESS, None, record, resumable=False)
        if not before + outcome.n_evaluations:
            raise KeyboardInterrupt
        return outcome

    def _first_stages(self, springs: Tethers) -> list[Stage]:
        """Stages before the force field, each of which runs only if it is needed."""
        stages, bonded = [], bonded_part(self.energy) if self.strength.softened else None
        for share, stiffness in self.strength.softened:
            if bonded is not None:
                repulsion = SoftRepulsion(self.structure, share=share, stiffness=stiffness)
                soft = self._preparatory_stage(Sum([bonded, repulsion]), springs, is_soft=True)
                stages.append(replace(soft, ready=self._overlaps))
        rough = getattr(self.energy, "coarse", None)
        if rough is not None:
            stages.append(replace(self._preparatory_stage(rough, springs), ready=self._is_high))
        return stages

    def _overlaps(self, stage: Stage, at: Placement) -> bool:
        return len(overlapping(self.structure, at.x)[0]) > 0

    def _is_high(self, stage: Stage, at: Placement) -> bool:
        return evaluate(self._space, self.energy, at.q).residual > _HIGH

    def _correction_stages(self, springs: Tethers) -> list[Stage]:
        """Stages for folded or flat atoms, inverted stereocentres, reversed peptide bonds, if there are any.

        The later stages turn bonds that are only twisted. Another stage finishes half-turned centres of
        ligands and sugars, which the mean force of a large protein does not detect.
        """
        stage = self._preparatory_stage(getattr(self.energy, "coarse", self.energy), springs)
        stages, s = [replace(stage, ready=self._needs_correction)], self.structure
        if s.ligands or s.glycans:
            sugars = np.flatnonzero(np.isin(s.atom_residue, [*s.glycans]))
            atoms = np.concatenate([sugars, *(ligand.atoms for ligand in s.ligands)])
            on = replace(stage, tolerance=_TURNED)
            stages += [
                replace(on, ready=lambda _, at: bool(np.isin(atoms, self.chirality.low_volumes(at.x)).any()))
            ]
        return stages

    def _needs_correction(self, stage: Stage, at: Placement) -> bool:
        return bool(self.shapes(at.x)[0] or len(self.peptides.reversed_bonds(at.x)))

    def _preparatory_stage(self, energy: Force, springs: Tethers, is_soft: bool = False) -> Stage:
        """Preparatory stage on another energy, which may fail and whose end is never the result."""
        tolerance, patience = (20.0, 60) if is_soft else (30.0, PATIENCE)
        return Stage(
            self._space, self._method(springs, is_soft), energy, tolerance,
            Sum([springs, self.shapes, self.peptides, *self.user_restraints]),
            recorded=False, patience=patience, name="resolving clashes", ends=(Stop.INTERRUPTED,),
        )  # fmt: skip

    def _force_field_stages(self, springs: Tethers) -> list[Stage]:
        """Stage on the force field, and a stage on its reference if that is another engine."""
        return with_reference(
            Stage(
                self._space, self._method(springs), self.energy, self.strength.tolerance,
                self.restraint(springs), name="all atoms", ends=_FINAL,
            )
        )  # fmt: skip

    def _method(self, springs: Tethers, is_soft: bool = False) -> Descent:
        stiffer, refresh, memory = _STIFFER, _REFRESH, _MEMORY
        if self._space.terms is not None:
            stiffer, refresh, memory = _STIFFER_NEAR, NEAR_REFRESH, NEAR_MEMORY
        model = TetheredModel(springs.weight + stiffer, is_soft, refresh)
        return Descent(LBFGS(model, memory), StrongWolfe())

    @cached_property
    def shapes(self) -> Sum:
        """Restraints of chiral atoms, and of planar atoms to the centre of their neighbours."""
        return Sum([self.chirality, Planes.of(self.structure)])

    def restraint(self, springs: Tethers) -> Force:
        """Restraint of the last stage of a round, which is part of its minimum.

        Springs to a bad model twist peptide bonds. While springs act, the restraint of peptides compensates.
        """
        pushed = springs.weight.any() and self.strength.planar
        additional: list[Force] = [*([self.peptides] if pushed else ()), *self.user_restraints]
        return Sum([springs, *additional]) if additional else springs

    @cached_property
    def peptides(self) -> PeptideBonds:
        """Restraint of peptide bonds to trans or cis."""
        return PeptideBonds.of(self.structure)

    @cached_property
    def chirality(self) -> ChiralityRestraint:
        """Restraint of chiral atoms to their target configurations."""
        return ChiralityRestraint.of(self.structure)

    @cached_property
    def _mobile(self) -> NDArray[np.bool_]:
        """(na,) bool: moving atoms."""
        return ~self.structure.obstacle if self.moving is None else self.moving

    @cached_property
    def _space(self) -> Cartesian:
        """Coordinates of the moving atoms, with the springs of their bonds."""
        return Cartesian(self.structure, self._mobile, near_terms(self.energy))

    def _springs(self, share: Floats, backbone: float, side_chains: float) -> Tethers:
        """Springs of the heavy atoms, with strengths scaled by the share of each residue (nr,)."""
        structure = self.structure
        weight = np.where(np.isin(structure.atom_name, _BACKBONE), backbone, side_chains)
        without = (structure.atom_element == "H") | ~self._mobile
        weight = weight * share[structure.atom_residue]
        return Tethers(structure.positions, np.where(without, 0.0, weight))

    def _near(self, residues: Integers) -> NDArray[np.bool_]:
        """(nr,) bool: residues, and their neighbours by bonds: in sequence, and by disulfides."""
        ends = both_ways(self.structure.atom_residue[self.structure.bonds])
        near = np.zeros(self.structure.n_residues, dtype=bool)
        near[residues] = near[ends[np.isin(ends[:, 0], residues), 1]] = True
        return near

    def _touching(self, residues: Integers, x: Floats) -> NDArray[np.bool_]:
        """(nr,) bool: residues in contact with the given residues, themselves included."""
        pairs = self.structure.atom_residue[near_pairs(self.structure, x, 1.0)[0]]
        touching = np.zeros(self.structure.n_residues, dtype=bool)
        touching[pairs[np.isin(pairs, residues).any(axis=1)]] = True
        return touching


_TURNED = 1.0  # kJ/mol/nm, RMS force at which the turning of a ligand's centre ends.
_ENDLESS = 1_000_000_000
_FINAL = (Stop.INTERRUPTED, Stop.NON_FINITE)


def _tethers(restraint: Force | None) -> Tethers:
    springs = restraint.parts[0] if isinstance(restraint, Sum) else restraint
    assert isinstance(springs, Tethers)
    return springs


def best_round(ends: Sequence[RoundEnd]) -> RoundEnd:
    """Round after which the fewest residues have problems, the first of equals."""
    return min(ends, key=lambda end: len(end.concerned))
