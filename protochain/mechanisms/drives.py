"""Hinges whose motion is prescribed."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from protochain.core.arrays import Floats
from protochain.core.checks import brief
from protochain.core.errors import MechanicsError
from protochain.mechanics.motion import Drive
from protochain.mechanisms.bodies import Bodies
from protochain.mechanisms.element_arguments import answer
from protochain.mechanisms.elements import Named


@dataclass(frozen=True, eq=False)
class Driven(Named):
    """Prescribed motion of a hinge, by its name: time -> coordinate, rate, acceleration."""

    noun: ClassVar[str] = "drive of hinge"

    motion: Callable[[float], tuple[float, float, float]]

    def __post_init__(self) -> None:
        if not callable(self.motion):
            raise MechanicsError(
                f"{self.label}: motion {brief(self.motion)}: give a function of time, as lambda t: (t, 1, 0)"
            )

    def at(self, time: float) -> tuple[float, float, float]:
        """Coordinate, rate and acceleration at a time."""
        values = answer(f"{self.label}: its motion", self.motion, time)
        try:
            q, qd, qdd = (float(value) for value in values)
        except (TypeError, ValueError):
            q = qd = qdd = np.nan
        if not np.isfinite(q + qd + qdd):
            raise MechanicsError(
                f"{self.label}: at time {time:g} it gives {brief(values)}; "
                "give coordinate, rate and acceleration, finite"
            )
        return q, qd, qdd


def drive_of(bodies: Bodies, drives: Sequence[Driven]) -> Drive:
    """All drives as one, in the order of the tree."""
    ordered = sorted(drives, key=lambda driven: bodies.hinge(driven.name))
    units = np.array([bodies.unit(driven.name) for driven in ordered])

    def drive(time: float) -> tuple[Floats, Floats, Floats]:
        q, qd, qdd = np.array([driven.at(time) for driven in ordered]).T * units
        return q, qd, qdd

    return drive


def check_drive(bodies: Bodies, drive: Drive, time: float, nudge: float) -> None:
    """Raise if a drive's rates and accelerations are not the derivatives of its coordinates and rates."""
    tree = bodies.tree
    before, at, after = (np.array(drive(t)) for t in (time - nudge, time, time + nudge))
    change = (after[:2] - before[:2]) / (2.0 * nudge)
    # A hundredth, and what the differences are rounded by: a start from rest cancels terms of order one.
    rounded = (1e-12 * np.abs(at[:2]) + 1e-13 * tree.units[tree.driven_v]) / nudge
    allowed = 0.01 * np.maximum(np.abs(change), np.abs(at[1:])) + rounded
    if np.any(np.abs(change - at[1:]) > allowed):
        row, k = (int(i) for i in np.argwhere(np.abs(change - at[1:]) > allowed)[0])
        driven = [hinge for hinge, b in bodies.hinges.items() if tree.v_start[b] in tree.driven_v]
        name = sorted(driven, key=bodies.hinge)[k]
        noun, rate = ("coordinate", "rate") if row == 0 else ("rate", "acceleration")
        raise MechanicsError(
            f'drive of hinge "{name}": at time {time:g} its {noun} changes by {change[row, k]:g} per time, '
            f"but its {rate} is {at[row + 1, k]:g}; give the derivative"
        )
