"""Rounds of a relaxation: minimised under springs to the input, and let go where that does not suffice."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from itertools import count
from time import perf_counter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from protochain.contacts import near_pairs, overlapping
from protochain.core.arrays import Floats, Integers, read_only
from protochain.energies import Energy
from protochain.energies.bonded import bonded_part
from protochain.minimisers.curvature import near_terms
from protochain.minimisers.descent import Descent
from protochain.minimisers.lbfgs import LBFGS, NEAR_MEMORY
from protochain.minimisers.loop import Stop, run
from protochain.minimisers.metrics import NEAR_REFRESH
from protochain.minimisers.parting import Held, unthreading
from protochain.minimisers.problem import BudgetSpentError, Evaluation, Force, Problem, evaluate
from protochain.minimisers.recipes import SINGLE_PRECISION_ENDS
from protochain.minimisers.restraints import SoftRepulsion, Sum, Tethers
from protochain.minimisers.spaces import Cartesian
from protochain.minimisers.stages import PATIENCE, lowest
from protochain.minimisers.steps import StrongWolfe
from protochain.relaxation.chirality_restraint import Hands
from protochain.relaxation.peptides import PeptideBonds
from protochain.relaxation.planarity_restraint import Planes
from protochain.relaxation.presets import Preset
from protochain.structure import Structure
from protochain.validation import threaded_rings, violations
from protochain.validation.rings import ThreadedRing
from protochain.validation.violations import Violations

_BACKBONE = ("N", "CA", "C", "O", "OXT")
_MEMORY = 8
"""Pairs of L-BFGS: while overlaps part, the curvature changes so much that older ones mislead."""
_REFRESH = 20
"""Iterations between two models of the Hessian."""
_STIFFER = 60e3
"""kJ/mol/nm^2, added to the model of the Hessian for every atom: under springs steps are short. With 60
times 1000 in place of 8 the number of evaluations falls by half."""
_STIFFER_NEAR = 10e3
"""kJ/mol/nm^2, the same for the model from the near terms: a fifth fewer evaluations than with none."""
_HIGH = 1000.0
"""kJ/mol/nm, RMS force from which on a rough energy does the first part of the way, several times as fast."""

_WEAKER = 0.1
"""Share of their springs that residues with violations keep at first; the next time they lose them all.
Without any at once, more of the fold gives way than has to."""


class Phase(StrEnum):
    """What a minimisation is for."""

    GENTLE = "parting overlaps"
    """Its energy is not the force field's."""
    WHOLE = "all atoms"


Note = Callable[[Phase, Evaluation, int], None]
"""Told each point accepted: what for, the point, evaluations so far."""


@dataclass(frozen=True)
class Round:
    """One minimisation.

    Parameters
    ----------
    let_go : int
        Residues whose springs were weakened, or taken away.
    violations : int
        Residues with violations at its end.
    overlaps : int
        Pairs of atoms that overlap at its end.
    iterations, evaluations : int
        Steps, and energies computed.
    seconds : float
        Wall time.
    """

    let_go: int
    violations: int
    overlaps: int
    iterations: int
    evaluations: int
    seconds: float


@dataclass(frozen=True, eq=False)
class Ended:
    """Where a round ended.

    Parameters
    ----------
    x : (na, 3) float, nm
    stop : Stop
    springs : Tethers
        Those of its last stage.
    concerned : (n,) int
        Residues with violations, overlaps, threaded rings, chiral atoms of the wrong hand or twisted peptide
        bonds.
    round : Round
    """

    x: Floats
    stop: Stop
    springs: Tethers
    concerned: Integers
    round: Round


