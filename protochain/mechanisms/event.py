"""Events of a mechanism: what happens when a value of its state falls through zero."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from protochain.core.errors import MechanicsError
from protochain.mechanics.motion import Equations, Phase
from protochain.mechanisms.bodies import State
from protochain.mechanisms.element_arguments import answer
from protochain.mechanisms.elements import Named
from protochain.mechanisms.march import Event as Watched


class Happened(NamedTuple):
    """An event that has happened.

    Parameters
    ----------
    time : float
        When.
    name : str
        Its name.
    energy : float
        Kinetic energy that its jump gave, negative if it took some.
    """

    time: float
    name: str
    energy: float


@dataclass(frozen=True, eq=False)
class Event(Named):
    """Something that happens when a value falls through zero.

    Parameters
    ----------
    name : str
        Name.
    value : callable
        :class:`State` -> float, positive before the event.
    jump : callable
        :class:`State` -> velocities (n_v,) from which the motion goes on, or None if it goes on as it was.
    passes : bool
        Whether the motion goes on below zero, as past a mark. Otherwise the value must rise again.

    Raises
    ------
    MechanicsError
        If the name is already in use, or a callable is not a function.
    """

    noun: ClassVar[str] = "event"

    value: Callable[..., float]
    jump: Callable[..., Any]
    passes: bool = False

    def __post_init__(self) -> None:
        for name_of_callable in ("value", "jump"):
            if not callable(getattr(self, name_of_callable)):
                raise MechanicsError(f"{self.label}: its {name_of_callable} must be a function of the state")

    def watch(self, state_of: Callable[[Phase], State], happened: list[Happened]) -> Watched:
        """Return it for ``march``. When the event happens, it is added to the list."""

        def value(at: Phase) -> float:
            number = float(answer(f"{self.label}: its value", self.value, state_of(at)))
            if np.isnan(number):
                raise MechanicsError(f"{self.label}: its value is not a number at time {at.time:g}")
            return number

        def jump(system: Equations, at: Phase) -> Phase:
            qd = answer(f"{self.label}: its jump", self.jump, state_of(at))
            after = at
            if qd is not None:
                qd = np.array(qd, dtype=float)
                if qd.shape != (system.n_v,) or not np.all(np.isfinite(qd)):
                    raise MechanicsError(
                        f"{self.label}: its jump must give {system.n_v} finite velocities, or None to go on"
                    )
                after = system.with_velocities(at, qd)
            happened.append(Happened(at.time, self.name, after.kinetic - at.kinetic))
            return after

        return Watched(self.name, value, jump, self.passes)
