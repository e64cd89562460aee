"""Motion of trees of rigid bodies in potentials and under loads: phase space, integrators.

Knows nothing of proteins. Any consistent set of units will do.
"""

from protochain.mechanics.motion.leapfrog import Leapfrog
from protochain.mechanics.motion.midpoint import ImplicitMidpoint
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
)

__all__ = [
    "Applied", "Constraint", "DormandPrince", "Drive", "Equations", "ImplicitMidpoint", "Integrator",
    "Leapfrog", "Load", "Phase", "Potential", "RungeKutta4", "StepTooLargeError", "System", "total",
]  # fmt: skip
