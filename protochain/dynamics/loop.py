"""The one loop of dynamics: it steps, watches the energy, and reports; all else is done by its parts."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from protochain.arrays import Floats
from protochain.dynamics.overall import without_drift
from protochain.dynamics.system import Integrator, Phase, StepTooLargeError, System
from protochain.dynamics.thermostats import Bath, Thermostat
from protochain.errors import MechanicsError
from protochain.interrupts import held_interrupts
from protochain.multibody import sample_velocities

DRIFT_STEPS = 100
"""Steps after which what rounding gave to the motion of everything as one is taken away."""
BREACH = 0.2
"""Change of the conserved energy in one step, in parts of the thermal and kinetic energy, that no step within
its limit of stability makes: there it is some thousandths."""


class Ending(StrEnum):
    """How a simulation ended."""

    COMPLETED = "completed"
    INTERRUPTED = "interrupted"
    UNSTABLE = "unstable"


@dataclass(frozen=True, eq=False)
class Moment:
    """All that the rest of a simulation depends on.

    Parameters
    ----------
    step : int
    at : Phase
    bath : Bath
    """

    step: int
    at: Phase
    bath: Bath

    @property
    def conserved(self) -> float:
        """Energy of the system and of what its thermostat has of it, kJ/mol."""
        return self.at.total + self.bath.energy


@dataclass(frozen=True)
class Course:
    """How to step.

    Parameters
    ----------
    system : System
    integrator : Integrator
    thermostat : Thermostat
    time_step : float, ps
    thermal_energy : float, kJ/mol
        kT of the thermostat, or of the first velocities.
    seed : int
    stays : bool
        Whether the motion of everything as one is kept at zero.
    """

    system: System
    integrator: Integrator
    thermostat: Thermostat
    time_step: float
    thermal_energy: float
    seed: int
    stays: bool


def noise(seed: int, step: int) -> np.random.Generator:
    """Random numbers of one step, which depend on nothing but the seed and its number: so runs can go on."""
    return np.random.Generator(np.random.Philox(key=seed, counter=[0, 0, 0, step]))


def advance(course: Course, now: Moment) -> Moment:
    """Return the moment one time step later.

    Raises
    ------
    StepTooLargeError
        If the step has no solution, or its energy cannot be right.
    """
    step = now.step + 1
    try:
        at = _step(course, now.at)
    except StepTooLargeError:
        if not course.thermostat.undoes:
            raise
        at = replace(now.at, potential=np.inf)
    rng = noise(course.seed, step)
    at, bath = course.thermostat.apply(course.system, at, now.bath, course.time_step, rng)
    if course.stays and step % DRIFT_STEPS == 0:
        at = course.system.moving(at, without_drift(course.system.tree, at.factors.frames, at.qd))
    return Moment(step, at, bath)


def _step(course: Course, before: Phase) -> Phase:
    """Return the phase one time step later, if its energy can be right."""
    if not np.isfinite(before.potential):
        raise StepTooLargeError("the energy is not a number")
    try:
        at = course.integrator.step(course.system, before, course.time_step)
    except MechanicsError as error:
        raise StepTooLargeError(str(error)) from None
    if not at.is_finite:
        raise StepTooLargeError("the energy or a torque is not a number")
    jump = abs(at.total - before.total)
    thermal = 0.5 * len(at.qd) * course.thermal_energy
    if jump > BREACH * (thermal + before.kinetic) + course.thermal_energy + 1.0:
        raise StepTooLargeError(f"the energy changed by {jump:.3g} kJ/mol in one step")
    return at


def run(
    course: Course, start: Moment, n_steps: int, every: int, report: Callable[[Moment], None]
) -> tuple[Moment, Ending, str]:
    """Step until ``n_steps`` are done.

    Parameters
    ----------
    course : Course
    start : Moment
    n_steps : int
        Counted from the simulation's own start.
    every : int
        Steps between reports.
    report : callable
        Called at every multiple of ``every``.

    Returns
    -------
    Moment, Ending, str
        The last moment that is sound, how it ended, and why it ended early.
    """
    now = start
    with held_interrupts() as interrupts:
        while now.step < n_steps:
            if interrupts:
                return now, Ending.INTERRUPTED, ""
            try:
                now = advance(course, now)
            except StepTooLargeError as error:
                return now, Ending.UNSTABLE, str(error)
            if now.step % every == 0:
                report(now)
    return now, Ending.COMPLETED, ""


def initial(course: Course, q: Floats) -> Moment:
    """Begin at q with velocities drawn at the temperature."""
    system = course.system
    at = system.at(q, np.zeros(system.tree.n_v))
    qd = sample_velocities(system.tree, at.factors.frames, course.thermal_energy, noise(course.seed, 0))
    if course.stays:
        qd = without_drift(system.tree, at.factors.frames, qd)
    at = system.moving(at, qd)
    return Moment(0, at, course.thermostat.init(at))
