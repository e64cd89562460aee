"""Substeps as long as an estimate of their error allows."""

from collections.abc import Callable

import numpy as np

from protochain.core.arrays import Floats
from protochain.core.checks import in_range, number
from protochain.core.errors import MechanicsError
from protochain.mechanics.motion.system import Equations, Phase, StepTooLargeError

TOLERANCE = in_range(number, lambda value: 0.0 < value < np.inf, "give a number above 0, as 1e-8")
"""Check of a tolerance."""
Tried = tuple[Phase, Floats, Floats]
"""Phase after a substep, and estimates of the errors of its displacement and velocities, (n_v,) each."""
_MOST = 100_000
"""Substeps of a step: ten seconds of a small tree, and far more than a motion without stiffness needs."""


def in_substeps(
    substep: Callable[[Phase, float], Tried], system: Equations, at: Phase, time_step: float,
    tolerance: float, order: int, least: float = 1e-9, n_most: int | None = None,
) -> Phase:  # fmt: skip
    """Advance by one time step, in substeps as the tolerance requires, none shorter than ``least`` of it."""
    start, elapsed, part = at.time, 0.0, time_step
    cause, fault = "", None
    n_most = n_most or _MOST
    for _ in range(n_most):
        if not abs(time_step - elapsed) > 1e-12 * abs(time_step):
            return system.at_time(at, start + time_step)
        part = part if abs(part) < abs(time_step - elapsed) else time_step - elapsed
        if abs(part) <= least * abs(time_step):
            raise StepTooLargeError(f"no substep of the time step is accurate{cause}", fault=fault)
        try:
            after, moved, quickened = substep(at, part)
            errors = np.maximum(np.abs(moved), abs(time_step) * np.abs(quickened)) / system.units
            size = float(np.max(errors, initial=0.0)) / tolerance if after.is_finite else np.nan
            cause, fault = "", None
        except (MechanicsError, StepTooLargeError) as error:
            # A stage has diverged to NaN, or come where there is no motion, or where no loop closes.
            size, cause, fault = np.nan, f" ({error})", error.fault
        # Hairer, Norsett, Wanner (1993), II.4: 0.9 of the estimated substep, within bounds.
        factor = min(5.0, max(0.2, 0.9 * size ** (-1.0 / order))) if np.isfinite(size) and size > 0.0 else 0.2
        if size <= 1.0:
            elapsed += part
            at = after
        elif factor > 0.9:
            factor = 0.9
        part *= 5.0 if size == 0.0 else factor
    raise StepTooLargeError(
        f"{n_most} substeps cover only {elapsed / time_step:.1g} of the time step: it is too stiff for "
        "this method or its tolerance"
    )