@dataclass(frozen=True, eq=False)
class Relaxer:
    """What all rounds share.

    Parameters
    ----------
    structure : Structure
        The input, or that with side chains turned: all springs lead to it.
    energy : Energy
    strength : Preset
    max_iterations : int
        Of each minimisation; 0 for no limit.
    note : callable
    moving : (na,) bool, optional
        Atoms that may move; all but obstacles by default.
    """

    structure: Structure
    energy: Energy
    strength: Preset
    max_iterations: int
    note: Note
    moving: NDArray[np.bool_] | None = None

    def rounds(self, x: Floats, excluded: NDArray[np.bool_], most: int) -> list[Ended]:
        """Minimise from x, and again with fewer springs while there are violations or overlaps.

        Parameters
        ----------
        x : (na, 3) float, nm
            Where the first begins.
        excluded : (nr,) bool
            Residues without springs.
        most : int
            Rounds at most.
        """
        share, done = np.where(excluded, 0.0, 1.0), list[Ended]()
        # Their places are wrong: springs to them would keep the C-beta, or the peptide's atoms, off.
        turning = self.structure.atom_residue[[*self.hands.wrong(x), *self.peptides.reversed(x)]]
        share[turning] = np.minimum(share[turning], _WEAKER)
        strengths = list(zip(self.strength.backbone, self.strength.side_chains, strict=True))
        strongest = strengths[-1:]
        while True:
            x, share, work = self._freed(x, share, sum(each.round.evaluations for each in done))
            springs = self._springs(share, *strengths[0])
            if not done:
                x, work = self._begun(x, springs, work)
            x, work = self._righted(x, springs, work)
            done.append(self._round(x, share, strengths, work))
            last = done[-1]
            x = last.x
            # As weak as springs in series: those of other programs lead to the end of the round before.
            strengths = [(own / (len(done) + 1), beside / (len(done) + 1)) for own, beside in strongest]
            less = np.where(self._near(last.concerned), np.where(share == 1.0, _WEAKER, 0.0), share)
            # Where that did not help, what lies against them is in the way.
            still_wrong = last.concerned[share[last.concerned] < 1.0]
            less[self._touching(still_wrong, x) & (less == 1.0)] = _WEAKER
            still = last.stop in _FINAL or not any(strengths[0])
            if still or not len(last.concerned) or len(done) == most or (less == share).all():
                return done
            share = less

    def _begun(self, x: Floats, springs: Tethers, work: "_Work") -> "tuple[Floats, _Work]":
        """Positions from which the force field takes over, and the work so far."""
        if self.strength.softened and len(_overlapping(self.structure, x)):
            bonded = bonded_part(self.energy)
            if bonded is not None:
                gentle = Sum([bonded, SoftRepulsion(self.structure)])
                x, _, work = self._minimised(gentle, springs, x, work, _SOFT)
        rough = getattr(self.energy, "coarse", None)
        if rough is not None and evaluate(self._space, self.energy, x.ravel()).residual > _HIGH:
            x, _, work = self._minimised(rough, springs, x, work, _ROUGH)
        return x, work

    def _righted(self, x: Floats, springs: Tethers, work: "_Work") -> "tuple[Floats, _Work]":
        """Positions without folded or nearly flat atoms, wrong hands or reversed peptide bonds, and the work.

        Bonds that are only twisted are turned by the stages that follow.
        """
        if not self.shapes(x)[0] and not len(self.peptides.reversed(x)):
            return x, work
        x, _, work = self._minimised(getattr(self.energy, "coarse", self.energy), springs, x, work, _ROUGH)
        return x, work

    def _round(self, x: Floats, share: Floats, strengths: list[tuple[float, float]], work: "_Work") -> Ended:
        began, structure = perf_counter(), self.structure
        for strength in strengths:
            springs = self._springs(share, *strength)
            x, stop, work = self._minimised(self.energy, springs, x, work)
            if not self.energy.is_exact and stop in SINGLE_PRECISION_ENDS:
                x, stop, work = self._minimised(self.energy.reference, springs, x, work)
            if stop in _FINAL:
                break
        found, pairs = violations(structure, x), _overlapping(structure, x)
        wrong = mendable(structure, found)
        wrong[self._of_rings(threaded_rings(structure, x))] = True
        wrong[structure.atom_residue[pairs]] = True
        wrong[structure.atom_residue[self.hands.wrong(x)]] = True
        if self.strength.planar:
            wrong[structure.atom_residue[self.peptides.wrong(x)]] = True
        wrong &= np.bincount(structure.atom_residue, self._mobile, structure.n_residues) > 0.0
        seconds = perf_counter() - began
        told = Round(
            int((share < 1.0).sum()),
            len(found.residues),
            len(pairs),
            work.iterations,
            work.evaluations,
            seconds,
        )
        return Ended(read_only(x), stop, springs, np.flatnonzero(wrong), told)

    def _minimised(
        self, energy: Force, springs: Tethers, x: Floats, work: "_Work", stage: "_Stage | None" = None
    ) -> "tuple[Floats, Stop, _Work]":
        """Positions, why it ended, and the work with that of the stages before."""
        if work.interrupted:
            return x, Stop.INTERRUPTED, work
        stage = stage or _Stage(Phase.WHOLE, self.strength.tolerance, PATIENCE)
        space = self._space
        if space.terms is None:
            direction = LBFGS(Held(springs.weight + _STIFFER, stage is _SOFT, _REFRESH), _MEMORY)
        else:
            direction = LBFGS(Held(springs.weight + _STIFFER_NEAR, stage is _SOFT, NEAR_REFRESH), NEAR_MEMORY)
        method = Descent(direction, StrongWolfe())
        restraint = self.restraint(springs)
        if stage.phase is Phase.GENTLE:
            restraint = Sum([springs, self.shapes, self.peptides])
        problem = Problem(space, energy, _ENDLESS, restraint)
        seen, allowed = count(), (self.max_iterations or _ENDLESS) - work.iterations

        def record(at: Evaluation) -> None:
            self.note(stage.phase, at, work.so_far + problem.n_evaluations)
            if next(seen) >= allowed:
                raise BudgetSpentError

        q = space.start(x)
        try:
            ending = run(problem, method, q, stage.tolerance, stage.patience, record)
        except KeyboardInterrupt:
            if not work.so_far:
                raise
            return x, Stop.INTERRUPTED, work._replace(interrupted=True)
        x = space.place(lowest(problem, ending, q)).x
        return x, ending.stop, work.and_more(ending.last.n_iterations, problem.n_evaluations, ending.stop)

    @cached_property
    def shapes(self) -> Sum:
        """Push of chiral atoms to their hands, and of planar ones into the middle of their neighbours."""
        return Sum([self.hands, Planes.of(self.structure)])

    def restraint(self, springs: Tethers) -> Force:
        """What holds the last stage of a round, of whose minimum it is part.

        Springs to a bad model twist peptide bonds; the push to their form makes up for it, while they act.
        """
        pushed = springs.weight.any() and self.strength.planar
        return Sum([springs, self.peptides]) if pushed else springs

    @cached_property
    def peptides(self) -> PeptideBonds:
        """Push of peptide bonds to trans or cis."""
        return PeptideBonds.of(self.structure)

    @cached_property
    def hands(self) -> Hands:
        """Push of chiral atoms to the hands that they should have."""
        return Hands.of(self.structure)

    @cached_property
    def _mobile(self) -> NDArray[np.bool_]:
        """(na,) bool: atoms that may move."""
        return ~self.structure.obstacle if self.moving is None else self.moving

    @cached_property
    def _space(self) -> Cartesian:
        """Atoms that may move, with the springs of their bonds."""
        return Cartesian(self.structure, self._mobile, near_terms(self.energy))

    def _freed(self, x: Floats, share: Floats, before: int) -> "tuple[Floats, Floats, _Work]":
        """Positions without threaded rings, springs that do not draw the bonds back, and the work."""
        threaded = threaded_rings(self.structure, x)
        if not threaded:
            return x, share, _Work(before)
        let_go = share.copy()
        let_go[self._of_rings(threaded)] = 0.0
        x, work = self._unthreaded(x, _Work(before))
        return x, let_go, work

    def _of_rings(self, threaded: Sequence[ThreadedRing]) -> list[int]:
        """Residues of rings and of the bonds that go through them."""
        return [int(self.structure.atom_residue[i]) for ring in threaded for i in (*ring.atoms, *ring.bond)]

    def _unthreaded(self, x: Floats, work: "_Work") -> "tuple[Floats, _Work]":
        """Positions with bonds drawn out of rings, as far as that is possible, and the work."""
        space = self._space
        # One budget for all stages: of hundreds of rings none may come free.
        left = iter(range(self.max_iterations)) if self.max_iterations else count()
        for stage in unthreading(space, self.energy):
            q = space.start(x)
            if stage.ready and not stage.ready(stage, space.place(q)):
                continue
            own = stage.fit(stage, x) if stage.fit else stage
            problem = Problem(space, own.energy, _ENDLESS)

            def record(at: Evaluation, before: int = work.so_far, problem: Problem = problem) -> None:
                self.note(Phase.GENTLE, at, before + problem.n_evaluations)
                if next(left, None) is None:
                    raise BudgetSpentError

            try:
                ending = run(problem, own.method, q, own.tolerance, own.patience, record)
            except KeyboardInterrupt:
                if not work.so_far:
                    raise
                return x, work._replace(interrupted=True)
            x = space.place(own.answer(problem, ending, q)).x
            work = work.and_more(0, problem.n_evaluations, ending.stop)
            if ending.stop in (Stop.BUDGET, Stop.INTERRUPTED):
                break
        return x, work

    def _springs(self, share: Floats, backbone: float, side_chains: float) -> Tethers:
        """Springs of the heavy atoms; each residue (nr,) has its share of their strength."""
        structure = self.structure
        weight = np.where(np.isin(structure.atom_name, _BACKBONE), backbone, side_chains)
        without = (structure.atom_element == "H") | ~self._mobile
        weight = weight * share[structure.atom_residue]
        return Tethers(structure.positions, np.where(without, 0.0, weight))

    def _near(self, residues: Integers) -> NDArray[np.bool_]:
        """(nr,) bool: residues, and those bonded to them: neighbours in sequence, and by disulfides."""
        concerned = np.zeros(self.structure.n_residues, dtype=bool)
        concerned[residues] = True
        ends = self.structure.atom_residue[self.structure.bonds]
        near = concerned.copy()
        for a, b in ((0, 1), (1, 0)):
            near[ends[concerned[ends[:, a]], b]] = True
        return near

    def _touching(self, residues: Integers, x: Floats) -> NDArray[np.bool_]:
        """(nr,) bool: residues with atoms in contact with others."""
        pairs = self.structure.atom_residue[near_pairs(self.structure, x, 1.0)[0]]
        touching = np.zeros(self.structure.n_residues, dtype=bool)
        touching[pairs[np.isin(pairs, residues).any(axis=1)]] = True
        return touching


