"""What acts in a mechanism, as given to the builder: names and constants, not yet bound to bodies."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from protochain.arrays import Floats
from protochain.checks import shown
from protochain.errors import MechanicsError
from protochain.mechanisms.elements import Element
from protochain.motion import Load


@dataclass(frozen=True, eq=False)
class Spring:
    """Spring between two points."""

    ends: tuple[str, str]
    points: Floats
    stiffness: float
    damping: float
    rest: float | None


@dataclass(frozen=True, eq=False)
class Torsion:
    """Spring on a hinge."""

    hinge: str
    stiffness: float
    damping: float
    rest: float | None


@dataclass(frozen=True, eq=False)
class Bushing:
    """Elastic joint."""

    ends: tuple[str, str]
    points: Floats
    stiffness: Floats
    damping: Floats


@dataclass(frozen=True, eq=False)
class Pushed:
    """Force and moment on a body: constants (3,), functions, or None."""

    name: str
    body: str
    at: Floats
    force: Any
    moment: Any


@dataclass(frozen=True, eq=False)
class Turned:
    """Torque at a hinge: a constant, or a function."""

    name: str
    hinge: str
    value: Any


@dataclass(frozen=True, eq=False)
class Forced:
    """Element of the user's own."""

    element: Element | Load


@dataclass(frozen=True, eq=False)
class Driven:
    """Prescribed motion of a hinge."""

    hinge: str
    motion: Callable[[float], tuple[float, float, float]]

    def start(self) -> tuple[float, float]:
        """Coordinate and rate at the start."""
        q, qd, _ = self.at(0.0)
        return q, qd

    def at(self, time: float) -> tuple[float, float, float]:
        """Coordinate, rate and acceleration at a time.

        Raises
        ------
        MechanicsError
            If they are not three finite numbers.
        """
        found = self.motion(time)
        try:
            q, qd, qdd = (float(value) for value in found)
        except (TypeError, ValueError):
            q = qd = qdd = np.nan
        if not np.isfinite(q + qd + qdd):
            raise MechanicsError(
                f'drive of hinge "{self.hinge}": at time {time:g} it gives {shown(found)}; '
                "give coordinate, rate and acceleration, finite"
            )
        return q, qd, qdd


@dataclass(frozen=True, eq=False)
class Happening:
    """Event."""

    name: str
    value: Callable[..., float]
    jump: Callable[..., Any]
    passes: bool
