"""Settings of a simulation: their checks, and the integrators and thermostats by name."""

from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np

from protochain.dynamics import thermostats
from protochain.errors import ProtochainError
from protochain.motion import lobatto
from protochain.motion.leapfrog import Leapfrog
from protochain.motion.midpoint import ImplicitMidpoint
from protochain.motion.runge_kutta import DormandPrince, RungeKutta4
from protochain.motion.system import Integrator
from protochain.units import MOLAR_GAS

INTEGRATORS: dict[str, Integrator] = {
    "leapfrog": Leapfrog(),
    "lobatto": Leapfrog(lobatto.drift),
    "midpoint": ImplicitMidpoint(),
    "rk4": RungeKutta4(),
    "dormand-prince": DormandPrince(),
}
THERMOSTATS: dict[str, type[thermostats.Thermostat]] = {
    "none": thermostats.Isolated,
    "langevin": thermostats.Langevin,
    "nose-hoover": thermostats.NoseHoover,
    "rescale": thermostats.Rescaling,
    "hmc": thermostats.HybridMonteCarlo,
}

LONGEST_STEP = 0.5
"""ps. Steps of bodies bound by springs are below a hundredth of this; who gives more means femtoseconds."""


@dataclass(frozen=True)
class SimulationSettings:
    """Settings that define a simulation; for their meaning see :func:`protochain.simulate`."""

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
        """Value of kT, kJ/mol."""
        return MOLAR_GAS * self.temperature

    def record(self) -> dict[str, Any]:
        """Return the settings as plain values by name."""
        return asdict(self)

    def check(self, n_steps: int, checkpoint_every: int) -> None:
        """Check the settings before any work is done.

        Raises
        ------
        ProtochainError
            If a setting is unknown, out of range or incompatible with another; the message says what to do.
        """
        for name, value, known in (
            ("thermostat", self.thermostat, THERMOSTATS),
            ("integrator", self.integrator, INTEGRATORS),
            ("loops", self.loops, ("open", "closed")),
        ):
            if value not in known:
                raise ProtochainError(f"{name} {value!r} is not known; choose from {', '.join(known)}")
        if not 0.0 < self.time_step < np.inf:
            raise ProtochainError(f"time_step {self.time_step:g} ps: give a number above 0")
        if self.time_step >= LONGEST_STEP:
            raise ProtochainError(
                f"time_step {self.time_step:g} ps: no step of this length is stable; "
                f"give picoseconds: {self.time_step / 1000:g} are {self.time_step:g} fs"
            )
        if not 0.0 <= self.temperature < np.inf:
            raise ProtochainError(f"temperature {self.temperature:g} K: give 0 or more")
        if not 0.0 <= self.friction < np.inf:
            raise ProtochainError(f"friction {self.friction:g} /ps: give 0 or more")
        for name, count in (
            ("n_steps", n_steps), ("every", self.every), ("trajectory_length", self.trajectory_length),
            ("checkpoint_every", checkpoint_every),
        ):  # fmt: skip
            if count < 1:
                raise ProtochainError(f"{name} {count}: give at least 1")
        if self.seed < 0:
            raise ProtochainError(f"seed {self.seed}: give 0 or more")
        if self.thermostat == "nose-hoover" and not (self.temperature > 0.0 and self.friction > 0.0):
            raise ProtochainError("nose-hoover: needs a temperature and a friction above 0; choose langevin")
        if THERMOSTATS[self.thermostat].metropolis:
            if not INTEGRATORS[self.integrator].reversible:
                raise ProtochainError(
                    f"{self.thermostat}: {self.integrator} is not reversible; choose leapfrog or midpoint"
                )
            if self.every % self.trajectory_length:
                raise ProtochainError(
                    f"every {self.every}: give a multiple of the trajectory length, "
                    f"{self.trajectory_length}: only the end of a trajectory is a valid sample"
                )
        if self.loops == "closed" and self.integrator != "leapfrog":
            raise ProtochainError("loops closed: only the leapfrog supports constraints; choose it")


def build_thermostat(settings: SimulationSettings, freedoms: int) -> thermostats.Thermostat:
    """Thermostat of the settings for this number of degrees of freedom; it takes its fields by name."""
    kind: Any = THERMOSTATS[settings.thermostat]
    given = settings.record() | {"thermal_energy": settings.thermal_energy, "freedoms": freedoms}
    return kind(**{field.name: given[field.name] for field in fields(kind)})
