"""The numbers and names of a simulation, what they may be, and the parts they stand for."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from protochain.dynamics import lobatto
from protochain.dynamics.leapfrog import Leapfrog
from protochain.dynamics.midpoint import ImplicitMidpoint
from protochain.dynamics.runge_kutta import DormandPrince, RungeKutta4
from protochain.dynamics.system import Integrator
from protochain.dynamics.thermostats import (
    HybridMonteCarlo,
    Isolated,
    Langevin,
    NoseHoover,
    Rescaling,
    Thermostat,
)  # fmt: skip
from protochain.errors import ProtochainError
from protochain.units import MOLAR_GAS

INTEGRATORS: dict[str, Integrator] = {
    "leapfrog": Leapfrog(),
    "lobatto": Leapfrog(lobatto.fly),
    "midpoint": ImplicitMidpoint(),
    "rk4": RungeKutta4(),
    "dormand-prince": DormandPrince(),
}
THERMOSTATS = ("none", "langevin", "nose-hoover", "rescale", "hmc")


@dataclass(frozen=True)
class Settings:
    """How to simulate: as :func:`protochain.simulate` takes it."""

    temperature: float
    time_step: float
    thermostat: str
    friction: float
    integrator: str
    fixman: bool
    loops: str
    hydrogen_mass: float | None
    trajectory_length: int
    every: int
    seed: int

    @property
    def thermal_energy(self) -> float:
        """Return kT, kJ/mol."""
        return MOLAR_GAS * self.temperature

    def record(self) -> dict[str, Any]:
        """Return plain values by name."""
        return asdict(self)

    def check(self, n_steps: int, checkpoint_every: int) -> None:
        """Refuse what makes no sense, before any work is done.

        Raises
        ------
        ProtochainError
            Naming the setting and the mend.
        """
        for name, value, known in (
            ("thermostat", self.thermostat, THERMOSTATS),
            ("integrator", self.integrator, tuple(INTEGRATORS)),
            ("loops", self.loops, ("open", "closed")),
        ):
            if value not in known:
                raise ProtochainError(f"{name} {value!r} is not known; choose from {', '.join(known)}")
        if not 0.0 < self.time_step < np.inf:
            raise ProtochainError(f"time-step {1000 * self.time_step:g} fs: give a number above 0")
        if not 0.0 <= self.temperature < np.inf:
            raise ProtochainError(f"temperature {self.temperature:g} K: give 0 or more")
        if not 0.0 <= self.friction < np.inf:
            raise ProtochainError(f"friction {self.friction:g} /ps: give 0 or more")
        for name, count in (
            ("steps", n_steps), ("every", self.every), ("trajectory-length", self.trajectory_length),
            ("checkpoint-every", checkpoint_every),
        ):  # fmt: skip
            if count < 1:
                raise ProtochainError(f"{name} {count}: give at least 1")
        if self.seed < 0:
            raise ProtochainError(f"seed {self.seed}: give 0 or more")
        if self.thermostat == "nose-hoover" and not (self.temperature > 0.0 and self.friction > 0.0):
            raise ProtochainError("nose-hoover: needs a temperature and a friction above 0; choose langevin")
        if self.thermostat == "hmc" and self.integrator not in ("leapfrog", "lobatto", "midpoint"):
            raise ProtochainError(f"hmc: {self.integrator} is not reversible; choose leapfrog or midpoint")
        if self.thermostat == "hmc" and self.every % self.trajectory_length:
            raise ProtochainError(
                f"every {self.every}: give a multiple of the trajectory length, {self.trajectory_length}; "
                "between its ends a trajectory is no sample"
            )
        if self.loops == "closed" and self.integrator != "leapfrog":
            raise ProtochainError("loops closed: only the leapfrog holds constraints; choose it")
        if self.loops == "closed" and self.fixman:
            raise ProtochainError("loops closed: Fixman's potential is not known there; leave out one")


def integrator(settings: Settings) -> Integrator:
    """Return the integrator of a name."""
    return INTEGRATORS[settings.integrator]


def thermostat(settings: Settings, freedoms: int) -> Thermostat:
    """Return the thermostat of a name, for as many freedoms as can move."""
    kt, friction = settings.thermal_energy, settings.friction
    if settings.thermostat == "none":
        return Isolated()
    if settings.thermostat == "langevin":
        return Langevin(kt, friction)
    if settings.thermostat == "rescale":
        return Rescaling(kt, freedoms, friction)
    if settings.thermostat == "nose-hoover":
        return NoseHoover(kt, freedoms, friction)
    return HybridMonteCarlo(kt, settings.trajectory_length)
