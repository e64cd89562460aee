"""Explicit Runge-Kutta methods for trees: high-order references, not for long runs (the energy drifts)."""

from dataclasses import dataclass

import numpy as np

from protochain import multibody
from protochain.arrays import Floats
from protochain.dynamics.system import Integrator, Phase, StepTooLargeError, System
from protochain.errors import MechanicsError
from protochain.multibody.rotations import displacement_rates


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

    def step(self, system: System, at: Phase, time_step: float) -> Phase:
        """Advance by one time step, with four evaluations of the potential."""
        q, qd, _ = _advance(CLASSICAL, system, at, time_step)
        return system.at(q, qd)


@dataclass(frozen=True)
class DormandPrince(Integrator):
    """Runge-Kutta method of order five with adaptive substeps.

    Parameters
    ----------
    tolerance : float
        Error of a coordinate (rad, nm) or a velocity, relative to 1 + the largest velocity.
    """

    tolerance: float = 1e-8

    def step(self, system: System, at: Phase, time_step: float) -> Phase:
        """Advance by one time step, in as many substeps as the tolerance requires.

        Raises
        ------
        StepTooLargeError
            If a substep would have to be shorter than rounding allows.
        """
        done, part = 0.0, time_step
        while abs(time_step - done) > 1e-12 * abs(time_step):
            part = part if abs(part) < abs(time_step - done) else time_step - done
            if abs(part) < 1e-9 * abs(time_step):
                raise StepTooLargeError(
                    f"no substep of a time step of {1000 * abs(time_step):g} fs is accurate"
                )
            try:
                q, qd, error = _advance(DORMAND_PRINCE, system, at, part)
                size = np.max(error / (1.0 + np.max(np.abs(at.qd)))) / self.tolerance
            except MechanicsError:
                # A stage has diverged to NaN.
                size = np.nan
            # Hairer, Norsett, Wanner (1993), II.4: 0.9 of the estimated substep, within bounds.
            factor = min(5.0, max(0.2, 0.9 * size**-0.2)) if np.isfinite(size) and size > 0.0 else 0.2
            if size <= 1.0:
                done += part
                at = system.at(q, qd)
            elif factor > 0.9:
                factor = 0.9
            part *= 5.0 if size == 0.0 else factor
        return at


def _advance(tableau: Tableau, system: System, at: Phase, h: float) -> tuple[Floats, Floats, Floats]:
    """Coordinates and velocities after one step, and an estimate of the error of each freedom."""
    tree = system.tree
    a, b, wrong = (h * np.array(weights) for weights in (tableau.a, tableau.b, tableau.error))
    slopes, accelerations = np.zeros((len(b), tree.n_v)), np.zeros((len(b), tree.n_v))
    for i, row in enumerate(a):
        move, qd = row @ slopes, at.qd + row @ accelerations
        q, torque = at.q, at.torque
        if i:
            q = multibody.integrate(tree, at.q, move)
            _, torque = system.potential(q, system.factors(q))
        slopes[i] = displacement_rates(tree, move, qd)
        accelerations[i] = multibody.forward_dynamics(tree, q, qd, torque)
    error = np.maximum(np.abs(wrong @ slopes), np.abs(wrong @ accelerations))
    return multibody.integrate(tree, at.q, b @ slopes), at.qd + b @ accelerations, error
