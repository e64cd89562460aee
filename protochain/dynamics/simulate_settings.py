"""Settings of a simulation, shared by the call and the command."""

import math
from collections.abc import Iterable
from dataclasses import MISSING, dataclass, fields
from typing import Any, Self

from protochain.chains.restraint import Restraint
from protochain.chains.restraint_lines import read_restraints
from protochain.core import defaults
from protochain.core.checks import (
    Check,
    at_least,
    brief,
    check_fields,
    ends,
    flag,
    in_range,
    number,
    optional,
    quantity,
    refuse_unknown,
    text,
)
from protochain.core.errors import Argument, ProtochainError, refusal
from protochain.core.settings import Settings, document_fields, setting
from protochain.core.units import MOLAR_GAS

LONGEST_STEP = 0.5
"""ps. Steps of bodies with springs are below a hundredth of this. A larger value was probably meant in fs."""
_SHORTEST = 0.015
"""fs. Less than a thousandth of any useful step. A smaller value was probably meant in picoseconds."""

FARTHEST_PULL = 0.1
"""nm. An atom's radius. A speed that moves a spring farther in a step was probably meant in other units."""


@document_fields
@dataclass(frozen=True)
class Pull(Settings):
    """Spring between two places of a structure, whose rest length changes at constant speed.

    Raises
    ------
    ProtochainError
        If a number makes no sense, or the places cannot be read.

    Examples
    --------
    >>> pc.Pull("A:1:N-A:20:C", speed=0.01).between
    ('A:1:N', 'A:20:C')
    """

    # Two atoms, ``("A:1:N", "A:20:C")`` or ``"A:1:N-A:20:C"``: chain, number with insertion code, name. A
    # residue, ``A:20``, or a selection in MDAnalysis's language means its centre of mass. Two of these in one
    # text are separated by a dash with blanks, ``" - "``.
    between: tuple[str, str] = setting(
        MISSING,
        "Pull two atoms apart by a moving spring, or residues (A:1-A:20), or selections around ' - '.",
        ends, option="--pull", metavar="A:1:N-A:20:C",
    )  # fmt: skip
    stiffness: float = setting(
        defaults.PULL_STIFFNESS, "Stiffness of the pulling spring, kJ/mol/nm^2.",
        quantity("kilojoule_per_mole/nanometer/nanometer"), float, "--pull-stiffness", metavar="K",
    )  # fmt: skip
    # nm/ps: At which its rest length grows from the initial distance. Below 0 it shrinks, at most to 0.
    speed: float = setting(
        defaults.PULL_SPEED, "Speed of the spring's length, nm/ps, below 0 together, 0 constant.",
        quantity("nanometer/picosecond"), float, "--pull-speed", metavar="NM/PS",
    )  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0.0 < self.stiffness < math.inf:
            raise ProtochainError(f"stiffness {self.stiffness:g} kJ/mol/nm^2: give a number above 0")
        if not math.isfinite(self.speed):
            raise ProtochainError(f"speed {self.speed:g} nm/ps: give a finite number")

    @classmethod
    def of(cls, value: Any, name: str = "pull") -> "Pull | None":
        """Read an argument of :func:`protochain.simulate`: a Pull, two places, or None."""
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


