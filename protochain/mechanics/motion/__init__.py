"""Motion of trees of rigid bodies in potentials and under loads: phase space, integrators, events.

Knows nothing of proteins. Any consistent set of units will do.
"""

from protochain.mechanics.motion.closed import ClosedEquations
from protochain.mechanics.motion.events import Event, march
from protochain.mechanics.motion.leapfrog import Leapfrog
from protochain.mechanics.motion.midpoint import ImplicitMidpoint
from protochain.mechanics.motion.rosenbrock import Rosenbrock
from protochain.mechanics.motion.runge_kutta import DormandPrince, RungeKutta4
from protochain.mechanics.motion.system import (
    Applied,
    Constraint,
    Drive,
    Equations,
    Integrator,
    Load,
    Phase,
    Potential,
    StepTooLargeError,
    System,
    total,
)  # fmt: skip

__all__ = [
    "Applied", "ClosedEquations", "Constraint", "DormandPrince", "Drive", "Equations", "Event",
    "ImplicitMidpoint", "Integrator", "Leapfrog", "Load", "Phase", "Potential", "Rosenbrock", "RungeKutta4",
    "StepTooLargeError", "System", "march", "total",
]  # fmt: skip
