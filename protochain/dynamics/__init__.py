"""Constrained molecular dynamics of chains: integrators, thermostats, Fixman's potential, Monte Carlo."""

from protochain.dynamics.closure import Closure, closure_of
from protochain.dynamics.com_motion import remove_com_motion
from protochain.dynamics.fixman import fixman
from protochain.dynamics.loop import Ending, Propagator, State, advance, initial, run
from protochain.dynamics.potential import chain_potential
from protochain.dynamics.settings import HingeSpring, Pull
from protochain.dynamics.simulate import simulate
from protochain.dynamics.simulation import Simulation
from protochain.dynamics.thermostats import (
    HybridMonteCarlo,
    Isolated,
    Langevin,
    NoseHoover,
    Rescaling,
    Thermostat,
)  # fmt: skip
from protochain.mechanics.motion.leapfrog import Leapfrog
from protochain.mechanics.motion.midpoint import ImplicitMidpoint
from protochain.mechanics.motion.runge_kutta import DormandPrince, RungeKutta4
from protochain.mechanics.motion.system import Phase, StepTooLargeError, System, total

__all__ = [
    "Closure", "DormandPrince", "Ending", "HingeSpring", "HybridMonteCarlo", "ImplicitMidpoint", "Isolated",
    "Langevin", "Leapfrog", "NoseHoover", "Phase", "Propagator", "Pull", "Rescaling", "RungeKutta4",
    "Simulation", "State", "StepTooLargeError", "System", "Thermostat", "advance", "chain_potential",
    "closure_of", "fixman", "initial", "remove_com_motion", "run", "simulate", "total",
]  # fmt: skip
