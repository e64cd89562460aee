"""What stiff dampers take in steps that do not resolve them."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from protochain.core.arrays import Floats
from protochain.mechanics.motion import Equations, Integrator, Phase, StepTooLargeError
from protochain.mechanisms.rosenbrock import Rosenbrock

_TRUSTED = 0.01
"""Error of a step's balance, of the energy that flows in it, up to which the power at its ends is trusted."""


@dataclass(frozen=True)
class WithDampers(Integrator):
    """Rosenbrock's method, with the work of dampers that are stiffer than its steps.

    The step itself is right with any damper, but what the damper takes is not the integral of the power at
    the step's ends. Where a step's energies do not balance by it, the step is followed in substeps:
    what those lose is what dampers have taken, and what the step has lost beside it comes from vibrations
    that it does not resolve. That no sum of powers could tell, nor half of the step, which loses the same.

    integrator: The method.
    taking (k,) bool: Which of the works of a phase are of dampers and friction.
    """

    integrator: Rosenbrock
    taking: NDArray[np.bool_]

    def step(self, system: Equations, at: Phase, time_step: float) -> Phase:
        """Advance by one time step."""
        after = self.integrator.step(system, at, time_step)
        work = after.work - at.work
        flow = max(at.kinetic, after.kinetic) + abs(after.potential - at.potential) + np.sum(np.abs(work))
        if abs(after.total - at.total - np.sum(work)) <= _TRUSTED * flow:
            return after
        try:
            closer = self.integrator.follow(system, at, time_step)
        except StepTooLargeError:
            return after
        taken = closer.total - at.total - np.sum((closer.work - at.work)[~self.taking])
        return replace(after, work=at.work + self._shared(work, min(float(taken), 0.0)))

    def _shared(self, work: Floats, taken: float) -> Floats:
        """Work (k,) of a step, of which dampers have what they take, shared as the powers say."""
        theirs = np.abs(work) * self.taking
        share = theirs / np.sum(theirs) if np.any(theirs) else theirs
        return np.where(self.taking, taken * share, work)
