"""Settings of a simulation: their checks, and the integrators and thermostats by name."""

from collections.abc import Iterable
from dataclasses import dataclass, fields
from typing import Any, Self

import numpy as np

from protochain.core import defaults
from protochain.core.checks import check_fields, ends, number, quantity, shown, text
from protochain.core.errors import Argument, ProtochainError, refused
from protochain.core.units import MOLAR_GAS
from protochain.dynamics import thermostats
from protochain.hinges import HINGES
from protochain.mechanics.motion import lobatto
from protochain.mechanics.motion.leapfrog import Leapfrog
from protochain.mechanics.motion.midpoint import ImplicitMidpoint
from protochain.mechanics.motion.runge_kutta import DormandPrince, RungeKutta4
from protochain.mechanics.motion.system import Integrator

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


FARTHEST_PULL = 0.1
"""nm. An atom's radius: a spring that moves farther in one step is meant in another unit."""


@dataclass(frozen=True)
class Pull:
    """Spring between two places of a structure, whose length at rest changes at constant speed.

    Parameters
    ----------
    between : pair of str, or str
        Two atoms, ``("A:1:N", "A:20:C")`` or ``"A:1:N-A:20:C"``: chain, number with insertion code, name. A
        residue, ``A:20``, or a selection in MDAnalysis's language stands for its centre of mass; two of these
        in one text have `` - `` between them.
    stiffness : float, kJ/mol/nm^2
        Of the spring.
    speed : float, nm/ps
        At which its length at rest grows from the distance at the start; below 0 it shrinks, down to no
        length; 0 holds the distance.

    Raises
    ------
    ProtochainError
        If a number makes no sense, or the places cannot be read.
    """

    between: tuple[str, str]
    stiffness: float = defaults.PULL_STIFFNESS
    speed: float = defaults.PULL_SPEED

    def __post_init__(self) -> None:
        check_fields(
            self, between=ends, stiffness=quantity("kilojoule_per_mole/nanometer/nanometer"),
            speed=quantity("nanometer/picosecond"),
        )  # fmt: skip
        if not 0.0 < self.stiffness < np.inf:
            raise ProtochainError(f"stiffness {self.stiffness:g} kJ/mol/nm^2: give a number above 0")
        if not np.isfinite(self.speed):
            raise ProtochainError(f"speed {self.speed:g} nm/ps: give a finite number")

    @classmethod
    def of(cls, value: Any, name: str = "pull") -> "Pull | None":
        """Read what :func:`protochain.simulate` takes: a Pull, two places, or None."""
        if value is None or isinstance(value, cls):
            return value
        return cls(ends(value, name))

    def record(self) -> dict[str, Any]:
        """Return the settings as plain values by name, with their units."""
        return {
            "pull": str(self),
            "pull_stiffness_kj_mol_nm2": float(self.stiffness),
            "pull_speed_nm_ps": float(self.speed),
        }

    def __str__(self) -> str:
        return " - ".join(self.between)


