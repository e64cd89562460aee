"""Explicit Runge-Kutta methods for trees: high-order references, not for long runs (the energy drifts)."""

from dataclasses import dataclass

import numpy as np

from protochain.mechanics.motion.substeps import Tried, in_substeps
from protochain.mechanics.motion.system import Equations, Integrator, Phase


@dataclass(frozen=True)
class Tableau:
    """Butcher tableau of an explicit method.

    Parameters
    ----------
    a : (s, s) of float
        Strictly lower triangle.
    b : (s,) of float
    error : (s,) of float
        Weights b minus those of the embedded method.
    """

    a: tuple[tuple[float, ...], ...]
    b: tuple[float, ...]
    error: tuple[float, ...]


CLASSICAL = Tableau(
    a=(
        (0.0, 0.0, 0.0, 0.0),
        (1 / 2, 0.0, 0.0, 0.0),
        (0.0, 1 / 2, 0.0, 0.0),
        (0.0, 0.0, 1.0, 0.0),
    ),
    b=(1 / 6, 1 / 3, 1 / 3, 1 / 6),
    error=(0.0, 0.0, 0.0, 0.0),
)
"""Kutta (1901)."""

_FIFTH = (35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84, 0.0)
DORMAND_PRINCE = Tableau(
    a=(
        (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        (1 / 5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        (3 / 40, 9 / 40, 0.0, 0.0, 0.0, 0.0, 0.0),
        (44 / 45, -56 / 15, 32 / 9, 0.0, 0.0, 0.0, 0.0),
        (19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729, 0.0, 0.0, 0.0),
        (9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656, 0.0, 0.0),
        _FIFTH,
    ),
    b=_FIFTH,
    error=(71 / 57600, 0.0, -71 / 16695, 71 / 1920, -17253 / 339200, 22 / 525, -1 / 40),
)
"""Dormand, Prince, J. Comput. Appl. Math. 6:19 (1980), RK5(4)7M."""


@dataclass(frozen=True)
class RungeKutta4(Integrator):
    """Classical Runge-Kutta method of order four; free roots follow the exponential map.

    Munthe-Kaas, BIT 38:92 (1998): the displacement of a root within the step is integrated, so that
    quaternions keep unit length.
    """

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
        q, torque, loads = at.q, at.torque, at.loads
        if i:
            q, qd = system.driven_to(time, system.integrate(at.q, move), qd)
            _, torque, loads = system.forces(time, q, qd, system.factors(q))
        slopes[i] = system.displacement_rates(move, qd)
        accelerations[i], loads = system.accelerations(time, q, qd, torque, loads)
        if loads is not None:
            powers.append(loads @ qd)
    q, qd = system.integrate(at.q, b @ slopes), at.qd + b @ accelerations
    work = at.work + b @ powers if powers else at.work
    return system.at(q, qd, at.time + h, work), wrong @ slopes, wrong @ accelerations