@document_fields
@dataclass(frozen=True)
class HingeSpring:
    """Springs and dampers on all hinges of a kind, or on one, in addition to the force field.

    Raises
    ------
    ProtochainError
        If a number makes no sense, or the kind is unknown.

    Examples
    --------
    >>> pc.HingeSpring("phi", 100.0).kind
    'phi'
    """

    # Kind of hinge, of ``phi psi omega chi rotors angles nucleic ligand glycan``, which must be open in the
    # chain, or one hinge, as ``phi@A:3`` or ``phi A:3``.
    kind: str
    # kJ/mol/rad^2: E = stiffness (1 - cos(q - q0)) of a dihedral, stiffness/2 (q - q0)^2 of a bond angle,
    # with q0 the value at the start.
    stiffness: float
    # kJ/mol ps/rad^2: Torque against the motion, divided by the hinge's rate. Thermostats add random torques.
    damping: float = 0.0

    def __post_init__(self) -> None:
        from protochain.chains.hinges import HINGES

        unit = "kilojoule_per_mole/radian/radian"
        check_fields(self, kind=text, stiffness=quantity(unit), damping=number)
        # Polar hinges are rotors.
        kinds = [kind for kind in HINGES if kind != "polar"]
        kind, _, place = self.kind.replace("@", " ").partition(" ")
        if (kind.rstrip("12345") if place else kind) not in kinds:
            raise ProtochainError(f"kind {self.kind!r} is not a hinge kind; choose from {', '.join(kinds)}")
        for name, value in (("stiffness", self.stiffness), ("damping", self.damping)):
            if not 0.0 <= value < math.inf:
                raise ProtochainError(f"{name} {value:g}: give 0 or more")

    @classmethod
    def read(cls, stated: str, name: str = "hinge_springs") -> Self:
        """Read ``omega 40 0.5``: kind, stiffness, and optional damping."""
        kind, *numbers = stated.split() or [""]
        try:
            return cls(kind, *(float(word) for word in numbers))
        except (TypeError, ValueError) as error:
            reason = error.parts if isinstance(error, ProtochainError) else ("give kind, stiffness, damping",)
            raise ProtochainError(Argument(name), f" {stated!r}: ", *reason, ", as 'omega 40 0.5'") from None

    @classmethod
    def several(cls, value: Any, name: str = "hinge_springs") -> tuple[Self, ...]:
        """Read an argument of :func:`protochain.simulate`: one, several, or texts of them."""
        items = value if isinstance(value, Iterable) and not isinstance(value, str) else (value,)
        springs = [cls.read(item, name) if isinstance(item, str) else item for item in items]
        for spring in springs:
            if not isinstance(spring, cls):
                raise refusal(name, brief(spring), "give HingeSprings, as 'omega 40 0.5'")
        return tuple(springs)

    def __str__(self) -> str:
        return f"{self.kind} {float(self.stiffness)!r} {float(self.damping)!r}"


def _picoseconds(femtoseconds: float) -> float:
    """Time step of the command line, or an error if it was probably meant in another unit."""
    text = f"{femtoseconds:g} fs"
    if not 0.0 < femtoseconds < 1000.0 * LONGEST_STEP:
        raise refusal("time_step", text, f"give a number above 0 and below {1000.0 * LONGEST_STEP:g}")
    if femtoseconds < _SHORTEST:
        raise refusal(
            "time_step", text, f"give femtoseconds: {1000.0 * femtoseconds:g} are {femtoseconds:g} ps"
        )
    return femtoseconds / 1000.0


def _not_negative(unit: str, shown_as: str) -> Check:
    return in_range(quantity(unit), lambda value: 0.0 <= value < math.inf, "give 0 or more", shown_as)