@dataclass(frozen=True)
class HingeSpring:
    """Springs and dampers on all hinges of a kind, beside the force field's own terms.

    Parameters
    ----------
    kind : str
        Kind of hinge, of ``phi psi omega chi rotors angles``, which the chain must have open.
    stiffness : float, kJ/mol/rad^2
        E = stiffness (1 - cos(q - q0)) of a dihedral, stiffness/2 (q - q0)^2 of a bond angle, with q0 the
        value at the start.
    damping : float, kJ/mol ps/rad^2
        Torque against the motion, over the rate of the hinge. With a thermostat random torques come with it,
        as many as keep the temperature.

    Raises
    ------
    ProtochainError
        If a number makes no sense, or the kind is unknown.
    """

    kind: str
    stiffness: float
    damping: float = 0.0

    def __post_init__(self) -> None:
        unit = "kilojoule_per_mole/radian/radian"
        check_fields(self, kind=text, stiffness=quantity(unit), damping=number)
        if self.kind not in HINGES:
            raise ProtochainError(f"kind {self.kind!r} is no kind of hinge; choose from {', '.join(HINGES)}")
        for name, value in (("stiffness", self.stiffness), ("damping", self.damping)):
            if not 0.0 <= value < np.inf:
                raise ProtochainError(f"{name} {value:g}: give 0 or more")

    @classmethod
    def read(cls, said: str, name: str = "hinge_springs") -> Self:
        """Read ``omega 40 0.5``: kind, stiffness, and damping if there is any."""
        kind, *rest = said.split() or [""]
        try:
            return cls(kind, *(float(word) for word in rest))
        except (TypeError, ValueError) as error:
            why = error.parts if isinstance(error, ProtochainError) else ("give kind, stiffness, damping",)
            raise ProtochainError(Argument(name), f" {said!r}: ", *why, ", as 'omega 40 0.5'") from None

    @classmethod
    def several(cls, value: Any, name: str = "hinge_springs") -> tuple[Self, ...]:
        """Read what :func:`protochain.simulate` takes: one, several, or texts of them."""
        given = value if isinstance(value, Iterable) and not isinstance(value, str) else (value,)
        springs = [cls.read(each, name) if isinstance(each, str) else each for each in given]
        for spring in springs:
            if not isinstance(spring, cls):
                raise refused(name, shown(spring), "give HingeSprings, as of 'omega 40 0.5'")
        return tuple(springs)

    def __str__(self) -> str:
        return f"{self.kind} {float(self.stiffness)!r} {float(self.damping)!r}"


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
    pull: Pull | None = None
    hinge_springs: tuple[HingeSpring, ...] = ()

    @property
    def thermal_energy(self) -> float:
        """Value of kT, kJ/mol."""
        return MOLAR_GAS * self.temperature

    def record(self) -> dict[str, Any]:
        """Return the settings as plain values by name."""
        plain = {field.name: getattr(self, field.name) for field in fields(self)}
        plain["hinge_springs"] = [str(spring) for spring in self.hinge_springs] or None
        return plain | ({"pull": None} if self.pull is None else self.pull.record())

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
                raise ProtochainError(
                    Argument(name), f" {value!r} is not known; choose from {', '.join(known)}"
                )
        if not 0.0 < self.time_step < np.inf:
            raise refused("time_step", f"{self.time_step:g} ps", "give a number above 0")
        if self.time_step >= LONGEST_STEP:
            raise ProtochainError(
                Argument("time_step"),
                f" {self.time_step:g} ps: no step of this length is stable; give picoseconds: "
                f"{self.time_step / 1000:g} are {self.time_step:g} fs",
            )
        if not 0.0 <= self.temperature < np.inf:
            raise refused("temperature", f"{self.temperature:g} K", "give 0 or more")
        if not 0.0 <= self.friction < np.inf:
            raise refused("friction", f"{self.friction:g} /ps", "give 0 or more")
        for name, count in (
            ("n_steps", n_steps), ("every", self.every), ("trajectory_length", self.trajectory_length),
            ("checkpoint_every", checkpoint_every),
        ):  # fmt: skip
            if count < 1:
                raise refused(name, count, "give at least 1")
        if self.seed < 0:
            raise refused("seed", self.seed, "give 0 or more")
        if self.pull is not None and abs(self.pull.speed) * self.time_step > FARTHEST_PULL:
            raise ProtochainError(
                f"pull: a speed of {self.pull.speed:g} nm/ps moves the spring by more than {FARTHEST_PULL:g} "
                f"nm in a step; give at most {FARTHEST_PULL / self.time_step:g}"
            )
        if self.thermostat == "nose-hoover" and not (self.temperature > 0.0 and self.friction > 0.0):
            raise ProtochainError(
                "nose-hoover: needs a ", Argument("temperature"), " and a ", Argument("friction"),
                " above 0; choose langevin",
            )  # fmt: skip
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
            if self.pull is not None and self.pull.speed != 0.0:
                raise ProtochainError(
                    f"{self.thermostat}: its trajectories are proposals, in no time in which a spring could "
                    "move; choose langevin, or a speed of 0"
                )
            if any(spring.damping > 0.0 for spring in self.hinge_springs):
                raise ProtochainError(
                    f"{self.thermostat}: draws velocities anew, which leaves a damper nothing to do; choose "
                    "langevin, or a damping of 0"
                )
        if self.loops == "closed" and self.integrator != "leapfrog":
            raise ProtochainError("loops closed: only the leapfrog supports constraints; choose it")


def build_thermostat(settings: SimulationSettings, freedoms: int) -> thermostats.Thermostat:
    """Thermostat of the settings for this number of degrees of freedom; it takes its fields by name."""
    kind: Any = THERMOSTATS[settings.thermostat]
    given = settings.record() | {"thermal_energy": settings.thermal_energy, "freedoms": freedoms}
    return kind(**{field.name: given[field.name] for field in fields(kind)})
