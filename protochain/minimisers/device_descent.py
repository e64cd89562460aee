"""OpenMM's minimiser on a device, as a method of the loop; positions stay there for a hundred iterations."""

from dataclasses import dataclass, replace
from typing import Any

from protochain.minimisers.problem import BudgetSpentError, Evaluation, Problem
from protochain.minimisers.restraints import Sum, Tethers
from protochain.minimisers.spaces import Cartesian

AT_A_TIME = 100
"""Iterations between two looks: each time its L-BFGS begins anew, also where its line search has stumbled."""

_RESOLVED = 1e-6
"""Of the energy: a step that gains less is the last, for single precision tells no more apart."""

_STRICTER = 0.99
"""Of the tolerance, so that the end meets it in double precision, too: forces are right to 1e-4 of it."""


@dataclass(frozen=True, eq=False)
class DeviceState:
    """Where OpenMM's minimiser was last looked at."""

    at: Evaluation


@dataclass(frozen=True)
class DeviceDescent:
    """A hundred iterations of OpenMM's minimiser, to kJ/mol/nm; none where more than tethers hold atoms."""

    tolerance: float
    states = (DeviceState,)

    def init(self, problem: Problem, at: Evaluation) -> DeviceState:
        """State at the start."""
        return DeviceState(at)

    def step(self, problem: Problem, state: DeviceState) -> DeviceState | None:
        """State after some iterations, each counted as an evaluation; None if they gain nothing."""
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
        gained = state.at.energy - at.energy
        return DeviceState(at) if gained > _RESOLVED * abs(state.at.energy) else None
