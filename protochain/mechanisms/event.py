"""Events: moments at which a value of the state falls through zero, and a march that stops at them."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import brentq

from protochain.core.errors import Fault, MechanicsError
from protochain.core.settings import document_fields
from protochain.mechanics.motion import Equations, Integrator, Phase
from protochain.mechanisms.bodies import State
from protochain.mechanisms.element_arguments import answer
from protochain.mechanisms.elements import Named

_SAME_TIME = 1e-12
"""Error of the time of an event, relative to the time step."""


@document_fields
class Happened(NamedTuple):
    """An event that has happened."""

    time: float  # When.
    name: str  # Its name.
    energy: float  # Kinetic energy that its jump gave, negative if it took some.


@dataclass(frozen=True, eq=False)
class Watched:
    """An event as integrators see it."""

    name: str  # Name, for messages.
    value: Callable[[Phase], float]  # Phase -> float: positive before the event.
    # System, phase -> phase from which the motion goes on, at the same time: with other velocities by
    # :meth:`Equations.with_velocities`.
    jump: Callable[[Any, Phase], Phase]
    # Whether the motion goes on below zero, as past a mark. Otherwise the value must rise again.
    passes: bool = False


@document_fields
@dataclass(frozen=True, eq=False)
class Event(Named, noun="event"):
    """Something that happens when a value falls through zero.

    Raises
    ------
    MechanicsError
        If the name is already in use, or a callable is not a function.
    """

    value: Callable[..., float]  # Function of the :class:`State`, positive before the event.
    # Function of the :class:`State`, whose velocities (n_v,) the motion goes on with, or None if it goes on
    # as it was.
    jump: Callable[..., Any]
    # Whether the motion goes on below zero, as past a mark. Otherwise the value must rise again.
    passes: bool = False

    def __post_init__(self) -> None:
        for name_of_callable in ("value", "jump"):
            if not callable(getattr(self, name_of_callable)):
                raise self.refusal(f"its {name_of_callable} must be a function of the state")

    def watch(self, state_of: Callable[[Phase], State], happened: list[Happened]) -> Watched:
        """Return it for ``march``. When the event happens, it is added to the list."""

        def value(at: Phase) -> float:
            number = float(answer(f"{self.label}: its value", self.value, state_of(at)))
            if np.isnan(number):
                raise self.refusal(f"its value is not a number at time {at.time:g}")
            return number

        def jump(system: Equations, at: Phase) -> Phase:
            qd = answer(f"{self.label}: its jump", self.jump, state_of(at))
            after = at
            if qd is not None:
                qd = np.array(qd, dtype=float)
                if qd.shape != (system.n_v,) or not np.all(np.isfinite(qd)):
                    raise self.refusal(f"its jump must give {system.n_v} finite velocities, or None to go on")
                after = system.with_velocities(at, qd)
            happened.append(Happened(at.time, self.name, after.kinetic - at.kinetic))
            return after

        return Watched(self.name, value, jump, self.passes)


def march(
    system: Equations,
    integrator: Integrator,
    at: Phase,
    until: float,
    time_step: float,
    events: Sequence[Watched] = (),
) -> Iterator[tuple[Phase, Watched | None]]:
    """Advance to a time, stopping at events."""
    # The time of an event is found by Brent's method on the length of the last step, to 1e-12 of a step; of
    # several in one step the earliest is taken; those of one time follow each other in the order given.
    if not time_step > 0.0:
        raise MechanicsError(f"the time step {time_step:g} must be positive")
    fired: tuple[Watched, ...] = ()
    while until - at.time > _SAME_TIME * time_step:
        h, after = _past(system, integrator, at, min(time_step, until - at.time), fired)
        # Rounding may leave an event that has been passed just above zero.
        passed = {id(event) for event in fired if event.passes}
        falling = [e for e in events if id(e) not in passed and e.value(at) >= 0.0 > e.value(after)]
        if not falling:
            at, fired = after, ()
            yield at, None
            continue
        moments = [_moment(system, integrator, at, h, event, time_step) for event in falling]
        first = min(moments)
        at = integrator.step(system, at, first) if first > 0.0 else at
        fired = tuple(
            e for e, s in zip(falling, moments, strict=True) if s - first <= 2.0 * _SAME_TIME * time_step
        )
        for event in fired:
            at = event.jump(system, at)
            yield at, event


def _past(
    system: Equations, integrator: Integrator, at: Phase, h: float, fired: tuple[Watched, ...]
) -> tuple[float, Phase]:
    """Take the longest of the steps h, h/2, h/4 ... after which events just past have risen above zero."""
    length = h
    while length > 2.0**-30 * h:
        after = integrator.step(system, at, length)
        low = [event for event in fired if not (event.passes or event.value(after) > 0.0)]
        if not low:
            return length, after
        length *= 0.5
    raise MechanicsError(
        f"{low[0].name}: its value is not above zero after its jump at time {at.time:g}; "
        "let the jump raise the value, or remove this event",
        fault=Fault.ENDLESS,
    )


def _moment(
    system: Equations, integrator: Integrator, at: Phase, h: float, event: Watched, time_step: float
) -> float:
    """Length of the step at whose end the value is zero."""

    def value(length: float) -> float:
        return event.value(integrator.step(system, at, length) if length > 0.0 else at)

    return float(brentq(value, 0.0, h, xtol=_SAME_TIME * time_step))