class _Work(NamedTuple):
    """Evaluations of the rounds before; iterations and evaluations of a round so far; whether it must end."""

    before: int
    iterations: int = 0
    evaluations: int = 0
    interrupted: bool = False

    @property
    def so_far(self) -> int:
        """Evaluations of all rounds."""
        return self.before + self.evaluations

    def and_more(self, iterations: int, evaluations: int, stop: Stop) -> "_Work":
        """With those of another minimisation, and how it ended."""
        iterations, evaluations = self.iterations + iterations, self.evaluations + evaluations
        return _Work(self.before, iterations, evaluations, stop is Stop.INTERRUPTED)


class _Stage(NamedTuple):
    """What a minimisation is for, its tolerance in kJ/mol/nm, and its patience."""

    phase: Phase
    tolerance: float
    patience: int


_SOFT = _Stage(Phase.GENTLE, 20.0, 60)
_ROUGH = _Stage(Phase.GENTLE, 30.0, PATIENCE)


_ENDLESS = 1_000_000_000
_FINAL = (Stop.INTERRUPTED, Stop.NON_FINITE)


def _overlapping(structure: Structure, x: Floats) -> Integers:
    """(n, 2) int: pairs of atoms that overlap."""
    return overlapping(structure, x)[0]


def mendable(structure: Structure, found: Violations) -> NDArray[np.bool_]:
    """(nr,) bool: residues with violations but those of a peptide bond that a broken chain does not have."""
    n, of = structure.n_atoms, structure.atom_residue
    bonded = np.sort(structure.bonds, axis=1) @ [n, 1]
    at_breaks, elsewhere = np.zeros((2, structure.n_residues), dtype=bool)
    joints = (found.bonds, (0, 1)), (found.angles_ca_c_n, (1, 2)), (found.angles_c_n_ca, (0, 1))
    for atoms, ends in joints:
        is_bond = np.isin(np.sort(atoms[:, ends], axis=1) @ [n, 1], bonded)
        at_breaks[of[atoms[~is_bond]]] = elsewhere[of[atoms[is_bond]]] = True
    for atoms in (found.clashes, found.within):
        elsewhere[of[atoms]] = True
    return np.asarray(found.per_residue & ~(at_breaks & ~elsewhere))


def fewest_left(done: Sequence[Ended]) -> Ended:
    """Round after which the fewest residues have violations or overlaps, the first of equals."""
    return min(done, key=lambda each: len(each.concerned))