@dataclass(frozen=True, kw_only=True)
class SimulationSettings(Settings):
    """Settings that define a simulation. :func:`protochain.simulate` explains them."""

    temperature: float = setting(
        defaults.TEMPERATURE, "Temperature of the thermostat and of the initial velocities, K.",
        _not_negative("kelvin", "K"), float,
    )  # fmt: skip
    time_step: float = setting(
        defaults.TIME_STEP, f"Time step, fs [default: {1000.0 * defaults.TIME_STEP:g}].",
        in_range(quantity("picosecond"), lambda step: 0.0 < step < math.inf, "give a number above 0", "ps"),
        float, read=_picoseconds, doc="Time step, ps.",
    )  # fmt: skip
    thermostat: str = setting(defaults.THERMOSTAT, "langevin, nose-hoover, rescale, hmc or none.", text)
    friction: float = setting(
        defaults.FRICTION, "Coupling of the thermostat, 1/ps.", _not_negative("1/picosecond", "/ps"), float
    )
    integrator: str = setting(
        defaults.INTEGRATOR, "leapfrog, lobatto, midpoint, rk4 or dormand-prince.", text,
        doc="``leapfrog`` (reversible, one energy a step), ``lobatto`` (as good for short chains), "
        "``midpoint`` (implicit, for stiff springs), ``rk4`` or ``dormand-prince`` (references).",
    )  # fmt: skip
    fixman: bool = setting(
        False, "Add Fixman's potential, against the bias of rigid bonds and angles.", flag, bool
    )
    loops: str = setting(
        defaults.LOOPS, "Disulfides: open (force field) or closed (constraints).", text,
        doc="Disulfides and other bonds at which loops were cut: ``open`` uses only the force field, "
        "``closed`` constrains their lengths and angles to the values at q.",
    )  # fmt: skip
    hydrogen_mass: float | None = setting(
        None, "Mass of hydrogens, repartitioned from their heavy atoms, amu.", optional(quantity("dalton")),
        float,
    )  # fmt: skip
    trajectory_length: int = setting(
        defaults.TRAJECTORY_LENGTH, "Steps in each trajectory of hmc.", at_least(1), int
    )
    every: int = setting(defaults.EVERY, "Steps between frames and rows of the log.", at_least(1), int)
    seed: int = setting(defaults.SEED, "Seed of all random numbers.", at_least(0), int)
    pull: Pull | None = setting(
        None, "", Pull.of, type="Pull or str, optional",
        doc="Spring that pulls two places apart, or together, at constant speed. The log has its distance, "
        'extension, force and work. A text, as ``"A:1:N-A:20:C"``, uses the default stiffness and speed.',
    )  # fmt: skip
    hinge_springs: tuple[HingeSpring, ...] = setting(
        (), "Spring (kJ/mol/rad^2) and damper (kJ/mol ps/rad^2) on all hinges of a kind, as 'omega 40 0.5'.",
        HingeSpring.several, list[str], "--hinge-spring", metavar="'KIND K C'",
        type="HingeSpring, str, or sequence of them",
    )  # fmt: skip
    restraints: tuple[Restraint, ...] = setting(
        (), "Restraint, as 'distance A:3:CA A:9:CA 0 6 1000' (angstrom, kJ/mol/nm^2), or a file of them.",
        read_restraints, list[str], "--restraints --restrain", metavar="LINE|FILE",
        type="Restraint, str, path-like, or sequence of them",
        doc="Restraints, their lines, or a file of them. The log has their energy.",
    )  # fmt: skip
    superpose: bool = setting(
        True, "Write positions of the run without superposition on the start.", flag, bool, "--no-superpose",
        doc="Superpose all positions on the start of the run, and the start on the input. A molecule with "
        "external forces, such as restraints of positions, is not superposed.",
    )  # fmt: skip

    def __post_init__(self) -> None:
        from protochain.dynamics.integrators import INTEGRATORS
        from protochain.dynamics.thermostats import THERMOSTATS

        super().__post_init__()
        refuse_unknown(self.thermostat, "thermostat", THERMOSTATS)
        refuse_unknown(self.integrator, "integrator", INTEGRATORS)
        refuse_unknown(self.loops, "loops", ("open", "closed"))
        if self.time_step >= LONGEST_STEP:
            raise ProtochainError(
                Argument("time_step"),
                f" {self.time_step:g} ps: this step is too long to be stable; give picoseconds: "
                f"{self.time_step / 1000:g} are {self.time_step:g} fs",
            )
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
                    f"{self.thermostat}: its trajectories are proposals without a time, so a spring cannot "
                    "move; choose langevin, or a speed of 0"
                )
            if any(spring.damping > 0.0 for spring in self.hinge_springs):
                raise ProtochainError(
                    f"{self.thermostat}: redraws velocities, so a damper has no effect; choose "
                    "langevin, or a damping of 0"
                )
        if self.loops == "closed" and self.integrator != "leapfrog":
            raise ProtochainError("loops closed: only the leapfrog supports constraints; choose it")

    @property
    def thermal_energy(self) -> float:
        """Value of kT, kJ/mol."""
        return MOLAR_GAS * self.temperature

    def record(self) -> dict[str, Any]:
        """Return the settings as plain values by name."""
        # Files have the singular of restraints.
        plain = {f.name.replace("restraints", "restraint"): getattr(self, f.name) for f in fields(self)}
        for name in ("hinge_springs", "restraint"):
            plain[name] = [str(value) for value in plain[name]] or None
        return plain | ({"pull": None} if self.pull is None else self.pull.record())


@dataclass(frozen=True, kw_only=True)
class RunSettings(Settings):
    """Length of a simulation and contents of its folder. A resumed run may change these settings."""

    n_steps: int = setting(
        defaults.N_STEPS, "Total number of time steps.", at_least(1), int, "--steps",
        doc="Number of steps in all, including those before a resumed run.",
    )  # fmt: skip
    trajectory: str = setting(
        defaults.TRAJECTORY, "dcd or xtc.", text, doc="Format of the trajectory, ``dcd`` or ``xtc``."
    )
    checkpoint_every: int = setting(defaults.CHECKPOINT_EVERY, "Rows between checkpoints.", at_least(1), int)
    resume: bool = setting(
        False, "Continue the simulation in DIR.", flag, bool,
        doc="Continue the simulation in the folder, bit for bit as if it had not been stopped.",
    )  # fmt: skip
    force: bool = setting(
        False, "Replace the simulation in DIR.", flag, bool, doc="Replace the simulation in the folder."
    )
