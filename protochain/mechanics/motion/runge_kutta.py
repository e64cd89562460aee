"""Explicit Runge-Kutta methods for trees: high-order references, not for long runs (the energy drifts)."""

from dataclasses import dataclass

import numpy as np

from protochain.core.checks import check_fields
from protochain.mechanics.motion.substeps import TOLERANCE, Tried, in_substeps
from protochain.mechanics.motion.system import Equations, Integrator, Phase
from protochain.mechanics.tableaux import CLASSICAL, DORMAND_PRINCE, Tableau


@dataclass(frozen=True)
class RungeKutta4(Integrator):
    """Classical Runge-Kutta method of order four; free roots follow the exponential map.

    Munthe-Kaas, BIT 38:92 (1998): the displacement of a root within the step is integrated, so that
    quaternions keep unit length.
    """

    @property
    def remedy(self) -> str:
        """What to take where a time step is too long."""
        return "take a shorter one, DormandPrince(), or for stiff dampers Rosenbrock()"

    def step(self, system: Equations, at: Phase, time_step: float) -> Phase:
        """Advance by one time step, with four evaluations of the potential."""
        return _advance(CLASSICAL, system, at, time_step)[0]


@dataclass(frozen=True)
class DormandPrince(Integrator):
    """Runge-Kutta method of order five with adaptive substeps.

    Parameters
    ----------
    tolerance : float
        Error of a coordinate, or of a velocity times the time step, in radians and sizes of the tree.
    """

    tolerance: float = 1e-8

    def __post_init__(self) -> None:
        check_fields(self, tolerance=TOLERANCE)

    @property
    def remedy(self) -> str:
        """What to take where a time step is too long."""
        return f"take DormandPrince({self.tolerance / 100:.1g}), or for stiff dampers Rosenbrock()"

    def step(self, system: Equations, at: Phase, time_step: float) -> Phase:
        """Advance by one time step, in as many substeps as the tolerance requires.

        Raises
        ------
        StepTooLargeError
            If a substep would have to be shorter than rounding allows.
        """

        def substep(at: Phase, h: float) -> Tried:
            return _advance(DORMAND_PRINCE, system, at, h)

        return in_substeps(substep, system, at, time_step, self.tolerance, order=5)


def _advance(tableau: Tableau, system: Equations, at: Phase, h: float) -> Tried:
    """Phase after one step, and estimates of the errors of its coordinates and velocities."""
    a, b, wrong = (h * np.array(weights) for weights in (tableau.a, tableau.b, tableau.error))
    slopes, accelerations = np.zeros((len(b), system.n_v)), np.zeros((len(b), system.n_v))
    # The sum of a row of the tableau is the time of its stage.
    times, powers = at.time + np.sum(a, axis=1), []
    for i, row in enumerate(a):
        time, move, qd = float(times[i]), row @ slopes, at.qd + row @ accelerations
        q, torque, loads, factors = at.q, at.torque, at.loads, at.factors
        if i:
            q, qd = system.driven_to(time, system.integrate(at.q, move), qd)
            factors = system.factors(q)
            _, torque, loads = system.forces(time, q, qd, factors)
        slopes[i] = system.displacement_rates(move, qd)
        accelerations[i], loads = system.accelerations(time, q, qd, torque, loads, factors)
        if loads is not None:
            powers.append(loads @ qd)
    q, qd = system.integrate(at.q, b @ slopes), at.qd + b @ accelerations
    work = at.work + b @ powers if powers else at.work
    return system.at(q, qd, at.time + h, work), wrong @ slopes, wrong @ accelerations
