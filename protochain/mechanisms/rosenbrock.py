"""Linearly implicit Rosenbrock method for stiff springs and dampers: no iteration, stable for any step."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import lu_factor, lu_solve

from protochain.core.arrays import Floats
from protochain.core.checks import check_fields
from protochain.core.settings import document_fields
from protochain.mechanics.motion.substeps import TOLERANCE, Tried, in_substeps
from protochain.mechanics.motion.system import NOTHING, Equations, Integrator, Phase, StepTooLargeError

GAMMA = 1.0 - 1.0 / np.sqrt(2.0)
"""With it the method is L-stable: motions stiffer than the resolution of the step are damped at once."""
_LEAST, _MOST = 1e-15, 10_000
"""Shortest substep, relative to the step, which no step resolves, and the most substeps of a step."""
_NUDGE = 1e-6
"""Displacement for the derivatives by differences, in radians and sizes of the tree."""


@document_fields
@dataclass(frozen=True)
class Rosenbrock(Integrator):
    """ROS2: order two, L-stable, in substeps whose error is estimated by the method of order one within.

    With f the rates of displacement and velocity and J their derivatives, (1 - gamma h J) k1 = f(t, y) +
    gamma h f_t, (1 - gamma h J) k2 = f(t + h, y + h k1) - 2 k1 - gamma h f_t, and y + h (3 k1 + k2) / 2 is
    the end: Verwer, Spee, Blom, Hundsdorfer, SIAM J. Sci. Comput. 20:1456 (1999). Of order two with any J, so
    that differences are enough. They need 2 n_v + 1 accelerations a step, and the solution O(n_v^3): for
    mechanisms of up to some hundred freedoms.
    """

    # Error of a coordinate, or of a velocity times the time step, in radians and sizes of the tree, that
    # substeps permit. Smaller motions are damped.
    tolerance: float = 1e-6

    def __post_init__(self) -> None:
        check_fields(self, tolerance=TOLERANCE)

    @property
    def remedy(self) -> str:
        """Remedy for a time step that is too long."""
        closer = f"a shorter one, Rosenbrock({self.tolerance / 100:.1g})"
        return f"use {closer}, or ImplicitMidpoint(), which conserves the energy of vibrations"

    def step(self, system: Equations, at: Phase, time_step: float) -> Phase:
        """Advance by one time step, in as many substeps as the tolerance requires.

        Raises
        ------
        StepTooLargeError
            If no substep satisfies the tolerance, or the balance of energy and work.
        """

        def substep(at: Phase, h: float) -> Tried:
            after, moved, quickened = _advance(system, at, h)
            _check_balance(system, at, after, self.tolerance / abs(time_step) * system.units)
            return after, moved, quickened

        return in_substeps(substep, system, at, time_step, self.tolerance, 2, _LEAST, _MOST)


def _check_balance(system: Equations, at: Phase, after: Phase, speed: Floats) -> None:
    """Raise if energy changes by other than the work of the ends' powers, as of an unresolved damper."""
    # Motions up to ``speed`` (n_v,) may lose their energy, and forces their work at such speeds.
    work = after.work - at.work
    flow = max(at.kinetic, after.kinetic) + abs(after.potential - at.potential) + np.sum(np.abs(work))
    trace = 0.5 * float(system.momenta(after.factors, speed) @ speed)
    trace += abs(after.time - at.time) * float(np.maximum(at.effort, after.effort) @ speed)
    lack = after.total - at.total - np.sum(work)
    if abs(lack) > 1e-3 * flow + trace:
        raise StepTooLargeError(f"it loses {-lack:.2g} of {flow:.2g} of energy in motion, work not counted")


def _advance(system: Equations, at: Phase, h: float) -> Tried:
    n, driven = system.n_v, system.tree.driven_v

    def rates(time: float, move: Floats, qd: Floats) -> tuple[Floats, Floats, Floats]:
        """Rates of displacement and velocity, none of driven hinges, and power of loads and drive."""
        q, qd = system.driven_to(time, system.integrate(at.q, move), qd)
        factors = system.factors(q)
        _, torque, loads = system.forces(time, q, qd, factors)
        qdd, loads = system.accelerations(time, q, qd, torque, loads, factors)
        slope = system.displacement_rates(move, qd)
        slope[driven], qdd[driven] = 0.0, 0.0
        return slope, qdd, NOTHING if loads is None else loads @ qd

    still = np.zeros(n)
    slope, acceleration, power = rates(at.time, still, at.qd)
    nudge = _NUDGE * system.units
    # A velocity's nudge moves as far in a step as a coordinate's.
    push = nudge / abs(h)
    by_place, by_speed = np.zeros((n, n)), np.zeros((n, n))
    for k in np.setdiff1d(np.arange(n), driven):
        one = np.eye(1, n, k)[0]
        by_place[:, k] = (rates(at.time, nudge[k] * one, at.qd)[1] - acceleration) / nudge[k]
        by_speed[:, k] = (rates(at.time, still, at.qd + push[k] * one)[1] - acceleration) / push[k]
    g = GAMMA * h
    # Displacements change by velocities to first order, so that half of the equations are solved at once.
    factor = lu_factor(np.eye(n) - g * by_speed - g * g * by_place)

    def solve(place: Floats, speed: Floats) -> tuple[Floats, Floats]:
        k = lu_solve(factor, speed + g * by_place @ place)
        return place + g * k, k

    later = np.zeros(n)
    if system.loads or system.drive is not None:
        later = g * (rates(at.time + _NUDGE * h, still, at.qd)[1] - acceleration) / (_NUDGE * h)
    place, speed = solve(slope, acceleration + later)
    rate_at_end, quicker, power_there = rates(at.time + h, h * place, at.qd + h * speed)
    place_2, speed_2 = solve(rate_at_end - 2.0 * place, quicker - 2.0 * speed - later)
    q = system.integrate(at.q, h * (1.5 * place + 0.5 * place_2))
    qd = at.qd + h * (1.5 * speed + 0.5 * speed_2)
    work = at.work + 0.5 * h * (power + power_there)
    # Against the method of order one, y + h k1.
    return system.at(q, qd, at.time + h, work), 0.5 * h * (place + place_2), 0.5 * h * (speed + speed_2)
