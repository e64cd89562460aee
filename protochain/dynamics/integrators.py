"""Integrators by their names in settings, and the systems that they advance, from general mechanics."""

from protochain.mechanics.motion import lobatto
from protochain.mechanics.motion.leapfrog import Leapfrog
from protochain.mechanics.motion.midpoint import ImplicitMidpoint
from protochain.mechanics.motion.runge_kutta import DormandPrince, RungeKutta4
from protochain.mechanics.motion.system import Integrator, Phase, StepTooLargeError, System, total

__all__ = [
    "INTEGRATORS", "DormandPrince", "ImplicitMidpoint", "Leapfrog", "Phase", "RungeKutta4",
    "StepTooLargeError", "System", "total",
]  # fmt: skip

INTEGRATORS: dict[str, Integrator] = {
    "leapfrog": Leapfrog(),
    "lobatto": Leapfrog(lobatto.drift),
    "midpoint": ImplicitMidpoint(),
    "rk4": RungeKutta4(),
    "dormand-prince": DormandPrince(),
}
