"""The energy of one chain over its torsions: minimisation, and sampling by hybrid Monte Carlo."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from protochain.chains.articulate import build_chain
from protochain.chains.chain import Chain, pose
from protochain.chains.restraint_list import Restraints
from protochain.core.arrays import Floats, Value
from protochain.core.errors import Argument, ProtochainError
from protochain.core.settings import document_fields
from protochain.core.units import MOLAR_GAS
from protochain.dynamics import (
    HybridMonteCarlo,
    Leapfrog,
    Propagator,
    State,
    System,
    chain_potential,
    fixman,
    initial,
    run,
    total,
)
from protochain.energies import Energy
from protochain.minimisers.curvature import near_terms
from protochain.minimisers.loop import run as descend
from protochain.minimisers.problem import Evaluation, Problem
from protochain.minimisers.recipes import RECIPES
from protochain.minimisers.spaces import Torsions
from protochain.minimisers.stages import PATIENCE
from protochain.searching.minima import Symmetry
from protochain.searching.moves import Moves

if TYPE_CHECKING:
    from protochain.mechanics.multibody.articulated import Articulated

TRAJECTORY_LENGTH = 20
"""Steps of a trajectory of hybrid Monte Carlo."""

_MOST = 2000  # Limit of the evaluations of one descent. From random torsions a tenth is usual.


class DescentEnd(NamedTuple):
    """End of a descent: torsions (n,), energy in kJ/mol, and number of evaluations."""

    q: Floats
    energy: float
    n_evaluations: int


class Sweep(NamedTuple):
    """Trajectories of hybrid Monte Carlo."""

    q: Floats  # (n,) rad: Torsions at the end.
    energies: Floats  # (k,) kJ/mol: Energy after each trajectory, without Fixman's potential.
    accepted: float  # Share of accepted trajectories.
    n_evaluations: int


@document_fields
@dataclass(frozen=True, eq=False)
class Landscape(Value):
    """Energy of one chain over its torsions, with a fixed root.

    The root may be fixed: the energy does not depend on position, nor with Fixman's potential on mass.
    """

    chain: Chain  # Chain whose only coordinates are its torsions.
    energy: Energy  # Energy with all terms.
    restraints: Restraints | None = None  # Added to the energy.

    @classmethod
    def of(cls, chain: Chain, energy: Energy, restraints: Any = ()) -> Landscape:
        """Fix the root of a chain.

        Raises
        ------
        ProtochainError
            If there are several chains or molecules, whose relative positions are degrees of freedom too, or
            if the energy depends on the position.
        """
        name = chain.structure.name
        # ``auto`` fixes the root of one chain, and lets runs that begin at a minimum free it.
        fixed = build_chain(chain, root="fixed" if chain.root == "fixed" else "auto")
        if np.sum(fixed.tree.parent < 0) != 1 or chain.structure.obstacle.any():
            raise ProtochainError(
                f"{name}: a search requires a single chain; select one, as by ", Argument("chains", "A"),
                " and ", Argument("keep", "none"),
            )  # fmt: skip
        if not fixed.n_v:
            raise ProtochainError(f"{name}: no bond turns with hinges {chain.opened!r}; open more kinds")
        return cls(fixed, energy, Restraints.of(fixed.structure, restraints) if restraints else None)

    @cached_property
    def _varying(self) -> Energy:
        return self.energy.without_constants(self.chain.rigid_groups, self.chain.structure.positions)

    @cached_property
    def _space(self) -> Torsions:
        return Torsions(self.chain, near_terms(self.energy))

    @cached_property
    def moves(self) -> Moves:
        """Moves of the chain's torsions."""
        return Moves.of(self.chain)

    @cached_property
    def symmetry(self) -> Symmetry:
        """Turns that only exchange equivalent atoms."""
        return Symmetry.of(self.chain)

    @property
    def period(self) -> Floats:
        """(n,) float, rad: turn of each torsion that only exchanges equivalent atoms."""
        return self.symmetry.period

    def positions(self, q: Floats) -> Floats:
        """Positions (na, 3), nm, at torsions (n,)."""
        return pose(self.chain, q).x

    def minimise(self, q: Floats, tolerance: float = 0.1) -> DescentEnd:
        """Descend by L-BFGS to a largest torque, kJ/mol/rad, from torsions (n,). Atoms may overlap."""
        # Neighbour lists set the order of sums: it must not depend on earlier evaluations.
        self._varying.list_at(self.positions(q))
        problem = Problem(self._space, self._varying, _MOST, self.restraints)
        method = RECIPES["lbfgs"].runs[0].method
        descend(problem, method, q, tolerance, PATIENCE, lambda at: None)
        best = problem.best
        if best is None or not best.is_finite:
            return DescentEnd(q, np.inf, problem.n_evaluations)
        return DescentEnd(_wrap(best.q), self._exact_energy(best), problem.n_evaluations)

    def _exact_energy(self, best: Evaluation) -> float:
        """Energy of the end of a descent in double precision, kJ/mol."""
        if self.energy.is_exact:
            return best.energy
        judge = self.energy.reference
        judge.list_at(best.pose.x)
        return judge(best.pose.x)[0] + best.restraint

    def sweep(self, q: Floats, temperature: float, time_step: float, n_trajectories: int, seed: int) -> Sweep:
        """Sample torsions from exp(-E/kT) by trajectories with Fixman's potential.

        Parameters
        ----------
        q : (n,) float, rad
            Start.
        temperature : float, K
        time_step : float, ps
        n_trajectories : int
        seed : int
            Seed of their velocities and choices.
        """
        self._varying.list_at(self.positions(q))
        kt, evaluations = MOLAR_GAS * temperature, [0]
        bias, chain_energy = fixman(kt), chain_potential(self.chain, self._varying)

        def potential(q: Floats, factors: Articulated) -> tuple[float, Floats]:
            evaluations[0] += 1
            return chain_energy(q, factors)

        restraint_terms = [chain_potential(self.chain, self.restraints)] if self.restraints else []
        system = System(self.chain.tree, total([potential, *restraint_terms, bias]))
        thermostat = HybridMonteCarlo(kt, TRAJECTORY_LENGTH)
        propagator = Propagator(system, Leapfrog(), thermostat, time_step, kt, seed, False)
        energies = []

        def note(state: State) -> None:
            at = state.at
            energies.append(at.potential - bias(at.q, at.factors)[0])

        n_steps = n_trajectories * TRAJECTORY_LENGTH
        state, _, _ = run(propagator, initial(propagator, q), n_steps, TRAJECTORY_LENGTH, note)
        _, accepted, tried, _ = state.bath.memory[:4]
        share = float(accepted / max(tried, 1.0))
        return Sweep(_wrap(state.at.q), np.array(energies), share, evaluations[0])


def _wrap(q: Floats) -> Floats:
    """Torsions from -pi to pi."""
    return np.asarray(q - 2.0 * np.pi * np.rint(q / (2.0 * np.pi)))
