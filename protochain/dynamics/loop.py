"""Main loop of dynamics: advances the state, checks the energy and reports."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import partial

import numpy as np

from protochain.core.arrays import Floats
from protochain.core.errors import MechanicsError
from protochain.core.interrupts import held_interrupts
from protochain.core.settings import document_fields
from protochain.dynamics.hinge_springs import Dampers
from protochain.dynamics.thermostats import Bath, Thermostat
from protochain.mechanics import multibody
from protochain.mechanics.motion.system import Integrator, Phase, StepTooLargeError, System
from protochain.mechanics.multibody import Frames, Tree, sample_velocities


class Ending(StrEnum):
    """Outcome of a simulation."""

    COMPLETED = "completed"
    INTERRUPTED = "interrupted"
    UNSTABLE = "unstable"


@document_fields
@dataclass(frozen=True, eq=False)
class State:
    """Complete state of a simulation, from which it can continue."""

    step: int  # Number of steps since the start.
    at: Phase  # Point in phase space.
    bath: Bath  # State of the thermostat.
    damped: float = 0.0  # kJ/mol: Energy transferred to the dampers of hinges.

    @property
    def conserved_energy(self) -> float:
        """Conserved quantity, kJ/mol: total energy, plus energy of heat bath and dampers, minus the work."""
        return self.at.total - float(np.sum(self.at.work)) + self.bath.energy + self.damped


@document_fields
@dataclass(frozen=True)
class Propagator:
    """System, integrator and thermostat, with the numbers that define a step."""

    system: System  # Rigid bodies in a potential.
    integrator: Integrator  # Integrator of the equations of motion.
    thermostat: Thermostat  # Thermostat, applied after each step of the integrator.
    time_step: float  # ps: Length of a step.
    thermal_energy: float  # kJ/mol: Value of kT for the thermostat and the initial velocities.
    seed: int  # Seed of all random numbers.
    removes_com_motion: bool  # Whether centre-of-mass translation and rotation are removed.
    # Dampers of hinges, which act for half a step before and after the integrator.
    dampers: Dampers | None = None


def noise(seed: int, step: int, stream: int = 0) -> np.random.Generator:
    """Random generator of one step. It depends only on seed and step, so that runs can be resumed."""
    return np.random.Generator(np.random.Philox(key=seed, counter=[0, 0, stream, step]))


def advance(propagator: Propagator, state: State) -> State:
    """Return the state one time step later.

    Parameters
    ----------
    propagator : Propagator
        System, integrator and thermostat.
    state : State
        State to advance from.

    Returns
    -------
    State
        State after the step and the thermostat.

    Raises
    ------
    StepTooLargeError
        If the step has no solution, or changes the energy too much.

    Notes
    -----
    Metropolis' criterion requires a reverse for every step. A step whose reverse would fail is rejected
    (Zappa, Holmes-Cerfon, Goodman, Commun. Pure Appl. Math. 71:2609, 2018).
    """
    step, at, damped, dampers = state.step + 1, state.at, state.damped, propagator.dampers
    if dampers is not None:
        shake = noise(propagator.seed, step, 1)
        at, damped = _apply_dampers(propagator, dampers, at, damped, shake)
    try:
        at = _step(propagator, at)
    except StepTooLargeError:
        if not propagator.thermostat.metropolis:
            raise
        at = replace(state.at, potential=np.inf)
    if dampers is not None:
        at, damped = _apply_dampers(propagator, dampers, at, damped, shake)
    system, thermostat = propagator.system, propagator.thermostat
    random = partial(noise, propagator.seed, step)
    at, bath = thermostat.apply(system, at, state.bath, propagator.time_step, random)
    # Centre-of-mass motion accumulates by rounding.
    if propagator.removes_com_motion and step % 100 == 0:
        at = system.with_velocities(at, remove_com_motion(system.tree, at.factors.frames, at.qd))
    return State(step, at, bath, damped)


def _apply_dampers(
    propagator: Propagator, dampers: Dampers, at: Phase, damped: float, shake: np.random.Generator
) -> tuple[Phase, float]:
    """Apply the dampers for half a step. Return also their energy after it."""
    after = dampers.apply(propagator.system, at, 0.5 * abs(propagator.time_step), shake)
    return after, damped + at.kinetic - after.kinetic


def _step(propagator: Propagator, before: Phase) -> Phase:
    """Return the phase one time step later, if the energy change is within bounds."""
    if not np.isfinite(before.potential):
        raise StepTooLargeError("the energy is not a number")
    system, integrator, h = propagator.system, propagator.integrator, propagator.time_step
    try:
        at = integrator.step(system, before, h)
        if propagator.thermostat.metropolis and at.is_finite:
            integrator.check_return(system, before, at, h)
    except (MechanicsError, StepTooLargeError) as error:
        raise StepTooLargeError(f"{error} ({1000 * abs(h):g} fs)") from None
    if not at.is_finite:
        raise StepTooLargeError("the energy or a torque is not a number")
    jump = abs(at.total - before.total - float(np.sum(at.work - before.work)))
    thermal = 0.5 * len(at.qd) * propagator.thermal_energy
    # Stable steps change the energy by thousandths. The larger kinetic energy of both ends counts, so that
    # reverse steps are refused alike.
    if jump > 0.2 * (thermal + max(before.kinetic, at.kinetic)) + propagator.thermal_energy + 1.0:
        raise StepTooLargeError(f"the energy changed by {jump:.3g} kJ/mol in one step")
    return at


def run(
    propagator: Propagator, start: State, n_steps: int, interval: int, report: Callable[[State], None]
) -> tuple[State, Ending, str]:
    """Advance a simulation to step ``n_steps``.

    Parameters
    ----------
    propagator : Propagator
        System, integrator and thermostat.
    start : State
        State to continue from.
    n_steps : int
        Number of the last step, counted from the start of the simulation.
    interval : int
        Steps between reports.
    report : callable
        Called with the state at every multiple of ``interval``.

    Returns
    -------
    State, Ending, str
        Last valid state, outcome, and the reason if the run has become unstable.
    """
    state = start
    with held_interrupts() as interrupts:
        while state.step < n_steps:
            if interrupts:
                return state, Ending.INTERRUPTED, ""
            try:
                state = advance(propagator, state)
            except StepTooLargeError as error:
                return state, Ending.UNSTABLE, str(error)
            if state.step % interval == 0:
                report(state)
    return state, Ending.COMPLETED, ""


def initial(propagator: Propagator, q: Floats) -> State:
    """Draw velocities at the temperature for a simulation that starts at q.

    Parameters
    ----------
    propagator : Propagator
        System, integrator and thermostat.
    q : (n_q,) float
        Coordinates.

    Returns
    -------
    State
        State at step 0.
    """
    system, kt = propagator.system, propagator.thermal_energy
    at = system.at(q, np.zeros(system.tree.n_v))
    qd = sample_velocities(system.tree, at.factors.frames, kt, noise(propagator.seed, 0))
    if propagator.removes_com_motion:
        qd = remove_com_motion(system.tree, at.factors.frames, qd)
    at = system.with_velocities(at, qd)
    return State(0, at, propagator.thermostat.init(at))


def remove_com_motion(tree: Tree, frames: Frames, qd: Floats) -> Floats:
    """Remove translation and rotation of the whole from velocities (n_v,), if all roots are free."""
    centre = multibody.centre_of_mass(tree, frames)
    turns = [_rigid_motion(tree, frames, axis, np.zeros(3), centre) for axis in np.eye(3)]
    inertia = np.stack([multibody.momentum(tree, frames, turn)[1] for turn in turns], axis=1)
    linear, angular = multibody.momentum(tree, frames, qd)
    # A lone diatomic has neither inertia nor angular momentum about its axis.
    omega = np.asarray(np.linalg.lstsq(inertia, angular, rcond=1e-12)[0], dtype=np.float64)
    return np.asarray(qd - _rigid_motion(tree, frames, omega, linear / tree.mass.sum(), centre))


def _rigid_motion(tree: Tree, frames: Frames, omega: Floats, u: Floats, centre: Floats) -> Floats:
    """Velocities of the roots for a rotation of the whole system about the centre and a translation."""
    qd = np.zeros(tree.n_v)
    for b in np.flatnonzero(tree.parent < 0):
        k = tree.v_start[b]
        qd[k : k + 3], qd[k + 3 : k + 6] = omega, u + np.cross(omega, frames.origin[b] - centre)
    return qd
