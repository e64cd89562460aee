"""Common start of runs: one chain and one energy, judged and warmed up once for all methods."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from protochain.chains.articulate import with_free_root
from protochain.chains.chain import Chain, Pose, pose
from protochain.core import defaults
from protochain.core.arrays import Floats
from protochain.energies.on_device import prepare_energy
from protochain.energies.protocol import Energy
from protochain.minimisers.curvature import near_terms
from protochain.minimisers.judging import CachedEnergy
from protochain.minimisers.problem import Evaluation, Problem, evaluate
from protochain.minimisers.recipes import Recipe
from protochain.minimisers.spaces import Cartesian, Torsions, spaces
from protochain.minimisers.start_warnings import is_crowded
from protochain.minimisers.verdict import Judgement, judge


@dataclass(frozen=True, eq=False)
class Start:
    """A chain and its energy, with data derived from them for any method."""

    chain: Chain
    energy: Energy  # With all terms.
    judge: str = defaults.JUDGE  # One of ``settings.JUDGES``.

    def __post_init__(self) -> None:
        object.__setattr__(self, "energy", prepare_energy(self.energy, self.chain.structure.positions))

    @cached_property
    def pose(self) -> Pose:
        """Pose of the chain at its start, with exactly the positions of the structure."""
        return replace(pose(self.chain, self.chain.q0), x=self.chain.structure.positions)

    @cached_property
    def cached_energy(self) -> CachedEnergy:
        """The energy of runs, with their judge and a cache."""
        return CachedEnergy(self.energy, self.judge)

    @cached_property
    def start_values(self) -> tuple[float, Floats]:
        """Energy, kJ/mol, and forces (na, 3) of the start, by the judge."""
        return self.cached_energy.judge_at(self.pose.x, first=True)

    @cached_property
    def is_crowded(self) -> bool:
        """Whether atoms overlap at the start, or a bond passes through a ring."""
        return is_crowded(self.chain.structure)

    @cached_property
    def judgement(self) -> Judgement:
        """Energy and residuals of the start in double precision."""
        return judge(self.chain, self.pose, self.start_values)

    def of(self, recipe: Recipe, judge: str = defaults.JUDGE) -> "Start":
        """Start for a method and a judge. Methods that move masses free a root that ``auto`` has fixed."""
        start = self if judge == self.judge else replace(self, judge=judge)
        moves = recipe.moves_masses and self.chain.root == "auto"
        return start._with_free_root if moves else start

    @cached_property
    def _with_free_root(self) -> "Start":
        return replace(self, chain=with_free_root(self.chain))

    @property
    def _spaces(self) -> tuple[Torsions, Cartesian]:
        return spaces(self.chain, near_terms(self.energy))

    @cached_property
    def reduced_energy(self) -> Energy:
        """Energy without the terms that are constant in the chain."""
        return self.energy.without_constants(self.chain.rigid_groups, self.pose.x)

    def energy_of(self, recipe: Recipe) -> Energy:
        """Energy that the first run of a method evaluates."""
        return self.reduced_energy if recipe.in_torsions else self.energy

    def warm(self, recipe: Recipe) -> None:
        """Compile kernels and create contexts before the clock starts."""
        # The order of sums depends on the neighbour lists: build them at the start.
        self.energy.list_at(self.pose.x)
        # Otherwise the run evaluates its start itself.
        if recipe.in_torsions or self.cached_energy.judging is not self.energy:
            _ = self.judgement
        if recipe.in_torsions:
            _ = self._warm_in_torsions
        if not recipe.keeps_geometry:
            _ = self._warm_atoms
        for run in recipe.runs:
            if hasattr(run.method, "warm"):
                run.method.warm(Problem(self._spaces[0], self.reduced_energy, 1), self._warm_in_torsions)

    @cached_property
    def _warm_in_torsions(self) -> Evaluation:
        torsions = self._spaces[0]
        at = evaluate(torsions, self.reduced_energy, torsions.move(self.chain.q0, np.zeros(self.chain.n_v)))
        torsions.stiffness(at)(at.torque)
        torsions.inertia(at)(at.torque)
        # The second evaluation checks whether the neighbour lists are still valid.
        self.reduced_energy(self.pose.x)
        return at

    @cached_property
    def _warm_atoms(self) -> None:
        # The run begins with the same evaluation.
        atoms = self._spaces[1]
        at = evaluate(atoms, self.cached_energy, self.pose.x.ravel())
        if self.energy.device == "cpu":
            atoms.stiffness(at)(at.torque)
