"""OpenMM's minimiser on a device, as a method of the loop. Positions stay there for a hundred iterations."""

from dataclasses import dataclass, replace
from typing import Any

from protochain.minimisers.problem import BudgetSpentError, Evaluation, Problem
from protochain.minimisers.restraints import Sum, Tethers
from protochain.minimisers.spaces import Cartesian

AT_A_TIME = 100  # Iterations of a call. Each call restarts its L-BFGS, also after a failed line search.
_RESOLVED = 1e-6
"""Share of the energy. A step that gains less is the last, as single precision resolves no more."""
_STRICTER = 0.99
"""Share of the tolerance, so that the end also meets it in double precision. Forces are accurate to 1e-4."""


@dataclass(frozen=True, eq=False)
class DeviceState:
    """Last point read from OpenMM's minimiser."""

    at: Evaluation


@dataclass(frozen=True)
class DeviceDescent:
    """A hundred iterations of OpenMM's minimiser, to kJ/mol/nm. Other restraints than tethers prevent it."""

    tolerance: float
    states = (DeviceState,)

    def init(self, problem: Problem, at: Evaluation) -> DeviceState:
        """State at the start."""
        return DeviceState(at)

    def step(self, problem: Problem, state: DeviceState) -> DeviceState | None:
        """State after some iterations, each counted as an evaluation, or None if they gain nothing."""
        energy: Any = problem.energy
        restraint, space = problem.restraint, problem.space
        parts = restraint.parts if isinstance(restraint, Sum) else [restraint] if restraint else []
        tethers = next((part for part in parts if isinstance(part, Tethers)), None)
        if any(part is not tethers and part(state.at.x)[0] for part in parts):
            return None
        n = min(AT_A_TIME, problem.max_evaluations - problem.n_evaluations - 1)
        if n < 1:
            raise BudgetSpentError
        assert isinstance(space, Cartesian)
        x = energy.descend(state.at.x, space.moving, tethers, _STRICTER * self.tolerance, n)
        if x is None:
            return None
        problem.tally = replace(problem.tally, n_evaluations=problem.n_evaluations + n)
        at = problem.evaluate(x.ravel())
        gain = state.at.energy - at.energy
        return DeviceState(at) if gain > _RESOLVED * abs(state.at.energy) else None
